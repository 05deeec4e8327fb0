//! The metrics that a node computes on request, as its params name them.

use crate::{
    metrics::{More, too_small},
    ssim::{MOST_SCALES, scales_that_fit},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{Before, Facts, Foreseen, Later, Named, ParamProblem, Source};
use tauflow_data::facts::{FILM, MORE_METRICS};

/// A metric that is computed only if asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnRequest {
    /// SSIM over several scales.
    MsSsim,
    /// FLIP of previews.
    Flip,
    /// FLIP over exposures of linear radiance.
    HdrFlip,
}

impl OnRequest {
    fn name(self) -> &'static str {
        match self {
            Self::MsSsim => "ms_ssim",
            Self::Flip => "flip",
            Self::HdrFlip => "hdr_flip",
        }
    }
}

/// The default of `ms_ssim_scales`.
pub(crate) const SCALES: u64 = MOST_SCALES as u64;

/// The params for metrics on request, which came later than their kinds.
pub(crate) const LATER: &[Later] = &[
    Later { pointer: "/also", before: Before::Integers(&[]) },
    Later { pointer: "/ms_ssim_scales", before: Before::Integer(SCALES as i64) },
];

/// The metrics that the params ask for.
pub(crate) fn more(also: &[OnRequest], scales: u64) -> More {
    More {
        ms_ssim: also.contains(&OnRequest::MsSsim).then_some(scales as usize),
        flip: also.contains(&OnRequest::Flip),
        hdr_flip: also.contains(&OnRequest::HdrFlip),
    }
}

/// Problems of the params themselves.
pub(crate) fn check(also: &[OnRequest], scales: u64) -> Vec<ParamProblem> {
    let twice = also.iter().enumerate().filter(|(place, metric)| also[..*place].contains(metric));
    let mut problems: Vec<ParamProblem> = twice
        .map(|(place, metric)| {
            let message = format!("`{}` is named twice", metric.name());
            ParamProblem::new(format!("/also/{place}"), message, "name each metric once")
        })
        .collect();
    if scales != SCALES && !also.contains(&OnRequest::MsSsim) {
        problems.push(ParamProblem::new(
            "/ms_ssim_scales",
            "`ms_ssim_scales` is set, but `ms_ssim` is not computed",
            "add `ms_ssim` to `also`, or remove `ms_ssim_scales`",
        ));
    }
    problems
}

/// Whether images are sure to be too small for the scales of MS-SSIM; `port` is the input of `source`.
pub(crate) fn too_few_pixels(port: impl Named, source: &Source, also: &[OnRequest], scales: u64) -> Option<Foreseen> {
    let scales = more(also, scales).ms_ssim?;
    let [width, height] = source.facts.get(FILM).filter(|[w, h]| scales_that_fit(*w, *h) < scales)?;
    let told = too_small(width, height, scales);
    let (message, hint) = told.split_once("; ").unwrap_or((&told, "increase the resolution"));
    Some(Foreseen::input(port, format!("the images of `{}` are too small: {message}", source.name), hint))
}

/// The names, as a fact of the scores.
pub(crate) fn known(scores: Facts, also: &[OnRequest]) -> Facts {
    scores.with(MORE_METRICS, also.iter().map(|metric| metric.name().to_owned()).collect())
}
