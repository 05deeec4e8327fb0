use super::*;
use crate::made_up::numbers;

/// Output, and gradients of input and kernel for a gradient of the output, in f64 from the definition.
fn defined(conv: &Conv3, x: &[f32], kernel: &[f32], bias: &[f32], gradient: &[f32]) -> [Vec<f64>; 3] {
    let (h, w, c, o) = (conv.height, conv.width, conv.inputs, conv.outputs);
    let mut out: Vec<f64> = bias.iter().map(|v| f64::from(*v)).cycle().take(x.len() / c * o).collect();
    let (mut of_x, mut of_kernel) = (vec![0.0; x.len()], vec![0.0; kernel.len()]);
    for pixel in 0..x.len() / c {
        let (at_x, at_y, image) = (pixel % w, pixel / w % h, pixel / (w * h));
        for tap in 0..9 {
            let (sx, sy) = ((at_x + tap % 3).wrapping_sub(1), (at_y + tap / 3).wrapping_sub(1));
            if sx >= w || sy >= h {
                continue;
            }
            let source = ((image * h + sy) * w + sx) * c;
            for i in 0..c {
                for j in 0..o {
                    let at = (tap * c + i) * o + j;
                    out[pixel * o + j] += f64::from(x[source + i]) * f64::from(kernel[at]);
                    of_x[source + i] += f64::from(gradient[pixel * o + j]) * f64::from(kernel[at]);
                    of_kernel[at] += f64::from(gradient[pixel * o + j]) * f64::from(x[source + i]);
                }
            }
        }
    }
    [out, of_x, of_kernel]
}

fn near(found: &[f32], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1.0f64, |m, v| m.max(v.abs()));
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((f64::from(*found) - expected).abs() < 3e-6 * scale, "{what} {i}: {found} {expected}");
    }
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

/// Shapes with whole and ragged panels, tiles, bands and depths.
const SHAPES: [[usize; 5]; 9] = [
    [2, 5, 7, 3, 4],
    [1, 1, 1, 16, 16],
    [2, 8, 8, 36, 32],
    [1, 17, 33, 32, 24],
    [1, 3, 300, 5, 48],
    [3, 4, 12, 24, 80],
    [1, 2, 16, 70, 112],
    [3, 6, 1, 5, 17],
    [2, 1, 40, 16, 16],
];

#[test]
fn convolutions_are_what_they_say_with_any_instructions() {
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    for [images, height, width, inputs, outputs] in SHAPES {
        let (x, kernel, bias) =
            (numbers(1, images * height * width * inputs), numbers(2, 9 * inputs * outputs), numbers(3, outputs));
        let gradient = numbers(4, images * height * width * outputs);
        let mut first = None;
        for instructions in Instructions::available() {
            let conv = Conv3 { height, width, inputs, outputs, convolutions: Convolutions::Direct, instructions };
            let (out, ()) = conv.forward([&x, &kernel, &bias]);
            let [of_x, of_kernel, of_bias] = conv.backward([&x, &kernel, &bias], &(), &gradient, [true; 3]);
            let found = [&out, &of_x, &of_kernel, &of_bias].map(|v| bits(v));
            match &first {
                None => {
                    let [expected, expected_x, expected_kernel] = defined(&conv, &x, &kernel, &bias, &gradient);
                    near(&out, &expected, "output");
                    near(&of_x, &expected_x, "gradient of x");
                    near(&of_kernel, &expected_kernel, "gradient of the kernel");
                    first = Some(found);
                }
                Some(first) => assert!(*first == found, "{instructions:?} differs for {conv:?}"),
            }
        }
    }
}

#[test]
fn linear_maps_are_what_they_say_with_any_instructions() {
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    for (pixels, inputs, outputs) in [(1, 3, 4), (300, 36, 32), (513, 160, 96), (40, 200, 24), (7, 8, 144)] {
        let (x, kernel, bias) = (numbers(1, pixels * inputs), numbers(2, inputs * outputs), numbers(3, outputs));
        let gradient = numbers(4, pixels * outputs);
        let mut first = None;
        for instructions in Instructions::available() {
            let map = Linear { inputs, outputs, instructions };
            let (out, ()) = map.forward([&x, &kernel, &bias]);
            let [of_x, of_kernel, of_bias] = map.backward([&x, &kernel, &bias], &(), &gradient, [true; 3]);
            let found = [&out, &of_x, &of_kernel, &of_bias].map(|v| bits(v));
            if let Some(first) = &first {
                assert!(*first == found, "{instructions:?} differs for {map:?}");
                continue;
            }
            first = Some(found);
            let sum = |size: usize, f: &dyn Fn(usize) -> f64| (0..size).map(f).sum::<f64>();
            let of = |values: &[f32], at: usize| f64::from(values[at]);
            let expected: Vec<f64> = (0..pixels * outputs)
                .map(|i| {
                    let (p, j) = (i / outputs, i % outputs);
                    of(&bias, j) + sum(inputs, &|k| of(&x, p * inputs + k) * of(&kernel, k * outputs + j))
                })
                .collect();
            near(&out, &expected, "output");
            let expected: Vec<f64> = (0..x.len())
                .map(|i| {
                    let (p, k) = (i / inputs, i % inputs);
                    sum(outputs, &|j| of(&gradient, p * outputs + j) * of(&kernel, k * outputs + j))
                })
                .collect();
            near(&of_x, &expected, "gradient of x");
            let expected: Vec<f64> = (0..kernel.len())
                .map(|i| {
                    let (k, j) = (i / outputs, i % outputs);
                    sum(pixels, &|p| of(&x, p * inputs + k) * of(&gradient, p * outputs + j))
                })
                .collect();
            near(&of_kernel, &expected, "gradient of the kernel");
        }
    }
}

/// Whether it panics.
fn refused(f: impl FnOnce() + std::panic::UnwindSafe) -> bool {
    std::panic::catch_unwind(f).is_err()
}

#[test]
fn sizes_that_do_not_fit_are_refused() {
    let conv = |height, width, inputs, outputs| Conv3 {
        height,
        width,
        inputs,
        outputs,
        convolutions: Convolutions::Direct,
        instructions: Instructions::best(),
    };
    let forward = |conv: Conv3, x: usize, kernel: usize, bias: usize| {
        refused(move || _ = conv.forward([&vec![1.0; x], &vec![1.0; kernel], &vec![1.0; bias]]))
    };
    assert!(!forward(conv(2, 2, 1, 1), 8, 9, 1));
    assert!(
        forward(conv(2, 2, 1, 1), 7, 9, 1) && forward(conv(2, 2, 1, 1), 8, 10, 1) && forward(conv(2, 2, 1, 1), 8, 9, 2)
    );
    assert!(forward(conv(0, 2, 1, 1), 8, 9, 1) && forward(conv(2, 2, 0, 1), 8, 0, 1));
    // Products of sizes that wrap around.
    assert!(forward(conv(1, (1 << 60) + 1, 16, 16), 16, 2304, 16));
    assert!(forward(conv(0xAAAA_AAAA_AAAA_AAAB, 1, 3, 1), 1, 27, 1));
    let conv = conv(2, 2, 1, 1);
    assert!(refused(move || _ = conv.backward([&[1.0; 4], &[1.0; 9], &[0.0]], &(), &[1.0; 8], [true; 3])));
    let map = Linear { inputs: 3, outputs: 5, instructions: Instructions::best() };
    let other = map.clone();
    assert!(refused(move || _ = map.backward([&[1.0; 3], &[1.0; 11], &[0.0; 5]], &(), &[1.0; 5], [true; 3])));
    assert!(!refused(move || _ = other.backward([&[1.0; 3], &[1.0; 15], &[0.0; 5]], &(), &[1.0; 5], [true; 3])));
}

#[test]
fn no_images_give_no_result_and_gradients_of_nothing() {
    let conv = Conv3 {
        height: 4,
        width: 4,
        inputs: 2,
        outputs: 3,
        convolutions: Convolutions::Direct,
        instructions: Instructions::best(),
    };
    let inputs = [&[][..], &[1.0; 54], &[1.0; 3]];
    assert!(conv.forward(inputs).0.is_empty());
    assert_eq!(conv.backward(inputs, &(), &[], [true; 3]).map(|v| v.len()), [0, 54, 3]);
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let instructions = Instructions::best();
    let conv =
        Conv3 { height: 40, width: 24, inputs: 48, outputs: 48, convolutions: Convolutions::Direct, instructions };
    let (x, kernel, bias) = (numbers(1, 3 * 960 * 48), numbers(2, 9 * 48 * 48), numbers(3, 48));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let (out, ()) = conv.forward([&x, &kernel, &bias]);
            let gradients = conv.backward([&x, &kernel, &bias], &(), &out, [true; 3]);
            [vec![out], gradients.to_vec()].concat().iter().map(|v| bits(v)).collect::<Vec<_>>()
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}
