//! Folders and file names of a store.
//!
//! ```text
//! FORMAT          version of this layout
//! CACHEDIR.TAG    backup programs skip the folder
//! blobs/ab/<hash>-<size>         large blobs, one file each
//! packs/<seq>-<owner>.pack       small blobs, appended by one store instance
//! log/<seq>-<owner>.log          records, appended by one store instance
//! {packs,log}/<segment>.idx      what a segment holds; can be deleted at any time
//! leases/<owner>.lease           locked while its owner lives; what the owner uses
//! locks/claims                   a byte of it is locked while an action is claimed
//! pins/<name>                    a digest that gc keeps
//! quarantine/                    damaged blobs, for inspection
//! tmp/<owner>.<n>                files being written
//! trash/                         files that a gc is about to delete
//! gc.lock                        locked while a gc goes on
//! ```
//! Knows names only; contents are the business of the module of that name.

use crate::{
    Digest,
    error::{At, CacheError},
};
use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

/// First line of the FORMAT file.
pub(crate) const FORMAT: &str = "tauflow-cache 2";
const TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n# This folder is a cache of tauflow.\n";
const FOLDERS: [&str; 9] = ["blobs", "packs", "log", "leases", "locks", "pins", "quarantine", "tmp", "trash"];

/// A store's folder.
#[derive(Debug)]
pub(crate) struct Layout {
    pub root: PathBuf,
    pub owner: String,
    next_tmp: AtomicU64,
}

impl Layout {
    /// Makes the folders that are missing; refuses a store of another format.
    pub fn open(root: &Path, owner: String) -> Result<Self, CacheError> {
        for folder in FOLDERS {
            let path = root.join(folder);
            fs::create_dir_all(&path).at("create the cache folder", &path)?;
        }
        let layout = Self { root: root.to_owned(), owner, next_tmp: AtomicU64::new(0) };
        layout.has_format()?;
        Ok(layout)
    }

    /// Says what the folder is, where nothing does yet.  The owner has its lease, so that no collection takes the files for a dead one's.
    pub fn sign(&self) -> Result<(), CacheError> {
        if !self.has_format()? {
            self.write_file(&self.root.join("CACHEDIR.TAG"), TAG.as_bytes())?;
            self.write_file(&self.root.join("FORMAT"), format!("{FORMAT}\n").as_bytes())?;
        }
        Ok(())
    }

    /// Whether the folder says that it is a store of this format; an error if of another.
    fn has_format(&self) -> Result<bool, CacheError> {
        let path = self.root.join("FORMAT");
        match fs::read_to_string(&path) {
            Ok(text) if text.trim_end() == FORMAT => Ok(true),
            Ok(text) => {
                let found = text.trim_end().chars().take(60).collect();
                Err(CacheError::Format { dir: self.root.clone(), found, expected: FORMAT })
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error).at("read", &path),
        }
    }

    pub fn folder(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    pub fn blob(&self, digest: &Digest) -> PathBuf {
        let name = digest.to_string();
        self.root.join("blobs").join(&name[..2]).join(name)
    }

    /// A name in `tmp/` that nobody else uses.
    pub fn tmp(&self) -> PathBuf {
        let n = self.next_tmp.fetch_add(1, Ordering::Relaxed);
        self.root.join("tmp").join(format!("{}.{n}", self.owner))
    }

    /// Writes a small file whole and durably: temporary file, sync, rename, sync of the folder.  The owner has its lease.
    pub fn write_file(&self, path: &Path, bytes: &[u8]) -> Result<(), CacheError> {
        let tmp = self.tmp();
        let written = File::create_new(&tmp)
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
            .and_then(|()| fs::rename(&tmp, path));
        if written.is_err() {
            let _ = fs::remove_file(&tmp); // the first error is the one to report
        }
        written.at("write", path)?;
        sync_dir(path.parent().unwrap_or(&self.root)).at("sync the folder of", path)
    }
}

/// Makes the names in `dir` durable.
pub(crate) fn sync_dir(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}

/// Names of the files in `dir`, sorted.  A folder that does not exist has none.
pub(crate) fn names(dir: &Path) -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    match fs::read_dir(dir) {
        Ok(entries) => {
            for entry in entries {
                if let Ok(name) = entry?.file_name().into_string() {
                    names.push(name);
                }
            }
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    names.sort_unstable();
    Ok(names)
}

/// Every large blob's digest and path, sorted; names that are not digests are left out.
pub(crate) fn loose_blobs(root: &Path) -> io::Result<Vec<(Digest, PathBuf)>> {
    let blobs = root.join("blobs");
    let mut found = Vec::new();
    for folder in names(&blobs)? {
        let folder = blobs.join(folder);
        if !folder.is_dir() {
            continue;
        }
        for name in names(&folder)? {
            if let Ok(digest) = name.parse::<Digest>() {
                found.push((digest, folder.join(name)));
            }
        }
    }
    Ok(found)
}
