//! Weights being trained: forward, backward, update. Knows neither what they predict nor where batches come from.

use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use tauflow_contract::KindError;
use tauflow_tensors::{Optimised, Rates, Slots, Weights};

/// Parts of a batch, at most: parts, not threads, decide the bits.
pub(crate) const PARTS: usize = 2;

/// Largest norm of a gradient whose square is a number in single precision.
const STEEPEST: f64 = 1.8e19;

/// A part's share of the loss, and the gradient of each weight that it uses.
type Share = (f64, Vec<Option<Vec<f32>>>);

/// Weights on their way.
pub(crate) struct Trainer {
    pub(crate) slots: Slots,
    pub(crate) state: Optimised,
    pub(crate) rates: Rates,
}

impl Trainer {
    pub(crate) fn new(slots: Slots, start: Weights, rates: Rates) -> Self {
        Self { slots, state: Optimised::new(start), rates }
    }

    /// The learning rate of the next step.
    pub(crate) fn learning_rate(&self) -> f64 {
        self.rates.at(self.state.step)
    }

    /// One step on the parts of a batch, of which each gives its share of the loss; returns the loss and the norm of
    /// the gradient. Weights that no part uses stay as they are.
    ///
    /// # Errors
    /// If it diverges.
    pub(crate) fn step<P: Sync>(
        &mut self,
        parts: &[P],
        loss: impl Fn(&P, &[Tensor<2>]) -> Result<Tensor<1>, KindError> + Sync,
    ) -> Result<(f64, f64), KindError> {
        let device = Device::flex().autodiff();
        let weights = self.slots.tensors(&self.state.weights, &device);
        let part = |part: &P| -> Result<Share, KindError> {
            // The same numbers at the start of a graph of its own.
            let weights: Vec<Tensor<2>> = weights.iter().map(|w| w.clone().detach().require_grad()).collect();
            let loss = loss(part, &weights)?;
            let mut gradients = loss.backward();
            let value = f64::from(loss.into_scalar::<f32>());
            let numbers = |tensor: Tensor<2>| {
                let bad = |e| KindError::Internal(format!("a gradient that is not f32: {e:?}"));
                tensor.into_data().try_into_vec::<f32>().map_err(bad)
            };
            let found = weights.iter().map(|weight| weight.grad_remove(&mut gradients).map(numbers).transpose());
            Ok((value, found.collect::<Result<_, _>>()?))
        };
        let found: Vec<_> = parts.par_iter().map(part).collect::<Result<_, _>>()?;
        let value: f64 = found.iter().map(|(loss, _)| loss).sum();
        let mut gradient = self.state.weights.zeros();
        for (_, part) in &found {
            for (sum, part) in gradient.0.iter_mut().zip(part) {
                if let Some(part) = part {
                    sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
                }
            }
        }
        let norm = gradient.norm();
        if !value.is_finite() || !norm.is_finite() || norm.min(self.rates.clip) > STEEPEST {
            return Err(KindError::Input(format!(
                "the loss is {value} and the norm of its gradient {norm:.1e} at step {}, at a learning rate of {:.1e}; \
                 lower `learning_rate`",
                self.state.step + 1,
                self.learning_rate()
            )));
        }
        self.state.update(&self.rates, &gradient, norm);
        Ok((value, norm))
    }
}
