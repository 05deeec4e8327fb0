//! Quarantine: where damaged blobs go, so that nobody reads them again.
//!
//! A large blob's file is moved here.  A packed blob is copied to
//! `<segment>@<offset>`; that name alone tells every store that the place in
//! the pack is bad.

use crate::{
    Digest,
    layout::{Layout, is_number, names},
    segment::Sort,
};
use std::{
    fs::{self, File},
    io::{self, Write},
    path::Path,
};

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
    if !layout.writes {
        return;
    }
    let path = layout.folder("quarantine").join(format!("{segment}@{offset}"));
    // Best effort: without it, others find the damage by themselves.
    let _ = File::create_new(path).and_then(|mut file| file.write_all(bytes));
}

/// Moves a large blob's file out of the way.
pub(crate) fn loose(layout: &Layout, digest: &Digest, path: &Path) {
    if layout.writes {
        let _ = fs::rename(path, layout.folder("quarantine").join(digest.to_string())); // gone already: as good
    }
}

/// Whether a file of this name lies in the quarantine, and which segment it is about.
pub(crate) fn subject(name: &str) -> Option<Option<&str>> {
    match name.split_once('@') {
        Some((segment, offset)) => (Sort::Pack.parse(segment).is_some() && is_number(offset)).then_some(Some(segment)),
        None => name.parse::<Digest>().is_ok().then_some(None),
    }
}
