//! Ways to make meshes: skins over rings, sweeps, lathes, extrusions, blocks, signed-distance bodies, cloth, branches.
//!
//! Knows no object in particular; [`super::forms`] names them. Metres, y up; uv in metres along the surface; closed
//! bodies face outwards. All of it works in f64 on [`Body`], which becomes a mesh once, at the end.

mod ball;
mod blocks;
mod body;
mod branch;
mod cloth;
mod curve;
mod extrude;
mod field;
mod glyphs;
mod skin;

pub use ball::{ball, faceted, icosphere};
pub use blocks::{block, board, panel, soft_block};
pub use body::Body;
pub use branch::{Branching, Growth, blade, leaf, small_leaf};
pub use cloth::Cloth;
pub use curve::{arc, circle, closed_spline, fillet, flat_spline, line, ring_path, spline};
pub use extrude::{extrude, extrude_with_holes, rounded_rect};
pub use field::{Field, capsule, cylinder_field, ellipsoid, smooth_min};
pub use glyphs::{lettering, text_width};
pub use skin::{beam, lathe, lathe_loop, rod, sheet, skin, slab, sweep, sweep_loop, tube, tube_loop, tube_rings};

/// Two pi.
pub const TAU: f64 = core::f64::consts::TAU;
/// Pi.
pub const PI: f64 = core::f64::consts::PI;

#[cfg(test)]
mod tests;
