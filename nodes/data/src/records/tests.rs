//! Every media type: stored, loaded, exported and imported again, with the same content.

use super::*;
use crate::{Image, IntegratorKind, SamplerKind};
use serde_json::{Value, json};
use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{Context, FileTree, Handle, Media, MemoryBlobs, Silent, Stored};

thread_local! {
    /// Names of the media types that went round in this test.
    static SEEN: RefCell<BTreeSet<&'static str>> = const { RefCell::new(BTreeSet::new()) };
}

fn image(width: usize, value: f32) -> Image {
    let data = (0..width * 2 * 3).map(|i| value * (i as f32 + 0.1) - 0.3).collect();
    Image::from_data(width, 2, 3, data).expect("fits")
}

fn in_memory(test: impl FnOnce(&Context<'_>)) {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    test(&Context::new(&blobs, &Silent, &stop));
}

fn round_trip<M: Media + PartialEq + std::fmt::Debug>(ctx: &Context<'_>, value: &M) -> FileTree {
    SEEN.with_borrow_mut(|seen| seen.insert(M::NAME));
    let stored: Stored<M> = value.store(ctx).expect("in memory");
    assert_eq!(&stored.handle().load(ctx).expect("whole"), value);
    let mut files = FileTree::new();
    let row = media(M::NAME).expect("in the table");
    (row.export)(ctx, stored.artifact(), &mut files).expect("whole");
    assert_eq!(&(row.import)(ctx, &files).expect("own files"), stored.artifact(), "{}", M::NAME);
    // Without one of its files it is another thing, or none; previews alone are for people.
    // Values of packed scenes are exposed where nothing else is said.
    let said = |name: &String| !(M::NAME == PackedScene::NAME && name == "meta.json");
    for gone in files.keys().filter(|name| !name.ends_with(".png") && said(name)) {
        let fewer = files.iter().filter(|(name, _)| *name != gone).map(|(n, b)| (n.clone(), b.clone())).collect();
        if let Ok(other) = (row.import)(ctx, &fewer as &FileTree) {
            assert_ne!(&other, stored.artifact(), "{} without `{gone}`", M::NAME);
        }
    }
    files
}

fn ladder() -> Ladder {
    let meta = LadderMeta {
        counts: vec![1, 2],
        width: 3,
        height: 2,
        rejected: 0,
        mean_path_length: 1.5,
        sampler: SamplerKind::Independent,
        integrator: IntegratorKind::Path,
        estimated_error: None,
    };
    let rungs = vec![Rung { spp: 1, image: image(3, 1e6) }, Rung { spp: 2, image: image(3, 1e-30) }];
    Ladder { meta, rungs, variance: image(3, 0.25) }
}

#[test]
fn every_media_type_comes_back_from_its_files() {
    in_memory(|ctx| {
        images(ctx);
        records(ctx);
        tables(ctx);
        assets_and_scenes(ctx);
        round_trip(ctx, &tauflow_contract::Files([("a/b.txt".to_owned(), vec![1])].into()));
    });
    let all: BTreeSet<&str> = MEDIA.iter().map(|row| row.name).collect();
    assert_eq!(SEEN.take(), all, "give this test a value of each media type");
}

/// Images to the bit.
fn images(ctx: &Context<'_>) {
    let files = round_trip(ctx, &ladder());
    assert!(files.contains_key("spp-000002.exr") && files.contains_key("spp-000002.png"));
    let variances = Variances { rungs: vec![(2, image(3, 0.25)), (4, image(3, 0.5))] };
    assert!(round_trip(ctx, &variances).contains_key("spp-000004.exr"));
    round_trip(ctx, &GBuffer { albedo: image(3, 0.1), normal: image(3, -0.1) });
    let gbuffer = Some(image(3, 0.1).beside(&image(3, -0.2)).expect("of one size"));
    let states = vec![image(3, 2.0), image(3, 1.0)];
    let packed = PackedScene { counts: vec![1, 4], states, gbuffer, sampler: Default::default() };
    assert!(round_trip(ctx, &packed).contains_key("gbuffer.exr"));
    round_trip(ctx, &PackedScene { gbuffer: None, sampler: SamplerKind::Sobol, ..packed });
    let said = |nfe| RefinedImage { method: "mc_noise".into(), from_spp: 1, to_spp: 4, nfe };
    let images = vec![(said(1), image(3, 3.0)), (said(2), image(3, 4.0))];
    round_trip(ctx, &Refined { images: images.clone(), note: Some("a note".into()), ..Default::default() });
    generated(ctx, |value| image(3, value).map(|v| v.clamp(0.0, 1.0)));
    let clock = BridgeClock { exponent: 0.7, ..BridgeClock::new(1, 4) };
    let setting = BTreeMap::from([("space".to_owned(), "linear".to_owned())]);
    round_trip(ctx, &BridgeSteps { clock, setting, images });
    let state = |calls, tau| RolloutState { method: "mc_noise".into(), from_spp: 1, nfe: 2, calls, tau };
    let states = vec![(state(1, 0.3), image(3, 5.0)), (state(2, 1.0), image(3, 6.0))];
    let files = round_trip(ctx, &Rollout { clock, states });
    assert!(files.contains_key("mc_noise-1-nfe-2-call-0001.exr"), "{:?}", files.keys());
}

/// A sample of a backbone, with frames of one variant.
fn generated(ctx: &Context<'_>, image: impl Fn(f32) -> Image) {
    let variant =
        |variant, value| GeneratedVariant { variant, image: image(value), energy: vec![0.0, 0.1], frames: Vec::new() };
    let frames = vec![Snapshot { step: 0, image: image(0.1) }, Snapshot { step: 2, image: image(0.05) }];
    let adapted = GeneratedVariant { frames, ..variant(Variant::Adapted, 0.3) };
    let variants = vec![variant(Variant::Frozen, 0.2), adapted, variant(Variant::EtaZero, 0.2)];
    let backbone = crate::methods::MethodName::new("ddpm_church").expect("a name");
    let files = round_trip(ctx, &Generated { backbone, family: Family::Ddpm, sample: 3, steps: 2, variants });
    assert!(files.contains_key("adapted-step-0000.exr") && files.contains_key("eta_zero.png"), "{:?}", files.keys());
}

fn parsed<T: serde::de::DeserializeOwned>(value: serde_json::Value) -> T {
    serde_json::from_value(value).expect("a record")
}

/// Records with tables in them.
fn tables(ctx: &Context<'_>) {
    let table: ScoreTable = parsed(json!({
        "title": "", "axes": [{ "name": "spp", "type": "number", "values": [0.5, 4] }], "row_axes": 1,
        "metrics": ["ssim"], "reference_spp": null, "items": 1, "resamples": 100, "per_item": [],
        "cells": [{ "at": [4], "items": 1, "metrics": { "ssim": { "mean": 0.5, "low": 0.4, "high": 0.6 } } }],
        "formats": { "latex": false }
    }));
    round_trip(ctx, &table);
    let statistics: SceneStatistics = parsed(json!({
        "mean_path_length": 2.5, "environment_share": 0.5, "diffuse_share": 0.25, "refractive_share": 0.1,
        "caustic_share": 0.0, "relative_rmse": 0.3, "slope": null, "tail_share": 0.1,
        "samples_to_percent": 900.0, "depth_discontinuities": 0.1, "normal_discontinuities": 0.2,
        "picture": { "edge_density": 0.2, "spectrum_slope": null, "saturation": 0.1, "saturation_spread": 0.0,
            "hue_entropy": 0.5, "log_luminance_spread": 1.0, "log_contrast": 0.25 },
        "spp": [64, 1024], "rejected": 0, "dropped": 1,
    }));
    round_trip(ctx, &statistics);
    let log: TrainingLog = parsed(json!({
        "parameterization": "mc_noise", "conditioning": "rgb", "space": "linear", "preset": "tiny", "weights": 10,
        "steps": 2, "params": { "steps": 2 }, "points": [{ "step": 0, "train": null, "test": 0.1, "gain": null,
        "learning_rate": 0.0, "gradient_norm": null }],
    }));
    round_trip(ctx, &log);
    let evaluation: Evaluation = parsed(json!({
        "reference_spp": 4, "from_spp": 1, "scenes": 1, "resamples": 10, "nfe": [1],
        "hold": { "ssim": { "mean": 0.5, "low": 0.25, "high": 0.75 } }, "methods": [], "per_scene": [],
    }));
    round_trip(ctx, &evaluation);
    let time_error: TimeError = parsed(json!({
        "machine": { "cores": 2 }, "reference_spp": 64, "scenes": 1, "resamples": 10, "methods": [], "notes": ["none"],
    }));
    round_trip(ctx, &time_error);
    let claim = json!({ "statement": "s", "group": {}, "evidence": [], "verdict": "undecided" });
    let half = json!({ "mean": 0.5, "low": 0.25, "high": 0.75 });
    let quality: ImageQuality = parsed(json!({
        "judged_by": "mmd", "resamples": 10, "references": 3, "training": 4,
        "columns": [{ "name": "mmd", "better": "lower" }], "notes": ["a note"],
        "backbones": [{ "backbone": "ddpm", "family": "ddpm", "samples": 2, "steps": 2, "size": [3, 2],
            "variants": [{ "variant": "frozen", "scores": { "mmd": half }, "change": 0.0, "energy": [0.0, 0.0] }],
            "gains": [{ "over": "frozen", "scores": { "mmd": half } }],
            "gaussian": { "images": 2, "samples": 2, "steps": 3, "gaussian": half, "frozen": half, "nearer": half },
            "claim": claim }],
        "per_sample": [{ "backbone": "ddpm", "sample": 0, "variant": "frozen", "scores": { "clipiqa": 0.5 } }],
    }));
    round_trip(ctx, &quality);
    let row = json!({
        "stratum": "all", "scenes": 1, "noiseless": 1, "unresolved": 0, "rmse": [], "law": [], "slope": null,
        "mean": [], "covariance": [], "excess_kurtosis": null, "tail_index": null, "off_normal": [],
        "trusted_from": null, "tail_share": 0.0, "heavy_scenes": 0, "heavy_tail": false, "mean_path_length": 1.0,
        "rejected": 0,
    });
    let convergence: Convergence =
        parsed(json!({ "reference_spp": 64, "counts": [1, 2], "overall": row, "strata": [], "scenes": [], "sde": [] }));
    round_trip(ctx, &convergence);
}

#[test]
fn files_that_do_not_fit_are_refused() {
    in_memory(|ctx| {
        let mut files = FileTree::new();
        Ladder::export(ctx, ladder().store(ctx).expect("in memory").artifact(), &mut files).expect("whole");
        let import = |files: &FileTree| Ladder::import(ctx, files).map(Stored::into_artifact);
        let mut more = files.clone();
        more.insert("spp-000004.exr".into(), files["spp-000002.exr"].clone());
        assert!(import(&more).expect_err("a rung that is not listed").to_string().contains("[1, 2, 4]"));
        let mut other = files.clone();
        other.insert("variance.exr".into(), crate::image_io::exr_bytes(&[("", &image(4, 1.0))]).expect("fits"));
        assert!(import(&other).expect_err("another size").to_string().contains("3 x 2"));
        let mut damaged = files;
        damaged.insert("spp-000001.exr".into(), b"no picture".to_vec());
        assert!(import(&damaged).expect_err("damaged").to_string().contains("spp-000001.exr"));
        let twice = RefinedImage { method: "a".into(), from_spp: 1, to_spp: 4, nfe: 1 };
        let twice = Refined {
            images: vec![(twice.clone(), image(3, 1.0)), (twice, image(3, 2.0))],
            note: None,
            ..Default::default()
        };
        assert!(twice.store(ctx).expect_err("one name").to_string().contains("`a-1-to-4-nfe-1`"));
        let said = RefinedImage { method: "../../x".into(), from_spp: 1, to_spp: 4, nfe: 1 };
        let outside = Refined { images: vec![(said, image(3, 1.0))], note: None, ..Default::default() };
        assert!(outside.store(ctx).expect_err("a path").to_string().contains("../../x"));
    });
}

fn records(ctx: &Context<'_>) {
    round_trip(ctx, &Exposure { factor: 1.5, ev: -0.25, mean_luminance: 0.1 });
    round_trip(ctx, &Verdict { reasons: vec!["black".into()], measures: [("mean".into(), 0.0)].into() });
    round_trip(ctx, &SampleScores::default());
    round_trip(ctx, &SplitReport::default());
    round_trip(ctx, &SamplingReport::default());
    round_trip(ctx, &AssetReport { name: "a".into(), ..AssetReport::default() });
    round_trip(ctx, &Timing::here(Vec::new()));
    round_trip(ctx, &SceneScores { reference_spp: 4, scores: Vec::new(), note: None });
    round_trip(ctx, &TrainingTiming { steps: 1, seconds: 0.5, median_step_ms: 0.5, threads: 2, machine: Value::Null });
    round_trip(ctx, &ModelFile(vec![1, 2, 3]));
    round_trip(ctx, &AdapterFile(vec![1, 2, 3]));
    round_trip(ctx, &PerceptualFile(vec![1, 2, 3]));
    let backbone = BackboneFiles { config: "{}".into(), scheduler: Some("{ }".into()), weights: vec![1, 2] };
    assert!(round_trip(ctx, &backbone).contains_key("scheduler_config.json"));
    round_trip(ctx, &BackboneFiles { scheduler: None, ..backbone });
    let bridge = Bridge {
        groups: Some(1),
        n_max: 4,
        scenes: 0,
        setting: BTreeMap::from([("space".to_owned(), "linear".to_owned())]),
        rows: Vec::new(),
        summary: Vec::new(),
        claims: Vec::new(),
        cases: Vec::new(),
    };
    let maps = [("a.png".to_owned(), vec![1])].into();
    round_trip(ctx, &BridgeFiles { bridge, cases_csv: b"a,b\n".to_vec(), maps });
}

fn assets_and_scenes(ctx: &Context<'_>) {
    let image = ctx.put(&image(3, 1.0).to_bytes()).expect("in memory");
    let body = AssetBody::Hdri { image, size: [3, 2], mean: 1.0, top_share: 0.1 };
    let asset = Asset { name: "a.hdr".into(), body };
    let files = round_trip(ctx, &asset);
    let blob = format!("blob/{image}");
    let mut other: FileTree = files.clone();
    other.insert(blob.clone(), b"other".to_vec());
    assert!(Asset::import(ctx, &other).expect_err("other bytes").to_string().contains(&blob));
    let scene = parsed(json!({
        "version": 1, "seed": 1, "max_depth": 2, "shapes": [], "materials": [],
        "camera": { "origin": [0, 0, 4], "target": [0, 0, 0], "up": [0, 1, 0], "fov_x": 40, "near": 0.01 },
        "emitters": [{ "type": "envmap", "image": image, "scale": 1.0, "to_world": crate::scene::IDENTITY }],
    }));
    let recipe = parsed(json!({
        "stratum": "L0-open", "index": 0, "layout": "plain", "layout_params": {}, "objects": [],
        "environment": "none", "side": null, "exposure_ev": 0.0, "content": 0, "view": 0,
    }));
    let files = round_trip(ctx, &SceneRecord { scene, recipe });
    assert!(files.contains_key(&blob), "{:?}", files.keys());
}

#[test]
fn the_table_has_each_name_once() {
    let names: BTreeSet<&str> = MEDIA.iter().map(|row| row.name).collect();
    assert_eq!(names.len(), MEDIA.len());
    assert!(MEDIA.iter().all(|row| !row.doc.is_empty() && row.name.starts_with("tauflow/")));
    assert!(media("application/json").is_none());
}

#[test]
fn a_handle_of_another_type_is_refused() {
    in_memory(|ctx| {
        let stored = ladder().store(ctx).expect("in memory");
        assert!(Handle::<GBuffer>::new(stored.artifact()).is_err());
    });
}
