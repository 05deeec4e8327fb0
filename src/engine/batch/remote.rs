//! A batch whose process shares nothing with the run but what a [`Courier`] carries: it publishes its results, and then
//! tells of them.

use super::{BatchFile, Line};
use crate::{
    engine::{EngineError, courier::Courier, reached::seen_by, records::ACTION},
    kinds::Registry,
};
use std::{
    sync::{
        Mutex, PoisonError,
        atomic::AtomicBool,
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::{Duration, Instant},
};
use tauflow_cache::{Key, Store};

/// Time between two publications of a batch of short actions.
const EVERY: Duration = Duration::from_secs(30);
/// Time after which an action is a long one: if its job is killed, the run should know that it was at this one. What
/// was done before is published, too.
const LONG: Duration = Duration::from_secs(5);
/// Time between two looks for one of the two.
const LOOK: Duration = Duration::from_secs(1);

/// The lines of a batch, and how many are told.
struct Told<'a> {
    store: &'a Store,
    courier: &'a dyn Courier,
    name: &'a str,
    text: Vec<u8>,
    /// Records of actions that have ended, and were not published.
    ended: Vec<Key>,
    last: Option<Instant>,
    /// When the first line came that was not published.
    untold: Option<Instant>,
    /// When the action began that the last line tells of.
    begun: Option<Instant>,
    /// Why nothing can be published.
    failed: Option<String>,
}

impl<'a> Told<'a> {
    fn new(store: &'a Store, courier: &'a dyn Courier, name: &'a str) -> Self {
        let (text, ended) = (Vec::new(), Vec::new());
        Self { store, courier, name, text, ended, last: None, untold: None, begun: None, failed: None }
    }

    fn hear(&mut self, line: &Line) {
        if let Line::Progress { .. } = line {
            return; // each would be a request
        }
        serde_json::to_writer(&mut self.text, line).expect("lines are plain data");
        self.text.push(b'\n');
        let now = Instant::now();
        self.untold.get_or_insert(now);
        self.begun = matches!(line, Line::Begun { .. }).then_some(now);
        // The first line says that the job has begun.
        if self.last.is_none_or(|last| last.elapsed() >= EVERY) {
            self.publish();
        }
    }

    /// Publishes what is due, also while an action runs.
    fn look(&mut self, now: Instant) {
        let after = |of: Option<Instant>, time: Duration| of.is_some_and(|of| now.duration_since(of) >= time);
        if self.untold.is_some() && (after(self.last, EVERY) || after(self.begun, LONG)) {
            self.publish();
        }
    }

    fn publish(&mut self) {
        let actions: Vec<(&str, Key)> = self.ended.iter().map(|key| (ACTION, *key)).collect();
        // Whatever a job was asked to make goes back, what only holds on this machine included.
        let seen = seen_by(self.store, &actions, &|_| true);
        let records = [actions.as_slice(), seen.as_slice()].concat();
        let published = if records.is_empty() { Ok(()) } else { self.courier.publish(self.store, &[], &records) };
        if published.is_ok() {
            self.ended.clear();
        }
        let told = published.and_then(|()| self.courier.put(self.name, self.text.clone()));
        self.failed = told.err();
        if self.failed.is_none() {
            self.untold = None;
        }
        // After a failure, the next attempt waits as well.
        (self.last, self.begun) = (Some(Instant::now()), None);
    }
}

/// Executes a batch.
///
/// # Errors
/// If the store fails, or results cannot be published.
pub fn serve(
    batch: BatchFile,
    store: &Store,
    registry: &Registry,
    stop: &AtomicBool,
    (courier, name): (&dyn Courier, &str),
) -> Result<(), EngineError> {
    let told = Mutex::new(Told::new(store, courier, name));
    let lock = &|| told.lock().unwrap_or_else(PoisonError::into_inner);
    let recorded = |key| lock().ended.push(key);
    let (end, ended) = mpsc::channel::<()>();
    let result = thread::scope(|scope| {
        scope.spawn(move || {
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(LOOK) {
                lock().look(Instant::now());
            }
        });
        let result = batch.run(store, registry, stop, &|line| lock().hear(line), Some(&recorded));
        drop(end);
        result
    });
    let mut told = lock();
    told.publish();
    match told.failed.take() {
        Some(why) => Err(EngineError::Executor(format!("cannot publish results: {why}"))),
        None => result,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::batch::End;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use tauflow_contract::Digest;

    #[derive(Debug, Default)]
    struct Counting(AtomicUsize);

    impl Courier for Counting {
        fn publish(&self, _: &Store, _: &[Digest], _: &[(&str, Key)]) -> Result<(), String> {
            Ok(())
        }

        fn put(&self, _: &str, text: Vec<u8>) -> Result<(), String> {
            self.0.store(text.iter().filter(|byte| **byte == b'\n').count(), Ordering::Relaxed);
            Ok(())
        }

        fn get(&self, _: &str) -> Result<Option<Vec<u8>>, String> {
            Ok(None)
        }

        fn delete(&self, _: &[String]) {}

        fn refresh(&self) -> Result<(), String> {
            Ok(())
        }
    }

    #[test]
    fn a_long_action_is_told_of_while_it_runs_and_short_ones_together() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("store")).expect("a store");
        let courier = Counting::default();
        let mut told = Told::new(&store, &courier, "1");
        let lines = || courier.0.load(Ordering::Relaxed);
        let ended = |action| Line::Ended { action, end: End::Hit, warning: None, spent_us: 0, recorded: None };
        told.hear(&Line::Begun { action: 0 });
        assert_eq!(lines(), 1, "the job has begun");
        told.hear(&ended(0));
        told.hear(&Line::Begun { action: 1 });
        let now = Instant::now();
        told.look(now + LONG / 2);
        assert_eq!(lines(), 1);
        told.hear(&Line::Progress { action: 1, done: 1, total: 2, message: String::new() });
        told.look(now + LONG + LOOK);
        assert_eq!(lines(), 3, "it is a long one");
        told.look(now + 10 * EVERY);
        assert_eq!(lines(), 3, "nothing is new");
        // Short ones.
        told.hear(&ended(1));
        let now = Instant::now();
        told.look(now + LONG + LOOK);
        assert_eq!(lines(), 3);
        told.look(now + EVERY);
        assert_eq!(lines(), 4);
    }
}
