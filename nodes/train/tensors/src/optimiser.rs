//! Adam (Kingma and Ba 2015) with warm-up, a clip on the norm of the whole gradient, and an average of the weights.
//!
//! burn's own optimiser clips each tensor by itself and keeps no average; this one goes once over plain numbers, in
//! order.

use crate::weights::Weights;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_data::maths;
use tauflow_ops::Adam;

const EPSILON: f64 = 1e-8;

/// Decay of the learning rate after the warm-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Decay {
    /// It stays.
    #[default]
    None,
    /// Half a cosine, to a hundredth at the last step: for short runs.
    Cosine,
}

/// The rates of an optimiser.
#[derive(Clone, Copy, Debug)]
pub struct Rates {
    /// The learning rate after the warm-up.
    pub learning_rate: f64,
    /// Decay rates of the moments.
    pub betas: [f64; 2],
    /// Steps in which the rate rises.
    pub warmup: u64,
    /// Maximum norm of the gradient.
    pub clip: f64,
    /// Share that the average keeps.
    pub ema: f64,
    /// How the rate falls.
    pub decay: Decay,
    /// Steps in all.
    pub steps: u64,
    /// Share of the weights, times the rate, that each step takes away (AdamW, Loshchilov and Hutter 2019).
    pub weight_decay: f64,
}

impl Rates {
    /// The learning rate of a step, counted from 0.
    pub fn at(&self, step: u64) -> f64 {
        let rise = ((step + 1) as f64 / self.warmup.max(1) as f64).min(1.0);
        let fall = match self.decay {
            Decay::None => 1.0,
            Decay::Cosine => {
                let angle = core::f64::consts::PI * (step as f64 / self.steps.max(1) as f64).min(1.0);
                0.01 + 0.99 * 0.5 * (1.0 + maths::cos(angle))
            }
        };
        self.learning_rate * rise * fall
    }

    /// The share that the average keeps at a step: `ema` in the long run; early on it looks back a tenth of the way.
    fn keep(&self, step: u64) -> f64 {
        self.ema.min((step + 1) as f64 / (step + 10) as f64)
    }
}

/// Weights on their way.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimised {
    /// The weights themselves.
    pub weights: Weights,
    /// Their average: what a model is made of.
    pub average: Weights,
    /// First moments of the gradient.
    pub first: Weights,
    /// Second moments of the gradient.
    pub second: Weights,
    /// Steps done.
    pub step: u64,
}

impl Optimised {
    /// At the start.
    pub fn new(weights: Weights) -> Self {
        let (first, second) = (weights.zeros(), weights.zeros());
        Self { average: weights.clone(), weights, first, second, step: 0 }
    }

    /// Whether all weights and their averages are.
    pub fn is_finite(&self) -> bool {
        self.weights.norm().is_finite() && self.average.norm().is_finite()
    }

    /// One step along `gradient`, which has this norm.
    pub fn update(&mut self, rates: &Rates, gradient: &Weights, norm: f64) {
        let clip = if norm > rates.clip { (rates.clip / norm) as f32 } else { 1.0 };
        let [b1, b2] = rates.betas;
        let count = (self.step + 1) as f64;
        // lr m/(1 - b1^t) / (sqrt(v/(1 - b2^t)) + eps) with the corrections drawn together.
        let corrected = (1.0 - maths::pow(b2, count)).sqrt();
        let rate = (rates.at(self.step) * corrected / (1.0 - maths::pow(b1, count))) as f32;
        let epsilon = (EPSILON * corrected) as f32;
        let adam = Adam { clip, betas: rates.betas, rate, epsilon, keep: rates.keep(self.step) };
        if rates.weight_decay > 0.0 {
            let kept = (1.0 - rates.at(self.step) * rates.weight_decay) as f32;
            self.weights.0.iter_mut().flatten().for_each(|weight| *weight *= kept);
        }
        let matrices = self.weights.0.iter_mut().zip(&mut self.average.0).zip(&mut self.first.0);
        for ((((weights, average), first), second), gradient) in matrices.zip(&mut self.second.0).zip(&gradient.0) {
            adam.update(weights, average, [first, second], gradient);
        }
        self.step += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rates() -> Rates {
        Rates {
            learning_rate: 0.1,
            betas: [0.9, 0.999],
            warmup: 4,
            clip: 1.0,
            ema: 0.9,
            decay: Decay::None,
            steps: 100,
            weight_decay: 0.0,
        }
    }

    #[test]
    fn the_rate_rises_and_falls() {
        assert_eq!(rates().at(0), 0.025);
        assert_eq!(rates().at(3), 0.1);
        assert_eq!(rates().at(99), 0.1);
        let cosine = Rates { decay: Decay::Cosine, ..rates() };
        assert!((cosine.at(50) - 0.0505).abs() < 1e-9 && (cosine.at(100) - 0.001).abs() < 1e-12);
    }

    #[test]
    fn weights_decay_by_a_share_of_the_rate() {
        let mut state = Optimised::new(Weights(vec![vec![2.0]]));
        state.update(&Rates { weight_decay: 0.5, ..rates() }, &Weights(vec![vec![0.0]]), 0.0);
        assert!((state.weights.0[0][0] - 2.0 * (1.0 - 0.025 * 0.5)).abs() < 1e-6);
    }

    #[test]
    fn two_steps_by_hand() {
        let mut state = Optimised::new(Weights(vec![vec![1.0], vec![-2.0, 0.0]]));
        // The norm is 5: everything is divided by it, and Adam's first step is the rate times the sign.
        let gradient = Weights(vec![vec![3.0], vec![-4.0, 0.0]]);
        assert!((gradient.norm() - 5.0).abs() < 1e-6);
        state.update(&rates(), &gradient, 5.0);
        assert!((state.weights.0[0][0] - 0.975).abs() < 1e-6 && (state.weights.0[1][0] + 1.975).abs() < 1e-6);
        assert_eq!(state.weights.0[1][1], 0.0);
        assert!((state.first.0[0][0] - 0.06).abs() < 1e-6 && (state.second.0[0][0] - 3.6e-4).abs() < 1e-8);
        // The first average keeps a tenth.
        assert!((state.average.0[0][0] - 0.9775).abs() < 1e-6);
        // A gradient within the clip is left alone: m = .9 .06 + .1 .3, v = .999 3.6e-4 + .001 .09.
        state.update(&rates(), &Weights(vec![vec![0.3], vec![0.0, 0.0]]), 0.3);
        let (m, v) = (0.084 / (1.0 - 0.81), 4.4964e-4 / (1.0 - 0.998_001));
        let expected = 0.975 - 0.05 * m / f64::sqrt(v);
        assert!((f64::from(state.weights.0[0][0]) - expected).abs() < 1e-5, "{} {expected}", state.weights.0[0][0]);
        assert_eq!(state.step, 2);
    }
}
