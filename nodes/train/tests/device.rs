//! The kinds on a device with a Vulkan driver, in a process of their own, which TAUFLOW_DEVICE sends there, against the
//! same on the CPU. Skips where there is no such device.

#![cfg(feature = "gpu")]

#[expect(dead_code, reason = "other tests use the rest")]
mod toy;

use serde_json::{Value, json};
use std::{collections::BTreeMap, process::Command, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Artifact, Collection, Context, Determinism, Kind, KindError, Look, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::records::{BridgeSteps, Refined, RefinedImages, TrainingLog};
use tauflow_testing::{Need, skip};
use tauflow_train::{
    BridgeRefinement, BridgeRefinementParams, Conditioning, Parameterization, Place, Refinement, RefinementParams,
    Training, TrainingParams,
};

const COUNTS: [u64; 5] = [1, 2, 4, 8, 16];
/// Before what the child tells.
const TOLD: &str = "told: ";

struct Lab {
    blobs: MemoryBlobs,
    train: Collection,
}

impl Lab {
    fn run<K: Kind>(
        &self,
        params: K::Params,
        each: &[(&'static str, &Artifact)],
        all: &[(&'static str, &Collection)],
    ) -> Result<Outputs, KindError> {
        let cancel = AtomicBool::new(false);
        let ctx = Context::new(&self.blobs, &Silent, &cancel);
        let (each, all): (BTreeMap<_, _>, BTreeMap<_, _>) =
            (each.iter().copied().collect(), all.iter().copied().collect());
        K::run(&ctx, &Action { params, item: None, group: "main", seed: 11, each, all })
    }

    fn train(&self, parameterization: Parameterization, conditioning: Conditioning) -> Result<Outputs, KindError> {
        let params = TrainingParams {
            parameterization,
            conditioning,
            steps: 8,
            batch: 2,
            crop: 16,
            learning_rate: 2e-3,
            warmup: 2,
            test_every: 2,
            checkpoint_every: 4,
            ..Default::default()
        };
        self.run::<Training>(params, &[], &[("train", &self.train), ("test", &self.train)])
    }
}

/// Losses of trainings, and refined images: a training with G-buffers and one without, and both ways to refine.
fn results() -> Result<Value, KindError> {
    let blobs = MemoryBlobs::default();
    let train = toy::collection(&blobs, 0..2, 24, &COUNTS);
    let endpoints = toy::collection(&blobs, 5..6, 24, &[1, 2, 3, 4]);
    let lab = Lab { blobs, train };
    let noise = lab.train(Parameterization::McNoise, Conditioning::Gbuffer)?;
    let local = lab.train(Parameterization::LocalVelocity, Conditioning::Rgb)?;
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(&lab.blobs, &Silent, &cancel);
    let losses = |outputs: &Outputs| -> Result<Vec<f64>, KindError> {
        let log = TrainingLog::load(&ctx, outputs.collections["log"].get("model").expect("one item"))?;
        Ok(log.points.iter().flat_map(|point| [point.train, point.test]).flatten().collect())
    };
    let (_, endpoint) = endpoints.iter().next().expect("one");
    let models = [&noise.collections["model"], &local.collections["model"]];
    let params = RefinementParams { nfe: vec![1, 3].try_into()?, ..Default::default() };
    let refined = lab.run::<Refinement>(params, &[("endpoints", endpoint)], &[("model", models[0])])?;
    let all = [("mc_noise", models[0]), ("local_velocity", models[1])];
    let bridge = lab.run::<BridgeRefinement>(BridgeRefinementParams {}, &[("endpoints", endpoint)], &all)?;
    let refined = Refined::load(&ctx, &refined.items["refined"])?.images;
    let steps = BridgeSteps::load(&ctx, &bridge.items["steps"])?.images;
    let numbers = |images: RefinedImages| -> Vec<Vec<f32>> {
        images.into_iter().map(|(_, image)| image.data().to_vec()).collect()
    };
    Ok(json!({
        "losses": [losses(&noise)?, losses(&local)?],
        "refined": numbers(refined),
        "bridge": numbers(steps),
    }))
}

/// What the engine sees of the kinds beside their results.
fn stated() -> Value {
    let bitwise = [Training::spec(), Refinement::spec(), BridgeRefinement::spec()]
        .map(|spec| spec.outputs.iter().filter(|port| port.determinism == Determinism::Bitwise).count());
    let environments = [
        Training::environment(&TrainingParams::default(), "main", &Look),
        Refinement::environment(&RefinementParams::default(), "main", &Look),
        BridgeRefinement::environment(&BridgeRefinementParams {}, "main", &Look),
    ];
    json!({ "bitwise": bitwise, "environments": environments })
}

#[test]
#[ignore = "run by the other tests, in a process of its own"]
fn inside() {
    let told = match results() {
        Ok(results) => json!({ "results": results, "stated": stated() }),
        Err(error) => json!({ "environment": matches!(error, KindError::Environment(_)), "error": error.to_string() }),
    };
    println!("{TOLD}{told}");
}

/// What [`inside`] tells with this device.
fn told(device: &str) -> Value {
    let program = std::env::current_exe().expect("this one");
    let arguments = ["--exact", "inside", "--ignored", "--nocapture"];
    let child = Command::new(program).args(arguments).env("TAUFLOW_DEVICE", device).output().expect("starts");
    let out = String::from_utf8_lossy(&child.stdout);
    // The harness writes the test's name before it on the same line.
    let told = out.lines().find_map(|line| line.split_once(TOLD)).map(|(_, told)| told);
    let told = told.unwrap_or_else(|| panic!("{out}\n{}", String::from_utf8_lossy(&child.stderr)));
    serde_json::from_str(told).expect("as written")
}

/// Largest difference of the numbers of two values, by the largest number.
fn apart(found: &Value, expected: &Value) -> f64 {
    fn numbers(value: &Value, out: &mut Vec<f64>) {
        match value {
            Value::Array(values) => values.iter().for_each(|value| numbers(value, out)),
            value => out.push(value.as_f64().expect("finite numbers only")),
        }
    }
    let (mut a, mut b) = (Vec::new(), Vec::new());
    numbers(found, &mut a);
    numbers(expected, &mut b);
    assert_eq!(a.len(), b.len());
    let largest = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    a.iter().zip(&b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / largest
}

#[test]
fn kinds_on_a_device_do_as_on_the_cpu() {
    let found = ["vulkan", "software_vulkan"].into_iter().find_map(|name| Some((name, Place::named(name).ok()?)));
    let Some((name, place)) = found else {
        skip(Need::Vulkan, "no device with a Vulkan driver");
        return;
    };
    let (found, expected) = (told(name), told("cpu"));
    assert!(found.get("error").is_none() && expected.get("error").is_none(), "{found} {expected}");
    for what in ["losses", "refined", "bridge"] {
        let apart = apart(&found["results"][what], &expected["results"][what]);
        println!("{what} on {}: {apart:.1e} apart", place.adapter().unwrap_or_default());
        assert!(apart < 1e-3, "{what}: {apart}");
    }
    for losses in found["results"]["losses"].as_array().expect("two") {
        let losses = losses.as_array().expect("a curve");
        let ends = [losses.first(), losses.last()].map(|loss| loss.and_then(Value::as_f64).expect("a number"));
        assert!(ends[1] < ends[0], "{losses:?}");
    }
    // The device is in the keys, and its bits are of this machine; without it nothing of that is seen.
    assert_eq!(expected["stated"], json!({ "bitwise": [2, 1, 1], "environments": [null, null, null] }));
    assert_eq!(found["stated"]["bitwise"], json!([0, 0, 0]));
    for environment in found["stated"]["environments"].as_array().expect("three") {
        assert_eq!(environment["device"].as_str(), place.adapter());
    }
}

#[test]
fn a_device_that_is_none_is_an_error_of_the_environment() {
    let found = told("abacus");
    let error = found["error"].as_str().expect("refused");
    assert_eq!(found["environment"], json!(true));
    assert!(error.contains("TAUFLOW_DEVICE is `abacus`") && error.contains("`vulkan`"), "{error}");
}
