//! Params of `scene_generation`, their checks, and which of them an item reads.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tauflow_contract::ParamProblem;
use tauflow_data::{ContextClass, Regime, Stratum, rng::Stream};
use tauflow_scene_library::{
    CausticRanges, DiffuseRanges, GlossyRanges, Range, Ranges, RefractiveRanges, variant_of_library,
};

/// Which assets are parted into train and test pools before scenes are built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HoldOut {
    /// Objects, procedural forms among them.
    Objects,
    /// Environments: HDRIs and procedural skies.
    Environments,
}

/// Params of `scene_generation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SceneGenerationParams {
    /// Number of scenes, divided as equally as possible over the strata. A larger number adds scenes and changes none.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub pool: u64,
    /// Minimum and maximum number of scenes per content, with different cameras, exposures and light.
    #[schemars(inner(range(min = 1, max = 64)))]
    pub views: [u32; 2],
    /// Regimes to generate.
    #[schemars(length(min = 1))]
    pub regimes: Vec<Regime>,
    /// Contexts to generate.
    #[schemars(length(min = 1))]
    pub contexts: Vec<ContextClass>,
    /// Assets to split into training and test pools.
    pub hold_out: Vec<HoldOut>,
    /// Library of procedural objects, skies and patterns; two libraries share none.
    #[schemars(range(min = 0, max = 1000))]
    pub library: u64,
    /// Share of contents, and of each held-out pool, for testing; read only with `hold_out`.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub test_share: f64,
    /// Minimum and maximum number of things in a scene. The number is drawn from this range, and limited by the space
    /// of the layout. Walls, doors and windows do not count.
    #[schemars(inner(range(min = 1, max = 200)))]
    pub objects: [u32; 2],
    /// Share of the exhibits of a scene (not its furniture) that are connected assets; the main object always is one.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub asset_share: f64,
    /// Exposure offset in stops.
    #[schemars(inner(range(min = -16.0, max = 16.0)))]
    pub exposure: Range,
    /// Horizontal field of view in degrees.
    #[schemars(inner(range(min = 5.0, max = 120.0)))]
    pub fov: Range,
    /// Maximum path length in segments, by context.
    pub max_depth: MaxDepth,
    /// Diffuse surfaces; read by all regimes.
    pub diffuse: DiffuseRanges,
    /// Share of lamps with an emission texture. Screens always show an image, and windows a part of a sky; 0 makes all
    /// uniform.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub textured_lights: f64,
    /// Glossy surfaces; read only by L1.
    pub glossy: GlossyRanges,
    /// Refractive surfaces under broad light; read only by L2.
    pub refractive: RefractiveRanges,
    /// Glass, mirrors and small lights; read only by L3.
    pub caustic: CausticRanges,
}

/// Maximum path length in segments, by context.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MaxDepth {
    /// Under an environment.
    #[schemars(range(min = 1, max = 1000))]
    pub environment: u32,
    /// In the open.
    #[schemars(range(min = 1, max = 1000))]
    pub open: u32,
    /// In rooms.
    #[schemars(range(min = 1, max = 1000))]
    pub enclosed: u32,
}

impl Default for SceneGenerationParams {
    fn default() -> Self {
        Self {
            pool: 120,
            views: [1, 6],
            regimes: Regime::ALL.to_vec(),
            contexts: ContextClass::ALL.to_vec(),
            hold_out: Vec::new(),
            library: 0,
            test_share: 0.2,
            objects: [5, 60],
            asset_share: 0.35,
            exposure: [-1.0, 1.0],
            fov: [35.0, 70.0],
            max_depth: MaxDepth::default(),
            diffuse: DiffuseRanges::default(),
            textured_lights: 0.6,
            glossy: GlossyRanges::default(),
            refractive: RefractiveRanges::default(),
            caustic: CausticRanges::default(),
        }
    }
}

impl Default for MaxDepth {
    fn default() -> Self {
        Self { environment: 8, open: 12, enclosed: 16 }
    }
}

impl SceneGenerationParams {
    /// The strata asked for, in their order, without repeats.
    pub fn strata(&self) -> Vec<Stratum> {
        Stratum::all().filter(|s| self.regimes.contains(&s.regime) && self.contexts.contains(&s.context)).collect()
    }

    /// How many scenes each stratum gets.
    pub fn counts(&self) -> Vec<(Stratum, u64)> {
        let strata = self.strata();
        let n = strata.len().max(1) as u64;
        strata.into_iter().zip(0..).map(|(s, i)| (s, self.pool / n + u64::from(i < self.pool % n))).collect()
    }

    /// One of `count` variants of this library.
    pub fn variant(&self, draw: &mut Stream, count: u64) -> u64 {
        variant_of_library(self.library, draw, count)
    }

    /// What materials are drawn from.
    pub fn ranges(&self) -> Ranges {
        Ranges {
            library: self.library,
            diffuse: self.diffuse.clone(),
            textured_lights: self.textured_lights,
            glossy: self.glossy.clone(),
            refractive: self.refractive.clone(),
            caustic: self.caustic.clone(),
        }
    }

    /// Longest path of a context.
    pub fn depth(&self, context: ContextClass) -> u32 {
        match context {
            ContextClass::Environment => self.max_depth.environment,
            ContextClass::Open => self.max_depth.open,
            ContextClass::Enclosed => self.max_depth.enclosed,
        }
    }

    /// Checks across fields: ranges out of order, and a held-out side without a share.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let mut out = Vec::new();
        for (pointer, [low, high]) in [
            ("/exposure", self.exposure),
            ("/fov", self.fov),
            ("/diffuse/albedo", self.diffuse.albedo),
            ("/glossy/roughness", self.glossy.roughness),
            ("/refractive/ior", self.refractive.ior),
            ("/refractive/roughness", self.refractive.roughness),
            ("/caustic/ior", self.caustic.ior),
            ("/caustic/emitter", self.caustic.emitter),
            ("/objects", self.objects.map(f64::from)),
            ("/views", self.views.map(f64::from)),
        ] {
            if low > high {
                out.push(ParamProblem::new(pointer, format!("[{low}, {high}] is out of order"), "write [low, high]"));
            }
        }
        if !self.hold_out.is_empty() && (self.test_share <= 0.0 || self.test_share >= 1.0) {
            out.push(ParamProblem::new(
                "/test_share",
                "with `hold_out`, both sides need a share",
                "choose a share between 0 and 1",
            ));
        }
        out
    }

    /// The params that a scene of `stratum` reads: never the pool, nor ranges of another regime or context.
    pub fn read_by(&self, stratum: Stratum) -> Value {
        let mut value = json!({
            "views": self.views,
            "objects": self.objects,
            "asset_share": self.asset_share,
            "exposure": self.exposure,
            "fov": self.fov,
            "max_depth": { stratum.context.to_string(): self.depth(stratum.context) },
            "diffuse": self.diffuse,
            "textured_lights": self.textured_lights,
            "library": self.library,
        });
        let fields = value.as_object_mut().expect("just made");
        if !self.hold_out.is_empty() {
            let mut hold_out = self.hold_out.clone();
            hold_out.sort_unstable();
            hold_out.dedup();
            fields.insert("hold_out".into(), json!(hold_out));
            fields.insert("test_share".into(), json!(self.test_share));
        }
        match stratum.regime {
            Regime::L0 => None,
            Regime::L1 => fields.insert("glossy".into(), json!(self.glossy)),
            Regime::L2 => fields.insert("refractive".into(), json!(self.refractive)),
            Regime::L3 => fields.insert("caustic".into(), json!(self.caustic)),
        };
        value
    }
}
