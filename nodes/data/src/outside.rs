//! Files and programs outside that decide what a kind makes: where they are, and what they hold.
//!
//! Kinds put the digests of such files into their keys. Nothing is run or loaded here.

use std::{
    collections::BTreeMap,
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::SystemTime,
};
use tauflow_contract::{Digest, file_digest};

/// The file of a program: as it is named, or where the system looks for programs.
pub fn program(name: &str) -> Option<PathBuf> {
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
pub fn identity(template: &[String]) -> BTreeMap<String, String> {
    let words = template.iter().enumerate();
    let file = |(at, word): (usize, &String)| {
        let file = if at == 0 { program(word) } else { Some(PathBuf::from(word)).filter(|file| file.is_file()) }?;
        Some((word.clone(), contents(&file)))
    };
    words.filter_map(file).collect()
}

/// The digest of a file's content; an unreadable file differs from a missing one.
pub fn contents(file: &Path) -> String {
    digest(file).map_or_else(|| "cannot be read".to_owned(), |digest| digest.hex())
}

/// Digests of files, read again only when they have changed.
pub fn digest(file: &Path) -> Option<Digest> {
    static KNOWN: Mutex<BTreeMap<PathBuf, (SystemTime, u64, Digest)>> = Mutex::new(BTreeMap::new());
    let about = fs::metadata(file).ok()?;
    let (changed, size) = (about.modified().ok()?, about.len());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((at, len, digest)) = known.get(file)
        && (*at, *len) == (changed, size)
    {
        return Some(*digest);
    }
    let digest = file_digest(file).ok()?;
    known.insert(file.to_owned(), (changed, size, digest));
    Some(digest)
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
}
