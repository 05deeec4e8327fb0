//! What happens when something fails: siblings go on, readers are blocked, nothing false is kept.

use crate::support::Workshop;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::atomic::Ordering,
};
use tauflow::engine::{
    RunOptions,
    event::{Ended, Event},
};
use tauflow_testing::{Need, skip};

const RISKY: &str = "
nodes:
  numbers: {kind: numbers, params: {count: 6}}
  risky: {kind: affine, inputs: {in: numbers}, params: {fail_from: 40, mul: 2}}
  rounded: {kind: round, inputs: {in: risky}}
  total: {kind: total, inputs: {in: rounded}}
  beside: {kind: total, inputs: {in: numbers}}
";

#[test]
fn a_failure_blocks_its_readers_and_nobody_else() {
    let shop = Workshop::new();
    let ran = shop.run(RISKY);
    assert_eq!(ran.ran(), BTreeMap::from([("numbers", 6), ("risky", 4), ("rounded", 4), ("beside", 2)]));
    assert_eq!(ran.count(|n| n.failed), BTreeMap::from([("risky", 2)]));
    assert_eq!(ran.count(|n| n.blocked), BTreeMap::from([("rounded", 2), ("total", 2)]));
    // One cause, two items, each with what runs just that one.
    let causes: BTreeSet<String> = ran.summary.failures.iter().map(tauflow::engine::event::Failure::cause).collect();
    assert_eq!(causes, BTreeSet::from(["`<item>` is too large; lower it".to_owned()]));
    let mut only: Vec<String> = ran.summary.failures.iter().map(tauflow::engine::event::Failure::only).collect();
    only.sort();
    assert_eq!(only, ["risky/n0004", "risky/n0005"]);
    assert_eq!(shop.run_only(RISKY, &only[0]).summary.failures.len(), 1);
}

#[test]
fn errors_are_never_cached() {
    let shop = Workshop::new();
    assert_eq!(shop.run(RISKY).summary.failures.len(), 2);
    let again = shop.run(RISKY);
    assert_eq!(again.summary.failures.len(), 2);
    assert_eq!(again.ran(), BTreeMap::new());
    assert_eq!(again.count(|n| n.failed), BTreeMap::from([("risky", 2)]));
    // What was done stays done: mending the cause runs the rest.
    let mended = shop.run(&RISKY.replace("count: 6", "count: 4"));
    assert_eq!(mended.ran(), BTreeMap::from([("total", 2), ("beside", 2)]));
}

#[test]
fn a_panic_is_a_failure_like_any_other() {
    let shop = Workshop::new();
    let ran = shop.run(&RISKY.replace("fail_from: 40", "panic_on: 20"));
    assert_eq!(ran.count(|n| n.failed), BTreeMap::from([("risky", 1)]));
    let failure = &ran.summary.failures[0];
    assert_eq!(failure.only(), "risky/n0002");
    assert!(failure.message.contains("panic: the number 20 is unlucky"), "{}", failure.message);
    assert_eq!(ran.ran()["rounded"], 5);
}

#[test]
fn fail_fast_begins_nothing_after_the_first_failure() {
    let shop = Workshop::new();
    let options = RunOptions { jobs: 1, fail_fast: true, ..RunOptions::default() };
    let text = RISKY.replace("fail_from: 40", "fail_from: 10");
    let ran = shop.run_with(&text, &options, |_, _| {});
    assert_eq!(ran.summary.failures.len(), 1);
    assert_eq!(ran.ended(Ended::Failed), ["risky/n0001"]);
    let begun = ran.events.iter().filter_map(|event| match event {
        Event::Begin { node, item, .. } => Some(format!("{node}/{item}")),
        _ => None,
    });
    assert_eq!(begun.collect::<Vec<_>>().last().map(String::as_str), Some("risky/n0001"));
    assert!(!ran.summary.interrupted);
}

#[test]
fn a_source_that_cannot_list_its_items_leaves_its_readers_unknown() {
    let shop = Workshop::new();
    let ran = shop.run(
        "
nodes:
  files: {kind: files, params: {folder: /nowhere/at/all}}
  scaled: {kind: affine, inputs: {in: files}}
  total: {kind: total, inputs: {in: scaled}}
  numbers: {kind: numbers}
",
    );
    assert_eq!(ran.summary.failures.len(), 1);
    assert!(ran.summary.failures[0].message.contains("/nowhere/at/all"));
    assert_eq!(ran.ran(), BTreeMap::from([("numbers", 4)]));
    assert_eq!(ran.count(|n| u64::from(n.unknown)), BTreeMap::from([("files", 1), ("scaled", 1)]));
    assert_eq!(ran.count(|n| n.blocked), BTreeMap::from([("total", 2)]));
}

#[test]
fn a_stopped_run_goes_on_where_it_stopped() {
    let shop = Workshop::new();
    let text = RISKY.replace("fail_from: 40, ", "");
    let done = std::sync::atomic::AtomicUsize::new(0);
    let stopped = shop.run_with(&text, &RunOptions { jobs: 2, ..RunOptions::default() }, |event, stop| {
        if matches!(event, Event::End { .. }) && done.fetch_add(1, Ordering::Relaxed) == 6 {
            stop.store(true, Ordering::Relaxed);
        }
    });
    assert!(stopped.summary.interrupted);
    let before = stopped.summary.total(|n| n.ran);
    assert!((7..22).contains(&before), "{before}");
    assert!(stopped.summary.failures.is_empty());
    let rest = shop.run(&text);
    assert!(!rest.summary.interrupted);
    assert_eq!(rest.summary.total(|n| n.ran), 6 + 6 + 6 + 2 + 2 - before);
    assert_eq!(shop.run(&text).ran(), BTreeMap::new());
}

#[test]
fn files_that_are_no_regular_ones_fail_alone() {
    let shop = Workshop::new();
    let folder = shop.path("given");
    std::fs::create_dir(&folder).expect("writable");
    std::fs::write(folder.join("sound"), "7").expect("writable");
    // Reading it would never end.
    std::os::unix::fs::symlink("/dev/zero", folder.join("device")).expect("writable");
    std::os::unix::fs::symlink("nowhere", folder.join("dangling")).expect("writable");
    std::fs::create_dir(folder.join("folder")).expect("writable");
    let huge = std::fs::File::create(folder.join("huge")).expect("writable");
    huge.set_len(1 << 40).expect("a file of holes");
    let mut failed = vec!["files/dangling", "files/device", "files/folder", "files/huge"];
    match std::process::Command::new("mkfifo").arg(folder.join("fifo")).status() {
        Ok(status) if status.success() => failed.insert(2, "files/fifo"),
        other => skip(Need::Fifo, format_args!("FIFOs cannot be made here: {other:?}")),
    }
    let text = format!("nodes: {{files: {{kind: files, params: {{folder: '{}'}}}}}}", folder.display());
    for sound in [1, 0] {
        let ran = shop.run(&text);
        let mut only: Vec<String> = ran.summary.failures.iter().map(tauflow::engine::event::Failure::only).collect();
        only.sort();
        assert_eq!(only, failed);
        assert_eq!(ran.ran().get("files").copied().unwrap_or(0), sound, "the sound file alone, once");
        for failure in &ran.summary.failures {
            let told = &failure.message;
            assert!(told.contains("cannot read `") && told.contains("; repair or remove it"), "{told}");
        }
    }
}
