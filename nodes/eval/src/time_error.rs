#![doc = include_str!("time_error.md")]

use crate::{
    groups::{Groups, SPLIT},
    held_out::{HeldOut, shared},
    ssim::LEAST_SIDE,
    time_params::TimeErrorParams,
    time_samples::Measured,
    time_scene::{Cells, Own, measured},
    time_tables::summarise,
};
use serde_json::Value;
use tauflow_contract::{
    Action, All, Context, Foreseen, Group, ItemKey, Items, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook,
    Outputs,
};
use tauflow_data::{
    facts,
    records::{Exposure, Ladder, PackedScene, Refined, TimeError, Timing},
    timing::named,
};

/// The kind `time_error`.
pub struct TimeErrorKind;

const REFERENCES: All<Ladder> =
    All::new("references", "Held-out references of a different stream; the last rung is used.");
const EXPOSURE: All<Exposure> = All::new("exposure", "The exposure of the same scenes.");
const LADDERS: All<PackedScene> = All::new("ladders", "The exposed images of the path tracer.");
const RENDER_TIMES: All<Timing> = All::new("render_times", "Their times: `timing` of `ladder_rendering`.");
const REFINED: All<Refined> = All::new("refined", "Images of the other methods, by cell and scene.").or_none();
const TIMES: All<Timing> = All::new("times", "Their times: `timing` of the nodes that produced them.").or_none();
const SAMPLED: All<Ladder> = All::new("sampled", "Ladders of other samplers, by cell and scene.").or_none();
const RENDERED: All<Refined> =
    All::new("rendered", "Images of other renderers, by cell and scene; not exposed.").or_none();
const RENDERED_TIMES: All<Timing> =
    All::new("rendered_times", "Times of both: `timing` of the nodes that produced them.").or_none();
const MAIN: Group = Group::main(11);
// It measures nothing itself: the same times give the same tables.
const TABLES: Out<TimeError> = Out::new(MAIN, "tables", "Errors, times and derived figures per method.").single();

impl Kind for TimeErrorKind {
    type Params = TimeErrorParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "time_error",
            summary: "Computes error against wall time of path tracing, solvers and denoisers.",
            manual: include_str!("time_error.md"),
            mode: Mode::Gather,
            inputs: vec![
                REFERENCES.port(),
                EXPOSURE.port(),
                LADDERS.port(),
                RENDER_TIMES.port(),
                REFINED.port(),
                TIMES.port(),
                SAMPLED.port(),
                RENDERED.port(),
                RENDERED_TIMES.port(),
                SPLIT.port(),
            ],
            outputs: vec![TABLES.port()],
            seeded: true,
        }
    }

    fn foresee(_params: &Self::Params, known: &Known) -> Outlook {
        let (references, ladders) = (known.all(REFERENCES), known.all(LADDERS));
        let mut problems: Vec<Foreseen> = Vec::new();
        problems.extend(ladders.iter().find_map(|of| facts::independent(LADDERS, of)));
        if let [reference] = references {
            problems.extend(facts::least_film(REFERENCES, reference, LEAST_SIDE, "SSIM"));
            problems.extend(ladders.iter().find_map(|of| facts::same_film(LADDERS, of, reference)));
            problems.extend(known.all(REFINED).iter().find_map(|of| facts::same_film(REFINED, of, reference)));
            problems.extend(known.all(SAMPLED).iter().find_map(|of| facts::same_film(SAMPLED, of, reference)));
            problems.extend(known.all(RENDERED).iter().find_map(|of| facts::same_film(RENDERED, of, reference)));
        }
        Outlook::default().but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let references = action.all(REFERENCES)?;
        let inputs = Inputs::of(action)?;
        let machine = one_machine(ctx, action)?;
        let mut notes = Vec::new();
        let mut scenes: Vec<Measured> = Vec::with_capacity(references.len());
        let mut against_law = Vec::new();
        // Samples per pixel of the references, and of the last rungs that they judge.
        let mut samples: Option<[u64; 2]> = None;
        for (done, (key, reference)) in references.iter().enumerate() {
            ctx.check_cancelled()?;
            let exposure = inputs.exposure.need(EXPOSURE, key, REFERENCES.name())?.load(ctx)?;
            let reference = HeldOut::load(ctx, reference, exposure.factor, key)?;
            let packed = inputs.ladders.need(LADDERS, key, REFERENCES.name())?.load(ctx)?;
            if !packed.sampler.is_independent() {
                return Err(KindError::Input(format!(
                    "the ladder of `{key}` on `{}` has correlated samples; connect independent ones there, and others \
                     to `{}`",
                    LADDERS.name(),
                    SAMPLED.name()
                )));
            }
            let rendering = inputs.render_times.need(RENDER_TIMES, key, REFERENCES.name())?.load(ctx)?;
            let own = Own { packed: &packed, rendering: &rendering, factor: exposure.factor };
            scenes.push(measured(ctx, key, &reference, &own, &inputs.cells, &mut notes)?);
            against_law.extend(reference.against_law(&packed.counts, &packed.states));
            alike(&mut samples, [reference.spp, packed.counts.last().copied().unwrap_or_default()], key)?;
            ctx.progress(done as u64 + 1, references.len() as u64, "");
        }
        notes.sort_unstable();
        notes.dedup();
        let [reference_spp, last] = samples.unwrap_or_default();
        if let Some(value) = shared(&against_law, last, reference_spp) {
            return Err(KindError::Input(format!(
                "references share samples with the ladders that they judge: squares of what the rungs of {last} are \
                 off by are {value:.3} of those of independent samples; render references with another `stream`"
            )));
        }
        if reference_spp < 16 * last {
            notes.push(format!(
                "references of {reference_spp} samples, less than 16 times the last rung's {last}: their own noise, \
                 which is taken off, is no small part of low errors"
            ));
        }
        let hidden =
            |of: &Measured| of.own.iter().chain(of.methods.values().flatten()).filter(|s| s.unresolved).count();
        let unresolved: usize = scenes.iter().map(hidden).sum();
        if unresolved > 0 {
            notes.push(format!(
                "{unresolved} images are nearer to their references than the references' own noise tells: a thousandth \
                 of what was found stands for their errors"
            ));
        }
        let groups = Groups::load(ctx, action)?;
        let tables = summarise(&scenes, &groups, &action.params, reference_spp, notes, action.seed)?;
        let tables = TimeError { machine, ..tables };
        Outputs::default().put_one(TABLES, "time_error", tables.store(ctx)?)
    }
}

/// The machine that measured all times: those of several machines cannot be compared.
fn one_machine(ctx: &Context<'_>, action: &Action<'_, TimeErrorParams>) -> Result<Value, KindError> {
    let mut first: Option<(String, Value)> = None;
    let optional = [(TIMES.name(), action.all_if(TIMES)?), (RENDERED_TIMES.name(), action.all_if(RENDERED_TIMES)?)];
    let given = optional.into_iter().filter_map(|(port, times)| Some((port, times?)));
    for (port, times) in [(RENDER_TIMES.name(), action.all(RENDER_TIMES)?)].into_iter().chain(given) {
        for (key, timing) in times.iter() {
            let own = timing.load(ctx)?.machine;
            let name = || format!("`{key}` on `{port}`");
            let (known, machine) = first.get_or_insert_with(|| (name(), own.clone()));
            if *machine != own {
                let told = |of: &Value| named(of).unwrap_or_else(|| "an unknown machine".into());
                return Err(KindError::Input(format!(
                    "times of two machines cannot be compared: {known} was measured on {}, {} on {}; measure all on \
                     one",
                    told(machine),
                    name(),
                    told(&own)
                )));
            }
        }
    }
    Ok(first.map_or(Value::Null, |(_, machine)| machine))
}

/// The collections of an action, but for the references.
struct Inputs<'a> {
    exposure: Items<'a, Exposure>,
    ladders: Items<'a, PackedScene>,
    render_times: Items<'a, Timing>,
    cells: Cells<'a>,
}

impl<'a> Inputs<'a> {
    fn of(action: &Action<'a, TimeErrorParams>) -> Result<Self, KindError> {
        Ok(Self {
            exposure: action.all(EXPOSURE)?,
            ladders: action.all(LADDERS)?,
            render_times: action.all(RENDER_TIMES)?,
            cells: Cells::new(
                ((REFINED.name(), action.all_if(REFINED)?), (TIMES.name(), action.all_if(TIMES)?)),
                (
                    (RENDERED.name(), action.all_if(RENDERED)?),
                    (SAMPLED.name(), action.all_if(SAMPLED)?),
                    (RENDERED_TIMES.name(), action.all_if(RENDERED_TIMES)?),
                ),
            )?,
        })
    }
}

/// Wants the samples per pixel of all references, and of all last rungs, to be those of the first scene.
fn alike(first: &mut Option<[u64; 2]>, own: [u64; 2], key: &ItemKey) -> Result<(), KindError> {
    let [reference_spp, last] = *first.get_or_insert(own);
    let [reference, spp] = own;
    if spp != last {
        return Err(KindError::Input(format!(
            "the ladder of `{key}` ends at {spp} samples per pixel, but the others end at {last}; connect ladders \
            with the same `rungs`"
        )));
    }
    if reference != reference_spp {
        return Err(KindError::Input(format!(
            "the reference of `{key}` has {reference} samples per pixel, but that of the first scene has \
            {reference_spp}; render all with the same `rungs`"
        )));
    }
    Ok(())
}
