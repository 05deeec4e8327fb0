//! Overrides: `node.param=value` and `values.NAME=value`, of the command line and of profiles. They replace named
//! values and parts of params before validation, so that an error is reported at its own position.

use super::{
    file::PipelineFile,
    node::RawNode,
    values::Values,
    yaml::{self, Data, Key, Yaml},
};
use crate::diagnostics::{Hint, Problem, Sources, Span, did_you_mean};
use std::{collections::HashMap, sync::Arc};

/// One override.
pub(super) struct Override {
    key: Key,
    value: Yaml,
    /// It counts. The others are those of profiles that were not chosen, which must still name what exists.
    chosen: bool,
}

impl Override {
    /// The named value that it is for, if it is for one, and where in it.
    fn of_value(&self) -> Option<(&str, Vec<&str>)> {
        let rest = self.key.text.strip_prefix("values.")?;
        let mut parts = rest.split('.');
        Some((parts.next().unwrap_or_default(), parts.collect()))
    }
}

/// All overrides, in order: those of profiles, then those of the command line.
pub(super) fn read(
    file: &mut PipelineFile,
    profile: Option<&str>,
    sets: &[String],
    sources: &mut Sources,
    problems: &mut Vec<Problem>,
) -> Vec<Override> {
    let profiles = std::mem::take(&mut file.profiles);
    if let Some(wanted) = profile
        && profiles.iter().all(|p| p.name.text != wanted)
    {
        let hint = did_you_mean(wanted, "profiles", profiles.iter().map(|p| p.name.text.as_str()));
        problems.push(Problem::nowhere(format!("unknown profile `{wanted}`")).hint(hint));
    }
    let mut found = Vec::new();
    for known in profiles {
        let chosen = profile == Some(known.name.text.as_str());
        found.extend(known.entries.into_iter().map(|(key, value)| Override { key, value, chosen }));
    }
    for set in sets {
        let source = sources.add("--set", set.clone());
        let whole = Span { source, start: 0, len: set.len().max(1) };
        let Some((path, text)) = set.split_once('=') else {
            let message = format!("`{set}` is not an assignment");
            problems.push(Problem::at(whole, message).hint("write `--set node.param=value`"));
            continue;
        };
        let key = Key { text: path.trim().to_owned(), span: Span { len: path.len().max(1), ..whole } };
        match yaml::parse(text, source) {
            Ok(value) => found.push(Override { key, value: value.shifted(path.len() + 1), chosen: true }),
            Err(problem) => problems.push(Problem { span: Some(whole), ..*problem }),
        }
    }
    found
}

/// Applies those of named values.
pub(super) fn to_values(file: &mut PipelineFile, overrides: &[Override], problems: &mut Vec<Problem>) {
    let index: HashMap<String, usize> =
        file.values.iter().enumerate().map(|(i, (key, _))| (key.text.clone(), i)).collect();
    let names: Arc<[String]> = file.values.iter().map(|(key, _)| key.text.clone()).collect();
    for one in overrides {
        let Some((name, path)) = one.of_value() else { continue };
        let Some(&at) = index.get(name) else {
            let hint = Hint::near(name, "values", &names);
            problems.push(Problem::at(one.key.span, format!("unknown value `{name}`")).hint(hint));
            continue;
        };
        if path.iter().any(|part| part.is_empty()) {
            let message = format!("`{}` is not `values.NAME`", one.key.text);
            problems.push(Problem::at(one.key.span, message).hint("remove the dot at the end"));
        } else if one.chosen {
            let (key, value) = &mut file.values[at];
            key.span = one.key.span;
            file.replaced.extend(replace(value, one.key.span, &path, one.value.clone()));
        } else {
            file.replaced.push(one.value.clone());
        }
    }
}

/// Applies those of params and of the seed.
pub(super) fn to_nodes(
    overrides: Vec<Override>,
    seed: &mut Option<Yaml>,
    nodes: &mut [RawNode],
    values: &mut Values,
    problems: &mut Vec<Problem>,
) {
    let index: HashMap<String, usize> = nodes.iter().enumerate().map(|(i, n)| (n.name.text.clone(), i)).collect();
    let names: Arc<[String]> = nodes.iter().map(|n| n.name.text.clone()).collect();
    for one in overrides {
        if one.of_value().is_some() {
            continue;
        }
        let Override { key, value, chosen } = one;
        let value = values.fill(value);
        if key.text == "seed" {
            if chosen {
                *seed = Some(value);
            }
            continue;
        }
        let mut parts = key.text.split('.');
        let name = parts.next().unwrap_or_default();
        let path: Vec<&str> = parts.collect();
        if path.is_empty() || path.iter().any(|part| part.is_empty()) {
            let message = format!("`{}` is not `node.param`", key.text);
            problems.push(Problem::at(key.span, message).hint("write for example `scenes.pool`"));
            continue;
        }
        let Some(&at) = index.get(name) else {
            let hint = Hint::near(name, "nodes", &names);
            problems.push(Problem::at(key.span, format!("unknown node `{name}`")).hint(hint));
            continue;
        };
        let node = &mut nodes[at];
        if node.matrix.iter().any(|axis| axis.name.text == path[0]) {
            let message = format!("`{}` is an axis of the matrix of `{name}`, so it cannot be set", path[0]);
            problems.push(Problem::at(key.span, message).hint("edit the matrix, or select one cell"));
        } else if chosen {
            replace(&mut node.params, key.span, &path, value);
        }
    }
}

/// Puts a value to a place in another, and gives what it took the place of.
fn replace(within: &mut Yaml, span: Span, path: &[&str], value: Yaml) -> Vec<Yaml> {
    let mut before = Vec::new();
    let mut at = within;
    for part in path {
        // A value that is no map gives way to one: `rungs.dyadic=64` over a list of rungs.
        if !matches!(at.data, Data::Map(_)) {
            before.push(std::mem::replace(at, Yaml { data: Data::Map(Vec::new()), span }));
        }
        let Data::Map(fields) = &mut at.data else { return before }; // made one right above
        let index = fields.iter().position(|(k, _)| k.text == *part).unwrap_or_else(|| {
            let empty = Yaml { data: Data::Null, span };
            fields.push((Key { text: (*part).to_owned(), span }, empty));
            fields.len() - 1
        });
        fields[index].0.span = span;
        at = &mut fields[index].1;
    }
    before.push(std::mem::replace(at, value));
    before
}
