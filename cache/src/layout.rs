//! Directories and file names of a store.
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
//! Nothing else is ever written, moved or deleted: what has another name, or is a link, a pipe or a device, is of
//! somebody else.
//!
//! Knows names only; contents are the business of the module of that name.

use crate::{
    Digest,
    error::{At, CacheError},
    network,
};
use nix::libc;
use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
};

/// First line of the FORMAT file.
pub(crate) const FORMAT: &str = "tauflow-cache 2";
const TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n# This folder is a cache of tauflow.\n";
const FOLDERS: [&str; 9] = ["blobs", "packs", "log", "leases", "locks", "pins", "quarantine", "tmp", "trash"];
/// More than FORMAT, CACHEDIR.TAG or a pin holds.
const SMALL_FILE: u64 = 4096;

/// A store's folder.
#[derive(Debug)]
pub(crate) struct Layout {
    pub root: PathBuf,
    pub owner: String,
    /// Files of no consequence may be written, too: index files, and what is set aside.
    pub writes: bool,
    next_tmp: AtomicU64,
    /// The folders of large blobs that were seen to be the store's own, by the first byte of the hash.
    own_blobs: [AtomicBool; 256],
}

impl Layout {
    pub fn new(root: &Path, owner: String) -> Self {
        let own_blobs = [const { AtomicBool::new(false) }; 256];
        Self { root: root.to_owned(), owner, writes: true, next_tmp: AtomicU64::new(0), own_blobs }
    }

    /// Whether there is a store of this format, all of whose folders are its own. If not, one may be made here. Changes
    /// nothing.
    ///
    /// # Errors
    /// When the folder holds a store of another format, or anything but what an unfinished opening leaves.
    pub fn is_made(&self) -> Result<bool, CacheError> {
        let made = self.has_format()?;
        if !made && let Some(found) = self.stranger().at("look into", &self.root)? {
            // Another process that makes the store fills it once FORMAT is there.
            if !self.has_format()? {
                return Err(CacheError::Foreign { dir: self.root.clone(), found });
            }
            self.own_folders()?;
            return Ok(true);
        }
        self.own_folders()?;
        Ok(made)
    }

    /// Refuses links in place of the store's folders: what lies behind one is of somebody else.
    pub fn own_folders(&self) -> Result<(), CacheError> {
        for folder in FOLDERS {
            own_folder(&self.root.join(folder))?;
        }
        Ok(())
    }

    /// Makes the folders that are missing.
    pub fn make_folders(&self) -> Result<(), CacheError> {
        for folder in FOLDERS {
            let path = self.root.join(folder);
            fs::create_dir_all(&path).at("create the cache folder", &path)?;
        }
        Ok(())
    }

    /// Says what the folder is, where nothing does yet. The owner has its lease, so that no collection takes the files
    /// for a dead one's.
    pub fn sign(&self) -> Result<(), CacheError> {
        // Made now, as a full disk would have no room for it when a collection is needed most.
        open_lock(&self.gc_lock())?;
        if !self.has_format()? {
            self.write_file(&self.root.join("CACHEDIR.TAG"), TAG.as_bytes())?;
            self.write_file(&self.root.join("FORMAT"), format!("{FORMAT}\n").as_bytes())?;
        }
        Ok(())
    }

    /// Whether the folder says that it is a store of this format; an error if of another.
    fn has_format(&self) -> Result<bool, CacheError> {
        let path = self.root.join("FORMAT");
        match read_small(&path) {
            Ok(text) if text.trim_end() == FORMAT => Ok(true),
            Ok(text) => {
                let found = text.trim_end().chars().take(60).collect();
                Err(CacheError::Format { dir: self.root.clone(), found, expected: FORMAT })
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error).at("read", &path),
        }
    }

    /// Something in the folder that no unfinished opening of a store leaves, as a path within the folder.
    fn stranger(&self) -> io::Result<Option<PathBuf>> {
        for entry in fs::read_dir(&self.root)? {
            let entry = entry?;
            let (name, path) = (entry.file_name(), entry.path());
            let kind = entry.file_type()?;
            let known = name.to_str().unwrap_or_default();
            let own = match known {
                "FORMAT" => kind.is_file(), // just written, as it was not there before
                "CACHEDIR.TAG" => kind.is_file() && read_small(&path).is_ok_and(|text| text == TAG),
                "gc.lock" => kind.is_file(),
                "lost+found" => kind.is_dir(),
                _ => kind.is_dir() && FOLDERS.contains(&known),
            };
            if !own {
                return Ok(Some(name.into()));
            }
            if !FOLDERS.contains(&known) {
                continue;
            }
            for inner in fs::read_dir(&path)? {
                let inner = inner?;
                let text = inner.file_name();
                let text = text.to_str().unwrap_or_default();
                let own = match known {
                    "leases" => lease_owner(text).is_some(),
                    "tmp" => tmp_owner(text).is_some(),
                    "locks" => text == "claims",
                    _ => false,
                };
                if !(own && inner.file_type()?.is_file()) {
                    return Ok(Some(Path::new(&name).join(inner.file_name())));
                }
            }
        }
        Ok(None)
    }

    pub fn folder(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    pub fn gc_lock(&self) -> PathBuf {
        self.root.join("gc.lock")
    }

    /// The lease file of an owner.
    pub fn lease(&self, owner: &str) -> PathBuf {
        self.root.join("leases").join(format!("{owner}.lease"))
    }

    pub fn blob(&self, digest: &Digest) -> PathBuf {
        let name = digest.to_string();
        self.root.join("blobs").join(&name[..2]).join(name)
    }

    /// Whether a large blob's folder is there and the store's own: what lies behind a link is of somebody else. Each
    /// folder is looked at once, which is enough for reading, as content is checked; who moves files looks anew.
    pub fn has_own_folder(&self, digest: &Digest) -> bool {
        let known = &self.own_blobs[usize::from(digest.hash[0])];
        if known.load(Ordering::Relaxed) {
            return true;
        }
        let own = self.blob(digest).parent().is_some_and(is_own_folder);
        known.store(own, Ordering::Relaxed);
        own
    }

    /// A name in `tmp/` that nobody else uses.
    pub fn tmp(&self) -> PathBuf {
        let n = self.next_tmp.fetch_add(1, Ordering::Relaxed);
        self.root.join("tmp").join(format!("{}.{n}", self.owner))
    }

    /// Writes a small file whole and durably: temporary file, sync, rename, sync of the folder. The owner has its
    /// lease.
    pub fn write_file(&self, path: &Path, bytes: &[u8]) -> Result<(), CacheError> {
        let tmp = self.tmp();
        let written = File::create_new(&tmp)
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
            .and_then(|()| network::rename(&tmp, path));
        if written.is_err() {
            let _ = fs::remove_file(&tmp); // the first error is the one to report
        }
        written.at("write", path)?;
        sync_dir(path.parent().unwrap_or(&self.root)).at("sync the folder of", path)
    }
}

/// Whether a text has the form of an owner's name: `<process>-<16 hexadecimal digits>`.
pub(crate) fn is_owner(text: &str) -> bool {
    let hex = |c: u8| c.is_ascii_digit() || (b'a'..=b'f').contains(&c);
    text.split_once('-')
        .is_some_and(|(process, random)| is_number(process) && random.len() == 16 && random.bytes().all(hex))
}

/// Whether a text is a number as this program writes it.
pub(crate) fn is_number(text: &str) -> bool {
    let digits = !text.is_empty() && text.len() <= 20 && text.bytes().all(|c| c.is_ascii_digit());
    digits && (text == "0" || !text.starts_with('0'))
}

/// The owner of a lease file of this name.
pub(crate) fn lease_owner(name: &str) -> Option<&str> {
    name.strip_suffix(".lease").filter(|owner| is_owner(owner))
}

/// The owner of a temporary file of this name.
pub(crate) fn tmp_owner(name: &str) -> Option<&str> {
    let (owner, number) = name.split_once('.')?;
    (is_owner(owner) && is_number(number)).then_some(owner)
}

/// Makes the names in `dir` durable.
pub(crate) fn sync_dir(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}

/// Whether the folder is there; refuses a link in its place.
pub(crate) fn own_folder(path: &Path) -> Result<bool, CacheError> {
    match fs::symlink_metadata(path) {
        Ok(meta) if meta.is_dir() => Ok(true),
        Ok(_) => Err(CacheError::InTheWay { path: path.to_owned() }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error).at("look at", path),
    }
}

/// Whether the folder is there, and no link.
pub(crate) fn is_own_folder(path: &Path) -> bool {
    own_folder(path).unwrap_or(false)
}

/// Opens a folder that is no link, to name files in it however its own name changes meanwhile.
pub(crate) fn open_folder(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW | libc::O_DIRECTORY).open(path)
}

/// Opens a file for reading. A link, a pipe, a device or a folder of that name is as good as no file.
pub(crate) fn open_plain(path: &Path) -> io::Result<File> {
    let strange = || io::Error::new(io::ErrorKind::NotFound, "no plain file");
    // Opening a pipe would wait for a writer.
    let opened = OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path);
    let file = opened.map_err(|error| if error.raw_os_error() == Some(libc::ELOOP) { strange() } else { error })?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(strange()) }
}

/// Opens a file to be locked, making it if it is missing.
pub(crate) fn open_lock(path: &Path) -> Result<File, CacheError> {
    let mut options = OpenOptions::new();
    options.create(true).truncate(false).write(true).custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK);
    options.open(path).at("open the lock", path)
}

/// The text of a file that holds a line or two, and no more of it.
pub(crate) fn read_small(path: &Path) -> io::Result<String> {
    let mut bytes = Vec::new();
    open_plain(path)?.take(SMALL_FILE).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Names in `dir` of the entries that `wanted` takes, sorted. A folder that does not exist has none.
fn list(dir: &Path, wanted: impl Fn(fs::FileType) -> bool) -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    match fs::read_dir(dir) {
        Ok(entries) => {
            for entry in entries {
                let entry = entry?;
                let wanted = match entry.file_type() {
                    Ok(kind) => wanted(kind),
                    Err(error) if network::is_gone(&error) => false,
                    Err(error) => return Err(error),
                };
                if wanted && let Ok(name) = entry.file_name().into_string() {
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

/// Names of the files in `dir`, sorted; links and the like are left out. A folder that does not exist has none.
pub(crate) fn names(dir: &Path) -> io::Result<Vec<String>> {
    list(dir, |kind| kind.is_file())
}

/// Every large blob's digest and path, sorted; what is not named after a digest, as `Layout::blob` does, is left out.
pub(crate) fn loose_blobs(root: &Path) -> io::Result<Vec<(Digest, PathBuf)>> {
    let blobs = root.join("blobs");
    let mut found = Vec::new();
    for start in list(&blobs, |kind| kind.is_dir())? {
        let folder = blobs.join(&start);
        for name in names(&folder)? {
            if let Ok(digest) = name.parse::<Digest>()
                && start.len() == 2
                && name.starts_with(&start)
            {
                found.push((digest, folder.join(name)));
            }
        }
    }
    Ok(found)
}
