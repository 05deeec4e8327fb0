//! Records as files: written once, found by their ids, and skipped where they are damaged.

use super::*;

fn record(pipeline: &str, started: u64) -> RunRecord {
    RunRecord {
        format: FORMAT,
        id: String::new(),
        started,
        elapsed_s: 1.5,
        pipeline: pipeline.into(),
        file: PathBuf::from("/nowhere/p.yaml"),
        version: "1".into(),
        commit: None,
        command: vec!["tauflow".into()],
        overrides: Vec::new(),
        machine: Machine::here(),
        outcome: Outcome::Done,
        error: None,
        nodes: vec![NodeStat { node: "n".into(), ran: 2, spent_s: 3.0, ..NodeStat::default() }],
        slowest: Vec::new(),
        params: BTreeMap::from([("n".into(), serde_json::json!({ "a": { "b": 1 }, "list": [1, 2] }))]),
        outputs: BTreeMap::new(),
        failures: Vec::new(),
        failed: 0,
    }
}

#[test]
fn records_of_one_second_are_all_kept_and_read_in_order() {
    let cache = tempfile::tempdir().expect("a folder");
    assert_eq!(read_all(cache.path()).expect("no run yet"), (vec![], vec![]));
    let mut written: Vec<RunRecord> = (0..12).map(|_| record("p", 951_782_400)).collect();
    for record in &mut written {
        record.write(cache.path()).expect("room");
    }
    let mut earlier = record("q", 951_782_399);
    earlier.write(cache.path()).expect("room");
    written.insert(0, earlier);
    assert_eq!(read_all(cache.path()).expect("readable"), (written.clone(), vec![]));
    assert_eq!(written[12].id, "20000229-000000-12");
    let files = fs::read_dir(cache.path().join(FOLDER)).expect("written").count();
    assert_eq!(files, 13, "no temporary file is left");
}

#[test]
fn damaged_records_are_named_and_skipped() {
    let cache = tempfile::tempdir().expect("a folder");
    let mut good = record("p", 0);
    let path = good.write(cache.path()).expect("room");
    let folder = path.parent().expect("a folder");
    let text = fs::read_to_string(&path).expect("written");
    fs::write(folder.join("half.json"), &text[..text.len() / 2]).expect("room");
    fs::write(folder.join("later.json"), text.replace("\"format\":1", "\"format\":99")).expect("room");
    fs::write(folder.join("other.json"), &text).expect("room");
    fs::create_dir(folder.join("folder.json")).expect("room");
    fs::write(folder.join("notes.txt"), "of somebody else").expect("room");
    let (records, damaged) = read_all(cache.path()).expect("readable");
    assert_eq!(records, [good]);
    let named = |name: &str| damaged.iter().find(|d| d.path.ends_with(name)).map(|d| d.why.clone()).unwrap_or_default();
    assert!(named("half.json").contains("not JSON"), "{damaged:?}");
    assert!(named("later.json").contains("format 99"), "{damaged:?}");
    assert!(named("other.json").contains("record of run `19700101-000000`"), "{damaged:?}");
    assert!(!named("folder.json").is_empty() && damaged.len() == 4, "{damaged:?}");
}

#[test]
fn runs_are_found_by_id_or_its_beginning() {
    let ids = ["20000229-000000", "20000229-000000-2", "20000301-000000"];
    let records: Vec<RunRecord> = ids.map(|id| RunRecord { id: id.into(), ..record("p", 0) }).to_vec();
    let find = |wanted: &str| find(&records, wanted).map(|r| r.id.clone()).map_err(|e| e.to_string());
    assert_eq!(find("20000229-000000").as_deref(), Ok(ids[0]), "an exact id is no beginning");
    assert_eq!(find("200003").as_deref(), Ok(ids[2]));
    assert!(find("2000").is_err_and(|e| e.starts_with("3 runs begin with `2000`")));
    assert!(find("20000229-000001").is_err_and(|e| e.contains("did you mean `20000229-00000")));
    assert!(find("").is_err());
}

#[test]
fn params_are_compared_by_path_and_times_by_node() {
    let cache = tempfile::tempdir().expect("a folder");
    let store = tauflow_cache::Store::open(cache.path()).expect("a store");
    let (a, mut b) = (record("p", 0), record("p", 1));
    assert_eq!(compare(&a, &a, &store).expect("readable").params, []);
    b.params.insert("n".into(), serde_json::json!({ "a": { "b": 2 }, "list": [1, 2], "new": true }));
    b.nodes[0].spent_s = 6.0;
    let found = compare(&a, &b, &store).expect("readable");
    let named: Vec<&str> = found.params.iter().map(|change| change.name.as_str()).collect();
    assert_eq!(named, ["n.a.b", "n.new"]);
    assert_eq!((&found.params[1].before, &found.params[1].after), (&None, &Some(true.into())));
    assert_eq!((found.times[0].before, found.times[0].after), (3.0, 6.0));
}

#[test]
fn a_link_in_place_of_the_directory_is_refused() {
    let (cache, other) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    std::os::unix::fs::symlink(other.path(), cache.path().join(FOLDER)).expect("room");
    let said = record("p", 0).write(cache.path()).expect_err("nothing may be written there").to_string();
    assert!(said.contains("it is a link"), "{said}");
    assert!(read_all(cache.path()).is_err());
    assert_eq!(fs::read_dir(other.path()).expect("it is there").count(), 0);
}

#[test]
fn the_latest_runs_stay_and_the_one_that_did_the_work() {
    let cache = tempfile::tempdir().expect("a folder");
    let write = |pipeline: &str, started: u64, ran: u64, outcome: Outcome| {
        let nodes = vec![NodeStat { node: "n".into(), ran, ..NodeStat::default() }];
        let mut record = RunRecord { nodes, outcome, ..record(pipeline, started) };
        record.write(cache.path()).expect("room");
        record.id
    };
    let first = write("p", 0, 3, Outcome::Done);
    let work = write("p", 1, 2, Outcome::Done);
    let broken = write("p", 2, 2, Outcome::Failed);
    let nothing: Vec<String> = (3..6).map(|started| write("p", started, 0, Outcome::Done)).collect();
    let other = write("q", 0, 0, Outcome::Done);
    let (records, _) = read_all(cache.path()).expect("readable");
    let gone = superfluous(&records, 2);
    assert_eq!(gone, [first, broken, nothing[0].clone()]);
    assert_eq!(superfluous(&records, 10), [""; 0]);
    prune(cache.path(), &gone).expect("ours");
    let (left, _) = read_all(cache.path()).expect("readable");
    let left: BTreeSet<String> = left.into_iter().map(|record| record.id).collect();
    assert_eq!(left, BTreeSet::from([work, nothing[1].clone(), nothing[2].clone(), other]));
}

#[test]
fn a_run_without_a_state_goes_on_for_a_while_and_was_killed_later() {
    let cache = tempfile::tempdir().expect("a folder");
    for (started, outcome) in [(engine::now(), Outcome::Running), (engine::now() - 3600, Outcome::Killed)] {
        let mut running = RunRecord { outcome: Outcome::Running, ..record("p", started) };
        running.write(cache.path()).expect("room");
        let (records, _) = read_all(cache.path()).expect("readable");
        assert_eq!(records.iter().find(|of| of.id == running.id).expect("it is there").outcome, outcome);
    }
}

#[test]
fn a_run_whose_process_is_gone_was_killed_and_one_that_has_begun_is_never_overwritten() {
    let cache = tempfile::tempdir().expect("a folder");
    let mut running = RunRecord { outcome: Outcome::Running, nodes: vec![], ..record("p", 7) };
    running.write(cache.path()).expect("room");
    let mut state = LiveState { id: running.id.clone(), process: Process::here(), ..LiveState::default() };
    state.nodes.push(LiveNode { node: "n".into(), known: true, ..LiveNode::default() });
    state.nodes[0].counts.ran = 5;
    state.elapsed_s = 2.5;
    state.write(cache.path()).expect("room");
    let read = || read_all(cache.path()).expect("readable").0;
    assert_eq!(read()[0].outcome, Outcome::Running);
    assert_eq!(superfluous(&read(), 0), [""; 0], "it goes on");
    state.process.began += 1;
    state.write(cache.path()).expect("room");
    let killed = read().remove(0);
    assert_eq!((killed.outcome, killed.elapsed_s, killed.total(|n| n.ran)), (Outcome::Killed, 2.5, 5));
    let mut second = record("p", 7);
    second.write(cache.path()).expect("room");
    assert_ne!(second.id, running.id);
    let ended = RunRecord { outcome: Outcome::Failed, ..running };
    ended.conclude(cache.path()).expect("room");
    assert_eq!(read(), [ended, second]);
}
