#![doc = include_str!("convergence.md")]

mod measure;
mod sde;

pub(crate) use measure::{slope, top_share};

use measure::{Measured, measure};
use schemars::JsonSchema;
use sde::Sde;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs,
};
use tauflow_data::{
    Stratum,
    convergence::{Convergence, ConvergenceRow, SceneConvergence},
    formats::{EXPOSURE, Exposure, JSON},
    ladder::{LADDER, Ladder},
    maths::{exp, log},
    results::Estimate,
    rng::Stream,
    statistics::quantile,
};

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
            version: 3,
            summary: "Measures how far ladders keep to the law of variance time, against held-out references.",
            manual: include_str!("convergence.md"),
            mode: Mode::Gather,
            inputs: const {
                &[
                    InputPort::whole("references", LADDER, "References of another stream; their last rung counts."),
                    InputPort::whole("ladders", LADDER, "Ladders of the same scenes: three rungs or more, all alike."),
                    InputPort::whole("exposure", EXPOSURE, "The exposure of the same scenes."),
                ]
            },
            outputs: const { &[OutputPort::new("convergence", JSON, "Errors, slopes, covariances and tails.")] },
            seeded: true,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let references = action.whole("references")?;
        let mut counts: Option<(Vec<u64>, u64)> = None;
        let mut scenes: Vec<Measured> = Vec::new();
        let mut sde = Sde::default();
        for (done, (key, artifact)) in references.iter().enumerate() {
            ctx.check_cancelled()?;
            let item = |port: &str| {
                action.whole(port)?.get(key.as_str()).ok_or_else(|| {
                    KindError::Input(format!(
                        "`{port}` has no item `{key}`, which `references` has; connect the same scenes"
                    ))
                })
            };
            let reference = Ladder::load(ctx, artifact)?;
            let ladder = Ladder::load(ctx, item("ladders")?)?;
            let exposure: Exposure = ctx.json(item("exposure")?, "")?;
            let spp = reference.meta.counts.last().copied().unwrap_or_default();
            let (first, expected) = counts.get_or_insert_with(|| (ladder.meta.counts.clone(), spp));
            if (&*first, *expected) != (&ladder.meta.counts, spp) {
                return Err(KindError::Input(format!(
                    "the ladder or reference of `{key}` has other rungs than the first; connect ladders of one `rungs`"
                )));
            }
            if !(ladder.meta.sampler.is_independent() && reference.meta.sampler.is_independent()) {
                return Err(KindError::Input(format!(
                    "samples of `{key}` depend on each other, and variances of single samples say nothing of their means; render \
                     ladder and reference with `sampler: independent`"
                )));
            }
            // Streams differ in what they estimate, unless there is no noise to estimate.
            let noisy = reference.variance.data().iter().any(|v| *v > 0.0);
            if noisy && artifact.part("variance") == item("ladders")?.part("variance") {
                return Err(KindError::Input(format!(
                    "the reference of `{key}` is its own ladder: nothing can be judged by itself; render references with \
                     another `stream`"
                )));
            }
            let mut stream = Stream::new(action.seed, &[]).part(key.as_str());
            scenes.push(measure(key.as_str(), &ladder, &reference, exposure.factor, &mut stream)?);
            sde.add(&ladder, &reference, exposure.factor, &mut stream);
            ctx.progress(done as u64 + 1, references.len() as u64, "");
        }
        let (counts, reference_spp) =
            counts.ok_or_else(|| KindError::Input("there are no references to measure by".into()))?;
        let mut stream = Stream::new(action.seed, &[]).part("rows");
        let mut groups: BTreeMap<String, Vec<&Measured>> = BTreeMap::new();
        for scene in &scenes {
            let stratum = Stratum::of_key(&scene.scene).map_or("other".to_owned(), |(s, _)| s.to_string());
            groups.entry(stratum).or_default().push(scene);
        }
        let result = Convergence {
            overall: row("all", &counts, &scenes.iter().collect::<Vec<_>>(), &mut stream),
            strata: groups.into_iter().map(|(name, of)| row(&name, &counts, &of, &mut stream)).collect(),
            scenes: scenes.iter().map(of_scene).collect(),
            sde: sde.rows(&counts),
            reference_spp,
            counts,
        };
        let key = ItemKey::new("convergence").expect("a valid key");
        let artifact = Artifact::blob(JSON, ctx.put_json(&result)?);
        Ok(Outputs::default().collection("convergence", Collection::from_iter([(key, artifact)])))
    }
}

fn of_scene(scene: &Measured) -> SceneConvergence {
    SceneConvergence {
        scene: scene.scene.clone(),
        slope: scene.slope,
        excess_kurtosis: scene.tail.map(|tail| tail.excess_kurtosis),
        tail_index: scene.tail.and_then(|tail| tail.index),
        tail_share: scene.tail_share,
    }
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    (!sorted.is_empty()).then(|| quantile(&sorted, 0.5))
}

fn row(stratum: &str, counts: &[u64], scenes: &[&Measured], stream: &mut Stream) -> ConvergenceRow {
    let mean = |of: &dyn Fn(&Measured) -> f64| scenes.iter().map(|m| of(m)).sum::<f64>() / scenes.len() as f64;
    // A scene without any noise at a rung has no logarithm there; the floor is far below every real error.
    let geometric = |of: &dyn Fn(&Measured) -> f64| exp(mean(&|m| 0.5 * log(of(m).max(1e-24))));
    let noisy: Vec<&&Measured> = scenes.iter().filter(|m| m.variance > 0.0).collect();
    let covariance = |m: usize, n: usize| {
        let ratio = |of: &&&Measured| of.covariance[m][n] * counts[m] as f64 / of.variance;
        noisy.iter().map(ratio).sum::<f64>() / noisy.len().max(1) as f64
    };
    let excess_kurtosis = median(scenes.iter().filter_map(|m| Some(m.tail?.excess_kurtosis)));
    let tail_share = mean(&|m| m.tail_share);
    ConvergenceRow {
        stratum: stratum.to_owned(),
        scenes: scenes.len() as u64,
        rmse: (0..counts.len()).map(|k| geometric(&|m| m.covariance[k][k])).collect(),
        law: counts.iter().map(|n| geometric(&|m| m.variance / *n as f64)).collect(),
        slope: resampled(&scenes.iter().map(|m| m.slope.mean).collect::<Vec<_>>(), stream),
        covariance: (0..counts.len()).map(|m| (0..=m).map(|n| covariance(m, n)).collect()).collect(),
        excess_kurtosis,
        tail_index: median(scenes.iter().filter_map(|m| m.tail?.index)),
        trusted_from: excess_kurtosis.and_then(|kurtosis| counts.iter().copied().find(|n| kurtosis <= *n as f64)),
        tail_share,
        heavy_tail: tail_share > 0.5,
        mean_path_length: mean(&|m| m.mean_path_length),
        rejected: scenes.iter().map(|m| m.rejected).sum(),
    }
}

/// The mean, with a bootstrap interval.
fn resampled(values: &[f64], stream: &mut Stream) -> Estimate {
    let count = values.len() as f64;
    let mut draws: Vec<f64> = (0..RESAMPLES)
        .map(|_| (0..values.len()).map(|_| values[stream.below(values.len())]).sum::<f64>() / count)
        .collect();
    draws.sort_by(f64::total_cmp);
    Estimate { mean: values.iter().sum::<f64>() / count, low: quantile(&draws, 0.025), high: quantile(&draws, 0.975) }
}
