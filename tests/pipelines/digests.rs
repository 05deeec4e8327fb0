//! Holds the bits of what each kind makes of a tiny pipeline, beside the kind's version: who changes outputs raises the
//! version, or results of before are taken for results of now. They hold on any x86-64 machine. Training is not among
//! them: its matrix products use what instructions the processor has.

use crate::{edits::PIPELINE, support::Done};
use std::fmt::Write as _;

const PINNED: &str = include_str!("digests.txt");

#[test]
fn outputs_change_with_versions_alone() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("tiny.yaml");
    std::fs::write(&file, PIPELINE).expect("written");
    let done = Done::run(&file, Vec::new(), folder.path());
    let mut found = String::new();
    for port in [
        "scenes.scenes",
        "previews.ladder",
        "gate.accepted",
        "gate.exposure",
        "gate.verdicts",
        "split.train",
        "split.test",
        "split.report",
        "sampling.train",
        "sampling.test",
        "sampling.report",
        "train_ladders.ladder",
        "train_set.packed",
        "hold.metrics",
    ] {
        let (kind, version) = done.kind(port);
        let _ = writeln!(found, "{kind} {version} {port} {}", done.collection(port).digest());
    }
    assert!(
        found == PINNED,
        "outputs differ from tests/pipelines/digests.txt. If that is meant, raise `version` of each kind whose lines differ \
         (of those that only read other inputs, not), and put this there:\n{found}"
    );
}
