//! The checkpoints of a solver's training: beside its weights, what their model will say of itself.

use super::trainer::Trainer;
use crate::model::ModelInfo;
use tauflow_contract::{Context, KindError};
use tauflow_tensors::{Checkpoints as Kept, Curve};

/// Where the checkpoints of one training are kept.
pub(crate) struct Checkpoints {
    pub(crate) kept: Kept,
    /// What its model will say of itself.
    pub(crate) info: ModelInfo,
}

impl Checkpoints {
    /// Keeps where a training stands.
    pub(crate) fn keep(&self, ctx: &Context<'_>, trainer: &Trainer, curve: &Curve) -> Result<(), KindError> {
        // Of the step: trainings of more steps may share it.
        let info = ModelInfo { steps: trainer.state.step, ..self.info.clone() };
        let note = serde_json::to_string(&info).expect("plain data");
        self.kept.keep(ctx, trainer.network.slots(), &trainer.state, curve, note)
    }

    /// The latest one at or before `steps`, if there is any.
    pub(crate) fn latest(&self, ctx: &Context<'_>, trainer: &mut Trainer, steps: u64) -> Option<Curve> {
        let (state, curve) = self.kept.latest(ctx, trainer.network.slots(), steps)?;
        trainer.state = state;
        Some(curve)
    }
}
