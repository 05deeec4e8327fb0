//! The kind `image_metrics` over artifacts in memory.

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Artifact, Context, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Image, IntegratorKind, SamplerKind,
    methods::{HOLD, Parameterization},
    records::{Exposure, Ladder, LadderMeta, PackedScene, Refined, RefinedImage, Rung, SceneScores},
};
use tauflow_eval::{ImageMetrics, ImageMetricsParams};

const MC_NOISE: &str = Parameterization::McNoise.name();

fn near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{what}: {found}, expected {expected}");
}

fn constant(value: f32) -> Image {
    Image::from_data(12, 12, 3, vec![value; 12 * 12 * 3]).expect("fits")
}

fn run(ctx: &Context<'_>, each: &[(&'static str, &Artifact)], from: u64) -> Result<Outputs, KindError> {
    let item = ItemKey::new("L0-open-000001").expect("plain");
    let action = Action {
        params: ImageMetricsParams { from, ..ImageMetricsParams::default() },
        item: Some(&item),
        group: "main",
        seed: 0,
        each: each.iter().copied().collect(),
        all: BTreeMap::new(),
    };
    ImageMetrics::run(ctx, &action)
}

fn packed(ctx: &Context<'_>) -> Artifact {
    let scene = PackedScene {
        counts: vec![1, 4],
        states: vec![constant(0.5), constant(0.6)],
        gbuffer: None,
        sampler: Default::default(),
    };
    scene.store(ctx).expect("consistent").into_artifact()
}

fn refined(ctx: &Context<'_>, images: &[(u64, Image)]) -> Artifact {
    let said = |nfe| RefinedImage { method: MC_NOISE.into(), from_spp: 1, to_spp: 4, nfe };
    let images = images.iter().map(|(nfe, image)| (said(*nfe), image.clone())).collect();
    Refined { images, note: None, ..Default::default() }.store(ctx).expect("stored").into_artifact()
}

fn scores(ctx: &Context<'_>, outputs: &Outputs) -> SceneScores {
    Handle::new(&outputs.items["metrics"]).expect("the port's type").load(ctx).expect("scores")
}

#[test]
fn the_kind_scores_images_or_a_rung() {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let references = packed(&ctx);
    let hold = scores(&ctx, &run(&ctx, &[("references", &references)], 1).expect("a rung"));
    assert_eq!((hold.reference_spp, hold.scores.len()), (4, 1));
    let score = &hold.scores[0];
    assert_eq!((score.method.as_str(), score.from_spp, score.nfe), (HOLD, 1, 0));
    // An error of .1 everywhere is 20 dB.
    near(score.metrics.hdr_psnr, 20.0, HOLD);
    let none = run(&ctx, &[("references", &references)], 2).expect_err("no such rung").to_string();
    assert!(none.contains("no rung of 2 samples, only [1, 4]"), "{none}");

    let images = refined(&ctx, &[(1, constant(0.59)), (9, constant(0.6))]);
    let scored = scores(&ctx, &run(&ctx, &[("images", &images), ("references", &references)], 1).expect("two images"));
    let said: Vec<_> = scored.scores.iter().map(|s| (s.method.as_str(), s.to_spp, s.nfe)).collect();
    assert_eq!(said, [(MC_NOISE, 4, 1), (MC_NOISE, 4, 9)]);
    near(scored.scores[0].metrics.hdr_psnr, 40.0, "one step");
    assert!(scored.scores[1].metrics.hdr_psnr.is_infinite() && scored.scores[1].metrics.ssim == 1.0);

    let blown = refined(&ctx, &[(1, constant(f32::NAN))]);
    let error = run(&ctx, &[("images", &blown), ("references", &references)], 1).expect_err("not finite").to_string();
    assert!(error.contains("`mc_noise`, 1 -> 4 samples, NFE 1, of `L0-open-000001`"), "{error}");
}

/// A reference of 4 samples at twice the exposure, whose single samples have this variance.
fn held_out(ctx: &Context<'_>, value: f32, variance: f32, sampler: SamplerKind) -> Artifact {
    let meta = LadderMeta {
        counts: vec![4],
        width: 12,
        height: 12,
        rejected: 0,
        mean_path_length: 1.0,
        sampler,
        integrator: IntegratorKind::Path,
        estimated_error: None,
    };
    let rungs = vec![Rung { spp: 4, image: constant(value / 2.0) }];
    Ladder { meta, rungs, variance: constant(variance / 4.0) }.store(ctx).expect("consistent").into_artifact()
}

#[test]
fn the_reference_s_own_noise_is_taken_off() {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let (references, images) = (packed(&ctx), refined(&ctx, &[(1, constant(0.5))]));
    let exposure = Exposure { factor: 2.0, ev: 0.0, mean_luminance: 0.1 }.store(&ctx).expect("stored").into_artifact();
    let of = |ladder: &Artifact| {
        let each = [("images", &images), ("references", &references), ("held_out", ladder), ("exposure", &exposure)];
        run(&ctx, &each, 1).map(|outputs| scores(&ctx, &outputs).scores[0].metrics)
    };
    let found = |variance, sampler| of(&held_out(&ctx, 0.6, variance, sampler)).expect("a reference");
    let free = found(0.0, SamplerKind::Independent);
    near(free.hdr_psnr, 20.0, "no noise");
    // 0.01 was measured. Four samples of this variance have a mean square of 0.0075.
    let noisy = found(0.03, SamplerKind::Independent);
    near(noisy.hdr_psnr, -10.0 * 0.0025f64.log10(), "noise");
    near(noisy.hdr_psnr_max - free.hdr_psnr_max, -10.0 * 0.25f64.log10(), "noise, by the maximum");
    assert_eq!((noisy.hdr_mae, noisy.preview_psnr, noisy.ssim), (free.hdr_mae, free.preview_psnr, free.ssim));
    near(found(4.0, SamplerKind::Independent).hdr_psnr, 30.0, "noise beyond the error");
    for (variance, sampler) in [(0.03, SamplerKind::Sobol), (f32::INFINITY, SamplerKind::Independent)] {
        let error = of(&held_out(&ctx, 0.6, variance, sampler)).expect_err("it does not tell").to_string();
        assert!(error.contains("does not tell its noise") && error.contains("`held_out`"), "{error}");
    }

    let other = of(&held_out(&ctx, 0.61, 0.0, SamplerKind::Independent)).expect_err("another image").to_string();
    assert!(other.contains("`L0-open-000001` is not the last rung of its ladder in `held_out`"), "{other}");
}
