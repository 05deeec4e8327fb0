#![doc = include_str!("ladder_rendering.md")]

use crate::{accumulator::Accumulator, render::Renderer, world::World};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::{BTreeMap, btree_map::Entry};
use tauflow_contract::{
    Action, Artifact, Context, Digest, InputPort, ItemKey, Kind, KindError, KindSpec, MemoKey, Mode, OutputPort,
    Outputs, ParamProblem,
};
use tauflow_data::{
    LadderMeta, RungCounts, Scene,
    formats::{JSON, SCENE},
    ladder::{GBUFFER, LADDER, SamplerKind, rung_part},
    timing::{Repeated, TimedImage, Timing, machine},
};

/// Version of the renderer: goes up when any image changes.
const RENDERER_VERSION: u32 = 4;
/// Group of the output port that is measured.
const TIMING: &str = "timing";
/// What a path tracer is called among methods that are timed.
const METHOD: &str = "path_tracer";
/// Points of a sequence: a sample's index has 32 bits.
const MOST_SOBOL: u64 = 1 << 32;
/// Media type of memoised sub-actions.
const STATE: &str = "tauflow/render-state";

/// The kind `ladder_rendering`.
pub struct LadderRendering;

/// Params of `ladder_rendering`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LadderRenderingParams {
    /// Sample counts of the rungs: `{dyadic: 256}` for 1, 2, 4 ... 256, or an increasing list.
    pub rungs: RungCounts,
    /// Width and height in pixels.
    #[schemars(inner(range(min = 1, max = 16384)))]
    pub resolution: [u32; 2],
    /// Which samples: ladders of one stream share them, those of two are independent.
    pub stream: u64,
    /// How samples are drawn.
    pub sampler: SamplerKind,
    /// Samples a pixel of the G-buffer.
    #[schemars(range(min = 1, max = 65536))]
    pub gbuffer_samples: u64,
    /// Times that `timing` renders the ladder.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

impl Default for LadderRenderingParams {
    fn default() -> Self {
        Self {
            rungs: RungCounts::Dyadic { dyadic: 256 },
            resolution: [256, 256],
            stream: 0,
            sampler: SamplerKind::Independent,
            gbuffer_samples: 32,
            repeats: 3,
        }
    }
}

impl Kind for LadderRendering {
    type Params = LadderRenderingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "ladder_rendering",
            version: 4,
            summary: "Renders nested sample ladders of scenes by path tracing",
            manual: include_str!("ladder_rendering.md"),
            mode: Mode::Map,
            inputs: const {
                &[
                    InputPort::each("scenes", SCENE, "the scenes to render"),
                    InputPort::whole("after", "*", "what must be there before `timing` measures").or_none(),
                ]
            },
            outputs: const {
                &[
                    OutputPort::new("ladder", LADDER, "the rungs, and the variance of samples").in_group("ladder"),
                    OutputPort::new("gbuffer", GBUFFER, "albedo and normal at the first surface").in_group("gbuffer"),
                    OutputPort::new("timing", JSON, "how long it takes to get to each rung, on all cores")
                        .in_group(TIMING)
                        .measured(),
                ]
            },
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        if let Err(error) = params.rungs.counts() {
            problems.push(ParamProblem::new("/rungs", error.to_string(), "write `{dyadic: 256}` or `[1, 2, 3]`"));
        }
        if params.resolution.iter().any(|side| !(1..=crate::render::MAX_SIDE as u32).contains(side)) {
            problems.push(ParamProblem::new(
                "/resolution",
                format!("{:?} is no film that can be rendered", params.resolution),
                format!("use sides from 1 to {}", crate::render::MAX_SIDE),
            ));
        }
        if !(1..=65536).contains(&params.gbuffer_samples) {
            problems.push(ParamProblem::new(
                "/gbuffer_samples",
                format!("{} samples a pixel", params.gbuffer_samples),
                "use 1 to 65536",
            ));
        }
        if params.sampler == SamplerKind::Sobol
            && params.rungs.counts().is_ok_and(|counts| counts.last().is_some_and(|last| *last > MOST_SOBOL))
        {
            problems.push(ParamProblem::new(
                "/rungs",
                format!("more samples than the {MOST_SOBOL} points of a Sobol' sequence"),
                "end at one of these, or use `sampler: independent`",
            ));
        }
        problems
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        let LadderRenderingParams { rungs, resolution, stream, sampler, gbuffer_samples, repeats } = params;
        match group {
            TIMING => json!({ "rungs": rungs, "resolution": resolution, "stream": stream, "sampler": sampler,
                "gbuffer_samples": gbuffer_samples, "repeats": repeats }),
            "gbuffer" => json!({ "resolution": resolution, "stream": stream, "gbuffer_samples": gbuffer_samples }),
            _ => {
                // `{dyadic: 4}` and `[1, 2, 4]` are the same ladder.
                let counts = rungs.counts().map_or_else(|_| json!(rungs), |counts| json!(counts));
                json!({ "rungs": counts, "resolution": resolution, "stream": stream, "sampler": sampler })
            }
        }
    }

    fn environment(_params: &Self::Params, group: &str) -> Value {
        if group != TIMING {
            return Value::Null;
        }
        let mut environment = machine();
        // Measurements of before, whose first round counted, are other measurements.
        environment["rounds_before"] = json!(1);
        environment
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let artifact = action.each("scenes")?;
        let work = Work { ctx, artifact, params: &action.params };
        match action.group {
            "gbuffer" => Ok(Outputs::default().item("gbuffer", work.gbuffer()?)),
            TIMING => {
                let timing = Artifact::blob(JSON, ctx.put_json(&work.timing()?)?);
                Ok(Outputs::default().item("timing", timing))
            }
            _ => Ok(Outputs::default().item("ladder", work.ladder()?)),
        }
    }
}

/// One scene to render.
struct Work<'a> {
    ctx: &'a Context<'a>,
    artifact: &'a Artifact,
    params: &'a LadderRenderingParams,
}

impl Work<'_> {
    fn world(&self) -> Result<World, KindError> {
        let scene: Scene = self.ctx.json(self.artifact, "scene.json")?;
        World::new(&scene, &mut |digest: &Digest| self.ctx.get(digest))
    }

    fn renderer<'w>(&self, world: &'w World) -> Result<Renderer<'w>, KindError> {
        let [width, height] = self.params.resolution;
        let renderer = Renderer::new(world, width as usize, height as usize, self.params.stream)?;
        Ok(renderer.with_sampler(self.params.sampler))
    }

    fn gbuffer(&self) -> Result<Artifact, KindError> {
        let world = self.world()?;
        let samples = self.params.gbuffer_samples;
        self.renderer(&world)?
            .gbuffer(self.params.stream, samples, &mut |done| {
                self.ctx.progress(done, samples, "gbuffer");
                self.ctx.check_cancelled()
            })?
            .store(self.ctx)
    }

    /// What it takes to get from the scene's files to each rung, and for a G-buffer; rung 0 is a scene that is ready to be
    /// rendered.
    fn timing(&self) -> Result<Timing, KindError> {
        let counts = self.params.rungs.counts()?;
        let entry = |spp| TimedImage { method: METHOD.into(), from_spp: spp, nfe: 0, took: Repeated::default() };
        let mut entries: Vec<TimedImage> = std::iter::once(0).chain(counts.iter().copied()).map(entry).collect();
        let mut gbuffer = Repeated::default();
        for round in 0..=self.params.repeats {
            let mut parts = Repeated::default();
            let world = parts.add(|| self.world())?;
            let renderer = parts.add(|| self.renderer(&world))?;
            let mut state = renderer.begin();
            for count in &counts {
                parts.add(|| renderer.advance(&mut state, *count, &mut |_| self.ctx.check_cancelled()))?;
            }
            let (rendered, samples) = (parts.wall_s.len(), self.params.gbuffer_samples);
            parts.add(|| renderer.gbuffer(self.params.stream, samples, &mut |_| self.ctx.check_cancelled()))?;
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
        let (method, from_spp) = ("gbuffer".to_owned(), self.params.gbuffer_samples);
        entries.push(TimedImage { method, from_spp, nfe: 0, took: gbuffer });
        Ok(Timing { entries })
    }

    /// Key of the state, or of the image, after `count` samples. The scene's JSON names its blobs by digest.
    fn key(&self, what: &str, count: u64) -> Result<MemoKey, KindError> {
        let LadderRenderingParams { resolution, stream, sampler, .. } = self.params;
        let scene = self.artifact.part("scene.json");
        let scene = scene.ok_or_else(|| KindError::Input("the item on `scenes` is no scene".into()))?;
        Ok(MemoKey {
            name: format!("ladder_rendering/{what}"),
            version: RENDERER_VERSION,
            params: json!({ "resolution": resolution, "stream": stream, "sampler": sampler, "count": count }),
            inputs: vec![scene],
        })
    }

    fn remembered(&self, what: &str, count: u64) -> Result<Option<Digest>, KindError> {
        Ok(self.ctx.memo_get(&self.key(what, count)?).and_then(|artifact| artifact.part("")))
    }

    fn remember(&self, what: &str, count: u64, digest: Digest) -> Result<(), KindError> {
        self.ctx.memo_put(&self.key(what, count)?, &Artifact::blob(STATE, digest))
    }

    /// The state after at most `limit` samples from which the fewest are missing.
    fn nearest_state(&self, limit: u64, counts: &[u64]) -> Result<Option<Accumulator>, KindError> {
        let mut candidates: Vec<u64> = counts.iter().copied().chain((0..63).map(|i| 1 << i)).collect();
        candidates.retain(|count| *count <= limit);
        candidates.sort_unstable();
        candidates.dedup();
        for count in candidates.into_iter().rev() {
            if let Some(digest) = self.remembered("accumulator", count)? {
                // One that another version wrote is no use: what it saves is rendered again.
                let Ok(state) = Accumulator::from_bytes(&self.ctx.get(&digest)?) else { continue };
                let [width, height] = self.params.resolution;
                if (state.width(), state.height(), state.count) == (width as usize, height as usize, count) {
                    return Ok(Some(state));
                }
            }
        }
        Ok(None)
    }

    fn ladder(&self) -> Result<Artifact, KindError> {
        let counts = self.params.rungs.counts()?;
        let last = *counts.last().ok_or_else(|| KindError::Internal("a ladder without rungs".into()))?;
        let mut images: BTreeMap<u64, Digest> = BTreeMap::new();
        for count in &counts {
            if let Some(digest) = self.remembered("rung", *count)? {
                images.insert(*count, digest);
            }
        }
        // All before the first missing image can be skipped; the last state is needed for the variance.
        let missing = counts.iter().copied().find(|count| !images.contains_key(count)).unwrap_or(last);
        let mut state = self.nearest_state(missing, &counts)?;
        if state.as_ref().is_none_or(|state| state.count < last || !images.contains_key(&last)) {
            state = Some(self.render(state, &counts, last, &mut images)?);
        }
        let state = state.ok_or_else(|| KindError::Internal("a ladder without a state".into()))?;
        let meta = LadderMeta {
            counts: counts.clone(),
            width: state.width(),
            height: state.height(),
            rejected: state.rejected,
            mean_path_length: state.mean_path_length(),
            sampler: self.params.sampler,
        };
        let mut parts = vec![
            ("meta.json".to_owned(), self.ctx.put_json(&meta)?),
            ("variance".to_owned(), self.ctx.put(&state.variance().to_bytes())?),
        ];
        for count in &counts {
            let digest = images.get(count).ok_or_else(|| KindError::Internal(format!("rung {count} was not made")))?;
            parts.push((rung_part(*count), *digest));
        }
        Ok(Artifact::tree(LADDER, parts))
    }

    /// Renders on to `last`, keeping the image of every rung and dyadic count on the way, and the state at the end.
    fn render(
        &self,
        state: Option<Accumulator>,
        counts: &[u64],
        last: u64,
        images: &mut BTreeMap<u64, Digest>,
    ) -> Result<Accumulator, KindError> {
        let world = self.world()?;
        let renderer = self.renderer(&world)?;
        let mut state = state.unwrap_or_else(|| renderer.begin());
        let begun = state.count;
        let dyadic = (0..63).map(|i| 1u64 << i).take_while(|count| *count < last);
        let mut stops: Vec<u64> = counts.iter().copied().chain(dyadic).filter(|stop| *stop >= begun.max(1)).collect();
        stops.sort_unstable();
        stops.dedup();
        for stop in stops {
            renderer.advance(&mut state, stop, &mut |done| {
                self.ctx.progress(done - begun, last - begun, "samples a pixel");
                self.ctx.check_cancelled()
            })?;
            if let Entry::Vacant(place) = images.entry(stop) {
                let digest = self.ctx.put(&state.mean().to_bytes())?;
                self.remember("rung", stop, digest)?;
                place.insert(digest);
            }
        }
        let digest = self.ctx.put(&state.to_bytes())?;
        self.remember("accumulator", last, digest)?;
        Ok(state)
    }
}
