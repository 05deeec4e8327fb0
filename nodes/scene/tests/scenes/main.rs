//! The kinds of this crate, run as the engine runs them: assets, scenes, split and sampling.

mod choices;
mod default_pose;
mod fuzz;
mod hostile_files;
mod left_out;
mod real_assets;
mod small_assets;
mod support;
