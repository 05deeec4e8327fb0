//! The loss curve while it is written.

use serde::{Deserialize, Serialize};
use tauflow_data::results::TrainingPoint;

/// How good averaged weights are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Score {
    /// Their loss on the test scenes.
    pub(crate) test: f64,
    /// Mean gain of one call over the first rung, on the first test scenes: dB of PSNR.
    pub(crate) gain: f64,
}

/// Points so far, and the sums since the last one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Record {
    /// The curve.
    pub(crate) points: Vec<TrainingPoint>,
    loss: f64,
    norm: f64,
    count: u64,
}

impl Record {
    /// Adds a step's loss and gradient norm.
    pub(crate) fn add(&mut self, loss: f64, norm: f64) {
        self.loss += loss;
        self.norm += norm;
        self.count += 1;
    }

    /// The last gain that was measured.
    pub(crate) fn gain(&self) -> Option<f64> {
        self.points.last().and_then(|point| point.gain)
    }

    /// Ends the running means in a point.
    pub(crate) fn point(&mut self, step: u64, score: Option<Score>, learning_rate: f64) {
        let mean = |sum: f64| (self.count > 0).then(|| sum / self.count as f64);
        let (train, gradient_norm) = (mean(self.loss), mean(self.norm));
        let (test, gain) = (score.map(|s| s.test), score.map(|s| s.gain));
        self.points.push(TrainingPoint { step, train, test, gain, learning_rate, gradient_norm });
        (self.loss, self.norm, self.count) = (0.0, 0.0, 0);
    }
}
