//! The capabilities of the terminal on stderr, and the preferences of its user.

use indicatif::{MultiProgress, ProgressBar};
use std::{
    env,
    io::IsTerminal,
    sync::{Mutex, PoisonError},
};

/// Whether lines can be drawn over; `TERM=dumb` says that they cannot.
pub(crate) fn redraws() -> bool {
    std::io::stderr().is_terminal() && may_draw()
}

/// Whether colours are shown: where lines can be drawn over, unless `NO_COLOR` holds anything.
pub(crate) fn colours() -> bool {
    redraws() && may_colour()
}

/// The colours of a terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Palette {
    /// All of 24 bits.
    All,
    /// The usual 256.
    Few,
}

/// The colours of pictures on stdout, where a terminal shows them; none without one, and where [`colours`] are not
/// wanted. `COLORTERM` says whether it has all.
pub(crate) fn pictures() -> Option<Palette> {
    let wanted = std::io::stdout().is_terminal() && may_draw() && may_colour();
    let all = env::var("COLORTERM").is_ok_and(|name| name == "truecolor" || name == "24bit");
    wanted.then_some(if all { Palette::All } else { Palette::Few })
}

/// Whether `TERM` allows lines to be drawn over.
fn may_draw() -> bool {
    env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Whether `NO_COLOR` allows colours.
fn may_colour() -> bool {
    env::var_os("NO_COLOR").is_none_or(|asked| asked.is_empty())
}

/// A bar of so many steps, where a bar can be shown.
pub(crate) fn bar(steps: u64) -> ProgressBar {
    if redraws() { ProgressBar::new(steps) } else { ProgressBar::hidden() }
}

/// The bars that are shown, if any.
static BARS: Mutex<Option<MultiProgress>> = Mutex::new(None);

/// Has notes appear above these bars.
pub(crate) fn show_notes_above(bars: Option<&MultiProgress>) {
    *BARS.lock().unwrap_or_else(PoisonError::into_inner) = bars.cloned();
}

/// A line for people on stderr, above the bars if there are any.
pub(crate) fn note(text: &str) {
    match &*BARS.lock().unwrap_or_else(PoisonError::into_inner) {
        // The terminal going away must not stop a run.
        Some(bars) => drop(bars.println(text)),
        None => errln!("{text}"),
    }
}
