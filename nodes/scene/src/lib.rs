//! Assets, scene generation, stratified sampling, content-signature split.
//!
//! Makes scene descriptions and chooses among them; knows nothing of rendering or learning.

mod assets;
mod generation;
mod geom;
mod mesh_check;

pub use generation::{
    CausticRanges, DiffuseRanges, GlossyRanges, HoldOut, MaxDepth, Range, RefractiveRanges, SceneGeneration,
    SceneGenerationParams,
};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![Box::new(KindRow::<SceneGeneration>::new())]
}
