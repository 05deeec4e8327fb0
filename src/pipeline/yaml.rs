//! YAML with positions: parses text into a tree whose nodes know their source range.
//!
//! Knows no pipeline. Parsing is `serde-saphyr`'s, with limits on aliases, depth and size; YAML 1.1 booleans
//! (`yes`, `on`) are plain strings here.

use crate::diagnostics::{Problem, Span};
use serde::{
    Deserialize, Deserializer,
    de::{Error as _, MapAccess, SeqAccess, Visitor},
};
use serde_json::{Map, Number, Value};
use serde_saphyr::{Location, Spanned};
use std::{collections::HashSet, fmt};

/// A node of the tree.
#[derive(Clone, Debug, PartialEq)]
pub struct Yaml {
    /// Its content.
    pub data: Data,
    /// Where it stands.
    pub span: Span,
}

/// The content of a node.
#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    /// Nothing.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A number.
    Number(Number),
    /// A text.
    Text(String),
    /// A list.
    List(Vec<Yaml>),
    /// A map, in the order of the file.
    Map(Vec<(Key, Yaml)>),
}

/// A key of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// Its text.
    pub text: String,
    /// Where it stands.
    pub span: Span,
}

impl Yaml {
    /// The type of the node, for messages.
    pub fn sort(&self) -> &'static str {
        match &self.data {
            Data::Null => "nothing",
            Data::Bool(_) => "a boolean",
            Data::Number(_) => "a number",
            Data::Text(_) => "a text",
            Data::List(_) => "a list",
            Data::Map(_) => "a map",
        }
    }

    /// The same tree as JSON.
    pub fn to_json(&self) -> Value {
        match &self.data {
            Data::Null => Value::Null,
            Data::Bool(b) => Value::Bool(*b),
            Data::Number(n) => Value::Number(n.clone()),
            Data::Text(s) => Value::String(s.clone()),
            Data::List(items) => Value::Array(items.iter().map(Self::to_json).collect()),
            Data::Map(fields) => {
                Value::Object(fields.iter().map(|(k, v)| (k.text.clone(), v.to_json())).collect::<Map<_, _>>())
            }
        }
    }

    /// The value of a key of a map.
    pub fn get(&self, key: &str) -> Option<&Self> {
        let Data::Map(fields) = &self.data else { return None };
        fields.iter().find(|(k, _)| k.text == key).map(|(_, v)| v)
    }

    /// The same tree, standing `by` bytes later in its source.
    pub fn shifted(mut self, by: usize) -> Self {
        self.span.start += by;
        match &mut self.data {
            Data::List(items) => {
                for item in items {
                    *item = std::mem::replace(item, Self { data: Data::Null, span: self.span }).shifted(by);
                }
            }
            Data::Map(fields) => {
                for (key, value) in fields {
                    key.span.start += by;
                    *value = std::mem::replace(value, Self { data: Data::Null, span: self.span }).shifted(by);
                }
            }
            _ => {}
        }
        self
    }

    /// The same tree, all of it standing at one place.
    pub fn standing_at(&self, span: Span) -> Self {
        let data = match &self.data {
            Data::List(items) => Data::List(items.iter().map(|item| item.standing_at(span)).collect()),
            Data::Map(fields) => {
                let field =
                    |(key, value): &(Key, Self)| (Key { text: key.text.clone(), span }, value.standing_at(span));
                Data::Map(fields.iter().map(field).collect())
            }
            scalar => scalar.clone(),
        };
        Self { data, span }
    }

    /// The number of its nodes, itself among them, and its depth.
    pub fn size(&self) -> (usize, usize) {
        let children: Vec<&Self> = match &self.data {
            Data::List(items) => items.iter().collect(),
            Data::Map(fields) => fields.iter().map(|(_, value)| value).collect(),
            _ => Vec::new(),
        };
        children.into_iter().fold((1, 1), |(nodes, depth), child| {
            let (more, below) = child.size();
            (nodes + more, depth.max(below + 1))
        })
    }

    /// The bytes of its texts and keys.
    pub fn bytes(&self) -> usize {
        match &self.data {
            Data::Text(text) => text.len(),
            Data::List(items) => items.iter().map(Self::bytes).sum(),
            Data::Map(fields) => fields.iter().map(|(key, value)| key.text.len() + value.bytes()).sum(),
            Data::Null | Data::Bool(_) | Data::Number(_) => 0,
        }
    }

    /// The deepest node that a JSON pointer reaches, and the span of its key if it is a map's field.
    pub fn locate(&self, pointer: &str) -> (Span, Option<Span>) {
        let mut at = (self.span, None);
        let mut node = self;
        for part in pointer.split('/').skip(1) {
            let part = part.replace("~1", "/").replace("~0", "~");
            let next = match &node.data {
                Data::Map(fields) => {
                    fields.iter().find(|(k, _)| k.text == part).map(|(k, v)| ((v.span, Some(k.span)), v))
                }
                Data::List(items) => part.parse::<usize>().ok().and_then(|i| items.get(i)).map(|v| ((v.span, None), v)),
                _ => None,
            };
            let Some((span, child)) = next else { break };
            at = span;
            node = child;
        }
        at
    }
}

/// Parses `text`; every span names `source`.
///
/// # Errors
/// The first syntax error: a broken file cannot be read any further.
pub fn parse(text: &str, source: usize) -> Result<Yaml, Box<Problem>> {
    let options = serde_saphyr::options! {
        strict_booleans: true,
        with_snippet: false,
        budget: serde_saphyr::budget! { max_depth: 48, max_nodes: 200_000, max_aliases: 1_000, max_documents: 1 },
    };
    let parsed: Result<Raw, _> = serde_saphyr::from_str_with_options(text, options);
    match parsed {
        Ok(raw) => Ok(raw.into_yaml(text, source)),
        Err(error) => {
            let span = error.location().map_or(Span { source, start: 0, len: 0 }, |at| span(at, text, source));
            let message = error.without_snippet().to_string();
            let message = message.split(" at line ").next().unwrap_or_default();
            let message = message.strip_prefix("error: ").unwrap_or(message);
            // The parser's advice is for its callers.
            let (message, hint) = match message.strip_prefix("duplicate mapping key: ") {
                Some(rest) => {
                    let key = rest.split(", set ").next().unwrap_or(rest);
                    (format!("the key `{key}` occurs twice in one map"), "keep one of the two")
                }
                None => refused(message),
            };
            Err(Box::new(Problem::at(span, message).hint(hint)))
        }
    }
}

/// Translates errors of the parser into messages with a remedy.
fn refused(message: &str) -> (String, &'static str) {
    let known = [
        (
            "budget breached: Documents",
            "the file holds more than one document",
            "keep one pipeline per file: remove the document after `---`",
        ),
        (
            "budget breached: Depth",
            "the file is nested too deeply",
            "check the brackets; a pipeline needs only a few levels",
        ),
        (
            "budget breached",
            "the file is too large after its aliases are expanded",
            "remove aliases (`*name`) of values that contain aliases",
        ),
        ("recursion limit", "the file is nested too deeply", "check the brackets; a pipeline needs only a few levels"),
        ("tabs disallowed", "tab in indentation", "indent with spaces; YAML does not allow tabs"),
        ("non-finite float", "a number must be finite", "write a finite number"),
        ("expected string scalar", "the key of a map must be a text", "write `name: value`"),
        ("unclosed quote", "a quote is not closed", "close the quote on this line"),
        ("unknown anchor", "unknown alias", "mark the value to repeat with `&name`"),
    ];
    match known.iter().find(|(part, ..)| message.contains(part)) {
        Some((_, what, hint)) => ((*what).to_owned(), hint),
        None => (
            format!("invalid YAML: {message}"),
            "check the indentation, quotes and brackets on this line and the one above",
        ),
    }
}

fn span(at: Location, text: &str, source: usize) -> Span {
    let known = at.span();
    let (start, len) = match (known.byte_offset(), known.byte_len()) {
        (Some(start), Some(len)) => (start as usize, len as usize),
        _ => {
            // Character offsets only: find the bytes.
            let start = text.char_indices().nth(known.offset() as usize).map_or(text.len(), |(i, _)| i);
            (start, text[start..].chars().take(known.len() as usize).map(char::len_utf8).sum())
        }
    };
    let start = start.min(text.len());
    // A span ends with its line: a block's first line says enough.
    let line = text[start..].find('\n').unwrap_or(text.len() - start);
    Span { source, start, len: len.min(line).max(1) }
}

struct Raw(Spanned<RawData>);

enum RawData {
    Null,
    Bool(bool),
    Number(Number),
    Text(String),
    List(Vec<Raw>),
    Map(Vec<(Spanned<String>, Raw)>),
}

impl Raw {
    fn into_yaml(self, text: &str, source: usize) -> Yaml {
        let at = span(self.0.referenced, text, source);
        let data = match self.0.value {
            RawData::Null => Data::Null,
            RawData::Bool(b) => Data::Bool(b),
            RawData::Number(n) => Data::Number(n),
            RawData::Text(s) => Data::Text(s),
            RawData::List(items) => Data::List(items.into_iter().map(|v| v.into_yaml(text, source)).collect()),
            RawData::Map(fields) => Data::Map(
                fields
                    .into_iter()
                    .map(|(k, v)| {
                        let key_span = span(k.referenced, text, source);
                        (Key { text: k.value, span: key_span }, v.into_yaml(text, source))
                    })
                    .collect(),
            ),
        };
        Yaml { data, span: at }
    }
}

impl<'de> Deserialize<'de> for Raw {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Spanned::<RawData>::deserialize(deserializer).map(Self)
    }
}

impl<'de> Deserialize<'de> for RawData {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(RawVisitor)
    }
}

struct RawVisitor;

impl<'de> Visitor<'de> for RawVisitor {
    type Value = RawData;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a YAML value")
    }

    fn visit_unit<E>(self) -> Result<RawData, E> {
        Ok(RawData::Null)
    }

    fn visit_none<E>(self) -> Result<RawData, E> {
        Ok(RawData::Null)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<RawData, D::Error> {
        RawData::deserialize(deserializer)
    }

    fn visit_bool<E>(self, value: bool) -> Result<RawData, E> {
        Ok(RawData::Bool(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<RawData, E> {
        Ok(RawData::Number(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<RawData, E> {
        Ok(RawData::Number(value.into()))
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<RawData, E> {
        Number::from_f64(value).map(RawData::Number).ok_or_else(|| E::custom("a number must be finite"))
    }

    fn visit_str<E>(self, value: &str) -> Result<RawData, E> {
        Ok(RawData::Text(value.to_owned()))
    }

    fn visit_string<E>(self, value: String) -> Result<RawData, E> {
        Ok(RawData::Text(value))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<RawData, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = seq.next_element()? {
            items.push(item);
        }
        Ok(RawData::List(items))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<RawData, A::Error> {
        let mut fields: Vec<(Spanned<String>, Raw)> = Vec::new();
        let mut known = HashSet::new();
        while let Some((key, value)) = map.next_entry::<Spanned<String>, Raw>()? {
            if !known.insert(key.value.clone()) {
                return Err(A::Error::custom(format!("the key `{}` occurs twice in one map", key.value)));
            }
            fields.push((key, value));
        }
        Ok(RawData::Map(fields))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_positions() {
        let text = "a: 1\nb: {c: [x, 2.5, true, no, null]}\nd: \"7\"\n";
        let yaml = parse(text, 3).expect("valid");
        assert_eq!(yaml.to_json(), serde_json::json!({"a": 1, "b": {"c": ["x", 2.5, true, "no", null]}, "d": "7"}));
        let (span, key) = yaml.locate("/b/c/1");
        assert_eq!((&text[span.start..span.start + span.len], span.source, key), ("2.5", 3, None));
        let (span, key) = yaml.locate("/d/nothing/below");
        assert_eq!(&text[span.start..span.start + span.len], "\"7\"");
        assert_eq!(key.map(|k| &text[k.start..k.start + k.len]), Some("d"));
    }

    #[test]
    fn broken_text_is_one_problem_with_a_place() {
        for text in ["a: [1, 2\nb: 3\n", "a: 1\na: 2\n", "a: .nan\n", "- a\n b: c\n"] {
            let problem = parse(text, 0).expect_err(text);
            assert!(problem.span.is_some(), "{text}: {problem:?}");
        }
        let bomb = "a: &a [x, x]\nb: &b [*a, *a, *a, *a, *a, *a, *a, *a, *a]\nc: &c [*b, *b, *b, *b, *b, *b, *b, *b]\n\
                    d: &d [*c, *c, *c, *c, *c, *c, *c, *c]\ne: &e [*d, *d, *d, *d, *d, *d, *d, *d]\n\
                    f: &f [*e, *e, *e, *e, *e, *e, *e, *e]\ng: &g [*f, *f, *f, *f, *f, *f, *f, *f]\n\
                    h: [*g, *g, *g, *g, *g, *g, *g, *g]\n";
        assert!(parse(bomb, 0).is_err());
    }
}
