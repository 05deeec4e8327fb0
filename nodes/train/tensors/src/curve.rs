//! The loss curve while it is written.

use serde::{Deserialize, Serialize};
use tauflow_data::{curve::Standing, records::TrainingPoint};

/// Points of a curve before it is told what it does.
const TELLING: usize = 4;

/// How good averaged weights are.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    /// Their loss on the test scenes.
    pub test: f64,
    /// Mean gain of one call over the first rung, on the first test scenes: dB of PSNR.
    pub gain: f64,
}

/// Points so far, and the sums since the last one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// The curve.
    pub points: Vec<TrainingPoint>,
    loss: f64,
    norm: f64,
    count: u64,
}

impl Curve {
    /// Adds a step's loss and gradient norm.
    pub fn add(&mut self, loss: f64, norm: f64) {
        self.loss += loss;
        self.norm += norm;
        self.count += 1;
    }

    /// The last gain that was measured.
    pub fn gain(&self) -> Option<f64> {
        self.points.last().and_then(|point| point.gain)
    }

    /// What the loss on the test scenes did last, unless it falls as it should or there is too little of it to tell.
    pub fn standing(&self) -> String {
        let standing = Standing::of(&self.points).filter(|_| self.points.len() > TELLING);
        standing
            .filter(|standing| *standing != Standing::Falls)
            .map(|standing| format!(" ({standing})"))
            .unwrap_or_default()
    }

    /// Ends the running means in a point.
    pub fn point(&mut self, step: u64, score: Option<Score>, learning_rate: f64) {
        let mean = |sum: f64| (self.count > 0).then(|| sum / self.count as f64);
        let (train, gradient_norm) = (mean(self.loss), mean(self.norm));
        let (test, gain) = (score.map(|s| s.test), score.map(|s| s.gain));
        self.points.push(TrainingPoint { step, train, test, gain, learning_rate, gradient_norm });
        (self.loss, self.norm, self.count) = (0.0, 0.0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_told_of_once_there_is_enough_of_it_and_it_does_not_fall() {
        let told = |tests: &[f64]| {
            let mut curve = Curve::default();
            for (i, test) in tests.iter().enumerate() {
                curve.point(i as u64 * 100, Some(Score { test: *test, gain: 0.0 }), 1e-3);
            }
            curve.standing()
        };
        assert_eq!(told(&[1.0, 0.4, 0.4, 0.4]), "");
        assert_eq!(told(&[1.0, 0.4, 0.4, 0.4, 0.4]), " (settled)");
        assert_eq!(told(&[1.0, 0.9, 0.8, 0.7, 0.6]), "");
        assert_eq!(told(&[1.0, 0.4, 0.9, 0.9, 0.9]), " (rises since step 100)");
    }
}
