//! The only file that names the crates of kinds: all node kinds, and functions that commands use outside of pipelines.

use crate::kinds::Registry;

pub use tauflow_denoiser::{
    Denoised, Denoiser as BundledDenoiser, Frame, Settings as DenoiseSettings, Weights as BundledWeights,
    mended_normals,
};
pub use tauflow_eval::{
    bootstrap::{Resampled, Table as Paired},
    bounded,
};
pub use tauflow_render::{
    choices::Choices,
    quality_gate::geometric_mean_luminance,
    render::{Goal, RenderStats, Rendered, Setup, Stage, render_image},
    samples::{Sample, render_samples},
    until::Until,
};
pub use tauflow_scene_library::skies::sky;
pub use tauflow_scene_readers::{LightUnit, Options, Setting, View, check_scene, environment_map, load_scene_in};
pub use tauflow_train::{
    Conditioning, Course, Denoiser, Mirrored, Model, NetworkCalls, NetworkDevice, Place, clean_estimate, rollout_to,
};

/// Every kind there is.
pub fn registry() -> Registry {
    let crates = [
        tauflow_scene_readers::kinds(),
        tauflow_scene::kinds(),
        tauflow_render::kinds(),
        tauflow_train::kinds(),
        tauflow_generative::kinds(),
        tauflow_denoiser::kinds(),
        tauflow_perceptual::kinds(),
        tauflow_denoise::kinds(),
        tauflow_eval::kinds(),
        tauflow_scorer::kinds(),
        tauflow_report::kinds(),
    ];
    Registry::new(crates.into_iter().flatten())
}
