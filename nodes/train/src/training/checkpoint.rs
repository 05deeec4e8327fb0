//! Checkpoints: everything that the rest of a training depends on, as one blob; a run that resumes ends with the same
//! bits as one that was never stopped.

use super::{curve::Curve, optimiser::Optimised, trainer::Trainer};
use crate::model::ModelInfo;
use serde_json::json;
use tauflow_contract::{Artifact, Basis, Context, Digest, KindError, MemoKey};
use tauflow_data::TensorFile;

const MEDIA: &str = "tauflow/training-checkpoint";
/// Raised with every change of what a checkpoint holds.
const LAYOUT: u32 = 2;

/// Where the checkpoints of one training are kept.
pub(crate) struct Checkpoints {
    /// Together with the inputs, this determines the weights after a number of steps.
    pub(crate) basis: Basis,
    pub(crate) inputs: Vec<Digest>,
    /// The metadata of its model.
    pub(crate) info: ModelInfo,
    /// Steps between two.
    pub(crate) every: u64,
}

impl Checkpoints {
    fn key(&self, step: u64) -> MemoKey {
        let params = json!({ "training": self.basis.params, "step": step, "layout": LAYOUT });
        MemoKey { basis: self.basis.with(params, self.basis.seed), inputs: self.inputs.clone() }
    }

    /// True if there is one to be kept at this step.
    pub(crate) fn due(&self, step: u64) -> bool {
        step.is_multiple_of(self.every)
    }

    /// The latest step up to `step` at which one was due; 0 for none.
    pub(crate) fn last_due(&self, step: u64) -> u64 {
        step / self.every * self.every
    }

    /// Keeps where a training stands.
    pub(crate) fn keep(&self, ctx: &Context<'_>, trainer: &Trainer, curve: &Curve) -> Result<(), KindError> {
        let state = &trainer.state;
        let slots = trainer.network.slots();
        // Of the step: trainings of more steps may share it.
        let info = ModelInfo { steps: state.step, ..self.info.clone() };
        let mut file = TensorFile::default()
            .note("model", serde_json::to_string(&info).expect("plain data"))
            .note("record", serde_json::to_string(curve).expect("plain data"))
            .note("step", state.step.to_string());
        for (prefix, weights) in [
            ("weights.", &state.weights),
            ("average.", &state.average),
            ("first.", &state.first),
            ("second.", &state.second),
        ] {
            file = slots.write(file, prefix, weights);
        }
        let digest = ctx.put(&file.to_bytes()?)?;
        ctx.memo_put(&self.key(state.step), &Artifact::blob(MEDIA, digest))
    }

    /// The latest one at or before `steps`, if there is any.
    pub(crate) fn latest(&self, ctx: &Context<'_>, trainer: &mut Trainer, steps: u64) -> Option<Curve> {
        (1..=steps / self.every).rev().find_map(|i| {
            let artifact = ctx.memo_get(&self.key(i * self.every))?;
            // A checkpoint that cannot be read is as good as none: the training takes an earlier one.
            let (state, curve) = read(&ctx.part(&artifact, "").ok()?, trainer).ok()?;
            trainer.state = state;
            Some(curve)
        })
    }
}

fn read(bytes: &[u8], trainer: &Trainer) -> Result<(Optimised, Curve), KindError> {
    let file = TensorFile::from_bytes(bytes)?;
    let slots = trainer.network.slots();
    let note = |name: &str| {
        let missing = || KindError::Input(format!("a checkpoint without the note `{name}`"));
        file.metadata.get(name).map(String::as_str).ok_or_else(missing)
    };
    let broken = |e: &dyn std::fmt::Display| KindError::Input(format!("a damaged checkpoint: {e}"));
    let state = Optimised {
        weights: slots.read(&file, "weights.")?,
        average: slots.read(&file, "average.")?,
        first: slots.read(&file, "first.")?,
        second: slots.read(&file, "second.")?,
        step: note("step")?.parse().map_err(|e| broken(&e))?,
    };
    Ok((state, serde_json::from_str(note("record")?).map_err(|e| broken(&e))?))
}
