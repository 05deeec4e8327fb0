#![doc = include_str!("quality_gate.md")]

mod framing;
mod picture;
mod things;

pub use crate::bins::geometric_mean_luminance;

use crate::{bins::KEY, world::World};
use framing::Framing;
use picture::{Picture, Preview};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{Action, Context, Digest, Each, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs};
use tauflow_data::{
    maths::exp2,
    records::{Exposure, Ladder, SceneRecord, Verdict},
};
use things::Things;

const SCENES: Each<SceneRecord> = Each::new("scenes", "The scenes to judge.");
const PREVIEWS: Each<Ladder> = Each::new("previews", "A ladder of each; its last rung is judged.");

const MAIN: Group = Group::main(5);
const ACCEPTED: Out<SceneRecord> = Out::new(MAIN, "accepted", "The scenes that passed.").filtering();
const EXPOSURE: Out<Exposure> = Out::new(MAIN, "exposure", "Exposure of the scenes that passed.").filtering();
const VERDICTS: Out<Verdict> = Out::new(MAIN, "verdicts", "What was measured, and every reason for rejection.");

/// Noise that hides nothing, added to that of the picture.
const GRAIN: f64 = 0.02;

/// The kind `quality_gate`.
pub struct QualityGate;

/// Params of `quality_gate`. A share of 1 rejects nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct QualityGateParams {
    /// Largest share of all directions in which the camera sees the inside of a body.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub inside: f64,
    /// What is nearer than this times the median distance of what is around is near.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub near: f64,
    /// Largest share of the frame that is near.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub near_share: f64,
    /// Largest share of the frame that shows no surface.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub sky_share: f64,
    /// Largest share of the frame that one smooth surface fills.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub surface_share: f64,
    /// Smallest mean luminance, in the scene's own radiance.
    #[schemars(range(min = 0.0))]
    pub black: f64,
    /// Largest share of dark bins.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub dark_share: f64,
    /// Display value below which a bin is dark, as the preview without the scene's EV shows it; mid grey is shown as
    /// 0.43.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub dark: f64,
    /// Largest share of bins that show white.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub bright_share: f64,
    /// Exposed luminance, without the scene's EV, from which a bin shows white; a preview shows 8 as 0.95.
    #[schemars(range(min = 0.0))]
    pub white: f64,
    /// Smallest standard deviation of the preview over bins; previews run from 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub contrast: f64,
    /// Smallest length of all edges in the preview, in sides of it: a horizon alone has 1.
    #[schemars(range(min = 0.0))]
    pub edges: f64,
    /// Largest share of light in the brightest 1% of the bins.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub concentration: f64,
    /// Largest share of bins whose standard error is above a quarter of what they show.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub noisy_share: f64,
    /// Least that stands out: contrast of the things that are seen nearly whole, over noise.
    #[schemars(range(min = 0.0))]
    pub to_see: f64,
    /// Luminance that the geometric mean over the bins is exposed to.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub key: f64,
}

impl Default for QualityGateParams {
    fn default() -> Self {
        Self {
            inside: 0.6,
            near: 0.1,
            near_share: 0.95,
            sky_share: 0.85,
            surface_share: 0.98,
            black: 1e-6,
            dark_share: 0.6,
            dark: 0.06,
            bright_share: 0.25,
            white: 8.0,
            contrast: 0.015,
            edges: 1.1,
            concentration: 0.97,
            noisy_share: 0.4,
            to_see: 0.17,
            key: KEY,
        }
    }
}

impl Kind for QualityGate {
    type Params = QualityGateParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "quality_gate",
            summary: "Rejects scenes that teach nothing, and sets the exposure of the others.",
            manual: include_str!("quality_gate.md"),
            mode: Mode::Map,
            inputs: vec![SCENES.port(), PREVIEWS.port()],
            outputs: vec![ACCEPTED.port(), EXPOSURE.port(), VERDICTS.port()],
            seeded: false,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let (scene, previews) = (action.handle(SCENES)?, action.handle(PREVIEWS)?);
        let recipe = SceneRecord::recipe(ctx, scene)?;
        let described = SceneRecord::scene(ctx, scene)?;
        let meta = Ladder::meta(ctx, previews)?;
        let last = *meta.counts.last().ok_or_else(|| KindError::Input("a preview without rungs".into()))?;
        let (image, variance) = (Ladder::rung(ctx, previews, last)?, Ladder::variance(ctx, previews)?);
        let preview = Preview { image: &image, variance: &variance, spp: last, rejected: meta.rejected };
        let world = World::new(&framing::bare(&described), &mut |digest: &Digest| ctx.get(digest))?;
        let film = [image.width(), image.height()];
        let framing = Framing::of(&world, &described, film, action.params.near)?;
        let things = Things::of(&world, &described, film)?;
        let (verdict, exposure) = judge(&preview, &framing, &things, recipe.exposure_ev, &action.params);
        let outputs = Outputs::default().put(VERDICTS, verdict.store(ctx)?);
        if !verdict.reasons.is_empty() {
            return Ok(outputs);
        }
        Ok(outputs.put(ACCEPTED, scene.to_stored()).put(EXPOSURE, exposure.store(ctx)?))
    }
}

fn named(measures: impl IntoIterator<Item = (&'static str, f64)>) -> BTreeMap<String, f64> {
    measures.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// Every reason for rejection, the most telling first: what explains others stands before them.
fn judge(
    of: &Preview<'_>,
    framing: &Framing,
    things: &Things,
    ev: f64,
    params: &QualityGateParams,
) -> (Verdict, Exposure) {
    let mut reasons = Vec::new();
    let mut reject = |so: bool, reason: &str| {
        if so {
            reasons.push(reason.to_owned());
        }
    };
    let broken = [of.image, of.variance].iter().flat_map(|i| i.data()).filter(|v| !v.is_finite()).count();
    reject(of.rejected > 0 || broken > 0, "non_finite");
    reject(framing.inside > params.inside, "inside");
    reject(framing.near_share > params.near_share, "too_near");
    reject(framing.sky_share > params.sky_share, "mostly_sky");
    reject(framing.surface_share > params.surface_share, "one_surface");
    let mut measures = named(framing.measures());
    measures.insert("rejected".to_owned(), of.rejected as f64);
    if broken > 0 {
        measures.insert("non_finite".to_owned(), broken as f64);
        return (Verdict { reasons, measures }, Exposure { factor: 1.0, ev, mean_luminance: 0.0 });
    }
    let picture = Picture::of(of, params.key, params.dark, params.white);
    let neutral = params.key / picture.geometric_mean;
    measures.extend(named(picture.measures(framing.outlines)));
    measures.insert(Verdict::EXPOSURE.to_owned(), neutral);
    if picture.mean <= params.black {
        reject(true, "black");
    } else {
        reject(picture.dark_share > params.dark_share, "dark");
        reject(picture.bright_share > params.bright_share, "over_exposed");
        reject(picture.contrast < params.contrast, "near_constant");
        reject(picture.edges_of(framing.outlines) < params.edges, "featureless");
        reject(picture.concentration > params.concentration, "degenerate");
        reject(picture.noisy_share > params.noisy_share, "noisy");
        let to_see = things.contrast(of.image, neutral) / (GRAIN + picture.noise);
        reject(to_see < params.to_see, "little_to_see");
        measures.insert("to_see".to_owned(), to_see);
    }
    let exposure = Exposure { factor: neutral * exp2(ev), ev, mean_luminance: picture.geometric_mean };
    (Verdict { reasons, measures }, exposure)
}

#[cfg(test)]
mod tests;
