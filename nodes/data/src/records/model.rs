//! Trained models. The crate that trains them defines the meaning of their tensors.

use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles};

const FILE: &str = "model.safetensors";

/// The bytes of a trained model, in the safetensors format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFile(pub Vec<u8>);

impl Media for ModelFile {
    const NAME: &'static str = "tauflow/model";
    const DOC: &'static str = "A trained model: `model.safetensors`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        Ok(Self(ctx.part(artifact, "")?))
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        Ok(Stored::blob(ctx.put(&self.0)?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        to.put(FILE, &Self::load(ctx, artifact)?.0)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        Self(from.need(FILE)?).store(ctx)
    }
}
