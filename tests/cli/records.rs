//! `runs` and `diff`: every run leaves a record, and two of them can be compared.

use crate::{Place, Said, json};
use serde_json::Value;
use std::fs;

/// The records as JSON, oldest first.
fn records(place: &Place) -> Vec<Value> {
    let said = place.tauflow(&["runs", "--json"]).ends(0);
    said.lines().into_iter().map(json).collect()
}

fn id(record: &Value) -> String {
    record["id"].as_str().expect("an id").to_owned()
}

/// Three runs: the work, nothing, and more scenes.
fn three() -> (Place, Vec<Value>) {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    place.tauflow(&["run", "small.yaml", "--profile", "more"]).ends(0);
    let records = records(&place);
    (place, records)
}

#[test]
fn a_run_that_does_nothing_keeps_the_record_of_the_one_that_did_the_work() {
    let (place, records) = three();
    assert_eq!(records.len(), 3);
    let ran = |record: &Value| record["nodes"].as_array().expect("nodes").iter().map(|n| n["ran"].as_u64()).sum();
    let counts: Vec<Option<u64>> = records.iter().map(ran).collect();
    assert_eq!(counts[..2], [Some(10), Some(0)]);
    assert!(counts[2].is_some_and(|count| count > 0));
    assert_eq!(records[0]["outputs"], records[1]["outputs"], "the same digests");
    let word = |record: &Value, n: usize| record["command"][n].as_str().map(str::to_owned);
    assert_eq!((word(&records[0], 1).as_deref(), word(&records[0], 2).as_deref()), (Some("run"), Some("small.yaml")));
    assert_eq!(records[2]["overrides"], serde_json::json!(["--profile more"]));
    assert_eq!((&records[2]["params"]["scenes"]["pool"], &records[2]["outcome"]), (&10.into(), &"done".into()));
    assert!(records[0]["machine"]["threads"].as_u64() > Some(0));
    let table = place.tauflow(&["runs", "small.yaml"]).ends(0);
    assert_eq!(table.lines().len(), 4, "{}", table.out);
    assert!(table.lines()[1].starts_with(&id(&records[0])), "{}", table.out);
    let last = place.tauflow(&["runs", "small", "--last", "1"]).ends(0);
    assert!(last.lines().len() == 2 && last.err.contains("2 earlier runs not shown"), "{last:?}");
    let one = place.tauflow(&["runs", &id(&records[2])]).ends(0).out;
    for part in
        ["command    ", "run small.yaml --profile more", "overrides  --profile more", "outcome    done", "\nscenes "]
    {
        assert!(one.contains(part), "`{part}` is not in\n{one}");
    }
    assert_eq!(json(&place.tauflow(&["runs", &id(&records[2]), "--json"]).ends(0).out), records[2]);
    place.tauflow(&["cache", "gc", "--max-size", "1KiB"]).ends(0);
    assert_eq!(self::records(&place), records, "a gc takes no record");
    let pruned = place.tauflow(&["runs", "--prune", "--keep", "1"]).ends(0);
    assert_eq!(pruned.out, "deleted 2 records of runs, kept 1\n");
    assert_eq!(self::records(&place), records[2..]);
}

#[test]
fn a_diff_names_params_outputs_and_times() {
    let (place, records) = three();
    let (work, more) = (id(&records[0]), id(&records[2]));
    let said = place.tauflow(&["diff", &work]).ends(0);
    assert!(said.out.contains("\n  scenes.pool: 8 -> 10\n"), "{}", said.out);
    assert!(said.out.contains("\n  scenes.scenes: ") && said.out.contains("ran before"), "{}", said.out);
    assert!(said.out.contains(&format!("after   {more}")), "the latest is the default: {}", said.out);
    let same = place.tauflow(&["diff", &work, &id(&records[1])]).ends(0);
    assert!(same.out.contains("params: equal") && same.out.contains(" equal, 0 different"), "{}", same.out);
    let json = place.tauflow(&["diff", &work, "--json"]).ends(0);
    let value = crate::json(&json.out);
    assert_eq!(value["comparison"]["params"][0]["name"], "scenes.pool");
}

#[test]
fn outputs_that_a_run_did_not_need_are_no_differences() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    place.tauflow(&["run", "small.yaml", "--target", "scenes"]).ends(0);
    // A run that could not begin made nothing, and is not what people ask for.
    place.tauflow(&["run", "small.yaml", "--only", "scenes/nobody"]).ends(2);
    let found = records(&place);
    let said = place.tauflow(&["diff", &id(&found[0])]).ends(0).out;
    assert!(said.contains("done --target scenes; tauflow"), "{said}");
    assert!(said.contains("outputs: 1 equal, 0 different\n"), "{said}");
    assert!(said.contains("split.train: only before; the other run did not make it or need it"), "{said}");
    let said = place.tauflow(&["diff", &id(&found[1]), &id(&found[0])]).ends(0).out;
    assert!(said.contains("sampling.train: only after;"), "{said}");
}

#[test]
fn a_run_that_is_not_there_is_an_error_with_a_hint() {
    let (place, records) = three();
    let said = |arguments: &[&str]| -> Said { place.tauflow(arguments).ends(2) };
    let latest = id(&records[2]);
    assert!(said(&["diff", &latest]).err.contains("is the latest run of `small`"));
    assert!(said(&["diff", "1999"]).err.contains("no run `1999`; runs: "));
    assert!(said(&["runs", "smal"]).err.contains("did you mean `small`?"));
    let empty = Place::new();
    assert!(empty.tauflow(&["runs"]).ends(0).err.contains("no runs are recorded in "));
}

#[test]
fn failures_are_recorded_and_damaged_records_are_named_and_skipped() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--out", "small.yaml"]).ends(3);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let found = records(&place);
    assert_eq!((&found[0]["outcome"], &found[1]["outcome"]), (&"error".into(), &"done".into()));
    assert!(found[0]["error"].as_str().is_some_and(|e| e.contains("cannot write small.yaml")), "{}", found[0]);
    let broken = place.path(&format!("store/runs/{}.json", id(&found[0])));
    fs::write(&broken, "{").expect("room");
    let said = place.tauflow(&["runs"]).ends(0);
    assert!(said.err.contains("warning: the run record") && said.err.contains("is damaged and skipped"), "{said:?}");
    assert_eq!(said.lines().len(), 2, "{}", said.out);
}
