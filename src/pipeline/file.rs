//! The pipeline file as it is written: names and texts with positions, nothing checked against kinds yet.

use super::{
    reference::is_name,
    yaml::{self, Data, Key, Yaml},
};
use crate::diagnostics::{Problem, Sources, Span, did_you_mean};
use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

/// Files that include each other deeper than this are refused.
const INCLUDE_DEPTH: usize = 16;

/// A file and what it includes.
#[derive(Debug, Default)]
pub struct PipelineFile {
    /// The pipeline's name.
    pub name: Option<Key>,
    /// The seed, and where it stands.
    pub seed: Option<Yaml>,
    /// Nodes that are asked for.
    pub targets: Option<Vec<Key>>,
    /// Named sets of overrides; of two with one name, later entries win.
    pub profiles: Vec<Profile>,
    /// The nodes, those of included files first.
    pub nodes: Vec<RawNode>,
}

/// A named set of overrides.
#[derive(Debug)]
pub struct Profile {
    /// Its name.
    pub name: Key,
    /// `node.param` and its value.
    pub entries: Vec<(Key, Yaml)>,
}

/// A node as written.
#[derive(Debug)]
pub struct RawNode {
    /// Its name.
    pub name: Key,
    /// Its kind's name.
    pub kind: Option<Key>,
    /// Its inputs.
    pub inputs: Vec<RawInput>,
    /// Its params: a map.
    pub params: Yaml,
    /// Its axes.
    pub matrix: Vec<(Key, Vec<Yaml>)>,
    /// Its outputs need not be stored.
    pub transient: bool,
}

/// An input as written.
#[derive(Debug)]
pub struct RawInput {
    /// The port.
    pub port: Key,
    /// What it names.
    pub refs: Vec<Key>,
}

/// Reads a file and all that it includes. Problems are added to `problems`; what can be read is returned.
pub fn load(path: &Path, sources: &mut Sources, problems: &mut Vec<Problem>) -> PipelineFile {
    let mut loader = Loader { sources, problems, seen: BTreeSet::new(), file: PipelineFile::default() };
    loader.load(path, None, 0);
    loader.file
}

/// Parses one text as if it were a file without includes.
pub fn load_text(name: &str, text: &str, sources: &mut Sources, problems: &mut Vec<Problem>) -> PipelineFile {
    let source = sources.add(name, text);
    let mut loader = Loader { sources, problems, seen: BTreeSet::new(), file: PipelineFile::default() };
    loader.text(text, source, Path::new("."), 0);
    loader.file
}

struct Loader<'a> {
    sources: &'a mut Sources,
    problems: &'a mut Vec<Problem>,
    seen: BTreeSet<PathBuf>,
    file: PipelineFile,
}

const TOP: [&str; 6] = ["pipeline", "seed", "include", "profiles", "targets", "nodes"];
const NODE: [&str; 5] = ["kind", "inputs", "params", "matrix", "transient"];

impl Loader<'_> {
    fn problem(&mut self, problem: Problem) {
        self.problems.push(problem);
    }

    fn load(&mut self, path: &Path, from: Option<Span>, depth: usize) {
        let read = fs::read(path).map(String::from_utf8);
        let text = match read {
            Ok(Ok(text)) => text,
            Ok(Err(error)) => {
                let at = error.utf8_error().valid_up_to();
                let bytes = error.into_bytes();
                let line = bytes[..at].iter().filter(|byte| **byte == b'\n').count() + 1;
                let message = format!(
                    "the pipeline `{}` is no UTF-8 text: byte {:#04x} on line {line}",
                    path.display(),
                    bytes.get(at).copied().unwrap_or_default()
                );
                let problem = from.map_or_else(|| Problem::nowhere(&message), |span| Problem::at(span, &message));
                self.problem(problem.hint("save it as UTF-8, which plain ASCII is too"));
                return;
            }
            Err(error) => {
                let message = format!("cannot read the pipeline `{}`: {error}", path.display());
                let hint = "give the path of a YAML file; `tauflow init` writes one to start from";
                self.problem(match from {
                    Some(span) => Problem::at(span, message).hint("paths are relative to the file that includes them"),
                    None => Problem::nowhere(message).hint(hint),
                });
                return;
            }
        };
        // A file that two others include is read once.
        if !self.seen.insert(path.canonicalize().unwrap_or_else(|_| path.to_owned())) {
            return;
        }
        let source = self.sources.add(path.display().to_string(), text.clone());
        self.text(&text, source, path.parent().unwrap_or(Path::new(".")), depth);
    }

    fn text(&mut self, text: &str, source: usize, folder: &Path, depth: usize) {
        let yaml = match yaml::parse(text, source) {
            Ok(yaml) => yaml,
            Err(problem) => return self.problem(*problem),
        };
        let Data::Map(mut fields) = yaml.data else {
            let message = format!("a pipeline file is a map, this is {}", yaml.sort());
            return self.problem(Problem::at(yaml.span, message).hint("start with `pipeline: NAME` and `nodes:`"));
        };
        let root = depth == 0;
        // What is included comes first, so that this file can override its profiles.
        fields.sort_by_key(|(key, _)| key.text != "include");
        for (key, value) in fields {
            match key.text.as_str() {
                "pipeline" if root => self.file.name = self.name_of(&value, "the pipeline's name"),
                "seed" if root => self.file.seed = Some(value),
                "targets" if root => self.file.targets = Some(self.texts(&value, "targets")),
                "include" => self.include(&value, folder, depth),
                "profiles" => self.profiles(value),
                "nodes" => self.nodes(value),
                // An included file is a pipeline of its own; its name, seed and targets are not this one's.
                "pipeline" | "seed" | "targets" => {}
                other => {
                    let hint = did_you_mean(other, "keys of a pipeline", TOP);
                    self.problem(Problem::at(key.span, format!("unknown key `{other}`")).hint(hint));
                }
            }
        }
    }

    fn include(&mut self, value: &Yaml, folder: &Path, depth: usize) {
        for file in self.texts(value, "include") {
            if depth + 1 > INCLUDE_DEPTH {
                let message = format!("files include each other more than {INCLUDE_DEPTH} deep");
                self.problem(Problem::at(file.span, message).hint("put shared nodes into one file"));
                return;
            }
            self.load(&folder.join(&file.text), Some(file.span), depth + 1);
        }
    }

    fn profiles(&mut self, value: Yaml) {
        for (name, entries) in self.map(value, "profiles") {
            let entries = self.map(entries, "a profile");
            // An included file's entries come first, so that the including file overrides them.
            match self.file.profiles.iter_mut().find(|p| p.name.text == name.text) {
                Some(known) => known.entries.extend(entries),
                None => self.file.profiles.push(Profile { name, entries }),
            }
        }
    }

    fn nodes(&mut self, value: Yaml) {
        for (name, body) in self.map(value, "nodes") {
            if !is_name(&name.text) {
                let message = format!("`{}` cannot name a node", name.text);
                self.problem(
                    Problem::at(name.span, message).hint("use letters, digits, `_` and `-`, starting with a letter"),
                );
            }
            if let Some(other) = self.file.nodes.iter().find(|n| n.name.text == name.text) {
                let place = self.sources.place(other.name.span);
                let message = format!("the node `{}` is there already, at {place}", name.text);
                self.problem(Problem::at(name.span, message).hint("give one of them another name"));
                continue;
            }
            let node = self.node(name, body);
            self.file.nodes.push(node);
        }
    }

    fn node(&mut self, name: Key, body: Yaml) -> RawNode {
        let empty = Yaml { data: Data::Map(Vec::new()), span: name.span };
        let name_key = name.clone();
        let (inputs, matrix) = (Vec::new(), Vec::new());
        let mut node = RawNode { name: name_key, kind: None, inputs, params: empty, matrix, transient: false };
        let mut has_kind = false;
        for (key, value) in self.map(body, "a node") {
            match key.text.as_str() {
                "kind" => {
                    has_kind = true;
                    node.kind = self.name_of(&value, "a kind");
                }
                "inputs" => {
                    for (port, value) in self.map(value, "inputs") {
                        let refs = self.texts(&value, "an input");
                        if refs.is_empty() && matches!(&value.data, Data::List(list) if list.is_empty()) {
                            let message = format!("the input `{}` names nothing", port.text);
                            self.problem(Problem::at(value.span, message).hint("name a node, or leave the input out"));
                        }
                        node.inputs.push(RawInput { port, refs });
                    }
                }
                "params" => {
                    let span = value.span;
                    node.params = Yaml { data: Data::Map(self.map(value, "params")), span };
                }
                "matrix" => node.matrix = self.matrix(value),
                "transient" => match value.data {
                    Data::Bool(transient) => node.transient = transient,
                    _ => {
                        let message = format!("`transient` must be true or false, this is {}", value.sort());
                        self.problem(Problem::at(value.span, message).hint("write `transient: true`, or leave it out"));
                    }
                },
                other => {
                    let hint = did_you_mean(other, "keys of a node", NODE);
                    self.problem(Problem::at(key.span, format!("unknown key `{other}` of a node")).hint(hint));
                }
            }
        }
        if !has_kind {
            let message = format!("the node `{}` has no kind", name.text);
            self.problem(Problem::at(name.span, message).hint("add `kind: ...`; `tauflow kinds` lists them"));
        }
        node
    }

    fn matrix(&mut self, value: Yaml) -> Vec<(Key, Vec<Yaml>)> {
        let mut axes = Vec::new();
        for (axis, values) in self.map(value, "matrix") {
            if !is_name(&axis.text) {
                let message = format!("`{}` cannot name an axis", axis.text);
                self.problem(
                    Problem::at(axis.span, message).hint("use letters, digits, `_` and `-`, starting with a letter"),
                );
            }
            match values.data {
                Data::List(list) if !list.is_empty() => axes.push((axis, list)),
                Data::List(_) => {
                    let message = format!("the axis `{}` has no values", axis.text);
                    self.problem(Problem::at(values.span, message).hint("give at least one value"));
                }
                _ => {
                    let message = format!("the axis `{}` is {}, expected a list of values", axis.text, values.sort());
                    self.problem(Problem::at(values.span, message).hint("write `[a, b]`"));
                }
            }
        }
        axes
    }

    fn map(&mut self, value: Yaml, what: &str) -> Vec<(Key, Yaml)> {
        match value.data {
            Data::Map(fields) => fields,
            Data::Null => Vec::new(),
            _ => {
                let message = format!("{what} must be a map, this is {}", value.sort());
                self.problem(Problem::at(value.span, message).hint("write `key: value` lines below it"));
                Vec::new()
            }
        }
    }

    /// A text, or a list of texts.
    fn texts(&mut self, value: &Yaml, what: &str) -> Vec<Key> {
        let mut found = Vec::new();
        let single = std::slice::from_ref(value);
        let items = if let Data::List(items) = &value.data { items } else { single };
        for item in items {
            match &item.data {
                Data::Text(text) => found.push(Key { text: text.clone(), span: item.span }),
                _ => {
                    let message = format!("{what}: expected a text or a list of texts, found {}", item.sort());
                    self.problem(Problem::at(item.span, message).hint("write a name, or `[a, b]`"));
                }
            }
        }
        found
    }

    fn name_of(&mut self, value: &Yaml, what: &str) -> Option<Key> {
        if let Data::Text(text) = &value.data {
            if is_name(text) {
                return Some(Key { text: text.clone(), span: value.span });
            }
            let hint = "use letters, digits, `_` and `-`, starting with a letter";
            self.problem(Problem::at(value.span, format!("`{text}` cannot be {what}")).hint(hint));
        } else {
            let message = format!("{what} must be a text, this is {}", value.sort());
            self.problem(Problem::at(value.span, message).hint("write a name, in quotes if it looks like a number"));
        }
        None
    }
}
