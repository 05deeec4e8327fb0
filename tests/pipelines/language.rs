//! Every example of `docs/pipelines.md` is a valid pipeline, every command of it resolves, and its limits are checked.

use crate::support::root;
use std::{collections::BTreeSet, fs, path::Path};
use tauflow::{
    pipeline::{self, Options, Pipeline},
    registry,
};

/// The fenced blocks of a language.
fn blocks<'a>(page: &'a str, language: &str) -> Vec<&'a str> {
    let fence = format!("```{language}\n");
    page.split(fence.as_str()).skip(1).map(|rest| rest.split("```").next().unwrap_or_default()).collect()
}

/// Writes each example to the file that its first line names.
fn write_examples(page: &str, folder: &Path) -> BTreeSet<String> {
    let examples = blocks(page, "yaml");
    let mut names = BTreeSet::new();
    for text in examples {
        let name =
            text.lines().next().and_then(|line| line.strip_prefix("# file: ")).expect("an example names its file");
        fs::write(folder.join(name), text).expect("the folder can be written");
        assert!(names.insert(name.to_owned()), "two examples are named {name}");
    }
    names
}

fn resolve(file: &Path, options: &Options) -> Pipeline {
    pipeline::resolve(file, &registry::registry(), options).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

/// The cells of a node.
fn cells(pipeline: &Pipeline, node: &str) -> usize {
    pipeline.nodes[pipeline.node(node).expect("the node")].cells.len()
}

#[test]
fn the_examples_of_the_language_are_right() {
    let page = fs::read_to_string(root().join("docs/pipelines.md")).expect("the page");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let names = write_examples(&page, folder.path());
    assert!(names.len() >= 9, "{names:?}");
    for name in &names {
        resolve(&folder.path().join(name), &Options::default());
    }
    // Claims of the page about its examples.
    let at = |name: &str| resolve(&folder.path().join(name), &Options::default());
    let matrix = at("matrix.yaml");
    assert_eq!((cells(&matrix, "solvers"), cells(&matrix, "refined")), (4, 8));
    let joins = at("joins.yaml");
    assert_eq!((cells(&joins, "scores"), cells(&joins, "table")), (2, 1));
    let table = &joins.cells[joins.nodes[joins.node("table").expect("the table")].cells.start];
    let prefixes: Vec<_> = table.inputs.iter().flatten().map(|of| of.prefix.as_deref()).collect();
    assert_eq!(prefixes, [Some("sampler=independent"), Some("sampler=sobol")]);
    let selected = at("selectors.yaml");
    let best = &selected.cells[selected.nodes[selected.node("best").expect("the node")].cells.start];
    assert!(best.inputs.iter().flatten().all(|of| of.prefix.is_none()), "a selected axis is not part of keys");
    let transient = at("transient.yaml");
    assert!(transient.nodes[transient.node("measured").expect("the node")].transient);
    let targets = at("targets.yaml");
    assert_eq!(targets.targets.len(), 1);
}

#[test]
fn the_commands_of_the_language_are_right() {
    let page = fs::read_to_string(root().join("docs/pipelines.md")).expect("the page");
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_examples(&page, folder.path());
    let mut commands = 0;
    for line in blocks(&page, "sh").into_iter().flat_map(str::lines) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let ["tauflow", "check" | "plan", file, rest @ ..] = words.as_slice() else { panic!("not checked: {line}") };
        let mut options = Options::default();
        for pair in rest.chunks(2) {
            match pair {
                ["--set", set] => options.sets.push((*set).to_owned()),
                ["--profile", name] => options.profile = Some((*name).to_owned()),
                ["--target", name] => options.targets.push((*name).to_owned()),
                _ => panic!("not checked: {line}"),
            }
        }
        let changed = resolve(&folder.path().join(file), &options);
        let before = resolve(&folder.path().join(file), &Options::default());
        let differs = changed.seed != before.seed
            || changed.targets.len() != before.targets.len()
            || changed.targets.iter().zip(&before.targets).any(|(a, b)| (a.node, a.port) != (b.node, b.port))
            || changed.cells.iter().zip(&before.cells).any(|(a, b)| a.params != b.params);
        assert_eq!(differs, !rest.is_empty(), "{line} changes nothing");
        commands += 1;
    }
    assert!(commands >= 6, "{commands} commands");
}
