//! The library of procedural environments: latitude-longitude maps of skies and studios, in fixed variants.
//!
//! Convention of [`tauflow_data::scene::Emitter::Envmap`]. Each map's mean radiance over the sphere is 1, so that a
//! scene's `scale` is its level. The sun is wider than the real one, at the same irradiance: no texel is above
//! [`BRIGHTEST`]. Values are those of f16, so that maps are stored in half of the room.

mod air;
mod clouds;
mod land;
mod studio;
#[cfg(test)]
mod tests;

use super::materials::put_bitmap;
use tauflow_contract::{Artifact, Basis, Context, Digest, KindError, MemoKey};
use tauflow_data::geom::Vec3;
use tauflow_data::{Image, maths, mesh::Bitmap, rng::Stream};

/// Linear RGB.
type Color = [f64; 3];

/// A sort of environment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sky {
    /// Its name.
    pub name: &'static str,
    /// How concentrated its light is.
    pub light: Light,
}

/// How concentrated an environment's light is: by what its brightest hundredth of the sphere gives of all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// From all sides, less than 0.08: casts no caustic worth the name.
    Soft,
    /// Broad sources that stand out, from 0.06 to 0.45.
    Mixed,
    /// A small, intense source carries most of it, more than 0.4.
    Sun,
}

/// Every sky, in order of name.
pub const SKIES: [Sky; 14] = [
    Sky { name: "afternoon", light: Light::Sun },
    Sky { name: "cloudy", light: Light::Soft },
    Sky { name: "dusk", light: Light::Mixed },
    Sky { name: "fair", light: Light::Sun },
    Sky { name: "fog", light: Light::Soft },
    Sky { name: "hazy", light: Light::Mixed },
    Sky { name: "morning", light: Light::Sun },
    Sky { name: "night", light: Light::Mixed },
    Sky { name: "noon", light: Light::Sun },
    Sky { name: "overcast", light: Light::Soft },
    Sky { name: "softboxes", light: Light::Mixed },
    Sky { name: "spotlit", light: Light::Sun },
    Sky { name: "tent", light: Light::Soft },
    Sky { name: "windows", light: Light::Mixed },
];

/// Variants of each sky.
pub const VARIANTS: u64 = 16;

/// No texel is above this.
pub const BRIGHTEST: f64 = 16_000.0;

/// Raised when a variant changes: what is kept of earlier ones is then not found.
const VERSION: u32 = 1;

fn step(low: f64, high: f64, v: f64) -> f64 {
    let t = ((v - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn mix3(a: Color, b: Color, t: f64) -> Color {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

fn scaled(a: Color, k: f64) -> Color {
    a.map(|v| v * k)
}

/// The direction of the texel at `u`, `v`.
pub fn texel_direction(u: f64, v: f64) -> Vec3 {
    let (phi, theta) = (core::f64::consts::TAU * u, core::f64::consts::PI * v);
    [maths::sin(theta) * maths::sin(phi), maths::cos(theta), -maths::sin(theta) * maths::cos(phi)]
}

/// The nearest number of f16; values are at least 0 and below 65,504.
fn half(v: f64) -> f32 {
    let v = v as f32;
    let finest = 1.0 / 16_777_216.0;
    // Below 2^-14 halves are whole multiples of 2^-24.
    if v < 1.0 / 16_384.0 {
        return (v / finest).round() * finest;
    }
    f32::from_bits((v.to_bits() + 0x0FFF + ((v.to_bits() >> 13) & 1)) & !0x1FFF)
}

/// What the store keeps of a sky's variant: an artifact of this kind's own, which passes no port.
const MEDIA: &str = "tauflow/library-sky";

/// The digest of a sky's variant in the store, made if it is not there.
///
/// # Errors
/// If a blob cannot be stored.
pub fn stored(ctx: &Context<'_>, name: &str, variant: u64) -> Result<Digest, KindError> {
    let params = serde_json::json!({ "sky": name, "variant": variant });
    let key = MemoKey { basis: Basis::new("scene_generation", VERSION, "sky").with(params, None), inputs: Vec::new() };
    if let Some(found) = ctx.memo_get(&key).and_then(|artifact| artifact.part("")) {
        return Ok(found);
    }
    let digest = put_bitmap(ctx, &sky(name, variant))?;
    ctx.memo_put(&key, &Artifact::blob(MEDIA, digest))?;
    Ok(digest)
}

/// A sky's variant: 512 x 256 where it has a small source, else 256 x 128.
pub fn sky(name: &str, variant: u64) -> Bitmap {
    let draw = Stream::new(0x736B_7900, &[variant]).part(name);
    let studio = matches!(name, "softboxes" | "spotlit" | "tent" | "windows");
    let fine = studio || !matches!(name, "cloudy" | "fog" | "overcast");
    let (width, height) = if fine && name != "tent" { (512, 256) } else { (256, 128) };
    let radiance: Box<dyn Fn(Vec3) -> Color> =
        if studio { studio::radiance(name, &draw) } else { land::radiance(name, &draw) };
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
    let data = values.into_iter().map(|v| half((v * scale).min(BRIGHTEST))).collect();
    Image::from_data(width, height, 3, data).expect("the shape is the data's")
}
