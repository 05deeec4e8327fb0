//! Results of others: audits, and upstreams that are pinned to a key.

use crate::Place;
use std::{fs, path::PathBuf};
use tauflow_cache::{Record, Store};

/// Two scenes of this cache swap their names, and all that follows from them is recorded.
fn forge(place: &Place, machine: &str) {
    place.off(machine, &["run", "small.yaml"]).ends(0);
    let store = Store::open(&place.path(machine)).expect("a store");
    let scenes: Vec<Record> = store.by_label("action", "scene_generation");
    let (one, other) = (&scenes[0], scenes.iter().find(|of| of.payload != scenes[0].payload).expect("another scene"));
    let Record { payload, refs, trees, .. } = other.clone();
    let forged = Record { payload, refs, trees, maker: "the-forger, tauflow 0.0".into(), ..one.clone() };
    store.replace(&forged).expect("writable");
    drop(store);
    place.off(machine, &["run", "small.yaml", "--no-rollup"]).ends(0);
}

/// The digests of all outputs.
fn outputs(place: &Place, machine: &str, more: &[&str]) -> (String, String) {
    let said = place.on(machine, &[&["run", "small.yaml", "--update-lock"], more].concat()).ends(0);
    (fs::read_to_string(place.path("small.lock")).expect("it was written"), said.err)
}

#[test]
fn an_audit_quarantines_what_differs_and_names_its_maker() {
    let place = Place::new();
    let honest = outputs(&place, "honest", &["--upstream", ""]).0;
    forge(&place, "evil");
    place.on("evil", &["cache", "push"]).ends(0);
    assert_ne!(outputs(&place, "trusting", &[]).0, honest, "who trusts the upstream gets the forged outputs");
    for (machine, more) in [("careful", &[][..]), ("children", &["--executor", "process"])] {
        let (audited, said) = outputs(&place, machine, &[&["--audit", "1"], more].concat());
        assert_eq!(audited, honest);
        let about = said.lines().find(|line| line.contains("is not what this machine computes")).unwrap_or_default();
        assert!(said.contains("results made again, 1 of them different"), "{said}");
        assert!(about.contains("the-forger, tauflow 0.0") && about.contains("scene_generation"), "{said}");
        // It stays so without an audit, although the roll-ups of the upstream contain it.
        assert_eq!(outputs(&place, machine, &[]).0, honest);
        let store = Store::open_existing(&place.path(machine)).expect("a store");
        assert_eq!(store.keys_like("quarantine", "").len(), 1);
        drop(store);
        place.on(machine, &["cache", "verify"]).ends(0);
    }
    // An audit that comes later finds what was copied before.
    assert_eq!(outputs(&place, "trusting", &["--audit", "1"]).0, honest);
    assert_eq!(outputs(&place, "trusting", &[]).0, honest);
}

#[test]
fn roll_ups_of_one_s_own_from_before_a_quarantine_do_not_count() {
    let place = Place::new();
    let more = |machine: &str, upstream: &[&str]| {
        place.on(machine, &[&["run", "small.yaml", "--profile", "more", "--update-lock"], upstream].concat()).ends(0);
        fs::read_to_string(place.path("small.more.lock")).expect("it was written")
    };
    let honest = more("honest", &["--upstream", ""]);
    forge(&place, "evil");
    place.on("evil", &["cache", "push"]).ends(0);
    // The upstream has eight of these ten scenes, and no roll-up of them: the machine makes its own.
    assert_ne!(more("audited", &[]), honest);
    assert!(place.on("audited", &["run", "small.yaml", "--audit", "1"]).ends(0).err.contains("1 of them different"));
    assert_eq!(more("audited", &[]), honest);
    // What is found anew counts again.
    std::thread::sleep(std::time::Duration::from_millis(1100));
    more("audited", &[]);
    let store = Store::open_existing(&place.path("audited")).expect("a store");
    let quarantined = store.by_label("quarantine", "scene_generation")[0].when;
    let lanes: Vec<Record> = ["scene_generation", "content_signature_split", "stratified_sampling"]
        .iter()
        .flat_map(|kind| store.by_label("rollup", kind))
        .collect();
    assert!(lanes.iter().filter(|lane| lane.when > quarantined && !lane.fetched).count() >= 3, "{lanes:?}");
}

#[test]
fn an_audit_of_honest_results_finds_nothing_and_asks_for_a_share() {
    let place = Place::new();
    let honest = outputs(&place, "a", &["--push"]).0;
    let (audited, said) = outputs(&place, "b", &["--audit", "1"]);
    assert_eq!(audited, honest);
    assert!(!said.contains("warning") && said.contains("audit: 10 results made again, 0 of them different"), "{said}");
    // Its own results are not audited.
    let said = place.off("a", &["run", "small.yaml", "--audit", "1"]).ends(0);
    assert!(said.err.contains("nothing to do") && said.err.contains("audit: 0 results made again"), "{}", said.err);
    let said = place.on("b", &["run", "small.yaml", "--audit", "2"]).ends(2);
    assert!(said.err.contains("--audit 2 must be between 0 and 1"), "{}", said.err);
    // The maker is known to whoever gets a record.
    let store = Store::open_existing(&place.path("b")).expect("a store");
    let scenes = store.by_label("action", "scene_generation");
    let host = fs::read_to_string("/proc/sys/kernel/hostname").expect("Linux has it");
    assert!(scenes.iter().all(|of| of.fetched && of.maker.starts_with(host.trim())), "{:?}", scenes[0].maker);
}

fn indices(place: &Place, extension: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(place.path("shared/packs")).expect("readable").flatten().map(|entry| entry.path());
    entries.filter(|path| path.extension().is_some_and(|e| e == extension)).collect()
}

#[test]
fn an_upstream_that_is_pinned_to_a_key_serves_what_the_key_signed() {
    let place = Place::new();
    let key = |name: &str| place.tauflow(&["cache", "keygen", name]).ends(0).out.trim().to_owned();
    let (key, other) = (key("lab.key"), key("other.key"));
    let said = place.tauflow(&["cache", "keygen", "lab.key"]).ends(2);
    assert!(said.err.contains("lab.key") && said.err.contains("keys are never replaced"), "{}", said.err);
    // Neither file is written if one of them is there.
    fs::write(place.path("half.key.pub"), "mine").expect("writable");
    let said = place.tauflow(&["cache", "keygen", "half.key"]).ends(2);
    assert!(said.err.contains("half.key.pub") && !place.path("half.key").exists(), "{}", said.err);
    place.off("a", &["run", "small.yaml"]).ends(0);
    place.on("a", &["cache", "push"]).ends(0);
    let pinned = |machine: &str, key: &str| {
        let mut command = place.machine(machine, &["run", "small.yaml"]);
        crate::Said::of(&command.env("TAUFLOW_UPSTREAM_KEY", key).output().expect("the program starts")).ends(0).err
    };
    let said = pinned("b", &key);
    assert!(said.contains("has no signature of the key") && said.contains(&key), "{said}");
    let pack = indices(&place, "index").remove(0);
    assert!(said.contains(&pack.display().to_string()) && said.contains(" ran, "), "{said}");
    // A signature of another key would be in vain.
    place.on("a", &["cache", "keygen", "mine.key"]).ends(0);
    let refused = place.on("a", &["cache", "push", "--sign", "mine.key", "--upstream-key", &key]).ends(2);
    assert!(refused.err.contains("signs with another one"), "{}", refused.err);
    // What was pushed without a signature is signed by the next push.
    place.on("a", &["cache", "push", "--sign", "lab.key"]).ends(0);
    assert_eq!(indices(&place, "minisig").len(), 1);
    for (machine, key) in [("c", key.as_str()), ("d", "lab.key.pub")] {
        let said = pinned(machine, key);
        assert!(said.contains("nothing to do") && !said.contains("note: "), "{said}");
    }
    let said = pinned("e", &other);
    assert!(said.contains("has a signature that is not one of the key") && said.contains(&other), "{said}");
    assert!(said.contains(" ran, "), "{said}");
    let pulled = place.on("f", &["cache", "pull", "--upstream-key", &other]).ends(1);
    assert!(pulled.err.contains("note: ") && pulled.out.starts_with("pulled 0 records"), "{pulled:?}");
    // A signature that was changed.
    let signature = indices(&place, "minisig").remove(0);
    let text = fs::read_to_string(&signature).expect("readable");
    fs::write(&signature, text.replace("tauflow index", "tauflow indox")).expect("writable");
    assert!(pinned("g", &key).contains("has a signature that is not one of the key"));
    for (key, part) in [("nonsense", "begin with RW"), ("lab.key", "begin with RW")] {
        let said = place.on("h", &["run", "small.yaml", "--upstream-key", key]).ends(2);
        assert!(said.err.contains(part), "{}", said.err);
    }
    let said = place.on("a", &["cache", "push", "--sign", "lab.key.pub"]).ends(2);
    assert!(said.err.contains("cache keygen FILE"), "{}", said.err);
}

#[test]
fn results_for_an_upstream_that_is_pinned_to_a_key_are_signed_or_not_pushed() {
    let place = Place::new();
    let key = place.tauflow(&["cache", "keygen", "lab.key"]).ends(0).out.trim().to_owned();
    let pinned = ["run", "small.yaml", "--upstream-key", &key];
    for push in [&["cache", "push", "--upstream-key", &key][..], &[&pinned[..], &["--push"]].concat()] {
        let said = place.on("a", push).ends(2);
        assert!(said.err.contains("pinned to a key") && said.err.contains("--sign FILE"), "{}", said.err);
    }
    assert!(!place.path("a").exists(), "nothing has run");
    place.on("a", &[&pinned[..], &["--push", "--sign", "lab.key"]].concat()).ends(0);
    let said = place.on("b", &pinned).ends(0);
    assert!(said.err.contains("nothing to do") && !said.err.contains("note: "), "{}", said.err);
    // Jobs have no secret key.
    let folder = place.path("jobs").display().to_string();
    let apart = [&pinned[..], &crate::jobs::SHELL, &["--worker-cache", &folder]].concat();
    let said = place.on("c", &apart).ends(2);
    assert!(said.err.contains("jobs do not sign"), "{}", said.err);
}
