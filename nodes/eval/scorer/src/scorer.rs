//! What a scorer is. Knows no model and no program.

use tauflow_contract::KindError;
use tauflow_data::{Image, records::ScoreColumn};

/// Gives each image a value of each of its metrics.
pub(crate) trait Scorer {
    /// Its metrics.
    fn columns(&self) -> &[ScoreColumn];

    /// The values of an image, one for each metric.
    ///
    /// # Shapes
    /// `image` is [H, W, 3] of display values in [0, 1].
    ///
    /// # Errors
    /// If the model or program fails, or gives no finite number.
    fn score(&mut self, image: &Image) -> Result<Vec<f64>, KindError>;
}

/// A scorer, or why there is none: something of it is not on this machine.
pub(crate) enum Search<S> {
    /// It can be used.
    Here(S),
    /// A file that it needs is missing; a line for people.
    Missing(String),
}
