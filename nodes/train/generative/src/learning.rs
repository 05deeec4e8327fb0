//! What the trainings of this crate share: steps with a curve, checkpoints and a measured time.

use crate::trainer::{PARTS, Trainer};
use serde::Serialize;
use std::{ops::Range, time::Instant};
use tauflow_contract::{Context, KindError};
use tauflow_data::{
    records::{TrainingLog, TrainingPoint, TrainingTiming},
    timing::machine,
};
use tauflow_tensors::{Checkpoints, Share};

/// How long a training is and what it keeps.
pub(crate) struct Numbers {
    pub(crate) steps: u64,
    pub(crate) log_every: u64,
    /// Whether the last state serves a longer training.
    pub(crate) keep_last: bool,
    /// What its model will say of itself.
    pub(crate) note: String,
}

/// A training.
pub(crate) struct Learning<'a> {
    pub(crate) ctx: &'a Context<'a>,
    pub(crate) checkpoints: &'a Checkpoints,
    pub(crate) numbers: Numbers,
}

/// The examples of a batch in parts of its own, as even as they can be.
pub(crate) fn parts(batch: usize) -> impl Iterator<Item = Range<usize>> {
    let count = PARTS.min(batch);
    (0..count).map(move |part| part * batch / count..(part + 1) * batch / count)
}

impl Learning<'_> {
    /// Takes the steps that are left, from the latest checkpoint on.
    pub(crate) fn run(
        &self,
        trainer: &mut Trainer,
        share: &mut Share,
        step: impl Fn(&mut Trainer, u64) -> Result<(f64, f64), KindError> + Sync,
    ) -> Result<(Vec<TrainingPoint>, TrainingTiming), KindError> {
        let Numbers { steps, log_every, keep_last, note } = &self.numbers;
        let kept = self.checkpoints.latest(self.ctx, &trainer.slots, *steps);
        let mut curve = match kept {
            Some((state, curve)) => {
                trainer.state = state;
                curve
            }
            None => Default::default(),
        };
        if curve.points.is_empty() {
            curve.point(0, None, trainer.learning_rate());
        }
        let mut seconds = Vec::new();
        while trainer.state.step < *steps {
            self.ctx.check_cancelled()?;
            #[expect(clippy::disallowed_methods, reason = "`timing` is a measurement")]
            let start = Instant::now();
            let (rate, before) = (trainer.learning_rate(), trainer.state.step);
            let (loss, norm) = share.run(|| step(trainer, before))??;
            seconds.push(start.elapsed().as_secs_f64());
            curve.add(loss, norm);
            let done = before + 1;
            if done.is_multiple_of(*log_every) {
                curve.point(done, None, rate);
            }
            if self.checkpoints.due(done) && (done < *steps || *keep_last) {
                self.checkpoints.keep(self.ctx, &trainer.slots, &trainer.state, &curve, note.clone())?;
            }
            if done.is_multiple_of(10) || done == *steps {
                let recent = &seconds[seconds.len().saturating_sub(20)..];
                let rate = recent.len() as f64 / recent.iter().sum::<f64>().max(1e-9);
                self.ctx.progress(done, *steps, &format!("loss {loss:.4}  {rate:.1} steps/s"));
            }
        }
        // Not in the loop: a checkpoint must not depend on where its training ends.
        if curve.points.last().is_some_and(|point| point.step < *steps) {
            curve.point(*steps, None, trainer.rates.at(*steps - 1));
        }
        if !trainer.state.is_finite() {
            return Err(KindError::Input("weights are no longer finite; lower `learning_rate`".into()));
        }
        let total = seconds.iter().sum();
        seconds.sort_by(f64::total_cmp);
        let timing = TrainingTiming {
            steps: seconds.len() as u64,
            seconds: total,
            median_step_ms: 1000.0 * seconds.get(seconds.len() / 2).copied().unwrap_or(0.0),
            threads: share.most() as u64,
            machine: machine(),
        };
        Ok((curve.points, timing))
    }
}

/// What a training writes down: its sort, its network, its weights and steps, its params and its curve.
pub(crate) fn log<P: Serialize>(
    sort: &str,
    preset: &str,
    (weights, steps): (usize, u64),
    params: &P,
    points: Vec<TrainingPoint>,
) -> TrainingLog {
    let params = serde_json::to_value(params).expect("plain data");
    TrainingLog {
        parameterization: sort.into(),
        conditioning: "none".into(),
        space: "preview".into(),
        preset: preset.into(),
        weights: weights as u64,
        steps,
        params: params.as_object().cloned().unwrap_or_default(),
        points,
    }
}
