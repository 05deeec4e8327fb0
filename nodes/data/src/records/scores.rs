//! Scores of images against their references, as `image_metrics` hands them on.

use super::estimate::infinite;
use serde::{Deserialize, Serialize};
use tauflow_contract::json_media;

/// The metrics of one image against its reference. An infinite value is written as `null`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// PSNR of exposed linear radiance, peak 1, in dB.
    #[serde(with = "infinite")]
    pub hdr_psnr: f64,
    /// The same with the reference's maximum as the peak.
    #[serde(with = "infinite")]
    pub hdr_psnr_max: f64,
    /// Mean absolute error of exposed linear radiance.
    pub hdr_mae: f64,
    /// PSNR of previews, in dB.
    #[serde(with = "infinite")]
    pub preview_psnr: f64,
    /// Mean absolute error of previews.
    pub preview_mae: f64,
    /// Structural similarity of previews.
    pub ssim: f64,
}

/// Names of the metrics, in the order of tables.
pub const METRICS: [&str; 6] = ["hdr_psnr", "hdr_psnr_max", "hdr_mae", "preview_psnr", "preview_mae", "ssim"];

/// Whether more is better, for a name of [`METRICS`].
pub fn higher_is_better(metric: &str) -> bool {
    !metric.ends_with("_mae")
}

impl Metrics {
    /// A value by its name in [`METRICS`].
    pub fn get(&self, name: &str) -> Option<f64> {
        Some(match name {
            "hdr_psnr" => self.hdr_psnr,
            "hdr_psnr_max" => self.hdr_psnr_max,
            "hdr_mae" => self.hdr_mae,
            "preview_psnr" => self.preview_psnr,
            "preview_mae" => self.preview_mae,
            "ssim" => self.ssim,
            _ => return None,
        })
    }
}

/// One refined image's score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// The method, e.g. `mc_noise` or `hold`.
    pub method: String,
    /// Sample count of the endpoint it starts from.
    pub from_spp: u64,
    /// Sample count that it aims at.
    pub to_spp: u64,
    /// Network calls; 0 for the input itself.
    pub nfe: u64,
    /// Its metrics.
    pub metrics: Metrics,
}

/// The results of `image_metrics` for a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneScores {
    /// Sample count of the reference, the last rung.
    pub reference_spp: u64,
    /// One for each image.
    pub scores: Vec<Score>,
    /// Why there are none, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

json_media! { SceneScores, "tauflow/scene-scores", "The metrics of each image of a scene."; }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn infinite_values_survive_json() {
        let metrics = Metrics {
            hdr_psnr: f64::INFINITY,
            hdr_psnr_max: 30.5,
            hdr_mae: 0.0,
            preview_psnr: f64::INFINITY,
            preview_mae: 0.0,
            ssim: 1.0,
        };
        let text = serde_json::to_string(&metrics).expect("plain data");
        assert_eq!(serde_json::from_str::<Metrics>(&text).expect("own text"), metrics);
        for name in METRICS {
            assert!(metrics.get(name).is_some());
        }
        assert!(metrics.get("lpips").is_none() && higher_is_better("ssim") && !higher_is_better("hdr_mae"));
    }
}
