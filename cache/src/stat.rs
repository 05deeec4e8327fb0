//! Statistics of a store.

use crate::{
    CacheError, Store,
    error::At,
    layout::{loose_blobs, names},
    segment::Sort,
};
use std::{collections::BTreeMap, fs};

/// Numbers of a store.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Stat {
    /// Blobs, small and large.
    pub blobs: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Blobs with a file of their own, among `blobs`.
    pub loose: u64,
    /// Bytes of the pack files: those of the small blobs, and what a gc would win.
    pub pack_bytes: u64,
    /// Bytes of the log.
    pub log_bytes: u64,
    /// Damaged blobs set aside.
    pub quarantined: u64,
    /// Keys for which two processes recorded different payloads at the same time.
    pub conflicts: u64,
    /// Records by namespace and label.
    pub records: BTreeMap<String, BTreeMap<String, LabelStat>>,
}

/// Numbers of the records of one label.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LabelStat {
    /// How many.
    pub count: u64,
    /// Their wall time, in microseconds.
    pub wall_us: u64,
    /// The bytes they made.
    pub bytes: u64,
}

impl Store {
    /// Counts what the store holds; takes a look at every large blob's name and size.
    ///
    /// # Errors
    /// When the folders cannot be read.
    pub fn stat(&self) -> Result<Stat, CacheError> {
        self.refresh()?;
        let mut stat = Stat::default();
        for (digest, _) in loose_blobs(&self.layout.root).at("list the blobs in", &self.layout.root)? {
            stat.loose += 1;
            stat.bytes = stat.bytes.saturating_add(digest.size);
        }
        let folder = self.layout.folder("quarantine");
        stat.quarantined = names(&folder).at("list", &folder)?.len() as u64;
        let index = self.index();
        stat.blobs = stat.loose + index.blobs.len() as u64;
        stat.bytes = index.blobs.values().fold(stat.bytes, |sum, at| sum.saturating_add(at.size));
        for segment in index.segments.iter().filter(|segment| !segment.gone) {
            let len = fs::metadata(&segment.path).map_or(0, |meta| meta.len());
            match segment.sort {
                Sort::Pack => stat.pack_bytes += len,
                Sort::Log => stat.log_bytes += len,
            }
        }
        stat.conflicts = index.conflicts.len() as u64;
        drop(index);
        stat.records = self.record_stats();
        Ok(stat)
    }

    /// Numbers of the records, by namespace and label, from the index alone.
    pub fn record_stats(&self) -> BTreeMap<String, BTreeMap<String, LabelStat>> {
        let index = self.index();
        let mut found: BTreeMap<String, BTreeMap<String, LabelStat>> = BTreeMap::new();
        let mut by_number: BTreeMap<(u32, u32), LabelStat> = BTreeMap::new();
        #[expect(clippy::iter_over_hash_type, reason = "these are sums, whose order does not count")]
        for ((namespace, _), at) in &index.records {
            let label = by_number.entry((*namespace, at.label)).or_default();
            label.count += 1;
            label.wall_us = label.wall_us.saturating_add(at.wall_us);
            label.bytes = label.bytes.saturating_add(at.bytes);
        }
        for ((namespace, label), numbers) in by_number {
            let labels = found.entry(index.name(namespace).to_string()).or_default();
            labels.insert(index.name(label).to_string(), numbers);
        }
        found
    }
}
