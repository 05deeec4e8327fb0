//! Which instructions kernels are made of: chosen once, by what the processor has, or fewer if `TAUFLOW_INSTRUCTIONS` says so.
//! The bits do not depend on it.

use std::sync::OnceLock;

/// Sets of instructions that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Instructions {
    /// Plain Rust: right everywhere, slow where products cannot be fused by one instruction.
    Portable,
    /// Eight lanes and fused products.
    Avx2,
    /// Sixteen lanes.
    Avx512,
}

impl Instructions {
    /// All that this processor has, from the narrowest.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut found = vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            found.push(Self::Avx2);
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
            {
                found.push(Self::Avx512);
            }
        }
        found
    }

    /// The widest that this processor has.
    pub(crate) fn most() -> Self {
        static MOST: OnceLock<Instructions> = OnceLock::new();
        *MOST.get_or_init(|| Self::available().into_iter().max().unwrap_or(Self::Portable))
    }

    /// The widest that this processor has, and that `TAUFLOW_INSTRUCTIONS` (`sse2`, for the portable ones, `avx2` or
    /// `avx512`) allows.
    pub fn best() -> Self {
        static BEST: OnceLock<Instructions> = OnceLock::new();
        *BEST.get_or_init(|| {
            let most = match std::env::var("TAUFLOW_INSTRUCTIONS").as_deref() {
                Ok("sse2") => Self::Portable,
                Ok("avx2") => Self::Avx2,
                // Whoever misspells it is told by the renderer, which heeds it too.
                _ => Self::Avx512,
            };
            Self::most().min(most)
        })
    }
}

/// Runs `f`, compiled for as many lanes as the machine has. Lanes change no bits: each holds another value, and Rust never
/// fuses a product and a sum by itself.
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
            Instructions::Portable => {}
        }
    }
    f()
}
