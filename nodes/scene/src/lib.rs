//! Scene generation, stratified sampling, content-signature split.
//!
//! Draws scene descriptions from the library and chooses among them; knows nothing of file formats, rendering or
//! learning.

mod content_signature_split;
mod scene_generation;
mod signature;
mod stratified_sampling;

pub use content_signature_split::{ContentSignatureSplit, ContentSignatureSplitParams, is_test};
pub use scene_generation::{HoldOut, MaxDepth, SceneGeneration, SceneGenerationParams};
pub use signature::{QUANTUM, check_leaks, quantised, shared_assets, signature};
pub use stratified_sampling::{StratifiedSampling, StratifiedSamplingParams, quotas};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<SceneGeneration>::new()),
        Box::new(KindRow::<ContentSignatureSplit>::new()),
        Box::new(KindRow::<StratifiedSampling>::new()),
    ]
}
