//! How a run scales: the scheduler over simulated workers, with the recorded times of a pipeline's actions.
//!
//! ```text
//! cargo bench --bench scaling -- CACHE PIPELINE [PROFILE]
//! ```
//!
//! The cache must have all results of the pipeline. Each line is a run on so many workers, where a batch of actions
//! starts with this latency. It prints the time on the simulated clock and the speed-up over one worker without
//! latency. `busy` is the share of the workers' time that is spent in actions, and `scheduler` the share of the time in
//! which the scheduler computes.

use std::{error::Error, path::PathBuf, sync::Arc, time::Duration};
use tauflow::{
    engine::simulation::{Cluster, simulate},
    pipeline::{self, Options},
    registry::registry,
};
use tauflow_cache::Store;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1).filter(|argument| !argument.starts_with("--"));
    let usage = "usage: cargo bench --bench scaling -- CACHE PIPELINE [PROFILE]";
    let cache = arguments.next().ok_or(usage)?;
    let file = PathBuf::from(arguments.next().ok_or(usage)?);
    let options = Options { profile: arguments.next(), ..Options::default() };
    let pipeline = pipeline::resolve(&file, &registry(), &options).map_err(|problems| problems.to_string())?;
    let recorded = Arc::new(Store::open_existing(cache.as_ref())?);
    println!("workers  latency  failures      time  speed-up  busy  scheduler  per action");
    let runs =
        [0, 1, 10, 100].into_iter().flat_map(|latency| [1, 10, 100, 1000].map(|workers| (workers, latency, 0.0)));
    for (workers, latency, failures) in runs.chain([(100, 10, 0.01), (1000, 10, 0.01), (1000, 10, 0.1)]) {
        let empty = tempfile::tempdir()?;
        let of = Cluster { workers, latency: Duration::from_millis(latency), failures, notice: Duration::from_secs(3) };
        let done = simulate(&pipeline, &recorded, Store::open(empty.path())?, of)?;
        println!(
            "{workers:7} {latency:5} ms {:8.0}% {:8.1} s {:8.1}x {:4.0}% {:9.1}% {:8.1} us",
            failures * 100.0,
            done.clock_s,
            done.work_s / done.clock_s,
            100.0 * done.work_s / (done.clock_s * workers as f64),
            100.0 * done.steering_s / done.clock_s,
            1e6 * done.steering_s / done.actions as f64,
        );
        if workers == 1 && latency == 0 {
            println!("        {} actions, {:.1} s of work", done.actions, done.work_s);
        }
    }
    Ok(())
}
