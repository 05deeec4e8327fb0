//! What all networks here share: the operators of `tauflow-ops` in burn's autodiff graph, weights with names, their
//! optimiser, and shares of the processor for trainings side by side. Knows no network, no data set and no kind.

mod checkpoint;
mod curve;
pub mod layers;
mod on_device;
mod op;
mod optimiser;
mod threads;
mod weights;

pub use checkpoint::Checkpoints;
pub use curve::{Curve, Score};
pub use on_device::{OnDevice, constant, flat};
pub use op::{Input, apply, apply_on_cpu};
pub use optimiser::{Decay, Optimised, Rates};
pub use threads::Share;
pub use weights::{Slot, Slots, Start, Weights};
