//! Results that test programs share, because making them takes minutes.

use std::{
    fs::{self, File},
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
};

/// A folder for results of one build of a program, and the right to use it alone.
#[derive(Debug)]
pub struct Shared {
    path: PathBuf,
    /// Locked as long as this lives.
    _lock: File,
}

impl Shared {
    /// The folder `name` below a folder for temporary files of tests, for this build of `program`. Folders of earlier
    /// builds are deleted: whatever a test finds, this build has made.
    ///
    /// # Panics
    /// If it cannot be made.
    pub fn of(program: &Path, folder: &Path, name: &str) -> Self {
        let built = fs::metadata(program).expect("the program is built");
        let mut hasher = DefaultHasher::new();
        (program, built.len(), built.modified().expect("files have times")).hash(&mut hasher);
        fs::create_dir_all(folder).expect("a folder for temporary files");
        let lock = File::create(folder.join(format!("{name}.lock"))).expect("it can be written");
        lock.lock().expect("files can be locked");
        let own = format!("{name}-{:016x}", hasher.finish());
        for entry in fs::read_dir(folder).expect("it can be listed").flatten() {
            let other = entry.file_name().into_string().unwrap_or_default();
            if other != own && other.starts_with(&format!("{name}-")) {
                fs::remove_dir_all(entry.path()).expect("our own");
            }
        }
        let path = folder.join(own);
        fs::create_dir_all(&path).expect("it can be written");
        Self { path, _lock: lock }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_another_build_are_gone() {
        let folder = std::env::temp_dir().join(format!("tauflow-shared-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("writable");
        let program = folder.join("program");
        fs::write(&program, "one").expect("writable");
        let of = || Shared::of(&program, &folder, "results");
        fs::write(of().path().join("result"), "1").expect("writable");
        assert!(of().path().join("result").exists());
        let before = of().path().to_owned();
        fs::write(&program, "another").expect("writable");
        assert!(!of().path().join("result").exists() && !before.exists());
        fs::remove_dir_all(&folder).expect("our own");
    }
}
