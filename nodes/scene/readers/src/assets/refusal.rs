//! Why a file is refused: one line that says where, what is so, and what to do. Knows no file format.

use std::fmt;

/// A refused file, or part of one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    place: String,
    what: String,
    remedy: String,
}

/// Longest text of one field; files are hostile, reports are for people.
const LONGEST: usize = 240;

/// `text` on one line, without control characters, of bounded length.
pub fn tame(text: impl Into<String>) -> String {
    let text: String = text.into().chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.chars().count() <= LONGEST {
        return text;
    }
    let mut short: String = text.chars().take(LONGEST).collect();
    short.push('…');
    short
}

impl Refusal {
    /// Refuses what stands at `place` of the file.
    pub fn new(place: impl Into<String>, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { place: tame(place), what: tame(what), remedy: tame(remedy) }
    }

    /// The line, with the file's name before it.
    pub fn line(&self, file: &str) -> String {
        format!("{}: {self}", tame(file))
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.place, self.what, self.remedy)
    }
}

/// A refusal of a damaged file, whose remedy is to get it again.
pub fn damaged(place: impl Into<String>, what: impl Into<String>) -> Refusal {
    Refusal::new(place, what, "the file is damaged: fetch or export it again")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_is_one_line_of_bounded_length() {
        let line = Refusal::new("chunk 1", "a\nb\u{7}".repeat(500), "mend it").line("x\r.glb");
        assert!(!line.contains(['\n', '\r', '\u{7}']) && line.len() < 400, "{line}");
        assert!(line.starts_with("x .glb: chunk 1: a b") && line.ends_with("; mend it"), "{line}");
    }
}
