//! Quarantine: where damaged blobs go, so that nobody reads them again.
//!
//! A large blob's file is moved here.  A packed blob is copied to
//! `<segment>@<offset>`; that name alone tells every store that the place in
//! the pack is bad.

use crate::{
    Digest,
    layout::{Layout, names},
};
use std::{fs, io, path::Path};

/// The bad places in packs: segment name and offset of the blob.
pub(crate) fn places(layout: &Layout) -> io::Result<Vec<(String, u64)>> {
    let parse = |name: &String| {
        let (segment, offset) = name.split_once('@')?;
        Some((segment.to_owned(), offset.parse().ok()?))
    };
    Ok(names(&layout.folder("quarantine"))?.iter().filter_map(parse).collect())
}

/// Marks a place in a pack as bad, keeping its bytes.  On a full disk the name is kept at least.
pub(crate) fn packed(layout: &Layout, segment: &str, offset: u64, bytes: &[u8]) {
    let path = layout.folder("quarantine").join(format!("{segment}@{offset}"));
    if fs::write(&path, bytes).is_err() {
        let _ = fs::File::create(&path); // best effort: without it, others find the damage by themselves
    }
}

/// Moves a large blob's file out of the way.
pub(crate) fn loose(layout: &Layout, digest: &Digest, path: &Path) {
    let _ = fs::rename(path, layout.folder("quarantine").join(digest.to_string())); // gone already: as good
}
