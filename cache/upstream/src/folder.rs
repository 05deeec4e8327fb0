//! The folder of an upstream: file names, complete writes, and bounded reads. Knows no contents.

use crate::{
    UpstreamError,
    error::At,
    index::{Contents, MOST_INDEX},
};
use nix::libc;
use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    os::unix::fs::{FileExt, OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
};
use tauflow_cache::Digest;
use tempfile::NamedTempFile;

const FORMAT: &str = "tauflow-upstream 1";
/// More than the file `UPSTREAM` holds.
const SMALL_FILE: u64 = 4096;
/// Files that whole groups share: the user's own mask has no say over temporary files, which are private.
const MODE: u32 = 0o644;

/// Opens a file for reading. A link, a pipe or a device of that name is an error, and nothing waits for it.
fn open_plain(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("it is not a regular file")) }
}

/// A folder that holds sealed packs.
#[derive(Debug)]
pub struct Upstream {
    root: PathBuf,
}

impl Upstream {
    /// Opens an upstream for reading.
    ///
    /// # Errors
    /// When the folder cannot be read, or is no upstream of this format.
    pub fn open(dir: &Path) -> Result<Self, UpstreamError> {
        let marker = dir.join("UPSTREAM");
        let mut text = Vec::new();
        match open_plain(&marker).and_then(|file| file.take(SMALL_FILE).read_to_end(&mut text)) {
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound && dir.is_dir() => {
                return Err(UpstreamError::NotUpstream { dir: dir.to_owned() });
            }
            Err(error) => return Err(error).at("read", &marker),
        }
        let text = String::from_utf8_lossy(&text);
        if text.trim_end() != FORMAT {
            let found = text.trim_end().chars().take(60).collect();
            return Err(UpstreamError::Format { dir: dir.to_owned(), found, expected: FORMAT });
        }
        Ok(Self { root: dir.to_owned() })
    }

    /// Opens an upstream for writing, and makes one in a folder that is missing or empty.
    ///
    /// # Errors
    /// As [`open`](Self::open), or when the folder cannot be written.
    pub fn create(dir: &Path) -> Result<Self, UpstreamError> {
        fs::create_dir_all(dir).at("create the directory", dir)?;
        if !dir.join("UPSTREAM").exists() {
            // Another machine may be making it, too.
            let own = |name: &str| ["UPSTREAM", "packs", "tmp", "lost+found"].contains(&name);
            for entry in fs::read_dir(dir).at("list", dir)? {
                let name = entry.at("list", dir)?.file_name();
                if !name.to_str().is_some_and(own) {
                    return Err(UpstreamError::NotUpstream { dir: dir.to_owned() });
                }
            }
        }
        let upstream = Self { root: dir.to_owned() };
        for folder in ["packs", "tmp"] {
            let path = dir.join(folder);
            fs::create_dir_all(&path).at("create the directory", &path)?;
        }
        if !dir.join("UPSTREAM").exists() {
            let mut file = upstream.temporary()?;
            file.write_all(format!("{FORMAT}\n").as_bytes()).at("write", file.path())?;
            upstream.seal(file, &dir.join("UPSTREAM"))?;
        }
        Self::open(dir)
    }

    /// Its folder.
    pub fn dir(&self) -> &Path {
        &self.root
    }

    /// Reads all indices, without their records.
    ///
    /// # Errors
    /// When the folder cannot be listed.
    pub fn contents(&self) -> Result<Contents, UpstreamError> {
        Contents::read(self)
    }

    /// A file for a content.
    pub(crate) fn file(&self, digest: &Digest, extension: &str) -> PathBuf {
        self.root.join("packs").join(format!("{digest}.{extension}"))
    }

    /// The digests by which indices are named, sorted. Files of other names are left out.
    pub(crate) fn indices(&self) -> Result<Vec<Digest>, UpstreamError> {
        let folder = self.root.join("packs");
        let mut found = Vec::new();
        for entry in fs::read_dir(&folder).at("list", &folder)? {
            let entry = entry.at("list", &folder)?;
            let name = entry.file_name();
            let digest = name.to_str().and_then(|name| name.strip_suffix(".index")?.parse().ok());
            if let Some(digest) = digest
                && entry.file_type().is_ok_and(|kind| kind.is_file())
            {
                found.push(digest);
            }
        }
        found.sort_unstable();
        Ok(found)
    }

    /// The bytes of an index, or why they are not what its name says.
    pub(crate) fn index(&self, digest: &Digest) -> Result<Vec<u8>, String> {
        let path = self.file(digest, "index");
        let wrong = |what: &str| format!("index `{}` {what}; it is ignored", path.display());
        if digest.size > MOST_INDEX {
            return Err(wrong("is larger than any that this program writes"));
        }
        let mut bytes = Vec::new();
        open_plain(&path)
            .and_then(|file| file.take(MOST_INDEX + 1).read_to_end(&mut bytes))
            .map_err(|error| wrong(&format!("cannot be read ({error})")))?;
        if Digest::of(&bytes) == *digest { Ok(bytes) } else { Err(wrong("is damaged or truncated")) }
    }

    /// Opens a pack, or says why that fails.
    pub(crate) fn pack(&self, digest: &Digest) -> Result<Pack, String> {
        let path = self.file(digest, "pack");
        let open = || -> io::Result<(File, u64)> {
            let file = open_plain(&path)?;
            let len = file.metadata()?.len();
            Ok((file, len))
        };
        match open() {
            Ok((file, len)) => Ok(Pack { digest: *digest, path, file, len }),
            Err(error) => Err(format!("pack `{}` cannot be read ({error}); its blobs are misses", path.display())),
        }
    }

    /// A file to be written and then sealed. It vanishes if it is dropped before.
    pub(crate) fn temporary(&self) -> Result<NamedTempFile, UpstreamError> {
        let folder = self.root.join("tmp");
        NamedTempFile::new_in(&folder).at("write to", &folder)
    }

    /// Makes a complete file visible under its name. A file of that name already has the same content.
    pub(crate) fn seal(&self, file: NamedTempFile, path: &Path) -> Result<(), UpstreamError> {
        file.as_file().set_permissions(fs::Permissions::from_mode(MODE)).at("write", path)?;
        file.as_file().sync_all().at("write", path)?;
        file.persist(path).map_err(|error| error.error).at("write", path)?;
        let folder = path.parent().unwrap_or(&self.root);
        File::open(folder).and_then(|folder| folder.sync_all()).at("write to", folder)
    }
}

/// A pack that is open for reading.
pub(crate) struct Pack {
    /// The digest by which it is named.
    pub digest: Digest,
    path: PathBuf,
    file: File,
    len: u64,
}

impl Pack {
    /// A blob, or why it cannot be had.
    pub fn blob(&self, offset: u64, digest: &Digest) -> Result<Vec<u8>, String> {
        let wrong = |what: &str| format!("pack `{}` {what}; blob {} is a miss", self.path.display(), digest.short());
        // Memory is taken only for bytes that are there.
        if offset.checked_add(digest.size).is_none_or(|end| end > self.len) {
            return Err(wrong("is truncated"));
        }
        let mut bytes = vec![0; usize::try_from(digest.size).unwrap_or(usize::MAX)];
        match self.file.read_exact_at(&mut bytes, offset) {
            Ok(()) if Digest::of(&bytes) == *digest => Ok(bytes),
            Ok(()) => Err(wrong("is damaged")),
            Err(error) => Err(wrong(&format!("cannot be read ({error})"))),
        }
    }
}
