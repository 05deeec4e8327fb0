//! Machines that share results through a folder: here, two caches.

use crate::{Place, Said};
use std::fs;

impl Place {
    /// Runs the program as a machine with a cache of its own.
    fn on(&self, machine: &str, arguments: &[&str]) -> Said {
        let mut command = self.command(arguments);
        command.env("TAUFLOW_CACHE", self.path(machine)).env("TAUFLOW_UPSTREAM", self.path("shared"));
        Said::of(&command.output().expect("the program starts"))
    }
}

#[test]
fn what_one_machine_ran_is_up_to_date_on_another() {
    let place = Place::new();
    let run = ["run", "small.yaml"];
    place.on("a", &run).ends(0);
    let pushed = place.on("a", &["cache", "push"]).ends(0).out;
    assert!(pushed.starts_with("pushed ") && pushed.ends_with(" 0 there already\n"), "{pushed}");
    let pulled = place.on("b", &["cache", "pull"]).ends(0).out;
    assert!(pulled.starts_with("pulled ") && pulled.ends_with(" 0 here already\n"), "{pulled}");
    let said = place.on("b", &run).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    // Item by item, too.
    let said = place.on("b", &[&run[..], &["--no-rollup"]].concat()).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    place.on("b", &["cache", "verify"]).ends(0);
    // Now what only the other machine has goes back.
    place.on("b", &[&run[..], &["--profile", "more"]].concat()).ends(0);
    let dry = place.on("b", &["cache", "push", "--dry-run"]).ends(0).out;
    let pushed = place.on("b", &["cache", "push"]).ends(0).out;
    assert_eq!(dry.replacen("would push", "pushed", 1), pushed);
    place.on("a", &["cache", "pull"]).ends(0);
    let said = place.on("a", &[&run[..], &["--profile", "more"]].concat()).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    let shared = place.path("shared").display().to_string();
    let stat = place.on("a", &["cache", "stat", "--upstream", &shared]).ends(0).out;
    assert!(stat.contains("2 packs with 2 indices"), "{stat}");
}

#[test]
fn damage_is_a_note_and_the_run_makes_the_rest() {
    let place = Place::new();
    place.on("a", &["run", "small.yaml"]).ends(0);
    place.on("a", &["cache", "push"]).ends(0);
    for entry in fs::read_dir(place.path("shared/packs")).expect("readable") {
        let path = entry.expect("readable").path();
        if path.extension().is_some_and(|extension| extension == "pack") {
            let bytes = fs::read(&path).expect("readable");
            fs::write(&path, &bytes[..bytes.len() / 2]).expect("writable");
        }
    }
    let said = place.on("b", &["cache", "pull"]).ends(1);
    assert!(said.err.contains("note: pack ") && said.err.contains("is truncated"), "{}", said.err);
    assert!(said.out.contains("left out, because blobs are missing or damaged"), "{}", said.out);
    place.on("b", &["run", "small.yaml"]).ends(0);
    place.on("b", &["cache", "verify"]).ends(0);
}

#[test]
fn an_upstream_that_is_none_is_an_error_with_a_remedy() {
    let place = Place::new();
    for words in [&["pull"][..], &["push", "--dry-run"]] {
        let said = place.tauflow(&[&["cache"], words].concat()).ends(2);
        assert!(said.err.contains("give --upstream DIR") || said.err.contains("no cache in"), "{}", said.err);
    }
    let said = place.tauflow(&["cache", "pull", "--upstream", "s3://bucket/lab"]).ends(2);
    assert!(said.err.contains("must be a directory"), "{}", said.err);
    let said = place.tauflow(&["cache", "pull", "--upstream", "nowhere"]).ends(3);
    assert!(said.err.contains("nowhere"), "{}", said.err);
    let said = place.tauflow(&["cache", "pull", "--upstream", "."]).ends(2);
    assert!(said.err.contains("is not an upstream"), "{}", said.err);
    assert!(!place.path("store").exists(), "looking for an upstream makes no cache");
}
