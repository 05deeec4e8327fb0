//! Colours and materials: a palette for each scene, diffuse surfaces, and the surfaces of each regime.

use super::{params::SceneGenerationParams, textures};
use tauflow_contract::{Context, KindError};
use tauflow_data::{
    Regime, maths,
    mesh::Bitmap,
    rng::Stream,
    scene::{Bsdf, Rgb, Texture},
};

/// Stores an image in the format of [`Bitmap`].
pub fn put_bitmap(ctx: &Context<'_>, image: &Bitmap) -> Result<tauflow_contract::Digest, KindError> {
    ctx.put(&image.to_bytes())
}

/// A few colours that go together; linear RGB, largest channel 1.
pub struct Palette {
    colors: Vec<[f64; 3]>,
}

/// Complex indices of refraction of metals, by RGB (from the tables of refractiveindex.info, as renderers ship them).
const METALS: [(Rgb, Rgb); 7] = [
    ([0.143, 0.375, 1.442], [3.983, 2.386, 1.603]), // gold
    ([0.200, 0.924, 1.102], [3.912, 2.452, 2.142]), // copper
    ([1.657, 0.880, 0.521], [9.224, 6.270, 4.837]), // aluminium
    ([0.155, 0.117, 0.138], [4.828, 3.122, 2.147]), // silver
    ([2.912, 2.950, 2.585], [3.089, 2.932, 2.767]), // iron
    ([3.110, 3.181, 2.323], [3.331, 3.291, 3.135]), // chromium
    ([2.741, 2.541, 2.267], [3.814, 3.435, 3.039]), // titanium
];

fn hsv(h: f64, s: f64, v: f64) -> [f64; 3] {
    // Display-referred, then to linear by the power 2.2: palettes are picked by eye.
    [0.0, 4.0, 2.0].map(|shift| {
        let k = (h * 6.0 + shift) % 6.0;
        let t = ((k - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        maths::pow(v * (1.0 - s + s * t), 2.2)
    })
}

impl Palette {
    /// A palette: a base hue, and others by a scheme of harmony.
    pub fn new(draw: &mut Stream) -> Self {
        let base = draw.uniform();
        let hues: &[f64] = match draw.below(4) {
            0 => &[0.0, 0.06, -0.06, 0.5],
            1 => &[0.0, 0.33, 0.67, 0.05],
            2 => &[0.0, 0.5, 0.46, 0.08],
            _ => &[0.0, 0.08, 0.16, -0.08],
        };
        let saturation = draw.range(0.25, 0.75);
        let mut colors: Vec<[f64; 3]> = hues
            .iter()
            .map(|shift| {
                let h = base + shift + 1.0 + draw.range(-0.02, 0.02);
                let s = (saturation * draw.range(0.7, 1.3)).min(0.85);
                hsv(h - h.floor(), s, 1.0)
            })
            .collect();
        colors.push(hsv(base, 0.06, 1.0));
        Self { colors }
    }

    /// One of its colours.
    pub fn pick(&self, draw: &mut Stream) -> [f64; 3] {
        *draw.pick(&self.colors)
    }

    /// A pale tone of one of its colours, for walls and floors.
    pub fn pale(&self, draw: &mut Stream) -> [f64; 3] {
        let t = draw.range(0.55, 0.95);
        self.pick(draw).map(|c| c + (1.0 - c) * t)
    }
}

/// Scales a colour to a largest channel within `range`.
fn within(color: [f64; 3], range: [f64; 2], draw: &mut Stream) -> Rgb {
    let most = color[0].max(color[1]).max(color[2]).max(1e-6);
    let level = draw.range(range[0], range[1]);
    color.map(|c| (c / most * level) as f32)
}

/// Makes materials of one scene.
pub struct Materials<'a, 'c> {
    /// Where textures go.
    pub ctx: &'a Context<'c>,
    /// The ranges.
    pub params: &'a SceneGenerationParams,
    /// The colours.
    pub palette: Palette,
}

impl Materials<'_, '_> {
    /// A colour, or a texture of it, where there are texture coordinates.
    fn albedo(&self, draw: &mut Stream, color: Rgb, uv: bool, tiling: f64) -> Result<Texture, KindError> {
        let textured = draw.chance(self.params.diffuse.textured);
        let other = within(self.palette.pick(draw), self.params.diffuse.albedo, draw);
        let choice = draw.below(textures::PATTERNS.len() + 2);
        let variant = self.params.variant(draw, textures::VARIANTS);
        let repeat = tiling * (1 + draw.below(3)) as f64;
        Ok(if !(textured && uv) {
            Texture::rgb(color)
        } else if let Some(name) = textures::PATTERNS.get(choice) {
            let image = put_bitmap(self.ctx, &textures::pattern(name, variant))?;
            let uv = [[repeat, 0.0, 0.0], [0.0, repeat, 0.0]];
            Texture::Bitmap { image, uv, scale: color, channel: None, clamp: false }
        } else {
            Texture::Checkerboard { color0: color, color1: other, scale: [4.0 * repeat, 4.0 * repeat] }
        })
    }

    /// A diffuse surface.
    pub fn diffuse(&self, draw: &mut Stream, uv: bool) -> Result<Bsdf, KindError> {
        let color = within(self.palette.pick(draw), self.params.diffuse.albedo, draw);
        Ok(two_sided(Bsdf::Diffuse { reflectance: self.albedo(draw, color, uv, 1.0)? }))
    }

    /// A floor or wall: paler than an object, in the upper part of the albedo range; `tiling` repeats textures.
    pub fn architecture(&self, draw: &mut Stream, tiling: f64, plain: bool) -> Result<Bsdf, KindError> {
        let [low, high] = self.params.diffuse.albedo;
        let color = within(self.palette.pale(draw), [0.5 * (low + high), high], draw);
        let reflectance = self.albedo(draw, color, !plain, tiling)?;
        Ok(two_sided(Bsdf::Diffuse { reflectance }))
    }

    /// The surface that makes a regime: glossy, frosted or clear glass, mirror; diffuse for L0.
    ///
    /// `closed` tells whether glass suits the body; without it L2 and L3 give a mirror-like metal or a matte surface.
    pub fn special(&self, regime: Regime, draw: &mut Stream, uv: bool, closed: bool) -> Result<Bsdf, KindError> {
        match regime {
            Regime::L0 => self.diffuse(draw, uv),
            Regime::L1 => self.glossy(draw, uv),
            Regime::L2 if closed => {
                let range = &self.params.refractive;
                let ior = draw.range(range.ior[0], range.ior[1]);
                let alpha = draw.range(range.roughness[0], range.roughness[1]);
                Ok(self.glass(draw, ior, alpha))
            }
            Regime::L3 => {
                let range = &self.params.caustic;
                let ior = draw.range(range.ior[0], range.ior[1]);
                let mirror = draw.chance(range.mirror);
                Ok(if closed && !mirror { self.glass(draw, ior, 0.0) } else { self.metal(draw, 0.0) })
            }
            Regime::L2 => self.diffuse(draw, uv),
        }
    }

    fn glass(&self, draw: &mut Stream, ior: f64, alpha: f64) -> Bsdf {
        // Most glass is clear; some is tinted, lightly, as the tint applies at every crossing.
        let tint = if draw.chance(0.35) { draw.range(0.1, 0.4) } else { 0.0 };
        let color = self.palette.pick(draw).map(|c| (1.0 + (c - 1.0) * tint) as f32);
        Bsdf::Dielectric {
            int_ior: ior as f32,
            ext_ior: 1.0,
            alpha: alpha as f32,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: Texture::rgb(color),
        }
    }

    /// A thin sheet of glass.
    pub fn pane(&self, draw: &mut Stream) -> Bsdf {
        let [low, high] = self.params.refractive.ior;
        let color = self.palette.pick(draw).map(|c| (1.0 + (c - 1.0) * 0.25) as f32);
        Bsdf::ThinDielectric {
            int_ior: draw.range(low, high) as f32,
            ext_ior: 1.0,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: Texture::rgb(color),
        }
    }

    fn metal(&self, draw: &mut Stream, alpha: f64) -> Bsdf {
        let (eta, k) = *draw.pick(&METALS);
        two_sided(Bsdf::Conductor { eta, k, alpha: alpha as f32, specular_reflectance: Texture::scalar(1.0) })
    }

    /// Metal, lacquer or a principled surface, of the range `glossy`.
    pub fn glossy(&self, draw: &mut Stream, uv: bool) -> Result<Bsdf, KindError> {
        let range = &self.params.glossy;
        let alpha = draw.range(range.roughness[0], range.roughness[1]);
        if draw.chance(range.metal) {
            return Ok(self.metal(draw, alpha));
        }
        let color = within(self.palette.pick(draw), self.params.diffuse.albedo, draw);
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

/// A surface that looks the same from its back, if light does not pass through it.
pub fn two_sided(inner: Bsdf) -> Bsdf {
    Bsdf::TwoSided { inner: Box::new(inner) }
}
