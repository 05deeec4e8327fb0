//! An upstream: immutable files whose names are the digests of their contents, in a directory or an object store.

use crate::{
    Address, PublicKey, SecretKey, UpstreamError,
    error::{At, Failure},
    folder::{Folder, read_at, read_plain},
    index::{Contents, MOST_INDEX},
    objects::Objects,
    sign::MOST_BYTES as MOST_SIGNATURE,
    traffic::{Reads, Traffic},
};
use std::{
    collections::{BTreeSet, HashSet},
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
    thread,
};
use tauflow_cache::Digest;
use tempfile::NamedTempFile;

const FORMAT: &str = "tauflow-upstream 1";
/// More than the file `UPSTREAM` holds, and most bytes of a list of indices.
const SMALL_FILE: u64 = 4096;
const MOST_LIST: u64 = 64 << 20;
/// Names that belong to an upstream. Another machine may be making it, too.
const OWN: [&str; 6] = ["UPSTREAM", "LIST", "packs", "jobs", "tmp", "lost+found"];
/// Bytes at which a pack is sealed and another begun. In an object store it is one request, and must fit in memory.
const FULL_PACK: u64 = 256 << 20;
const FULL_OBJECT: u64 = 64 << 20;
/// Most bytes of a note.
const MOST_NOTE: u64 = 1 << 30;
/// Indices that are read at the same time.
const AT_ONCE: usize = 8;

/// Sealed packs, in a directory or an object store.
#[derive(Debug)]
pub struct Upstream {
    place: Place,
    /// Where indices of an object store are kept on this machine.
    kept: Option<PathBuf>,
    /// The key that must have signed an index.
    pinned: Option<PublicKey>,
    /// The key that signs indices.
    signing: Option<SecretKey>,
}

#[derive(Debug)]
enum Place {
    Folder(Folder),
    Objects(Box<Objects>),
}

/// A file that is being written.
pub(crate) enum Draft {
    File(NamedTempFile),
    Chunks(Vec<Vec<u8>>),
}

impl Draft {
    pub fn add(&mut self, bytes: Vec<u8>) -> Result<(), UpstreamError> {
        match self {
            Self::File(file) => file.write_all(&bytes).at("write", file.path()),
            Self::Chunks(chunks) => {
                chunks.push(bytes);
                Ok(())
            }
        }
    }
}

/// Receives each index: its bytes, or why they are not used.
pub(crate) type EachIndex<'a> = dyn FnMut(&Digest, Result<Vec<u8>, String>) + 'a;

/// A pack that is open for reading.
pub(crate) struct Pack {
    /// The digest by which it is named.
    pub digest: Digest,
    from: From,
}

enum From {
    File(File, u64),
    Object(Reads),
}

impl Upstream {
    /// Opens an upstream for reading.
    ///
    /// # Errors
    /// When it cannot be read, or is no upstream of this format.
    pub fn open(address: &Address) -> Result<Self, UpstreamError> {
        let upstream = Self::at(address)?;
        upstream.check()?;
        Ok(upstream)
    }

    /// Opens an upstream for writing, and makes one in a folder that is missing or empty, or under a new prefix.
    ///
    /// # Errors
    /// As [`open`](Self::open), or when it cannot be written.
    pub fn create(address: &Address) -> Result<Self, UpstreamError> {
        let upstream = Self::at(address)?;
        if let Place::Folder(folder) = &upstream.place {
            fs::create_dir_all(folder.root()).at("create the directory", folder.root())?;
        }
        let marker = upstream.small("UPSTREAM")?;
        if marker.is_none() {
            let names = match &upstream.place {
                Place::Folder(folder) => folder.names("")?,
                Place::Objects(objects) => objects.names()?,
            };
            let is_own =
                |name: &String| OWN.contains(&name.as_str()) || name.starts_with("packs/") || name.starts_with("jobs/");
            if !names.iter().all(is_own) {
                return Err(UpstreamError::NotUpstream { place: upstream.name() });
            }
        }
        if let Place::Folder(folder) = &upstream.place {
            folder.make()?;
        }
        if marker.is_none() {
            upstream.write("UPSTREAM", format!("{FORMAT}\n").into_bytes())?;
        }
        upstream.check()?;
        Ok(upstream)
    }

    fn at(address: &Address) -> Result<Self, UpstreamError> {
        let place = match address {
            Address::Folder(folder) => Place::Folder(Folder::new(folder)),
            Address::Objects(at) => Place::Objects(Box::new(Objects::new(at)?)),
        };
        Ok(Self { place, kept: None, pinned: None, signing: None })
    }

    /// Keeps the indices of an object store below a folder of this machine, so that each is read once. It makes no
    /// parent folder. Indices that are gone from the upstream are deleted.
    #[must_use]
    pub fn keeping(self, folder: &Path) -> Self {
        let kept = match &self.place {
            Place::Folder(_) => None,
            Place::Objects(objects) => {
                let name = blake3::hash(objects.at().to_string().as_bytes()).to_hex();
                Some(folder.join(&name[..16]))
            }
        };
        Self { kept, ..self }
    }

    /// Uses only indices that this key has signed. Others are misses with a note.
    #[must_use]
    pub fn pinned(self, key: Option<PublicKey>) -> Self {
        Self { pinned: key, ..self }
    }

    /// Signs the indices that are written. Only indices with a signature of this key count as there.
    ///
    /// # Errors
    /// Never for a key that was read or made.
    pub fn signing(self, key: SecretKey) -> Result<Self, UpstreamError> {
        Ok(Self { pinned: Some(key.public()?), signing: Some(key), ..self })
    }

    fn check(&self) -> Result<(), UpstreamError> {
        let Some(text) = self.small("UPSTREAM")? else {
            return Err(UpstreamError::NotUpstream { place: self.name() });
        };
        let text = String::from_utf8_lossy(&text);
        if text.trim_end() == FORMAT {
            return Ok(());
        }
        let found = text.trim_end().chars().take(60).collect();
        Err(UpstreamError::Format { place: self.name(), found, expected: FORMAT })
    }

    fn small(&self, name: &str) -> Result<Option<Vec<u8>>, UpstreamError> {
        match &self.place {
            Place::Folder(folder) => folder.small(name, SMALL_FILE),
            Place::Objects(objects) => objects.small(name),
        }
    }

    /// Writes a small file, which may change.
    fn write(&self, name: &str, content: Vec<u8>) -> Result<(), UpstreamError> {
        match &self.place {
            Place::Folder(folder) => folder.write(name, &content),
            // Who makes an upstream at the same time writes the same marker.
            Place::Objects(objects) if name == "UPSTREAM" => objects.seal(name, vec![content]),
            Place::Objects(objects) => objects.replace(name, content),
        }
    }

    /// Writes a note: a small file below `jobs/`, which may change. Machines that share nothing else tell each other
    /// by notes what is to be done.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put_note(&self, name: &str, content: Vec<u8>) -> Result<(), UpstreamError> {
        let name = format!("jobs/{name}");
        if let Place::Folder(folder) = &self.place {
            let path = folder.path(&name);
            let above = path.parent().unwrap_or(folder.root());
            fs::create_dir_all(above).at("create the directory", above)?;
        }
        self.write(&name, content)
    }

    /// Reads a note, if it is there.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn note(&self, name: &str) -> Result<Option<Vec<u8>>, UpstreamError> {
        let name = format!("jobs/{name}");
        match &self.place {
            Place::Folder(folder) => folder.small(&name, MOST_NOTE),
            Place::Objects(objects) => objects.small(&name),
        }
    }

    /// Deletes notes. A note that cannot be deleted only takes space.
    pub fn delete_notes(&self, names: &[String]) {
        for name in names {
            let name = format!("jobs/{name}");
            match &self.place {
                Place::Folder(folder) => folder.delete(&name),
                Place::Objects(objects) => objects.delete(&name),
            }
        }
    }

    /// Its directory or URL.
    pub fn name(&self) -> String {
        match &self.place {
            Place::Folder(folder) => folder.root().display().to_string(),
            Place::Objects(objects) => objects.at().to_string(),
        }
    }

    /// Whether it is a directory whose file system may show late what other machines write.
    pub(crate) fn lists_late(&self) -> bool {
        matches!(&self.place, Place::Folder(folder) if tauflow_cache::network(folder.root()).is_some())
    }

    /// Requests so far; none for a directory.
    pub fn traffic(&self) -> Option<Traffic> {
        match &self.place {
            Place::Folder(_) => None,
            Place::Objects(objects) => Some(objects.traffic()),
        }
    }

    /// Reads all indices, without their records.
    ///
    /// # Errors
    /// When the upstream cannot be listed, or not be reached while it is read.
    pub fn contents(&self) -> Result<Contents, UpstreamError> {
        Contents::read(self)
    }

    /// The path or URL of a file for a content.
    pub(crate) fn file(&self, digest: &Digest, extension: &str) -> String {
        let name = format!("packs/{digest}.{extension}");
        match &self.place {
            Place::Folder(folder) => folder.path(&name).display().to_string(),
            Place::Objects(objects) => objects.url(&name),
        }
    }

    /// The digests by which indices are named, sorted. Files of other names are left out.
    pub(crate) fn indices(&self) -> Result<Vec<Digest>, UpstreamError> {
        let names = match &self.place {
            Place::Folder(folder) => {
                let mut names = folder.names("packs")?;
                names.retain(|name| name.ends_with(".index") && folder.is_file(&format!("packs/{name}")));
                names
            }
            Place::Objects(objects) if objects.is_web() => {
                let list = objects.small("LIST")?.unwrap_or_default();
                String::from_utf8_lossy(&list).lines().map(str::to_owned).collect()
            }
            Place::Objects(objects) => objects.packs()?.into_iter().map(|(name, _)| name).collect(),
        };
        let digest = |name: &String| name.strip_suffix(".index")?.parse().ok();
        let found: BTreeSet<Digest> = names.iter().filter_map(digest).collect();
        self.forget(&found);
        Ok(found.into_iter().collect())
    }

    /// The packs that have the size that their name says; none for a web server, which cannot list.
    pub(crate) fn packs(&self) -> Result<Option<HashSet<Digest>>, UpstreamError> {
        let files: Vec<(String, u64)> = match &self.place {
            Place::Folder(folder) => {
                let sized = |name: String| {
                    let size = fs::symlink_metadata(folder.path(&format!("packs/{name}"))).ok()?.len();
                    Some((name, size))
                };
                folder.names("packs")?.into_iter().filter(|name| name.ends_with(".pack")).filter_map(sized).collect()
            }
            Place::Objects(objects) if objects.is_web() => return Ok(None),
            Place::Objects(objects) => objects.packs()?,
        };
        let whole = |(name, size): &(String, u64)| {
            let digest: Digest = name.strip_suffix(".pack")?.parse().ok()?;
            (digest.size == *size).then_some(digest)
        };
        Ok(Some(files.iter().filter_map(whole).collect()))
    }

    /// Writes the list of indices, by which a web server can serve this upstream. Machines that write it at the same
    /// time may leave each other's new indices out; the next push adds them.
    pub(crate) fn list(&self, written: &[Digest]) -> Result<(), UpstreamError> {
        let mut all: BTreeSet<Digest> = self.indices()?.into_iter().collect();
        all.extend(written);
        let text: String = all.iter().map(|digest| format!("{digest}.index\n")).collect();
        if text.len() as u64 > MOST_LIST { Ok(()) } else { self.write("LIST", text.into_bytes()) }
    }

    /// Deletes kept indices that are not in the upstream any more.
    fn forget(&self, listed: &BTreeSet<Digest>) {
        let Some(kept) = &self.kept else { return };
        for entry in fs::read_dir(kept).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let plain = name.to_str().map(|name| name.strip_suffix(".minisig").unwrap_or(name));
            let digest = plain.and_then(|name| name.strip_suffix(".index")?.parse().ok());
            if digest.is_some_and(|digest| !listed.contains(&digest)) {
                // A file that stays costs room and nothing else.
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    /// The bytes of an index, or why they are not what its name says, or not signed as they should be.
    pub(crate) fn index(&self, digest: &Digest) -> Result<Vec<u8>, Failure> {
        let bytes = self.unsigned(digest)?;
        let Some(key) = &self.pinned else { return Ok(bytes) };
        let wrong = |what: &str| {
            let file = self.file(digest, "index");
            Failure::Unsigned(format!(
                "the sealed pack with index `{file}` {what} the key {key}; its results are not used"
            ))
        };
        let name = format!("{digest}.index.minisig");
        let kept = self.kept.as_ref().map(|kept| kept.join(&name));
        if let Some(signature) = kept.as_ref().and_then(|path| read_plain(path, MOST_SIGNATURE).ok())
            && key.verifies(&bytes, &signature)
        {
            return Ok(bytes);
        }
        match self.fetched(&name, MOST_SIGNATURE) {
            Ok(signature) if key.verifies(&bytes, &signature) => {
                if let Some(path) = kept {
                    keep(&path, &signature);
                }
                Ok(bytes)
            }
            Ok(_) => Err(wrong("has a signature that is not one of")),
            Err(Failure::File(_) | Failure::Unsigned(_)) => Err(wrong("has no signature of")),
            Err(lost @ Failure::Place(_)) => Err(lost),
        }
    }

    fn unsigned(&self, digest: &Digest) -> Result<Vec<u8>, Failure> {
        let wrong = |what: &str| Failure::File(format!("index `{}` {what}; it is ignored", self.file(digest, "index")));
        if digest.size > MOST_INDEX {
            return Err(wrong("is larger than any that this program writes"));
        }
        let name = format!("{digest}.index");
        let kept = self.kept.as_ref().map(|kept| kept.join(&name));
        if let Some(bytes) = kept.as_ref().and_then(|path| read_plain(path, digest.size).ok())
            && Digest::of(&bytes) == *digest
        {
            return Ok(bytes);
        }
        let bytes = self.fetched(&name, MOST_INDEX).map_err(|failure| match failure {
            Failure::File(why) | Failure::Unsigned(why) => wrong(&format!("cannot be read ({why})")),
            lost @ Failure::Place(_) => lost,
        })?;
        if Digest::of(&bytes) != *digest {
            return Err(wrong("is damaged or truncated"));
        }
        if let Some(path) = kept {
            keep(&path, &bytes);
        }
        Ok(bytes)
    }

    /// A whole file in `packs`, or why it cannot be read.
    fn fetched(&self, name: &str, most: u64) -> Result<Vec<u8>, Failure> {
        let name = format!("packs/{name}");
        match &self.place {
            Place::Folder(folder) => {
                read_plain(&folder.path(&name), most).map_err(|error| Failure::File(error.to_string()))
            }
            Place::Objects(objects) => objects.whole(&name),
        }
    }

    /// Reads indices in order, several at a time. It ends early where the upstream fails.
    ///
    /// # Errors
    /// When the upstream fails, or `each` does.
    pub(crate) fn each_index(&self, digests: &[Digest], each: &mut EachIndex<'_>) -> Result<(), UpstreamError> {
        let at_once = if matches!(self.place, Place::Folder(_)) { 1 } else { AT_ONCE };
        for some in digests.chunks(at_once) {
            let read: Vec<Result<Vec<u8>, Failure>> = thread::scope(|scope| {
                let started: Vec<_> = some.iter().map(|digest| scope.spawn(|| self.index(digest))).collect();
                let lost = || Failure::File("an index was not read, because the program failed; it is ignored".into());
                started.into_iter().map(|one| one.join().unwrap_or_else(|_| Err(lost()))).collect()
            });
            for (digest, read) in some.iter().zip(read) {
                match read {
                    Ok(bytes) => each(digest, Ok(bytes)),
                    // An index without a signature is written again with one.
                    Err(Failure::Unsigned(_)) if self.signing.is_some() => {}
                    Err(Failure::File(note) | Failure::Unsigned(note)) => each(digest, Err(note)),
                    Err(Failure::Place(why)) => {
                        return Err(UpstreamError::Remote { action: "read", place: self.name(), why });
                    }
                }
            }
        }
        Ok(())
    }

    /// Opens a pack, or says why that fails.
    pub(crate) fn pack(&self, digest: &Digest) -> Result<Pack, Failure> {
        let from = match &self.place {
            Place::Folder(folder) => {
                let (file, len) = folder.pack(&format!("packs/{digest}.pack"))?;
                From::File(file, len)
            }
            Place::Objects(_) => From::Object(Reads::default()),
        };
        Ok(Pack { digest: *digest, from })
    }

    /// A blob of a pack, or why it cannot be had.
    pub(crate) fn blob(&self, pack: &Pack, offset: u64, digest: &Digest) -> Result<Vec<u8>, Failure> {
        let file = self.file(&pack.digest, "pack");
        let wrong = |what: &str| Failure::File(format!("pack `{file}` {what}; blob {} is a miss", digest.short()));
        // Memory is taken only for bytes that are there.
        let len = if let From::File(_, len) = &pack.from { *len } else { pack.digest.size };
        let Some(end) = offset.checked_add(digest.size).filter(|end| *end <= len) else {
            return Err(wrong("is truncated"));
        };
        let bytes = match (&pack.from, &self.place) {
            (From::File(file, _), _) => {
                read_at(file, offset, digest.size).map_err(|error| wrong(&format!("cannot be read ({error})")))?
            }
            (From::Object(reads), Place::Objects(objects)) if digest.size > 0 => {
                match objects.read(&pack.digest, reads, offset..end, self.kept.as_deref()) {
                    Ok(bytes) => bytes,
                    Err(lost @ Failure::Place(_)) => return Err(lost),
                    Err(failure) => return Err(wrong(&format!("cannot be read ({})", failure.note()))),
                }
            }
            (From::Object(_), _) => Vec::new(),
        };
        if Digest::of(&bytes) == *digest { Ok(bytes) } else { Err(wrong("is damaged")) }
    }

    /// Bytes at which a pack is sealed.
    pub(crate) fn full_pack(&self) -> u64 {
        if matches!(self.place, Place::Folder(_)) { FULL_PACK } else { FULL_OBJECT }
    }

    /// A file to be written and then sealed.
    pub(crate) fn draft(&self) -> Result<Draft, UpstreamError> {
        match &self.place {
            Place::Folder(folder) => folder.temporary().map(Draft::File),
            Place::Objects(_) => Ok(Draft::Chunks(Vec::new())),
        }
    }

    /// Makes an index visible, after its signature.
    pub(crate) fn seal_index(&self, index: Vec<u8>) -> Result<Digest, UpstreamError> {
        let digest = Digest::of(&index);
        if let Some(key) = &self.signing {
            // Another key may have signed it, too. The last signature stays.
            let signature = key.sign(&index, &format!("tauflow index {digest}"));
            self.write(&format!("packs/{digest}.index.minisig"), signature.into_bytes())?;
        }
        let mut draft = self.draft()?;
        draft.add(index)?;
        self.seal(draft, &digest, "index")?;
        Ok(digest)
    }

    /// Makes a complete file visible under its digest. A file of that name already has the same content.
    pub(crate) fn seal(&self, draft: Draft, digest: &Digest, extension: &str) -> Result<(), UpstreamError> {
        let name = format!("packs/{digest}.{extension}");
        match (draft, &self.place) {
            (Draft::File(file), Place::Folder(folder)) => folder.seal(file, &name),
            (Draft::Chunks(chunks), Place::Objects(objects)) => objects.seal(&name, chunks),
            (Draft::File(_), Place::Objects(_)) | (Draft::Chunks(_), Place::Folder(_)) => {
                let of_another = std::io::Error::other("it was begun in a different upstream");
                Err(of_another).at("write", Path::new(&name))
            }
        }
    }
}

/// Keeps an index on this machine. One that cannot be written is read from the upstream again.
fn keep(path: &Path, bytes: &[u8]) {
    let write = || -> std::io::Result<()> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let above = folder.parent().unwrap_or(Path::new("."));
        for folder in [above, folder] {
            match fs::create_dir(folder) {
                Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => return Err(error),
                _ => {}
            }
        }
        let mut file = NamedTempFile::new_in(folder)?;
        file.write_all(bytes)?;
        file.persist(path).map(drop).map_err(|error| error.error)
    };
    let _ = write();
}
