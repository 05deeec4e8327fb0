#![doc = include_str!("ladder_metrics.md")]

use crate::{
    image_metrics::not_comparable,
    metrics::Reference,
    request::{self, OnRequest, SCALES},
    ssim::LEAST_SIDE,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, Context, Each, Facts, Foreseen, Group, Handle, Kind, KindError, KindSpec, Known, Later, Media, Mode, Out,
    Outlook, Outputs, ParamProblem,
};
use tauflow_data::{
    Image,
    bins::{KEY, geometric_mean_luminance},
    facts::{self, NFE, REFERENCE_SPP, RUNGS, SPP},
    methods::HOLD,
    records::{Exposure, Ladder, RefinedImage, SceneScores, Score},
};

/// The kind `ladder_metrics`.
pub struct LadderMetrics;

/// Params of `ladder_metrics`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LadderMetricsParams {
    /// Sample counts of the rungs to score; empty for all rungs.
    pub rungs: Vec<u64>,
    /// Exposed luminance of the geometric mean of the reference; unused if `exposure` is connected.
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub key: f64,
    /// Metrics to compute beside those that every score has: `ms_ssim`, `flip`, `hdr_flip`.
    pub also: Vec<OnRequest>,
    /// Number of scales of `ms_ssim`; the published 5 need images of at least 161 x 161 pixels.
    #[schemars(range(min = 1, max = 5))]
    pub ms_ssim_scales: u64,
}

impl Default for LadderMetricsParams {
    fn default() -> Self {
        Self { rungs: Vec::new(), key: KEY, also: Vec::new(), ms_ssim_scales: SCALES }
    }
}

const LADDERS: Each<Ladder> = Each::new("ladders", "The ladders to score.");
const REFERENCES: Each<Ladder> =
    Each::new("references", "Ladders of the same scenes from a different stream; the last rung is the reference.");
const EXPOSURE: Each<Exposure> =
    Each::new("exposure", "The exposure of the same scenes. Default: computed from the reference.").or_none();
const METRICS: Out<SceneScores> = Out::new(Group::main(1), "metrics", "The metrics of each rung of a scene's ladder.");

impl Kind for LadderMetrics {
    type Params = LadderMetricsParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "ladder_metrics",
            summary: "Scores the rungs of ladders against held-out references.",
            manual: include_str!("ladder_metrics.md"),
            mode: Mode::Map,
            inputs: vec![LADDERS.port(), REFERENCES.port(), EXPOSURE.port()],
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
        let (ladders, references) = (known.each(LADDERS), known.each(REFERENCES));
        let mut problems: Vec<Foreseen> = Vec::new();
        problems.extend(facts::same_film(REFERENCES, &references, &ladders));
        problems.extend(facts::least_film(REFERENCES, &references, LEAST_SIDE, "SSIM"));
        problems.extend(request::too_few_pixels(REFERENCES, &references, &params.also, params.ms_ssim_scales));
        let named = params.rungs.iter().enumerate();
        problems.extend(named.filter_map(|(at, rung)| facts::rung(&ladders, *rung, &format!("/rungs/{at}"))));
        let scored = if params.rungs.is_empty() { ladders.facts.get(RUNGS) } else { Some(params.rungs.clone()) };
        let last = references.facts.get(RUNGS).and_then(|rungs| rungs.last().copied());
        let scores = Facts::default().with_some(REFERENCE_SPP, last).with_some(SPP, scored).with(NFE, vec![0]);
        let scores = request::known(scores, &params.also);
        Outlook::default().with(METRICS, scores).but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let item = action.item()?.as_str();
        let (reference_spp, reference) = last_rung(ctx, action.handle(REFERENCES)?, item)?;
        let exposure = match action.read_if(ctx, EXPOSURE)? {
            Some(exposure) => exposure.factor,
            None => action.params.key / geometric_mean_luminance(&reference),
        };
        let exposed = |image: &Image| image.map(|value| (f64::from(value) * exposure) as f32);
        let reference = exposed(&reference);
        let more = request::more(&action.params.also, action.params.ms_ssim_scales);
        let reference = Reference::with(&reference, more)
            .map_err(|e| KindError::Input(format!("the reference of `{item}`: {e}")))?;
        let ladder = action.handle(LADDERS)?;
        let counts = Ladder::meta(ctx, ladder)?.counts;
        let chosen = if action.params.rungs.is_empty() { &counts } else { &action.params.rungs };
        if let Some(missing) = chosen.iter().find(|spp| !counts.contains(spp)) {
            return Err(KindError::Input(format!(
                "the ladder of `{item}` has no rung of {missing} samples, only {counts:?}; add it to the `rungs` of \
                 the ladders, or remove it from `rungs` here"
            )));
        }
        let mut scores = Vec::with_capacity(chosen.len());
        for spp in chosen {
            ctx.check_cancelled()?;
            let image = exposed(&Ladder::rung(ctx, ladder, *spp)?);
            let said = RefinedImage { method: HOLD.into(), from_spp: *spp, to_spp: *spp, nfe: 0 };
            let metrics = reference.metrics(&image).map_err(|e| not_comparable(&e, &said, item))?;
            scores.push(Score { method: said.method, from_spp: *spp, to_spp: *spp, nfe: 0, metrics });
        }
        Ok(Outputs::default().put(METRICS, SceneScores { reference_spp, scores, note: None }.store(ctx)?))
    }
}

/// Sample count and image of the last rung.
fn last_rung(ctx: &Context<'_>, ladder: Handle<'_, Ladder>, item: &str) -> Result<(u64, Image), KindError> {
    let counts = Ladder::meta(ctx, ladder)?.counts;
    let last = counts.last().ok_or_else(|| KindError::Input(format!("the reference of `{item}` has no rung")))?;
    Ok((*last, Ladder::rung(ctx, ladder, *last)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{collections::BTreeMap, sync::atomic::AtomicBool};
    use tauflow_contract::{ItemKey, MemoryBlobs, Silent};
    use tauflow_data::{
        IntegratorKind, SamplerKind,
        records::{LadderMeta, Rung},
    };

    const SIDE: usize = 16;

    fn grey(value: f32) -> Image {
        Image::from_data(SIDE, SIDE, 3, vec![value; SIDE * SIDE * 3]).expect("fits")
    }

    fn ladder(rungs: &[(u64, f32)]) -> Ladder {
        Ladder {
            meta: LadderMeta {
                counts: rungs.iter().map(|rung| rung.0).collect(),
                width: SIDE,
                height: SIDE,
                rejected: 0,
                mean_path_length: 1.0,
                sampler: SamplerKind::Independent,
                integrator: IntegratorKind::Path,
                estimated_error: None,
            },
            rungs: rungs.iter().map(|(spp, value)| Rung { spp: *spp, image: grey(*value) }).collect(),
            variance: grey(0.0),
        }
    }

    fn scores(params: LadderMetricsParams, own: &Ladder, reference: &Ladder) -> Result<SceneScores, KindError> {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let [own, reference] = [own, reference].map(|of| of.store(&ctx).expect("in memory").into_artifact());
        let item = ItemKey::new("L0-open-000000").expect("plain");
        let each = BTreeMap::from([(LADDERS.name(), &own), (REFERENCES.name(), &reference)]);
        let action = Action { params, item: Some(&item), group: "main", seed: 0, each, all: BTreeMap::new() };
        let outputs = LadderMetrics::run(&ctx, &action)?;
        SceneScores::load(&ctx, &outputs.items["metrics"])
    }

    #[test]
    fn every_rung_is_scored_at_the_exposure_of_the_reference() {
        // A grey reference is exposed to the key, whatever its level: 0.18 against 0.09 and 0.18.
        let found =
            scores(LadderMetricsParams::default(), &ladder(&[(1, 2.0), (2, 4.0)]), &ladder(&[(1, 9.0), (64, 4.0)]))
                .expect("scored");
        assert_eq!(found.reference_spp, 64);
        assert_eq!(found.scores.iter().map(|s| (s.from_spp, s.nfe)).collect::<Vec<_>>(), [(1, 0), (2, 0)]);
        assert!((found.scores[0].metrics.hdr_mae - 0.09).abs() < 1e-6, "{found:?}");
        assert!((found.scores[0].metrics.hdr_psnr - 20.0 * (1.0f64 / 0.09).log10()).abs() < 1e-4);
        assert_eq!(found.scores[1].metrics.hdr_psnr, f64::INFINITY);
        let one = LadderMetricsParams { rungs: vec![2], ..LadderMetricsParams::default() };
        assert_eq!(scores(one, &ladder(&[(1, 2.0), (2, 4.0)]), &ladder(&[(64, 4.0)])).expect("scored").scores.len(), 1);
    }

    #[test]
    fn a_rung_that_is_not_there_and_another_size_are_refused() {
        let params = LadderMetricsParams { rungs: vec![3], ..LadderMetricsParams::default() };
        let refused = scores(params, &ladder(&[(1, 2.0)]), &ladder(&[(64, 4.0)])).expect_err("no rung of 3");
        assert!(refused.to_string().contains("no rung of 3 samples, only [1]"), "{refused}");
        let mut small = ladder(&[(1, 2.0)]);
        small.rungs[0].image = Image::from_data(12, 12, 3, vec![1.0; 432]).expect("fits");
        let refused = scores(LadderMetricsParams::default(), &small, &ladder(&[(64, 4.0)])).expect_err("another size");
        assert!(refused.to_string().contains("12 x 12"), "{refused}");
    }
}
