//! Dataset packing, training and refinement of transport solvers.

mod bridge;
mod bridge_refinement;
mod dataset_packing;
mod device;
mod law;
mod mirrors;
mod model;
mod model_rounding;
mod network;
mod network_calls;
mod parameterization;
mod refinement;
mod rollout;
mod space;
mod training;

pub use bridge::{LocalRule, ReferenceSolver, bridge_stop, expected_stop, local_path, stochastic_stop};
pub use bridge_refinement::{BridgeRefinement, BridgeRefinementParams};
pub use dataset_packing::{DatasetPacking, DatasetPackingParams};
pub use device::{NetworkDevice, Place};
pub use law::{Factors, Law};
pub use mirrors::Mirrored;
pub use model::{Model, ModelInfo};
pub use model_rounding::{ModelRounding, ModelRoundingParams, Precision};
pub use network::{Features, Loss, Output, Preset};
pub use network_calls::NetworkCalls;
pub use refinement::{Refinement, RefinementParams};
pub use rollout::{Course, Denoiser, clean_estimate, rollout, rollout_to};
pub use space::{Space, signed_log1p};
pub use tauflow_data::methods::{Conditioning, Parameterization};
pub use training::{Clock, Convolving, Decay, Training, TrainingParams, timing};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<DatasetPacking>::new()),
        Box::new(KindRow::<Training>::new()),
        Box::new(KindRow::<Refinement>::new()),
        Box::new(KindRow::<ModelRounding>::new()),
        Box::new(KindRow::<BridgeRefinement>::new()),
    ]
}
