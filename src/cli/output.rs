//! Output to stdout and stderr, and formatting of numbers and tables. Knows no command.

use std::{borrow::Cow, fmt, io::Write, process};

/// Prints results, as `print!` does; see [`show`].
macro_rules! out {
    ($($text:tt)*) => { $crate::cli::output::show(format_args!($($text)*)) };
}

/// Prints a line of results, as `println!` does; see [`show`].
macro_rules! outln {
    ($($text:tt)*) => { $crate::cli::output::show(format_args!("{}\n", format_args!($($text)*))) };
}

/// Mentions something on stderr, as `eprint!` does; see [`mention`].
macro_rules! err {
    ($($text:tt)*) => { $crate::cli::output::mention(format_args!($($text)*)) };
}

/// Mentions a line on stderr, as `eprintln!` does; see [`mention`].
macro_rules! errln {
    ($($text:tt)*) => { $crate::cli::output::mention(format_args!("{}\n", format_args!($($text)*))) };
}

/// Writes to stderr. A reader that has gone away (`tauflow run ... 2>&1 | head`) misses what is said, and ends nothing:
/// `eprintln!` would panic in the middle of a run.
pub(crate) fn mention(text: fmt::Arguments<'_>) {
    let _ = std::io::stderr().lock().write_all(text.to_string().as_bytes());
}

/// Writes to stdout. A reader that has gone away (`tauflow schema | head`) ends the program quietly, and a full disk
/// with a message: results that did not arrive are no success.
pub(crate) fn show(text: fmt::Arguments<'_>) {
    put(&harmless(&text.to_string()));
}

/// Shows a picture in colours, for terminals alone. Its orders to the terminal are ours: never pass text of others.
pub(crate) fn picture(orders: &str) {
    put(orders);
}

/// Text in place of that which a terminal shows at its end.
#[derive(Default)]
pub(crate) struct Redrawn {
    /// Lines that it shows.
    lines: usize,
}

impl Redrawn {
    /// Shows this instead of what was shown before.
    pub(crate) fn show(&mut self, text: &str) {
        put(&self.frame(text));
    }

    /// The orders to the terminal, and the text without any: up by the lines shown before, all below cleared, and no
    /// line longer than the terminal is wide, so that each takes one row.
    fn frame(&mut self, text: &str) -> String {
        let back = if self.lines > 0 { format!("\u{1b}[{}A\u{1b}[J", self.lines) } else { String::new() };
        self.lines = text.lines().count();
        format!("{back}\u{1b}[?7l{}\u{1b}[?7h", harmless(text))
    }
}

fn put(text: &str) {
    let mut stdout = std::io::stdout().lock();
    if let Err(error) = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        if error.kind() == std::io::ErrorKind::BrokenPipe {
            process::exit(0);
        }
        errln!("error: cannot write to stdout: {error}");
        process::exit(3);
    }
}

/// Text without orders to the terminal: what is told comes from files and caches, too.
fn harmless(text: &str) -> Cow<'_, str> {
    let order = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if text.contains(order) { Cow::Owned(text.replace(order, "\u{fffd}")) } else { Cow::Borrowed(text) }
}

/// A count of bytes, with a unit that reads well.
pub(crate) fn bytes_text(bytes: u64) -> String {
    indicatif::BinaryBytes(bytes).to_string()
}

/// Seconds as people say them.
pub(crate) fn seconds_text(seconds: f64) -> String {
    match seconds {
        s if s < 0.001 => "0 s".into(),
        s if s < 1.0 => format!("{s:.2} s"),
        s if s < 100.0 => format!("{s:.1} s"),
        s if s < 3600.0 => format!("{} min {:02} s", s as u64 / 60, s as u64 % 60),
        s => format!("{} h {:02} min", s as u64 / 3600, s as u64 / 60 % 60),
    }
}

/// `1 item`, `2 items`.
pub(crate) fn counted(count: u64, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Columns of text, the first to the left and the others to the right.
pub(crate) fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |c: usize| rows.iter().filter_map(|r| r.get(c)).map(|t| t.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut out = String::new();
    for row in rows {
        let mut line = String::new();
        for (c, cell) in row.iter().enumerate() {
            let pad = " ".repeat(widths[c].saturating_sub(cell.chars().count()));
            let (before, after) = if c == 0 { ("", pad.as_str()) } else { (pad.as_str(), "") };
            line += &format!("{}{before}{cell}{after}", if c == 0 { "" } else { "  " });
        }
        out += line.trim_end();
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_line_up_and_have_no_trailing_blanks() {
        let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
        let text = table(&[row(["node", "ran", "size"]), row(["a", "10", ""]), row(["gather", "1", "2 KiB"])]);
        assert_eq!(text, "node    ran   size\na        10\ngather    1  2 KiB\n");
    }

    #[test]
    fn nothing_told_is_an_order_to_the_terminal() {
        assert_eq!(harmless("a\tb\nΩ"), "a\tb\nΩ");
        assert_eq!(harmless("\u{1b}[2Ja\u{9b}1m\r\u{7}"), "\u{fffd}[2Ja\u{fffd}1m\u{fffd}\u{fffd}");
    }

    #[test]
    fn a_redrawn_text_takes_the_place_of_the_last_one() {
        let mut shown = Redrawn::default();
        assert_eq!(shown.frame("a\nb\u{1b}[2J\n"), "\u{1b}[?7la\nb\u{fffd}[2J\n\u{1b}[?7h");
        assert_eq!(shown.frame("c\n"), "\u{1b}[2A\u{1b}[J\u{1b}[?7lc\n\u{1b}[?7h");
        assert!(shown.frame("").starts_with("\u{1b}[1A"));
    }

    #[test]
    fn durations_read_well() {
        let texts = [0.0, 0.12, 4.31, 130.0, 7380.0].map(seconds_text);
        assert_eq!(texts, ["0 s", "0.12 s", "4.3 s", "2 min 10 s", "2 h 03 min"]);
    }
}
