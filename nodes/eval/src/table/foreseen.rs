//! Problems of a table that are certain before its scores exist: metrics and axes that they lack, and axes that are
//! left over.

use super::{
    AgainstParams, TableParams,
    tabulate::{METHOD, NFE, SPP, STRATUM, quoted},
};
use crate::evaluation::coordinates;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Fact, Foreseen, Source};
use tauflow_data::{
    facts,
    records::{AxisValue, BASIC},
};

/// Axes that the scores are sure not to have, and axes that are sure to be left over.
pub(super) fn foreseen(sources: &[Source], params: &TableParams) -> Vec<Foreseen> {
    let mut problems = Vec::new();
    let of: Vec<BTreeMap<String, String>> = sources.iter().map(|source| coordinates(&source.prefix)).collect();
    let own = [METHOD, SPP, NFE, STRATUM];
    let names: BTreeSet<&str> = of.iter().flat_map(|axes| axes.keys().map(String::as_str)).chain(own).collect();
    for (list, chosen) in [("rows", &params.rows), ("columns", &params.columns)] {
        for (place, name) in chosen.iter().enumerate().filter(|(_, name)| !names.contains(name.as_str())) {
            let message = format!("`{list}` names the axis `{name}`, which the scores do not have");
            let hint = format!("they have {}", quoted(&names));
            problems.push(Foreseen::param(&format!("/{list}/{place}"), message, hint));
        }
    }
    let placed = |name: &str| params.rows.iter().chain(&params.columns).any(|own| own == name);
    if !params.rows.is_empty() && problems.is_empty() {
        // Where no image is sure to be there, there may be no score with this value.
        let sure: Vec<_> =
            sources.iter().zip(&of).filter(|(source, _)| source.facts.get(facts::SPP).is_some()).collect();
        // The axis `from` says the sample count, too: one of both is enough.
        let twice = |name: &str| (name == SPP && placed("from")) || (name == "from" && placed(SPP));
        for name in names.iter().filter(|name| !own.contains(*name) && !placed(name) && !twice(name)) {
            let values: BTreeSet<&str> =
                sure.iter().map(|(_, axes)| axes.get(*name).map_or("", String::as_str)).collect();
            if values.len() > 1 {
                let message = format!(
                    "the axis `{name}` has the values {} and is neither in `rows` nor in `columns`",
                    quoted(&values)
                );
                let hint = format!("add it, or select one value as in `scores: \"node[{name}=value]\"`");
                problems.push(Foreseen::param("/rows", message, hint));
            }
        }
        for (name, known) in [(SPP, counts(sources, facts::SPP)), (NFE, counts(sources, facts::NFE))] {
            if let Some(known) = known.filter(|known| known.len() > 1 && !placed(name) && !twice(name)) {
                let known = quoted(known.iter().map(u64::to_string));
                let message =
                    format!("the axis `{name}` has the values {known} and is neither in `rows` nor in `columns`");
                problems.push(Foreseen::param("/rows", message, "add it"));
            }
        }
    }
    if let Some(AgainstParams { axis, value }) = &params.against {
        if !names.contains(axis.as_str()) {
            let message = format!("`against` names the axis `{axis}`, which the scores do not have");
            problems.push(Foreseen::param("/against/axis", message, format!("they have {}", quoted(&names))));
            return problems;
        }
        let values = values_of(axis, sources, &of);
        if !placed(axis) && (!params.rows.is_empty() || stays_out(axis, values.as_ref())) {
            // An axis with several values was told of above.
            if problems.is_empty() {
                let message = format!("`against` names the axis `{axis}`, which is no axis of the table");
                problems.push(Foreseen::param("/against/axis", message, "add it to `rows` or `columns`".to_owned()));
            }
        } else if let Some(known) = values.filter(|known| !known.contains(&value.value().to_string())) {
            let message = format!("the axis `{axis}` has no value `{}`", value.value());
            problems.push(Foreseen::param("/against/value", message, format!("it has {}", quoted(&known))));
        }
    }
    problems
}

/// Metrics of the table that scores are sure not to have.
pub(super) fn absent_metrics(sources: &[Source], metrics: &[String]) -> Vec<Foreseen> {
    metrics.iter().enumerate().filter_map(|(place, name)| lacking(sources, name, place)).collect()
}

fn lacking(sources: &[Source], name: &str, place: usize) -> Option<Foreseen> {
    let lacks = |source: &&Source| {
        source.facts.get(facts::MORE_METRICS).is_some_and(|more| !more.iter().any(|own| own == name))
    };
    let source = sources.iter().filter(|_| !BASIC.contains(&name)).find(lacks)?;
    let message = format!("`{}` does not compute the metric `{name}`", source.name);
    let hint = match name {
        "lpips" => format!("read the scores of a node of kind `lpips`, which adds it to those of `{}`", source.name),
        _ => format!("add `{name}` to `also` of `{}`", source.name),
    };
    Some(Foreseen::param(&format!("/metrics/{place}"), message, hint))
}

/// The values on an axis over all scores, as a table shows them; none if they are not known.
fn values_of(axis: &str, sources: &[Source], of: &[BTreeMap<String, String>]) -> Option<BTreeSet<String>> {
    let known = |fact| counts(sources, fact).map(|counts| counts.iter().map(u64::to_string).collect());
    match axis {
        SPP => known(facts::SPP),
        NFE => known(facts::NFE),
        // A score tells the method that no matrix names.
        METHOD if of.iter().any(|axes| !axes.contains_key(METHOD)) => None,
        _ if of.iter().any(|axes| axes.contains_key(axis)) => {
            // A score without a coordinate has the empty text there.
            let text = |axes: &BTreeMap<String, String>| axes.get(axis).map_or("", String::as_str).to_owned();
            Some(of.iter().map(|axes| AxisValue::parse(&text(axes)).to_string()).collect())
        }
        _ => None,
    }
}

/// Whether an axis with these values does not become rows by itself.
fn stays_out(axis: &str, values: Option<&BTreeSet<String>>) -> bool {
    axis == STRATUM || values.is_some_and(|values| values.len() < 2)
}

/// The values of `spp` or `nfe` over all scores, if every source tells its own.
fn counts(sources: &[Source], fact: Fact<Vec<u64>>) -> Option<BTreeSet<u64>> {
    let of: Option<Vec<Vec<u64>>> = sources.iter().map(|source| source.facts.get(fact)).collect();
    of.filter(|of| !of.is_empty()).map(|of| of.into_iter().flatten().collect())
}
