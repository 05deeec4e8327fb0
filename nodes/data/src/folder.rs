//! Artifacts as folders on disk: what `export` writes, and what is imported from there.
//!
//! A folder of items has a [`Manifest`], which is written last: where it stands, all that it lists is whole. Knows no
//! media type; each writes and reads its own files (see [`crate::records`]).

use crate::records;
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    ops::Bound,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};
use tauflow_contract::{
    Artifact, Collection, Context, Digest, ItemKey, KindError, Radiance, ReadFiles, WriteFiles, parse_json,
    pretty_json, read_regular,
};

/// File that lists the items of a folder.
pub const MANIFEST: &str = "manifest.json";

/// The content of a folder of items, and its origin.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The pipeline; empty for what another program made.
    #[serde(default)]
    pub pipeline: String,
    /// The node.
    #[serde(default)]
    pub node: String,
    /// Its output port.
    #[serde(default)]
    pub port: String,
    /// The items.
    pub items: Vec<ExportedItem>,
}

/// An item in a folder of its own, which is named by its key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportedItem {
    /// Its key.
    pub item: ItemKey,
    /// Name of its media type.
    pub media: String,
    /// Content digest of the artifact that was exported; none for what another program made.
    #[serde(default)]
    pub digest: Option<Digest>,
    /// Content digests of its parts, for `cache pin` and such.
    #[serde(default)]
    pub parts: BTreeMap<String, Digest>,
    /// Its files; none for whatever there is.
    #[serde(default)]
    pub files: Option<Vec<String>>,
}

/// A folder on disk. Each file is written whole or not at all, and no name leads out of it.
#[derive(Clone, Debug)]
pub struct DiskFolder {
    path: PathBuf,
    /// The files that are looked at; none for all.
    listed: Option<BTreeSet<String>>,
    written: BTreeSet<String>,
    /// The item whose folder it is, and the files of all items that were written with it.
    item: Option<ItemKey>,
    radiance: Radiance,
    taken: Arc<Mutex<BTreeMap<PathBuf, ItemKey>>>,
    /// The manifest of what was there before, which goes before the first file is written.
    earlier: Arc<Mutex<Option<PathBuf>>>,
}

impl DiskFolder {
    /// A folder, which is made once something is written.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        let (listed, written, radiance, taken, earlier) = Default::default();
        Self { path: path.into(), listed, written, item: None, radiance, taken, earlier }
    }

    /// The same, where images are written so.
    pub fn with_radiance(&self, radiance: Radiance) -> Self {
        Self { radiance, ..self.clone() }
    }

    /// The folder of an item.
    fn of_item(&self, item: &ItemKey) -> Self {
        // A key is a path below the folder: that is what `ItemKey::new` checks.
        let path = self.path.join(item.as_str());
        let (radiance, taken, earlier) = (self.radiance, self.taken.clone(), self.earlier.clone());
        Self { path, item: Some(item.clone()), radiance, taken, earlier, ..Self::new("") }
    }

    /// Takes a file for this folder's item: the folders of items may lie in each other, and their files may meet.
    fn take(&self, path: &Path) -> Result<(), KindError> {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        let others = |item: &&ItemKey| Some(*item) != self.item.as_ref();
        let above = path.ancestors().find_map(|above| taken.get(above).filter(others));
        let below = taken.range::<Path, _>((Bound::Excluded(path), Bound::Unbounded)).next();
        let below = below.filter(|(other, _)| other.starts_with(path)).map(|(_, item)| item).filter(others);
        if let Some(other) = above.or(below) {
            let own = self.item.as_ref().map_or_else(|| "the list of all items".to_owned(), |item| format!("`{item}`"));
            return Err(KindError::Input(format!(
                "`{other}` and {own} would be written to the same file {}; export them separately, or rename a key",
                path.display()
            )));
        }
        if let Some(item) = &self.item {
            taken.insert(path.to_owned(), item.clone());
        }
        Ok(())
    }

    /// Removes the manifest of what was there before, if [`begin`] was called: what it lists is about to change.
    fn forget(&self) -> Result<(), KindError> {
        let mut earlier = self.earlier.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(path) = &*earlier {
            match fs::remove_file(path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(KindError::Environment(format!("cannot remove {}: {error}", path.display())));
                }
                _ => *earlier = None,
            }
        }
        Ok(())
    }

    /// The file of a name: names of files are held to the rule of keys, so that none leads out of the folder.
    fn file(&self, name: &str) -> Result<PathBuf, KindError> {
        ItemKey::check(name)
            .map_err(|error| KindError::Input(format!("a file in {}: {error}", self.path.display())))?;
        Ok(self.path.join(name))
    }

    fn list(&self, below: &Path, prefix: &str, found: &mut Vec<String>) -> Result<(), KindError> {
        let failed = |e: io::Error| KindError::Environment(format!("cannot list {}: {e}", below.display()));
        for entry in fs::read_dir(below).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let name = entry.file_name().into_string().map_err(|name| {
                KindError::Input(format!("{}: the name {name:?} is not UTF-8; rename the file", below.display()))
            })?;
            // No export writes such names: they are of file managers, of version control, or of a process that was
            // killed at its work.
            if name.starts_with('.') {
                continue;
            }
            let full = format!("{prefix}{name}");
            if entry.file_type().map_err(failed)?.is_dir() {
                self.list(&entry.path(), &format!("{full}/"), found)?;
            } else {
                found.push(full);
            }
        }
        Ok(())
    }
}

/// Name of the file that is written first, and then renamed; none that is listed.
fn temporary(name: &str) -> String {
    #[expect(clippy::disallowed_methods, reason = "the name of a file that does not stay; no output holds it")]
    let process = std::process::id();
    format!(".{name}.{process}.tmp")
}

impl WriteFiles for DiskFolder {
    fn put(&mut self, name: &str, bytes: &[u8]) -> Result<(), KindError> {
        let path = self.file(name)?;
        self.take(&path)?;
        self.forget()?;
        let failed = |e: io::Error| KindError::Environment(format!("cannot write {}: {e}", path.display()));
        let (Some(folder), Some(own)) = (path.parent(), path.file_name()) else {
            return Err(KindError::Internal(format!("`{name}` was checked, and has no folder")));
        };
        fs::create_dir_all(folder).map_err(failed)?;
        let temporary = folder.join(temporary(&own.to_string_lossy()));
        fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, &path)).map_err(|error| {
            // Nobody has a use for half of a file, and it may not be there at all.
            let _ = fs::remove_file(&temporary);
            failed(error)
        })?;
        self.written.insert(name.to_owned());
        Ok(())
    }

    fn radiance(&self) -> Radiance {
        self.radiance
    }
}

impl ReadFiles for DiskFolder {
    fn names(&self) -> Result<Vec<String>, KindError> {
        if let Some(listed) = &self.listed {
            return Ok(listed.iter().cloned().collect());
        }
        let mut found = Vec::new();
        self.list(&self.path, "", &mut found)?;
        found.sort();
        Ok(found)
    }

    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, KindError> {
        let path = self.file(name)?;
        if self.listed.as_ref().is_some_and(|listed| !listed.contains(name)) {
            return Ok(None);
        }
        // Folders of other programs may hold anything: a FIFO would wait, and a device has no end.
        match read_regular(&path, u64::MAX) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => {
                Err(KindError::Input(format!("cannot read {}: {error}; put a file there", path.display())))
            }
            Err(error) => Err(KindError::Environment(format!("cannot read {}: {error}", path.display()))),
        }
    }
}

/// The row of a media type.
fn row(media: &str) -> Result<&'static tauflow_contract::MediaRow, KindError> {
    records::media(media).ok_or_else(|| {
        let names: Vec<&str> = records::MEDIA.iter().map(|row| row.name).collect();
        KindError::Input(format!("there is no media type `{media}`; there are {}", names.join(", ")))
    })
}

/// Begins an export that ends with a manifest. The first file that is written takes the earlier manifest away, so that
/// a manifest stands for what is written now alone. An export that fails before it writes a file leaves all as it was.
pub fn begin(out: &DiskFolder) {
    *out.earlier.lock().unwrap_or_else(PoisonError::into_inner) = Some(out.path.join(MANIFEST));
}

/// Writes an item into a folder of its own.
///
/// # Errors
/// If it is not whole, its media type is unknown, or a file cannot be written.
pub fn export_item(
    ctx: &Context<'_>,
    item: &ItemKey,
    artifact: &Artifact,
    out: &DiskFolder,
) -> Result<ExportedItem, KindError> {
    let mut own = out.of_item(item);
    (row(&artifact.media)?.export)(ctx, artifact, &mut own)?;
    Ok(ExportedItem {
        item: item.clone(),
        media: artifact.media.clone(),
        digest: Some(artifact.digest()),
        parts: artifact.parts.iter().map(|(name, digest)| (name.clone(), *digest)).collect(),
        files: Some(own.written.into_iter().collect()),
    })
}

/// Ends what [`begin`] began: writes the manifest.
///
/// # Errors
/// If it cannot be written.
pub fn finish(out: &mut DiskFolder, manifest: &Manifest) -> Result<(), KindError> {
    out.put(MANIFEST, &pretty_json(manifest)?)
}

/// Stores the items of a folder that was exported, or that another program made alike.
///
/// # Errors
/// If the manifest or a file is missing or not what it should be; if the store cannot be written.
pub fn import_items(ctx: &Context<'_>, from: &DiskFolder) -> Result<Collection, KindError> {
    let manifest: Manifest = parse_json(MANIFEST, &from.need(MANIFEST)?)?;
    let import = |exported: &ExportedItem| {
        let mut own = from.of_item(&exported.item);
        own.listed = exported.files.as_ref().map(|files| files.iter().cloned().collect());
        let artifact = row(&exported.media)
            .and_then(|row| (row.import)(ctx, &own))
            .map_err(|error| in_item(&exported.item, error))?;
        Ok((exported.item.clone(), artifact))
    };
    manifest.items.iter().map(import).collect()
}

/// An error of an item, which it names.
fn in_item(item: &ItemKey, error: KindError) -> KindError {
    match error {
        KindError::Input(message) => KindError::Input(format!("`{item}`: {message}")),
        KindError::Environment(message) => KindError::Environment(format!("`{item}`: {message}")),
        other => other,
    }
}

#[cfg(test)]
mod tests;
