//! Checks a value against the JSON Schema of a kind's params, and reports all problems.
//!
//! Understands what `schemars` writes: types, properties, enums, ranges, `$ref`, `anyOf`/`oneOf`/`allOf`. Formats and
//! patterns are left to the kind itself.

use crate::diagnostics::{Hint, did_you_mean};
use serde_json::Value;
use std::sync::Arc;

/// One mismatch.
#[derive(Clone, Debug, PartialEq)]
pub struct Mismatch {
    /// JSON pointer to the value, or to the field whose name is wrong.
    pub pointer: String,
    /// True if the field's name is meant, not its value.
    pub key: bool,
    /// The problem.
    pub message: String,
    /// The remedy.
    pub hint: Hint,
}

/// Every mismatch of `value` with `root`, a schema with its definitions.
pub fn check(root: &Value, value: &Value) -> Vec<Mismatch> {
    let mut found = Vec::new();
    Checker { root, found: &mut found }.value(root, value, "");
    found
}

/// A schema with its reference followed.
fn follow<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    let mut schema = schema;
    // References of generated schemas are not circular without a step down; the limit is for hand-made ones.
    for _ in 0..16 {
        let Some(target) = schema.get("$ref").and_then(Value::as_str) else { break };
        let Some(found) = target.strip_prefix('#').and_then(|p| root.pointer(p)) else { break };
        schema = found;
    }
    schema
}

/// The schema of a top-level param, if the kind has it.
pub fn param<'a>(root: &'a Value, name: &str) -> Option<&'a Value> {
    follow(root, root).get("properties")?.get(name).map(|schema| follow(root, schema))
}

/// The names of the top-level params.
pub fn params(root: &Value) -> Vec<&str> {
    let properties = follow(root, root).get("properties").and_then(Value::as_object);
    properties.map(|p| p.keys().map(String::as_str).collect()).unwrap_or_default()
}

/// A schema in words: `a whole number`, ``one of `a`, `b` ``.
pub fn describe(root: &Value, schema: &Value) -> String {
    let schema = follow(root, schema);
    let values = choices(root, schema);
    if !values.is_empty() {
        let list: Vec<String> = values.iter().map(|v| show(v)).collect();
        return if list.len() == 1 { list[0].clone() } else { format!("one of {}", list.join(", ")) };
    }
    if let Some(branches) = branches(schema) {
        return branches.iter().map(|b| describe(root, b)).collect::<Vec<_>>().join(", or ");
    }
    let types = types(schema);
    let mut words: Vec<String> = types.iter().map(|t| type_words(t).to_owned()).collect();
    if types == ["object"]
        && let Some(required) = schema.get("required").and_then(Value::as_array)
    {
        let names: Vec<String> = required.iter().filter_map(Value::as_str).map(|n| format!("`{n}`")).collect();
        words = vec![format!("a map with {}", names.join(" and "))];
    }
    if types == ["array"]
        && let Some(items) = schema.get("items").filter(|i| i.is_object())
    {
        words = vec![format!("a list, each item {}", describe(root, items))];
    }
    let range = range_words(schema);
    if words.is_empty() { "any value".into() } else { format!("{}{range}", words.join(" or ")) }
}

fn range_words(schema: &Value) -> String {
    let bound = |name: &str| schema.get(name).and_then(Value::as_f64);
    match (bound("minimum"), bound("maximum"), bound("exclusiveMinimum"), bound("exclusiveMaximum")) {
        (Some(low), Some(high), ..) => format!(" from {low} to {high}"),
        (Some(low), _, _, Some(high)) => format!(" from {low}, below {high}"),
        (_, Some(high), Some(low), _) => format!(" above {low}, up to {high}"),
        (.., Some(low), Some(high)) => format!(" above {low} and below {high}"),
        (Some(low), ..) => format!(" from {low}"),
        (_, Some(high), ..) => format!(" up to {high}"),
        (_, _, Some(low), _) => format!(" above {low}"),
        (.., Some(high)) => format!(" below {high}"),
        _ => String::new(),
    }
}

fn types(schema: &Value) -> Vec<&str> {
    match schema.get("type") {
        Some(Value::String(one)) => vec![one],
        Some(Value::Array(many)) => many.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    }
}

fn type_words(name: &str) -> &str {
    match name {
        "integer" => "a whole number",
        "number" => "a number",
        "string" => "a text",
        "boolean" => "true or false",
        "array" => "a list",
        "object" => "a map",
        "null" => "null",
        other => other,
    }
}

fn value_words(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a boolean",
        Value::Number(n) if n.as_f64().is_some_and(|v| v.abs() >= 9.0e15) => "a number too large for that",
        Value::Number(n) if n.is_f64() => "a number with a fraction",
        Value::Number(_) => "a whole number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "a map",
    }
}

fn has_type(value: &Value, name: &str) -> bool {
    match name {
        "integer" => value.is_i64() || value.is_u64(),
        "number" => value.is_number(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        "null" => value.is_null(),
        _ => true,
    }
}

fn branches(schema: &Value) -> Option<&Vec<Value>> {
    schema.get("anyOf").or_else(|| schema.get("oneOf")).and_then(Value::as_array)
}

/// The constants that a schema allows, if constants are all that it allows.
fn choices<'a>(root: &'a Value, schema: &'a Value) -> Vec<&'a Value> {
    let schema = follow(root, schema);
    if let Some(values) = schema.get("enum").and_then(Value::as_array) {
        return values.iter().collect();
    }
    if let Some(value) = schema.get("const") {
        return vec![value];
    }
    let Some(branches) = branches(schema) else {
        return Vec::new();
    };
    let mut all = Vec::new();
    for branch in branches {
        let values = choices(root, branch);
        if values.is_empty() {
            return Vec::new();
        }
        all.extend(values);
    }
    all
}

fn show(value: &Value) -> String {
    match value {
        Value::String(text) => format!("`{text}`"),
        other => format!("`{other}`"),
    }
}

struct Checker<'a> {
    root: &'a Value,
    found: &'a mut Vec<Mismatch>,
}

impl Checker<'_> {
    fn add(&mut self, pointer: &str, key: bool, message: String, hint: impl Into<Hint>) {
        self.found.push(Mismatch { pointer: pointer.to_owned(), key, message, hint: hint.into() });
    }

    fn value(&mut self, schema: &Value, value: &Value, at: &str) {
        let root = self.root;
        let schema = follow(root, schema);
        let types = types(schema);
        if !types.is_empty() && !types.iter().any(|t| has_type(value, t)) {
            let message = format!("expected {}, found {}", describe(root, schema), value_words(value));
            self.add(at, false, message, advice(schema, value));
            return;
        }
        let allowed = choices(root, schema);
        if !allowed.is_empty() {
            if !allowed.contains(&value) {
                let names: Vec<&str> = allowed.iter().filter_map(|v| v.as_str()).collect();
                let hint = match value.as_str() {
                    Some(text) if names.len() == allowed.len() => did_you_mean(text, "choices", names),
                    _ => format!("choices: {}", allowed.iter().map(|v| show(v)).collect::<Vec<_>>().join(", ")),
                };
                self.add(at, false, format!("{} is not one of the choices", show(value)), hint);
            }
            return;
        }
        for part in schema.get("allOf").and_then(Value::as_array).into_iter().flatten() {
            self.value(part, value, at);
        }
        if let Some(branches) = branches(schema) {
            self.any_of(schema, branches, value, at);
        }
        match value {
            Value::Number(number) => self.range(schema, number.as_f64().unwrap_or(0.0), value, at),
            Value::Array(items) => self.list(schema, items, at),
            Value::Object(fields) => self.map(schema, fields, at),
            Value::String(text) => {
                let length = text.chars().count() as u64;
                if schema.get("minLength").and_then(Value::as_u64).is_some_and(|low| length < low) {
                    self.add(at, false, "the text is empty".into(), "write at least one character");
                }
            }
            _ => {}
        }
    }

    fn any_of(&mut self, schema: &Value, branches: &[Value], value: &Value, at: &str) {
        let mut tries: Vec<(&Value, Vec<Mismatch>)> = Vec::new();
        for branch in branches {
            let mut found = Vec::new();
            Checker { root: self.root, found: &mut found }.value(branch, value, at);
            if found.is_empty() {
                return;
            }
            tries.push((branch, found));
        }
        // The branch that was meant: the right type, and for maps one of its own keys.
        let meant = |branch: &Value| {
            let branch = follow(self.root, branch);
            let typed = types(branch).iter().any(|t| has_type(value, t));
            let keyed = value.as_object().is_none_or(|fields| {
                branch.get("properties").is_some_and(|p| fields.keys().any(|name| p.get(name).is_some()))
            });
            typed && keyed
        };
        let mut candidates = tries.iter().filter(|(branch, _)| meant(branch));
        if let (Some((_, found)), None) = (candidates.next(), candidates.next()) {
            self.found.extend(found.iter().cloned());
            return;
        }
        let message = format!("{} is not allowed here", value_words(value));
        let expected = format!("expected {}", describe(self.root, schema));
        self.add(at, false, message, expected);
    }

    fn range(&mut self, schema: &Value, number: f64, value: &Value, at: &str) {
        let bound = |name: &str| schema.get(name).and_then(Value::as_f64);
        let out = bound("minimum").is_some_and(|low| number < low)
            || bound("maximum").is_some_and(|high| number > high)
            || bound("exclusiveMinimum").is_some_and(|low| number <= low)
            || bound("exclusiveMaximum").is_some_and(|high| number >= high);
        if out {
            let message = format!("{value} is out of range");
            self.add(at, false, message, format!("give a number{}", range_words(schema)));
        }
    }

    fn list(&mut self, schema: &Value, items: &[Value], at: &str) {
        let count = |name: &str| schema.get(name).and_then(Value::as_u64);
        let length = items.len() as u64;
        let (low, high) = (count("minItems"), count("maxItems"));
        if low.is_some_and(|low| length < low) || high.is_some_and(|high| length > high) {
            let wanted = match (low, high) {
                (Some(low), Some(high)) if low == high => format!("exactly {low}"),
                (Some(low), Some(high)) => format!("{low} to {high}"),
                (Some(low), None) => format!("at least {low}"),
                (_, high) => format!("at most {}", high.unwrap_or_default()),
            };
            self.add(at, false, format!("a list of {length} items"), format!("give {wanted}"));
        }
        let prefix = schema.get("prefixItems").and_then(Value::as_array);
        for (i, item) in items.iter().enumerate() {
            let of_place = prefix.and_then(|p| p.get(i)).or_else(|| schema.get("items").filter(|s| s.is_object()));
            if let Some(of_place) = of_place {
                self.value(of_place, item, &format!("{at}/{i}"));
            }
        }
    }

    fn map(&mut self, schema: &Value, fields: &serde_json::Map<String, Value>, at: &str) {
        let properties = schema.get("properties").and_then(Value::as_object);
        let additional = schema.get("additionalProperties");
        let mut known: Option<Arc<[String]>> = None;
        for (name, field) in fields {
            let pointer = format!("{at}/{}", name.replace('~', "~0").replace('/', "~1"));
            if let Some(known) = properties.and_then(|p| p.get(name)) {
                self.value(known, field, &pointer);
            } else if additional == Some(&Value::Bool(false)) {
                let names =
                    known.get_or_insert_with(|| properties.into_iter().flat_map(|p| p.keys().cloned()).collect());
                let (one, what) = if at.is_empty() { ("param", "params") } else { ("key", "keys") };
                self.add(&pointer, true, format!("unknown {one} `{name}`"), Hint::near(name, what, names));
            } else if let Some(rest) = additional.filter(|a| a.is_object()) {
                self.value(rest, field, &pointer);
            }
        }
        for name in schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str) {
            if !fields.contains_key(name) {
                let one = if at.is_empty() { "param" } else { "key" };
                let wanted = properties.and_then(|p| p.get(name)).map(|s| describe(self.root, s));
                let hint = format!("add `{name}: ...`, {}", wanted.unwrap_or_else(|| "any value".into()));
                self.add(at, false, format!("missing {one} `{name}`"), hint);
            }
        }
    }
}

fn advice(schema: &Value, value: &Value) -> String {
    let wants = |name: &str| types(schema).contains(&name);
    match value {
        Value::String(text) if wants("integer") || wants("number") => match text.parse::<f64>() {
            Ok(_) => "remove the quotes".into(),
            Err(_) => "write a number".into(),
        },
        Value::String(text) if wants("boolean") && ["yes", "no", "on", "off"].contains(&text.as_str()) => {
            "write `true` or `false`; `yes` and `no` are texts in YAML 1.2".into()
        }
        _ if wants("array") && !value.is_array() => format!("write a list: `[{}]`", plain(value)),
        Value::Number(n) if n.as_f64().is_some_and(|v| v.abs() >= 9.0e15) => "write a smaller number".into(),
        Value::Number(_) if wants("integer") => "write it without a fraction".into(),
        _ => String::new(),
    }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};
    use serde_json::json;

    #[derive(Serialize, Deserialize, JsonSchema, Default)]
    #[serde(untagged)]
    enum Rungs {
        Dyadic {
            dyadic: u64,
        },
        List(Vec<u64>),
        #[default]
        None,
    }

    #[derive(Serialize, Deserialize, JsonSchema, Default)]
    #[serde(rename_all = "snake_case")]
    enum Preset {
        /// Small.
        #[default]
        Tiny,
        /// Large.
        Base,
    }

    #[derive(Serialize, Deserialize, JsonSchema, Default)]
    #[serde(default, deny_unknown_fields)]
    struct Params {
        #[schemars(range(min = 1, max = 9))]
        steps: u32,
        rungs: Rungs,
        preset: Preset,
        size: [u32; 2],
        name: Option<String>,
        share: f64,
    }

    #[test]
    fn every_mismatch_is_found_and_told() {
        let schema = schemars::schema_for!(Params).to_value();
        let good = json!({"steps": 3, "rungs": [1, 2], "preset": "base", "size": [2, 3], "name": null, "share": 1});
        assert_eq!(check(&schema, &good), []);
        assert_eq!(check(&schema, &json!({"rungs": {"dyadic": 4}, "name": "x"})), []);
        let bad =
            json!({"stepz": 1, "steps": 0, "rungs": {"dyadic": "x"}, "preset": "tinny", "size": [1], "share": "2"});
        let found = check(&schema, &bad);
        let texts: Vec<String> = found
            .iter()
            .map(|m| format!("{}: {} | {}", m.pointer, m.message, m.hint.text().unwrap_or_default()))
            .collect();
        assert_eq!(
            texts,
            [
                "/preset: `tinny` is not one of the choices | did you mean `tiny`?",
                "/rungs/dyadic: expected a whole number from 0, found a text | write a number",
                "/share: expected a number, found a text | remove the quotes",
                "/size: a list of 1 items | give exactly 2",
                "/steps: 0 is out of range | give a number from 1 to 9",
                "/stepz: unknown param `stepz` | did you mean `steps`?",
            ]
        );
    }
}
