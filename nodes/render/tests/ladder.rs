//! The kind: nesting, continuation, keys, threads.

mod scenes;

use scenes::{Built, balls_under_sky, columns, everything, film, level, recipe, room};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
    },
};
use tauflow_contract::{
    Action, Artifact, Blobs, Context, Digest, Kind, KindError, Media, MemoKey, MemoryBlobs, Progress, Silent, leave_out,
};
use tauflow_data::{
    Image, Rungs,
    records::{GBuffer, Ladder, SceneRecord, Variances},
    scene::{Bsdf, Geometry, Texture},
};
use tauflow_render::{
    choices::Choices,
    gbuffer::GBufferSurface,
    ladder_rendering::{LadderRendering, LadderRenderingParams},
    render::{Goal, Rendered, Renderer, Setup, render_image},
    world::World,
};

/// Remembers how many samples per pixel were rendered.
#[derive(Default)]
struct Samples(Mutex<BTreeSet<u64>>);

impl Progress for Samples {
    fn report(&self, _done: u64, total: u64, _message: &str) {
        self.0.lock().expect("no holder panics").insert(total);
    }
}

fn scene_of(ctx: &Context<'_>, built: &Built) -> Artifact {
    let record = SceneRecord { scene: built.scene.clone(), recipe: recipe(0.0) };
    record.store(ctx).expect("memory").into_artifact()
}

/// Content digest of a rung's image.
fn rung(ladder: &Artifact, spp: u64) -> Digest {
    let found = ladder.parts.iter().find(|(name, _)| name.rsplit('/').next() == Some(&format!("{spp:08}")));
    *found.unwrap_or_else(|| panic!("no rung {spp}")).1
}

fn run(
    blobs: &dyn Blobs,
    progress: &dyn Progress,
    built: &Built,
    params: LadderRenderingParams,
    group: &str,
) -> Artifact {
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(blobs, progress, &cancel);
    for bytes in built.blobs.values() {
        ctx.put(bytes).expect("memory");
    }
    let scene = scene_of(&ctx, built);
    let action =
        Action { params, item: None, group, seed: 0, each: BTreeMap::from([("scenes", &scene)]), all: BTreeMap::new() };
    let outputs = LadderRendering::run(&ctx, &action).expect("a sound scene");
    outputs.items.get(group).cloned().expect("the group's port")
}

fn params(rungs: Rungs) -> LadderRenderingParams {
    LadderRenderingParams { rungs, resolution: film(16, 12), ..LadderRenderingParams::default() }
}

fn dyadic(last: u64) -> LadderRenderingParams {
    params(Rungs::dyadic(last).expect("a power of two"))
}

fn list(counts: &[u64]) -> LadderRenderingParams {
    params(Rungs::list(counts.to_vec()).expect("increasing"))
}

#[test]
fn continuing_has_the_bits_of_starting_over_and_renders_only_what_is_new() {
    for built in [balls_under_sky(), room()] {
        let fresh = MemoryBlobs::default();
        let whole = run(&fresh, &Silent, &built, dyadic(256), "ladder");
        let shared = MemoryBlobs::default();
        let rendered = |rungs: LadderRenderingParams| {
            let samples = Samples::default();
            let artifact = run(&shared, &samples, &built, rungs, "ladder");
            (artifact, samples.0.into_inner().expect("no holder panics").into_iter().collect::<Vec<_>>())
        };
        assert_eq!(rendered(list(&[32])).1, [32]);
        let (continued, new) = rendered(dyadic(256));
        assert_eq!(new, [224], "only the samples after the preview's");
        assert_eq!(continued, whole);
        assert_eq!(rendered(dyadic(256)), (whole.clone(), vec![]), "nothing is rendered twice");
        assert_eq!(rendered(list(&[32])).1, Vec::<u64>::new());
        assert_eq!(rendered(list(&[32, 256])).1, Vec::<u64>::new());
        // 32, then 512, then 1024.
        assert_eq!(rendered(dyadic(512)).1, [256]);
        let (long, new) = rendered(dyadic(1024));
        assert_eq!(new, [512]);
        assert_eq!(long, run(&MemoryBlobs::default(), &Silent, &built, dyadic(1024), "ladder"));
        // A rung between, and one beyond.
        let (odd, new) = rendered(list(&[256, 300]));
        assert_eq!(new, [44]);
        assert_eq!(odd, run(&MemoryBlobs::default(), &Silent, &built, list(&[256, 300]), "ladder"));
        let (dense, _) = rendered(list(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]));
        assert_eq!(
            dense,
            run(&MemoryBlobs::default(), &Silent, &built, list(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]), "ladder")
        );
        assert_eq!(rung(&dense, 8), rung(&whole, 8), "ladders share samples");
        assert_eq!(rung(&odd, 256), rung(&whole, 256));
    }
}

#[test]
fn rungs_are_means_and_the_variance_is_that_of_the_samples() {
    let built = balls_under_sky();
    let blobs = MemoryBlobs::default();
    let artifact = run(&blobs, &Silent, &built, list(&(1..=16).collect::<Vec<_>>()), "ladder");
    let cancel = AtomicBool::new(false);
    let ladder = Ladder::load(&Context::new(&blobs, &Silent, &cancel), &artifact).expect("own artifact");
    assert_eq!((ladder.meta.rejected, ladder.meta.width, ladder.meta.height), (0, 16, 12));
    assert!(ladder.meta.mean_path_length > 1.0 && ladder.meta.mean_path_length <= 6.0);
    // The samples, from the means of 1..n.
    let means: Vec<&Image> = ladder.rungs.iter().map(|rung| &rung.image).collect();
    for at in 0..means[0].data().len() {
        let value = |n: usize| f64::from(means[n].data()[at]) * (n + 1) as f64;
        let samples: Vec<f64> = (0..16).map(|n| if n == 0 { value(0) } else { value(n) - value(n - 1) }).collect();
        let mean = samples.iter().sum::<f64>() / 16.0;
        let variance = samples.iter().map(|s| (s - mean) * (s - mean)).sum::<f64>() / 15.0;
        let found = f64::from(ladder.variance.data()[at]);
        assert!((found - variance).abs() < 1e-5 + 1e-4 * variance, "{found} {variance}");
    }
    let setup = Setup::new(film(16, 12));
    let Rendered { image, stats, .. } =
        render_image(&built.scene, &mut |d| built.load(d), setup, Goal::Samples(16), &mut |_| Ok(())).expect("sound");
    assert_eq!(&image, means[15], "the command renders what the kind does");
    assert_eq!((stats.paths, stats.rejected), (16 * 16 * 12, 0));
}

#[test]
fn variances_are_those_of_ladders_that_end_there_and_their_samples_are_not_rendered_twice() {
    let built = room();
    let (blobs, cancel) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let artifact = run(&blobs, &Silent, &built, dyadic(16), "variances");
    let variances = Variances::load(&ctx, &artifact).expect("own artifact");
    assert_eq!(variances.rungs.iter().map(|(spp, _)| *spp).collect::<Vec<_>>(), [1, 2, 4, 8, 16]);
    assert!(variances.rungs[0].1.data().iter().all(|value| *value == 0.0), "one sample has no variance");
    let samples = Samples::default();
    let ladder = run(&blobs, &samples, &built, dyadic(16), "ladder");
    assert!(samples.0.into_inner().expect("no holder panics").is_empty(), "the ladder's samples are there");
    assert_eq!(ladder, run(&MemoryBlobs::default(), &Silent, &built, dyadic(16), "ladder"));
    for (spp, variance) in &variances.rungs {
        let alone = MemoryBlobs::default();
        let ladder = run(&alone, &Silent, &built, list(&[*spp]), "ladder");
        let ladder = Ladder::load(&Context::new(&alone, &Silent, &cancel), &ladder).expect("own artifact");
        assert_eq!(&ladder.variance, variance, "{spp}");
    }
    // After the ladder: the same bits.
    let other = MemoryBlobs::default();
    run(&other, &Silent, &built, dyadic(16), "ladder");
    assert_eq!(run(&other, &Silent, &built, dyadic(16), "variances"), artifact);
}

#[test]
fn threads_change_no_bit() {
    for built in [balls_under_sky(), room(), everything()] {
        let films: Vec<_> = [1, 2, 4, 7]
            .into_iter()
            .map(|threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
                pool.install(|| {
                    let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
                    let world = world.with_choices(Choices::default());
                    let renderer = Renderer::new(&world, film(33, 21), 0).expect("a film");
                    let mut film = renderer.begin();
                    renderer.advance(&mut film, 9, &mut |_| Ok(())).expect("nothing stops it");
                    (film, renderer.gbuffer((0, GBufferSurface::First), 5, &mut |_| Ok(())).expect("nothing stops it"))
                })
            })
            .collect();
        assert!(films.windows(2).all(|w| w[0] == w[1]));
    }
}

#[test]
fn streams_are_independent_and_resolutions_apart() {
    let built = balls_under_sky();
    let blobs = MemoryBlobs::default();
    let base = run(&blobs, &Silent, &built, dyadic(4), "ladder");
    let other = run(&blobs, &Silent, &built, LadderRenderingParams { stream: 1, ..dyadic(4) }, "ladder");
    let larger =
        run(&blobs, &Silent, &built, LadderRenderingParams { resolution: film(18, 12), ..dyadic(4) }, "ladder");
    assert_ne!(rung(&base, 4), rung(&other, 4));
    assert_ne!(rung(&base, 4), rung(&larger, 4));
    let mut reseeded = built;
    reseeded.scene.seed += 1;
    assert_ne!(rung(&run(&blobs, &Silent, &reseeded, dyadic(4), "ladder"), 4), rung(&base, 4));
}

#[test]
fn ladders_of_other_choices_are_kept_apart() {
    let mut built = balls_under_sky();
    built.scene.materials.fill(Bsdf::Principled {
        base_color: Texture::scalar(0.4),
        metallic: Texture::scalar(0.0),
        roughness: Texture::scalar(0.5),
        specular: 0.5,
        spec_trans: Texture::scalar(0.0),
        clearcoat: 0.0,
        clearcoat_gloss: 0.0,
    });
    let of = |choices| LadderRenderingParams { choices, ..dyadic(64) };
    let both = [Choices::Fixed, Choices::Adapted].map(of);
    let shared = MemoryBlobs::default();
    let ladders = both.clone().map(|params| run(&shared, &Silent, &built, params, "ladder"));
    for (params, ladder) in both.iter().zip(&ladders) {
        assert_eq!(*ladder, run(&MemoryBlobs::default(), &Silent, &built, params.clone(), "ladder"));
    }
    assert_ne!(rung(&ladders[0], 64), rung(&ladders[1], 64));
    // A G-buffer draws no lobes of `principled`, and no lights.
    for built in [&built, &everything()] {
        for surface in [GBufferSurface::First, GBufferSurface::Rough] {
            let gbuffers = [Choices::Fixed, Choices::Adapted].map(|choices| {
                let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
                let world = world.with_choices(choices);
                let renderer = Renderer::new(&world, film(16, 12), 0).expect("a film");
                renderer.gbuffer((0, surface), 8, &mut |_| Ok(())).expect("nothing stops it")
            });
            assert_eq!(gbuffers[0], gbuffers[1], "{surface:?}");
        }
    }
    // Keys of before the param stay, and only what depends on it has others.
    for (group, depends) in [("ladder", true), ("variances", true), ("timing", true), ("gbuffer", false)] {
        let [before, now] = both.clone().map(|params| {
            let mut keyed = LadderRendering::project(&params, None, group);
            leave_out(&mut keyed, LadderRendering::later());
            keyed
        });
        assert_eq!(before.get("choices"), None, "{group}");
        assert_eq!(now.get("choices").is_some(), depends, "{group}");
    }
}

#[test]
fn the_gbuffer_looks_through_clear_glass_and_into_mirrors_if_asked() {
    let blobs = MemoryBlobs::default();
    let cancel = AtomicBool::new(false);
    let render = |built: &Built, gbuffer_surface: GBufferSurface| {
        let params = LadderRenderingParams { resolution: film(32, 32), gbuffer_surface, ..dyadic(1) };
        let artifact = run(&blobs, &Silent, built, params, "gbuffer");
        GBuffer::load(&Context::new(&blobs, &Silent, &cancel), &artifact).expect("own artifact")
    };
    let open = render(&balls_under_sky(), GBufferSurface::Rough);
    assert_eq!(open, render(&balls_under_sky(), GBufferSurface::First), "nothing is specular");
    // A pane before all that is seen, of an index that reflects nothing and bends nothing.
    let mut built = balls_under_sky();
    let pane = Bsdf::ThinDielectric {
        int_ior: 1.0,
        ext_ior: 1.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::rgb([0.5, 1.0, 0.25]),
    };
    let pane = built.material(pane);
    built.shape(Geometry::Rectangle, columns([4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.5, 5.0]), pane);
    let through = render(&built, GBufferSurface::Rough);
    assert_ne!(through, render(&built, GBufferSurface::First));
    let mut seen = 0;
    for (x, y) in (0..32).flat_map(|y| (0..32).map(move |x| (x, y))) {
        for c in 0..3 {
            let (own, tint) = (open.albedo.pixel(x, y)[c], [0.5, 1.0, 0.25][c]);
            assert!((through.albedo.pixel(x, y)[c] - own * tint).abs() < 1e-4, "{x} {y}");
            assert!((through.normal.pixel(x, y)[c] - open.normal.pixel(x, y)[c]).abs() < 1e-4, "{x} {y}");
            seen += usize::from(own > 0.0);
        }
    }
    assert!(seen > 1000, "{seen}");
    // A mirror as floor shows the balls and, where they are not, the sky, which has no albedo.
    let mut built = balls_under_sky();
    let mirror = Bsdf::Conductor { eta: [0.2; 3], k: [3.9; 3], alpha: 0.0, specular_reflectance: Texture::scalar(1.0) };
    let mirror = built.material(mirror);
    built.shape(Geometry::Rectangle, level(10.0, [0.0, 0.01, 0.0], true), mirror);
    let mirrored = render(&built, GBufferSurface::Rough).albedo;
    let reddest = (0..32)
        .map(|x| mirrored.pixel(x, 25))
        .fold([0.0; 2], |most: [f32; 2], p| if p[0] - p[2] > most[0] - most[1] { [p[0], p[2]] } else { most });
    assert!(reddest[0] > 0.3 && reddest[1] < 0.2, "{reddest:?}");
    assert_eq!(mirrored.pixel(16, 31), [0.0; 3], "the sky");
}

#[test]
fn the_gbuffer_holds_albedo_and_normal() {
    let mut built = balls_under_sky();
    built.scene.camera.fov_x = 60.0;
    let blobs = MemoryBlobs::default();
    let artifact =
        run(&blobs, &Silent, &built, LadderRenderingParams { resolution: film(64, 64), ..dyadic(1) }, "gbuffer");
    let cancel = AtomicBool::new(false);
    let gbuffer = GBuffer::load(&Context::new(&blobs, &Silent, &cancel), &artifact).expect("own artifact");
    let near = |a: &[f32], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-2);
    assert_eq!(gbuffer.albedo.pixel(32, 1), [0.0; 3], "the sky has none");
    assert_eq!(gbuffer.normal.pixel(32, 1), [0.0; 3]);
    // The ground faces up, which a camera that looks down sees as up and towards it.
    let camera = &built.scene.camera;
    let [origin, target, up] = [camera.origin, camera.target, camera.up].map(glam::DVec3::from_array);
    let forward = (target - origin).normalize();
    let side = forward.cross(up).normalize();
    let ground = [side.y, side.cross(forward).y, -forward.y].map(|v| v as f32);
    assert!(near(gbuffer.albedo.pixel(32, 60), [0.5; 3]) && near(gbuffer.normal.pixel(32, 60), ground), "{ground:?}");
    let red = (0..64 * 64).map(|i| gbuffer.albedo.pixel(i % 64, i / 64)).filter(|p| near(p, [0.7, 0.2, 0.15])).count();
    let blue = (0..64 * 64).map(|i| gbuffer.albedo.pixel(i % 64, i / 64)).filter(|p| near(p, [0.15, 0.3, 0.7])).count();
    println!("{red} red and {blue} blue pixels");
    assert!(red > 150 && blue > 150 && (red as i64 - blue as i64).abs() < 20, "a sphere and its mesh look the same");
}

/// Forgets half of what it is told, as a cache after its collection.
#[derive(Default)]
struct Forgetful(MemoryBlobs, &'static str);

impl Blobs for Forgetful {
    fn get(&self, digest: &Digest) -> Result<Option<Vec<u8>>, KindError> {
        self.0.get(digest)
    }

    fn put(&self, bytes: &[u8]) -> Result<Digest, KindError> {
        self.0.put(bytes)
    }

    fn memo_get(&self, key: &MemoKey) -> Option<Artifact> {
        (!key.basis.group.ends_with(self.1)).then(|| self.0.memo_get(key)).flatten()
    }

    fn memo_put(&self, key: &MemoKey, artifact: &Artifact) -> Result<(), KindError> {
        self.0.memo_put(key, artifact)
    }
}

#[test]
fn what_the_cache_forgets_is_rendered_again() {
    let built = balls_under_sky();
    let whole = run(&MemoryBlobs::default(), &Silent, &built, dyadic(16), "ladder");
    for forgotten in ["accumulator", "rung", ""] {
        let blobs = Forgetful(MemoryBlobs::default(), forgotten);
        run(&blobs, &Silent, &built, list(&[8]), "ladder");
        assert_eq!(run(&blobs, &Silent, &built, dyadic(16), "ladder"), whole, "without `{forgotten}`");
        assert_eq!(run(&blobs, &Silent, &built, dyadic(16), "ladder"), whole, "without `{forgotten}`, again");
    }
}

#[test]
fn a_run_that_is_stopped_says_so() {
    let blobs = MemoryBlobs::default();
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let built = balls_under_sky();
    built.blobs.values().for_each(|bytes| drop(ctx.put(bytes)));
    let scene = scene_of(&ctx, &built);
    cancel.store(true, Ordering::Relaxed);
    for group in ["ladder", "gbuffer"] {
        let each = BTreeMap::from([("scenes", &scene)]);
        let action = Action { params: dyadic(4), item: None, group, seed: 0, each, all: BTreeMap::new() };
        assert!(matches!(LadderRendering::run(&ctx, &action), Err(KindError::Cancelled)));
    }
}

#[test]
fn params_are_checked_and_projected() {
    let kinds = tauflow_render::kinds();
    let kind = kinds.iter().find(|k| k.spec().name == "ladder_rendering").expect("the crate's kind");
    let resolve = |text: &str| kind.resolve(&serde_json::from_str(text).expect("JSON"));
    let pointer = |text: &str| resolve(text).expect_err("refused")[0].pointer.clone();
    assert_eq!(pointer(r#"{"rungs": {"dyadic": 12}}"#), "/rungs");
    assert_eq!(pointer(r#"{"rungs": [4, 2]}"#), "/rungs");
    assert_eq!(pointer(r#"{"resolution": [0, 64]}"#), "/resolution");
    assert_eq!(pointer(r#"{"sampler": "sobol", "rungs": [4, 8589934592]}"#), "/rungs");
    assert!(resolve(r#"{"sampler": "halton"}"#).is_err() && resolve(r#"{"spp": 3}"#).is_err());
    let schema = kind.params_schema();
    assert_eq!(schema["properties"]["gbuffer_samples"]["minimum"], 1, "what the schema says, no one else checks");
    let full = resolve(r#"{"rungs": {"dyadic": 4}, "gbuffer_samples": 7}"#).expect("sound");
    assert_eq!(full, resolve(r#"{"rungs": [1, 2, 4], "gbuffer_samples": 7}"#).expect("sound"), "one ladder, one key");
    let ladder = kind.projection(&full)(None, "ladder");
    let sobol = resolve(r#"{"rungs": {"dyadic": 4}, "sampler": "sobol"}"#).expect("sound");
    assert_ne!(kind.projection(&sobol)(None, "ladder"), ladder);
    assert!(ladder.get("gbuffer_samples").is_none() && ladder["rungs"] == serde_json::json!([1, 2, 4]));
    let gbuffer = kind.projection(&full)(None, "gbuffer");
    assert!(gbuffer.get("rungs").is_none() && gbuffer["gbuffer_samples"] == 7);
    assert!(kind.resolve(&ladder).is_ok() && kind.resolve(&gbuffer).is_ok(), "a projection is a set of params");
}
