//! Overrides: `node.param=value` of the command line, and profiles. They replace parts of params before anything is
//! checked, so that a wrong one is reported at its own place.

use super::{
    file::{PipelineFile, RawNode},
    yaml::{self, Data, Key, Yaml},
};
use crate::diagnostics::{Problem, Sources, Span, did_you_mean};

/// Applies a profile, then the command line's overrides.
pub fn apply(
    file: &mut PipelineFile,
    profile: Option<&str>,
    sets: &[String],
    sources: &mut Sources,
    problems: &mut Vec<Problem>,
) {
    let profiles = std::mem::take(&mut file.profiles);
    for known in &profiles {
        let chosen = profile == Some(known.name.text.as_str());
        for (key, value) in &known.entries {
            // A profile that is not chosen must still name what exists.
            apply_one(file, key, value.clone(), chosen, problems);
        }
    }
    if let Some(wanted) = profile
        && profiles.iter().all(|p| p.name.text != wanted)
    {
        let names: Vec<&str> = profiles.iter().map(|p| p.name.text.as_str()).collect();
        problems.push(
            Problem::nowhere(format!("there is no profile `{wanted}`")).hint(did_you_mean(wanted, "profiles", names)),
        );
    }
    file.profiles = profiles;
    for set in sets {
        let source = sources.add("--set", set.clone());
        let whole = Span { source, start: 0, len: set.len().max(1) };
        let Some((path, text)) = set.split_once('=') else {
            let message = format!("`{set}` sets nothing");
            problems.push(Problem::at(whole, message).hint("write `--set node.param=value`"));
            continue;
        };
        let key = Key { text: path.trim().to_owned(), span: Span { len: path.len().max(1), ..whole } };
        match yaml::parse(text, source) {
            Ok(value) => apply_one(file, &key, value.shifted(path.len() + 1), true, problems),
            Err(problem) => problems.push(Problem { span: Some(whole), ..*problem }),
        }
    }
}

fn apply_one(file: &mut PipelineFile, key: &Key, value: Yaml, chosen: bool, problems: &mut Vec<Problem>) {
    if key.text == "seed" {
        if chosen {
            file.seed = Some(value);
        }
        return;
    }
    let mut parts = key.text.split('.');
    let name = parts.next().unwrap_or_default();
    let path: Vec<&str> = parts.collect();
    if path.is_empty() || path.iter().any(|part| part.is_empty()) {
        let message = format!("`{}` is not `node.param`", key.text);
        problems.push(Problem::at(key.span, message).hint("write for example `scenes.pool`"));
        return;
    }
    let names: Vec<String> = file.nodes.iter().map(|n| n.name.text.clone()).collect();
    let Some(node) = file.nodes.iter_mut().find(|n| n.name.text == name) else {
        let hint = did_you_mean(name, "nodes", names.iter().map(String::as_str));
        problems.push(Problem::at(key.span, format!("there is no node `{name}`")).hint(hint));
        return;
    };
    if node.matrix.iter().any(|(axis, _)| axis.text == path[0]) {
        let message = format!("`{}` is an axis of the matrix of `{name}`, so it cannot be set", path[0]);
        problems.push(Problem::at(key.span, message).hint("edit the matrix, or ask for one cell only"));
        return;
    }
    if chosen {
        replace(node, key.span, &path, value);
    }
}

fn replace(node: &mut RawNode, span: Span, path: &[&str], value: Yaml) {
    let mut at = &mut node.params;
    for part in path {
        // A value that is no map gives way to one: `rungs.dyadic=64` over a list of rungs.
        if !matches!(at.data, Data::Map(_)) {
            *at = Yaml { data: Data::Map(Vec::new()), span };
        }
        let Data::Map(fields) = &mut at.data else { return }; // made one right above
        let index = fields.iter().position(|(k, _)| k.text == *part).unwrap_or_else(|| {
            let empty = Yaml { data: Data::Null, span };
            fields.push((Key { text: (*part).to_owned(), span }, empty));
            fields.len() - 1
        });
        fields[index].0.span = span;
        at = &mut fields[index].1;
    }
    *at = value;
}
