//! The kinds on a device with a Vulkan driver against the same on the CPU. Skips where there is no such device.

use crate::toy;
use serde_json::{Value, json};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{
    Action, Artifact, Collection, Context, Determinism, Kind, KindError, Look, Media, MemoryBlobs, Outputs, Silent,
};
use tauflow_data::records::{BridgeSteps, Refined, RefinedImages, TrainingLog};
use tauflow_testing::{Need, skip};
use tauflow_train::{
    BridgeRefinement, BridgeRefinementParams, Conditioning, NetworkDevice, Parameterization, Place, Refinement,
    RefinementParams, Training, TrainingParams,
};

const COUNTS: [u64; 5] = [1, 2, 4, 8, 16];

struct Lab {
    device: NetworkDevice,
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
            device: self.device,
            ..Default::default()
        };
        self.run::<Training>(params, &[], &[("train", &self.train), ("test", &self.train)])
    }
}

/// Losses of trainings, and refined images: a training with G-buffers and one without, and both ways to refine.
fn results(device: NetworkDevice) -> Result<Value, KindError> {
    let blobs = MemoryBlobs::default();
    let train = toy::collection(&blobs, 0..2, 24, &COUNTS);
    let endpoints = toy::collection(&blobs, 5..6, 24, &[1, 2, 3, 4]);
    let lab = Lab { device, blobs, train };
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
    let params = RefinementParams { nfe: vec![1, 3].try_into()?, device, ..Default::default() };
    let refined = lab.run::<Refinement>(params, &[("endpoints", endpoint)], &[("model", models[0])])?;
    let all = [("mc_noise", models[0]), ("local_velocity", models[1])];
    let bridge = lab.run::<BridgeRefinement>(
        BridgeRefinementParams { device, ..Default::default() },
        &[("endpoints", endpoint)],
        &all,
    )?;
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
fn stated(device: NetworkDevice) -> Value {
    let training = TrainingParams { device, ..Default::default() };
    let refinement = RefinementParams { device, ..Default::default() };
    let bridge = BridgeRefinementParams { device, ..Default::default() };
    let specs = [Training::spec_for(&training), Refinement::spec_for(&refinement), BridgeRefinement::spec_for(&bridge)];
    let bitwise = specs.map(|spec| spec.outputs.iter().filter(|port| port.determinism == Determinism::Bitwise).count());
    let environments = [
        Training::environment(&training, "main", &Look),
        Refinement::environment(&refinement, "main", &Look),
        BridgeRefinement::environment(&bridge, "main", &Look),
    ];
    json!({ "bitwise": bitwise, "environments": environments })
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
    let devices = [NetworkDevice::Vulkan, NetworkDevice::SoftwareVulkan];
    let Some((device, place)) = devices.into_iter().find_map(|device| Some((device, Place::of(device).ok()?))) else {
        skip(Need::Vulkan, "no device with a Vulkan driver");
        return;
    };
    let found = results(device).expect("the device does it");
    let expected = results(NetworkDevice::Cpu).expect("the CPU does it");
    for what in ["losses", "refined", "bridge"] {
        let apart = apart(&found[what], &expected[what]);
        println!("{what} on {}: {apart:.1e} apart", place.adapter().unwrap_or_default());
        assert!(apart < 1e-3, "{what}: {apart}");
    }
    for losses in found["losses"].as_array().expect("two") {
        let losses = losses.as_array().expect("a curve");
        let ends = [losses.first(), losses.last()].map(|loss| loss.and_then(Value::as_f64).expect("a number"));
        assert!(ends[1] < ends[0], "{losses:?}");
    }
    // The device is in the keys, and its bits are of this machine; without it nothing of that is seen.
    let nothing = json!({ "bitwise": [2, 1, 1], "environments": [null, null, null] });
    assert_eq!(stated(NetworkDevice::Cpu), nothing);
    let found = stated(device);
    assert_eq!(found["bitwise"], json!([0, 0, 0]));
    for environment in found["environments"].as_array().expect("three") {
        assert_eq!(environment["device"].as_str(), place.adapter());
    }
}
