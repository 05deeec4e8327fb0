//! Overhead of the engine: ten map nodes over many items that do next to nothing; and large items beside plain files.
//!
//! ```text
//! cargo bench --bench engine [-- ITEMS [FOLDER [UPSTREAM]]]
//! ```
//!
//! The default is 30,000 items. The cache lies in FOLDER, or in memory. UPSTREAM is a new directory or a prefix
//! in an object store: the results are pushed there, and a second machine with an empty cache runs the same.
//!
//! `benches/engine_peers.sh` does the same graph with ninja and with Snakemake.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    error::Error,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};
use tauflow::{
    engine::{self, RunOptions, Summary},
    kinds::Registry,
    pipeline::{self, Options},
};
use tauflow_cache::Store;
use tauflow_contract::{
    Action, Artifact, Context, Each, Group, InputPort, ItemKey, Kind, KindError, KindRow, KindSpec, Media, Mode,
    NodeKind, Out, Outputs, ReadFiles, SourceItem, Stored, WriteFiles,
};
use tauflow_upstream::{Address, Reader, Upstream, all, push};

/// Bytes of an output.
const SIZE: usize = 1024;
/// Map nodes in a row.
const NODES: usize = 10;

/// What the nodes hand each other.
struct Bytes(Vec<u8>);

const FILE: &str = "bytes.bin";

impl Media for Bytes {
    const NAME: &'static str = "bench";
    const DOC: &'static str = "Bytes: `bytes.bin`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        Ok(Self(ctx.part(artifact, "")?))
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        Ok(Stored::blob(ctx.put(&self.0)?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        to.put(FILE, &Self::load(ctx, artifact)?.0)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        Self(from.need(FILE)?).store(ctx)
    }
}

const IN: Each<Bytes> = Each::new("in", "What to copy.");
const OUT: Out<Bytes> = Out::new(Group::main(1), "out", "A kilobyte.");

#[derive(Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct SourceParams {
    /// How many items.
    items: u64,
    /// The item that is another than before.
    changed: u64,
    /// Bytes of an item.
    bytes: usize,
}

struct Source;

impl Kind for Source {
    type Params = SourceParams;

    fn spec() -> KindSpec {
        spec("source", Mode::Source, vec![])
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        (0..params.items).map(|i| Ok(SourceItem { key: key(i)?, files: Vec::new() })).collect()
    }

    fn project(params: &Self::Params, item: Option<&ItemKey>, _: &str) -> Value {
        let index = item.and_then(|i| i.as_str().parse::<u64>().ok()).unwrap_or_default();
        let changed = u64::from(params.changed > 0 && params.changed == index);
        json!({ "items": index, "changed": changed, "bytes": params.bytes })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let mut bytes = vec![0; action.params.bytes.max(SIZE)];
        bytes[..8].copy_from_slice(&action.params.items.to_le_bytes());
        bytes[8] = action.params.changed as u8;
        Ok(Outputs::default().put(OUT, Bytes(bytes).store(ctx)?))
    }
}

#[derive(Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct CopyParams {
    /// Which node this is.
    node: u8,
}

struct Copy;

impl Kind for Copy {
    type Params = CopyParams;

    fn spec() -> KindSpec {
        spec("copy", Mode::Map, vec![IN.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let Bytes(mut bytes) = action.read(ctx, IN)?;
        bytes[9] = action.params.node;
        Ok(Outputs::default().put(OUT, Bytes(bytes).store(ctx)?))
    }
}

fn spec(name: &'static str, mode: Mode, inputs: Vec<InputPort>) -> KindSpec {
    let outputs = vec![OUT.port()];
    KindSpec { name, summary: "A toy.", manual: "", mode, inputs, outputs, seeded: false }
}

fn key(index: u64) -> Result<ItemKey, KindError> {
    ItemKey::new(format!("{index:06}")).map_err(|e| KindError::Internal(e.to_string()))
}

/// Largest memory of this process so far, in MiB.
fn memory() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).unwrap_or("0 kB");
    line.trim().trim_end_matches(" kB").trim().parse::<f64>().unwrap_or(0.0) / 1024.0
}

struct Bench {
    registry: Registry,
    folder: PathBuf,
    items: u64,
}

impl Bench {
    /// Resolves and runs the pipeline in a freshly opened store, as a new process would; seconds and what it did.
    fn run(&self, changed: u64, no_rollup: bool) -> Result<(f64, Summary), Box<dyn Error>> {
        self.run_in(&|| Ok(Store::open(&self.folder)?), changed, no_rollup)
    }

    fn run_in(
        &self,
        open: &dyn Fn() -> Result<Store, Box<dyn Error>>,
        changed: u64,
        no_rollup: bool,
    ) -> Result<(f64, Summary), Box<dyn Error>> {
        let start = Instant::now();
        let mut text = format!(
            "pipeline: bench\nnodes:\n  n0: {{ kind: source, params: {{ items: {}, changed: {changed} }} }}\n",
            self.items
        );
        for node in 1..=NODES {
            let before = node - 1;
            text.push_str(&format!(
                "  n{node}: {{ kind: copy, inputs: {{ in: n{before} }}, params: {{ node: {node} }} }}\n"
            ));
        }
        let pipeline = pipeline::resolve_text("bench.yaml", &text, &self.registry, &Options::default())?;
        let store = open()?;
        let options = RunOptions { no_rollup, ..RunOptions::default() };
        let summary = engine::run(&pipeline, &store, &options, &AtomicBool::new(false), &|_| {})?;
        drop(store);
        assert!(summary.failures.is_empty());
        Ok((start.elapsed().as_secs_f64(), summary))
    }

    /// Pushes the results, and tells what a second machine with an empty cache takes.
    fn second_machine(&self, address: &Address) -> Result<(), Box<dyn Error>> {
        const SHARED: &[&str] = &["action", "rollup", "shard"];
        let store = Store::open(&self.folder)?;
        let upstream = Upstream::create(address)?;
        let start = Instant::now();
        push(&store, &upstream, &all(&store, SHARED), &|_| true, false, &mut |_, _| {})?;
        let traffic = upstream.traffic().unwrap_or_default();
        println!(
            "pushed in {:.1} s: {} requests, {} bytes",
            start.elapsed().as_secs_f64(),
            traffic.requests,
            traffic.sent
        );
        for (what, changed, no_rollup) in [
            ("second machine, by roll-ups", 0, false),
            ("second machine, every key derived", 0, true),
            ("second machine, one source item changed", self.items / 2, false),
        ] {
            let folder = tempfile::tempdir()?;
            let (at, kept) = (address.clone(), folder.path().join("upstream"));
            let opening = move || Ok(Upstream::open(&at)?.keeping(&kept));
            let reader =
                Arc::new(Reader::new(Box::new(opening), SHARED, |_| true, Box::new(|note| eprintln!("{note}"))));
            let open = || -> Result<Store, Box<dyn Error>> {
                let mut store = Store::open(folder.path())?;
                store.look_beyond(reader.clone());
                Ok(store)
            };
            let (seconds, summary) = self.run_in(&open, changed, no_rollup)?;
            let ran: u64 = summary.nodes.iter().map(|n| n.ran).sum();
            let traffic = reader.traffic().unwrap_or_default();
            let (requests, bytes) = (traffic.requests, traffic.received);
            println!("{what:<44} {seconds:>9.2} s, {ran} ran, {requests} requests, {bytes} bytes received");
        }
        Ok(())
    }

    /// Runs with each of these items changed (0 is none) and tells the median.
    fn tell(&self, what: &str, changed: &[u64], no_rollup: bool) -> Result<(), Box<dyn Error>> {
        let times = changed.len();
        let mut runs = Vec::new();
        for item in changed {
            runs.push(self.run(*item, no_rollup)?);
        }
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (seconds, summary) = &runs[times / 2];
        let ran: u64 = summary.nodes.iter().map(|n| n.ran).sum();
        let actions = self.items as f64 * (NODES as f64 + 1.0);
        println!(
            "{what:<44} {:>9.1} ms {:>8.2} us per action, {ran} ran, {:.0} MiB at most so far",
            seconds * 1e3,
            seconds * 1e6 / actions,
            memory()
        );
        Ok(())
    }
}

/// Items of 10 MB, one after the other, beside plain files that are written and synced; both are there when the power
/// goes.
fn large(registry: &Registry, folder: &std::path::Path) -> Result<(), Box<dyn Error>> {
    const COUNT: u64 = 30;
    const BYTES: usize = 10_000_000;
    let mut ratios = Vec::new();
    let (mut ours, mut plain) = (Vec::new(), Vec::new());
    for round in 0..5 {
        let start = Instant::now();
        for item in 0..COUNT {
            let mut bytes = vec![0; BYTES];
            bytes[..8].copy_from_slice(&(item + 1000 * round).to_le_bytes());
            let mut file = std::fs::File::create(folder.join(format!("plain{round}-{item}")))?;
            std::io::Write::write_all(&mut file, &bytes)?;
            file.sync_data()?;
        }
        plain.push(start.elapsed().as_secs_f64() / COUNT as f64);
        let text = format!(
            "pipeline: large\nseed: {round}\nnodes:\n  n: \
             {{ kind: source, params: {{ items: {COUNT}, bytes: {} }} }}\n",
            BYTES + round as usize
        );
        let pipeline = pipeline::resolve_text("large.yaml", &text, registry, &Options::default())?;
        let store = Store::open(&folder.join("large"))?;
        let start = Instant::now();
        let options = RunOptions { jobs: 1, ..RunOptions::default() };
        let summary = engine::run(&pipeline, &store, &options, &AtomicBool::new(false), &|_| {})?;
        ours.push(start.elapsed().as_secs_f64() / COUNT as f64);
        assert_eq!(summary.nodes[0].ran, COUNT);
        ratios.push(ours[ours.len() - 1] / plain[plain.len() - 1]);
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    println!(
        "one item of 10 MB {:>45.1} ms; a plain file, synced, {:.1} ms; ratio {:.2}",
        median(ours) * 1e3,
        median(plain) * 1e3,
        median(ratios)
    );
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    let items = args.next().map_or(Ok(30_000), |a| a.parse())?;
    let own = tempfile::tempdir_in(args.next().map_or_else(std::env::temp_dir, PathBuf::from))?;
    let upstream = args.next().map(|address| address.parse::<Address>()).transpose()?;
    let registry =
        Registry::new([Box::new(KindRow::<Source>::new()) as Box<dyn NodeKind>, Box::new(KindRow::<Copy>::new())]);
    large(&registry, own.path())?;
    let bench = Bench { registry, folder: own.path().join("store"), items };
    bench.tell("first run", &[0], false)?;
    bench.tell("nothing changed, by roll-ups", &[0; 5], false)?;
    bench.tell("nothing changed, every key derived", &[0; 5], true)?;
    bench.tell("one source item changed", &[2, 3, 5, 7, 11].map(|n| items / n), false)?;
    if let Some(address) = &upstream {
        bench.second_machine(address)?;
    }
    Ok(())
}
