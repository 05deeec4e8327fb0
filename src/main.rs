//! Command line of tauflow.
fn main() {}
