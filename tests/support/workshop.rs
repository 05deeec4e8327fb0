//! A store in a temporary folder, and runs of small pipelines in it.

use super::registry;
use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
    },
};
use tauflow::{
    engine::{
        self, EngineError, Only, RunOptions, Summary,
        event::{Ended, Event},
    },
    ids::{Id, PortId},
    pipeline::{self, Options, Pipeline},
};
use tauflow_cache::Store;
use tauflow_contract::Collection;

/// A store and a folder for results.
pub struct Workshop {
    folder: tempfile::TempDir,
}

/// What a run did.
pub struct Ran {
    /// The engine's own account.
    pub summary: Summary,
    /// All that was told, in order.
    pub events: Vec<Event>,
}

impl Ran {
    /// Actions that ran, by node; nodes of which none ran are left out.
    pub fn ran(&self) -> BTreeMap<&str, u64> {
        self.count(|n| n.ran)
    }

    /// Any number of each node that is not zero.
    pub fn count(&self, of: impl Fn(&engine::event::NodeStat) -> u64) -> BTreeMap<&str, u64> {
        self.summary.nodes.iter().map(|n| (n.node.as_str(), of(n))).filter(|(_, count)| *count > 0).collect()
    }

    /// `node/item` of every action that ended like this, in order.
    pub fn ended(&self, like: Ended) -> Vec<String> {
        let of = |event: &Event| match event {
            Event::End { node, item, outcome, .. } if *outcome == like => Some(format!("{node}/{item}")),
            _ => None,
        };
        self.events.iter().filter_map(of).collect()
    }
}

impl Workshop {
    /// An empty one.
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a temporary folder can be made") }
    }

    /// The folder of the store.
    pub fn cache(&self) -> PathBuf {
        self.folder.path().join("cache")
    }

    /// The folder of results.
    pub fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    /// Any other folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The store, opened anew.
    pub fn store(&self) -> Store {
        Store::open(&self.cache()).expect("a temporary folder can be written")
    }

    /// Runs a pipeline of toy kinds with two jobs, without publishing.
    pub fn run(&self, text: &str) -> Ran {
        self.run_with(text, &RunOptions { jobs: 2, ..RunOptions::default() }, |_, _| {})
    }

    /// Runs with options; `look` sees every event, and may stop the run.
    pub fn run_with(&self, text: &str, options: &RunOptions, look: impl Fn(&Event, &AtomicBool) + Sync) -> Ran {
        self.try_run(&resolve(text), options, look).expect("the store works")
    }

    /// Runs the part that `only` names.
    pub fn run_only(&self, text: &str, only: &str) -> Ran {
        let pipeline = resolve(text);
        let only = Some(Only::parse(only, &pipeline).expect("it is there"));
        self.try_run(&pipeline, &RunOptions { only, jobs: 1, ..RunOptions::default() }, |_, _| {}).expect("runs")
    }

    /// Runs a resolved pipeline.
    pub fn try_run(
        &self,
        pipeline: &Pipeline,
        options: &RunOptions,
        look: impl Fn(&Event, &AtomicBool) + Sync,
    ) -> Result<Ran, EngineError> {
        let store = self.store();
        let stop = AtomicBool::new(false);
        let events = Mutex::new(Vec::new());
        let sink = |event: &Event| {
            look(event, &stop);
            events.lock().expect("nobody panics in here").push(event.clone());
        };
        let summary = engine::run(pipeline, &store, options, &stop, &sink)?;
        assert!(summary.interrupted == stop.load(Ordering::Relaxed));
        Ok(Ran { summary, events: events.into_inner().expect("nobody panicked in there") })
    }

    /// The collection on a port.
    pub fn outputs(&self, text: &str, node: &str, port: usize) -> Result<Collection, EngineError> {
        let pipeline = resolve(text);
        let node = pipeline.node(node).expect("it is there");
        engine::outputs(&pipeline, &self.store(), node, PortId::at(port))
    }

    /// The numbers on a node's default port, by item.
    pub fn numbers(&self, text: &str, node: &str) -> BTreeMap<String, i64> {
        let collection = self.outputs(text, node, 0).expect("it has run");
        let store = self.store();
        let number = |artifact: &tauflow_contract::Artifact| {
            let bytes = store.get(&artifact.part("").expect("one blob")).expect("readable").expect("there");
            String::from_utf8_lossy(&bytes).trim().parse().expect("a number")
        };
        collection.iter().map(|(key, artifact)| (key.to_string(), number(artifact))).collect()
    }
}

/// Resolves a valid pipeline.
pub fn resolve(text: &str) -> Pipeline {
    match pipeline::resolve_text("toy.yaml", text, &registry(), &Options::default()) {
        Ok(pipeline) => pipeline,
        Err(problems) => panic!("{problems}"),
    }
}
