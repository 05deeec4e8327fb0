//! The backbones: two published architectures on burn's tensors, with the heavy operators of `tauflow-ops`.
//!
//! Knows images, times and weights; nothing of files, samplers or how they are trained.

mod layers;
mod ncsnpp;
mod parameters;
mod unet2d;

pub use ncsnpp::{Ncsnpp, NcsnppConfig};
pub(crate) use parameters::slots;
pub use parameters::{Layout, Parameter, count};
pub use unet2d::{Unet2d, Unet2dConfig};

use burn::tensor::Tensor;

/// One of the architectures.
#[derive(Clone, Debug)]
pub enum Network {
    /// diffusers' U-Net, which predicts noise.
    Unet2d(Box<Unet2d>),
    /// NCSN++ of Rectified Flow, which predicts velocity.
    Ncsnpp(Box<Ncsnpp>),
}

impl Network {
    /// Its weights.
    pub fn parameters(&self) -> &[Parameter] {
        match self {
            Self::Unet2d(network) => network.parameters(),
            Self::Ncsnpp(network) => network.parameters(),
        }
    }

    /// Predictions for images [N, H, W, 3] at network times.
    pub(crate) fn forward(&self, weights: &[Tensor<2>], x: Tensor<4>, times: &[f64]) -> Tensor<4> {
        match self {
            Self::Unet2d(network) => network.forward(weights, x, times),
            Self::Ncsnpp(network) => network.forward(weights, x, times),
        }
    }
}

#[cfg(test)]
mod tests;
