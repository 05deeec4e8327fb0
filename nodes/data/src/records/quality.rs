//! Scores of generated images, as `no_reference_scores` and `image_quality` hand them on.

use super::{Claim, Estimate, Family, Variant};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::json_media;

/// Which values of a score are better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Higher ones.
    Higher,
    /// Lower ones.
    Lower,
}

impl Better {
    /// How much better `value` is than `other`; below 0 if it is worse.
    pub fn gain(self, value: f64, other: f64) -> f64 {
        match self {
            Self::Higher => value - other,
            Self::Lower => other - value,
        }
    }
}

/// A score of images or of sets of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoreColumn {
    /// Its name, such as `mmd` or `clipiqa`.
    pub name: String,
    /// Which values are better.
    pub better: Better,
}

/// Scores of each generated image by metrics that need no reference.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SampleScores {
    /// The metrics; every row has a value of each.
    pub columns: Vec<ScoreColumn>,
    /// One row for each image.
    pub rows: Vec<SampleRow>,
    /// What was left out, and why.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// Scores of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SampleRow {
    /// The backbone that made it.
    pub backbone: String,
    /// The sample's number.
    pub sample: u64,
    /// Which variant of the sample.
    pub variant: Variant,
    /// The values, by score.
    pub scores: BTreeMap<String, f64>,
}

/// What `image_quality` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageQuality {
    /// The score that decides the verdicts, named before the run.
    pub judged_by: String,
    /// Number of bootstrap resamples.
    pub resamples: u64,
    /// Number of held-out clean renders.
    pub references: u64,
    /// Number of clean renders of the training set; none if it was not connected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training: Option<u64>,
    /// The scores, in the order of tables.
    pub columns: Vec<ScoreColumn>,
    /// One for each backbone, by name.
    pub backbones: Vec<BackboneQuality>,
    /// What was left out, and why.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// The scores of each image, for further work.
    pub per_sample: Vec<SampleRow>,
}

/// The scores of one backbone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BackboneQuality {
    /// Its name.
    pub backbone: String,
    /// What sort of model it is.
    pub family: Family,
    /// Number of samples.
    pub samples: u64,
    /// Sampler steps.
    pub steps: u64,
    /// Width and height at which images were compared, in pixels.
    pub size: [u64; 2],
    /// One for each variant, in the order of [`Variant::ALL`].
    pub variants: Vec<VariantQuality>,
    /// How much better the adapted variant is than each of the others; empty without an adapted variant.
    pub gains: Vec<Gain>,
    /// The frozen backbone against Gaussian images; none without a training set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gaussian: Option<AgainstGaussian>,
    /// Whether the gain on `judged_by` is physical: it has to hold over the frozen backbone and over every control.
    /// None without an adapted variant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub claim: Option<Claim>,
}

/// The scores of one variant over all samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantQuality {
    /// Which one.
    pub variant: Variant,
    /// The scores, by name.
    pub scores: BTreeMap<String, Estimate>,
    /// Largest difference of a value from the frozen variant of the same sample.
    pub change: f64,
    /// Mean over samples of the injected energy of each sampler step.
    pub energy: Vec<f64>,
}

/// How much better the adapted variant is than another, paired by sample. Above 0 is better for every score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gain {
    /// The other variant.
    pub over: Variant,
    /// The gains, by score.
    pub scores: BTreeMap<String, Estimate>,
}

/// A frozen backbone against Gaussian images that have the mean and the covariance of the training set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AgainstGaussian {
    /// Number of Gaussian images.
    pub images: u64,
    /// Number of frozen samples.
    pub samples: u64,
    /// Sampler steps of these samples.
    pub steps: u64,
    /// Squared MMD of the Gaussian images to the held-out renders.
    pub gaussian: Estimate,
    /// Squared MMD of the frozen backbone's images to the held-out renders.
    pub frozen: Estimate,
    /// The former less the latter: above 0 if the backbone is nearer.
    pub nearer: Estimate,
}

json_media! {
    SampleScores, "tauflow/sample-scores", "Scores of each generated image by metrics that need no reference.";
    ImageQuality, "tauflow/image-quality", "Scores of generated images by backbone and variant, gains and verdicts.";
}
