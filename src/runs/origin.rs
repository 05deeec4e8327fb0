//! Where a run took place: the machine, and the commit of the pipeline's checkout. Starts no program.

use serde::{Deserialize, Serialize};
use std::{
    fs,
    path::{Path, PathBuf},
    thread,
};
use tauflow_contract::read_regular;

/// More than a reference of git, or a short file of `/proc`, holds.
const SMALL: u64 = 1 << 16;
/// More than the packed references of a large repository hold.
const PACKED: u64 = 1 << 26;

/// A machine.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Its host name, empty if unknown.
    pub host: String,
    /// Its processor, empty if unknown.
    pub processor: String,
    /// Threads that run at a time.
    pub threads: u64,
}

impl Machine {
    /// This machine.
    pub fn here() -> Self {
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default().trim().to_owned();
        let processors = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = processors.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
        let threads = thread::available_parallelism().map_or(1, std::num::NonZero::get) as u64;
        Self { host, processor: model.map(|(_, name)| name.trim().to_owned()).unwrap_or_default(), threads }
    }
}

fn text(path: &Path, most: u64) -> Option<String> {
    String::from_utf8(read_regular(path, most).ok()?).ok()
}

/// The commit that is checked out where a file lies; none outside of git.
pub(super) fn commit(file: &Path) -> Option<String> {
    let git = file.ancestors().skip(1).map(|folder| folder.join(".git")).find(|git| git.exists())?;
    let own = if git.is_dir() {
        git
    } else {
        // A linked worktree: the file names its folder.
        let folder = PathBuf::from(text(&git, SMALL)?.strip_prefix("gitdir:")?.trim());
        git.parent()?.join(folder)
    };
    let head = text(&own.join("HEAD"), SMALL)?;
    let Some(name) = head.trim().strip_prefix("ref: ") else { return hash(&head) };
    let shared = match text(&own.join("commondir"), SMALL) {
        Some(folder) => own.join(folder.trim()),
        None => own.clone(),
    };
    let loose = [&own, &shared].into_iter().find_map(|folder| text(&folder.join(name), SMALL));
    if let Some(found) = loose {
        return hash(&found);
    }
    let packed = text(&shared.join("packed-refs"), PACKED)?;
    packed.lines().find_map(|line| line.split_once(' ').filter(|(_, of)| of.trim() == name)).and_then(|(h, _)| hash(h))
}

/// A text that is a hash of git's.
fn hash(text: &str) -> Option<String> {
    let text = text.trim();
    (matches!(text.len(), 40 | 64) && text.bytes().all(|b| b.is_ascii_hexdigit())).then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commit_is_read_from_loose_and_packed_references_and_worktrees() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        let write = |name: &str, text: &str| {
            fs::create_dir_all(at(name).parent().expect("below the folder")).expect("room");
            fs::write(at(name), text).expect("room");
        };
        let (one, two) = ("1".repeat(40), "2".repeat(40));
        let file = at("pipelines/small.yaml");
        assert_eq!(commit(&at("nothing/x.yaml")).filter(|c| *c == one), None);
        write(".git/HEAD", "ref: refs/heads/main\n");
        assert_eq!(commit(&file), None, "a branch without commits");
        write(".git/packed-refs", &format!("# pack-refs\n{one} refs/heads/main\n"));
        assert_eq!(commit(&file), Some(one));
        write(".git/refs/heads/main", &format!("{two}\n"));
        assert_eq!(commit(&file), Some(two.clone()), "a loose one is newer");
        write("tree/.git", "gitdir: ../.git/worktrees/tree\n");
        write(".git/worktrees/tree/HEAD", "ref: refs/heads/main\n");
        write(".git/worktrees/tree/commondir", "../..\n");
        assert_eq!(commit(&at("tree/small.yaml")), Some(two.clone()));
        write(".git/worktrees/tree/HEAD", &two);
        assert_eq!(commit(&at("tree/small.yaml")), Some(two));
        write(".git/HEAD", "ref: nonsense");
        assert_eq!(commit(&file), None);
    }
}
