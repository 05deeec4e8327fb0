//! Plain loops, compiled for as many lanes as the machine has.

pub use tauflow_instructions::Instructions;

/// Runs `f`, compiled for as many lanes as the machine has. Lanes change no bits: each holds another value, and Rust
/// never fuses a product and a sum by itself.
#[inline(always)]
pub(crate) fn wide<T>(f: impl FnOnce() -> T) -> T {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn eight<T>(f: impl FnOnce() -> T) -> T {
            f()
        }
        #[target_feature(enable = "avx2,avx512f,avx512dq,avx512bw,avx512vl")]
        fn sixteen<T>(f: impl FnOnce() -> T) -> T {
            f()
        }
        match Instructions::best() {
            // SAFETY: the machine has the instructions.
            Instructions::Avx512 => return unsafe { sixteen(f) },
            // SAFETY: the machine has the instructions.
            Instructions::Avx2 => return unsafe { eight(f) },
            Instructions::Sse2 | Instructions::Portable => {}
        }
    }
    f()
}
