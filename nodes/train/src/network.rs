//! The network of the solvers: a U-Net on burn's autodiff graph, with the heavy operators of `tauflow-ops`; on devices
//! that are no CPU, with burn's.
//!
//! Knows images and times, nothing of data sets or of how it is trained.

pub(crate) mod features;
#[cfg(test)]
mod gradients;
pub(crate) mod head;
pub(crate) mod loss;
#[cfg(any(test, feature = "gpu"))]
mod on_device;
#[cfg(test)]
mod peer;
mod structure;
pub(crate) mod unet;

pub use features::Features;
pub use head::Output;
pub use loss::Loss;
pub use unet::Preset;
