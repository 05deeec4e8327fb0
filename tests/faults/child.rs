//! The process that faults happen to: this program again, which runs a pipeline of toy kinds and keeps a ledger.

use crate::kinds::registry;
use std::{
    fs::File,
    io::Write,
    path::Path,
    process,
    sync::{Mutex, atomic::AtomicBool},
};
use tauflow::{
    engine::{
        self, RunOptions,
        event::{Ended, Event},
    },
    pipeline::{self, Options},
};
use tauflow_cache::{Key, Store};

/// Where the cache lies.
pub const CACHE: &str = "TAUFLOW_FAULTS_CACHE";
/// Where a line is added for every action that was announced as done.
pub const LEDGER: &str = "TAUFLOW_FAULTS_LEDGER";
/// The pipeline's text.
pub const TEXT: &str = "TAUFLOW_FAULTS_TEXT";

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

fn run(cache: &Path, ledger: &Path, text: &str) -> Result<bool, String> {
    let ledger = File::options().append(true).open(ledger).map_err(|e| e.to_string())?;
    let ledger = Mutex::new(ledger);
    let pipeline = pipeline::resolve_text("faults.yaml", text, &registry(), &Options::default());
    let pipeline = pipeline.map_err(|e| e.to_string())?;
    let of = Key::of(text.as_bytes()).short();
    let store = Store::open(cache).map_err(|e| e.to_string())?;
    let sink = |event: &Event| {
        if let Event::End { node, cell, item, group, outcome: Ended::Ran, .. } = event {
            let line = format!("{of} {node} {cell} {item} {group}\n");
            // One write each, so that lines of several processes do not mix; on a full disk the line is missing.
            let _ = ledger.lock().expect("nobody panics in here").write_all(line.as_bytes());
        }
    };
    // Few items go by shards here, too: roll-ups of shards and listings of two levels meet every fault.
    let options = RunOptions { jobs: 2, many: 8, ..RunOptions::default() };
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
