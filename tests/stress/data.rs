//! Empty strata, ladders without noise, and maps with broken texels: what kinds make of data that lack something.

use super::{Hazard, held};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Artifact, Blobs, Collection, Context, Digest, FILE_PORT, Files, ItemKey, Kind, KindError, Media,
    MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Image, IntegratorKind, Regime, SamplerKind, Stratum,
    image_io::write_exr,
    records::{
        Asset, AssetBody, AssetReport, BASIC, Convergence, Evaluation, Exposure, Ladder, LadderMeta, Metrics, Rung,
        SceneRecord, SceneScores, Score,
    },
    rng::Stream,
};
use tauflow_eval::{EvaluationKind, EvaluationParams, TimeErrorKind, TimeErrorParams};
use tauflow_render::convergence::{ConvergenceKind, ConvergenceParams};
use tauflow_scene::{StratifiedSampling, StratifiedSamplingParams};
use tauflow_scene_readers::{Assets, AssetsParams};

const AREA: &str = "Strata, ladders and files";

type Add<'a> = &'a mut dyn FnMut(&str, &str, Result<String, String>);

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: &str, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    strata(&mut add);
    scores(&mut add);
    constant_ladders(&mut add);
    maps(&mut add);
    out
}

/// Runs a kind that sees whole collections.
fn run<K: Kind>(
    blobs: &MemoryBlobs,
    params: K::Params,
    all: &[(&'static str, &Collection)],
) -> Result<Outputs, String> {
    let stop = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &stop);
    let all = all.iter().copied().collect();
    let action = Action { params, item: None, group: "main", seed: 1, each: BTreeMap::new(), all };
    K::run(&ctx, &action).map_err(|e: KindError| e.to_string())
}

/// The one item of a port, read.
fn read<T: serde::de::DeserializeOwned>(blobs: &MemoryBlobs, outputs: &Outputs, port: &str) -> Result<T, String> {
    let stop = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &stop);
    let (_, artifact) = outputs.collections[port].iter().next().ok_or("no item")?;
    ctx.json(artifact, "").map_err(|e| e.to_string())
}

/// That an error says all this.
fn refused<T>(outcome: Result<T, String>, words: &[&str], came: &str) -> Result<String, String> {
    match outcome {
        Err(told) => {
            let all = words.iter().all(|word| told.contains(word));
            held(all, if all { came.into() } else { told })
        }
        Ok(_) => Err("accepted".into()),
    }
}

fn strata(add: Add<'_>) {
    let blobs = MemoryBlobs::default();
    let pool: Collection = Stratum::all()
        .filter(|stratum| stratum.to_string() != "L2-open")
        .flat_map(|stratum| (0..3).map(move |i| stratum.item_key(i)))
        .map(|key| {
            let digest = Digest::of(key.as_str().as_bytes());
            (key, Artifact::blob(SceneRecord::NAME, digest))
        })
        .collect();
    let sample = |params, pool: &Collection| run::<StratifiedSampling>(&blobs, params, &[("train", pool)]);
    let params = || StratifiedSamplingParams { train: 24, ..Default::default() };
    add(
        "sampling from a pool without a scene of L2-open",
        "refused, with the stratum and the number of missing scenes",
        refused(
            sample(params(), &pool),
            &["L2-open on the train side: 0 of 2", "allow_short"],
            "refused, with the stratum and the remedy",
        ),
    );
    let came = sample(StratifiedSamplingParams { allow_short: true, ..params() }, &pool).and_then(|outputs| {
        let report: serde_json::Value = read(&blobs, &outputs, "report")?;
        let told = report["short"].as_array().is_some_and(|short| short.len() == 1)
            && report["train"]["strata"]["L2-open"]["chosen"] == 0;
        held(told && outputs.collections["train"].len() == 22, "22 of 24, and the report says which are missing".into())
    });
    add("the same with `allow_short`", "the available scenes, and a report of the missing ones", came);
    let came = sample(StratifiedSamplingParams { allow_short: true, ..params() }, &Collection::default()).and_then(
        |outputs| {
            let report: serde_json::Value = read(&blobs, &outputs, "report")?;
            let told = report["short"].as_array().is_some_and(|short| short.len() == 12);
            held(told && outputs.collections["train"].is_empty(), "none, and all twelve strata are reported".into())
        },
    );
    add("an empty pool, with `allow_short`", "none, and a report that says so", came);
    add(
        "an empty pool",
        "refused with a specific error",
        refused(
            sample(params(), &Collection::default()),
            &["L0-environment", "L3-enclosed"],
            "refused, with all twelve strata",
        ),
    );
    let only = StratifiedSamplingParams { regimes: vec![Regime::L2], ..params() };
    add(
        "sampling 24 scenes of one regime, more than the pool has",
        "refused, with each stratum that lacks scenes",
        refused(sample(only, &pool), &["L2-environment", "L2-open", "L2-enclosed"], "refused, with all three"),
    );
}

fn scores(add: Add<'_>) {
    let blobs = MemoryBlobs::default();
    let none = Collection::default();
    let params = EvaluationParams { resamples: 100 };
    add(
        "an evaluation of no scenes",
        "refused",
        refused(
            run::<EvaluationKind>(&blobs, params.clone(), &[("scores", &none), ("hold", &none)]),
            &["no scores"],
            "refused: there are no scores",
        ),
    );
    let all = [("references", &none), ("exposure", &none), ("ladders", &none), ("render_times", &none)];
    let came = run::<TimeErrorKind>(&blobs, TimeErrorParams::default(), &all);
    add("error against time of no scenes", "refused", refused(came, &["no scenes"], "refused: there are no scenes"));
    let came = run::<ConvergenceKind>(&blobs, ConvergenceParams {}, &all[..3]);
    add("convergence of no ladders", "refused", refused(came, &["no references"], "refused: there are no references"));
    // One scene: nothing to resample, one stratum of twelve.
    let metrics = |psnr: f64| Metrics {
        hdr_psnr: psnr,
        hdr_psnr_max: psnr,
        hdr_mae: 0.1,
        preview_psnr: psnr,
        preview_mae: 0.1,
        ssim: 0.5,
        ..Metrics::default()
    };
    let scored = |key: &str, method: &str, nfe: u64, psnr: f64| -> Collection {
        let score = Score { method: method.into(), from_spp: 1, to_spp: 8, nfe, metrics: metrics(psnr) };
        let scores = SceneScores { reference_spp: 8, scores: vec![score], note: None };
        let stop = AtomicBool::new(false);
        let stored = scores.store(&Context::new(&blobs, &Silent, &stop)).expect("memory");
        [(ItemKey::new(key).expect("plain"), stored.into_artifact())].into_iter().collect()
    };
    let hold = scored("L1-open-000000", "hold", 0, 20.0);
    let cell = scored("parameterization=mc_noise/L1-open-000000", "mc_noise", 1, f64::INFINITY);
    let came = run::<EvaluationKind>(&blobs, params, &[("scores", &cell), ("hold", &hold)]).and_then(|outputs| {
        let found: Evaluation = read(&blobs, &outputs, "tables")?;
        let at = &found.methods[0].at[0];
        let finite = BASIC.iter().all(|name| {
            let estimate = &at.gain[*name];
            [estimate.mean, estimate.low, estimate.high].iter().all(|v| v.is_finite())
        });
        held(
            finite && at.strata.len() == 1,
            "finite means; eleven strata are omitted from the table, not counted as zero".into(),
        )
    });
    add(
        "an evaluation of one scene, whose image equals its reference",
        "finite means and intervals, for its stratum only",
        came,
    );
}

/// A ladder of images of one value, with the variance of its samples; `noise` moves each rung by chance.
fn ladder(counts: &[u64], value: f32, noise: f32, seed: u64) -> Ladder {
    let mut stream = Stream::new(seed, &[]);
    let mut image = |n: u64| {
        let scale = noise / (n as f32).sqrt();
        let data = (0..12 * 12 * 3).map(|_| value + scale * stream.normal() as f32).collect();
        Image::from_data(12, 12, 3, data).expect("fits")
    };
    Ladder {
        rungs: counts.iter().map(|spp| Rung { spp: *spp, image: image(*spp) }).collect(),
        meta: LadderMeta {
            counts: counts.to_vec(),
            width: 12,
            height: 12,
            rejected: 0,
            mean_path_length: 1.0,
            sampler: SamplerKind::Independent,
            integrator: IntegratorKind::Path,
            estimated_error: None,
        },
        variance: Image::from_data(12, 12, 3, vec![noise * noise; 12 * 12 * 3]).expect("fits"),
    }
}

/// What `convergence` says of ladders and their references.
pub(super) fn converged(pairs: &[(Ladder, Ladder)]) -> Result<Convergence, String> {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let (mut ladders, mut references, mut exposure) = (Vec::new(), Vec::new(), Vec::new());
    for (i, (ladder, reference)) in pairs.iter().enumerate() {
        let key = ItemKey::new(format!("L0-open-{i:06}")).expect("plain");
        ladders.push((key.clone(), ladder.store(&ctx).map_err(|e| e.to_string())?.into_artifact()));
        references.push((key.clone(), reference.store(&ctx).map_err(|e| e.to_string())?.into_artifact()));
        let factor = Exposure { factor: 1.0, ev: 0.0, mean_luminance: 0.18 };
        exposure.push((key, factor.store(&ctx).map_err(|e| e.to_string())?.into_artifact()));
    }
    let [ladders, references, exposure] =
        [ladders, references, exposure].map(|of| of.into_iter().collect::<Collection>());
    let all = [("references", &references), ("ladders", &ladders), ("exposure", &exposure)];
    // JSON has no NaN: a number that is none would be read as missing, and refused.
    read(&blobs, &run::<ConvergenceKind>(&blobs, ConvergenceParams {}, &all)?, "convergence")
}

/// Every number of it.
pub(super) fn numbers(found: &Convergence) -> impl Iterator<Item = f64> + '_ {
    let row = &found.overall;
    let errors = row.rmse.iter().chain(&row.law).chain(&row.off_normal);
    let errors = errors.chain(found.scenes.iter().flat_map(|scene| &scene.image)).copied();
    let law = row.mean.iter().chain(row.covariance.iter().flatten());
    let law = law.chain(found.scenes.iter().flat_map(|scene| &scene.variance)).flat_map(|r| [r.value, r.error, r.z]);
    let sde = found.sde.iter().flat_map(|r| [&r.mean, &r.variance].into_iter().chain(&r.covariance));
    let sde = sde.flat_map(|r| [r.sde, r.ladders, r.z]);
    let slopes = found.scenes.iter().filter_map(|scene| scene.slope.as_ref()).chain(row.slope.as_ref());
    errors.chain(law).chain(sde).chain(slopes.flat_map(|slope| [slope.mean, slope.low, slope.high]))
}

fn constant_ladders(add: Add<'_>) {
    for (name, values, noise) in [
        ("ladders of black images", [0.0f32, 0.0], [0.0f32, 0.0]),
        ("ladders of constant images", [0.7, 0.7], [0.0, 0.0]),
        ("a ladder of constant images and a ladder with noise", [0.7, 0.7], [0.0, 0.1]),
        ("constant ladders whose references are off by 1", [0.7, 1.7], [0.0, 0.0]),
    ] {
        let pairs = noise.map(|noise| {
            // Estimates of one variance differ between streams, unless there is none.
            let mut reference = ladder(&[128], values[1], noise, 2);
            reference.variance.data_mut().iter_mut().for_each(|v| *v *= 1.01);
            (ladder(&[1, 2, 4, 8], values[0], noise, 1), reference)
        });
        let quiet = noise.iter().filter(|noise| **noise == 0.0).count();
        let came = converged(&pairs).and_then(|found| {
            let row = &found.overall;
            let (slope, told) = match row.slope {
                Some(slope) => ((slope.mean + 0.5).abs() < 0.1, format!("a slope of {:.2}", slope.mean)),
                None => (quiet == pairs.len(), "no slope".into()),
            };
            let rungs = if quiet == pairs.len() { 0 } else { 4 };
            let law = row.rmse.iter().zip(&row.law).all(|(rmse, law)| (rmse / law - 1.0).abs() < 0.2);
            held(
                numbers(&found).all(f64::is_finite)
                    && slope
                    && law
                    && (row.rmse.len(), row.law.len()) == (rungs, rungs)
                    && row.noiseless == quiet as u64,
                format!("finite; {told}, {} of {} scenes without noise", row.noiseless, row.scenes),
            )
        });
        add(
            &format!("convergence of {name}"),
            "finite figures; errors and a slope near -1/2 of scenes with noise only, the others counted",
            came,
        );
    }
}

/// Imports a file: the report of it, what holds its blobs, and what was made of it.
pub(super) fn import(name: &str, bytes: &[u8]) -> Result<(AssetReport, MemoryBlobs, Option<AssetBody>), String> {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let file = Files([("file".to_owned(), bytes.to_vec())].into()).store(&ctx).expect("memory").into_artifact();
    let key = ItemKey::new(name).expect("plain");
    let (each, all) = (BTreeMap::from([(FILE_PORT, &file)]), BTreeMap::new());
    let params = AssetsParams::default();
    let outputs = Assets::run(&ctx, &Action { params, item: Some(&key), group: "main", seed: 0, each, all })
        .map_err(|e| e.to_string())?;
    let report = AssetReport::load(&ctx, &outputs.items["reports"]).map_err(|e| e.to_string())?;
    let asset = outputs.items.get("assets").map(|asset| Asset::load(&ctx, asset)).transpose();
    let body = asset.map_err(|e| e.to_string())?.map(|asset| asset.body);
    Ok((report, blobs, body))
}

/// Imports a map of 1 everywhere but for its first values.
fn imported(values: &[f32]) -> Result<(AssetReport, Option<Image>), String> {
    let mut map = Image::from_data(8, 4, 3, vec![1.0; 96]).expect("fits");
    map.data_mut()[..values.len()].copy_from_slice(values);
    let folder = tempfile::tempdir().map_err(|e| e.to_string())?;
    let path = folder.path().join("sky.exr");
    write_exr(&path, &[("", &map)]).map_err(|e| e.to_string())?;
    let bytes = std::fs::read(&path).map_err(|e| e.to_string())?;
    let (report, blobs, body) = import("sky.exr", &bytes)?;
    let image = |body| -> Result<Image, String> {
        let AssetBody::Hdri { image, .. } = body else { return Err("no map".into()) };
        let bytes = blobs.get(&image).map_err(|e| e.to_string())?.ok_or("not stored")?;
        Image::from_bytes(&bytes).map_err(|e| e.to_string())
    };
    Ok((report, body.map(image).transpose()?))
}

fn maps(add: Add<'_>) {
    let came =
        imported(&[f32::NAN, -1.0, f32::INFINITY, f32::NEG_INFINITY, 65504.0, 3.0]).and_then(|(report, image)| {
            let image = image.ok_or("refused")?;
            let repaired: Vec<u64> = report.repairs.values().copied().collect();
            // By name: infinite, NaN, negative (one of them infinitely), texels.
            let told = repaired == [1, 1, 2, 2] && report.notes.iter().any(|note| note.contains("1 texels at 65504"));
            let mended = image.data()[..6] == [0.0, 0.0, 65504.0, 0.0, 65504.0, 3.0];
            held(
                told && mended,
                if told && mended {
                    "each repaired and counted; the texel at the limit is noted".into()
                } else {
                    format!("{report:?}")
                },
            )
        });
    add(
        "import of an environment map with NaN, -1, infinities of both signs, and the limit of half precision",
        "0, 0, the largest finite value and 0, each counted; a note on the limit",
        came,
    );
    let came = imported(&[f32::NAN; 96]).and_then(|(report, image)| {
        held(
            image.is_none() && report.reason.is_some_and(|r| r.contains("no texel holds any light")),
            "refused with a specific error".into(),
        )
    });
    add("import of an environment map of only NaN", "refused with a specific error", came);
}
