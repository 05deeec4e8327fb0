//! The network of the solvers: a U-Net on burn's autodiff graph, with heavy operators of its own.
//!
//! Knows images and times, nothing of data sets or of how it is trained.

mod conv;
pub(crate) mod features;
#[cfg(test)]
mod gradients;
pub(crate) mod head;
mod matrix;
mod norm;
mod op;
mod shuffle;
mod sums;
pub(crate) mod unet;
pub(crate) mod weights;

pub use unet::Preset;
