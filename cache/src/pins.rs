//! Pins: names that protect a digest, and everything reachable from it, from gc.

use crate::{
    CacheError, Digest, Store,
    error::At,
    layout::{names, read_small, sync_dir},
};
use std::{collections::BTreeMap, fs, io, path::PathBuf};

impl Store {
    /// Keeps `digest`, and all blobs of the records that reach it, until [`unpin`](Self::unpin). A pin of that name
    /// moves.
    ///
    /// # Errors
    /// When the name cannot be a file name, or the pin cannot be written.
    pub fn pin(&self, name: &str, digest: &Digest) -> Result<(), CacheError> {
        let path = self.pin_path(name)?;
        self.writes()?;
        self.layout.write_file(&path, format!("{digest}\n").as_bytes())
    }

    /// Removes a pin; whether there was one.
    ///
    /// # Errors
    /// When the name cannot be a file name, or the pin cannot be removed.
    pub fn unpin(&self, name: &str) -> Result<bool, CacheError> {
        let path = self.pin_path(name)?;
        if !fs::symlink_metadata(&path).is_ok_and(|meta| meta.is_file()) {
            return Ok(false);
        }
        self.writes()?;
        match fs::remove_file(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            other => other.at("remove the pin", &path)?,
        }
        sync_dir(&self.layout.folder("pins")).at("sync the folder of", &path)?;
        Ok(true)
    }

    /// All pins, by name. Files that hold no digest are left out.
    ///
    /// # Errors
    /// When the pins cannot be read.
    pub fn pins(&self) -> Result<BTreeMap<String, Digest>, CacheError> {
        let folder = self.layout.folder("pins");
        let mut pins = BTreeMap::new();
        for name in names(&folder).at("read the pins in", &folder)? {
            let path = folder.join(&name);
            let text = match read_small(&path) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue, // unpinned meanwhile
                other => other.at("read the pin", &path)?,
            };
            if let Ok(digest) = text.trim().parse() {
                pins.insert(name, digest);
            }
        }
        Ok(pins)
    }

    fn pin_path(&self, name: &str) -> Result<PathBuf, CacheError> {
        let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if name.is_empty() || name.len() > 100 || name.starts_with('.') || !name.chars().all(good) {
            return Err(CacheError::PinName { name: name.to_owned() });
        }
        Ok(self.layout.folder("pins").join(name))
    }
}
