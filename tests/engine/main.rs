//! The engine on toy kinds: what runs, what does not, and what is told.

#[path = "../support/mod.rs"]
mod support;

mod caching;
mod demand;
mod diagnostics;
mod failures;
mod flow;
mod fuzz;
mod healing;
mod machine;
mod matrix;
mod memory;
mod plans;
mod ports;
mod publishing;
mod queries;
mod shards;
mod simulated;
#[path = "../cli/validator.rs"]
mod validator;
mod values;
mod yaml_text;
