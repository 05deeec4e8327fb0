//! How actions become jobs, and what comes of a scheduler that does not take them.

use super::{
    super::{
        Apart, JobOption, bundle,
        folder::{Folder, Submitted},
        job::{Job, Open},
        pace::Pace,
        queue,
    },
    Like, Steward,
};
use crate::engine::{
    EngineError,
    batch::{BatchFile, BatchedAction},
    execute::{Execution, Outcome},
};
use std::{
    cell::RefCell,
    collections::BTreeSet,
    rc::Rc,
    time::{Duration, Instant},
};
use tauflow_cache::CacheError;
use tauflow_contract::{Digest, Resources};

/// Actions are gathered until none has come for this long,
const QUIET: Duration = Duration::from_millis(200);
/// or the first of them has waited this long.
const GATHERED: Duration = Duration::from_secs(2);
/// Jobs that are submitted together, at most.
const MOST_TOGETHER: usize = 256;
/// Attempts to submit jobs, each after a longer pause.
const MOST_SUBMISSIONS: u32 = 6;

/// Why jobs were not submitted.
enum Refusal {
    /// The scheduler may take them later.
    Scheduler(String),
    /// They cannot be submitted.
    Fatal(EngineError),
}

impl Steward<'_, '_> {
    /// Makes jobs of the actions that wait, if it is time.
    pub(super) fn submit(&mut self) {
        let due = self.first.is_some_and(|first| self.last.elapsed() >= QUIET || first.elapsed() >= GATHERED);
        let free = self.options.most.saturating_sub(self.jobs.len());
        if !due || free == 0 || Instant::now() < self.not_before {
            return;
        }
        let longest = self.options.duration.as_secs_f64();
        let cost =
            |pace: &mut Pace, open: &Open| pace.seconds(&open.label.node, &open.order.action, self.crew.of.store);
        let costs: Vec<(Like, Vec<f64>)> = self
            .waiting
            .iter()
            .map(|(like, opens)| (like.clone(), opens.iter().map(|open| cost(&mut self.pace, open)).collect()))
            .collect();
        let all = costs.iter().flat_map(|(_, costs)| costs).sum();
        let duration = bundle::duration(all, free, longest);
        let mut room = free.min(MOST_TOGETHER);
        for (like, costs) in costs {
            // Jobs that measure come one after the other, whatever the scheduler would do.
            let (duration, room_now) = match like.alone {
                true if self.jobs.iter().any(|job| job.alone) => continue,
                true => (longest, room.min(1)),
                false => (duration, room),
            };
            let Some(opens) = self.waiting.get_mut(&like) else { continue };
            let bundles: Vec<_> = bundle::bundles(&costs, duration).into_iter().take(room_now).collect();
            let longest = bundles.iter().map(|range| costs[range.clone()].iter().sum::<f64>()).fold(0.0, f64::max);
            let jobs: Vec<Vec<Open>> = bundles.iter().map(|range| opens.drain(..range.len()).collect()).collect();
            let resources = like.resources;
            let most = jobs.iter().map(Vec::len).max().unwrap_or(0);
            let time = bundle::time_limit(resources.time, most, longest);
            let like = Like { resources: Resources { time, ..resources }, ..like };
            if jobs.is_empty() {
                continue;
            }
            room -= jobs.len();
            if let Err((error, orders)) = self.submit_jobs(&like, jobs) {
                self.refused(error, orders);
                break;
            }
        }
        self.waiting.retain(|_, opens| !opens.is_empty());
        if self.waiting.is_empty() {
            self.first = None;
        }
    }

    /// Submits jobs of these actions of a node, or gives them back.
    fn submit_jobs(&mut self, like: &Like, jobs: Vec<Vec<Open>>) -> Result<(), (Refusal, Vec<Open>)> {
        let all = |jobs: Vec<Vec<Open>>| jobs.into_iter().flatten().collect();
        let holdings = self.holdings();
        let mut wanted: Vec<Digest> = self.wanted.iter().copied().collect();
        wanted.sort_unstable();
        let batch = |opens: &Vec<Open>| {
            let actions = opens.iter().map(|open| BatchedAction::leave(&open.order.action, holdings));
            let actions = actions.collect::<Result<_, CacheError>>()?;
            Ok(BatchFile { actions, wanted: wanted.clone(), machine: false })
        };
        // Other machines see what this process has only stored after that.
        let batches = jobs.iter().map(batch).collect::<Result<Vec<_>, EngineError>>();
        let batches = batches.and_then(|batches| self.crew.of.store.flush().map(|()| batches).map_err(Into::into));
        let batches = match batches {
            Ok(batches) => batches,
            Err(error) => return Err((Refusal::Fatal(error), all(jobs))),
        };
        let apart = self.options.apart.as_ref();
        if let Some(apart) = apart
            && let Err(error) = self.publish_inputs(apart, &batches)
        {
            return Err((error, all(jobs)));
        }
        let written = Folder::new(&self.root, &batches, &self.options.worker, &self.store, apart);
        let folder = match written {
            Ok(folder) => folder,
            Err(error) => {
                let why = format!("cannot write jobs to {}: {error}", self.root.display());
                return Err((Refusal::Fatal(EngineError::Executor(why)), all(jobs)));
            }
        };
        let name = folder.name();
        let for_it = |option: &&JobOption| option.node.as_deref().is_none_or(|name| name == &*like.node);
        let options = self.options.options.iter().filter(for_it).map(|option| option.text.as_str()).collect();
        let class = self.options.timing.as_deref().filter(|_| like.alone);
        let class = class.map(|name| queue::Class { name, node: self.node.as_deref() });
        let (jobs_len, resources) = (jobs.len(), like.resources);
        let submission = queue::Submission { name: &name, folder: &folder, jobs: jobs_len, resources, class, options };
        let ids = match self.queue.submit(&submission) {
            Ok(ids) => ids,
            Err(error) => return Err((Refusal::Scheduler(error), all(jobs))),
        };
        (self.refused, self.accepts) = (0, true);
        let noted = Submitted { scheduler: self.options.scheduling.name(), ids };
        if let Err(error) = folder.submitted(&noted) {
            self.warn(format!("the next run will not find the jobs of this one: {error}"));
        }
        let folder = Rc::new(RefCell::new(folder));
        for (number, (opens, id)) in jobs.into_iter().zip(noted.ids).enumerate() {
            let job = Job::new(&folder, number, id, opens.into_iter().map(Some).collect());
            self.jobs.push(Job { alone: like.alone, ..job });
        }
        Ok(())
    }

    /// Publishes what actions read, for jobs that do not share the store.
    fn publish_inputs(&self, apart: &Apart, batches: &[BatchFile]) -> Result<(), Refusal> {
        let store = self.crew.of.store;
        let mut read = BTreeSet::new();
        for action in batches.iter().flat_map(|batch| &batch.actions) {
            read.extend(action.reads(store).map_err(|error| Refusal::Fatal(error.into()))?);
        }
        let read: Vec<Digest> = read.into_iter().collect();
        // An upstream that does not answer may answer later, as a scheduler may.
        apart.courier.publish(store, &read, &[]).map_err(Refusal::Scheduler)
    }

    /// The scheduler did not take jobs: their actions wait for a while.
    fn refused(&mut self, refusal: Refusal, orders: Vec<Open>) {
        let error = match refusal {
            Refusal::Scheduler(error) => {
                self.refused += 1;
                // A scheduler that never took one is not there, or not as the options say.
                if self.accepts && self.refused < MOST_SUBMISSIONS {
                    let pause = Duration::from_secs(1 << self.refused);
                    self.warn(format!("{error}; trying again in {} s", pause.as_secs()));
                    self.not_before = Instant::now() + pause;
                    orders.into_iter().for_each(|open| self.wait(open));
                    return;
                }
                EngineError::Executor(format!("cannot submit jobs: {error}"))
            }
            Refusal::Fatal(error) => error,
        };
        let message = error.to_string();
        let mut error = Some(error);
        for open in orders {
            let error = error.take().unwrap_or_else(|| EngineError::Executor(message.clone()));
            self.reply(open, Execution::of(Outcome::Fatal(error)));
        }
    }
}
