//! Scores of images by metrics that need no reference, such as CLIPIQA, by models and programs that users bring.
//!
//! Knows nothing of how images are made, and nothing of any metric. It stands apart from the other metrics because it
//! brings ONNX Runtime's interface.

mod manifest;
mod no_reference_scores;
mod onnx;
mod program;
mod resize;
mod scorer;

pub use no_reference_scores::{NoReferenceScores, NoReferenceScoresParams};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![Box::new(KindRow::<NoReferenceScores>::new())]
}
