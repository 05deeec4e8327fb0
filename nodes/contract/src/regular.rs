//! Reads external files, which can be of any type and size.

use nix::libc;
use std::{
    fs::{File, OpenOptions},
    io::{self, Read},
    os::unix::fs::OpenOptionsExt,
    path::Path,
};
use tauflow_cache::Digest;

/// Opens a regular file for reading, links followed. Neither opening a FIFO nor reading a device waits.
///
/// # Errors
/// If it cannot be opened, or is no regular file.
pub fn open_regular(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)?;
    // The open file is asked, not the path: it may lead elsewhere by now.
    match file.metadata()?.is_file() {
        true => Ok(file),
        false => Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file")),
    }
}

/// The bytes of a regular file of at most `most` bytes. Files of the system tell no size and may have no end; so what
/// is read counts, too.
///
/// # Errors
/// If it cannot be read, is no regular file, or is larger.
pub fn read_regular(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = open_regular(path)?;
    let large =
        |len: u64| io::Error::new(io::ErrorKind::FileTooLarge, format!("it has {len} bytes; the limit is {most}"));
    let len = file.metadata()?.len();
    if len > most {
        return Err(large(len));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(len).unwrap_or(0));
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    let len = bytes.len() as u64;
    if len > most { Err(large(len)) } else { Ok(bytes) }
}

/// The digest of a file of any size.
///
/// # Errors
/// If it is no regular file, or cannot be read.
pub fn file_digest(path: &Path) -> io::Result<Digest> {
    let mut from = open_regular(path)?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn only_regular_files_are_read_and_no_further_than_asked() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        fs::write(&path, [7; 10]).expect("writable");
        assert_eq!(read_regular(&path, 10).expect("it fits"), [7; 10]);
        let told = read_regular(&path, 9).expect_err("too large").to_string();
        assert_eq!(told, "it has 10 bytes; the limit is 9");
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&path, &link).expect("writable");
        assert_eq!(read_regular(&link, 10).expect("links are followed").len(), 10);
        // A device without an end, one that waits, a FIFO that nobody writes to, a folder.
        let fifo = folder.path().join("fifo");
        nix::unistd::mkfifo(&fifo, nix::sys::stat::Mode::S_IRWXU).expect("writable");
        for strange in [Path::new("/dev/zero"), Path::new("/dev/tty"), &fifo, folder.path()] {
            assert!(read_regular(strange, 10).is_err(), "{}", strange.display());
        }
        // Its size is said to be 0.
        assert!(read_regular(Path::new("/proc/self/maps"), 100).is_err());
    }

    #[test]
    fn digests_of_files_are_those_of_their_bytes() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("large");
        for size in [0, 1, 1 << 20, (3 << 20) + 7] {
            let bytes: Vec<u8> = (0..size).map(|i: usize| (i * 31 % 251) as u8).collect();
            fs::write(&path, &bytes).expect("writable");
            assert_eq!(file_digest(&path).expect("readable"), Digest::of(&bytes), "{size}");
        }
        assert!(file_digest(Path::new("/dev/zero")).is_err());
    }
}
