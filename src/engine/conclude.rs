//! The end of a pass: published files, requested results, and their missing blobs.

use super::{
    EngineError,
    event::OutputOf,
    ids::{Id, LaneId, PortId, Row},
    lanes::{Lane, Lanes},
    publish,
    run::Run,
    scheduler::Scheduler,
    sharded::{Listed, Sharded},
};
use crate::pipeline::Pipeline;
use std::{collections::HashSet, path::PathBuf, sync::Arc};
use tauflow_cache::{CacheError, Digest};
use tauflow_contract::Determinism;

/// A port's collection at the end of a run.
pub(super) struct ResultOf {
    pub cell: usize,
    pub port: PortId,
    pub collection: Arc<Sharded>,
}

/// The state of a lane's collection.
enum LaneResult {
    Collection(Arc<Sharded>),
    /// The blob that lists it is not in the store.
    Missing(Digest),
}

/// The files that were written, and the blobs that are missing, each with the lane whose output names it.
pub(super) type Concluded = (Vec<PathBuf>, Vec<(LaneId, Digest)>);

impl Run<'_> {
    /// Publishes, and keeps results that were asked for; names blobs of them that are missing.
    pub(super) fn conclude(&mut self, lanes: &Lanes, scheduler: &Scheduler<'_>) -> Result<Concluded, EngineError> {
        let (mut publications, mut missing) = (Vec::new(), Vec::new());
        let publishing: HashSet<usize> = lanes.iter().filter(|l| self.publishes(l)).map(|l| l.node).collect();
        for (id, port, result) in self.results_of(lanes, scheduler)? {
            let lane = &lanes[id];
            let collection = match result {
                LaneResult::Collection(collection) => collection,
                LaneResult::Missing(blob) => {
                    missing.push((id, blob));
                    continue;
                }
            };
            // Requested results must exist, whether or not a node reads them in this run.
            let (blobs, listings) = collection.blobs(self.store)?;
            missing.extend(listings.iter().map(|blob| (id, *blob)));
            for digest in blobs {
                let here =
                    if self.options.verify { self.store.get(&digest)?.is_some() } else { self.store.contains(&digest) };
                if here {
                    continue;
                }
                // A node that is asked for may pass on what a transient one made.
                let pool = self.pool.as_ref().filter(|_| !self.options.dry);
                match pool.and_then(|pool| pool.get(&digest)) {
                    Some(bytes) => {
                        self.store.put(&bytes)?;
                    }
                    None => missing.push((id, digest)),
                }
            }
            if !listings.is_empty() {
                continue;
            }
            if self.keep_results {
                self.results.push(ResultOf { cell: lane.cell, port, collection: collection.clone() });
            }
            if self.pipeline.nodes[lane.node].spec.outputs[port.place()].publish {
                let folder = self.folder(lane, publishing.len());
                let name = self.pipeline.cell_name(lane.cell);
                publications.push((id, publish::Publication { folder, name, collection }));
            }
        }
        match &self.options.out {
            Some(out) if !self.options.dry && self.options.only.is_none() => {
                let (out, mut written) = (out.join(&self.pipeline.name), Vec::new());
                let mut taken = publish::Taken::new(&out);
                for (id, publication) in &publications {
                    // Read, and so proved: what is damaged is made again though nothing else has changed.
                    let (files, gone) =
                        publish::publish(self.store, &out, publication, &mut taken, self.options.account.as_deref())?;
                    written.extend(files);
                    missing.extend(gone.into_iter().map(|blob| (*id, blob)));
                }
                Ok((written, missing))
            }
            _ => Ok((Vec::new(), missing)),
        }
    }

    /// The folder of a lane's files below the pipeline's: a lone publishing node needs none of its own.
    fn folder(&self, lane: &Lane, publishing: usize) -> String {
        let cell = &self.pipeline.cells[lane.cell].text;
        let node = if publishing > 1 { self.pipeline.nodes[lane.node].name.as_str() } else { "" };
        [node, cell].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/")
    }

    fn publishes(&self, lane: &Lane) -> bool {
        let outputs = &self.pipeline.nodes[lane.node].spec.outputs;
        lane.target && lane.ports.iter().any(|p| outputs[p.place()].publish)
    }

    /// The collections of lanes that are asked for, worked out now or in an earlier run. Lanes that did not come to an
    /// end have none.
    fn results_of(
        &self,
        lanes: &Lanes,
        scheduler: &Scheduler<'_>,
    ) -> Result<Vec<(LaneId, PortId, LaneResult)>, CacheError> {
        let targets = lanes.pairs().filter(|(_, lane)| lane.target);
        let asked = targets.flat_map(|(id, lane)| lane.ports.iter().map(move |port| (id, *port)));
        let (mut results, mut earlier) = (Vec::new(), Vec::new());
        for (id, port) in asked {
            let of = &self.pipeline.nodes[lanes[id].node].spec.outputs[port.place()];
            if let Some(result) = scheduler.result(id, port) {
                results.push((id, port, LaneResult::Collection(result.clone())));
            } else if let Some(listed) = scheduler.rolled(id).and_then(|p| p.collections.get(of.name)) {
                earlier.push((results.len(), (listed, of.media)));
                results.push((id, port, LaneResult::Missing(listed.blob)));
            }
        }
        // All listings of earlier runs are read together.
        let (places, listings): (Vec<usize>, Vec<_>) = earlier.into_iter().unzip();
        for (place, found) in places.into_iter().zip(Sharded::get_many(self.store, &listings)?) {
            if let Some(found) = found {
                results[place].2 = LaneResult::Collection(Arc::new(found));
            }
        }
        Ok(results)
    }
}

/// Every output of the lanes, and the blobs that list them.
pub fn outputs(pipeline: &Pipeline, lanes: &Lanes, scheduler: &Scheduler<'_>) -> (Vec<OutputOf>, Vec<Digest>) {
    let (mut found, mut trees): (Vec<OutputOf>, Vec<Digest>) = Default::default();
    // The inputs of a lane limit how far its outputs are reproducible.
    let mut read: Row<LaneId, _> = lanes.iter().map(|_| Determinism::Bitwise).collect();
    let weaker = |a: Determinism, b: Determinism| match (a, b) {
        (Determinism::Measured, _) | (_, Determinism::Measured) => Determinism::Measured,
        (Determinism::Local, _) | (_, Determinism::Local) => Determinism::Local,
        _ => Determinism::Bitwise,
    };
    for (id, lane) in lanes.pairs() {
        let output = |lane: LaneId, port: PortId| &pipeline.nodes[lanes[lane].node].spec.outputs[port.place()];
        for feed in lane.inputs.iter().flatten() {
            read[id] = weaker(read[id], weaker(read[feed.lane], output(feed.lane, feed.port).determinism));
        }
        for port in &lane.ports {
            let of = output(id, *port);
            let rolled = scheduler.rolled(id).and_then(|payload| payload.collections.get(of.name));
            let result = scheduler.result(id, *port);
            let digest = rolled.map(|listed| listed.digest).or_else(|| Some(result?.digest));
            let listed = rolled.cloned().or_else(|| {
                let result = result?;
                Some(Listed { digest: result.digest, blob: result.blob()?, len: result.len() })
            });
            trees.extend(listed.as_ref().map(|listed| listed.blob));
            found.push(OutputOf {
                name: format!("{}.{}", pipeline.cell_name(lane.cell), of.name),
                determinism: weaker(read[id], of.determinism),
                digest,
                media: of.media,
                listed,
            });
        }
    }
    (found, trees)
}
