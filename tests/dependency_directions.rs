//! Holds the directions `cache <- contract <- data <- each kind's crate <- root`, so that a change in the renderer
//! never rebuilds burn, nor the reverse; that burn stays below `nodes/train`, and that `cargo test` at the root skips
//! no crate.
//! `cache/upstream` stands beside `contract`, and only the root uses it. It alone names crates that speak to the net.
//! `nodes/instructions` stands beside `cache`, below all that ask it; `testing` is below all, for tests alone.

use serde_json::Value;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// A member of the workspace.
#[derive(Clone, Debug)]
struct Member {
    /// Its folder, from the root; empty for the root.
    folder: String,
    /// Names of all it depends on: for building, testing and build scripts.
    needs: BTreeSet<String>,
    /// Those of them that are for building.
    builds: BTreeSet<String>,
}

type Members = BTreeMap<String, Member>;

/// Where the crates of kinds stand.
const KINDS: u32 = 4;

/// Where a crate stands; it may depend on lower ones only.
fn layer(folder: &str) -> u32 {
    match folder {
        "" => 5,
        "testing" => 0,
        "cache" | "nodes/instructions" => 1,
        "nodes/contract" | "cache/upstream" => 2,
        "nodes/data" => 3,
        _ => KINDS,
    }
}

/// The first folder below `nodes`: crates of one family, such as `nodes/train/ops`, may use each other.
fn family(folder: &str) -> Option<&str> {
    folder.strip_prefix("nodes/")?.split('/').next()
}

/// Crates that speak to the net, or that such crates need.
const NET: [&str; 10] = ["curl", "http", "hyper", "object_store", "reqwest", "ring", "rustls", "tokio", "ureq", "url"];

/// What breaks the rules, a line each.
fn violations(members: &Members) -> Vec<String> {
    let mut found = Vec::new();
    for (name, member) in members {
        for need in &member.needs {
            if need.starts_with("burn") && family(&member.folder) != Some("train") {
                found.push(format!("{name} names {need}; only crates under nodes/train may"));
            }
            if NET.contains(&need.as_str()) && member.folder != "cache/upstream" {
                found.push(format!("{name} names {need}; only cache/upstream may speak to the net"));
            }
            let Some(other) = members.get(need) else { continue };
            if other.folder == "testing" && member.builds.contains(need) {
                found.push(format!("{name} names {need} to build; only tests may"));
            }
            let below = layer(&other.folder) < layer(&member.folder);
            let kin = family(&member.folder).is_some() && family(&member.folder) == family(&other.folder);
            if !below && !kin {
                found.push(format!("{name} ({}) must not depend on {need} ({})", member.folder, other.folder));
            }
        }
    }
    found
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn metadata() -> Value {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(root())
        .output()
        .expect("cargo runs this test, so it can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON")
}

fn members(metadata: &Value) -> Members {
    let packages = metadata["packages"].as_array().expect("packages");
    let text = |value: &Value| value.as_str().expect("a text").to_owned();
    let root = text(&metadata["workspace_root"]);
    let member = |package: &Value| {
        let manifest = text(&package["manifest_path"]);
        let folder = Path::new(&manifest).parent().expect("a manifest lies in a folder");
        let folder = folder.strip_prefix(&root).expect("members lie below the root").display().to_string();
        let needs = package["dependencies"].as_array().expect("dependencies");
        let builds = needs.iter().filter(|d| d["kind"] != "dev").map(|d| text(&d["name"])).collect();
        (text(&package["name"]), Member { folder, needs: needs.iter().map(|d| text(&d["name"])).collect(), builds })
    };
    packages.iter().map(member).collect()
}

#[test]
fn dependencies_point_one_way() {
    let members = members(&metadata());
    for folder in [
        "",
        "cache",
        "cache/upstream",
        "nodes/contract",
        "nodes/data",
        "nodes/scene",
        "nodes/scene/library",
        "nodes/scene/readers",
        "nodes/render",
        "nodes/eval",
    ] {
        assert!(members.values().any(|m| m.folder == folder), "no crate in `{folder}`: {members:#?}");
    }
    assert_eq!(violations(&members), [""; 0]);
}

#[test]
fn planted_violations_are_found() {
    let member = |folder: &str, needs: &[&str]| Member {
        folder: folder.into(),
        needs: needs.iter().map(|n| (*n).to_owned()).collect(),
        builds: BTreeSet::new(),
    };
    let sound = BTreeMap::from([
        ("tauflow".to_owned(), member("", &["tauflow-render", "tauflow-train", "clap"])),
        ("tauflow-testing".to_owned(), member("testing", &[])),
        ("tauflow-cache".to_owned(), member("cache", &["blake3", "tauflow-testing"])),
        ("tauflow-upstream".to_owned(), member("cache/upstream", &["tauflow-cache", "object_store", "ureq"])),
        ("tauflow-data".to_owned(), member("nodes/data", &["tauflow-cache"])),
        ("tauflow-instructions".to_owned(), member("nodes/instructions", &[])),
        ("tauflow-render".to_owned(), member("nodes/render", &["tauflow-data", "tauflow-instructions"])),
        ("tauflow-train".to_owned(), member("nodes/train", &["tauflow-train-ops", "burn"])),
        ("tauflow-train-ops".to_owned(), member("nodes/train/ops", &["burn-core", "tauflow-instructions"])),
    ]);
    assert_eq!(violations(&sound), [""; 0]);
    for (name, need) in [
        ("tauflow-cache", "tauflow-data"),
        ("tauflow-data", "tauflow-render"),
        ("tauflow-render", "tauflow-train"),
        ("tauflow-train-ops", "tauflow-render"),
        ("tauflow-instructions", "tauflow-data"),
        ("tauflow-render", "tauflow"),
        ("tauflow-render", "burn-tensor"),
        ("tauflow", "burn"),
        ("tauflow", "ureq"),
        ("tauflow-cache", "object_store"),
    ] {
        let mut broken = sound.clone();
        broken.get_mut(name).expect("it is in the list").needs.insert(need.to_owned());
        let found = violations(&broken);
        assert!(found.len() == 1 && found[0].contains(name) && found[0].contains(need), "{name} -> {need}: {found:?}");
    }
    let mut broken = sound.clone();
    broken.get_mut("tauflow-cache").expect("it is in the list").builds.insert("tauflow-testing".to_owned());
    assert_eq!(violations(&broken), ["tauflow-cache names tauflow-testing to build; only tests may"]);
}

#[test]
fn cargo_test_at_the_root_skips_no_member() {
    let metadata = metadata();
    let list = |name: &str| -> BTreeSet<String> {
        let ids = metadata[name].as_array().expect("a list of members");
        ids.iter().map(|id| id.as_str().expect("a text").to_owned()).collect()
    };
    assert_eq!(list("workspace_default_members"), list("workspace_members"), "default-members must list every member");
}

/// The Rust files of a folder and of all folders below it: path from the root, and text.
fn sources_below(folder: &str) -> BTreeMap<String, String> {
    let (mut folders, mut found) = (vec![root().join(folder)], BTreeMap::new());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("src can be read").map(|e| e.expect("src can be read").path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else if entry.extension().is_some_and(|e| e == "rs") {
                let path = entry.strip_prefix(root()).expect("below the root").display().to_string();
                found.insert(path, fs::read_to_string(&entry).expect("a source file"));
            }
        }
    }
    found
}

/// The code of a file, without comments and without its unit tests, which stand at its end.
fn code_of(text: &str) -> String {
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    code.lines().map(str::trim).filter(|line| !line.starts_with("//")).collect::<Vec<_>>().join("\n")
}

#[test]
fn one_file_names_the_kinds_crates() {
    let members = members(&metadata());
    // The viewer has no kind: it makes pages of images for a command.
    let has_kinds = |name: &str, folder: &str| layer(folder) == KINDS && name != "tauflow-viewer";
    let crates: Vec<String> =
        members.iter().filter(|(name, m)| has_kinds(name, &m.folder)).map(|(name, _)| name.replace('-', "_")).collect();
    let mut naming = BTreeSet::new();
    for (path, text) in sources_below("src") {
        if crates.iter().any(|name| text.contains(name.as_str())) {
            naming.insert(path);
        }
    }
    assert_eq!(naming, BTreeSet::from(["src/registry.rs".to_owned()]));
}

/// What code names that reads or writes a store or files, or runs a kind's code; one line for each.
fn deeds(path: &str, text: &str) -> Vec<String> {
    let code = code_of(text);
    let words: BTreeSet<&str> = code.split(|c: char| !(c.is_alphanumeric() || c == '_')).collect();
    let names =
        ["Store", "StoreBlobs", "Holdings", "Catalog", "Pool", "fs", "File", "look_up", "lookup", "lookup_many"];
    let named = names.into_iter().chain(["probe", "sighted", "projection"]).filter(|name| words.contains(name));
    let calls = ["kind.items(", "kind.run(", "kind.seed(", "execute(", "rollup::", ".load(store", "Sharded::get"];
    let called = calls.into_iter().filter(|call| code.contains(call));
    named.chain(called).map(|what| format!("{path}: `{what}`")).collect()
}

/// The scheduler and the loop that drives it decide and do nothing: they send requests for what they need of the store,
/// of files and of kinds.
#[test]
fn the_scheduler_and_the_loop_of_a_run_import_no_store_and_run_no_kind() {
    let mut files = sources_below("src/engine/scheduler");
    assert!(files.len() > 5, "the scheduler has moved");
    for path in ["src/engine/scheduler.rs", "src/engine/steering.rs", "src/engine/rolled.rs", "src/engine/keys.rs"] {
        files.insert(path.to_owned(), fs::read_to_string(root().join(path)).expect("a source file"));
    }
    assert!(files["src/engine/steering.rs"].contains("scheduler.next_request()"), "the loop has moved");
    let found: Vec<String> = files.iter().flat_map(|(path, text)| deeds(path, text)).collect();
    assert_eq!(found, [""; 0], "send a request instead");
    // The rest of a run begins passes and ends them. It looks nothing up.
    let run = code_of(&fs::read_to_string(root().join("src/engine/run.rs")).expect("a source file"));
    for call in ["lookup", "rollup::find", "store.get(", "Sharded::get", "next_request("] {
        assert!(!run.contains(call), "src/engine/run.rs: `{call}`; send a request instead");
    }
}

#[test]
fn a_deed_is_found_in_code_and_not_in_comments_or_tests() {
    let found = deeds("a.rs", "use tauflow_cache::{Key, Store};\nlet items = kind.items(&params);\n");
    assert_eq!(found, ["a.rs: `Store`", "a.rs: `kind.items(`"]);
    assert_eq!(deeds("a.rs", "// A Store.\nuse tauflow_cache::Key;\n#[cfg(test)]\nuse tauflow_cache::Store;"), [""; 0]);
}

/// Rust code in a doc comment that begins a fence: the line of each.
fn doc_tests(text: &str) -> Vec<usize> {
    let (mut found, mut open) = (Vec::new(), false);
    for (i, line) in text.lines().enumerate() {
        let comment = line.trim_start().strip_prefix("//!").or_else(|| line.trim_start().strip_prefix("///"));
        let Some(language) = comment.and_then(|comment| comment.trim_start().strip_prefix("```")) else { continue };
        // Without a language it is Rust.
        if !open && ["", "rust", "should_panic", "no_run"].contains(&language.trim()) {
            found.push(i + 1);
        }
        open = !open;
    }
    found
}

/// `doctest = false` spares a pass of rustdoc over each crate; code that it would have to run has a test instead.
#[test]
fn no_doc_comment_has_code_that_nothing_runs() {
    assert_eq!(doc_tests("/// ```text\n/// ```\n/// ```\n/// f();\n/// ```\n//! ```rust\n"), [3, 6]);
    let files = Command::new("git").args(["ls-files", "*.rs"]).current_dir(root()).output().expect("git starts");
    let files = String::from_utf8_lossy(&files.stdout).into_owned();
    let found: Vec<String> = files
        .lines()
        .filter_map(|file| Some((file, fs::read_to_string(root().join(file)).ok()?)))
        .flat_map(|(file, text)| doc_tests(&text).into_iter().map(move |line| format!("{file}:{line}")))
        .collect();
    assert!(files.lines().count() > 300, "{files}");
    assert_eq!(found, [""; 0]);
}

/// A module `a` with modules of its own stands in `a.rs`, and they below `a/`. Test programs and examples share helpers
/// as `mod.rs`, because a file beside them would be a program.
#[test]
fn modules_stand_beside_their_folders() {
    let files = Command::new("git").args(["ls-files", "*mod.rs"]).current_dir(root()).output().expect("git starts");
    let files = String::from_utf8_lossy(&files.stdout).into_owned();
    let other = |file: &&str| {
        let parts: Vec<&str> = file.split('/').collect();
        parts.last() == Some(&"mod.rs") && !parts.iter().any(|part| ["tests", "examples"].contains(part))
    };
    assert!(files.lines().any(|file| file == "tests/support/mod.rs"), "{files}");
    assert_eq!(files.lines().filter(other).collect::<Vec<_>>(), [""; 0]);
}

/// Each package of the graph with the features that are on.
fn features(more: &[&str]) -> BTreeSet<String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["tree", "--offline", "--prefix", "none", "--no-dedupe", "--format", "{p} {f}"])
        .args(more)
        .current_dir(root())
        .output()
        .expect("cargo runs this test, so it can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect()
}

#[test]
fn running_and_testing_share_one_build_of_burn() {
    let running = features(&["--package", "tauflow", "--edges", "normal,build"]);
    let testing = features(&["--workspace", "--edges", "normal,build,dev"]);
    assert!(running.iter().any(|line| line.starts_with("burn-flex ")));
    assert!(testing.iter().all(|line| !line.starts_with("wgpu ")), "only the feature `gpu` brings it");
    let differ: Vec<&String> = running.difference(&testing).collect();
    assert!(
        differ.is_empty(),
        "built twice, with these features to run and others to test: {differ:?}; ask for the union in \
         nodes/train/tensors/Cargo.toml"
    );
}
