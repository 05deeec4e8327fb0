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
    ("non_finite", "samples or pixels that are no numbers"),
    ("inside", "the camera stands inside a body"),
    ("too_near", "something right before the camera hides the rest"),
    ("mostly_sky", "next to nothing but sky or void"),
    ("one_surface", "one smooth surface fills the frame"),
    ("black", "no light at all"),
    ("dark", "most of the frame shows black"),
    ("over_exposed", "much of the frame shows white"),
    ("near_constant", "all of it has about one brightness"),
    ("featureless", "hardly an edge in it"),
    ("degenerate", "all light in a few pixels"),
    ("noisy", "noise that hides what there is"),
    ("little_to_see", "hardly a thing stands out from what is around it, or from noise"),
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
