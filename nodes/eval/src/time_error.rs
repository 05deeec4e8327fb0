#![doc = include_str!("time_error.md")]

use crate::{
    evaluation::check_resamples,
    held_out::{Errors, HeldOut, shared},
    metrics::Reference,
    time_tables::{Measured, MethodOf, Sample, quartiles, summarise},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs,
    ParamProblem,
};
use tauflow_data::{
    Image, Ladder,
    formats::{EXPOSURE, Exposure, JSON, PACKED, PackedScene, REFINED, load_refined},
    ladder::{LADDER, SamplerKind},
    timing::{Repeated, Timing, machine},
};

/// What the path tracer is called.
pub(crate) const PATH_TRACER: &str = "path_tracer";
/// What timings call a G-buffer.
const GBUFFER: &str = "gbuffer";

/// The kind `time_error`.
pub struct TimeErrorKind;

/// Params of `time_error`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TimeErrorParams {
    /// PSNR of linear radiance that times are given to, in dB.
    pub psnr_targets: Vec<f64>,
    /// Relative mean squared errors that times are given to.
    pub rel_mse_targets: Vec<f64>,
    /// Resamples of the bootstrap.
    #[schemars(range(min = 100, max = 100_000))]
    pub resamples: u64,
}

impl Default for TimeErrorParams {
    fn default() -> Self {
        Self { psnr_targets: vec![25.0, 30.0, 35.0, 40.0], rel_mse_targets: vec![0.1, 0.01, 0.001], resamples: 2000 }
    }
}

const INPUTS: &[InputPort] = &[
    InputPort::whole("references", LADDER, "Held-out references: of another stream, their last rung counts."),
    InputPort::whole("exposure", EXPOSURE, "The exposure of the same scenes."),
    InputPort::whole("ladders", PACKED, "The path tracer's own images, exposed."),
    InputPort::whole("render_times", JSON, "What they take: `timing` of `ladder_rendering`."),
    InputPort::whole("refined", REFINED, "Images of the other methods, by cell and scene.").or_none(),
    InputPort::whole("times", JSON, "What these take: `timing` of the nodes that made them.").or_none(),
    InputPort::whole("sampled", LADDER, "Ladders of other samplers, by cell and scene.").or_none(),
    InputPort::whole("rendered", REFINED, "Images of other renderers, by cell and scene; not exposed.").or_none(),
    InputPort::whole("rendered_times", JSON, "What both take: `timing` of the nodes that made them.").or_none(),
];
const OUTPUTS: &[OutputPort] =
    &[OutputPort::new("tables", JSON, "Errors and times by method, and what follows from them.").measured()];

impl Kind for TimeErrorKind {
    type Params = TimeErrorParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "time_error",
            version: 8,
            summary: "Error against time: of rendering alone, solvers and denoisers.",
            manual: include_str!("time_error.md"),
            mode: Mode::Gather,
            inputs: INPUTS,
            outputs: OUTPUTS,
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut out = check_resamples(params.resamples);
        let bad = |v: &f64| !(v.is_finite() && *v > 0.0);
        for (pointer, values) in
            [("/psnr_targets", &params.psnr_targets), ("/rel_mse_targets", &params.rel_mse_targets)]
        {
            if values.iter().any(bad) {
                out.push(ParamProblem::new(pointer, "a target that is not above 0", "write for example `[25, 30]`"));
            }
        }
        out
    }

    fn environment(_params: &Self::Params, _group: &str) -> Value {
        machine()
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let references = action.whole("references")?;
        let port = |name: &str| action.whole.get(name).copied();
        let cells = Cells {
            refined: cells(("refined", [port("refined"), None]), ("times", port("times")))?,
            rendered: cells(
                ("rendered` or `sampled", [port("rendered"), port("sampled")]),
                ("rendered_times", port("rendered_times")),
            )?,
        };
        let mut notes = Vec::new();
        let mut scenes = Vec::new();
        let (mut against_law, mut last) = (Vec::new(), 0);
        for (done, (key, artifact)) in references.iter().enumerate() {
            ctx.check_cancelled()?;
            let item = |port: &str| -> Result<&Artifact, KindError> {
                action.whole(port)?.get(key.as_str()).ok_or_else(|| {
                    KindError::Input(format!(
                        "`{port}` has no item `{key}`, which `references` has; connect the same scenes"
                    ))
                })
            };
            let exposure: Exposure = ctx.json(item("exposure")?, "")?;
            let reference = HeldOut::load(ctx, artifact, exposure.factor, key)?;
            let packed = PackedScene::from_bytes(&ctx.part(item("ladders")?, "")?)?;
            let rendering: Timing = ctx.json(item("render_times")?, "")?;
            let own = Own { packed: &packed, rendering: &rendering, factor: exposure.factor };
            scenes.push(scene(ctx, key, &reference, &own, &cells, &mut notes)?);
            against_law.extend(reference.against_law(&packed.counts, &packed.states));
            let spp = packed.counts.last().copied().unwrap_or_default();
            if done > 0 && spp != last {
                return Err(KindError::Input(format!(
                    "the ladder of `{key}` ends at {spp} samples a pixel and the others at {last}; connect ladders of one `rungs`"
                )));
            }
            last = spp;
            ctx.progress(done as u64 + 1, references.len() as u64, "");
        }
        notes.sort_unstable();
        notes.dedup();
        let reference_spp = scenes.first().map_or(0, |(spp, _)| *spp);
        if let Some((spp, other)) = scenes.iter().find(|(spp, _)| *spp != reference_spp) {
            return Err(KindError::Input(format!(
                "the reference of `{}` has {spp} samples a pixel and the first scene's {reference_spp}; render all alike",
                other.scene
            )));
        }
        if let Some(value) = shared(&against_law, last, reference_spp) {
            return Err(KindError::Input(format!(
                "references share samples with the ladders that they judge: squares of what the rungs of {last} are off by are {value:.3} of \
                 those of independent samples; render references with another `stream`"
            )));
        }
        if reference_spp < 16 * last {
            notes.push(format!(
                "references of {reference_spp} samples, less than 16 times the last rung's {last}: their own noise, which is taken off, is no \
                 small part of low errors"
            ));
        }
        let hidden =
            |of: &Measured| of.own.iter().chain(of.methods.values().flatten()).filter(|s| s.unresolved).count();
        let unresolved: usize = scenes.iter().map(|(_, of)| hidden(of)).sum();
        if unresolved > 0 {
            notes.push(format!(
                "{unresolved} images are nearer to their references than the references' own noise tells: a thousandth of what was found \
                 stands for their errors"
            ));
        }
        let measured: Vec<Measured> = scenes.into_iter().map(|(_, measured)| measured).collect();
        let result = summarise(&measured, &action.params, reference_spp, notes, action.seed)?;
        let key = ItemKey::new("time_error").expect("a valid key");
        let artifact = Artifact::blob(JSON, ctx.put_json(&result)?);
        Ok(Outputs::default().collection("tables", Collection::from_iter([(key, artifact)])))
    }
}

/// A cell's images and times, by scene.
struct CellOf<'a> {
    name: &'a str,
    images: BTreeMap<&'a str, &'a Artifact>,
    times: BTreeMap<&'a str, &'a Artifact>,
}

/// The cells that start from our own endpoints, and those that render for themselves.
struct Cells<'a> {
    refined: Vec<CellOf<'a>>,
    rendered: Vec<CellOf<'a>>,
}

/// The path tracer's images of a scene, what they take, and the scene's exposure.
struct Own<'a> {
    packed: &'a PackedScene,
    rendering: &'a Timing,
    factor: f64,
}

impl<'a> CellOf<'a> {
    /// Images and times of a scene.
    fn scene(&self, key: &ItemKey) -> Result<(&'a Artifact, &'a Artifact), KindError> {
        let found = self.images.get(key.as_str()).zip(self.times.get(key.as_str()));
        found.map(|(images, times)| (*images, *times)).ok_or_else(|| {
            KindError::Input(format!("the cell `{}` has no scene `{key}`; connect the same scenes", self.name))
        })
    }
}

/// Cells by name, which the ports of images and of times must share; each with its name.
fn cells<'a>(
    (images_port, images): (&str, [Option<&'a Collection>; 2]),
    (times_port, times): (&str, Option<&'a Collection>),
) -> Result<Vec<CellOf<'a>>, KindError> {
    let mut cells: BTreeMap<&str, CellOf<'_>> = BTreeMap::new();
    let listed = |of: Option<&'a Collection>| of.into_iter().flat_map(Collection::iter);
    let empty = |name| CellOf { name, images: BTreeMap::new(), times: BTreeMap::new() };
    for (key, artifact) in images.into_iter().flat_map(listed) {
        let (name, scene) = key.split_cell().unwrap_or(("", key.as_str()));
        cells.entry(name).or_insert_with(|| empty(name)).images.insert(scene, artifact);
    }
    for (key, artifact) in listed(times) {
        let (name, scene) = key.split_cell().unwrap_or(("", key.as_str()));
        cells.entry(name).or_insert_with(|| empty(name)).times.insert(scene, artifact);
    }
    if let Some(cell) = cells.values().find(|cell| cell.images.is_empty() || cell.times.is_empty()) {
        let (there, missing) =
            if cell.images.is_empty() { (times_port, images_port) } else { (images_port, times_port) };
        return Err(KindError::Input(format!(
            "`{there}` has the cell `{}` and `{missing}` has not; connect the output and the `timing` of the same nodes",
            cell.name
        )));
    }
    Ok(cells.into_values().collect())
}

/// Quartiles of the wall and processor times of an image.
type Took = ([f64; 3], [f64; 3]);

/// Quartiles of an image's times; none if it was not timed.
fn times_of(timing: &Timing, method: Option<&str>, spp: u64, nfe: u64) -> Option<Took> {
    let fits = |e: &&tauflow_data::timing::TimedImage| {
        e.from_spp == spp
            && e.nfe == nfe
            && method.is_none_or(|m| m == e.method)
            && (method.is_some() || e.method != GBUFFER)
    };
    let Repeated { wall_s, cpu_s } = &timing.entries.iter().find(fits)?.took;
    let quartiles = |times: &[f64]| (!times.is_empty()).then(|| quartiles(times.iter().copied()));
    Some((quartiles(wall_s)?, quartiles(cpu_s)?))
}

/// Of what is done one after the other.
fn sum(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + b[i])
}

fn scene(
    ctx: &Context<'_>,
    key: &ItemKey,
    held_out: &HeldOut,
    of: &Own<'_>,
    cells: &Cells<'_>,
    notes: &mut Vec<String>,
) -> Result<(u64, Measured), KindError> {
    let Own { packed, rendering, factor } = of;
    let reference =
        Reference::new(&held_out.image).map_err(|e| KindError::Input(format!("the reference of `{key}`: {e}")))?;
    let untimed =
        |what: &str| KindError::Input(format!("`{what}` of `{key}` was not timed; time it at the same rungs and NFE"));
    let sample = |image: &Image, from: u64, nfe: u64, took: Took| -> Result<Sample, KindError> {
        let metrics = reference.metrics(image).map_err(|e| KindError::Input(format!("an image of `{key}`: {e}")))?;
        let Errors { mse, rel_mse, hdr_psnr, unresolved } = held_out.errors(image);
        Ok(Sample {
            from_spp: from,
            nfe,
            wall_s: took.0,
            cpu_s: took.1,
            mse,
            rel_mse,
            hdr_psnr,
            preview_psnr: metrics.preview_psnr,
            ssim: metrics.ssim,
            unresolved,
        })
    };
    // Of the same samples a reference is no judge.
    if held_out.noisy && packed.states.contains(&held_out.image) {
        return Err(KindError::Input(format!(
            "the reference of `{key}` is a rung of its own ladder: nothing can be judged by itself; render references with another `stream`"
        )));
    }
    let mut methods = BTreeMap::new();
    let mut own = Vec::new();
    for (spp, image) in packed.counts.iter().zip(&packed.states) {
        // A ladder may go on beyond what was timed.
        if let Some(took) = times_of(rendering, Some(PATH_TRACER), *spp, 0) {
            own.push(sample(image, *spp, 0, took)?);
        }
    }
    if own.len() < 2 {
        return Err(untimed(PATH_TRACER));
    }
    let gbuffer = rendering
        .entries
        .iter()
        .find(|e| e.method == GBUFFER)
        .and_then(|e| times_of(rendering, Some(GBUFFER), e.from_spp, 0));
    for cell in &cells.rendered {
        let (artifact, times) = cell.scene(key)?;
        let (images, note) = rendered(ctx, artifact)?;
        notes.extend(note);
        let times: Timing = ctx.json(times, "")?;
        // A ladder may go on beyond what was timed, but not be without.
        if let Some((name, ..)) = images.first()
            && images.iter().all(|(_, spp, _)| times_of(&times, None, *spp, 0).is_none())
        {
            return Err(untimed(name));
        }
        if images.iter().any(|(name, ..)| name == PATH_TRACER) {
            return Err(KindError::Input(format!(
                "the cell `{}` has ladders of independent samples, as `ladders` has; `sampled` takes those of another sampler",
                cell.name
            )));
        }
        for (name, spp, image) in images {
            let Some(took) = times_of(&times, None, spp, 0) else { continue };
            let exposed = image.map(|v| (f64::from(v) * factor) as f32);
            // A renderer sees a scene, and no image of it.
            let method = MethodOf { conditioning: String::new(), ..MethodOf::new(cell.name, &name) };
            methods.entry(method).or_insert_with(Vec::new).push(sample(&exposed, spp, 0, took)?);
        }
    }
    for cell in &cells.refined {
        let (images, times) = cell.scene(key)?;
        let (images, note) = load_refined(ctx, images)?;
        notes.extend(note);
        let times: Timing = ctx.json(times, "")?;
        for (said, image) in images {
            let method = MethodOf::new(cell.name, &said.method);
            let after = times_of(&times, None, said.from_spp, said.nfe).ok_or_else(|| untimed(&said.method))?;
            let before =
                times_of(rendering, Some(PATH_TRACER), said.from_spp, 0).ok_or_else(|| untimed(PATH_TRACER))?;
            let aside = match (method.conditioning.as_str(), gbuffer) {
                ("gbuffer", Some(took)) => took,
                ("gbuffer", None) => return Err(untimed(GBUFFER)),
                _ => ([0.0; 3], [0.0; 3]),
            };
            let [wall, cpu] = [(after.0, before.0, aside.0), (after.1, before.1, aside.1)];
            let whole = [wall, cpu].map(|(after, before, aside)| sum(sum(after, before), aside));
            let whole = (whole[0], whole[1]);
            methods.entry(method).or_insert_with(Vec::new).push(sample(&image, said.from_spp, said.nfe, whole)?);
        }
    }
    // Cells come in the order of their names, where 16 is before 4.
    methods.values_mut().for_each(|of| of.sort_by_key(|sample| (sample.from_spp, sample.nfe)));
    Ok((held_out.spp, Measured { scene: key.to_string(), own, methods }))
}

/// Images of a ladder of another sampler, or of another renderer: each with its method's name and samples a pixel; and a note.
type Rendered = (Vec<(String, u64, Image)>, Option<String>);

fn rendered(ctx: &Context<'_>, artifact: &Artifact) -> Result<Rendered, KindError> {
    if artifact.media != LADDER {
        let (images, note) = load_refined(ctx, artifact)?;
        return Ok((images.into_iter().map(|(said, image)| (said.method, said.from_spp, image)).collect(), note));
    }
    let ladder = Ladder::load(ctx, artifact)?;
    let name = match ladder.meta.sampler {
        SamplerKind::Independent => PATH_TRACER.to_owned(),
        SamplerKind::Sobol => format!("{PATH_TRACER}_sobol"),
    };
    Ok((ladder.rungs.into_iter().map(|rung| (name.clone(), rung.spp, rung.image)).collect(), None))
}
