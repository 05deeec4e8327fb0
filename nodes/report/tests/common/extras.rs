//! The rest of the material: losses, gate, split, sampling, bridge, timings.

use super::{CONDITIONINGS, LAST, METHODS, NFE, cell_key, item};
use std::collections::BTreeMap;
use tauflow_contract::{Artifact, Collection, Context, ItemKey, MemoryBlobs, Silent};
use tauflow_data::{
    Image, IntegratorKind, SamplerKind, Stratum,
    image_io::encode_png,
    maths::{exp, log2},
    methods::{HOLD, LOCAL_DELTA, LOCAL_STEP, OIDN, PATH_TRACER, Parameterization},
    records::{
        AgainstLaw, Beside, Bridge, BridgeClock, BridgeFiles, BridgeRow, BridgeSummary, Convergence, ConvergenceRow,
        Estimate, Ladder, LadderMeta, MomentsRow, PictureStatistics, Quota, Rollout, RolloutState, Rung,
        SamplingReport, SceneConvergence, SceneGroup, SceneStatistics, SdeRow, Sides, SplitReport, StratumQuota,
        TimeError, TimeTo, TimedMethod, TimedPoint, TimedScene, TimedSummary, TrainingLog, TrainingPoint,
        TrainingTiming, Verdict, VersusRendering,
    },
    rng::Stream,
    scene::Side,
};

fn around(mean: f64, half: f64) -> Estimate {
    Estimate { mean, low: mean - half, high: mean + half }
}

fn cells() -> impl Iterator<Item = (&'static str, &'static str)> {
    CONDITIONINGS.into_iter().flat_map(|c| METHODS.into_iter().map(move |m| (m, c)))
}

fn losses(ctx: &Context<'_>) -> Collection {
    let log = |method: &str, conditioning: &str| {
        let mut stream = Stream::new(9, &[]).part(method).part(conditioning);
        let floor = if conditioning == CONDITIONINGS[1] { 0.11 } else { 0.14 };
        let point = |step: u64, stream: &mut Stream| {
            let loss = floor + 0.9 * exp(-(step as f64) / 220.0);
            TrainingPoint {
                step,
                train: (step > 0).then(|| loss * (1.0 + 0.12 * stream.normal())),
                gain: Some(3.5),
                test: Some(loss * 1.08),
                learning_rate: 2e-4,
                gradient_norm: None,
            }
        };
        TrainingLog {
            parameterization: method.into(),
            conditioning: conditioning.into(),
            space: "linear".into(),
            preset: "tiny".into(),
            weights: if conditioning == CONDITIONINGS[1] { 118_211 } else { 117_347 },
            steps: 1500,
            params: serde_json::Map::from_iter([
                ("batch".to_owned(), 8.into()),
                ("parameterization".to_owned(), method.into()),
                ("steps".to_owned(), 1500.into()),
            ]),
            points: (0..=30).map(|i| point(i * 50, &mut stream)).collect(),
        }
    };
    cells().map(|(m, c)| item(ctx, &cell_key(m, c), &log(m, c))).collect()
}

fn timings(ctx: &Context<'_>) -> Collection {
    let timing = |i: usize| TrainingTiming {
        steps: 1500,
        seconds: 61.3 + i as f64,
        median_step_ms: 40.2 + 0.6 * i as f64,
        threads: 2,
        machine: serde_json::json!({ "processor": "Abacus <9>", "cores": 2, "identity": "0123456789abcdef" }),
    };
    cells().enumerate().map(|(i, (m, c))| item(ctx, &format!("{}/timing", cell_key(m, c)), &timing(i))).collect()
}

fn verdicts(ctx: &Context<'_>) -> Collection {
    let mut out = Collection::default();
    for (s, stratum) in Stratum::all().enumerate() {
        for i in 0..10 {
            let reasons: &[&str] = match (s * 10 + i) % 17 {
                3 => &["black"],
                8 if s > 6 => &["over_exposed", "near_constant"],
                11 if s > 2 => &["near_constant"],
                _ => &[],
            };
            let verdict = Verdict { reasons: reasons.iter().map(|r| (*r).into()).collect(), measures: BTreeMap::new() };
            out.items.extend([item(ctx, stratum.item_key(i as u64).as_str(), &verdict)]);
        }
    }
    out
}

/// A preview for each verdict.
fn previews(ctx: &Context<'_>, verdicts: &Collection) -> Collection {
    let sampler = SamplerKind::Independent;
    let meta = LadderMeta {
        counts: vec![32],
        width: 6,
        height: 4,
        rejected: 0,
        mean_path_length: 2.0,
        sampler,
        integrator: IntegratorKind::Path,
        estimated_error: None,
    };
    let preview = |(number, (key, _)): (usize, (&ItemKey, &Artifact))| {
        let image = Image::new(6, 4, 3).map(|_| 0.01 * number as f32);
        let rungs = vec![Rung { spp: 32, image: image.clone() }];
        item(ctx, key.as_str(), &Ladder { meta: meta.clone(), rungs, variance: image })
    };
    verdicts.iter().enumerate().map(preview).collect()
}

fn split() -> SplitReport {
    let group = |n: usize| SceneGroup {
        signature: n.to_string(),
        side: Side::Train,
        items: (0..1 + usize::from(n == 0)).map(|k| format!("{n}-{k}")).collect(),
    };
    SplitReport {
        groups: (0..106).map(group).collect(),
        quantum: 0.05,
        sides: Sides { train: 72, test: 36 },
        strata: Stratum::all().map(|s| (s.to_string(), Sides { train: 6, test: 3 })).collect(),
        leaks: Vec::new(),
        dropped: Vec::new(),
    }
}

fn sampling() -> SamplingReport {
    let side = |n: u64| {
        let quota = StratumQuota { wanted: n, available: n + 1, chosen: n };
        let strata = Stratum::all().map(|s| (s.to_string(), quota)).collect();
        Quota { wanted: 12 * n, chosen: 12 * n, equal: true, strata }
    };
    SamplingReport { train: side(4), test: side(2), short: Vec::new(), notes: Vec::new() }
}

fn bridge() -> BridgeFiles {
    let (mut rows, mut summary) = (Vec::new(), Vec::new());
    for (stop, ks) in [("adjacent", 1..=9u64), ("direct", 1..=8)] {
        let methods = [
            (HOLD, 0.0),
            (LOCAL_DELTA, -0.9),
            (LOCAL_STEP, 0.8),
            (Parameterization::McNoise.name(), 2.1),
            ("mc_noise+log1p", 2.0),
            ("mc_noise+log1p+reference", 2.4),
            ("stochastic+reference", -0.5),
        ];
        for (method, lead) in methods {
            let moments = method.starts_with("stochastic").then(|| MomentsRow {
                variance: around(1.02, 0.04),
                real_variance: around(1.01, 0.03),
                excess: around(0.01, 0.05),
                covariance: around(0.99, 0.04),
                real_covariance: around(1.0, 0.03),
                covariance_excess: around(-0.01, 0.05),
            });
            let n = ks.clone().count() as f64;
            let mut sum = 0.0;
            for k in ks.clone() {
                let gain = lead * (1.0 - 0.08 * k as f64);
                let base = if stop == "adjacent" { 20.0 + 5.6 * log2(k as f64) } else { 17.0 + 3.2 * log2(k as f64) };
                sum += base + gain;
                rows.push(BridgeRow {
                    stop: stop.into(),
                    method: method.into(),
                    from_spp: k,
                    to_spp: if stop == "adjacent" { k + 1 } else { 10 },
                    fraction: 0.7 / k as f64,
                    psnr: around(base + gain, 1.1),
                    gain: around(gain, 0.3),
                    moments: moments.clone(),
                });
            }
            summary.push(BridgeSummary {
                stop: stop.into(),
                method: method.into(),
                cases: 10 * n as u64,
                psnr: around(sum / n, 0.9),
                gain: around(lead * 0.6, 0.25),
                better: if method == HOLD { 0.0 } else { 0.87 },
            });
        }
    }
    let setting = BTreeMap::from([("space".to_owned(), "log1p".to_owned())]);
    let (claims, cases) = (Vec::new(), Vec::new());
    let bridge = Bridge { n_max: 256, scenes: 10, groups: None, setting, rows, summary, claims, cases };
    let mut maps = BTreeMap::new();
    for scene in ["L0-open-000003", "L3-enclosed-000011"] {
        for (i, stop) in
            ["adjacent-01", "adjacent-02", "adjacent-03", "direct-01", "strip-adjacent-01"].into_iter().enumerate()
        {
            let mut stream = Stream::new(i as u64, &[]).part(scene);
            let mut image = Image::new(3 * 32 + 4, 2 * 32 + 2, 3);
            image.data_mut().iter_mut().for_each(|v| *v = stream.uniform() as f32);
            maps.insert(format!("{scene}/{stop}.png"), encode_png(&image).expect("3 channels"));
        }
    }
    BridgeFiles { bridge, cases_csv: b"scene,stop\n".to_vec(), maps }
}

fn statistics(ctx: &Context<'_>) -> Collection {
    let mut stream = Stream::new(11, &[]);
    let scenes = Stratum::all().flat_map(|s| (0..3).map(move |i| (s, i)));
    scenes
        .map(|(stratum, i)| {
            let of = SceneStatistics {
                mean_path_length: 2.0 + f64::from(stratum.context as u8),
                environment_share: 1.0 - 0.5 * f64::from(stratum.context as u8),
                diffuse_share: stream.uniform(),
                refractive_share: stream.uniform(),
                caustic_share: 0.01 * f64::from(i),
                relative_rmse: 0.4 + stream.uniform(),
                slope: (i != 1).then_some(-0.5),
                tail_share: 0.1,
                samples_to_percent: Some(900.0),
                depth_discontinuities: 0.1,
                normal_discontinuities: 0.2,
                picture: PictureStatistics {
                    edge_density: 0.2,
                    spectrum_slope: None,
                    saturation: 0.1,
                    saturation_spread: 0.0,
                    hue_entropy: 0.5,
                    log_luminance_spread: 1.0,
                    log_contrast: 0.25,
                },
                spp: [128, 2048],
                rejected: 0,
                dropped: u64::from(i == 2),
            };
            item(ctx, &format!("{stratum}-{i:06}"), &of)
        })
        .collect()
}

/// Rendering alone, a solver that is 10 times as fast, and a denoiser between them.
fn time_error() -> TimeError {
    let summary = |wall: f64, mse: f64, own: bool| TimedSummary {
        scenes: 24,
        groups: None,
        wall_s: [0.9 * wall, wall, 1.2 * wall],
        cpu_s: [1.8 * wall, 1.9 * wall, 2.4 * wall],
        mse,
        rel_mse: 3.0 * mse,
        hdr_psnr: -4.3 * mse.ln(),
        preview_psnr: 5.0 - 4.3 * mse.ln(),
        ssim: 0.9,
        crossover_spp: (!own).then(|| Estimate { mean: 1.0 / mse, low: 0.8 / mse, high: 1.25 / mse }),
        extrapolated: if mse < 0.03 && !own { 0.25 } else { 0.0 },
        speed_up: (!own).then_some(Estimate { mean: 10.0, low: 8.0, high: 12.5 }),
    };
    let scene = |scene: String, wall: f64, mse: f64, own: bool| TimedScene {
        scene,
        wall_s: [0.9 * wall, wall, 1.1 * wall],
        cpu_s: [1.8 * wall, 1.9 * wall, 2.0 * wall],
        mse,
        rel_mse: 3.0 * mse,
        hdr_psnr: -4.3 * mse.ln(),
        preview_psnr: 5.0 - 4.3 * mse.ln(),
        ssim: 0.9,
        unresolved: false,
        crossover_spp: (!own).then_some(1.0 / mse),
        speed_up: (!own).then_some(10.0),
    };
    let point = |from_spp: u64, nfe: u64, wall: f64, mse: f64| {
        let own = nfe == 0;
        let gain = |mean: f64| Estimate { mean, low: 0.5 * mean, high: 1.5 * mean };
        TimedPoint {
            from_spp,
            nfe,
            scenes: Stratum::all()
                .flat_map(|s| (0..2).map(move |i| format!("{s}-{i:06}")))
                .map(|s| scene(s, wall, mse, own))
                .collect(),
            all: summary(wall, mse, own),
            strata: Stratum::all().map(|s| (s.to_string(), summary(wall, mse, own))).collect(),
            versus: (!own).then(|| VersusRendering {
                spp: 3.5,
                hdr_psnr: gain(6.0),
                preview_psnr: gain(7.0),
                ssim: gain(0.1),
                better: 0.97,
            }),
        }
    };
    let targets = || {
        vec![
            TimeTo { metric: "hdr_psnr".into(), target: 30.0, reached: 0.75, wall_s: Some(0.4) },
            TimeTo { metric: "rel_mse".into(), target: 0.001, reached: 0.1, wall_s: None },
        ]
    };
    let method = |method: &str, conditioning: &str, points: Vec<TimedPoint>| TimedMethod {
        method: method.into(),
        conditioning: conditioning.into(),
        cell: BTreeMap::new(),
        points,
        targets: targets(),
        strata_targets: Stratum::all().map(|s| (s.to_string(), targets())).collect(),
    };
    let rendering = (0..8).map(|k| 1u64 << k).map(|n| point(n, 0, 0.01 * n as f64, 1.0 / n as f64)).collect();
    let solver = vec![point(1, 1, 0.012, 0.05), point(1, 2, 0.014, 0.06), point(4, 1, 0.05, 0.02)];
    TimeError {
        groups: None,
        machine: serde_json::json!({ "processor": "Abacus <9>", "cores": 2, "identity": "0123456789abcdef" }),
        reference_spp: 4096,
        scenes: 24,
        resamples: 2000,
        methods: vec![
            method(PATH_TRACER, CONDITIONINGS[0], rendering),
            method(Parameterization::McNoise.name(), CONDITIONINGS[1], solver),
            method(OIDN, CONDITIONINGS[1], vec![point(1, 1, 0.02, 0.04)]),
        ],
        notes: vec!["other: there is no library <here>".into()],
    }
}

fn sde(k: usize, n: u64) -> SdeRow {
    let beside = |value: f64, law: f64| Beside::new([law + 0.01, 0.004], &AgainstLaw::new(value, 0.02, law));
    let covariance = (0..k).map(|i| beside(0.98 + 0.02 * i as f64, 1.0)).collect();
    SdeRow { n, mean: beside(-0.01, 0.0), variance: beside(0.98, 1.0), covariance }
}

fn converging(scene: String, heavy: bool, counts: &[u64]) -> SceneConvergence {
    SceneConvergence {
        scene,
        slope: Some(around(if heavy { -0.43 } else { -0.498 }, 0.03)),
        unresolved: u64::from(heavy),
        variance: counts.iter().map(|_| AgainstLaw::new(1.02, if heavy { 0.4 } else { 0.05 }, 1.0)).collect(),
        excess_kurtosis: Some(if heavy { 900.0 } else { 12.0 }),
        tail_index: heavy.then_some(1.7),
        tail_share: 0.2,
        off_normal: counts.iter().map(|n| 0.3 / (*n as f64).sqrt()).collect(),
        trusted_from: (!heavy).then_some(16),
        image: counts.iter().map(|_| if heavy { 0.4 } else { 1.05 }).collect(),
        image_from: (!heavy).then_some(1),
        heavy_tail: heavy,
        reasons: if heavy { vec!["tail index 1.70, below 2".into(), "kurtosis <b>".into()] } else { Vec::new() },
        trust: "errors of pixels within 10% of normal from 16 samples on".into(),
    }
}

/// A scene in which nothing is drawn by chance.
fn still(scene: String) -> SceneConvergence {
    SceneConvergence {
        slope: None,
        excess_kurtosis: None,
        tail_share: 0.0,
        trusted_from: None,
        image_from: None,
        trust: "no noise".into(),
        ..converging(scene, false, &[])
    }
}

/// A stratum of such scenes alone.
fn all_still(row: ConvergenceRow) -> ConvergenceRow {
    ConvergenceRow {
        noiseless: row.scenes,
        rmse: Vec::new(),
        law: Vec::new(),
        slope: None,
        mean: Vec::new(),
        covariance: Vec::new(),
        excess_kurtosis: None,
        tail_index: None,
        off_normal: Vec::new(),
        trusted_from: None,
        tail_share: 0.0,
        ..row
    }
}

fn convergence() -> Convergence {
    let counts: Vec<u64> = (0..8).map(|i| 1u64 << i).collect();
    let row = |name: String, sigma: f64, heavy: bool, scenes: u64| {
        let law: Vec<f64> = counts.iter().map(|n| sigma / (*n as f64).sqrt()).collect();
        let rmse = law.iter().enumerate().map(|(i, v)| v * (1.0 + if i % 2 == 0 { 0.03 } else { -0.03 })).collect();
        let slope = if heavy { -0.43 } else { -0.498 };
        let slope = Estimate { mean: slope, low: slope - 0.02, high: slope + 0.02 };
        let tail_share = if heavy { 0.64 } else { 0.12 };
        ConvergenceRow {
            stratum: name,
            scenes,
            noiseless: 0,
            unresolved: u64::from(heavy),
            rmse,
            law,
            slope: Some(slope),
            mean: counts.iter().map(|_| AgainstLaw::new(0.01, 0.02, 0.0)).collect(),
            covariance: (0..counts.len())
                .map(|m| vec![AgainstLaw::new(1.0 - 0.02 * m as f64, 0.03, 1.0); m + 1])
                .collect(),
            excess_kurtosis: Some(if heavy { 900.0 } else { 12.0 }),
            tail_index: Some(if heavy { 1.7 } else { 4.2 }),
            off_normal: counts.iter().map(|n| 0.3 / (*n as f64).sqrt()).collect(),
            trusted_from: (!heavy).then_some(16),
            tail_share,
            heavy_scenes: u64::from(heavy) * scenes,
            heavy_tail: heavy,
            mean_path_length: 4.2,
            rejected: 0,
        }
    };
    Convergence {
        reference_spp: 4096,
        sampler: SamplerKind::Independent,
        scenes: (0..2)
            .map(|i| converging(format!("L{}-open-000000", 3 * i), i > 0, &counts))
            .chain([still("L1-environment-000000".into())])
            .collect(),
        sde: counts.iter().enumerate().map(|(k, n)| sde(k, *n)).collect(),
        strata: Stratum::all()
            .map(|s| row(s.to_string(), 0.2 + 0.12 * f64::from(s.regime as u8), s.to_string() == "L3-enclosed", 2))
            .map(|row| if row.stratum == "L1-environment" { all_still(row) } else { row })
            .collect(),
        overall: ConvergenceRow { noiseless: 2, unresolved: 1, ..row("all".into(), 0.38, false, 24) },
        counts,
    }
}

/// The ladders of the test scenes, as they were rendered.
fn ladders(ctx: &Context<'_>, size: usize) -> Collection {
    let meta = LadderMeta {
        counts: vec![1, LAST],
        width: size,
        height: size,
        rejected: 0,
        mean_path_length: 2.0,
        sampler: SamplerKind::Independent,
        integrator: IntegratorKind::Path,
        estimated_error: None,
    };
    let grey = |value: f32| Image::new(size, size, 3).map(|_| value);
    let ladder = |(name, _): (String, Stratum)| {
        let rungs = [1, LAST].map(|spp| Rung { spp, image: grey(0.3) }).into();
        item(ctx, &name, &Ladder { meta: meta.clone(), rungs, variance: grey(0.04) })
    };
    super::scenes().into_iter().map(ladder).collect()
}

/// The states of a solver in some scenes: two calls from the first rung to the last.
fn states(ctx: &Context<'_>, size: usize) -> Collection {
    let method = Parameterization::McNoise.name();
    let state = |nfe: u64, calls: u64| {
        let said = RolloutState { method: method.into(), from_spp: 1, nfe, calls, tau: calls as f64 / nfe as f64 };
        (said, Image::new(size, size, 3).map(|_| 0.2 + 0.1 * calls as f32))
    };
    let rollout = Rollout { clock: BridgeClock::new(1, LAST), states: [state(1, 1), state(2, 1), state(2, 2)].into() };
    let own =
        |(name, _): (String, Stratum)| item(ctx, &format!("{}/{name}", cell_key(method, CONDITIONINGS[1])), &rollout);
    super::scenes().into_iter().step_by(2).map(own).collect()
}

/// Every input of a report, over synthetic material; pictures of `size` x `size` pixels.
pub fn all(blobs: &MemoryBlobs, size: usize) -> BTreeMap<&'static str, Collection> {
    let cancel = std::sync::atomic::AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &cancel);
    let pictures = super::pictures(&ctx, size).expect("memory");
    let evaluation = super::evaluation(pictures.rows);
    assert_eq!(evaluation.nfe, NFE);
    let one = |item: (tauflow_contract::ItemKey, Artifact)| [item].into_iter().collect::<Collection>();
    BTreeMap::from([
        ("evaluation", one(item(&ctx, "evaluation", &evaluation))),
        ("references", pictures.references),
        ("refined", pictures.refined),
        ("losses", losses(&ctx)),
        ("timings", timings(&ctx)),
        ("previews", previews(&ctx, &verdicts(&ctx))),
        ("verdicts", verdicts(&ctx)),
        ("split", one(item(&ctx, "report", &split()))),
        ("sampling", one(item(&ctx, "report", &sampling()))),
        ("bridge", one(item(&ctx, "bridge", &bridge()))),
        ("convergence", one(item(&ctx, "convergence", &convergence()))),
        ("time_error", one(item(&ctx, "time_error", &time_error()))),
        ("statistics", statistics(&ctx)),
        ("ladders", ladders(&ctx, size)),
        ("states", states(&ctx, size)),
    ])
}
