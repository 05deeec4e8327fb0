//! The capabilities of the terminal on stderr, and the preferences of its user.

use indicatif::ProgressBar;
use std::{env, io::IsTerminal};

/// Whether lines can be drawn over; `TERM=dumb` says that they cannot.
pub(crate) fn redraws() -> bool {
    std::io::stderr().is_terminal() && env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Whether colours are shown: where lines can be drawn over, unless `NO_COLOR` holds anything.
pub(crate) fn colours() -> bool {
    redraws() && env::var_os("NO_COLOR").is_none_or(|asked| asked.is_empty())
}

/// A bar of so many steps, where a bar can be shown.
pub(crate) fn bar(steps: u64) -> ProgressBar {
    if redraws() { ProgressBar::new(steps) } else { ProgressBar::hidden() }
}
