//! Tests of the operators and of the whole network: gradients against central differences.

use super::{
    features,
    head::{self, Answer, Output, Shade},
    loss::{self, Loss},
    structure,
    unet::{Preset, Unet},
};
use crate::{
    law::{Factors, Law},
    space::Space,
};
use burn::tensor::{Device, Tensor, TensorData};
use std::sync::Arc;
use tauflow_data::{methods::Parameterization, rng::Stream};
use tauflow_ops::Convolutions;
use tauflow_tensors::{apply, layers};

fn numbers(seed: u64, size: usize) -> Vec<f32> {
    let mut stream = Stream::new(seed, &[]);
    (0..size).map(|_| stream.range(-1.0, 1.0) as f32).collect()
}

fn tensor<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
}

/// The weighted sum of an output, so that every element has a gradient of its own.
fn probe<const D: usize>(output: Tensor<D>) -> f64 {
    let data = output.into_data().try_into_vec::<f32>().expect("f32");
    let weights = numbers(99, data.len());
    data.iter().zip(weights).map(|(a, b)| f64::from(*a) * f64::from(b)).sum()
}

/// Checks the gradients of `f`, at some elements of each input, against central differences.
fn check<const D: usize>(inputs: &[(Vec<f32>, Vec<usize>)], f: impl Fn(&[Tensor<4>]) -> Tensor<D>) {
    let shaped = |shape: &[usize]| -> [usize; 4] {
        let mut out = [1; 4];
        out[4 - shape.len()..].copy_from_slice(shape);
        out
    };
    let tracked = Device::flex().autodiff();
    let tensors: Vec<Tensor<4>> =
        inputs.iter().map(|(v, shape)| tensor(v, shaped(shape), &tracked).require_grad()).collect();
    let output = f(&tensors);
    let weights = tensor(&numbers(99, output.shape().num_elements()), output.dims(), &tracked);
    let gradients = (output * weights).sum().backward();
    let plain = Device::flex();
    let value = |which: usize, at: usize, by: f32| {
        let tensors: Vec<Tensor<4>> = inputs
            .iter()
            .enumerate()
            .map(|(i, (v, shape))| {
                let mut v = v.clone();
                if i == which {
                    v[at] += by;
                }
                tensor(&v, shaped(shape), &plain)
            })
            .collect();
        probe(f(&tensors))
    };
    for (which, input) in tensors.iter().enumerate() {
        let found = input.grad(&gradients).expect("tracked").into_data().try_into_vec::<f32>().expect("f32");
        let largest = found.iter().fold(0.0f32, |m, g| m.max(g.abs()));
        let mut stream = Stream::new(5, &[which as u64]);
        for _ in 0..24 {
            let at = stream.below(found.len());
            let step = 1e-2f32;
            let expected = (value(which, at, step) - value(which, at, -step)) / (2.0 * f64::from(step));
            let error = (f64::from(found[at]) - expected).abs();
            assert!(
                error < 2e-3 * f64::from(largest).max(1.0),
                "input {which} at {at}: {} but differences say {expected}",
                found[at]
            );
        }
    }
}

fn flat(t: &Tensor<4>) -> Tensor<2> {
    let [_, _, rows, columns] = t.dims();
    t.clone().reshape([rows, columns])
}

#[test]
fn gradients_of_convolutions() {
    let inputs =
        [(numbers(1, 2 * 6 * 5 * 3), vec![2, 6, 5, 3]), (numbers(2, 27 * 4), vec![27, 4]), (numbers(3, 4), vec![1, 4])];
    check(&inputs, |t| layers::conv3(t[0].clone(), flat(&t[1]), flat(&t[2]), Convolutions::Direct));
    let inputs = [
        (numbers(1, 2 * 20 * 30 * 3), vec![2, 20, 30, 3]),
        (numbers(2, 3 * 4), vec![3, 4]),
        (numbers(3, 4), vec![1, 4]),
    ];
    check(&inputs, |t| layers::linear(t[0].clone(), flat(&t[1]), flat(&t[2])));
}

#[test]
fn gradients_of_normalisation() {
    let inputs = [(numbers(1, 2 * 4 * 5 * 16), vec![2, 4, 5, 16]), (numbers(2, 2 * 32), vec![2, 32])];
    check(&inputs, |t| layers::norm_silu(t[0].clone(), flat(&t[1])));
    check(&inputs, |t| layers::modulated_silu(t[0].clone(), flat(&t[1])));
    check(&inputs[..1], |t| layers::silu(t[0].clone()));
}

#[test]
fn normalised_values_have_no_mean_and_unit_variance() {
    let (size, c) = (2 * 8 * 8 * 8, 8);
    let x: Vec<f32> = numbers(1, size).iter().map(|v| 30.0 + 4.0 * v).collect();
    let device = Device::flex();
    // A shift of 20 puts SiLU where it is the identity.
    let modulation: Vec<f32> = (0..2).flat_map(|_| [vec![0.0; c], vec![20.0; c]].concat()).collect();
    let out = layers::norm_silu(tensor(&x, [2, 8, 8, 8], &device), tensor(&modulation, [2, 2 * c], &device));
    let out = out.into_data().try_into_vec::<f32>().expect("f32");
    for image in out.chunks_exact(size / 2) {
        let mean = image.iter().map(|v| f64::from(*v) - 20.0).sum::<f64>() / image.len() as f64;
        let square = image.iter().map(|v| (f64::from(*v) - 20.0).powi(2)).sum::<f64>() / image.len() as f64;
        assert!(mean.abs() < 1e-4 && (square - 1.0).abs() < 1e-3, "{mean} {square}");
    }
}

#[test]
fn folding_is_undone_and_moves_gradients() {
    let values = numbers(1, 2 * 4 * 6 * 3);
    let device = Device::flex();
    let folded = layers::fold(tensor(&values, [2, 4, 6, 3], &device));
    assert_eq!(folded.dims(), [2, 2, 3, 12]);
    let first = folded.clone().into_data().try_into_vec::<f32>().expect("f32");
    // The first small pixel: two pixels of the first row, then two of the second.
    assert_eq!(first[..6], values[..6]);
    assert_eq!(first[6..12], values[18..24]);
    assert_eq!(layers::unfold(folded).into_data().try_into_vec::<f32>().expect("f32"), values);
    check(&[(values, vec![2, 4, 6, 3])], |t| layers::fold(t[0].clone()));
    check(&[(numbers(2, 2 * 2 * 3 * 8), vec![2, 2, 3, 8])], |t| layers::unfold(t[0].clone()));
}

#[test]
fn gradients_of_head_and_loss() {
    let size = 2 * 2 * 4 * 3;
    let inputs = [(numbers(1, size), vec![2, 2, 4, 3])];
    for (albedo, log) in [(None, false), (Some(Arc::new(numbers(5, size))), true)] {
        let answer = Answer { albedo, state: Arc::new(numbers(6, size)), gain: Arc::new(vec![0.5, -2.0]), log };
        check(&inputs, |t| apply(answer.clone(), [t[0].clone().into()], [2, 2, 4, 3]));
    }
    let shaded =
        [(numbers(1, size), vec![2, 2, 4, 3]), (numbers(2, size).iter().map(|v| 5.0 * v).collect(), vec![2, 2, 4, 3])];
    check(&shaded, |t| apply(Shade, [t[0].clone().into(), t[1].clone().into()], [2, 2, 4, 3]));
    let blend = head::Blend { fits: Arc::new(numbers(6, 3 * size)) };
    let blended =
        [(numbers(1, size), vec![2, 2, 4, 3]), (numbers(2, size).iter().map(|v| 5.0 * v).collect(), vec![2, 2, 4, 3])];
    check(&blended, |t| apply(blend.clone(), [t[0].clone().into(), t[1].clone().into()], [2, 2, 4, 3]));
    // Nowhere so near that a difference changes its sign on the way.
    let target: Vec<f32> =
        inputs[0].0.iter().enumerate().map(|(i, v)| if i % 2 == 0 { v + 0.3 } else { v - 0.2 }).collect();
    let target = Arc::new(target);
    for loss in [Loss::Squared, Loss::Absolute] {
        check(&inputs, |t| loss::mean_loss(t[0].clone(), (target.clone(), None), target.len(), loss).reshape([1]));
    }
}

#[test]
fn gradients_of_the_tonal_loss() {
    let (side, size) = (4, 2 * 4 * 4 * 3);
    // Clean images between -0.5 and 2, and predictions off them by more than a step of the differences.
    let clean: Vec<f32> = numbers(3, size).iter().map(|v| 0.75 + 1.25 * v).collect();
    let state = Arc::new(numbers(4, size));
    let target: Vec<f32> = state.iter().zip(&clean).map(|(state, clean)| state - clean).collect();
    // Differences of all pairs of neighbours have a sign, too.
    let off = |i: usize| (if (i / 3 + i / 12).is_multiple_of(2) { 0.4 } else { -0.3 }) + 0.03 * (i % 7) as f32;
    let prediction: Vec<f32> = target.iter().enumerate().map(|(i, t)| t + off(i)).collect();
    let target = Arc::new(target);
    let shown = loss::Shown { state, side, previews: None, noise: None };
    let loss = |t: &[Tensor<4>]| {
        let judged = (target.clone(), Some(shown.clone()));
        loss::mean_loss(t[0].clone(), judged, target.len(), Loss::Tonal).reshape([1])
    };
    check(&[(prediction, vec![2, side, side, 3])], loss);
    let at = |values: &[f32]| loss(&[tensor(values, [2, side, side, 3], &Device::flex())]).into_scalar::<f32>();
    assert_eq!(at(&target), 0.0);
    // A dark image that is off by 0.01 is worse than a bright one.
    let dark = Arc::new(vec![0.0; size]);
    let of = |log: f32| {
        let (shown, target) =
            (loss::Shown { state: dark.clone(), side, previews: None, noise: None }, Arc::new(vec![-log; size]));
        let off = tensor(&vec![-log - 0.01; size], [2, side, side, 3], &Device::flex());
        loss::mean_loss(off, (target, Some(shown)), size, Loss::Tonal).into_scalar::<f32>()
    };
    assert!(of(0.01) > 2.0 * of(1.0) && of(40.0) > 0.0 && of(40.0).is_finite(), "{} {}", of(0.01), of(1.0));
}

#[test]
fn gradients_of_the_loss_of_previews() {
    let (side, size) = (4, 2 * 4 * 4 * 3);
    // Clean images between 0.1 and 2.1, and predictions off them.
    let clean: Vec<f32> = numbers(3, size).iter().map(|v| 1.1 + v).collect();
    let state = Arc::new(numbers(4, size));
    let target: Vec<f32> = state.iter().zip(&clean).map(|(state, clean)| state - clean).collect();
    let prediction: Vec<f32> =
        target.iter().zip(numbers(5, size)).map(|(t, v)| t + 0.05f32.copysign(v) - 0.03 * v).collect();
    let target = Arc::new(target);
    let shown = loss::Shown { state, side, previews: None, noise: None };
    let loss = |t: &[Tensor<4>]| {
        let judged = (target.clone(), Some(shown.clone()));
        loss::mean_loss(t[0].clone(), judged, target.len(), Loss::Preview).reshape([1])
    };
    check(&[(prediction, vec![2, side, side, 3])], loss);
    let at = |values: &[f32]| loss(&[tensor(values, [2, side, side, 3], &Device::flex())]).into_scalar::<f32>();
    assert_eq!(at(&target), 0.0);
    // One image of one brightness that is off by a little: the square counts beside the difference of logarithms.
    let of = |log: f32, off: f32| {
        let state = Arc::new(vec![0.0; size]);
        let (shown, target) = (loss::Shown { state, side, previews: None, noise: None }, Arc::new(vec![-log; size]));
        let off = tensor(&vec![-log - off; size], [2, side, side, 3], &Device::flex());
        f64::from(loss::mean_loss(off, (target, Some(shown)), size, Loss::Preview).into_scalar::<f32>())
    };
    let seen = |log: f64| {
        let radiance = log.exp() - 1.0 + f64::from(loss::DIM);
        (radiance / (1.0 + radiance)).sqrt()
    };
    for (log, off) in [(0.01f32, 0.01f32), (1.0, 0.05), (40.0, 0.1)] {
        let (a, b) = (f64::from(log), f64::from(log + off));
        let square = if log < 30.0 { (seen(b) - seen(a)).powi(2) } else { 0.0 };
        let expected = (b - a) + f64::from(loss::PREVIEWS) * square;
        assert!((of(log, off) - expected).abs() < 1e-3 * expected, "{log}: {} {expected}", of(log, off));
    }
}

#[test]
fn gradients_of_the_unbiased_loss() {
    let (side, size) = (4, 2 * 4 * 4 * 3);
    let clean: Vec<f32> = numbers(3, size).iter().map(|v| 1.1 + v).collect();
    let state = Arc::new(numbers(4, size));
    let target: Vec<f32> = state.iter().zip(&clean).map(|(state, clean)| state - clean).collect();
    // Below and above the bound of squares, and never near it.
    let off = |i: usize| if i.is_multiple_of(3) { 1.3 } else { -0.2 };
    let prediction: Vec<f32> = target.iter().enumerate().map(|(i, t)| t + off(i)).collect();
    let previews: Vec<f32> = numbers(6, size).iter().map(|v| 0.5 + 0.3 * v).collect();
    let (target, shown) =
        (Arc::new(target), loss::Shown { state, side, previews: Some(Arc::new(previews)), noise: None });
    let loss = |t: &[Tensor<4>]| {
        let judged = (target.clone(), Some(shown.clone()));
        loss::mean_loss(t[0].clone(), judged, target.len(), Loss::UnbiasedPreview).reshape([1])
    };
    check(&[(prediction, vec![2, side, side, 3])], loss);
    // Two even images, off by 1.5 and 0.2 in the logarithm, with previews off by 0.1 and 0.2: each image counts by the
    // logarithms of its own mean squares, and its size beyond 1.
    let radiance = 1.5f32;
    let halves = |a: f32, b: f32| [a, b].map(|v| vec![v; size / 2]).concat();
    let seen = loss::preview_of(radiance);
    let previews = Some(Arc::new(halves(seen - 0.1, seen + 0.2)));
    let shown = loss::Shown { state: Arc::new(vec![0.0; size]), side, previews, noise: None };
    let log = radiance.ln_1p();
    let predicted = tensor(&vec![-log; size], [2, side, side, 3], &Device::flex());
    let judged = (Arc::new(halves(-log - 1.5, -log + 0.2)), Some(shown));
    let found = loss::mean_loss(predicted, judged, size, Loss::UnbiasedPreview).into_scalar::<f32>();
    let of = |square: f32| (square / loss::NEGLIGIBLE).ln_1p();
    let expected = 0.25 * (of(2.0) + of(0.04) + of(loss::PREVIEWS * 0.01) + of(loss::PREVIEWS * 0.04));
    assert!((found - expected).abs() < 1e-4 * expected, "{found} {expected}");
}

#[test]
fn gradients_of_the_structural_loss() {
    let (side, size) = (13, 2 * 13 * 13 * 3);
    let clean: Vec<f32> = numbers(3, size).iter().map(|v| 1.1 + v).collect();
    let state = Arc::new(numbers(4, size));
    let target: Vec<f32> = state.iter().zip(&clean).map(|(state, clean)| state - clean).collect();
    let prediction: Vec<f32> = target.iter().zip(numbers(7, size)).map(|(t, by)| t - 0.2 + 0.1 * by).collect();
    let previews: Vec<f32> = numbers(6, size).iter().map(|v| 0.5 + 0.3 * v).collect();
    let noise: Vec<f32> = numbers(8, size).iter().map(|v| 0.02 * v.abs()).collect();
    let images: Vec<f32> =
        state.iter().zip(&prediction).map(|(state, p)| loss::preview_of((state - p).max(0.0).exp_m1())).collect();
    let lacking: f64 = [0, 1]
        .map(|example| example * size / 2..(example + 1) * size / 2)
        .map(|of| structure::Windows::new(&images[of.clone()], &previews[of.clone()], &noise[of], side))
        .iter()
        .map(|windows| 1.0 - windows.similarity())
        .sum();
    let shown = loss::Shown { state, side, previews: Some(Arc::new(previews)), noise: Some(Arc::new(noise)) };
    let target = Arc::new(target);
    let of = |t: &[Tensor<4>], by: Loss| {
        let judged = (target.clone(), Some(shown.clone()));
        loss::mean_loss(t[0].clone(), judged, target.len(), by).reshape([1])
    };
    check(&[(prediction.clone(), vec![2, side, side, 3])], |t| of(t, Loss::Structural));
    let predicted = [tensor(&prediction, [2, side, side, 3], &Device::flex())];
    let [with, without] =
        [Loss::Structural, Loss::UnbiasedPreview].map(|by| f64::from(of(&predicted, by).into_scalar::<f32>()));
    let expected = f64::from(loss::STRUCTURE) * lacking / 2.0;
    assert!((with - without - expected).abs() < 1e-4 * with, "{with} {without} {expected}");
}

#[test]
fn gradients_of_the_whole_network() {
    for output in Output::ALL {
        gradients_of_the_network(output, Preset::Tiny, Some(0.3));
    }
    gradients_of_the_network(Output::ShadedMeans, Preset::Fast, Some(0.3));
    gradients_of_the_network(Output::SmoothedMeans, Preset::Fast, Some(0.3));
    gradients_of_the_network(Output::FittedMeans, Preset::Fast, Some(0.3));
}

fn gradients_of_the_network(output: Output, preset: Preset, tau: Option<f64>) {
    let encoding = features::Encoding {
        factors: Factors::new(Parameterization::McNoise, &[1, 4, 16], Law::Covariances).expect("a ladder"),
        space: Space::Linear,
        gbuffer: true,
        features: features::Features::Contrast,
        output,
        preset,
    };
    let network: Unet = encoding.network();
    let state: Vec<f32> = numbers(1, 16 * 16 * 3).iter().map(|v| 3.0 * v.abs()).collect();
    let gbuffer = numbers(2, 16 * 16 * 6);
    let mut weights = network.slots().draw(3);
    // Strengths of guides act sixteenfold, on distances of up to 8.
    let names = network.slots().shapes();
    let guide = |i: usize| names[i].0.starts_with("guide");
    // Nothing may be zero, or its gradient and those behind it would be.
    for (i, matrix) in weights.0.iter_mut().enumerate() {
        if matrix.iter().all(|v| *v == 0.0) {
            let scale = if guide(i) { 0.005 } else { 0.05 };
            *matrix = numbers(100 + i as u64, matrix.len()).iter().map(|v| scale * v).collect();
        }
    }
    let target = Arc::new(numbers(4, 16 * 16 * 3));
    let loss = |weights: &tauflow_tensors::Weights, device: &Device| {
        let tensors = network.slots().tensors(weights, device);
        let sample = features::Sample { state: &state, gbuffer: Some(&gbuffer), tau };
        let inputs = encoding.inputs(device, &[sample], 16, 16);
        (
            loss::mean_loss(
                network.forward(&tensors, inputs, Convolutions::Direct),
                (target.clone(), None),
                target.len(),
                Loss::Squared,
            ),
            tensors,
        )
    };
    let (value, tensors) = loss(&weights, &Device::flex().autodiff());
    let gradients = value.backward();
    let value = f64::from(value.into_scalar::<f32>());
    for (i, tensor) in tensors.iter().enumerate() {
        let found = tensor.grad(&gradients).expect("every weight is used").into_data();
        let found = found.try_into_vec::<f32>().expect("f32");
        // Along the gradient the loss must rise by the gradient's length.
        let length = found.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        assert!(length > 0.0, "matrix {i} has no gradient");
        // Small against the curvature: the loss changes by a hundredth at most.
        let step = (0.01 * value / length).min(if guide(i) { 1e-3 } else { 1e-2 });
        let moved = |sign: f64| {
            let mut moved = weights.clone();
            for (w, g) in moved.0[i].iter_mut().zip(&found) {
                *w += (sign * step * f64::from(*g) / length) as f32;
            }
            f64::from(loss(&moved, &Device::flex()).0.into_scalar::<f32>())
        };
        let slope = (moved(1.0) - moved(-1.0)) / (2.0 * step);
        assert!((slope - length).abs() < 0.02 * length + 1e-3, "matrix {i}: {slope} {length}");
    }
}

#[test]
fn an_operator_refuses_to_mix_devices() {
    let mixed = std::panic::catch_unwind(|| {
        let x = tensor(&[1.0, 2.0], [1, 2], &Device::flex().autodiff());
        let kernel = tensor(&[1.0, 2.0], [2, 1], &Device::flex());
        layers::linear(x, kernel.clone(), kernel.slice([0..1, 0..1]))
    });
    assert!(mixed.is_err());
}
