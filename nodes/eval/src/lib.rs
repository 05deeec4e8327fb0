//! Metrics, evaluation and bridge validation.
//!
//! Compares images with references and sums the scores up; knows nothing of how images are made or shown.

pub mod bootstrap;
pub mod bridge_maps;
mod bridge_tables;
mod bridge_validation;
mod claims;
pub mod curve;
mod draws;
mod evaluation;
mod flip;
mod groups;
mod held_out;
mod image_metrics;
mod image_quality;
mod ladder_metrics;
pub mod metrics;
mod request;
mod ssim;
mod table;
mod time_course;
mod time_error;
mod time_params;
mod time_samples;
mod time_scene;
mod time_tables;

pub use bridge_tables::fraction;
pub use bridge_validation::{BridgeValidation, BridgeValidationParams};
pub use evaluation::{EvaluationKind, EvaluationParams, evaluate};
pub use groups::Groups;
pub use image_metrics::{ImageMetrics, ImageMetricsParams};
pub use image_quality::{ImageQualityKind, ImageQualityParams};
pub use ladder_metrics::{LadderMetrics, LadderMetricsParams};
pub use request::OnRequest;
pub use table::{AgainstParams, Coordinate, TableKind, TableParams, tabulate};
pub use time_error::TimeErrorKind;
pub use time_params::TimeErrorParams;

pub use tauflow_data::records::{PSNR_CEILING, bounded};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<ImageMetrics>::new()),
        Box::new(KindRow::<ImageQualityKind>::new()),
        Box::new(KindRow::<LadderMetrics>::new()),
        Box::new(KindRow::<TableKind>::new()),
        Box::new(KindRow::<EvaluationKind>::new()),
        Box::new(KindRow::<BridgeValidation>::new()),
        Box::new(KindRow::<TimeErrorKind>::new()),
    ]
}
