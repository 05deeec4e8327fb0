//! Nodes of the kind `command` in a pipeline: what runs again, what a lock holds, and what a failure leaves.

use crate::{Place, json, root};
use std::{collections::BTreeMap, fs, path::Path, process::Command};
use tauflow_testing::{Need, Shared, skip};

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

/// The block of the manual that is marked so, as its page has it.
fn block(marked: &str) -> &'static str {
    let page = include_str!("../../nodes/denoise/src/command_kind.md");
    let begin = format!("```{marked}\n");
    let (_, rest) = page.split_once(&begin).expect("the page has such a block");
    rest.split("```").next().unwrap_or_default()
}

#[test]
fn the_denoiser_of_the_manual_is_a_method_in_the_tables_of_the_quickstart() {
    if !Command::new("python3").arg("-V").output().is_ok_and(|done| done.status.success()) {
        skip(Need::Python, "there is no python3");
        return;
    }
    let quickstart = root().join("pipelines/quickstart.yaml");
    let pipeline = block("text").replace("quickstart.yaml", &quickstart.to_string_lossy());
    let place = Place::with(&pipeline);
    place.write("box.py", block("python"));
    let wanted = ["--target", "comparison", "--target", "comparison_report"];
    // `tests/pipelines/executors.rs` shares the rest of the quickstart.
    let tmp = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let shared = Shared::of(Path::new(env!("CARGO_BIN_EXE_tauflow")), tmp, "tiny-quickstart");
    let cache = shared.path().join("cache").display().to_string();
    let tiny = ["small.yaml", "--profile", "tiny", "--cache", &cache];
    place.tauflow(&[&["run"], &tiny[..], &["--out", "out"], &wanted[..]].concat()).ends(0);
    place.tauflow(&[&["export", "small.yaml", "comparison"], &tiny[1..], &["-o", "tables"]].concat()).ends(0);
    let table = json(&fs::read_to_string(place.path("tables/evaluation/value.json")).expect("exported"));
    let of = |method: &str| {
        let rows = table["baselines"].as_array().into_iter().flatten();
        rows.filter(|row| row["method"] == method).map(|row| row["at"][0]["gain"]["hdr_psnr"].clone()).next()
    };
    let gain = of("box").unwrap_or_else(|| panic!("no row of the program: {table}"));
    assert!(gain["low"].as_f64().is_some_and(|low| low > 0.0), "means of nine pixels are less noisy: {gain}");
    let page = fs::read_to_string(place.path("out/with_box/report.html")).expect("written");
    assert!(page.contains("</span>box</td>"), "the report shows the program");
    // The published copy names the run that wrote it.
    let account = page.split_once("<!--tauflow:run-->").and_then(|(_, rest)| rest.split_once("<!--/tauflow:run-->"));
    let (account, _) = account.expect("a line on the run");
    assert!(
        account.contains("Made by tauflow ") && account.contains(" UTC, on ") && account.contains(" run "),
        "{account}"
    );
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
