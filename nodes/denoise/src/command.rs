//! Programs that are not ours: templates of their command lines, and running them.

use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::{Mutex, PoisonError},
    time::Instant,
};
use tauflow_contract::{KindError, Probe};
pub(crate) use tauflow_data::outside::{contents, identity, program};
use tauflow_data::timing::{commands_cpu_seconds, machine};

/// Allowed and required placeholders of a template.
pub(crate) struct Places {
    /// The role of the program, for errors.
    pub(crate) what: &'static str,
    /// Names of places, such as `{output}`.
    pub(crate) all: &'static [&'static str],
    /// Those without which the program cannot do its work.
    pub(crate) needed: &'static [&'static str],
}

impl Places {
    /// The error of a template; none if it is valid.
    pub(crate) fn problem(&self, template: &[String]) -> Option<String> {
        let has = |place: &str| template.iter().any(|word| word.contains(place));
        let missing: Vec<&str> = self.needed.iter().copied().filter(|place| !has(place)).collect();
        let unknown = template.iter().find_map(|word| {
            let start = word.find('{')?;
            let place = word[start..].split_inclusive('}').next()?;
            (!self.all.contains(&place)).then(|| place.to_owned())
        });
        match (missing.is_empty(), unknown) {
            (false, _) => Some(format!("the command lacks the placeholder {}", missing.join(" or "))),
            (true, Some(place)) => {
                Some(format!("the command contains the unknown placeholder `{place}`; use {}", self.all.join(", ")))
            }
            (true, None) => None,
        }
    }

    /// Runs the program with places filled in, and returns the seconds of wall and processor time that it took. The
    /// latter are right where no other command ends meanwhile, as when times are taken.
    ///
    /// # Errors
    /// If it cannot be started, or fails.
    #[expect(clippy::disallowed_methods, reason = "it measures, for ports that are measurements")]
    pub(crate) fn run(&self, template: &[String], filled: &[(&str, String)]) -> Result<[f64; 2], KindError> {
        let fill = |word: &String| filled.iter().fold(word.clone(), |word, (place, value)| word.replace(place, value));
        let words: Vec<String> = template.iter().map(fill).collect();
        let Some((program, arguments)) = words.split_first() else { return Err(self.failed(template, "is empty")) };
        let (begun, spent) = (Instant::now(), commands_cpu_seconds());
        let done = Command::new(program)
            .args(arguments)
            .output()
            .map_err(|e| self.failed(template, &format!("cannot be started: {e}")))?;
        let seconds = [begun.elapsed().as_secs_f64(), commands_cpu_seconds() - spent];
        if !done.status.success() {
            let told = String::from_utf8_lossy(&done.stderr);
            let last = told.lines().rev().take(5).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n");
            return Err(self.failed(template, &format!("failed with {}:\n{last}", done.status)));
        }
        Ok(seconds)
    }

    /// An error of the program.
    pub(crate) fn failed(&self, template: &[String], what: &str) -> KindError {
        KindError::Environment(format!("the {} `{}` {what}", self.what, template.join(" ")))
    }
}

/// The files that `depends` names, by their contents: each file, and all files below each folder. Names that begin with
/// a dot and `__pycache__` are passed over in folders.
pub(crate) fn depended(depends: &[String]) -> BTreeMap<String, String> {
    let mut files = Vec::new();
    for name in depends {
        let path = Path::new(name);
        if path.is_dir() { below(path, &mut files) } else { files.push(path.to_owned()) }
    }
    // A folder that has no files is told from one that is not there.
    let folders = depends.iter().filter(|name| Path::new(name).is_dir());
    let folders = folders.map(|name| (name.clone(), "a folder".to_owned()));
    let files = files.into_iter().map(|file| {
        let content = if file.exists() { contents(&file) } else { "not there".to_owned() };
        (file.to_string_lossy().into_owned(), content)
    });
    folders.chain(files).collect()
}

/// All files below a folder. Links to folders are not followed, as they may go round in circles.
fn below(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        let name = name.to_string_lossy();
        if name.starts_with('.') || name == "__pycache__" {
            continue;
        }
        if !path.is_dir() {
            found.push(path);
        } else if !path.is_symlink() {
            below(&path, found);
        }
    }
}

/// # Errors
/// If a file or folder of `depends` is not there.
pub(crate) fn check_depends(depends: &[String]) -> Result<(), KindError> {
    match depends.iter().find(|name| !Path::new(name).exists()) {
        None => Ok(()),
        Some(name) => Err(KindError::Input(format!(
            "`depends` names `{name}`, which does not exist; paths start at the working directory of tauflow"
        ))),
    }
}

/// The version that a command prints, as far as `probe` knows or may ask: null if it fails, and nothing without a
/// command.
///
/// An earlier answer counts as long as the program, the files that its command line names and the machine are the same.
pub(crate) fn probed_version(words: &[String], probe: &dyn Probe) -> Option<Value> {
    if words.is_empty() {
        return Some(json!(""));
    }
    let question = json!({ "command": words, "files": identity(words), "machine": machine() });
    probe.answer(&question, &|| json!(version(words).ok()))
}

/// The version that a command prints, queried once per process; nothing without a command.
///
/// # Errors
/// The problem and its remedy, if it cannot be started or fails.
pub(crate) fn version(words: &[String]) -> Result<String, String> {
    static KNOWN: Mutex<BTreeMap<Vec<String>, Result<String, String>>> = Mutex::new(BTreeMap::new());
    let Some((program, arguments)) = words.split_first() else { return Ok(String::new()) };
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(told) = known.get(words) {
        return told.clone();
    }
    let missing = |what: String| format!("`{}` {what}; install what it asks for", words.join(" "));
    let told = match Command::new(program).args(arguments).output() {
        Err(error) => Err(missing(format!("cannot be started: {error}"))),
        Ok(done) if !done.status.success() => {
            let told = String::from_utf8_lossy(&done.stderr);
            Err(missing(format!("failed: {}", told.lines().last().unwrap_or_default())))
        }
        Ok(done) => Ok(String::from_utf8_lossy(&done.stdout).trim().to_owned()),
    };
    known.insert(words.to_vec(), told.clone());
    told
}
