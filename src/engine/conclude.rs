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
use tauflow_cache::Digest;
use tauflow_contract::Determinism;

/// A port's collection at the end of a run.
pub(super) struct ResultOf {
    pub cell: usize,
    pub port: PortId,
    pub collection: Arc<Sharded>,
}

/// What is known of a lane's collection.
enum LaneResult {
    Collection(Arc<Sharded>),
    /// The blob that lists it is not in the store.
    Missing(Digest),
    /// The lane did not come to an end.
    Unknown,
}

/// The files that were written, and the blobs that are missing, each with the lane whose output names it.
pub(super) type Concluded = (Vec<PathBuf>, Vec<(LaneId, Digest)>);

impl Run<'_> {
    /// Publishes, and keeps results that were asked for; names blobs of them that are missing.
    pub(super) fn conclude(&mut self, lanes: &Lanes, scheduler: &Scheduler<'_>) -> Result<Concluded, EngineError> {
        let (mut publications, mut missing) = (Vec::new(), Vec::new());
        let publishing: HashSet<usize> = lanes.iter().filter(|l| self.publishes(l)).map(|l| l.node).collect();
        for (id, lane) in lanes.pairs().filter(|(_, l)| l.target) {
            for port in &lane.ports {
                let collection = match self.result(scheduler, id, *port)? {
                    LaneResult::Collection(collection) => collection,
                    LaneResult::Missing(blob) => {
                        missing.push((id, blob));
                        continue;
                    }
                    LaneResult::Unknown => continue,
                };
                // Requested results must exist, whether or not a node reads them in this run.
                let (blobs, listings) = collection.blobs(self.store)?;
                missing.extend(listings.iter().map(|blob| (id, *blob)));
                for digest in blobs {
                    let here = if self.options.verify {
                        self.store.get(&digest)?.is_some()
                    } else {
                        self.store.contains(&digest)
                    };
                    if !here {
                        missing.push((id, digest));
                    }
                }
                if !listings.is_empty() {
                    continue;
                }
                if self.keep_results {
                    self.results.push(ResultOf { cell: lane.cell, port: *port, collection: collection.clone() });
                }
                if self.pipeline.nodes[lane.node].spec.outputs[port.place()].publish {
                    let folder = self.folder(lane, publishing.len());
                    let name = self.pipeline.cell_name(lane.cell);
                    publications.push((id, publish::Publication { folder, name, collection }));
                }
            }
        }
        match &self.options.out {
            Some(out) if !self.options.dry && self.options.only.is_none() => {
                let (out, mut written) = (out.join(&self.pipeline.name), Vec::new());
                let mut taken = publish::Taken::new(&out);
                for (id, publication) in &publications {
                    // Read, and so proved: what is damaged is made again though nothing else has changed.
                    let (files, gone) = publish::publish(self.store, &out, publication, &mut taken)?;
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

    /// A lane's collection, worked out now or in an earlier run.
    fn result(&self, scheduler: &Scheduler<'_>, lane: LaneId, port: PortId) -> Result<LaneResult, EngineError> {
        if let Some(result) = scheduler.result(lane, port) {
            return Ok(LaneResult::Collection(result.clone()));
        }
        let of = &self.pipeline.nodes[scheduler.node_of(lane)].spec.outputs[port.place()];
        let Some(listed) = scheduler.rolled(lane).and_then(|p| p.collections.get(of.name)) else {
            return Ok(LaneResult::Unknown);
        };
        let found = Sharded::get(self.store, listed, of.media)?;
        Ok(found.map_or(LaneResult::Missing(listed.blob), |found| LaneResult::Collection(Arc::new(found))))
    }
}

/// Every output of the lanes, and the blobs that list them.
pub fn outputs(pipeline: &Pipeline, lanes: &Lanes, scheduler: &Scheduler<'_>) -> (Vec<OutputOf>, Vec<Digest>) {
    let (mut found, mut trees): (Vec<OutputOf>, Vec<Digest>) = Default::default();
    // What a lane reads decides, too, how far its outputs are reproducible.
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
