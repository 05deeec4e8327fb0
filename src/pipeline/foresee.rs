//! Finds before a run which nodes are sure to fail: inputs whose items never meet, several items where a node takes
//! one, and problems that kinds foresee from params and facts ([`tauflow_contract::Kind::foresee`]).
//!
//! Knows no fact. An unknown fact is no problem.

use super::{Pipeline, node::RawNode, resolve::Draft};
use crate::{
    diagnostics::{Problem, Span},
    ids::Id,
};
use std::{
    borrow::Cow,
    collections::{BTreeSet, HashMap, HashSet},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_contract::{At, Facts, Foreseen, ItemKey, Known, Mode, Outlook, Source, Takes};

/// All outputs together have at most so many parts and prefixes within them; beyond that, nothing is foreseen.
const MOST_PARTS: usize = 200_000;
/// After so many problems of a node no more are looked for.
const ENOUGH: usize = 10;

/// The items that sources list, by cell.
pub(super) type Listed = HashMap<usize, Arc<BTreeSet<ItemKey>>>;

/// The items of an output that share a prefix of their keys.
#[derive(Clone)]
struct Part {
    prefix: String,
    facts: Facts,
    items: Items,
}

/// The known facts about the items of a part.
#[derive(Clone)]
enum Items {
    Unknown,
    /// All that a cell makes on a port, whatever they are.
    Of(usize, usize),
    /// The same. The cell gathers items of other cells and may pass them on with their keys, so that keys of its items
    /// may begin with any of these prefixes.
    Through(usize, usize, Arc<BTreeSet<String>>),
    /// One.
    One,
    /// None beside these: what a cell lets through on a port.
    Among(Arc<BTreeSet<ItemKey>>, usize, usize),
    /// These.
    These(Arc<BTreeSet<ItemKey>>),
}

impl Items {
    /// What a cell that filters lets through on a port.
    fn filtered(&self, cell: usize, port: usize) -> Self {
        match self {
            Self::These(items) | Self::Among(items, ..) => Self::Among(items.clone(), cell, port),
            Self::One | Self::Of(..) | Self::Unknown => Self::Of(cell, port),
            Self::Through(.., within) => Self::Through(cell, port, within.clone()),
        }
    }

    /// At least so many.
    fn least(&self) -> usize {
        match self {
            Self::One => 1,
            Self::These(items) => items.len(),
            Self::Among(..) | Self::Of(..) | Self::Through(..) | Self::Unknown => 0,
        }
    }
}

/// Whether an item of one input may have the key of an item of the other.
fn may_meet(leading: &[(Source, Items)], others: &[(Source, Items)]) -> bool {
    let same = |a: &Items, b: &Items| match (a, b) {
        (Items::These(a) | Items::Among(a, ..), Items::These(b) | Items::Among(b, ..)) => !a.is_disjoint(b),
        _ => true,
    };
    let meets = |own: &(Source, Items)| others.iter().any(|other| share_prefix(own, other) && same(&own.1, &other.1));
    leading.is_empty() || others.is_empty() || leading.iter().any(meets)
}

/// The prefixes that keys of the items may have.
fn prefixes((source, items): &(Source, Items)) -> Vec<Cow<'_, str>> {
    match items {
        Items::Through(.., within) => within.iter().map(|prefix| joined(&source.prefix, prefix)).collect(),
        _ => vec![Cow::Borrowed(source.prefix.as_str())],
    }
}

/// A prefix in front of another; either may be empty.
fn joined<'a>(outer: &'a str, inner: &'a str) -> Cow<'a, str> {
    match (outer, inner) {
        (outer, "") => Cow::Borrowed(outer),
        ("", inner) => Cow::Borrowed(inner),
        (outer, inner) => Cow::Owned(format!("{outer}/{inner}")),
    }
}

/// Whether keys of the items may begin with this.
fn may_begin((source, items): &(Source, Items), prefix: &str) -> bool {
    let Items::Through(.., within) = items else { return source.prefix == prefix };
    let inner = match source.prefix.as_str() {
        "" => Some(prefix),
        outer if outer == prefix => Some(""),
        outer => prefix.strip_prefix(outer).and_then(|rest| rest.strip_prefix('/')),
    };
    inner.is_some_and(|inner| within.contains(inner))
}

/// Whether keys of both may begin alike.
fn share_prefix(own: &(Source, Items), other: &(Source, Items)) -> bool {
    match (&own.1, &other.1) {
        (Items::Through(..), Items::Through(..)) => prefixes(own).iter().any(|prefix| may_begin(other, prefix)),
        (Items::Through(..), _) => may_begin(own, &other.0.prefix),
        _ => may_begin(other, &own.0.prefix),
    }
}

/// Adds what is sure to fail. `raw` and `drafts` are the nodes as written, `order` their places in the pipeline.
pub(super) fn foresee(
    pipeline: &Pipeline,
    (raw, drafts, order): (&[RawNode], &[Draft], &[usize]),
    listed: &Listed,
    problems: &mut Vec<Problem>,
) {
    let mut made: Vec<Vec<Vec<Part>>> = Vec::with_capacity(pipeline.cells.len());
    let mut count = 0;
    for (place, node) in pipeline.nodes.iter().enumerate() {
        let (raw, draft) = (&raw[order[place]], &drafts[order[place]]);
        let mut told = HashSet::new();
        for cell in node.cells.clone() {
            let mut eye = Eye { pipeline, cell, made: &made, found: Vec::new() };
            let outputs = eye.look(listed.get(&cell));
            for Foreseen { at, message, hint } in eye.found {
                // Cells mostly fail in the same way.
                if told.len() >= ENOUGH || !told.insert((at.clone(), message.clone())) {
                    continue;
                }
                let span = match at {
                    At::Param(pointer) => param_span(raw, draft, cell - node.cells.start, &pointer),
                    At::Input(port) => input_span(raw, port),
                };
                problems.push(Problem::at(span, message).hint(hint));
            }
            let size = |part: &Part| match &part.items {
                Items::Through(.., within) => within.len(),
                _ => 1,
            };
            count += outputs.iter().flatten().map(size).sum::<usize>();
            made.push(outputs);
        }
        if count > MOST_PARTS {
            return;
        }
    }
}

/// Where a param of a cell stands.
pub(super) fn param_span(raw: &RawNode, draft: &Draft, cell: usize, pointer: &str) -> Span {
    let tree = draft.cells[cell].tree(raw);
    let named = pointer.split('/').nth(1).is_some_and(|name| tree.get(name).is_some());
    if named { tree.locate(pointer).0 } else { raw.name.span }
}

/// Where the node names what it reads on an input.
fn input_span(raw: &RawNode, port: &str) -> Span {
    let input = raw.inputs.iter().find(|input| input.port.text == port);
    input.map_or(raw.name.span, |input| input.refs.first().map_or(input.port.span, |key| key.span))
}

/// The collections whose items may meet those of `leading` as one, with the facts that all of them share.
fn merged(sources: &[(Source, Items)], leading: &(Source, Items)) -> Vec<Source> {
    let mut of = sources.iter().filter(|source| share_prefix(source, leading)).map(|(source, _)| source);
    let Some(first) = of.next() else { return Vec::new() };
    let facts = of.fold(first.facts.clone(), |facts, other| facts.shared(&other.facts));
    vec![Source { facts, ..first.clone() }]
}

/// A look at one cell.
struct Eye<'a> {
    pipeline: &'a Pipeline,
    cell: usize,
    /// The parts of all cells before it, by output.
    made: &'a [Vec<Vec<Part>>],
    found: Vec<Foreseen>,
}

impl Eye<'_> {
    /// The outputs of the cell, by port.
    fn look(&mut self, listed: Option<&Arc<BTreeSet<ItemKey>>>) -> Vec<Vec<Part>> {
        let cell = &self.pipeline.cells[self.cell];
        let node = &self.pipeline.nodes[cell.node];
        let inputs: Vec<Vec<(Source, Items)>> = (0..node.spec.inputs.len()).map(|input| self.sources(input)).collect();
        node.spec.inputs.iter().zip(&inputs).for_each(|(port, given)| self.apart(port.name, given));
        let sources = |of: &[(Source, Items)]| of.iter().map(|(source, _)| source.clone()).collect::<Vec<_>>();
        let mut whole = Known::default();
        for (port, given) in node.spec.inputs.iter().zip(&inputs) {
            if port.takes == Takes::Collection || node.mode() != Mode::Map {
                whole = whole.with(port.name, sources(given));
                if port.single {
                    self.single(port.name, given);
                }
            }
        }
        if node.mode() != Mode::Map {
            let outlook = self.outlooks(&[whole]).pop().unwrap_or_default();
            // It may also make keys of its own.
            let within: BTreeSet<String> = inputs.iter().flatten().flat_map(prefixes).map(Cow::into_owned).collect();
            let within = Arc::new(within.into_iter().chain([String::new()]).collect::<BTreeSet<_>>());
            let items = |place: usize, port: &tauflow_contract::OutputPort| match (node.mode(), listed) {
                (Mode::Source, Some(items)) if port.filter => Items::Among(items.clone(), self.cell, place),
                (Mode::Source, Some(items)) => Items::These(items.clone()),
                (Mode::Gather, _) if port.single => Items::One,
                (Mode::Gather, _) if within.len() > 1 => Items::Through(self.cell, place, within.clone()),
                _ => Items::Of(self.cell, place),
            };
            let part = |(place, port): (usize, &tauflow_contract::OutputPort)| Part {
                prefix: String::new(),
                facts: outlook.facts(port.name),
                items: items(place, port),
            };
            return node.spec.outputs.iter().enumerate().map(|of| vec![part(of)]).collect();
        }
        let by_item = |at: &usize| node.spec.inputs[*at].takes == Takes::Item && !inputs[*at].is_empty();
        let ports: Vec<usize> = (0..inputs.len()).filter(by_item).collect();
        let Some((driving, others)) = ports.split_first() else { return vec![Vec::new(); node.spec.outputs.len()] };
        for other in others {
            // Some items of an optional input may be missing. An input of which none is read is a mistake.
            if node.spec.inputs[*other].optional && may_meet(&inputs[*driving], &inputs[*other]) {
                continue;
            }
            self.meet((*driving, &inputs[*driving]), (*other, &inputs[*other]));
        }
        // The known facts about the items of each prefix.
        let known: Vec<Known> = inputs[*driving]
            .iter()
            .map(|leading| {
                let start = whole.clone().with(node.spec.inputs[*driving].name, vec![leading.0.clone()]);
                others.iter().fold(start, |known, port| {
                    known.with(node.spec.inputs[*port].name, merged(&inputs[*port], leading))
                })
            })
            .collect();
        let outlooks = self.outlooks(&known);
        let parts = |(place, port): (usize, &tauflow_contract::OutputPort)| {
            let of = |((leading, items), outlook): (&(Source, Items), &Outlook)| Part {
                prefix: leading.prefix.clone(),
                facts: outlook.facts(port.name),
                items: if port.filter { items.filtered(self.cell, place) } else { items.clone() },
            };
            inputs[*driving].iter().zip(&outlooks).map(of).collect()
        };
        node.spec.outputs.iter().enumerate().map(parts).collect()
    }

    /// The parts of all collections that feed an input, with the prefixes that their keys have there.
    fn sources(&self, input: usize) -> Vec<(Source, Items)> {
        let mut found = Vec::new();
        for feed in &self.pipeline.cells[self.cell].inputs[input] {
            let node = &self.pipeline.nodes[self.pipeline.cells[feed.cell].node];
            let mut name = self.pipeline.cell_name(feed.cell);
            if feed.port.place() > 0 {
                name = format!("{name}.{}", node.spec.outputs[feed.port.place()].name);
            }
            for part in &self.made[feed.cell][feed.port.place()] {
                let parts = [feed.prefix.as_deref().unwrap_or_default(), &part.prefix];
                let prefix = parts.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("/");
                let source = Source { name: name.clone(), prefix, facts: part.facts.clone() };
                found.push((source, part.items.clone()));
            }
        }
        found
    }

    /// The collections of an input must have different items.
    fn apart(&mut self, port: &'static str, given: &[(Source, Items)]) {
        let same = |a: &Items, b: &Items| match (a, b) {
            (Items::These(a), Items::These(b)) => !a.is_disjoint(b),
            (Items::Of(cell, port), Items::Of(other, of))
            | (Items::Through(cell, port, _), Items::Through(other, of, _))
            | (Items::Among(_, cell, port), Items::Among(_, other, of)) => (cell, port) == (other, of),
            _ => false,
        };
        // Parts of large matrices mostly differ in their prefixes.
        let mut before: HashMap<&str, Vec<(&Source, &Items)>> = HashMap::new();
        for (source, items) in given {
            let others = before.entry(&source.prefix).or_default();
            if let Some((other, _)) = others.iter().find(|(_, theirs)| same(theirs, items)) {
                let message = format!(
                    "`{}` and `{}` have items of the same keys, and cannot both be on the input `{port}`",
                    other.name, source.name
                );
                let hint = "give each of these nodes a matrix axis, such as `matrix: { method: [first] }`, whose \
                            value tells its items apart"
                    .to_owned();
                self.found.push(Foreseen { at: At::Input(port), message, hint });
                return;
            }
            others.push((source, items));
        }
    }

    /// The outlook of the kind. If the kind panics, nothing is foreseen, and its actions report the error.
    fn outlooks(&mut self, known: &[Known]) -> Vec<Outlook> {
        let cell = &self.pipeline.cells[self.cell];
        let kind = &self.pipeline.nodes[cell.node].kind;
        let found = catch_unwind(AssertUnwindSafe(|| kind.foresee(&cell.params, known)));
        let found = found.unwrap_or_else(|_| vec![Outlook::default(); known.len()]);
        self.found.extend(found.iter().flat_map(|outlook| outlook.problems.iter().cloned()));
        found
    }

    /// The items of one input must be among those of another.
    fn meet(&mut self, (driving, leading): (usize, &[(Source, Items)]), (at, others): (usize, &[(Source, Items)])) {
        let cell = &self.pipeline.cells[self.cell];
        let node = &self.pipeline.nodes[cell.node];
        let [driver, port] = [driving, at].map(|input| node.spec.inputs[input].name);
        let mut of: HashMap<Cow<'_, str>, &Items> = HashMap::new();
        for other in others {
            for prefix in prefixes(other) {
                // The items of several collections are not looked at.
                let several = |known: &mut &Items| *known = &Items::Unknown;
                of.entry(prefix).and_modify(several).or_insert(&other.1);
            }
        }
        for own in leading {
            let Some(theirs) = prefixes(own).iter().find_map(|prefix| of.get(prefix)) else {
                let cells = |prefix: &str| match prefix {
                    "" => "no cell".to_owned(),
                    prefix => format!("the cell `{}`", prefix.replace('+', ", ")),
                };
                let named = |of: &(Source, Items)| {
                    prefixes(of).iter().find(|prefix| !prefix.is_empty()).map(ToString::to_string)
                };
                let [other, own] = [others.first(), Some(own)].map(|of| of.and_then(named).unwrap_or_default());
                let message = format!(
                    "no item of the input `{port}` meets one of `{driver}`: the keys of `{port}` name {}, those of \
                     `{driver}` {}",
                    cells(&other),
                    cells(&own)
                );
                let hint = self.joined(driving, at);
                self.found.push(Foreseen { at: At::Input(port), message, hint });
                return;
            };
            if let (Items::These(own), Items::These(theirs) | Items::Among(theirs, ..)) = (&own.1, *theirs)
                && let Some(key) = own.difference(theirs).next()
            {
                let message = format!("the input `{port}` has no item `{key}`, which the input `{driver}` has");
                let hint = format!("connect a node that has all items of `{driver}`");
                self.found.push(Foreseen { at: At::Input(port), message, hint });
                return;
            }
        }
    }

    /// How two inputs are made to meet.
    fn joined(&self, driving: usize, at: usize) -> String {
        let cell = &self.pipeline.cells[self.cell];
        let name = &self.pipeline.nodes[cell.node].name;
        // A node that is gathered has axes which this one has not.
        let gathered = [driving, at].into_iter().flat_map(|input| &cell.inputs[input]).find_map(|feed| {
            let prefix = feed.prefix.as_ref()?;
            Some((&self.pipeline.nodes[self.pipeline.cells[feed.cell].node].name, prefix.replace('+', ", ")))
        });
        match gathered {
            Some((node, first)) => format!(
                "add `matrix: {{ like: {node} }}` to `{name}`, so that each cell reads its own, or select one cell, \
                 such as `{node}[{first}]`"
            ),
            None => format!("connect nodes to `{name}` that work on the same cells"),
        }
    }

    /// One item is wanted.
    fn single(&mut self, port: &'static str, given: &[(Source, Items)]) {
        let least: usize = given.iter().map(|(_, items)| items.least()).sum();
        if least < 2 {
            return;
        }
        let names: BTreeSet<&str> = given.iter().map(|(source, _)| source.name.as_str()).collect();
        let shown: Vec<String> = names.iter().take(3).map(|name| format!("`{name}`")).collect();
        let more = if names.len() > 3 { ", ..." } else { "" };
        let message = format!("the input `{port}` takes one item, but gets {least}, from {}{more}", shown.join(", "));
        let cell = &self.pipeline.cells[self.cell];
        let input = self.pipeline.nodes[cell.node].spec.inputs.iter().position(|of| of.name == port).unwrap_or(0);
        let gathers = cell.inputs[input].iter().any(|feed| feed.prefix.is_some());
        let hint = if gathers { self.joined(input, input) } else { "connect a node that makes one item".to_owned() };
        self.found.push(Foreseen { at: At::Input(port), message, hint });
    }
}
