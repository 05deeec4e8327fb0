//! Writes the adapter's page over made-up material, to look at its layout: `cargo run --release -p tauflow-report
//! --example sample_adapter_report -- FOLDER`. Nothing in it is a result.

#[path = "../tests/made_up/mod.rs"]
mod made_up;

use std::{error::Error, path::PathBuf};
use tauflow_report::AdapterReportParams;

fn main() -> Result<(), Box<dyn Error>> {
    let folder =
        std::env::args().nth(1).map_or_else(|| std::env::temp_dir().join("tauflow-sample-adapter"), PathBuf::from);
    std::fs::create_dir_all(&folder)?;
    let params = AdapterReportParams {
        subtitle: "Made-up samples and scores: nothing here is a result.".into(),
        ..AdapterReportParams::default()
    };
    for (name, bytes) in made_up::files(params, &made_up::quality(), 3)? {
        std::fs::write(folder.join(name), bytes)?;
    }
    println!("{}", folder.join("adapter_report.html").display());
    Ok(())
}
