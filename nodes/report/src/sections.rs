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
    text::{escape, interval, plural, signed},
};
use tauflow_data::records::Estimate;

/// The unit of intervals: groups of scenes if a split is known, otherwise scenes.
pub fn resampled(groups: Option<u64>) -> String {
    groups.map_or_else(|| "scenes".to_owned(), |groups| format!("{} of scenes of one content", plural(groups, "group")))
}

/// A sentence in place of those on intervals, where there are none: all figures are of one scene, item or group.
pub fn no_intervals(of: &str, groups: Option<u64>) -> String {
    let group = groups.map_or_else(String::new, |_| format!("group of {of}s of one content"));
    format!("Intervals are omitted, because there is only one {}.", if group.is_empty() { of } else { &group })
}

/// The small print below a mean: its interval, if it has one.
pub fn small_print(estimate: &Estimate, digits: usize, has_interval: bool) -> String {
    small(&interval(estimate, digits), has_interval)
}

/// As [`small_print`], with signs.
pub fn signed_print(estimate: &Estimate, digits: usize, has_interval: bool) -> String {
    small(&format!("[{}, {}]", signed(estimate.low, digits), signed(estimate.high, digits)), has_interval)
}

fn small(interval: &str, has_interval: bool) -> String {
    if has_interval { format!("<span class=\"ci\">{interval}</span>") } else { String::new() }
}

/// A coloured dot and a method's name, as HTML.
pub fn method_html(method: &str) -> String {
    format!(r#"<span class="key {}"></span>{}"#, ranking::colour(method), escape(&ranking::method_name(method)))
}
