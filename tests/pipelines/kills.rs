//! A training that is killed, as by a power cut, again and again: it goes on from its last checkpoint and ends with the
//! bits of one that is left alone.

use crate::edits::{PIPELINE, run_before};
use serde_json::Value;
use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
    thread,
    time::Duration,
};

const STEPS: u64 = 240;
const EVERY: u64 = 8;
const LONG: &str = "  \
  long:
    kind: training
    inputs: { train: train_set, test: test_set }
    params:
      parameterization: mc_velocity
      preset: tiny
      steps: 240
      batch: 2
      crop: 16
      decay: cosine
      test_every: 50
      checkpoint_every: 8
targets: [long]
";

fn tauflow(folder: &Path, cache: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tauflow"));
    command.args(["run", "long.yaml", "--cache", cache]).args(arguments).current_dir(folder);
    command
}

/// Runs it until the training has told of a step of at least `until`, then kills it some time later: the first and the
/// last step that it told of.
fn killed(folder: &Path, until: u64, later: Duration) -> (u64, u64) {
    let mut command = tauflow(folder, "killed", &["--events", "json"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("it starts");
    let (mut first, mut last) = (None, 0);
    let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
    for line in lines.map_while(Result::ok) {
        let Ok(event) = serde_json::from_str::<Value>(&line) else { continue };
        if event["event"] != "progress" || event["node"] != "long" || event["total"] != STEPS {
            continue;
        }
        last = event["done"].as_u64().expect("a number of steps");
        first.get_or_insert(last);
        if last >= until {
            break;
        }
    }
    thread::sleep(later);
    child.kill().expect("it is there");
    let status = child.wait().expect("it ends");
    assert!(!status.success(), "it was killed in time");
    (first.expect("it told of a step"), last)
}

#[test]
fn a_training_that_is_killed_again_and_again_ends_with_the_same_bits() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    fs::write(folder.join("long.yaml"), format!("{PIPELINE}{LONG}")).expect("writable");
    // What comes before the training is there.
    run_before(&folder.join("alone"));
    run_before(&folder.join("killed"));
    let alone = tauflow(folder, "alone", &["--update-lock"]).output().expect("it starts");
    assert!(alone.status.success(), "{}", String::from_utf8_lossy(&alone.stderr));
    let mut reached = 0;
    for (round, until) in (20..200).step_by(30).enumerate() {
        let (first, last) = killed(folder, until, Duration::from_millis(7 * round as u64));
        // What was told of before is not done again, but for the steps since the last checkpoint, of which every tenth
        // is told.
        assert!(first + EVERY > reached, "killed after step {reached}, and gone on with from {first}");
        reached = last.max(reached);
    }
    assert!(reached >= 170, "{reached}");
    let end = tauflow(folder, "killed", &["--locked"]).output().expect("it starts");
    let told = String::from_utf8_lossy(&end.stderr).into_owned();
    assert!(end.status.success() && told.contains("long.lock agrees"), "{told}");
}
