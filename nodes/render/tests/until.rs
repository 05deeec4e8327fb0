//! Ladders that go on until they are accurate enough.

mod scenes;

use scenes::{Built, balls_under_sky, film, recipe, room};
use serde_json::{Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Mutex, atomic::AtomicBool},
};
use tauflow_contract::{Action, Artifact, Context, Kind, KindRow, Media, MemoryBlobs, NodeKind, Progress};
use tauflow_data::{
    Image, IntegratorKind, Rungs, SamplerKind,
    records::{Ladder, SceneRecord},
};
use tauflow_render::{
    accumulator::{Accumulator, Pixel},
    ladder_rendering::{LadderRendering, LadderRenderingParams},
    quality_gate::geometric_mean_luminance,
    render::{Goal, RenderStats, Renderer, Setup, render_image},
    until::{Until, relative_error},
    world::World,
};

/// Samples that were rendered, by what they were for.
#[derive(Default)]
struct Steps(Mutex<BTreeSet<(String, u64)>>);

impl Progress for Steps {
    fn report(&self, _done: u64, total: u64, message: &str) {
        self.0.lock().expect("no holder panics").insert((message.to_owned(), total));
    }
}

fn params(counts: &[u64], until: Option<Until>) -> LadderRenderingParams {
    let rungs = Rungs::list(counts.to_vec()).expect("increasing");
    LadderRenderingParams { rungs, resolution: film(16, 12), until, ..LadderRenderingParams::default() }
}

fn asked(relative_error: f64, at_most: u64) -> Option<Until> {
    Some(Until { relative_error, at_most, paths: 0, samples: 64 })
}

/// A ladder, and how many samples each of the image and of the decision cost.
fn run(blobs: &MemoryBlobs, built: &Built, params: LadderRenderingParams) -> (Ladder, Vec<(String, u64)>) {
    let (cancel, steps) = (AtomicBool::new(false), Steps::default());
    let ctx = Context::new(blobs, &steps, &cancel);
    for bytes in built.blobs.values() {
        ctx.put(bytes).expect("memory");
    }
    let record = SceneRecord { scene: built.scene.clone(), recipe: recipe(0.0) };
    let scene: Artifact = record.store(&ctx).expect("memory").into_artifact();
    let each = BTreeMap::from([("scenes", &scene)]);
    let action = Action { params, item: None, group: "ladder", seed: 0, each, all: BTreeMap::new() };
    let outputs = LadderRendering::run(&ctx, &action).expect("a sound scene");
    let ladder = Ladder::load(&ctx, &outputs.items["ladder"]).expect("own artifact");
    (ladder, steps.0.into_inner().expect("no holder panics").into_iter().collect())
}

#[test]
fn a_ladder_ends_where_it_is_accurate_enough_and_has_the_samples_of_any_other() {
    for built in [balls_under_sky(), room()] {
        let (ladder, _) = run(&MemoryBlobs::default(), &built, params(&[4], asked(0.08, 65536)));
        let [first, stop] = ladder.meta.counts[..] else { panic!("{:?}", ladder.meta) };
        let error = ladder.meta.estimated_error.expect("it was decided");
        assert!(first == 4 && stop.is_power_of_two() && stop < 65536, "{stop}");
        // Half as many were not enough.
        assert!(error <= 0.08 && error * 2f64.sqrt() > 0.06, "{stop}: {error}");
        let (fixed, _) = run(&MemoryBlobs::default(), &built, params(&[4, stop], None));
        assert_eq!((&fixed.rungs, &fixed.variance), (&ladder.rungs, &ladder.variance), "the same samples");
        assert_eq!(fixed.meta.estimated_error, None);
    }
}

#[test]
fn light_paths_of_streams_that_decide_are_those_of_any_other() {
    let integrator = IntegratorKind::Bidirectional;
    let of = |counts: &[u64], until| {
        let params = LadderRenderingParams { integrator, ..params(counts, until) };
        run(&MemoryBlobs::default(), &room(), params).0
    };
    let stopped = of(&[4], asked(0.1, 65536));
    let fixed = of(&stopped.meta.counts, None);
    assert!(stopped.meta.counts.len() == 2, "{:?}", stopped.meta);
    assert_eq!((&fixed.rungs, &fixed.variance), (&stopped.rungs, &stopped.variance));
}

#[test]
fn a_tighter_target_goes_on_from_what_there_is() {
    let (built, blobs) = (room(), MemoryBlobs::default());
    let (loose, _) = run(&blobs, &built, params(&[8], asked(0.1, 65536)));
    let (tight, steps) = run(&blobs, &built, params(&[8], asked(0.03, 65536)));
    let (from, to) = (loose.meta.counts[1], tight.meta.counts[1]);
    assert!(to >= 2 * from, "{from}, {to}");
    let by = Until { relative_error: 0.03, at_most: 65536, paths: 0, samples: 64 };
    let of = |what: &str| -> Vec<u64> { steps.iter().filter(|s| s.0.contains(what)).map(|s| s.1).collect() };
    assert_eq!(of("samples per pixel"), [vec![to - from], of("decide")].concat(), "{steps:?}");
    assert!(of("decide").iter().all(|count| *count > by.trial(from, 192) && *count <= by.trial(to, 192)), "{steps:?}");
    assert_eq!(tight, run(&MemoryBlobs::default(), &built, params(&[8], asked(0.03, 65536))).0, "as from scratch");
    assert_eq!(run(&blobs, &built, params(&[8], asked(0.03, 65536))), (tight, Vec::new()), "nothing is rendered twice");
    // A looser one finds where it stopped.
    assert_eq!(run(&blobs, &built, params(&[8], asked(0.1, 65536))), (loose, Vec::new()));
}

#[test]
fn easy_scenes_stop_early_and_hopeless_ones_at_the_most() {
    let stop = |built: &Built, error: f64, at_most: u64| {
        let (ladder, _) = run(&MemoryBlobs::default(), built, params(&[2], asked(error, at_most)));
        (*ladder.meta.counts.last().expect("a rung"), ladder.meta.estimated_error.expect("decided"))
    };
    let (easy, hard) = (stop(&balls_under_sky(), 0.1, 65536).0, stop(&room(), 0.1, 65536).0);
    assert!(easy < hard, "{easy}, {hard}");
    // The most need not be a power of two; and what is accurate already gets no rung more.
    let (most, error) = stop(&room(), 1e-6, 100);
    assert!(most == 100 && error > 1e-6);
    let (built, blobs) = (balls_under_sky(), MemoryBlobs::default());
    let (enough, _) = run(&blobs, &built, params(&[2], asked(1e6, 64)));
    assert_eq!(enough.meta.counts, [2]);
}

#[test]
fn the_error_is_the_one_that_is_promised() {
    // Two pixels of 64 known samples: means 1 and 3, variances of single samples 64/63 and 0.
    let mut by = Accumulator::new(2, 1);
    for index in 0..64 {
        by.pixels[0].add(index, [2.0 * (index % 2) as f32; 3]);
        by.pixels[1].add(index, [3.0; 3]);
    }
    by.count = 64;
    let exposure = 0.18 / geometric_mean_luminance(&by.mean());
    let expected = (0.5 * (64.0 / 63.0 * exposure * exposure / (exposure * exposure + 0.01)) / 8.0).sqrt();
    assert!((relative_error([&by; 2], 8) / expected - 1.0).abs() < 1e-6);
    assert_eq!(relative_error([&Accumulator::new(2, 1); 2], 8), 0.0, "black has no error");
    // Variances are of one, means of the other: a bright sample that one of them has makes neither seem accurate.
    let calm = {
        let mut calm = Accumulator::new(2, 1);
        for index in 0..64 {
            calm.pixels.iter_mut().for_each(|pixel| pixel.add(index, [0.1; 3]));
        }
        calm.count = 64;
        calm
    };
    let lucky = {
        let mut lucky = calm.clone();
        lucky.pixels[0] = Pixel::default();
        (0..64).for_each(|index| lucky.pixels[0].add(index, [if index == 63 { 100.0 } else { 0.1 }; 3]));
        lucky
    };
    assert!(relative_error([&lucky, &calm], 8) > 3.0 * relative_error([&lucky; 2], 8));
    // The scale of radiance does not count.
    let mut brighter = by.clone();
    for pixel in &mut brighter.pixels {
        pixel.sum = pixel.sum.map(|v| 1e4 * v);
        pixel.m2 = pixel.m2.map(|v| 1e8 * v);
    }
    assert!((relative_error([&brighter; 2], 8) / relative_error([&by; 2], 8) - 1.0).abs() < 1e-6);
}

/// The relative error of an image against a reference, as exposed there.
fn true_error(image: &Image, reference: &Image) -> f64 {
    let exposure = 0.18 / geometric_mean_luminance(reference);
    let pairs = image.data().iter().zip(reference.data());
    let errors = pairs.map(|(a, b)| {
        let (a, b) = (f64::from(*a) * exposure, f64::from(*b) * exposure);
        (a - b) * (a - b) / (b * b + 0.01)
    });
    (errors.sum::<f64>() / image.data().len() as f64).sqrt()
}

#[test]
fn promises_are_held_and_stopping_moves_no_mean() {
    // By 64 samples per pixel or more, and by two or more of a larger film.
    for (built, width, height, least, target, streams, reference) in [
        (balls_under_sky(), 16, 12, 64, 0.1, 32u64, 16384),
        (room(), 16, 12, 64, 0.1, 32, 16384),
        (balls_under_sky(), 64, 48, 2, 0.2, 8, 1024),
        (room(), 64, 48, 2, 0.2, 8, 1024),
    ] {
        let world = World::new(&built.scene, &mut |d| built.load(d)).expect("sound");
        let render = |stream: u64, count: u64| {
            let renderer = Renderer::new(&world, film(width, height), stream).expect("a camera");
            let mut state = renderer.begin();
            renderer.advance(&mut state, count, &mut |_| Ok(())).expect("nobody stops it");
            state
        };
        let reference_samples = reference;
        let reference = render(1 << 40, reference).mean();
        let (mut stopped, mut decided) = (Vec::new(), 0);
        for stream in 0..streams {
            let until = Until { relative_error: target, at_most: 1 << 20, paths: 1, samples: least };
            let begin = || Accumulator::new(width as usize, height as usize);
            let advance = |state: &mut Accumulator, stream, trial| {
                decided += trial - state.count;
                *state = render(stream, trial);
                Ok::<(), ()>(())
            };
            let (stop, _) = until.decide(stream, 1, begin, advance).expect("nothing fails");
            stopped.push(render(stream, stop));
        }
        let samples: u64 = stopped.iter().map(|state| state.count).sum();
        assert!(decided <= (samples / 4).max(2 * least * streams), "{decided} {samples}");
        let held = stopped.iter().filter(|state| true_error(&state.mean(), &reference) <= 1.2 * target).count();
        assert!(10 * held >= 9 * stopped.len(), "{held} of {streams}");
        // The mean over streams against the reference: no bias by when they stopped.
        let sums = |state: &Accumulator| state.mean().data().iter().map(|v| f64::from(*v)).sum::<f64>();
        let means: Vec<f64> = stopped.iter().map(sums).collect();
        let mean = means.iter().sum::<f64>() / streams as f64;
        let variance = means.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (streams * (streams - 1)) as f64;
        let expected: f64 = reference.data().iter().map(|v| f64::from(*v)).sum();
        // The reference's own error is that of the samples, over so many.
        let own = variance * samples as f64 / reference_samples as f64;
        let z = (mean - expected) / (variance + own).sqrt();
        assert!(z.abs() < 4.0, "z = {z}");
    }
}

#[test]
fn an_image_by_itself_is_as_accurate_and_knows_how_far_it_is() {
    let built = room();
    fn image(built: &Built, goal: Goal<'_>) -> (Image, RenderStats) {
        let setup = Setup::new(film(16, 12));
        let found = render_image(&built.scene, &mut |d| built.load(d), setup, goal, &mut |_| Ok(())).expect("sound");
        (found.image, found.stats)
    }
    let (found, stats) = image(&built, Goal::Error(Until::new(0.1, 65536), 1));
    assert!(stats.error.is_some_and(|error| error <= 0.1), "{stats:?}");
    let (fixed, by_itself) = image(&built, Goal::Samples(stats.samples));
    assert_eq!(found, fixed);
    assert!((by_itself.error.expect("many samples") / stats.error.expect("decided") - 1.0).abs() < 0.5);
    let mut left = 3;
    let (_, some) = image(
        &built,
        Goal::While(&mut |_| {
            left -= 1;
            left >= 0
        }),
    );
    assert!(some.samples > 0 && some.paths == some.samples * 16 * 12, "{some:?}");
    assert_eq!(image(&built, Goal::Samples(1)).1.error, None);
}

#[test]
fn what_cannot_be_promised_is_refused() {
    let problems = |until: Until, sampler| {
        let params = LadderRenderingParams { sampler, ..params(&[64], Some(until)) };
        let found = LadderRendering::check(&params);
        found.iter().map(|problem| format!("{problem:?}")).collect::<Vec<_>>()
    };
    let fine = Until::new(0.01, 1024);
    assert_eq!(problems(fine.clone(), SamplerKind::Independent), [""; 0]);
    for (until, sampler, what) in [
        (fine.clone(), SamplerKind::Sobol, "independent"),
        (Until { relative_error: 0.0, ..fine.clone() }, SamplerKind::Independent, "relative_error"),
        (Until { relative_error: f64::NAN, ..fine.clone() }, SamplerKind::Independent, "relative_error"),
        (Until { at_most: 32, ..fine }, SamplerKind::Independent, "at_most"),
    ] {
        let found = problems(until, sampler);
        assert!(found.len() == 1 && found[0].contains(what), "{found:?}");
    }
}

/// A room without light.
fn unlit() -> Built {
    let mut built = room();
    for emission in built.scene.shapes.iter_mut().map(|shape| &mut shape.emission) {
        *emission = None;
    }
    built
}

#[test]
fn few_pixels_and_dark_images_are_not_taken_for_accurate() {
    // One pixel is decided by as many paths as a film of 262,144.
    let until = Until::new(0.1, 1 << 20);
    assert_eq!([until.trial(8, 1), until.trial(8, 1 << 20), until.trial(1 << 22, 1)], [1 << 18, 2, 1 << 19]);
    // Without light the error is unknown, and darkness is believed after a while.
    let (built, mut seen) = (unlit(), 0);
    let setup = Setup::new(film(4, 4));
    let found = render_image(&built.scene, &mut |d| built.load(d), setup, Goal::Error(until, 1), &mut |_| {
        seen += 1;
        Ok(())
    });
    let found = found.expect("a sound scene");
    assert!(seen > 2 && found.image.data().iter().all(|v| *v == 0.0));
    assert_eq!((found.stats.error, found.stats.samples), (None, 4096));
    let ladder = |paths| {
        let until = Some(Until { relative_error: 0.1, at_most: 1 << 20, paths, samples: 64 });
        run(&MemoryBlobs::default(), &built, LadderRenderingParams { resolution: film(4, 4), ..params(&[2], until) }).0
    };
    let (dark, before) = (ladder(1), ladder(0));
    assert_eq!((dark.meta.counts.last(), dark.meta.estimated_error), (Some(&4096), None));
    assert_eq!((before.meta.counts.last(), before.meta.estimated_error), (Some(&2), Some(0.0)));
}

#[test]
fn params_that_came_later_leave_keys_as_they_were() {
    let row = KindRow::<LadderRendering>::new();
    let keyed = |more: Value| {
        let mut params = json!({ "rungs": [1, 2], "resolution": [16, 12], "choices": "fixed" });
        params.as_object_mut().expect("an object").extend(more.as_object().expect("an object").clone());
        row.projection(&row.resolve(&params).expect("sound params"))(None, "ladder")
    };
    let before = json!({ "rungs": [1, 2], "resolution": [16, 12], "stream": 0, "sampler": "independent" });
    assert_eq!(keyed(json!({})), before);
    assert_eq!(keyed(json!({ "integrator": "path", "until": null })), before);
    assert_eq!(keyed(json!({ "choices": "adapted" }))["choices"], "adapted");
    assert_eq!(keyed(json!({ "integrator": "bidirectional" }))["integrator"], "bidirectional");
    let until = |paths: u64, samples: u64| {
        let until = json!({ "relative_error": 0.1, "at_most": 64, "paths": paths, "samples": samples });
        json!({ "until": until })
    };
    assert_eq!(keyed(until(0, 64))["until"], json!({ "relative_error": 0.1, "at_most": 64 }));
    assert_eq!(keyed(until(65536, 64))["until"], json!({ "relative_error": 0.1, "at_most": 64, "paths": 65536 }));
    assert_eq!(keyed(until(1 << 18, 2)), keyed(json!({ "until": { "relative_error": 0.1, "at_most": 64 } })));
    assert_eq!(keyed(until(1 << 18, 2))["until"]["samples"], 2);
}
