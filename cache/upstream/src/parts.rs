//! Parts of packs that were read before they were needed. Blobs that an action reads lie in several places of a pack,
//! so their parts wait in a file that has no name, and no byte is read from the upstream twice.

use bytes::Bytes;
use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    fs::{self, File},
    ops::Range,
    os::unix::fs::FileExt as _,
    path::Path,
};
use tauflow_cache::Digest;

/// Bytes that wait in the file. Beyond that, all of them are forgotten.
const MOST_ON_DISK: u64 = 4 << 30;
/// Bytes that wait in memory, where there is no room on the disk.
const MOST_IN_MEMORY: usize = 128 << 20;

/// Where the bytes of a part are.
#[derive(Debug)]
enum Held {
    /// At this place of the file.
    File(u64),
    Memory(Bytes),
}

#[derive(Debug)]
struct Part {
    len: u64,
    held: Held,
}

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct Parts {
    /// By pack, and by the place where they begin.
    parts: HashMap<Digest, BTreeMap<u64, Part>>,
    /// The file, if one could be made, and its length.
    file: Option<(File, u64)>,
    /// Parts in memory, the oldest first.
    in_memory: VecDeque<(Digest, u64)>,
}

impl Parts {
    /// The bytes of a range, if one part has all of them.
    pub fn get(&mut self, pack: &Digest, range: &Range<u64>) -> Option<Vec<u8>> {
        let of_pack = self.parts.get_mut(pack)?;
        let (start, part) = of_pack.range(..=range.start).next_back()?;
        let (start, skip) = (*start, range.start - start);
        if range.end > start + part.len {
            return None;
        }
        let len = (range.end - range.start) as usize;
        match (&part.held, &self.file) {
            (Held::Memory(bytes), _) => Some(bytes[skip as usize..skip as usize + len].to_vec()),
            (Held::File(at), Some((file, _))) => {
                let mut bytes = vec![0; len];
                if file.read_exact_at(&mut bytes, at + skip).is_ok() {
                    return Some(bytes);
                }
                // It is read from the upstream again.
                of_pack.remove(&start);
                None
            }
            (Held::File(_), None) => None,
        }
    }

    /// Where to begin to read a place of a pack, so that nothing that waits is read again; none leaves it open.
    pub fn unread(&self, pack: &Digest, place: u64) -> Option<u64> {
        // A part may hold the first bytes that are wanted, but not all of them.
        let (start, part) = self.parts.get(pack)?.range(..=place).next_back()?;
        Some((start + part.len).min(place))
    }

    /// Keeps a part, in a file in this directory if possible.
    pub fn keep(&mut self, pack: Digest, start: u64, bytes: Bytes, folder: Option<&Path>) {
        let len = bytes.len() as u64;
        let held = match self.write(&bytes, folder) {
            Some(at) => Held::File(at),
            None => {
                self.in_memory.push_back((pack, start));
                Held::Memory(bytes)
            }
        };
        self.parts.entry(pack).or_default().insert(start, Part { len, held });
        while self.in_memory.len() > 1 && self.bytes_in_memory() > MOST_IN_MEMORY {
            if let Some((pack, start)) = self.in_memory.pop_front()
                && let Some(of_pack) = self.parts.get_mut(&pack)
            {
                of_pack.remove(&start);
            }
        }
    }

    fn bytes_in_memory(&self) -> usize {
        let part = |(pack, start): &(Digest, u64)| match self.parts.get(pack)?.get(start)?.held {
            Held::Memory(ref bytes) => Some(bytes.len()),
            Held::File(_) => None,
        };
        self.in_memory.iter().filter_map(part).sum()
    }

    /// The place of the file where these bytes are now, if they could be written.
    fn write(&mut self, bytes: &[u8], folder: Option<&Path>) -> Option<u64> {
        if self.file.as_ref().is_some_and(|(_, len)| *len + bytes.len() as u64 > MOST_ON_DISK) {
            *self = Self::default();
        }
        if self.file.is_none() {
            let folder = folder?;
            fs::create_dir_all(folder).ok()?;
            self.file = Some((tempfile::tempfile_in(folder).ok()?, 0));
        }
        let (file, len) = self.file.as_mut()?;
        file.write_all_at(bytes, *len).ok()?;
        let at = *len;
        *len += bytes.len() as u64;
        Some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_found_by_what_they_hold_on_disk_and_in_memory() {
        let folder = tempfile::tempdir().expect("a folder");
        let (one, two) = (Digest::of(b"one"), Digest::of(b"two"));
        for on_disk in [true, false] {
            let mut parts = Parts::default();
            let at = on_disk.then(|| folder.path().join("new"));
            let bytes: Vec<u8> = (0..=255).collect();
            parts.keep(one, 100, bytes.clone().into(), at.as_deref());
            parts.keep(one, 1000, bytes.into(), at.as_deref());
            assert_eq!(parts.file.is_some(), on_disk);
            assert_eq!(parts.get(&one, &(100..103)), Some(vec![0, 1, 2]));
            assert_eq!(parts.get(&one, &(1254..1256)), Some(vec![254, 255]));
            for (pack, range) in [(one, 99..101), (one, 355..357), (one, 500..501), (two, 100..101)] {
                assert_eq!(parts.get(&pack, &range), None, "{range:?}");
            }
            let unread = |place| parts.unread(&one, place);
            assert_eq!([unread(50), unread(200), unread(400), unread(1300)], [None, Some(200), Some(356), Some(1256)]);
        }
        // The file has no name.
        assert_eq!(fs::read_dir(folder.path().join("new")).expect("made").count(), 0);
    }

    #[test]
    fn memory_is_bounded() {
        let mut parts = Parts::default();
        let bytes = Bytes::from(vec![7; MOST_IN_MEMORY / 4]);
        for i in 0..9 {
            parts.keep(Digest::of(b"pack"), i * bytes.len() as u64, bytes.clone(), None);
        }
        assert_eq!(parts.in_memory.len(), 4);
        assert_eq!(parts.parts[&Digest::of(b"pack")].len(), 4);
    }
}
