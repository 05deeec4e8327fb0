#![doc = include_str!("stratified_sampling.md")]

use crate::signature::{QUANTUM, signature};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{
    Action, All, Before, Context, Digest, Facts, Foreseen, Group, Handle, ItemKey, Items, Kind, KindError, KindSpec,
    Known, Later, MOST_ITEMS, Media, Mode, Out, Outlook, Outputs, ParamProblem, Stored,
};
use tauflow_data::{
    ContextClass, Regime, Stratum, StratumName,
    records::{Quota, SamplingReport, SceneRecord, StratumQuota},
    rng::Stream,
};

const TRAIN_SIDE: All<SceneRecord> = All::new("train", "Scenes of the training side.").or_none();
const TEST_SIDE: All<SceneRecord> = All::new("test", "Scenes of the test side.").or_none();
const TAKEN: All<SceneRecord> =
    All::new("taken", "Scenes chosen by a different sampling, which are skipped.").or_none();

const MAIN: Group = Group::main(2);
const TRAIN: Out<SceneRecord> = Out::new(MAIN, "train", "The chosen training scenes.");
const TEST: Out<SceneRecord> = Out::new(MAIN, "test", "The chosen test scenes.");
const REPORT: Out<SamplingReport> =
    Out::new(MAIN, "report", "Wanted, available and chosen scenes per stratum.").single();

/// The kind `stratified_sampling`.
pub struct StratifiedSampling;

/// Params of `stratified_sampling`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StratifiedSamplingParams {
    /// Number of training scenes to choose.
    pub train: u64,
    /// Number of test scenes to choose.
    pub test: u64,
    /// Maximum number of training scenes per content; none for no limit.
    #[schemars(range(min = 1))]
    pub train_views: Option<u64>,
    /// Maximum number of test scenes per content; none for no limit.
    #[schemars(range(min = 1))]
    pub test_views: Option<u64>,
    /// Regimes to choose from.
    #[schemars(length(min = 1))]
    pub regimes: Vec<Regime>,
    /// Contexts to choose from.
    #[schemars(length(min = 1))]
    pub contexts: Vec<ContextClass>,
    /// Strata to choose from by name, in place of those of `regimes` and `contexts`.
    pub strata: Vec<StratumName>,
    /// Seed of the order in which strata receive the remainder of a count.
    pub order_seed: u64,
    /// Take the available scenes if a stratum has too few, and report it; otherwise this is an error.
    pub allow_short: bool,
}

impl Default for StratifiedSamplingParams {
    fn default() -> Self {
        Self {
            train: 0,
            test: 0,
            train_views: None,
            test_views: None,
            regimes: Regime::ALL.to_vec(),
            contexts: ContextClass::ALL.to_vec(),
            strata: Vec::new(),
            order_seed: 0,
            allow_short: false,
        }
    }
}

impl StratifiedSamplingParams {
    fn strata(&self) -> Vec<StratumName> {
        if !self.strata.is_empty() {
            return self.strata.clone();
        }
        let wanted = |s: &Stratum| self.regimes.contains(&s.regime) && self.contexts.contains(&s.context);
        Stratum::all().filter(wanted).map(StratumName::from).collect()
    }
}

/// A param before which all scenes were chosen from.
const fn before(pointer: &'static str) -> Later {
    Later { pointer, before: Before::Null }
}

/// How many scenes of each stratum make up `total`: equal, or within one of each other with the remainder in seeded
/// order. A larger total gives no stratum less.
pub fn quotas(strata: &[StratumName], total: u64, order_seed: u64) -> Vec<(StratumName, u64)> {
    let n = strata.len().max(1) as u64;
    let mut order: Vec<usize> = (0..strata.len()).collect();
    let rank = |s: &StratumName| Stream::new(order_seed, &[]).part(s.as_str()).bits();
    order.sort_by_key(|i| (rank(&strata[*i]), *i));
    let mut out: Vec<(StratumName, u64)> = strata.iter().map(|s| (s.clone(), total / n)).collect();
    for i in order.into_iter().take((total % n) as usize) {
        out[i].1 += 1;
    }
    out
}

/// A scene that may be chosen.
struct Candidate<'a> {
    index: u64,
    key: &'a ItemKey,
    scene: Handle<'a, SceneRecord>,
}

/// Scenes that were chosen.
type Chosen = Vec<(ItemKey, Stored<SceneRecord>)>;

/// What tells the contents of a stratum apart.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Content {
    /// The number of a generated one.
    Numbered(u64),
    /// The signature of one that was read from a file: all of its cameras share it.
    Unnumbered(Digest),
}

/// Passes over the views of a content beyond the first so many: others are let through as they are.
fn few_views<'a>(
    ctx: &Context<'_>,
    there: Vec<Candidate<'a>>,
    views: Option<u64>,
) -> Result<Vec<Candidate<'a>>, KindError> {
    let Some(views) = views else { return Ok(there) };
    let mut seen: BTreeMap<Content, u64> = BTreeMap::new();
    let mut out = Vec::new();
    for candidate in there {
        let recipe = SceneRecord::recipe(ctx, candidate.scene)?;
        let content =
            recipe.content.map_or_else(|| Content::Unnumbered(signature(&recipe, QUANTUM)), Content::Numbered);
        let count = seen.entry(content).or_default();
        *count += 1;
        if *count <= views {
            out.push(candidate);
        }
    }
    Ok(out)
}

/// Chooses by quota among what is not taken, in order of index within each stratum, so many views of a content at most.
fn choose(
    ctx: &Context<'_>,
    (name, views): (&str, Option<u64>),
    side: Option<Items<'_, SceneRecord>>,
    taken: Option<Items<'_, SceneRecord>>,
    quotas: &[(StratumName, u64)],
    short: &mut Vec<String>,
) -> Result<(Chosen, Quota), KindError> {
    let mut by_stratum: BTreeMap<StratumName, Vec<Candidate<'_>>> = BTreeMap::new();
    let free = |key: &ItemKey| taken.is_none_or(|taken| taken.get(key.as_str()).is_none());
    for (key, scene) in side.into_iter().flat_map(Items::iter).filter(|(key, _)| free(key)) {
        let (stratum, index) = StratumName::of_key(key.as_str()).ok_or_else(|| {
            KindError::Input(format!(
                "item `{key}` names no stratum and index, as L1-open-000123 and kitchens-000123 do"
            ))
        })?;
        by_stratum.entry(stratum).or_default().push(Candidate { index, key, scene });
    }
    let mut chosen = Chosen::new();
    let mut strata = BTreeMap::new();
    for (stratum, wanted) in quotas {
        let mut there = by_stratum.remove(stratum).unwrap_or_default();
        there.sort_by_key(|candidate| (candidate.index, candidate.key));
        let there = few_views(ctx, there, views)?;
        let available = there.len() as u64;
        let chosen_here = available.min(*wanted);
        if chosen_here < *wanted {
            short.push(format!("{stratum} on the {name} side: {available} of {wanted} scenes"));
        }
        let taken = there.into_iter().take(chosen_here as usize);
        chosen.extend(taken.map(|Candidate { key, scene, .. }| (key.clone(), scene.to_stored())));
        strata.insert(stratum.to_string(), StratumQuota { wanted: *wanted, available, chosen: chosen_here });
    }
    let wanted = quotas.iter().map(|q| q.1).sum();
    let equal = quotas.windows(2).all(|w| w[0].1 == w[1].1);
    let report = Quota { wanted, chosen: chosen.len() as u64, equal, strata };
    Ok((chosen, report))
}

impl Kind for StratifiedSampling {
    type Params = StratifiedSamplingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "stratified_sampling",
            summary: "Chooses training and test scenes equally from all strata.",
            manual: include_str!("stratified_sampling.md"),
            mode: Mode::Gather,
            inputs: vec![TRAIN_SIDE.port(), TEST_SIDE.port(), TAKEN.port()],
            outputs: vec![TRAIN.port(), TEST.port(), REPORT.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut problems = Vec::new();
        let whole = Self::Params::default();
        if !params.strata.is_empty() && (&params.regimes, &params.contexts) != (&whole.regimes, &whole.contexts) {
            let what = "`strata` beside `regimes` or `contexts`";
            problems.push(ParamProblem::new("/strata", what, "name all strata in `strata`, or leave it out"));
        }
        let distinct: BTreeSet<&StratumName> = params.strata.iter().collect();
        if distinct.len() < params.strata.len() {
            problems.push(ParamProblem::new("/strata", "a stratum is named twice", "name each once"));
        }
        problems
    }

    fn later() -> &'static [Later] {
        // An empty list of names.
        const NO_STRATA: Later = Later { pointer: "/strata", before: Before::Integers(&[]) };
        const { &[before("/train_views"), before("/test_views"), NO_STRATA] }
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let lacks = |port: All<SceneRecord>, total: u64| {
            let name = port.name();
            let message = format!("`{name}: {total}` is asked for, but the input `{name}` is not connected");
            let problem = || Foreseen::param(&format!("/{name}"), message, format!("connect `{name}`, or ask for 0"));
            (total > 0 && !known.has(name)).then(problem)
        };
        let problems = lacks(TRAIN_SIDE, params.train).into_iter().chain(lacks(TEST_SIDE, params.test));
        let most = |count: u64| Facts::default().with(MOST_ITEMS, count);
        Outlook::default().with(TRAIN, most(params.train)).with(TEST, most(params.test)).but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let strata = params.strata();
        let taken = action.all_if(TAKEN)?;
        let mut short = Vec::new();
        let mut side = |port: All<SceneRecord>, total: u64, views: Option<u64>| {
            let (name, input) = (port.name(), action.all_if(port)?);
            if total > 0 && input.is_none() {
                return Err(KindError::Input(format!(
                    "`{name}: {total}` is asked for, but the input `{name}` is not connected; connect it or ask for 0"
                )));
            }
            choose(ctx, (name, views), input, taken, &quotas(&strata, total, params.order_seed), &mut short)
        };
        let (train, train_report) = side(TRAIN_SIDE, params.train, params.train_views)?;
        let (test, test_report) = side(TEST_SIDE, params.test, params.test_views)?;
        if !short.is_empty() && !params.allow_short {
            return Err(KindError::Input(format!(
                "strata fall short: {}; raise the pool or the side's share, ask for fewer, or set `allow_short: true`",
                short.join("; ")
            )));
        }
        let mut notes = Vec::new();
        if !test_report.equal {
            let n = strata.len() as u64;
            notes.push(format!(
                "the test side's {} scenes do not divide by {n} strata: balanced within one; {} would be equal",
                params.test,
                params.test.next_multiple_of(n)
            ));
        }
        let report = SamplingReport { train: train_report, test: test_report, short, notes };
        Outputs::default().put_all(TRAIN, train).put_all(TEST, test).put_one(REPORT, REPORT.name(), report.store(ctx)?)
    }
}

#[cfg(test)]
mod tests;
