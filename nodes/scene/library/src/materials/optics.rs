//! Glass, panes, water, mirrors and metals: what a regime is shown by.

use super::{Materials, surface::Laid, two_sided};
use tauflow_data::{
    rng::Stream,
    scene::{Bsdf, Rgb, Texture},
};

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

/// Reflection of a metal seen head on: ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2).
fn head_on((eta, k): (Rgb, Rgb)) -> [f64; 3] {
    [0, 1, 2].map(|c| {
        let (n, k) = (f64::from(eta[c]), f64::from(k[c]));
        ((n - 1.0) * (n - 1.0) + k * k) / ((n + 1.0) * (n + 1.0) + k * k)
    })
}

/// A metal: its place in the table.
#[derive(Clone, Copy)]
pub struct Metal(usize);

impl Metal {
    /// One of the table; things are of steel, aluminium or chromium more often than of gold.
    pub fn new(draw: &mut Stream) -> Self {
        Self(*draw.pick(&[0, 1, 2, 2, 3, 4, 4, 5, 5, 6]))
    }

    /// Silver, as on the back of mirrors.
    pub fn silver() -> Self {
        Self(3)
    }

    /// Its colour.
    pub fn color(self) -> [f64; 3] {
        head_on(METALS[self.0])
    }
}

impl Materials<'_, '_> {
    pub(super) fn glass(&self, draw: &mut Stream, ior: f64, alpha: f64) -> Bsdf {
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

    /// Glass of the range `refractive`: frosted.
    pub(super) fn frosted(&self, draw: &mut Stream) -> Bsdf {
        let range = &self.ranges.refractive;
        let ior = draw.range(range.ior[0], range.ior[1]);
        let alpha = draw.range(range.roughness[0], range.roughness[1]);
        self.glass(draw, ior, alpha)
    }

    /// Glass of the range `caustic`: smooth.
    pub(super) fn clear(&self, draw: &mut Stream) -> Bsdf {
        let range = &self.ranges.caustic;
        let ior = draw.range(range.ior[0], range.ior[1]);
        self.glass(draw, ior, 0.0)
    }

    /// A thin sheet of glass.
    pub fn pane(&self, draw: &mut Stream) -> Bsdf {
        let [low, high] = self.ranges.refractive.ior;
        let color = self.palette.pick(draw).map(|c| (1.0 + (c - 1.0) * 0.25) as f32);
        Bsdf::ThinDielectric {
            int_ior: draw.range(low, high) as f32,
            ext_ior: 1.0,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: Texture::rgb(color),
        }
    }

    /// Water, rippled where `laid` has normals. `alpha` above 0 stands for ripples too small to be seen.
    pub(super) fn water(&self, draw: &mut Stream, alpha: f64, laid: &Laid) -> Bsdf {
        let depth = draw.range(0.0, 0.12);
        let color = [1.0 - 2.0 * depth, 1.0 - 0.7 * depth, 1.0 - 0.4 * depth].map(|c| c as f32);
        laid.bumped(Bsdf::Dielectric {
            int_ior: 1.333,
            ext_ior: 1.0,
            alpha: alpha as f32,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: Texture::rgb(color),
        })
    }

    pub(super) fn conductor(&self, metal: Metal, alpha: f64, reflectance: Texture) -> Bsdf {
        let (eta, k) = METALS[metal.0];
        two_sided(Bsdf::Conductor { eta, k, alpha: alpha as f32, specular_reflectance: reflectance })
    }

    /// A mirror: silver or aluminium.
    pub(super) fn mirror(&self, draw: &mut Stream, alpha: f64) -> Bsdf {
        let metal = Metal(if draw.chance(0.5) { 3 } else { 2 });
        self.conductor(metal, alpha, Texture::scalar(draw.range(0.9, 1.0) as f32))
    }
}
