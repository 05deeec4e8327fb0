//! Scorers that are programs: they read and write lines of JSON.
//!
//! The program first writes one line, `{"metrics": [{"name": "clipiqa", "better": "higher"}]}`. Then it reads lines
//! such as `{"image": "/tmp/x/image.png"}`, a PNG of 8-bit RGB, and answers each with a line such as
//! `{"scores": {"clipiqa": 0.52}}`, or `{"error": "..."}`. It ends when its input does. Other output goes to its error
//! stream.

use crate::scorer::{Scorer, Search};
use serde::Deserialize;
use serde_json::json;
use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead, BufReader, Read, Write},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};
use tauflow_contract::KindError;
use tauflow_data::{Image, image_io::encode_png, outside::program, records::ScoreColumn};
use tempfile::TempDir;

/// Most bytes of a line.
const MOST_BYTES: u64 = 1 << 20;

/// The program's first line.
#[derive(Deserialize)]
struct Hello {
    metrics: Vec<ScoreColumn>,
}

/// An answer.
#[derive(Deserialize)]
struct Answer {
    #[serde(default)]
    scores: BTreeMap<String, f64>,
    #[serde(default)]
    error: Option<String>,
}

/// A program that runs.
pub(crate) struct Program {
    words: Vec<String>,
    child: Child,
    /// None once it is to end.
    to: Option<ChildStdin>,
    from: BufReader<ChildStdout>,
    columns: Vec<ScoreColumn>,
    folder: TempDir,
}

impl Program {
    /// Starts the program.
    ///
    /// # Errors
    /// If it is there and cannot be started, or does not say what it measures.
    pub(crate) fn find(words: &[String]) -> Result<Search<Self>, KindError> {
        let failed = |what: String| failed(words, &what);
        let Some((name, arguments)) = words.split_first() else {
            return Err(KindError::Internal("a command without words".into()));
        };
        let Some(file) = program(name) else {
            return Ok(Search::Missing(format!("there is no program `{name}`")));
        };
        let folder = tempfile::tempdir().map_err(|e| failed(format!("got no folder for its images: {e}")))?;
        let mut child = Command::new(file)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|e| failed(format!("cannot be started: {e}")))?;
        let (Some(to), Some(from)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(KindError::Internal("a child without the pipes that it was given".into()));
        };
        let from = BufReader::new(from);
        let mut own = Self { words: words.to_vec(), child, to: Some(to), from, columns: Vec::new(), folder };
        let Hello { metrics } = own.line()?;
        let twice = metrics.iter().enumerate().find(|(at, own)| metrics[..*at].iter().any(|o| o.name == own.name));
        if metrics.is_empty() || twice.is_some() {
            return Err(failed("names no metric in its first line, or one twice".into()));
        }
        own.columns = metrics;
        Ok(Search::Here(own))
    }

    /// The next line that it writes.
    fn line<T: serde::de::DeserializeOwned>(&mut self) -> Result<T, KindError> {
        let mut line = String::new();
        let read = (&mut self.from).take(MOST_BYTES).read_line(&mut line);
        match read {
            Err(e) => Err(failed(&self.words, &format!("cannot be read: {e}"))),
            Ok(0) => {
                let ended = self.child.wait().map_or_else(|e| e.to_string(), |status| status.to_string());
                Err(failed(&self.words, &format!("ended before it answered ({ended}); its messages are above")))
            }
            Ok(_) => serde_json::from_str(&line).map_err(|e| {
                let shown: String = line.trim_end().chars().take(200).collect();
                failed(&self.words, &format!("wrote `{shown}`, which is no answer: {e}"))
            }),
        }
    }
}

fn failed(words: &[String], what: &str) -> KindError {
    KindError::Environment(format!("the scorer `{}` {what}", words.join(" ")))
}

impl Scorer for Program {
    fn columns(&self) -> &[ScoreColumn] {
        &self.columns
    }

    fn score(&mut self, image: &Image) -> Result<Vec<f64>, KindError> {
        let failed = |what: String| failed(&self.words, &what);
        let path = self.folder.path().join("image.png");
        fs::write(&path, encode_png(image)?).map_err(|e| failed(format!("got no image: {e}")))?;
        let Some(to) = &mut self.to else { return Err(failed("has been ended".into())) };
        let ask = json!({ "image": path.to_string_lossy() });
        // One that has ended does not read; the line that it does not write tells why.
        if let Err(e) = writeln!(to, "{ask}").and_then(|()| to.flush())
            && e.kind() != std::io::ErrorKind::BrokenPipe
        {
            return Err(failed(format!("cannot be written to: {e}")));
        }
        let Answer { scores, error } = self.line()?;
        let failed = |what: String| crate::program::failed(&self.words, &what);
        if let Some(error) = error {
            return Err(failed(format!("failed: {error}")));
        }
        let value = |column: &ScoreColumn| {
            let value = scores.get(&column.name).copied().filter(|value| value.is_finite());
            value.ok_or_else(|| failed(format!("answered without a number for `{}`", column.name)))
        };
        self.columns.iter().map(value).collect()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Nothing is asked any more. It is killed, lest it outlive the action.
        self.to = None;
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
