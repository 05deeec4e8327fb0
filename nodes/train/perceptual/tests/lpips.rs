//! LPIPS against the Python package `lpips` 0.1.4 with made-up weights; weights that cannot be used; the kinds.

use std::{path::PathBuf, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Artifact, Collection, Context, ItemKey, Kind, Media, MemoryBlobs, Silent};
use tauflow_data::{
    Image, TensorFile,
    image::preview,
    methods::HOLD,
    records::{Metrics, PackedScene, PerceptualFile, Refined, RefinedImage, SceneScores, Score},
};
use tauflow_perceptual::{File, Lpips, LpipsParams, LpipsWeights, LpipsWeightsParams, Network, read};
use tauflow_testing::{Need, skip};

/// Place, inputs, outputs and kernel side of AlexNet's convolutions.
const LAYERS: [(usize, usize, usize, usize); 5] =
    [(0, 3, 64, 11), (3, 64, 192, 5), (6, 192, 384, 3), (8, 384, 256, 3), (10, 256, 256, 3)];

/// Numbers within [0, 1) that any language can make: a multiplicative sequence of 32 bits.
fn made_up(count: usize, salt: u64) -> impl Iterator<Item = f64> {
    (0..count as u64).map(move |i| ((i * 2_654_435_761 + salt * 97) % (1 << 32)) as f64 / (1u64 << 32) as f64)
}

fn trunk() -> TensorFile {
    let mut file = TensorFile::default();
    for (j, (place, inputs, outputs, side)) in LAYERS.into_iter().enumerate() {
        let around = |bound: f64, count: usize, salt: usize| -> Vec<f32> {
            made_up(count, salt as u64).map(|u| ((u - 0.5) * 2.0 * bound) as f32).collect()
        };
        let bound = 2.0 / ((inputs * side * side) as f64).sqrt();
        let kernel = around(bound, outputs * inputs * side * side, j);
        file = file.with(&format!("features.{place}.weight"), &[outputs, inputs, side, side], kernel);
        file = file.with(&format!("features.{place}.bias"), &[outputs], around(0.1, outputs, 10 + j));
    }
    file
}

fn lin() -> TensorFile {
    LAYERS.into_iter().enumerate().fold(TensorFile::default(), |file, (j, (_, _, outputs, _))| {
        let weights = made_up(outputs, 20 + j as u64).map(|u| (u * 0.5) as f32).collect();
        file.with(&format!("lin{j}.model.1.weight"), &[1, outputs, 1, 1], weights)
    })
}

fn joined(trunk: &TensorFile, lin: &TensorFile) -> Result<TensorFile, String> {
    let bytes = [trunk, lin].map(|file| file.to_bytes().expect("shapes fit"));
    let [trunk, lin] = ["alexnet.safetensors", "alex.safetensors"].map(ToOwned::to_owned);
    let found = read(File { name: &trunk, bytes: &bytes[0] }, File { name: &lin, bytes: &bytes[1] });
    found.map_err(|error| error.to_string())
}

/// A pattern and a disturbed copy, each within [0, 1].
fn pair(width: usize, height: usize) -> [Image; 2] {
    let clean = |x: usize, y: usize, k: usize| (3 * x * x + 7 * y + 5 * x * y + 29 * k) % 64;
    let noisy = |x: usize, y: usize, k: usize| (clean(x, y, k) + (11 * x + 5 * y + 3 * k) % 9) % 64;
    let image = |of: &dyn Fn(usize, usize, usize) -> usize| {
        let at = |i: usize| (of(i / 3 % width, i / 3 / width, i % 3) as f64 / 63.0) as f32;
        Image::from_data(width, height, 3, (0..3 * width * height).map(at).collect()).expect("as many")
    };
    [image(&clean), image(&noisy)]
}

fn lpips(network: &Network, a: &Image, b: &Image) -> f64 {
    let [a, b] = [a, b].map(|image| network.features(image).expect("large enough"));
    network.distance(&a, &b).expect("finite")
}

#[test]
fn made_up_weights_give_the_distances_of_the_python_package() {
    let network = Network::new(&joined(&trunk(), &lin()).expect("whole")).expect("whole");
    for (width, height, expected) in [(40, 36, 0.512_740_832), (31, 31, 0.900_473_442)] {
        let [clean, noisy] = pair(width, height);
        let found = lpips(&network, &clean, &noisy);
        assert!((found - expected).abs() < 1e-5 * expected, "{found}, expected {expected}");
        assert_eq!(found, lpips(&network, &noisy, &clean));
        assert_eq!(lpips(&network, &clean, &clean), 0.0);
    }
    let [small, _] = pair(40, 30);
    let told = network.features(&small).expect_err("30 rows are too few").to_string();
    assert!(told.contains("31 x 31") && told.contains("40 x 30"), "{told}");
}

#[test]
fn random_weights_give_the_reference_distances() {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../shared/reference"));
    if !folder.is_dir() {
        skip(Need::Shared, format_args!("there is no {}", folder.display()));
        return;
    }
    let file = |name: &str| std::fs::read(folder.join(name)).expect("readable");
    let (trunk, lin) = ("lpips_alex_trunk_random.safetensors", "lpips_alex_lin_random.safetensors");
    let weights = read(File { name: trunk, bytes: &file(trunk) }, File { name: lin, bytes: &file(lin) });
    let network = Network::new(&weights.expect("whole")).expect("whole");
    let pairs = TensorFile::from_bytes(&file("metric_pairs.safetensors")).expect("f32 tensors");
    let image = |name: &str| {
        let tensor = pairs.get(name).expect("the tensor is there");
        let (height, width) = (tensor.shape[1], tensor.shape[2]);
        let at = |i: usize| preview(tensor.data[i % 3 * height * width + i / 3]);
        Image::from_data(width, height, 3, (0..3 * height * width).map(at).collect()).expect("fits")
    };
    let expected: serde_json::Value = serde_json::from_slice(&file("metric_expected.json")).expect("JSON");
    let rows = expected.as_array().expect("a list");
    assert_eq!(rows.len(), 4);
    for row in rows {
        let pair = row["pair"].as_u64().expect("a number");
        let expected = row["lpips_alex_random"].as_f64().expect("a number");
        let found = lpips(&network, &image(&format!("img{pair}")), &image(&format!("ref{pair}")));
        assert!((found - expected).abs() <= 1e-4 * expected, "pair {pair}: {found}, expected {expected}");
    }
}

#[test]
fn weights_that_do_not_fit_are_refused_by_file_and_tensor() {
    let whole = joined(&trunk(), &lin()).expect("whole");
    assert_eq!(whole.tensors.len(), 15);
    let with_classifier = trunk().with("classifier.1.weight", &[1], vec![0.0]);
    assert_eq!(joined(&with_classifier, &lin()).expect("the classifier is ignored"), whole);

    let mut lacking = trunk().with("features.3.bias", &[2], vec![0.0; 2]).with("features.12.bias", &[1], vec![0.0]);
    lacking.tensors.remove("features.6.weight");
    let told = joined(&lacking, &lin()).expect_err("refused");
    for part in [
        "`alexnet.safetensors`",
        "tensor `features.6.weight` [384, 192, 3, 3] is missing",
        "tensor `features.3.bias` has shape [2], expected [192]",
        "tensor `features.12.bias` [1] is unknown",
        "name the AlexNet of torchvision as `trunk`",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
    let mut nan = lin();
    nan.tensors.get_mut("lin2.model.1.weight").expect("there").data[7] = f32::NAN;
    let told = joined(&trunk(), &nan).expect_err("refused");
    assert!(
        told.contains("`alex.safetensors`") && told.contains("`lin2.model.1.weight` holds 1 numbers that"),
        "{told}"
    );
    // Two files that were exchanged, and a file that is none.
    assert!(joined(&lin(), &trunk()).expect_err("refused").contains("`features.0.weight`"));
    let cut = read(File { name: "a.pth", bytes: b"PK\x03\x04" }, File { name: "b", bytes: b"" });
    assert!(cut.expect_err("refused").to_string().contains("`a.pth`"));
}

#[test]
fn weights_that_overflow_are_refused_by_layer() {
    let mut huge = trunk();
    huge.tensors.get_mut("features.0.weight").expect("there").data.fill(f32::MAX);
    let network = Network::new(&joined(&huge, &lin()).expect("finite")).expect("whole");
    let [clean, noisy] = pair(40, 36).map(|image| network.features(&image).expect("large enough"));
    let told = network.distance(&clean, &noisy).expect_err("not finite").to_string();
    assert!(told.contains("`features.0.weight`") && told.contains("published weights"), "{told}");
}

/// The kinds over blobs in memory.
struct Bench {
    blobs: MemoryBlobs,
    stop: AtomicBool,
}

impl Bench {
    fn new() -> Self {
        Self { blobs: MemoryBlobs::default(), stop: AtomicBool::new(false) }
    }

    fn ctx(&self) -> Context<'_> {
        Context::new(&self.blobs, &Silent, &self.stop)
    }

    fn store(&self, value: &impl Media) -> Artifact {
        value.store(&self.ctx()).expect("in memory").into_artifact()
    }

    fn run(&self, inputs: &[(&'static str, Artifact)], weights: Option<&Collection>) -> Result<SceneScores, String> {
        let item = ItemKey::new("L0-open-000000").expect("plain");
        let each = inputs.iter().map(|(name, artifact)| (*name, artifact)).collect();
        let all = weights.map(|weights| ("weights", weights)).into_iter().collect();
        let params = LpipsParams {};
        let action = Action { params, item: Some(&item), group: "main", seed: 0, each, all };
        let outputs = Lpips::run(&self.ctx(), &action).map_err(|error| error.to_string())?;
        SceneScores::load(&self.ctx(), &outputs.items["metrics"]).map_err(|error| error.to_string())
    }
}

fn scores(said: &[(&str, u64)]) -> SceneScores {
    let score = |(method, nfe): &(&str, u64)| Score {
        method: (*method).to_owned(),
        from_spp: 1,
        to_spp: if *nfe == 0 { 1 } else { 2 },
        nfe: *nfe,
        metrics: Metrics { hdr_psnr: 20.0, ..Metrics::default() },
    };
    SceneScores { reference_spp: 2, scores: said.iter().map(score).collect(), note: None }
}

#[test]
fn scores_gain_the_metric_of_their_own_images() {
    let bench = Bench::new();
    let weights = joined(&trunk(), &lin()).expect("whole");
    let network = Network::new(&weights).expect("whole");
    let file = PerceptualFile(weights.to_bytes().expect("shapes fit"));
    let weights: Collection = [(ItemKey::new("alex").expect("plain"), bench.store(&file))].into_iter().collect();
    let [clean, noisy] = pair(40, 36);
    let packed = PackedScene {
        counts: vec![1, 2],
        states: vec![noisy.clone(), clean.clone()],
        gbuffer: None,
        sampler: Default::default(),
    };
    let packed = bench.store(&packed);
    let shown = |image: &Image| image.map(preview);

    // Without images, the rung of each score.
    let hold = [("scores", bench.store(&scores(&[(HOLD, 0)]))), ("references", packed.clone())];
    let found = bench.run(&hold, Some(&weights)).expect("scored");
    let expected = lpips(&network, &shown(&noisy), &shown(&clean));
    assert_eq!(found.scores[0].metrics, Metrics { lpips: Some(expected), hdr_psnr: 20.0, ..Metrics::default() });

    // With images, those of the same method and number of calls, in any order.
    let said = |nfe| RefinedImage { method: "m".into(), from_spp: 1, to_spp: 2, nfe };
    let images = vec![(said(9), clean.clone()), (said(1), noisy.clone())];
    let images = bench.store(&Refined { images, note: None, ..Default::default() });
    let given = |list: &[(&str, u64)]| {
        [("scores", bench.store(&scores(list))), ("images", images.clone()), ("references", packed.clone())]
    };
    let found = bench.run(&given(&[("m", 1), ("m", 9)]), Some(&weights)).expect("scored");
    assert_eq!(found.scores.iter().map(|s| s.metrics.lpips).collect::<Vec<_>>(), [Some(expected), Some(0.0)]);
    let told = bench.run(&given(&[("m", 2)]), Some(&weights)).expect_err("there is no such image");
    assert!(told.contains("NFE 2") && told.contains("L0-open-000000") && told.contains("`references`"), "{told}");

    // Without weights, the scores as they are, and a note.
    for none in [None, Some(&Collection::default())] {
        let found = bench.run(&given(&[("m", 1)]), none).expect("passed on");
        assert_eq!(found.scores, scores(&[("m", 1)]).scores);
        assert!(found.note.expect("a note").contains("`trunk` and `lin`"));
    }

    // Values that are no numbers are told by scene.
    let mut broken = clean.clone();
    broken.data_mut()[5] = f32::NAN;
    let broken = bench.store(&PackedScene {
        counts: vec![1, 2],
        states: vec![broken, clean],
        gbuffer: None,
        sampler: Default::default(),
    });
    let told = bench.run(&[hold[0].clone(), ("references", broken)], Some(&weights)).expect_err("not finite");
    assert!(told.contains("1 of the 4320 values") && told.contains("`hold`, 1 -> 1 samples"), "{told}");
}

#[test]
fn both_files_of_weights_are_named_or_neither() {
    let params = |trunk: Option<&str>, lin: Option<&str>| LpipsWeightsParams {
        trunk: trunk.map(str::to_owned),
        lin: lin.map(str::to_owned),
    };
    let place =
        |params: &LpipsWeightsParams| LpipsWeights::check(params).into_iter().map(|p| p.pointer).collect::<Vec<_>>();
    assert_eq!(place(&params(Some("a"), None)), ["/lin"]);
    assert_eq!(place(&params(None, Some("b"))), ["/trunk"]);
    assert!(place(&params(None, None)).is_empty() && place(&params(Some("a"), Some("b"))).is_empty());
    assert!(LpipsWeights::items(&params(None, None)).expect("none").is_empty());
    let told = LpipsWeights::items(&params(Some("no/such.safetensors"), Some("b"))).expect_err("no file").to_string();
    assert!(told.contains("`no/such.safetensors`") && told.contains("mend `trunk`"), "{told}");
}
