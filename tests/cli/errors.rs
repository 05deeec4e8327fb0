//! Exit codes of what goes wrong: 1 an item, 2 pipeline or arguments, 3 the environment, 130 interrupted.

use crate::{PIPELINE, Place, Said};
use std::{
    io::{BufRead, BufReader},
    process::{Command, Stdio},
};

#[test]
fn bad_arguments_are_2() {
    let place = Place::new();
    for (arguments, part) in [
        (&["run"][..], "PIPELINE"),
        (&["rum", "small.yaml"], "'run'"),
        (&["run", "other.yaml"], "other.yaml"),
        (&["run", "small.yaml", "--recheck", "2"], "--recheck 2"),
        (&["run", "small.yaml", "--only", "nothing"], "nothing"),
        (&["run", "small.yaml", "--profile", "mor"], "did you mean `more`?"),
        (&["run", "small.yaml", "--set", "scenes.poll=3"], "did you mean `pool`?"),
        (&["run", "small.yaml", "--target", "splt"], "did you mean `split`?"),
        (&["graph", "small.yaml", "--format", "png"], "mermaid"),
        (&["export", "small.yaml", "split.tran", "-o", "x"], "did you mean `train`?"),
        (&["explain", "small.yaml", "splt"], "splt"),
        (&["cache", "gc"], "--max-size"),
        (&["run", "small.yaml", "--jobs", "1000000"], "1024"),
        (&["check", "/dev/zero"], "not a regular file"),
        (&["render", "/dev/zero", "-o", "x.exr"], "not a regular file"),
        (&["refine", "/dev/zero", "x.exr", "--from-spp", "1", "-o", "x.exr"], "not a regular file"),
        (&["cache", "verify", "--sample", "7"], "--sample"),
        (&["cache", "pin", "it", "no-digest"], "no-digest"),
        (&["cache", "unpin", "it"], "unknown pin `it`"),
        (&["render", "none.json", "-o", "x.exr"], "none.json"),
        (&["render", "none.json", "-o", "x.jpg"], "x.jpg"),
        (&["render", "small.yaml", "-o", "x.exr"], "--item NODE/ITEM"),
        (&["render", "small.yaml", "--item", "scenes", "-o", "x.exr"], "is not an item"),
        (&["export", "small.yaml", "split[a=1]", "-o", "x"], "it has no axes"),
    ] {
        let said = place.tauflow(arguments).ends(2);
        assert!(said.err.contains(part), "{arguments:?}: `{part}` is not in\n{}", said.err);
        assert_eq!(said.out, "", "{arguments:?}");
    }
}

#[test]
fn a_mistyped_command_names_the_nearest() {
    let place = Place::new();
    for (typed, meant) in [("rnu", "run"), ("rum", "run"), ("statsu", "status"), ("cahce", "cache")] {
        let said = place.tauflow(&[typed]).ends(2);
        assert!(said.err.contains(&format!("a similar subcommand exists: '{meant}'")), "{}", said.err);
    }
}

#[test]
fn an_item_that_is_not_there_is_2_and_names_the_nearest() {
    let place = Place::new();
    for pass in ["from an empty cache", "with every item at hand"] {
        let said = place.tauflow(&["run", "small.yaml", "--only", "scenes/L0-open-00000"]).ends(2);
        let hint = "`scenes` has no item `L0-open-00000`; did you mean `L0-open-000000`?";
        assert!(said.err.contains(hint), "{pass}: {}", said.err);
        place.tauflow(&["run", "small.yaml"]).ends(0);
    }
    place.tauflow(&["run", "small.yaml", "--only", "scenes/L0-open-000000"]).ends(0);
    let said = place.tauflow(&["run", "small.yaml", "--only", "split/L0-open-000000"]).ends(2);
    assert!(said.err.contains("`split` works on whole collections and has no item `L0-open-000000`"), "{}", said.err);
}

#[test]
fn a_cache_that_cannot_be_made_is_3() {
    let place = Place::new();
    let said = place.tauflow(&["run", "small.yaml", "--cache", "small.yaml"]).ends(3);
    assert!(said.err.contains("small.yaml"), "{}", said.err);
}

#[test]
fn a_failed_item_is_1_and_says_how_to_run_it_again() {
    let place = Place::with(&PIPELINE.replace("train: 2,", "train: 200,"));
    let said = place.tauflow(&["run", "small.yaml"]).ends(1);
    assert!(said.err.contains("strata fall short"), "{}", said.err);
    let again = said.err.lines().find_map(|line| line.trim().strip_prefix("retry: tauflow "));
    let again: Vec<&str> = again.expect("the command is shown").split_whitespace().collect();
    assert_eq!(again, ["run", "small.yaml", "--only", "sampling"]);
    // How actions run stays; what only whole runs have goes.
    let said = place.tauflow(&["run", "small.yaml", "--jobs=1", "--shard", "1/1", "--wait"]).ends(1);
    assert!(said.err.contains("retry: tauflow run small.yaml --jobs=1 --only sampling\n"), "{}", said.err);
    let events = place.tauflow(&["run", "small.yaml", "--events", "json"]).ends(1);
    let failure = events.lines().into_iter().find(|line| line.contains(r#""event":"failure""#)).expect("it is told");
    assert!(failure.contains("strata fall short"), "{failure}");
    // Errors are never cached; what was done stays done.
    let said = place.tauflow(&again).ends(1);
    assert!(said.err.contains("strata fall short"), "{}", said.err);
}

#[test]
fn an_interrupt_is_130_and_the_next_run_goes_on() {
    let place = Place::with(&PIPELINE.replace("pool: 8", "pool: 20000"));
    let mut child = place
        .command(&["run", "small.yaml", "--events", "json", "--jobs", "1", "--target", "scenes"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut lines = BufReader::new(child.stdout.take().expect("it was asked for")).lines();
    let first_end = lines.find(|line| line.as_ref().is_ok_and(|l| l.contains(r#""event":"end""#)));
    assert!(first_end.is_some(), "the run goes on");
    let interrupt = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill starts");
    assert!(interrupt.success());
    let rest: Vec<String> = lines.map(|line| line.expect("text")).collect();
    let said = Said::of(&child.wait_with_output().expect("it ends")).ends(130);
    let resume = "to resume, run: tauflow run small.yaml --events json --jobs 1 --target scenes\n";
    assert!(said.err.contains("stopping") && said.err.contains(resume), "{}", said.err);
    assert!(rest.last().is_some_and(|l| l.contains(r#""event":"finished""#)), "{:?}", rest.last());
    // What was done before the interrupt is done.
    let plan = place.tauflow(&["plan", "small.yaml", "--target", "scenes"]).ends(0).out;
    let row: Vec<&str> = plan.lines().find(|l| l.starts_with("scenes")).expect("a row").split_whitespace().collect();
    let done: u64 = row[1].parse().expect("a count");
    assert!(done > 0 && done < 20_000, "{plan}");
}
