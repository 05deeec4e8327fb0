//! Metrics and curve summaries against numbers of the reference implementations (scikit-image, NumPy), where the folder
//! `shared/reference` lies beside the checkout; and image_metrics over artifacts in memory.

use std::{path::PathBuf, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Artifact, Context, ItemKey, Kind, KindError, MemoryBlobs, Outputs, Silent};
use tauflow_data::{
    Image, TensorFile,
    formats::{PACKED, PackedScene, REFINED, Refined, RefinedImage, refined_part},
    results::SceneScores,
};
use tauflow_eval::{ImageMetrics, ImageMetricsParams, curve, metrics::metrics};

fn reference_folder() -> Option<PathBuf> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/reference"));
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: there is no {}", folder.display());
    None
}

fn json(folder: &std::path::Path, name: &str) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(folder.join(name)).expect("readable")).expect("JSON")
}

fn near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{what}: {found}, expected {expected}");
}

/// An image of a tensor of shape [3, H, W].
fn planar(file: &TensorFile, name: &str) -> Image {
    let tensor = file.get(name).expect("the tensor is there");
    let (height, width) = (tensor.shape[1], tensor.shape[2]);
    let at = |i: usize| tensor.data[(i % 3) * height * width + i / 3];
    Image::from_data(width, height, 3, (0..3 * height * width).map(at).collect()).expect("fits")
}

#[test]
fn metrics_agree_with_the_reference_implementations() {
    let Some(folder) = reference_folder() else { return };
    let pairs = std::fs::read(folder.join("metric_pairs.safetensors")).expect("readable");
    let pairs = TensorFile::from_bytes(&pairs).expect("f32 tensors");
    let expected = json(&folder, "metric_expected.json");
    let expected = expected.as_array().expect("a list");
    assert_eq!(expected.len(), 4);
    for row in expected {
        let pair = row["pair"].as_u64().expect("a number");
        let found = metrics(&planar(&pairs, &format!("img{pair}")), &planar(&pairs, &format!("ref{pair}")));
        let found = found.expect("comparable");
        let names = [
            ("hdr_psnr_peak1", found.hdr_psnr),
            ("hdr_psnr_peakmax", found.hdr_psnr_max),
            ("hdr_mae", found.hdr_mae),
            ("preview_psnr", found.preview_psnr),
            ("preview_mae", found.preview_mae),
            ("preview_ssim_valid", found.ssim),
        ];
        for (name, value) in names {
            match row[name].as_f64() {
                Some(number) => near(value, number, &format!("{name} of pair {pair}")),
                None => assert!(row[name].is_null() && value == f64::INFINITY, "{name} of pair {pair}: {value}"),
            }
        }
    }
}

#[test]
fn curve_summaries_agree_with_the_reference() {
    let Some(folder) = reference_folder() else { return };
    let expected = json(&folder, "curve_expected.json");
    let nfe: Vec<u64> = serde_json::from_value(expected["nfe"].clone()).expect("counts");
    let psnr: Vec<f64> = serde_json::from_value(expected["psnr"].clone()).expect("numbers");
    let found = curve::summarise(&nfe, &psnr).expect("a curve");
    near(found.auc, expected["auc"].as_f64().expect("a number"), "auc");
    near(found.tv, expected["tv"].as_f64().expect("a number"), "tv");
}

fn constant(value: f32) -> Image {
    Image::from_data(12, 12, 3, vec![value; 12 * 12 * 3]).expect("fits")
}

fn run(ctx: &Context<'_>, each: &[(&'static str, &Artifact)], from: u64) -> Result<Outputs, KindError> {
    let item = ItemKey::new("L0-open-000001").expect("plain");
    let action = Action {
        params: ImageMetricsParams { from },
        item: Some(&item),
        group: "main",
        seed: 0,
        each: each.iter().copied().collect(),
        whole: std::collections::BTreeMap::new(),
    };
    ImageMetrics::run(ctx, &action)
}

fn packed(ctx: &Context<'_>) -> Artifact {
    let scene = PackedScene { counts: vec![1, 4], states: vec![constant(0.5), constant(0.6)], gbuffer: None };
    Artifact::blob(PACKED, ctx.put(&scene.to_bytes().expect("consistent")).expect("stored"))
}

fn refined(ctx: &Context<'_>, images: &[(u64, Image)]) -> Artifact {
    let said = |nfe| RefinedImage { method: "mc_noise".into(), from_spp: 1, to_spp: 4, nfe };
    let meta = Refined { images: images.iter().map(|(nfe, _)| said(*nfe)).collect(), note: None };
    let mut parts = vec![("meta.json".to_owned(), ctx.put_json(&meta).expect("stored"))];
    for (index, (_, image)) in images.iter().enumerate() {
        parts.push((refined_part(index), ctx.put(&image.to_bytes()).expect("stored")));
    }
    Artifact::tree(REFINED, parts)
}

#[test]
fn the_kind_scores_images_or_a_rung() {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let references = packed(&ctx);
    let scores = |out: Outputs| ctx.json::<SceneScores>(&out.items["metrics"], "").expect("scores");

    let hold = scores(run(&ctx, &[("references", &references)], 1).expect("a rung"));
    assert_eq!((hold.reference_spp, hold.scores.len()), (4, 1));
    let score = &hold.scores[0];
    assert_eq!((score.method.as_str(), score.from_spp, score.nfe), ("hold", 1, 0));
    // An error of .1 everywhere is 20 dB.
    near(score.metrics.hdr_psnr, 20.0, "hold");
    let none = run(&ctx, &[("references", &references)], 2).expect_err("no such rung").to_string();
    assert!(none.contains("no rung of 2 samples, only [1, 4]"), "{none}");

    let images = refined(&ctx, &[(1, constant(0.59)), (9, constant(0.6))]);
    let scored = scores(run(&ctx, &[("images", &images), ("references", &references)], 1).expect("two images"));
    let said: Vec<_> = scored.scores.iter().map(|s| (s.method.as_str(), s.to_spp, s.nfe)).collect();
    assert_eq!(said, [("mc_noise", 4, 1), ("mc_noise", 4, 9)]);
    near(scored.scores[0].metrics.hdr_psnr, 40.0, "one step");
    assert!(scored.scores[1].metrics.hdr_psnr.is_infinite() && scored.scores[1].metrics.ssim == 1.0);

    let blown = refined(&ctx, &[(1, constant(f32::NAN))]);
    let error = run(&ctx, &[("images", &blown), ("references", &references)], 1).expect_err("not finite").to_string();
    assert!(error.contains("`mc_noise`, 1 -> 4 samples, NFE 1, of `L0-open-000001`"), "{error}");
}
