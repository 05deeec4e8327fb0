//! What materials are drawn from: ranges and shares, and which library variants come from.
//!
//! They are params of `scene_generation`. Knows no layout and no stratum.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_data::rng::Stream;

/// A range `[low, high]`.
pub type Range = [f64; 2];

/// What the materials of a scene are drawn from.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranges {
    /// Which library patterns are from.
    pub library: u64,
    /// Diffuse surfaces.
    pub diffuse: DiffuseRanges,
    /// Share of lamps that are brighter in places.
    pub textured_lights: f64,
    /// Glossy surfaces.
    pub glossy: GlossyRanges,
    /// Refractive surfaces under broad light.
    pub refractive: RefractiveRanges,
    /// Glass, mirrors and small lights.
    pub caustic: CausticRanges,
}

impl Ranges {
    /// One of `count` variants of this library.
    pub fn variant(&self, draw: &mut Stream, count: u64) -> u64 {
        variant_of_library(self.library, draw, count)
    }
}

/// One of `count` variants of a library: no two libraries share one.
pub fn variant_of_library(library: u64, draw: &mut Stream, count: u64) -> u64 {
    library * count + draw.below(count as usize) as u64
}

/// Diffuse surfaces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DiffuseRanges {
    /// Largest channel of the albedo.
    #[schemars(inner(range(min = 0.0, max = 0.98)))]
    pub albedo: Range,
    /// Share of surfaces with a texture.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub textured: f64,
}

/// Glossy surfaces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GlossyRanges {
    /// GGX roughness alpha.
    #[schemars(inner(range(min = 0.0, max = 1.0)))]
    pub roughness: Range,
    /// Share of metals.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub metal: f64,
}

/// Refractive surfaces under broad light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RefractiveRanges {
    /// Index of refraction.
    #[schemars(inner(range(min = 1.01, max = 3.0)))]
    pub ior: Range,
    /// GGX roughness alpha of frosted glass.
    #[schemars(inner(range(min = 0.0, max = 1.0)))]
    pub roughness: Range,
    /// Share of scenes with a thin pane.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub panes: f64,
}

/// Glass, mirrors and small lights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CausticRanges {
    /// Index of refraction.
    #[schemars(inner(range(min = 1.01, max = 3.0)))]
    pub ior: Range,
    /// Share of mirrors among the specular objects.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub mirror: f64,
    /// Radius of the lights, metres.
    #[schemars(inner(range(min = 0.01, max = 1.0)))]
    pub emitter: Range,
}

impl Default for DiffuseRanges {
    fn default() -> Self {
        Self { albedo: [0.2, 0.8], textured: 0.7 }
    }
}

impl Default for GlossyRanges {
    fn default() -> Self {
        Self { roughness: [0.05, 0.4], metal: 0.5 }
    }
}

impl Default for RefractiveRanges {
    fn default() -> Self {
        Self { ior: [1.3, 1.7], roughness: [0.1, 0.4], panes: 0.35 }
    }
}

impl Default for CausticRanges {
    fn default() -> Self {
        Self { ior: [1.33, 1.8], mirror: 0.35, emitter: [0.03, 0.1] }
    }
}

impl Default for Ranges {
    fn default() -> Self {
        Self {
            library: 0,
            diffuse: DiffuseRanges::default(),
            textured_lights: 0.6,
            glossy: GlossyRanges::default(),
            refractive: RefractiveRanges::default(),
            caustic: CausticRanges::default(),
        }
    }
}
