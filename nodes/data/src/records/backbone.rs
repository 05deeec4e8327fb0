//! Generative backbones: a checkpoint in the layout in which they are published.

use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles};

/// The files of a backbone's checkpoint. What their tensors mean is known to the crate that samples from them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BackboneFiles {
    /// `config.json`: the network.
    pub config: String,
    /// `scheduler_config.json`: the sampler, where the network does not say it.
    pub scheduler: Option<String>,
    /// The weights, in the safetensors format.
    pub weights: Vec<u8>,
}

impl BackboneFiles {
    /// Name of the file of the network's configuration.
    pub const CONFIG: &'static str = "config.json";
    /// Name of the file of the sampler's configuration.
    pub const SCHEDULER: &'static str = "scheduler_config.json";
    /// Name of the file of the weights, as diffusers has it.
    pub const WEIGHTS: &'static str = "diffusion_pytorch_model.safetensors";
}

fn text(file: &str, bytes: Vec<u8>) -> Result<String, KindError> {
    String::from_utf8(bytes).map_err(|_| KindError::Input(format!("`{file}` of a backbone is no text")))
}

impl Media for BackboneFiles {
    const NAME: &'static str = "tauflow/backbone";
    const DOC: &'static str = "A generative backbone: `config.json`, `scheduler_config.json` where there is one, and \
                               `diffusion_pytorch_model.safetensors`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let scheduler = artifact.part(Self::SCHEDULER).map(|_| ctx.part(artifact, Self::SCHEDULER)).transpose()?;
        Ok(Self {
            config: text(Self::CONFIG, ctx.part(artifact, Self::CONFIG)?)?,
            scheduler: scheduler.map(|bytes| text(Self::SCHEDULER, bytes)).transpose()?,
            weights: ctx.part(artifact, Self::WEIGHTS)?,
        })
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let mut parts = vec![
            (Self::CONFIG.to_owned(), ctx.put(self.config.as_bytes())?),
            (Self::WEIGHTS.to_owned(), ctx.put(&self.weights)?),
        ];
        if let Some(scheduler) = &self.scheduler {
            parts.push((Self::SCHEDULER.to_owned(), ctx.put(scheduler.as_bytes())?));
        }
        Ok(Stored::tree(parts))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let files = Self::load(ctx, artifact)?;
        to.put(Self::CONFIG, files.config.as_bytes())?;
        if let Some(scheduler) = &files.scheduler {
            to.put(Self::SCHEDULER, scheduler.as_bytes())?;
        }
        to.put(Self::WEIGHTS, &files.weights)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let scheduler = from.get(Self::SCHEDULER)?.map(|bytes| text(Self::SCHEDULER, bytes)).transpose()?;
        let config = text(Self::CONFIG, from.need(Self::CONFIG)?)?;
        Self { config, scheduler, weights: from.need(Self::WEIGHTS)? }.store(ctx)
    }
}
