//! Lanes whose outputs are known as a whole from an earlier run.
//!
//! They are asked for in waves: each lane once everything that it reads is known, and all lanes of a wave together.
//! Then the collections that the other lanes read are asked for. Pure: it says what to ask, and notes the answers.

use super::{
    ids::{Id, LaneId, PortId, Row},
    keys,
    lanes::Lanes,
    records::Payload,
    request::{LaneFound, LaneListing, LaneLookUp, LaneOf, ListingRead, Request, Task},
    sharded::Sharded,
};
use crate::pipeline::Pipeline;
use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};
use tauflow_cache::Digest;
use tauflow_contract::Mode;

/// See the module.
pub struct RolledLanes {
    /// Waves that have not been asked for.
    waves: VecDeque<Vec<LaneId>>,
    /// The outputs of each lane that was found.
    pub payloads: Row<LaneId, Option<Payload>>,
    /// Wall time in microseconds, and bytes, of each lane.
    pub totals: Row<LaneId, (u64, u64)>,
    /// Collections of these lanes that other lanes need, by lane and port.
    pub loaded: BTreeMap<(LaneId, PortId), Arc<Sharded>>,
}

/// The lanes in waves: each lane after all that it reads, and as early as that allows.
fn waves(lanes: &Lanes) -> VecDeque<Vec<LaneId>> {
    let mut depth: Row<LaneId, usize> = Row::new();
    let mut waves: VecDeque<Vec<LaneId>> = VecDeque::new();
    for (id, lane) in lanes.pairs() {
        let after = lane.inputs.iter().flatten().map(|feed| depth[feed.lane] + 1).max().unwrap_or(0);
        depth.push(after);
        if waves.len() <= after {
            waves.push_back(Vec::new());
        }
        waves[after].push(id);
    }
    waves
}

impl RolledLanes {
    /// Nothing is known of the lanes, and nothing will be asked.
    pub fn none(lanes: &Lanes) -> Self {
        let (payloads, totals) = (lanes.iter().map(|_| None).collect(), lanes.iter().map(|_| (0, 0)).collect());
        Self { waves: VecDeque::new(), payloads, totals, loaded: BTreeMap::new() }
    }

    /// Nothing is known of the lanes yet, and all will be asked for.
    pub fn unknown(lanes: &Lanes) -> Self {
        Self { waves: waves(lanes), ..Self::none(lanes) }
    }

    /// The next request, once the last one is answered; none when everything is known.
    pub fn next(&mut self, pipeline: &Pipeline, lanes: &Lanes, tasks: &Row<LaneId, Arc<Task>>) -> Option<Request> {
        while let Some(wave) = self.waves.pop_front() {
            let asked: Vec<LaneLookUp> =
                wave.into_iter().filter_map(|id| self.question(pipeline, lanes, &tasks[id])).collect();
            if !asked.is_empty() {
                return Some(Request::Lanes(asked));
            }
        }
        let unread = self.unread(pipeline, lanes);
        (!unread.is_empty()).then_some(Request::Listings(unread))
    }

    /// The look-up of a lane; none if it can have no roll-up, or reads something without one.
    fn question(&self, pipeline: &Pipeline, lanes: &Lanes, task: &Arc<Task>) -> Option<LaneLookUp> {
        let lane = &lanes[task.lane];
        let of = match pipeline.nodes[lane.node].mode() {
            Mode::Source if !lane.is_rolled_up() => return None,
            Mode::Source => LaneOf::Source(pipeline.cells[lane.cell].params.clone(), lane.basis.clone()),
            Mode::Map | Mode::Gather => {
                let content = |from, port| self.content(pipeline, lanes, from, port);
                LaneOf::Key(keys::lane(pipeline, lane, content, || None)?.0)
            }
        };
        Some(LaneLookUp { task: task.clone(), of, ports: lane.ports.clone() })
    }

    /// Content digest of a lane's port.
    fn content(&self, pipeline: &Pipeline, lanes: &Lanes, lane: LaneId, port: PortId) -> Option<Digest> {
        let outputs = &pipeline.nodes[lanes[lane].node].spec.outputs;
        Some(self.payloads[lane].as_ref()?.collections.get(outputs[port.place()].name)?.digest)
    }

    /// The collections that working lanes read from known lanes, and that are not loaded yet.
    fn unread(&self, pipeline: &Pipeline, lanes: &Lanes) -> Vec<LaneListing> {
        let mut unread: BTreeMap<(LaneId, PortId), LaneListing> = BTreeMap::new();
        let open = lanes.pairs().filter(|(id, _)| self.payloads[*id].is_none());
        for feed in open.flat_map(|(_, lane)| lane.inputs.iter().flatten()) {
            let (lane, port) = (feed.lane, feed.port);
            let of = &pipeline.nodes[lanes[lane].node].spec.outputs[port.place()];
            let Some(payload) = self.payloads[lane].as_ref().filter(|_| !self.loaded.contains_key(&(lane, port)))
            else {
                continue;
            };
            // Only payloads that fill all ports in demand are taken for found.
            if let Some(listed) = payload.collections.get(of.name) {
                unread.insert((lane, port), LaneListing { lane, port, listed: listed.clone(), media: of.media });
            }
        }
        unread.into_values().collect()
    }

    /// Notes the lanes that were found.
    pub fn note_lanes(&mut self, found: Vec<LaneFound>) {
        for LaneFound { lane, payload, totals, .. } in found {
            self.payloads[lane] = Some(payload);
            self.totals[lane] = totals;
        }
    }

    /// Notes the collections that were read. A lane of which a listing is missing is not known after all: it must work,
    /// and needs what it reads.
    pub fn note_listings(&mut self, read: Vec<ListingRead>) {
        for (lane, port, collection) in read {
            match collection {
                Some(collection) if self.payloads[lane].is_some() => {
                    self.loaded.insert((lane, port), collection);
                }
                Some(_) => {}
                None => {
                    self.payloads[lane] = None;
                    self.loaded.retain(|(of, _), _| *of != lane);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        engine::{lanes, measured::Measured, request, sharded::Listed},
        pipeline::{self, Options},
        registry::registry,
    };
    use std::collections::BTreeSet;
    use tauflow_cache::Key;

    const TEXT: &str = "
pipeline: waves
seed: 1
nodes:
  scenes: {kind: scene_generation, params: {pool: 12}}
  previews: {kind: ladder_rendering, inputs: {scenes: scenes}, params: {rungs: [4], resolution: [8, 8]}}
  gate: {kind: quality_gate, inputs: {scenes: scenes, previews: previews}}
  ladders: {kind: ladder_rendering, inputs: {scenes: gate.accepted}, params: {rungs: [4], resolution: [8, 8]}}
  statistics: {kind: scene_statistics, inputs: {scenes: gate.accepted}}
";

    fn laid_out() -> (Pipeline, Lanes) {
        let pipeline = pipeline::resolve_text("waves.yaml", TEXT, &registry(), &Options::default());
        let pipeline = pipeline.unwrap_or_else(|problems| panic!("{problems}"));
        let lanes = lanes::demand(&pipeline, &pipeline.targets, None, &|_, _, _| Ok(None)).expect("no store is read");
        (pipeline, lanes)
    }

    /// A roll-up of all ports of the lane.
    fn found(of: &LaneLookUp) -> LaneFound {
        let outputs = &of.task.producer.spec.outputs;
        let listed = Listed { digest: Digest::of(b"items"), blob: Digest::of(b"listing"), len: 1 };
        let collections = of.ports.iter().map(|port| (outputs[port.place()].name.to_owned(), listed.clone())).collect();
        let payload = Payload { collections, ..Payload::default() };
        LaneFound { lane: of.task.lane, key: Key::of(b"lane"), payload, totals: (1, 1) }
    }

    #[test]
    fn each_wave_is_one_request_and_asks_after_what_it_reads() {
        let (pipeline, lanes) = laid_out();
        let tasks = request::tasks(&pipeline, &lanes, &Measured::default());
        let (mut rolled, mut asked, mut requests) = (RolledLanes::unknown(&lanes), BTreeSet::new(), 0);
        while let Some(request) = rolled.next(&pipeline, &lanes, &tasks) {
            let Request::Lanes(wave) = request else { panic!("all lanes are known, so no listing is needed") };
            let before = asked.clone();
            for of in &wave {
                let lane = of.task.lane;
                assert!(lanes[lane].inputs.iter().flatten().all(|feed| before.contains(&feed.lane)));
                assert!(asked.insert(lane), "asked twice");
            }
            rolled.note_lanes(wave.iter().map(found).collect());
            requests += 1;
        }
        assert_eq!(asked.len(), lanes.len());
        assert!(requests < lanes.len(), "{requests} requests for {} lanes: waves have several", lanes.len());
        assert!(rolled.payloads.iter().all(Option::is_some));
    }

    #[test]
    fn a_lane_that_lost_its_listing_works_and_reads_what_it_needs() {
        let (pipeline, lanes) = laid_out();
        let tasks = request::tasks(&pipeline, &lanes, &Measured::default());
        let last = lanes.ids().last().expect("there are lanes");
        let mut rolled = RolledLanes::unknown(&lanes);
        let mut listings = Vec::new();
        while let Some(request) = rolled.next(&pipeline, &lanes, &tasks) {
            match request {
                Request::Lanes(wave) => {
                    let all = wave.iter().filter(|of| of.task.lane != last);
                    rolled.note_lanes(all.map(found).collect());
                }
                Request::Listings(asked) => {
                    // The first is lost, the others are there.
                    let first = listings.is_empty();
                    let here = || Some(Arc::new(Sharded::of([])));
                    let read = asked.iter().map(|of| (of.lane, of.port, if first { None } else { here() })).collect();
                    listings.push(asked.into_iter().map(|of| of.lane).collect::<Vec<_>>());
                    rolled.note_listings(read);
                }
                _ => panic!("it asks for whole lanes only"),
            }
        }
        let reads = |lane: LaneId| lanes[lane].inputs.iter().flatten().map(|feed| feed.lane).collect::<BTreeSet<_>>();
        let [lost, needed] = &listings[..] else { panic!("two rounds, not {listings:?}") };
        assert_eq!(BTreeSet::from_iter(lost.iter().copied()), reads(last));
        assert!(lost.iter().all(|lane| rolled.payloads[*lane].is_none()), "they must work");
        let again: BTreeSet<LaneId> = lost.iter().flat_map(|lane| reads(*lane)).collect();
        assert!(needed.iter().all(|lane| again.contains(lane)) && !needed.is_empty(), "{needed:?} of {again:?}");
    }
}
