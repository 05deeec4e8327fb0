//! Made-up samples and scores for the adapter's page. None of it is a result.

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Collection, Context, FileTree, Files, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Silent,
};
use tauflow_data::{
    Image,
    maths::exp,
    methods::MethodName,
    records::{
        AgainstGaussian, BackboneQuality, Better, Claim, ClaimVerdict, Estimate, Evidence, Family, Gain, Generated,
        GeneratedVariant, ImageQuality, SampleRow, ScoreColumn, Snapshot, Variant, VariantQuality,
    },
    rng::Stream,
};
use tauflow_report::{AdapterReport, AdapterReportParams};

/// Backbones by name.
pub const BACKBONES: [(&str, Family, u64); 2] =
    [("ddpm_own", Family::Ddpm, 100), ("rf_own", Family::RectifiedFlow, 32)];

/// How noisy a variant is.
fn noise(variant: Variant) -> f64 {
    match variant {
        Variant::Adapted => 0.04,
        Variant::ShuffledResiduals => 0.08,
        Variant::GaussianResiduals => 0.09,
        _ => 0.1,
    }
}

fn energy(variant: Variant, steps: u64) -> Vec<f64> {
    let strength = match variant {
        Variant::Adapted => 2e-4,
        Variant::ShuffledResiduals => 1e-4,
        Variant::GaussianResiduals => 1.5e-4,
        _ => 0.0,
    };
    let late = |step: u64| ((step as f64 / steps as f64 - 0.5) / 0.5).max(0.0);
    (1..=steps).map(|step| strength * late(step).powi(4)).collect()
}

/// A ball before a wall, with noise.
fn picture(seed: u64, side: usize, noise: f64) -> Image {
    let (mut scene, mut grain) = (Stream::new(seed, &[1]), Stream::new(seed, &[2]));
    let [x, y] = [0, 1].map(|_| scene.range(0.35, 0.65));
    let (radius, tint) = (scene.range(0.15, 0.3), [0, 1, 2].map(|_| scene.range(0.4, 0.9)));
    let mut image = Image::new(side, side, 3);
    for (column, row) in (0..side).flat_map(|row| (0..side).map(move |column| (column, row))) {
        let [u, v] = [column, row].map(|at| (at as f64 + 0.5) / side as f64);
        let off = ((u - x).powi(2) + (v - y).powi(2)) / (radius * radius);
        for (c, value) in image.pixel_mut(column, row).iter_mut().enumerate() {
            let shown = if off < 1.0 { tint[c] * exp(-0.8 * off) } else { 0.25 + 0.4 * v };
            *value = (shown + noise * grain.normal()).clamp(0.0, 1.0) as f32;
        }
    }
    image
}

/// A sample of a backbone in all variants, with frames of the first two.
fn generated((backbone, family, steps): (&str, Family, u64), sample: u64, side: usize) -> Generated {
    let variant = |variant: Variant| {
        let kept = if sample == 0 && !variant.is_control() { 8 } else { 0 };
        let frame = |at: u64| Snapshot {
            step: at * steps / 8,
            image: picture(sample, side, noise(variant) + 0.5 * (1.0 - at as f64 / 8.0)),
        };
        let image = picture(sample, side, noise(variant));
        GeneratedVariant { variant, image, energy: energy(variant, steps), frames: (0..=kept).map(frame).collect() }
    };
    let mut variants: Vec<GeneratedVariant> = Variant::ALL.map(variant).into();
    variants.iter_mut().filter(|its| its.frames.len() < 2).for_each(|its| its.frames.clear());
    Generated { backbone: MethodName::new(backbone).expect("a name"), family, sample, steps, variants }
}

fn estimate(mean: f64, half: f64) -> Estimate {
    Estimate { mean, low: mean - half, high: mean + half }
}

fn table((backbone, family, steps): (&str, Family, u64), number: f64) -> BackboneQuality {
    let scores = |variant: Variant| {
        let n = noise(variant);
        BTreeMap::from([
            ("mmd".to_owned(), estimate(number * n, 0.01)),
            ("swd".to_owned(), estimate(3.0 * number * n, 0.05)),
            ("niqe".to_owned(), estimate(40.0 * n, 0.3)),
            ("musiq".to_owned(), estimate(60.0 - 100.0 * n, 1.5)),
        ])
    };
    let variant = |variant: Variant| VariantQuality {
        variant,
        scores: scores(variant),
        change: (0.1 - noise(variant)).max(0.0),
        energy: energy(variant, steps),
    };
    let gain = |over: Variant| {
        let difference = |(name, own): (String, Estimate)| {
            let other = scores(over)[&name].mean;
            let gain = if name == "musiq" { own.mean - other } else { other - own.mean };
            (name, estimate(gain, 0.4 * gain))
        };
        Gain { over, scores: scores(Variant::Adapted).into_iter().map(difference).collect() }
    };
    let gains: Vec<Gain> = Variant::ALL.into_iter().filter(|v| *v != Variant::Adapted).map(gain).collect();
    let evidence = |gain: &Gain| Evidence {
        what: format!("over {}", gain.over.label()),
        metric: "mmd".into(),
        difference: gain.scores["mmd"],
        draws: None,
    };
    let verdict = if number > 1.0 { ClaimVerdict::Held } else { ClaimVerdict::Undecided };
    let claim = Claim {
        statement: "The adapter's gain is physical".into(),
        group: BTreeMap::from([("backbone".to_owned(), backbone.to_owned())]),
        evidence: gains.iter().map(evidence).collect(),
        verdict,
    };
    let gaussian = AgainstGaussian {
        samples: 100,
        steps,
        images: 100,
        gaussian: estimate(0.9, 0.1),
        frozen: estimate(0.1, 0.02),
        nearer: estimate(0.8, 0.1),
    };
    BackboneQuality {
        backbone: backbone.into(),
        family,
        samples: 100,
        steps,
        size: [64, 64],
        variants: Variant::ALL.map(variant).into(),
        gains,
        gaussian: Some(gaussian),
        claim: Some(claim),
    }
}

/// Scores of both backbones.
pub fn quality() -> ImageQuality {
    let column = |name: &str| ScoreColumn {
        name: name.into(),
        better: if name == "musiq" { Better::Higher } else { Better::Lower },
    };
    let row = |sample: u64| SampleRow {
        backbone: "rf_own".into(),
        sample,
        variant: Variant::Frozen,
        scores: BTreeMap::from([("musiq".to_owned(), 50.0 + sample as f64)]),
    };
    ImageQuality {
        judged_by: "mmd".into(),
        resamples: 2000,
        references: 128,
        training: Some(128),
        columns: ["mmd", "swd", "niqe", "musiq"].map(column).into(),
        backbones: vec![table(BACKBONES[0], 1.0), table(BACKBONES[1], 2.0)],
        notes: vec!["CLIPIQA is left out: there is no manifest `models/clipiqa.json`".into()],
        per_sample: (0..2).map(row).collect(),
    }
}

/// The files of a page over this; without samples, if none are asked for.
pub fn files(params: AdapterReportParams, quality: &ImageQuality, samples: u64) -> Result<FileTree, KindError> {
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let key = |text: String| ItemKey::new(text).expect("a key");
    let one = [(key("quality".into()), quality.store(&ctx)?.into_artifact())].into_iter().collect();
    let mut items = Vec::new();
    for backbone in BACKBONES {
        for sample in 0..samples {
            let stored = generated(backbone, sample, 64).store(&ctx)?;
            items.push((key(format!("{}-{sample:04}", backbone.0)), stored.into_artifact()));
        }
    }
    let generated: Collection = items.into_iter().collect();
    let mut all: BTreeMap<&str, &Collection> = BTreeMap::from([("quality", &one)]);
    if samples > 0 {
        all.insert("generated", &generated);
    }
    let action = Action { params, item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
    let outputs = AdapterReport::run(&ctx, &action)?;
    let artifact = outputs.collections["report"].iter().next().expect("one").1;
    Ok(Handle::<Files>::new(artifact)?.load(&ctx)?.0)
}
