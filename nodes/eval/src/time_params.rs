//! What is asked of `time_error`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Params of `time_error`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TimeErrorParams {
    /// PSNR targets in dB, of linear radiance: the table states the time to reach each.
    #[schemars(extend("items" = above_zero()))]
    pub psnr_targets: Vec<f64>,
    /// Targets of the relative mean squared error: the table states the time to reach each.
    #[schemars(extend("items" = above_zero()))]
    pub rel_mse_targets: Vec<f64>,
    /// Number of bootstrap resamples.
    #[schemars(range(min = 100, max = 100_000))]
    pub resamples: u64,
}

impl Default for TimeErrorParams {
    fn default() -> Self {
        Self { psnr_targets: vec![25.0, 30.0, 35.0, 40.0], rel_mse_targets: vec![0.1, 0.01, 0.001], resamples: 2000 }
    }
}

/// The schema of a target.
fn above_zero() -> Value {
    json!({ "type": "number", "format": "double", "exclusiveMinimum": 0.0 })
}
