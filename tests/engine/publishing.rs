//! Files below the folder of results.

use crate::support::Workshop;
use std::{fs, path::PathBuf, time::SystemTime};
use tauflow::engine::RunOptions;

const PAGES: &str = "
pipeline: pages
nodes:
  numbers: {kind: numbers, params: {count: 3}}
  scaled: {kind: affine, matrix: {mul: [2, 3]}, inputs: {in: numbers}}
  total: {kind: total, inputs: {in: scaled}, params: {title: Sum}}
";

fn options(shop: &Workshop) -> RunOptions {
    RunOptions { jobs: 2, out: Some(shop.out()), ..RunOptions::default() }
}

fn files(shop: &Workshop) -> Vec<String> {
    fn walk(folder: PathBuf, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).expect("readable") {
            let path = entry.expect("readable").path();
            if path.is_dir() { walk(path, found) } else { found.push(path) }
        }
    }
    let mut found = Vec::new();
    walk(shop.out(), &mut found);
    let text = |p: &PathBuf| p.strip_prefix(shop.out()).expect("below").to_string_lossy().into_owned();
    let mut names: Vec<String> = found.iter().map(text).collect();
    names.sort();
    names
}

#[test]
fn targets_are_published_and_what_is_the_same_is_left_alone() {
    let shop = Workshop::new();
    let ran = shop.run_with(PAGES, &options(&shop), |_, _| {});
    assert_eq!(files(&shop), ["pages/page.txt", "pages/run.json"]);
    let page = shop.out().join("pages/page.txt");
    assert_eq!(ran.summary.published, std::slice::from_ref(&page));
    let text = "Sum: mul=2/n0000 + mul=2/n0001 + mul=2/n0002 + mul=3/n0000 + mul=3/n0001 + mul=3/n0002 = 150\n";
    assert_eq!(fs::read_to_string(&page).expect("written"), text);
    let old = SystemTime::UNIX_EPOCH;
    fs::File::options().write(true).open(&page).and_then(|f| f.set_modified(old)).expect("writable");
    shop.run_with(PAGES, &options(&shop), |_, _| {});
    let modified = || fs::metadata(&page).and_then(|m| m.modified()).expect("there");
    assert_eq!(modified(), old, "the same page is not written again");
    shop.run_with(&PAGES.replace("title: Sum", "title: All"), &options(&shop), |_, _| {});
    assert_ne!(modified(), old);
    assert!(fs::read_to_string(&page).expect("written").starts_with("All: "));
    // A page that was spoiled is mended.
    fs::write(&page, "spoiled").expect("writable");
    shop.run_with(PAGES, &options(&shop), |_, _| {});
    assert_eq!(fs::read_to_string(&page).expect("written"), text);
}

#[test]
fn nodes_and_cells_have_folders_of_their_own() {
    let shop = Workshop::new();
    let text = PAGES.replace(
        "total: {kind: total,",
        "all: {kind: total, inputs: {in: numbers}}\n  total: {kind: total, matrix: {mul: [2, 3]},",
    );
    let ran = shop.run_with(&text, &options(&shop), |_, _| {});
    assert!(ran.summary.failures.is_empty());
    let expected = ["pages/all/page.txt", "pages/run.json", "pages/total/mul=2/page.txt", "pages/total/mul=3/page.txt"];
    assert_eq!(files(&shop), expected);
}

#[test]
fn run_json_has_the_numbers_of_each_node() {
    let shop = Workshop::new();
    shop.run_with(PAGES, &options(&shop), |_, _| {});
    shop.run_with(&PAGES.replace("count: 3", "count: 4"), &options(&shop), |_, _| {});
    let text = fs::read_to_string(shop.out().join("pages/run.json")).expect("written");
    let run: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(run["pipeline"], "pages");
    assert_eq!(run["interrupted"], false);
    let scaled = run["nodes"].as_array().expect("a list").iter().find(|n| n["node"] == "scaled").expect("listed");
    assert_eq!((&scaled["ran"], &scaled["hit"], &scaled["failed"]), (&2.into(), &6.into(), &0.into()));
    let bytes = 2 * (2 + 2 + 2);
    assert_eq!(scaled["bytes"], bytes, "of all its items, those of earlier runs too; but 0 is passed on as it is");
    assert!(scaled["wall_s"].as_f64() >= scaled["spent_s"].as_f64() || scaled["spent_s"].is_number());
}

#[test]
fn run_json_stays_that_of_the_run_whose_files_are_there() {
    let shop = Workshop::new();
    let read = || fs::read_to_string(shop.out().join("pages/run.json")).expect("written");
    shop.run_with(PAGES, &options(&shop), |_, _| {});
    let first = read();
    // A part that publishes nothing, of other numbers.
    let part = PAGES.replace("count: 3", "count: 4").replace("\nnodes:", "\ntargets: [scaled]\nnodes:");
    assert!(shop.run_with(&part, &options(&shop), |_, _| {}).summary.published.is_empty());
    assert_eq!(read(), first);
    shop.run_with(&PAGES.replace("count: 3", "count: 4"), &options(&shop), |_, _| {});
    assert_ne!(read(), first);
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_with_its_path() {
    let shop = Workshop::new();
    fs::write(shop.path("file"), "in the way").expect("writable");
    let blocked = RunOptions { out: Some(shop.path("file")), ..RunOptions::default() };
    let error = shop.try_run(&crate::support::resolve(PAGES), &blocked, |_, _| {}).err().expect("it cannot be written");
    assert!(error.to_string().contains("cannot write") && error.to_string().contains("page.txt"), "{error}");
    // The work itself is kept.
    assert!(shop.run(PAGES).ran().is_empty());
}
