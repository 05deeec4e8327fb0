//! All operators have the same bits whatever instructions they are made of. Which ones is chosen once in a process, so
//! that each set has one of its own: this program again, with `TAUFLOW_INSTRUCTIONS`.

use std::{process::Command, sync::Arc};
use tauflow_ops::{
    Adam, Conv3, Convolutions, Fold, GuidedMean, Guides, Instructions, Linear, NormSilu, Operator, Pyramid, Silu,
    WeightedMean, exp, expm1, local_models, log1p, map, map2, square_sum,
};

/// Set in the processes that answer.
const ASKED: &str = "TAUFLOW_OPS_BITS";
const MARK: &str = "bits of ";

/// Numbers between -1 and 1 (Knuth's multiplicative generator).
fn numbers(seed: u64, size: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..size).map(|_| next()).collect()
}

/// A hash (FNV-1a) of their bits.
fn bits<'a>(of: impl IntoIterator<Item = &'a Vec<f32>>) -> u64 {
    let bytes = of.into_iter().flatten().flat_map(|value| value.to_bits().to_le_bytes());
    bytes.fold(0xCBF2_9CE4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01B3))
}

/// Output and gradients of an operator.
fn both<const N: usize>(operator: &impl Operator<N>, inputs: [&[f32]; N]) -> u64 {
    let (out, saved) = operator.forward(inputs);
    let gradients = operator.backward(inputs, &saved, &numbers(9, out.len()), [true; N]);
    bits(std::iter::once(&out).chain(&gradients))
}

/// Every operator at sizes of trainings: more than a band of rows, a run of sums and a part of weights, and odd ends of
/// all.
fn found() -> Vec<(&'static str, u64)> {
    let instructions = Instructions::best();
    let (x, norm) = (numbers(1, 2 * 1300 * 48), NormSilu { pixels: 1300, channels: 48, normalise: true });
    let pyramid = Arc::new(Pyramid::new(&numbers(3, 2 * 40 * 24 * 3), 40, 24, &[5, 3, 3, 3]));
    let logits = numbers(4, 2 * 40 * 24 * pyramid.weights());
    let guides = Arc::new(Guides::new(&numbers(7, 2 * 40 * 24 * 6), 40, 24, &[5, 3, 3, 3]));
    let guided = GuidedMean { pyramid: pyramid.clone(), guides, first: 0 };
    let conv = |convolutions| Conv3 { height: 18, width: 21, inputs: 24, outputs: 40, convolutions, instructions };
    let of_conv = [numbers(1, 2 * 18 * 21 * 24), numbers(2, 9 * 24 * 40), numbers(3, 40)];
    let convolution = |how| both(&conv(how), of_conv.each_ref().map(Vec::as_slice));
    let linear = Linear { inputs: 37, outputs: 53, instructions };
    let fold = Fold { height: 10, width: 14, channels: 24, back: false };
    let far: Vec<f32> = numbers(5, 50_021).iter().map(|v| v * v * v * 80.0).collect();
    let mut state = [6, 7, 8, 9].map(|seed| numbers(seed, 50_021));
    state[3].iter_mut().for_each(|second| *second = second.abs());
    let [weights, average, first, second] = &mut state;
    let adam = Adam { clip: 0.7, betas: [0.9, 0.999], rate: 1e-3, epsilon: 1e-8, keep: 0.99 };
    adam.update(weights, average, [first, second], &far);
    vec![
        ("normalisation", both(&norm, [&x, &numbers(2, 2 * 96)])),
        ("silu", both(&Silu, [&far])),
        ("guided means", both(&guided, [&logits, &numbers(6, 2 * 40 * 24 * guided.strengths())])),
        ("weighted means", both(&WeightedMean { pyramid, own: 2.0, first: 0 }, [&logits])),
        ("convolution", convolution(Convolutions::Direct)),
        ("minimal convolution", convolution(Convolutions::Minimal)),
        ("local models", bits([&local_models(&numbers(1, 76 * 84 * 3), &numbers(2, 76 * 84 * 6), 76, 84)])),
        ("linear", both(&linear, [&numbers(1, 111 * 37), &numbers(2, 37 * 53), &numbers(3, 53)])),
        ("fold", both(&fold, [&numbers(1, 2 * 10 * 14 * 24)])),
        ("adam", bits(&state)),
        ("squares", square_sum(&far).to_bits()),
        ("exponentials", bits([&map(&far, exp), &map(&far, expm1), &map(&far, |x| log1p(x.abs()))])),
        ("pairs", bits([&map2(&far, &state[0], |a, b| a * b + a)])),
    ]
}

fn lines() -> Vec<String> {
    found().into_iter().map(|(name, hash)| format!("{MARK}{name}: {hash:016x}")).collect()
}

#[test]
fn every_operator_has_the_same_bits_with_any_instructions() {
    let own = lines();
    if std::env::var_os(ASKED).is_some() {
        own.iter().for_each(|line| println!("{line}"));
        return;
    }
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    let askable = |one: &Instructions| Instructions::named(one.name()).is_ok();
    for name in Instructions::available().into_iter().filter(askable).map(Instructions::name) {
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        command.args(["every_operator_has_the_same_bits_with_any_instructions", "--exact", "--nocapture"]);
        let output = command.env(ASKED, "1").env("TAUFLOW_INSTRUCTIONS", name).output().expect("it starts");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let told: Vec<&str> = text.lines().filter_map(|line| line.find(MARK).map(|at| &line[at..])).collect();
        assert_eq!(told, own, "{name}: {}", String::from_utf8_lossy(&output.stderr));
    }
}
