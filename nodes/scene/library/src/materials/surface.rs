//! Maps laid on a surface: their scale and place on it, levels of colour and roughness, dirt over them.

use super::{Materials, palette::at_level, stored::Stored, two_sided};
use crate::textures::Pattern;
use tauflow_contract::KindError;
use tauflow_data::{
    rng::Stream,
    scene::{Bsdf, Rgb, Texture},
};

/// Nothing reflects more than this share.
const BRIGHTEST: f64 = 0.98;

/// Where maps lie on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// Repeated at their real size: units of uv a metre.
    Repeated([f64; 2]),
    /// Once over a box of uv, low and high, row 0 at the low end of v.
    Once([[f64; 2]; 2]),
}

/// Linear map of uv to that of an image.
type Matrix = [[f64; 3]; 2];

/// Maps on a surface.
pub struct Laid {
    stored: Stored,
    uv: Matrix,
    /// True where opposite borders must not run into one another.
    clamp: bool,
    /// Scales the normals' lean.
    bump: f32,
    color: Rgb,
}

/// The factor for a map's colour.
#[derive(Clone, Copy)]
pub enum Tone {
    /// Its own colours, times a factor near 1.
    Own,
    /// Its own, whatever the range of albedos: black or white by nature.
    Nature,
    /// A colour at a level of the range of albedos.
    Of([f64; 3], f64),
}

impl Place {
    /// Over a box of uv, the `index`-th of `count` x `count` parts of an image.
    pub fn part([low, high]: [[f64; 2]; 2], count: usize, index: usize) -> Self {
        let at = [index % count, index / count].map(|k| k as f64);
        let span = [0, 1].map(|i| high[i] - low[i]);
        Self::Once([
            [0, 1].map(|i| low[i] - at[i] * span[i]),
            [0, 1].map(|i| low[i] + (count as f64 - at[i]) * span[i]),
        ])
    }

    /// The map for images of `period` metres, moved by `shift` periods.
    pub fn matrix(&self, period: [f64; 2], shift: [f64; 2]) -> Matrix {
        match self {
            Self::Repeated(per_metre) => {
                let scale = [0, 1].map(|i| 1.0 / (per_metre[i] * period[i]));
                [[scale[0], 0.0, shift[0]], [0.0, scale[1], shift[1]]]
            }
            Self::Once([low, high]) => {
                let scale = [0, 1].map(|i| 1.0 / (high[i] - low[i]));
                [[scale[0], 0.0, -low[0] * scale[0]], [0.0, scale[1], -low[1] * scale[1]]]
            }
        }
    }
}

impl Laid {
    fn image(&self, image: tauflow_contract::Digest, scale: Rgb, channel: Option<u8>) -> Texture {
        Texture::Bitmap { image, uv: self.uv, scale, channel, clamp: self.clamp }
    }

    /// Albedo.
    pub fn albedo(&self) -> Texture {
        self.image(self.stored.color, self.color, None)
    }

    /// The map's tones as a gray share whose brightest texel is 0.98.
    pub fn share(&self) -> Texture {
        let most = self.stored.facts.most.iter().fold(1e-6f64, |m, v| m.max(*v));
        self.image(self.stored.color, [(BRIGHTEST / most) as f32; 3], None)
    }

    /// As light: mean luminance 1, times `radiance`.
    pub fn radiance(&self, radiance: Rgb) -> Texture {
        let mean = self.stored.facts.mean;
        let luminance = 0.2126 * mean[0] + 0.7152 * mean[1] + 0.0722 * mean[2];
        self.image(self.stored.color, radiance.map(|r| (f64::from(r) / luminance.max(1e-6)) as f32), None)
    }

    /// Perceptual roughness whose mean is that of `alpha`, if the map leaves room for it.
    pub fn roughness(&self, alpha: f64) -> Texture {
        let [mean, most] = self.stored.facts.rough;
        let scale = (alpha.sqrt() / mean).min(1.0 / most) as f32;
        self.image(self.stored.roughness, [scale; 3], Some(0))
    }

    /// A surface with the maps' normals.
    pub fn bumped(&self, inner: Bsdf) -> Bsdf {
        match self.stored.normal {
            Some(normal) => {
                let map = self.image(normal, [1.0; 3], None);
                Bsdf::NormalMap { map, scale: self.bump, inner: Box::new(inner) }
            }
            None => inner,
        }
    }
}

impl Materials<'_, '_> {
    /// Lays a variant of `pattern`. `shift` puts its origin somewhere, or at random.
    pub(super) fn lay(
        &self,
        pattern: &Pattern,
        place: Place,
        tone: Tone,
        shift: Option<[f64; 2]>,
        draw: &mut Stream,
    ) -> Result<Laid, KindError> {
        let mut house = self.palette.house(pattern.name, draw);
        let variant = self.ranges.variant(&mut house, pattern.variants);
        let stored = Stored::of(self.ctx, pattern, variant)?;
        let shift = shift.unwrap_or([draw.uniform(), draw.uniform()]);
        let facts = &stored.facts;
        let mean = facts.mean.iter().fold(1e-6f64, |m, v| m.max(*v));
        let [low, high] = self.ranges.diffuse.albedo;
        let near = draw.range(0.9, 1.1);
        let color = match tone {
            Tone::Nature => [near; 3],
            Tone::Own => [(near * mean).clamp(low, high) / mean; 3],
            Tone::Of(color, level) => {
                let tinted = [0, 1, 2].map(|c| color[c] * facts.mean[c]);
                let tinted = at_level(tinted, level);
                [0, 1, 2].map(|c| f64::from(tinted[c]) / facts.mean[c].max(1e-6))
            }
        };
        // No texel is brighter than anything can be.
        let most = [0, 1, 2].map(|c| color[c] * facts.most[c]).into_iter().fold(1e-6f64, f64::max);
        let kept = (BRIGHTEST / most).min(1.0);
        Ok(Laid {
            uv: place.matrix(pattern.period, shift),
            clamp: !pattern.tiles && matches!(place, Place::Once(_)),
            bump: draw.range(0.7, 1.1) as f32,
            color: color.map(|c| (c * kept) as f32),
            stored,
        })
    }

    /// Diffuse, with the maps' normals.
    pub(super) fn matte(&self, laid: &Laid) -> Bsdf {
        laid.bumped(two_sided(Bsdf::Diffuse { reflectance: laid.albedo() }))
    }

    /// Under a coat, or with a sheen of its own that follows the roughness map.
    pub(super) fn coated(&self, laid: &Laid, draw: &mut Stream) -> Bsdf {
        let alpha = self.gloss(draw);
        laid.bumped(two_sided(if draw.chance(0.35) {
            Bsdf::Plastic {
                diffuse_reflectance: laid.albedo(),
                int_ior: draw.range(1.4, 1.7) as f32,
                ext_ior: 1.0,
                alpha: alpha as f32,
            }
        } else {
            Bsdf::Principled {
                base_color: laid.albedo(),
                metallic: Texture::scalar(0.0),
                roughness: laid.roughness(alpha),
                specular: draw.range(0.3, 0.8) as f32,
                spec_trans: Texture::scalar(0.0),
                clearcoat: if draw.chance(0.3) { draw.range(0.3, 1.0) as f32 } else { 0.0 },
                clearcoat_gloss: draw.range(0.6, 0.95) as f32,
            }
        }))
    }

    /// A roughness alpha of the range `glossy`.
    pub(super) fn gloss(&self, draw: &mut Stream) -> f64 {
        let [low, high] = self.ranges.glossy.roughness;
        draw.range(low, high)
    }

    /// Diffuse dirt that gathers along the edges of a large surface whose uv is the unit square.
    pub(super) fn soiled(&self, laid: &Laid, draw: &mut Stream) -> Result<Bsdf, KindError> {
        let whole = Place::Once([[0.0; 2], [1.0; 2]]);
        let dirt = self.lay(Pattern::of("dirt"), whole, Tone::Nature, None, draw)?;
        let strength = draw.range(0.35, 0.8);
        let level = draw.range(0.06, 0.14);
        let soil = [1.0, draw.range(0.82, 0.95), draw.range(0.62, 0.85)].map(|c| (c * level) as f32);
        let weight = dirt.image(dirt.stored.color, [strength as f32; 3], Some(0));
        Ok(laid.bumped(two_sided(Bsdf::Blend {
            weight,
            a: Box::new(Bsdf::Diffuse { reflectance: laid.albedo() }),
            b: Box::new(Bsdf::Diffuse { reflectance: Texture::rgb(soil) }),
        })))
    }
}
