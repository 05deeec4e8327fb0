//! Light from infinity: constant, or a latitude-longitude map with Mitsuba 3's conventions (`constant`, `envmap`).
//!
//! A map is read bilinearly: columns repeat with texel centres in the middle of a cell, the first and last row lie on the
//! poles. Directions are drawn from f64 tables over the cells between texels, in proportion to the mean luminance of a
//! cell's corners times its solid angle; within a cell evenly in (u, v).

use crate::texture::LoadBitmap;
use glam::{Mat3, Vec2, Vec3};
use std::f64::consts::PI;
use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    image::luminance,
    maths::{acosf, atan2f, cos, cosf, sinf},
    scene::Emitter,
};

const PI_F: f32 = std::f32::consts::PI;

/// The light from infinity of a scene.
#[derive(Debug)]
pub enum Environment {
    /// The same from everywhere.
    Constant(Vec3),
    /// A map.
    Map(Box<Map>),
}

/// A map, and the tables to draw from it.
#[derive(Debug)]
pub struct Map {
    image: Image,
    scale: f32,
    to_world: Mat3,
    to_local: Mat3,
    /// Sums over cells, by row: `columns` values each, the last 1.
    conditional: Vec<f64>,
    /// Sums over rows, the last 1.
    marginal: Vec<f64>,
    /// Integral of luminance over the sphere.
    total: f64,
}

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
                Ok(Self::Map(Box::new(Map::new(load(image)?, *scale, map)?)))
            }
            other => Err(KindError::Internal(format!("{other:?} is no environment"))),
        }
    }

    /// Radiance from a unit direction.
    #[inline]
    pub fn eval(&self, direction: Vec3) -> Vec3 {
        match self {
            Self::Constant(radiance) => *radiance,
            Self::Map(map) => map.eval(map.uv(direction).0),
        }
    }

    /// Density of [`Environment::sample`] over solid angle.
    #[inline]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        match self {
            Self::Constant(_) => 1.0 / (4.0 * PI_F),
            Self::Map(map) => map.pdf(direction),
        }
    }

    /// Unit direction, radiance and density of a draw; a density of 0 is no sample.
    #[inline]
    pub fn sample(&self, u: Vec2) -> (Vec3, Vec3, f32) {
        match self {
            Self::Constant(radiance) => {
                let z = 1.0 - 2.0 * u.y;
                let r = (1.0 - z * z).max(0.0).sqrt();
                let phi = 2.0 * PI_F * u.x;
                (Vec3::new(r * cosf(phi), z, r * sinf(phi)), *radiance, 1.0 / (4.0 * PI_F))
            }
            Self::Map(map) => map.sample(u),
        }
    }

    /// Power that enters a scene of this radius, as luminance.
    pub fn power(&self, radius: f32) -> f32 {
        let disk = PI * f64::from(radius) * f64::from(radius);
        let integral = match self {
            Self::Constant(radiance) => 4.0 * PI * f64::from(luminance(&radiance.to_array())),
            Self::Map(map) => map.total,
        };
        (disk * integral) as f32
    }
}

impl Map {
    fn new(image: Image, scale: f32, to_world: Mat3) -> Result<Self, KindError> {
        let (width, height, channels) = (image.width(), image.height(), image.channels());
        if width == 0 || height == 0 || channels < 3 {
            return Err(KindError::Input(format!(
                "an environment map of {width} x {height} pixels of {channels} channels; it needs at least one, of three"
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
        let image = if height > 1 {
            image
        } else {
            let twice = [image.data(), image.data()].concat();
            Image::from_data(width, 2, channels, twice)?
        };
        let rows = image.height() - 1;
        let mut map = Self {
            image,
            scale,
            to_world,
            to_local: to_world.transpose(),
            conditional: Vec::with_capacity(rows * width),
            marginal: Vec::with_capacity(rows),
            total: 0.0,
        };
        let light = |x: usize, y: usize| f64::from(luminance(map.image.pixel(x % width, y))) * f64::from(scale);
        let (mut conditional, mut marginal) = (Vec::with_capacity(rows * width), Vec::with_capacity(rows));
        let mut total = 0.0;
        for y in 0..rows {
            // Solid angle of a cell of this row.
            let angle = |i: usize| cos(PI * i as f64 / rows as f64);
            let cell = (angle(y) - angle(y + 1)) * 2.0 * PI / width as f64;
            let start = conditional.len();
            let mut sum = 0.0;
            for x in 0..width {
                sum += 0.25 * (light(x, y) + light(x + 1, y) + light(x, y + 1) + light(x + 1, y + 1)) * cell;
                conditional.push(sum);
            }
            normalise(&mut conditional[start..], sum);
            total += sum;
            marginal.push(total);
        }
        normalise(&mut marginal, total);
        map.conditional = conditional;
        map.marginal = marginal;
        map.total = total;
        Ok(map)
    }

    /// (u, v) of a direction, u shifted so that cells begin at whole columns; and the sine of the polar angle.
    #[inline]
    fn uv(&self, direction: Vec3) -> (Vec2, f32) {
        let d = self.to_local * direction;
        let sin = (d.x * d.x + d.z * d.z).sqrt();
        let u = atan2f(d.x, -d.z) * (0.5 / PI_F) - 0.5 / self.image.width() as f32;
        // Near the poles the arc cosine loses its digits.
        let theta = if d.y.abs() < 0.9 { acosf(d.y) } else { atan2f(sin, d.y) };
        (Vec2::new(u - u.floor(), theta / PI_F), sin)
    }

    /// Cell and place in it of (u, v).
    #[inline]
    fn cell(&self, uv: Vec2) -> (usize, usize, Vec2) {
        let (columns, rows) = (self.image.width(), self.image.height() - 1);
        let (x, y) = (uv.x * columns as f32, uv.y * rows as f32);
        let (i, j) = ((x as usize).min(columns - 1), (y as usize).min(rows - 1));
        (i, j, Vec2::new(x - i as f32, y - j as f32))
    }

    #[inline]
    fn eval(&self, uv: Vec2) -> Vec3 {
        let (i, j, f) = self.cell(uv);
        let next = if i + 1 == self.image.width() { 0 } else { i + 1 };
        let texel = |x: usize, y: usize| {
            let pixel = self.image.pixel(x, y);
            Vec3::new(pixel[0], pixel[1], pixel[2])
        };
        let upper = texel(i, j) * (1.0 - f.x) + texel(next, j) * f.x;
        let lower = texel(i, j + 1) * (1.0 - f.x) + texel(next, j + 1) * f.x;
        (upper * (1.0 - f.y) + lower * f.y) * self.scale
    }

    /// Probability of a cell, times the number of cells: the density over (u, v).
    #[inline]
    fn density(&self, i: usize, j: usize) -> f64 {
        let (columns, rows) = (self.image.width(), self.image.height() - 1);
        let step = |sums: &[f64], at: usize| sums[at] - if at == 0 { 0.0 } else { sums[at - 1] };
        let row = &self.conditional[j * columns..(j + 1) * columns];
        step(&self.marginal, j) * step(row, i) * (rows * columns) as f64
    }

    #[inline]
    fn pdf(&self, direction: Vec3) -> f32 {
        let (uv, sin) = self.uv(direction);
        let (i, j, _) = self.cell(uv);
        solid(self.density(i, j), sin)
    }

    #[inline]
    fn sample(&self, u: Vec2) -> (Vec3, Vec3, f32) {
        if self.total <= 0.0 {
            return (Vec3::Y, Vec3::ZERO, 0.0);
        }
        let columns = self.image.width();
        let (j, fy) = invert(&self.marginal, f64::from(u.y));
        let (i, fx) = invert(&self.conditional[j * columns..(j + 1) * columns], f64::from(u.x));
        let uv = Vec2::new(
            ((i as f64 + fx) / columns as f64) as f32,
            ((j as f64 + fy) / (self.image.height() - 1) as f64) as f32,
        );
        let theta = uv.y * PI_F;
        let phi = (uv.x + 0.5 / columns as f32) * 2.0 * PI_F;
        let sin = sinf(theta);
        let local = Vec3::new(sinf(phi) * sin, cosf(theta), -cosf(phi) * sin);
        (self.to_world * local, self.eval(uv), solid(self.density(i, j), sin))
    }
}

/// Density over solid angle from one over (u, v).
#[inline]
fn solid(density: f64, sin: f32) -> f32 {
    if sin <= 0.0 { 0.0 } else { (density / (2.0 * PI * PI * f64::from(sin))) as f32 }
}

/// Turns sums into a cumulative distribution; without any weight, an even one.
fn normalise(sums: &mut [f64], total: f64) {
    let count = sums.len() as f64;
    for (i, sum) in sums.iter_mut().enumerate() {
        *sum = if total > 0.0 { *sum / total } else { (i + 1) as f64 / count };
    }
    if let Some(last) = sums.last_mut() {
        *last = 1.0;
    }
}

/// The step of a cumulative distribution that `u` falls in, and how far in.
#[inline]
fn invert(sums: &[f64], u: f64) -> (usize, f64) {
    let at = sums.partition_point(|s| *s <= u).min(sums.len() - 1);
    let before = if at == 0 { 0.0 } else { sums[at - 1] };
    let width = sums[at] - before;
    (at, if width > 0.0 { ((u - before) / width).clamp(0.0, 1.0) } else { 0.5 })
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
        Environment::Map(Box::new(Map::new(image, 1.5, turned).expect("a sound map")))
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
            if environment.power(1.0) == 0.0 {
                assert_eq!(environment.sample(Vec2::splat(0.3)).2, 0.0);
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
                    integral += f64::from(environment.pdf(d)) * cell;
                    radiance += f64::from(environment.eval(d).y) * cell;
                }
            }
            assert!((integral - 1.0).abs() < 0.01, "{number}: {integral}");
            let mut stream = Stream::new(3, &[number as u64]);
            let count = 200_000;
            let (mut sum, mut squares) = (0.0, 0.0);
            for _ in 0..count {
                let (d, value, pdf) = environment.sample(Vec2::new(stream.uniform() as f32, stream.uniform() as f32));
                assert!((d.length() - 1.0).abs() < 1e-5);
                let again = environment.pdf(d);
                assert!(pdf > 0.0 && (again - pdf).abs() < 0.02 * pdf || environment.power(1.0) > 1e3, "{pdf} {again}");
                let estimate = f64::from(value.y) / f64::from(pdf);
                sum += estimate;
                squares += estimate * estimate;
            }
            let mean = sum / f64::from(count);
            let error = ((squares / f64::from(count) - mean * mean) / f64::from(count)).sqrt();
            assert!((mean - radiance).abs() < 5.0 * error + 0.012 * radiance, "{number}: {mean} {radiance} {error}");
        }
    }

    #[test]
    fn bad_maps_are_refused() {
        let image = Image::from_data(1, 1, 3, vec![-1.0, 0.0, 0.0]).expect("fits");
        assert!(Map::new(image, 1.0, Mat3::IDENTITY).is_err());
        let image = Image::from_data(1, 1, 3, vec![1.0; 3]).expect("fits");
        assert!(Map::new(image.clone(), 1.0, Mat3::from_diagonal(Vec3::new(2.0, 1.0, 1.0))).is_err());
        assert!(Map::new(image, f32::NAN, Mat3::IDENTITY).is_err());
    }
}
