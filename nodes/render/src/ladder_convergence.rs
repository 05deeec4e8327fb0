#![doc = include_str!("ladder_convergence.md")]

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs,
};
use tauflow_data::{
    Stratum,
    convergence::{Convergence, ConvergenceRow},
    formats::{EXPOSURE, Exposure, JSON},
    ladder::{LADDER, Ladder},
    maths::{exp, log},
};

/// The kind `ladder_convergence`.
pub struct LadderConvergence;

/// Params of `ladder_convergence`: none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LadderConvergenceParams {}

impl Kind for LadderConvergence {
    type Params = LadderConvergenceParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "ladder_convergence",
            version: 1,
            summary: "Measures how far ladders keep to the 1/sqrt(n) law.",
            manual: include_str!("ladder_convergence.md"),
            mode: Mode::Gather,
            inputs: const {
                &[
                    InputPort::whole("ladders", LADDER, "Ladders of three rungs or more, all of the same counts."),
                    InputPort::whole("exposure", EXPOSURE, "The exposure of the same scenes."),
                ]
            },
            outputs: const { &[OutputPort::new("convergence", JSON, "Errors, slopes and tails by stratum.")] },
            seeded: false,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let exposures = action.whole("exposure")?;
        let mut counts: Option<Vec<u64>> = None;
        let mut scenes: Vec<(String, Measured)> = Vec::new();
        let ladders = action.whole("ladders")?;
        for (done, (key, artifact)) in ladders.iter().enumerate() {
            ctx.check_cancelled()?;
            let ladder = Ladder::load(ctx, artifact)?;
            let of_scene = exposures.get(key.as_str()).ok_or_else(|| {
                KindError::Input(format!("`exposure` has no item `{key}`; connect the gate that these scenes passed"))
            })?;
            let exposure: Exposure = ctx.json(of_scene, "")?;
            if counts.get_or_insert_with(|| ladder.meta.counts.clone()) != &ladder.meta.counts {
                return Err(KindError::Input(format!(
                    "the ladder of `{key}` has other rungs than the first; connect ladders of one `rungs`"
                )));
            }
            let stratum = Stratum::of_key(key.as_str()).map_or("other".to_owned(), |(s, _)| s.to_string());
            scenes.push((stratum, measure(&ladder, exposure.factor)?));
            ctx.progress(done as u64 + 1, ladders.len() as u64, "");
        }
        let counts = counts.ok_or_else(|| KindError::Input("there are no ladders to measure".into()))?;
        let result = summarise(&counts, &scenes);
        let key = ItemKey::new("convergence").expect("a valid key");
        let artifact = Artifact::blob(JSON, ctx.put_json(&result)?);
        Ok(Outputs::default().collection("convergence", Collection::from_iter([(key, artifact)])))
    }
}

/// What one ladder shows.
struct Measured {
    /// Mean squared error of each rung below the last.
    mse: Vec<f64>,
    /// Mean variance of a single sample.
    variance: f64,
    tail_share: f64,
    mean_path_length: f64,
    rejected: u64,
}

fn measure(ladder: &Ladder, factor: f64) -> Result<Measured, KindError> {
    let Some((last, below)) = ladder.rungs.split_last().filter(|(_, below)| below.len() >= 2) else {
        return Err(KindError::Input(format!(
            "a ladder of rungs {:?}; a slope needs at least three",
            ladder.meta.counts
        )));
    };
    let square = |a: f32, b: f32| {
        let d = (f64::from(a) - f64::from(b)) * factor;
        d * d
    };
    let mse = below
        .iter()
        .map(|rung| {
            let pairs = rung.image.data().iter().zip(last.image.data());
            pairs.map(|(a, b)| square(*a, *b)).sum::<f64>() / rung.image.data().len() as f64
        })
        .collect();
    let mut pixels: Vec<f64> = ladder
        .variance
        .data()
        .chunks_exact(3)
        .map(|rgb| rgb.iter().map(|v| f64::from(*v)).sum::<f64>() * factor * factor / 3.0)
        .collect();
    // Smallest last, whatever their places: the sum's bits are those of its order.
    pixels.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = pixels.iter().sum();
    let count = pixels.len();
    Ok(Measured {
        mse,
        variance: total / count as f64,
        tail_share: top_share(pixels),
        mean_path_length: ladder.meta.mean_path_length,
        rejected: ladder.meta.rejected,
    })
}

fn summarise(counts: &[u64], scenes: &[(String, Measured)]) -> Convergence {
    let mut groups: BTreeMap<&str, Vec<&Measured>> = BTreeMap::new();
    for (stratum, measured) in scenes {
        groups.entry(stratum).or_default().push(measured);
    }
    let all: Vec<&Measured> = scenes.iter().map(|(_, m)| m).collect();
    Convergence {
        reference_spp: counts[counts.len() - 1],
        counts: counts[..counts.len() - 1].to_vec(),
        overall: row("all", counts, &all),
        strata: groups.into_iter().map(|(stratum, of)| row(stratum, counts, &of)).collect(),
    }
}

fn row(stratum: &str, counts: &[u64], scenes: &[&Measured]) -> ConvergenceRow {
    let n_max = counts[counts.len() - 1] as f64;
    let below = &counts[..counts.len() - 1];
    let mean = |of: &dyn Fn(&Measured) -> f64| scenes.iter().map(|m| of(m)).sum::<f64>() / scenes.len() as f64;
    // A scene without any noise at a rung has no logarithm there; the floor is far below every real error.
    let geometric = |of: &dyn Fn(&Measured) -> f64| exp(mean(&|m| 0.5 * log(of(m).max(1e-24))));
    let rmse: Vec<f64> = (0..below.len()).map(|k| geometric(&|m| m.mse[k])).collect();
    let law = below.iter().map(|n| geometric(&|m| m.variance * (1.0 / *n as f64 - 1.0 / n_max))).collect();
    let points: Vec<(f64, f64)> =
        below.iter().zip(&rmse).map(|(n, e)| (log(*n as f64), log(e / (1.0 - *n as f64 / n_max).sqrt()))).collect();
    let tail_share = mean(&|m| m.tail_share);
    ConvergenceRow {
        stratum: stratum.to_owned(),
        scenes: scenes.len() as u64,
        rmse,
        law,
        slope: slope(&points),
        tail_share,
        heavy_tail: tail_share > 0.5,
        mean_path_length: mean(&|m| m.mean_path_length),
        rejected: scenes.iter().map(|m| m.rejected).sum(),
    }
}

/// Share of the sum that is in the largest 1% of values.
pub(crate) fn top_share(mut values: Vec<f64>) -> f64 {
    values.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = values.iter().sum();
    let top: f64 = values.iter().take(values.len().div_ceil(100)).sum();
    if total > 0.0 { top / total } else { 0.0 }
}

/// Slope by least squares.
pub(crate) fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (x, y) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let sxy: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let sxx: f64 = points.iter().map(|p| (p.0 - x) * (p.0 - x)).sum();
    sxy / sxx
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{
        Image,
        ladder::{LadderMeta, Rung},
        rng::Stream,
    };

    /// A ladder of normal samples about 1, of standard deviation `sigma`.
    fn ladder(sigma: f64, seed: u64) -> Ladder {
        let counts: Vec<u64> = (0..=6).map(|i| 1 << i).collect();
        let (width, height) = (24, 24);
        let mut rungs: Vec<Rung> =
            counts.iter().map(|spp| Rung { spp: *spp, image: Image::new(width, height, 3) }).collect();
        let mut variance = Image::new(width, height, 3);
        let mut stream = Stream::new(seed, &[]);
        for at in 0..width * height * 3 {
            let (mut sum, mut squares) = (0.0, 0.0);
            for n in 1..=64u64 {
                let sample = 1.0 + sigma * stream.normal();
                sum += sample;
                squares += sample * sample;
                if n.is_power_of_two() {
                    rungs[n.trailing_zeros() as usize].image.data_mut()[at] = (sum / n as f64) as f32;
                }
            }
            variance.data_mut()[at] = ((squares - sum * sum / 64.0) / 63.0) as f32;
        }
        let meta = LadderMeta { counts, width, height, rejected: 0, mean_path_length: 2.0 };
        Ladder { meta, rungs, variance }
    }

    #[test]
    fn normal_samples_keep_the_law() {
        let scenes: Vec<(String, Measured)> = (0..4)
            .map(|i| ("L0-open".to_owned(), measure(&ladder(0.1 * (i + 1) as f64, i), 2.0).expect("enough rungs")))
            .collect();
        let counts: Vec<u64> = (0..=6).map(|i| 1 << i).collect();
        let result = summarise(&counts, &scenes);
        assert_eq!((result.reference_spp, result.counts.len(), result.strata.len()), (64, 6, 1));
        let row = &result.strata[0];
        assert!((row.slope + 0.5).abs() < 0.01, "{}", row.slope);
        assert!(!row.heavy_tail && row.tail_share < 0.05);
        for (rmse, law) in row.rmse.iter().zip(&row.law) {
            assert!((rmse / law - 1.0).abs() < 0.03, "{rmse} {law}");
        }
    }

    #[test]
    fn a_few_wild_pixels_are_flagged() {
        let mut wild = ladder(0.1, 9);
        wild.variance.data_mut()[..9].fill(1e4);
        assert!(measure(&wild, 1.0).expect("enough rungs").tail_share > 0.9);
        wild.rungs.truncate(2);
        assert!(measure(&wild, 1.0).is_err());
    }
}
