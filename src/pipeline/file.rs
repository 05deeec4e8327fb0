//! The raw pipeline file: names and texts with positions, not yet checked against kinds.

use super::{
    read,
    yaml::{self, Data, Key, Yaml},
};
use crate::diagnostics::{Hint, Problem, Sources, Span};
use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    path::{Path, PathBuf},
    sync::Arc,
};
use tauflow_contract::read_regular;

/// Files that include each other deeper than this are refused.
const INCLUDE_DEPTH: usize = 16;
/// Most bytes of a file: far more than any has that people write.
const MOST_BYTES: u64 = 16 << 20;

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
    /// Named values; those of an including file take the place of those that it includes.
    pub values: Vec<(Key, Yaml)>,
    /// Values that were overridden. It is checked, and what it names counts as used.
    pub replaced: Vec<Yaml>,
    /// The nodes with what stands below their names, those of included files first.
    pub nodes: Vec<(Key, Yaml)>,
}

/// A named set of overrides.
#[derive(Debug)]
pub struct Profile {
    /// Its name.
    pub name: Key,
    /// `node.param` and its value.
    pub entries: Vec<(Key, Yaml)>,
}

/// Reads a file and all that it includes. Problems are added to `problems`; what can be read is returned.
pub fn load(path: &Path, sources: &mut Sources, problems: &mut Vec<Problem>) -> PipelineFile {
    let mut loader = Loader::new(sources, problems);
    loader.load(path, None, &[]);
    loader.file
}

/// Parses one text as if it were a file without includes.
pub fn load_text(name: &str, text: &str, sources: &mut Sources, problems: &mut Vec<Problem>) -> PipelineFile {
    let source = sources.add(name, text);
    let mut loader = Loader::new(sources, problems);
    loader.text(text, source, Path::new("."), &[]);
    loader.file
}

struct Loader<'a> {
    sources: &'a mut Sources,
    problems: &'a mut Vec<Problem>,
    /// Files that were read, and their sources.
    seen: BTreeMap<PathBuf, usize>,
    /// Which source includes which, directly or not.
    includes: BTreeSet<(usize, usize)>,
    /// Where each name stands in `file.nodes` and `file.values`.
    nodes: HashMap<String, usize>,
    values: HashMap<String, usize>,
    file: PipelineFile,
}

const TOP: [&str; 7] = ["pipeline", "seed", "include", "values", "profiles", "targets", "nodes"];

impl<'a> Loader<'a> {
    fn new(sources: &'a mut Sources, problems: &'a mut Vec<Problem>) -> Self {
        Self {
            sources,
            problems,
            seen: BTreeMap::new(),
            includes: BTreeSet::new(),
            nodes: HashMap::new(),
            values: HashMap::new(),
            file: PipelineFile::default(),
        }
    }

    fn problem(&mut self, problem: Problem) {
        self.problems.push(problem);
    }

    /// `above` are the files that include this one, the outermost first.
    fn load(&mut self, path: &Path, from: Option<Span>, above: &[usize]) {
        let read = read_regular(path, MOST_BYTES).map(String::from_utf8);
        let text = match read {
            Ok(Ok(text)) => text,
            Ok(Err(error)) => {
                let at = error.utf8_error().valid_up_to();
                let bytes = error.into_bytes();
                let line = bytes[..at].iter().filter(|byte| **byte == b'\n').count() + 1;
                let message = format!(
                    "the pipeline `{}` is not UTF-8: byte {:#04x} on line {line}",
                    path.display(),
                    bytes.get(at).copied().unwrap_or_default()
                );
                let problem = from.map_or_else(|| Problem::nowhere(&message), |span| Problem::at(span, &message));
                self.problem(problem.hint("save it as UTF-8 or ASCII"));
                return;
            }
            Err(error) => {
                let message = format!("cannot read the pipeline `{}`: {error}", path.display());
                let hint = "give the path of a YAML file; `tauflow init` writes a first one";
                self.problem(match from {
                    Some(span) => Problem::at(span, message).hint("paths are relative to the file that includes them"),
                    None => Problem::nowhere(message).hint(hint),
                });
                return;
            }
        };
        // A file that two others include is read once.
        let real = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if let Some(known) = self.seen.get(&real).copied() {
            let below: Vec<usize> = self.includes.iter().filter(|(by, _)| *by == known).map(|(_, of)| *of).collect();
            for by in above {
                self.includes.extend(below.iter().chain([&known]).map(|of| (*by, *of)));
            }
            return;
        }
        let source = self.sources.add(path.display().to_string(), text.clone());
        self.seen.insert(real, source);
        self.includes.extend(above.iter().map(|by| (*by, source)));
        self.text(&text, source, path.parent().unwrap_or(Path::new(".")), above);
    }

    fn text(&mut self, text: &str, source: usize, folder: &Path, above: &[usize]) {
        let yaml = match yaml::parse(text, source) {
            Ok(yaml) => yaml,
            Err(problem) => return self.problem(*problem),
        };
        let Data::Map(mut fields) = yaml.data else {
            let message = format!("a pipeline file must be a map, found {}", yaml.sort());
            return self.problem(Problem::at(yaml.span, message).hint("start with `pipeline: NAME` and `nodes:`"));
        };
        let root = above.is_empty();
        let names: Arc<[String]> = TOP.iter().map(|key| (*key).to_owned()).collect();
        // Included files come first, so that this file can override their values and profiles.
        fields.sort_by_key(|(key, _)| key.text != "include");
        for (key, value) in fields {
            match key.text.as_str() {
                "pipeline" if root => self.file.name = read::name(&value, "the pipeline's name", self.problems),
                "seed" if root => self.file.seed = Some(value),
                "targets" if root => self.file.targets = Some(read::texts(&value, "targets", self.problems)),
                "include" => self.include(&value, folder, &[above, &[source]].concat()),
                "values" => self.values(value, source),
                "profiles" => self.profiles(value),
                "nodes" => self.nodes(value),
                // An included file is a pipeline of its own; its name, seed and targets are not this one's.
                "pipeline" | "seed" | "targets" => {}
                other => {
                    let hint = Hint::near(other, "keys of a pipeline", &names);
                    self.problem(Problem::at(key.span, format!("unknown key `{other}`")).hint(hint));
                }
            }
        }
    }

    fn include(&mut self, value: &Yaml, folder: &Path, above: &[usize]) {
        for file in read::texts(value, "include", self.problems) {
            if above.len() > INCLUDE_DEPTH {
                let message = format!("files include each other more than {INCLUDE_DEPTH} deep");
                self.problem(Problem::at(file.span, message).hint("put shared nodes into one file"));
                return;
            }
            self.load(&folder.join(&file.text), Some(file.span), above);
        }
    }

    fn values(&mut self, value: Yaml, source: usize) {
        for (key, value) in read::map(value, "values", self.problems) {
            read::check_name(&key, "a value", self.problems);
            let Some(&index) = self.values.get(&key.text) else {
                self.values.insert(key.text.clone(), self.file.values.len());
                self.file.values.push((key, value));
                continue;
            };
            let known = self.file.values[index].0.span;
            if !self.includes.contains(&(source, known.source)) {
                let place = self.sources.place(known);
                let message = format!("the value `{}` is already defined at {place}", key.text);
                let hint = "neither file includes the other, so neither overrides the other: rename one of the values";
                self.problem(Problem::at(key.span, message).hint(hint));
            }
            let (_, before) = std::mem::replace(&mut self.file.values[index], (key, value));
            self.file.replaced.push(before);
        }
    }

    fn profiles(&mut self, value: Yaml) {
        for (name, entries) in read::map(value, "profiles", self.problems) {
            if name.text.is_empty() || name.text.starts_with('.') || name.text.contains(['/', '\\']) {
                let message = format!("`{}` cannot name a profile", name.text);
                let hint = "it is part of the name of a lock file: use no slash, and no dot at the start";
                self.problem(Problem::at(name.span, message).hint(hint));
            }
            let entries = read::map(entries, "a profile", self.problems);
            // An included file's entries come first, so that the including file overrides them.
            match self.file.profiles.iter_mut().find(|p| p.name.text == name.text) {
                Some(known) => known.entries.extend(entries),
                None => self.file.profiles.push(Profile { name, entries }),
            }
        }
    }

    fn nodes(&mut self, value: Yaml) {
        for (name, body) in read::map(value, "nodes", self.problems) {
            read::check_name(&name, "a node", self.problems);
            if name.text == "values" {
                let hint = "`values.NAME` overrides a named value: rename the node";
                self.problem(Problem::at(name.span, "`values` cannot be the name of a node").hint(hint));
            }
            if let Some(&other) = self.nodes.get(&name.text) {
                let place = self.sources.place(self.file.nodes[other].0.span);
                let message = format!("the node `{}` is already defined at {place}", name.text);
                self.problem(Problem::at(name.span, message).hint("rename one of them"));
                continue;
            }
            self.nodes.insert(name.text.clone(), self.file.nodes.len());
            self.file.nodes.push((name, body));
        }
    }
}
