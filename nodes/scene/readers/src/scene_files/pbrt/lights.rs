//! pbrt's lights, those of shapes included.

use super::{Directive, PbrtReader};
use crate::scene_files::spectra;
use core::f64::consts::PI;
use tauflow_data::geom::{apply, cross, dot, sub, unit};
use tauflow_data::{
    Image, maths,
    scene::{Affine, Emitter, Texture},
};

impl<'t> PbrtReader<'t, '_, '_> {
    /// The product of a light's spectrum and `scale`, exposed by the film.
    fn spectrum(&mut self, directive: &'t Directive, name: &str) -> [f64; 3] {
        let color = match self.find(directive, name) {
            Some(param) => self.color(param, true).unwrap_or([0.0; 3]),
            None => [1.0; 3],
        };
        let scale = self.number(directive, "scale").unwrap_or(1.0) * self.exposure[0] * self.exposure[1];
        color.map(|v| v * scale)
    }

    /// The factor that gives a light the power or illuminance of a parameter; `of_one` is that at radiance 1.
    fn strength(&mut self, directive: &'t Directive, name: &str, of_one: f64) -> f64 {
        match self.number(directive, name) {
            Some(value) if value > 0.0 && of_one > 0.0 => value / of_one,
            _ => 1.0,
        }
    }

    /// The radiance of a shape that follows an `AreaLightSource`.
    pub(super) fn area(&mut self, directive: &'t Directive, shape: &'t Directive) -> Option<Texture> {
        if self.name(directive) != "diffuse" {
            self.unsupported(directive, "use `diffuse`");
            return None;
        }
        let mut radiance = self.spectrum(directive, "L");
        if let Some(param) = self.find(directive, "power") {
            match self.own_area(shape) {
                Some(area) => {
                    let strength = self.strength(directive, "power", area * PI);
                    radiance = radiance.map(|v| v * strength);
                }
                None => {
                    let what = "`power` of a shape whose area is not known is not supported";
                    self.build.problems.error(&param.at, what, "use a whole sphere, disk or cylinder, or `scale`");
                }
            }
        }
        if self.flag(directive, "twosided", false) {
            let what = "a light on both sides of a shape is not supported";
            self.build.problems.error(&directive.at, what, "put a second shape with `ReverseOrientation` behind it");
        }
        self.finish(directive);
        Some(Texture::rgb(self.build.light(radiance, "L", &directive.at)))
    }

    pub(super) fn light(&mut self, directive: &'t Directive) {
        let ctm = self.state.ctm;
        let made = match self.name(directive) {
            "infinite" => self.infinite(directive),
            "point" => {
                let from = self.point(directive, "from").unwrap_or([0.0; 3]);
                let strength = self.strength(directive, "power", 4.0 * PI);
                let intensity = self.spectrum(directive, "I").map(|v| v * strength);
                let intensity = self.build.light(intensity, "I", &directive.at);
                Some(Emitter::Point { position: apply(&ctm, from), intensity })
            }
            "distant" => {
                let from = self.point(directive, "from").unwrap_or([0.0; 3]);
                let to = self.point(directive, "to").unwrap_or([0.0, 0.0, 1.0]);
                let direction = unit(sub(apply(&ctm, to), apply(&ctm, from)));
                let strength = self.strength(directive, "illuminance", 1.0);
                let irradiance = self.spectrum(directive, "L").map(|v| v * strength);
                Some(Emitter::Directional { direction, irradiance: self.build.light(irradiance, "L", &directive.at) })
            }
            "spot" => self.spot(directive),
            _ => return self.unsupported(directive, "use `infinite`, `point`, `spot`, `distant` or an area light"),
        };
        self.finish(directive);
        if let Some(emitter) = made {
            self.build.emitter(emitter, &directive.at);
        }
    }

    /// The area of a whole sphere, disk or cylinder as pbrt counts it: before its transform.
    fn own_area(&mut self, shape: &'t Directive) -> Option<f64> {
        let parts = ["zmin", "zmax", "phimax", "innerradius", "height"];
        let sort = self.name(shape);
        let whole = parts.iter().all(|name| self.find(shape, name).is_none());
        let radius = self.number(shape, "radius").unwrap_or(1.0);
        match sort {
            "sphere" if whole => Some(4.0 * PI * radius * radius),
            "disk" if whole => Some(PI * radius * radius),
            "cylinder" if self.find(shape, "phimax").is_none() => {
                let mut end = |name: &str, default: f64| self.number(shape, name).unwrap_or(default);
                let height = end("zmax", 1.0) - end("zmin", -1.0);
                Some(2.0 * PI * radius * height)
            }
            _ => None,
        }
    }

    fn spot(&mut self, directive: &'t Directive) -> Option<Emitter> {
        let from = self.point(directive, "from").unwrap_or([0.0; 3]);
        let to = self.point(directive, "to").unwrap_or([0.0, 0.0, 1.0]);
        let cutoff_angle = self.number(directive, "coneangle").unwrap_or(30.0);
        let delta = self.number(directive, "conedeltaangle").unwrap_or(5.0);
        let [end, begin] = [cutoff_angle, cutoff_angle - delta].map(|angle| maths::cos(angle.to_radians()));
        let strength = self.strength(directive, "power", 2.0 * PI * ((1.0 - begin) + (begin - end) / 2.0));
        let intensity = self.spectrum(directive, "I").map(|v| v * strength);
        if delta != 0.0 {
            let [most, power] = edge_error(cutoff_angle, cutoff_angle - delta);
            let what = format!(
                "a spot's smooth edge: here it falls linearly with the angle, which differs by up to {:.0}% of the \
                 peak within the edge, and by {:+.1}% in all light",
                100.0 * most,
                100.0 * power
            );
            self.build.problems.approximated(&directive.at, what, "set `conedeltaangle` to 0");
        }
        let (from, to) = (apply(&self.state.ctm, from), apply(&self.state.ctm, to));
        let forward = unit(sub(to, from));
        let side = unit(cross(if forward[0].abs() > 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] }, forward));
        let up = cross(forward, side);
        Some(Emitter::Spot {
            to_world: [0, 1, 2].map(|r: usize| [side[r], up[r], forward[r], from[r]]),
            intensity: self.build.light(intensity, "I", &directive.at),
            cutoff_angle,
            beam_width: (cutoff_angle - delta).max(0.0),
        })
    }

    fn infinite(&mut self, directive: &'t Directive) -> Option<Emitter> {
        let color = self.spectrum(directive, "L");
        let Some(path) = self.text(directive, "filename") else {
            let strength = self.strength(directive, "illuminance", PI);
            let color = color.map(|v| v * strength);
            return Some(Emitter::Constant { radiance: self.build.light(color, "L", &directive.at) });
        };
        let at = &directive.at;
        if self.build.emitters.iter().any(|e| matches!(e, Emitter::Constant { .. } | Emitter::Envmap { .. })) {
            self.build.problems.error(at, "a second environment", "keep one of them");
            return None;
        }
        let image = self.build.image(path, false, at)?;
        if image.width() != image.height() {
            let what = format!("`{path}` is not square");
            self.build.problems.error(at, what, "make an equal-area map of it (`imgtool makeequiarea`)");
            return None;
        }
        let ctm = self.state.ctm;
        let column = |c: usize| unit([0, 1, 2].map(|r: usize| ctm[r][c]));
        let axes = [column(0), column(1), column(2)];
        if [(0, 1), (1, 2), (2, 0)].iter().any(|(a, b): &(usize, usize)| dot(axes[*a], axes[*b]).abs() > 1e-4) {
            self.build.problems.error(at, "a map in a sheared space", "rotate it alone");
            return None;
        }
        // A direction that is looked up costs what a texel does that is read.
        let (directions, bytes) = (SAMPLES * SAMPLES * 2 * image.data().len() / 3, 2 * size_of_val(image.data()));
        if !self.build.looks_up(directions, at) || !self.build.affords(bytes, at) {
            return None;
        }
        let strength = self.strength(directive, "illuminance", illuminance(&image));
        let spread = latitudes(&image, color.map(|v| v * strength));
        let what = format!(
            "an equal-area map, whose texels are spread anew, which changes all light by {:+.2}%",
            100.0 * (mean_light(&spread) / mean_light_of_square(&image, color, strength) - 1.0)
        );
        self.build.problems.approximated(at, what, "use a constant light");
        let digest = self.build.blobs.add(spread.to_bytes());
        let to_world: Affine = [0, 1, 2].map(|r: usize| [axes[0][r], axes[1][r], axes[2][r], 0.0]);
        Some(Emitter::Envmap { image: digest, scale: 1.0, to_world })
    }
}

/// How a spot whose edge falls linearly with the angle differs from pbrt's, which falls smoothly with the cosine: at
/// most at an angle, of the peak, and in all light, of pbrt's. Angles are in degrees.
fn edge_error(end: f64, begin: f64) -> [f64; 2] {
    const STEPS: u32 = 1000;
    let [cos_end, cos_begin] = [end, begin].map(|angle| maths::cos(angle.to_radians()));
    let (mut most, mut theirs, mut ours) = (0.0f64, 0.0, 0.0);
    for step in 0..STEPS {
        let angle = end * (f64::from(step) + 0.5) / f64::from(STEPS);
        let (cos, sin) = (maths::cos(angle.to_radians()), maths::sin(angle.to_radians()));
        let t = ((cos - cos_end) / (cos_begin - cos_end)).clamp(0.0, 1.0);
        let smooth = t * t * (3.0 - 2.0 * t);
        let linear = ((end - angle) / (end - begin)).clamp(0.0, 1.0);
        most = most.max((smooth - linear).abs());
        theirs += smooth * sin;
        ours += linear * sin;
    }
    [most, if theirs > 0.0 { ours / theirs - 1.0 } else { 0.0 }]
}

/// Where a direction lies in an equal-area map: Clarberg, *Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD*.
fn square([x, y, z]: [f64; 3]) -> [f64; 2] {
    let (a, b) = (x.abs().max(y.abs()), x.abs().min(y.abs()));
    let turn = maths::atan(if a > 0.0 { b / a } else { 0.0 }) * 2.0 / core::f64::consts::PI;
    let turn = if x.abs() < y.abs() { 1.0 - turn } else { turn };
    let r = (1.0 - z.abs()).max(0.0).sqrt();
    let (mut v, mut u) = (turn * r, r - turn * r);
    if z < 0.0 {
        (u, v) = (1.0 - v, 1.0 - u);
    }
    [(u.copysign(x) + 1.0) * 0.5, (v.copysign(y) + 1.0) * 0.5]
}

/// The cosine of the direction of a place in an equal-area map to +z; see [`square`].
fn height([u, v]: [f64; 2]) -> f64 {
    let side = 1.0 - ((2.0 * u - 1.0).abs() + (2.0 * v - 1.0).abs());
    let r = 1.0 - side.abs();
    (1.0 - r * r).copysign(side)
}

/// The illuminance of an equal-area map on what faces +z, by pbrt's own sum, which has half the solid angle.
fn illuminance(map: &Image) -> f64 {
    let (width, height_of) = (map.width(), map.height());
    let mut sum = 0.0;
    for y in 0..height_of {
        for x in 0..width {
            let at = [(x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height_of as f64];
            let texel = map.pixel(x, y);
            let luminance = spectra::luminance([0, 1, 2].map(|c: usize| f64::from(texel[c])));
            sum += luminance * height(at).max(0.0);
        }
    }
    sum * 2.0 * PI / (width * height_of) as f64
}

/// The mean over all directions of an equal-area map in this colour, channels summed.
fn mean_light_of_square(map: &Image, color: [f64; 3], strength: f64) -> f64 {
    let sum = |c: usize| map.data().iter().skip(c).step_by(3).map(|v| f64::from(*v)).sum::<f64>();
    let light: f64 = (0..3).map(|c: usize| sum(c) * color[c] * strength).sum();
    light / (map.width() * map.height()).max(1) as f64
}

/// The mean over all directions of a map by longitude and latitude, channels summed.
fn mean_light(map: &Image) -> f64 {
    let rows = map.height();
    let weight = |y: usize| maths::sin((y as f64 + 0.5) / rows as f64 * PI);
    let row =
        |y: usize| (0..map.width()).map(|x| map.pixel(x, y).iter().map(|v| f64::from(*v)).sum::<f64>()).sum::<f64>();
    let light: f64 = (0..rows).map(|y| weight(y) * row(y)).sum();
    light / ((0..rows).map(weight).sum::<f64>() * map.width() as f64)
}

/// Samples along each side of a texel.
const SAMPLES: usize = 4;

/// An equal-area map by longitude and latitude, as an environment map holds it; each texel is a mean of 16 directions.
fn latitudes(map: &Image, color: [f64; 3]) -> Image {
    let side = map.height();
    let (width, height) = (2 * side, side);
    let mut out = Image::new(width, height, 3);
    // The sine and cosine of each angle that is sampled.
    let angles = |count: usize, whole: f64| -> Vec<[f64; 2]> {
        let at = |i: usize| (i as f64 + 0.5) / SAMPLES as f64;
        let angle = |n: usize| ((n / SAMPLES) as f64 + at(n % SAMPLES)) / count as f64 * whole;
        (0..count * SAMPLES).map(angle).map(|angle| [maths::sin(angle), maths::cos(angle)]).collect()
    };
    let (longitudes, polars) = (angles(width, 2.0 * PI), angles(height, PI));
    for y in 0..height {
        for x in 0..width {
            let mut sum = [0.0f64; 3];
            for sample in 0..SAMPLES * SAMPLES {
                let [sin, cos] = longitudes[x * SAMPLES + sample % SAMPLES];
                let [ring, up] = polars[y * SAMPLES + sample / SAMPLES];
                // u = atan2(d.x, -d.z) / 2 pi, v = acos(d.y) / pi.
                let d = [ring * sin, up, -ring * cos];
                let texel = square(d).map(|t| ((t * side as f64) as usize).min(side - 1));
                let value = map.pixel(texel[0], texel[1]);
                sum.iter_mut().zip(value).for_each(|(s, v)| *s += f64::from(*v));
            }
            let mean = |c: usize| (sum[c] * color[c] / (SAMPLES * SAMPLES) as f64) as f32;
            out.pixel_mut(x, y).copy_from_slice(&[mean(0), mean(1), mean(2)]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_areas_are_equal_and_keep_their_light() {
        assert_eq!(square([0.0, 0.0, 1.0]), [0.5, 0.5]);
        let near = |d: [f64; 3], at: [f64; 2]| {
            let found = square(d);
            assert!(found.iter().zip(at).all(|(a, b)| (a - b).abs() < 1e-9), "{d:?}: {found:?}");
        };
        near([1.0, 0.0, 0.0], [1.0, 0.5]);
        near([0.0, -1.0, 0.0], [0.5, 0.0]);
        let turn = maths::atan(0.75) * 2.0 / core::f64::consts::PI;
        near([-0.6, -0.8, 0.0], [0.5 - 0.5 * turn, 0.5 * turn]);
        // The middle of the lower half is at the corners.
        near([0.0, 0.0, -1.0], [1.0, 1.0]);
        for d in [[0.6, 0.0, 0.8], [-0.48, 0.64, -0.6], [0.0, 0.0, 1.0], [0.28, -0.96, 0.0]] {
            assert!((height(square(d)) - d[2]).abs() < 1e-9, "{d:?}");
        }
        let lit = Image::from_data(8, 8, 3, vec![2.0; 192]).expect("fits");
        assert!(latitudes(&lit, [1.0, 0.5, 0.0]).data().chunks(3).all(|t| t == [2.0, 1.0, 0.0]));
    }
}
