//! What the kinds share: the endpoint, its G-buffer, the images that come out, and their times.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{Action, Artifact, Context, KindError, Outputs};
use tauflow_data::{
    Image,
    formats::{JSON, PackedScene, RefinedImage, RefinedImages, store_refined},
    timing::{Repeated, TimedImage, Timing},
};

/// Group of the output ports that are measured.
pub(crate) const TIMING: &str = "timing";

/// What it sees beside the noisy image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Conditioning {
    /// Nothing.
    Rgb,
    /// Albedo and shading normal.
    #[default]
    Gbuffer,
}

/// Params without what only `timing` reads, in the other groups.
pub(crate) fn projected(params: &impl Serialize, group: &str) -> serde_json::Value {
    let mut value = serde_json::to_value(params).expect("plain data");
    if group != TIMING
        && let serde_json::Value::Object(fields) = &mut value
    {
        fields.remove("repeats");
    }
    value
}

/// The scene of an action.
pub(crate) fn scene<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<PackedScene, KindError> {
    Ok(PackedScene::from_bytes(&ctx.part(action.each("endpoints")?, "")?)?)
}

/// The rung of `from` samples.
pub(crate) fn endpoint(scene: &PackedScene, from: u64) -> Result<&Image, KindError> {
    let rung = scene.counts.iter().zip(&scene.states).find(|(count, _)| **count == from);
    rung.map(|(_, image)| image).ok_or_else(|| {
        KindError::Input(format!(
            "the scene has no rung of {from} samples, only {:?}; change `from` or the rungs",
            scene.counts
        ))
    })
}

/// The G-buffer, where it is asked for.
pub(crate) fn gbuffer(scene: &PackedScene, conditioning: Conditioning) -> Result<Option<&Image>, KindError> {
    match (conditioning, &scene.gbuffer) {
        (Conditioning::Rgb, _) => Ok(None),
        (Conditioning::Gbuffer, Some(gbuffer)) => Ok(Some(gbuffer)),
        (Conditioning::Gbuffer, None) => Err(KindError::Input(
            "`conditioning` is gbuffer and the scene has no G-buffer; connect `gbuffers` of its `dataset_packing`"
                .into(),
        )),
    }
}

/// What is said of an image made from the endpoint of `from` samples in one go.
pub(crate) fn said(method: &str, scene: &PackedScene, from: u64) -> RefinedImage {
    let to_spp = scene.counts.last().copied().unwrap_or(from);
    RefinedImage { method: method.to_owned(), from_spp: from, to_spp, nfe: 1 }
}

/// The port `refined`: one image, or none with a note that says why.
pub(crate) fn refined(ctx: &Context<'_>, images: RefinedImages, note: Option<String>) -> Result<Outputs, KindError> {
    Ok(Outputs::default().item("refined", store_refined(ctx, images, note, Vec::new())?))
}

/// The port `timing`: what `run` took, so many times after once that does not count. Where it tells its own seconds, of wall and
/// processor time, those.
pub(crate) fn timing(
    ctx: &Context<'_>,
    said: &RefinedImage,
    repeats: u64,
    mut run: impl FnMut() -> Result<Option<[f64; 2]>, KindError>,
) -> Result<Outputs, KindError> {
    let mut took = Repeated::default();
    run()?;
    for _ in 0..repeats {
        ctx.check_cancelled()?;
        if let Some([wall, cpu]) = took.add(&mut run)? {
            // A program of its own: what we do to hand images over is not its time.
            took.wall_s.pop();
            took.cpu_s.pop();
            took.wall_s.push(wall);
            took.cpu_s.push(cpu);
        }
    }
    let RefinedImage { method, from_spp, nfe, .. } = said.clone();
    let timing = Timing { entries: vec![TimedImage { method, from_spp, nfe, took }] };
    timings(ctx, &timing)
}

/// The port `timing` with these times.
pub(crate) fn timings(ctx: &Context<'_>, timing: &Timing) -> Result<Outputs, KindError> {
    Ok(Outputs::default().item("timing", Artifact::blob(JSON, ctx.put_json(timing)?)))
}
