//! Which vector instructions kernels may be made of: what this processor has, or fewer if [`VARIABLE`] says so.
//!
//! The renderer and the operators of networks compile their kernels for each level, and choose among them here.
//! No bit of a result depends on the level, so that it is in no key but those of measurements.
//! Knows no kernel.
//!
//! A level stands for all that either of the two takes. The table says which of them takes what, and
//! `#[target_feature]` of a kernel names nothing else:
//!
//! | level | renderer | operators |
//! |---|---|---|
//! | [`Avx2`](Instructions::Avx2) | `avx2`, `bmi1`, `bmi2`, `lzcnt`, `popcnt` | `avx2`, `fma` |
//! | [`Avx512`](Instructions::Avx512) | these, `avx512f`, `avx512dq`, `avx512bw`, `avx512vl` | the same, and theirs |

use std::{io::Write, sync::OnceLock};

/// Environment variable that allows fewer instructions than the processor has.
pub const VARIABLE: &str = "TAUFLOW_INSTRUCTIONS";

/// Sets of instructions that kernels are compiled for, from the narrowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Instructions {
    /// Plain Rust, one number at a time: for processors other than x86-64, and to hold the others to.
    Portable,
    /// Four lanes; any x86-64 processor.
    Sse2,
    /// Eight lanes, and for operators fused products.
    Avx2,
    /// Sixteen lanes.
    Avx512,
}

/// A value of [`VARIABLE`] that names no level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownInstructions(String);

impl std::fmt::Display for UnknownInstructions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{VARIABLE} is `{}`, which is none of sse2, avx2 and avx512; set one of these or none", self.0)
    }
}

impl std::error::Error for UnknownInstructions {}

impl Instructions {
    /// All of them, from the narrowest.
    pub const ALL: [Self; 4] = [Self::Portable, Self::Sse2, Self::Avx2, Self::Avx512];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Sse2 => "sse2",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The level that a value of [`VARIABLE`] names: `sse2`, `avx2` or `avx512`.
    ///
    /// # Errors
    /// If it names none.
    pub fn named(name: &str) -> Result<Self, UnknownInstructions> {
        let found = Self::ALL.into_iter().filter(|one| *one != Self::Portable).find(|one| one.name() == name);
        found.ok_or_else(|| UnknownInstructions(name.to_owned()))
    }

    /// The widest that this processor has.
    pub fn most() -> Self {
        static MOST: OnceLock<Instructions> = OnceLock::new();
        *MOST.get_or_init(detect)
    }

    /// All that this processor has, from the narrowest.
    pub fn available() -> Vec<Self> {
        Self::ALL.into_iter().filter(|one| *one <= Self::most()).collect()
    }

    /// The widest that [`VARIABLE`] allows; none if it is not set.
    ///
    /// # Errors
    /// If it names no level.
    pub fn asked() -> Result<Option<Self>, UnknownInstructions> {
        std::env::var_os(VARIABLE).map(|name| Self::named(&name.to_string_lossy())).transpose()
    }

    /// The widest that this processor has and that [`VARIABLE`] allows. A value that names no level is told of once,
    /// and allows all.
    pub fn best() -> Self {
        static BEST: OnceLock<Instructions> = OnceLock::new();
        *BEST.get_or_init(|| {
            let asked = Self::asked().unwrap_or_else(|unknown| {
                // `eprintln!` would panic if nobody reads stderr any more.
                let _ = writeln!(std::io::stderr(), "{unknown}; it is not heeded");
                None
            });
            Self::most().min(asked.unwrap_or(Self::Avx512))
        })
    }
}

#[cfg(target_arch = "x86_64")]
fn detect() -> Instructions {
    let eight = is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("fma")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt");
    let sixteen = is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512vl");
    match (eight, sixteen) {
        (true, true) => Instructions::Avx512,
        (true, false) => Instructions::Avx2,
        (false, _) => Instructions::Sse2,
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn detect() -> Instructions {
    Instructions::Portable
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_found_by_their_names_and_others_are_told_of() {
        for one in Instructions::ALL.into_iter().skip(1) {
            assert_eq!(Instructions::named(one.name()), Ok(one));
        }
        for wrong in ["portable", "avx", "AVX2", ""] {
            let told = Instructions::named(wrong).expect_err("no level that can be asked for").to_string();
            assert!(told.contains(&format!("`{wrong}`")) && told.contains("sse2, avx2 and avx512"), "{told}");
        }
    }

    #[test]
    fn a_processor_has_all_up_to_the_widest() {
        let all = Instructions::available();
        assert_eq!(all, Instructions::ALL[..all.len()]);
        assert_eq!(all.last(), Some(&Instructions::most()));
        assert!(Instructions::best() <= Instructions::most());
        assert_eq!(cfg!(target_arch = "x86_64"), Instructions::most() >= Instructions::Sse2);
    }
}
