use super::{super::FARTHEST, *};
use crate::{Fold, made_up::numbers};

const SIDES: [usize; 3] = [5, 3, 1];
const SIZE: (usize, usize) = (8, 12);
const ALL: usize = 2 * SIZE.0 * SIZE.1;
const COUNT: usize = 35;

fn pyramid() -> (Vec<f32>, Arc<Pyramid>) {
    let pixels = numbers(3, 3 * ALL);
    let pyramid = Pyramid::new(&pixels, SIZE.0, SIZE.1, &SIDES);
    assert_eq!(pyramid.weights(), COUNT);
    (pixels, Arc::new(pyramid))
}

/// Numbers of pixels as those of folded pixels, or back.
fn folded(values: &[f32], channels: usize, back: bool) -> Vec<f32> {
    Fold { height: SIZE.0, width: SIZE.1, channels, back }.forward([values]).0
}

/// Where a pixel is: image, y, x.
fn place(at: usize) -> Place {
    (at / (SIZE.0 * SIZE.1), at / SIZE.1 % SIZE.0, at % SIZE.1)
}

/// The means over the blocks in the windows around a pixel, of one of the channels of an image.
fn around(pixels: &[f32], channels: usize, channel: usize, (image, y, x): Place) -> Vec<f64> {
    let ((height, width), mut out) = (SIZE, Vec::new());
    for (scale, side) in SIDES.iter().enumerate() {
        let (block, reach) = (1usize << scale, (side / 2) as i64);
        for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
            let edge = |v: usize, d: i64, size: usize| {
                ((v / block) as i64 + d).clamp(0, (size / block) as i64 - 1) as usize * block
            };
            let (v, u) = (edge(y, dy, height), edge(x, dx, width));
            let of =
                |j: usize, i: usize| f64::from(pixels[channels * ((image * height + v + j) * width + u + i) + channel]);
            let sum: f64 = (0..block * block).map(|i| of(i / block, i % block)).sum();
            out.push(sum / (block * block) as f64);
        }
    }
    out
}

/// The weighted mean from the definition.
fn defined(around: &[f64], logits: &[f64]) -> f64 {
    let (sum, total) = around.iter().zip(logits).fold((0.0, 0.0), |(sum, total), (value, logit)| {
        let weight = logit.exp();
        (sum + weight * value, total + weight)
    });
    sum / total
}

/// Asserts that a gradient is what central differences of the definition say.
fn assert_slope(found: f32, value: impl Fn(f64) -> f64, what: &str) {
    let expected = (value(1e-4) - value(-1e-4)) / 2e-4;
    assert!((f64::from(found) - expected).abs() < 1e-4 * expected.abs().max(0.1), "{what}: {found} {expected}");
}

#[test]
fn means_and_gradients_are_those_of_the_definition() {
    let (pixels, pyramid) = pyramid();
    let operator = WeightedMean { pyramid, own: 0.5, first: 0 };
    let logits: Vec<f32> = numbers(5, ALL * COUNT).iter().map(|v| 4.0 * v).collect();
    let given = folded(&logits, COUNT, false);
    let (out, ()) = operator.forward([&given]);
    let gradient = numbers(7, out.len());
    let [found] = operator.backward([&given], &(), &gradient, [true]);
    let found = folded(&found, COUNT, true);
    for at in (0..ALL).step_by(5) {
        let around = [0, 1, 2].map(|c| around(&pixels, 3, c, place(at)));
        let mut own: Vec<f64> = logits[at * COUNT..][..COUNT].iter().map(|v| f64::from(*v)).collect();
        own[12] += 0.5;
        for c in 0..3 {
            let expected = defined(&around[c], &own);
            assert!((f64::from(out[3 * at + c]) - expected).abs() < 1e-5, "{at}: {} {expected}", out[3 * at + c]);
        }
        for b in (0..COUNT).step_by(3) {
            let value = |by: f64| {
                let mut logits = own.clone();
                logits[b] += by;
                (0..3).map(|c| defined(&around[c], &logits) * f64::from(gradient[3 * at + c])).sum()
            };
            assert_slope(found[at * COUNT + b], value, &format!("{at} {b}"));
        }
    }
}

#[test]
fn guides_lower_what_looks_different_as_defined() {
    let (pixels, pyramid) = pyramid();
    let mut gbuffer = numbers(4, 6 * ALL);
    // Some pixels are farther than counts, one beyond all numbers.
    gbuffer.iter_mut().step_by(50).for_each(|value| *value *= 4.0);
    gbuffer[103] = 1e30;
    let guides = Arc::new(Guides::new(&gbuffer, SIZE.0, SIZE.1, &SIDES));
    let operator = GuidedMean { pyramid, guides, first: 0 };
    let each = operator.strengths();
    assert_eq!(each, 6);
    let logits: Vec<f32> = numbers(5, ALL * COUNT).iter().map(|v| 4.0 * v).collect();
    // Both signs, so that no place takes all of the weight everywhere.
    let strengths: Vec<f32> = numbers(6, ALL * each).iter().map(|v| 0.1 * v).collect();
    let given = [folded(&logits, COUNT, false), folded(&strengths, each, false)];
    let inputs = [&given[0][..], &given[1]];
    let (out, ()) = operator.forward(inputs);
    let gradient = numbers(7, out.len());
    let [of_numbers, of_strengths] = operator.backward(inputs, &(), &gradient, [true; 2]);
    let (of_numbers, of_strengths) = (folded(&of_numbers, COUNT, true), folded(&of_strengths, each, true));
    for at in (0..ALL).step_by(3) {
        let lights = [0, 1, 2].map(|c| around(&pixels, 3, c, place(at)));
        let guides: [Vec<f64>; 6] = std::array::from_fn(|c| around(&gbuffer, 6, c, place(at)));
        let distance = |guide: usize, b: usize| -> f64 {
            let own = |c: usize| f64::from(gbuffer[6 * at + c]);
            let square = (3 * guide..3 * guide + 3).map(|c| (guides[c][b] - own(c)).powi(2)).sum::<f64>();
            square.min(f64::from(FARTHEST))
        };
        let levels = [0..25, 25..34, 34..35];
        let value = |moved: Option<(bool, usize, f64)>| -> [f64; 3] {
            let mut numbers: Vec<f64> = logits[at * COUNT..][..COUNT].iter().map(|v| f64::from(*v)).collect();
            let mut strengths: Vec<f64> = strengths[at * each..][..each].iter().map(|v| f64::from(*v)).collect();
            if let Some((of_strengths, which, by)) = moved {
                *if of_strengths { &mut strengths[which] } else { &mut numbers[which] } += by;
            }
            for (level, places) in levels.iter().enumerate() {
                for b in places.clone() {
                    for guide in 0..GUIDES {
                        numbers[b] -= f64::from(SHARPNESS) * strengths[level * GUIDES + guide] * distance(guide, b);
                    }
                }
            }
            [0, 1, 2].map(|c| defined(&lights[c], &numbers))
        };
        let probed = |values: [f64; 3]| (0..3).map(|c| values[c] * f64::from(gradient[3 * at + c])).sum::<f64>();
        for (found, expected) in out[3 * at..].iter().zip(value(None)) {
            assert!((f64::from(*found) - expected).abs() < 2e-5, "{at}: {found} {expected}");
        }
        for b in (0..COUNT).step_by(4) {
            let found = of_numbers[at * COUNT + b];
            assert_slope(found, |by| probed(value(Some((false, b, by)))), &format!("{at}, number {b}"));
        }
        for which in 0..each {
            let found = of_strengths[at * each + which];
            assert_slope(found, |by| probed(value(Some((true, which, by)))), &format!("{at}, strength {which}"));
        }
    }
    let levels: Vec<_> = operator.guides.levels().map(|level| (level.scale, level.side, level.pixels)).collect();
    assert_eq!(levels[0].2.len(), 2 * (SIZE.0 + 4) * (SIZE.1 + 4) * 6);
    // The third pixel of the third row is the first of the image.
    assert_eq!(levels[0].2[6 * (2 * (SIZE.1 + 4) + 2)..][..6], gbuffer[..6]);
    assert_eq!((levels[2].0, levels[2].1, levels[2].2.len()), (2, 1, 2 * 2 * 3 * 6));
}

#[test]
fn means_stay_within_the_window_whatever_the_weights() {
    let (pixels, pyramid) = pyramid();
    let operator = WeightedMean { pyramid, own: 0.0, first: 0 };
    // A weight far above the others takes it all, here the window's middle.
    let mut logits = vec![-300.0f32; ALL * COUNT];
    logits.chunks_exact_mut(COUNT).for_each(|of| of[12] = 300.0);
    let (out, ()) = operator.forward([&logits]);
    assert!(out.iter().zip(&pixels).all(|(a, b)| (a - b).abs() < 1e-6));
    let [gradient] = operator.backward([&logits], &(), &vec![1.0; out.len()], [true]);
    assert!(gradient.iter().all(|g| g.abs() < 1e-6));
}

/// Small images, of which the last window ends with the data, and three of them.
#[test]
fn tiny_images_are_averaged_as_well() {
    for (height, width, sides) in [(4, 4, &[5, 3, 1][..]), (2, 2, &[5, 1]), (2, 2, &[1]), (2, 6, &[3])] {
        let pixels = 3 * height * width;
        let pyramid = Arc::new(Pyramid::new(&numbers(1, 3 * pixels), height, width, sides));
        let guides = Arc::new(Guides::new(&numbers(2, 6 * pixels), height, width, sides));
        let count = pyramid.weights();
        let logits = numbers(3, count * pixels);
        let plain = WeightedMean { pyramid: pyramid.clone(), own: 0.0, first: 0 };
        let guided = GuidedMean { pyramid, guides, first: 0 };
        // Strengths of zero guide nothing.
        let none = vec![0.0; guided.strengths() * pixels];
        let (expected, ()) = plain.forward([&logits]);
        let (found, ()) = guided.forward([&logits, &none]);
        assert_eq!((found.len(), &found), (3 * pixels, &expected), "{height} x {width}, {sides:?}");
        let [expected] = plain.backward([&logits], &(), &found, [true]);
        let [found, strengths] = guided.backward([&logits, &none], &(), &found, [true; 2]);
        assert!(found == expected && strengths.iter().all(|slope| slope.is_finite()));
        let levels: Vec<_> = guided.guides.levels().map(|level| (level.side, level.pixels.len())).collect();
        let padded = |(scale, side): (usize, &usize)| {
            (*side, 3 * ((height >> scale) + side - 1) * ((width >> scale) + side - 1) * 6)
        };
        assert_eq!(levels, sides.iter().enumerate().map(padded).collect::<Vec<_>>());
    }
}

#[test]
fn what_is_no_number_is_far() {
    let (_, pyramid) = pyramid();
    let far = |value: f32| {
        let mut gbuffer = vec![0.25; 6 * ALL];
        gbuffer[6 * (3 * SIZE.1 + 3)] = value;
        let guides = Arc::new(Guides::new(&gbuffer, SIZE.0, SIZE.1, &SIDES));
        let guided = GuidedMean { pyramid: pyramid.clone(), guides, first: 0 };
        guided.forward([&folded(&numbers(5, ALL * COUNT), COUNT, false), &vec![0.1; ALL * guided.strengths()]]).0
    };
    let (nan, infinite) = (far(f32::NAN), far(1e30));
    assert!(nan.iter().all(|value| value.is_finite()));
    // The pixel itself is no number from everything, itself included.
    let own = 3 * (3 * SIZE.1 + 3);
    let others = |values: &[f32]| [&values[..own], &values[own + 3..]].concat();
    assert_eq!(others(&nan), others(&infinite));
}
