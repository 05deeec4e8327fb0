//! What a scene is, measured.

use serde::{Deserialize, Serialize};
use tauflow_contract::json_media;

/// What one scene is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneStatistics {
    /// Mean number of segments of a path.
    pub mean_path_length: f64,
    /// Share of the image's light that comes from infinity, directly or in the end.
    pub environment_share: f64,
    /// Share of the light whose paths meet nothing but diffuse surfaces.
    pub diffuse_share: f64,
    /// Share of the light whose paths meet glass.
    pub refractive_share: f64,
    /// Share of the light that a specular surface sends onto one that scatters it.
    pub caustic_share: f64,
    /// Root mean square error of an image of 1 sample a pixel, over the image's mean.
    pub relative_rmse: f64,
    /// Slope of log RMSE on log n over the ladder, against a held-out reference; the law says -1/2. None for scenes
    /// without noise.
    pub slope: Option<f64>,
    /// Share of variance in the 1% of pixels that vary most.
    pub tail_share: f64,
    /// Samples a pixel of the ladder's last rung and of the reference.
    pub spp: [u64; 2],
    /// Contributions that were rejected as non-finite.
    pub rejected: u64,
    /// Triangles that were left out: without area, or with a corner that is not finite.
    pub dropped: u64,
}

json_media! { SceneStatistics, "tauflow/scene-statistics", "What a scene is, measured."; }
