//! The data that node kinds exchange: images, ladders, scenes, strata, variance time, and their file formats.
//!
//! Knows no kind: how a scene is drawn, rendered, learnt from or judged is elsewhere.

pub mod bins;
pub mod curve;
pub mod facts;
pub mod folder;
pub mod geom;
pub mod image;
pub mod image_io;
pub mod maths;
pub mod mesh;
pub mod mesh_check;
pub mod methods;
pub mod mitsuba;
pub mod outside;
pub mod records;
pub mod rng;
pub mod rungs;
pub mod scene;
pub mod statistics;
pub mod stratum;
pub mod tabular;
pub mod tensors;
pub mod time;
pub mod timing;
pub mod views;

pub use image::Image;
pub use rungs::{IntegratorKind, Resolution, Rungs, SamplerKind};
pub use scene::Scene;
pub use stratum::{ContextClass, Regime, Stratum, StratumName};
pub use tensors::{Tensor, TensorFile};
pub use time::{SdeTime, VarianceTime};

/// A file or artifact that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// The bytes are not what they should be.
    #[error("{0}")]
    Format(String),
    /// The file cannot be opened, read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
}

impl From<DataError> for tauflow_contract::KindError {
    fn from(error: DataError) -> Self {
        match error {
            DataError::Format(_) => Self::Input(error.to_string()),
            DataError::Io { .. } => Self::Environment(error.to_string()),
        }
    }
}
