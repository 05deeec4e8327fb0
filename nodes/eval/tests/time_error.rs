//! The kind `time_error` over ladders and times in memory: whose time is whose, exposures, references' own noise,
//! refusals.

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Collection, Context, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Image, IntegratorKind, SamplerKind,
    methods::{PATH_TRACER, PATH_TRACER_SOBOL, Parameterization},
    records::{
        Exposure, Ladder, LadderMeta, PackedScene, Refined, RefinedImage, Rung, TimeError, TimedImage, TimedMethod,
        Timing,
    },
    timing::Repeated,
};
use tauflow_eval::{TimeErrorKind, TimeErrorParams};

const MC_NOISE: &str = Parameterization::McNoise.name();
const SIDE: usize = 12;
const SCENES: [&str; 2] = ["L0-open-000000", "L1-enclosed-000003"];
/// Of every scene: what its images are off by is given in exposed radiance.
const FACTOR: f64 = 0.5;

struct Bench {
    blobs: MemoryBlobs,
    stop: AtomicBool,
    ports: BTreeMap<&'static str, Collection>,
}

/// Radiance whose exposed squared error is `mse` everywhere.
fn off(mse: f64) -> Image {
    Image::from_data(SIDE, SIDE, 3, vec![((0.4 + mse.sqrt()) / FACTOR) as f32; SIDE * SIDE * 3]).expect("fits")
}

fn ladder(counts: &[(u64, f64)], sampler: SamplerKind, variance: f32) -> Ladder {
    let rungs = counts.iter().map(|(spp, mse)| Rung { spp: *spp, image: off(*mse) }).collect();
    let counts = counts.iter().map(|(spp, _)| *spp).collect();
    let meta = LadderMeta {
        counts,
        width: SIDE,
        height: SIDE,
        rejected: 0,
        mean_path_length: 2.0,
        sampler,
        integrator: IntegratorKind::Path,
        estimated_error: None,
    };
    let variance = Image::from_data(SIDE, SIDE, 3, vec![variance; SIDE * SIDE * 3]).expect("fits");
    Ladder { meta, rungs, variance }
}

fn timing(method: &str, nfe: u64, times: &[(u64, f64)]) -> Timing {
    let took = |wall: f64| Repeated { wall_s: vec![wall, wall, 9.0], cpu_s: vec![2.0 * wall; 3] };
    let entry = |(spp, wall): &(u64, f64)| TimedImage { method: method.into(), from_spp: *spp, nfe, took: took(*wall) };
    Timing { machine: serde_json::json!({ "processor": "Abacus" }), entries: times.iter().map(entry).collect() }
}

impl Bench {
    /// A path tracer whose squared error is 0.04/n after 0.01 n seconds, and references of 1000 samples.
    fn new() -> Self {
        let mut bench = Self { blobs: MemoryBlobs::default(), stop: AtomicBool::new(false), ports: BTreeMap::new() };
        let counts = [1, 4, 16].map(|n| (n, 0.04 / n as f64));
        for scene in SCENES {
            bench.put("references", scene, &ladder(&[(1000, 0.0)], SamplerKind::Independent, 0.0));
            bench.put("exposure", scene, &Exposure { factor: FACTOR, ev: 0.0, mean_luminance: 0.4 });
            let exposed = |mse: &(u64, f64)| off(mse.1).map(|v| v * FACTOR as f32);
            let states = counts.iter().map(exposed).collect();
            bench.put(
                "ladders",
                scene,
                &PackedScene { counts: vec![1, 4, 16], states, gbuffer: None, sampler: Default::default() },
            );
            bench.put("render_times", scene, &timing(PATH_TRACER, 0, &[(1, 0.01), (4, 0.04), (16, 0.16)]));
        }
        bench
    }

    fn ctx(&self) -> Context<'_> {
        Context::new(&self.blobs, &Silent, &self.stop)
    }

    fn put<M: Media>(&mut self, port: &'static str, key: &str, record: &M) {
        let artifact = record.store(&self.ctx()).expect("memory").into_artifact();
        let before = self.ports.remove(port).unwrap_or_default();
        let item = (ItemKey::new(key).expect("a key"), artifact);
        self.ports.insert(port, before.iter().map(|(k, a)| (k.clone(), a.clone())).chain([item]).collect());
    }

    fn run(&self) -> Result<Outputs, KindError> {
        let all = self.ports.iter().map(|(port, of)| (*port, of)).collect();
        let params = TimeErrorParams { resamples: 100, ..TimeErrorParams::default() };
        let action = Action { params, item: None, group: "main", seed: 3, each: BTreeMap::new(), all };
        TimeErrorKind::run(&self.ctx(), &action)
    }

    fn tables(&self) -> TimeError {
        let outputs = self.run().expect("sound inputs");
        let (_, artifact) = outputs.collections["tables"].iter().next().expect("one item");
        Handle::new(artifact).expect("the port's type").load(&self.ctx()).expect("tables")
    }
}

fn method<'a>(tables: &'a TimeError, name: &str) -> &'a TimedMethod {
    tables.methods.iter().find(|m| m.method == name).unwrap_or_else(|| panic!("no {name}"))
}

fn near(found: f64, expected: f64) {
    assert!((found / expected - 1.0).abs() < 1e-3, "{found}, expected {expected}");
}

#[test]
fn other_samplers_and_renderers_take_their_own_time_and_are_exposed() {
    let mut bench = Bench::new();
    for scene in SCENES {
        let key = format!("sampler=sobol/{scene}");
        bench.put("sampled", &key, &ladder(&[(1, 0.04), (4, 0.0025)], SamplerKind::Sobol, 0.0));
        // A rung that was not timed is left away.
        bench.put("rendered_times", &key, &timing(PATH_TRACER, 0, &[(4, 0.05)]));
        let said = RefinedImage { method: "mitsuba".into(), from_spp: 4, to_spp: 4, nfe: 0 };
        let images = vec![(said, off(0.01))];
        bench.put(
            "rendered",
            &format!("method=mitsuba/{scene}"),
            &Refined { images, note: None, ..Default::default() },
        );
        bench.put("rendered_times", &format!("method=mitsuba/{scene}"), &timing("mitsuba", 0, &[(4, 0.08)]));
    }
    // A solver from either sampler, which halves the error in 0.02 s.
    for scene in SCENES {
        for (sampler, mse) in [("independent", 0.01), ("sobol", 0.0025)] {
            let key = format!("sampler={sampler}/{scene}");
            let said = RefinedImage { method: "mc_noise".into(), from_spp: 4, to_spp: 16, nfe: 1 };
            let exposed = off(mse / 2.0).map(|v| v * FACTOR as f32);
            let of = if sampler == "sobol" { SamplerKind::Sobol } else { SamplerKind::Independent };
            bench.put("refined", &key, &Refined { images: vec![(said, exposed)], note: None, sampler: of });
            bench.put("times", &key, &timing("mc_noise", 1, &[(4, 0.02)]));
        }
    }
    let tables = bench.tables();
    let names: Vec<&str> = tables.methods.iter().map(|m| m.method.as_str()).collect();
    assert_eq!(names, [PATH_TRACER, "mc_noise", "mc_noise", "mitsuba", PATH_TRACER_SOBOL]);
    let solvers: Vec<&TimedMethod> = tables.methods.iter().filter(|m| m.method == "mc_noise").collect();
    let took = solvers.iter().map(|m| (m.cell.get("sampler").map(String::as_str), m.points[0].all.wall_s[1]));
    let took: Vec<_> = took.collect();
    assert_eq!((took[0].0, took[1].0), (None, Some("sobol")));
    near(took[0].1, 0.06);
    near(took[1].1, 0.07);
    let sobol = &method(&tables, PATH_TRACER_SOBOL);
    assert!(sobol.cell.is_empty() && sobol.points.len() == 1);
    // Its error at 4 samples is that of the path tracer at 16, after 0.05 s in place of 0.16 s.
    near(sobol.points[0].all.mse, 0.0025);
    near(sobol.points[0].all.wall_s[1], 0.05);
    near(sobol.points[0].all.speed_up.expect("not the path tracer").mean, 3.2);
    near(sobol.points[0].all.crossover_spp.expect("not the path tracer").mean, 16.0);
    // Mitsuba's is that of 4, after twice the time.
    near(method(&tables, "mitsuba").points[0].all.speed_up.expect("not the path tracer").mean, 0.5);
}

#[test]
fn refined_images_take_the_endpoints_time_too() {
    let mut bench = Bench::new();
    for scene in SCENES {
        let key = format!("conditioning=rgb+from=1/{scene}");
        let said = RefinedImage { method: MC_NOISE.into(), from_spp: 1, to_spp: 16, nfe: 2 };
        let images = vec![(said, off(0.01).map(|v| v * FACTOR as f32))];
        bench.put("refined", &key, &Refined { images, note: None, ..Default::default() });
        bench.put("times", &key, &timing(MC_NOISE, 2, &[(1, 0.03)]));
    }
    let tables = bench.tables();
    let point = &method(&tables, MC_NOISE).points[0];
    near(point.all.wall_s[1], 0.04);
    near(point.all.cpu_s[1], 0.08);
    near(point.all.mse, 0.01);
    near(point.all.speed_up.expect("not the path tracer").mean, 1.0);
}

#[test]
fn what_the_references_own_noise_adds_is_taken_off_where_it_is_known() {
    let with = |sampler| {
        let mut bench = Bench::new();
        bench.ports.remove("references");
        for scene in SCENES {
            // Of 1000 samples of exposed variance 0.035, somewhat less than the path tracer's: 0.000035 of every
            // squared error is the reference's.
            let variance = (0.035 / (FACTOR * FACTOR)) as f32;
            bench.put("references", scene, &ladder(&[(1000, 0.0)], sampler, variance));
        }
        let all = bench.tables().methods[0].points[2].all.clone();
        near(all.hdr_psnr, -10.0 * all.mse.log10());
        all.mse
    };
    near(with(SamplerKind::Independent), 0.0025 - 0.000_035);
    near(with(SamplerKind::Sobol), 0.0025);
}

#[test]
fn a_reference_that_is_no_judge_is_refused() {
    let mut bench = Bench::new();
    bench.ports.remove("references");
    for scene in SCENES {
        // The rung of 16 samples, which has noise.
        let last = [(16, 0.04 / 16.0)];
        bench.put("references", scene, &ladder(&last, SamplerKind::Independent, 0.1));
    }
    let error = bench.run().expect_err("its own rung").to_string();
    assert!(error.contains("its own ladder") && error.contains("`stream`"), "{error}");
    // Squares that fall short of what independent samples of this variance would be off by.
    let mut bench = Bench::new();
    bench.ports.remove("references");
    for scene in SCENES {
        let variance = (0.06 / (FACTOR * FACTOR)) as f32;
        bench.put("references", scene, &ladder(&[(1000, 0.0)], SamplerKind::Independent, variance));
    }
    let error = bench.run().expect_err("shared samples").to_string();
    assert!(error.contains("share samples") && error.contains("`stream`"), "{error}");
    let mut bench = Bench::new();
    bench.ports.remove("references");
    for (scene, spp) in SCENES.iter().zip([1000, 2000]) {
        bench.put("references", scene, &ladder(&[(spp, 0.0)], SamplerKind::Independent, 0.0));
    }
    let error = bench.run().expect_err("two counts").to_string();
    assert!(error.contains("1000") && error.contains("2000"), "{error}");
    let mut bench = Bench::new();
    for scene in SCENES {
        let key = format!("sampler=independent/{scene}");
        bench.put("sampled", &key, &ladder(&[(1, 0.04)], SamplerKind::Independent, 0.0));
        bench.put("rendered_times", &key, &timing(PATH_TRACER, 0, &[(1, 0.05)]));
    }
    let error = bench.run().expect_err("the same method twice").to_string();
    assert!(error.contains("sampler=independent") && error.contains("another sampler"), "{error}");
}

#[test]
fn ports_that_do_not_fit_are_told() {
    let mut bench = Bench::new();
    let key = format!("sampler=sobol/{}", SCENES[0]);
    bench.put("sampled", &key, &ladder(&[(1, 0.04)], SamplerKind::Sobol, 0.0));
    let error = bench.run().expect_err("no times").to_string();
    assert!(error.contains("`rendered` or `sampled`") && error.contains("`rendered_times`"), "{error}");
    bench.put("rendered_times", &key, &timing(PATH_TRACER, 0, &[(1, 0.05)]));
    let error = bench.run().expect_err("one scene of two").to_string();
    assert!(error.contains(SCENES[1]) && error.contains("sampler=sobol"), "{error}");
    let mut bench = Bench::new();
    for scene in SCENES {
        let key = format!("sampler=sobol/{scene}");
        bench.put("sampled", &key, &ladder(&[(1, 0.04)], SamplerKind::Sobol, 0.0));
        bench.put("rendered_times", &key, &timing(PATH_TRACER, 0, &[(4, 0.05)]));
    }
    let error = bench.run().expect_err("times of other rungs").to_string();
    assert!(error.contains("`path_tracer_sobol`") && error.contains("was not timed"), "{error}");
}

#[test]
fn times_of_two_machines_are_not_compared_and_that_of_one_is_named() {
    let mut bench = Bench::new();
    let key = format!("sampler=sobol/{}", SCENES[0]);
    for scene in SCENES {
        bench.put("sampled", &format!("sampler=sobol/{scene}"), &ladder(&[(1, 0.04)], SamplerKind::Sobol, 0.0));
        let times = timing(PATH_TRACER, 0, &[(1, 0.05)]);
        bench.put("rendered_times", &format!("sampler=sobol/{scene}"), &times);
    }
    assert_eq!(bench.tables().machine["processor"], "Abacus");
    let other = serde_json::json!({ "processor": "Slide rule", "cores": 1, "identity": "0123456789" });
    bench.put("rendered_times", &key, &Timing { machine: other, ..timing(PATH_TRACER, 0, &[(1, 0.05)]) });
    let error = bench.run().expect_err("two machines").to_string();
    for part in ["times of two machines", "`rendered_times`", "Slide rule, 1 core, id 01234567", "; measure all on one"]
    {
        assert!(error.contains(part), "{part}: {error}");
    }
}
