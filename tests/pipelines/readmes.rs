//! `pipelines/README.md` and `benches/README.md` name every file there is, and what the former shows of the language is
//! right.

use crate::support::root;
use std::{
    fs,
    path::{Path, PathBuf},
};
use tauflow::{
    pipeline::{self, Options, Pipeline},
    registry,
};

/// The files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("the folder can be read").map(|e| e.expect("and its entries").path());
    let (folders, mut found): (Vec<PathBuf>, Vec<PathBuf>) = entries.partition(|path| path.is_dir());
    found.extend(folders.iter().flat_map(|folder| files(folder)));
    found
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).expect("it is there")
}

#[test]
fn every_file_is_named() {
    for folder in ["pipelines", "benches"] {
        let page = read(&format!("{folder}/README.md"));
        for path in files(&root().join(folder)) {
            let name = path.strip_prefix(root().join(folder)).expect("it is below the folder");
            let name = name.to_str().expect("names in UTF-8").to_owned();
            // What Python leaves behind is no file of ours.
            if !name.ends_with("README.md") && !name.contains("__pycache__") {
                assert!(page.contains(&format!("]({name})")), "{folder}/README.md has no link to {name}");
            }
        }
        // And every link leads somewhere.
        for link in page.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next()) {
            let elsewhere = link.starts_with("https://");
            assert!(elsewhere || root().join(folder).join(link).exists(), "{folder}/README.md links to {link}");
        }
    }
}

fn resolve(text: &str, options: &Options) -> Pipeline {
    pipeline::resolve_text("README.yaml", text, &registry::registry(), options).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn the_example_is_right() {
    let page = read("pipelines/README.md");
    let yaml = page.split("```yaml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let rungs = |options: &Options| {
        let pipeline = resolve(yaml, options);
        let node = &pipeline.nodes[pipeline.node("ladders").expect("it is there")];
        let rungs = pipeline.cells[node.cells.start].params["rungs"].as_array().expect("a list").clone();
        rungs.last().expect("a rung").clone()
    };
    assert_eq!(rungs(&Options::default()), 64);
    assert_eq!(rungs(&Options { profile: Some("long".into()), ..Options::default() }), 256);
    assert_eq!(rungs(&Options { sets: vec!["values.last_rung=8".into()], ..Options::default() }), 8);
    let pipeline = resolve(yaml, &Options::default());
    let node = &pipeline.nodes[pipeline.node("refined").expect("it is there")];
    assert_eq!(node.cells.len(), 8);
}

#[test]
fn a_longer_ladder_is_an_edit_of_one_line() {
    let text = read("pipelines/quickstart.yaml");
    let longer = text.replace("\n  last_rung: 256\n", "\n  last_rung: 512\n");
    assert_ne!(text, longer, "the quickstart names its last rung");
    let (short, long) = (resolve(&text, &Options::default()), resolve(&longer, &Options::default()));
    let changed: Vec<&str> = short
        .cells
        .iter()
        .zip(&long.cells)
        .filter(|(a, b)| a.params != b.params)
        .map(|(a, _)| short.nodes[a.node].name.as_str())
        .collect();
    assert_eq!(changed, ["train_ladders", "test_ladders", "held_ladders", "timed_ladders"]);
    let ladder_of = |last: u64| serde_json::json!((0..=last.ilog2()).map(|i| 1u64 << i).collect::<Vec<_>>());
    let ladders = |pipeline: &Pipeline, last: u64| {
        pipeline.cells.iter().filter(|cell| cell.params.get("rungs") == Some(&ladder_of(last))).count()
    };
    assert_eq!((ladders(&short, 256), ladders(&short, 512)), (4, 0));
    assert_eq!((ladders(&long, 256), ladders(&long, 512)), (0, 4), "no ladder was forgotten");
}
