//! Cases in closed form, invariants, and numbers of the reference implementation.

use super::*;

fn image(width: usize, height: usize, of: impl Fn(usize, usize, usize) -> f64) -> Image {
    let at = |i: usize| of(i / 3 % width, i / 3 / width, i % 3) as f32;
    Image::from_data(width, height, 3, (0..3 * width * height).map(at).collect()).expect("as many")
}

fn constant(value: f64) -> Image {
    image(12, 12, |_, _, _| value)
}

fn near(found: f64, expected: f64, off: f64) {
    assert!((found - expected).abs() <= off, "{found}, expected {expected}");
}

/// A pattern and a disturbed copy, each within [0, 1].
fn pair(width: usize, height: usize) -> [Image; 2] {
    let clean = |x: usize, y: usize, k: usize| (3 * x * x + 7 * y + 5 * x * y + 29 * k) % 64;
    let noisy = move |x: usize, y: usize, k: usize| (clean(x, y, k) + (11 * x + 5 * y + 3 * k) % 9) % 64;
    [
        image(width, height, |x, y, k| clean(x, y, k) as f64 / 63.0),
        image(width, height, |x, y, k| noisy(x, y, k) as f64 / 63.0),
    ]
}

/// The same with radiance up to 8.
fn bright(width: usize, height: usize) -> [Image; 2] {
    pair(width, height).map(|image| image.map(|v| (f64::from(v) * f64::from(v) * f64::from(v) * 8.0) as f32))
}

fn of_hdr(test: &Image, reference: &Image) -> f64 {
    hdr_flip(test, reference, &exposures(reference))
}

#[test]
fn a_kernel_of_one_tap_changes_nothing_and_borders_repeat() {
    let plane = Plane { values: &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], width: 3 };
    assert_eq!(plane.convolved(&[1.0], &[1.0]), plane.values);
    // A step to the right, and one down: the last column and the last row repeat.
    assert_eq!(plane.convolved(&[0.0, 0.0, 1.0], &[1.0]), [2.0, 3.0, 3.0, 5.0, 6.0, 6.0]);
    assert_eq!(plane.convolved(&[1.0], &[0.0, 0.0, 1.0]), [4.0, 5.0, 6.0, 4.0, 5.0, 6.0]);
    // A kernel that is wider than the image.
    let wide = plane.convolved(&[1.0 / 9.0; 9], &[1.0]);
    near(wide[0], (5.0 * 1.0 + 2.0 + 3.0 * 3.0) / 9.0, 1e-12);
}

#[test]
fn constant_images_have_the_error_of_their_colours() {
    // No features. Lightness 100 against 0: 100^0.7 is beyond 0.4 of the largest distance, 203.3017^0.7 = 41.27610.
    let (most, white) = (41.276_098_4, 100f64.powf(0.7));
    near(flip(&seen(&constant(1.0)), &seen(&constant(0.0))), 0.95 + 0.05 * (white / most - 0.4) / 0.6, 2e-5);
    // Linear 0.01 has lightness 8.991442, which is below it.
    let dark = Seen::of(&pixels(&constant(0.01), |v| v), 12);
    near(flip(&dark, &seen(&constant(0.0))), 0.95 * 8.991_442_4f64.powf(0.7) / (0.4 * most), 2e-5);
    near(largest(), most, 1e-6);
}

#[test]
fn equal_images_have_no_error_and_order_does_not_matter() {
    let [clean, noisy] = pair(23, 17);
    let [a, b] = [seen(&clean), seen(&noisy)];
    assert_eq!(flip(&a, &a), 0.0);
    assert_eq!(flip(&a, &b), flip(&b, &a));
    let all = errors(&a, &b);
    assert!(all.iter().all(|error| (0.0..=1.0).contains(error)));
    let [clean, noisy] = bright(23, 17);
    assert_eq!(of_hdr(&clean, &clean), 0.0);
    assert!(of_hdr(&noisy, &clean) > 0.0);
}

#[test]
fn exposures_reach_from_the_maximum_to_the_median_of_the_reference() {
    // ACES shows 2.1188723 as 0.85.
    let grey = exposures(&constant(2.118_872_3));
    assert_eq!(grey.len(), 2);
    assert!(grey.iter().all(|stop| stop.abs() < 1e-6), "{grey:?}");
    // A maximum of 8 and a median of 0.5 are four stops apart.
    let two = exposures(&image(10, 10, |x, _, _| if x == 3 { 8.0 } else { 0.5 }));
    near(two[two.len() - 1] - two[0], 4.0, 1e-6);
    assert!(two.len() == 4 || two.len() == 5, "{two:?}");
    // A black reference, and negative values, which count as black.
    assert_eq!(exposures(&constant(0.0)), exposures(&constant(-1.0)));
    assert!(exposures(&constant(0.0)).iter().all(|stop| stop.is_finite()));
}

#[test]
fn a_common_factor_changes_no_hdr_flip() {
    let [clean, noisy] = bright(20, 16);
    let times = |image: &Image| image.map(|v| 16.0 * v);
    near(of_hdr(&times(&noisy), &times(&clean)), of_hdr(&noisy, &clean), 1e-12);
}

#[test]
fn values_without_bounds_have_a_bounded_error() {
    let [clean, _] = bright(20, 16);
    let mut wild = clean.clone();
    wild.data_mut()[..6].copy_from_slice(&[f32::MAX, f32::MIN, -1.0, f32::MAX, 0.0, f32::MIN_POSITIVE]);
    let black = clean.map(|_| 0.0);
    for (test, reference) in [(&wild, &clean), (&clean, &wild), (&wild, &black)] {
        let found = of_hdr(test, reference);
        assert!((0.0..=1.0).contains(&found) && found > 0.0, "{found}");
    }
}

#[test]
fn errors_are_those_of_the_reference_implementation() {
    // flip_evaluator 1.7: LDR with sRGB input, HDR with its defaults. It computes in f32.
    for (width, height, ldr, hdr, range) in [
        (40, 30, 0.304_023, 0.306_654, (-1.511_168, 0.523_760, 3)),
        (7, 5, 0.421_621, 0.381_804, (-1.136_590, 0.523_760, 2)),
    ] {
        let [clean, noisy] = pair(width, height);
        near(flip(&seen(&noisy), &seen(&clean)), ldr, 3e-6);
        let [clean, noisy] = bright(width, height);
        let stops = exposures(&clean);
        assert_eq!(stops.len(), range.2);
        near(stops[0], range.0, 2e-6);
        near(stops[stops.len() - 1], range.1, 2e-6);
        near(hdr_flip(&noisy, &clean, &stops), hdr, 3e-6);
    }
}

#[test]
fn the_error_map_is_that_of_the_viewer() {
    // The images and the numbers of the viewer's own test, which are of flip_evaluator 1.7 with linear input.
    let clean = image(40, 30, |x, y, k| ((x / 5 * 5 + y / 6 * 11 + k * 3) % 17) as f64 / 16.0);
    let noisy = image(40, 30, |x, y, k| ((x * 7 + y * 13 + k * 5) % 17) as f64 / 16.0);
    let [clean, noisy] = [clean, noisy].map(|image| Seen::of(&pixels(&image, |v| v), 40));
    let map = errors(&noisy, &clean);
    let expected =
        [((0, 0), 0.701_560), ((10, 5), 0.605_962), ((39, 29), 0.973_534), ((20, 15), 0.621_757), ((3, 28), 0.737_012)];
    for ((x, y), value) in expected {
        near(map[y * 40 + x], value, 2e-6);
    }
    near(mean(&map), 0.714_194, 2e-6);
}
