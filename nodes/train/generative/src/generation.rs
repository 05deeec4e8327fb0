#![doc = include_str!("generation.md")]

use crate::{
    adapter::{Adapter, AdapterInfo, Residuals},
    backbone::Backbone,
    course::{Course, Injection, Way},
};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    sync::atomic::{AtomicU64, Ordering},
};
use tauflow_contract::{
    Action, All, Basis, Context, Digest, Group, ItemKey, Kind, KindError, KindSpec, Media, MemoKey, Mode, Out, Outputs,
    ParamProblem, Stored,
};
use tauflow_data::{
    methods::MethodName,
    records::{AdapterFile, BackboneFiles, Family, Generated, Variant},
    rng::mix,
};

/// Raised with every change of what a sample is: samples that were kept do not count then.
const VERSION: u32 = 2;

/// Samples are made side by side up to this many pixels of a side; larger ones fill a processor by themselves.
const SMALL: usize = 64;

/// The kind `generation`.
pub struct Generation;

/// Params of `generation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GenerationParams {
    /// Number of samples per backbone; 0 generates none.
    #[schemars(range(max = 100_000))]
    pub samples: u64,
    /// Strength of the correction.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub eta: f64,
    /// Fraction of the steps that run without a correction.
    #[schemars(range(min = 0.0, max = 0.99))]
    pub start: f64,
    /// Steps of a DDPM.
    #[schemars(range(min = 1, max = 1000))]
    pub ddpm_steps: usize,
    /// Steps of a Rectified Flow.
    #[schemars(range(min = 1, max = 1000))]
    pub rectified_flow_steps: usize,
    /// Side of the images in pixels. Default: the configuration of the backbone.
    #[schemars(range(min = 8, max = 1024))]
    pub side: Option<usize>,
    /// Variants to compute in addition to `frozen`.
    pub variants: Vec<Variant>,
    /// Number of intermediate states to store per sample, evenly spaced from the noise to the image.
    #[schemars(range(min = 0, max = 100))]
    pub frames: u64,
}

impl Default for GenerationParams {
    fn default() -> Self {
        Self {
            samples: 100,
            eta: 0.05,
            start: 0.5,
            ddpm_steps: 100,
            rectified_flow_steps: 32,
            side: None,
            variants: Variant::ALL[1..].to_vec(),
            frames: 5,
        }
    }
}

const BACKBONES: All<BackboneFiles> = All::new("backbones", "The frozen backbones.");
const ADAPTERS: All<AdapterFile> =
    All::new("adapters", "Adapters of these backbones: trained on renders, or controls.").or_none();
const SAMPLES: Out<Generated> = Out::new(Group::main(VERSION), "samples", "Each sample, in all its variants.");

impl Kind for Generation {
    type Params = GenerationParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "generation",
            summary: "Samples from frozen generative backbones, with and without transport adapters.",
            manual: include_str!("generation.md"),
            mode: Mode::Gather,
            inputs: vec![BACKBONES.port(), ADAPTERS.port()],
            outputs: vec![SAMPLES.port()],
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut sorted = params.variants.clone();
        sorted.sort_unstable();
        sorted.dedup();
        if sorted.len() == params.variants.len() {
            return Vec::new();
        }
        vec![ParamProblem::new("/variants", "a variant is named twice", "name each once")]
    }

    fn work(params: &Self::Params, _group: &str) -> f64 {
        let ways = (1 + params.variants.len()) as f64;
        params.samples as f64 * (params.ddpm_steps + params.rectified_flow_steps) as f64 * ways
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let backbones = action.all(BACKBONES)?;
        let mut adapters: BTreeMap<(Digest, Residuals), (Digest, Adapter)> = BTreeMap::new();
        for (key, handle) in action.all_if(ADAPTERS)?.iter().flat_map(|all| all.iter()) {
            let adapter = Adapter::load(&handle.load(ctx)?.0)?;
            let of = (adapter.info().backbone, adapter.info().residuals);
            if adapters.insert(of, (handle.artifact().digest(), adapter)).is_some() {
                return Err(KindError::Input(format!(
                    "there are two adapters of residuals `{}` for one backbone, the second is `{key}`; connect one",
                    of.1.name()
                )));
            }
        }
        if backbones.is_empty() {
            return Err(KindError::Input("there are no backbones; train some, or name folders of checkpoints".into()));
        }
        let total = backbones.len() as u64 * params.samples;
        let (mut items, done) = (BTreeMap::new(), AtomicU64::new(0));
        for (key, handle) in backbones.iter() {
            let name = key.as_str().rsplit('/').next().unwrap_or_default();
            let backbone = Backbone::load(&handle.load(ctx)?)?;
            let digest = handle.artifact().digest();
            let own = adapters.iter().filter(|((of, _), _)| *of == digest);
            let own = own.map(|((_, residuals), (digest, adapter))| (*residuals, *digest, adapter)).collect();
            let session = Session { ctx, params, seed: action.seed, name, backbone, digest, adapters: own };
            for (sample, stored) in session.samples(|| {
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                ctx.progress(done, total, &format!("samples of {name}"));
            })? {
                let key = ItemKey::new(format!("{name}-{sample:04}")).map_err(|e| KindError::Input(e.to_string()))?;
                if items.insert(key, stored).is_some() {
                    return Err(KindError::Input(format!("two backbones are called `{name}`; rename one's folder")));
                }
            }
        }
        Ok(Outputs::default().put_all(SAMPLES, items))
    }
}

/// The sampling of one backbone.
struct Session<'a> {
    ctx: &'a Context<'a>,
    params: &'a GenerationParams,
    seed: u64,
    name: &'a str,
    backbone: Backbone,
    digest: Digest,
    adapters: Vec<(Residuals, Digest, &'a Adapter)>,
}

impl Session<'_> {
    fn steps(&self) -> usize {
        match self.backbone.family() {
            Family::Ddpm => self.params.ddpm_steps,
            Family::RectifiedFlow => self.params.rectified_flow_steps,
        }
    }

    fn adapter(&self, residuals: Residuals) -> Option<&Adapter> {
        self.adapters.iter().find(|(its, ..)| *its == residuals).map(|(_, _, adapter)| *adapter)
    }

    /// Makes all samples, each kept as soon as it is made.
    fn samples(&self, tell: impl Fn() + Sync) -> Result<Vec<(u64, Stored<Generated>)>, KindError> {
        let side = self.params.side.or_else(|| self.backbone.config().side()).ok_or_else(|| {
            KindError::Input(format!("backbone `{}` does not say the size of its images; set `side`", self.name))
        })?;
        if side > 1024 {
            return Err(KindError::Input(format!(
                "backbone `{}` makes images of {side} pixels; set `side`",
                self.name
            )));
        }
        // Without an adapter of rendering, its clean images are what training would have asked for.
        let info = self.adapter(Residuals::Rendered).map_or_else(
            || AdapterInfo {
                backbone: self.digest,
                family: self.backbone.family(),
                residuals: Residuals::Rendered,
                clamp_clean: true,
                counts: Vec::new(),
                steps: 0,
            },
            |adapter| adapter.info().clone(),
        );
        let untrained = Adapter::untrained(info, self.seed);
        let injection = |eta| Injection { eta, start: self.params.start };
        let way = |variant: Variant| {
            let (adapter, eta) = match variant {
                Variant::Frozen => return Some(Way { variant, adapter: None }),
                Variant::Adapted => (self.adapter(Residuals::Rendered)?, self.params.eta),
                Variant::EtaZero => (self.adapter(Residuals::Rendered)?, 0.0),
                Variant::UntrainedAdapter => (&untrained, self.params.eta),
                Variant::ShuffledResiduals => (self.adapter(Residuals::Shuffled)?, self.params.eta),
                Variant::GaussianResiduals => (self.adapter(Residuals::Gaussian)?, self.params.eta),
            };
            Some(Way { variant, adapter: Some((adapter, injection(eta))) })
        };
        let wanted = Variant::ALL.into_iter().filter(|v| *v == Variant::Frozen || self.params.variants.contains(v));
        let ways: Vec<Way<'_>> = wanted.filter_map(way).collect();
        let make = |sample: u64| -> Result<(u64, Stored<Generated>), KindError> {
            self.ctx.check_cancelled()?;
            let made = self.sample(sample, side, &ways)?;
            tell();
            Ok((sample, made))
        };
        let all = 0..self.params.samples;
        if side <= SMALL { all.into_par_iter().map(make).collect() } else { all.map(make).collect() }
    }

    /// What decides a sample.
    fn key(&self, sample: u64, side: usize, ways: &[Way<'_>]) -> MemoKey {
        let variants: Vec<Variant> = ways.iter().map(|way| way.variant).collect();
        let params = json!({
            "backbone": self.name,
            "sample": sample,
            "side": side,
            "steps": self.steps(),
            "eta": self.params.eta,
            "start": self.params.start,
            "frames": self.params.frames,
            "variants": serde_json::to_value(variants).unwrap_or(Value::Null),
        });
        let mut inputs = vec![self.digest];
        inputs.extend(self.adapters.iter().map(|(_, digest, _)| *digest));
        MemoKey { basis: Basis::new("generation", VERSION, "sample").with(params, Some(self.seed)), inputs }
    }

    fn sample(&self, sample: u64, side: usize, ways: &[Way<'_>]) -> Result<Stored<Generated>, KindError> {
        let key = self.key(sample, side, ways);
        let kept = self.ctx.memo_get(&key).and_then(|artifact| {
            // A sample that cannot be read is made again.
            Generated::load(self.ctx, &artifact).ok()
        });
        if let Some(kept) = kept {
            return kept.store(self.ctx);
        }
        let steps = self.steps();
        let frame = |i: u64| (i * steps as u64).div_euclid((self.params.frames - 1).max(1));
        // Every backbone has noise of its own.
        let seed = self.name.bytes().fold(mix(self.seed, self.name.len() as u64), |seed, b| mix(seed, u64::from(b)));
        let mut frames: Vec<u64> = (0..self.params.frames).map(frame).collect();
        frames.dedup();
        let sampler = self.backbone.sampler(steps);
        if self.backbone.family() == Family::Ddpm && !self.divides(steps) {
            return Err(KindError::Input(format!(
                "`ddpm_steps` is {steps}, more than the times of backbone `{}`; use fewer",
                self.name
            )));
        }
        let course = Course { backbone: &self.backbone, sampler, seed, sample, side, frames };
        let variants = course.run(ways, || ())?;
        let name = MethodName::new(self.name).map_err(|e| KindError::Input(e.to_string()))?;
        let family = self.backbone.family();
        let generated = Generated { backbone: name, family, sample, steps: steps as u64, variants };
        let stored = generated.store(self.ctx)?;
        self.ctx.memo_put(&key, stored.artifact())?;
        Ok(stored)
    }

    /// Whether a sampler of so many steps has a time for each.
    fn divides(&self, steps: usize) -> bool {
        match self.backbone.sampler(steps) {
            crate::schedule::Sampler::Ddpm { schedule, .. } => steps <= schedule.times(),
            crate::schedule::Sampler::Euler { .. } => true,
        }
    }
}
