//! Reports of single files.

use crate::support::load;
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Context, FILE_PORT, FileTree, Files, ItemKey, Media, MemoryBlobs, NodeKind, Silent};
use tauflow_data::records::AssetReport;

/// What the kind `assets` says of a file of these bytes.
pub fn report_on(kind: &dyn NodeKind, params: &serde_json::Value, name: &str, bytes: &[u8]) -> AssetReport {
    let blobs = MemoryBlobs::default();
    let key = ItemKey::new(name).expect("plain");
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let files = FileTree::from([("file".to_owned(), bytes.to_vec())]);
    let file = Files(files).store(&ctx).expect("in memory").into_artifact();
    let action = Action {
        params: kind.projection(params)(Some(&key), "main"),
        item: Some(&key),
        group: "main",
        seed: 0,
        each: BTreeMap::from([(FILE_PORT, &file)]),
        all: BTreeMap::new(),
    };
    let outputs = kind.run(&ctx, &action).expect("a report at least");
    load(&blobs, &outputs.items["reports"])
}
