//! Materials of one scene: colours that go together, library maps at their real size, and the surfaces of each regime.
//!
//! | regime | surfaces |
//! |---|---|
//! | L0 | diffuse ones alone, with normal maps |
//! | L1 | also coats, metals and principled surfaces with roughness maps; nothing lets light through |
//! | L2 | also frosted glass and thin panes |
//! | L3 | also smooth glass, mirrors and water |

mod glossy;
mod looks;
mod optics;
mod palette;
mod stored;
mod surface;
#[cfg(test)]
mod tests;

pub use palette::Palette;
pub use stored::put_bitmap;

use crate::Ranges;
use tauflow_contract::Context;
use tauflow_data::scene::Bsdf;

/// Makes materials of one scene.
pub struct Materials<'a, 'c> {
    /// Where textures go.
    pub ctx: &'a Context<'c>,
    /// The ranges.
    pub ranges: &'a Ranges,
    /// The colours.
    pub palette: Palette,
}

/// A surface that looks the same from its back, if light does not pass through it.
pub fn two_sided(inner: Bsdf) -> Bsdf {
    Bsdf::TwoSided { inner: Box::new(inner) }
}
