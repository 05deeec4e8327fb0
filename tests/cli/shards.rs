//! `run --shard`: runs that each do a share, and meet in the cache.

use crate::{PIPELINE, Place, Said};
use std::process::Child;

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
