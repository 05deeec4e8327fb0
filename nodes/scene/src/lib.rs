//! Assets, scene generation, stratified sampling, content-signature split.
//!
//! Makes scene descriptions and chooses among them; knows nothing of rendering or learning.

mod assets;
mod content_signature_split;
mod geom;
mod mesh_check;
mod scene_files;
mod scene_generation;
mod signature;
mod stratified_sampling;

pub use assets::{Assets, AssetsParams};
pub use content_signature_split::{ContentSignatureSplit, ContentSignatureSplitParams, is_test};
pub use scene_files::{LightUnit, Loaded, Options, SceneFiles, SceneFilesParams, ScenePath, load_scene};
pub use scene_generation::{
    CausticRanges, DiffuseRanges, GlossyRanges, HoldOut, MaxDepth, Range, RefractiveRanges, SceneGeneration,
    SceneGenerationParams,
};
pub use signature::{QUANTUM, check_leaks, quantised, shared_assets, signature};
pub use stratified_sampling::{StratifiedSampling, StratifiedSamplingParams, quotas};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<Assets>::new()),
        Box::new(KindRow::<SceneFiles>::new()),
        Box::new(KindRow::<SceneGeneration>::new()),
        Box::new(KindRow::<ContentSignatureSplit>::new()),
        Box::new(KindRow::<StratifiedSampling>::new()),
    ]
}
