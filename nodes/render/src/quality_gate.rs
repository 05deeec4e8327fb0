#![doc = include_str!("quality_gate.md")]

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{Action, Context, Each, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs};
use tauflow_data::{
    Image,
    image::{luminance, preview},
    maths::{exp, exp2, log},
    records::{Exposure, Ladder, SceneRecord, Verdict},
};

const SCENES: Each<SceneRecord> = Each::new("scenes", "The scenes to judge.");
const PREVIEWS: Each<Ladder> = Each::new("previews", "A ladder of each; its last rung is judged.");

const MAIN: Group = Group::main(1);
const ACCEPTED: Out<SceneRecord> = Out::new(MAIN, "accepted", "The scenes that passed.").filtering();
const EXPOSURE: Out<Exposure> = Out::new(MAIN, "exposure", "Exposure of the scenes that passed.").filtering();
const VERDICTS: Out<Verdict> = Out::new(MAIN, "verdicts", "What was measured, and every reason for rejection.");

/// Side of a bin in pixels.
const BIN: usize = 4;

/// The kind `quality_gate`.
pub struct QualityGate;

/// Params of `quality_gate`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct QualityGateParams {
    /// Smallest mean luminance, in the scene's own radiance.
    #[schemars(range(min = 0.0))]
    pub black: f64,
    /// Largest share of dark pixels.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub dark_share: f64,
    /// Share of the mean luminance below which a pixel is dark.
    #[schemars(range(min = 0.0))]
    pub dark: f64,
    /// Smallest standard deviation of the preview over bins; previews run from 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub contrast: f64,
    /// Largest share of pixels that show white.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub bright_share: f64,
    /// Exposed luminance, without the scene's EV, from which a pixel shows white; a preview shows 8 as 0.95.
    #[schemars(range(min = 0.0))]
    pub white: f64,
    /// Largest share of light in the brightest 1% of the bins.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub concentration: f64,
    /// Largest standard error of a bin over the mean luminance.
    #[schemars(range(min = 0.0))]
    pub noise: f64,
    /// Luminance that the geometric mean over the bins is exposed to.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub key: f64,
}

impl Default for QualityGateParams {
    fn default() -> Self {
        Self {
            black: 1e-6,
            dark_share: 0.6,
            dark: 1e-3,
            contrast: 0.02,
            bright_share: 0.25,
            white: 8.0,
            concentration: 0.9,
            noise: 1.0,
            key: 0.18,
        }
    }
}

impl Kind for QualityGate {
    type Params = QualityGateParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "quality_gate",
            summary: "Rejects scenes that teach nothing, and sets the exposure of the others.",
            manual: include_str!("quality_gate.md"),
            mode: Mode::Map,
            inputs: const { &[SCENES.port(), PREVIEWS.port()] },
            outputs: const { &[ACCEPTED.port(), EXPOSURE.port(), VERDICTS.port()] },
            seeded: false,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let (scene, previews) = (action.handle(SCENES)?, action.handle(PREVIEWS)?);
        let recipe = SceneRecord::recipe(ctx, scene)?;
        let meta = Ladder::meta(ctx, previews)?;
        let last = *meta.counts.last().ok_or_else(|| KindError::Input("a preview without rungs".into()))?;
        let (image, variance) = (Ladder::rung(ctx, previews, last)?, Ladder::variance(ctx, previews)?);
        let preview = Preview { image: &image, variance: &variance, spp: last, rejected: meta.rejected };
        let (verdict, exposure) = judge(&preview, recipe.exposure_ev, &action.params);
        let outputs = Outputs::default().put(VERDICTS, verdict.store(ctx)?);
        if !verdict.reasons.is_empty() {
            return Ok(outputs);
        }
        Ok(outputs.put(ACCEPTED, scene.to_stored()).put(EXPOSURE, exposure.store(ctx)?))
    }
}

/// Mean luminance of each block of pixels; blocks at the border may be smaller.
fn bins(image: &Image) -> Vec<f64> {
    let mut bins = Vec::new();
    for top in (0..image.height()).step_by(BIN) {
        for left in (0..image.width()).step_by(BIN) {
            let (mut sum, mut count) = (0.0, 0.0);
            for y in top..(top + BIN).min(image.height()) {
                for x in left..(left + BIN).min(image.width()) {
                    sum += f64::from(luminance(image.pixel(x, y)));
                    count += 1.0;
                }
            }
            bins.push(sum / count);
        }
    }
    bins
}

/// The geometric mean over bins of an image's luminance, with bins below 1/10,000 of the mean counted as that much:
/// what `key` is divided by for the exposure factor.
pub fn geometric_mean_luminance(image: &Image) -> f64 {
    let pixels = image.data().chunks_exact(3).map(|rgb| f64::from(luminance(rgb)).max(0.0));
    let floor = (pixels.sum::<f64>() / (image.width() * image.height()) as f64 * 1e-4).max(1e-30);
    let bins = bins(image);
    exp(bins.iter().map(|b| log(b.max(floor))).sum::<f64>() / bins.len() as f64)
}

/// What is judged.
struct Preview<'a> {
    image: &'a Image,
    /// Variance of single samples.
    variance: &'a Image,
    spp: u64,
    rejected: u64,
}

impl Preview<'_> {
    /// Root mean square of the standard errors of whole bins.
    fn error(&self) -> f64 {
        let values = self.variance.data();
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64;
        (mean / (self.spp as f64 * (BIN * BIN) as f64)).sqrt()
    }
}

fn judge(of: &Preview<'_>, ev: f64, params: &QualityGateParams) -> (Verdict, Exposure) {
    let Preview { image, variance, rejected, .. } = *of;
    let broken = [image, variance].iter().flat_map(|i| i.data()).filter(|v| !v.is_finite()).count();
    if broken > 0 {
        let measures = BTreeMap::from([("non_finite".to_owned(), broken as f64)]);
        let verdict = Verdict { reasons: vec!["non_finite".into()], measures };
        return (verdict, Exposure { factor: 1.0, ev, mean_luminance: 0.0 });
    }
    let pixels: Vec<f64> = image.data().chunks_exact(3).map(|rgb| f64::from(luminance(rgb)).max(0.0)).collect();
    let bins = bins(image);
    let mean = pixels.iter().sum::<f64>() / pixels.len() as f64;
    let geometric = geometric_mean_luminance(image);
    let neutral = params.key / geometric;
    let share = |of: &dyn Fn(f64) -> bool| pixels.iter().filter(|p| of(**p)).count() as f64 / pixels.len() as f64;
    let shown: Vec<f64> = bins.iter().map(|b| f64::from(preview((b * neutral) as f32))).collect();
    let shown_mean = shown.iter().sum::<f64>() / shown.len() as f64;
    let deviation = shown.iter().map(|s| (s - shown_mean) * (s - shown_mean)).sum::<f64>() / shown.len() as f64;
    let mut sorted = bins.clone();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let top: f64 = sorted.iter().take(sorted.len().div_ceil(100)).sum();
    let total: f64 = sorted.iter().sum();
    let measures = BTreeMap::from(
        [
            ("mean_luminance", mean),
            ("geometric_mean_luminance", geometric),
            ("dark_share", share(&|p| p < mean * params.dark)),
            ("contrast", deviation.sqrt()),
            ("bright_share", share(&|p| p * neutral > params.white)),
            ("concentration", if total > 0.0 { top / total } else { 0.0 }),
            ("noise", if mean > 0.0 { of.error() / mean } else { 0.0 }),
            ("rejected", rejected as f64),
        ]
        .map(|(name, value)| (name.to_owned(), value)),
    );
    let mut reasons = Vec::new();
    let mut reject = |so: bool, reason: &str| {
        if so {
            reasons.push(reason.to_owned());
        }
    };
    reject(rejected > 0, "non_finite");
    if mean <= params.black {
        reject(true, "black");
    } else {
        reject(measures["dark_share"] > params.dark_share, "dark");
        reject(measures["contrast"] < params.contrast, "near_constant");
        reject(measures["bright_share"] > params.bright_share, "over_exposed");
        reject(measures["concentration"] > params.concentration, "degenerate");
        reject(measures["noise"] > params.noise, "noisy");
    }
    let exposure = Exposure { factor: neutral * exp2(ev), ev, mean_luminance: geometric };
    (Verdict { reasons, measures }, exposure)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(value: impl Fn(usize, usize) -> f32) -> Image {
        let data = (0..32).flat_map(|y| (0..32).flat_map(move |x| [(x, y); 3])).map(|(x, y)| value(x, y)).collect();
        Image::from_data(32, 32, 3, data).expect("fits")
    }

    fn judged(image: &Image, variance: f32, rejected: u64, ev: f64, params: &QualityGateParams) -> (Verdict, Exposure) {
        let variance = image.map(|_| variance);
        judge(&Preview { image, variance: &variance, spp: 32, rejected }, ev, params)
    }

    fn reasons(image: &Image) -> Vec<String> {
        judged(image, 0.0, 0, 0.0, &QualityGateParams::default()).0.reasons
    }

    #[test]
    fn each_reason_is_found() {
        let good = image(|x, y| 0.1 + 0.01 * (x + y) as f32);
        assert_eq!(reasons(&good), [""; 0]);
        assert_eq!(reasons(&image(|_, _| 0.0)), ["black"]);
        assert_eq!(reasons(&image(|_, _| 0.3)), ["near_constant"]);
        assert_eq!(reasons(&image(|x, _| if x == 3 { f32::NAN } else { 1.0 })), ["non_finite"]);
        // A third of the picture is a hundred times brighter than the rest.
        assert!(reasons(&image(|x, _| if x < 11 { 100.0 } else { 0.1 })).contains(&"over_exposed".to_owned()));
        let one_lamp = image(|x, y| if (x, y) == (9, 9) { 1e5 } else { 0.01 + 0.001 * x as f32 });
        assert!(reasons(&one_lamp).contains(&"degenerate".to_owned()));
        let usual = QualityGateParams::default();
        assert_eq!(judged(&good, 0.0, 2, 0.0, &usual).0.reasons, ["non_finite"]);
        assert_eq!(judged(&good, f32::INFINITY, 0, 0.0, &usual).0.reasons, ["non_finite"]);
        // 512 samples of variance 512 have a mean of standard error 1; the picture's mean is 0.41.
        let (verdict, _) = judged(&good, 512.0, 0, 0.0, &usual);
        assert_eq!(verdict.reasons, ["noisy"]);
        assert!((verdict.measures["noise"] - 1.0 / 0.41).abs() < 1e-5, "{verdict:?}");
        assert_eq!(judged(&good, 5.0, 0, 0.0, &usual).0.reasons, [""; 0]);
    }

    #[test]
    fn exposure_brings_the_geometric_mean_to_mid_grey_and_no_threshold_moves_it() {
        let picture = image(|x, _| if x < 16 { 2.0 } else { 8.0 });
        let (_, exposure) = judged(&picture, 0.1, 0, 0.0, &QualityGateParams::default());
        assert!((exposure.mean_luminance - 4.0).abs() < 1e-5 && (exposure.factor - 0.045).abs() < 1e-7);
        let strict = QualityGateParams { contrast: 0.9, ..QualityGateParams::default() };
        let (verdict, same) = judged(&picture, 0.1, 0, 0.0, &strict);
        assert_eq!(same, exposure);
        assert_eq!(verdict.reasons, ["near_constant"]);
        let (_, brighter) = judged(&picture, 0.1, 0, 1.0, &strict);
        assert!((brighter.factor / exposure.factor - 2.0).abs() < 1e-12);
    }
}
