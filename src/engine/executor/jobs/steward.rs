//! The thread that looks after jobs: it submits them, reads what they tell, notices which ended before they were done,
//! and finds those of an earlier run again. Nobody else knows jobs.

mod submission;

use super::{
    JobOptions,
    folder::Folder,
    job::{Job, Open, Unseen},
    machine,
    pace::Pace,
    queue::{self, Queue, Stage},
};
use crate::engine::{
    batch::{End, Line},
    event::{Event, Name},
    execute::{Execution, Outcome},
    executor::{Batch, processes, threads::Crew},
    holdings::Holdings,
};
use std::{
    cell::RefCell,
    collections::{BTreeMap, HashMap, HashSet, VecDeque},
    path::PathBuf,
    rc::Rc,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError},
    },
    time::{Duration, Instant},
};
use tauflow_cache::Key;
use tauflow_contract::{Digest, Progress, Resources};

/// Shortest time between two looks at what jobs tell.
const LOOK: Duration = Duration::from_millis(100);
/// Questions to the scheduler in which a job must be missing before it has ended.
const MISSES: u32 = 2;
/// Time until a record that a job told of must be seen: file systems of several machines take a while.
const VISIBLE: Duration = Duration::from_secs(30);
/// Questions that the scheduler may leave open before people are told.
const UNANSWERED: u32 = 3;

/// What the actions of a job have in common.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Like {
    node: Name,
    resources: Resources,
    /// They measure, and have a node to themselves.
    alone: bool,
}

/// See the module.
pub struct Steward<'a, 'o> {
    crew: &'o Crew<'a>,
    options: &'o JobOptions,
    queue: Box<dyn Queue>,
    root: PathBuf,
    store: PathBuf,
    /// By what a job of them has in common, in the order in which they came.
    waiting: BTreeMap<Like, VecDeque<Open>>,
    /// The node that measures, if it has a name.
    node: Option<String>,
    /// Open orders by batch.
    batches: HashMap<u64, usize>,
    next_batch: u64,
    wanted: Arc<HashSet<Digest>>,
    pace: Pace,
    jobs: Vec<Job>,
    /// Actions of jobs that an earlier run submitted: the job's id, and the place.
    found: HashMap<Key, (String, usize)>,
    unseen: Vec<Unseen>,
    first: Option<Instant>,
    last: Instant,
    asked: Instant,
    unanswered: u32,
    refused: u32,
    /// The scheduler has taken jobs of this run.
    accepts: bool,
    not_before: Instant,
    told: (usize, usize, BTreeMap<Name, u64>),
    /// When notes of jobs were read last, and what was published was looked for.
    read: Instant,
    refreshed: Instant,
}

impl<'a, 'o> Steward<'a, 'o> {
    /// With no jobs. Those that measure run on this node.
    pub fn new(crew: &'o Crew<'a>, options: &'o JobOptions, node: Option<String>) -> Self {
        let dir = crew.of.store.dir();
        let store = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
        let now = Instant::now();
        Self {
            crew,
            options,
            queue: queue::queue(options),
            root: store.join("jobs"),
            store,
            waiting: BTreeMap::new(),
            node,
            batches: HashMap::new(),
            next_batch: 0,
            wanted: Arc::default(),
            pace: Pace::default(),
            jobs: Vec::new(),
            found: HashMap::new(),
            unseen: Vec::new(),
            first: None,
            last: now,
            asked: now,
            unanswered: 0,
            refused: 0,
            accepts: false,
            not_before: now,
            told: (0, 0, BTreeMap::new()),
            read: now,
            refreshed: now,
        }
    }

    /// Takes orders until nobody is left who gives any.
    pub fn run(mut self, orders: &Receiver<Batch>) {
        self.find();
        loop {
            // Many jobs are many files.
            let look = LOOK.max(Duration::from_millis(self.jobs.len() as u64));
            match orders.recv_timeout(look) {
                Ok(batch) => {
                    self.take(batch);
                    while let Ok(batch) = orders.try_recv() {
                        self.take(batch);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if self.crew.halts() {
                self.cancel();
                continue;
            }
            self.listen();
            self.see();
            self.ask();
            self.submit();
            self.tell();
        }
        self.cancel();
        // Jobs of an earlier run that nobody asked for go on: their folders stay.
    }

    fn holdings(&self) -> Holdings<'_> {
        Holdings { store: self.crew.of.store, pool: Some(&self.crew.of.pool), wanted: &self.wanted }
    }

    fn warn(&self, message: String) {
        (self.crew.of.sink)(&Event::Warning { message });
    }

    fn reply(&mut self, open: Open, execution: Execution) {
        let left = self.batches.get_mut(&open.batch);
        let last = left.is_none_or(|left| {
            *left -= 1;
            *left == 0
        });
        if last {
            self.batches.remove(&open.batch);
        }
        let producer = &open.order.action.producer;
        if matches!(execution.outcome, Outcome::Failed(_))
            && producer.spec.measures(producer.group)
            && let Err(error) = machine::forget(self.crew.of.store, self.options)
        {
            self.warn(format!("the machine that measures is not forgotten: {error}"));
        }
        if matches!(execution.outcome, Outcome::Ran(_)) {
            self.pace.note(&open.label.node, execution.spent_us);
        }
        self.crew.reply(&open.order, execution, last);
    }

    fn take(&mut self, batch: Batch) {
        let Batch { label, wanted, orders, .. } = batch;
        self.wanted = wanted;
        self.batches.insert(self.next_batch, orders.len());
        for order in orders {
            let open = Open { order, label: label.clone(), batch: self.next_batch, attempts: 0 };
            self.place(open);
        }
        self.next_batch += 1;
        self.last = Instant::now();
        self.first.get_or_insert(self.last);
    }

    /// Waits for the job of an earlier run that has this action, or for a new one.
    fn place(&mut self, open: Open) {
        if let Some((id, place)) = self.found.remove(&open.order.action.hash)
            && let Some(job) = self.jobs.iter_mut().find(|job| job.id == id)
        {
            if place >= job.at {
                if place == job.at && job.begun {
                    self.crew.announce(&open.label, &open.order);
                }
                job.orders[place] = Some(open);
                return;
            }
            // Done since it was looked up.
            let (end, since) = (End::Hit, Instant::now());
            self.unseen.push(Unseen { open, end, warning: None, spent_us: 0, recorded: None, since });
            return;
        }
        self.wait(open);
    }

    fn wait(&mut self, open: Open) {
        self.first.get_or_insert_with(Instant::now);
        let producer = &open.order.action.producer;
        let alone = producer.spec.measures(producer.group);
        let like = Like { node: open.label.node.clone(), resources: self.resources(&open), alone };
        self.waiting.entry(like).or_default().push_back(open);
    }

    /// What an action asks for.
    fn resources(&self, open: &Open) -> Resources {
        let basis = &open.order.action.key.basis;
        let kind = open.order.action.producer.kind.resources(&basis.params, &basis.group);
        self.options.resources.get(&*open.label.node).map_or(kind, |asked| asked.over(kind))
    }

    /// Takes over the jobs of earlier runs that have not ended.
    fn find(&mut self) {
        let scheduler = self.options.scheduling.name();
        let mut left = Vec::new();
        for mut folder in Folder::left(&self.root, self.options.apart.as_ref()) {
            match folder.jobs() {
                Some(jobs) if jobs.scheduler == scheduler => left.push((folder, jobs.ids)),
                // Jobs of another scheduler end by themselves, and a later run with that scheduler removes the folder.
                Some(_) => folder.open = 1,
                None => {}
            }
        }
        if left.is_empty() {
            return;
        }
        let ids: Vec<&str> = left.iter().flat_map(|(_, ids)| ids).map(String::as_str).collect();
        let alive = match self.queue.poll(&ids) {
            Ok(alive) => alive,
            Err(error) => {
                self.warn(format!("jobs of an earlier run are not looked for: {error}"));
                left.iter_mut().for_each(|(folder, _)| folder.open = 1);
                return;
            }
        };
        let mut count = 0;
        for (folder, ids) in left {
            let folder = Rc::new(RefCell::new(folder));
            for (number, id) in ids.into_iter().enumerate() {
                let Some(stage) = alive.get(&id) else { continue };
                let keys = folder.borrow().keys(number);
                let mut job = Job::new(&folder, number, id, keys.iter().map(|_| None).collect());
                job.stage = *stage;
                for line in job.lines.news() {
                    job.hear(&line);
                }
                if job.at < keys.len() {
                    count += 1;
                    let places = keys.into_iter().enumerate().skip(job.at);
                    self.found.extend(places.map(|(place, key)| (key, (job.id.clone(), place))));
                }
                self.jobs.push(job);
            }
        }
        if count > 0 {
            let jobs = if count == 1 { "1 job".to_owned() } else { format!("{count} jobs") };
            self.warn(format!("{jobs} of an earlier run found; their actions are not submitted again"));
        }
    }

    /// Reads what jobs tell.
    fn listen(&mut self) {
        let far = self.options.apart.is_some() && self.read.elapsed() < self.options.poll;
        if !far {
            self.read = Instant::now();
        }
        for n in 0..self.jobs.len() {
            // A request to a server has its time, unless the job has ended.
            if far && self.jobs[n].missed < MISSES {
                continue;
            }
            for line in self.jobs[n].lines.news() {
                let job = &mut self.jobs[n];
                let place = job.at;
                let end = job.hear(&line);
                match line {
                    Line::Begun { action } if action == place => {
                        job.stage = Stage::Running;
                        if let Some(Some(open)) = job.orders.get(place) {
                            self.crew.announce(&open.label, &open.order);
                        }
                    }
                    Line::Progress { action, done, total, message } if action == place => {
                        if let Some(Some(open)) = job.orders.get(place) {
                            self.crew.reporter(&open.label, &open.order).report(done, total, &message);
                        }
                    }
                    Line::Ended { end: told, warning, spent_us, recorded, .. } if end => {
                        if let Some(open) = job.orders.get_mut(place).and_then(Option::take) {
                            let since = Instant::now();
                            self.unseen.push(Unseen { open, end: told, warning, spent_us, recorded, since });
                        }
                    }
                    Line::Machine { .. } | Line::Begun { .. } | Line::Progress { .. } | Line::Ended { .. } => {}
                }
            }
        }
        for n in (0..self.jobs.len()).rev() {
            let job = &self.jobs[n];
            if job.at >= job.orders.len() || job.missed >= MISSES || job.trouble.is_some() {
                let job = self.jobs.swap_remove(n);
                self.ended(job);
            }
        }
    }

    /// Replies to actions that jobs told the end of.
    fn see(&mut self) {
        self.refresh();
        for unseen in std::mem::take(&mut self.unseen) {
            match processes::outcome(&unseen.open.order, &unseen.end, unseen.recorded, self.holdings()) {
                Ok(Some(outcome)) => {
                    let Unseen { open, warning, spent_us, recorded, .. } = unseen;
                    self.reply(open, Execution { outcome, recorded, warning, spent_us });
                }
                Ok(None) if unseen.since.elapsed() < VISIBLE => self.unseen.push(unseen),
                Ok(None) => {
                    self.blame(unseen.open, "a job says that it is done, but recorded nothing that is seen here");
                }
                Err(error) => self.reply(unseen.open, Execution::of(Outcome::Fatal(error))),
            }
        }
    }

    /// Looks for what jobs have published, if they have a store of their own.
    fn refresh(&mut self) {
        let Some(apart) = self.options.apart.as_ref().filter(|_| !self.unseen.is_empty()) else { return };
        let new = self.unseen.iter().any(|unseen| unseen.since > self.refreshed);
        if new || self.refreshed.elapsed() >= self.options.poll {
            self.refreshed = Instant::now();
            if let Err(error) = apart.courier.refresh() {
                self.warn(format!("the results of jobs are not seen yet: {error}"));
            }
        }
    }

    /// Asks the scheduler which jobs have not ended.
    fn ask(&mut self) {
        if self.jobs.is_empty() || self.asked.elapsed() < self.options.poll {
            return;
        }
        let ids: Vec<&str> = self.jobs.iter().map(|job| job.id.as_str()).collect();
        let answer = self.queue.poll(&ids);
        self.asked = Instant::now();
        match answer {
            Ok(alive) => {
                self.unanswered = 0;
                for job in &mut self.jobs {
                    match alive.get(&job.id) {
                        Some(stage) => (job.stage, job.missed) = (*stage, 0),
                        None => job.missed += 1,
                    }
                }
            }
            Err(error) => {
                self.unanswered += 1;
                if self.unanswered == UNANSWERED {
                    self.warn(format!("the scheduler does not answer, and is asked again: {error}"));
                }
            }
        }
    }

    /// A job has ended. The action that it was at counts an attempt; those behind it go to other jobs.
    fn ended(&mut self, job: Job) {
        let Job { folder, number, id, orders, trouble, .. } = job;
        folder.borrow_mut().open -= 1;
        let mut open = orders.into_iter().flatten();
        if let Some(first) = open.next() {
            let reason = trouble.or_else(|| self.queue.reason(&id)).unwrap_or_else(|| "for an unknown reason".into());
            let log = folder.borrow().log(number);
            let log = if log.is_empty() { String::new() } else { format!("; it printed: {log}") };
            self.blame(first, &format!("job {id} ended before it was done ({reason}){log}"));
        }
        open.for_each(|open| self.wait(open));
    }

    /// Has an action run again, or gives it up.
    fn blame(&mut self, mut open: Open, why: &str) {
        if self.crew.halts() {
            return self.wait(open);
        }
        open.attempts += 1;
        let item = open.order.action.item.as_ref().map_or_else(String::new, |item| format!("/{item}"));
        if open.attempts > self.options.retries {
            let message = format!(
                "{why}, at attempt {}; if memory or time ran out, ask for more with `resources` of the node; \
                 `--retries` allows more attempts",
                open.attempts
            );
            return self.reply(open, Execution::of(Outcome::Failed(message)));
        }
        self.warn(format!("{}{item}: {why}; it runs again", open.label.node));
        self.wait(open);
    }

    /// Cancels jobs, and replies to everything that is open.
    fn cancel(&mut self) {
        self.listen();
        self.see();
        let waiting = std::mem::take(&mut self.waiting).into_values().flatten();
        let mut open: Vec<Open> =
            waiting.chain(std::mem::take(&mut self.unseen).into_iter().map(|un| un.open)).collect();
        self.first = None;
        let jobs = std::mem::take(&mut self.jobs);
        let (ours, others): (Vec<Job>, Vec<Job>) =
            jobs.into_iter().partition(|job| job.orders.iter().any(Option::is_some));
        self.jobs = others;
        if !ours.is_empty() {
            let ids: Vec<&str> = ours.iter().map(|job| job.id.as_str()).collect();
            let cancelled = self.queue.cancel(&ids);
            if let Err(error) = &cancelled {
                let ids = ids.join(" ");
                self.warn(format!("jobs were not cancelled, and the next run finds them again ({ids}): {error}"));
            }
            for job in ours {
                job.folder.borrow_mut().open -= usize::from(cancelled.is_ok());
                open.extend(job.orders.into_iter().flatten());
            }
        }
        for open in open {
            self.reply(open, Execution::of(Outcome::Cancelled));
        }
        self.tell();
    }

    /// Tells how many jobs there are, if that has changed.
    fn tell(&mut self) {
        let running = self.jobs.iter().filter(|job| job.stage == Stage::Running).count();
        let mut waiting: BTreeMap<Name, u64> = BTreeMap::new();
        for job in self.jobs.iter().filter(|job| job.stage != Stage::Running) {
            for open in job.orders.iter().flatten() {
                *waiting.entry(open.label.node.clone()).or_default() += 1;
            }
        }
        let now = (self.jobs.len() - running, running, waiting.clone());
        if now != self.told {
            self.told = now;
            let queued = (self.jobs.len() - running) as u64;
            (self.crew.of.sink)(&Event::Jobs { queued, running: running as u64, waiting });
        }
    }
}
