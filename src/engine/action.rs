//! Independent parts of executing an action: importing external files, its key, checking its outputs.

use super::{
    execute::Whole,
    ids::{Id, InputId},
    request::{LookUp, Task},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use tauflow_cache::{CacheError, Digest};
use tauflow_contract::{
    ActionKey, Any, Artifact, FILE_PORT, Files, ItemKey, KindSpec, Media, Mode, Outputs, read_regular,
};

/// Most bytes of a file outside that is read: as many as a GLB can have.
const MOST_BYTES: u64 = 1 << 32;

/// The bytes of a file outside.
///
/// # Errors
/// In words if it is not a regular file, is too large or cannot be read.
fn read(path: &Path) -> Result<Vec<u8>, String> {
    let refused = |error| format!("cannot read `{}`: {error}; repair or remove it", path.display());
    read_regular(path, MOST_BYTES).map_err(refused)
}

/// The artifact of files outside; `put` digests or stores the bytes of each.
///
/// # Errors
/// In words if a file is no regular one, is too large or cannot be read; whatever `put` says.
pub fn files_artifact(
    files: &[(String, PathBuf)],
    put: impl Fn(&[u8]) -> Result<Digest, CacheError>,
) -> Result<Result<Artifact, String>, CacheError> {
    let mut parts = Vec::new();
    for (name, path) in files {
        match read(path) {
            Ok(bytes) => parts.push((name.clone(), put(&bytes)?)),
            Err(told) => return Ok(Err(told)),
        }
    }
    Ok(Ok(Artifact::tree(Files::NAME, parts)))
}

/// The key of an action.
pub fn action_key(task: &Task, whole: &Whole, of: &LookUp, file: Option<&Artifact>) -> ActionKey {
    let producer = &task.producer;
    let name = |input: InputId| producer.spec.inputs[input.place()].name.to_owned();
    let mut inputs: BTreeMap<String, Digest> =
        of.each.iter().map(|(input, output)| (name(*input), output.digest)).collect();
    inputs.extend(whole.iter().map(|(input, sharded)| (name(*input), sharded.digest)));
    if let Some(file) = file {
        inputs.insert(FILE_PORT.into(), file.digest());
    }
    let item = of.item.as_ref().map_or("", |i| i.as_str());
    let params = (task.projection)(of.item.as_ref(), producer.group);
    ActionKey { basis: task.basis.of_action(params, |seed| producer.kind.seed(seed, item)), inputs }
}

/// A kind must fill exactly the ports of its group, with what they say they hold.
pub fn check_outputs(spec: &KindSpec, group: &str, outputs: &Outputs) -> Result<(), String> {
    let name = spec.name;
    let ports: Vec<_> = spec.outputs.iter().filter(|p| p.group.name == group).collect();
    for port in outputs.items.keys().chain(outputs.collections.keys()) {
        if ports.iter().all(|p| p.name != port) {
            return Err(format!("`{name}` filled `{port}`, which is no port of its group `{group}`"));
        }
    }
    let artifacts = outputs.items.values().chain(outputs.collections.values().flat_map(|c| c.items.values()));
    for part in artifacts.flat_map(|a| a.parts.keys()) {
        if !part.is_empty() && ItemKey::new(part.as_str()).is_err() {
            return Err(format!("`{name}` named a part `{part}`, which cannot be a file name"));
        }
    }
    for port in ports {
        let wrong = |media: &str| port.media != Any::NAME && media != port.media;
        if spec.mode == Mode::Gather {
            let collection = outputs.collections.get(port.name);
            let Some(collection) = collection else { return Err(format!("`{name}` left `{}` out", port.name)) };
            if port.single && collection.items.len() != 1 {
                let count = collection.items.len();
                return Err(format!("`{name}` put {count} items on `{}`, which has one", port.name));
            }
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

/// The message of a panic.
pub fn panicked(panic: &Box<dyn std::any::Any + Send>) -> String {
    let told = panic.downcast_ref::<String>().map(String::as_str);
    let told = told.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
    format!("internal error: panic: {told}; please report it")
}
