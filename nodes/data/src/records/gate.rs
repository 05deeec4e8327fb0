//! What the quality gate says of a scene.

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

/// The gate's verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Reasons for rejection, empty if accepted; such as `black`, `over_exposed`.
    pub reasons: Vec<String>,
    /// What was measured, by name.
    pub measures: BTreeMap<String, f64>,
}

json_media! {
    Exposure, "tauflow/exposure", "The factor that all rungs of a scene are multiplied with.";
    Verdict, "tauflow/verdict", "The gate's verdict: reasons for rejection, and what was measured.";
}
