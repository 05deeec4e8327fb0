//! Records of `training`: its loss curve and its times.

use serde::{Deserialize, Serialize};
use tauflow_contract::json_media;

/// The log of `training`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingLog {
    /// The parameterization.
    pub parameterization: String,
    /// The conditioning.
    pub conditioning: String,
    /// The training space.
    pub space: String,
    /// The preset of the network.
    pub preset: String,
    /// Its number of weights.
    pub weights: u64,
    /// Steps in all.
    pub steps: u64,
    /// Every param of the training, as it was resolved.
    pub params: serde_json::Map<String, serde_json::Value>,
    /// Points of the curve; the first is before the first step.
    pub points: Vec<TrainingPoint>,
}

/// A point of a loss curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingPoint {
    /// Steps done.
    pub step: u64,
    /// Mean loss over the batches since the last point; none before the first step.
    pub train: Option<f64>,
    /// Loss of the averaged weights on the test scenes; none without any.
    pub test: Option<f64>,
    /// Mean gain of one call of the averaged weights over the first rung, on the first test scenes: dB of PSNR.
    pub gain: Option<f64>,
    /// Learning rate.
    pub learning_rate: f64,
    /// Mean norm of the gradient before clipping, since the last point.
    pub gradient_norm: Option<f64>,
}

/// How long a training took: a measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingTiming {
    /// Steps that were timed: those of the last run, if it was resumed.
    pub steps: u64,
    /// Their time, in seconds.
    pub seconds: f64,
    /// Median time of a step, in milliseconds.
    pub median_step_ms: f64,
    /// Threads that it had at most.
    pub threads: u64,
    /// The machine that trained; see [`machine`](crate::timing::machine). Null if it is not known.
    #[serde(default)]
    pub machine: serde_json::Value,
}

json_media! {
    TrainingLog, "tauflow/training-log", "The loss curve of a training, with its params.";
    TrainingTiming, "tauflow/training-timing", "How long the steps of a training took.";
}
