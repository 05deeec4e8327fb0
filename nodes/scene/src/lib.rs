//! Assets, scene generation, stratified sampling, content-signature split.
//!
//! Makes scene descriptions and chooses among them; knows nothing of rendering or learning.

mod assets;
mod generation;
mod geom;
mod mesh_check;
mod sampling;
mod signature;
mod split;

pub use assets::{
    Assets, AssetsParams,
    asset::{Asset, Body, Material, Part, Report as AssetReport},
};
pub use generation::{
    CausticRanges, DiffuseRanges, GlossyRanges, HoldOut, MaxDepth, Range, RefractiveRanges, SceneGeneration,
    SceneGenerationParams,
};
pub use sampling::{StratifiedSampling, StratifiedSamplingParams, quotas};
pub use signature::{Leak, QUANTUM, check_leaks, quantised, shared_assets, signature};
pub use split::{ContentSignatureSplit, ContentSignatureSplitParams, is_test};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<Assets>::new()),
        Box::new(KindRow::<SceneGeneration>::new()),
        Box::new(KindRow::<ContentSignatureSplit>::new()),
        Box::new(KindRow::<StratifiedSampling>::new()),
    ]
}
