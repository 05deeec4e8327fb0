//! Verification: reads and rehashes all blobs, and decodes all records.

use crate::{
    CacheError, Digest, Key, Store, error::At, gc, layout::loose_blobs, record::sum, segment::Sort, whole::State,
};
use std::collections::HashSet;

/// The result of a verification.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct VerifyReport {
    /// Blobs in the store.
    pub blobs: u64,
    /// Blobs that were read.
    pub checked: u64,
    /// Bytes that were read.
    pub checked_bytes: u64,
    /// Blobs that were damaged; they are in quarantine now, and misses.
    pub damaged: Vec<Digest>,
    /// Records in the store.
    pub records: u64,
    /// Records whose frame is damaged; they are misses.
    pub damaged_records: u64,
    /// Damaged places in packs that hide which blobs lay there; the next gc clears them away.
    pub damaged_places: u64,
    /// Records that reach a blob which is not there: their actions run again when needed.
    pub incomplete_records: u64,
    /// Committed ones among them that reach a blob which was there and is not any more. A transient action's outputs,
    /// and what others say of them, are none: nobody stored them. Who needs the blobs has them made again; a gc with
    /// [`GcOptions::lost`](crate::GcOptions::lost) clears the records away.
    pub lost_records: u64,
    /// Keys for which two processes recorded different payloads at the same time; the older record stands.
    pub conflicts: Vec<(String, Key)>,
    /// Bytes after the last whole frame of segments whose writer is dead: what a kill cut off.
    pub torn_bytes: u64,
}

impl VerifyReport {
    /// Whether something was damaged or lost. Other missing blobs do not count: they result from a power cut or a
    /// transient node, and a gc deletes records together with their blobs.
    pub fn is_damaged(&self) -> bool {
        !self.damaged.is_empty() || self.damaged_records + self.damaged_places + self.lost_records > 0
    }
}

impl Store {
    /// Rehashes all blobs, or about the fraction `sample` of them, chosen by `seed`. Damaged ones go to quarantine and
    /// are misses from then on; a store that is open for reading only just says so. `progress` gets the blobs done and
    /// the blobs to do.
    ///
    /// # Errors
    /// When a file that is there cannot be read.
    pub fn verify(
        &self,
        sample: Option<f64>,
        seed: u64,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<VerifyReport, CacheError> {
        self.refresh()?;
        let (mut report, mut missed) = (VerifyReport::default(), Vec::new());
        let blobs = self.all_blobs()?;
        report.blobs = blobs.len() as u64;
        for (done, digest) in blobs.iter().enumerate() {
            if chosen(digest, sample, seed) {
                report.checked += 1;
                report.checked_bytes += digest.size;
                if self.get_now(digest)?.is_none() {
                    missed.push(*digest);
                }
            }
            progress(done as u64 + 1, report.blobs);
        }
        if !missed.is_empty() {
            // They may have been in the hands of a collection. Asked once for all: a refresh lists what is set aside.
            gc::wait_for_sweep(&self.layout);
            self.refresh()?;
        }
        for digest in missed {
            if self.get_now(&digest)?.is_none() {
                report.damaged.push(digest);
            }
        }
        let index = self.index();
        report.conflicts = index.conflicts.iter().map(|(namespace, key)| (namespace.to_string(), *key)).collect();
        for segment in index.segments.iter().filter(|segment| segment.sealed && !segment.gone) {
            let len = std::fs::symlink_metadata(&segment.path).map_or(segment.scanned, |meta| meta.len());
            report.torn_bytes += len.saturating_sub(segment.scanned);
            match segment.sort {
                Sort::Log => report.damaged_records += segment.damaged,
                Sort::Pack => report.damaged_places += segment.damaged,
            }
        }
        drop(index);
        // Last: it counts the damage that it finds, and adds it to the counts of the segments, too.
        self.verify_records(&mut report)?;
        Ok(report)
    }

    /// Damaged places of logs that were passed over so far: what was recorded there is a miss, as if it never had been.
    /// Costs no reading. An entry that a kill truncated at the end of a log is not damage.
    pub fn damaged_log_places(&self) -> u64 {
        self.index().segments.iter().filter(|s| s.sort == Sort::Log && !s.gone).map(|s| s.damaged).sum()
    }

    /// Every blob, packed ones in the order of their places.
    fn all_blobs(&self) -> Result<Vec<Digest>, CacheError> {
        let mut blobs: Vec<Digest> = {
            let index = self.index();
            let mut packed: Vec<_> = index.blobs.iter().collect();
            packed.sort_unstable_by_key(|(hash, at)| (at.segment, at.offset, **hash));
            packed.into_iter().map(|(hash, at)| Digest { hash: *hash, size: at.size }).collect()
        };
        let loose = loose_blobs(&self.layout.root).at("list the blobs in", &self.layout.root)?;
        blobs.extend(loose.into_iter().map(|(digest, _)| digest));
        Ok(blobs)
    }

    fn verify_records(&self, report: &mut VerifyReport) -> Result<(), CacheError> {
        let here: HashSet<Digest> = self.all_blobs()?.into_iter().collect();
        for checked in self.check_records(&here)? {
            report.records += 1;
            match checked.state {
                Some(State::Whole) => {}
                Some(State::Excused | State::Lost) => report.incomplete_records += 1,
                None => {
                    report.damaged_records += 1;
                    self.index_mut().mark_damaged(&checked.slot);
                }
            }
            report.lost_records += u64::from(checked.has_lost());
        }
        Ok(())
    }
}

fn chosen(digest: &Digest, sample: Option<f64>, seed: u64) -> bool {
    let Some(fraction) = sample else { return true };
    let mut bytes = seed.to_le_bytes().to_vec();
    bytes.extend_from_slice(&digest.hash);
    (sum(&bytes) as f64) < fraction * u64::MAX as f64
}
