//! Names in the trash, and restoring its files.

use crate::{
    CacheError, Digest,
    error::At,
    layout::{Layout, names, own_folder},
    network,
    segment::Sort,
};
use std::{fs, path::PathBuf};

/// Where something in the trash belongs; none for what no collection put there.
pub(super) fn home(layout: &Layout, name: &str) -> Option<PathBuf> {
    match name.parse::<Digest>() {
        Ok(digest) => Some(layout.blob(&digest)),
        Err(_) if Sort::Pack.parse(name).is_some() => Some(layout.folder("packs").join(name)),
        Err(_) if Sort::Log.parse(name).is_some() => Some(layout.folder("log").join(name)),
        Err(_) => None,
    }
}

/// Puts back what a collection that died had moved to the trash. Its copies then exist twice.
pub(super) fn restore_trash(layout: &Layout) -> Result<(), CacheError> {
    let trash = layout.folder("trash");
    for name in names(&trash).at("list", &trash)? {
        let Some(home) = home(layout, &name) else { continue };
        if let Some(folder) = home.parent()
            && !own_folder(folder)?
        {
            fs::create_dir_all(folder).at("create the folder", folder)?;
        }
        network::rename(&trash.join(&name), &home).at("restore", &home)?;
    }
    Ok(())
}
