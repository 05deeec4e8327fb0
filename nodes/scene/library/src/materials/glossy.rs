//! Surfaces of things that have no stuff of their own: assets' glossy parts.

use super::{
    Materials,
    optics::Metal,
    palette::within,
    surface::{Place, Tone},
    two_sided,
};
use crate::textures::Pattern;
use tauflow_contract::KindError;
use tauflow_data::{
    rng::Stream,
    scene::{Bsdf, Rgb, Texture},
};

impl Materials<'_, '_> {
    /// A colour, or a gray map in that colour where there are texture coordinates; `tiling` is the size in metres.
    fn albedo(&self, draw: &mut Stream, color: Rgb, uv: bool, tiling: f64) -> Result<Texture, KindError> {
        let textured = draw.chance(self.ranges.diffuse.textured);
        let name = draw.pick(&["plain", "twill", "herringbone", "plaster", "leather", "pile", "brushed"]);
        if !(textured && uv) {
            return Ok(Texture::rgb(color));
        }
        let level = color.iter().fold(0.0f32, |m, c| m.max(*c));
        let tone = Tone::Of(color.map(f64::from), f64::from(level));
        let place = Place::Repeated([1.0 / tiling; 2]);
        Ok(self.lay(Pattern::of(name), place, tone, None, draw)?.albedo())
    }

    fn metal(&self, draw: &mut Stream, alpha: f64) -> Bsdf {
        self.conductor(Metal::new(draw), alpha, Texture::scalar(1.0))
    }

    /// Metal, lacquer or a principled surface, of the range `glossy`.
    ///
    /// # Errors
    /// If a blob cannot be stored.
    pub fn glossy(&self, draw: &mut Stream, uv: bool) -> Result<Bsdf, KindError> {
        let alpha = self.gloss(draw);
        if draw.chance(self.ranges.glossy.metal) {
            return Ok(self.metal(draw, alpha));
        }
        let color = within(self.palette.pick(draw), self.ranges.diffuse.albedo, draw);
        let albedo = self.albedo(draw, color, uv, 1.0)?;
        Ok(two_sided(if draw.chance(0.6) {
            Bsdf::Plastic {
                diffuse_reflectance: albedo,
                int_ior: draw.range(1.4, 1.7) as f32,
                ext_ior: 1.0,
                alpha: alpha as f32,
            }
        } else {
            Bsdf::Principled {
                base_color: albedo,
                metallic: Texture::scalar(if draw.chance(0.5) { draw.range(0.3, 1.0) as f32 } else { 0.0 }),
                // alpha = roughness^2.
                roughness: Texture::scalar(alpha.sqrt() as f32),
                specular: draw.range(0.3, 0.8) as f32,
                spec_trans: Texture::scalar(0.0),
                clearcoat: if draw.chance(0.4) { draw.range(0.3, 1.0) as f32 } else { 0.0 },
                clearcoat_gloss: draw.range(0.6, 0.95) as f32,
            }
        }))
    }
}
