//! Writes a report over synthetic material, to look at its layout: `cargo run --release -p tauflow-report --example
//! sample_report -- FOLDER`. Nothing in it is a result.

#[path = "../tests/common/mod.rs"]
mod common;

use std::{error::Error, path::PathBuf};
use tauflow_contract::MemoryBlobs;
use tauflow_report::ReportParams;

fn main() -> Result<(), Box<dyn Error>> {
    let folder =
        std::env::args().nth(1).map_or_else(|| std::env::temp_dir().join("tauflow-sample-report"), PathBuf::from);
    let blobs = MemoryBlobs::default();
    let params = ReportParams { title: "Sample of a report, synthetic data".into(), ..ReportParams::default() };
    for (name, bytes) in common::run(&blobs, params, &common::extras::all(&blobs, 64))? {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap_or(&folder))?;
        std::fs::write(path, bytes)?;
    }
    println!("{}", folder.join("report.html").display());
    Ok(())
}
