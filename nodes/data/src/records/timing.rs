//! Times of images, as kinds measure them.

use crate::timing::Repeated;
use serde::{Deserialize, Serialize};
use tauflow_contract::json_media;

/// The times of a scene's images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// The timed method.
    pub entries: Vec<TimedImage>,
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
