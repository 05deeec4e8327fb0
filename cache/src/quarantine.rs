//! Quarantine: the place of damaged blobs, so that they are never read again.
//!
//! A large blob's file is moved here. A packed blob is copied to `<segment>@<offset>`; that name alone tells every
//! store that the place in the pack is bad.

use crate::{
    Digest,
    layout::{Layout, is_number, is_own_folder, names, open_folder},
    segment::Sort,
};
use nix::fcntl::renameat;
use std::{
    fs::File,
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

/// Marks a place in a pack as bad, keeping its bytes. On a full disk the name is kept at least.
pub(crate) fn packed(layout: &Layout, segment: &str, offset: u64, bytes: &[u8]) {
    if !layout.writes {
        return;
    }
    let path = layout.folder("quarantine").join(format!("{segment}@{offset}"));
    // Best effort: without it, others find the damage by themselves.
    let _ = File::create_new(path).and_then(|mut file| file.write_all(bytes));
}

/// Moves a large blob's file out of the way. Neither folder may be a link, nor become one in between: behind it a file
/// of somebody else may have the blob's name.
pub(crate) fn loose(layout: &Layout, digest: &Digest, path: &Path) {
    let Some(folder) = path.parent().filter(|_| layout.writes && is_own_folder(&layout.folder("blobs"))) else {
        return;
    };
    if let (Ok(from), Ok(to)) = (open_folder(folder), open_folder(&layout.folder("quarantine"))) {
        let name = digest.to_string();
        let _ = renameat(&from, name.as_str(), &to, name.as_str()); // gone already: as good
    }
}

/// Whether a file of this name lies in the quarantine, and which segment it is about.
pub(crate) fn subject(name: &str) -> Option<Option<&str>> {
    match name.split_once('@') {
        Some((segment, offset)) => (Sort::Pack.parse(segment).is_some() && is_number(offset)).then_some(Some(segment)),
        None => name.parse::<Digest>().is_ok().then_some(None),
    }
}
