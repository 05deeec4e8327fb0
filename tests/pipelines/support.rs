//! Results of a pipeline, read out of a store.

use std::{collections::BTreeMap, path::Path, sync::atomic::AtomicBool};
use tauflow::{
    engine::{self, RunOptions},
    ids::{Id, PortId},
    pipeline::{self, Options, Pipeline},
    registry,
};
use tauflow_cache::Store;
use tauflow_contract::{
    Artifact, Blobs, Collection, Context, Digest, Handle, ItemKey, KindError, Media, MemoKey, Silent,
};

/// A pipeline that was run, and the store with its results.
pub struct Done {
    pipeline: Pipeline,
    store: Store,
}

impl Done {
    /// Resolves a pipeline file and brings its targets up to date; nothing may fail.
    pub fn run(file: &Path, sets: Vec<String>, store: &Path) -> Self {
        Self::run_with(file, sets, store, &RunOptions::default())
    }

    /// The same with options of the engine's.
    pub fn run_with(file: &Path, sets: Vec<String>, store: &Path, run: &RunOptions) -> Self {
        Self::resolved(file, &Options { sets, ..Options::default() }, store, run)
    }

    /// The same with a profile of the file.
    pub fn run_profile(file: &Path, profile: &str, sets: Vec<String>, store: &Path, run: &RunOptions) -> Self {
        Self::resolved(file, &Options { sets, profile: Some(profile.to_owned()), ..Options::default() }, store, run)
    }

    fn resolved(file: &Path, options: &Options, store: &Path, run: &RunOptions) -> Self {
        let pipeline = match pipeline::resolve(file, &registry::registry(), options) {
            Ok(pipeline) => pipeline,
            Err(problems) => panic!("{problems}"),
        };
        let store = Store::open(store).expect("the folder can be written");
        let stop = AtomicBool::new(false);
        let summary = engine::run(&pipeline, &store, run, &stop, &|_| {}).expect("runs");
        assert!(summary.failures.is_empty(), "{:#?}", summary.failures);
        Self { pipeline, store }
    }

    /// Hands out a context that reads from the store.
    pub fn with<T>(&self, read: impl FnOnce(&Context<'_>) -> T) -> T {
        read(&Context::new(&Reading(&self.store), &Silent, &AtomicBool::new(false)))
    }

    /// The kind of the node of `node.port`, and the version of the port's group.
    pub fn kind(&self, port: &str) -> (&'static str, u32) {
        let (name, port) = port.split_once('.').expect("`node.port`");
        let node = &self.pipeline.nodes[self.pipeline.node(name).expect("the node is there")];
        let port = node.output(port).expect("the port is there");
        (node.spec.name, node.spec.outputs[port.place()].group.version)
    }

    /// What stands at `node` or `node.port`.
    pub fn collection(&self, node: &str) -> Collection {
        let (name, port) = node.split_once('.').unwrap_or((node, ""));
        let node = self.pipeline.node(name).expect("the node is there");
        let of = &self.pipeline.nodes[node];
        let port = if port.is_empty() { PortId::DEFAULT } else { of.output(port).expect("the port is there") };
        engine::outputs(&self.pipeline, &self.store, node, port).expect("up to date")
    }

    /// The keys at `node` or `node.port`.
    pub fn keys(&self, node: &str) -> Vec<String> {
        self.collection(node).iter().map(|(key, _)| key.to_string()).collect()
    }

    /// The bytes of a part of an artifact.
    pub fn part(&self, artifact: &Artifact, part: &str) -> Vec<u8> {
        let digest = artifact.part(part).expect("the part is there");
        self.store.get(&digest).expect("the store can be read").expect("the blob is there")
    }

    /// Every item, loaded.
    pub fn read<M: Media>(&self, node: &str) -> BTreeMap<String, M> {
        let load = |(key, artifact): (&ItemKey, &Artifact)| {
            let handle = Handle::<M>::new(artifact).expect("of this media type");
            (key.to_string(), self.with(|ctx| handle.load(ctx)).expect("what the kind wrote"))
        };
        self.collection(node).iter().map(load).collect()
    }

    /// The only item, loaded.
    pub fn only<M: Media>(&self, node: &str) -> M {
        let mut items = self.read(node).into_values();
        let only = items.next().expect("an item");
        assert!(items.next().is_none(), "`{node}` has several items");
        only
    }
}

struct Reading<'a>(&'a Store);

impl Blobs for Reading<'_> {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        Ok(self.0.get(digest).expect("the store can be read"))
    }

    fn put(&self, _: &[u8]) -> Result<Digest, KindError> {
        unreachable!("results are read")
    }

    fn memo_get(&self, _: &MemoKey) -> Option<Artifact> {
        None
    }

    fn memo_put(&self, _: &MemoKey, _: &Artifact) -> Result<(), KindError> {
        unreachable!("results are read")
    }
}

/// The folder of this project.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}
