//! Writes published outputs as files below `OUT/<pipeline>/`, together with `run.json`.

use super::{EngineError, Summary, sharded::Sharded};
use serde_json::{Map, Value, json};
use std::{
    collections::BTreeMap,
    fs,
    ops::Bound,
    path::{Path, PathBuf},
    sync::Arc,
};
use tauflow_cache::{Digest, Store};

/// The target of publishing: a folder below the pipeline's, and the collection to write there.
pub struct Publication {
    /// Folder below `OUT/<pipeline>/`; empty for the only publishing node.
    pub folder: String,
    /// The node, with its cell, for people.
    pub name: String,
    /// The artifacts.
    pub collection: Arc<Sharded>,
}

/// The files of a run, each with what it is of: none is written twice.
pub struct Taken(BTreeMap<PathBuf, String>);

impl Taken {
    /// None but the run's own account of itself, and its page.
    pub fn new(out: &Path) -> Self {
        let own = |name, what: &str| (out.join(name), what.to_owned());
        Self(BTreeMap::from([own(SUMMARY, "the account of the run"), own(PAGE, "the page of the run")]))
    }

    /// Takes a file for `whose`.
    ///
    /// # Errors
    /// If something else has it, or a file where it needs a folder, or files below it.
    fn take(&mut self, path: &Path, whose: &str) -> Result<(), EngineError> {
        let before = path.ancestors().find_map(|above| self.0.get(above));
        let below = || {
            let next = self.0.range::<Path, _>((Bound::Excluded(path), Bound::Unbounded)).next();
            next.filter(|(other, _)| other.starts_with(path)).map(|(_, whose)| whose)
        };
        if let Some(other) = before.or_else(below) {
            return Err(EngineError::Request(format!(
                "{other} and {whose} would be written to the same file {}; rename a key or part, or publish them in \
                separate pipelines",
                path.display()
            )));
        }
        self.0.insert(path.to_owned(), whose.to_owned());
        Ok(())
    }
}

/// The run's account of itself.
const SUMMARY: &str = "run.json";
/// Where a published page asks for a line on the run that wrote it. A result must not depend on when or where it is
/// made, so the line is in the published copy alone.
const ACCOUNT: &str = "<!--tauflow:run-->";
/// The end of that line.
const ACCOUNT_END: &str = "<!--/tauflow:run-->";
/// The run's page.
pub const PAGE: &str = "index.html";

/// Writes what differs from what is there, each file at once; returns all files, and the blobs that are missing.
///
/// # Errors
/// If the folder cannot be written, or two artifacts meet in one file; of these files none is written then.
pub fn publish(
    store: &Store,
    out: &Path,
    publication: &Publication,
    taken: &mut Taken,
    account: Option<&str>,
) -> Result<(Vec<PathBuf>, Vec<Digest>), EngineError> {
    let (mut written, mut missing) = (Vec::new(), Vec::new());
    let many = publication.collection.len() > 1;
    let items = match publication.collection.items(store)? {
        Ok(items) => items,
        Err(blob) => return Ok((written, vec![blob])),
    };
    let mut files: Vec<(PathBuf, Digest)> = Vec::new();
    for (key, output) in items {
        // Names become paths here: those of a store were checked as they were read, and those of a kind are now.
        output.artifact.check_names().map_err(|error| EngineError::Request(format!("`{key}`: {error}")))?;
        let mut folder = out.join(&publication.folder);
        if many {
            folder.push(key.as_str());
        }
        for (part, digest) in output.artifact.parts.iter() {
            let path = folder.join(if part.is_empty() { "value" } else { part });
            taken.take(&path, &format!("`{part}` of `{key}` of `{}`", publication.name))?;
            files.push((path, *digest));
        }
    }
    for (path, digest) in files {
        match store.get(&digest)? {
            Some(bytes) => {
                match account.and_then(|account| told(&path, &bytes, account)) {
                    // The page as it is tells of the run that wrote it.
                    Some(_) if plain(&path).is_some_and(|old| old.as_bytes() == &bytes[..]) => {}
                    Some(told) => write(&path, told.as_bytes())?,
                    None => write(&path, &bytes)?,
                }
                written.push(path);
            }
            None => missing.push(digest),
        }
    }
    Ok((written, missing))
}

/// A page that asks for it, with a line on the run.
fn told(path: &Path, bytes: &[u8], account: &str) -> Option<String> {
    path.extension().filter(|extension| *extension == "html")?;
    let (before, after) = std::str::from_utf8(bytes).ok()?.split_once(ACCOUNT)?;
    Some(format!("{before}{ACCOUNT}{account}{ACCOUNT_END}{after}"))
}

/// A published page without its line on the run that wrote it; none if it has no such line.
fn plain(path: &Path) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    let (before, rest) = text.split_once(ACCOUNT)?;
    let (_, after) = rest.split_once(ACCOUNT_END)?;
    Some(format!("{before}{ACCOUNT}{after}"))
}

/// Writes a file at once, unless it holds these bytes already.
///
/// # Errors
/// If it cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), EngineError> {
    if fs::metadata(path).is_ok_and(|m| m.len() == bytes.len() as u64) && fs::read(path).is_ok_and(|old| old == bytes) {
        return Ok(());
    }
    let io = |source| EngineError::Write { path: path.to_path_buf(), source };
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(io)?;
    let mut name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    // Names have at most 255 bytes, of which the temporary one needs some more.
    if name.len() > 200 {
        name = Digest::of(name.as_bytes()).short();
    }
    let temporary = folder.join(format!(".{name}.{}.tmp", std::process::id()));
    fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path)).map_err(|source| {
        // The temporary file is of no use to anybody.
        let _ = fs::remove_file(&temporary);
        io(source)
    })
}

/// Writes `run.json`: what the run did, by node, and the name of the run. A run that did nothing keeps the account of
/// the run that did the work. One that published nothing, and did not fail, keeps that of the run whose files are
/// there.
///
/// # Errors
/// If it cannot be written.
pub fn write_summary(out: &Path, pipeline: &str, run: Option<&str>, summary: &Summary) -> Result<(), EngineError> {
    let idle = summary.is_whole() && summary.nodes.iter().all(|node| node.ran == 0);
    let before = fs::read(out.join(SUMMARY)).ok();
    let before = before.and_then(|bytes| serde_json::from_slice::<Map<String, Value>>(&bytes).ok());
    let published =
        |of: &Map<String, Value>| of.get("published").and_then(Value::as_u64).is_some_and(|files| files > 0);
    if summary.is_whole() && summary.published.is_empty() && before.as_ref().is_some_and(published) {
        return Ok(());
    }
    if let Some(mut before) = before.filter(|_| idle) {
        if run.is_none() || before.get("run").and_then(Value::as_str) == run {
            return Ok(());
        }
        before.insert("run".into(), json!(run));
        return write_pretty(&out.join(SUMMARY), &Value::Object(before));
    }
    let value = json!({
        "run": run,
        "pipeline": pipeline,
        "elapsed_s": summary.elapsed.as_secs_f64(),
        "interrupted": summary.interrupted,
        "published": summary.published.len(),
        "nodes": summary.nodes,
        "slowest": summary.slowest,
        "failures": summary.failures,
        "elsewhere": summary.elsewhere,
    });
    write_pretty(&out.join(SUMMARY), &value)
}

fn write_pretty(path: &Path, value: &Value) -> Result<(), EngineError> {
    let mut text = serde_json::to_vec_pretty(value).expect("plain data");
    text.push(b'\n');
    write(path, &text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::output::Output;
    use tauflow_contract::{Artifact, ItemKey};

    #[test]
    fn files_that_meet_are_told_and_not_written() {
        let dir = tempfile::tempdir().expect("a folder");
        let store = Store::open(&dir.path().join("cache")).expect("a store");
        let (one, two) = (store.put(b"one").expect("room"), store.put(b"two").expect("room"));
        let item = |key: &str, part: &str, digest: Digest| {
            let artifact = Artifact::tree("tauflow/files", [(part.to_owned(), digest)]);
            (ItemKey::new(key).expect("a key"), Output::new(artifact))
        };
        let out = dir.path().join("out");
        let publish = |items: Vec<_>, taken: &mut Taken| {
            let collection = Arc::new(Sharded::of(items));
            let publication = Publication { folder: String::new(), name: "sheet".into(), collection };
            publish(&store, &out, &publication, taken, None).map(|(files, _)| files.len()).map_err(|e| e.to_string())
        };
        for items in [
            vec![item("a", "b/x", one), item("a/b", "x", two)],
            // A file where the other needs a folder, in either order.
            vec![item("a", "b", one), item("a/b", "x", two)],
            vec![item("a", "b/x/y", one), item("a/b", "x", two)],
        ] {
            let said = publish(items, &mut Taken::new(&out)).expect_err("they meet");
            assert!(said.contains("of `a` of `sheet`") && said.contains("of `a/b` of `sheet`"), "{said}");
            assert!(!out.exists(), "{said}");
        }
        let said = publish(vec![item("a", "run.json", one)], &mut Taken::new(&out)).expect_err("it is the run's own");
        assert!(said.contains("the account of the run"), "{said}");
        let mut taken = Taken::new(&out);
        assert_eq!(publish(vec![item("a", "b/x", one), item("a/c", "x", two)], &mut taken), Ok(2));
        assert_eq!(fs::read(out.join("a/b/x")).expect("written"), b"one");
        // A page that asks for a line on the run keeps that of the run that wrote it, until it changes.
        let page = |text: &str, account: &str| {
            let digest = store.put(text.as_bytes()).expect("room");
            let collection = Arc::new(Sharded::of(vec![item("a", "page.html", digest)]));
            let publication = Publication { folder: String::new(), name: "sheet".into(), collection };
            super::publish(&store, &out, &publication, &mut Taken::new(&out), Some(account)).expect("written");
            fs::read_to_string(out.join("page.html")).expect("written")
        };
        let first = page("<p><!--tauflow:run--></p>", "by A");
        assert_eq!(first, "<p><!--tauflow:run-->by A<!--/tauflow:run--></p>");
        assert_eq!(page("<p><!--tauflow:run--></p>", "by B"), first);
        assert_eq!(page("<b><!--tauflow:run--></b>", "by B"), "<b><!--tauflow:run-->by B<!--/tauflow:run--></b>");
        assert_eq!(page("<p>plain</p>", "by B"), "<p>plain</p>");
        // Another publication of the same run.
        let said = publish(vec![item("a", "x", one), item("a/b", "x", one)], &mut taken).expect_err("they meet");
        assert!(said.contains("`b/x` of `a` of `sheet`"), "{said}");
    }
}
