//! `run --shard`: runs that each do a share, and meet in the cache.

use crate::{PIPELINE, Place, Said};
use std::{
    process::Child,
    thread,
    time::{Duration, Instant},
};

fn ran(said: &Said) -> usize {
    said.lines().iter().filter(|line| line.contains("\"outcome\":\"ran\"")).count()
}

#[test]
fn a_share_ends_with_what_it_can_do_and_says_what_is_missing() {
    let place = Place::new();
    let mut sums = (0, 0);
    for share in ["1/3", "2/3", "3/3"] {
        let said = place.tauflow(&["run", "small.yaml", "--shard", share, "--events", "json"]);
        sums = (sums.0 + ran(&said), sums.1 + usize::from(said.code == 1));
        if said.code == 1 {
            assert!(said.err.contains("not done yet: ") && said.err.contains("--wait"), "{}", said.err);
            assert!(!said.err.contains(&format!("of shard {share}")), "{}", said.err);
            assert!(!said.err.contains("failed: ") && !said.err.contains("retry: "), "{}", said.err);
        }
    }
    assert!(sums.0 >= 8 && sums.1 >= 2, "{sums:?}: all scenes are made, each once");
    // What is missing is known after that, as nobody could gather before.
    let said = place.tauflow(&["run", "small.yaml", "--events", "json"]).ends(0);
    assert_eq!(ran(&said) + sums.0, 10, "nothing is done twice");
    for wrong in ["0/3", "4/3", "x"] {
        let said = place.tauflow(&["run", "small.yaml", "--shard", wrong]).ends(2);
        assert!(said.err.contains("give I/N"), "{}", said.err);
    }
}

#[test]
fn shares_that_wait_do_the_whole_run_together() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    let cache = place.path("other").display().to_string();
    let start = |share: &str| {
        let mut command = place.command(&["run", "small.yaml", "--shard", share, "--wait", "--events", "json"]);
        command.args(["--locked", "--cache", &cache]).stdout(std::process::Stdio::piped());
        command.stderr(std::process::Stdio::piped()).spawn().expect("the program starts")
    };
    let all: Vec<Child> = ["1/2", "2/2"].map(start).into_iter().collect();
    let said: Vec<Said> =
        all.into_iter().map(|child| Said::of(&child.wait_with_output().expect("it ends")).ends(0)).collect();
    assert!(said.iter().all(|said| said.err.contains("agrees") && ran(said) > 0), "{said:#?}");
    assert_eq!(said.iter().map(ran).sum::<usize>(), 10, "nothing is done twice: {said:#?}");
}

/// Ends a shard that would wait for ever.
fn within(mut child: Child, limit: Duration) -> Said {
    let begun = Instant::now();
    while child.try_wait().expect("a child of ours").is_none() && begun.elapsed() < limit {
        thread::sleep(Duration::from_millis(50));
    }
    let late = child.kill().is_ok() && begun.elapsed() >= limit;
    let said = Said::of(&child.wait_with_output().expect("it ends"));
    assert!(!late, "{said:#?}");
    said
}

/// Items of a transient node that one action gathers.
const GATHERED: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 8, views: [1, 1], regimes: [L0], contexts: [open, enclosed], diffuse: { textured: 0.0 } }
  previews: { kind: ladder_rendering, inputs: { scenes: scenes }, params: { rungs: [4], resolution: [16, 16] } }
  gate: { kind: quality_gate, inputs: { scenes: scenes, previews: previews } }
  ladders:
    kind: ladder_rendering
    transient: true
    inputs: { scenes: gate.accepted }
    params: { rungs: [1, 2, 4], resolution: [16, 16] }
  held_out:
    kind: ladder_rendering
    inputs: { scenes: gate.accepted }
    params: { rungs: [64], resolution: [16, 16], stream: 1 }
  convergence:
    kind: convergence
    inputs: { ladders: ladders, references: held_out, exposure: gate.exposure }
";

#[test]
fn what_another_share_had_in_memory_alone_is_made_again() {
    let place = Place::with(GATHERED);
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    let cache = place.path("other").display().to_string();
    let start = |share: &str| {
        let mut command = place.command(&["run", "small.yaml", "--shard", share, "--wait", "--locked"]);
        command.args(["--cache", &cache]).stdout(std::process::Stdio::piped());
        command.stderr(std::process::Stdio::piped()).spawn().expect("the program starts")
    };
    let all: Vec<Child> = ["1/2", "2/2"].map(start).into_iter().collect();
    for child in all {
        let said = within(child, Duration::from_secs(120)).ends(0);
        assert!(said.err.contains("agrees"), "{}", said.err);
    }
}

/// Every item fails, after a moment.
const FAILING: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 40, views: [1, 1], regimes: [L0], contexts: [open, enclosed], diffuse: { textured: 0.0 } }
  step:
    kind: command
    inputs: { scenes: scenes }
    params:
      run: [sh, -c, sleep 0.2; exit 1]
      reproducible: everywhere
      inputs: { scenes: tauflow/scene }
      outputs: { files: tauflow/files }
";

#[test]
fn shares_that_halt_do_not_wait_for_each_other() {
    let place = Place::with(FAILING);
    let start = |share: &str| {
        let mut command =
            place.command(&["run", "small.yaml", "--shard", share, "--wait", "--fail-fast", "--jobs", "2"]);
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        command.spawn().expect("the program starts")
    };
    let all: Vec<Child> = ["1/2", "2/2"].map(start).into_iter().collect();
    for child in all {
        let said = within(child, Duration::from_secs(120)).ends(1);
        assert!(said.err.contains("exit status: 1"), "{}", said.err);
    }
}

#[test]
fn who_waits_is_told_what_failed_in_another_shard() {
    let place = Place::with(&PIPELINE.replace("train: 2,", "train: 200,"));
    let cache = place.path("other").display().to_string();
    let start = |share: &str| {
        let mut command = place.command(&["run", "small.yaml", "--shard", share, "--wait", "--cache", &cache]);
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        command.spawn().expect("the program starts")
    };
    // What failed in the first round is tried again in the second.
    for round in 0..2 {
        let all: Vec<Child> = ["1/2", "2/2"].map(start).into_iter().collect();
        let said: Vec<Said> =
            all.into_iter().map(|child| Said::of(&child.wait_with_output().expect("it ends"))).collect();
        let told = |text: &str| said.iter().filter(|said| said.err.contains(text)).count();
        assert!(said.iter().all(|said| said.code == 1), "{said:#?}");
        assert_eq!(told(" failed on it: "), 1, "{round}: {said:#?}");
        assert_eq!(told("strata fall short"), 2, "{round}: {said:#?}");
    }
}
