//! `run`, `plan`, `explain`, `export`, `render`, `scene` and `cache`, on a pipeline that renders nothing.

use crate::{Place, Said, json};
use serde_json::Value;
use std::{collections::BTreeMap, fs};

/// The counts that a plan prints, by node: as before, to run.
fn counts(plan: &Said) -> BTreeMap<&str, (String, String)> {
    let rows = plan.lines().into_iter().skip(1).take_while(|line| !line.is_empty() && !line.starts_with("nothing"));
    rows.map(|row| {
        let words: Vec<&str> = row.split_whitespace().collect();
        (words[0], (words[1].to_owned(), words[2].to_owned()))
    })
    .collect()
}

fn pair(before: &str, run: &str) -> (String, String) {
    (before.to_owned(), run.to_owned())
}

#[test]
fn a_second_run_has_nothing_to_do_and_says_so() {
    let place = Place::new();
    let first = place.tauflow(&["run", "small.yaml"]).ends(0);
    assert!(first.err.contains("10 actions ran, 0 as before"), "{}", first.err);
    // The account, and the name of the last run.
    let account = || {
        let mut account =
            json(&fs::read_to_string(place.path("out/small/run.json")).expect("a run leaves its numbers"));
        let run = account.as_object_mut().expect("fields").remove("run").expect("the run has a name");
        (account, run.as_str().expect("a name").to_owned())
    };
    let (numbers, run) = account();
    let second = place.tauflow(&["run", "small.yaml"]).ends(0);
    let again = account();
    assert_eq!(again.0, numbers, "no work, no other numbers");
    assert!(again.1 != run && place.path(&format!("store/runs/{}.json", again.1)).exists(), "{}", again.1);
    let last = second.err.lines().last().unwrap_or_default();
    assert!(last.starts_with("nothing to do: 10 results up to date ("), "{}", second.err);
    let summary = json(&fs::read_to_string(place.path("out/small/run.json")).expect("a run leaves its numbers"));
    assert_eq!(summary["pipeline"], "small");
    let again = place.tauflow(&["run", "small.yaml", "--recheck", "1"]).ends(0);
    assert!(again.err.contains("10 actions ran"), "a recheck runs what it compares: {}", again.err);
}

#[test]
fn a_file_whose_name_is_no_name_of_a_pipeline_writes_nothing_outside_the_folder_of_results() {
    let place = Place::new();
    let text = fs::read_to_string(place.path("small.yaml")).expect("it was written");
    place.write("...yaml", &text.replacen("pipeline: small\n", "", 1));
    place.tauflow(&["run", "./...yaml", "--out", "results"]).ends(0);
    assert!(place.path("results/pipeline/run.json").is_file());
    assert!(!place.path("run.json").exists(), "its name is `..`, and so would be its folder");
}

#[test]
fn events_are_one_json_line_each() {
    let place = Place::new();
    let said = place.tauflow(&["run", "small.yaml", "--events", "json"]).ends(0);
    let events: Vec<Value> = said.lines().into_iter().map(json).collect();
    assert_eq!(events[0]["event"], "started");
    let ended = events.iter().filter(|e| e["event"] == "end" && e["outcome"] == "ran").count();
    assert_eq!(ended, 10);
    let finished = events.iter().find(|e| e["event"] == "finished").expect("it ends");
    assert_eq!((&finished["ran"], &finished["failed"]), (&10.into(), &0.into()));
}

#[test]
fn a_plan_tells_what_would_run_and_why() {
    let place = Place::new();
    let before = place.tauflow(&["plan", "small.yaml"]).ends(0);
    assert_eq!(counts(&before)["scenes"], pair("0", "8"));
    assert!(before.out.contains("has never run"), "{}", before.out);
    assert!(before.out.contains("\nexpected: not known\n"), "{}", before.out);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let after = place.tauflow(&["plan", "small.yaml"]).ends(0);
    assert!(after.out.ends_with("nothing to do\n"), "{}", after.out);
    let more = place.tauflow(&["plan", "small.yaml", "--profile", "more"]).ends(0);
    assert_eq!(counts(&more)["scenes"], pair("8", "2"));
    let other = place.tauflow(&["plan", "small.yaml", "--set", "split.test_share=0.4"]).ends(0);
    assert_eq!((&counts(&other)["scenes"], &counts(&other)["split"]), (&pair("8", "0"), &pair("0", "1")));
    assert!(other.out.contains("test_share"), "the reason is named: {}", other.out);
}

#[test]
fn explain_shows_which_field_differs() {
    let place = Place::new();
    let before = place.tauflow(&["explain", "small.yaml", "split"]).ends(0).out;
    assert!(before.contains("scenes"), "it waits for the scenes: {before}");
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let same = place.tauflow(&["explain", "small.yaml", "split"]).ends(0).out;
    assert!(same.contains("no input has changed"), "{same}");
    let other = place.tauflow(&["explain", "small.yaml", "split", "--set", "split.test_share=0.4"]).ends(0).out;
    for part in ["/params/test_share", "before 0.5", "now    0.4", "kind       content_signature_split"] {
        assert!(other.contains(part), "`{part}` is not in\n{other}");
    }
    let item = place.tauflow(&["explain", "small.yaml", "scenes", "L0-open-000000"]).ends(0).out;
    assert!(item.contains("L0-open-000000") && item.contains("seed"), "{item}");
    let all = place.tauflow(&["explain", "small.yaml", "scenes"]).ends(0).out;
    assert!(all.starts_with("8 x up to date"), "{all}");
    let none = place.tauflow(&["explain", "small.yaml", "scenes", "L0-open-00000"]).ends(2);
    assert!(none.err.contains("did you mean `L0-open-00000"), "{}", none.err);
}

#[test]
fn an_export_of_what_is_lost_makes_it_again() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    place.tauflow(&["export", "small.yaml", "scenes", "-o", "before"]).ends(0);
    for folder in ["packs", "blobs"] {
        fs::remove_dir_all(place.path("store").join(folder)).expect("it was there");
        let said = place.tauflow(&["export", "small.yaml", "scenes", "-o", folder]).ends(0);
        assert!(folder != "packs" || said.err.contains("rebuilding them"), "{}", said.err);
        let manifest = |name: &str| fs::read_to_string(place.path(name).join("manifest.json")).expect("a manifest");
        assert_eq!(manifest(folder), manifest("before"));
    }
}

#[test]
fn an_export_has_files_and_a_manifest() {
    let place = Place::new();
    let early = place.tauflow(&["export", "small.yaml", "scenes", "-o", "scenes"]).ends(2);
    assert!(early.err.contains("`scenes` is stale"), "{}", early.err);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let said = place.tauflow(&["export", "small.yaml", "scenes", "-o", "scenes"]).ends(0);
    assert_eq!(said.out, "scenes\n");
    let manifest = json(&fs::read_to_string(place.path("scenes/manifest.json")).expect("a manifest"));
    let items = manifest["items"].as_array().expect("a list");
    assert_eq!((&manifest["node"], items.len()), (&"scenes".into(), 8));
    for item in items {
        let key = item["item"].as_str().expect("a key");
        let files = item["files"].as_array().expect("a list");
        assert!(!files.is_empty());
        for file in files {
            assert!(place.path("scenes").join(key).join(file.as_str().expect("a name")).is_file(), "{key}/{file}");
        }
    }
    place.tauflow(&["export", "small.yaml", "sampling.report", "-o", "report"]).ends(0);
    let report = fs::read_to_string(place.path("report/report/value.json")).expect("JSON is written for people");
    assert!(report.contains("\n  \""), "it is indented: {report}");
}

#[test]
fn an_exported_scene_is_rendered_and_written_for_mitsuba() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--target", "scenes"]).ends(0);
    place.tauflow(&["export", "small.yaml", "scenes", "-o", "scenes"]).ends(0);
    let scene = "scenes/L0-open-000000";
    let film = ["--spp", "4", "--width", "16", "--height", "12"];
    let render = |out: &str| place.tauflow(&[&["render", scene, "-o", out], &film[..]].concat()).ends(0);
    let said = render("a.exr");
    assert_eq!(said.out, "a.exr\n");
    assert!(said.err.contains("768 paths"), "{}", said.err);
    render("b.exr");
    let read = |name: &str| fs::read(place.path(name)).expect("the image is there");
    assert_eq!(read("a.exr"), read("b.exr"), "the same samples, the same bits");
    assert_eq!(&read("a.exr")[..4], [0x76, 0x2f, 0x31, 0x01], "the first bytes of every EXR");
    render("a.png");
    assert_eq!(&read("a.png")[..4], b"\x89PNG");
    let item = ["render", "small.yaml", "--item", "scenes/L0-open-000000", "-o", "c.exr"];
    place.tauflow(&[&item, &film[..]].concat()).ends(0);
    assert_eq!(read("a.exr"), read("c.exr"), "the item itself gives what its export gives");
    let xml = [&["scene", "mitsuba", scene, "-o", "mitsuba"], &film[..]].concat();
    assert_eq!(place.tauflow(&xml).ends(0).out, "mitsuba/scene.xml\n");
    let xml = fs::read_to_string(place.path("mitsuba/scene.xml")).expect("the scene is there");
    assert!(xml.contains("<scene version=\"3"), "{xml}");
}

#[test]
fn the_cache_is_counted_checked_pinned_and_emptied() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let stat = place.tauflow(&["cache", "stat"]).ends(0).out;
    assert!(stat.contains("scene_generation") && stat.contains("blobs, "), "{stat}");
    let verified = place.tauflow(&["cache", "verify"]).ends(0).out;
    assert!(verified.contains(" 0 damaged; "), "{verified}");
    place.tauflow(&["export", "small.yaml", "sampling.report", "-o", "report"]).ends(0);
    let manifest = json(&fs::read_to_string(place.path("report/manifest.json")).expect("a manifest"));
    let digest = manifest["items"][0]["parts"][""].as_str().expect("the digest of the only part");
    place.tauflow(&["cache", "pin", "mine", digest]).ends(0);
    assert_eq!(place.tauflow(&["cache", "pins"]).ends(0).out, format!("mine  {digest}\n"));
    for name in ["a b", "", ".a", "a/b"] {
        for words in [&["pin", name, digest][..], &["unpin", name]] {
            let said = place.tauflow(&[&["cache"], words].concat()).ends(2);
            assert!(said.err.contains(&format!("`{name}` is not a valid name of a pin")), "{}", said.err);
        }
    }
    place.tauflow(&["cache", "unpin", "mine"]).ends(0);
    assert_eq!(place.tauflow(&["cache", "pins"]).ends(0).out, "");
    let dry = place.tauflow(&["cache", "gc", "--keep-within", "0d", "--dry-run"]).ends(0).out;
    assert!(dry.starts_with("would remove "), "{dry}");
    let plan = place.tauflow(&["plan", "small.yaml"]).ends(0).out;
    assert!(plan.ends_with("nothing to do\n"), "a dry run removes nothing: {plan}");
    place.tauflow(&["cache", "gc", "--keep-within", "1d"]).ends(0);
    let plan = place.tauflow(&["plan", "small.yaml"]).ends(0).out;
    assert!(plan.ends_with("nothing to do\n"), "what is recent stays: {plan}");
}

#[test]
fn the_cache_lies_where_it_is_asked_for() {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--cache", "here"]).ends(0);
    assert!(place.path("here").is_dir() && !place.path("store").exists());
    place.tauflow(&["run", "small.yaml"]).ends(0);
    assert!(place.path("store").is_dir(), "TAUFLOW_CACHE");
    let mut command = place.command(&["run", "small.yaml"]);
    Said::of(&command.env_remove("TAUFLOW_CACHE").output().expect("the program starts")).ends(0);
    assert!(place.path(".tauflow").is_dir(), "outside a checkout");
}
