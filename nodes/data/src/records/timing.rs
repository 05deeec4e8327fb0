//! Times of images, as kinds measure them.

use crate::timing::{Repeated, machine};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tauflow_contract::json_media;

/// The times of a scene's images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// The machine that measured; see [`machine`]. Null if it is not known.
    #[serde(default)]
    pub machine: Value,
    /// The timed method.
    pub entries: Vec<TimedImage>,
}

impl Timing {
    /// Times that were measured on this machine.
    pub fn here(entries: Vec<TimedImage>) -> Self {
        Self { machine: machine(), entries }
    }
}

/// How long one image took to make, from the endpoint it starts from; or, of a path tracer, from nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedImage {
    /// Which method made it, e.g. `mc_noise`.
    pub method: String,
    /// Sample count of the endpoint it starts from; of a path tracer, its own.
    pub from_spp: u64,
    /// Network calls; 0 for a path tracer.
    pub nfe: u64,
    /// The times.
    pub took: Repeated,
}

json_media! { Timing, "tauflow/timing", "How long each image took to make, each time."; }
