//! What became of actions: replies of the threads that look up and run.

use super::{
    SLOWEST, Scheduler, lost,
    state::{Given, Names, Status},
};
use crate::engine::{
    event::{Ended, Event, Name, Slow},
    records::Made,
    work::{Outcome, Reply},
};
use tauflow_cache::CacheError;
use tauflow_contract::ItemKey;

impl Scheduler<'_> {
    /// Takes note of a batch that was looked up.
    pub fn looked_up(&mut self, replies: Vec<Reply>) -> Result<(), CacheError> {
        self.seeking -= 1;
        if let Some(reply) = replies.first() {
            self.sought[self.lanes[reply.slot.0].node] -= 1;
        }
        replies.into_iter().try_for_each(|reply| self.reply(reply))
    }

    /// Takes note of an action that was done; `last` says whether it was the last of its batch.
    pub fn performed(&mut self, reply: Reply, last: bool) -> Result<(), CacheError> {
        self.running -= usize::from(last);
        self.measuring &= !last;
        self.in_flight -= self.weights.remove(&reply.slot).unwrap_or(0);
        self.reply(reply)
    }

    /// Takes note of what became of an action.
    fn reply(&mut self, reply: Reply) -> Result<(), CacheError> {
        let (lane, slot) = reply.slot;
        if let Some(message) = reply.warning {
            self.events.push(Event::Warning { message });
        }
        if reply.file.is_some() {
            self.states[lane].slots[slot].extra.get_or_insert_default().file = reply.file;
        }
        let item = self.states[lane].slots[slot].key.clone();
        let ended = match reply.outcome {
            Outcome::Hit(made) => {
                self.states[lane].slots[slot].made = made;
                let before = !self.ran_before.is_empty() && self.ran_before.contains(&(lane, item.clone()));
                if before { Ended::Ran } else { Ended::Hit }
            }
            Outcome::Ran(made) => {
                self.note_run(lane, item.as_ref(), reply.spent_us, &made);
                self.states[lane].slots[slot].made = made;
                self.ran.insert((lane, item.clone()));
                Ended::Ran
            }
            Outcome::Todo(todo) => {
                self.states[lane].slots[slot].extra.get_or_insert_default().todo = Some(todo);
                self.set(lane, slot, Status::Todo);
                self.settle();
                return Ok(());
            }
            Outcome::WouldRun => {
                self.needs_again(lane, slot);
                Ended::WouldRun
            }
            Outcome::Failed(message) => {
                self.fail(lane, item.as_ref(), message);
                Ended::Failed
            }
            Outcome::Missing(digest) if self.bench.wanted.contains(&digest) => {
                self.fail(lane, item.as_ref(), lost(&digest));
                Ended::Failed
            }
            Outcome::Missing(digest) => {
                self.missing.insert(digest);
                self.set(lane, slot, Status::Stalled);
                self.settle();
                return Ok(());
            }
            Outcome::Cancelled => {
                self.set(lane, slot, Status::Stalled);
                self.settle();
                return Ok(());
            }
            Outcome::Fatal(error) => return Err(error),
        };
        if let Some(key) = reply.key {
            self.keys.push((lane, item, ended, key));
        }
        self.set(lane, slot, Status::Ended(ended));
        self.settle();
        Ok(())
    }

    /// In a dry run: what an action that would run reads of transient lanes, and is not there, would run again.
    fn needs_again(&mut self, lane: usize, slot: usize) {
        let lanes = self.lanes;
        let Some(key) = self.states[lane].slots[slot].key.clone() else { return };
        for (input, feeds) in lanes[lane].inputs.iter().enumerate() {
            let [feed] = &feeds[..] else { continue };
            let Some(Given::Item(output)) = self.states[lane].inputs[input].given.get(&key) else { continue };
            let gone = output.artifact.parts.values().any(|digest| !self.bench.is_here(digest));
            if self.tasks[feed.lane].transient && gone && self.again.insert((feed.lane, key.clone())) {
                let stat = &mut self.stats[lanes[feed.lane].node];
                stat.hit -= 1;
                stat.ran += 1;
            }
        }
    }

    fn note_run(&mut self, lane: usize, item: Option<&ItemKey>, spent_us: u64, made: &Made) {
        let stat = &mut self.stats[self.lanes[lane].node];
        stat.spent_s += spent_us as f64 / 1e6;
        stat.written += made.put;
        let mean = &mut self.states[lane].mean_us;
        *mean = Some(mean.map_or(spent_us as f64, |mean| mean + (spent_us as f64 - mean) / 8.0));
        let mean = &mut self.states[lane].mean_bytes;
        *mean = if *mean == 0 { made.put } else { (*mean * 7 + made.put) / 8 };
        let spent_s = spent_us as f64 / 1e6;
        if self.slowest.len() < SLOWEST || self.slowest.last().is_some_and(|last| last.spent_s < spent_s) {
            let Names { node, cell, .. } = &self.names[lane];
            let item = item.map_or_else(|| self.none.clone(), Name::from);
            let at = self.slowest.partition_point(|other| other.spent_s >= spent_s);
            self.slowest.insert(at, Slow { node: node.clone(), cell: cell.clone(), item, spent_s });
            self.slowest.truncate(SLOWEST);
        }
    }
}
