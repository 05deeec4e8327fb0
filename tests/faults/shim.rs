//! A library that stands between a program and its disk. Compiled by the campaign itself.
//!
//! It is loaded before all others, and counts the calls that change files. At a chosen one it kills the process: before
//! it, in the middle of it or after it. Or it lets it and all later ones fail, or it makes the clock jump.
//!
//! `SHIM_FAULT` is `before`, `half`, `after`, `full`, `read_only` or `clock`; `SHIM_AT` the number of the call, from 1.
//!
//! `SHIM_MIRROR` is a folder where it keeps, by inode, what was synced: contents of files, and names in folders. From
//! that the campaign makes what a power cut would leave: all else is undone, whichever process wrote it.

use std::{
    cell::Cell,
    ffi::{CStr, c_char, c_int, c_void},
    fmt::Write as _,
    fs,
    os::unix::fs::{DirEntryExt, MetadataExt},
    path::PathBuf,
    sync::{
        OnceLock,
        atomic::{AtomicU64, Ordering},
    },
};

unsafe extern "C" {
    fn dlsym(handle: *mut c_void, name: *const c_char) -> *mut c_void;
    fn __errno_location() -> *mut c_int;
    fn kill(pid: c_int, signal: c_int) -> c_int;
    fn getpid() -> c_int;
    fn getenv(name: *const c_char) -> *const c_char;
}

const NEXT: *mut c_void = -1isize as *mut c_void;
const ENOSPC: c_int = 28;
const EROFS: c_int = 30;
const SIGKILL: c_int = 9;
const O_CREAT: c_int = 0o100;

#[derive(Clone, Copy, PartialEq)]
enum Fault {
    None,
    Before,
    Half,
    After,
    Fails(c_int),
    Clock,
}

static CALLS: AtomicU64 = AtomicU64::new(0);

fn variable(name: &CStr) -> Option<&'static str> {
    // SAFETY: the name ends with a zero; nobody changes the environment of the child.
    let found = unsafe { getenv(name.as_ptr()) };
    // SAFETY: what `getenv` gives is null or a text that ends with a zero and stays.
    (!found.is_null()).then(|| unsafe { CStr::from_ptr(found) })?.to_str().ok()
}

fn chosen() -> (Fault, u64) {
    static CHOSEN: OnceLock<(Fault, u64)> = OnceLock::new();
    *CHOSEN.get_or_init(|| {
        let fault = match variable(c"SHIM_FAULT") {
            Some("before") => Fault::Before,
            Some("half") => Fault::Half,
            Some("after") => Fault::After,
            Some("full") => Fault::Fails(ENOSPC),
            Some("read_only") => Fault::Fails(EROFS),
            Some("clock") => Fault::Clock,
            _ => Fault::None,
        };
        (fault, variable(c"SHIM_AT").and_then(|at| at.parse().ok()).unwrap_or(u64::MAX))
    })
}

fn die() -> ! {
    // SAFETY: kills this process alone.
    unsafe { kill(getpid(), SIGKILL) };
    loop {
        std::hint::spin_loop();
    }
}

/// What happens to this call: nothing, an error, or death after half of it or all of it.
fn meet() -> Fault {
    if INSIDE.get() {
        return Fault::None;
    }
    let (fault, at) = chosen();
    let now = CALLS.fetch_add(1, Ordering::SeqCst) + 1;
    match fault {
        Fault::Before if now == at => die(),
        Fault::Half | Fault::After if now == at => fault,
        Fault::Fails(_) if now >= at => fault,
        _ => Fault::None,
    }
}

thread_local! {
    /// The mirror is being written: these calls are of this library.
    static INSIDE: Cell<bool> = const { Cell::new(false) };
}

/// Does something of this library's own, whose calls do not count.
fn within<T>(work: impl FnOnce() -> T) -> T {
    INSIDE.set(true);
    let done = work();
    INSIDE.set(false);
    done
}

fn mirror() -> Option<&'static str> {
    static MIRROR: OnceLock<Option<&'static str>> = OnceLock::new();
    *MIRROR.get_or_init(|| variable(c"SHIM_MIRROR"))
}

/// Before a sync: what it will make durable, in a file beside its place, and that place.
fn before_sync(fd: c_int) -> Option<(PathBuf, PathBuf)> {
    let mirror = mirror()?;
    within(|| {
        let path = fs::read_link(format!("/proc/self/fd/{fd}")).ok()?;
        let meta = fs::metadata(&path).ok()?;
        // SAFETY: it asks for a number.
        let process = unsafe { getpid() };
        let beside = PathBuf::from(format!("{mirror}/tmp{process}.{}", NEXT_COPY.fetch_add(1, Ordering::SeqCst)));
        if !meta.is_dir() {
            fs::write(&beside, fs::read(&path).ok()?).ok()?;
            return Some((beside, PathBuf::from(format!("{mirror}/f{}", meta.ino()))));
        }
        let mut names = String::new();
        for entry in fs::read_dir(&path).ok()? {
            let entry = entry.ok()?;
            let sort = if entry.file_type().ok()?.is_dir() { 'd' } else { 'f' };
            writeln!(names, "{sort}{} {}", entry.ino(), entry.file_name().to_str()?).ok()?;
        }
        fs::write(&beside, names).ok()?;
        Some((beside, PathBuf::from(format!("{mirror}/d{}", meta.ino()))))
    })
}

/// What is new has nothing of an earlier one that had its inode.
fn forget(sort: char, path: *const c_char) {
    let Some(mirror) = mirror() else { return };
    within(|| {
        // SAFETY: the caller of libc gave a text that ends with a zero.
        let path = unsafe { CStr::from_ptr(path) }.to_str().unwrap_or_default();
        if let Ok(meta) = fs::symlink_metadata(path)
            && (sort == 'd' || meta.len() == 0)
        {
            let _ = fs::remove_file(format!("{mirror}/{sort}{}", meta.ino()));
        }
    });
}

static NEXT_COPY: AtomicU64 = AtomicU64::new(0);

fn fail(error: c_int) -> c_int {
    // SAFETY: the address is this thread's own.
    unsafe { *__errno_location() = error };
    -1
}

macro_rules! real {
    ($name:literal, $type:ty) => {{
        static FOUND: OnceLock<usize> = OnceLock::new();
        // SAFETY: the name is that of a function of libc with this signature.
        let found = *FOUND.get_or_init(|| unsafe { dlsym(NEXT, $name.as_ptr()) } as usize);
        // SAFETY: as above.
        unsafe { std::mem::transmute::<usize, $type>(found) }
    }};
}

/// Calls that write bytes: half of them can be written.
macro_rules! writes {
    ($name:ident, $text:literal, ($($extra:ident: $type:ty),*)) => {
        /// # Safety
        /// As the function of libc of that name.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(fd: c_int, bytes: *const c_void, count: usize $(, $extra: $type)*) -> isize {
            type Real = unsafe extern "C" fn(c_int, *const c_void, usize $(, $type)*) -> isize;
            let real = real!($text, Real);
            if fd < 3 {
                // SAFETY: the caller's promise is passed on.
                return unsafe { real(fd, bytes, count $(, $extra)*) };
            }
            let fault = meet();
            if let Fault::Fails(error) = fault {
                return fail(error) as isize;
            }
            let count = if fault == Fault::Half { count / 2 } else { count };
            // SAFETY: the caller's promise is passed on; fewer bytes are fine.
            let done = unsafe { real(fd, bytes, count $(, $extra)*) };
            if fault != Fault::None { die() } else { done }
        }
    };
}

writes!(write, c"write", ());
writes!(pwrite64, c"pwrite64", (at: i64));
writes!(pwrite, c"pwrite", (at: i64));

macro_rules! first {
    ($first:ident $(, $more:ident)*) => {
        $first
    };
}

/// Calls without a middle. Those that only sync, or give room back, do not fail for want of room.
macro_rules! steps {
    ($($name:ident, $text:literal, $takes_room:literal, ($($arg:ident: $type:ty),*);)*) => { $(
        /// # Safety
        /// As the function of libc of that name.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name($($arg: $type),*) -> c_int {
            type Real = unsafe extern "C" fn($($type),*) -> c_int;
            let real = real!($text, Real);
            let fault = meet();
            if let Fault::Fails(error) = fault {
                if $takes_room || error != ENOSPC {
                    return fail(error);
                }
            }
            let syncs = $text.to_bytes().ends_with(b"sync");
            let synced = if syncs { before_sync(first!($($arg),*) as c_int) } else { None };
            // SAFETY: the caller's promise is passed on.
            let done = unsafe { real($($arg),*) };
            if let (Some((beside, place)), 0) = (synced, done) {
                let _ = within(|| fs::rename(beside, place));
            }
            if done == 0 && $text == c"mkdir" {
                forget('d', first!($($arg),*) as *const c_char);
            }
            if matches!(fault, Fault::Half | Fault::After) { die() } else { done }
        }
    )* };
}


steps! {
    fsync, c"fsync", false, (fd: c_int);
    fdatasync, c"fdatasync", false, (fd: c_int);
    rename, c"rename", false, (from: *const c_char, to: *const c_char);
    unlink, c"unlink", false, (path: *const c_char);
    mkdir, c"mkdir", true, (path: *const c_char, mode: u32);
    ftruncate64, c"ftruncate64", false, (fd: c_int, len: i64);
}

/// # Safety
/// As the function of libc of that name.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn open64(path: *const c_char, flags: c_int, mode: u32) -> c_int {
    type Real = unsafe extern "C" fn(*const c_char, c_int, u32) -> c_int;
    let real = real!(c"open64", Real);
    if flags & O_CREAT != 0 {
        match meet() {
            Fault::Fails(error) => return fail(error),
            Fault::None => {}
            _ => {
                // SAFETY: the caller's promise is passed on.
                unsafe { real(path, flags, mode) };
                die()
            }
        }
        // SAFETY: the caller's promise is passed on.
        let done = unsafe { real(path, flags, mode) };
        if done >= 0 && !INSIDE.get() {
            forget('f', path);
        }
        return done;
    }
    // SAFETY: the caller's promise is passed on.
    unsafe { real(path, flags, mode) }
}

/// # Safety
/// As the function of libc of that name.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn clock_gettime(clock: c_int, time: *mut [i64; 2]) -> c_int {
    type Real = unsafe extern "C" fn(c_int, *mut [i64; 2]) -> c_int;
    let real = real!(c"clock_gettime", Real);
    // SAFETY: the caller's promise is passed on.
    let done = unsafe { real(clock, time) };
    if clock == 0 && done == 0 && chosen().0 == Fault::Clock {
        // Every reading is years away from the one before, now later, now earlier.
        let n = CALLS.fetch_add(1, Ordering::SeqCst) as i64;
        // SAFETY: libc has just filled it.
        unsafe { (*time)[0] += (n * 7_919 % 41 - 20) * 31_536_000 };
    }
    done
}
