//! What is expected of a kind beside its code: a pinned digest, a row in the map of the code, a node under stress, and
//! a page. Whatever is missing is named, with the place where it goes.

use crate::root;
use std::{collections::BTreeSet, fs};
use tauflow::registry::registry;

/// Kinds whose outputs are not pinned, and why.
const NOT_PINNED: [(&str, &str); 17] = [
    ("assets", "what it makes depends on files from outside the project"),
    ("scene_files", "what it makes depends on files from outside the project"),
    ("command", "another program makes its outputs"),
    ("external_denoiser", "another program makes its images"),
    ("external_renderer", "another program makes its images"),
    ("pretrained_backbones", "what it makes depends on files from outside the project"),
    ("lpips_weights", "what it makes depends on files from outside the project"),
    ("lpips", "its weights are files from outside the project; the tests of its crate pin distances of made-up ones"),
    ("generative_training", "the tests of its crate pin what it makes of made-up scenes"),
    ("transport_adapter", "the tests of its crate pin what it makes of made-up scenes"),
    ("generation", "the tests of its crate pin what it makes of made-up scenes"),
    ("time_error", "its figures are times"),
    ("image_quality", "the tests of its crate pin the scores of samples that are made in memory"),
    ("no_reference_scores", "models and programs that are not ours make its scores"),
    ("adapter_report", "the tests of its crate check the page of samples that are made in memory"),
    ("denoising", "models/README.md pins the bits of the bundled models, which a test of its crate compares"),
    ("model_rounding", "the bundled models are its outputs, and models/README.md pins them"),
];

/// Kinds that `pipelines/stress.yaml` leaves out, and why.
const NOT_STRESSED: [(&str, &str); 14] = [
    ("assets", "its hazards are damaged files, which the tests of its crate feed it"),
    ("scene_files", "its hazards are damaged files, which the tests of its crate feed it"),
    ("pretrained_backbones", "its hazards are damaged checkpoints, which the tests of its crate feed it"),
    ("lpips_weights", "its hazards are damaged weights, which the tests of its crate feed it"),
    ("lpips", "the tests of its crate feed it weights that overflow and values that are no numbers"),
    ("contact_sheet", "it shows pixels that other kinds made, and no number comes of them"),
    ("command", "it calls programs that are not ours"),
    ("external_denoiser", "it calls programs that are not ours"),
    ("external_renderer", "it calls programs that are not ours"),
    ("image_quality", "its samples are clipped to display values, and the tests of its crate feed it flat ones"),
    ("no_reference_scores", "it calls models and programs that are not ours"),
    ("adapter_report", "it shows scores that other kinds made, and no number comes of them"),
    ("denoising", "the tests of its crate feed it fireflies, damaged pixels, extreme exposures and odd sizes"),
    ("model_rounding", "weights that are too large for half precision are refused, which a test of tensors holds"),
];

/// The texts in which a kind must be named.
struct Places {
    architecture: String,
    digests: String,
    stress: String,
    pages: BTreeSet<String>,
}

impl Places {
    fn read() -> Self {
        let read = |name: &str| fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let pages = fs::read_dir(root().join("docs/kinds")).expect("the folder is there");
        Self {
            architecture: read("docs/ARCHITECTURE.md"),
            digests: read("tests/pipelines/digests.txt"),
            stress: read("pipelines/stress.yaml"),
            pages: pages.map(|page| page.expect("listed").file_name().to_string_lossy().into_owned()).collect(),
        }
    }

    fn is_pinned(&self, kind: &str) -> bool {
        self.digests.lines().any(|line| line.split(' ').next() == Some(kind))
    }

    fn is_stressed(&self, kind: &str) -> bool {
        let named = |line: &str| line.split_once("kind: ").is_some_and(|(_, rest)| first_word(rest) == kind);
        self.stress.lines().any(named)
    }

    fn is_mapped(&self, kind: &str) -> bool {
        self.architecture.lines().any(|line| line.starts_with('|') && line.contains(&format!("`{kind}`")))
    }

    /// What is missing of a kind, a line each; `excused` says whether a list has it.
    fn missing(&self, kind: &str, excused: impl Fn(&[(&str, &str)]) -> bool) -> Vec<String> {
        let mut missing = Vec::new();
        if !self.is_pinned(kind) && !excused(&NOT_PINNED) {
            missing.push(format!(
                "`{kind}` has no pinned digest: put a node of it into the pipeline of tests/pipelines/digests.rs, its \
                 ports into the list there, and what the test then prints into tests/pipelines/digests.txt"
            ));
        }
        if !self.is_mapped(kind) {
            missing.push(format!(
                "no row of the code map in docs/ARCHITECTURE.md names `{kind}`: write it into the row of its crate"
            ));
        }
        if !self.is_stressed(kind) && !excused(&NOT_STRESSED) {
            missing
                .push(format!("pipelines/stress.yaml has no node of `{kind}`: add one, fed with what might break it"));
        }
        if !self.pages.contains(&format!("{kind}.md")) {
            missing.push(format!(
                "docs/kinds/{kind}.md is not there: write it by `cargo run --release -- kinds --markdown docs/kinds`"
            ));
        }
        missing
    }
}

fn first_word(text: &str) -> &str {
    text.split([' ', ',', '}', '#']).next().unwrap_or_default()
}

fn has(list: &[(&str, &str)], kind: &str) -> bool {
    list.iter().any(|(name, _)| *name == kind)
}

#[test]
fn every_kind_has_its_places() {
    let (places, registry) = (Places::read(), registry());
    let mut wrong: Vec<String> =
        registry.names().flat_map(|kind| places.missing(kind, |list| has(list, kind))).collect();
    for (kind, reason) in NOT_PINNED.iter().chain(&NOT_STRESSED) {
        assert!(!reason.is_empty(), "{kind}");
        if registry.get(kind).is_none() {
            wrong.push(format!("`{kind}` is excused in tests/cli/places_of_kinds.rs, and there is no such kind"));
        }
    }
    let pinned = NOT_PINNED.iter().filter(|(kind, _)| places.is_pinned(kind));
    let stressed = NOT_STRESSED.iter().filter(|(kind, _)| places.is_stressed(kind));
    for (kind, _) in pinned.chain(stressed) {
        wrong.push(format!("`{kind}` is excused in tests/cli/places_of_kinds.rs, and needs no excuse: take it out"));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn what_is_missing_of_a_kind_is_named() {
    let places = Places::read();
    // The guide's example is in none of the places.
    let missing = places.missing("image_gamma", |list| has(list, "image_gamma")).join("\n");
    for place in
        ["tests/pipelines/digests.txt", "docs/ARCHITECTURE.md", "pipelines/stress.yaml", "docs/kinds/image_gamma.md"]
    {
        assert_eq!(missing.matches(place).count(), 1, "{place}: {missing}");
    }
    assert_eq!(missing.lines().count(), 4, "{missing}");
    // A name is not taken for another that begins with it.
    assert!(places.is_stressed("ladder_rendering") && !places.is_stressed("ladder"));
    assert!(places.is_pinned("training") && !places.is_pinned("train") && !places.is_mapped("train"));
    let excused = places.missing("image_gamma", |_| true);
    assert_eq!(excused.len(), 2, "a pin and stress can be excused, the pages cannot: {excused:?}");
}
