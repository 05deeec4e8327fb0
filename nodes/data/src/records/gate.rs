//! The verdict of the quality gate on a scene.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::json_media;

/// The exposure of a scene: one factor for all its rungs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Multiplies linear radiance.
    pub factor: f64,
    /// Offset in stops that is part of the factor.
    pub ev: f64,
    /// Geometric mean luminance of the gate's render.
    pub mean_luminance: f64,
}

/// Reasons for rejection, the most telling first, each with what is so.
pub const REASONS: [(&str, &str); 13] = [
    ("non_finite", "samples or pixels are not finite"),
    ("inside", "the camera is inside an object"),
    ("too_near", "an object close to the camera hides the rest"),
    ("mostly_sky", "almost only sky or void is visible"),
    ("one_surface", "one smooth surface fills the frame"),
    ("black", "no light reaches the camera"),
    ("dark", "most of the frame is displayed black"),
    ("over_exposed", "much of the frame is displayed white"),
    ("near_constant", "almost uniform brightness"),
    ("featureless", "almost no edges"),
    ("degenerate", "a few pixels contain almost all light"),
    ("noisy", "noise hides the content"),
    ("little_to_see", "almost nothing stands out from its surroundings or from noise"),
];

/// The gate's verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Reasons for rejection, empty if accepted; the most telling first; names of [`REASONS`].
    pub reasons: Vec<String>,
    /// Measurements by name.
    pub measures: BTreeMap<String, f64>,
}

impl Verdict {
    /// Name of the measure that is the factor to look at the preview with; there is none where pixels are no numbers.
    pub const EXPOSURE: &str = "exposure";
}

json_media! {
    Exposure, "tauflow/exposure", "The factor that all rungs of a scene are multiplied with.";
    Verdict, "tauflow/verdict", "The gate's verdict: reasons for rejection, and what was measured.";
}
