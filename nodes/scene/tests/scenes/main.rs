//! The kinds of this crate, run as the engine runs them: scenes, split and sampling, with assets as the readers give
//! them.

mod choices;
mod shared_assets;
#[path = "../../readers/tests/scenes/support.rs"]
mod support;

/// The kinds that these tests run.
fn kinds() -> Vec<Box<dyn tauflow_contract::NodeKind>> {
    tauflow_scene::kinds().into_iter().chain(tauflow_scene_readers::kinds()).collect()
}
