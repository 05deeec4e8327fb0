//! How long the process keeps memory that it freed.

#![expect(unsafe_code, reason = "options of the allocator are set by a foreign function")]

use std::sync::Once;

/// Its number among mimalloc's options, in all of its versions so far; the test reads it back.
const PURGE_DELAY: libmimalloc_sys::mi_option_t = 15;

/// Milliseconds that freed memory stays with the process. A prediction of a network takes about a second, and frees
/// large tensors all along: after mimalloc's one second the kernel would take them, and clear the next ones.
const KEPT: std::ffi::c_long = 10_000;

/// Keeps freed memory for some seconds longer, if the process allocates by mimalloc. It has no effect otherwise.
pub fn keep() {
    static ONCE: Once = Once::new();
    // SAFETY: it stores a number in a table of the allocator, at any time and by any thread.
    ONCE.call_once(|| unsafe { libmimalloc_sys::mi_option_set(PURGE_DELAY, KEPT) });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mimalloc's default is a second (ten milliseconds in its second version): the number is still that option's.
    #[test]
    fn the_option_is_the_delay() {
        // SAFETY: as above.
        let before = unsafe { libmimalloc_sys::mi_option_get(PURGE_DELAY) };
        assert!([10, 1000, KEPT].contains(&before), "{before}");
        keep();
        // SAFETY: as above.
        assert_eq!(unsafe { libmimalloc_sys::mi_option_get(PURGE_DELAY) }, KEPT);
    }
}
