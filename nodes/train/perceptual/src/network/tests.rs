//! Layers against their definitions, and the distance of made-up weights.

use super::*;
use tauflow_data::rng::Stream;

fn numbers(seed: u64, count: usize, scale: f64) -> Vec<f32> {
    let mut stream = Stream::new(seed, &[]);
    (0..count).map(|_| (scale * stream.normal()) as f32).collect()
}

#[test]
fn a_convolution_follows_its_definition() {
    let shape = Shape { place: 0, inputs: 2, outputs: 3, side: 3, stride: 2, padding: 1, pooled: false };
    let theirs = numbers(1, 3 * 2 * 9, 1.0);
    let mut kernel = vec![0.0; theirs.len()];
    for (o, i, tap) in (0..3).flat_map(|o| (0..2).flat_map(move |i| (0..9).map(move |tap| (o, i, tap)))) {
        kernel[(tap * 2 + i) * 3 + o] = theirs[(o * 2 + i) * 9 + tap];
    }
    let x = Grid { height: 5, width: 6, channels: 2, data: numbers(2, 60, 1.0) };
    let found = Layer { shape, kernel, bias: vec![0.1, -0.2, 0.3] }.of(&x);
    assert_eq!((found.height, found.width, found.channels), (3, 3, 3));
    for (y, x0, o) in (0..3).flat_map(|y| (0..3).flat_map(move |x| (0..3).map(move |o| (y, x, o)))) {
        let mut sum = f64::from([0.1f32, -0.2, 0.3][o]);
        for (i, tap) in (0..2).flat_map(|i| (0..9).map(move |tap| (i, tap))) {
            let (row, column) = ((2 * y + tap / 3) as i64 - 1, (2 * x0 + tap % 3) as i64 - 1);
            if (0..5).contains(&row) && (0..6).contains(&column) {
                let value = x.pixel(column as usize, row as usize)[i];
                sum += f64::from(theirs[(o * 2 + i) * 9 + tap]) * f64::from(value);
            }
        }
        assert!((f64::from(found.pixel(x0, y)[o]) - sum.max(0.0)).abs() < 1e-5);
    }
}

#[test]
fn pooling_takes_the_maximum_of_nine() {
    let x = Grid { height: 5, width: 6, channels: 1, data: (0..30).map(|v| -(v as f32)).collect() };
    let found = x.pooled();
    assert_eq!((found.height, found.width), (2, 2));
    assert_eq!(found.data, [0.0, -2.0, -12.0, -14.0]);
}

#[test]
fn the_distance_of_a_pixel_follows_its_definition() {
    // Directions (1, 0) and (0.6, 0.8): differences 0.4 and -0.8.
    let found = of_pixel(&[2.0, 0.0], &[3.0, 4.0], &[10.0, 100.0]);
    assert!((found - (10.0 * 0.16 + 100.0 * 0.64)).abs() < 1e-6, "{found}");
    // Features that vanish have no direction.
    assert_eq!(of_pixel(&[0.0], &[0.0], &[1.0]), 0.0);
    assert!((of_pixel(&[0.0], &[5.0], &[1.0]) - 1.0).abs() < 1e-9);
}
