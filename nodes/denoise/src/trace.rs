//! Which files a program opens or looks for: noted while it runs, and their contents taken once it has ended.
//!
//! On Linux the kernel stops the program, and all that it starts, at each system call that names a file, and tells this
//! process (seccomp's user notification). This works for programs in any language, static ones too, and puts nothing
//! into them. Where it is not available, the reason is kept instead.

#[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
mod listener;

#[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
pub(crate) use listener::Listener;

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    fs,
    io::Read,
    os::unix::fs::MetadataExt,
    path::{Component, Path, PathBuf},
};
use tauflow_contract::{Asked, CHANGED, MISSING, Seen, Sight, Stamp, left_out_of_sights};

/// A program that looks at more paths than this is not followed further.
const MOST: usize = 200_000;

/// How a program uses a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// It asks whether it exists.
    Presence,
    /// It reads a file, or lists a folder.
    Read,
    /// It reads a file and may change it.
    Change,
    /// It makes a file anew, or only writes: the earlier content does not matter to it.
    Write,
    /// It makes a file or folder if there is none.
    Make,
    /// It reads a file, and makes it if there is none.
    ReadOrMake,
    /// It runs a file.
    Run,
}

/// Programs that may stand for each other: a script's interpreter may be a script.
const MOST_INTERPRETERS: usize = 5;

/// The program that the kernel starts in place of a file: the interpreter of a script, or the loader of a program with
/// libraries. The kernel opens it itself, so that no call names it.
fn interpreter(path: &Path) -> Option<PathBuf> {
    let mut head = Vec::new();
    fs::File::open(path).and_then(|file| file.take(4096).read_to_end(&mut head)).ok()?;
    let named = |bytes: &[u8]| {
        let text = std::str::from_utf8(bytes).ok()?.trim_matches(['\0', ' ', '\t']);
        (!text.is_empty()).then(|| PathBuf::from(text))
    };
    if let Some(line) = head.strip_prefix(b"#!") {
        let line = line.split(|byte| *byte == b'\n').next()?.trim_ascii();
        return named(line.split(|byte| *byte == b' ' || *byte == b'\t').next()?);
    }
    // An ELF file of 64 bits: the program header that names the loader (type 3).
    head.strip_prefix(b"\x7fELF\x02\x01")?;
    let number = |at: usize, bytes: usize| -> Option<usize> {
        let field = head.get(at..at.checked_add(bytes)?)?;
        let value = field.iter().rev().fold(0u64, |value, byte| value << 8 | u64::from(*byte));
        usize::try_from(value).ok()
    };
    let (first, size, count) = (number(32, 8)?, number(54, 2)?, number(56, 2)?);
    let header = |place: usize| first.checked_add(place.checked_mul(size)?);
    let loader = (0..count).filter_map(header).find(|at| number(*at, 4) == Some(3))?;
    let (at, length) = (number(loader + 8, 8)?, number(loader + 32, 8)?);
    named(head.get(at..at.checked_add(length)?)?)
}

/// Device, number, size and time of a file's content.
type ContentMark = (u64, u64, u64, i64, i64);

fn content_mark(path: &Path) -> Option<ContentMark> {
    let about = fs::metadata(path).ok()?;
    Some((about.dev(), about.ino(), about.size(), about.mtime(), about.mtime_nsec()))
}

/// What is noted of a path.
#[derive(Debug)]
struct Look {
    asked: Asked,
    /// What the file was when it was asked first; none if it did not exist.
    stamp: Option<Stamp>,
    /// What changes with its content alone, as far as that shows; a stamp changes with a new hard link, too.
    content: Option<ContentMark>,
    /// The program may change it itself.
    changes: bool,
}

/// What a program has looked at so far.
#[derive(Debug, Default)]
pub(crate) struct Notes {
    looks: BTreeMap<PathBuf, Look>,
    /// Files and folders that it made itself.
    own: HashSet<PathBuf>,
    /// Folders that do not count: its own, and those of the run.
    beside: Vec<PathBuf>,
    /// The last path that each thread asked about: Python's import asks about a folder before it lists it.
    last: HashMap<u32, PathBuf>,
    /// Folders that were listed as Python's import does it.
    listed: HashSet<PathBuf>,
    /// Folders of Python modules that were read.
    imported: HashSet<PathBuf>,
    /// Why not all is known.
    pub(crate) untraced: Option<String>,
}

/// The source of a file of Python's bytecode, which Python trusts as long as the source's time is the same.
fn source_of(path: &Path) -> Option<PathBuf> {
    let folder = path.parent().filter(|folder| folder.file_name().is_some_and(|name| name == "__pycache__"))?;
    let name = path.file_name()?.to_str()?;
    let module = name.split('.').next().filter(|_| name.contains(".pyc"))?;
    Some(folder.parent()?.join(format!("{module}.py")))
}

/// Whether a file of bytecode counts by itself: it has no source, or says that it belongs to a content of it.
fn counts_alone(bytecode: &Path, source: &Path) -> bool {
    let mut head = [0; 8];
    let read = fs::File::open(bytecode).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && (!source.exists() || head[4..] != [0; 4])
}

/// A path without `.` and `..`.
fn plain(path: &Path) -> PathBuf {
    let path: PathBuf = path.components().filter(|part| *part != Component::CurDir).collect();
    if !path.components().any(|part| part == Component::ParentDir) {
        return path;
    }
    let resolved = || Some(path.parent()?.canonicalize().ok()?.join(path.file_name()?));
    // A name that ends in `..` is a folder.
    path.canonicalize().ok().filter(|_| path.file_name().is_none()).or_else(resolved).unwrap_or(path)
}

impl Notes {
    /// No notes yet; everything below these folders is left out.
    pub(crate) fn beside(folders: impl IntoIterator<Item = PathBuf>) -> Self {
        let named = folders.into_iter().chain(left_out_of_sights());
        // By all of their names, as links are followed below.
        let beside = named.flat_map(|path| path.canonicalize().ok().into_iter().chain([path])).collect();
        Self { beside, ..Self::default() }
    }

    /// Not all that the program looks at will be known.
    pub(crate) fn give_up(&mut self, why: impl Into<String>) {
        self.untraced.get_or_insert(why.into());
    }

    /// True for paths that are no inputs.
    fn is_left_out(&self, path: &Path) -> bool {
        let system = ["/proc", "/sys", "/dev"].iter().any(|folder| path.starts_with(folder));
        system
            || self.beside.iter().any(|folder| path.starts_with(folder))
            || (!self.own.is_empty() && path.ancestors().any(|above| self.own.contains(above)))
    }

    /// The program made this path itself.
    fn keep_own(&mut self, path: PathBuf) {
        let real = || Some(path.parent()?.canonicalize().ok()?.join(path.file_name()?));
        self.own.extend(real().filter(|real| *real != path));
        self.own.insert(path);
    }

    /// The input that a path leads to which is none itself: the program may have made a link, or ask for a file by its
    /// process.
    fn behind(&self, thread: u32, path: &Path) -> Option<PathBuf> {
        let own = |rest: &Path| Path::new("/proc").join(thread.to_string()).join(rest);
        let of_process = ["/proc/self", "/proc/thread-self"].iter().find_map(|own| path.strip_prefix(own).ok());
        let path = of_process.map_or_else(|| path.to_owned(), own);
        let real = path.canonicalize().ok()?;
        (!path.starts_with("/dev") && real != path && !self.is_left_out(&real)).then_some(real)
    }

    /// A thread of the program is about to use a path.
    pub(crate) fn note(&mut self, thread: u32, path: &Path, what: Use) {
        let mut path = plain(path);
        if what == Use::Run {
            let found = std::iter::successors(interpreter(&path), |program| interpreter(program));
            let found: Vec<PathBuf> = found.take(MOST_INTERPRETERS).filter(|program| program.is_absolute()).collect();
            found.into_iter().for_each(|program| self.note(thread, &program, Use::Read));
        }
        if self.is_left_out(&path) {
            match self.behind(thread, &path) {
                Some(real) if !matches!(what, Use::Write | Use::Make) => path = real,
                _ => return,
            }
        }
        if let Some(source) = source_of(&path) {
            if what == Use::Read && path.exists() {
                self.imported.extend(source.parent().map(Path::to_owned));
                if source.exists() {
                    self.look(source.clone(), Asked::Content, false);
                }
                if counts_alone(&path, &source) {
                    self.look(path, Asked::Content, false);
                }
            }
            return;
        }
        if path.file_name().is_some_and(|name| name == "__pycache__") {
            return;
        }
        match what {
            Use::Write => self.keep_own(path),
            Use::Make | Use::ReadOrMake | Use::Change if !path.exists() => self.keep_own(path),
            Use::Make => self.look(path, Asked::Presence, false),
            Use::Change => self.look(path, Asked::Content, true),
            Use::Presence => {
                self.last.insert(thread, path.clone());
                self.look(path, Asked::Presence, false);
            }
            Use::Read if path.is_dir() => {
                // The first list after a question is that of an import, if modules of that folder are read.
                let imports = self.last.get(&thread) == Some(&path) && self.listed.insert(path.clone());
                self.look(path, if imports { Asked::Modules } else { Asked::Names }, false);
            }
            Use::Read | Use::Run | Use::ReadOrMake => {
                if path.extension().is_some_and(|ending| ending == "py" || ending == "so") {
                    self.imported.extend(path.parent().map(Path::to_owned));
                }
                self.look(path, Asked::Content, false);
            }
        }
    }

    fn look(&mut self, path: PathBuf, asked: Asked, changes: bool) {
        if self.looks.len() >= MOST {
            return self.give_up(format!("it looks at more than {MOST} paths"));
        }
        match self.looks.get_mut(&path) {
            Some(look) => {
                look.asked = asked.max(look.asked);
                look.changes |= changes;
            }
            None => {
                let (stamp, content) = (Stamp::at(&path), content_mark(&path));
                self.looks.insert(path, Look { asked, stamp, content, changes });
            }
        }
    }

    /// All that was seen, once the program has ended.
    pub(crate) fn seen(self) -> Seen {
        let Self { looks, own, imported, mut untraced, .. } = self;
        let is_own = |path: &Path| !own.is_empty() && path.ancestors().any(|above| own.contains(above));
        let mut sights = Vec::with_capacity(looks.len());
        for (path, Look { asked, stamp, content, changes }) in looks {
            if is_own(&path) {
                continue;
            }
            let asked = match asked {
                Asked::Modules if !imported.contains(&path) => Asked::Names,
                asked => asked,
            };
            let Some(name) = path.to_str() else {
                untraced.get_or_insert(format!("`{}` is no name in UTF-8", path.display()));
                continue;
            };
            let mut sight = Sight::of(name, asked);
            match stamp {
                // It may have been made meanwhile, and did not exist when it mattered.
                None => (sight.state, sight.stamp) = (MISSING.into(), None),
                Some(_) if asked == Asked::Content && !path.is_dir() && content_mark(&path) != content => {
                    if changes {
                        // A file in which the program keeps a state of its own.
                        continue;
                    }
                    (sight.state, sight.stamp) = (CHANGED.into(), None);
                }
                // It saw the earlier size.
                Some(stamp)
                    if asked == Asked::Presence
                        && path.is_file()
                        && Stamp::at(&path).is_some_and(|now| now.size() != stamp.size()) =>
                {
                    (sight.state, sight.stamp) = (CHANGED.into(), None);
                }
                Some(_) if sight.state == MISSING => (sight.state, sight.stamp) = (CHANGED.into(), None),
                Some(_) => {}
            }
            sights.push(sight);
        }
        Seen { untraced, sights }
    }
}

/// Stands for the listener where programs cannot be followed.
#[cfg(not(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64"))))]
pub(crate) struct Listener;

#[cfg(not(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64"))))]
impl Listener {
    /// Follows nothing.
    pub(crate) fn attach(_: &mut std::process::Command, _: Notes) -> std::io::Result<Self> {
        Ok(Self)
    }

    /// The notes.
    pub(crate) fn end(self) -> Notes {
        let mut notes = Notes::default();
        notes.give_up("files are traced on Linux only");
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytecode_stands_for_its_source() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("__pycache__")).expect("writable");
        let bytecode = path("__pycache__/helper.cpython-312.pyc");
        assert_eq!(source_of(&bytecode), Some(path("helper.py")));
        assert_eq!(source_of(&path("helper.pyc")), None);
        fs::write(&bytecode, [0; 16]).expect("writable");
        let noted = || {
            let mut notes = Notes::default();
            notes.note(1, &bytecode, Use::Read);
            notes.looks.into_keys().collect::<Vec<_>>()
        };
        assert_eq!(noted(), std::slice::from_ref(&bytecode), "without a source it counts by itself");
        fs::write(path("helper.py"), "").expect("writable");
        assert_eq!(noted(), [path("helper.py")]);
        fs::write(&bytecode, [1; 16]).expect("writable");
        assert_eq!(noted(), [bytecode.clone(), path("helper.py")], "it belongs to a content");
    }

    #[test]
    fn what_a_program_makes_is_its_own_and_what_others_change_meanwhile_counts_as_changed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        for name in ["old", "young", "database"] {
            fs::write(path(name), name).expect("writable");
        }
        let mut notes = Notes::beside([path("own")]);
        for (name, what) in [
            ("own/a", Use::Read),
            ("out", Use::Presence),
            ("out", Use::Write),
            ("out", Use::Read),
            ("made", Use::Presence),
            ("made", Use::Make),
            ("made/in", Use::Read),
            ("cache", Use::Read),
            ("old", Use::Change),
            ("database", Use::Change),
            ("young", Use::Presence),
            ("young", Use::Read),
            ("made/../old", Use::Presence),
        ] {
            notes.note(1, &path(name), what);
        }
        for (name, text) in [("cache", "made"), ("young", "otherwise"), ("database", "another")] {
            fs::write(path(name), text).expect("writable");
        }
        let seen = notes.seen();
        let state = |name: &str| {
            let found = seen.sights.iter().find(|sight| Path::new(&sight.path) == path(name));
            found.map(|sight| (sight.asked, sight.state.as_str()))
        };
        for own in ["own/a", "out", "made", "made/in", "database"] {
            assert_eq!(state(own), None, "{own}");
        }
        assert_eq!(state("cache"), Some((Asked::Content, MISSING)));
        assert_eq!(state("young"), Some((Asked::Content, CHANGED)));
        assert_eq!(state("old").expect("it was read").0, Asked::Content);
        assert!(state("old").expect("it was read").1.len() > 32, "{seen:?}");
    }

    #[test]
    fn files_behind_links_and_interpreters_count() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("own")).expect("writable");
        for name in ["data", "lock", "tool"] {
            fs::write(path(name), "1").expect("writable");
        }
        symlink(path("data"), path("own/link")).expect("writable");
        fs::write(path("own/script"), format!("#! {} -x\n", path("tool").display())).expect("writable");
        let mut notes = Notes::beside([path("own")]);
        let uses =
            [("own/link", Use::Read), ("own/script", Use::Run), ("lock", Use::ReadOrMake), ("new", Use::ReadOrMake)];
        uses.iter().for_each(|(name, what)| notes.note(1, &path(name), *what));
        notes.note(1, Path::new("/dev/stdin"), Use::Read);
        let seen: Vec<(String, Asked)> =
            notes.seen().sights.into_iter().map(|sight| (sight.path, sight.asked)).collect();
        let content = ["data", "lock", "tool"].map(|name| (path(name).display().to_string(), Asked::Content));
        assert_eq!(seen, content);
    }

    #[test]
    fn a_program_of_this_machine_names_its_loader() {
        let own = std::env::current_exe().expect("a test is a program");
        let loader = interpreter(&own).expect("it is linked dynamically");
        assert!(loader.is_absolute() && loader.exists(), "{}", loader.display());
        assert_eq!(interpreter(Path::new("/nowhere")), None);
    }

    #[test]
    fn a_list_that_an_import_makes_counts_modules_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let asked = |uses: &[(&str, Use)]| {
            let mut notes = Notes::default();
            uses.iter().for_each(|(name, what)| notes.note(1, &folder.path().join(name), *what));
            let seen = notes.seen();
            seen.sights.into_iter().find(|sight| Path::new(&sight.path) == folder.path()).expect("listed").asked
        };
        fs::write(folder.path().join("helper.py"), "").expect("writable");
        let import = [("", Use::Presence), ("", Use::Read), ("helper.py", Use::Read)];
        assert_eq!(asked(&import), Asked::Modules);
        assert_eq!(asked(&import[..2]), Asked::Names, "no module was read");
        assert_eq!(asked(&import[1..]), Asked::Names, "a list without a question is not of an import");
        let again = [&import[..], &import[..2]].concat();
        assert_eq!(asked(&again), Asked::Names, "the program lists it itself");
    }
}
