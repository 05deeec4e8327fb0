//! Means, intervals, curves and claims, as `evaluation` hands them on.

use super::{Estimate, Score, has_intervals};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::json_media;

/// The results of `evaluation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Sample count of the references.
    pub reference_spp: u64,
    /// Sample count of the endpoint that all start from.
    pub from_spp: u64,
    /// Number of test scenes.
    pub scenes: u64,
    /// Number of groups of them that intervals are over; none where each scene stands for itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groups: Option<u64>,
    /// Number of bootstrap resamples.
    pub resamples: u64,
    /// The network calls that were measured, increasing.
    pub nfe: Vec<u64>,
    /// The input itself.
    pub hold: BTreeMap<String, Estimate>,
    /// One for each cell: space, method, conditioning.
    pub methods: Vec<MethodTable>,
    /// Other methods that were scored on the same scenes, such as denoisers; one for each cell.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub baselines: Vec<MethodTable>,
    /// Every solver against every baseline, at each of the solver's NFE.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub versus: Vec<Versus>,
    /// Claims about the solvers, tested against these figures.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub claims: Vec<Claim>,
    /// Omitted methods, with the reasons.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Every score, for further work.
    pub per_scene: Vec<SceneRow>,
}

impl Evaluation {
    /// Whether its means have intervals.
    pub fn has_intervals(&self) -> bool {
        has_intervals(self.scenes, self.groups)
    }

    /// The table of a cell.
    pub fn table_of(&self, cell: &BTreeMap<String, String>) -> Option<&MethodTable> {
        self.methods.iter().chain(&self.baselines).find(|table| table.cell == *cell)
    }
}

/// A claim, in one group of cells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Claim {
    /// The claim.
    pub statement: String,
    /// Coordinates that the cells share.
    pub group: BTreeMap<String, String>,
    /// Differences that are all above 0 if it is so.
    pub evidence: Vec<Evidence>,
    /// The verdict.
    pub verdict: ClaimVerdict,
}

/// A difference that a claim says is above 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// The figure.
    pub what: String,
    /// In which metric.
    pub metric: String,
    /// The difference, paired by scene; the mean over draws of the trainings, where there are several.
    pub difference: Estimate,
    /// The same mean, with its interval over draws of the trainings; none of a single draw.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub draws: Option<Estimate>,
}

impl Evidence {
    /// Whether all its intervals are above 0. Says nothing where there is none over scenes ([`has_intervals`]).
    pub fn is_above(&self) -> bool {
        self.difference.low > 0.0 && self.draws.is_none_or(|draws| draws.low > 0.0)
    }

    /// Whether all its intervals are below 0. Says nothing where there is none over scenes ([`has_intervals`]).
    pub fn is_below(&self) -> bool {
        self.difference.high < 0.0 && self.draws.is_none_or(|draws| draws.high < 0.0)
    }
}

/// The verdict on a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClaimVerdict {
    /// All intervals are above 0.
    Held,
    /// The intervals of a difference are below 0.
    NotHeld,
    /// Neither, or there are no intervals over scenes.
    Undecided,
}

/// A solver against a baseline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Versus {
    /// The solver's cell.
    pub cell: BTreeMap<String, String>,
    /// Its network calls.
    pub nfe: u64,
    /// The baseline's cell.
    pub baseline: BTreeMap<String, String>,
    /// The baseline's method.
    pub method: String,
    /// Paired difference, the solver's value less the baseline's, by metric.
    pub gain: BTreeMap<String, Estimate>,
    /// Share of scenes on which the solver is better, by metric.
    pub better: BTreeMap<String, f64>,
}

/// The row of a method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodTable {
    /// The cell's coordinates, e.g. `parameterization` -> `mc_noise`.
    pub cell: BTreeMap<String, String>,
    /// The method: the coordinate `parameterization`.
    pub method: String,
    /// The conditioning: the coordinate `conditioning`, `rgb` if there is none.
    pub conditioning: String,
    /// The training space: the coordinate `space`, empty if there is none.
    pub space: String,
    /// One for each NFE.
    pub at: Vec<NfeTable>,
    /// Area under the curve over log NFE, by metric.
    pub auc: BTreeMap<String, Estimate>,
    /// Total variation over log NFE, by metric.
    pub tv: BTreeMap<String, Estimate>,
}

/// A method at one NFE.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NfeTable {
    /// Network calls.
    pub nfe: u64,
    /// Means over scenes, by metric.
    pub metrics: BTreeMap<String, Estimate>,
    /// Paired difference to the input itself, by metric.
    pub gain: BTreeMap<String, Estimate>,
    /// Mean over the scenes of each stratum, by stratum and metric.
    pub strata: BTreeMap<String, BTreeMap<String, f64>>,
}

/// One score in one row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneRow {
    /// The scene's item key.
    pub scene: String,
    /// Its stratum, e.g. `L1-open`.
    pub stratum: String,
    /// The cell's coordinates; empty for hold.
    pub cell: BTreeMap<String, String>,
    /// The score.
    pub score: Score,
}

json_media! { Evaluation, "tauflow/evaluation", "Means, intervals, curves, claims and every score."; }
