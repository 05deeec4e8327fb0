//! Records: what kinds hand each other, one file for each media type or two that belong together.
//!
//! A record is a Rust type with [`Media`]: its name, how it is loaded, stored, exported as files and imported from
//! them. [`MEDIA`] is the one table of all of them by name.

mod asset;
mod backbone;
mod bridge;
mod convergence;
mod estimate;
mod evaluation;
mod files;
mod gate;
mod gbuffer;
mod generated;
mod ladder;
mod model;
mod packed;
mod quality;
mod refined;
mod rollout;
mod scene;
mod scores;
mod split;
mod statistics;
mod table;
mod time_error;
mod timing;
mod training;
mod variances;

pub use asset::*;
pub use backbone::*;
pub use bridge::*;
pub use convergence::*;
pub use estimate::{Estimate, has_intervals};
pub use evaluation::*;
pub use gate::*;
pub use gbuffer::*;
pub use generated::*;
pub use ladder::*;
pub use model::*;
pub use packed::*;
pub use quality::*;
pub use refined::*;
pub use rollout::*;
pub use scene::*;
pub use scores::*;
pub use split::*;
pub use statistics::*;
pub use table::*;
pub use time_error::*;
pub use timing::*;
pub use training::*;
pub use variances::*;

use tauflow_contract::{Files, MediaRow};

/// Every media type, by name.
pub const MEDIA: &[MediaRow] = &[
    MediaRow::of::<AdapterFile>(),
    MediaRow::of::<Asset>(),
    MediaRow::of::<AssetReport>(),
    MediaRow::of::<BackboneFiles>(),
    MediaRow::of::<BridgeFiles>(),
    MediaRow::of::<BridgeSteps>(),
    MediaRow::of::<Convergence>(),
    MediaRow::of::<Evaluation>(),
    MediaRow::of::<Exposure>(),
    MediaRow::of::<Files>(),
    MediaRow::of::<GBuffer>(),
    MediaRow::of::<Generated>(),
    MediaRow::of::<ImageQuality>(),
    MediaRow::of::<Ladder>(),
    MediaRow::of::<ModelFile>(),
    MediaRow::of::<PackedScene>(),
    MediaRow::of::<PerceptualFile>(),
    MediaRow::of::<Refined>(),
    MediaRow::of::<Rollout>(),
    MediaRow::of::<SampleScores>(),
    MediaRow::of::<SamplingReport>(),
    MediaRow::of::<SceneRecord>(),
    MediaRow::of::<SceneScores>(),
    MediaRow::of::<SceneStatistics>(),
    MediaRow::of::<ScoreTable>(),
    MediaRow::of::<SplitReport>(),
    MediaRow::of::<TimeError>(),
    MediaRow::of::<Timing>(),
    MediaRow::of::<TrainingLog>(),
    MediaRow::of::<TrainingTiming>(),
    MediaRow::of::<Variances>(),
    MediaRow::of::<Verdict>(),
];

/// The media type of this name.
pub fn media(name: &str) -> Option<&'static MediaRow> {
    MEDIA.iter().find(|row| row.name == name)
}

#[cfg(test)]
mod tests;
