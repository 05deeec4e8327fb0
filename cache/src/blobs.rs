//! Blobs: immutable byte strings. Reading returns the same bytes, or a miss.
//!
//! Small blobs are appended to a pack; large blobs are single files. They are visible at once, and durable when the
//! next commit returns.

use crate::{
    CacheError, Digest, Store,
    error::At,
    gc,
    index::BlobAt,
    layout::{open_plain, own_folder},
    lease::Use,
    network, quarantine,
    segment::{Appender, BLOB_HEADER, Sort, blob_frame},
    store::lock,
};
use std::{
    fs::{self, File},
    io::{self, Read, Seek, SeekFrom, Write},
    os::unix::fs::FileExt,
};

/// Blobs of at least this many bytes get a file of their own.
pub(crate) const LOOSE_FROM: u64 = 64 << 10;
/// Bytes from which a pack is closed and another begun.
pub(crate) const PACK_LIMIT: u64 = 256 << 20;

/// A blob above this size is read twice, the first time to see whether it is good, before memory is taken for it.
const READ_TWICE_FROM: u64 = 256 << 20;

/// The result of reading a place in a pack.
enum PackedRead {
    Whole(Vec<u8>),
    Damaged(Vec<u8>),
    /// The file is gone; the blob may be elsewhere.
    Moved,
}

impl Store {
    /// Stores a blob. Storing it again costs a look-up.
    ///
    /// # Errors
    /// When it cannot be written; what was stored before is not affected.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, CacheError> {
        self.put_unless_here(bytes).map(|(digest, _)| digest)
    }

    /// As [`put`](Self::put); says also whether the blob is new.
    ///
    /// # Errors
    /// As [`put`](Self::put).
    pub fn put_unless_here(&self, bytes: &[u8]) -> Result<(Digest, bool), CacheError> {
        let digest = Digest::of(bytes);
        if self.hold(&digest)? {
            self.rely_on([digest]);
            return Ok((digest, false));
        }
        self.writes()?;
        if digest.size < LOOSE_FROM {
            self.put_packed(&digest, bytes)?;
        } else {
            self.put_loose(&digest, bytes)?;
        }
        Ok((digest, true))
    }

    /// Reads a blob and checks it. `None` when it is missing, or damaged: then it goes to quarantine. A blob that only
    /// the [upstream](Self::look_beyond) has is copied.
    ///
    /// # Errors
    /// When a file that is there cannot be read.
    pub fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, CacheError> {
        if let Some(found) = self.get_now(digest)? {
            return Ok(Some(found));
        }
        match self.blob_beyond(digest)? {
            // Blobs that this store relies on can be part of a running collection, which restores them.
            None => {
                gc::wait_for_sweep(&self.layout);
                self.refresh()?;
                self.get_now(digest)
            }
            found => Ok(found),
        }
    }

    /// Reads several blobs, each as [`get`](Self::get) does. An upstream is asked for each one that is missing here.
    ///
    /// # Errors
    /// When a file that is there cannot be read.
    pub fn get_many(&self, digests: &[Digest]) -> Result<Vec<Option<Vec<u8>>>, CacheError> {
        let mut found = digests.iter().map(|digest| self.get_now(digest)).collect::<Result<Vec<_>, _>>()?;
        for (digest, blob) in digests.iter().zip(&mut found).filter(|(_, blob)| blob.is_none()) {
            *blob = self.blob_beyond(digest)?;
        }
        if found.iter().any(Option::is_none) {
            gc::wait_for_sweep(&self.layout);
            self.refresh()?;
            for (digest, blob) in digests.iter().zip(&mut found).filter(|(_, blob)| blob.is_none()) {
                *blob = self.get_now(digest)?;
            }
        }
        Ok(found)
    }

    /// `get`, but never waiting for a collection: for the collection itself.
    pub(crate) fn get_now(&self, digest: &Digest) -> Result<Option<Vec<u8>>, CacheError> {
        // Three rounds: where the index says, where a gc may have moved it, where another process may have put it.
        for _ in 0..3 {
            if let Some(at) = self.packed_at(digest) {
                match self.read_packed(digest, at)? {
                    PackedRead::Whole(bytes) => return Ok(Some(bytes)),
                    PackedRead::Damaged(bytes) => self.quarantine_packed(digest, at, &bytes),
                    PackedRead::Moved => self.refresh()?,
                }
                continue;
            }
            if let Some(bytes) = self.get_loose(digest)? {
                return Ok(Some(bytes));
            }
            if !self.refresh_on_miss() {
                break;
            }
        }
        Ok(None)
    }

    /// Whether the blob is there, without reading it, here or [beyond](Self::look_beyond). A gc of another process may
    /// take it right afterwards, unless this store put it or found it through a record.
    pub fn contains(&self, digest: &Digest) -> bool {
        self.is_here(digest) || self.is_beyond(digest)
    }

    /// Whether the blob is in this store itself.
    pub(crate) fn is_here(&self, digest: &Digest) -> bool {
        let here = || self.packed_at(digest).is_some() || self.is_loose(digest);
        here() || (self.refresh_on_miss() && here())
    }

    pub(crate) fn packed_at(&self, digest: &Digest) -> Option<BlobAt> {
        self.index().blobs.get(&digest.hash).copied().filter(|at| at.size == digest.size)
    }

    /// Notes that this store relies on the blob, *then* looks whether it is there.
    fn hold(&self, digest: &Digest) -> Result<bool, CacheError> {
        if let Some(at) = self.packed_at(digest) {
            if self.is_own(at.segment) {
                return Ok(true);
            }
            let path = self.index().segments[at.segment as usize].path.clone();
            self.note([Use::Blob(digest.hash)])?;
            if fs::metadata(path).is_ok() {
                return Ok(true);
            }
            self.refresh()?;
            return Ok(self.packed_at(digest).is_some());
        }
        if digest.size < LOOSE_FROM {
            return Ok(false); // never a file of its own
        }
        // For a blob that is about to be written, too: no gc takes it before its record is there.
        self.note([Use::Blob(digest.hash)])?;
        Ok(self.is_loose(digest))
    }

    fn put_packed(&self, digest: &Digest, bytes: &[u8]) -> Result<(), CacheError> {
        let frame = blob_frame(&digest.hash, bytes);
        let mut packs = lock(&self.packs);
        if self.packed_at(digest).is_some_and(|at| self.is_own(at.segment)) {
            return Ok(()); // another thread was faster
        }
        if packs.appender.as_ref().is_some_and(|to| to.end > PACK_LIMIT || self.is_gone(to)) {
            packs.appender = None;
        }
        if packs.appender.is_none() {
            packs.appender = Some(self.start_segment(Sort::Pack)?);
        }
        let Some(to) = packs.appender.as_mut() else { return Ok(()) }; // set right above
        let offset = match to.append(&frame) {
            Ok(offset) => offset,
            Err((error, spoiled)) => {
                let path = to.path.clone();
                if spoiled {
                    packs.appender = None;
                }
                return Err(error).at("write a blob to", &path);
            }
        };
        let (segment, end, entry) = (to.segment, to.end, (to.path.clone(), to.file.clone()));
        if packs.dirty_packs.last().is_none_or(|(path, _)| *path != entry.0) {
            packs.dirty_packs.push(entry);
        }
        let mut index = self.index_mut();
        index.segments[segment as usize].scanned = end;
        index.insert_blob(digest.hash, BlobAt { segment, offset: offset + BLOB_HEADER, size: digest.size });
        Ok(())
    }

    /// Whether this instance writes the segment.
    pub(crate) fn is_own(&self, segment: u32) -> bool {
        self.index().segments[segment as usize].is_own()
    }

    /// Whether somebody removed the segment under its writer.
    pub(crate) fn is_gone(&self, to: &Appender) -> bool {
        self.index().segments[to.segment as usize].gone
    }

    fn put_loose(&self, digest: &Digest, bytes: &[u8]) -> Result<(), CacheError> {
        let path = self.layout.blob(digest);
        let folder = path.parent().unwrap_or(&self.layout.root); // a blob's path has one
        if !own_folder(folder)? {
            fs::create_dir_all(folder).at("create the folder", folder)?;
        }
        let tmp = self.layout.tmp();
        let written = File::create_new(&tmp)
            .and_then(|mut file| file.write_all(bytes))
            .and_then(|()| network::rename(&tmp, &path))
            .at("write the blob", &path);
        if written.is_err() {
            let _ = fs::remove_file(&tmp); // gives the space back; the first error is the one to report
            return written;
        }
        lock(&self.packs).dirty_loose.push(path);
        Ok(())
    }

    fn read_packed(&self, digest: &Digest, at: BlobAt) -> Result<PackedRead, CacheError> {
        let path = || self.index().segments[at.segment as usize].path.clone();
        let file = match self.segment_file(at.segment) {
            Ok(file) => file,
            Err(error) if network::is_gone(&error) => return Ok(PackedRead::Moved),
            Err(error) => return Err(error).at("open the pack", &path()),
        };
        let mut bytes = vec![0; at.size as usize];
        match file.read_exact_at(&mut bytes, at.offset) {
            Ok(()) if blake3::hash(&bytes).as_bytes() == &digest.hash => Ok(PackedRead::Whole(bytes)),
            Ok(()) => Ok(PackedRead::Damaged(bytes)),
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(PackedRead::Damaged(Vec::new())),
            Err(error) if network::is_gone(&error) => {
                // It was deleted while it was open here.
                self.forget_file(at.segment);
                Ok(PackedRead::Moved)
            }
            Err(error) => Err(error).at("read the pack", &path()),
        }
    }

    fn quarantine_packed(&self, digest: &Digest, at: BlobAt, bytes: &[u8]) {
        let mut index = self.index_mut();
        quarantine::packed(&self.layout, &index.segments[at.segment as usize].name, at.offset, bytes);
        index.mark_bad(&digest.hash, at);
    }

    fn get_loose(&self, digest: &Digest) -> Result<Option<Vec<u8>>, CacheError> {
        let path = self.layout.blob(digest);
        let read = match open_plain(&path) {
            Ok(_) if !self.layout.has_own_folder(digest) => return Ok(None),
            Ok(file) => read_blob(&file, 0, digest, true),
            Err(error) => Err(error),
        };
        match read {
            Ok(None) => {
                quarantine::loose(&self.layout, digest, &path);
                Ok(None)
            }
            Err(error) if network::is_gone(&error) => Ok(None),
            other => other.at("read the blob", &path),
        }
    }

    /// Whether a large blob's file is there, of the right size, in a folder of the store's own.
    pub(crate) fn is_loose(&self, digest: &Digest) -> bool {
        let there = fs::symlink_metadata(self.layout.blob(digest));
        there.is_ok_and(|meta| meta.is_file() && meta.len() == digest.size) && self.layout.has_own_folder(digest)
    }
}

/// Reads a blob from its place in a file, if it is good; `alone` when it is all of the file. Takes no more memory than
/// there are bytes, and much memory only for a blob that is known to be good.
pub(crate) fn read_blob(file: &File, offset: u64, digest: &Digest, alone: bool) -> io::Result<Option<Vec<u8>>> {
    let there = file.metadata()?.len();
    let Some(end) = offset.checked_add(digest.size) else { return Ok(None) };
    if end > there || (alone && end < there) {
        return Ok(None);
    }
    if digest.size > READ_TWICE_FROM && !is_good(file, offset, digest)? {
        return Ok(None);
    }
    let size = usize::try_from(digest.size).map_err(|_| io::ErrorKind::OutOfMemory)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(size).map_err(|_| io::ErrorKind::OutOfMemory)?;
    let mut from = file;
    from.seek(SeekFrom::Start(offset))?;
    from.take(digest.size).read_to_end(&mut bytes)?;
    Ok((Digest::of(&bytes) == *digest).then_some(bytes))
}

/// Whether a blob is good, found out by the piece.
fn is_good(file: &File, offset: u64, digest: &Digest) -> io::Result<bool> {
    let mut hasher = blake3::Hasher::new();
    let mut piece = vec![0; 1 << 20];
    let mut done = 0;
    while done < digest.size {
        let most = piece.len().min(usize::try_from(digest.size - done).unwrap_or(usize::MAX));
        let read = file.read_at(&mut piece[..most], offset + done)?;
        if read == 0 {
            return Ok(false);
        }
        hasher.update(&piece[..read]);
        done += read as u64;
    }
    Ok(hasher.finalize().as_bytes() == &digest.hash)
}
