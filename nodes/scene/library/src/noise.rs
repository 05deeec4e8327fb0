//! Value noise and fractal sums of it, for shapes, textures and skies.
//!
//! Lattice values are hashes, blended with a quintic step (Perlin 2002), so that the field is smooth and repeats
//! nowhere in use; `periods` makes it repeat where a texture must tile.

use tauflow_data::rng::mix;

/// Smooth noise in [-1, 1] at `p`; lattice coordinates are taken modulo `period` where it is not 0.
pub fn noise(seed: u64, p: [f64; 3], period: [i64; 3]) -> f64 {
    let cell = p.map(f64::floor);
    let t = [0, 1, 2].map(|i| {
        let f = p[i] - cell[i];
        f * f * f * (f * (f * 6.0 - 15.0) + 10.0)
    });
    let lattice = |dx: i64, dy: i64, dz: i64| {
        let offset = [dx, dy, dz];
        let state = (0..3).fold(seed, |state, i| {
            let at = cell[i] as i64 + offset[i];
            let at = if period[i] > 0 { at.rem_euclid(period[i]) } else { at };
            mix(state, at as u64)
        });
        (state >> 11) as f64 * (2.0 / (1u64 << 53) as f64) - 1.0
    };
    let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let plane = |dz: i64| {
        lerp(lerp(lattice(0, 0, dz), lattice(1, 0, dz), t[0]), lerp(lattice(0, 1, dz), lattice(1, 1, dz), t[0]), t[1])
    };
    lerp(plane(0), plane(1), t[2])
}

/// Sum of `octaves` of noise, each of twice the frequency and half the weight, scaled to about [-1, 1].
pub fn fractal(seed: u64, p: [f64; 3], period: [i64; 3], octaves: u32) -> f64 {
    let (mut sum, mut weight, mut total, mut scale) = (0.0, 1.0, 0.0, 1i64);
    for octave in 0..octaves {
        let q = p.map(|v| v * scale as f64);
        sum += weight * noise(mix(seed, u64::from(octave)), q, period.map(|v| v * scale));
        total += weight;
        weight *= 0.5;
        scale *= 2;
    }
    sum / total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_bounded_smooth_and_periodic() {
        for i in 0..500 {
            let p = [f64::from(i) * 0.137, f64::from(i) * 0.071, 0.3];
            let v = fractal(3, p, [0; 3], 4);
            assert!(v.abs() <= 1.0);
            let near = fractal(3, [p[0] + 1e-6, p[1], p[2]], [0; 3], 4);
            assert!((v - near).abs() < 1e-3);
            let periodic = noise(3, [p[0] + 4.0, p[1], p[2]], [4, 4, 0]);
            assert!((noise(3, p, [4, 4, 0]) - periodic).abs() < 1e-9);
        }
    }
}
