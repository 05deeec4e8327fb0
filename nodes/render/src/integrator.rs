//! How the radiance of a pixel is estimated.

mod light;
mod passage;
mod path;

pub(crate) use light::{LightPaths, Plan, Which, reaches};

pub(crate) use passage::{Dimmed, PASSAGES, Passage, first_solid, met};
pub(crate) use path::dimension;
pub use path::{Path, Roulette, Strategy};

use tauflow_data::IntegratorKind;

/// An integrator, with all that it can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Integrator {
    /// Path tracing from the camera.
    Path(Path),
    /// Path tracing from the camera, joined with paths from the lights.
    Bidirectional(Path),
    /// Paths from the lights alone. They do not find what is seen in mirrors and glass.
    LightTracing,
}

impl Integrator {
    /// The paths from the camera, how long they get in a scene of so long paths, and the paths from the lights.
    pub(crate) fn parts(self, max_depth: u32) -> (Path, u32, Option<Which>) {
        match self {
            Self::Path(path) => (path, max_depth, None),
            // Weights are against both ways of finding light.
            Self::Bidirectional(path) => (Path { strategy: Strategy::Mis, ..path }, max_depth, Some(Which::Joined)),
            // What shines into the camera itself.
            Self::LightTracing => (Path::default(), max_depth.min(1), Some(Which::Alone)),
        }
    }
}

impl From<IntegratorKind> for Integrator {
    fn from(kind: IntegratorKind) -> Self {
        match kind {
            IntegratorKind::Path => Self::Path(Path::default()),
            IntegratorKind::Bidirectional => Self::Bidirectional(Path::default()),
        }
    }
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
