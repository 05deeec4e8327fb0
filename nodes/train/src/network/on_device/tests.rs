//! burn's operations make what the operators of `tauflow-ops` make, with the same gradients.

use super::*;
use crate::network::unet::SIDES;
#[cfg(feature = "gpu")]
use crate::{
    law::{Factors, Law},
    network::{
        Features, Output, Preset,
        features::{Encoding, Sample},
        loss::mean_loss,
    },
    space::Space,
};
use burn::tensor::Device;
use std::sync::Arc;
#[cfg(feature = "gpu")]
use tauflow_data::methods::Parameterization;
use tauflow_data::rng::Stream;
use tauflow_ops::{
    Conv3, Convolutions, Fold, GuidedMean, Guides, Instructions, Linear, NormSilu, Pyramid, Silu, WeightedMean,
};

fn numbers(seed: u64, size: usize) -> Vec<f32> {
    let mut stream = Stream::new(seed, &[]);
    (0..size).map(|_| stream.range(-1.0, 1.0) as f32).collect()
}

/// The largest difference by the largest number.
fn apart(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    let difference = found.iter().zip(expected).fold(0.0f64, |m, (a, b)| m.max(f64::from((a - b).abs())));
    assert!(found.iter().all(|v| v.is_finite()) && largest > 0.0);
    difference / f64::from(largest)
}

fn values(tensor: Tensor<1>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("f32")
}

/// How far output and gradients are from those of plain slices, at most.
fn difference<const N: usize>(operator: impl OnDevice<N>, inputs: [Vec<f32>; N], device: &Device) -> f64 {
    let slices = inputs.each_ref().map(Vec::as_slice);
    let (expected, saved) = operator.forward(slices);
    let probe = numbers(99, expected.len());
    let gradients = operator.backward(slices, &saved, &probe, [true; N]);
    let device = device.clone().autodiff();
    let tensors = slices.map(|values| constant(values, [values.len()], &device).require_grad());
    let output = operator.by_tensors(tensors.clone());
    let found = (output.clone() * constant(&probe, [probe.len()], &device)).sum().backward();
    let gradients = tensors.iter().zip(&gradients);
    gradients
        .map(|(tensor, expected)| apart(&values(tensor.grad(&found).expect("tracked")), expected))
        .fold(apart(&values(output), &expected), f64::max)
}

/// Differences of all operators on a device.
fn differences(device: &Device) -> Vec<(String, f64)> {
    let mut all = Vec::new();
    let instructions = Instructions::best();
    for (images, height, width, inputs, outputs) in [(2, 6, 5, 3, 4), (1, 16, 16, 60, 32), (2, 8, 24, 32, 64)] {
        let conv = Conv3 { height, width, inputs, outputs, convolutions: Convolutions::Minimal, instructions };
        let x = numbers(1, images * height * width * inputs);
        let made = difference(conv.clone(), [x, numbers(2, 9 * inputs * outputs), numbers(3, outputs)], device);
        all.push((format!("{conv:?}"), made));
    }
    for (rows, inputs, outputs) in [(1, 14, 64), (600, 128, 48)] {
        let map = Linear { inputs, outputs, instructions };
        let inputs = [numbers(1, rows * inputs), numbers(2, inputs * outputs), numbers(3, outputs)];
        all.push((format!("{map:?}"), difference(map, inputs, device)));
    }
    for (images, pixels, channels, normalise) in [(2, 20, 16, true), (1, 1024, 32, true), (2, 20, 16, false)] {
        let norm = NormSilu { pixels, channels, normalise };
        let inputs = [numbers(1, images * pixels * channels), numbers(2, images * 2 * channels)];
        all.push((format!("{norm:?}"), difference(norm, inputs, device)));
    }
    all.push(("Silu".into(), difference(Silu, [numbers(1, 500).iter().map(|v| 9.0 * v).collect()], device)));
    for back in [false, true] {
        let fold = Fold { height: 4, width: 6, channels: 3, back };
        all.push((format!("{fold:?}"), difference(fold, [numbers(1, 2 * 4 * 6 * 3)], device)));
    }
    let (height, width) = (8, 16);
    let light = Arc::new(Pyramid::new(&numbers(1, 2 * height * width * 3), height, width, SIDES));
    let logits: Vec<f32> = numbers(2, 2 * height * width * light.weights()).iter().map(|v| 4.0 * v).collect();
    for own in [0.0, 3.0] {
        let mean = WeightedMean { pyramid: light.clone(), own, first: 0 };
        all.push((format!("WeightedMean, own {own}"), difference(mean, [logits.clone()], device)));
    }
    let guides = Arc::new(Guides::new(&numbers(11, 2 * height * width * 6), height, width, SIDES));
    let weights = light.weights();
    let guided = GuidedMean { pyramid: light, guides, first: 0 };
    // Weak ones, so that no place takes all of the weight.
    let strengths = numbers(14, 2 * height * width * guided.strengths()).iter().map(|v| 0.1 * v).collect();
    let inputs = [numbers(13, 2 * height * width * weights), strengths];
    all.push(("GuidedMean".into(), difference(guided, inputs, device)));
    let size = 2 * 4 * 4 * 3;
    for (albedo, log) in [(None, false), (Some(Arc::new(numbers(5, size))), true)] {
        let answer = Answer { albedo, state: Arc::new(numbers(6, size)), gain: Arc::new(vec![0.5, -2.0]), log };
        all.push((format!("Answer, log {log}"), difference(answer, [numbers(7, size)], device)));
    }
    let shades = numbers(2, 300).iter().map(|v| 100.0 * v * v * v).collect();
    all.push(("Shade".into(), difference(Shade, [numbers(1, 300), shades], device)));
    let blend = Blend { fits: Arc::new(numbers(21, 900)) };
    let shares = numbers(23, 300).iter().map(|v| 9.0 * v).collect();
    all.push(("Blend".into(), difference(blend, [numbers(22, 300), shares], device)));
    let (side, size) = (14, 2 * 14 * 14 * 3);
    for loss in [Loss::Squared, Loss::Absolute, Loss::Tonal, Loss::Preview, Loss::UnbiasedPreview, Loss::Structural] {
        let previews = loss.is_unbiased().then(|| Arc::new(numbers(12, size)));
        let noise = loss.is_structural().then(|| Arc::new(numbers(13, size).iter().map(|v| 0.1 * v.abs()).collect()));
        let state = Arc::new(numbers(10, size));
        let shown = loss.of_images().then_some(Shown { state, side, previews, noise });
        let loss = MeanLoss { target: Arc::new(numbers(8, size)), count: 900, loss, shown };
        all.push((format!("{:?}", loss.loss), difference(loss, [numbers(9, size)], device)));
    }
    all
}

fn check(device: &Device, most: f64) {
    for (name, difference) in differences(device) {
        println!("{difference:.1e} {name}");
        assert!(difference < most, "{name}: {difference}");
    }
}

#[test]
fn operators_by_tensors_are_those_over_slices() {
    check(&Device::flex(), 2e-5);
}

#[cfg(feature = "gpu")]
#[test]
fn operators_on_a_device_are_those_over_slices() {
    if let Some(place) = crate::device::vulkan::for_tests() {
        check(place.device(), 1e-4);
    }
}

/// The output of a network for a fixed batch, and the gradients of a loss.
#[cfg(feature = "gpu")]
fn of_network(preset: Preset, output: Output, gbuffer: bool, device: &Device) -> Vec<Vec<f32>> {
    const SIDE: usize = 16;
    let encoding = Encoding {
        factors: Factors::new(Parameterization::McVelocity, &[1, 4, 16], Law::Covariances).expect("a ladder"),
        space: Space::Linear,
        gbuffer,
        features: Features::Contrast,
        output,
        preset,
    };
    let network = encoding.network();
    let mut weights = network.slots().draw(3);
    // Nothing may be zero, or its gradient and those behind it would be.
    for (i, matrix) in weights.0.iter_mut().enumerate() {
        if matrix.iter().all(|v| *v == 0.0) {
            let scale = if network.slots().shapes()[i].0.starts_with("guide") { 0.005 } else { 0.05 };
            *matrix = numbers(100 + i as u64, matrix.len()).iter().map(|v| scale * v).collect();
        }
    }
    let device = device.clone().autodiff();
    let weights = network.slots().tensors(&weights, &device);
    let state = |i| numbers(i, SIDE * SIDE * 3).iter().map(|v| 3.0 * v.abs()).collect::<Vec<f32>>();
    let (states, gbuffers) = ([state(1), state(2)], [3, 4].map(|i| numbers(i, SIDE * SIDE * 6)));
    let samples: Vec<Sample<'_>> = (0..2)
        .map(|i| Sample { state: &states[i], gbuffer: gbuffer.then_some(&gbuffers[i][..]), tau: Some(0.3 * i as f64) })
        .collect();
    let output = network.forward(&weights, encoding.inputs(&device, &samples, SIDE, SIDE), Convolutions::Direct);
    let target = Arc::new(numbers(5, 2 * SIDE * SIDE * 3));
    let found = mean_loss(output.clone(), (target.clone(), None), target.len(), Loss::Squared).backward();
    let gradients = weights.iter().map(|weight| values(flat(weight.grad(&found).expect("every weight is used"))));
    std::iter::once(values(flat(output))).chain(gradients.collect::<Vec<_>>()).collect()
}

#[cfg(feature = "gpu")]
#[test]
fn networks_on_a_device_are_those_on_the_cpu() {
    let Some(place) = crate::device::vulkan::for_tests() else { return };
    for preset in Preset::ALL {
        for (output, gbuffer) in [(Output::Means, false), (Output::Means, true), (Output::FittedMeans, true)] {
            let of = |device| of_network(preset, output, gbuffer, device);
            let (found, expected) = (of(place.device()), of(&Device::flex()));
            let apart: Vec<f64> = found.iter().zip(&expected).map(|(found, expected)| apart(found, expected)).collect();
            let gradients = apart[1..].iter().fold(0.0f64, |most, apart| most.max(*apart));
            println!(
                "{preset:?}, {output:?}, G-buffers {gbuffer}: outputs {:.1e}, gradients {gradients:.1e}",
                apart[0]
            );
            assert!(apart[0] < 1e-3 && gradients < 1e-3);
        }
    }
}
