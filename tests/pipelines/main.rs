//! Pipelines of the real kinds, from the file to the results.

mod edits;
mod quickstart;
mod real_assets;
mod support;
