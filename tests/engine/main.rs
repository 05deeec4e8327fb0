//! The engine on toy kinds: what runs, what does not, and what is told.

#[path = "../support/mod.rs"]
mod support;

mod caching;
mod demand;
mod diagnostics;
mod failures;
mod flow;
mod healing;
mod matrix;
mod plans;
mod publishing;
mod shards;
