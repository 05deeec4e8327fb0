//! The library of procedural surface textures: tileable bitmaps in fixed variants, coloured by the material.
//!
//! Like the forms, variants come from the library and not from a scene's seed, so that scenes share blobs.

use super::noise::{fractal, noise};
use tauflow_data::{Image, maths, mesh::Bitmap, rng::Stream};

/// Pixels along a side.
pub const SIZE: usize = 96;
/// Variants of each pattern.
pub const VARIANTS: u64 = 8;
/// Every pattern.
pub const PATTERNS: [&str; 5] = ["marble", "wood", "tiles", "speckle", "stripes"];

/// A pattern's variant: one channel in [0.12, 1], which multiplies a colour.
pub fn pattern(name: &str, variant: u64) -> Bitmap {
    let mut draw = Stream::new(0x7465_7874, &[variant]).part(name);
    let seed = draw.bits();
    let (a, b) = (draw.uniform(), draw.uniform());
    let count = 2 + draw.below(4);
    let pi = core::f64::consts::PI;
    let value = |u: f64, v: f64| -> f64 {
        let f = |scale: i64, octaves| {
            fractal(seed, [u * scale as f64, v * scale as f64, a * 7.0], [scale, scale, 0], octaves)
        };
        match name {
            "marble" => {
                let phase = count as f64 * (u + v) + 1.2 * f(3, 5);
                let vein = maths::sin(2.0 * pi * phase).abs();
                0.35 + 0.65 * maths::pow(vein, 0.25 + 0.5 * b)
            }
            "wood" => {
                let ring = 2.0 * count as f64 * (u + 0.12 * f(2, 3));
                let grain = noise(seed ^ 1, [u * 48.0, v * 4.0, 0.5], [48, 4, 0]);
                0.62 + 0.25 * maths::sin(2.0 * pi * ring) + 0.13 * grain
            }
            "tiles" => {
                let n = 2.0 * count as f64;
                let (x, y) = (u * n, v * n);
                let shift = if b > 0.5 && (y.floor() as i64) % 2 == 1 { 0.5 } else { 0.0 };
                let (fx, fy) = ((x + shift) - (x + shift).floor(), y - y.floor());
                let gap = 0.05;
                let cell = [(x + shift).floor().rem_euclid(n), y.floor(), 0.0];
                if fx < gap || fy < gap { 0.25 } else { 0.8 + 0.2 * noise(seed, cell.map(|c| c * 1.0 + 0.5), [0; 3]) }
            }
            "speckle" => {
                let spots = f(6 + count as i64 * 2, 2);
                if spots > 0.18 { 0.3 + 0.2 * a } else { 0.85 + 0.15 * f(4, 3) }
            }
            _ => {
                let t = u * 2.0 * count as f64 + 0.05 * f(3, 2);
                if t - t.floor() < 0.35 + 0.3 * b { 0.95 } else { 0.3 + 0.3 * a }
            }
        }
    };
    let data = (0..SIZE * SIZE)
        .map(|i| {
            let (x, y) = (i % SIZE, i / SIZE);
            let v = value((x as f64 + 0.5) / SIZE as f64, (y as f64 + 0.5) / SIZE as f64);
            v.clamp(0.12, 1.0) as f32
        })
        .collect();
    Image::from_data(SIZE, SIZE, 1, data).expect("the shape is the data's")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_in_range_and_not_flat() {
        for name in PATTERNS {
            for variant in 0..VARIANTS {
                let image = pattern(name, variant);
                let (low, high) = image.data().iter().fold((1.0f32, 0.0f32), |(l, h), v| (l.min(*v), h.max(*v)));
                assert!(low >= 0.12 && high <= 1.0 && high - low > 0.2, "{name}-{variant}: {low}..{high}");
            }
        }
    }
}
