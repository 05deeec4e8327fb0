//! The kind `image_metrics` over artifacts in memory.

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Artifact, Context, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Image,
    methods::{HOLD, Parameterization},
    records::{PackedScene, Refined, RefinedImage, SceneScores},
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
