//! A solver being trained: forward, backward, update, and the loss on other scenes. Knows no files and no engine.

use super::{
    batches::{Batch, DataSet},
    optimiser::{Optimised, Rates},
};
use crate::network::{
    Preset,
    features::Encoding,
    head::mean_square,
    unet::Unet,
    weights::Weights,
};
use burn::tensor::{Device, Tensor};
use tauflow_contract::KindError;

/// A network and its weights on their way.
pub(crate) struct Trainer {
    pub(crate) encoding: Encoding,
    pub(crate) network: Unet,
    pub(crate) state: Optimised,
    rates: Rates,
    device: Device,
}

impl Trainer {
    /// At the start.
    pub(crate) fn new(encoding: Encoding, preset: Preset, rates: Rates, seed: u64) -> Self {
        let network = encoding.network(preset);
        let state = Optimised::new(network.slots().draw(seed));
        Self { encoding, network, state, rates, device: Device::flex().autodiff() }
    }

    /// One step on a batch; returns its loss and the norm of the gradient.
    ///
    /// # Errors
    /// If the loss is no longer finite.
    pub(crate) fn step(&mut self, batch: &Batch) -> Result<(f64, f64), KindError> {
        let weights = self.network.slots().tensors(&self.state.weights, &self.device);
        let loss = self.loss(batch, &weights, &self.device);
        let mut gradients = loss.backward();
        let value = f64::from(loss.into_scalar::<f32>());
        if !value.is_finite() {
            return Err(KindError::Input(format!(
                "the loss is {value} at step {}; lower `learning_rate` or `clip`",
                self.state.step + 1
            )));
        }
        let mut gradient = self.state.weights.zeros();
        for (tensor, values) in weights.iter().zip(&mut gradient.0) {
            if let Some(found) = tensor.grad_remove(&mut gradients) {
                *values = numbers(found)?;
            }
        }
        let norm = self.state.update(&self.rates, &gradient);
        Ok((value, norm))
    }

    /// The learning rate of the next step.
    pub(crate) fn learning_rate(&self) -> f64 {
        self.rates.at(self.state.step)
    }

    /// The loss of the averaged weights over every scene and rung of a set.
    pub(crate) fn test(&self, set: &DataSet, side: usize, batch: usize) -> f64 {
        self.loss_of(&self.state.average, set.all(&self.encoding, side, batch))
    }

    fn loss_of(&self, weights: &Weights, batches: impl Iterator<Item = Batch>) -> f64 {
        let device = Device::flex();
        let weights = self.network.slots().tensors(weights, &device);
        let (mut total, mut count) = (0.0, 0);
        for batch in batches {
            let loss = f64::from(self.loss(&batch, &weights, &device).into_scalar::<f32>());
            total += loss * batch.targets.len() as f64;
            count += batch.targets.len();
        }
        total / count.max(1) as f64
    }

    fn loss(&self, batch: &Batch, weights: &[Tensor<2>], device: &Device) -> Tensor<1> {
        let inputs = self.encoding.inputs(device, &batch.samples(), batch.side, batch.side);
        mean_square(self.network.forward(weights, inputs), batch.targets.clone())
    }
}

fn numbers(tensor: Tensor<2>) -> Result<Vec<f32>, KindError> {
    tensor.into_data().try_into_vec::<f32>().map_err(|e| KindError::Internal(format!("a gradient that is not f32: {e:?}")))
}
