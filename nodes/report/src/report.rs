#![doc = include_str!("report.md")]

use crate::{
    csv,
    gate_sheets::{self, Sheet},
    material::{self, Cell, Material},
    montage::{Choice, Montage, Pictures},
    page::{Section, page},
    ranking::extra,
    sections::{self, data::gate_counts},
    tex,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_contract::{
    Action, Context, FileTree, Files, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, ParamProblem,
    WriteFiles, pretty_json,
};
use tauflow_data::{
    methods::axes::{CONDITIONING, PARAMETERIZATION},
    records::{Claim, Evaluation, TrainingTiming},
};

/// The kind `report`.
pub struct Report;

/// Params of `report`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ReportParams {
    /// Title of the page.
    pub title: String,
    /// A sentence below the title; may be empty.
    pub subtitle: String,
    /// Scenes of each stratum among the pictures; 0 for no pictures.
    #[schemars(range(min = 0, max = 20))]
    pub montage_scenes: u64,
    /// NFE of the pictures and of the heat map; none for the first that was evaluated.
    pub montage_nfe: Option<u64>,
    /// Longest side of a picture in pixels; larger ones are reduced by an integer factor.
    #[schemars(range(min = 16, max = 2048))]
    pub montage_pixels: u64,
    /// Previews of each of the gate's reasons, and of scenes that it let through; 0 for none.
    #[schemars(range(min = 0, max = 1000))]
    pub gate_pictures: u64,
    /// Scenes whose bridge maps the page shows; the files hold all.
    #[schemars(range(min = 0, max = 100))]
    pub bridge_scenes: u64,
}

impl Default for ReportParams {
    fn default() -> Self {
        Self {
            title: "Monte Carlo transport".into(),
            subtitle: String::new(),
            montage_scenes: 1,
            montage_nfe: None,
            montage_pixels: 128,
            gate_pictures: 12,
            bridge_scenes: 2,
        }
    }
}

const PAGE: Out<Files> =
    Out::new(Group::main(11), "report", "The page, and its figures as JSON, CSV, LaTeX and PNG.").published();

impl Kind for Report {
    type Params = ReportParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "report",
            summary: "Shows what was measured: a self-contained page, JSON, CSV, LaTeX and pictures.",
            manual: include_str!("report.md"),
            mode: Mode::Gather,
            inputs: material::INPUTS.to_vec(),
            outputs: vec![PAGE.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if !params.title.trim().is_empty() {
            return Vec::new();
        }
        vec![ParamProblem::new("/title", "the title is empty", "write what the pipeline is about")]
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let material = Material::load(ctx, action)?;
        let evaluation = &material.evaluation;
        let params = &action.params;
        let nfe = picture_nfe(evaluation, params)?;
        let (montages, by_calls) = match action.all_if(material::REFERENCES)? {
            Some(references) if params.montage_scenes > 0 => {
                let choice =
                    Choice { scenes: params.montage_scenes as usize, nfe, pixels: params.montage_pixels as usize };
                let refined = action.all_if(material::REFINED)?;
                let pictures = Pictures::new(ctx, evaluation, references, refined, choice);
                (pictures.by_stratum()?, pictures.by_calls()?)
            }
            _ => Default::default(),
        };
        let sheets = match action.all_if(material::PREVIEWS)? {
            Some(previews) if params.gate_pictures > 0 => {
                gate_sheets::sheets(ctx, previews, &material.verdicts, params.gate_pictures as usize)?
            }
            _ => Vec::new(),
        };
        ctx.check_cancelled()?;
        let sections = sections(&material, params, (&montages, &by_calls), &sheets, nfe)?;
        let opening = material.time_error.as_ref().map(sections::time_error::opening).unwrap_or_default();
        let header = opening + &sections::headline::block(evaluation, &material, &params.subtitle, &montages, nfe)?;
        let html = page(&params.title, &header, &sections, &missing(action));

        let mut files = FileTree::new();
        let mut put = |name: &str, bytes: &[u8]| files.put(name, bytes);
        put("report.html", html.as_bytes())?;
        put("results.json", &results_json(&material, params)?)?;
        put("results.csv", csv::results(evaluation).as_bytes())?;
        put("curves.csv", csv::curves(evaluation).as_bytes())?;
        put("per_scene.csv", csv::per_scene(evaluation).as_bytes())?;
        if !evaluation.versus.is_empty() {
            put("versus.csv", csv::versus(evaluation).as_bytes())?;
        }
        put("table.tex", tex::table(evaluation, "hdr_psnr").as_bytes())?;
        put("tables.tex", tex::others(evaluation).as_bytes())?;
        for montage in montages.iter().chain(&by_calls).filter(|m| !m.rows.is_empty()) {
            put(&montage.file, &montage.png()?)?;
        }
        for sheet in &sheets {
            put(&sheet.file(), &sheet.png()?)?;
        }
        let between = material.bridge_tables().into_iter().flat_map(|bridge| &bridge.claims);
        let claims: Vec<&Claim> = evaluation.claims.iter().chain(between).collect();
        if !claims.is_empty() {
            put("claims.csv", sections::claims::csv(&claims).as_bytes())?;
        }
        if let Some(convergence) = &material.convergence {
            put("convergence.csv", sections::convergence::csv(convergence).as_bytes())?;
        }
        if let Some(time_error) = &material.time_error {
            put("time_error.csv", sections::time_error::points_csv(time_error).as_bytes())?;
            put("time_error_scenes.csv", sections::time_error::scenes_csv(time_error).as_bytes())?;
            put("time_error_targets.csv", sections::time_error::targets_csv(time_error).as_bytes())?;
        }
        if !material.timings.is_empty() {
            put("timings.csv", timings_csv(&material.timings).as_bytes())?;
        }
        // Files of the bridge go along, as they are exported.
        if let Some(bridge) = &material.bridge {
            let mut own = FileTree::new();
            bridge.write(&mut own)?;
            files.extend(own.into_iter().map(|(name, bytes)| (format!("bridge/{name}"), bytes)));
        }
        Outputs::default().put_one(PAGE, "report", Files(files).store(ctx)?)
    }
}

/// The NFE of pictures and heat map.
fn picture_nfe(evaluation: &Evaluation, params: &ReportParams) -> Result<u64, KindError> {
    let first = evaluation.nfe.first().copied().unwrap_or(0);
    match params.montage_nfe {
        None => Ok(first),
        Some(nfe) if evaluation.nfe.contains(&nfe) => Ok(nfe),
        Some(nfe) => Err(KindError::Input(format!(
            "`montage_nfe: {nfe}` was not evaluated, only {:?}; choose one of these, or add it to `nfe` of the \
             refinement",
            evaluation.nfe
        ))),
    }
}

/// The sections that there is material for, in order.
fn sections(
    material: &Material,
    params: &ReportParams,
    (montages, by_calls): (&[Montage], &[Montage]),
    sheets: &[Sheet],
    nfe: u64,
) -> Result<Vec<Section>, KindError> {
    let evaluation = &material.evaluation;
    let all = [
        sections::claims::section(evaluation, material.bridge_tables()),
        Some(sections::tables::section(evaluation)),
        Some(sections::curves::section(evaluation)),
        sections::strata::section(evaluation, nfe),
        sections::baselines::section(evaluation),
        material.time_error.as_ref().map(sections::time_error::section),
        sections::montage::section(montages, by_calls, nfe)?,
        material.bridge.as_ref().map(|b| sections::bridge::section(b, params.bridge_scenes as usize)),
        sections::losses::section(&material.losses),
        sections::data::section(material),
        sections::rejected::section(sheets, params.montage_pixels as usize)?,
        sections::scenes::section(&material.statistics),
        material.convergence.as_ref().and_then(sections::convergence::section),
        Some(sections::conventions::section(evaluation)),
        sections::timings::section(&material.timings),
    ];
    Ok(all.into_iter().flatten().collect())
}

/// What was not connected.
fn missing(action: &Action<'_, ReportParams>) -> Vec<String> {
    let there = |port: &str| action.all.get(port).is_some_and(|items| !items.is_empty());
    material::INPUTS.iter().filter(|p| !there(p.name)).map(|p| p.name.to_owned()).collect()
}

/// Every figure but the measured ones.
fn results_json(material: &Material, params: &ReportParams) -> Result<Vec<u8>, KindError> {
    let gate: BTreeMap<_, _> = gate_counts(&material.verdicts)
        .into_iter()
        .map(|(s, g)| (s, json!({"pool": g.pool, "accepted": g.accepted, "rejected": g.rejected})))
        .collect();
    pretty_json(&json!({
        "title": params.title,
        "references": material.references,
        "evaluation": material.evaluation,
        "losses": material.losses,
        "gate": gate,
        "split": material.split,
        "sampling": material.sampling,
        "bridge": material.bridge_tables(),
        "convergence": material.convergence,
        "statistics": material.statistics.iter().map(|(key, of)| (key, of)).collect::<BTreeMap<_, _>>(),
    }))
}

fn timings_csv(timings: &[(Cell, TrainingTiming)]) -> String {
    let mut out = String::from("parameterization,conditioning,cell,steps,seconds,median_step_ms,threads\n");
    for (cell, timing) in timings {
        let get = |axis: &str| csv::field(cell.get(axis).map_or("", String::as_str));
        let _ = writeln!(
            out,
            "{},{},{},{},{},{},{}",
            get(PARAMETERIZATION),
            get(CONDITIONING),
            csv::field(&extra(cell)),
            timing.steps,
            timing.seconds,
            timing.median_step_ms,
            timing.threads
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_contract::Determinism;

    #[test]
    fn the_ports_are_those_of_the_pipelines() {
        let spec = Report::spec();
        let names: Vec<&str> = spec.inputs.iter().map(|p| p.name).collect();
        assert_eq!(names[0], "evaluation");
        assert!(spec.inputs.iter().skip(1).all(|p| p.optional) && !spec.inputs[0].optional);
        assert!(spec.outputs[0].publish && spec.outputs[0].determinism == Determinism::Bitwise);
        assert!(Report::check(&ReportParams::default()).is_empty());
        assert_eq!(Report::check(&ReportParams { title: " ".into(), ..ReportParams::default() }).len(), 1);
    }
}
