//! The network of the solvers: a U-Net on burn's autodiff graph, with the heavy operators of `tauflow-ops`.
//!
//! Knows images and times, nothing of data sets or of how it is trained.

pub(crate) mod features;
#[cfg(test)]
mod gradients;
pub(crate) mod head;
mod layers;
mod op;
#[cfg(test)]
mod peer;
pub(crate) mod unet;
pub(crate) mod weights;

pub use head::Loss;
pub use unet::Preset;
