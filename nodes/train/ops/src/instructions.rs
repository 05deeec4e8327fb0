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
        let most = Self::most();
        [Self::Portable, Self::Avx2, Self::Avx512].into_iter().filter(|one| *one <= most).collect()
    }

    /// The widest that this processor has.
    pub(crate) fn most() -> Self {
        static MOST: OnceLock<Instructions> = OnceLock::new();
        *MOST.get_or_init(|| {
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                let wide = is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512vl");
                return if wide { Self::Avx512 } else { Self::Avx2 };
            }
            Self::Portable
        })
    }

    /// The widest that this processor has, and that `TAUFLOW_INSTRUCTIONS` (`sse2`, for the portable ones, `avx2` or
    /// `avx512`) allows.
    pub fn best() -> Self {
        static BEST: OnceLock<Instructions> = OnceLock::new();
        *BEST.get_or_init(|| {
            let most = match std::env::var("TAUFLOW_INSTRUCTIONS").as_deref() {
                Ok("sse2") => Self::Portable,
                Ok("avx2") => Self::Avx2,
                Ok("avx512") | Err(_) => Self::Avx512,
                Ok(other) => {
                    eprintln!(
                        "TAUFLOW_INSTRUCTIONS is `{other}`, which is none of sse2, avx2 and avx512; trainings do not heed it"
                    );
                    Self::Avx512
                }
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
