//! Path tracer, ladder rendering and quality gate.

pub mod accel;
pub mod accumulator;
mod alias;
mod bounds;
pub mod bsdf;
pub mod camera;
pub mod choices;
pub mod convergence;
mod dispatch;
pub mod environment;
pub mod gbuffer;
pub mod geometry;
pub mod integrator;
pub mod ladder_rendering;
mod lanes;
pub mod lights;
mod outlines;
mod pages;
pub mod picture_statistics;
mod placement;
pub mod quality_gate;
pub mod render;
pub mod rng;
pub mod samples;
pub mod scene_statistics;
pub mod skips;
mod sobol;
pub mod splats;
mod stream;
pub mod surface;
mod table;
pub mod texels;
pub mod texture;
pub mod until;
pub mod world;

#[cfg(test)]
mod chi_square;
#[cfg(test)]
#[path = "../tests/scenes/mod.rs"]
mod scenes;

pub use tauflow_instructions::Instructions;

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<ladder_rendering::LadderRendering>::new()),
        Box::new(KindRow::<quality_gate::QualityGate>::new()),
        Box::new(KindRow::<convergence::ConvergenceKind>::new()),
        Box::new(KindRow::<scene_statistics::SceneStatisticsKind>::new()),
    ]
}
