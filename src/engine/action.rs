//! Parts of doing an action that stand for themselves: the files outside that it reads, its key, the check of what it gave.

use super::{
    whole::Whole,
    work::{Job, Task},
};
use std::{collections::BTreeMap, fs, path::PathBuf, sync::Arc};
use tauflow_cache::{CacheError, Digest};
use tauflow_contract::{ActionKey, Artifact, FORMAT_VERSION, ItemKey, Mode, Outputs, derive_seed};

/// Media type of files outside that a source reads.
const FILES: &str = "tauflow/files";
/// The port on which a source's action finds them.
pub const FILE_PORT: &str = "file";

/// The artifact of files outside; `put` digests or stores the bytes of each.
///
/// # Errors
/// In words if a file cannot be read; whatever `put` says.
pub fn files_artifact(
    files: &[(String, PathBuf)],
    put: impl Fn(&[u8]) -> Result<Digest, CacheError>,
) -> Result<Result<Artifact, String>, CacheError> {
    let mut parts = Vec::new();
    for (name, path) in files {
        match fs::read(path) {
            Ok(bytes) => parts.push((name.clone(), put(&bytes)?)),
            Err(error) => {
                return Ok(Err(format!("cannot read `{}`: {error}; mend it or take it away", path.display())));
            }
        }
    }
    Ok(Ok(Artifact::tree(FILES, parts)))
}

/// The key of an action.
pub fn action_key(task: &Task, whole: &[(usize, Arc<Whole>)], job: &Job, file: Option<&Artifact>) -> ActionKey {
    let name = |port: usize| task.spec.inputs[port].name.to_owned();
    let mut inputs: BTreeMap<String, Digest> =
        job.each.iter().map(|(port, output)| (name(*port), output.digest)).collect();
    inputs.extend(whole.iter().map(|(port, whole)| (name(*port), whole.digest)));
    if let Some(file) = file {
        inputs.insert(FILE_PORT.into(), file.digest());
    }
    let item = job.item.as_ref().map_or("", |i| i.as_str());
    ActionKey {
        environment: task.environment.clone(),
        format: FORMAT_VERSION,
        kind: task.spec.name.to_owned(),
        version: task.spec.version,
        group: task.group.to_owned(),
        params: (task.projection)(job.item.as_ref(), task.group),
        inputs,
        seed: task.spec.seeded.then(|| derive_seed(task.seed, task.spec.name, item)),
    }
}

/// A kind must fill exactly the ports of its group, with what they say they hold.
pub fn check_outputs(task: &Task, outputs: &Outputs) -> Result<(), String> {
    let name = task.spec.name;
    let ports: Vec<_> = task.spec.outputs.iter().filter(|p| p.group == task.group).collect();
    for port in outputs.items.keys().chain(outputs.collections.keys()) {
        if ports.iter().all(|p| p.name != port) {
            return Err(format!("`{name}` filled `{port}`, which is no port of its group `{}`", task.group));
        }
    }
    let artifacts = outputs.items.values().chain(outputs.collections.values().flat_map(|c| c.items.values()));
    for part in artifacts.flat_map(|a| a.parts.keys()) {
        if !part.is_empty() && ItemKey::new(part.as_str()).is_err() {
            return Err(format!("`{name}` named a part `{part}`, which cannot be a file name"));
        }
    }
    for port in ports {
        let wrong = |media: &str| port.media != "*" && media != port.media;
        if task.spec.mode == Mode::Gather {
            let collection = outputs.collections.get(port.name);
            let Some(collection) = collection else { return Err(format!("`{name}` left `{}` out", port.name)) };
            if let Some((key, artifact)) = collection.iter().find(|(_, a)| wrong(&a.media)) {
                return Err(format!("`{name}` put `{}` on `{}` for `{key}`", artifact.media, port.name));
            }
        } else {
            match outputs.items.get(port.name) {
                Some(artifact) if wrong(&artifact.media) => {
                    return Err(format!("`{name}` put `{}` on `{}`", artifact.media, port.name));
                }
                None if !port.filter => return Err(format!("`{name}` left `{}` out", port.name)),
                _ => {}
            }
        }
    }
    Ok(())
}

/// What people are told of a panic.
pub fn panicked(panic: &Box<dyn std::any::Any + Send>) -> String {
    let told = panic.downcast_ref::<String>().map(String::as_str);
    let told = told.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
    format!("internal error: it panicked: {told}; please report it")
}
