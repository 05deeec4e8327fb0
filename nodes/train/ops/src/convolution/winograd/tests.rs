use super::*;
use crate::{instructions::Instructions, made_up::numbers, operator::Operator as _};

fn conv([height, width, inputs, outputs]: [usize; 4], instructions: Instructions) -> Conv3 {
    Conv3 { height, width, inputs, outputs, convolutions: Convolutions::Minimal, instructions }
}

/// Whole and ragged tiles, bands, blocks, panels and channels; each of a size that is convolved this way.
const SHAPES: [[usize; 5]; 8] = [
    [1, 16, 16, 16, 16],
    [1, 32, 32, 16, 16],
    [2, 23, 37, 28, 40],
    [1, 5, 131, 17, 100],
    [1, 129, 4, 33, 16],
    [3, 16, 48, 48, 49],
    [1, 24, 24, 200, 64],
    [1, 6, 300, 16, 244],
];

#[test]
fn outputs_are_those_of_the_definition_with_the_same_bits_for_any_instructions() {
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    for [images, height, width, inputs, outputs] in SHAPES {
        let (x, kernel, bias) =
            (numbers(1, images * height * width * inputs), numbers(2, 9 * inputs * outputs), numbers(3, outputs));
        let gradient = numbers(4, images * height * width * outputs);
        let mut first: Option<[Vec<f32>; 4]> = None;
        for instructions in Instructions::available() {
            let conv = conv([height, width, inputs, outputs], instructions);
            assert!(pays(&conv), "{conv:?}");
            let of = |conv: &Conv3| {
                let (out, ()) = conv.forward([&x, &kernel, &bias]);
                let [of_x, of_kernel, of_bias] = conv.backward([&x, &kernel, &bias], &(), &gradient, [true; 3]);
                [out, of_x, of_kernel, of_bias]
            };
            let found = of(&conv);
            let Some(first) = &first else {
                let expected = of(&Conv3 { convolutions: Convolutions::Direct, ..conv.clone() });
                for (what, (found, expected)) in found.iter().zip(&expected).enumerate() {
                    let scale = expected.iter().fold(0.0f32, |most, value| most.max(value.abs()));
                    let apart = found.iter().zip(expected).fold(0.0f32, |most, (a, b)| most.max((a - b).abs()));
                    assert!(found.len() == expected.len() && apart < 3e-5 * scale, "{what} {conv:?}: {apart} {scale}");
                }
                first = Some(found);
                continue;
            };
            let bits = |all: &[Vec<f32>; 4]| all.concat().into_iter().map(f32::to_bits).collect::<Vec<_>>();
            let same = bits(first) == bits(&found);
            assert!(same, "{instructions:?} differs for {conv:?}");
        }
    }
}

/// The error beside that of the sum of the definition, both against f64.
#[test]
fn rounding_is_little_coarser_than_that_of_the_definition() {
    let conv = conv([32, 32, 80, 16], Instructions::best());
    let (x, kernel, bias) = (numbers(5, 1024 * 80), numbers(6, 9 * 80 * 16), numbers(7, 16));
    let exact = |pixel: usize, output: usize| {
        let mut sum = f64::from(bias[output]);
        for tap in 0..9 {
            let (y, x_) = ((pixel / 32 + tap / 3).wrapping_sub(1), (pixel % 32 + tap % 3).wrapping_sub(1));
            if y < 32 && x_ < 32 {
                for c in 0..80 {
                    sum += f64::from(x[(y * 32 + x_) * 80 + c]) * f64::from(kernel[(tap * 80 + c) * 16 + output]);
                }
            }
        }
        sum
    };
    let exact: Vec<f64> = (0..1024 * 16).map(|i| exact(i / 16, i % 16)).collect();
    let error = |found: &[f32]| {
        let sum = found.iter().zip(&exact).map(|(found, exact)| (f64::from(*found) - exact).powi(2)).sum::<f64>();
        (sum / exact.len() as f64).sqrt()
    };
    let scale = (exact.iter().map(|value| value * value).sum::<f64>() / exact.len() as f64).sqrt();
    let own = error(&conv.forward([&x, &kernel, &bias]).0) / scale;
    let direct = Conv3 { convolutions: Convolutions::Direct, ..conv };
    let plain = error(&direct.forward([&x, &kernel, &bias]).0) / scale;
    println!("relative error {own:.1e}, of the definition {plain:.1e}");
    assert!(own < 4e-6 && own < 10.0 * plain, "{own:.1e}, of the definition {plain:.1e}");
}

/// A number reaches its neighbours, and nothing but rounding reaches others.
#[test]
fn one_pixel_is_spread_over_its_neighbours() {
    let conv = conv([27, 30, 16, 16], Instructions::best());
    let kernel = numbers(8, 9 * 16 * 16);
    for (row, column) in [(0, 0), (13, 16), (26, 29), (15, 15)] {
        let mut x = vec![0.0; 27 * 30 * 16];
        x[(row * 30 + column) * 16 + 3] = 1.0;
        let (out, ()) = conv.forward([&x, &kernel, &[0.0; 16]]);
        for pixel in 0..27 * 30 {
            let (dy, dx) = ((row + 1).wrapping_sub(pixel / 30), (column + 1).wrapping_sub(pixel % 30));
            for o in 0..16 {
                let expected = if dy < 3 && dx < 3 { kernel[((3 * dy + dx) * 16 + 3) * 16 + o] } else { 0.0 };
                assert!((out[pixel * 16 + o] - expected).abs() < 5e-6, "{row} {column}: {pixel} {o}");
            }
        }
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads_nor_on_images_beside() {
    let conv = conv([40, 24, 48, 48], Instructions::best());
    let (x, kernel, bias) = (numbers(1, 3 * 960 * 48), numbers(2, 9 * 48 * 48), numbers(3, 48));
    let run = |threads, x: &[f32]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let (out, ()) = conv.forward([x, &kernel, &bias]);
            let gradients = conv.backward([x, &kernel, &bias], &(), &out, [true; 3]);
            [vec![out], gradients.to_vec()].concat()
        })
    };
    let one = run(1, &x);
    assert!(one == run(2, &x) && one == run(5, &x));
    let alone = run(1, &x[..960 * 48]);
    assert!(one[0][..960 * 48] == alone[0] && one[1][..960 * 48] == alone[1]);
}

#[test]
fn no_images_give_no_result_and_gradients_of_nothing() {
    let conv = conv([16, 16, 16, 16], Instructions::best());
    assert!(pays(&conv));
    let inputs = [&[][..], &[1.0; 9 * 256], &[1.0; 16]];
    assert!(conv.forward(inputs).0.is_empty());
    let [of_x, of_kernel, of_bias] = conv.backward(inputs, &(), &[], [true; 3]);
    assert!(of_x.is_empty() && of_kernel == [0.0; 9 * 256] && of_bias == [0.0; 16]);
}

#[test]
fn small_and_narrow_convolutions_are_those_of_the_definition() {
    for shape in [[15, 16, 32, 32], [3, 600, 32, 32], [64, 64, 3, 32], [64, 64, 32, 3]] {
        let conv = conv(shape, Instructions::best());
        let [height, width, inputs, outputs] = shape;
        let (x, kernel) = (numbers(1, height * width * inputs), numbers(2, 9 * inputs * outputs));
        let bias = numbers(3, outputs);
        let direct = Conv3 { convolutions: Convolutions::Direct, ..conv.clone() };
        assert!(conv.forward([&x, &kernel, &bias]).0 == direct.forward([&x, &kernel, &bias]).0, "{shape:?}");
    }
}
