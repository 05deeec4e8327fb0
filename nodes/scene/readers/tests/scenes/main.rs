//! The kinds of this crate, run as the engine runs them: assets and scene files.

mod costly_scenes;
mod default_pose;
mod fuzz;
mod fuzz_scenes;
mod hostile_files;
mod hostile_scenes;
mod left_out;
mod real_assets;
mod reports;
mod small_assets;
mod support;

/// The kinds that these tests run.
fn kinds() -> Vec<Box<dyn tauflow_contract::NodeKind>> {
    tauflow_scene_readers::kinds()
}
