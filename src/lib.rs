//! `tauflow`: a data-flow engine for declarative pipelines, and its command line.
//!
//! docs/ARCHITECTURE.md describes the architecture. The engine knows no kind; [`registry`] names them all.

pub mod cli;
pub mod diagnostics;
pub mod engine;
pub mod ids;
pub mod kinds;
pub mod lock;
pub mod pipeline;
pub mod query;
pub mod registry;
pub mod runs;
pub mod units;
