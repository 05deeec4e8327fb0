//! Programs that are not ours: templates of their command lines, and running them.

use crate::process::{self, Ended, Launch, Ran, tail};
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::Duration,
};
use tauflow_contract::{Context, KindError, ParamProblem, Probe};
pub(crate) use tauflow_data::outside::{contents, identity, program};
use tauflow_data::timing::machine;

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

    /// Runs the program with places filled in; `own` is the folder of all that was made for it. The files that it looks
    /// at are noted if it is to be traced.
    ///
    /// # Errors
    /// If it cannot be started, or fails, or the run is being stopped.
    pub(crate) fn run(
        &self,
        ctx: &Context<'_>,
        template: &[String],
        filled: &[(&str, String)],
        Surroundings { own, variables, trace }: Surroundings<'_>,
    ) -> Result<Ran, KindError> {
        let fill = |word: &String| filled.iter().fold(word.clone(), |word, (place, value)| word.replace(place, value));
        let words: Vec<String> = template.iter().map(fill).collect();
        let temporary = own.join("tmp");
        let made = std::fs::create_dir_all(&temporary);
        made.map_err(|e| self.failed(template, &format!("got no folder for temporary files: {e}")))?;
        let launch = Launch {
            words: &words,
            folder: None,
            temporary: &temporary,
            own,
            variables,
            trace,
            time: None,
            memory: None,
        };
        let ran = launch.run(ctx)?;
        match &ran.ended {
            Ended::Not(error) => Err(self.failed(template, &format!("cannot be started: {error}"))),
            Ended::Itself(status, told) if !status.success() => {
                Err(self.failed(template, &format!("failed with {status}{}", tail(told))))
            }
            _ => Ok(ran),
        }
    }

    /// An error of the program.
    pub(crate) fn failed(&self, template: &[String], what: &str) -> KindError {
        KindError::Environment(format!("the {} `{}` {what}", self.what, template.join(" ")))
    }
}

/// What is around a program beside its command line.
#[derive(Clone, Copy)]
pub(crate) struct Surroundings<'a> {
    /// The folder of all that was made for it.
    pub(crate) own: &'a Path,
    /// Names of environment variables that it gets beside the usual ones.
    pub(crate) variables: &'a [String],
    /// The files that it looks at are noted.
    pub(crate) trace: bool,
}

/// The files that `depends` names, by their contents: each file, all files below each folder, and both for each
/// pattern. Names that begin with a dot and `__pycache__` are passed over in folders.
pub(crate) fn depended(depends: &[String]) -> BTreeMap<String, String> {
    let (mut files, mut folders) = (Vec::new(), BTreeMap::new());
    for path in depends.iter().flat_map(|name| named(name)) {
        if path.is_dir() {
            below(&path, &mut files);
            // A folder without files differs from a missing one.
            folders.insert(path.to_string_lossy().into_owned(), "a folder".to_owned());
        } else {
            files.push(path);
        }
    }
    let files = files.into_iter().map(|file| {
        let content = if file.exists() { contents(&file) } else { "not there".to_owned() };
        (file.to_string_lossy().into_owned(), content)
    });
    folders.into_iter().chain(files).collect()
}

/// The paths that an entry of `depends` names: itself, or what a pattern matches. In a pattern `*` stands for any text
/// within a name, `?` for any character, and `**` for any folders.
fn named(entry: &str) -> Vec<PathBuf> {
    let path = Path::new(entry);
    if !is_pattern(entry) || path.exists() {
        return vec![path.to_owned()];
    }
    let mut found = vec![PathBuf::new()];
    for part in path.components() {
        let name = part.as_os_str().to_string_lossy();
        found = match &*name {
            "**" => found.iter().flat_map(|folder| folders_below(folder)).collect(),
            name if is_pattern(name) => {
                let pattern: Vec<char> = name.chars().collect();
                let fits = |name: &str| matches(&pattern, &name.chars().collect::<Vec<_>>());
                let entries =
                    found.iter().flat_map(|folder| entries(folder).into_iter().map(move |name| (folder, name)));
                let fitting = entries.filter(|(_, name)| fits(name) && (!name.starts_with('.') || pattern[0] == '.'));
                fitting.map(|(folder, name)| folder.join(name)).collect()
            }
            _ => found.iter().map(|folder| folder.join(part)).filter(|path| path.exists()).collect(),
        };
    }
    found.sort();
    found.dedup();
    found
}

fn is_pattern(text: &str) -> bool {
    text.contains(['*', '?'])
}

/// Whether a pattern of one name matches a name.
fn matches(pattern: &[char], name: &[char]) -> bool {
    // Where the last star was, and what of the name it has not taken yet.
    let (mut at, mut of, mut star) = (0, 0, None);
    while of < name.len() {
        match pattern.get(at) {
            Some('*') => {
                star = Some((at, of));
                at += 1;
            }
            Some(c) if *c == '?' || *c == name[of] => (at, of) = (at + 1, of + 1),
            _ => match star {
                None => return false,
                Some((start, taken)) => {
                    star = Some((start, taken + 1));
                    (at, of) = (start + 1, taken + 1);
                }
            },
        }
    }
    pattern[at..].iter().all(|c| *c == '*')
}

/// Names in a folder; none if it cannot be listed.
fn entries(folder: &Path) -> Vec<String> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

/// A folder and all folders below it, without links and names that begin with a dot.
fn folders_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = vec![folder.to_owned()];
    for name in entries(folder) {
        let path = folder.join(&name);
        if path.is_dir() && !path.is_symlink() && !name.starts_with('.') && name != "__pycache__" {
            found.extend(folders_below(&path));
        }
    }
    found
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

/// Programs whose first argument is a script, unless it begins with a dash.
const INTERPRETERS: [&str; 9] = ["python", "sh", "bash", "zsh", "node", "perl", "ruby", "Rscript", "julia"];

/// What a command and its `depends` name and what is not there: the program at `pointer`, its script, a file.
pub(crate) fn missing(words: &[String], pointer: &str, depends: &[String]) -> Vec<ParamProblem> {
    let mut found = Vec::new();
    if let Some(name) = words.first()
        && program(name).is_none()
    {
        let message = format!("there is no program `{name}` here");
        let hint = "install it, or give its path; paths start at the working directory of tauflow";
        found.push(ParamProblem::new(format!("{pointer}/0"), message, hint));
    }
    let interpreter = words.first().map(|name| name.rsplit('/').next().unwrap_or_default());
    let interpreter = interpreter.map(|name| name.trim_end_matches(|c: char| c.is_ascii_digit() || c == '.'));
    if let (Some(true), Some(script)) = (interpreter.map(|name| INTERPRETERS.contains(&name)), words.get(1))
        && !script.starts_with('-')
        && !script.contains('{')
        && !Path::new(script).is_file()
    {
        let hint = "mend the path; paths start at the working directory of tauflow";
        found.push(ParamProblem::new(format!("{pointer}/1"), format!("there is no file `{script}` here"), hint));
    }
    for (place, entry) in depends.iter().enumerate() {
        if let Err(error) = check_depends(std::slice::from_ref(entry)) {
            let told = error.to_string();
            let (what, hint) = told.rsplit_once("; ").unwrap_or((&told, ""));
            found.push(ParamProblem::new(format!("/depends/{place}"), what, hint));
        }
    }
    found
}

/// # Errors
/// If a file or folder of `depends` does not exist, or a pattern matches nothing.
pub(crate) fn check_depends(depends: &[String]) -> Result<(), KindError> {
    match depends.iter().find(|entry| named(entry).iter().all(|path| !path.exists())) {
        None => Ok(()),
        Some(entry) => Err(KindError::Input(format!(
            "`depends` names `{entry}`, which {}; paths start at the working directory of tauflow",
            if is_pattern(entry) { "matches no file" } else { "does not exist" }
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

/// Most time for the answer of a `version` command.
const MOST_ASKED: Duration = Duration::from_secs(60);

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
    let told = match process::answer(program, arguments, MOST_ASKED) {
        Err(error) => Err(missing(format!("cannot be asked: {error}"))),
        Ok(None) => Err(missing(format!("takes longer than {} s", MOST_ASKED.as_secs()))),
        Ok(Some(done)) if !done.status.success() => {
            let told = String::from_utf8_lossy(&done.stderr);
            let last = told.lines().last().map(|line| format!(": {line}")).unwrap_or_default();
            Err(missing(format!("failed ({}){last}", done.status)))
        }
        Ok(Some(done)) => Ok(short(String::from_utf8_lossy(&done.stdout).trim())),
    };
    known.insert(words.to_vec(), told.clone());
    told
}

/// Longest answer that is written into keys as it is.
const MOST_WRITTEN: usize = 16 << 10;

/// An answer for keys: a list of all packages is long, and its digest tells as much.
fn short(answer: &str) -> String {
    match answer.len() {
        0..=MOST_WRITTEN => answer.to_owned(),
        bytes => format!("{bytes} bytes, {}", blake3::hash(answer.as_bytes()).to_hex()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_of_a_version_counts() {
        let ask = |end: &str| version(&["sh".to_owned(), "-c".to_owned(), format!("seq 1 20000; echo {end}")]);
        let (one, other) = (ask("one").expect("it answers"), ask("other").expect("it answers"));
        assert!(one != other && one.len() < 100, "{one}");
        assert_eq!(version(&["echo".to_owned(), " 1.2 ".to_owned()]), Ok("1.2".to_owned()));
        let endless = version(&["seq".to_owned(), "1000000".to_owned()]).expect_err("too long");
        assert!(endless.contains("prints more than"), "{endless}");
    }

    #[test]
    fn patterns_match_names_as_shells_do() {
        let fits = |pattern: &str, name: &str| {
            matches(&pattern.chars().collect::<Vec<_>>(), &name.chars().collect::<Vec<_>>())
        };
        for (pattern, name) in [("*", ""), ("*.pt", "a.pt"), ("a?c", "abc"), ("*a*b*", "xaxxbx"), ("a*a", "aba")] {
            assert!(fits(pattern, name), "{pattern} {name}");
        }
        for (pattern, name) in [("?", ""), ("*.pt", "a.py"), ("a?c", "ac"), ("a*a", "a"), ("*ab", "aba")] {
            assert!(!fits(pattern, name), "{pattern} {name}");
        }
    }

    #[test]
    fn patterns_name_files_and_those_that_match_nothing_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        fs::create_dir_all(path("models/deep")).expect("writable");
        for name in ["models/a.pt", "models/b.pt", "models/deep/c.pt", "models/.hidden.pt", "models/readme"] {
            fs::write(path(name), name).expect("writable");
        }
        let found = |pattern: &str| depended(&[path(pattern)]).into_keys().collect::<Vec<_>>();
        assert_eq!(found("models/*.pt"), [path("models/a.pt"), path("models/b.pt")]);
        assert_eq!(found("models/**/*.pt"), [path("models/a.pt"), path("models/b.pt"), path("models/deep/c.pt")]);
        assert_eq!(found("*/deep"), [path("models/deep"), path("models/deep/c.pt")]);
        assert!(check_depends(&[path("models/*.pt")]).is_ok());
        let refused = check_depends(&[path("models/*.onnx")]).expect_err("nothing matches");
        assert!(refused.to_string().contains("matches no file"), "{refused}");
    }
}
