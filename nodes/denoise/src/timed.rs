//! Shared timing code of the kinds.

use serde::Serialize;
use tauflow_contract::{Any, Context, Each, KindError};
use tauflow_data::{
    records::{RefinedImage, TimedImage, Timing},
    timing::Repeated,
};

/// Name of the group of output ports that are measured.
pub(crate) const TIMING: &str = "timing";

/// Input that only has to be there.
pub(crate) const AFTER: Each<Any> =
    Each::any("after", "Completed before `timing` measures, so that methods take turns.").or_none();

/// Params without what only `timing` reads, in the other groups.
pub(crate) fn projected(params: &impl Serialize, group: &str) -> serde_json::Value {
    let mut value = serde_json::to_value(params).expect("plain data");
    if group != TIMING
        && let serde_json::Value::Object(fields) = &mut value
    {
        fields.remove("repeats");
    }
    value
}

/// No times, of what is not there.
pub(crate) fn nothing() -> Timing {
    Timing::here(Vec::new())
}

/// The times of `run`, for the given number of repeats after a warm-up. Where it tells its own seconds, of wall and
/// processor time, those.
///
/// # Errors
/// Those of `run`, and if the run is being stopped.
pub(crate) fn timing(
    ctx: &Context<'_>,
    said: &RefinedImage,
    repeats: u64,
    mut run: impl FnMut() -> Result<Option<[f64; 2]>, KindError>,
) -> Result<Timing, KindError> {
    let mut took = Repeated::default();
    run()?;
    for _ in 0..repeats {
        ctx.check_cancelled()?;
        if let Some([wall, cpu]) = took.add(&mut run)? {
            // A program of its own: what we do to hand images over is not its time.
            took.wall_s.pop();
            took.cpu_s.pop();
            took.wall_s.push(wall);
            took.cpu_s.push(cpu);
        }
    }
    let RefinedImage { method, from_spp, nfe, .. } = said.clone();
    Ok(Timing::here(vec![TimedImage { method, from_spp, nfe, took }]))
}
