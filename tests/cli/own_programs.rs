//! Nodes of the kind `command` in a pipeline: what runs again, what a lock holds, and what a failure leaves.

use crate::Place;
use std::{collections::BTreeMap, fs};

/// Numbers of a list, each doubled, and their sum. Each script notes that it ran.
const PIPELINE: &str = "\
pipeline: small
seed: 3
nodes:
  numbers:
    kind: command
    params:
      run: [sh, numbers.sh]
      mode: gather
      outputs: { numbers: tauflow/files }
      depends: [list]
      reproducible: everywhere
  doubled:
    kind: command
    inputs: { numbers: numbers }
    params:
      run: [sh, double.sh]
      inputs: { numbers: tauflow/files }
      outputs: { doubled: tauflow/files }
  total:
    kind: command
    inputs: { doubled: doubled }
    params:
      run: [sh, total.sh]
      mode: gather
      inputs: { doubled: tauflow/files }
      outputs: { total: tauflow/files }
      reproducible: \"no\"
";

const SCRIPTS: [(&str, &str); 3] = [
    (
        "numbers.sh",
        "echo numbers >> HERE/ran
for n in $(cat HERE/list/numbers); do mkdir out/numbers/$n; echo $n > out/numbers/$n/n; done",
    ),
    ("double.sh", "echo doubled >> HERE/ran; echo $((2 * $(cat in/numbers/n))) > out/doubled/n"),
    (
        "total.sh",
        "echo total >> HERE/ran; sum=0
for file in in/doubled/*/n; do sum=$((sum + $(cat $file))); done
mkdir out/total/all; echo $sum > out/total/all/n; cp out/total/all/n HERE/total",
    ),
];

fn place() -> Place {
    let place = Place::with(PIPELINE);
    SCRIPTS.iter().for_each(|(name, text)| script(&place, name, text));
    fs::create_dir(place.path("list")).expect("writable");
    place.write("list/numbers", "1 2 3");
    place
}

fn script(place: &Place, name: &str, text: &str) {
    place.write(name, &text.replace("HERE", &place.path("").display().to_string()));
}

/// How often each script ran since the last question.
fn ran(place: &Place) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for line in fs::read_to_string(place.path("ran")).unwrap_or_default().lines() {
        *counts.entry(line.to_owned()).or_default() += 1;
    }
    place.write("ran", "");
    counts
}

fn counts(of: &[(&str, usize)]) -> BTreeMap<String, usize> {
    of.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect()
}

#[test]
fn programs_run_again_where_something_that_they_name_changed() {
    let place = place();
    place.tauflow(&["check", "small.yaml"]).ends(0);
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    // What is declared to be the same everywhere is run twice.
    assert_eq!(ran(&place), counts(&[("numbers", 2), ("doubled", 3), ("total", 1)]));
    assert_eq!(fs::read_to_string(place.path("total")).expect("written"), "12\n");
    let lock = fs::read_to_string(place.path("small.lock")).expect("it was asked for");
    let (same, left_out) = lock.split_once("left_out").expect("what depends on the machine is named");
    assert!(same.contains("numbers.numbers") && left_out.contains("doubled.doubled"), "{lock}");
    assert!(left_out.contains("total.total") && !same.contains("doubled"), "{lock}");
    place.tauflow(&["run", "small.yaml", "--locked"]).ends(0);
    assert_eq!(ran(&place), BTreeMap::new());
    place.write("list/numbers", "1 2 3 40");
    place.tauflow(&["run", "small.yaml", "--executor", "process"]).ends(0);
    assert_eq!(ran(&place), counts(&[("numbers", 2), ("doubled", 1), ("total", 1)]));
    assert_eq!(fs::read_to_string(place.path("total")).expect("written"), "92\n");
}

#[test]
fn a_program_that_fails_is_told_and_nothing_of_it_is_recorded() {
    let place = place();
    script(&place, "double.sh", "echo doubled >> HERE/ran; echo no luck today >&2; exit 7");
    for _ in 0..2 {
        let failed = place.tauflow(&["run", "small.yaml"]);
        assert_ne!(failed.code, 0);
        assert!(failed.err.contains("no luck today") && failed.err.contains("exit status: 7"), "{}", failed.err);
        assert!(ran(&place).get("doubled").is_some_and(|count| *count > 0), "nothing was recorded");
    }
    script(&place, SCRIPTS[1].0, SCRIPTS[1].1);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    assert_eq!(ran(&place), counts(&[("doubled", 3), ("total", 1)]));
}

#[test]
fn programs_of_one_machine_do_not_run_on_another_that_has_the_upstream() {
    let place = place();
    place.off("a", &["run", "small.yaml"]).ends(0);
    assert_eq!(ran(&place), counts(&[("numbers", 2), ("doubled", 3), ("total", 1)]));
    place.on("a", &["cache", "push", "small.yaml"]).ends(0);
    // What is declared to be the same everywhere is shared.
    place.on("b", &["run", "small.yaml"]).ends(0);
    assert_eq!(ran(&place), counts(&[("doubled", 3), ("total", 1)]));
    place.on("a", &["cache", "push", "--all"]).ends(0);
    for (machine, more) in [("c", &[][..]), ("d", &["--no-rollup"]), ("e", &["--executor", "process"])] {
        let said = place.on(machine, &[&["run", "small.yaml"], more].concat()).ends(0);
        assert_eq!(ran(&place), BTreeMap::new());
        assert!(said.err.contains("nothing to do"), "{}", said.err);
    }
    place.on("f", &["cache", "pull"]).ends(0);
    place.off("f", &["run", "small.yaml"]).ends(0);
    assert_eq!(ran(&place), BTreeMap::new());
    // A file that only the program knew of differs here.
    place.write("list/numbers", "1 2 3 40");
    place.on("g", &["run", "small.yaml"]).ends(0);
    assert_eq!(ran(&place), counts(&[("numbers", 2), ("doubled", 1), ("total", 1)]));
}
