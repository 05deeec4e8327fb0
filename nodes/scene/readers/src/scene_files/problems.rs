//! All problems of a scene's files, each with file and line. Knows no file format.

use crate::assets::Refusal;
use std::rc::Rc;
use tauflow_contract::KindError;

/// Where something stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file, by its path from the scene's own file.
    pub file: Rc<str>,
    /// The line, from 1; 0 for the file as a whole.
    pub line: u32,
}

impl Place {
    /// A file as a whole.
    pub fn file(name: &str) -> Self {
        Self { file: name.into(), line: 0 }
    }

    fn tell(&self, what: String, remedy: &str) -> String {
        let place = if self.line == 0 { "file".to_owned() } else { format!("line {}", self.line) };
        Refusal::new(place, what, remedy).line(&self.file)
    }
}

/// Most lines that are told; a file that is no scene at all would fill a screen otherwise.
const MOST: usize = 200;

/// Everything that was found wrong or worth knowing.
#[derive(Debug, Default)]
pub struct Problems {
    errors: Vec<String>,
    more: usize,
    notes: Vec<String>,
    approximate: bool,
}

impl Problems {
    /// None yet; with `approximate`, what is only nearly the same is a note and no error.
    pub fn new(approximate: bool) -> Self {
        Self { approximate, ..Self::default() }
    }

    fn push(&mut self, line: String) {
        if self.errors.contains(&line) {
        } else if self.errors.len() < MOST {
            self.errors.push(line);
        } else {
            self.more += 1;
        }
    }

    /// Something without which the image would be another.
    pub fn error(&mut self, at: &Place, what: impl Into<String>, remedy: &str) {
        self.push(at.tell(what.into(), remedy));
    }

    /// A refusal by one of the readers of pictures or meshes.
    pub fn refuse(&mut self, at: &Place, file: &str, refusal: &Refusal) {
        self.push(at.tell(refusal.line(file), "or take it out of the scene"));
    }

    /// Something that does not change the expected image.
    pub fn note(&mut self, at: &Place, what: impl Into<String>) {
        let line = at.tell(what.into(), "");
        let line = line.trim_end_matches([' ', ';']).to_owned();
        if self.notes.len() < MOST && !self.notes.contains(&line) {
            self.notes.push(line);
        }
    }

    /// Something that is expressed by what is nearly the same: a note where that was allowed, or else an error.
    pub fn approximated(&mut self, at: &Place, what: impl Into<String>, remedy: &str) {
        if self.approximate {
            self.note(at, format!("approximated: {}", what.into()));
        } else {
            self.error(at, what, &format!("{remedy}, or allow it by `approximate` (`--approximate`)"));
        }
    }

    /// Forgets all that was told: something says more than all of it.
    pub fn forget(&mut self) {
        (self.errors, self.notes, self.more) = (Vec::new(), Vec::new(), 0);
    }

    /// True if nothing was wrong so far.
    pub fn is_fine(&self) -> bool {
        self.errors.is_empty()
    }

    /// The notes, if nothing was wrong.
    ///
    /// # Errors
    /// All that was wrong, a line each.
    pub fn finish(self) -> Result<Vec<String>, KindError> {
        if self.errors.is_empty() {
            return Ok(self.notes);
        }
        let mut text = self.errors.join("\n");
        if self.more > 0 {
            text.push_str(&format!("\nand {} more", self.more));
        }
        Err(KindError::Input(text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_told_at_once_with_its_line() {
        let mut problems = Problems::new(false);
        let at = Place { file: "a.xml".into(), line: 7 };
        problems.note(&at, "a reconstruction filter is left out");
        problems.error(&at, "`hair` is not supported", "use `principled`");
        problems.error(&at, "`hair` is not supported", "use `principled`");
        problems.approximated(&Place::file("b.xml"), "beckmann", "write `ggx`");
        let text = problems.finish().expect_err("two errors").to_string();
        assert_eq!(
            text.lines().collect::<Vec<_>>(),
            [
                "a.xml: line 7: `hair` is not supported; use `principled`",
                "b.xml: file: beckmann; write `ggx`, or allow it by `approximate` (`--approximate`)",
            ]
        );
        let mut allowed = Problems::new(true);
        allowed.approximated(&at, "beckmann", "write `ggx`");
        assert_eq!(allowed.finish().expect("a note"), ["a.xml: line 7: approximated: beckmann"]);
    }
}
