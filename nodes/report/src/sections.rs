//! The sections of the page, one file each: every one turns material into HTML, and is left out without its input.

pub mod assets;
pub mod baselines;
pub mod bridge;
pub mod claims;
pub mod conventions;
pub mod convergence;
pub mod curves;
pub mod data;
pub mod headline;
pub mod losses;
pub mod montage;
pub mod rejected;
pub mod scenes;
pub mod score_tables;
pub mod standings;
pub mod strata;
pub mod tables;
pub mod time_error;
pub mod timings;

use crate::{
    ranking,
    text::{escape, plural},
};

/// The unit of intervals: groups of scenes if a split is known, otherwise scenes.
pub fn resampled(groups: Option<u64>) -> String {
    groups.map_or_else(|| "scenes".to_owned(), |groups| format!("{} of scenes of one content", plural(groups, "group")))
}

/// A coloured dot and a method's name, as HTML.
pub fn method_html(method: &str) -> String {
    format!(r#"<span class="key {}"></span>{}"#, ranking::colour(method), escape(&ranking::method_name(method)))
}
