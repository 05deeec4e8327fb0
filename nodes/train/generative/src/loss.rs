//! Losses as operators of burn's graph. Their sums are taken in one order, so that a curve has the same bits
//! everywhere.

use burn::tensor::Tensor;
use std::sync::Arc;
use tauflow_ops::Operator;
use tauflow_tensors::apply_on_cpu;

/// What an error counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Rho {
    /// Its square.
    Squared,
    /// sqrt(e^2 + c^2) - c: squared below c, absolute beyond it (pseudo-Huber).
    PseudoHuber(f32),
}

impl Rho {
    fn value(self, e: f32) -> f64 {
        let e = f64::from(e);
        match self {
            Self::Squared => e * e,
            Self::PseudoHuber(c) => (e * e + f64::from(c) * f64::from(c)).sqrt() - f64::from(c),
        }
    }

    fn slope(self, e: f32) -> f32 {
        match self {
            Self::Squared => 2.0 * e,
            Self::PseudoHuber(c) => e / (e * e + c * c).sqrt(),
        }
    }
}

/// The sum over all numbers of rho(prediction - target) + lambda prediction^2, divided by `count`.
#[derive(Clone, Debug)]
struct MeanLoss {
    target: Arc<[f32]>,
    count: usize,
    rho: Rho,
    lambda: f32,
}

impl Operator<1> for MeanLoss {
    type Saved = ();

    fn forward(&self, [prediction]: [&[f32]; 1]) -> (Vec<f32>, ()) {
        let terms = prediction
            .iter()
            .zip(&self.target[..])
            .map(|(p, t)| self.rho.value(p - t) + f64::from(self.lambda) * f64::from(*p) * f64::from(*p));
        (vec![(terms.sum::<f64>() / self.count as f64) as f32], ())
    }

    fn backward(&self, [prediction]: [&[f32]; 1], (): &(), gradient: &[f32], _: [bool; 1]) -> [Vec<f32>; 1] {
        let share = gradient[0] / self.count as f32;
        let slope = |(p, t): (&f32, &f32)| share * (self.rho.slope(p - t) + 2.0 * self.lambda * p);
        [prediction.iter().zip(&self.target[..]).map(slope).collect()]
    }
}

/// A batch part's share in the mean loss of `count` numbers.
pub(crate) fn mean_loss(prediction: Tensor<4>, target: Arc<[f32]>, count: usize, rho: Rho, lambda: f32) -> Tensor<1> {
    assert_eq!(prediction.shape().num_elements(), target.len(), "a target for each number");
    apply_on_cpu(MeanLoss { target, count, rho, lambda }, [prediction.into()], [1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_and_their_slopes_are_what_they_say() {
        let loss = |rho, lambda| MeanLoss { target: vec![0.0, 1.0].into(), count: 4, rho, lambda };
        let squared = loss(Rho::Squared, 0.5);
        // (4 + 0.5 4 + 4 + 0.5 9)/4.
        assert_eq!(squared.forward([&[2.0, 3.0]]).0, [3.625]);
        let huber = loss(Rho::PseudoHuber(0.03), 0.01);
        for which in [squared, huber] {
            let at = [0.4f32, 0.98];
            let [found] = which.backward([&at], &(), &[1.0], [true]);
            for i in 0..2 {
                let value = |by: f32| {
                    let mut moved = at;
                    moved[i] += by;
                    f64::from(which.forward([&moved]).0[0])
                };
                let expected = (value(1e-2) - value(-1e-2)) / 2e-2;
                assert!((f64::from(found[i]) - expected).abs() < 0.02, "{which:?} {i}: {} {expected}", found[i]);
            }
        }
    }
}
