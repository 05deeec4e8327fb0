//! Writes published outputs as files below `OUT/<pipeline>/`, and `run.json` beside them.

use super::{EngineError, Summary, sharded::Sharded};
use serde_json::json;
use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};
use tauflow_cache::{Digest, Store};

/// What is written: a folder below the pipeline's, and the collection whose parts go there.
pub struct Publication {
    /// Folder below `OUT/<pipeline>/`; empty for the only publishing node.
    pub folder: String,
    /// The artifacts.
    pub collection: Arc<Sharded>,
}

/// Writes what differs from what is there, each file at once; returns all files, and the blobs that are missing.
///
/// # Errors
/// If the folder cannot be written.
pub fn publish(
    store: &Store,
    out: &Path,
    publication: &Publication,
) -> Result<(Vec<PathBuf>, Vec<Digest>), EngineError> {
    let (mut written, mut missing) = (Vec::new(), Vec::new());
    let many = publication.collection.len() > 1;
    let items = match publication.collection.items(store)? {
        Ok(items) => items,
        Err(blob) => return Ok((written, vec![blob])),
    };
    for (key, output) in items {
        // Names become paths here: those of a store were checked as they were read, and those of a kind are now.
        output.artifact.check_names().map_err(|error| EngineError::Request(format!("`{key}`: {error}")))?;
        let mut folder = out.join(&publication.folder);
        if many {
            folder.push(key.as_str());
        }
        for (part, digest) in output.artifact.parts.iter() {
            let path = folder.join(if part.is_empty() { "value" } else { part });
            match store.get(digest)? {
                Some(bytes) => {
                    write(&path, &bytes)?;
                    written.push(path);
                }
                None => missing.push(*digest),
            }
        }
    }
    Ok((written, missing))
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
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let temporary = folder.join(format!(".{name}.{}.tmp", std::process::id()));
    fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path)).map_err(|source| {
        // The temporary file is of no use to anybody.
        let _ = fs::remove_file(&temporary);
        io(source)
    })
}

/// Writes `run.json`: what the run did, by node.
///
/// # Errors
/// If it cannot be written.
pub fn write_summary(out: &Path, pipeline: &str, summary: &Summary) -> Result<(), EngineError> {
    let value = json!({
        "pipeline": pipeline,
        "elapsed_s": summary.elapsed.as_secs_f64(),
        "interrupted": summary.interrupted,
        "nodes": summary.nodes,
        "slowest": summary.slowest,
        "failures": summary.failures,
    });
    let mut text = serde_json::to_vec_pretty(&value).expect("plain data");
    text.push(b'\n');
    write(&out.join("run.json"), &text)
}
