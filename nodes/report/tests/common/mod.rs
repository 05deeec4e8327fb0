//! Synthetic material for reports: invented scenes, noise and scores of a plausible shape. None of it is a result.

pub mod extras;

use std::collections::BTreeMap;
use tauflow_contract::{
    Action, Artifact, Collection, Context, Files, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::{
    Image, Stratum,
    image::preview,
    maths::{cosf, exp, log10, sinf},
    methods::{Conditioning, HOLD, OIDN, Parameterization},
    records::{
        Claim, ClaimVerdict, Estimate, Evaluation, Evidence, METRICS, MethodTable, Metrics, NfeTable, PackedScene,
        Refined, RefinedImage, SceneRow, Score, Versus, higher_is_better,
    },
    rng::Stream,
};
use tauflow_report::{Report, ReportParams};

pub const NFE: [u64; 5] = [1, 2, 9, 20, 50];

pub const METHODS: [&str; 4] = [
    Parameterization::ALL[0].name(),
    Parameterization::ALL[1].name(),
    Parameterization::ALL[2].name(),
    Parameterization::ALL[3].name(),
];
pub const CONDITIONINGS: [&str; 2] = [Conditioning::Rgb.name(), Conditioning::Gbuffer.name()];
pub const LAST: u64 = 256;

pub fn key(text: &str) -> ItemKey {
    ItemKey::new(text).expect("a plain key")
}

pub fn cell(method: &str, conditioning: &str) -> BTreeMap<String, String> {
    BTreeMap::from([("parameterization".into(), method.into()), ("conditioning".into(), conditioning.into())])
}

pub fn cell_key(method: &str, conditioning: &str) -> String {
    format!("parameterization={method}+conditioning={conditioning}")
}

/// Scenes: two of each stratum.
pub fn scenes() -> Vec<(String, Stratum)> {
    Stratum::all().flat_map(|s| [3, 11].map(|i| (s.item_key(i).to_string(), s))).collect()
}

/// A ball on a floor below a sky, its colours by number.
fn clean(number: usize, size: usize) -> Image {
    let mut image = Image::new(size, size, 3);
    let hue = number as f32 * 0.7;
    let tint = [0.5 + 0.4 * sinf(hue), 0.5 + 0.4 * sinf(hue + 2.1), 0.5 + 0.4 * sinf(hue + 4.2)];
    for y in 0..size {
        for x in 0..size {
            let (u, v) = ((x as f32 + 0.5) / size as f32 * 2.0 - 1.0, 1.0 - (y as f32 + 0.5) / size as f32 * 2.0);
            let r2 = u * u + (v + 0.1) * (v + 0.1);
            let value = if r2 < 0.3 {
                let nz = (1.0 - r2 / 0.3).sqrt();
                let light = (0.4 * u + 0.7 * (v + 0.1) + 0.6 * nz).max(0.05);
                tint.map(|t| t * light + 0.6 * light * light * light * light * light * light)
            } else if v < -0.25 {
                let check = cosf(14.0 * u / (0.3 - v)) * cosf(6.0 / (0.2 - v)) > 0.0;
                [if check { 0.45 } else { 0.12 }; 3]
            } else {
                [0.25 + 0.2 * v, 0.4 + 0.2 * v, 0.7 + 0.3 * v]
            };
            image.pixel_mut(x, y).copy_from_slice(&value);
        }
    }
    image
}

fn noisy(image: &Image, sigma: f32, stream: &mut Stream) -> Image {
    let mut out = image.clone();
    for value in out.data_mut() {
        *value = (*value + sigma * stream.normal() as f32).max(0.0);
    }
    out
}

pub fn metrics(image: &Image, reference: &Image) -> Metrics {
    let n = image.data().len() as f64;
    let pairs = || image.data().iter().zip(reference.data());
    let square: f64 = pairs().map(|(a, b)| f64::from(a - b) * f64::from(a - b)).sum::<f64>() / n;
    let mae = pairs().map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / n;
    let shown: f64 = pairs().map(|(a, b)| f64::from((preview(*a) - preview(*b)).abs())).sum::<f64>() / n;
    let psnr = -10.0 * log10(square);
    Metrics {
        hdr_psnr: psnr,
        hdr_psnr_max: psnr + 1.3,
        hdr_mae: mae,
        preview_psnr: -20.0 * log10(shown * 1.25),
        preview_mae: shown,
        ssim: exp(-6.0 * shown),
        ms_ssim: Some(exp(-3.0 * shown)),
        flip: Some(2.0 * shown),
        hdr_flip: Some(2.5 * shown),
        lpips: Some(shown * shown),
    }
}

/// Noise that a method leaves at an NFE.
fn left(method: &str, conditioning: &str, nfe: u64, regime: usize) -> f32 {
    let base = match method {
        "vanilla_rf" => 0.115,
        "local_velocity" => 0.16 / (nfe as f32).sqrt() + 0.07,
        "mc_velocity" => 0.085 + 0.0006 * nfe as f32,
        _ => 0.062 + 0.0001 * nfe as f32,
    };
    base * if conditioning == "gbuffer" { 0.82 } else { 1.0 } * (0.7 + 0.25 * regime as f32)
}

/// References and refined images.
pub struct Pictures {
    pub references: Collection,
    pub refined: Collection,
    pub rows: Vec<SceneRow>,
}

pub fn pictures(ctx: &Context<'_>, size: usize) -> Result<Pictures, KindError> {
    let (mut references, mut refined, mut rows) = (Collection::default(), Collection::default(), Vec::new());
    for (number, (name, stratum)) in scenes().into_iter().enumerate() {
        let mut stream = Stream::new(5, &[number as u64]);
        let truth = clean(number, size);
        let regime = stratum.regime as usize;
        let sigma = 0.2 + 0.12 * regime as f32;
        let counts: Vec<u64> = (0..=8).map(|i| 1u64 << i).collect();
        let states: Vec<Image> =
            counts.iter().map(|n| noisy(&truth, sigma / (*n as f32).sqrt(), &mut stream)).collect();
        let reference = states[8].clone();
        let row = |cell, method: &str, nfe, image: &Image| SceneRow {
            scene: name.clone(),
            stratum: stratum.to_string(),
            cell,
            score: Score { method: method.into(), from_spp: 1, to_spp: LAST, nfe, metrics: metrics(image, &reference) },
        };
        rows.push(row(BTreeMap::new(), HOLD, 0, &states[0]));
        for conditioning in CONDITIONINGS {
            for method in METHODS {
                let mut images = Vec::new();
                for nfe in NFE {
                    let image = noisy(&truth, left(method, conditioning, nfe, regime), &mut stream);
                    rows.push(row(cell(method, conditioning), method, nfe, &image));
                    images.push((RefinedImage { method: method.into(), from_spp: 1, to_spp: LAST, nfe }, image));
                }
                let own = format!("{}/{name}", cell_key(method, conditioning));
                refined.items.extend([item(ctx, &own, &Refined { images, note: None, ..Default::default() })]);
            }
        }
        let packed = PackedScene { counts, states, gbuffer: None, sampler: Default::default() };
        references.items.extend([item(ctx, &name, &packed)]);
    }
    Ok(Pictures { references, refined, rows })
}

fn estimate(values: &[f64]) -> Estimate {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let spread = (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
    let half = 1.96 * spread / n.sqrt();
    Estimate { mean, low: mean - half, high: mean + half }
}

/// One claim of each verdict.
fn claims() -> Vec<Claim> {
    let evidence = |what: &str, metric: &str, mean: f64| Evidence {
        what: what.into(),
        metric: metric.into(),
        difference: Estimate { mean, low: mean - 0.1, high: mean + 0.1 },
        draws: (what == "NFE 50 over NFE 1").then_some(Estimate { mean, low: mean - 0.2, high: mean + 0.2 }),
    };
    let claim = |statement: &str, conditioning: &str, verdict, evidence| Claim {
        statement: statement.into(),
        group: BTreeMap::from([("conditioning".to_owned(), conditioning.to_owned())]),
        evidence,
        verdict,
    };
    let best = |by: f64| {
        vec![evidence("AUC over vanilla_rf", "hdr_psnr", by), evidence("AUC over mc_velocity", "hdr_psnr", 0.7)]
    };
    vec![
        claim("MC noise has the best AUC", "rgb", ClaimVerdict::Held, best(0.31)),
        claim("MC noise has the best AUC", "gbuffer", ClaimVerdict::Undecided, best(0.05)),
        claim("HDR MAE grows", "rgb", ClaimVerdict::NotHeld, vec![evidence("NFE 50 over NFE 1", "hdr_mae", -0.25)]),
    ]
}

/// Means and intervals of rows; the intervals are normal ones.
pub fn evaluation(per_scene: Vec<SceneRow>) -> Evaluation {
    let value = |r: &SceneRow, m: &str| r.score.metrics.get(m).expect("a known metric");
    let of = |cell: &BTreeMap<String, String>, nfe: u64, m: &str| -> Vec<f64> {
        per_scene.iter().filter(|r| r.cell == *cell && r.score.nfe == nfe).map(|r| value(r, m)).collect()
    };
    let none = BTreeMap::new();
    let by = |f: &dyn Fn(&str) -> Estimate| METRICS.iter().map(|m| ((*m).to_owned(), f(m))).collect::<BTreeMap<_, _>>();
    let mut methods = Vec::new();
    for conditioning in CONDITIONINGS {
        for method in METHODS {
            let cell = cell(method, conditioning);
            let at: Vec<NfeTable> = NFE
                .into_iter()
                .map(|nfe| {
                    let gain = |m: &str| -> Vec<f64> {
                        of(&cell, nfe, m).iter().zip(of(&none, 0, m)).map(|(a, b)| a - b).collect()
                    };
                    let strata = Stratum::all().map(|s| s.to_string()).map(|s| {
                        let mean = |m: &str| {
                            let own: Vec<f64> = per_scene
                                .iter()
                                .filter(|r| r.cell == cell && r.score.nfe == nfe && r.stratum == s)
                                .map(|r| value(r, m))
                                .collect();
                            own.iter().sum::<f64>() / own.len() as f64
                        };
                        (s.clone(), METRICS.iter().map(|m| ((*m).to_owned(), mean(m))).collect())
                    });
                    NfeTable {
                        nfe,
                        metrics: by(&|m| estimate(&of(&cell, nfe, m))),
                        gain: by(&|m| estimate(&gain(m))),
                        strata: strata.collect(),
                    }
                })
                .collect();
            let curve = |m: &str| -> Vec<f64> { at.iter().map(|a| a.metrics[m].mean).collect() };
            let auc = by(&|m| estimate(&curve(m)));
            let tv = by(&|m| estimate(&curve(m).windows(2).map(|w| (w[1] - w[0]).abs()).collect::<Vec<_>>()));
            methods.push(MethodTable {
                method: method.into(),
                conditioning: conditioning.into(),
                space: "linear".into(),
                cell,
                at,
                auc,
                tv,
            });
        }
    }
    // Something like the last method, but made in one go.
    let like = methods[methods.len() - 1].clone();
    let oidn = BTreeMap::from([
        ("method".to_owned(), OIDN.to_owned()),
        ("conditioning".to_owned(), CONDITIONINGS[1].to_owned()),
    ]);
    let versus = |table: &MethodTable| Versus {
        cell: table.cell.clone(),
        nfe: 1,
        baseline: oidn.clone(),
        method: OIDN.into(),
        gain: by(&|m| estimate(&[if !higher_is_better(m) { -0.1 } else { 0.1 }, 0.0, 0.05])),
        better: METRICS.iter().map(|m| ((*m).to_owned(), 0.625)).collect(),
    };
    Evaluation {
        groups: Some(7),
        versus: methods.iter().map(versus).collect(),
        baselines: vec![MethodTable {
            method: OIDN.into(),
            cell: oidn.clone(),
            at: like.at[..1].to_vec(),
            auc: BTreeMap::new(),
            tv: BTreeMap::new(),
            ..like
        }],
        claims: claims(),
        notes: vec!["another: no library".into()],
        reference_spp: LAST,
        from_spp: 1,
        scenes: scenes().len() as u64,
        resamples: 2000,
        nfe: NFE.to_vec(),
        hold: by(&|m| estimate(&of(&none, 0, m))),
        methods,
        per_scene,
    }
}

/// A stored item under a key.
pub fn item<M: Media>(ctx: &Context<'_>, name: &str, value: &M) -> (ItemKey, Artifact) {
    (key(name), value.store(ctx).expect("memory").into_artifact())
}

/// Runs the kind on these inputs.
pub fn run(
    blobs: &MemoryBlobs,
    params: ReportParams,
    inputs: &BTreeMap<&'static str, Collection>,
) -> Result<BTreeMap<String, Vec<u8>>, KindError> {
    let cancel = std::sync::atomic::AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &cancel);
    let all = inputs.iter().map(|(port, collection)| (*port, collection)).collect();
    let action = Action { params, item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
    let outputs: Outputs = Report::run(&ctx, &action)?;
    let artifact = outputs.collections["report"].get("report").expect("one item");
    Ok(Handle::<Files>::new(artifact)?.load(&ctx)?.0)
}
