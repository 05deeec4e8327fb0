//! Ladders in which some pixels have no variance at all, black and bright, among such that have: what the whole way
//! from rungs to metrics makes of them.

use super::{
    Hazard, about,
    data::{converged, numbers},
    held,
    learning::{Lab, SIDE, guided, sound},
    networks,
    transport::{Oracle, difference},
};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Artifact, Context, Kind, Media, MemoryBlobs, Silent};
use tauflow_data::{
    Image, IntegratorKind, SamplerKind, VarianceTime,
    records::{Exposure, GBuffer, Ladder, LadderMeta, PackedScene, Rung},
    rng::Stream,
    time::TimeGrid,
};
use tauflow_eval::metrics::metrics;
use tauflow_train::{Course, DatasetPacking, DatasetPackingParams, Loss, Parameterization, Space, rollout, rollout_to};

const AREA: &str = "Ladders with dead pixels";
const COUNTS: [u64; 4] = [1, 2, 4, 8];
/// Radiance of dead pixels: black, ordinary, a lamp.
const DEAD: [f32; 3] = [0.0, 0.7, DEAD_LAMP];
const DEAD_LAMP: f32 = 1e4;
/// What is packed is exposed by this.
const FACTOR: f64 = 0.3;

/// The value of a pixel that is dead: three in ten of them, no two of which touch but at corners.
fn dead(pixel: usize) -> Option<f32> {
    match (pixel % SIDE * 3 + pixel / SIDE * 7) % 10 {
        0 => Some(DEAD[0]),
        1 => Some(DEAD[1]),
        2 => Some(DEAD[2]),
        _ => None,
    }
}

/// Means of samples that are uniform about a ramp, but for the dead pixels.
fn ladder(seed: u64, counts: &[u64]) -> Ladder {
    let mut stream = Stream::new(seed, &[]);
    let mut states = vec![Image::new(SIDE, SIDE, 3); counts.len()];
    let mut variance = Image::new(SIDE, SIDE, 3);
    for at in 0..SIDE * SIDE * 3 {
        let mean = 0.2 + (at / 3 % SIDE) as f64 / SIDE as f64;
        let (mut sum, mut squares) = (0.0, 0.0);
        let most = counts.last().copied().unwrap_or(0);
        for n in 1..=most {
            let sample = dead(at / 3).map_or_else(|| mean * 2.0 * stream.uniform(), f64::from);
            sum += sample;
            squares += sample * sample;
            if let Some(k) = counts.iter().position(|count| *count == n) {
                states[k].data_mut()[at] = (sum / n as f64) as f32;
            }
        }
        let spread = (squares - sum * sum / most as f64) / (most - 1).max(1) as f64;
        variance.data_mut()[at] = if dead(at / 3).is_some() { 0.0 } else { spread as f32 };
    }
    Ladder {
        rungs: counts.iter().zip(states).map(|(spp, image)| Rung { spp: *spp, image }).collect(),
        meta: LadderMeta {
            counts: counts.to_vec(),
            width: SIDE,
            height: SIDE,
            rejected: 0,
            mean_path_length: 1.0,
            sampler: SamplerKind::Independent,
            integrator: IntegratorKind::Path,
            estimated_error: None,
        },
        variance,
    }
}

/// It as `dataset_packing` packs it, with a G-buffer in which black pixels and lamps are black, as such are, and the
/// others textured.
fn packed(ladder: &Ladder) -> Result<PackedScene, String> {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let exposure = Exposure { factor: FACTOR, ev: 0.0, mean_luminance: 0.18 };
    let albedo = (0..SIDE * SIDE).flat_map(|pixel| match dead(pixel) {
        Some(0.0) => [0.0; 3],
        Some(DEAD_LAMP) => [1e-6; 3],
        _ => [0, 1, 2].map(|c| 0.05 + 0.15 * ((pixel + c) % 7) as f32),
    });
    let albedo = Image::from_data(SIDE, SIDE, 3, albedo.collect()).expect("fits");
    let gbuffer = GBuffer { albedo, normal: Image::new(SIDE, SIDE, 3) };
    let stored = || {
        let (ladder, gbuffer, exposure) = (ladder.store(&ctx)?, gbuffer.store(&ctx)?, exposure.store(&ctx)?);
        Ok([ladder.into_artifact(), gbuffer.into_artifact(), exposure.into_artifact()])
    };
    let run = |[ladder, gbuffer, exposure]: [Artifact; 3]| {
        let each = BTreeMap::from([("ladders", &ladder), ("gbuffers", &gbuffer), ("exposure", &exposure)]);
        let params = DatasetPackingParams {};
        let action = Action { params, item: None, group: "main", seed: 0, each, all: BTreeMap::new() };
        let outputs = DatasetPacking::run(&ctx, &action)?;
        PackedScene::load(&ctx, &outputs.items["packed"])
    };
    stored().and_then(run).map_err(|e: tauflow_contract::KindError| e.to_string())
}

/// Its pixels that are dead, or those that are not.
fn pixels(image: &Image, wanted: bool) -> Image {
    let chosen = (0..SIDE * SIDE).filter(|pixel| dead(*pixel).is_some() == wanted);
    let data: Vec<f32> = chosen.flat_map(|pixel| image.pixel(pixel % SIDE, pixel / SIDE).to_vec()).collect();
    Image::from_data(data.len() / 3, 1, 3, data).expect("whole pixels")
}

type Add<'a> = &'a mut dyn FnMut(String, &str, Result<String, String>);

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    let pairs: Vec<_> = (0..3).map(|i| (ladder(i, &COUNTS), ladder(100 + i, &[512]))).collect();
    let came = converged(&pairs).and_then(|found| {
        let slope = found.overall.slope.map_or(f64::NAN, |slope| slope.mean);
        let law = found.overall.law.iter().zip(&found.overall.rmse).map(|(law, rmse)| (rmse / law - 1.0).abs());
        let off = law.fold(0.0, f64::max);
        held(
            numbers(&found).all(f64::is_finite)
                && (slope + 0.5).abs() < 0.05
                && off < 0.1
                && found.overall.noiseless == 0,
            format!("all finite; slope {slope:.2}, errors within {} of the law", about(off)),
        )
    });
    add(
        "convergence of ladders of 16 x 16 pixels, in which a tenth of the pixels is black in every sample, a tenth \
         0.7, and a tenth 1e4"
            .into(),
        "finite errors, slopes and covariances, and the variance law for all other pixels: a slope of -1/2",
        came,
    );
    let scenes: Result<Vec<PackedScene>, String> = pairs.iter().map(|(ladder, _)| packed(ladder)).collect();
    let came = scenes.as_ref().map_err(Clone::clone).and_then(|scenes| {
        let exposed = |pixel: usize| dead(pixel).map(|v| (f64::from(v) * FACTOR) as f32);
        let same = |image: &Image| {
            (0..SIDE * SIDE).all(|at| exposed(at).is_none_or(|v| image.pixel(at % SIDE, at / SIDE) == [v; 3]))
        };
        let states = || scenes.iter().flat_map(|scene| &scene.states);
        held(states().all(same) && states().count() == 12, "the value of the ladder, exposed, in every rung".into())
    });
    add("packing these ladders at exposure 0.3".into(), "dead pixels unchanged, in every rung", came);
    if let Ok(scenes) = &scenes {
        rollouts(scenes, &mut add);
        trainings(scenes, &mut add);
    }
    out
}

/// With exact predictions.
fn rollouts(scenes: &[PackedScene], add: Add<'_>) {
    let clock = VarianceTime::new(COUNTS[0], COUNTS[3]).map_err(|e| e.to_string());
    for space in [Space::Linear, Space::Log1p] {
        let came = clock.clone().and_then(|clock| {
            Parameterization::ALL.into_iter().try_fold([0.0f64; 2], |worst, kind| {
                let (start, clean) = (scenes[0].states[0].clone(), scenes[0].states[3].clone());
                let oracle = Oracle { kind, space, clock, start: start.clone(), clean: clean.clone() };
                [1usize, 9, 1000].into_iter().try_fold(worst, |worst, steps| {
                    let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
                    let end = rollout(&oracle, &start, None, course).map_err(|e| e.to_string())?;
                    let way = rollout_to(&oracle, &start, None, course, 4.0).map_err(|e| e.to_string())?;
                    let moved = [&end, &way].map(|image| difference(&pixels(image, true), &pixels(&start, true)));
                    let live = difference(&pixels(&end, false), &pixels(&clean, false));
                    Ok::<_, String>([worst[0].max(moved[0]).max(moved[1]), worst[1].max(live)])
                })
            })
        });
        let most = if space == Space::Linear { 0.0 } else { 1e-5 };
        let came = came.and_then(|[moved, live]| {
            held(
                moved <= most && live < 1e-3,
                format!(
                    "dead pixels changed by {}, other pixels within {} of the clean image",
                    about(moved),
                    about(live)
                ),
            )
        });
        add(
            format!(
                "all four parameterizations with exact predictions in {} space, 1, 9 and 1,000 steps, to 4 samples and \
                 to the end",
                space.name()
            ),
            if space == Space::Linear {
                "dead pixels unchanged, bit for bit"
            } else {
                "dead pixels unchanged, except for the rounding of logarithms"
            },
            came,
        );
    }
}

/// The farthest that a pixel of each of `DEAD` went: of black in radiance, of the others relative to what they are.
fn moves(end: &Image, start: &Image) -> [f64; 3] {
    DEAD.map(|value| {
        let chosen =
            (0..SIDE * SIDE).filter(|pixel| dead(*pixel) == Some(value)).map(|pixel| (pixel % SIDE, pixel / SIDE));
        let most = chosen
            .flat_map(|(x, y)| end.pixel(x, y).iter().zip(start.pixel(x, y)))
            .map(|(a, b)| f64::from((a - b).abs()))
            .fold(0.0, f64::max);
        if value > 0.0 { most / (f64::from(value) * FACTOR) } else { most }
    })
}

/// With networks that learned on them.
fn trainings(scenes: &[PackedScene], add: Add<'_>) {
    for (space, loss) in [(Space::Linear, Loss::Squared), (Space::Log1p, Loss::Absolute)] {
        for parameterization in Parameterization::ALL {
            let lab = Lab::new();
            let set = lab.scenes(scenes.iter().cloned());
            let params = guided(parameterization, space, loss);
            let came = lab.train_and_test(&set, Some(&set), params).and_then(|outputs| {
                sound(&lab, &outputs)?;
                let model = networks::loaded(&lab, &outputs)?;
                let (start, clean) = (&scenes[0].states[0], &scenes[0].states[3]);
                let course = Course { from: 1, steps: 9, grid: TimeGrid::Ladder };
                let end = rollout(&model, start, scenes[0].gbuffer.as_ref(), course).map_err(|e| e.to_string())?;
                let scores = [metrics(&end, clean), metrics(start, clean)].map(|m| m.map_err(|e| e.to_string()));
                let [after, before] = scores;
                let [after, before] = [after?, before?];
                let finite = [after.hdr_psnr, after.hdr_mae, after.preview_psnr, after.ssim, before.hdr_psnr];
                let dark = end.data().iter().fold(f32::MAX, |least, v| least.min(*v));
                // Each by itself: together, the lamps would hide the rest. A network of 20 steps has not learned to
                // keep them.
                let moved = moves(&end, start);
                let [black, grey, lamp] = moved.map(about);
                held(
                    finite.iter().chain(&moved).all(|v| v.is_finite())
                        && end.data().iter().all(|v| v.is_finite())
                        && dark >= 0.0,
                    format!(
                        "finite losses, gains, images and metrics, nothing negative; in 9 steps black pixels reach at \
                         most {black}, pixels of 0.7 change by at most {grey} of their value, pixels of 1e4 by at most \
                         {lamp} of their value (reported, not tested)"
                    ),
                )
            });
            add(
                format!(
                    "{} of 20 steps in {} space, trained and tested on these ladders, with albedo 0 at black pixels \
                     and 1e-6 at lamps",
                    parameterization.name(),
                    space.name()
                ),
                "finite losses, gains, images and metrics, nothing negative; the change of dead pixels is reported, \
                 not tested",
                came,
            );
        }
    }
}
