//! The process that faults happen to: this program again, which runs a pipeline of toy kinds and keeps a ledger.

use crate::kinds::registry;
use std::{
    collections::BTreeMap,
    fs::File,
    io::Write,
    path::Path,
    process::{self, Command},
    sync::{Mutex, atomic::AtomicBool},
};
use tauflow::{
    engine::{
        self, ChildCommand, EngineError, ExecutorKind, RunOptions,
        batch::{self, BatchFile},
        event::{Ended, Event},
    },
    ids::PortId,
    pipeline::{self, Options, Pipeline},
};
use tauflow_cache::{Key, Store};

/// Where the cache lies.
pub const CACHE: &str = "TAUFLOW_FAULTS_CACHE";
/// Where a line is added for every action that was announced as done.
pub const LEDGER: &str = "TAUFLOW_FAULTS_LEDGER";
/// The pipeline's text.
pub const TEXT: &str = "TAUFLOW_FAULTS_TEXT";

/// Runs actions in child processes, if it is set.
pub const PROCESSES: &str = "TAUFLOW_FAULTS_PROCESSES";
/// The file of a batch, for such a child.
const BATCH: &str = "TAUFLOW_FAULTS_BATCH";

/// A text that begins with this names a node, whose outputs are read as `export` does.
pub const EXPORT: &str = "#export";

/// Runs in a child; ends it with the code of the command line, and prints the digests of all outputs.
#[test]
fn child() {
    let (Ok(cache), Ok(ledger), Ok(text)) = (std::env::var(CACHE), std::env::var(LEDGER), std::env::var(TEXT)) else {
        return;
    };
    println!(); // the test runner has begun a line
    process::exit(match run(Path::new(&cache), Path::new(&ledger), &text) {
        Ok(true) => 0,
        Ok(false) => 1,
        Err(message) => {
            println!("error: {message}");
            3
        }
    });
}

/// Runs a batch in a child of a child.
#[test]
fn batch() {
    let (Ok(cache), Ok(batch)) = (std::env::var(CACHE), std::env::var(BATCH)) else { return };
    println!(); // the test runner has begun a line
    let batch = BatchFile::read(Path::new(&batch)).expect("a batch");
    let store = Store::open(Path::new(&cache)).expect("a store");
    batch::serve(batch, &store, &registry(), batch::Telling::Parent).expect("it runs");
    drop(store);
    process::exit(0);
}

/// Where actions run.
fn executor() -> ExecutorKind {
    if std::env::var_os(PROCESSES).is_none() {
        return ExecutorKind::Threads;
    }
    ExecutorKind::Processes(ChildCommand::new(|batch, cache| {
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        command.args(["--exact", "child::batch", "--nocapture", "--test-threads=1"]);
        command.env(BATCH, batch).env(CACHE, cache);
        command
    }))
}

/// Reads all that a node gave, as `export` does, and makes again what is lost.
fn export(pipeline: &Pipeline, store: &Store, node: &str) -> Result<bool, String> {
    let node = pipeline.node(node).ok_or("there is no such node")?;
    let restore = || {
        let stop = AtomicBool::new(false);
        let summary =
            engine::restore(pipeline, store, (node, PortId::DEFAULT), &stop, &|_| {}).map_err(|e| e.to_string())?;
        summary.failures.first().map_or(Ok(()), |failure| Err(failure.message.clone()))
    };
    let whole = || -> Result<Option<Vec<String>>, String> {
        let mut lines = Vec::new();
        let found = match engine::outputs(pipeline, store, node, PortId::DEFAULT) {
            Err(EngineError::Lost(_)) => return Ok(None),
            found => found.map_err(|e| e.to_string())?,
        };
        for (key, artifact) in found.iter() {
            for digest in artifact.parts.values() {
                let Some(bytes) = store.get(digest).map_err(|e| e.to_string())? else { return Ok(None) };
                lines.push(format!("output {key} {}", String::from_utf8_lossy(&bytes).trim()));
            }
        }
        Ok(Some(lines))
    };
    let lines = match whole()? {
        Some(lines) => lines,
        None => {
            restore()?;
            whole()?.ok_or("it was not restored")?
        }
    };
    lines.iter().for_each(|line| println!("{line}"));
    Ok(true)
}

fn run(cache: &Path, ledger: &Path, text: &str) -> Result<bool, String> {
    let ledger = File::options().append(true).open(ledger).map_err(|e| e.to_string())?;
    let ledger = Mutex::new(ledger);
    let pipeline = pipeline::resolve_text("faults.yaml", text, &registry(), &Options::default());
    let pipeline = pipeline.map_err(|e| e.to_string())?;
    let of = Key::of(text.as_bytes()).short();
    let store = Store::open(cache).map_err(|e| e.to_string())?;
    if let Some(node) = text.lines().next().and_then(|line| line.strip_prefix(EXPORT)) {
        return export(&pipeline, &store, node.trim());
    }
    // A pass that makes lost blobs again tells anew what the passes before it did; that has not begun again.
    let begun: Mutex<BTreeMap<String, usize>> = Mutex::default();
    let sink = |event: &Event| match event {
        Event::Begin { node, cell, item } => {
            *begun.lock().expect("nobody panics in here").entry(format!("{node} {cell} {item}")).or_default() += 1;
        }
        Event::End { node, cell, item, group, outcome: Ended::Ran, .. } => {
            match begun.lock().expect("nobody panics in here").get_mut(&format!("{node} {cell} {item}")) {
                Some(count) if *count > 0 => *count -= 1,
                _ => return,
            }
            let line = format!("{of} {node} {cell} {item} {group}\n");
            // One write each, so that lines of several processes do not mix; on a full disk the line is missing.
            let _ = ledger.lock().expect("nobody panics in here").write_all(line.as_bytes());
        }
        Event::Warning { message } => println!("warning: {message}"),
        _ => {}
    };
    // Few items go by shards here, too: roll-ups of shards and listings of two levels meet every fault.
    let options = RunOptions { jobs: 2, many: 8, executor: executor(), ..RunOptions::default() };
    let summary =
        engine::run(&pipeline, &store, &options, &AtomicBool::new(false), &sink).map_err(|e| e.to_string())?;
    for failure in &summary.failures {
        println!("failed: {} {} {}", failure.node, failure.item, failure.message);
    }
    for output in &summary.outputs {
        println!("output {} {}", output.name, output.digest.map_or("unknown".to_owned(), |d| d.to_string()));
    }
    drop(store);
    Ok(summary.failures.is_empty())
}
