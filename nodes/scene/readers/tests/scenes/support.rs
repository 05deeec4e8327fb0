//! Runs kinds as the engine does: items, projection, files imported, outputs collected. The tests of
//! `tauflow-scene` use it as well.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{
    Action, Artifact, Collection, Context, FILE_PORT, FileTree, Files, ItemKey, KindError, Media, MemoryBlobs,
    NodeKind, Outputs, Silent, SourceItem,
};
use tauflow_testing::{Need, skip};

/// A kind by name.
pub fn kind(name: &str) -> Box<dyn NodeKind> {
    crate::kinds().into_iter().find(|k| k.spec().name == name).expect("a kind of these tests")
}

/// A folder of the shared assets, if they are there.
pub fn shared(folder: &str) -> Option<String> {
    let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let found = above.map(|at| at.join("shared/assets").join(folder)).find(|path| path.is_dir());
    if found.is_none() {
        skip(
            Need::Shared,
            format_args!("no `shared/assets/{folder}` in a folder above {}", env!("CARGO_MANIFEST_DIR")),
        );
    }
    found.map(|path| path.display().to_string())
}

/// Runs one action on blobs in memory.
pub fn act(
    blobs: &MemoryBlobs,
    kind: &dyn NodeKind,
    params: &serde_json::Value,
    item: Option<&SourceItem>,
    all: BTreeMap<&str, &Collection>,
) -> Result<Outputs, KindError> {
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &cancel);
    let key = item.map(|i| &i.key);
    let file = match item {
        Some(item) if !item.files.is_empty() => {
            let read =
                |(name, path): &(String, PathBuf)| (name.clone(), fs::read(path).expect("a file that was listed"));
            let files: FileTree = item.files.iter().map(read).collect();
            Some(Files(files).store(&ctx)?.into_artifact())
        }
        _ => None,
    };
    let action = Action {
        params: kind.projection(params)(key, "main"),
        item: key,
        group: "main",
        seed: kind.seed(7, key.map_or("", ItemKey::as_str)),
        each: file.iter().map(|f| (FILE_PORT, f)).collect(),
        all,
    };
    kind.run(&ctx, &action)
}

/// Runs every item of a source; its collections by port.
pub fn source(
    blobs: &MemoryBlobs,
    name: &str,
    params: serde_json::Value,
    all: &BTreeMap<&str, &Collection>,
) -> BTreeMap<String, Collection> {
    let kind = kind(name);
    let params = kind.resolve(&params).expect("fine params");
    let mut out: BTreeMap<String, Collection> = BTreeMap::new();
    for item in kind.items(&params).expect("files that can be listed") {
        let outputs = act(blobs, kind.as_ref(), &params, Some(&item), all.clone()).expect("an action that works");
        for (port, artifact) in outputs.items {
            out.entry(port).or_default().items.insert(item.key.clone(), artifact);
        }
    }
    out
}

/// A record that a kind made.
pub fn load<M: Media>(blobs: &MemoryBlobs, artifact: &Artifact) -> M {
    let cancel = AtomicBool::new(false);
    M::load(&Context::new(blobs, &Silent, &cancel), artifact).expect("an artifact of its type")
}
