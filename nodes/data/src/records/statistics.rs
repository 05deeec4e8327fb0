//! Statistics of a scene.

use serde::{Deserialize, Serialize};
use tauflow_contract::json_media;

/// Statistics of an image at the gate's exposure: the same for renders and photographs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureStatistics {
    /// Share of neighbouring pixels that differ by 0.04 in display luminance, beside what noise explains.
    pub edge_density: f64,
    /// Slope of log power on log frequency of display luminance, from three waves a side to a quarter of the pixels of
    /// one; white noise has 0. None for pictures that are too small or have no detail.
    pub spectrum_slope: Option<f64>,
    /// Mean saturation of display colours: 0 is grey, 1 lacks one of the three.
    pub saturation: f64,
    /// Standard deviation of the saturation over the pixels.
    pub saturation_spread: f64,
    /// Entropy of the hue over twelve classes, weighted by saturation, in bits; 0 for a single hue or none.
    pub hue_entropy: f64,
    /// Standard deviation of log luminance over the pixels, in stops.
    pub log_luminance_spread: f64,
    /// Mean difference of log luminance between neighbouring pixels, in stops.
    pub log_contrast: f64,
}

/// Statistics of one scene.
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
    /// Root mean square error of an image of 1 sample per pixel, over the image's mean.
    pub relative_rmse: f64,
    /// Slope of log RMSE on log n over the ladder, against a held-out reference; the law says -1/2. None for scenes
    /// without noise.
    pub slope: Option<f64>,
    /// Share of variance in the 1% of pixels that vary most.
    pub tail_share: f64,
    /// Samples per pixel at which half of the pixels that get light have a standard error below 1% of their mean. None
    /// if none gets light.
    pub samples_to_percent: Option<f64>,
    /// Share of neighbouring pixels between which depth jumps, or a surface ends before the sky.
    pub depth_discontinuities: f64,
    /// Share of neighbouring pixels whose shading normals are 30 degrees or more apart.
    pub normal_discontinuities: f64,
    /// The reference as a picture.
    pub picture: PictureStatistics,
    /// Samples per pixel of the ladder's last rung and of the reference.
    pub spp: [u64; 2],
    /// Contributions that were rejected as non-finite.
    pub rejected: u64,
    /// Triangles that were left out: without area, or with a corner that is not finite.
    pub dropped: u64,
}

json_media! { SceneStatistics, "tauflow/scene-statistics", "What a scene is, measured."; }
