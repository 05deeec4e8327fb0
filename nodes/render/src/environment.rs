//! Light from infinity: constant, or a latitude-longitude map with Mitsuba 3's conventions (`constant`, `envmap`).
//!
//! A map is read bilinearly. Columns repeat with texel centres in the middle of a cell, and the first and last row lie
//! on the poles. Directions are drawn over the cells between texels, in proportion to the mean luminance of a cell's
//! corners times its solid angle. Sampling uses alias tables over rows and columns (Walker 1977, Vose 1991), computed
//! in f64. Within a cell they are drawn in proportion to the luminance between the texels.
//!
//! Only luminance above the mean counts. The rest is found by scattering as well, and multiple importance sampling adds
//! up the two (Karlik et al. 2019, *MIS Compensation*). A vertex that samples the map must therefore also be able to
//! scatter.

use crate::{
    alias::Alias,
    lanes::{Integer, Pair, Real, Record, Triple, atan2, sin_cos_turn},
    texture::LoadBitmap,
};
use glam::{Mat3, Vec2, Vec3};
use std::f64::consts::PI;
use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    image::{LUMINANCE, luminance},
    maths::cos,
    scene::Emitter,
};

const PI_F: f32 = std::f32::consts::PI;

/// The light from infinity of a scene.
#[derive(Debug)]
pub enum Environment {
    /// The same from everywhere.
    Constant(Vec3),
    /// A map.
    Map(Box<EnvironmentMap>),
}

/// A map, and the tables to draw from it.
#[derive(Debug)]
pub struct EnvironmentMap {
    width: usize,
    height: usize,
    /// Of each texel and the next in its row, radiance and luminance above the floor: a half record.
    pairs: Vec<Record>,
    scale: f32,
    to_world: Mat3,
    to_local: Mat3,
    /// Columns, row after row.
    columns: Alias,
    rows: Alias,
    /// By row, density over solid angle times the sine of the polar angle, over luminance.
    density: Vec<f32>,
    /// Integral of luminance over the sphere.
    total: f64,
}

/// Numbers that a draw takes.
pub(crate) type Numbers<R> = [Pair<R>; 3];

impl Environment {
    /// Compiles an emitter of type `constant` or `envmap`.
    ///
    /// # Errors
    /// If the image is missing or empty, its values are negative or not finite, or it is turned by no rotation.
    pub fn compile(emitter: &Emitter, load: LoadBitmap<'_>) -> Result<Self, KindError> {
        match emitter {
            Emitter::Constant { radiance } => {
                if radiance.iter().all(|v| v.is_finite() && *v >= 0.0) {
                    Ok(Self::Constant(Vec3::from_array(*radiance)))
                } else {
                    Err(KindError::Input(format!("a constant environment of {radiance:?}; use finite numbers from 0")))
                }
            }
            Emitter::Envmap { image, scale, to_world } => {
                let linear: Vec<Vec3> =
                    (0..3).map(|c| Vec3::from_array([0, 1, 2].map(|r: usize| to_world[r][c] as f32))).collect();
                let map = Mat3::from_cols(linear[0], linear[1], linear[2]);
                let image = load(image)?.image()?;
                Ok(Self::Map(Box::new(EnvironmentMap::new(&image, *scale, map)?)))
            }
            other => Err(KindError::Internal(format!("{other:?} is no environment"))),
        }
    }

    /// Radiance from a unit direction, and the density of [`Environment::sample`] over solid angle.
    pub fn look(&self, direction: Vec3) -> (Vec3, f32) {
        let (radiance, pdf) = self.look_lanes::<f32>(direction.into());
        (radiance.into(), pdf)
    }

    /// Unit direction, radiance and density of a draw; a density of 0 is no sample.
    pub fn sample(&self, numbers: [Vec2; 3]) -> (Vec3, Vec3, f32) {
        let (direction, radiance, pdf) = self.sample_lanes::<f32>(numbers.map(Into::into));
        (direction.into(), radiance.into(), pdf)
    }

    /// [`Environment::look`] by lane.
    #[inline(always)]
    pub(crate) fn look_lanes<R: Real>(&self, direction: Triple<R>) -> (Triple<R>, R) {
        match self {
            Self::Constant(radiance) => (Triple::splat(*radiance), R::splat(1.0 / (4.0 * PI_F))),
            Self::Map(map) => map.look(direction),
        }
    }

    /// [`Environment::sample`] by lane.
    #[inline(always)]
    pub(crate) fn sample_lanes<R: Real>(&self, numbers: Numbers<R>) -> (Triple<R>, Triple<R>, R) {
        match self {
            Self::Constant(radiance) => {
                let u = numbers[2];
                let z = R::one() - u.y * 2.0;
                let r = (R::one() - z * z).max(R::zero()).sqrt();
                let (sin, cos) = sin_cos_turn(u.x);
                (Triple::new(r * cos, z, r * sin), Triple::splat(*radiance), R::splat(1.0 / (4.0 * PI_F)))
            }
            Self::Map(map) => map.sample(numbers),
        }
    }

    /// Integral of luminance over the sphere.
    pub fn total(&self) -> f64 {
        match self {
            Self::Constant(radiance) => 4.0 * PI * f64::from(luminance(&radiance.to_array())),
            Self::Map(map) => map.total,
        }
    }
}

impl EnvironmentMap {
    fn new(image: &Image, scale: f32, to_world: Mat3) -> Result<Self, KindError> {
        let (width, height, channels) = (image.width(), image.height(), image.channels());
        if width == 0 || height == 0 || channels < 3 {
            return Err(KindError::Input(format!(
                "an environment map of {width} x {height} pixels of {channels} channels; \
                 it needs at least one, of three"
            )));
        }
        if image.data().iter().any(|v| !(v.is_finite() && *v >= 0.0)) || !(scale.is_finite() && scale >= 0.0) {
            return Err(KindError::Input(
                "an environment map or its scale with values that are negative or not finite; load it by `assets`, \
                 which mends and counts them"
                    .into(),
            ));
        }
        let off = (to_world.transpose() * to_world - Mat3::IDENTITY).to_cols_array();
        if off.iter().any(|v| v.is_nan() || v.abs() > 1e-4) {
            return Err(KindError::Input(
                "an environment map whose `to_world` is no rotation; take the scale out".into(),
            ));
        }
        // A map of one row is the same from pole to pole.
        let twice;
        let image = if height > 1 {
            image
        } else {
            twice = Image::from_data(width, 2, channels, [image.data(), image.data()].concat())?;
            &twice
        };
        let rows = image.height() - 1;
        // Solid angle of a cell of each row.
        let angle = |i: usize| cos(PI * i as f64 / rows as f64);
        let solid: Vec<f64> = (0..rows).map(|y| (angle(y) - angle(y + 1)) * 2.0 * PI / width as f64).collect();
        let weights = |floor: f64| -> Vec<f64> {
            let light = |x: usize, y: usize| (f64::from(luminance(image.pixel(x % width, y))) - floor).max(0.0);
            let cells = (0..rows).flat_map(|y| (0..width).map(move |x| (x, y)));
            cells
                .map(|(x, y)| 0.25 * (light(x, y) + light(x + 1, y) + light(x, y + 1) + light(x + 1, y + 1)) * solid[y])
                .collect()
        };
        let whole = weights(0.0);
        let integral: f64 = whole.iter().sum();
        // Texels that are not brighter than the mean are left to BSDF sampling, unless all are.
        let floor = f64::from((integral / (4.0 * PI)) as f32);
        let above = weights(floor);
        let (floor, weights) = if above.iter().sum::<f64>() > 1e-3 * integral { (floor, above) } else { (0.0, whole) };
        let by_row: Vec<f64> = weights.chunks(width).map(|row| row.iter().sum()).collect();
        let sum: f64 = by_row.iter().sum();
        // Cells have one over their number of (u, v), which has sin / (2 pi^2) of solid angle.
        let density = |cell: &f64| cell * (rows * width) as f64 / (sum * 2.0 * PI * PI);
        let density = solid.iter().map(|cell| if sum > 0.0 { density(cell) as f32 } else { 0.0 }).collect();
        let total = integral * f64::from(scale);
        let mut columns = Alias::default();
        for row in weights.chunks(width) {
            columns.extend(row);
        }
        let mut of_rows = Alias::default();
        of_rows.extend(&by_row);
        let to_local = to_world.transpose();
        let (height, floor) = (image.height(), floor as f32);
        let pairs = pairs(image, floor);
        Ok(Self { width, height, pairs, scale, to_world, to_local, columns, rows: of_rows, density, total })
    }

    #[inline(always)]
    fn turned<R: Real>(map: &Mat3, d: Triple<R>) -> Triple<R> {
        let (x, y, z) = (map.row(0), map.row(1), map.row(2));
        Triple::new(d.dot(Triple::splat(x)), d.dot(Triple::splat(y)), d.dot(Triple::splat(z)))
    }

    #[inline(always)]
    fn look<R: Real>(&self, direction: Triple<R>) -> (Triple<R>, R) {
        let d = Self::turned(&self.to_local, direction);
        let sin = (d.x * d.x + d.z * d.z).sqrt();
        // Shifted so that cells begin at whole columns. The arc tangent keeps its digits near the poles.
        let u = atan2(d.x, -d.z) * (0.5 / PI_F) - 0.5 / self.width as f32;
        let v = atan2(sin, d.y) * (1.0 / PI_F);
        let (columns, rows) = (self.width, self.height - 1);
        let (x, y) = ((u - u.floor()) * columns as f32, v * rows as f32);
        let (i, j) = (x.clamp(0.0, (columns - 1) as f32).floor(), y.clamp(0.0, (rows - 1) as f32).floor());
        let (corners, [a, b, c, d]) = self.corners(i.to_integer(), j.to_integer());
        let (fx, fy) = (x - i, y - j);
        let upper = a * (R::one() - fx) + b * fx;
        let lower = c * (R::one() - fx) + d * fx;
        let light = upper * (R::one() - fy) + lower * fy;
        (between(&corners, fx, fy) * R::splat(self.scale), self.pdf(j.to_integer(), light, sin))
    }

    /// Density over solid angle in a row of cells, where the luminance above the floor is `light`.
    #[inline(always)]
    fn pdf<R: Real>(&self, row: R::Integer, light: R, sin: R) -> R {
        (R::gather(&self.density, row) * light / sin).only(sin.positive())
    }

    /// Texels about a cell: upper left and right, lower left and right; and the luminance above the floor of each.
    #[inline(always)]
    fn corners<R: Real>(&self, i: R::Integer, j: R::Integer) -> ([Triple<R>; 4], [R; 4]) {
        let at = j * R::Integer::splat(self.width as i32) + i;
        let [ar, ag, ab, a, br, bg, bb, b] = R::columns(&self.pairs, at);
        let [cr, cg, cb, c, dr, dg, db, d] = R::columns(&self.pairs, at + R::Integer::splat(self.width as i32));
        let corners =
            [Triple::new(ar, ag, ab), Triple::new(br, bg, bb), Triple::new(cr, cg, cb), Triple::new(dr, dg, db)];
        (corners, [a, b, c, d])
    }

    #[inline(always)]
    fn sample<R: Real>(&self, [pick, accept, within]: Numbers<R>) -> (Triple<R>, Triple<R>, R) {
        let (columns, rows) = (self.width, self.height - 1);
        let none = R::Integer::splat(0);
        let j = self.rows.draw(none, rows, pick.x, accept.x);
        let start = j * R::Integer::splat(columns as i32);
        let i = self.columns.draw(start, columns, pick.y, accept.y);
        let (corners, [a, b, c, d]) = self.corners::<R>(i, j);
        // Down by the sums of the rows, across by the luminance at that height.
        let y = ramp(a + b, c + d, within.y);
        let (left, right) = (a * (R::one() - y) + c * y, b * (R::one() - y) + d * y);
        let x = ramp(left, right, within.x);
        let light = left * (R::one() - x) + right * x;
        let radiance = between(&corners, x, y);
        let u = (R::of_integer(i) + x) * (1.0 / columns as f32);
        let v = (R::of_integer(j) + y) * (1.0 / rows as f32);
        let (sin_phi, cos_phi) = sin_cos_turn(u + 0.5 / columns as f32);
        let (sin, cos) = sin_cos_turn(v * 0.5);
        let local = Triple::new(sin_phi * sin, cos, -cos_phi * sin);
        (Self::turned(&self.to_world, local), radiance * R::splat(self.scale), self.pdf(j, light, sin))
    }
}

/// Of each texel and the next in its row, radiance and luminance above a floor.
fn pairs(image: &Image, floor: f32) -> Vec<Record> {
    let (width, height) = (image.width(), image.height());
    let [red, green, blue] = LUMINANCE;
    let mut records = vec![Record::default(); (width * height).div_ceil(2)];
    for at in 0..width * height {
        let (x, y) = (at % width, at / width);
        for (k, x) in [x, (x + 1) % width].into_iter().enumerate() {
            let [r, g, b] = [0, 1, 2].map(|c| image.pixel(x, y)[c]);
            let above = (r * red + g * green + b * blue - floor).max(0.0);
            records[at / 2].0[8 * (at % 2) + 4 * k..][..4].copy_from_slice(&[r, g, b, above]);
        }
    }
    records
}

/// Between the corners of a cell.
#[inline(always)]
fn between<R: Real>([a, b, c, d]: &[Triple<R>; 4], x: R, y: R) -> Triple<R> {
    let upper = *a * (R::one() - x) + *b * x;
    let lower = *c * (R::one() - x) + *d * x;
    upper * (R::one() - y) + lower * y
}

/// Draws from [0, 1) in proportion to what rises or falls from `from` to `to`.
#[inline(always)]
fn ramp<R: Real>(from: R, to: R, u: R) -> R {
    // The inverse of (from x + (to - from) x^2 / 2) over its end, in the form that does not cancel.
    let root = (from * from * (R::one() - u) + to * to * u).max(R::zero()).sqrt();
    let sum = from + root;
    let x = u * (from + to) / sum;
    R::select(sum.positive(), x, u).clamp(0.0, 1.0 - f32::EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    fn map(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Environment {
        let data =
            (0..height).flat_map(|y| (0..width).flat_map(move |x| [(x, y); 3])).map(|(x, y)| value(x, y)).collect();
        let image = Image::from_data(width, height, 3, data).expect("fits");
        let turned = Mat3::from_rotation_y(0.7) * Mat3::from_rotation_x(0.4);
        Environment::Map(Box::new(EnvironmentMap::new(&image, 1.5, turned).expect("a sound map")))
    }

    fn all() -> Vec<Environment> {
        vec![
            Environment::Constant(Vec3::new(0.5, 1.0, 2.0)),
            map(1, 1, |_, _| 1.0),
            map(7, 5, |x, y| (x * y) as f32),
            map(16, 9, |x, y| if (x, y) == (15, 4) { 1e5 } else { 0.1 }),
            map(8, 8, |_, y| if y == 0 { 50.0 } else { 0.0 }),
            map(3, 4, |_, _| 0.0),
        ]
    }

    #[test]
    fn densities_integrate_to_one_and_draws_agree_with_them() {
        for (number, environment) in all().iter().enumerate() {
            if environment.total() == 0.0 {
                assert_eq!(environment.sample([Vec2::splat(0.3); 3]).2, 0.0);
                continue;
            }
            let (mut integral, mut radiance) = (0.0, 0.0);
            let (rows, columns) = (720, 1440);
            for y in 0..rows {
                let theta = PI * (f64::from(y) + 0.5) / f64::from(rows);
                let cell = libm::sin(theta) * (PI / f64::from(rows)) * (2.0 * PI / f64::from(columns));
                for x in 0..columns {
                    let phi = 2.0 * PI * (f64::from(x) + 0.5) / f64::from(columns);
                    let (s, c) = (libm::sin(theta), libm::cos(theta));
                    let d = Vec3::new((s * libm::cos(phi)) as f32, c as f32, (s * libm::sin(phi)) as f32);
                    let (value, pdf) = environment.look(d);
                    integral += f64::from(pdf) * cell;
                    // Texels that are not sampled are left to BSDF sampling.
                    radiance += if pdf > 0.0 { f64::from(value.y) * cell } else { 0.0 };
                }
            }
            assert!((integral - 1.0).abs() < 0.01, "{number}: {integral}");
            let mut stream = Stream::new(3, &[number as u64]);
            let count = 200_000;
            let (mut sum, mut squares) = (0.0, 0.0);
            for _ in 0..count {
                let mut two = || Vec2::new(stream.range(0.0, 0.999_999) as f32, stream.range(0.0, 0.999_999) as f32);
                let (d, value, pdf) = environment.sample([two(), two(), two()]);
                assert!((d.length() - 1.0).abs() < 1e-5);
                let again = environment.look(d).1;
                assert!(pdf > 0.0 && (again - pdf).abs() < 0.02 * pdf || environment.total() > 3e3, "{pdf} {again}");
                let estimate = f64::from(value.y) / f64::from(pdf);
                sum += estimate;
                squares += estimate * estimate;
            }
            let mean = sum / f64::from(count);
            let error = ((squares / f64::from(count) - mean * mean) / f64::from(count)).sqrt();
            assert!((mean - radiance).abs() < 5.0 * error + 0.012 * radiance, "{number}: {mean} {radiance} {error}");
        }
    }

    /// Draws by cell, against the density integrated over each: suns at the seam, in a corner cell and at the poles.
    #[test]
    fn draws_fall_into_cells_as_the_density_says() {
        const FINE: usize = 24;
        let suns = [
            ("seam", [16, 9], [(15, 4), (15, 4)]),
            ("pole", [16, 9], [(3, 0), (3, 0)]),
            ("other pole and corner", [12, 7], [(0, 6), (11, 1)]),
            ("two", [9, 5], [(4, 2), (8, 3)]),
        ];
        for (name, [width, height], bright) in suns {
            let of = |x: usize, y: usize| if bright.contains(&(x, y)) { 1e5 } else { 0.1 + (x + y) as f32 };
            let environment = map(width, height, of);
            let Environment::Map(own) = &environment else { panic!("a map") };
            let rows = height - 1;
            // Where a direction is in the map, in cells; texel centres are in the middle of columns.
            let place = |d: Vec3| -> usize {
                let local: Vec3 = EnvironmentMap::turned(&own.to_local, Triple::<f32>::from(d)).into();
                let u = libm::atan2(f64::from(local.x), f64::from(-local.z)) / (2.0 * PI) - 0.5 / width as f64;
                let v = libm::acos(f64::from(local.y).clamp(-1.0, 1.0)) / PI;
                let x = ((u - libm::floor(u)) * width as f64) as usize;
                ((v * rows as f64) as usize).min(rows - 1) * width + x.min(width - 1)
            };
            let mut expected = vec![0.0; rows * width];
            for y in 0..rows * FINE {
                let theta = PI * (y as f64 + 0.5) / (rows * FINE) as f64;
                let solid = libm::sin(theta) * PI / (rows * FINE) as f64 * 2.0 * PI / (width * FINE) as f64;
                for x in 0..width * FINE {
                    let phi = 2.0 * PI * ((x as f64 + 0.5) / (width * FINE) as f64 + 0.5 / width as f64);
                    let sin = libm::sin(theta);
                    let local = Vec3::new(
                        (sin * libm::sin(phi)) as f32,
                        libm::cos(theta) as f32,
                        (-sin * libm::cos(phi)) as f32,
                    );
                    let d: Vec3 = EnvironmentMap::turned(&own.to_world, Triple::<f32>::from(local)).into();
                    expected[y / FINE * width + x / FINE] += f64::from(environment.look(d).1) * solid;
                }
            }
            let count = 200_000;
            let mut stream = Stream::new(6, &[]).part(name);
            let mut found = vec![0.0; rows * width];
            for _ in 0..count {
                let mut two = || Vec2::new(stream.uniform() as f32, stream.uniform() as f32);
                let (d, _, pdf) = environment.sample([two(), two(), two()]);
                assert!(pdf > 0.0 && pdf.is_finite(), "{name}");
                found[place(d)] += 1.0;
            }
            let expected: Vec<f64> = expected.iter().map(|e| e * f64::from(count)).collect();
            let deviation = crate::chi_square::deviation(&found, &expected, 3e-3);
            println!("{name}: {deviation:+.2} deviations");
            assert!(deviation < crate::chi_square::ALLOWED, "{name}: {deviation}");
        }
    }

    #[test]
    fn bad_maps_are_refused() {
        let image = Image::from_data(1, 1, 3, vec![-1.0, 0.0, 0.0]).expect("fits");
        assert!(EnvironmentMap::new(&image, 1.0, Mat3::IDENTITY).is_err());
        let image = Image::from_data(1, 1, 3, vec![1.0; 3]).expect("fits");
        assert!(EnvironmentMap::new(&image, 1.0, Mat3::from_diagonal(Vec3::new(2.0, 1.0, 1.0))).is_err());
        assert!(EnvironmentMap::new(&image, f32::NAN, Mat3::IDENTITY).is_err());
    }
}
