#![doc = include_str!("evaluation.md")]

use crate::{
    bootstrap::{Resampled, Table},
    claims::{Curve, claims},
    curve::summarise,
    groups::{Groups, SPLIT},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Debug,
};
use tauflow_contract::{
    Action, All, Context, Fact, Facts, Foreseen, Group, ItemKey, Items, Kind, KindError, KindSpec, Known, Media, Mode,
    Out, Outlook, Outputs, Source,
};
use tauflow_data::{
    StratumName,
    facts::{MORE_METRICS, NFE, REFERENCE_SPP, SPP},
    methods::{
        Conditioning,
        axes::{CONDITIONING, PARAMETERIZATION, SPACE},
    },
    records::{
        Estimate, Evaluation, MethodTable, Metrics, NfeTable, SceneRow, SceneScores, Score, Versus, bounded, computed,
        higher_is_better,
    },
};

/// The kind `evaluation`.
pub struct EvaluationKind;

/// Params of `evaluation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationParams {
    /// Number of bootstrap resamples.
    #[schemars(range(min = 100, max = 100_000))]
    pub resamples: u64,
}

impl Default for EvaluationParams {
    fn default() -> Self {
        Self { resamples: 2000 }
    }
}

const SCORES: All<SceneScores> = All::new("scores", "Scores of refined images, by cell and scene.");
const HOLD: All<SceneScores> = All::new("hold", "Scores of the endpoints from which all methods start, by scene.");
const BASELINES: All<SceneScores> =
    All::new("baselines", "Scores of other methods, such as denoisers, by cell and scene.").or_none();
const MAIN: Group = Group::main(7);
const TABLES: Out<Evaluation> = Out::new(MAIN, "tables", "Means, intervals, curves and all scores.").single();

impl Kind for EvaluationKind {
    type Params = EvaluationParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "evaluation",
            summary: "Aggregates scores by method, network calls and stratum, with confidence intervals.",
            manual: include_str!("evaluation.md"),
            mode: Mode::Gather,
            inputs: vec![SCORES.port(), HOLD.port(), BASELINES.port(), SPLIT.port()],
            outputs: vec![TABLES.port()],
            seeded: true,
        }
    }

    fn foresee(_params: &Self::Params, known: &Known) -> Outlook {
        let (hold, scores, baselines) = (known.all(HOLD), known.all(SCORES), known.all(BASELINES));
        let mut problems: Vec<Foreseen> = Vec::new();
        let cells: BTreeSet<&str> = hold.iter().map(|source| source.prefix.as_str()).collect();
        if cells.len() > 1 {
            let message = format!(
                "the input `hold` takes the scores of one cell, but gets those of {}, such as `{}`",
                cells.len(),
                hold[0].name
            );
            problems.push(Foreseen::input(HOLD, message, "select one cell, such as `node[axis=value]`"));
        } else if let [hold] = hold {
            if let Some(nfe) = hold.facts.get(NFE).filter(|nfe| nfe.len() > 1) {
                let message = format!("`{}` has scores at NFE {nfe:?}, but `hold` takes one score", hold.name);
                problems.push(Foreseen::input(HOLD, message, "connect the scores of the endpoints"));
            }
            for (port, sources) in [(SCORES, scores), (BASELINES, baselines)] {
                // Where no image is sure to be there, there may be no score either.
                let sure = || sources.iter().filter(|source| source.facts.get(SPP).is_some());
                problems.extend(sure().find_map(|of| differ(port, of, hold, REFERENCE_SPP, "reference")));
                problems.extend(sure().find_map(|of| differ(port, of, hold, SPP, "start")));
                problems.extend(sources.iter().find_map(|of| differ_in_metrics(port, of, hold)));
            }
        }
        let nfe: Option<Vec<Vec<u64>>> = scores.iter().map(|source| source.facts.get(NFE)).collect();
        let nfe = nfe.map(|lists| lists.concat().into_iter().collect::<BTreeSet<u64>>().into_iter().collect());
        Outlook::default().with(TABLES, Facts::default().with_some(NFE, nfe)).but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let read = |items: Items<'_, SceneScores>| -> Result<Vec<(ItemKey, SceneScores)>, KindError> {
            items.iter().map(|(key, scores)| Ok((key.clone(), scores.load(ctx)?))).collect()
        };
        let hold = read(action.all(HOLD)?)?;
        let scores = read(action.all(SCORES)?)?;
        let baselines = action.all_if(BASELINES)?.map_or_else(|| Ok(Vec::new()), read)?;
        ctx.check_cancelled()?;
        let groups = Groups::load(ctx, action)?;
        let evaluation = evaluate(&hold, &scores, &baselines, &groups, action.params.resamples, action.seed)?;
        Outputs::default().put_one(TABLES, "evaluation", evaluation.store(ctx)?)
    }
}

/// Whether scores differ from those of the endpoints in the samples of their references, or of their starts.
fn differ<T: DeserializeOwned + PartialEq + Debug>(
    port: All<SceneScores>,
    source: &Source,
    hold: &Source,
    fact: Fact<T>,
    what: &str,
) -> Option<Foreseen> {
    let (own, other) = (source.facts.get(fact)?, hold.facts.get(fact)?);
    (own != other).then(|| {
        let bare = |value: &T| format!("{value:?}").trim_matches(['[', ']']).to_owned();
        let message = format!(
            "the {what} of `{}` has {} samples, but that of `{}` in `hold` has {}",
            source.name,
            bare(&own),
            hold.name,
            bare(&other)
        );
        Foreseen::input(port, message, "use the same samples for both, or evaluate them in separate nodes")
    })
}

/// Whether scores have a metric that those of the endpoints lack, or the other way round.
fn differ_in_metrics(port: All<SceneScores>, source: &Source, hold: &Source) -> Option<Foreseen> {
    let (own, other) = (source.facts.get(MORE_METRICS)?, hold.facts.get(MORE_METRICS)?);
    let lacks = |has: &[String], lacks: &[String]| has.iter().find(|name| !lacks.contains(name)).cloned();
    let told = |name: String, has: &Source, lacks: &Source| {
        let message = format!("`{}` computes `{name}`, but `{}` does not", has.name, lacks.name);
        Foreseen::input(port, message, format!("add `{name}` to `also` of `{}`, or remove it", lacks.name))
    };
    lacks(&own, &other)
        .map(|name| told(name, source, hold))
        .or_else(|| lacks(&other, &own).map(|name| told(name, hold, source)))
}

/// A cell's coordinates, from a text such as `parameterization=mc_noise+conditioning=rgb`.
pub(crate) fn coordinates(cell: &str) -> BTreeMap<String, String> {
    cell.split(['+', '/']).filter_map(|p| p.split_once('=')).map(|(a, v)| (a.to_owned(), v.to_owned())).collect()
}

pub(crate) fn stratum(scene: &str) -> String {
    StratumName::group_of(scene)
}

/// The scores of a cell: the method's NFE, and by scene one score for each.
struct Cell<'a> {
    key: &'a str,
    nfe: Vec<u64>,
    scenes: BTreeMap<&'a str, Vec<&'a Score>>,
}

fn input(message: String) -> KindError {
    KindError::Input(message)
}

/// Groups scores by cell, and checks that each scene of a cell has the same NFE.
fn cells<'a>(scores: &'a [(ItemKey, SceneScores)], port: &str) -> Result<Vec<Cell<'a>>, KindError> {
    let mut cells: BTreeMap<&str, Cell<'_>> = BTreeMap::new();
    for (key, of) in scores {
        let (name, scene) = key.split_cell().unwrap_or(("", key.as_str()));
        let mut sorted: Vec<&Score> = of.scores.iter().collect();
        sorted.sort_by_key(|s| s.nfe);
        let nfe: Vec<u64> = sorted.iter().map(|s| s.nfe).collect();
        if nfe.is_empty() || nfe.windows(2).any(|w| w[0] == w[1]) {
            return Err(input(format!(
                "item `{key}` of `{port}` has scores at NFE {nfe:?}; it takes one score at each of one NFE or more"
            )));
        }
        let cell = cells.entry(name).or_insert_with(|| Cell { key: name, nfe: nfe.clone(), scenes: BTreeMap::new() });
        if cell.nfe != nfe {
            return Err(input(format!(
                "item `{key}` of `{port}` has scores at NFE {nfe:?} and others of its cell at {:?}; refine all alike",
                cell.nfe
            )));
        }
        cell.scenes.insert(scene, sorted);
    }
    Ok(cells.into_values().collect())
}

/// The one value that all items share.
fn common(values: impl Iterator<Item = (String, u64)>, what: &str) -> Result<u64, KindError> {
    let mut first: Option<(String, u64)> = None;
    for (name, value) in values {
        match &first {
            Some((other, expected)) if *expected != value => {
                return Err(input(format!(
                    "{what} is {expected} samples for `{other}`, but {value} for `{name}`; use the same samples for \
                    both"
                )));
            }
            Some(_) => {}
            None => first = Some((name, value)),
        }
    }
    first.map(|(_, value)| value).ok_or_else(|| input("there are no scores to aggregate".into()))
}

fn check_scenes(hold: &Cell<'_>, cell: &Cell<'_>) -> Result<(), KindError> {
    let name = if cell.key.is_empty() { "scores" } else { cell.key };
    if let Some(scene) = hold.scenes.keys().find(|s| !cell.scenes.contains_key(*s)) {
        return Err(input(format!("`{name}` lacks scores of the scene `{scene}` of `hold`; score the same scenes")));
    }
    match cell.scenes.keys().find(|s| !hold.scenes.contains_key(*s)) {
        Some(scene) => Err(input(format!(
            "`hold` lacks a score of the scene `{scene}` of `{name}`; connect the same references to both"
        ))),
        None => Ok(()),
    }
}

/// Sums scores up. `hold` is keyed by scene, `scores` and `baselines` by cell and scene. A baseline without scores is
/// left out, with what it says of that.
///
/// # Errors
/// If there are none, cells differ in scenes, start or reference, or a scene is of no group.
pub fn evaluate(
    hold: &[(ItemKey, SceneScores)],
    scores: &[(ItemKey, SceneScores)],
    baselines: &[(ItemKey, SceneScores)],
    groups: &Groups,
    resamples: u64,
    seed: u64,
) -> Result<Evaluation, KindError> {
    let (baselines, absent): (Vec<_>, Vec<_>) = baselines.iter().cloned().partition(|(_, of)| !of.scores.is_empty());
    let mut notes: Vec<String> = absent.into_iter().filter_map(|(_, of)| of.note).collect();
    let baselines = &baselines[..];
    let items = || hold.iter().chain(scores).chain(baselines);
    notes.extend(items().filter_map(|(_, of)| of.note.clone()));
    let (names, left_out) = common_metrics(items());
    notes.extend(left_out);
    notes.sort_unstable();
    notes.dedup();
    let reference_spp = common(items().map(|(k, s)| (k.to_string(), s.reference_spp)), "the reference")?;
    let starts = items().flat_map(|(k, s)| s.scores.iter().map(move |score| (k.to_string(), score.from_spp)));
    let from_spp = common(starts, "the start")?;
    let cells_of_hold = cells(hold, HOLD.name())?;
    let [hold] = &cells_of_hold[..] else {
        return Err(input(format!("input `hold` takes one node's scores and got {} cells", cells_of_hold.len())));
    };
    if hold.nfe.len() != 1 {
        return Err(input(format!("input `hold` takes one score of each scene and got NFE {:?}", hold.nfe)));
    }
    let cells = cells(scores, SCORES.name())?;
    let others = self::cells(baselines, BASELINES.name())?;
    cells.iter().chain(&others).try_for_each(|cell| check_scenes(hold, cell))?;

    let names = Names(&names);
    let resampled = resample(names, hold, cells.iter().chain(&others), groups, resamples, seed)?;
    let count = names.0.len();
    let mut at = count;
    let mut methods = Vec::with_capacity(cells.len());
    let mut curves = Vec::with_capacity(cells.len());
    for cell in &cells {
        curves.push(Curve { cell: coordinates(cell.key), nfe: &cell.nfe, at, metrics: names.0 });
        methods.push(method(names, cell, &resampled, at));
        at += cell.nfe.len() * count;
    }
    let mut tables = Vec::with_capacity(others.len());
    let mut versus = Vec::new();
    let mut beside = Vec::with_capacity(others.len());
    for other in &others {
        beside.push(Curve { cell: coordinates(other.key), nfe: &other.nfe, at, metrics: names.0 });
        tables.push(method(names, other, &resampled, at));
        versus.extend(against(names, &cells, other, &resampled, at));
        at += other.nfe.len() * count;
    }
    let mut nfe: Vec<u64> = cells.iter().flat_map(|c| c.nfe.iter().copied()).collect();
    nfe.sort_unstable();
    nfe.dedup();
    Ok(Evaluation {
        reference_spp,
        from_spp,
        scenes: hold.scenes.len() as u64,
        groups: groups.count(hold.scenes.keys().copied())?,
        resamples,
        nfe,
        hold: names.each(|i, _| resampled.estimate(|m| m[i])),
        methods,
        baselines: tables,
        versus,
        claims: claims(&curves, &beside, &resampled),
        notes,
        per_scene: std::iter::once(hold).chain(&cells).chain(&others).flat_map(rows).collect(),
    })
}

/// The metrics that all scores have, and what is said of those that only some have.
pub(crate) fn common_metrics<'a>(
    items: impl Iterator<Item = &'a (ItemKey, SceneScores)> + Clone,
) -> (Vec<&'static str>, Vec<String>) {
    let all = || items.clone().flat_map(|(key, of)| of.scores.iter().map(move |score| (key, &score.metrics)));
    let lacking = |name: &str| all().find(|(_, metrics)| metrics.get(name).is_none());
    let (mut names, mut notes) = (Vec::new(), Vec::new());
    for name in computed(all().map(|(_, metrics)| metrics)) {
        match lacking(name) {
            None => names.push(name),
            Some((key, _)) => notes.push(format!(
                "`{name}`, because `{key}` and perhaps others lack it; compute it for all scores or for none"
            )),
        }
    }
    (names, notes)
}

/// The metrics of an evaluation, which every score has.
#[derive(Clone, Copy)]
struct Names<'a>(&'a [&'static str]);

impl Names<'_> {
    /// A figure for each metric, by place and name.
    fn each<T>(self, of: impl Fn(usize, &'static str) -> T) -> BTreeMap<String, T> {
        self.0.iter().enumerate().map(|(i, name)| ((*name).to_owned(), of(i, name))).collect()
    }

    /// The figures of an image as they enter means.
    fn figures(self, metrics: &Metrics) -> impl Iterator<Item = f64> {
        self.0.iter().map(move |name| figure(metrics, name))
    }
}

/// A figure as it enters means.
fn figure(metrics: &Metrics, name: &str) -> f64 {
    bounded(name, metrics.get(name).expect("every score has the common metrics"))
}

/// Every cell at each of its NFE against a baseline whose columns start at `at`; those of the cells follow those of
/// hold.
fn against(names: Names<'_>, cells: &[Cell<'_>], baseline: &Cell<'_>, resampled: &Resampled, at: usize) -> Vec<Versus> {
    let own = |cell: &Cell<'_>| {
        cell.scenes.values().next().and_then(|s| s.first()).map_or("", |s| s.method.as_str()).to_owned()
    };
    let mut first = 0;
    let mut out = Vec::new();
    for cell in cells {
        for (step, nfe) in cell.nfe.iter().enumerate() {
            first += names.0.len();
            let better = |_: usize, name: &'static str| {
                let ahead = |(scene, scores): (&&str, &Vec<&Score>)| {
                    let value = |score: &Score| figure(&score.metrics, name);
                    let (ours, theirs) = (value(scores[step]), value(baseline.scenes[scene][0]));
                    if higher_is_better(name) { ours > theirs } else { ours < theirs }
                };
                cell.scenes.iter().filter(|of| ahead(*of)).count() as f64 / cell.scenes.len() as f64
            };
            out.push(Versus {
                cell: coordinates(cell.key),
                nfe: *nfe,
                baseline: coordinates(baseline.key),
                method: own(baseline),
                gain: names.each(|i, _| resampled.estimate(|m| m[first + i] - m[at + i])),
                better: names.each(better),
            });
        }
    }
    out
}

/// Columns: hold's metrics, then those of each cell at each NFE.
fn resample<'a>(
    names: Names<'_>,
    hold: &'a Cell<'a>,
    cells: impl Iterator<Item = &'a Cell<'a>> + Clone,
    groups: &Groups,
    resamples: u64,
    seed: u64,
) -> Result<Resampled, KindError> {
    let images = 1 + cells.clone().map(|c| c.nfe.len()).sum::<usize>();
    let mut table = Table::new(images * names.0.len());
    for scene in hold.scenes.keys() {
        let of = std::iter::once(hold).chain(cells.clone()).flat_map(|cell| &cell.scenes[scene]);
        let row: Vec<f64> = of.flat_map(|score| names.figures(&score.metrics)).collect();
        table.push(groups.of(scene)?, &row);
    }
    Resampled::new(&table, resamples as usize, seed).ok_or_else(|| input("`hold` has no scenes".into()))
}

/// The table of a cell whose columns start at `at`; those of hold start at 0.
fn method(names: Names<'_>, cell: &Cell<'_>, resampled: &Resampled, at: usize) -> MethodTable {
    let count = names.0.len();
    let by_metric = |of: &dyn Fn(usize) -> Estimate| names.each(|i, _| of(i));
    let strata = strata(names, cell);
    let tables = cell.nfe.iter().enumerate().map(|(step, nfe)| {
        let first = at + step * count;
        NfeTable {
            nfe: *nfe,
            metrics: by_metric(&|i| resampled.estimate(|m| m[first + i])),
            gain: by_metric(&|i| resampled.estimate(|m| m[first + i] - m[i])),
            strata: strata[step].clone(),
        }
    });
    let curve = |i: usize, pick: &dyn Fn(crate::curve::CurveSummary) -> f64| {
        resampled.estimate(|m| {
            let q: Vec<f64> = (0..cell.nfe.len()).map(|step| m[at + step * count + i]).collect();
            pick(summarise(&cell.nfe, &q).expect("two increasing NFE or more"))
        })
    };
    let curves = |pick: &dyn Fn(crate::curve::CurveSummary) -> f64| {
        let is_curve = cell.nfe.len() >= 2 && cell.nfe[0] >= 1;
        if is_curve { by_metric(&|i| curve(i, pick)) } else { BTreeMap::new() }
    };
    let coordinates = coordinates(cell.key);
    let named = |axis: &str, otherwise: &str| coordinates.get(axis).map_or(otherwise, String::as_str).to_owned();
    let own = cell.scenes.values().next().and_then(|s| s.first()).map_or("", |s| s.method.as_str());
    MethodTable {
        method: named(PARAMETERIZATION, own),
        conditioning: named(CONDITIONING, Conditioning::Rgb.name()),
        space: named(SPACE, ""),
        at: tables.collect(),
        auc: curves(&|c| c.auc),
        tv: curves(&|c| c.tv),
        cell: coordinates,
    }
}

/// For each NFE, the mean over the scenes of each stratum.
fn strata(names: Names<'_>, cell: &Cell<'_>) -> Vec<BTreeMap<String, BTreeMap<String, f64>>> {
    let mut groups: BTreeMap<String, Vec<&Vec<&Score>>> = BTreeMap::new();
    for (scene, scores) in &cell.scenes {
        groups.entry(stratum(scene)).or_default().push(scores);
    }
    let mean = |scenes: &[&Vec<&Score>], step: usize, name: &str| {
        let value = |s: &&Vec<&Score>| figure(&s[step].metrics, name);
        scenes.iter().map(value).sum::<f64>() / scenes.len() as f64
    };
    let of_step = |step: usize| {
        let of_group = |scenes: &[&Vec<&Score>]| names.each(|_, name| mean(scenes, step, name));
        groups.iter().map(|(stratum, scenes)| (stratum.clone(), of_group(scenes))).collect()
    };
    (0..cell.nfe.len()).map(of_step).collect()
}

/// Every score of a cell, by scene.
fn rows<'a>(cell: &'a Cell<'_>) -> impl Iterator<Item = SceneRow> + 'a {
    let coordinates = coordinates(cell.key);
    cell.scenes.iter().flat_map(move |(scene, scores)| {
        let coordinates = coordinates.clone();
        scores.iter().map(move |score| SceneRow {
            scene: (*scene).to_owned(),
            stratum: stratum(scene),
            cell: coordinates.clone(),
            score: (*score).clone(),
        })
    })
}
