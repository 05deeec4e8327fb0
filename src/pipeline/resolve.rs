//! Turns the raw file into a [`Pipeline`]: looks up kinds, expands matrices, validates params and fills in defaults.
//!
//! Collects all problems before it fails.

use super::{
    AskedResources, Cell, Node, Pipeline, Target,
    file::{self, PipelineFile},
    foresee::{self, Listed},
    node::{self, Axis, RawNode},
    outside, overrides,
    reference::{Reference, is_word},
    schema_check,
    values::Values,
    wire,
    yaml::{Data, Key, Yaml},
};
use crate::{
    diagnostics::{Problem, Problems, Sources, Span, did_you_mean, nearest},
    kinds::Registry,
};
use serde_json::Value;
use std::{collections::BTreeSet, path::Path, sync::Arc};
use tauflow_contract::{ItemKey, KindSpec, NodeKind};

/// Overrides from the command line.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// A profile.
    pub profile: Option<String>,
    /// `node.param=value` and `values.NAME=value`.
    pub sets: Vec<String>,
    /// `node` or `node.port`, instead of the file's targets.
    pub targets: Vec<String>,
}

/// Reads and resolves a pipeline file.
///
/// # Errors
/// Every problem of it.
pub fn resolve(path: &Path, registry: &Registry, options: &Options) -> Result<Pipeline, Problems> {
    read(path, registry, options, Depth::Text)
}

/// Reads and resolves a pipeline file, and looks at what its targets need on this machine.
///
/// # Errors
/// Every problem of it; if the file itself has none, every file, folder and program that is missing.
pub fn check(path: &Path, registry: &Registry, options: &Options) -> Result<Pipeline, Problems> {
    read(path, registry, options, Depth::Outside)
}

/// How far a pipeline is looked at.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Depth {
    /// Its text alone.
    Text,
    /// Files, folders and programs that it names, too.
    Outside,
}

fn read(path: &Path, registry: &Registry, options: &Options, depth: Depth) -> Result<Pipeline, Problems> {
    let mut sources = Sources::default();
    let mut problems = Vec::new();
    let file = file::load(path, &mut sources, &mut problems);
    finish(file, path.file_stem().and_then(|s| s.to_str()), registry, options, depth, (sources, problems))
}

/// Resolves a text, for tests and examples; it cannot include files.
///
/// # Errors
/// Every problem of it.
pub fn resolve_text(name: &str, text: &str, registry: &Registry, options: &Options) -> Result<Pipeline, Problems> {
    let mut sources = Sources::default();
    let mut problems = Vec::new();
    let file = file::load_text(name, text, &mut sources, &mut problems);
    finish(file, None, registry, options, Depth::Text, (sources, problems))
}

fn finish(
    mut file: PipelineFile,
    stem: Option<&str>,
    registry: &Registry,
    options: &Options,
    depth: Depth,
    (mut sources, mut problems): (Sources, Vec<Problem>),
) -> Result<Pipeline, Problems> {
    // A text that could not be read has no nodes worth complaining about.
    if file.nodes.is_empty() {
        if problems.is_empty() {
            problems.push(Problem::nowhere("the pipeline has no nodes").hint("add `nodes:`; see `tauflow init`"));
        }
        return Err(Problems::new(sources, problems));
    }
    let profile = options.profile.as_deref();
    let overrides = overrides::read(&mut file, profile, &options.sets, &mut sources, &mut problems);
    overrides::to_values(&mut file, &overrides, &mut problems);
    let mut values = Values::new(&mut file);
    file.seed = file.seed.take().map(|seed| values.fill(seed));
    let mut nodes = node::read(std::mem::take(&mut file.nodes), &mut values, &mut problems);
    overrides::to_nodes(overrides, &mut file.seed, &mut nodes, &mut values, &mut problems);
    let seed = seed(&file, &mut problems);
    let mut drafts: Vec<Draft> = nodes.iter().map(|raw| draft(raw, registry, &mut problems)).collect();
    for (draft, raw) in drafts.iter_mut().zip(&nodes) {
        params(draft, raw, &mut problems);
        ports(draft, raw, &mut problems);
    }
    let wiring = wire::wire(&nodes, &drafts, &mut problems);
    for (at, (draft, raw)) in drafts.iter().zip(&nodes).enumerate() {
        check_axes(draft, raw, wiring.axes_read(at), &mut problems);
        check_folders(draft, raw, &mut problems);
    }
    let order = wire::order(&wiring, &mut problems);
    values.explain(&mut problems);
    let name =
        file.name.as_ref().map(|n| n.text.clone()).or_else(|| stem.filter(|stem| is_word(stem)).map(str::to_owned));
    let Some(order) = order.filter(|_| problems.is_empty()) else {
        return Err(Problems::new(sources, problems));
    };
    let mut pipeline = assemble(name.unwrap_or_else(|| "pipeline".into()), seed, &drafts, &wiring, &order);
    targets(&mut pipeline, &file, options, &mut problems);
    if problems.is_empty() {
        let written = (&nodes[..], &drafts[..], &order[..]);
        let listed = match depth {
            Depth::Outside => outside::look(&pipeline, written, &mut problems),
            Depth::Text => Listed::new(),
        };
        foresee::foresee(&pipeline, written, &listed, &mut problems);
        if !problems.is_empty() {
            values.explain(&mut problems);
        }
    }
    if problems.is_empty() { Ok(pipeline) } else { Err(Problems::new(sources, problems)) }
}

/// A node on its way: kind found, cells known, inputs not connected yet.
pub(super) struct Draft {
    pub kind: Option<(Arc<dyn NodeKind>, KindSpec)>,
    pub axes: Vec<(String, Vec<String>)>,
    pub cells: Vec<DraftCell>,
    pub transient: bool,
    pub resources: AskedResources,
}

/// A cell on its way.
pub(super) struct DraftCell {
    pub coords: Vec<(String, String)>,
    /// The axis values that the params get, with their places.
    pub values: Vec<(Key, Yaml)>,
    pub params: Value,
}

impl DraftCell {
    /// The params as written, with the axis values of this cell among them.
    pub fn tree(&self, raw: &RawNode) -> Yaml {
        let mut fields = match &raw.params.data {
            Data::Map(fields) => fields.clone(),
            _ => Vec::new(),
        };
        for (axis, value) in &self.values {
            fields.retain(|(key, _)| key.text != axis.text);
            fields.push((axis.clone(), value.clone()));
        }
        Yaml { data: Data::Map(fields), span: raw.params.span }
    }

    pub fn text(&self) -> String {
        self.coords.iter().map(|(axis, value)| format!("{axis}={value}")).collect::<Vec<_>>().join("+")
    }
}

fn seed(file: &PipelineFile, problems: &mut Vec<Problem>) -> u64 {
    let Some(seed) = &file.seed else { return 0 };
    if let Data::Number(number) = &seed.data
        && let Some(value) = number.as_u64()
    {
        return value;
    }
    let message = format!("the seed must be a whole number from 0, found {}", seed.sort());
    problems.push(Problem::at(seed.span, message).hint("write `seed: 7`"));
    0
}

fn draft(raw: &RawNode, registry: &Registry, problems: &mut Vec<Problem>) -> Draft {
    let kind = raw.kind.as_ref().and_then(|name| {
        let kind = registry.get(&name.text).map(|kind| (kind.clone(), kind.spec()));
        if kind.is_none() {
            let message = format!("unknown kind `{}`", name.text);
            problems.push(Problem::at(name.span, message).hint(registry.hint(&name.text)));
        }
        kind
    });
    let mut axes: Vec<(String, Vec<String>)> = Vec::new();
    let mut cells = vec![DraftCell { coords: Vec::new(), values: Vec::new(), params: Value::Null }];
    for Axis { name: axis, values, taken } in &raw.matrix {
        let mut texts: Vec<String> = Vec::new();
        let mut known = BTreeSet::new();
        for value in values {
            let text = axis_text(value);
            // Errors in an axis of a different node are reported there.
            if *taken {
            } else if ItemKey::new(format!("{}={text}", axis.text)).is_err() || text.contains(['/', '+', '=']) {
                let message = format!("`{text}` cannot name a cell of the axis `{}`", axis.text);
                problems.push(Problem::at(value.span, message).hint("use short names and numbers"));
            } else if !known.insert(text.clone()) {
                let message = format!("the value `{text}` occurs twice in the axis `{}`", axis.text);
                problems.push(Problem::at(value.span, message).hint("take one away"));
            }
            texts.push(text);
        }
        cells = cells
            .into_iter()
            .flat_map(|cell| {
                texts.iter().zip(values).map(move |(text, value)| {
                    let mut coords = cell.coords.clone();
                    coords.push((axis.text.clone(), text.clone()));
                    let mut fields = cell.values.clone();
                    fields.push((axis.clone(), value.clone()));
                    DraftCell { coords, values: fields, params: Value::Null }
                })
            })
            .collect();
        axes.push((axis.text.clone(), texts));
    }
    Draft { kind, axes, cells, transient: raw.transient, resources: raw.resources }
}

/// The text of an axis value: scalars as they are, lists and maps with their scalars joined by `-`.
fn axis_text(value: &Yaml) -> String {
    match &value.data {
        Data::Null => "null".into(),
        Data::Bool(b) => b.to_string(),
        Data::Number(n) => n.to_string(),
        Data::Text(s) => s.clone(),
        Data::List(items) => items.iter().map(axis_text).collect::<Vec<_>>().join("-"),
        Data::Map(fields) => {
            fields.iter().map(|(k, v)| format!("{}-{}", k.text, axis_text(v))).collect::<Vec<_>>().join("-")
        }
    }
}

/// An axis sets a param, or binds to an input's axis; else its cells would all be the same.
fn check_axes(draft: &Draft, raw: &RawNode, bound: &BTreeSet<String>, problems: &mut Vec<Problem>) {
    let Some((kind, spec)) = &draft.kind else { return };
    let schema = kind.params_schema();
    for Axis { name: axis, .. } in &raw.matrix {
        if schema_check::param(&schema, &axis.text).is_some() || bound.contains(&axis.text) {
            continue;
        }
        let names: BTreeSet<&str> =
            schema_check::params(&schema).into_iter().chain(bound.iter().map(String::as_str)).collect();
        let message = format!(
            "the axis `{}` is neither a param of `{}` nor an axis of an input, so all cells would be equal",
            axis.text, spec.name
        );
        let hint = nearest(&axis.text, names).map_or_else(
            || format!("name a param of `{}`, or an axis of an input of `{}`", spec.name, raw.name.text),
            |near| format!("did you mean `{near}`?"),
        );
        problems.push(Problem::at(axis.span, message).hint(hint));
    }
}

/// Most bytes of the name of a folder on usual file systems.
const MOST_FOLDER: usize = 255;

/// Results for people are in a folder for each cell, with the name of the cell.
fn check_folders(draft: &Draft, raw: &RawNode, problems: &mut Vec<Problem>) {
    let Some((_, spec)) = &draft.kind else { return };
    let long = |cell: &&DraftCell| cell.text().len() > MOST_FOLDER;
    if let Some(cell) = draft.cells.iter().find(long).filter(|_| spec.outputs.iter().any(|port| port.publish)) {
        let (bytes, node) = (cell.text().len(), &raw.name.text);
        let message = format!(
            "the axes of `{node}` and their values name a folder of results in {bytes} bytes; at most {MOST_FOLDER} fit"
        );
        problems.push(Problem::at(raw.name.span, message).hint("shorten values, or move what is long to `params`"));
    }
}

/// The params of all cells of a node hold at most so many values together.
const MOST_PARAMS: usize = 20_000_000;
/// The same of the bytes of texts in params.
const MOST_PARAM_BYTES: usize = 256 << 20;
/// After so many problems no more cells of a node are looked at.
const ENOUGH: usize = 50;

/// Checks and completes the params of every cell.
fn params(draft: &mut Draft, raw: &RawNode, problems: &mut Vec<Problem>) {
    let Some((kind, _)) = &draft.kind else { return };
    let schema = kind.params_schema();
    let Data::Map(base) = &raw.params.data else { return };
    for Axis { name: axis, .. } in &raw.matrix {
        if let Some((key, _)) = base.iter().find(|(k, _)| k.text == axis.text) {
            let message = format!("`{}` is set here, and is also an axis of the matrix", axis.text);
            problems.push(Problem::at(key.span, message).hint("keep one of the two"));
        }
    }
    let (size, _) = raw.params.size();
    if draft.cells.len() * size > MOST_PARAMS {
        let message = format!("{} cells with params of {size} values each are too many", draft.cells.len());
        problems.push(Problem::at(raw.params.span, message).hint("shorten the matrix or the params"));
        return;
    }
    let bytes = raw.params.bytes();
    if draft.cells.len() * bytes > MOST_PARAM_BYTES {
        let message =
            format!("{} cells with params of {} KiB of text each are too many", draft.cells.len(), bytes >> 10);
        problems.push(Problem::at(raw.params.span, message).hint("shorten the matrix or the params"));
        return;
    }
    let before = problems.len();
    for cell in &mut draft.cells {
        // Cells are mostly wrong in the same way.
        if problems.len() - before > ENOUGH {
            break;
        }
        let mut fields = base.clone();
        for (axis, value) in &cell.values {
            fields.retain(|(k, _)| k.text != axis.text);
            if schema_check::param(&schema, &axis.text).is_some() {
                fields.push((axis.clone(), value.clone()));
            }
        }
        let tree = Yaml { data: Data::Map(fields), span: raw.params.span };
        let json = tree.to_json();
        let place = |pointer: &str, key: bool| -> Span {
            let (span, name) = tree.locate(pointer);
            if key { name.unwrap_or(span) } else { span }
        };
        let mismatches = schema_check::check(&schema, &json);
        if !mismatches.is_empty() {
            problems
                .extend(mismatches.into_iter().map(|m| Problem::at(place(&m.pointer, m.key), m.message).hint(m.hint)));
            continue;
        }
        match kind.resolve(&json) {
            Ok(resolved) => cell.params = resolved,
            Err(list) => {
                problems
                    .extend(list.into_iter().map(|p| Problem::at(place(&p.pointer, false), p.message).hint(p.hint)));
            }
        }
    }
}

/// Gives a node the ports that its params decide; all its cells have the same.
fn ports(draft: &mut Draft, raw: &RawNode, problems: &mut Vec<Problem>) {
    let Some((kind, spec)) = &mut draft.kind else { return };
    let deciding = kind.port_params();
    if deciding.is_empty() {
        return;
    }
    for Axis { name: axis, .. } in raw.matrix.iter().filter(|axis| deciding.contains(&axis.name.text.as_str())) {
        let message = format!(
            "`{}` decides what the ports of `{}` are, and a node has one set of ports: it cannot be an axis",
            axis.text, spec.name
        );
        problems.push(Problem::at(axis.span, message).hint("write a node for each value, with its value in `params`"));
    }
    match draft.cells.first().map(|cell| &cell.params) {
        Some(params) if !params.is_null() => *spec = kind.spec_for(params),
        // The params are wrong, which has been told of. The ports are not known, so that nothing is said of them.
        _ => draft.kind = None,
    }
}

fn assemble(name: String, seed: u64, drafts: &[Draft], wiring: &wire::Wiring, order: &[usize]) -> Pipeline {
    let mut pipeline = Pipeline { name, seed, nodes: Vec::new(), cells: Vec::new(), targets: Vec::new() };
    // First cell of each draft, in the pipeline's order.
    let mut first = vec![0; drafts.len()];
    let mut next = 0;
    for &index in order {
        first[index] = next;
        next += drafts[index].cells.len();
    }
    for &index in order {
        let draft = &drafts[index];
        let Some((kind, spec)) = &draft.kind else { continue }; // a missing kind is a problem, and none is left
        let node = pipeline.nodes.len();
        let start = pipeline.cells.len();
        for (i, cell) in draft.cells.iter().enumerate() {
            let inputs = wiring.connections(index, i, spec.inputs.len(), &first);
            let (coords, params) = (cell.coords.clone(), cell.params.clone());
            pipeline.cells.push(Cell { node, text: cell.text(), coords, params, inputs });
        }
        pipeline.nodes.push(Node {
            name: wiring.names[index].clone(),
            kind: kind.clone(),
            spec: spec.clone(),
            axes: draft.axes.clone(),
            cells: start..pipeline.cells.len(),
            transient: draft.transient,
            resources: draft.resources,
        });
    }
    pipeline
}

fn targets(pipeline: &mut Pipeline, file: &PipelineFile, options: &Options, problems: &mut Vec<Problem>) {
    let asked: Vec<(String, Option<Span>)> = if options.targets.is_empty() {
        file.targets.iter().flatten().map(|key| (key.text.clone(), Some(key.span))).collect()
    } else {
        options.targets.iter().map(|text| (text.clone(), None)).collect()
    };
    let problem = |span: Option<Span>, message: String| Problem { span, ..Problem::nowhere(message) };
    let mut found = Vec::new();
    for (text, span) in asked {
        let reference = match Reference::parse(&text) {
            Ok(reference) if reference.select.is_empty() => reference,
            Ok(_) => {
                let message = format!("the target `{text}` selects cells");
                problems.push(problem(span, message).hint("name a node, or `node.port`"));
                continue;
            }
            Err(message) => {
                problems.push(problem(span, message).hint("name a node, or `node.port`"));
                continue;
            }
        };
        let Some(node) = pipeline.node(reference.node) else {
            let hint = did_you_mean(reference.node, "nodes", pipeline.nodes.iter().map(|n| n.name.as_str()));
            problems.push(problem(span, format!("unknown node `{}`", reference.node)).hint(hint));
            continue;
        };
        let spec = &pipeline.nodes[node].spec;
        let port = match reference.port {
            None => None,
            Some(name) => match pipeline.nodes[node].output(name) {
                Some(port) => Some(port),
                None => {
                    let message = format!("`{}` has no output `{name}`", reference.node);
                    let hint = did_you_mean(name, "outputs", spec.outputs.iter().map(|p| p.name));
                    problems.push(problem(span, message).hint(hint));
                    continue;
                }
            },
        };
        found.push(Target { node, port });
    }
    if found.is_empty() {
        let read: BTreeSet<usize> = (0..pipeline.nodes.len()).flat_map(|n| pipeline.reads(n)).collect();
        found =
            (0..pipeline.nodes.len()).filter(|n| !read.contains(n)).map(|node| Target { node, port: None }).collect();
    }
    pipeline.targets = found;
}
