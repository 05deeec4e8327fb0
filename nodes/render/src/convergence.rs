#![doc = include_str!("convergence.md")]

mod measure;
mod moments;
mod sde;
mod trust;

pub(crate) use measure::{slope, top_share};

use measure::{Measured, measure};
use moments::{Figure, Moments, pooled};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, All, Context, Foreseen, Group, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook, Outputs,
};
use tauflow_data::{
    SamplerKind, StratumName, facts,
    maths::{exp, log},
    records::{AgainstLaw, Convergence, ConvergenceRow, Estimate, Exposure, Ladder, SceneConvergence, shares_samples},
    rng::Stream,
    statistics::quantile,
};

const REFERENCES: All<Ladder> = All::new("references", "References of a different stream; the last rung is used.");
const LADDERS: All<Ladder> =
    All::new("ladders", "Ladders of the same scenes, with at least three rungs, the same for all scenes.");
const EXPOSURE: All<Exposure> = All::new("exposure", "The exposure of the same scenes.");
const CONVERGENCE: Out<Convergence> =
    Out::new(Group::main(5), "convergence", "Errors, slopes, covariances and tails.").single();

/// The kind `convergence`.
pub struct ConvergenceKind;

/// Resamples behind an interval.
const RESAMPLES: usize = 500;

/// Params of `convergence`: none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ConvergenceParams {}

impl Kind for ConvergenceKind {
    type Params = ConvergenceParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "convergence",
            summary: "Measures how errors of ladders fall, and tests the variance law, with held-out references.",
            manual: include_str!("convergence.md"),
            mode: Mode::Gather,
            inputs: vec![REFERENCES.port(), LADDERS.port(), EXPOSURE.port()],
            outputs: vec![CONVERGENCE.port()],
            seeded: true,
        }
    }

    fn foresee(_params: &Self::Params, known: &Known) -> Outlook {
        let (references, ladders) = (known.all(REFERENCES), known.all(LADDERS));
        let mut problems: Vec<Foreseen> = Vec::new();
        problems.extend(references.iter().find_map(|of| facts::independent(REFERENCES, of)));
        if let [first, ..] = ladders {
            problems.extend(ladders.iter().find_map(|of| facts::same_rungs(LADDERS, of, first)));
        }
        if let ([reference], [ladder]) = (references, ladders) {
            problems.extend(facts::same_film(REFERENCES, reference, ladder));
        }
        Outlook::default().but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let references = action.all(REFERENCES)?;
        let (ladders, exposures) = (action.all(LADDERS)?, action.all(EXPOSURE)?);
        let mut counts: Option<(Vec<u64>, u64, SamplerKind)> = None;
        let mut scenes: Vec<Measured> = Vec::new();
        for (done, (key, of_reference)) in references.iter().enumerate() {
            ctx.check_cancelled()?;
            let of_ladder = ladders.need(LADDERS, key, REFERENCES.name())?;
            let (reference, ladder) = (of_reference.load(ctx)?, of_ladder.load(ctx)?);
            let exposure = exposures.need(EXPOSURE, key, REFERENCES.name())?.load(ctx)?;
            let spp = reference.meta.counts.last().copied().unwrap_or_default();
            let sampler = ladder.meta.sampler;
            let (first, expected, same) = counts.get_or_insert_with(|| (ladder.meta.counts.clone(), spp, sampler));
            if (&*first, *expected, *same) != (&ladder.meta.counts, spp, sampler) {
                return Err(KindError::Input(format!(
                    "the ladder or reference of `{key}` has different rungs or another sampler than the first; connect \
                    ladders with the same `rungs` and `sampler`"
                )));
            }
            if !reference.meta.sampler.is_independent() {
                return Err(KindError::Input(format!(
                    "the samples of the reference of `{key}` are correlated, so their variance does not predict its \
                    error; render references with `sampler: independent`"
                )));
            }
            // Streams differ in what they estimate, unless there is no noise to estimate.
            let noisy = reference.variance.data().iter().any(|v| *v > 0.0);
            if noisy && Ladder::variance_digest(of_reference) == Ladder::variance_digest(of_ladder) {
                return Err(KindError::Input(format!(
                    "the reference of `{key}` is its own ladder; render references with a different `stream`"
                )));
            }
            let mut stream = Stream::new(action.seed, &[]).part(key.as_str());
            scenes.push(measure(key.as_str(), &ladder, &reference, exposure.factor, &mut stream)?);
            ctx.progress(done as u64 + 1, references.len() as u64, "");
        }
        let (counts, reference_spp, sampler) =
            counts.ok_or_else(|| KindError::Input("there are no references to measure by".into()))?;
        ctx.check_cancelled()?;
        let mut stream = Stream::new(action.seed, &[]).part("rows");
        let mut groups: BTreeMap<String, Vec<&Measured>> = BTreeMap::new();
        for scene in &scenes {
            let stratum = StratumName::group_of(&scene.scene);
            groups.entry(stratum).or_default().push(scene);
        }
        let overall = row("all", &counts, &scenes.iter().collect::<Vec<_>>(), &mut stream);
        let last = counts.last().copied().unwrap_or_default();
        if let Some(of_last) = overall.covariance.last().and_then(|row| row.last())
            && shares_samples(of_last.value, of_last.error, last, reference_spp)
        {
            return Err(KindError::Input(format!(
                "references share samples with the ladders that they judge: the variance of the rungs of {last} is \
                 {:.3} of that of independent samples; render references with another `stream`",
                of_last.value
            )));
        }
        let sde = if overall.mean.is_empty() {
            Vec::new()
        } else {
            let simulated = sde::simulate(&counts, &mut Stream::new(action.seed, &[]).part("sde"));
            simulated.rows(&counts, &overall.mean, &overall.covariance)
        };
        let result = Convergence {
            overall,
            strata: groups.into_iter().map(|(name, of)| row(&name, &counts, &of, &mut stream)).collect(),
            scenes: scenes.iter().map(|scene| of_scene(scene, &counts)).collect(),
            sde,
            reference_spp,
            counts,
            sampler,
        };
        Outputs::default().put_one(CONVERGENCE, CONVERGENCE.name(), result.store(ctx)?)
    }
}

fn of_scene(scene: &Measured, counts: &[u64]) -> SceneConvergence {
    let excess_kurtosis = scene.moments.as_ref().map(|moments| moments.kurtosis);
    let off_normal = scene.moments.as_ref().map_or_else(Vec::new, |moments| moments.off_normal.clone());
    let variances = scene.moments.iter().flat_map(|moments| moments.covariance.iter().filter_map(|row| row.last()));
    let reasons = flags(scene);
    let ratio = |(mse, n): (&f64, &u64)| mse * *n as f64 / scene.variance;
    // Pixels that have no more than rounding have no law either.
    let image: Vec<f64> =
        if scene.noisy && scene.independent { scene.mse.iter().zip(counts).map(ratio).collect() } else { Vec::new() };
    SceneConvergence {
        scene: scene.scene.clone(),
        slope: scene.slope,
        unresolved: scene.unresolved,
        variance: variances.map(|figure| AgainstLaw::new(figure.value, figure.error, 1.0)).collect(),
        excess_kurtosis,
        tail_index: scene.tail_index,
        tail_share: scene.tail_share,
        trusted_from: trust::trusted_from(counts, &off_normal),
        trust: if scene.independent || !scene.noisy {
            trust::words(counts, &off_normal, &image)
        } else {
            "none: samples are correlated".into()
        },
        off_normal,
        image_from: trust::image_from(counts, &image),
        image,
        heavy_tail: !reasons.is_empty(),
        reasons,
    }
}

/// Reasons to call a scene heavy-tailed.
fn flags(scene: &Measured) -> Vec<String> {
    trust::reasons(scene.tail_index, scene.moments.as_ref().map(|moments| moments.kurtosis), scene.tail_share)
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    (!sorted.is_empty()).then(|| quantile(&sorted, 0.5))
}

fn row(stratum: &str, counts: &[u64], scenes: &[&Measured], stream: &mut Stream) -> ConvergenceRow {
    let mean = |of: &dyn Fn(&Measured) -> f64| scenes.iter().map(|m| of(m)).sum::<f64>() / scenes.len() as f64;
    let noiseless = scenes.iter().filter(|m| !m.noisy).count();
    // Over scenes that have a logarithm at a rung: errors and law are of the same ones.
    let geometric = |k: usize, of: &dyn Fn(&Measured) -> f64| {
        let resolved = scenes.iter().filter(|m| m.noisy && m.mse[k] > 0.0);
        let logs: Vec<f64> = resolved.map(|m| 0.5 * log(of(m))).collect();
        if logs.is_empty() { 0.0 } else { exp(logs.iter().sum::<f64>() / logs.len() as f64) }
    };
    let errors: &[u64] = if noiseless == scenes.len() { &[] } else { counts };
    let moments: Vec<&Moments> = scenes.iter().filter_map(|m| m.moments.as_ref()).collect();
    let against = |law: f64, of: &dyn Fn(&Moments) -> Figure| {
        let [value, error] = pooled(&moments.iter().map(|m| of(m)).collect::<Vec<_>>());
        AgainstLaw::new(value, error, law)
    };
    // Without noise there is nothing to hold against the law.
    let rungs = if moments.is_empty() { 0 } else { counts.len() };
    let off_normal: Vec<f64> =
        (0..rungs).map(|k| moments.iter().map(|m| m.off_normal[k]).sum::<f64>() / moments.len() as f64).collect();
    let heavy_scenes = scenes.iter().filter(|m| !flags(m).is_empty()).count();
    ConvergenceRow {
        stratum: stratum.to_owned(),
        scenes: scenes.len() as u64,
        noiseless: noiseless as u64,
        unresolved: scenes.iter().map(|m| m.unresolved).sum(),
        rmse: (0..errors.len()).map(|k| geometric(k, &|m| m.mse[k])).collect(),
        law: errors.iter().enumerate().map(|(k, n)| geometric(k, &|m| m.variance / *n as f64)).collect(),
        slope: slope_of(scenes, stream),
        mean: (0..rungs).map(|k| against(0.0, &|m| m.mean[k])).collect(),
        covariance: (0..rungs).map(|m| (0..=m).map(|n| against(1.0, &|of| of.covariance[m][n])).collect()).collect(),
        excess_kurtosis: median(moments.iter().map(|m| m.kurtosis)),
        tail_index: median(scenes.iter().filter_map(|m| m.tail_index)),
        trusted_from: trust::trusted_from(counts, &off_normal),
        off_normal,
        tail_share: mean(&|m| m.tail_share),
        heavy_scenes: heavy_scenes as u64,
        heavy_tail: 2 * heavy_scenes >= scenes.len(),
        mean_path_length: mean(&|m| m.mean_path_length),
        rejected: scenes.iter().map(|m| m.rejected).sum(),
    }
}

/// Mean slope of the scenes that have one, with a bootstrap interval over scenes and, within each, over its blocks of
/// pixels. One scene therefore has the interval of its pixels, and the interval of few similar scenes is not narrower
/// than their pixels allow.
fn slope_of(scenes: &[&Measured], stream: &mut Stream) -> Option<Estimate> {
    let sloping: Vec<(f64, &[f64])> =
        scenes.iter().filter_map(|m| m.slope.map(|slope| (slope.mean, m.slopes.as_slice()))).collect();
    if sloping.is_empty() {
        return None;
    }
    let count = sloping.len() as f64;
    let mut draw = || {
        let (_, slopes) = sloping[stream.below(sloping.len())];
        slopes[stream.below(slopes.len())]
    };
    let mut draws: Vec<f64> = (0..RESAMPLES).map(|_| (0..sloping.len()).map(|_| draw()).sum::<f64>() / count).collect();
    draws.sort_by(f64::total_cmp);
    Some(Estimate {
        mean: sloping.iter().map(|(mean, _)| *mean).sum::<f64>() / count,
        low: quantile(&draws, 0.025),
        high: quantile(&draws, 0.975),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convergence::measure::tests::{COUNTS, ladder};

    #[test]
    fn scenes_without_noise_are_counted_and_move_nothing() {
        let (mut a, mut b) = (Stream::new(1, &[0]), Stream::new(1, &[1]));
        let of = |own: Ladder, held_out: Ladder| {
            measure("x", &own, &held_out, 1.0, &mut Stream::new(1, &[2])).expect("enough rungs")
        };
        let noisy = of(ladder(&COUNTS, |_| 1.0 + a.normal()), ladder(&[1024], |_| 1.0 + b.normal()));
        let flat = of(ladder(&COUNTS, |_| 0.7), ladder(&[1024], |_| 0.7));
        let of_all = |scenes: &[&Measured]| row("all", &COUNTS, scenes, &mut Stream::new(1, &[3]));
        let (alone, beside) = (of_all(&[&noisy]), of_all(&[&flat, &noisy]));
        assert_eq!((alone.scenes, alone.noiseless, beside.scenes, beside.noiseless), (1, 0, 2, 1));
        assert_eq!((&beside.rmse, &beside.law, beside.slope), (&alone.rmse, &alone.law, alone.slope));
        assert!(beside.slope.is_some_and(|slope| (slope.mean + 0.5).abs() < 0.05), "{beside:?}");
        let none = of_all(&[&flat, &flat]);
        assert_eq!((none.noiseless, none.unresolved, none.slope), (2, 0, None));
        assert!(none.rmse.is_empty() && none.law.is_empty() && none.mean.is_empty(), "{none:?}");
    }
}
