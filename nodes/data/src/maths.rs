//! Transcendental functions whose bits do not depend on the machine: `libm`'s, never the system's.
//!
//! `sqrt` and the four operations are exact by IEEE 754, and `mul_add` too; those of `std` are fine.

pub use libm::{
    acos, acosf, asin, asinf, atan, atan2, atan2f, atanf, cbrt, cos, cosf, erfc, exp, exp2, exp2f, expf, expm1f, log,
    log1p, log1pf, log2, log2f, log10, log10f, logf, pow, powf, sin, sinf, tan, tanf, tgamma,
};
