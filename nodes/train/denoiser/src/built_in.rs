//! The bundled models. `pipelines/denoiser.yaml` makes their files; `models/README.md` describes them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::KindError;
use tauflow_train::{Conditioning, Model};

/// A bundled size of network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Weights {
    /// Quick.
    Fast,
    /// More accurate, in 1.4 to 1.7 times the time.
    #[default]
    Best,
}

impl Weights {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Fast, Self::Best];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Best => "best",
        }
    }

    /// The file of a model.
    pub fn bytes(self, conditioning: Conditioning) -> &'static [u8] {
        match (self, conditioning) {
            (Self::Fast, Conditioning::Gbuffer) => include_bytes!("../../../../models/fast_gbuffer.safetensors"),
            (Self::Fast, Conditioning::Rgb) => include_bytes!("../../../../models/fast_rgb.safetensors"),
            (Self::Best, Conditioning::Gbuffer) => include_bytes!("../../../../models/best_gbuffer.safetensors"),
            (Self::Best, Conditioning::Rgb) => include_bytes!("../../../../models/best_rgb.safetensors"),
        }
    }

    /// Loads a model.
    ///
    /// # Errors
    /// None with the files of this repository, which a test holds.
    pub fn model(self, conditioning: Conditioning) -> Result<Model, KindError> {
        Model::load(self.bytes(conditioning))
    }
}
