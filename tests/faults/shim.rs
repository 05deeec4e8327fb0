//! A library that stands between a program and its disk: loaded before all others, it counts the calls that change files, and
//! at a chosen one kills the process, before it, in the middle of it or after it, or lets it and all later ones fail, or
//! it makes the clock jump. Compiled by the campaign itself.
//!
//! `SHIM_FAULT` is `before`, `half`, `after`, `full`, `read_only` or `clock`; `SHIM_AT` the number of the call, from 1.

use std::{
    ffi::{CStr, c_char, c_int, c_void},
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
    let (fault, at) = chosen();
    let now = CALLS.fetch_add(1, Ordering::SeqCst) + 1;
    match fault {
        Fault::Before if now == at => die(),
        Fault::Half | Fault::After if now == at => fault,
        Fault::Fails(_) if now >= at => fault,
        _ => Fault::None,
    }
}

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
            // SAFETY: the caller's promise is passed on.
            let done = unsafe { real($($arg),*) };
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
