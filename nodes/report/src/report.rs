#![doc = include_str!("report.md")]

use crate::{
    album::Album,
    csv,
    gate_sheets::{self, Sheet},
    ladder_pictures,
    material::{self, Cell, Material},
    method_pictures::MethodPictures,
    montage::{Choice, Montage, Pictures},
    page::{Section, page, provenance},
    ranking::{Standing, extra, solver, standings},
    sections::{self, data::gate_counts},
    shelf::Viewer,
    tex,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};
use tauflow_contract::{
    Action, Before, Context, FileTree, Files, Foreseen, Group, Items, Kind, KindError, KindSpec, Known, Later, Media,
    Mode, Out, Outlook, Outputs, ParamProblem, WriteFiles, pretty_json,
};
use tauflow_data::{
    facts::NFE,
    methods::axes::{CONDITIONING, PARAMETERIZATION},
    records::{Evaluation, Ladder, MethodTable, TrainingTiming},
    timing::named,
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
    /// Number of scenes per stratum among the images; 0 for no images.
    #[schemars(range(min = 0, max = 20))]
    pub montage_scenes: u64,
    /// Number of scenes per stratum in the viewer; those of the images on the page are always there.
    #[schemars(range(min = 0, max = 1000))]
    pub viewer_scenes: u64,
    /// NFE of the images and the heat map; none for the first evaluated one.
    pub montage_nfe: Option<u64>,
    /// NFE of the images of solvers with G-buffers, if it differs from `montage_nfe`.
    pub montage_nfe_gbuffer: Option<u64>,
    /// Maximum side of an image in pixels; larger images are reduced by an integer factor.
    #[schemars(range(min = 16, max = 2048))]
    pub montage_pixels: u64,
    /// Number of previews per reason of the gate, and of accepted scenes; 0 for none.
    #[schemars(range(min = 0, max = 1000))]
    pub gate_pictures: u64,
    /// Number of scenes with bridge maps on the page; the files contain all.
    #[schemars(range(min = 0, max = 100))]
    pub bridge_scenes: u64,
}

impl Default for ReportParams {
    fn default() -> Self {
        Self {
            title: "Monte Carlo transport".into(),
            subtitle: String::new(),
            montage_scenes: 1,
            viewer_scenes: 4,
            montage_nfe: None,
            montage_nfe_gbuffer: None,
            montage_pixels: 128,
            gate_pictures: 12,
            bridge_scenes: 2,
        }
    }
}

const PAGE: Out<Files> =
    Out::new(Group::main(25), "report", "The page, and its figures as JSON, CSV, LaTeX and PNG.").single().published();

impl Kind for Report {
    type Params = ReportParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "report",
            summary: "Writes the results as a self-contained HTML page, JSON, CSV, LaTeX and images.",
            manual: include_str!("report.md"),
            mode: Mode::Gather,
            inputs: material::INPUTS.to_vec(),
            outputs: vec![PAGE.port()],
            seeded: false,
        }
    }

    fn later() -> &'static [Later] {
        &[Later { pointer: "/viewer_scenes", before: Before::Integer(0) }]
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if !params.title.trim().is_empty() {
            return Vec::new();
        }
        vec![ParamProblem::new("/title", "the title is empty", "write what the pipeline is about")]
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let evaluated = known.all(material::EVALUATION).first().and_then(|of| of.facts.get(NFE));
        let asked = [("montage_nfe", params.montage_nfe), ("montage_nfe_gbuffer", params.montage_nfe_gbuffer)];
        let problem = asked.into_iter().filter_map(|(name, nfe)| {
            let (nfe, evaluated) = nfe.zip(evaluated.clone()).filter(|(nfe, evaluated)| !evaluated.contains(nfe))?;
            let message = format!("`{name}: {nfe}` is not evaluated, only {evaluated:?}");
            let hint = format!("choose one of these, or add {nfe} to `nfe`");
            Some(Foreseen::param(&format!("/{name}"), message, hint))
        });
        let nothing = !known.has(material::EVALUATION.name()) && !known.has(material::TABLES.name());
        let scores = nothing.then(|| {
            let message = "the report has no scores".to_owned();
            Foreseen::input(material::EVALUATION, message, "connect `evaluation` or `tables`")
        });
        Outlook::default().but(problem.chain(scores))
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let material = Material::load(ctx, action)?;
        if material.evaluation.is_none() && material.tables.is_empty() {
            return Err(KindError::Input("the report has no scores; connect `evaluation` or `tables`".into()));
        }
        let params = &action.params;
        let images = Images::load(ctx, action, &material)?;
        ctx.check_cancelled()?;
        let sections = sections(&material, params, &images)?;
        let mut header = sections::headline::subtitle(&params.subtitle);
        if let Some(evaluation) = &material.evaluation {
            header += &sections::headline::summary(evaluation, &material);
        }
        header += &material.tables.iter().map(|(_, table)| sections::score_tables::opening(table)).collect::<String>();
        header += &provenance(&action.all);
        let viewer = images.viewer.as_ref();
        header += &images.opening.as_ref().map_or(Ok(String::new()), |of| sections::headline::hero(of, viewer))?;
        header += &material.time_error.as_ref().map(sections::time_error::opening).unwrap_or_default();
        if let Some(evaluation) = &material.evaluation {
            header += &sections::headline::block(evaluation, &material);
        }
        let beside = "<code>results.json</code> and as CSV and LaTeX files";
        let html = page(&params.title, &header, &sections, &missing(action, &material), beside);

        let mut files = FileTree::new();
        let mut put = |name: &str, bytes: &[u8]| files.put(name, bytes);
        put("report.html", html.as_bytes())?;
        if let Some(viewer) = &images.viewer {
            put(Viewer::FILE, viewer.html.as_bytes())?;
        }
        put("results.json", &results_json(&material, params)?)?;
        for montage in images.all().filter(|m| !m.rows.is_empty()) {
            put(&montage.file, &montage.png()?)?;
        }
        for sheet in &images.sheets {
            put(&sheet.file(), &sheet.png()?)?;
        }
        for (name, text) in figures(&material) {
            put(name, text.as_bytes())?;
        }
        // The bridge and the tables add their files as `export` writes them.
        if let Some(bridge) = &material.bridge {
            let mut own = FileTree::new();
            bridge.write(&mut own)?;
            files.extend(own.into_iter().map(|(name, bytes)| (format!("bridge/{name}"), bytes)));
        }
        for (key, table) in &material.tables {
            let own = table.files()?.into_iter();
            files.extend(own.map(|(name, bytes)| (format!("tables/{key}/{name}"), bytes)));
        }
        Outputs::default().put_one(PAGE, "report", Files(files).store(ctx)?)
    }
}

/// The images of a page.
struct Images {
    /// Network calls of those of solvers.
    nfe: u64,
    /// NFE of the pictures of solvers with G-buffers.
    nfe_gbuffer: u64,
    /// The viewer of the scenes on the page.
    viewer: Option<Viewer>,
    /// The figure that opens the page.
    opening: Option<Montage>,
    /// Solvers by stratum.
    montages: Vec<Montage>,
    /// Solvers by number of calls.
    by_calls: Vec<Montage>,
    /// Any methods, on a page without an evaluation.
    methods: Option<Montage>,
    /// Ladders side by side.
    ladders: Option<Montage>,
    /// What the gate rejected.
    sheets: Vec<Sheet>,
}

impl Images {
    fn load(ctx: &Context<'_>, action: &Action<'_, ReportParams>, material: &Material) -> Result<Self, KindError> {
        let params = &action.params;
        let (scenes, pixels) = (params.montage_scenes as usize, params.montage_pixels as usize);
        let nfe = material
            .evaluation
            .as_ref()
            .map_or(Ok(0), |evaluation| picture_nfe(evaluation, "montage_nfe", params.montage_nfe))?;
        let asked = params.montage_nfe_gbuffer;
        let of_gbuffer = |of| if asked.is_none() { Ok(nfe) } else { picture_nfe(of, "montage_nfe_gbuffer", asked) };
        let nfe_gbuffer = material.evaluation.as_ref().map_or(Ok(nfe), of_gbuffer)?;
        let (opening, montages, by_calls) = match (&material.evaluation, action.all_if(material::REFERENCES)?) {
            (Some(evaluation), Some(references)) if scenes > 0 => {
                let refined = action.all_if(material::REFINED)?;
                let input = material.references.as_ref().is_some_and(|of| of.has_input(evaluation.from_spp));
                let choice = Choice { scenes, nfe, nfe_gbuffer, pixels, input };
                let pictures = Pictures::new(ctx, evaluation, references, refined, choice);
                let first = evaluation.nfe.first().copied().unwrap_or(nfe);
                let methods = opening_methods(&standings(evaluation, first));
                let opening = pictures.opening(&methods)?;
                (opening, pictures.by_stratum()?, pictures.by_calls()?)
            }
            _ => Default::default(),
        };
        let (methods, other) = match (action.all_if(material::REFERENCES)?, action.all_if(material::REFINED)?) {
            (Some(references), Some(refined)) if scenes > 0 && material.evaluation.is_none() => {
                MethodPictures::new(ctx, references, refined).montages(scenes, pixels)?
            }
            _ => Default::default(),
        };
        let opening = opening.or(other);
        let ladders = match action.all_if(material::LADDERS)? {
            // Rungs of one cell that are packed as references show nothing new: they are there for the viewer.
            Some(ladders) if scenes > 0 && (action.all_if(material::REFERENCES)?.is_none() || several(ladders)) => {
                ladder_pictures::montage(ctx, ladders, scenes, pixels)?
            }
            _ => None,
        };
        let sheets = match action.all_if(material::PREVIEWS)? {
            Some(previews) if params.gate_pictures > 0 => {
                gate_sheets::sheets(ctx, previews, &material.verdicts, params.gate_pictures as usize)?
            }
            _ => Vec::new(),
        };
        let shown = opening.iter().chain(&montages).chain(&by_calls).chain(&methods);
        let viewer = viewer(ctx, action, material, shown, &sheets)?;
        Ok(Self { nfe, nfe_gbuffer, viewer, opening, montages, by_calls, methods, ladders, sheets })
    }

    /// Whether sections of their own have pictures that are links to the viewer.
    fn lead_to_viewer(&self) -> bool {
        let rejected = self.sheets.iter().any(|sheet| sheet.reason.is_some());
        rejected || self.montages.iter().any(|montage| !montage.rows.is_empty())
    }

    /// Every montage.
    fn all(&self) -> impl Iterator<Item = &Montage> {
        self.montages.iter().chain(&self.by_calls).chain(&self.methods).chain(&self.ladders)
    }
}

/// Whether ladders are of several cells.
fn several(ladders: Items<'_, Ladder>) -> bool {
    ladders.iter().map(|(key, _)| material::cell_of_key(key.as_str())).collect::<BTreeSet<_>>().len() > 1
}

/// The viewer of the scenes on the page and of more; none on a page without images.
fn viewer<'m>(
    ctx: &Context<'_>,
    action: &Action<'_, ReportParams>,
    material: &Material,
    shown: impl Iterator<Item = &'m Montage>,
    sheets: &[Sheet],
) -> Result<Option<Viewer>, KindError> {
    let params = &action.params;
    if params.montage_scenes == 0 {
        return Ok(None);
    }
    let packed = action.all_if(material::REFERENCES)?;
    let made = (action.all_if(material::REFINED)?, action.all_if(material::STATES)?);
    let ladders = [action.all_if(material::LADDERS)?, action.all_if(material::PREVIEWS)?];
    let album = Album::new(ctx, material.evaluation.as_ref(), packed, made, ladders);
    let mut first: Vec<String> = Vec::new();
    let rejected = sheets.iter().filter(|sheet| sheet.reason.is_some()).flat_map(|sheet| &sheet.pictures);
    let scenes = shown.flat_map(|montage| &montage.rows).map(|row| &row.scene);
    for scene in scenes.chain(rejected.map(|shot| &shot.scene)) {
        if !first.contains(scene) {
            first.push(scene.clone());
        }
    }
    album.viewer(&params.title, (&first, params.viewer_scenes as usize), &material.verdicts)
}

/// The best method, and the best of the other sort: a solver if that is a baseline, and the other way round.
fn opening_methods<'a>(standings: &[Standing<'a>]) -> Vec<&'a MethodTable> {
    let ours = |table: &MethodTable| solver(&table.method).is_some();
    let mut tables = standings.iter().filter_map(|of| of.table);
    let Some(first) = tables.next() else { return Vec::new() };
    let second = tables.find(|table| ours(table) != ours(first));
    [first].into_iter().chain(second).collect()
}

/// The figures as CSV and LaTeX, by file name.
fn figures(material: &Material) -> Vec<(&'static str, String)> {
    let mut files = Vec::new();
    if let Some(evaluation) = &material.evaluation {
        files.push(("results.csv", csv::results(evaluation)));
        files.push(("curves.csv", csv::curves(evaluation)));
        files.push(("per_scene.csv", csv::per_scene(evaluation)));
        files.push(("table.tex", tex::table(evaluation, "hdr_psnr")));
        files.push(("tables.tex", tex::others(evaluation)));
        if !evaluation.versus.is_empty() {
            files.push(("versus.csv", csv::versus(evaluation)));
        }
    }
    let claims = sections::claims::judged(material.evaluation.as_ref(), material.bridge_tables());
    if !claims.is_empty() {
        files.push(("claims.csv", sections::claims::csv(&claims)));
    }
    if let Some(assets) = &material.assets {
        files.push(("assets.csv", sections::assets::csv(assets)));
    }
    if let Some(convergence) = &material.convergence {
        files.push(("convergence.csv", sections::convergence::csv(convergence)));
    }
    if let Some(time_error) = &material.time_error {
        files.push(("time_error.csv", sections::time_error::points_csv(time_error)));
        files.push(("time_error_scenes.csv", sections::time_error::scenes_csv(time_error)));
        files.push(("time_error_targets.csv", sections::time_error::targets_csv(time_error)));
    }
    if !material.timings.is_empty() {
        files.push(("timings.csv", timings_csv(&material.timings)));
    }
    files
}

/// The NFE of pictures and heat map.
fn picture_nfe(evaluation: &Evaluation, name: &str, asked: Option<u64>) -> Result<u64, KindError> {
    let first = evaluation.nfe.first().copied().unwrap_or(0);
    match asked {
        None => Ok(first),
        Some(nfe) if evaluation.nfe.contains(&nfe) => Ok(nfe),
        Some(nfe) => Err(KindError::Input(format!(
            "`{name}: {nfe}` was not evaluated, only {:?}; choose one of these, or add it to `nfe` of the \
             refinement",
            evaluation.nfe
        ))),
    }
}

/// The sections that there is material for, in order.
fn sections(material: &Material, params: &ReportParams, images: &Images) -> Result<Vec<Section>, KindError> {
    let evaluation = material.evaluation.as_ref();
    let all = [
        evaluation.and_then(|of| sections::standings::section(of, of.nfe.first().copied().unwrap_or(0))),
        sections::score_tables::section(&material.tables),
        sections::score_tables::pictures(
            images.methods.as_ref(),
            images.ladders.as_ref(),
            images.viewer.as_ref(),
            images.lead_to_viewer(),
        )?
        .map(|own| {
            if images.montages.is_empty() { own } else { Section { id: "renders", title: "Renders".into(), ..own } }
        }),
        evaluation.and_then(|of| sections::claims::section(of, material.bridge_tables())),
        evaluation.and_then(sections::tables::section),
        evaluation.and_then(sections::curves::section),
        evaluation.and_then(|of| sections::strata::section(of, images.nfe)),
        evaluation.and_then(sections::baselines::section),
        material.time_error.as_ref().map(sections::time_error::section),
        sections::montage::section(
            &images.montages,
            &images.by_calls,
            [images.nfe, images.nfe_gbuffer],
            images.viewer.as_ref(),
        )?,
        material.bridge.as_ref().map(|b| sections::bridge::section(b, params.bridge_scenes as usize)),
        sections::losses::section(&material.losses),
        sections::data::section(material),
        material.assets.as_ref().map(sections::assets::section),
        sections::rejected::section(&images.sheets, params.montage_pixels as usize, images.viewer.as_ref())?,
        sections::scenes::section(&material.statistics),
        material.convergence.as_ref().and_then(sections::convergence::section),
        evaluation.map(sections::conventions::section),
        sections::timings::section(&material.timings),
    ];
    Ok(all.into_iter().flatten().collect())
}

/// What was not connected.
fn missing(action: &Action<'_, ReportParams>, material: &Material) -> Vec<String> {
    // A page of tables alone needs none of the inputs for solvers.
    if material.evaluation.is_none() {
        return Vec::new();
    }
    let there = |port: &str| action.all.get(port).is_some_and(|items| !items.is_empty());
    let alone = [material::TABLES.name(), material::LADDERS.name(), material::STATES.name()];
    // Only pipelines with files of assets connect these.
    let files = [material::ASSETS.name(), material::TRAIN_SCENES.name(), material::TEST_SCENES.name()];
    let missing = |name: &&str| !there(name) && !alone.contains(name) && !files.contains(name);
    material::INPUTS.iter().map(|port| port.name).filter(missing).map(str::to_owned).collect()
}

/// Every figure but the measured ones.
fn results_json(material: &Material, params: &ReportParams) -> Result<Vec<u8>, KindError> {
    let gate: BTreeMap<_, _> = gate_counts(&material.verdicts)
        .into_iter()
        .map(|(s, g)| (s, json!({"pool": g.pool, "accepted": g.accepted, "rejected": g.rejected})))
        .collect();
    let mut results = json!({
        "title": params.title,
        "references": material.references,
        "evaluation": material.evaluation,
        "tables": material.tables.iter().map(|(key, table)| (key, table)).collect::<BTreeMap<_, _>>(),
        "losses": material.losses,
        "gate": gate,
        "split": material.split,
        "sampling": material.sampling,
        "bridge": material.bridge_tables(),
        "convergence": material.convergence,
        "statistics": material.statistics.iter().map(|(key, of)| (key, of)).collect::<BTreeMap<_, _>>(),
    });
    if let Some(assets) = &material.assets {
        results["assets"] = json!(assets);
    }
    pretty_json(&results)
}

fn timings_csv(timings: &[(Cell, TrainingTiming)]) -> String {
    let mut out = String::from("parameterization,conditioning,cell,steps,seconds,median_step_ms,threads,machine\n");
    for (cell, timing) in timings {
        let get = |axis: &str| csv::field(cell.get(axis).map_or("", String::as_str));
        let _ = writeln!(
            out,
            "{},{},{},{},{},{},{},{}",
            get(PARAMETERIZATION),
            get(CONDITIONING),
            csv::field(&extra(cell)),
            timing.steps,
            timing.seconds,
            timing.median_step_ms,
            timing.threads,
            csv::field(&named(&timing.machine).unwrap_or_default())
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
        assert!(spec.inputs.iter().all(|port| port.optional), "`run` says that it needs an evaluation or a table");
        assert!(spec.outputs[0].publish && spec.outputs[0].determinism == Determinism::Bitwise);
        assert!(Report::check(&ReportParams::default()).is_empty());
        assert_eq!(Report::check(&ReportParams { title: " ".into(), ..ReportParams::default() }).len(), 1);
    }
}
