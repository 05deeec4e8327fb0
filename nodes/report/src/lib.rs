//! Plots, montages, tables and the HTML report.
//!
//! Knows other kinds by their artifacts' formats alone, and computes no score: what it prints was measured elsewhere.

mod adapter_report;
mod album;
mod contact_sheet;
mod csv;
mod font;
mod gate_sheets;
mod ladder_pictures;
mod material;
mod method_pictures;
mod montage;
mod page;
mod ranking;
mod report;
mod sections;
mod shelf;
mod svg;
mod tex;
mod text;

pub use adapter_report::{AdapterReport, AdapterReportParams};
pub use report::{Report, ReportParams};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<Report>::new()),
        Box::new(KindRow::<AdapterReport>::new()),
        Box::new(KindRow::<contact_sheet::ContactSheet>::new()),
    ]
}
