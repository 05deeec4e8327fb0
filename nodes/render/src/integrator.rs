//! How the radiance of a pixel is estimated.

mod passage;
mod path;

pub(crate) use passage::{Dimmed, PASSAGES, Passage, first_solid, met};
pub(crate) use path::dimension;
pub use path::{Path, Roulette, Strategy};

/// An integrator, with all that it can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Integrator {
    /// Path tracing from the camera.
    Path(Path),
}

impl Default for Integrator {
    fn default() -> Self {
        Self::Path(Path::default())
    }
}

impl From<Path> for Integrator {
    fn from(path: Path) -> Self {
        Self::Path(path)
    }
}

impl From<Strategy> for Integrator {
    fn from(strategy: Strategy) -> Self {
        Path { strategy, ..Path::default() }.into()
    }
}

impl From<Roulette> for Integrator {
    fn from(roulette: Roulette) -> Self {
        Path { roulette, ..Path::default() }.into()
    }
}

#[cfg(test)]
mod tests;
