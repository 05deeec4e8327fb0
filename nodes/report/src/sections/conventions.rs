//! How the figures are defined, so that the page stands on its own.

use crate::{page::Section, sections::resampled};
use tauflow_data::records::Evaluation;

/// Metrics that were computed on request.
const REQUESTED: [(&str, &str, &str); 4] = [
    (
        "ms_ssim",
        "MS-SSIM",
        "SSIM of previews over several scales, each half as fine as the last, with the published weights; fewer than \
        five scales have their weights divided by the sum",
    ),
    (
        "flip",
        "FLIP",
        "of previews as sRGB images at 67 pixels per degree, mean over pixels; 0 is equal, lower is better",
    ),
    (
        "hdr_flip",
        "HDR-FLIP",
        "per pixel the largest FLIP of exposed radiance over exposures between the reference's maximum and median, \
        shown by the ACES curve; mean over pixels",
    ),
    ("lpips", "LPIPS", "version 0.1 with AlexNet, of previews mapped to [−1, 1]; lower is better"),
];

/// The section.
pub fn section(evaluation: &Evaluation) -> Section {
    let (from, last) = (evaluation.from_spp, evaluation.reference_spp);
    let mut entries = vec![
        (
            "Radiance",
            "linear, multiplied by one exposure factor per scene for all rungs; negative values are set to 0; no \
            upper clip; the factor is the gate's <code>key</code> (0.18 by default) over the geometric mean luminance \
            of bins of 4 × 4 pixels of its preview, times 2<sup>EV</sup>"
                .to_owned(),
        ),
        (
            "HDR PSNR, HDR MAE",
            "on exposed linear radiance, peak 1.0 (a separate column uses the reference's maximum as peak); computed \
            per image, then averaged over scenes"
                .to_owned(),
        ),
        (
            "Preview",
            "Reinhard x/(1+x), then gamma 1/2.2, clipped to [0, 1]; metrics are computed before rounding to 8 bits; \
            pictures on this page use it"
                .to_owned(),
        ),
        (
            "SSIM",
            "on previews: 11 × 11 Gaussian window, σ 1.5, K₁ .01, K₂ .03, mean over RGB and valid \
            windows"
                .to_owned(),
        ),
    ];
    let requested = REQUESTED.iter().filter(|(metric, ..)| evaluation.hold.contains_key(*metric));
    entries.extend(requested.map(|(_, term, text)| (*term, (*text).to_owned())));
    entries.extend([
        ("Hold", format!("the unchanged input with {from} spp, without a network call")),
        (
            "NFE",
            format!(
                "number of network calls from I<sub>{from}</sub> to τ = 1, the variance time of I<sub>{last}</sub>"
            ),
        ),
        ("AUC", "mean of the curve over log NFE, by the trapezoidal rule".to_owned()),
        (
            "TV",
            "total variation: sum of the absolute changes along the curve, divided by its length in log NFE; lower \
            is steadier"
                .to_owned(),
        ),
        (
            "Interval",
            match evaluation.has_intervals() {
                true => format!(
                    "95%, percentile bootstrap over {}, {} resamples; differences to hold are paired by scene",
                    resampled(evaluation.groups),
                    evaluation.resamples
                ),
                false => "none for a single scene, or a single group of scenes of one content".to_owned(),
            },
        ),
        (
            "Infinite PSNR",
            "an image equal to its reference counts as 144.49 dB (a mean squared error of 2<sup>−48</sup>) in means \
            and intervals; the values per scene are inf in CSV and null in JSON"
                .to_owned(),
        ),
    ]);
    let rows: String = entries.iter().map(|(term, text)| format!("<dt>{term}</dt><dd>{text}</dd>")).collect();
    Section::new("conventions", "Conventions", format!("<dl>{rows}</dl>"))
}
