#![doc = include_str!("ladder_rendering.md")]

use crate::{
    accumulator::Accumulator,
    choices::Choices,
    gbuffer::GBufferSurface,
    render::{Renderer, SharedPlan},
    until::Until,
    world::World,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    cell::OnceCell,
    collections::{BTreeMap, btree_map::Entry},
};
use tauflow_contract::{
    Action, All, Any, Artifact, Basis, Before, Context, Digest, Each, Facts, Group, Handle, ItemKey, Kind, KindError,
    KindSpec, Known, Later, Media, MemoKey, Mode, Out, Outlook, Outputs, ParamProblem, Probe, Resources, Stored,
    leave_out,
};
use tauflow_data::{
    IntegratorKind, Resolution, Rungs, SamplerKind,
    facts::{FILM, INDEPENDENT, RUNGS},
    methods::{self, PATH_TRACER},
    records::{GBuffer, Ladder, LadderMeta, SceneRecord, TimedImage, Timing, Variances},
    timing::{Repeated, measuring},
};

const NAME: &str = "ladder_rendering";
const LADDERS: Group = Group::new("ladder", 6);
const GBUFFERS: Group = Group::new("gbuffer", 6);
const TIMINGS: Group = Group::new("timing", 7);
const VARIANCES: Group = Group::new("variances", 1);
/// Version of what is remembered of renders: goes up with that of [`LADDERS`] when any image changes.
const MEMO_VERSION: u32 = 6;

const SCENES: Each<SceneRecord> = Each::new("scenes", "The scenes to render.");
const AFTER: All<Any> = All::any("after", "Completed before `timing` measures.").or_none();
const LADDER: Out<Ladder> = Out::new(LADDERS, "ladder", "The rungs, and the variance of samples.");
const GBUFFER: Out<GBuffer> = Out::new(GBUFFERS, "gbuffer", "Albedo and normal at the first surface.");
const VARIANCE: Out<Variances> =
    Out::new(VARIANCES, "variances", "The variance of single samples at each rung, from its own samples.");
const TIMING: Out<Timing> = Out::new(TIMINGS, "timing", "Wall time to reach each rung, on all cores.").measured();

/// Params that came later, with what acted before.
const LATER: &[Later] = &[
    Later { pointer: "/until", before: Before::Null },
    Later { pointer: "/until/paths", before: Before::Integer(0) },
    Later { pointer: "/until/samples", before: Before::Integer(64) },
    Later { pointer: "/integrator", before: Before::Text("path") },
    Later { pointer: "/gbuffer_surface", before: Before::Text("first") },
    Later { pointer: "/choices", before: Before::Text("fixed") },
];

/// Points of a sequence: a sample's index has 32 bits.
const MOST_SOBOL: u64 = 1 << 32;

/// The cached state of a render after a number of samples, from which other ladders continue.
#[derive(Clone, Copy)]
enum Memo {
    /// The image.
    Rung,
    /// The variance of samples.
    Variance,
    /// The state, which more samples can be added to.
    Accumulator,
}

impl Memo {
    /// Media type of all.
    const MEDIA: &str = "tauflow/render-state";

    const fn name(self) -> &'static str {
        match self {
            Self::Rung => "rung",
            Self::Variance => "variance",
            Self::Accumulator => "accumulator",
        }
    }
}

/// The kind `ladder_rendering`.
pub struct LadderRendering;

/// Params of `ladder_rendering`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LadderRenderingParams {
    /// Sample counts of the rungs: `{dyadic: 256}` for 1, 2, 4 ... 256, or an increasing list.
    pub rungs: Rungs,
    /// Width and height in pixels.
    pub resolution: Resolution,
    /// Random stream: ladders of the same stream share samples, and ladders of different streams are independent.
    pub stream: u64,
    /// Sampler of random numbers.
    pub sampler: SamplerKind,
    /// Estimator of radiance: the path tracer, or also paths from the lights.
    pub integrator: IntegratorKind,
    /// How lobes of `principled` materials and lights are chosen.
    pub choices: Choices,
    /// Samples per pixel of the G-buffer.
    #[schemars(range(min = 1, max = 65536))]
    pub gbuffer_samples: u64,
    /// Surface that the G-buffer describes.
    pub gbuffer_surface: GBufferSurface,
    /// Number of times that `timing` renders the ladder.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
    /// Continue after the last of `rungs` until the image has this accuracy.
    pub until: Option<Until>,
}

impl Default for LadderRenderingParams {
    fn default() -> Self {
        Self {
            rungs: Rungs::dyadic(256).expect("a power of two"),
            resolution: Resolution::new(256, 256).expect("sides that can be rendered"),
            stream: 0,
            sampler: SamplerKind::Independent,
            integrator: IntegratorKind::Path,
            choices: Choices::default(),
            gbuffer_samples: 32,
            gbuffer_surface: GBufferSurface::First,
            repeats: 3,
            until: None,
        }
    }
}

impl Kind for LadderRendering {
    type Params = LadderRenderingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: NAME,
            summary: "Renders nested sample ladders of scenes by path tracing.",
            manual: include_str!("ladder_rendering.md"),
            mode: Mode::Map,
            inputs: vec![SCENES.port(), AFTER.port()],
            outputs: vec![LADDER.port(), GBUFFER.port(), VARIANCE.port(), TIMING.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if params.sampler == SamplerKind::Sobol && params.rungs.last() > MOST_SOBOL {
            return vec![ParamProblem::new(
                "/rungs",
                format!("more samples than the {MOST_SOBOL} points of a Sobol' sequence"),
                "end at one of these, or use `sampler: independent`",
            )];
        }
        params.until.iter().flat_map(|until| until.check(params.rungs.last(), params.sampler)).collect()
    }

    fn foresee(params: &Self::Params, _known: &Known) -> Outlook {
        let film = [params.resolution.width(), params.resolution.height()];
        let facts = Facts::default().with(FILM, film).with(INDEPENDENT, params.sampler.is_independent());
        // A ladder that ends by itself may have more rungs.
        let rungs = params.until.is_none().then(|| params.rungs.counts().to_vec());
        let gbuffer = Facts::default().with(FILM, film);
        let variances = facts.clone().with(RUNGS, params.rungs.counts().to_vec());
        let ladder = facts.with_some(RUNGS, rungs);
        Outlook::default().with(LADDER, ladder).with(GBUFFER, gbuffer).with(VARIANCE, variances)
    }

    fn work(params: &Self::Params, group: &str) -> f64 {
        let pixels = (params.resolution.width() * params.resolution.height()) as f64;
        let samples = if group == GBUFFERS.name { params.gbuffer_samples } else { params.rungs.last() };
        let rounds = if group == TIMINGS.name { params.repeats + 1 } else { 1 };
        pixels * samples as f64 * rounds as f64
    }

    fn resources(params: &Self::Params, _group: &str) -> Resources {
        let pixels = (params.resolution.width() * params.resolution.height()) as u64;
        let rungs = params.rungs.counts().len() as u64;
        // Scenes of files may be large, and are not known here.
        Resources::default().cores(2).memory((1 << 30) + pixels * (512 + 64 * rungs))
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        let LadderRenderingParams { rungs, resolution, stream, sampler, integrator, choices, repeats, until, .. } =
            params;
        let (gbuffer_samples, gbuffer_surface) = (params.gbuffer_samples, params.gbuffer_surface);
        if group == TIMINGS.name {
            // A ladder that ends by itself is timed to the last rung that is asked for in any case.
            json!({ "rungs": rungs, "resolution": resolution, "stream": stream, "sampler": sampler,
                "integrator": integrator, "choices": choices, "gbuffer_samples": gbuffer_samples,
                "gbuffer_surface": gbuffer_surface, "repeats": repeats })
        } else if group == GBUFFERS.name {
            json!({ "resolution": resolution, "stream": stream, "gbuffer_samples": gbuffer_samples,
                "gbuffer_surface": gbuffer_surface })
        } else if group == VARIANCES.name {
            // As with times: those of the rungs that are asked for in any case.
            json!({ "rungs": rungs, "resolution": resolution, "stream": stream, "sampler": sampler,
                "integrator": integrator, "choices": choices })
        } else {
            json!({ "rungs": rungs, "resolution": resolution, "stream": stream, "sampler": sampler,
                "integrator": integrator, "choices": choices, "until": until })
        }
    }

    fn later() -> &'static [Later] {
        LATER
    }

    fn environment(_params: &Self::Params, group: &str, probe: &dyn Probe) -> Option<Value> {
        Some(if group == TIMINGS.name { measuring(probe) } else { Value::Null })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let work = SceneRender {
            ctx,
            scene: action.handle(SCENES)?,
            params: &action.params,
            // A G-buffer draws no lights, and no lobes of `principled`.
            choices: if action.group == GBUFFERS.name { Choices::Fixed } else { action.params.choices },
            world: OnceCell::new(),
            plan: SharedPlan::default(),
        };
        let outputs = Outputs::default();
        if action.group == TIMINGS.name {
            Ok(outputs.put(TIMING, work.timing()?.store(ctx)?))
        } else if action.group == GBUFFERS.name {
            Ok(outputs.put(GBUFFER, work.gbuffer()?.store(ctx)?))
        } else if action.group == VARIANCES.name {
            Ok(outputs.put(VARIANCE, work.variances()?))
        } else {
            Ok(outputs.put(LADDER, work.ladder()?))
        }
    }
}

/// One scene to render.
struct SceneRender<'a> {
    ctx: &'a Context<'a>,
    scene: Handle<'a, SceneRecord>,
    params: &'a LadderRenderingParams,
    choices: Choices,
    world: OnceCell<World>,
    plan: SharedPlan,
}

impl SceneRender<'_> {
    fn new_world(&self) -> Result<World, KindError> {
        let scene = SceneRecord::scene(self.ctx, self.scene)?;
        let world = World::new(&scene, &mut |digest: &Digest| self.ctx.get(digest))?;
        Ok(world.with_choices(self.choices))
    }

    /// The world, made when it is first asked for.
    fn world(&self) -> Result<&World, KindError> {
        if let Some(world) = self.world.get() {
            return Ok(world);
        }
        let world = self.new_world()?;
        Ok(self.world.get_or_init(|| world))
    }

    fn renderer<'w>(&self, world: &'w World, stream: u64, plan: &SharedPlan) -> Result<Renderer<'w>, KindError> {
        let renderer = Renderer::new(world, self.params.resolution, stream)?;
        let renderer = renderer.with_sampler(self.params.sampler).with_integrator(self.params.integrator);
        Ok(renderer.sharing(plan))
    }

    fn gbuffer(&self) -> Result<GBuffer, KindError> {
        let samples = self.params.gbuffer_samples;
        let of = (self.params.stream, self.params.gbuffer_surface);
        self.renderer(self.world()?, self.params.stream, &self.plan)?.gbuffer(of, samples, &mut |done| {
            self.ctx.progress(done, samples, "gbuffer");
            self.ctx.check_cancelled()
        })
    }

    /// The time from the scene's files to each rung, and for a G-buffer; rung 0 is a loaded scene.
    fn timing(&self) -> Result<Timing, KindError> {
        let counts = self.params.rungs.counts();
        let entry = |spp| TimedImage { method: PATH_TRACER.into(), from_spp: spp, nfe: 0, took: Repeated::default() };
        let mut entries: Vec<TimedImage> = std::iter::once(0).chain(counts.iter().copied()).map(entry).collect();
        let mut gbuffer = Repeated::default();
        for round in 0..=self.params.repeats {
            let mut parts = Repeated::default();
            let world = parts.add(|| self.new_world())?;
            // Every round works out its own plan of light paths, which is part of the time.
            let renderer = parts.add(|| self.renderer(&world, self.params.stream, &SharedPlan::default()))?;
            let mut state = renderer.begin();
            for count in counts {
                parts.add(|| renderer.advance(&mut state, *count, &mut |_| self.ctx.check_cancelled()))?;
            }
            let (rendered, samples) = (parts.wall_s.len(), self.params.gbuffer_samples);
            let of = (self.params.stream, self.params.gbuffer_surface);
            parts.add(|| renderer.gbuffer(of, samples, &mut |_| self.ctx.check_cancelled()))?;
            self.ctx.progress(round, self.params.repeats, "rounds");
            // The first round does not count: it reads the scene from a disk, and touches memory for the first time.
            if round == 0 {
                continue;
            }
            let (mut wall, mut cpu) = (parts.wall_s[0], parts.cpu_s[0]);
            for (entry, at) in entries.iter_mut().zip(1..) {
                wall += parts.wall_s[at];
                cpu += parts.cpu_s[at];
                entry.took.wall_s.push(wall);
                entry.took.cpu_s.push(cpu);
            }
            gbuffer.wall_s.push(parts.wall_s[rendered]);
            gbuffer.cpu_s.push(parts.cpu_s[rendered]);
        }
        let (method, from_spp) = (methods::GBUFFER.to_owned(), self.params.gbuffer_samples);
        entries.push(TimedImage { method, from_spp, nfe: 0, took: gbuffer });
        Ok(Timing::here(entries))
    }

    /// Key of the state, or of the image, after `count` samples. The scene's JSON names its blobs by digest.
    fn key(&self, what: Memo, stream: u64, count: u64) -> Result<MemoKey, KindError> {
        let LadderRenderingParams { resolution, sampler, integrator, choices, .. } = self.params;
        let mut params = json!({ "resolution": resolution, "stream": stream, "sampler": sampler,
            "integrator": integrator, "choices": choices, "count": count });
        leave_out(&mut params, LATER);
        Ok(MemoKey {
            basis: Basis::new(NAME, MEMO_VERSION, what.name()).with(params, None),
            inputs: vec![SceneRecord::scene_digest(self.scene)?],
        })
    }

    fn remembered(&self, what: Memo, stream: u64, count: u64) -> Result<Option<Digest>, KindError> {
        Ok(self.ctx.memo_get(&self.key(what, stream, count)?).and_then(|artifact| artifact.part("")))
    }

    fn remember(&self, what: Memo, stream: u64, count: u64, digest: Digest) -> Result<(), KindError> {
        self.ctx.memo_put(&self.key(what, stream, count)?, &Artifact::blob(Memo::MEDIA, digest))
    }

    /// The state after at most `limit` samples from which the fewest are missing.
    fn nearest_state(&self, stream: u64, limit: u64, counts: &[u64]) -> Result<Option<Accumulator>, KindError> {
        let mut candidates: Vec<u64> = counts.iter().copied().chain((0..63).map(|i| 1 << i)).collect();
        candidates.retain(|count| *count <= limit);
        candidates.sort_unstable();
        candidates.dedup();
        for count in candidates.into_iter().rev() {
            if let Some(digest) = self.remembered(Memo::Accumulator, stream, count)? {
                // One that another version wrote is no use: what it saves is rendered again.
                let Ok(state) = Accumulator::from_bytes(&self.ctx.get(&digest)?) else { continue };
                let film = self.params.resolution;
                if (state.width(), state.height(), state.count) == (film.width(), film.height(), count) {
                    return Ok(Some(state));
                }
            }
        }
        Ok(None)
    }

    fn ladder(&self) -> Result<Stored<Ladder>, KindError> {
        let (mut counts, mut estimated_error) = (self.params.rungs.counts().to_vec(), None);
        if let Some(until) = &self.params.until {
            let (stop, error) = self.stop(until)?;
            counts.extend((stop > self.params.rungs.last()).then_some(stop));
            estimated_error = Some(error).filter(|error| error.is_finite());
        }
        let last = counts.last().copied().unwrap_or(1);
        let (counts, stream) = (&counts[..], self.params.stream);
        let mut images: BTreeMap<u64, Digest> = BTreeMap::new();
        for count in counts {
            if let Some(digest) = self.remembered(Memo::Rung, stream, *count)? {
                images.insert(*count, digest);
            }
        }
        // All before the first missing image can be skipped; the last state is needed for the variance.
        let missing = counts.iter().copied().find(|count| !images.contains_key(count)).unwrap_or(last);
        let mut state = self.nearest_state(stream, missing, counts)?;
        if state.as_ref().is_none_or(|state| state.count < last || !images.contains_key(&last)) {
            state = Some(self.render(state, counts, last, &mut images)?);
        }
        let state = state.ok_or_else(|| KindError::Internal("a ladder without a state".into()))?;
        let meta = LadderMeta {
            counts: counts.to_vec(),
            width: state.width(),
            height: state.height(),
            rejected: state.rejected,
            mean_path_length: state.mean_path_length(),
            sampler: self.params.sampler,
            integrator: self.params.integrator,
            estimated_error,
        };
        let rung = |count: &u64| {
            let digest = images.get(count).ok_or_else(|| KindError::Internal(format!("rung {count} was not made")))?;
            Ok((*count, *digest))
        };
        let rungs = counts.iter().map(rung).collect::<Result<Vec<_>, KindError>>()?;
        Ladder::of_stored(self.ctx, &meta, &state.variance(), rungs)
    }

    /// The variances at the rungs. What is rendered for them is remembered for the ladder.
    fn variances(&self) -> Result<Stored<Variances>, KindError> {
        if !self.params.sampler.is_independent() {
            return Err(KindError::Input(
                "samples of `sampler: sobol` are correlated, so their variance does not predict the error of a rung; \
                 use `sampler: independent`"
                    .into(),
            ));
        }
        let (counts, stream) = (self.params.rungs.counts(), self.params.stream);
        let mut found = Vec::with_capacity(counts.len());
        let mut state: Option<Accumulator> = None;
        let mut made = None;
        for count in counts {
            if let Some(digest) = self.remembered(Memo::Variance, stream, *count)? {
                found.push((*count, digest));
                continue;
            }
            if made.is_none() {
                made = Some(self.renderer(self.world()?, stream, &self.plan)?);
            }
            let Some(renderer) = &made else { continue };
            let known = self.nearest_state(stream, *count, counts)?;
            let nearest = state.into_iter().chain(known).max_by_key(|state| state.count);
            let mut now = nearest.unwrap_or_else(|| renderer.begin());
            renderer.advance(&mut now, *count, &mut |done| {
                self.ctx.progress(done, self.params.rungs.last(), "samples per pixel");
                self.ctx.check_cancelled()
            })?;
            let digest = self.ctx.put(&now.variance().to_bytes())?;
            self.remember(Memo::Variance, stream, *count, digest)?;
            found.push((*count, digest));
            if self.remembered(Memo::Rung, stream, *count)?.is_none() {
                self.remember(Memo::Rung, stream, *count, self.ctx.put(&now.mean().to_bytes())?)?;
            }
            state = Some(now);
        }
        if let Some(state) = state.filter(|state| state.count == self.params.rungs.last()) {
            self.remember(Memo::Accumulator, stream, state.count, self.ctx.put(&state.to_bytes())?)?;
        }
        Variances::of_stored(self.ctx, &found)
    }

    /// Where the ladder ends, and the error that is to be expected there. Samples of other streams decide, of which
    /// some may be remembered.
    fn stop(&self, until: &Until) -> Result<(u64, f64), KindError> {
        let film = self.params.resolution;
        let begin = || Accumulator::new(film.width(), film.height());
        until.decide(self.params.stream, self.params.rungs.last(), begin, |state, stream, trial| {
            if let Some(known) = self.nearest_state(stream, trial, &[trial])?
                && known.count > state.count
            {
                *state = known;
            }
            if state.count == trial {
                return Ok(());
            }
            self.renderer(self.world()?, stream, &self.plan)?.advance(state, trial, &mut |done| {
                self.ctx.progress(done, trial, "samples per pixel that decide");
                self.ctx.check_cancelled()
            })?;
            let digest = self.ctx.put(&state.to_bytes())?;
            self.remember(Memo::Accumulator, stream, trial, digest)
        })
    }

    /// Renders on to `last`, keeping the image of every rung and dyadic count on the way, and the state at the end.
    fn render(
        &self,
        state: Option<Accumulator>,
        counts: &[u64],
        last: u64,
        images: &mut BTreeMap<u64, Digest>,
    ) -> Result<Accumulator, KindError> {
        let stream = self.params.stream;
        let renderer = self.renderer(self.world()?, stream, &self.plan)?;
        let mut state = state.unwrap_or_else(|| renderer.begin());
        let begun = state.count;
        let dyadic = (0..63).map(|i| 1u64 << i).take_while(|count| *count < last);
        let mut stops: Vec<u64> = counts.iter().copied().chain(dyadic).filter(|stop| *stop >= begun.max(1)).collect();
        stops.sort_unstable();
        stops.dedup();
        for stop in stops {
            renderer.advance(&mut state, stop, &mut |done| {
                self.ctx.progress(done - begun, last - begun, "samples per pixel");
                self.ctx.check_cancelled()
            })?;
            if let Entry::Vacant(place) = images.entry(stop) {
                let digest = self.ctx.put(&state.mean().to_bytes())?;
                self.remember(Memo::Rung, stream, stop, digest)?;
                place.insert(digest);
            }
        }
        let digest = self.ctx.put(&state.to_bytes())?;
        self.remember(Memo::Accumulator, stream, last, digest)?;
        Ok(state)
    }
}
