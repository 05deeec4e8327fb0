//! The operators of the head by burn's own operations: for devices that are no CPU. burn finds their gradients itself.

use super::head::{Answer, BRIGHTEST, Loss, MeanLoss, Shade};
use burn::tensor::{Tensor, activation::sigmoid};
use tauflow_tensors::{OnDevice, constant, flat};

impl OnDevice<2> for Shade {
    fn by_tensors(&self, [mean, shade]: [Tensor<1>; 2]) -> Tensor<1> {
        const { assert!(BRIGHTEST == 4.0, "its logarithm is 2 ln 2") };
        // The same factor without exponentials, whose squares would be too large in a gradient.
        let part = sigmoid(shade - 2.0 * core::f32::consts::LN_2);
        mean * (part * (BRIGHTEST - 1.0 / BRIGHTEST) + 1.0 / BRIGHTEST)
    }
}

impl OnDevice<1> for Answer {
    fn by_tensors(&self, [mean]: [Tensor<1>; 1]) -> Tensor<1> {
        let device = mean.device();
        let shape = [self.gain.len(), self.state.len() / self.gain.len().max(1)];
        let mut value = mean.reshape(shape);
        if let Some(albedo) = &self.albedo {
            value = value * constant(albedo, shape, &device);
        }
        if self.log {
            value = value.clone().sign() * value.abs().log1p();
        }
        let gain = constant(&self.gain, [shape[0], 1], &device);
        flat((value - constant(&self.state, shape, &device)) * gain)
    }
}

impl OnDevice<1> for MeanLoss {
    fn by_tensors(&self, [prediction]: [Tensor<1>; 1]) -> Tensor<1> {
        let device = prediction.device();
        let difference = prediction - constant(&self.target, [self.target.len()], &device);
        let losses = match self.loss {
            Loss::Squared => difference.square(),
            Loss::Absolute => difference.abs(),
        };
        losses.sum() / self.count as f64
    }
}

#[cfg(test)]
mod tests;
