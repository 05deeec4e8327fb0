//! Index files: the content of a segment, so that opening a store need not read it.
//!
//! `<segment>.idx` covers its segment up to an offset; the rest is scanned. It is a cache: a damaged or missing index
//! file only costs time, and all may be deleted.

use crate::{
    Key,
    codec::{Fields, Put},
    index::{BlobAt, Index, RecordAt},
    layout::{Layout, open_plain},
    network,
    record::MOST_GENERATION,
    segment::{MAX_BODY, MAX_PACKED, RECORD_HEADER, Sort},
};
use std::{
    collections::HashMap,
    fs::{self, File},
    hash::BuildHasher as _,
    io::{self, Read, Write},
    path::Path,
};

const MAGIC: &[u8; 8] = b"tauidx 2";
/// Bytes of an index file beside its entries and names, and more.
const SLACK: u64 = 128;
/// Bytes of the largest index file: more than a segment at its limit needs.
const LARGEST: u64 = 512 << 20;
/// Bytes of a packed blob's entry: hash, offset, size.
const BLOB: usize = 48;
/// Bytes of a record's entry: see `record`.
const RECORD: usize = 96;
/// Parts of a map that are filled one after the other: each fits the processor's caches.
const PARTS: usize = 256;
/// Entries from which that is worth it.
const MANY: usize = 4096;

fn path_of(segment: &Path) -> std::path::PathBuf {
    segment.with_added_extension("idx")
}

/// Fills the index from the segment's index file, if there is a good one.
pub(crate) fn load(index: &mut Index, number: u32) {
    let segment = &index.segments[number as usize];
    let (sort, path) = (segment.sort, segment.path.clone());
    let Ok((bytes, there)) = read(&path) else { return };
    let Some((body, check)) = bytes.split_last_chunk::<32>() else { return };
    if blake3::hash(body).as_bytes() != check {
        return;
    }
    // The checksum was right, so what does not parse is of another version; the scan then starts at 0.
    let _ = fill(index, number, sort, there, Fields(body));
}

/// The bytes of a segment's index file, and how many the segment has.
fn read(segment: &Path) -> io::Result<(Vec<u8>, u64)> {
    let there = open_plain(segment)?.metadata()?.len();
    let file = open_plain(&path_of(segment))?;
    // An entry is shorter than its frame, so an index file that is longer than its segment is of another one.
    let most = there.saturating_add(SLACK).min(LARGEST);
    if file.metadata()?.len() > most {
        return Err(io::ErrorKind::InvalidData.into());
    }
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes)?;
    Ok((bytes, there))
}

fn fill(index: &mut Index, number: u32, sort: Sort, there: u64, mut fields: Fields<'_>) -> Option<()> {
    (fields.take(8)? == MAGIC).then_some(())?;
    let (scanned, committed, count) = (fields.u64()?, fields.u64()?, fields.u64()? as usize);
    if there < scanned {
        return None; // of another file of that name
    }
    // Later reads allocate the sizes given here, so the bytes must exist.
    let fits = |offset: u64, size: u64| offset.checked_add(size).is_some_and(|end| end <= scanned);
    let mut names = Vec::new();
    for _ in 0..fields.u32()? {
        names.push(index.intern(fields.text()?));
    }
    match sort {
        Sort::Pack => {
            let entries = fields.take(count.checked_mul(BLOB)?)?;
            index.blobs.reserve(count);
            let parsed = entries.chunks_exact(BLOB).map(|entry| {
                let mut entry = Fields(entry);
                let (hash, offset, size) = (entry.array::<32>()?, entry.u64()?, entry.u64()?);
                (size <= MAX_PACKED && fits(offset, size)).then_some((hash, BlobAt { segment: number, offset, size }))
            });
            let hasher = index.blobs.hasher().clone();
            let found = by_place(index.blobs.capacity(), count, parsed, |(hash, _)| hasher.hash_one(hash))?;
            found.for_each(|(hash, at)| index.insert_blob(hash, at));
        }
        Sort::Log => {
            let entries = fields.take(count.checked_mul(RECORD)?)?;
            index.records.reserve(count);
            let parsed = entries.chunks_exact(RECORD).map(|entry| {
                let (namespace, key, at) = record(Fields(entry), number, &names)?;
                let len = u64::from(at.len);
                (len <= MAX_BODY && fits(at.offset, RECORD_HEADER + len)).then_some(((namespace, key), at))
            });
            let hasher = index.records.hasher().clone();
            let found = by_place(index.records.capacity(), count, parsed, |(slot, _)| hasher.hash_one(slot))?;
            found.for_each(|(slot, at)| index.insert_record_at(slot, at));
        }
    }
    let segment = &mut index.segments[number as usize];
    (segment.scanned, segment.committed) = (scanned, committed.min(scanned));
    Some(())
}

/// Entries in about the order of their places in a map of this capacity.
///
/// Hashes are in no order, and a large map is read from memory for each of them. In the order of places, what one entry
/// has brought into the caches serves those after it. A guess at how the map is laid out: a wrong one costs time alone.
fn by_place<T>(
    capacity: usize,
    count: usize,
    entries: impl Iterator<Item = Option<T>>,
    hash_of: impl Fn(&T) -> u64,
) -> Option<impl Iterator<Item = T>> {
    let places = (capacity as u64).saturating_mul(8).div_ceil(7).next_power_of_two();
    let many = if count < MANY { 1 } else { PARTS };
    let mut parts: Vec<Vec<T>> = (0..many).map(|_| Vec::with_capacity(count / many * 9 / 8)).collect();
    for entry in entries {
        let entry = entry?;
        let place = hash_of(&entry) & (places - 1);
        parts[(place / places.div_ceil(many as u64)) as usize].push(entry);
    }
    Some(parts.into_iter().flatten())
}

fn record(mut entry: Fields<'_>, segment: u32, names: &[u32]) -> Option<(u32, Key, RecordAt)> {
    let key = Key(entry.array()?);
    let namespace = *names.get(entry.u32()? as usize)?;
    let label = *names.get(entry.u32()? as usize)?;
    let at = RecordAt {
        segment,
        label,
        generation: entry.u32()?,
        len: entry.u32()?,
        offset: entry.u64()?,
        origin: entry.u64()?,
        sum: entry.u64()?,
        wall_us: entry.u64()?,
        bytes: entry.u64()?,
        when: entry.u64()?,
    };
    (at.generation <= MOST_GENERATION).then_some((namespace, key, at))
}

/// Writes the segment's index file. Failure is of no consequence. A damaged segment gets none: it would hide that.
pub(crate) fn save(index: &Index, number: u32, layout: &Layout) {
    let segment = &index.segments[number as usize];
    if !layout.writes || segment.damaged > 0 {
        return;
    }
    let (mut names, mut entries, mut count): (Vec<u32>, Vec<u8>, u64) = Default::default();
    match segment.sort {
        Sort::Pack => {
            let mut blobs: Vec<_> = index.blobs.iter().filter(|(_, at)| at.segment == number).collect();
            blobs.sort_unstable_by_key(|(hash, at)| (at.offset, **hash));
            for (hash, at) in blobs {
                entries.extend_from_slice(hash);
                entries.u64(at.offset);
                entries.u64(at.size);
                count += 1;
            }
        }
        Sort::Log => {
            let mut records: Vec<_> = index.records.iter().filter(|(_, at)| at.segment == number).collect();
            records.sort_unstable_by_key(|(slot, at)| (at.offset, **slot));
            // Each record may have a label of its own.
            let mut places: HashMap<u32, u32> = HashMap::new();
            let mut of_file = |name: u32| {
                *places.entry(name).or_insert_with(|| {
                    names.push(name);
                    names.len() as u32 - 1
                })
            };
            for ((namespace, key), at) in records {
                entries.extend_from_slice(&key.0);
                for value in [of_file(*namespace), of_file(at.label), at.generation, at.len] {
                    entries.u32(value);
                }
                for value in [at.offset, at.origin, at.sum, at.wall_us, at.bytes, at.when] {
                    entries.u64(value);
                }
                count += 1;
            }
        }
    }
    let mut body = MAGIC.to_vec();
    for value in [segment.scanned, segment.committed, count] {
        body.u64(value);
    }
    body.u32(names.len() as u32);
    names.iter().for_each(|name| body.text(index.name(*name)));
    body.extend_from_slice(&entries);
    let check = blake3::hash(&body);
    body.extend_from_slice(check.as_bytes());
    let tmp = layout.tmp();
    let written = File::create_new(&tmp)
        .and_then(|mut file| file.write_all(&body))
        .and_then(|()| network::rename(&tmp, &path_of(&segment.path)));
    if written.is_err() {
        let _ = fs::remove_file(&tmp); // gives the space back
    }
}
