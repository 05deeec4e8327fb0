//! Validates JSON against a JSON Schema: the keywords that pipeline schemas use, each as the 2020-12 drafts define it.
//! An unknown keyword is an error, so that nothing passes because it was not looked at.

use serde_json::Value;

/// Keywords that say something to people or editors only.
const NOTES: [&str; 8] = ["$schema", "$defs", "title", "description", "default", "format", "examples", "deprecated"];

/// What names of pipelines and nodes look like.
const NAME: &str = "^[A-Za-z_][A-Za-z0-9_-]*$";
/// What uses of named values look like.
const USE: &str = "^\\$[A-Za-z_][A-Za-z0-9_-]*$";
/// The pattern of names of strata.
const STRATUM: &str = "^[A-Za-z0-9][A-Za-z0-9_.-]*$";
const METHOD: &str = "^[A-Za-z0-9_+-][A-Za-z0-9_.+-]*$";

/// What is wrong with `value`, a line each, with its place.
pub fn problems(root: &Value, value: &Value) -> Vec<String> {
    let mut found = Vec::new();
    check(root, root, value, "", &mut found);
    found
}

fn fits(root: &Value, schema: &Value, value: &Value) -> bool {
    let mut found = Vec::new();
    check(root, schema, value, "", &mut found);
    found.is_empty()
}

fn is_of(kind: &str, value: &Value) -> bool {
    match kind {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|v| v.fract() == 0.0),
        other => panic!("the schema names a type `{other}`"),
    }
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(std::slice::from_ref(value), Vec::as_slice)
}

fn check(root: &Value, schema: &Value, value: &Value, place: &str, found: &mut Vec<String>) {
    let Some(fields) = schema.as_object() else {
        if *schema != Value::Bool(true) {
            found.push(format!("{place}: nothing may stand here"));
        }
        return;
    };
    let mut fail = |what: String| found.push(format!("{place}: {what}"));
    let number = |limit: &Value| value.as_f64().zip(limit.as_f64());
    let count = |limit: &Value| limit.as_u64().expect("a count") as usize;
    for (keyword, rule) in fields {
        match keyword.as_str() {
            name if NOTES.contains(&name) => {}
            // Handled beside `if`, `properties` and `prefixItems`.
            "then" | "else" | "additionalProperties" | "items" | "prefixItems" | "$ref" | "allOf" | "properties" => {}
            "type" => {
                let kinds = list(rule);
                if !kinds.iter().any(|k| is_of(k.as_str().expect("a type's name"), value)) {
                    fail(format!("expected {rule}, found {value}"));
                }
            }
            "const" if value != rule => fail(format!("expected {rule}, found {value}")),
            "enum" if !list(rule).contains(value) => fail(format!("expected one of {rule}, found {value}")),
            "const" | "enum" => {}
            "anyOf" if !list(rule).iter().any(|s| fits(root, s, value)) => fail(format!("{value} fits no alternative")),
            "oneOf" if list(rule).iter().filter(|s| fits(root, s, value)).count() != 1 => {
                fail(format!("{value} does not fit exactly one alternative"));
            }
            "anyOf" | "oneOf" => {}
            "required" => {
                let missing =
                    |name: &&Value| value.as_object().is_some_and(|o| !o.contains_key(name.as_str().unwrap_or("")));
                list(rule).iter().filter(missing).for_each(|name| fail(format!("{name} is missing")));
            }
            "minimum" if number(rule).is_some_and(|(v, limit)| v < limit) => fail(format!("{value} is below {rule}")),
            "maximum" if number(rule).is_some_and(|(v, limit)| v > limit) => fail(format!("{value} is above {rule}")),
            "exclusiveMinimum" if number(rule).is_some_and(|(v, limit)| v <= limit) => {
                fail(format!("{value} is not above {rule}"));
            }
            "exclusiveMaximum" if number(rule).is_some_and(|(v, limit)| v >= limit) => {
                fail(format!("{value} is not below {rule}"));
            }
            "minimum" | "maximum" | "exclusiveMinimum" | "exclusiveMaximum" => {}
            "minItems" if value.as_array().is_some_and(|a| a.len() < count(rule)) => fail("too few items".into()),
            "maxItems" if value.as_array().is_some_and(|a| a.len() > count(rule)) => fail("too many items".into()),
            "minLength" if value.as_str().is_some_and(|t| t.chars().count() < count(rule)) => fail("too short".into()),
            "maxLength" if value.as_str().is_some_and(|t| t.chars().count() > count(rule)) => fail("too long".into()),
            "minItems" | "maxItems" | "minLength" | "maxLength" => {}
            "uniqueItems" => {
                let repeated = |items: &Vec<Value>| (1..items.len()).any(|i| items[..i].contains(&items[i]));
                if *rule == Value::Bool(true) && value.as_array().is_some_and(repeated) {
                    fail("an item stands twice".into());
                }
            }
            "pattern" => {
                assert!(
                    [NAME, USE, STRATUM, METHOD].iter().any(|known| rule == known),
                    "the validator does not know {rule}"
                );
                let fine = |text: &str| {
                    if *rule == METHOD {
                        return !text.is_empty()
                            && !text.starts_with('.')
                            && text.chars().all(|c| c.is_ascii_alphanumeric() || "_.+-".contains(c));
                    }
                    if *rule == STRATUM {
                        return text.starts_with(|c: char| c.is_ascii_alphanumeric())
                            && text.chars().all(|c| c.is_ascii_alphanumeric() || "_.-".contains(c));
                    }
                    let Some(text) = text.strip_prefix(if *rule == USE { "$" } else { "" }) else { return false };
                    text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
                        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
                };
                if value.as_str().is_some_and(|text| !fine(text)) {
                    fail(format!("{value} does not look like a name"));
                }
            }
            "propertyNames" => {
                for name in value.as_object().into_iter().flat_map(|fields| fields.keys()) {
                    if !fits(root, rule, &Value::String(name.clone())) {
                        fail(format!("{name} does not look like a name"));
                    }
                }
            }
            "if" => {}
            unknown => panic!("the validator does not know the keyword `{unknown}` at {place}"),
        }
    }
    parts(root, schema, value, place, found);
}

/// Rules that apply other rules: to the same value, or to what it holds.
fn parts(root: &Value, schema: &Value, value: &Value, place: &str, found: &mut Vec<String>) {
    if let Some(reference) = schema["$ref"].as_str() {
        let pointer = reference.strip_prefix('#').expect("references stay in the file");
        let target = root.pointer(pointer).unwrap_or_else(|| panic!("{reference} names nothing"));
        check(root, target, value, place, found);
    }
    for rule in schema["allOf"].as_array().into_iter().flatten() {
        check(root, rule, value, place, found);
    }
    if let Some(condition) = schema.get("if") {
        let branch = if fits(root, condition, value) { "then" } else { "else" };
        if let Some(rule) = schema.get(branch) {
            check(root, rule, value, place, found);
        }
    }
    for (name, field) in value.as_object().into_iter().flatten() {
        let at = format!("{place}/{name}");
        match (schema["properties"].get(name), schema.get("additionalProperties")) {
            (Some(rule), _) => check(root, rule, field, &at, found),
            (None, Some(Value::Bool(false))) => found.push(format!("{at}: unknown")),
            (None, Some(rule)) => check(root, rule, field, &at, found),
            (None, None) => {}
        }
    }
    let tuple = schema["prefixItems"].as_array().map_or(&[][..], Vec::as_slice);
    for (index, item) in value.as_array().into_iter().flatten().enumerate() {
        if let Some(rule) = tuple.get(index).or_else(|| schema.get("items")) {
            check(root, rule, item, &format!("{place}/{index}"), found);
        }
    }
}
