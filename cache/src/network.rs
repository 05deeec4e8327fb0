//! File systems of several machines: which one a store lies on, and habits of theirs that other code must expect.
//!
//! NFS repeats requests whose answers were lost, so that a rename that was done can be reported as failed. Files that
//! another machine deleted give `ESTALE`. Where no lock daemon answers, locks give `ENOLCK`.

use nix::{libc, sys::statfs::statfs};
use std::{fs, io, os::unix::fs::MetadataExt, path::Path};

/// Types of file systems that several machines can share, as `statfs` numbers them.
const NETWORKS: [(i64, &str); 12] = [
    (0x6969, "NFS"),
    (0xFF53_4D42, "CIFS"),
    (0xFE53_4D42, "SMB"),
    (0x517B, "SMB"),
    (0x0BD0_0BD0, "Lustre"),
    (0x4750_4653, "GPFS"),
    (0x1983_0326, "BeeGFS"),
    (0x00C3_6400, "Ceph"),
    (0x5346_414F, "AFS"),
    (0x0102_1997, "9p"),
    (0x6573_5546, "FUSE"),
    (0x7461_636F, "OCFS2"),
];

/// The file system on which a store lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FileSystem {
    /// Its name, if several machines can share it.
    pub network: Option<&'static str>,
    /// Locks are refused: nobody can tell which processes use the store.
    pub lockless: bool,
}

/// The name of the file system of a folder, if several machines can share it.
pub fn network(folder: &Path) -> Option<&'static str> {
    let found = statfs(folder).ok()?.filesystem_type().0 as i64;
    // The type is signed on some machines.
    NETWORKS.iter().find(|(number, _)| found & 0xFFFF_FFFF == *number).map(|(_, name)| *name)
}

/// Whether a file is not there any more: another machine may have deleted it while it was open here.
pub(crate) fn is_gone(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::StaleNetworkFileHandle)
}

/// Whether a file system refused a lock because it has none.
pub fn has_no_locks(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(libc::ENOLCK | libc::EOPNOTSUPP | libc::ENOSYS))
        || error.kind() == io::ErrorKind::Unsupported
}

/// Renames a file. A rename that is reported as failed counts as done if the file has its new name.
///
/// # Errors
/// If it cannot be renamed.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    let before = fs::symlink_metadata(from)?;
    fs::rename(from, to).or_else(|error| {
        let after = fs::symlink_metadata(to);
        let same = after.is_ok_and(|after| (after.dev(), after.ino()) == (before.dev(), before.ino()));
        if same && fs::symlink_metadata(from).is_err() { Ok(()) } else { Err(error) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rename_fails_where_nothing_was_renamed() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (from, to) = (folder.path().join("a"), folder.path().join("b"));
        assert_eq!(rename(&from, &to).expect_err("nothing is there").kind(), io::ErrorKind::NotFound);
        fs::write(&from, "a").expect("writable");
        fs::create_dir(&to).expect("writable");
        rename(&from, &to).expect_err("a folder is in the way");
        fs::remove_dir(&to).expect("our own");
        rename(&from, &to).expect("nothing is in the way");
        assert_eq!(fs::read(&to).expect("it was renamed"), b"a");
    }

    #[test]
    fn the_file_system_of_processes_is_of_one_machine() {
        assert_eq!(network(Path::new("/proc")), None);
    }
}
