//! Frozen generative backbones, their samplers, and the transport adapter.

mod adapter;
mod backbone;
mod checkpoint;
mod course;
mod generation;
mod generative_training;
mod learning;
mod loss;
mod network;
mod pictures;
mod pretrained_backbones;
mod schedule;
mod trainer;
mod transport_adapter;

pub use adapter::{Adapter, AdapterInfo, Residuals};
pub use backbone::{Backbone, Config};
pub use checkpoint::{read_weights, write_weights};
pub use course::{Course, Injection, Way};
pub use generation::{Generation, GenerationParams};
pub use generative_training::{GenerativeTraining, GenerativeTrainingParams};
pub use network::{Layout, Ncsnpp, NcsnppConfig, Network, Parameter, Unet2d, Unet2dConfig, count};
pub use pretrained_backbones::{PretrainedBackbones, PretrainedBackbonesParams};
pub use schedule::{Ddpm, DdpmConfig, FIRST, SCALE, Sampler};
pub use transport_adapter::{TransportAdapter, TransportAdapterParams};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<PretrainedBackbones>::new()),
        Box::new(KindRow::<GenerativeTraining>::new()),
        Box::new(KindRow::<TransportAdapter>::new()),
        Box::new(KindRow::<Generation>::new()),
    ]
}
