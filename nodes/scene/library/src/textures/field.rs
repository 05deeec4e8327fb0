//! Grids of numbers that repeat in both directions: noise, cells, blurs and slopes, from which maps are made.
//!
//! Knows no material. A field covers one period; u runs with columns and v with rows, both over [0, 1). Lattice noise
//! is that of Perlin (2002) on a hashed lattice that wraps; cells are those of Worley (1996).

use tauflow_data::rng::mix;

/// Columns and rows.
pub type Size = [usize; 2];

/// A number for each texel of one period.
#[derive(Clone)]
pub struct Field {
    /// Columns and rows.
    pub size: Size,
    /// Values by row.
    pub values: Vec<f64>,
}

/// 0 below `low`, 1 above `high`, smooth between.
pub fn step(low: f64, high: f64, v: f64) -> f64 {
    let t = ((v - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A number in [0, 1) of a seed and whole coordinates.
pub fn hash(seed: u64, at: [i64; 2]) -> f64 {
    (mix(mix(seed, at[0] as u64), at[1] as u64) >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

fn fade(t: f64) -> f64 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// The part after the point.
pub fn fract(v: f64) -> f64 {
    v - v.floor()
}

impl Field {
    /// A field of `f(u, v)` at the texels' centres.
    #[cfg(test)]
    pub fn of(size: Size, mut f: impl FnMut(f64, f64) -> f64) -> Self {
        let mut values = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            let v = (y as f64 + 0.5) / size[1] as f64;
            values.extend((0..size[0]).map(|x| f((x as f64 + 0.5) / size[0] as f64, v)));
        }
        Self { size, values }
    }

    /// Lattice noise of `cells` cells, about [-1, 1].
    pub fn noise(size: Size, seed: u64, cells: Size) -> Self {
        let [nx, ny] = cells;
        let slope = |x: usize, y: usize| {
            let word = mix(mix(seed, x as u64), y as u64);
            let unit = |bits: u64| (bits & 0xFFFF) as f64 * (2.0 / 65535.0) - 1.0;
            [unit(word >> 8), unit(word >> 32)]
        };
        let slopes: Vec<[f64; 2]> = (0..nx * ny).map(|i| slope(i % nx, i / nx)).collect();
        let columns: Vec<(usize, usize, f64, f64)> = (0..size[0])
            .map(|x| {
                let at = (x as f64 + 0.5) * nx as f64 / size[0] as f64;
                let left = at.floor() as usize;
                (left % nx, (left + 1) % nx, at - left as f64, fade(at - left as f64))
            })
            .collect();
        let mut values = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            let at = (y as f64 + 0.5) * ny as f64 / size[1] as f64;
            let top = at.floor() as usize;
            let (ty, wy) = (at - top as f64, fade(at - top as f64));
            let (upper, lower) = (&slopes[top % ny * nx..][..nx], &slopes[(top + 1) % ny * nx..][..nx]);
            values.extend(columns.iter().map(|&(left, right, tx, wx)| {
                let dot = |g: [f64; 2], x: f64, y: f64| g[0] * x + g[1] * y;
                let a = dot(upper[left], tx, ty);
                let b = dot(upper[right], tx - 1.0, ty);
                let c = dot(lower[left], tx, ty - 1.0);
                let d = dot(lower[right], tx - 1.0, ty - 1.0);
                let (ab, cd) = (a + (b - a) * wx, c + (d - c) * wx);
                1.7 * (ab + (cd - ab) * wy)
            }));
        }
        Self { size, values }
    }

    /// Sum of octaves of noise, each of twice the frequency and `gain` times the weight, scaled to about [-1, 1].
    /// Octaves finer than two texels are left out.
    pub fn fractal(size: Size, seed: u64, cells: Size, octaves: u32, gain: f64) -> Self {
        let mut sum = Self { size, values: vec![0.0; size[0] * size[1]] };
        let (mut weight, mut total) = (1.0, 0.0);
        for octave in 0..octaves {
            let now = cells.map(|c| c << octave);
            if octave > 0 && (now[0] > size[0] / 2 || now[1] > size[1] / 2) {
                break;
            }
            let more = Self::noise(size, mix(seed, u64::from(octave)), [now[0].min(size[0]), now[1].min(size[1])]);
            sum.values.iter_mut().zip(&more.values).for_each(|(a, b)| *a += weight * b);
            total += weight * weight;
            weight *= gain;
        }
        let scale = 1.0 / total.sqrt();
        sum.values.iter_mut().for_each(|v| *v *= scale);
        sum
    }

    /// The value at a texel, wrapped.
    pub fn at(&self, x: i64, y: i64) -> f64 {
        let (w, h) = (self.size[0] as i64, self.size[1] as i64);
        self.values[(y.rem_euclid(h) * w + x.rem_euclid(w)) as usize]
    }

    /// The value at u, v, wrapped, between texels by their distance.
    pub fn sample(&self, u: f64, v: f64) -> f64 {
        let (x, y) = (u * self.size[0] as f64 - 0.5, v * self.size[1] as f64 - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (tx, ty) = (x - left, y - top);
        let (i, j) = (left as i64, top as i64);
        let upper = self.at(i, j) * (1.0 - tx) + self.at(i + 1, j) * tx;
        let lower = self.at(i, j + 1) * (1.0 - tx) + self.at(i + 1, j + 1) * tx;
        upper * (1.0 - ty) + lower * ty
    }

    /// Means over squares of `2 radius + 1` texels.
    pub fn blurred(&self, radius: usize) -> Self {
        let (w, h, r) = (self.size[0] as i64, self.size[1] as i64, radius as i64);
        let share = 1.0 / (2 * r + 1) as f64;
        let pass = |from: &Self, along_rows: bool| {
            let mut out = vec![0.0; from.values.len()];
            let (lines, length) = if along_rows { (h, w) } else { (w, h) };
            for line in 0..lines {
                let get = |i: i64| if along_rows { from.at(i, line) } else { from.at(line, i) };
                let mut sum: f64 = (-r..=r).map(get).sum();
                for i in 0..length {
                    let place = if along_rows { line * w + i } else { i * w + line };
                    out[place as usize] = sum * share;
                    sum += get(i + r + 1) - get(i - r);
                }
            }
            Self { size: from.size, values: out }
        };
        pass(&pass(self, true), false)
    }

    /// Mean value.
    #[cfg(test)]
    pub fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }
}

/// Distances to scattered points, one in each cell of a lattice.
pub struct Cells {
    /// To the nearest, in cells.
    pub near: Field,
    /// To the second nearest.
    pub next: Field,
    /// A number in [0, 1) for the nearest one.
    pub id: Field,
}

impl Cells {
    /// Of `cells` cells whose points lie up to `jitter` / 2 off their middles. `shift(u, v)` moves the place that is
    /// looked up, in cells.
    pub fn new(size: Size, seed: u64, cells: Size, jitter: f64, shift: impl Fn(f64, f64) -> [f64; 2]) -> Self {
        let [nx, ny] = cells.map(|c| c as i64);
        let points: Vec<[f64; 2]> = (0..nx * ny)
            .map(|i| {
                let at = [i % nx, i / nx];
                let off = |salt: u64| 0.5 + jitter * (hash(seed ^ salt, at) - 0.5);
                [off(1), off(2)]
            })
            .collect();
        let blank = || Field { size, values: Vec::with_capacity(size[0] * size[1]) };
        let mut out = Self { near: blank(), next: blank(), id: blank() };
        for y in 0..size[1] {
            let v = (y as f64 + 0.5) / size[1] as f64;
            for x in 0..size[0] {
                let u = (x as f64 + 0.5) / size[0] as f64;
                let [du, dv] = shift(u, v);
                let (px, py) = (u * nx as f64 + du, v * ny as f64 + dv);
                let (cx, cy) = (px.floor() as i64, py.floor() as i64);
                let (mut first, mut second, mut owner) = (f64::MAX, f64::MAX, 0);
                for j in cy - 1..=cy + 1 {
                    for i in cx - 1..=cx + 1 {
                        let index = (j.rem_euclid(ny) * nx + i.rem_euclid(nx)) as usize;
                        let (ex, ey) = (i as f64 + points[index][0] - px, j as f64 + points[index][1] - py);
                        let square = ex * ex + ey * ey;
                        if square < first {
                            (second, first, owner) = (first, square, index);
                        } else if square < second {
                            second = square;
                        }
                    }
                }
                out.near.values.push(first.sqrt());
                out.next.values.push(second.sqrt());
                out.id.values.push(hash(seed ^ 3, [owner as i64, 0]));
            }
        }
        out
    }

    /// How far from the border of two cells, 0 on it.
    pub fn edge(&self) -> Field {
        let values = self.next.values.iter().zip(&self.near.values).map(|(b, a)| b - a).collect();
        Field { size: self.near.size, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_bounded_varied_and_repeats() {
        for cells in [[3, 3], [7, 2], [32, 32]] {
            let field = Field::noise([64, 64], 5, cells);
            assert!(field.values.iter().all(|v| v.abs() < 1.8), "{cells:?}");
            assert!(field.mean().abs() < 0.25, "{cells:?}");
            let spread = field.values.iter().map(|v| v * v).sum::<f64>() / 4096.0;
            assert!(spread > 0.02, "{cells:?}: {spread}");
            // The step over the border is like the one inside.
            let largest = |xs: &[i64]| {
                (0..64)
                    .flat_map(|y| xs.iter().map(move |x| (x, y)))
                    .fold(0.0f64, |most, (x, y)| most.max((field.at(*x, y) - field.at(x - 1, y)).abs()))
            };
            assert!(largest(&[0]) <= 1.5 * largest(&(1..64).collect::<Vec<_>>()), "{cells:?}");
        }
    }

    #[test]
    fn cells_order_their_distances_and_blurring_keeps_means() {
        let cells = Cells::new([48, 32], 9, [6, 4], 0.9, |_, _| [0.0; 2]);
        assert!(cells.edge().values.iter().all(|v| *v >= 0.0));
        assert!(cells.near.values.iter().all(|v| *v < 1.5));
        let blurred = cells.near.blurred(3);
        assert!((blurred.mean() - cells.near.mean()).abs() < 1e-9);
        let own = |x: i64, y: i64| (-3..=3).flat_map(move |j| (-3..=3).map(move |i| (x + i, y + j)));
        let direct: f64 = own(1, 30).map(|(x, y)| cells.near.at(x, y)).sum::<f64>() / 49.0;
        assert!((blurred.at(1, 30) - direct).abs() < 1e-9);
    }

    #[test]
    fn samples_meet_texels_and_wrap() {
        let field = Field::of([4, 4], |u, v| u + 10.0 * v);
        assert!((field.sample(0.125, 0.125) - field.at(0, 0)).abs() < 1e-12);
        assert!((field.sample(0.0, 0.125) - 0.5 * (field.at(0, 0) + field.at(3, 0))).abs() < 1e-12);
        assert!((field.sample(1.125, -0.875) - field.at(0, 0)).abs() < 1e-12);
    }
}
