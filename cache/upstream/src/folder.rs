//! An upstream in a directory: complete writes, and bounded reads. Knows no contents.

use crate::{
    UpstreamError,
    error::{At, Failure},
};
use nix::libc;
use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    os::unix::fs::{FileExt, OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
};
use tauflow_cache::rename;
use tempfile::NamedTempFile;

/// Files that whole groups share: the user's own mask has no say over temporary files, which are private.
const MODE: u32 = 0o644;

/// Opens a file for reading. A link, a pipe or a device of that name is an error, and nothing waits for it.
fn open_plain(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("it is not a regular file")) }
}

/// Reads a file up to a size.
pub(crate) fn read_plain(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_plain(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(io::Error::other("it is too large")) } else { Ok(bytes) }
}

/// The files of an upstream in a directory.
#[derive(Debug)]
pub(crate) struct Folder {
    root: PathBuf,
}

impl Folder {
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Makes its directories.
    pub fn make(&self) -> Result<(), UpstreamError> {
        for folder in ["packs", "tmp"] {
            let path = self.path(folder);
            fs::create_dir_all(&path).at("create the directory", &path)?;
        }
        Ok(())
    }

    /// A small file, if it is there.
    pub fn small(&self, name: &str, most: u64) -> Result<Option<Vec<u8>>, UpstreamError> {
        let path = self.path(name);
        match read_plain(&path, most) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound && self.root.is_dir() => Ok(None),
            Err(error) => Err(error).at("read", &path),
        }
    }

    /// The names in a folder of it.
    pub fn names(&self, folder: &str) -> Result<Vec<String>, UpstreamError> {
        let folder = self.path(folder);
        let mut found = Vec::new();
        for entry in fs::read_dir(&folder).at("list", &folder)? {
            // A name that is no UTF-8 is none of ours, and stays foreign.
            found.push(entry.at("list", &folder)?.file_name().to_string_lossy().into_owned());
        }
        Ok(found)
    }

    /// Whether a name is a regular file.
    pub fn is_file(&self, name: &str) -> bool {
        fs::symlink_metadata(self.path(name)).is_ok_and(|meta| meta.is_file())
    }

    /// Opens a pack.
    pub fn pack(&self, name: &str) -> Result<(File, u64), Failure> {
        let path = self.path(name);
        let open = || -> io::Result<(File, u64)> {
            let file = open_plain(&path)?;
            let len = file.metadata()?.len();
            Ok((file, len))
        };
        open().map_err(|error| {
            Failure::File(format!("pack `{}` cannot be read ({error}); its blobs are misses", path.display()))
        })
    }

    /// A file to be written and then sealed. It vanishes if it is dropped before.
    pub fn temporary(&self) -> Result<NamedTempFile, UpstreamError> {
        let folder = self.path("tmp");
        NamedTempFile::new_in(&folder).at("write to", &folder)
    }

    /// Makes a complete file visible under its name, in place of a file of that name.
    pub fn seal(&self, file: NamedTempFile, name: &str) -> Result<(), UpstreamError> {
        let path = self.path(name);
        file.as_file().set_permissions(fs::Permissions::from_mode(MODE)).at("write", &path)?;
        file.as_file().sync_all().at("write", &path)?;
        rename(&file.into_temp_path(), &path).at("write", &path)?;
        let folder = path.parent().unwrap_or(&self.root);
        File::open(folder).and_then(|folder| folder.sync_all()).at("write to", folder)
    }

    /// Deletes a file, and its folder if that is empty then.
    pub fn delete(&self, name: &str) {
        let path = self.path(name);
        let _ = fs::remove_file(&path); // it may never have been written
        if let Some(above) = path.parent() {
            let _ = fs::remove_dir(above); // it has other files
        }
    }

    /// Writes a small file whole.
    pub fn write(&self, name: &str, content: &[u8]) -> Result<(), UpstreamError> {
        let mut file = self.temporary()?;
        file.write_all(content).at("write", file.path())?;
        self.seal(file, name)
    }
}

/// Bytes of an open pack.
pub(crate) fn read_at(file: &File, offset: u64, size: u64) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; usize::try_from(size).unwrap_or(usize::MAX)];
    file.read_exact_at(&mut bytes, offset)?;
    Ok(bytes)
}
