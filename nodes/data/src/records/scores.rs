//! Scores of images against their references, as `image_metrics` hands them on.

use super::estimate::infinite;
use serde::{Deserialize, Serialize};
use tauflow_contract::json_media;

/// The metrics of one image against its reference. An infinite value is written as `null`; a metric that was not
/// computed is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// Structural similarity of previews over several scales.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ms_ssim: Option<f64>,
    /// Mean FLIP of previews.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flip: Option<f64>,
    /// Mean HDR-FLIP of exposed linear radiance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hdr_flip: Option<f64>,
    /// LPIPS of previews.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

/// Names of the metrics that every score has, in the order of tables.
pub const BASIC: [&str; 6] = ["hdr_psnr", "hdr_psnr_max", "hdr_mae", "preview_psnr", "preview_mae", "ssim"];

/// Names of all metrics, in the order of tables: [`BASIC`], then those that are computed on request.
pub const METRICS: [&str; 10] = [
    "hdr_psnr",
    "hdr_psnr_max",
    "hdr_mae",
    "preview_psnr",
    "preview_mae",
    "ssim",
    "ms_ssim",
    "flip",
    "hdr_flip",
    "lpips",
];

/// Whether more is better, for a name of [`METRICS`].
pub fn higher_is_better(metric: &str) -> bool {
    !(metric.ends_with("_mae") || metric.ends_with("flip") || metric == "lpips")
}

/// The maximum of a PSNR in a mean, in dB: 20 log10 2^24, the rounding of an f32 at the peak.
pub const PSNR_CEILING: f64 = 144.494_397_918_710_97;

/// A value as it enters means: a PSNR is held below [`PSNR_CEILING`].
pub fn bounded(metric: &str, value: f64) -> f64 {
    // `min` would hide that a value is not known.
    if metric.contains("psnr") && value > PSNR_CEILING { PSNR_CEILING } else { value }
}

/// Names of the metrics that at least one of the scores has, in the order of tables; always those of [`BASIC`].
pub fn computed<'a>(scores: impl IntoIterator<Item = &'a Metrics>) -> Vec<&'static str> {
    let mut has = [false; METRICS.len()];
    has[..BASIC.len()].fill(true);
    for metrics in scores {
        METRICS.iter().zip(&mut has).for_each(|(name, has)| *has |= metrics.get(name).is_some());
    }
    METRICS.into_iter().zip(has).filter_map(|(name, has)| has.then_some(name)).collect()
}

impl Metrics {
    /// A value by its name in [`METRICS`]; none if the name is unknown, or the metric was not computed.
    pub fn get(&self, name: &str) -> Option<f64> {
        Some(match name {
            "hdr_psnr" => self.hdr_psnr,
            "hdr_psnr_max" => self.hdr_psnr_max,
            "hdr_mae" => self.hdr_mae,
            "preview_psnr" => self.preview_psnr,
            "preview_mae" => self.preview_mae,
            "ssim" => self.ssim,
            "ms_ssim" => self.ms_ssim?,
            "flip" => self.flip?,
            "hdr_flip" => self.hdr_flip?,
            "lpips" => self.lpips?,
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
    /// Why there are no scores, or why a metric is missing, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

json_media! { SceneScores, "tauflow/scene-scores", "The metrics of each image of a scene."; }

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn infinite_values_survive_json_and_absent_metrics_leave_no_trace() {
        let metrics = Metrics {
            hdr_psnr: f64::INFINITY,
            hdr_psnr_max: 30.5,
            preview_psnr: f64::INFINITY,
            ssim: 1.0,
            ..Metrics::default()
        };
        let text = serde_json::to_string(&metrics).expect("plain data");
        assert_eq!(serde_json::from_str::<Metrics>(&text).expect("own text"), metrics);
        assert!(!text.contains("flip") && !text.contains("lpips"), "{text}");
        assert_eq!(computed([&metrics]), BASIC);
        assert!(BASIC.iter().all(|name| metrics.get(name).is_some()));
        assert!(METRICS[BASIC.len()..].iter().all(|name| metrics.get(name).is_none()));
        assert_eq!(metrics.get("psnr"), None);
        let more = Metrics { flip: Some(0.25), ..metrics };
        let text = serde_json::to_string(&more).expect("plain data");
        assert_eq!(serde_json::from_str::<Metrics>(&text).expect("own text"), more);
        assert_eq!(computed([&metrics, &more])[BASIC.len()..], ["flip"]);
    }

    #[test]
    fn only_psnrs_are_bounded_in_means() {
        assert!((PSNR_CEILING - 20.0 * 24.0 * 2f64.log10()).abs() < 1e-12);
        for metric in METRICS {
            let ceiling = if metric.contains("psnr") { PSNR_CEILING } else { f64::INFINITY };
            assert_eq!((bounded(metric, f64::INFINITY), bounded(metric, 40.0)), (ceiling, 40.0), "{metric}");
            assert!(bounded(metric, f64::NAN).is_nan(), "{metric}");
        }
    }

    #[test]
    fn errors_are_better_when_lower() {
        let lower: Vec<&str> = METRICS.into_iter().filter(|name| !higher_is_better(name)).collect();
        assert_eq!(lower, ["hdr_mae", "preview_mae", "flip", "hdr_flip", "lpips"]);
    }
}
