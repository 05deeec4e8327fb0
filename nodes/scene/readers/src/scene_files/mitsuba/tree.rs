//! A Mitsuba 3 file as plugins with their parameters: defaults put in, files included, references found. Knows no
//! plugin.
//!
//! Source: Mitsuba 3's documentation of its file format, and what version 3.9.1 does where that is silent. Paths are
//! relative to the main file, also in included ones.

mod transforms;

use super::values::{Transform, Value, color, numbers, spectrum};
use crate::scene_files::{
    given::{Given, normalised, text_of},
    problems::{Place, Problems},
};
use roxmltree::{Document, Node as Element, ParsingOptions};
use std::{
    cell::Cell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

/// A parameter.
#[derive(Debug)]
pub struct Property {
    /// Its name; empty for plugins inside that have none.
    pub name: String,
    /// Its type.
    pub value: Value,
    /// Where it stands.
    pub at: Place,
    /// True once somebody read it.
    pub used: Cell<bool>,
}

/// A plugin.
#[derive(Debug)]
pub struct Plugin {
    /// `bsdf`, `shape`, ...
    pub tag: String,
    /// Its type.
    pub sort: String,
    /// Where it stands.
    pub at: Place,
    /// Its arguments.
    pub properties: Vec<Property>,
}

/// A file.
#[derive(Debug, Default)]
pub struct Tree {
    /// All plugins; the last is the scene.
    pub plugins: Vec<Plugin>,
    /// Plugins by their `id`.
    pub ids: BTreeMap<String, usize>,
    /// Every file that is named.
    pub files: BTreeSet<String>,
}

const PLUGINS: [&str; 14] = [
    "scene",
    "integrator",
    "sensor",
    "sampler",
    "film",
    "rfilter",
    "bsdf",
    "shape",
    "emitter",
    "texture",
    "medium",
    "phase",
    "volume",
    "spectrum",
];

/// Deepest nesting of elements, most files included, and most plugins.
const DEEPEST: usize = 64;
const MOST_INCLUDED: usize = 1000;
const MOST_PLUGINS: usize = 1 << 20;

/// Most search paths: each file is looked for in each.
const MOST_FOLDERS: usize = 32;

/// Most bytes of files that are included again, of values that defaults are put into, and most attributes of an
/// element: what finds doubles among these compares each with each.
const MOST_AGAIN: usize = 1 << 25;
const MOST_EXPANDED: usize = 1 << 25;
const MOST_ATTRIBUTES: usize = 64;

/// Most namespaces of a file: Mitsuba knows none, and each element inside of some has them all.
const MOST_NAMESPACES: usize = 16;

/// Most bytes of a default's name: of a text behind a `$`, each prefix may be one.
const LONGEST_NAME: usize = 256;

/// The attributes that elements have: those of all, and those of some.
const COMMON: [&str; 2] = ["name", "value"];
const ATTRIBUTES: [(&str, &[&str]); 11] = [
    ("scene", &["version"]),
    ("ref", &["id"]),
    ("alias", &["id", "as"]),
    ("include", &["filename"]),
    ("spectrum", &["type", "id", "filename"]),
    ("point", &["x", "y", "z"]),
    ("vector", &["x", "y", "z"]),
    ("translate", &["x", "y", "z"]),
    ("scale", &["x", "y", "z"]),
    ("rotate", &["x", "y", "z", "angle"]),
    ("lookat", &["origin", "target", "up"]),
];

struct Parser<'a> {
    given: &'a Given<'a>,
    problems: &'a mut Problems,
    tree: Tree,
    defaults: BTreeMap<String, String>,
    aliases: Vec<(String, String, Place)>,
    /// Folders that files are looked for in, the first one first.
    folders: Vec<String>,
    included: usize,
    /// Bytes of files that were included again, and of values that defaults were put into.
    again: usize,
    expanded: usize,
}

/// Reads a file and what it includes; what is wrong with it is told.
pub fn parse(name: &str, bytes: &[u8], given: &Given<'_>, problems: &mut Problems) -> Tree {
    let (defaults, aliases) = (BTreeMap::new(), Vec::new());
    let mut parser = Parser {
        given,
        problems,
        tree: Tree::default(),
        defaults,
        aliases,
        folders: Vec::new(),
        included: 0,
        again: 0,
        expanded: 0,
    };
    let mut scene = Vec::new();
    parser.document(name, bytes, 0, &mut scene);
    parser.tree.plugins.push(Plugin {
        tag: "scene".into(),
        sort: "scene".into(),
        at: Place::file(name),
        properties: scene,
    });
    parser.find_files();
    for (id, name, at) in parser.aliases {
        match parser.tree.ids.get(&id) {
            Some(plugin) => {
                parser.tree.ids.insert(name, *plugin);
            }
            None => parser.problems.error(&at, format!("there is no `{id}`"), "name the `id` of a plugin"),
        }
    }
    parser.tree
}

/// A folder by a relative path, with `/` behind it; empty for the main file's own.
fn normalised_folder(path: &str) -> Option<String> {
    if path.split(['/', '\\']).all(|part| matches!(part, "" | ".")) && !path.starts_with('/') {
        return Some(String::new());
    }
    normalised(path).map(|path| format!("{path}/"))
}

impl Parser<'_> {
    /// Where a file is: in one of the folders that are searched, or where its name says.
    fn found(&self, path: &str) -> String {
        let places = self.folders.iter().map(|folder| format!("{folder}{path}"));
        places.filter(|_| !path.starts_with('/')).find(|place| self.given.has(place)).unwrap_or_else(|| path.to_owned())
    }

    /// Finds the files that plugins name, once all search paths are known.
    fn find_files(&mut self) {
        let mut plugins = std::mem::take(&mut self.tree.plugins);
        for property in plugins.iter_mut().flat_map(|plugin| &mut plugin.properties) {
            if let (Value::Text(path), "filename") = (&mut property.value, property.name.as_str()) {
                *path = self.found(path);
                self.tree.files.insert(path.clone());
            }
        }
        self.tree.plugins = plugins;
    }

    fn document(&mut self, name: &str, bytes: &[u8], depth: usize, into: &mut Vec<Property>) {
        let file = Place::file(name);
        let Some(text) = text_of(bytes, &file, self.problems) else { return };
        if let Some((line, what)) = crowded(text) {
            let at = Place { file: name.into(), line };
            return self.problems.error(&at, what, "no file of Mitsuba has as many: take them out");
        }
        let options = ParsingOptions { allow_dtd: false, nodes_limit: 1 << 22, ..ParsingOptions::default() };
        let document = match Document::parse_with_options(text, options) {
            Ok(document) => document,
            Err(error) => return self.problems.error(&file, format!("no XML: {error}"), "mend it"),
        };
        let root = document.root_element();
        let rows = Lines { file: name.into(), starts: text_lines(document.input_text()) };
        if root.tag_name().name() != "scene" {
            let what = format!("its root is `{}`", root.tag_name().name());
            return self.problems.error(&rows.place(root), what, "a Mitsuba file has a root `scene`");
        }
        if let Some(version) = root.attribute("version")
            && version.split('.').next().and_then(|v| v.trim().parse::<u32>().ok()).is_none_or(|v| v < 2)
        {
            let remedy = "load it in Mitsuba 3 and write it anew (`mitsuba.parser.write_file`)";
            self.problems.error(&rows.place(root), format!("it is of version {version}"), remedy);
        }
        for child in root.children().filter(Element::is_element) {
            self.element(child, &rows, depth + 1, into);
        }
    }

    /// Names attributes that an element of its sort does not have.
    fn check_attributes(&mut self, element: Element<'_, '_>, at: &Place) {
        let tag = element.tag_name().name();
        let of_plugin: &[&str] = if PLUGINS.contains(&tag) { &["type", "id"] } else { &[] };
        let own = ATTRIBUTES.iter().find(|(name, _)| *name == tag).map_or(of_plugin, |(_, own)| own);
        for name in element.attributes().map(|a| a.name()).filter(|n| !COMMON.contains(n) && !own.contains(n)) {
            self.problems.error(at, format!("`{tag}` has no attribute `{name}`"), "take it out");
        }
    }

    /// An attribute with defaults put in for `$name`.
    fn attribute(&mut self, element: Element<'_, '_>, name: &str, at: &Place) -> Option<String> {
        let text = element.attribute(name)?;
        if !text.contains('$') {
            return Some(text.to_owned());
        }
        let mut out = String::new();
        let mut rest = text;
        while let Some(dollar) = rest.find('$') {
            out.push_str(&rest[..dollar]);
            rest = &rest[dollar + 1..];
            // The longest name that is known: `$spp2` may be `$spp` with a 2 behind it.
            let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
            let end = end.min(LONGEST_NAME);
            let known = (1..=end)
                .rev()
                .filter(|end| rest.is_char_boundary(*end))
                .find(|end| self.defaults.contains_key(&rest[..*end]));
            let Some(end) = known else {
                let name: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').take(80).collect();
                self.problems.error(at, format!("`${name}` has no value"), "give it one by a `default` above");
                return None;
            };
            out.push_str(&self.defaults[&rest[..end]]);
            rest = &rest[end..];
            if out.len() > 1 << 16 {
                self.problems.error(at, "its value is too long", "write shorter defaults");
                return None;
            }
        }
        out.push_str(rest);
        self.expanded += out.len();
        if self.expanded > MOST_EXPANDED {
            let file = Place::file(&at.file);
            self.problems.error(&file, "its defaults are put into too many values", "write shorter ones");
            return None;
        }
        Some(out)
    }

    fn needed(&mut self, element: Element<'_, '_>, name: &str, at: &Place) -> Option<String> {
        if element.attribute(name).is_none() {
            let what = format!("`{}` without the attribute `{name}`", element.tag_name().name());
            self.problems.error(at, what, "give it one");
        }
        self.attribute(element, name, at)
    }

    fn element(&mut self, element: Element<'_, '_>, rows: &Lines, depth: usize, into: &mut Vec<Property>) {
        let at = rows.place(element);
        let tag = element.tag_name().name();
        if depth > DEEPEST || self.tree.plugins.len() >= MOST_PLUGINS {
            return self.problems.error(&at, "too deep, or too much of it", "write a smaller scene");
        }
        self.check_attributes(element, &at);
        match tag {
            "default" => {
                let name = self.needed(element, "name", &at);
                if name.as_ref().is_some_and(|name| name.len() > LONGEST_NAME) {
                    let what = format!("a default's name has more than {LONGEST_NAME} bytes");
                    return self.problems.error(&at, what, "use a shorter one");
                }
                if let (Some(name), Some(value)) = (name, self.needed(element, "value", &at)) {
                    self.defaults.entry(name).or_insert(value);
                }
                return;
            }
            "alias" => {
                let (id, name) = (self.needed(element, "id", &at), self.needed(element, "as", &at));
                self.aliases.extend(id.zip(name).map(|(id, name)| (id, name, at)));
                return;
            }
            "path" => {
                let Some(path) = self.needed(element, "value", &at) else { return };
                // Searched before those that were named earlier, and before the main file's own folder.
                match normalised_folder(&path) {
                    Some(folder) => self.folders.insert(0, folder),
                    None => {
                        let what = format!("the search path `{path}` is not relative to the main file");
                        self.problems.error(&at, what, "write a relative one");
                    }
                }
                if self.folders.len() > MOST_FOLDERS {
                    self.problems.error(&at, "too many search paths", "put the files into fewer folders");
                    self.folders.clear();
                }
                return;
            }
            "include" => {
                let Some(path) = self.needed(element, "filename", &at) else { return };
                let path = self.found(&path);
                self.included += 1;
                if self.included > MOST_INCLUDED || depth + 4 > DEEPEST {
                    return self.problems.error(&at, "too many files are included, or one in itself", "include less");
                }
                let again = !self.tree.files.insert(path.clone());
                if let Some(bytes) = self.given.read(&path, &at, self.problems) {
                    self.again += if again { bytes.len() } else { 0 };
                    if self.again > MOST_AGAIN {
                        let file = Place::file(&at.file);
                        return self.problems.error(&file, "files are included again and again", "include less");
                    }
                    self.document(&path, &bytes, depth + 4, into);
                }
                return;
            }
            _ => {}
        }
        let name = self.attribute(element, "name", &at).unwrap_or_default();
        let Some(value) = self.value(element, tag, rows, depth, &at) else { return };
        into.push(Property { name, value, at, used: Cell::new(false) });
    }

    fn value(&mut self, element: Element<'_, '_>, tag: &str, rows: &Lines, depth: usize, at: &Place) -> Option<Value> {
        if PLUGINS.contains(&tag) && (tag != "spectrum" || element.has_attribute("type")) {
            return self.plugin(element, tag, rows, depth, at).map(Value::Plugin);
        }
        match tag {
            "ref" => return self.needed(element, "id", at).map(Value::Reference),
            "transform" => return Some(Value::Transform(self.transform(element, rows))),
            "point" | "vector" => {
                return match element.has_attribute("value") {
                    true => self.triple(element, "value", at).map(Value::Vector),
                    false => Some(Value::Vector(self.axes(element, 0.0, at)?)),
                };
            }
            "float" | "integer" | "boolean" | "string" | "rgb" | "srgb" | "spectrum" => {}
            _ => {
                self.problems.error(at, format!("elements `{tag}` are not supported"), "take it out");
                return None;
            }
        }
        if tag == "spectrum" && element.has_attribute("filename") {
            self.problems.error(at, "spectra in files are not supported", "write its values into `value`");
            return None;
        }
        let text = self.needed(element, "value", at)?;
        let value = match tag {
            "string" => Some(Value::Text(text.clone())),
            "boolean" => match text.trim().to_ascii_lowercase().as_str() {
                "true" => Some(Value::Bool(true)),
                "false" => Some(Value::Bool(false)),
                _ => None,
            },
            "rgb" | "srgb" => color(&text, tag == "srgb").map(Value::Color),
            "spectrum" => spectrum(&text),
            _ => numbers(&text)
                .filter(|v| v.len() == 1 && (tag != "integer" || v[0].fract() == 0.0))
                .map(|v| Value::Number(v[0])),
        };
        if value.is_none() {
            self.problems.error(at, format!("`{text}` is no {tag}"), "mend the value");
        }
        value
    }

    /// Tells of values that are given twice.
    fn check_names(&mut self, properties: &[Property]) {
        let mut seen = BTreeSet::new();
        for property in properties.iter().filter(|p| !p.name.is_empty()) {
            let new = seen.insert(&property.name);
            if !new && !matches!(property.value, Value::Plugin(_) | Value::Reference(_)) {
                let what = format!("`{}` is given twice", property.name);
                self.problems.error(&property.at, what, "take one of them out");
            }
        }
    }

    fn plugin(&mut self, element: Element<'_, '_>, tag: &str, rows: &Lines, depth: usize, at: &Place) -> Option<usize> {
        let sort = self.needed(element, "type", at)?;
        let id = self.attribute(element, "id", at);
        let mut properties = Vec::new();
        for child in element.children().filter(Element::is_element) {
            self.element(child, rows, depth + 1, &mut properties);
        }
        self.check_names(&properties);
        self.tree.plugins.push(Plugin { tag: tag.to_owned(), sort, at: at.clone(), properties });
        let number = self.tree.plugins.len() - 1;
        if let Some(id) = id
            && self.tree.ids.insert(id.clone(), number).is_some()
        {
            self.problems.error(at, format!("two plugins have the id `{id}`"), "give each its own");
        }
        Some(number)
    }
}

/// An element that has more attributes than any of Mitsuba's, or one namespace too many, if there is one: its line, and
/// what it is.
fn crowded(text: &str) -> Option<(u32, String)> {
    let (mut line, mut rest, mut namespaces) = (1, text, 0);
    let skip = |rest: &mut &str, line: &mut u32, end: usize| {
        *line += rest[..end].bytes().filter(|b| *b == b'\n').count() as u32;
        *rest = &rest[end..];
    };
    while let Some(start) = rest.find('<') {
        skip(&mut rest, &mut line, start);
        let ends = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        if let Some((_, end)) = ends.iter().find(|(start, _)| rest.starts_with(start)) {
            let end = rest.find(end).map_or(rest.len(), |at| at + end.len());
            skip(&mut rest, &mut line, end);
            continue;
        }
        let (mut quote, mut count, mut end) = (None, 0, rest.len());
        for (at, byte) in rest.bytes().enumerate() {
            match (quote, byte) {
                (None, b'"' | b'\'') => quote = Some(byte),
                (None, b'=') => count += 1,
                (None, b'x') => {
                    let begins = rest.as_bytes()[at - 1].is_ascii_whitespace();
                    namespaces += usize::from(begins && rest.as_bytes()[at..].starts_with(b"xmlns"));
                }
                (None, b'>') => {
                    end = at + 1;
                    break;
                }
                (Some(open), _) if open == byte => quote = None,
                _ => {}
            }
        }
        if count > MOST_ATTRIBUTES {
            return Some((line, format!("an element of more than {MOST_ATTRIBUTES} attributes")));
        }
        if namespaces > MOST_NAMESPACES {
            return Some((line, format!("more than {MOST_NAMESPACES} namespaces")));
        }
        skip(&mut rest, &mut line, end);
    }
    None
}

/// The lines of a text, to find a node's in.
struct Lines {
    file: Rc<str>,
    starts: Vec<usize>,
}

fn text_lines(text: &str) -> Vec<usize> {
    std::iter::once(0).chain(text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i + 1)).collect()
}

impl Lines {
    fn place(&self, element: Element<'_, '_>) -> Place {
        let line = self.starts.partition_point(|start| *start <= element.range().start);
        Place { file: Rc::clone(&self.file), line: line as u32 }
    }
}
