//! The library of procedural environments: latitude-longitude maps of skies and studios, in fixed variants.
//!
//! Convention of [`tauflow_data::scene::Emitter::Envmap`]. Each map's mean radiance over the sphere is 1, so that a
//! scene's `scale` is its level. Light is kept moderate: no texel above 2,000.

use super::noise::fractal;
use crate::geom::{Vec3, direction, dot, unit};
use tauflow_data::{Image, maths, mesh::Bitmap, rng::Stream};

/// A sort of environment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sky {
    /// Its name.
    pub name: &'static str,
    /// How concentrated its light is.
    pub light: Light,
}

/// How concentrated an environment's light is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// From all sides: casts no caustic worth the name.
    Soft,
    /// Broad sources that stand out.
    Mixed,
    /// A small, intense source carries most of it.
    Sun,
}

/// Every sky, in order of name.
pub const SKIES: [Sky; 8] = [
    Sky { name: "clear", light: Light::Mixed },
    Sky { name: "cloudy", light: Light::Soft },
    Sky { name: "dusk", light: Light::Mixed },
    Sky { name: "noon", light: Light::Sun },
    Sky { name: "overcast", light: Light::Soft },
    Sky { name: "softboxes", light: Light::Mixed },
    Sky { name: "spotlit", light: Light::Sun },
    Sky { name: "tent", light: Light::Soft },
];

/// Variants of each sky.
pub const VARIANTS: u64 = 32;

struct Disc {
    toward: Vec3,
    /// Cosines of the half angles where it ends, and where it begins to fall.
    ends: f64,
    full: f64,
    radiance: [f64; 3],
}

fn disc(draw: &mut Stream, elevation: [f64; 2], half_degrees: [f64; 2], radiance: [f64; 3]) -> Disc {
    let toward = direction(draw.range(0.0, core::f64::consts::TAU), draw.range(elevation[0], elevation[1]));
    let half = draw.range(half_degrees[0], half_degrees[1]).to_radians();
    Disc { toward, ends: maths::cos(1.25 * half), full: maths::cos(0.75 * half), radiance }
}

/// A disc of a flux (radiance x solid angle) of `flux`, whatever its size.
fn sun(draw: &mut Stream, elevation: [f64; 2], half_degrees: [f64; 2], color: [f64; 3], flux: f64) -> Disc {
    let mut disc = disc(draw, elevation, half_degrees, color);
    let solid_angle = core::f64::consts::PI * (2.0 - disc.ends - disc.full);
    disc.radiance = color.map(|c| c * flux / solid_angle);
    disc
}

fn step(low: f64, high: f64, v: f64) -> f64 {
    let t = ((v - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn mix3(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

/// The direction of the texel at `u`, `v`.
pub fn texel_direction(u: f64, v: f64) -> Vec3 {
    let (phi, theta) = (core::f64::consts::TAU * u, core::f64::consts::PI * v);
    [maths::sin(theta) * maths::sin(phi), maths::cos(theta), -maths::sin(theta) * maths::cos(phi)]
}

/// A sky's variant: 128 x 64, or 256 x 128 where it has a small source.
pub fn sky(name: &str, variant: u64) -> Bitmap {
    let draw = Stream::new(0x736B_7900, &[variant]).part(name);
    let mut d = draw.part("colours");
    let mut s = draw.part("sources");
    let cloud_seed = draw.part("clouds").bits();
    let tint = |d: &mut Stream, base: [f64; 3], amount: f64| base.map(|v| v * (1.0 + amount * d.range(-1.0, 1.0)));
    let ground = tint(&mut d, [0.12, 0.11, 0.09], 0.5);
    let (zenith, horizon, clouds): ([f64; 3], [f64; 3], f64) = match name {
        "clear" | "noon" => (tint(&mut d, [0.15, 0.3, 0.7], 0.2), tint(&mut d, [0.6, 0.75, 0.95], 0.15), 0.35),
        "cloudy" => (tint(&mut d, [0.3, 0.45, 0.7], 0.2), tint(&mut d, [0.8, 0.85, 0.9], 0.1), 1.0),
        "dusk" => (tint(&mut d, [0.10, 0.12, 0.3], 0.3), tint(&mut d, [1.2, 0.6, 0.3], 0.25), 0.5),
        "overcast" => (tint(&mut d, [0.95, 1.0, 1.08], 0.1), tint(&mut d, [0.45, 0.47, 0.5], 0.15), 0.25),
        "tent" => (tint(&mut d, [1.0, 0.98, 0.95], 0.1), tint(&mut d, [0.7, 0.72, 0.75], 0.2), 0.0),
        // Studios: a dark hall.
        _ => (tint(&mut d, [0.05, 0.05, 0.06], 0.6), tint(&mut d, [0.1, 0.1, 0.11], 0.6), 0.0),
    };
    let warm = mix3([1.0, 0.95, 0.88], [1.0, 0.8, 0.55], d.uniform());
    let sources: Vec<Disc> = match name {
        "noon" => vec![sun(&mut s, [0.5, 1.2], [2.5, 4.5], warm, 8.0)],
        "spotlit" => (0..1 + s.below(2)).map(|_| sun(&mut s, [0.4, 1.2], [3.0, 5.5], warm, 3.0)).collect(),
        "clear" => vec![disc(&mut s, [0.4, 1.1], [6.0, 12.0], warm.map(|v| v * 12.0))],
        "dusk" => vec![disc(&mut s, [0.03, 0.2], [8.0, 16.0], [9.0, 4.0, 1.4])],
        "softboxes" => (0..2 + s.below(3))
            .map(|i| {
                let cool = if i % 2 == 0 { warm } else { [0.8, 0.9, 1.0] };
                disc(&mut s, [-0.1, 1.2], [12.0, 28.0], cool.map(|v| v * 7.0))
            })
            .collect(),
        _ => Vec::new(),
    };
    let square = name == "softboxes";
    let radiance = |w: Vec3| -> [f64; 3] {
        let up = w[1];
        let mut c = mix3(horizon, zenith, maths::pow(up.max(0.0), 0.5));
        if clouds > 0.0 && up > 0.0 {
            // Clouds lie on a plane overhead: compress towards the horizon.
            let k = 1.0 / (up + 0.15);
            let n = fractal(cloud_seed, [w[0] * k * 1.3, w[2] * k * 1.3, 0.0], [0; 3], 4);
            let cover = step(-0.05, 0.45, n) * clouds * step(0.0, 0.12, up);
            let white = mix3(horizon, [1.1, 1.1, 1.12], 0.6);
            c = mix3(c, white, cover.min(1.0));
        }
        let below = step(0.02, -0.06, up);
        c = mix3(c, ground, if name == "tent" { 0.6 * below } else { below });
        for source in &sources {
            let cos = if square {
                // A rounded square about the axis: the larger of two angles instead of the distance.
                let right = unit(crate::geom::cross([0.0, 1.0, 0.0], source.toward));
                let over = crate::geom::cross(source.toward, right);
                let (x, y, z) = (dot(w, right), dot(w, over), dot(w, source.toward));
                if z <= 0.0 { -1.0 } else { z / (z * z + x.abs().max(y.abs()) * x.abs().max(y.abs())).sqrt() }
            } else {
                dot(w, source.toward)
            };
            let t = step(source.ends, source.full, cos);
            c = [0, 1, 2].map(|i| c[i] + source.radiance[i] * t);
        }
        c
    };
    let (width, height) = if name == "noon" || name == "spotlit" { (256, 128) } else { (128, 64) };
    let mut values = Vec::with_capacity(width * height * 3);
    let (mut sum, mut weight) = (0.0, 0.0);
    for y in 0..height {
        let v = (y as f64 + 0.5) / height as f64;
        let area = maths::sin(core::f64::consts::PI * v);
        for x in 0..width {
            let c = radiance(texel_direction((x as f64 + 0.5) / width as f64, v));
            sum += area * (0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]);
            weight += area;
            values.extend(c);
        }
    }
    let scale = weight / sum;
    Image::from_data(width, height, 3, values.into_iter().map(|v| (v * scale) as f32).collect())
        .expect("the shape is the data's")
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::image::luminance;

    #[test]
    fn skies_have_unit_mean_and_the_light_they_claim() {
        for sky_kind in SKIES {
            for variant in 0..VARIANTS {
                let image = sky(sky_kind.name, variant);
                let mut texels: Vec<(f64, f64)> = Vec::new();
                for y in 0..image.height() {
                    let area = maths::sin(core::f64::consts::PI * (y as f64 + 0.5) / image.height() as f64);
                    texels.extend((0..image.width()).map(|x| (f64::from(luminance(image.pixel(x, y))), area)));
                }
                let area: f64 = texels.iter().map(|t| t.1).sum();
                let mean = texels.iter().map(|t| t.0 * t.1).sum::<f64>() / area;
                assert!((mean - 1.0).abs() < 1e-4, "{}-{variant}: {mean}", sky_kind.name);
                texels.sort_by(|a, b| b.0.total_cmp(&a.0));
                let (mut top, mut seen) = (0.0, 0.0);
                for (l, a) in &texels {
                    if seen > 0.01 * area {
                        break;
                    }
                    top += l * a / area;
                    seen += a;
                }
                let name = format!("{}-{variant}: {top}", sky_kind.name);
                match sky_kind.light {
                    Light::Soft => assert!(top < 0.06, "{name}"),
                    Light::Mixed => assert!(top < 0.45, "{name}"),
                    Light::Sun => assert!(top > 0.4, "{name}"),
                }
                assert!(texels.iter().all(|t| t.0 >= 0.0 && t.0 < 2000.0), "{name}");
            }
        }
    }
}
