//! Sizes of the published networks, and gradients of small ones.

use super::*;
use burn::tensor::{Device, TensorData};
use tauflow_data::rng::Stream;
use tauflow_tensors::{Start, Weights};

#[test]
fn published_networks_have_as_many_weights_as_they_should() {
    let church = Unet2d::new(&Unet2dConfig::church());
    assert_eq!(Unet2dConfig::church().problems(), [""; 0]);
    assert_eq!(count(church.parameters()), 113_673_219);
    let lsun = Ncsnpp::new(&NcsnppConfig::lsun());
    assert_eq!(NcsnppConfig::lsun().problems(), [""; 0]);
    assert_eq!(count(lsun.parameters()), 65_574_549);
    assert_eq!(lsun.parameters().iter().filter(|parameter| parameter.frozen).count(), 1);
}

#[test]
fn unsupported_configurations_are_told_in_full() {
    let ddpm =
        Unet2dConfig { act_fn: "gelu".into(), downsample_padding: 1, norm_num_groups: 0, ..Unet2dConfig::church() };
    let told = ddpm.problems().join("\n");
    assert!(["act_fn", "downsample_padding", "norm_num_groups"].iter().all(|field| told.contains(field)), "{told}");
    let flow = NcsnppConfig { fir_kernel: vec![1], nf: 6, resblock_type: "ddpm".into(), ..NcsnppConfig::lsun() };
    let told = flow.problems().join("\n");
    assert!(["fir_kernel", "`nf`", "resblock_type"].iter().all(|field| told.contains(field)), "{told}");
}

fn small() -> [Network; 2] {
    let ddpm = Unet2dConfig::small(16, 16);
    let flow = NcsnppConfig::small(16, 16);
    assert_eq!((ddpm.problems(), flow.problems()), (Vec::new(), Vec::new()));
    [Network::Unet2d(Box::new(Unet2d::new(&ddpm))), Network::Ncsnpp(Box::new(Ncsnpp::new(&flow)))]
}

/// Weights none of which is zero, or gradients behind it would be.
fn made_up(network: &Network) -> Weights {
    let mut parameters = network.parameters().to_vec();
    parameters.iter_mut().filter(|p| p.start == Start::Zero).for_each(|p| p.start = Start::Normal(0.3));
    slots(&parameters).draw(5)
}

fn images(count: usize) -> Vec<f32> {
    let mut stream = Stream::new(3, &[]);
    (0..count * 16 * 16 * 3).map(|_| stream.uniform() as f32).collect()
}

fn input(values: Vec<f32>, device: &Device) -> Tensor<4> {
    let count = values.len() / (16 * 16 * 3);
    Tensor::from_data(TensorData::new(values, [count, 16, 16, 3]), device)
}

#[test]
fn images_of_a_batch_do_not_see_each_other() {
    for network in small() {
        let device = Device::flex();
        let weights = slots(network.parameters()).tensors(&made_up(&network), &device);
        let both = images(2);
        let run = |values: &[f32], times: &[f64]| {
            let out = network.forward(&weights, input(values.to_vec(), &device), times);
            out.into_data().try_into_vec::<f32>().expect("f32")
        };
        let together = run(&both, &[700.0, 20.0]);
        let size = both.len() / 2;
        assert!(together[..size] == run(&both[..size], &[700.0]) && together[size..] == run(&both[size..], &[20.0]));
        assert!(together.iter().all(|value| value.is_finite()));
        assert!(together[..size] != run(&both[..size], &[20.0]), "the time is told");
    }
}

#[test]
fn gradients_are_those_of_small_changes() {
    for network in small() {
        let tracked = Device::flex().autodiff();
        let (weights, parameters) = (made_up(&network), network.parameters());
        let tensors = slots(parameters).tensors(&weights, &tracked);
        let out = network.forward(&tensors, input(images(1), &tracked), &[300.0]);
        let mut stream = Stream::new(8, &[]);
        let factors: Vec<f32> = (0..out.shape().num_elements()).map(|_| stream.range(-1.0, 1.0) as f32).collect();
        let gradients = (out * input(factors.clone(), &tracked)).sum().backward();
        let plain = Device::flex();
        let value = |weights: &Weights| {
            let tensors = slots(parameters).tensors(weights, &plain);
            let out = network.forward(&tensors, input(images(1), &plain), &[300.0]);
            let out = out.into_data().try_into_vec::<f32>().expect("f32");
            out.iter().zip(&factors).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
        };
        let mut seen = 0;
        for (at, parameter) in parameters.iter().enumerate().step_by(7) {
            let Some(gradient) = tensors[at].grad(&gradients) else {
                assert!(parameter.frozen, "{} has no gradient", parameter.name);
                continue;
            };
            let gradient = gradient.into_data().try_into_vec::<f32>().expect("f32");
            // Along the gradient itself, every number of it counts.
            let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
            let moved = |by: f64| {
                let mut moved = weights.clone();
                let step = by / norm.max(1e-12);
                moved.0[at].iter_mut().zip(&gradient).for_each(|(w, g)| *w += (step * f64::from(*g)) as f32);
                value(&moved)
            };
            let found = (moved(0.01) - moved(-0.01)) / 0.02;
            assert!((found - norm).abs() < 0.03 * norm + 0.02, "{}: {found} {norm}", parameter.name);
            seen += 1;
        }
        assert!(seen > 10);
    }
}
