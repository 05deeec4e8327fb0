//! What belongs to a machine: outputs that a library or processor decides, and measurements.

use crate::support::{Workshop, resolve};
use std::{
    collections::BTreeMap,
    fs,
    sync::{Arc, atomic::AtomicBool},
};
use tauflow::{
    engine::{self, Measured, RunOptions, Summary},
    lock::Lock,
};
use tauflow_cache::{Beyond, Digest, Key, Record, Store};
use tauflow_contract::Determinism;

fn pipeline(shop: &Workshop) -> String {
    format!(
        "
pipeline: site
nodes:
  numbers: {{kind: numbers, params: {{count: 12}}}}
  sited: {{kind: sited, inputs: {{in: numbers}}, params: {{site: {:?}}}}}
  total: {{kind: total, inputs: {{in: sited}}}}
  clocks: {{kind: total, inputs: {{in: sited.clocked}}}}
",
        shop.path("site")
    )
}

#[test]
fn another_machine_is_another_key_and_the_first_one_again_is_known() {
    let shop = Workshop::new();
    let text = pipeline(&shop);
    fs::write(shop.path("site"), "7").expect("writable");
    let first = shop.run(&text);
    assert_eq!(first.ran()["sited"], 24);
    assert_eq!(shop.numbers(&text, "total")["all"], 84);
    assert_eq!(shop.run(&text).ran(), BTreeMap::new());
    fs::write(shop.path("site"), "8").expect("writable");
    let second = shop.run(&text);
    assert_eq!(second.ran()["sited"], 24, "the library is another");
    assert!(!second.ran().contains_key("numbers"));
    assert_eq!(shop.numbers(&text, "total")["all"], 96);
    fs::write(shop.path("site"), "7").expect("writable");
    let back = shop.run(&text);
    assert_eq!(back.ran(), BTreeMap::new(), "nothing was lost");
    // By items, too.
    let options = RunOptions { no_rollup: true, many: 1, ..RunOptions::default() };
    assert_eq!(shop.run_with(&text, &options, |_, _| {}).ran(), BTreeMap::new());
}

#[test]
fn what_measures_runs_alone() {
    let shop = Workshop::new();
    let text = pipeline(&shop);
    fs::write(shop.path("site"), "7").expect("writable");
    let options = RunOptions { jobs: 4, ..RunOptions::default() };
    shop.run_with(&text, &options, |_, _| {});
    // Each of the twelve saw itself alone.
    assert_eq!(shop.numbers(&text, "clocks")["all"], 12);
}

#[test]
fn a_lock_leaves_out_what_belongs_to_a_machine() {
    let shop = Workshop::new();
    let text = pipeline(&shop);
    fs::write(shop.path("site"), "7").expect("writable");
    let ran = shop.run(&text);
    let found: BTreeMap<&str, Determinism> =
        ran.summary.outputs.iter().map(|output| (output.name.as_str(), output.determinism)).collect();
    assert_eq!(found["numbers.out"], Determinism::Bitwise);
    assert_eq!((found["sited.out"], found["total.out"]), (Determinism::Local, Determinism::Local));
    assert_eq!((found["sited.clocked"], found["clocks.out"]), (Determinism::Measured, Determinism::Measured));
    let lock = Lock::of("site", &ran.summary.outputs);
    assert!(lock.bitwise.contains_key("numbers.out") && !lock.bitwise.contains_key("total.out"));
    assert!(lock.left_out.contains("sited.out"));
}

/// An upstream that has what a store has.
#[derive(Debug)]
struct Theirs(Arc<Store>);

impl Beyond for Theirs {
    fn records(&self, namespace: &str, keys: &[Key]) -> Vec<Option<Record>> {
        let shared = ["action", "rollup", "machine"].contains(&namespace);
        let made = |record: Record| Record { maker: "theirs, tauflow 0.0".into(), ..record };
        keys.iter().map(|key| self.0.read(namespace, key).filter(|_| shared).map(made)).collect()
    }

    fn keys(&self, namespace: &str) -> Vec<Key> {
        self.0.keys_like(namespace, "")
    }

    fn contains(&self, digest: &Digest) -> bool {
        self.0.contains(digest)
    }

    fn blob(&self, digest: &Digest) -> Option<Vec<u8>> {
        self.0.get(digest).ok().flatten()
    }
}

const LEARNING: &str = "
pipeline: learning
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  learned: {kind: learned, inputs: {in: numbers}}
  doubled: {kind: total, inputs: {in: learned}}
  times: {kind: total, inputs: {in: learned.took}}
";

#[test]
fn a_time_of_another_machine_is_measured_again_unless_it_is_accepted_and_the_rest_is_taken() {
    let (theirs, ours) = (Workshop::new(), Workshop::new());
    theirs.run(LEARNING);
    let took = theirs.numbers(LEARNING, "times")["all"];
    let run = |text: &str, measured: Measured, no_rollup: bool| -> Summary {
        let mut store = ours.store();
        store.look_beyond(Arc::new(Theirs(Arc::new(theirs.store()))));
        let options = RunOptions { measured: Some(measured), no_rollup, ..RunOptions::default() };
        engine::run(&resolve(text), &store, &options, &AtomicBool::new(false), &|_| {}).expect("the store works")
    };
    let ran = |summary: &Summary| -> Vec<String> {
        summary.nodes.iter().filter(|node| node.ran > 0).map(|node| node.node.clone()).collect()
    };
    let accepted = Measured { host: "theirs".into(), accepted: true, ..Measured::default() };
    // Nobody reads the time: what was learned is taken.
    let untimed = LEARNING.split_once("  times").expect("it is there").0.to_owned() + "targets: [doubled]\n";
    assert!(ran(&run(&untimed, Measured::default(), false)).is_empty());
    // Accepted, all is taken, also by commands that run nothing.
    assert!(ran(&run(LEARNING, accepted.clone(), false)).is_empty());
    let times = |of: &Workshop| of.outputs(LEARNING, "times", 0).expect("it has run");
    assert_eq!(times(&ours), times(&theirs));
    // Of another host, nothing is.
    let other = Measured { host: "others".into(), ..accepted.clone() };
    assert_eq!(ran(&run(LEARNING, other, false)), ["learned", "times"]);
    let own = ours.numbers(LEARNING, "times")["all"];
    assert_ne!(own, took);
    // What was measured here takes the place of theirs for good.
    for no_rollup in [false, true] {
        assert!(ran(&run(LEARNING, Measured::default(), no_rollup)).is_empty());
        assert!(ran(&run(LEARNING, accepted.clone(), no_rollup)).is_empty());
    }
    assert_eq!(ours.numbers(LEARNING, "times")["all"], own);
}

#[test]
fn roll_ups_over_accepted_times_are_not_taken_for_own_ones() {
    let (theirs, ours) = (Workshop::new(), Workshop::new());
    theirs.run(LEARNING);
    let run = |measured: Measured, no_rollup: bool| -> u64 {
        let mut store = ours.store();
        store.look_beyond(Arc::new(Theirs(Arc::new(theirs.store()))));
        let options = RunOptions { measured: Some(measured), no_rollup, ..RunOptions::default() };
        let run = engine::run(&resolve(LEARNING), &store, &options, &AtomicBool::new(false), &|_| {});
        run.expect("the store works").nodes.iter().map(|node| node.ran).sum()
    };
    let accepted = Measured { host: "theirs".into(), accepted: true, ..Measured::default() };
    // Item by item, so that the roll-ups are made here.
    assert_eq!((run(accepted.clone(), true), run(accepted, false)), (0, 0));
    assert_eq!(run(Measured::default(), false), 3, "the training, and both groups of the total of its time");
}

#[test]
fn what_reads_outputs_of_one_machine_belongs_to_every_share() {
    let shop = Workshop::new();
    let text = pipeline(&shop);
    fs::write(shop.path("site"), "7").expect("writable");
    shop.run_only(&text, "numbers");
    for share in ["1/4", "2/4", "3/4", "4/4"] {
        // Another machine each time, which nothing else is equal to.
        fs::write(shop.path("site"), format!("10{}", &share[..1])).expect("writable");
        let share = Some(share.parse().expect("a share"));
        let ran = shop.run_with(&text, &RunOptions { share, ..RunOptions::default() }, |_, _| {});
        assert!(ran.summary.failures.is_empty(), "{:?}", ran.summary.failures);
        assert_eq!((ran.ran()["sited"], ran.ran()["total"]), (24, 2));
    }
}
