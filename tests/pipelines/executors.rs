//! The quickstart as jobs of schedulers, from an empty cache: the outputs of a local run.

#[path = "../support/schedulers.rs"]
mod schedulers;

use crate::support::root;
use schedulers::{HyperQueue, Slurm};
use std::{
    path::Path,
    process::{Command, Stdio},
    time::Instant,
};
use tauflow_testing::{Need, Shared, skip, slow};

/// Runs the profile tiny up to the evaluation; what it said.
fn run(folder: &Path, cache: &Path, more: &[&str], variables: &[(&str, String)]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tauflow"));
    command.args(["run", "quickstart.yaml", "--profile", "tiny", "--cache"]).arg(cache).args(more);
    command.envs(variables.iter().cloned()).current_dir(folder).stdin(Stdio::null());
    let begun = Instant::now();
    let output = command.output().expect("it starts");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{more:?}: {text}");
    eprintln!("part: the tiny quickstart {}, {:.0} s", more.join(" "), begun.elapsed().as_secs_f64());
    text
}

#[test]
fn jobs_of_schedulers_make_the_outputs_of_the_quickstart() {
    if !slow() {
        return skip(Need::Slow, "TAUFLOW_SLOW is not set");
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let text = std::fs::read_to_string(root().join("pipelines/quickstart.yaml")).expect("the quickstart");
    let text = text.replace("\nnodes:\n", "\ntargets: [evaluation]\n\nnodes:\n");
    std::fs::write(folder.path().join("quickstart.yaml"), text).expect("writable");
    // `tests/cli/own_programs.rs` shares these results.
    let tmp = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let shared = Shared::of(Path::new(env!("CARGO_BIN_EXE_tauflow")), tmp, "tiny-quickstart");
    run(folder.path(), &shared.path().join("cache"), &["--update-lock"], &[]);
    drop(shared);
    let jobs = |executor: &str, core: &str, variables: &[(&str, String)]| {
        // Two jobs at a time on two cores, and few of them.
        let more = ["--locked", "--executor", executor, "--poll-every", "0.5s", "--batch", "20s", core];
        let said = run(folder.path(), &folder.path().join(executor), &more, variables);
        assert!(said.contains(".lock agrees") && !said.contains("warning"), "{said}");
    };
    match Slurm::start() {
        Some(slurm) => jobs("slurm", "--job-option=--cpus-per-task=1", &slurm.variables()),
        None => skip(Need::Slurm, "slurm-wlm and munge are not installed"),
    }
    match HyperQueue::start() {
        Some(hyperqueue) => jobs("hyperqueue", "--job-option=--cpus=1", &hyperqueue.variables()),
        None => skip(Need::HyperQueue, "TAUFLOW_HYPERQUEUE names no Python with the package hyperqueue"),
    }
}
