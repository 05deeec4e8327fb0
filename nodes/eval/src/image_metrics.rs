#![doc = include_str!("image_metrics.md")]

use crate::{
    held_out::HeldOut,
    metrics::{MetricError, Reference},
    request::{self, OnRequest, SCALES},
    ssim::LEAST_SIDE,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, Context, Each, Facts, Foreseen, Group, Kind, KindError, KindSpec, Known, Later, Media, Mode, Named, Out,
    Outlook, Outputs, ParamProblem,
};
use tauflow_data::{
    Image,
    facts::{self, NFE, REFERENCE_SPP, RUNGS, SPP},
    methods::HOLD,
    records::{Exposure, Ladder, PackedScene, Refined, RefinedImage, SceneScores, Score},
};

/// The kind `image_metrics`.
pub struct ImageMetrics;

/// Params of `image_metrics`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ImageMetricsParams {
    /// Sample count of the rung to score if `images` is not connected.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// Metrics to compute beside those that every score has: `ms_ssim`, `flip`, `hdr_flip`.
    pub also: Vec<OnRequest>,
    /// Number of scales of `ms_ssim`; the published 5 need images of at least 161 x 161 pixels.
    #[schemars(range(min = 1, max = 5))]
    pub ms_ssim_scales: u64,
}

impl Default for ImageMetricsParams {
    fn default() -> Self {
        Self { from: 1, also: Vec::new(), ms_ssim_scales: SCALES }
    }
}

// `images` stands first: where it is connected it decides the items, and each needs a reference.
const IMAGES: Each<Refined> =
    Each::new("images", "The images to score; without them, a rung of the references is scored.").or_none();
const REFERENCES: Each<PackedScene> = Each::new("references", "The same scenes; their last rung is the reference.");
const HELD_OUT: Each<Ladder> = Each::new(
    "held_out",
    "The ladders of `references`, of another stream than the images: their own noise is taken off `hdr_psnr`.",
)
.or_none();
const EXPOSURE: Each<Exposure> = Each::new("exposure", "The exposure of the same scenes, for `held_out`.").or_none();
const MAIN: Group = Group::main(1);
const METRICS: Out<SceneScores> = Out::new(MAIN, "metrics", "The metrics of each image of a scene.");

impl Kind for ImageMetrics {
    type Params = ImageMetricsParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "image_metrics",
            summary: "Compares images with references: PSNR, MAE, SSIM, FLIP.",
            manual: include_str!("image_metrics.md"),
            mode: Mode::Map,
            inputs: vec![IMAGES.port(), REFERENCES.port(), HELD_OUT.port(), EXPOSURE.port()],
            outputs: vec![METRICS.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        request::check(&params.also, params.ms_ssim_scales)
    }

    fn later() -> &'static [Later] {
        request::LATER
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let references = known.each(REFERENCES);
        let mut problems: Vec<Foreseen> =
            facts::least_film(REFERENCES, &references, LEAST_SIDE, "SSIM").into_iter().collect();
        let last = references.facts.get(RUNGS).and_then(|rungs| rungs.last().copied());
        problems.extend(request::too_few_pixels(REFERENCES, &references, &params.also, params.ms_ssim_scales));
        if known.has(HELD_OUT.name()) {
            let held_out = known.each(HELD_OUT);
            problems.extend(facts::same_film(HELD_OUT, &held_out, &references));
            problems.extend(facts::independent(HELD_OUT, &held_out));
            problems.extend(facts::same_last_rung(HELD_OUT, &held_out, &references));
            problems.extend((!known.has(EXPOSURE.name())).then(|| unexposed(HELD_OUT, EXPOSURE.name())));
        } else if known.has(EXPOSURE.name()) {
            problems.push(unexposed(EXPOSURE, HELD_OUT.name()));
        }
        let scores = request::known(Facts::default().with_some(REFERENCE_SPP, last), &params.also);
        let scores = if known.has(IMAGES.name()) {
            let images = known.each(IMAGES);
            problems.extend(facts::same_film(REFERENCES, &references, &images));
            scores.with_some(SPP, images.facts.get(SPP)).with_some(NFE, images.facts.get(NFE))
        } else {
            problems.extend(facts::rung(&references, params.from, "/from"));
            scores.with(SPP, vec![params.from]).with(NFE, vec![0])
        };
        Outlook::default().with(METRICS, scores).but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let item = action.item()?.as_str();
        let scene = action.read(ctx, REFERENCES)?;
        let (Some(reference_spp), Some(last)) = (scene.counts.last().copied(), scene.states.last()) else {
            return Err(KindError::Input(format!("`{item}` has no rung to be its reference")));
        };
        let more = request::more(&action.params.also, action.params.ms_ssim_scales);
        let reference =
            Reference::with(last, more).map_err(|e| KindError::Input(format!("the reference of `{item}`: {e}")))?;
        let reference = reference.with_own_error(own_error(ctx, action, last)?);
        let Refined { images, note, .. } = match action.read_if(ctx, IMAGES)? {
            Some(refined) => refined,
            None => Refined { images: vec![own_rung(&scene, action.params.from)?], note: None, ..Default::default() },
        };
        let mut scores = Vec::with_capacity(images.len());
        for (said, image) in images {
            ctx.check_cancelled()?;
            let metrics = reference.metrics(&image).map_err(|e| not_comparable(&e, &said, item))?;
            let RefinedImage { method, from_spp, to_spp, nfe } = said;
            scores.push(Score { method, from_spp, to_spp, nfe, metrics });
        }
        Ok(Outputs::default().put(METRICS, SceneScores { reference_spp, scores, note }.store(ctx)?))
    }
}

/// One of the two inputs that tell the reference's own error, without the other.
fn unexposed(port: impl Named, lacks: &str) -> Foreseen {
    Foreseen::input(port, format!("this needs `{lacks}`, too, which is not connected"), "connect both, or none of them")
}

/// The mean squared error of the reference, or 0 if nothing tells it.
fn own_error(ctx: &Context<'_>, action: &Action<'_, ImageMetricsParams>, reference: &Image) -> Result<f64, KindError> {
    let Some((ladder, exposure)) = action.handle_if(HELD_OUT)?.zip(action.read_if(ctx, EXPOSURE)?) else {
        return Ok(0.0);
    };
    let item = action.item()?;
    let held_out = HeldOut::load(ctx, ladder, exposure.factor, item)?;
    if held_out.image != *reference {
        return Err(KindError::Input(format!(
            "the reference of `{item}` is not the last rung of its ladder in `{}`; connect the ladders from which \
             `{}` was packed, and the same exposure",
            HELD_OUT.name(),
            REFERENCES.name()
        )));
    }
    if !held_out.independent || held_out.spp < 2 || !held_out.own_mse.is_finite() {
        return Err(KindError::Input(format!(
            "the variance of the reference of `{item}` does not tell its noise: it needs two independent samples per \
             pixel or more, and finite ones; disconnect `{}` and `{}`, or render other references",
            HELD_OUT.name(),
            EXPOSURE.name()
        )));
    }
    Ok(held_out.own_mse)
}

/// The problem and its image.
pub(crate) fn not_comparable(error: &MetricError, said: &RefinedImage, scene: &str) -> KindError {
    let RefinedImage { method, from_spp, to_spp, nfe } = said;
    KindError::Input(format!(
        "the image of `{method}`, {from_spp} -> {to_spp} samples, NFE {nfe}, of `{scene}`: {error}"
    ))
}

/// The rung of `spp` samples.
pub(crate) fn rung(scene: &PackedScene, spp: u64) -> Result<&Image, KindError> {
    scene.counts.iter().zip(&scene.states).find(|(n, _)| **n == spp).map(|(_, state)| state).ok_or_else(|| {
        KindError::Input(format!(
            "there is no rung of {spp} samples, only {:?}; add it to `rungs` of the ladders, or change `from`",
            scene.counts
        ))
    })
}

fn own_rung(scene: &PackedScene, from: u64) -> Result<(RefinedImage, Image), KindError> {
    let said = RefinedImage { method: HOLD.into(), from_spp: from, to_spp: from, nfe: 0 };
    Ok((said, rung(scene, from)?.clone()))
}
