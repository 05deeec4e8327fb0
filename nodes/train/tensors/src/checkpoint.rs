//! Checkpoints: everything that the rest of a training depends on, as one blob; a run that resumes ends with the same
//! bits as one that was never stopped.

use crate::{curve::Curve, optimiser::Optimised, weights::Slots};
use serde_json::json;
use tauflow_contract::{Artifact, Basis, Context, Digest, KindError, MemoKey};
use tauflow_data::TensorFile;

const MEDIA: &str = "tauflow/training-checkpoint";
/// Raised with every change of what a checkpoint holds.
const LAYOUT: u32 = 2;

/// Where the checkpoints of one training are kept.
pub struct Checkpoints {
    /// With the inputs, all that decides the weights after a number of steps.
    pub basis: Basis,
    /// What the training reads.
    pub inputs: Vec<Digest>,
    /// Steps between two.
    pub every: u64,
}

impl Checkpoints {
    fn key(&self, step: u64) -> MemoKey {
        let params = json!({ "training": self.basis.params, "step": step, "layout": LAYOUT });
        MemoKey { basis: self.basis.with(params, self.basis.seed), inputs: self.inputs.clone() }
    }

    /// True if there is one to be kept at this step.
    pub fn due(&self, step: u64) -> bool {
        step.is_multiple_of(self.every)
    }

    /// The latest step up to `step` at which one was due; 0 for none.
    pub fn last_due(&self, step: u64) -> u64 {
        step / self.every * self.every
    }

    /// Keeps where a training stands; `note` says what its model is.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn keep(
        &self,
        ctx: &Context<'_>,
        slots: &Slots,
        state: &Optimised,
        curve: &Curve,
        note: String,
    ) -> Result<(), KindError> {
        let mut file = TensorFile::default()
            .note("model", note)
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
    pub fn latest(&self, ctx: &Context<'_>, slots: &Slots, steps: u64) -> Option<(Optimised, Curve)> {
        (1..=steps / self.every).rev().find_map(|i| {
            let artifact = ctx.memo_get(&self.key(i * self.every))?;
            // A checkpoint that cannot be read is as good as none: the training takes an earlier one.
            read(&ctx.part(&artifact, "").ok()?, slots).ok()
        })
    }
}

fn read(bytes: &[u8], slots: &Slots) -> Result<(Optimised, Curve), KindError> {
    let file = TensorFile::from_bytes(bytes)?;
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
