//! Index files: what a segment holds, so that opening a store need not read it.
//!
//! `<segment>.idx` covers its segment up to an offset; what lies beyond is
//! scanned.  It is a cache of the segment: a damaged or missing one costs time,
//! and any may be deleted.

use crate::{
    codec::{Fields, Put},
    index::{BlobAt, Index},
    layout::Layout,
    record::Head,
    segment::Sort,
};
use std::{fs, path::Path};

const MAGIC: &[u8; 8] = b"tauidx 1";

fn path_of(segment: &Path) -> std::path::PathBuf {
    segment.with_added_extension("idx")
}

/// Fills the index from the segment's index file, if there is a good one.
pub(crate) fn load(index: &mut Index, number: u32) {
    let segment = &index.segments[number as usize];
    let (sort, path) = (segment.sort, segment.path.clone());
    let Ok(bytes) = fs::read(path_of(&path)) else { return };
    let Some((body, check)) = bytes.split_last_chunk::<32>() else { return };
    if blake3::hash(body).as_bytes() != check {
        return;
    }
    let mut fields = Fields(body);
    let Some((scanned, committed, count)) = head(&mut fields) else { return };
    if fs::metadata(&path).map_or(0, |meta| meta.len()) < scanned {
        return; // of another file of that name
    }
    for _ in 0..count {
        let read = match sort {
            Sort::Pack => blob(&mut fields).map(|(hash, offset, size)| {
                index.insert_blob(hash, BlobAt { segment: number, offset, size });
            }),
            Sort::Log => Head::decode(&mut fields).zip(fields.u64()).map(|(head, offset)| {
                index.insert_record(&head, number, offset);
            }),
        };
        if read.is_none() {
            return; // the checksum was right, so this is another version; the scan starts at 0 then
        }
    }
    let segment = &mut index.segments[number as usize];
    (segment.scanned, segment.committed) = (scanned, committed);
}

fn head(fields: &mut Fields<'_>) -> Option<(u64, u64, u64)> {
    (fields.take(8)? == MAGIC).then_some(())?;
    Some((fields.u64()?, fields.u64()?, fields.u64()?))
}

fn blob(fields: &mut Fields<'_>) -> Option<([u8; 32], u64, u64)> {
    Some((fields.array()?, fields.u64()?, fields.u64()?))
}

/// Writes the segment's index file.  Failure is of no consequence.
pub(crate) fn save(index: &Index, number: u32, layout: &Layout) {
    let segment = &index.segments[number as usize];
    let (mut entries, mut count) = (Vec::new(), 0);
    match segment.sort {
        Sort::Pack => {
            let mut blobs: Vec<_> = index.blobs.iter().filter(|(_, at)| at.segment == number).collect();
            blobs.sort_unstable_by_key(|(_, at)| at.offset);
            for (hash, at) in blobs {
                entries.extend_from_slice(hash);
                entries.u64(at.offset);
                entries.u64(at.size);
                count += 1;
            }
        }
        Sort::Log => {
            let mut records: Vec<_> = index.records.iter().filter(|(_, at)| at.segment == number).collect();
            records.sort_unstable_by_key(|(_, at)| at.offset);
            for ((namespace, key), at) in records {
                let head = Head {
                    namespace: index.name(*namespace).to_string(),
                    label: index.name(at.label).to_string(),
                    key: *key,
                    generation: at.generation,
                    origin: at.origin,
                    sum: at.sum,
                    wall_us: at.wall_us,
                    bytes: at.bytes,
                    when: at.when,
                };
                head.encode(&mut entries);
                entries.u64(at.offset);
                count += 1;
            }
        }
    }
    let mut body = MAGIC.to_vec();
    for value in [segment.scanned, segment.committed, count] {
        body.u64(value);
    }
    body.extend_from_slice(&entries);
    let check = blake3::hash(&body);
    body.extend_from_slice(check.as_bytes());
    let tmp = layout.tmp();
    let _ = fs::write(&tmp, &body).and_then(|()| fs::rename(&tmp, path_of(&segment.path)));
}
