//! Trained models. The crate that trains them defines the meaning of their tensors.

use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles};

const FILE: &str = "model.safetensors";

/// The bytes of a trained model, in the safetensors format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFile(pub Vec<u8>);

/// The bytes of a transport adapter, in the safetensors format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterFile(pub Vec<u8>);

/// The bytes of the weights of a perceptual distance, in the safetensors format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PerceptualFile(pub Vec<u8>);

/// A media type that is one safetensors file.
macro_rules! safetensors_media {
    ($type:ident, $name:literal, $doc:literal) => {
        impl Media for $type {
            const NAME: &'static str = $name;
            const DOC: &'static str = $doc;

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
    };
}

safetensors_media!(ModelFile, "tauflow/model", "A trained model: `model.safetensors`.");
safetensors_media!(AdapterFile, "tauflow/adapter", "A transport adapter: `model.safetensors`.");
safetensors_media!(PerceptualFile, "tauflow/perceptual", "Weights of a perceptual distance: `model.safetensors`.");
