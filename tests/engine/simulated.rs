//! The simulated cluster, with the recorded times of a run.

use crate::support::{Workshop, resolve};
use std::{sync::Arc, time::Duration};
use tauflow::engine::simulation::{Cluster, Simulated, simulate};
use tauflow_cache::Store;

/// Eight actions that sleep for 50 ms.
const NAPS: &str = "
nodes:
  numbers: {kind: numbers, params: {count: 8, nap_ms: 50}}
  total: {kind: total, inputs: {in: numbers}}
";

const CLUSTER: Cluster = Cluster { workers: 1, latency: Duration::ZERO, failures: 0.0, notice: Duration::from_secs(3) };

#[test]
fn a_simulated_run_takes_the_recorded_times_and_what_failures_and_latency_add() {
    let shop = Workshop::new();
    shop.run(NAPS);
    let (pipeline, recorded) = (resolve(NAPS), Arc::new(shop.store()));
    let on = |of: Cluster| -> Simulated {
        let empty = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(empty.path()).expect("a new store");
        simulate(&pipeline, &recorded, store, of).expect("all is recorded")
    };
    let one = on(CLUSTER);
    // The total has two groups of outputs.
    assert_eq!((one.actions, one.failed), (10, 0));
    assert!(one.work_s >= 8.0 * 0.05, "{one:?}");
    // The clock also goes on while the scheduler computes.
    assert!(one.clock_s >= one.work_s && one.clock_s <= one.work_s + one.steering_s + 1e-6, "{one:?}");
    let eight = on(Cluster { workers: 8, ..CLUSTER });
    assert!(eight.clock_s - eight.steering_s < 0.5 * one.work_s, "the numbers go side by side: {eight:?}");
    // Two actions after one another, at least.
    let slow = on(Cluster { workers: 8, latency: Duration::from_secs(1), ..CLUSTER });
    assert!(slow.clock_s >= 2.0 && slow.clock_s < 9.0, "{slow:?}");
    let failing = on(Cluster { failures: 0.5, ..CLUSTER });
    assert!(failing.failed > 0 && failing.clock_s >= one.work_s + 3.0 * failing.failed as f64, "{failing:?}");
}
