#![doc = include_str!("stratified_sampling.md")]

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs,
    ParamProblem,
};
use tauflow_data::{
    ContextClass, Regime, Stratum,
    formats::{JSON, SCENE},
    rng::Stream,
};

/// The kind `stratified_sampling`.
pub struct StratifiedSampling;

/// Params of `stratified_sampling`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StratifiedSamplingParams {
    /// Scenes to choose from the train side.
    pub train: u64,
    /// Scenes to choose from the test side.
    pub test: u64,
    /// Regimes to choose from.
    pub regimes: Vec<Regime>,
    /// Contexts to choose from.
    pub contexts: Vec<ContextClass>,
    /// Seed of the order in which strata get one scene more where a count does not divide.
    pub order_seed: u64,
    /// True takes what there is where a stratum falls short, and says so in the report; false is an error.
    pub allow_short: bool,
}

impl Default for StratifiedSamplingParams {
    fn default() -> Self {
        Self {
            train: 0,
            test: 0,
            regimes: Regime::ALL.to_vec(),
            contexts: ContextClass::ALL.to_vec(),
            order_seed: 0,
            allow_short: false,
        }
    }
}

impl StratifiedSamplingParams {
    fn strata(&self) -> Vec<Stratum> {
        Stratum::all().filter(|s| self.regimes.contains(&s.regime) && self.contexts.contains(&s.context)).collect()
    }
}

/// How many scenes of each stratum make up `total`: equal, or within one of each other with the remainder in seeded
/// order. A larger total gives no stratum less.
pub fn quotas(strata: &[Stratum], total: u64, order_seed: u64) -> Vec<(Stratum, u64)> {
    let n = strata.len().max(1) as u64;
    let mut order: Vec<usize> = (0..strata.len()).collect();
    let rank = |s: &Stratum| Stream::new(order_seed, &[]).part(&s.to_string()).bits();
    order.sort_by_key(|i| (rank(&strata[*i]), *i));
    let mut out: Vec<(Stratum, u64)> = strata.iter().map(|s| (*s, total / n)).collect();
    for i in order.into_iter().take((total % n) as usize) {
        out[i].1 += 1;
    }
    out
}

#[derive(Debug, Serialize)]
struct StratumReport {
    wanted: u64,
    available: u64,
    chosen: u64,
}

#[derive(Debug, Serialize)]
struct SideReport {
    wanted: u64,
    chosen: u64,
    /// True if every stratum was asked for equally many.
    equal: bool,
    strata: BTreeMap<String, StratumReport>,
}

#[derive(Debug, Serialize)]
struct Report {
    train: SideReport,
    test: SideReport,
    /// Strata that fall short, one line each.
    short: Vec<String>,
    notes: Vec<String>,
}

/// Chooses by quota among what is not taken, in order of index within each stratum.
fn choose(
    name: &str,
    side: Option<&Collection>,
    taken: Option<&Collection>,
    quotas: &[(Stratum, u64)],
    short: &mut Vec<String>,
) -> Result<(Collection, SideReport), KindError> {
    let mut by_stratum: BTreeMap<Stratum, Vec<(u64, &ItemKey, &Artifact)>> = BTreeMap::new();
    let free = |key: &ItemKey| taken.is_none_or(|taken| !taken.items.contains_key(key));
    for (key, artifact) in side.into_iter().flat_map(Collection::iter).filter(|(key, _)| free(key)) {
        let (stratum, index) = Stratum::of_key(key.as_str()).ok_or_else(|| {
            KindError::Input(format!("item `{key}` names no stratum and index, as L1-open-000123 does"))
        })?;
        by_stratum.entry(stratum).or_default().push((index, key, artifact));
    }
    let mut chosen = Collection::default();
    let mut strata = BTreeMap::new();
    for (stratum, wanted) in quotas {
        let mut there = by_stratum.remove(stratum).unwrap_or_default();
        there.sort_by_key(|(index, key, _)| (*index, *key));
        let available = there.len() as u64;
        let chosen_here = available.min(*wanted);
        if chosen_here < *wanted {
            short.push(format!("{stratum} on the {name} side: {available} of {wanted} scenes"));
        }
        chosen.items.extend(there.into_iter().take(chosen_here as usize).map(|(_, k, a)| (k.clone(), a.clone())));
        strata.insert(stratum.to_string(), StratumReport { wanted: *wanted, available, chosen: chosen_here });
    }
    let wanted = quotas.iter().map(|q| q.1).sum();
    let equal = quotas.windows(2).all(|w| w[0].1 == w[1].1);
    let report = SideReport { wanted, chosen: chosen.len() as u64, equal, strata };
    Ok((chosen, report))
}

impl Kind for StratifiedSampling {
    type Params = StratifiedSamplingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "stratified_sampling",
            version: 1,
            summary: "Fills each side's quota evenly over the strata",
            manual: include_str!("stratified_sampling.md"),
            mode: Mode::Gather,
            inputs: const {
                &[
                    InputPort::whole("train", SCENE, "scenes of the train side").or_none(),
                    InputPort::whole("test", SCENE, "scenes of the test side").or_none(),
                    InputPort::whole("taken", SCENE, "scenes that another sampling has chosen: not chosen again")
                        .or_none(),
                ]
            },
            outputs: const {
                &[
                    OutputPort::new("train", SCENE, "the chosen scenes of the train side"),
                    OutputPort::new("test", SCENE, "the chosen scenes of the test side"),
                    OutputPort::new("report", JSON, "wanted, available and chosen by stratum"),
                ]
            },
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut out = Vec::new();
        for (pointer, empty) in [("/regimes", params.regimes.is_empty()), ("/contexts", params.contexts.is_empty())] {
            if empty {
                out.push(ParamProblem::new(pointer, "the list is empty", "name at least one"));
            }
        }
        out
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let strata = params.strata();
        let taken = action.whole.get("taken").copied();
        let mut short = Vec::new();
        let mut side = |name: &str, total: u64| {
            let input = action.whole.get(name).copied();
            if total > 0 && input.is_none() {
                return Err(KindError::Input(format!(
                    "`{name}: {total}` is asked for, but the input `{name}` is not connected; connect it or ask for 0"
                )));
            }
            choose(name, input, taken, &quotas(&strata, total, params.order_seed), &mut short)
        };
        let (train, train_report) = side("train", params.train)?;
        let (test, test_report) = side("test", params.test)?;
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
        let report = Report { train: train_report, test: test_report, short, notes };
        let key = ItemKey::new("report").expect("letters");
        let report = Artifact::blob(JSON, ctx.put_json(&report)?);
        Ok(Outputs::default()
            .collection("train", train)
            .collection("test", test)
            .collection("report", [(key, report)].into_iter().collect()))
    }
}

#[cfg(test)]
mod tests;
