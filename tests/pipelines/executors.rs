//! The quickstart as jobs of two schedulers, from an empty cache that they share: the outputs of a local run.

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
    // Both work on one empty cache, each at its share: what one made, the other reads. Two jobs of each at a time on
    // two cores, and few of them.
    let cache = folder.path().join("shared");
    let jobs = |executor: &str, core: &str, share: Option<&str>, variables: &[(&str, String)]| {
        let mut more = vec!["--locked", "--executor", executor, "--poll-every", "0.5s", "--batch", "20s", core];
        more.extend(share.into_iter().flat_map(|share| ["--wait", "--shard", share]));
        let said = run(folder.path(), &cache, &more, variables);
        // On a slow machine, one waits for the other for more than a minute, and says so.
        let warns = |line: &str| line.contains("warning") && !line.contains("waiting for actions of other shards");
        assert!(said.contains(".lock agrees") && said.contains("jobs: ") && !said.lines().any(warns), "{said}");
    };
    let (slurm, hyperqueue) = (Slurm::start(), HyperQueue::start());
    let shares = if slurm.is_some() && hyperqueue.is_some() { [Some("1/2"), Some("2/2")] } else { [None, None] };
    std::thread::scope(|scope| {
        match &slurm {
            Some(slurm) => drop(scope.spawn(|| {
                jobs("slurm", "--job-option=--cpus-per-task=1", shares[0], &slurm.variables());
            })),
            None => skip(Need::Slurm, "slurm-wlm and munge are not installed"),
        }
        match &hyperqueue {
            Some(hyperqueue) => jobs("hyperqueue", "--job-option=--cpus=1", shares[1], &hyperqueue.variables()),
            None => skip(Need::HyperQueue, "TAUFLOW_HYPERQUEUE names no Python with the package hyperqueue"),
        }
    });
}
