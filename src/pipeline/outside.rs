//! What a pipeline names on this machine: lists the sources that its targets need, and asks their kinds for missing
//! programs and files, so that `check` reports them at the line that names them. Knows no kind.

use super::{
    Pipeline,
    foresee::{Listed, param_span},
    node::RawNode,
    resolve::Draft,
    yaml::{Data, Yaml},
};
use crate::diagnostics::{Problem, Span};
use serde_json::Value;
use std::{
    collections::{BTreeSet, HashSet},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_contract::{ItemKey, KindError, Mode, NodeKind};

/// Adds a problem for everything outside that the targets need and that is not there; the items of the sources.
pub(super) fn look(
    pipeline: &Pipeline,
    (raw, drafts, order): (&[RawNode], &[Draft], &[usize]),
    problems: &mut Vec<Problem>,
) -> Listed {
    let mut listed = Listed::new();
    for place in needed(pipeline) {
        let node = &pipeline.nodes[place];
        let (raw, draft) = (&raw[order[place]], &drafts[order[place]]);
        let mut told = HashSet::new();
        for cell in node.cells.clone() {
            let at = cell - node.cells.start;
            let params = &pipeline.cells[cell].params;
            let missing = catch_unwind(AssertUnwindSafe(|| node.kind.missing(params))).unwrap_or_default();
            for problem in missing {
                // Cells mostly lack the same.
                if told.insert(problem.message.clone()) {
                    let span = param_span(raw, draft, at, &problem.pointer);
                    problems.push(Problem::at(span, problem.message).hint(problem.hint));
                }
            }
            if node.mode() != Mode::Source {
                continue;
            }
            match items(node.kind.as_ref(), params) {
                Ok(items) => {
                    listed.insert(cell, Arc::new(items));
                }
                Err(message) => {
                    if told.insert(message.clone()) {
                        let tree = draft.cells[at].tree(raw);
                        let span = named(&tree, &message).unwrap_or(raw.name.span);
                        // Messages of kinds end with the remedy.
                        let (what, remedy) = message.rsplit_once("; ").unwrap_or((&message, ""));
                        problems.push(Problem::at(span, what).hint(remedy));
                    }
                }
            }
        }
    }
    listed
}

/// The targets, and all nodes that they read, directly or not.
fn needed(pipeline: &Pipeline) -> Vec<usize> {
    let mut needed = vec![false; pipeline.nodes.len()];
    let mut open: Vec<usize> = pipeline.targets.iter().map(|target| target.node).collect();
    while let Some(node) = open.pop() {
        if !std::mem::replace(&mut needed[node], true) {
            open.extend(pipeline.reads(node));
        }
    }
    (0..needed.len()).filter(|node| needed[*node]).collect()
}

/// The items of a source, or the reason why it cannot be listed.
fn items(kind: &dyn NodeKind, params: &Value) -> Result<BTreeSet<ItemKey>, String> {
    match catch_unwind(AssertUnwindSafe(|| kind.items(params))) {
        Ok(Ok(items)) => Ok(items.into_iter().map(|item| item.key).collect()),
        Ok(Err(KindError::Input(message) | KindError::Environment(message))) => Err(message),
        Ok(Err(error)) => Err(error.to_string()),
        Err(_) => Err("internal error: listing the items panicked; please report it".to_owned()),
    }
}

/// The first text of a tree that a message names in backticks, such as the path of a missing file.
fn named(tree: &Yaml, message: &str) -> Option<Span> {
    match &tree.data {
        Data::Text(text) => message.contains(&format!("`{text}`")).then_some(tree.span),
        Data::List(items) => items.iter().find_map(|item| named(item, message)),
        Data::Map(fields) => fields.iter().find_map(|(_, value)| named(value, message)),
        Data::Null | Data::Bool(_) | Data::Number(_) => None,
    }
}
