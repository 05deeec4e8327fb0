#![doc = include_str!("adapter_report.md")]

mod album;
mod energy;
mod montage;
mod samples;
mod table;
mod tables_csv;
mod trajectory;
mod verdicts;

use crate::{
    page,
    sections::{self, claims::Judged},
    shelf::Viewer,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, All, Before, Context, FileTree, Files, Group, Kind, KindError, KindSpec, Later, Media, Mode, Out, Outputs,
    ParamProblem, WriteFiles, pretty_json,
};
use tauflow_data::records::{Generated, ImageQuality};

/// The kind `adapter_report`.
pub struct AdapterReport;

/// Params of `adapter_report`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AdapterReportParams {
    /// Title of the page.
    pub title: String,
    /// A sentence below the title, such as the training data of the backbones; may be empty.
    pub subtitle: String,
    /// Number of samples per backbone in the montage; 0 for no images.
    #[schemars(range(min = 0, max = 20))]
    pub montage_samples: u64,
    /// Maximum side of an image in pixels; larger images are reduced by an integer factor.
    #[schemars(range(min = 16, max = 2048))]
    pub montage_pixels: u64,
    /// Number of samples per backbone in the viewer; 0 for no viewer.
    #[schemars(range(min = 0, max = 1000))]
    pub viewer_samples: u64,
}

impl Default for AdapterReportParams {
    fn default() -> Self {
        Self {
            title: "Transport adapter".into(),
            subtitle: String::new(),
            montage_samples: 3,
            montage_pixels: 192,
            viewer_samples: 32,
        }
    }
}

const QUALITY: All<ImageQuality> = All::new("quality", "Scores, gains and verdicts.").single();
const GENERATED: All<Generated> = All::new("generated", "The samples, for the images.").or_none();
const PAGE: Out<Files> =
    Out::new(Group::main(8), "report", "The page, and its figures as JSON, CSV and PNG.").single().published();

impl Kind for AdapterReport {
    type Params = AdapterReportParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "adapter_report",
            summary: "Reports the effect of transport adapters on generative backbones: a page, JSON, CSV and images.",
            manual: include_str!("adapter_report.md"),
            mode: Mode::Gather,
            inputs: vec![QUALITY.port(), GENERATED.port()],
            outputs: vec![PAGE.port()],
            seeded: false,
        }
    }

    fn later() -> &'static [Later] {
        &[Later { pointer: "/viewer_samples", before: Before::Integer(0) }]
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if !params.title.trim().is_empty() {
            return Vec::new();
        }
        vec![ParamProblem::new("/title", "the title is empty", "write what the pipeline is about")]
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let quality = action.only(QUALITY)?.load(ctx)?;
        let params = &action.params;
        let generated = action.all_if(GENERATED)?.filter(|_| params.montage_samples > 0);
        let generated = generated.map(|items| samples::by_backbone(ctx, items)).transpose()?.unwrap_or_default();
        let (pixels, number) = (params.montage_pixels as usize, params.montage_samples as usize);
        let montages = montage::montages(ctx, &generated, number, pixels)?;
        let trajectories = trajectory::all(ctx, &generated, pixels)?;
        let viewer = album::viewer(ctx, &params.title, &generated, params.viewer_samples as usize)?;
        ctx.check_cancelled()?;
        let all = [
            Some(table::section(&quality)),
            verdicts::section(&quality),
            montage::section(&montages, viewer.as_ref())?,
            energy::section(&quality),
            trajectory::section(&trajectories, viewer.as_ref())?,
            Some(table::conventions(&quality)),
        ];
        let sections: Vec<page::Section> = all.into_iter().flatten().collect();
        let missing: Vec<String> =
            action.all_if(GENERATED)?.is_none().then(|| GENERATED.name().to_owned()).into_iter().collect();
        let mut files = FileTree::new();
        let mut put = |name: &str, bytes: &[u8]| files.put(name, bytes);
        put("quality.json", &pretty_json(&quality)?)?;
        put("scores.csv", tables_csv::scores(&quality).as_bytes())?;
        put("gains.csv", tables_csv::gains(&quality).as_bytes())?;
        put("energy.csv", tables_csv::energy(&quality).as_bytes())?;
        // A backbone has at least two samples.
        let judged = |claim| Judged { claim, has_intervals: true };
        let claims: Vec<Judged<'_>> = quality.backbones.iter().filter_map(|of| of.claim.as_ref().map(judged)).collect();
        if !claims.is_empty() {
            put("claims.csv", sections::claims::csv(&claims).as_bytes())?;
        }
        if !quality.per_sample.is_empty() {
            put("per_sample.csv", tables_csv::per_sample(&quality).as_bytes())?;
        }
        if let Some(viewer) = &viewer {
            put(Viewer::FILE, viewer.html.as_bytes())?;
        }
        for montage in &montages {
            put(&montage.file, &montage.png()?)?;
        }

        let header = verdicts::header(&quality, &params.subtitle, &page::provenance(&action.all));
        let beside = "<code>quality.json</code> and as CSV files";
        let html = page::page(&params.title, &header, &sections, &missing, beside);
        files.put("adapter_report.html", html.as_bytes())?;
        Outputs::default().put_one(PAGE, "report", Files(files).store(ctx)?)
    }
}
