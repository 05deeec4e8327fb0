//! Pipelines of the real kinds, from the file to the results.

mod adapter;
mod bridge;
mod denoiser;
mod digests;
mod edits;
mod executors;
mod kills;
mod language;
mod mitsuba;
mod processors;
mod protocol;
mod quickstart;
mod readmes;
mod real_assets;
mod round_trip;
mod scene_files;
mod strata;
mod stress;
mod support;
mod time_error;
mod until;
