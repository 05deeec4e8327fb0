//! The files that a scene is made of: which of them its own file may name, and what is in them. Knows no file format.
//!
//! Paths are relative to the folder of the scene's own file. They may lead out of that folder, but not out of the
//! folder that the user named.

use super::problems::{Place, Problems};
use std::{
    cell::Cell,
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Component, Path, PathBuf},
};
use tauflow_contract::Digest;

/// Part name of the scene's own file.
pub const MAIN: &str = "file";

/// Largest file that is read, in bytes.
const LARGEST: u64 = 1 << 31;

/// Most files of a scene.
const MOST_FILES: usize = 20_000;

/// Part name of the file at a normalised path.
pub fn part(path: &str) -> String {
    format!("external/{}", &Digest::of(path.as_bytes()).to_string()[..32])
}

/// A path with `.` and `..` worked out and `/` between its parts; none for one that is absolute, empty or no path.
pub fn normalised(path: &str) -> Option<String> {
    let path = path.replace('\\', "/");
    if path.is_empty() || path.len() > 4096 || path.starts_with('/') || path.contains(['\0', ':']) {
        return None;
    }
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|last| *last != "..") => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    (!parts.is_empty()).then(|| parts.join("/"))
}

/// The text of a file without the mark of UTF-8 that some editors put before it; what is no such text is told.
pub fn text_of<'b>(bytes: &'b [u8], file: &Place, problems: &mut Problems) -> Option<&'b str> {
    let wide = [[0xFF, 0xFE], [0xFE, 0xFF]].iter().any(|mark| bytes.starts_with(mark));
    let what = match std::str::from_utf8(bytes) {
        _ if wide => "it is UTF-16",
        Ok(text) => return Some(text.trim_start_matches('\u{feff}')),
        Err(_) if bytes.starts_with(&[0x1F, 0x8B]) => "it is packed (gzip)",
        Err(_) => "it is no text in UTF-8",
    };
    problems.error(file, what, "unpack it, or save it as UTF-8");
    None
}

/// The place of a folder without links, `.` and `..`; the working directory for an empty path.
pub fn real(folder: &Path) -> io::Result<PathBuf> {
    fs::canonicalize(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
}

/// How many folders a folder lies below another, by their real places: a link or `..` may lead out of the other. None
/// if it does not lie below it, or cannot be found.
pub fn depth(folder: &Path, root: &Path) -> Option<usize> {
    let (folder, root) = (real(folder).ok()?, real(root).ok()?);
    Some(folder.strip_prefix(root).ok()?.components().count())
}

/// The files of a scene, as they were handed over or as they lie on disk.
pub enum Given<'a> {
    /// By part name.
    Parts(&'a BTreeMap<String, Vec<u8>>),
    /// On disk: in the folder of the scene's own file, and in some of the folders above it.
    Disk {
        /// Where paths begin.
        folder: PathBuf,
        /// How many folders up they may lead: see [`depth`].
        above: usize,
        /// Bytes that were read so far.
        read: Cell<u64>,
    },
}

/// Most bytes that are read to find out which files a scene names.
const MOST_READ: u64 = 1 << 32;

impl Given<'_> {
    /// The path on disk of a file that may be read.
    fn on_disk(folder: &Path, above: usize, path: &str) -> Option<PathBuf> {
        let mut depth = above;
        for part in Path::new(path).components() {
            match part {
                Component::ParentDir => depth = depth.checked_sub(1)?,
                Component::Normal(_) => depth += 1,
                _ => return None,
            }
        }
        let full = folder.join(path);
        // Files that are not regular are never opened: reading a FIFO would block.
        fs::metadata(&full).is_ok_and(|m| m.is_file() && m.len() <= LARGEST).then_some(full)
    }

    /// Whether a file is there.
    pub fn has(&self, path: &str) -> bool {
        let Some(path) = normalised(path) else { return false };
        match self {
            Self::Parts(parts) => parts.contains_key(&part(&path)),
            Self::Disk { folder, above, .. } => Self::on_disk(folder, *above, &path).is_some(),
        }
    }

    /// The bytes of a file, if it is there.
    pub fn get(&self, path: &str) -> Option<Vec<u8>> {
        let path = normalised(path)?;
        match self {
            Self::Parts(parts) => parts.get(&part(&path)).cloned(),
            Self::Disk { folder, above, read } => {
                let bytes = fs::read(Self::on_disk(folder, *above, &path)?).ok()?;
                read.set(read.get() + bytes.len() as u64);
                (read.get() <= MOST_READ).then_some(bytes)
            }
        }
    }

    /// The bytes of a file; what is wrong is told.
    pub fn read(&self, path: &str, at: &Place, problems: &mut Problems) -> Option<Vec<u8>> {
        let found = self.get(path);
        if found.is_none() {
            problems.error(
                at,
                format!("`{path}` is no file of up to 2 GiB below the folder that was named"),
                "name the folder that holds all of the scene's files, and them by relative paths",
            );
        }
        found
    }

    /// Part names and places on disk of the files at these paths that are there; none of parts that were handed over.
    pub fn parts(&self, paths: &BTreeSet<String>) -> Vec<(String, PathBuf)> {
        let Self::Disk { folder, above, .. } = self else { return Vec::new() };
        let found = paths.iter().filter_map(|path| {
            let path = normalised(path)?;
            Some((part(&path), Self::on_disk(folder, *above, &path)?))
        });
        found.take(MOST_FILES).collect::<BTreeMap<_, _>>().into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_worked_out_and_stay_below_the_root() {
        assert_eq!(normalised("a/./b/../c.ply").as_deref(), Some("a/c.ply"));
        assert_eq!(normalised("..\\x.png").as_deref(), Some("../x.png"));
        for bad in ["", "/etc/passwd", "C:/x", "a\0", "."] {
            assert_eq!(normalised(bad), None, "{bad:?}");
        }
        let temporary = tempfile::tempdir().expect("a folder");
        let folder = temporary.path();
        fs::create_dir_all(folder.join("scene")).expect("a folder");
        fs::write(folder.join("x"), "1").expect("a file");
        let scene = folder.join("scene");
        let at = |path| Given::on_disk(&scene, 1, path).is_some();
        assert!(at("../x") && !at("../../x") && !at("../scene/../../x") && !at("../y") && !at("../scene"));
        assert!(Given::on_disk(&scene, 0, "../x").is_none());
        // Places count, not spellings.
        std::os::unix::fs::symlink(folder, scene.join("up")).expect("a link");
        assert_eq!(depth(Path::new(""), Path::new(".")), Some(0));
        assert_eq!(depth(&scene, &scene.join("..")), Some(1));
        assert_eq!(depth(&scene.join("up/scene"), &scene), Some(0));
        for out in ["..", "up", "none"] {
            assert_eq!(depth(&scene.join(out), &scene), None, "{out}");
        }
    }
}
