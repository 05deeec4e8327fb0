//! The files that an external program looked at, so that an action runs again when one of them changes.
//!
//! A [`Sight`] is a path, what was asked of it, and the answer. The kind that ran the program hands the sights over
//! with its outputs ([`crate::Outputs::seen`]). The engine looks at the same paths before it takes those outputs again.
//! A file is read again only if its size, times or inode changed.

use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, Metadata},
    io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

/// What a program asked of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Asked {
    /// What it is: a folder, or a file of some size, executable or not, and where it leads if it is a link.
    Presence,
    /// The Python modules in a folder.
    Modules,
    /// The names in a folder.
    Names,
    /// The content of a file.
    Content,
}

/// Size, times and place of a file: while they stay the same, so does its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp([i64; 7]);

/// One path that a program looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sight {
    /// The path, from the root.
    pub path: String,
    /// What was asked.
    pub asked: Asked,
    /// The answer: a digest, or words such as `missing`.
    pub state: String,
    /// The file's stamp, if its content cannot have changed since without changing the stamp.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stamp: Option<Stamp>,
}

/// All that a program looked at.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seen {
    /// Why the list is incomplete; none if it is complete.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub untraced: Option<String>,
    /// The paths, sorted.
    pub sights: Vec<Sight>,
}

/// The state of a path that does not exist.
pub const MISSING: &str = "missing";
/// The state of a file that was changed while the program ran. No look gives this, so the outputs are not taken again.
pub const CHANGED: &str = "changed while it ran";

/// A change less than this ago may leave the times of a file as they are.
const TICK: Duration = Duration::from_millis(50);

/// The environment variables that programs of pipelines get. All are in keys. The others are cleared, so that no
/// undeclared variable can change an output.
pub const PROGRAM_VARIABLES: [&str; 13] = [
    "PATH",
    "HOME",
    "LD_LIBRARY_PATH",
    "PYTHONPATH",
    "PYTHONHOME",
    "VIRTUAL_ENV",
    "CONDA_PREFIX",
    "CUDA_VISIBLE_DEVICES",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "RAYON_NUM_THREADS",
    "TAUFLOW_INSTRUCTIONS",
];

/// Folders of the run itself: the store and the results.
static OURS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Declares a folder of the run itself: nothing in it is an input of a program, and listings leave it out.
pub fn leave_out_of_sights(ours: &Path) {
    let Ok(ours) = std::path::absolute(ours) else { return };
    let mut all = OURS.lock().unwrap_or_else(PoisonError::into_inner);
    for path in [ours.canonicalize().ok(), Some(ours)].into_iter().flatten() {
        if !all.contains(&path) {
            all.push(path);
        }
    }
}

/// The folders of the run itself.
pub fn left_out_of_sights() -> Vec<PathBuf> {
    OURS.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

impl Stamp {
    /// The stamp of a file or folder; none if it does not exist.
    pub fn at(path: &Path) -> Option<Self> {
        fs::metadata(path).ok().map(|about| Self::of(&about))
    }

    /// The size in bytes.
    pub fn size(&self) -> i64 {
        self.0[0]
    }

    fn of(about: &Metadata) -> Self {
        let (size, dev, ino) = (about.size() as i64, about.dev() as i64, about.ino() as i64);
        Self([size, dev, ino, about.mtime(), about.mtime_nsec(), about.ctime(), about.ctime_nsec()])
    }
}

/// When a file was changed last, its attributes included.
fn changed_at(about: &Metadata) -> SystemTime {
    let seconds = Duration::from_secs(about.ctime().max(0).unsigned_abs());
    UNIX_EPOCH + seconds + Duration::from_nanos(about.ctime_nsec().max(0).unsigned_abs())
}

impl Sight {
    /// The answer now.
    pub fn of(path: impl Into<String>, asked: Asked) -> Self {
        let path = path.into();
        let (state, stamp) = look(Path::new(&path), asked, None);
        Self { path, asked, state, stamp }
    }

    /// The same question asked now.
    pub fn again(&self) -> Self {
        let known = self.stamp.as_ref().map(|stamp| (stamp, self.state.as_str()));
        let (state, stamp) = look(Path::new(&self.path), self.asked, known);
        Self { path: self.path.clone(), asked: self.asked, state, stamp }
    }
}

impl Seen {
    /// The same questions asked now.
    pub fn again(&self) -> Self {
        Self { untraced: self.untraced.clone(), sights: self.sights.iter().map(Sight::again).collect() }
    }

    /// Adds what another run of the program looked at. Where the answers differ, none counts.
    pub fn join(&mut self, other: Self) {
        self.untraced = self.untraced.take().or(other.untraced);
        let mut all: BTreeMap<String, Sight> =
            std::mem::take(&mut self.sights).into_iter().map(|sight| (sight.path.clone(), sight)).collect();
        for sight in other.sights {
            match all.get_mut(&sight.path) {
                None => drop(all.insert(sight.path.clone(), sight)),
                Some(before) if before.asked < sight.asked => *before = sight,
                Some(before) if before.asked == sight.asked && before.state != sight.state => {
                    (before.state, before.stamp) = (CHANGED.into(), None);
                }
                Some(_) => {}
            }
        }
        self.sights = all.into_values().collect();
    }

    /// The part that other machines have, too: files below the current folder, by their paths from there, and contents
    /// of files elsewhere that belong neither to the system nor to an installed package.
    #[must_use]
    pub fn portable(mut self) -> Self {
        let here = std::env::current_dir().and_then(|here| here.canonicalize()).ok();
        self.sights.retain_mut(|sight| {
            let below = here.as_ref().and_then(|here| Path::new(&sight.path).strip_prefix(here).ok());
            match below.and_then(Path::to_str) {
                Some("") => sight.path = ".".into(),
                Some(below) => sight.path = below.to_owned(),
                None => return sight.asked == Asked::Content && installed(&sight.path).is_none(),
            }
            true
        });
        self
    }

    /// True if the program asked the same questions.
    pub fn same_paths(&self, other: &Self) -> bool {
        let questions = |seen: &Self| seen.sights.iter().map(|s| (s.path.clone(), s.asked)).collect::<Vec<_>>();
        self.untraced.is_some() == other.untraced.is_some() && questions(self) == questions(other)
    }

    /// What enters a key: files by their paths, files of the system and of installed packages by their folder, and the
    /// presence of paths by the folder above them.
    pub fn summary(&self) -> BTreeMap<String, String> {
        let mut groups: BTreeMap<String, blake3::Hasher> = BTreeMap::new();
        let mut summary = BTreeMap::new();
        for sight in &self.sights {
            let name = match (installed(&sight.path), sight.asked) {
                (Some(folder), _) => folder.to_owned(),
                (None, Asked::Content) if sight.state != MISSING => {
                    summary.insert(sight.path.clone(), sight.state.clone());
                    continue;
                }
                (None, Asked::Names | Asked::Modules) => format!("{} (its names)", sight.path),
                (None, Asked::Presence | Asked::Content) => {
                    let parent = Path::new(&sight.path).parent().unwrap_or_else(|| Path::new("/"));
                    format!("{} (what exists in it)", parent.display())
                }
            };
            let hasher = groups.entry(name).or_default();
            for text in [&sight.path, &sight.state] {
                hasher.update(&(text.len() as u64).to_le_bytes());
                hasher.update(text.as_bytes());
            }
            hasher.update(&[sight.asked as u8]);
        }
        summary.extend(groups.into_iter().map(|(name, hasher)| (name, hasher.finalize().to_hex().to_string())));
        summary
    }

    /// Files that were changed while the program ran.
    pub fn changed(&self) -> impl Iterator<Item = &str> {
        self.sights.iter().filter(|sight| sight.state == CHANGED).map(|sight| sight.path.as_str())
    }
}

/// The folder that stands for a file of the system or of an installed package.
fn installed(path: &str) -> Option<&str> {
    let below = |marker: &str| {
        let start = path.find(marker)? + marker.len();
        let end = path[start..].find('/').map_or(path.len(), |at| start + at);
        Some(&path[..end])
    };
    let library = || {
        // `…/lib/python3.12` stands for the modules of an interpreter.
        let start = path.find("/lib/python3")? + "/lib/".len();
        let end = path[start..].find('/').map_or(path.len(), |at| start + at);
        Some(&path[..end])
    };
    let system = || {
        let tops = ["/usr/", "/lib/", "/lib64/", "/bin/", "/sbin/", "/etc/", "/opt/", "/nix/", "/snap/"];
        let top = tops.iter().find(|top| path.starts_with(**top))?;
        let end = path[top.len()..].find('/').map_or(top.len() - 1, |at| top.len() + at);
        Some(&path[..end])
    };
    below("/site-packages/").or_else(|| below("/dist-packages/")).or_else(library).or_else(system)
}

/// True for names that come and go without anybody reading them: caches of bytecode, and copies that editors make.
fn is_noise(name: &str) -> bool {
    name == "__pycache__"
        || name == ".DS_Store"
        || name.ends_with('~')
        || name.ends_with(".swp")
        || name.starts_with(".#")
}

fn look(path: &Path, asked: Asked, known: Option<(&Stamp, &str)>) -> (String, Option<Stamp>) {
    let words = |text: &str| (text.to_owned(), None);
    let about = match fs::metadata(path) {
        Ok(about) => about,
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return words(MISSING);
        }
        Err(_) => return words("cannot be read"),
    };
    match asked {
        Asked::Presence => (about_text(path, &about), None),
        Asked::Names | Asked::Modules if about.is_dir() => {
            words(&names(path, asked == Asked::Modules).unwrap_or_else(|| "cannot be read".into()))
        }
        _ if about.is_dir() => words("a folder"),
        _ if !about.is_file() => words("no regular file"),
        _ => content(path, &about, known),
    }
}

/// What a program learns of a file without opening it, times excepted.
fn about_text(path: &Path, about: &Metadata) -> String {
    let mut text = match about.is_dir() {
        true => "a folder".to_owned(),
        false if about.is_file() => format!("a file of {} bytes", about.size()),
        false => "no regular file".to_owned(),
    };
    if about.is_file() && about.mode() & 0o111 != 0 {
        text += ", executable";
    }
    if let Ok(target) = fs::read_link(path) {
        text += &format!(", a link to {}", target.display());
    }
    text
}

/// The digest of the names in a folder, of all or of those that Python could import.
fn names(folder: &Path, modules: bool) -> Option<String> {
    let ours = left_out_of_sights();
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).ok()? {
        let entry = entry.ok()?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = folder.join(&name);
        let imported = || {
            let ending = [".py", ".pyc", ".so", ".zip"].iter().any(|ending| name.ends_with(ending));
            ending || path.join("__init__.py").exists()
        };
        if !is_noise(&name) && !ours.contains(&path) && (!modules || imported()) {
            names.push(name);
        }
    }
    names.sort();
    Some(blake3::hash(names.join("\0").as_bytes()).to_hex().to_string())
}

fn content(path: &Path, about: &Metadata, known: Option<(&Stamp, &str)>) -> (String, Option<Stamp>) {
    static KNOWN: Mutex<Option<HashMap<PathBuf, (Stamp, String)>>> = Mutex::new(None);
    let stamp = Stamp::of(about);
    let keep = |state: &str| {
        let mut all = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        all.get_or_insert_default().insert(path.to_owned(), (stamp, state.to_owned()));
    };
    if let Some((of, state)) = known
        && *of == stamp
    {
        keep(state);
        return (state.to_owned(), Some(stamp));
    }
    if let Some((of, state)) = KNOWN.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default().get(path)
        && *of == stamp
    {
        return (state.clone(), Some(stamp));
    }
    #[expect(clippy::disallowed_methods, reason = "it decides which files are read again, and enters no output")]
    let begun = SystemTime::now();
    let Ok(digest) = crate::file_digest(path) else { return ("cannot be read".into(), None) };
    let settled = begun.duration_since(changed_at(about)).is_ok_and(|age| age > TICK);
    let state = digest.hex();
    if !settled || Stamp::at(path) != Some(stamp) {
        return (state, None);
    }
    keep(&state);
    (state, Some(stamp))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread::sleep;

    #[test]
    fn every_change_of_what_was_asked_is_seen() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        fs::write(path("data"), "one").expect("writable");
        let sights = [
            Sight::of(path("data"), Asked::Content),
            Sight::of(path("none"), Asked::Content),
            Sight::of(path("none"), Asked::Presence),
            Sight::of(folder.path().to_string_lossy(), Asked::Names),
            Sight::of(folder.path().to_string_lossy(), Asked::Modules),
        ];
        assert_eq!(sights[1].state, MISSING);
        let differ = || sights.iter().map(|sight| sight.again().state != sight.state).collect::<Vec<_>>();
        assert_eq!(differ(), [false; 5]);
        // At once, of the same length.
        fs::write(path("data"), "two").expect("writable");
        assert_eq!(differ(), [true, false, false, false, false]);
        fs::write(path("data"), "one").expect("writable");
        fs::create_dir(path("__pycache__")).expect("writable");
        assert_eq!(differ(), [false; 5]);
        fs::write(path("none"), "").expect("writable");
        assert_eq!(differ(), [false, true, true, true, false]);
        fs::write(path("none.py"), "").expect("writable");
        assert_eq!(differ(), [false, true, true, true, true]);
    }

    #[test]
    fn size_mode_and_target_are_seen_without_reading() {
        use std::os::unix::fs::{PermissionsExt as _, symlink};
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        fs::write(path("data"), "one").expect("writable");
        symlink("data", path("link")).expect("writable");
        let states = || ["data", "link"].map(|name| Sight::of(path(name).to_string_lossy(), Asked::Presence).state);
        let first = states();
        assert_eq!(first, ["a file of 3 bytes", "a file of 3 bytes, a link to data"]);
        fs::write(path("data"), "two").expect("writable");
        assert_eq!(states(), first, "its content was not asked for");
        fs::set_permissions(path("data"), fs::Permissions::from_mode(0o755)).expect("its owner may");
        assert_eq!(states()[0], "a file of 3 bytes, executable");
        fs::write(path("data"), "three").expect("writable");
        assert_eq!(states()[1], "a file of 5 bytes, executable, a link to data");
        fs::remove_file(path("link")).and_then(|()| symlink("./data", path("link"))).expect("writable");
        assert_eq!(states()[1], "a file of 5 bytes, executable, a link to ./data");
    }

    #[test]
    fn a_settled_file_is_not_read_again_and_a_young_one_is() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("data");
        fs::write(&path, "one").expect("writable");
        let name = path.to_string_lossy().into_owned();
        assert_eq!(Sight::of(name.clone(), Asked::Content).stamp, None, "its times may stay the same");
        sleep(TICK + Duration::from_millis(10));
        let settled = Sight::of(name, Asked::Content);
        assert!(settled.stamp.is_some());
        // A state that is no digest shows that nothing was read.
        let told = Sight { state: "as told".into(), ..settled.clone() };
        assert_eq!(told.again().state, "as told");
        fs::write(&path, "two").expect("writable");
        assert_ne!(told.again().state, "as told");
        assert_ne!(settled.again().state, settled.state);
    }

    #[test]
    fn packages_and_systems_stand_as_folders() {
        let of = |path: &str| installed(path).unwrap_or("itself").to_owned();
        assert_eq!(of("/home/me/denoise.py"), "itself");
        assert_eq!(of("/home/me/.venv/lib/python3.12/site-packages/numpy/core/a.so").rsplit('/').next(), Some("numpy"));
        assert_eq!(of("/home/me/py/lib/python3.12/os.py"), "/home/me/py/lib/python3.12");
        assert_eq!(of("/usr/bin/env"), "/usr/bin");
        assert_eq!(of("/etc/passwd"), "/etc");
        let names = |sights| Seen { untraced: None, sights }.summary().into_keys().collect::<Vec<_>>();
        assert_eq!(names(vec![Sight::of("/nowhere/a", Asked::Content)]), ["/nowhere (what exists in it)"]);
        let read = Sight { state: "a digest".into(), ..Sight::of("/nowhere/a", Asked::Content) };
        assert_eq!(names(vec![read]), ["/nowhere/a"]);
    }

    #[test]
    fn two_runs_that_saw_other_contents_count_as_changed() {
        let sight =
            |path: &str, asked, state: &str| Sight { path: path.into(), asked, state: state.into(), stamp: None };
        let mut seen = Seen { untraced: None, sights: vec![sight("/a", Asked::Content, "1")] };
        seen.join(Seen { untraced: None, sights: vec![sight("/b", Asked::Content, "1")] });
        assert_eq!((seen.sights.len(), seen.changed().count()), (2, 0));
        seen.join(Seen { untraced: Some("none".into()), sights: vec![sight("/b", Asked::Content, "2")] });
        assert_eq!(seen.changed().collect::<Vec<_>>(), ["/b"]);
        assert!(seen.untraced.is_some());
    }
}
