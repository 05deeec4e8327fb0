//! Copies to an upstream in many small steps, as a job does with its results: what is there is read once, and then only
//! what is new.

use crate::{
    Upstream, UpstreamError,
    index::{Contents, Writer, identity},
};
use std::{
    collections::HashSet,
    sync::{Mutex, PoisonError},
};
use tauflow_cache::{Digest, Key, Store};

/// See the module.
#[derive(Debug)]
pub struct Sender {
    upstream: Upstream,
    /// The contents, once they were read.
    there: Mutex<Option<Contents>>,
}

impl Sender {
    /// A sender for an upstream that is open for writing.
    pub fn new(upstream: Upstream) -> Self {
        Self { upstream, there: Mutex::default() }
    }

    /// The upstream.
    pub fn upstream(&self) -> &Upstream {
        &self.upstream
    }

    /// Copies these blobs of a store, and these records with all that they reach, as far as the upstream lacks them. A
    /// record whose blobs are not all in the store is left out.
    ///
    /// # Errors
    /// When the store cannot be read, or the upstream cannot be read or written.
    pub fn send(&self, store: &Store, blobs: &[Digest], records: &[(&str, Key)]) -> Result<(), UpstreamError> {
        let mut there = self.there.lock().unwrap_or_else(PoisonError::into_inner);
        // At first, packs are looked for, too: blobs of lost ones are sent again.
        match &mut *there {
            Some(there) => there.refresh(&self.upstream)?,
            None => *there = Some(self.upstream.contents()?),
        }
        let Some(there) = &*there else { return Ok(()) }; // set right above
        let mut writer = Writer::new(&self.upstream);
        let mut sent: HashSet<Digest> = HashSet::new();
        let mut blob = |digest: Digest, writer: &mut Writer<'_>| {
            if there.blobs.contains_key(&digest) || sent.contains(&digest) {
                return Ok(true);
            }
            let Some(bytes) = store.get(&digest)? else { return Ok(false) };
            writer.blob(digest, bytes)?;
            sent.insert(digest);
            Ok::<bool, UpstreamError>(true)
        };
        for digest in blobs {
            blob(*digest, &mut writer)?;
        }
        for (namespace, key) in records {
            let Some(record) = store.read(namespace, key) else { continue };
            let known = there.records.contains(&identity(&record));
            let mut complete = true;
            for digest in store.reach(&record.refs, &record.trees)? {
                complete &= blob(digest, &mut writer)?;
            }
            // The upstream may lack blobs of a record that it has: a transient node's are not sent, and packs get lost.
            if !known && (complete || record.transient && !record.fetched) {
                writer.record(record)?;
            }
        }
        writer.end()
    }
}
