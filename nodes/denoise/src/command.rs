//! Programs that are not ours: templates of their command lines, and running them.

use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    fs,
    io::Read,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::Command,
    sync::{Mutex, PoisonError},
    time::{Instant, SystemTime},
};
use tauflow_contract::{Digest, KindError, Probe, open_regular};
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

/// The file of a program: as it is named, or where the system looks for programs.
pub(crate) fn program(name: &str) -> Option<PathBuf> {
    if name.contains('/') {
        return Some(PathBuf::from(name)).filter(|file| is_program(file));
    }
    let path = std::env::var_os("PATH")?;
    search(std::env::split_paths(&path), name)
}

/// The first program of a name in folders; the system passes over files that may not be run.
fn search(folders: impl Iterator<Item = PathBuf>, name: &str) -> Option<PathBuf> {
    folders.map(|folder| folder.join(name)).find(|file| is_program(file))
}

fn is_program(file: &Path) -> bool {
    fs::metadata(file).is_ok_and(|about| about.is_file() && about.permissions().mode() & 0o111 != 0)
}

/// The program and the files that a template names, by their contents: another of them is another program.
pub(crate) fn identity(template: &[String]) -> BTreeMap<String, String> {
    let words = template.iter().enumerate();
    let file = |(at, word): (usize, &String)| {
        let file = if at == 0 { program(word) } else { Some(PathBuf::from(word)).filter(|file| file.is_file()) }?;
        Some((word.clone(), contents(&file)))
    };
    words.filter_map(file).collect()
}

/// The digest of a file's content; an unreadable file differs from a missing one.
pub(crate) fn contents(file: &Path) -> String {
    digest(file).map_or_else(|| "cannot be read".to_owned(), |digest| digest.hex())
}

/// Digests of files, read again only when they have changed.
fn digest(file: &Path) -> Option<Digest> {
    static KNOWN: Mutex<BTreeMap<PathBuf, (SystemTime, u64, Digest)>> = Mutex::new(BTreeMap::new());
    let about = fs::metadata(file).ok()?;
    let (changed, size) = (about.modified().ok()?, about.len());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((at, len, digest)) = known.get(file)
        && (*at, *len) == (changed, size)
    {
        return Some(*digest);
    }
    let digest = by_the_piece(file).ok()?;
    known.insert(file.to_owned(), (changed, size, digest));
    Some(digest)
}

/// The digest of a file, however large it is.
fn by_the_piece(file: &Path) -> std::io::Result<Digest> {
    let mut from = open_regular(file)?;
    let (mut hasher, mut piece, mut size) = (blake3::Hasher::new(), vec![0; 1 << 20], 0);
    loop {
        let read = from.read(&mut piece)?;
        if read == 0 {
            return Ok(Digest { hash: *hasher.finalize().as_bytes(), size });
        }
        hasher.update(&piece[..read]);
        size += read as u64;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_may_not_be_run_is_passed_over_as_the_system_does() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = |name: &str, text: &str, mode: u32| {
            let file = folder.path().join(name).join("tool");
            fs::create_dir(folder.path().join(name)).expect("writable");
            fs::write(&file, text).expect("writable");
            fs::set_permissions(&file, fs::Permissions::from_mode(mode)).expect("our own");
            file
        };
        let (text, first, second) = (file("a", "a", 0o644), file("b", "b", 0o755), file("c", "c", 0o755));
        let folders = || [&text, &first, &second].map(|file| file.parent().expect("it has one").to_owned()).into_iter();
        assert_eq!(search(folders(), "tool"), Some(first.clone()));
        assert_eq!(search(folders(), "other"), None);
        assert_eq!(program(&text.to_string_lossy()), None);
        assert_eq!(program(&first.to_string_lossy()), Some(first));
    }

    #[test]
    fn digests_by_the_piece_are_those_of_the_whole() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("large");
        for size in [0, 1, 1 << 20, (3 << 20) + 7] {
            let bytes: Vec<u8> = (0..size).map(|i: usize| (i * 31 % 251) as u8).collect();
            fs::write(&path, &bytes).expect("writable");
            assert_eq!(by_the_piece(&path).expect("readable"), Digest::of(&bytes), "{size}");
        }
        assert!(by_the_piece(Path::new("/dev/zero")).is_err());
    }
}
