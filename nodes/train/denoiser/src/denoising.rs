#![doc = include_str!("denoising.md")]

use crate::{
    built_in::Weights,
    denoiser::{Denoised, Denoiser, Settings},
    frame::Frame,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tauflow_contract::{
    Action, All, Any, Context, Each, Foreseen, Group, ItemKey, Kind, KindError, KindSpec, Known, Media, Mode, Out,
    Outlook, Outputs, Probe, Resources,
};
use tauflow_data::{
    facts::{self, NFE, PARAMETERIZATION, SPP},
    methods::{Conditioning, MethodName, Parameterization},
    records::{Exposure, ModelFile, PackedScene, Refined, RefinedImage, TimedImage, Timing, Variances},
    timing::{Repeated, measuring},
    views::Views,
};
use tauflow_train::Model;

/// The kind `denoising`.
pub struct Denoising;

/// The model of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The bundled one that is quick.
    Fast,
    /// The bundled one that is more accurate.
    #[default]
    Best,
    /// That of the input `model`.
    Connected,
}

impl Source {
    fn built_in(self) -> Option<Weights> {
        match self {
            Self::Fast => Some(Weights::Fast),
            Self::Best => Some(Weights::Best),
            Self::Connected => None,
        }
    }
}

/// Params of `denoising`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DenoisingParams {
    /// Name of the method in tables.
    pub method: MethodName,
    /// Bundled model, or the one on the input `model`.
    pub weights: Source,
    /// Additional input of the network: none (RGB), or G-buffers.
    pub conditioning: Conditioning,
    /// Sample count of the endpoint to denoise.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// Tell the network the sample count.
    pub tell_count: bool,
    /// Mix the noisy image into the result where its estimated error is smaller. From 2 samples on, this needs the
    /// inputs `variances` and `exposure`.
    pub mix: bool,
    /// Share of the denoised image in the result; 0 for the endpoint itself, as a baseline.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub strength: f64,
    /// Number of mirrored and rotated copies over which the call is averaged: 1, 2 (mirrored), 4 (also upside down) or
    /// 8 (also transposed).
    pub mirrors: Views,
    /// Number of measurements by `timing`.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

impl Default for DenoisingParams {
    fn default() -> Self {
        Self {
            method: MethodName::try_from("tauflow".to_owned()).expect("a name"),
            weights: Source::Best,
            conditioning: Conditioning::Gbuffer,
            from: 1,
            tell_count: false,
            mix: false,
            strength: 1.0,
            mirrors: Views::ONE,
            repeats: 3,
        }
    }
}

const ENDPOINTS: Each<PackedScene> = Each::new("endpoints", "The scenes whose endpoints are denoised.");
const VARIANCES: Each<Variances> =
    Each::new("variances", "The variances of the same ladders, for `mix`: `variances` of `ladder_rendering`.")
        .or_none();
const EXPOSURE: Each<Exposure> = Each::new("exposure", "The exposure of the same scenes, for `mix`.").or_none();
const MODEL: All<ModelFile> =
    All::new("model", "A solver in place of the bundled one: at most one.").single().or_none();
const AFTER: Each<Any> =
    Each::any("after", "Completed before `timing` measures, so that methods take turns.").or_none();

/// Problems of `weights` and `model`, and their remedies.
const UNUSED: (&str, &str) = ("a model is connected, but `weights` names a bundled one", "set `weights: connected`");
const UNCONNECTED: (&str, &str) =
    ("`weights: connected` needs a model on the input `model`", "connect one, or set `weights: best`");

const MAIN: Group = Group::main(5);
const MEASURED: Group = Group::new("timing", 3);
const REFINED: Out<Refined> = Out::new(MAIN, "refined", "The denoised image.");
const TIMING: Out<Timing> = Out::new(MEASURED, "timing", "Wall time on all cores.").measured();

impl Kind for Denoising {
    type Params = DenoisingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "denoising",
            summary: "Denoises endpoints with the bundled denoiser.",
            manual: include_str!("denoising.md"),
            mode: Mode::Map,
            inputs: vec![ENDPOINTS.port(), VARIANCES.port(), EXPOSURE.port(), MODEL.port(), AFTER.port()],
            outputs: vec![REFINED.port(), TIMING.port()],
            seeded: false,
        }
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let endpoints = known.each(ENDPOINTS);
        let mut problems: Vec<_> = facts::rung(&endpoints, params.from, "/from").into_iter().collect();
        if params.mixes() {
            let variances = known.each(VARIANCES);
            problems.extend(facts::rung(&variances, params.from, "/from"));
            problems.extend(facts::same_film(VARIANCES, &variances, &endpoints));
            let lacks = |port: &str| (!known.has(port)).then(|| Foreseen::param("/mix", unmixed(port), CONNECT));
            problems.extend([VARIANCES.name(), EXPOSURE.name()].into_iter().find_map(lacks));
        }
        if params.needs_independent().is_some() {
            problems.extend(facts::independent(ENDPOINTS, &endpoints));
        }
        problems.extend(facts::gbuffer(ENDPOINTS, &endpoints, params.conditioning));
        match (params.weights.built_in().is_some(), known.has(MODEL.name())) {
            (true, true) => problems.push(Foreseen::param("/weights", UNUSED.0, UNUSED.1)),
            (false, false) => problems.push(Foreseen::param("/weights", UNCONNECTED.0, UNCONNECTED.1)),
            _ => {}
        }
        for model in known.all(MODEL) {
            if let Some(found) = model.facts.get(PARAMETERIZATION).filter(|found| *found != Parameterization::McNoise) {
                let message = format!("`{}` has the parameterization `{}`", model.name, found.name());
                problems.push(Foreseen::input(MODEL, message, "connect a model of `mc_noise`"));
            }
        }
        let facts = facts::image_of(&endpoints.facts).with(SPP, vec![params.from]).with(NFE, vec![1]);
        Outlook::default().with(REFINED, facts).but(problems)
    }

    fn work(params: &Self::Params, group: &str) -> f64 {
        let rounds = if group == MEASURED.name { params.repeats + 1 } else { 1 };
        let calls = u64::from(params.mirrors) * if params.mixes() { 2 } else { 1 };
        calls as f64 * rounds as f64
    }

    fn resources(_params: &Self::Params, _group: &str) -> Resources {
        Resources::default().cores(2).memory(2 << 30)
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        let mut value = serde_json::to_value(params).expect("plain data");
        if let Value::Object(fields) = &mut value
            && group != MEASURED.name
        {
            fields.remove("repeats");
        }
        value
    }

    fn environment(params: &Self::Params, group: &str, probe: &dyn Probe) -> Option<Value> {
        // A program with other bundled weights denoises anew.
        let digest = |weights: Weights| blake3::hash(weights.bytes(params.conditioning)).to_hex().to_string();
        let weights = params.weights.built_in().map(digest);
        Some(match (weights, group == MEASURED.name) {
            (weights, true) => json!({ "weights": weights, "machine": measuring(probe) }),
            (Some(weights), false) => json!({ "weights": weights }),
            (None, false) => Value::Null,
        })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let denoiser = match (params.weights.built_in(), action.only_if(MODEL)?) {
            (Some(weights), None) => Denoiser::of(weights.model(params.conditioning)?),
            (None, Some(model)) => Denoiser::of(Model::load(&model.load(ctx)?.0)?),
            (Some(_), Some(_)) => {
                return Err(KindError::Input(format!("{}; {}", UNUSED.0, UNUSED.1)));
            }
            (None, None) => {
                return Err(KindError::Input(format!("{}; {}", UNCONNECTED.0, UNCONNECTED.1)));
            }
        };
        let scene = action.read(ctx, ENDPOINTS)?;
        if let Some(param) = params.needs_independent().filter(|_| !scene.sampler.is_independent()) {
            return Err(KindError::Input(format!(
                "`{param}: true` needs independent samples, but those of the endpoints are correlated; set `{param}: \
                 false`, or render with `sampler: independent`"
            )));
        }
        let (mut frame, settings) = (params.frame(&scene)?, params.settings());
        if params.mixes() {
            let lacks = |port: &str| KindError::Input(format!("{}; {CONNECT}", unmixed(port)));
            let variances = action.handle_if(VARIANCES)?.ok_or_else(|| lacks(VARIANCES.name()))?;
            let exposure = action.read_if(ctx, EXPOSURE)?.ok_or_else(|| lacks(EXPOSURE.name()))?.factor;
            // That of the mean, as exposed.
            let factor = exposure * exposure / params.from as f64;
            let variance = Variances::of(ctx, variances, params.from)?;
            let variance = variance.map(|value| (f64::from(value) * factor) as f32);
            frame = frame.with_variance(variance, Some(params.from))?;
        }
        if action.group == MEASURED.name {
            let timing = timed(ctx, &denoiser, &frame, params)?;
            return Ok(Outputs::default().put(TIMING, timing.store(ctx)?));
        }
        let Denoised { image, .. } = denoiser.denoise(&frame, &settings, &mut |_, _| ctx.check_cancelled())?;
        let said = RefinedImage {
            method: params.method.as_str().to_owned(),
            from_spp: params.from,
            to_spp: *scene.counts.last().unwrap_or(&params.from),
            nfe: 1,
        };
        Ok(Outputs::default()
            .put(REFINED, Refined { images: vec![(said, image)], note: None, sampler: scene.sampler }.store(ctx)?))
    }
}

impl DenoisingParams {
    /// Whether there is a mix: the variance of one sample is not known.
    fn mixes(&self) -> bool {
        self.mix && self.from > 1
    }

    /// The param, if there is one, that takes a sample count for the noise of as many independent samples.
    fn needs_independent(&self) -> Option<&'static str> {
        self.mixes().then_some("mix").or(self.tell_count.then_some("tell_count"))
    }

    fn settings(&self) -> Settings {
        // Endpoints are exposed.
        let spp = self.tell_count.then_some(self.from);
        Settings { spp, exposure: Some(1.0), strength: self.strength, views: self.mirrors, ..Settings::default() }
    }

    fn frame(&self, scene: &PackedScene) -> Result<Frame, KindError> {
        let rung = |spp: u64| {
            scene.counts.iter().position(|n| *n == spp).map(|i| &scene.states[i]).ok_or_else(|| {
                let counts = &scene.counts;
                KindError::Input(format!("the scene has no rung of {spp} samples, only {counts:?}; change the rungs"))
            })
        };
        let noisy = rung(self.from)?;
        let mut frame = Frame::new(noisy.clone())?;
        if self.conditioning == Conditioning::Gbuffer {
            let gbuffer = scene.gbuffer.clone().ok_or_else(|| {
                let told = "the scene has no G-buffer; connect `gbuffers` of its `dataset_packing`, or set \
                            `conditioning: rgb`";
                KindError::Input(told.into())
            })?;
            frame = frame.with_gbuffer(gbuffer)?;
        }
        Ok(frame)
    }
}

/// Why there is no mix.
fn unmixed(port: &str) -> String {
    format!("`mix: true` needs the variance of each pixel, but `{port}` is not connected")
}

const CONNECT: &str =
    "connect `variances` of the node that rendered the ladders, and `exposure` of their `quality_gate`";

/// One warm-up, then the measurements.
fn timed(ctx: &Context<'_>, denoiser: &Denoiser, frame: &Frame, params: &DenoisingParams) -> Result<Timing, KindError> {
    let settings = params.settings();
    let denoise = || denoiser.denoise(frame, &settings, &mut |_, _| ctx.check_cancelled());
    denoise()?;
    let mut took = Repeated::default();
    for done in 0..params.repeats {
        took.add(denoise)?;
        ctx.progress(done + 1, params.repeats, "rounds");
    }
    let entry = TimedImage { method: params.method.as_str().to_owned(), from_spp: params.from, nfe: 1, took };
    Ok(Timing::here(vec![entry]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{collections::BTreeMap, sync::atomic::AtomicBool};
    use tauflow_contract::{KindRow, MemoryBlobs, NodeKind as _, Silent};
    use tauflow_data::Image;
    use tauflow_data::rng::Stream;

    fn scene() -> PackedScene {
        let mut stream = Stream::new(3, &[]);
        let mut sum = vec![0.0f64; 32 * 24 * 3];
        let mut states = Vec::new();
        for n in 1..=8u32 {
            sum.iter_mut().for_each(|sum| *sum += -(1.0 - stream.uniform()).ln());
            if n.is_power_of_two() {
                let data = sum.iter().map(|sum| (sum / f64::from(n)) as f32).collect();
                states.push(Image::from_data(32, 24, 3, data).expect("fits"));
            }
        }
        let wall = [0.5, 0.5, 0.5, 0.0, 0.0, 1.0].repeat(32 * 24);
        let gbuffer = Image::from_data(32, 24, 6, wall).expect("fits");
        PackedScene { counts: vec![1, 2, 4, 8], states, gbuffer: Some(gbuffer), sampler: Default::default() }
    }

    fn run(params: Value) -> Result<Image, KindError> {
        let params: DenoisingParams = serde_json::from_value(params).expect("params");
        let (blobs, cancel) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &cancel);
        let scene = scene().store(&ctx)?.into_artifact();
        // The samples have a variance of 1.
        let one = Image::from_data(32, 24, 3, vec![1.0; 32 * 24 * 3])?;
        let variances = Variances { rungs: vec![(4, one)] }.store(&ctx)?.into_artifact();
        let exposure = Exposure { factor: 1.0, ev: 0.0, mean_luminance: 1.0 }.store(&ctx)?.into_artifact();
        let mut each = BTreeMap::from([("endpoints", &scene)]);
        if params.mix {
            each.extend([("variances", &variances), ("exposure", &exposure)]);
        }
        let action = Action { params, item: None, group: "main", seed: 0, each, all: BTreeMap::new() };
        let outputs = Denoising::run(&ctx, &action)?;
        let refined = outputs.items.get("refined").expect("one").clone();
        Ok(Refined::load(&ctx, &refined)?.images.remove(0).1)
    }

    #[test]
    fn endpoints_are_denoised_and_what_lacks_is_told() {
        let error = |image: &Image| image.data().iter().map(|v| f64::from(v - 1.0).powi(2)).sum::<f64>();
        let noisy = error(&scene().states[2]);
        for conditioning in ["rgb", "gbuffer"] {
            let denoised =
                run(json!({ "from": 4, "conditioning": conditioning, "weights": "fast" })).expect("denoised");
            assert!(error(&denoised) < 0.5 * noisy, "{conditioning}: {} {noisy}", error(&denoised));
        }
        let told = |params: Value, part: &str| {
            let error = run(params).expect_err("cannot be").to_string();
            assert!(error.contains(part), "{error}");
        };
        let mixed = run(json!({ "from": 4, "mix": true, "weights": "fast" })).expect("mixed");
        assert!(error(&mixed) < 0.5 * noisy, "{} {noisy}", error(&mixed));
        told(json!({ "from": 16 }), "no rung of 16");
        told(json!({ "from": 8, "mix": true }), "variance/00000008");
        told(json!({ "weights": "connected" }), "needs a model");
        let row = KindRow::<Denoising>::new();
        let params = row.resolve(&json!({ "repeats": 5 })).expect("fine params");
        assert!(row.projection(&params)(None, MAIN.name).get("repeats").is_none());
        assert!(row.projection(&params)(None, MEASURED.name).get("repeats").is_some());
    }
}
