//! A solver being trained: forward, backward, update, and the loss on other scenes. Knows no files and no engine.

use super::{
    batches::{Batch, DataSet},
    divergence,
};
use crate::{
    device::Place,
    network::{Loss, features::Encoding, loss::mean_loss, unet::Unet},
};
use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use tauflow_contract::KindError;
use tauflow_ops::Convolutions;
use tauflow_tensors::{Optimised, Rates, Weights};

/// Parts of a batch, at most, on a CPU; a device is filled by one.
const PARTS: usize = 2;

/// A network and its weights on their way.
pub(crate) struct Trainer {
    pub(crate) encoding: Encoding,
    pub(crate) network: Unet,
    pub(crate) state: Optimised,
    /// The norm of the first weights.
    first: f64,
    rates: Rates,
    loss: Loss,
    pub(crate) convolutions: Convolutions,
    device: Device,
    parts: usize,
}

impl Trainer {
    /// At the start, with the given weights, or with random ones of a seed.
    pub(crate) fn new(
        encoding: Encoding,
        rates: Rates,
        (loss, convolutions): (Loss, Convolutions),
        (seed, start): (u64, Option<Weights>),
        place: &Place,
    ) -> Self {
        let network = encoding.network();
        let state = Optimised::new(start.unwrap_or_else(|| network.slots().draw(seed)));
        let first = state.weights.norm();
        let parts = if place.adapter().is_none() { PARTS } else { 1 };
        let device = place.device().clone().autodiff();
        Self { encoding, network, state, first, rates, loss, convolutions, device, parts }
    }

    /// One step on a batch; returns its loss and the norm of the gradient.
    ///
    /// Its parts go through networks of their own, side by side where there are threads, and their gradients are added
    /// in order: parts, not threads, decide the bits.
    ///
    /// # Errors
    /// If it diverges.
    pub(crate) fn step(&mut self, batch: &Batch) -> Result<(f64, f64), KindError> {
        let weights = self.network.slots().tensors(&self.state.weights, &self.device);
        let count = batch.targets.len();
        let parts = batch.parts(self.parts);
        let found: Vec<(f64, Vec<Vec<f32>>)> =
            parts.par_iter().map(|part| self.part(part, &weights, count)).collect::<Result<_, _>>()?;
        let value = found.iter().map(|(loss, _)| loss).sum::<f64>();
        let (step, rate) = (self.state.step + 1, self.learning_rate());
        divergence::loss(step, rate, value, batch.targets.iter().fold(0.0, |most, target| most.max(target.abs())))?;
        let gradient = found.into_iter().map(|(_, gradient)| gradient).reduce(|mut sum, part| {
            sum.par_iter_mut().zip(&part).for_each(|(sum, part)| sum.iter_mut().zip(part).for_each(|(s, p)| *s += p));
            sum
        });
        let gradient = Weights(gradient.ok_or_else(|| KindError::Internal("a batch without examples".into()))?);
        let norm = gradient.norm();
        divergence::gradient(step, rate, value, norm, self.rates.clip)?;
        self.state.update(&self.rates, &gradient, norm);
        divergence::weights(step, self.state.weights.norm(), self.first, rate)?;
        Ok((value, norm))
    }

    /// A part's share in the loss of `count` numbers, and its gradients.
    fn part(&self, part: &Batch, weights: &[Tensor<2>], count: usize) -> Result<(f64, Vec<Vec<f32>>), KindError> {
        // The same numbers at the start of a graph of its own.
        let weights: Vec<Tensor<2>> = weights.iter().map(|weight| weight.clone().detach().require_grad()).collect();
        let loss = self.loss(part, &weights, &self.device, count);
        let mut gradients = loss.backward();
        let value = f64::from(loss.into_scalar::<f32>());
        let found = weights.iter().map(|weight| match weight.grad_remove(&mut gradients) {
            Some(gradient) => numbers(gradient),
            None => Err(KindError::Internal("a weight that the network does not use".into())),
        });
        Ok((value, found.collect::<Result<_, _>>()?))
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
        let device = self.device.clone().inner();
        let weights = self.network.slots().tensors(weights, &device);
        let (mut total, mut count) = (0.0, 0);
        for batch in batches {
            let loss = self.loss(&batch, &weights, &device, batch.targets.len());
            let loss = f64::from(loss.into_scalar::<f32>());
            total += loss * batch.targets.len() as f64;
            count += batch.targets.len();
        }
        total / count.max(1) as f64
    }

    fn loss(&self, batch: &Batch, weights: &[Tensor<2>], device: &Device, count: usize) -> Tensor<1> {
        let inputs = self.encoding.inputs(device, &batch.samples(), batch.side, batch.side);
        let shown = self.loss.of_images().then(|| batch.shown());
        mean_loss(
            self.network.forward(weights, inputs, self.convolutions),
            (batch.targets.clone(), shown),
            count,
            self.loss,
        )
    }
}

fn numbers(tensor: Tensor<2>) -> Result<Vec<f32>, KindError> {
    tensor
        .into_data()
        .try_into_vec::<f32>()
        .map_err(|e| KindError::Internal(format!("a gradient that is not f32: {e:?}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        law::{Factors, Law},
        network::{Features, Output, Preset},
        space::Space,
        training::{Decay, batches::Draw},
    };
    use tauflow_data::{
        Image,
        methods::{Conditioning, Parameterization},
        records::PackedScene,
        rng::Stream,
    };

    /// Scenes of noise around a ramp; the rungs get nearer to it.
    fn scenes(count: usize, side: usize) -> DataSet {
        let counts = [1u64, 4, 16];
        let scenes = (0..count).map(|scene| {
            let states = counts.iter().enumerate().map(|(rung, n)| {
                let mut stream = Stream::new(scene as u64, &[rung as u64]);
                let ramp = |i: usize| (i / 3 % side) as f64 / side as f64;
                let noise = 1.0 / (*n as f64).sqrt();
                let data = (0..side * side * 3).map(|i| (ramp(i) + noise * stream.uniform()) as f32).collect();
                Image::from_data(side, side, 3, data).expect("fits")
            });
            let gbuffer = Some(Image::new(side, side, 6));
            (
                "scene",
                PackedScene { counts: counts.to_vec(), states: states.collect(), gbuffer, sampler: Default::default() },
            )
        });
        DataSet::new(scenes.collect(), "train", Conditioning::Gbuffer).expect("consistent")
    }

    fn encoding(parameterization: Parameterization) -> Encoding {
        let factors = Factors::new(parameterization, &[1, 4, 16], Law::Covariances).expect("a ladder");
        let (space, features, output, preset) = (Space::Linear, Features::Contrast, Output::Means, Preset::Tiny);
        Encoding { factors, space, gbuffer: true, features, output, preset }
    }

    fn rates() -> Rates {
        let (decay, betas) = (Decay::None, [0.9, 0.999]);
        Rates { learning_rate: 2e-3, betas, warmup: 5, clip: 1.0, ema: 0.999, decay, steps: 150, weight_decay: 0.0 }
    }

    fn fresh(parameterization: Parameterization, seed: u64) -> Trainer {
        let judged = (Loss::Squared, Convolutions::Minimal);
        Trainer::new(encoding(parameterization), rates(), judged, (seed, None), &Place::cpu())
    }

    #[test]
    fn parts_of_a_batch_add_up_to_its_gradient() {
        let trainer = fresh(Parameterization::McVelocity, 3);
        let mut weights = trainer.state.weights.clone();
        // Nothing may be zero, or gradients behind it would be.
        weights.0.iter_mut().enumerate().for_each(|(i, matrix)| {
            let mut stream = Stream::new(9, &[i as u64]);
            matrix.iter_mut().filter(|w| **w == 0.0).for_each(|w| *w = stream.range(-0.05, 0.05) as f32);
        });
        for batch in [1, 2, 5] {
            let draw = Draw { seed: 5, batch, side: 16, ..Draw::PLAIN };
            let batch = scenes(3, 16).draw(&trainer.encoding, &draw, 0);
            let tensors = trainer.network.slots().tensors(&weights, &trainer.device);
            let count = batch.targets.len();
            let whole = trainer.part(&batch, &tensors, count).expect("finite");
            let parts = batch.parts(PARTS);
            assert_eq!(parts.len(), PARTS.min(draw.batch));
            let parts: Vec<_> = parts.iter().map(|part| trainer.part(part, &tensors, count).expect("finite")).collect();
            assert!((parts.iter().map(|(loss, _)| loss).sum::<f64>() - whole.0).abs() < 1e-6 * whole.0);
            for (slot, expected) in whole.1.iter().enumerate() {
                let largest = expected.iter().fold(0.0f32, |m, g| m.max(g.abs()));
                for (at, expected) in expected.iter().enumerate() {
                    let found: f32 = parts.iter().map(|(_, gradients)| gradients[slot][at]).sum();
                    assert!((found - expected).abs() <= 1e-4 * largest, "{slot} {at}: {found} {expected}");
                }
            }
        }
    }

    #[test]
    fn a_loss_beyond_all_numbers_is_told_and_changes_nothing() {
        let mut trainer = fresh(Parameterization::McNoise, 3);
        let before = trainer.state.clone();
        let mut batch = scenes(2, 16).all(&trainer.encoding, 16, 2).next().expect("scenes");
        batch.targets = vec![1e30; batch.targets.len()].into();
        let told = trainer.step(&batch).expect_err("1e60 is no f32").to_string();
        assert!(told.contains("the loss is inf at step 1") && told.contains("lower `learning_rate`"), "{told}");
        assert!(trainer.state == before);
    }

    #[test]
    fn one_batch_is_learned() {
        for parameterization in Parameterization::ALL {
            let mut trainer = fresh(parameterization, 3);
            let draw = Draw { seed: 5, batch: 2, side: 16, ..Draw::PLAIN };
            let batch = scenes(2, 16).draw(&trainer.encoding, &draw, 0);
            let first = trainer.step(&batch).expect("finite").0;
            let mut last = first;
            for _ in 0..149 {
                last = trainer.step(&batch).expect("finite").0;
            }
            println!("{parameterization:?}: {first:.4} -> {last:.5}");
            // Outputs are means of inputs: pure noise cannot be memorised.
            assert!(last < 0.5 * first, "{parameterization:?}: {first} {last}");
        }
    }

    #[test]
    fn a_fresh_network_averages_and_its_loss_is_that_of_any_batches() {
        let set = scenes(3, 16);
        let trainer = fresh(Parameterization::McNoise, 1);
        let targets: Vec<f32> =
            set.all(&trainer.encoding, 16, 4).flat_map(|b| b.targets.iter().copied().collect::<Vec<_>>()).collect();
        assert_eq!(targets.len(), 3 * 2 * 16 * 16 * 3);
        let square = targets.iter().map(|t| f64::from(*t).powi(2)).sum::<f64>() / targets.len() as f64;
        let found = trainer.test(&set, 16, 4);
        assert!((found - trainer.test(&set, 16, 1)).abs() < 1e-6 * square);
        assert!(found < 0.7 * square, "{found} {square}");
    }
}
