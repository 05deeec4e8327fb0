//! The kinds' manuals: their YAML is right, and the pages in `docs/kinds` are what the kinds say.

use crate::{Place, root};
use std::{collections::BTreeMap, fs, path::Path};
use tauflow::{
    pipeline::{Options, resolve_text},
    registry::registry,
};

/// The texts of a Markdown text's YAML blocks.
fn snippets(markdown: &str) -> Vec<&str> {
    let blocks = markdown.split("```yaml\n").skip(1);
    blocks.map(|block| block.split("```").next().unwrap_or_default()).collect()
}

#[test]
fn the_yaml_of_every_manual_checks() {
    let registry = registry();
    let mut wrong = Vec::new();
    for kind in registry.iter() {
        let spec = kind.spec();
        let found = snippets(spec.manual);
        if !found.iter().any(|text| text.contains(&format!("kind: {}", spec.name))) {
            wrong.push(format!("the manual of `{}` shows no node of it", spec.name));
        }
        for text in found {
            let indented: Vec<String> = text.lines().map(|line| format!("  {line}")).collect();
            let pipeline = format!("pipeline: manual\nnodes:\n{}\n", indented.join("\n"));
            let Err(mut problems) = resolve_text(spec.name, &pipeline, &registry, &Options::default()) else {
                continue;
            };
            // A snippet shows one node; those that it reads stand elsewhere.
            problems.list.retain(|problem| !problem.message.starts_with("unknown node `"));
            if !problems.list.is_empty() {
                wrong.push(problems.to_string());
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn pages(folder: &Path) -> BTreeMap<String, String> {
    let Ok(entries) = fs::read_dir(folder) else { return BTreeMap::new() };
    entries
        .map(|entry| entry.expect("the folder can be read").path())
        .filter(|path| path.extension().is_some_and(|e| e == "md"))
        .map(|path| {
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            (name, fs::read_to_string(&path).expect("a page"))
        })
        .collect()
}

#[test]
fn the_pages_of_the_kinds_are_up_to_date() {
    let place = Place::new();
    place.tauflow(&["kinds", "--markdown", "pages"]).ends(0);
    let (made, kept) = (pages(&place.path("pages")), pages(&root().join("docs/kinds")));
    assert_eq!(made.len(), registry().iter().count());
    let differ: Vec<&String> = made.iter().filter(|(name, text)| kept.get(*name) != Some(*text)).map(|p| p.0).collect();
    let stale: Vec<&String> = kept.keys().filter(|name| !made.contains_key(*name)).collect();
    assert!(
        differ.is_empty() && stale.is_empty(),
        "docs/kinds is not what the kinds say (differ: {differ:?}; of no kind: {stale:?}); write it again by \
         `cargo run --release -- kinds --markdown docs/kinds`, and delete what is of no kind"
    );
}
