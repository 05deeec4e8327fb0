//! The library of procedural things: forms with their shapes, textures, materials and skies.
//!
//! Everything in it is a function of its name, its variant and the draws it is given. Knows no layout, no stratum's
//! context and no node kind.

pub mod forms;
pub mod materials;
mod memo;
pub mod noise;
mod ranges;
mod relief;
pub mod shapes;
pub mod skies;
pub mod stuff;
pub mod textures;

pub use memo::{Facts, Land, PartFacts, facts, land};
pub use ranges::{CausticRanges, DiffuseRanges, GlossyRanges, Range, Ranges, RefractiveRanges, variant_of_library};
pub use relief::Relief;
