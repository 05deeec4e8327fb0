//! Any scheduler, by three command lines for a shell.

use super::{Queue, Stage, Submission, ask, quoted};
use std::{collections::HashMap, process::Command};
use tauflow_contract::Resources;

/// Jobs that one command line names.
const MOST_NAMED: usize = 500;

/// See the module. In the command lines, words in braces are replaced.
pub struct Commands {
    /// Submits the job of `{script}` under the name `{name}`, with its output in `{log}`; prints the job's id. It may
    /// ask for `{cores}`, `{memory}` in MiB, `{time}` in seconds, and `{gpus}`. `{class}` is the class of nodes that
    /// measure, for jobs that do.
    pub submit: String,
    /// Prints a line for each job that has not ended: its id, and a word for its state. It may name other jobs.
    pub poll: String,
    /// Cancels the jobs `{ids}`.
    pub cancel: String,
}

fn shell(line: &str) -> Result<String, String> {
    let said = ask(Command::new("sh").args(["-c", line]));
    said.map_err(|error| format!("the command `{line}`: {error}"))
}

/// A command line with the resources of a job in their places; 1 core and 0 of everything else if nothing is asked for.
fn with_resources(line: &str, of: Resources) -> String {
    let places = [
        ("{cores}", u64::from(of.cores.unwrap_or(1))),
        ("{memory}", of.memory_mib().unwrap_or(0)),
        ("{time}", of.time.unwrap_or(0)),
        ("{gpus}", u64::from(of.gpus.unwrap_or(0))),
    ];
    places.iter().fold(line.to_owned(), |line, (place, number)| line.replace(place, &number.to_string()))
}

fn with_ids(line: &str, ids: &[&str]) -> String {
    line.replace("{ids}", &ids.iter().map(|id| quoted(id)).collect::<Vec<_>>().join(" "))
}

impl Queue for Commands {
    fn submit(&self, of: &Submission<'_>) -> Result<Vec<String>, String> {
        let mut ids = Vec::with_capacity(of.jobs);
        for job in 0..of.jobs {
            let script = quoted(&of.folder.path().join(format!("{job}.sh")).display().to_string());
            let log = quoted(&of.folder.log_of(&job.to_string()).display().to_string());
            let line = self.submit.replace("{script}", &script).replace("{log}", &log);
            let class = of.class.map_or_else(String::new, |class| quoted(class.name));
            let line = with_resources(&line, of.resources).replace("{class}", &class);
            let mut line = line.replace("{name}", &quoted(&format!("{}-{job}", of.name)));
            for option in &of.options {
                line.push(' ');
                line.push_str(&quoted(option));
            }
            let submitted = shell(&line).and_then(|said| {
                let id = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or_default().trim().to_owned();
                let plain = !id.is_empty() && !id.contains(char::is_whitespace);
                plain.then_some(id).ok_or_else(|| {
                    format!("the command `{line}` must print the id of the job alone, but printed: {}", said.trim())
                })
            });
            match submitted {
                Ok(id) => ids.push(id),
                Err(error) => {
                    // Those before are submitted again, with this one.
                    let ids: Vec<&str> = ids.iter().map(String::as_str).collect();
                    return match ids.is_empty() || self.cancel(&ids).is_ok() {
                        true => Err(error),
                        false => Err(format!("{error}; the jobs {} go on", ids.join(" "))),
                    };
                }
            }
        }
        Ok(ids)
    }

    fn poll(&self, ids: &[&str]) -> Result<HashMap<String, Stage>, String> {
        let mut found = HashMap::new();
        for some in ids.chunks(MOST_NAMED) {
            for line in shell(&with_ids(&self.poll, some))?.lines() {
                let mut words = line.split_whitespace();
                let Some(id) = words.next() else { continue };
                let state = words.next().unwrap_or_default().to_lowercase();
                let runs = state.starts_with('r');
                found.insert(id.to_owned(), if runs { Stage::Running } else { Stage::Queued });
            }
        }
        Ok(found)
    }

    fn reason(&self, _: &str) -> Option<String> {
        None
    }

    fn cancel(&self, ids: &[&str]) -> Result<(), String> {
        ids.chunks(MOST_NAMED).try_for_each(|some| shell(&with_ids(&self.cancel, some)).map(drop))
    }
}
