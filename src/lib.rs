//! `tauflow`: a data-flow graph engine with declarative pipelines, and the command line over it.
//!
//! See docs/ARCHITECTURE.md for how the parts hang together. The engine knows no kind; [`registry`] names them all.

pub mod cli;
pub mod diagnostics;
pub mod engine;
pub mod ids;
pub mod kinds;
pub mod lock;
pub mod pipeline;
pub mod query;
pub mod registry;
