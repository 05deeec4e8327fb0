//! The network of the solvers: a U-Net on burn's autodiff graph, with the heavy operators of `tauflow-ops`; on devices
//! that are no CPU, with burn's.
//!
//! Knows images and times, nothing of data sets or of how it is trained.

pub(crate) mod features;
#[cfg(test)]
mod gradients;
pub(crate) mod head;
#[cfg(any(test, feature = "gpu"))]
mod on_device;
#[cfg(test)]
mod peer;
pub(crate) mod unet;

pub use features::Features;
pub use head::{Loss, Output};
pub use unet::Preset;
