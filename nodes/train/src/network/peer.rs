//! The network is what it says: outputs and gradients of PyTorch, in f64, for the same made-up weights and inputs. The
//! numbers are made by `benches/pytorch/reference.py`.

use super::{
    features::CLOCK,
    head::{Answer, Head, Output},
    unet::{Inputs, Preset, SIDES, Unet},
};
use burn::tensor::{Device, Tensor, TensorData};
use serde::Deserialize;
use std::{collections::BTreeMap, sync::Arc};
use tauflow_ops::{Convolutions, Pyramid};

const SIDE: usize = 16;
const CHANNELS: usize = 15;

#[derive(Deserialize)]
struct Reference {
    /// For each weight its gradient's norm, and its product with made-up numbers.
    gradients: BTreeMap<String, [f64; 2]>,
    /// [1, H, W, 3].
    output: Vec<f64>,
}

/// The same as `numbers` of the script.
fn made_up(size: usize, salt: usize) -> Vec<f32> {
    (0..size).map(|i| (((i * 7919 + salt * 104_729) % 2003) as f64 / 1001.5 - 1.0) as f32).collect()
}

fn image(channels: usize, salt: usize) -> Vec<f32> {
    made_up(SIDE * SIDE * channels, salt)
}

#[test]
fn outputs_and_gradients_are_pytorchs() {
    let reference: Reference = serde_json::from_str(include_str!("pytorch.json")).expect("made by the script");
    let network = Unet::new(Preset::Tiny, CHANNELS, CLOCK, Output::Means);
    let device = Device::flex().autodiff();
    let mut names = network.slots().shapes();
    names.sort();
    assert_eq!(names.len(), reference.gradients.len());
    let salts: BTreeMap<&str, usize> = names.iter().enumerate().map(|(i, (name, _))| (name.as_str(), i)).collect();
    let weights: Vec<Tensor<2>> = network
        .slots()
        .shapes()
        .iter()
        .map(|(name, shape)| {
            let scale = if name.ends_with("bias") { 0.1 } else { 1.5 / (shape[0] as f64).sqrt() };
            let made_up = (0..shape[0] * shape[1])
                .map(|i| ((((i * 7919 + salts[name.as_str()] * 104_729) % 2003) as f64 / 1001.5 - 1.0) * scale) as f32);
            Tensor::from_data(TensorData::new(made_up.collect::<Vec<f32>>(), *shape), &device).require_grad()
        })
        .collect();
    let inputs = Inputs {
        features: Tensor::from_data(TensorData::new(image(CHANNELS, 1001), [1, SIDE, SIDE, CHANNELS]), &device),
        clock: Tensor::from_data(TensorData::new(made_up(CLOCK, 1002), [1, CLOCK]), &device),
        fits: None,
        head: Some(Head {
            fits: None,
            light: Arc::new(Pyramid::new(&image(3, 1003), SIDE, SIDE, SIDES)),
            guides: None,
            shaded: false,
            albedo: None,
            answer: Answer {
                albedo: Some(Arc::new(image(3, 1004))),
                state: Arc::new(image(3, 1007)),
                gain: Arc::new(vec![-1.5]),
                log: false,
            },
        }),
    };
    let output = network.forward(&weights, inputs, Convolutions::Direct);
    let found = output.clone().into_data().try_into_vec::<f32>().expect("f32");
    let largest = reference.output.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    for (i, (found, expected)) in found.iter().zip(&reference.output).enumerate() {
        assert!((f64::from(*found) - expected).abs() < 1e-5 * largest, "output {i}: {found} {expected}");
    }
    let probe = Tensor::from_data(TensorData::new(image(3, 1005), [1, SIDE, SIDE, 3]), &device);
    let gradients = (output * probe).sum().backward();
    for ((name, _), weight) in network.slots().shapes().iter().zip(&weights) {
        let found = weight.grad(&gradients).expect("used").into_data().try_into_vec::<f32>().expect("f32");
        let norm = found.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        let product: f64 =
            found.iter().zip(made_up(found.len(), 1006)).map(|(g, m)| f64::from(*g) * f64::from(m)).sum();
        let expected = reference.gradients[name];
        let near = |found: f64, expected: f64| (found - expected).abs() < 3e-5 * norm;
        assert!(near(norm, expected[0]) && near(product, expected[1]), "{name}: {norm} {product} {expected:?}");
    }
}
