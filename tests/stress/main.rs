//! Numerical hazards, one after the other: what is fed, what must come out, and what did.
//!
//! `docs/stress_table.md` is made by this test. All is deterministic, so that the page is held against this run.
//! `TAUFLOW_STRESS_DOC=1` writes it anew, and `docs/stress.md` says what it shows.

#[path = "../../nodes/render/tests/scenes/mod.rs"]
mod scenes;

mod dark;
mod data;
mod dead;
mod drift;
mod geometry;
mod interrupted;
mod learning;
mod materials;
mod metrics;
mod networks;
mod refraction;
mod rendering;
mod transport;

use rayon::prelude::*;
use std::{fmt::Write as _, fs, path::Path};

/// One hazard.
pub struct Hazard {
    /// What it threatens.
    area: &'static str,
    /// What is fed.
    fed: String,
    /// What must come out.
    must: String,
    /// What did come out; an error if it is not what must.
    came: Result<String, String>,
}

impl Hazard {
    /// A hazard and what came of it.
    pub fn new(
        area: &'static str,
        fed: impl Into<String>,
        must: impl Into<String>,
        came: Result<String, String>,
    ) -> Self {
        Self { area, fed: fed.into(), must: must.into(), came }
    }
}

/// `Ok` with the text if it holds, else `Err` with it.
///
/// # Errors
/// If it does not hold.
pub fn held(holds: bool, came: String) -> Result<String, String> {
    if holds { Ok(came) } else { Err(came) }
}

/// A number in words that do not depend on its last digits.
pub fn about(value: f64) -> String {
    if value == 0.0 { "0".into() } else { format!("{value:.1e}") }
}

/// Where the table is, and what stands above it.
const TABLE: &str = "docs/stress_table.md";
const HEAD: &str = "\
# Numerical stress: the table

This file is generated. `cargo test --release --test stress` holds it against every run, and with `TAUFLOW_STRESS_DOC=1`
writes it anew. [stress.md](stress.md) says what it shows. Where precision is lost, the last column says how much.
";

fn page(hazards: &[Hazard]) -> String {
    let mut out = String::from(HEAD);
    let mut area = "";
    for hazard in hazards {
        if hazard.area != area {
            area = hazard.area;
            let _ = write!(out, "\n## {area}\n\n| fed | must come out | came out |\n|---|---|---|\n");
        }
        let came = hazard.came.as_ref().map_or_else(|failed| format!("**{failed}**"), Clone::clone);
        let _ = writeln!(out, "| {} | {} | {came} |", hazard.fed, hazard.must);
    }
    out
}

#[test]
fn every_hazard_is_met_and_the_page_tells_what_came_of_it() {
    // Each is deterministic, so they may run side by side.
    type Area = (&'static str, fn() -> Vec<Hazard>);
    let areas: [Area; 9] = [
        ("rendering", rendering::hazards),
        ("materials", materials::hazards),
        ("transport", transport::hazards),
        ("learning", learning::hazards),
        ("networks", networks::hazards),
        ("dark", dark::hazards),
        ("dead", dead::hazards),
        ("data", data::hazards),
        ("metrics", metrics::hazards),
    ];
    let hazards: Vec<Hazard> =
        areas.into_par_iter().flat_map_iter(|(name, hazards)| tauflow_testing::part(name, hazards)).collect();
    let failed: Vec<String> = hazards
        .iter()
        .filter_map(|h| Some(format!("{}: {}: {}, not: {}", h.area, h.fed, h.came.as_ref().err()?, h.must)))
        .collect();
    println!("{} hazards, {} of them not met", hazards.len(), failed.len());
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    let found = page(&hazards);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(TABLE);
    if std::env::var_os("TAUFLOW_STRESS_DOC").is_some_and(|v| !v.is_empty()) {
        fs::write(&path, &found).expect("writable");
    }
    let told = fs::read_to_string(&path).unwrap_or_default();
    for (told, found) in told.lines().zip(found.lines()) {
        assert_eq!(told, found, "{TABLE} is not of this run; TAUFLOW_STRESS_DOC=1 writes it");
    }
    assert_eq!(told.len(), found.len(), "{TABLE} is not of this run; TAUFLOW_STRESS_DOC=1 writes it");
}
