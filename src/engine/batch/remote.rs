//! A batch whose process shares nothing with the run but what a [`Courier`] carries: it publishes its results, and then
//! tells of them.

use super::{BatchFile, Line};
use crate::{
    engine::{EngineError, courier::Courier, reached::seen_by, records::ACTION},
    kinds::Registry,
};
use std::{
    sync::{Mutex, PoisonError, atomic::AtomicBool},
    time::{Duration, Instant},
};
use tauflow_cache::{Key, Store};

/// Time between two publications of a batch.
const EVERY: Duration = Duration::from_secs(30);

/// The lines of a batch, and how many are told.
struct Told<'a> {
    store: &'a Store,
    courier: &'a dyn Courier,
    name: &'a str,
    text: Vec<u8>,
    /// Records of actions that have ended, and were not published.
    ended: Vec<Key>,
    last: Option<Instant>,
    /// Why nothing can be published.
    failed: Option<String>,
}

impl Told<'_> {
    fn hear(&mut self, line: &Line) {
        if let Line::Progress { .. } = line {
            return; // each would be a request
        }
        serde_json::to_writer(&mut self.text, line).expect("lines are plain data");
        self.text.push(b'\n');
        // The first line says that the job has begun.
        if self.last.is_none_or(|last| last.elapsed() >= EVERY) {
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
        self.last = Some(Instant::now());
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
    let told = Told { store, courier, name, text: Vec::new(), ended: Vec::new(), last: None, failed: None };
    let told = Mutex::new(told);
    let lock = || told.lock().unwrap_or_else(PoisonError::into_inner);
    let recorded = |key| lock().ended.push(key);
    let result = batch.run(store, registry, stop, &|line| lock().hear(line), Some(&recorded));
    let mut told = lock();
    told.publish();
    match told.failed.take() {
        Some(why) => Err(EngineError::Executor(format!("cannot publish results: {why}"))),
        None => result,
    }
}
