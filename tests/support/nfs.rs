//! A file system with the habits of NFS: a machine's view of a folder that several machines share.
//!
//! - A directory is listed as it was up to [`STALE`] ago.
//! - Every third rename is done, and reported as failed with `ENOENT`, as when an answer was lost and the request
//!   repeated.
//! - A file that another machine deleted gives `ESTALE` where it is open.
//! - Locks give `ENOLCK`, if [`Habits::lockless`] says so; they count on one machine otherwise.

use fuser::{
    BackgroundSession, FileAttr, FileType, Filesystem, KernelConfig, MountOption, ReplyAttr, ReplyCreate, ReplyData,
    ReplyDirectory, ReplyEmpty, ReplyEntry, ReplyLock, ReplyOpen, ReplyWrite, Request, TimeOrNow,
    consts::{FOPEN_DIRECT_IO, FUSE_FLOCK_LOCKS, FUSE_POSIX_LOCKS},
};
use nix::libc::{EIO, ENOENT, ENOLCK, ESTALE};
use std::{
    collections::HashMap,
    ffi::{OsStr, OsString},
    fs::{self, File, Metadata, OpenOptions},
    io,
    os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
    time::{Duration, Instant, SystemTime},
};

/// How long a listing is old.
pub const STALE: Duration = Duration::from_millis(700);
/// How long the kernel trusts attributes and names.
const TRUSTED: Duration = Duration::from_millis(100);
/// The number of the root.
const ROOT: u64 = 1;

/// What a mount does.
#[derive(Clone, Copy)]
pub struct Habits {
    /// Locks are refused.
    pub lockless: bool,
}

type Entries = Vec<(u64, FileType, OsString)>;

/// See the module.
struct Nfs {
    root: PathBuf,
    habits: Habits,
    /// Paths by number, as they were seen last.
    paths: HashMap<u64, PathBuf>,
    open: HashMap<u64, File>,
    next: u64,
    listed: HashMap<u64, (Instant, Entries)>,
    renames: u64,
}

/// Mounts a view of a folder, as long as the session lives.
///
/// # Errors
/// If file systems cannot be mounted here.
pub fn mount(folder: &Path, at: &Path, habits: Habits) -> io::Result<BackgroundSession> {
    let nfs = Nfs {
        root: folder.to_owned(),
        habits,
        paths: HashMap::from([(ROOT, folder.to_owned())]),
        open: HashMap::new(),
        next: 1,
        listed: HashMap::new(),
        renames: 0,
    };
    fuser::spawn_mount2(nfs, at, &[MountOption::FSName("nfs-of-tests".into()), MountOption::DefaultPermissions])
}

fn code(error: &io::Error) -> i32 {
    error.raw_os_error().unwrap_or(EIO)
}

impl Nfs {
    fn path(&self, of: u64) -> io::Result<PathBuf> {
        self.paths.get(&of).cloned().ok_or_else(|| io::Error::from_raw_os_error(ESTALE))
    }

    fn number(&self, of: &Metadata, path: &Path) -> u64 {
        if path == self.root { ROOT } else { of.ino() }
    }

    fn attributes(&mut self, of: &Metadata, path: &Path) -> FileAttr {
        let ino = self.number(of, path);
        self.paths.insert(ino, path.to_owned());
        let time = |seconds: i64, nanos: i64| {
            SystemTime::UNIX_EPOCH + Duration::new(seconds.max(0) as u64, nanos.max(0) as u32)
        };
        FileAttr {
            ino,
            size: of.size(),
            blocks: of.blocks(),
            atime: time(of.atime(), of.atime_nsec()),
            mtime: time(of.mtime(), of.mtime_nsec()),
            ctime: time(of.ctime(), of.ctime_nsec()),
            crtime: SystemTime::UNIX_EPOCH,
            kind: if of.is_dir() { FileType::Directory } else { FileType::RegularFile },
            perm: (of.mode() & 0o7777) as u16,
            nlink: of.nlink() as u32,
            uid: of.uid(),
            gid: of.gid(),
            rdev: 0,
            blksize: 4096,
            flags: 0,
        }
    }

    fn look(&mut self, parent: u64, name: &OsStr) -> io::Result<FileAttr> {
        let path = self.path(parent)?.join(name);
        let found = fs::symlink_metadata(&path)?;
        Ok(self.attributes(&found, &path))
    }

    fn keep(&mut self, file: File) -> u64 {
        self.next += 1;
        self.open.insert(self.next, file);
        self.next
    }

    /// An open file, unless somebody has deleted it.
    fn opened(&self, handle: u64) -> io::Result<&File> {
        let stale = || io::Error::from_raw_os_error(ESTALE);
        let file = self.open.get(&handle).ok_or_else(stale)?;
        if file.metadata()?.nlink() == 0 { Err(stale()) } else { Ok(file) }
    }

    fn list(&mut self, folder: u64) -> io::Result<Entries> {
        if let Some((at, entries)) = self.listed.get(&folder)
            && at.elapsed() < STALE
        {
            return Ok(entries.clone());
        }
        let mut entries = Entries::new();
        for entry in fs::read_dir(self.path(folder)?)? {
            let entry = entry?;
            let kind = if entry.file_type()?.is_dir() { FileType::Directory } else { FileType::RegularFile };
            entries.push((std::os::unix::fs::DirEntryExt::ino(&entry), kind, entry.file_name()));
        }
        self.listed.insert(folder, (Instant::now(), entries.clone()));
        Ok(entries)
    }

    fn moved(&mut self, from: (u64, &OsStr), to: (u64, &OsStr)) -> io::Result<()> {
        let (from, to) = (self.path(from.0)?.join(from.1), self.path(to.0)?.join(to.1));
        fs::rename(&from, &to)?;
        let found = fs::symlink_metadata(&to)?;
        self.attributes(&found, &to);
        self.renames += 1;
        if self.renames.is_multiple_of(3) { Err(io::Error::from_raw_os_error(ENOENT)) } else { Ok(()) }
    }
}

macro_rules! answer {
    ($reply:ident, $what:expr, $done:expr) => {
        match $what {
            Ok(found) => $done(found),
            Err(error) => $reply.error(code(&error)),
        }
    };
}

impl Filesystem for Nfs {
    fn init(&mut self, _: &Request<'_>, config: &mut KernelConfig) -> Result<(), i32> {
        if self.habits.lockless {
            // Locks are asked of this file system only then.
            config.add_capabilities(FUSE_POSIX_LOCKS | FUSE_FLOCK_LOCKS).map_err(|_| EIO)?;
        }
        Ok(())
    }

    fn lookup(&mut self, _: &Request<'_>, parent: u64, name: &OsStr, reply: ReplyEntry) {
        answer!(reply, self.look(parent, name), |of| reply.entry(&TRUSTED, &of, 0));
    }

    fn getattr(&mut self, _: &Request<'_>, ino: u64, _: Option<u64>, reply: ReplyAttr) {
        let found = self.path(ino).and_then(|path| {
            let found = fs::symlink_metadata(&path)?;
            Ok(self.attributes(&found, &path))
        });
        answer!(reply, found, |of| reply.attr(&TRUSTED, &of));
    }

    fn setattr(
        &mut self,
        _: &Request<'_>,
        ino: u64,
        mode: Option<u32>,
        _: Option<u32>,
        _: Option<u32>,
        size: Option<u64>,
        _: Option<TimeOrNow>,
        _: Option<TimeOrNow>,
        _: Option<SystemTime>,
        _: Option<u64>,
        _: Option<SystemTime>,
        _: Option<SystemTime>,
        _: Option<SystemTime>,
        _: Option<u32>,
        reply: ReplyAttr,
    ) {
        let set = self.path(ino).and_then(|path| {
            if let Some(mode) = mode {
                fs::set_permissions(&path, fs::Permissions::from_mode(mode))?;
            }
            if let Some(size) = size {
                OpenOptions::new().write(true).open(&path)?.set_len(size)?;
            }
            let found = fs::symlink_metadata(&path)?;
            Ok(self.attributes(&found, &path))
        });
        answer!(reply, set, |of| reply.attr(&TRUSTED, &of));
    }

    fn mkdir(&mut self, _: &Request<'_>, parent: u64, name: &OsStr, _: u32, _: u32, reply: ReplyEntry) {
        let made = self.path(parent).and_then(|path| fs::create_dir(path.join(name)));
        answer!(reply, made.and_then(|()| self.look(parent, name)), |of| reply.entry(&TRUSTED, &of, 0));
    }

    fn unlink(&mut self, _: &Request<'_>, parent: u64, name: &OsStr, reply: ReplyEmpty) {
        let gone = self.path(parent).and_then(|path| fs::remove_file(path.join(name)));
        answer!(reply, gone, |()| reply.ok());
    }

    fn rmdir(&mut self, _: &Request<'_>, parent: u64, name: &OsStr, reply: ReplyEmpty) {
        let gone = self.path(parent).and_then(|path| fs::remove_dir(path.join(name)));
        answer!(reply, gone, |()| reply.ok());
    }

    fn rename(
        &mut self,
        _: &Request<'_>,
        parent: u64,
        name: &OsStr,
        to_parent: u64,
        to_name: &OsStr,
        _: u32,
        reply: ReplyEmpty,
    ) {
        answer!(reply, self.moved((parent, name), (to_parent, to_name)), |()| reply.ok());
    }

    fn open(&mut self, _: &Request<'_>, ino: u64, flags: i32, reply: ReplyOpen) {
        // Pages that are kept would hide that a file was deleted.
        let write = flags & nix::libc::O_ACCMODE != nix::libc::O_RDONLY;
        let file = self.path(ino).and_then(|path| OpenOptions::new().read(true).write(write).open(path));
        answer!(reply, file, |file| reply.opened(self.keep(file), FOPEN_DIRECT_IO));
    }

    fn create(
        &mut self,
        _: &Request<'_>,
        parent: u64,
        name: &OsStr,
        mode: u32,
        _: u32,
        flags: i32,
        reply: ReplyCreate,
    ) {
        let made = self.path(parent).and_then(|path| {
            let mut options = OpenOptions::new();
            options.read(true).write(true).create(true).mode(mode).custom_flags(flags & nix::libc::O_EXCL);
            let file = options.open(path.join(name))?;
            Ok((self.look(parent, name)?, self.keep(file)))
        });
        answer!(reply, made, |(of, handle): (FileAttr, u64)| reply.created(&TRUSTED, &of, 0, handle, FOPEN_DIRECT_IO));
    }

    fn read(
        &mut self,
        _: &Request<'_>,
        _: u64,
        handle: u64,
        offset: i64,
        size: u32,
        _: i32,
        _: Option<u64>,
        reply: ReplyData,
    ) {
        let read = self.opened(handle).and_then(|file| {
            let (mut bytes, mut done) = (vec![0; size as usize], 0);
            while done < bytes.len() {
                let more = file.read_at(&mut bytes[done..], offset as u64 + done as u64)?;
                if more == 0 {
                    break;
                }
                done += more;
            }
            bytes.truncate(done);
            Ok(bytes)
        });
        answer!(reply, read, |bytes: Vec<u8>| reply.data(&bytes));
    }

    fn write(
        &mut self,
        _: &Request<'_>,
        _: u64,
        handle: u64,
        offset: i64,
        data: &[u8],
        _: u32,
        _: i32,
        _: Option<u64>,
        reply: ReplyWrite,
    ) {
        let written = self.opened(handle).and_then(|file| file.write_all_at(data, offset as u64));
        answer!(reply, written, |()| reply.written(data.len() as u32));
    }

    fn flush(&mut self, _: &Request<'_>, _: u64, _: u64, _: u64, reply: ReplyEmpty) {
        reply.ok();
    }

    fn release(&mut self, _: &Request<'_>, _: u64, handle: u64, _: i32, _: Option<u64>, _: bool, reply: ReplyEmpty) {
        self.open.remove(&handle);
        reply.ok();
    }

    fn fsync(&mut self, _: &Request<'_>, _: u64, handle: u64, _: bool, reply: ReplyEmpty) {
        answer!(reply, self.opened(handle).and_then(File::sync_all), |()| reply.ok());
    }

    fn fsyncdir(&mut self, _: &Request<'_>, _: u64, _: u64, _: bool, reply: ReplyEmpty) {
        reply.ok();
    }

    fn readdir(&mut self, _: &Request<'_>, ino: u64, _: u64, offset: i64, mut reply: ReplyDirectory) {
        let entries = self.list(ino);
        answer!(reply, entries, |entries: Entries| {
            for (n, (ino, kind, name)) in entries.iter().enumerate().skip(offset as usize) {
                if reply.add(*ino, n as i64 + 1, *kind, name) {
                    break;
                }
            }
            reply.ok();
        });
    }

    fn getlk(&mut self, _: &Request<'_>, _: u64, _: u64, _: u64, _: u64, _: u64, _: i32, _: u32, reply: ReplyLock) {
        reply.error(ENOLCK);
    }

    fn setlk(
        &mut self,
        _: &Request<'_>,
        _: u64,
        _: u64,
        _: u64,
        _: u64,
        _: u64,
        _: i32,
        _: u32,
        _: bool,
        reply: ReplyEmpty,
    ) {
        reply.error(ENOLCK);
    }
}
