//! The JSON Schema of pipeline files, for editors: completion and hover docs.

use crate::kinds::Registry;
use serde_json::{Map, Value, json};
use tauflow_contract::KindSpec;

/// The pattern of names.
const NAME: &str = "^[A-Za-z_][A-Za-z0-9_-]*$";
/// The pattern of a reference to a named value.
const USE: &str = "^\\$[A-Za-z_][A-Za-z0-9_-]*$";

/// The schema of the whole format, with the ports and params of every kind.
pub fn schema(registry: &Registry) -> Value {
    let mut definitions = Map::new();
    let mut branches = Vec::new();
    for kind in registry.iter() {
        let spec = kind.spec();
        let mut params = kind.params_schema();
        lift(&mut params, spec.name, &mut definitions);
        open(&mut params);
        definitions.insert(params_name(spec.name), params);
        branches.push(json!({
            "if": { "properties": { "kind": { "const": spec.name } }, "required": ["kind"] },
            "then": { "properties": {
                "kind": { "description": spec.summary },
                "params": or_named(json!({ "$ref": format!("#/$defs/{}", params_name(spec.name)) })),
                "inputs": or_named(inputs(&spec, kind.port_params())),
            } },
        }));
    }
    let kinds: Vec<Value> =
        registry.iter().map(|k| k.spec()).map(|s| json!({ "const": s.name, "description": s.summary })).collect();
    definitions.insert(
        "reference".into(),
        json!({
            "description": "`node`, `node.port`, or `node[axis=value, ...].port`; a list is merged.",
            "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }],
        }),
    );
    definitions.insert("named_value".into(), json!({ "type": "string", "pattern": USE }));
    definitions.insert(
        "node".into(),
        json!({
            "type": "object",
            "required": ["kind"],
            "additionalProperties": false,
            "properties": {
                "kind": { "description": "Kind of the node; see `tauflow kinds`.", "oneOf": kinds },
                "inputs": or_named(json!({ "description": "Source of each input port.", "type": "object" })),
                "params": or_named(json!({
                    "description": "Params of the kind; omitted params have their defaults.",
                    "type": "object",
                })),
                "transient": or_named(json!({
                    "description": "Pass the outputs on in memory without storing them: for large results that are \
                    fast to compute. Later runs that need them rebuild them.",
                    "type": "boolean",
                })),
                "resources": or_named(json!({
                    "description": "Resources that each action asks a scheduler for, instead of those of the kind; \
                    null leaves one to the scheduler. They change no result.",
                    "type": "object",
                    "additionalProperties": false,
                    "properties": {
                        "cores": or_named(json!({
                            "description": "Processor cores.", "type": ["integer", "null"], "minimum": 1,
                        })),
                        "memory": or_named(json!({
                            "description": "Memory with a unit, such as 8GiB.", "type": ["string", "null"],
                        })),
                        "time": or_named(json!({
                            "description": "The longest time that an action may take, such as 90s, 10m or 2h.",
                            "type": ["string", "null"],
                        })),
                        "gpu": or_named(json!({
                            "description": "GPUs.", "type": ["integer", "null"], "minimum": 0,
                        })),
                    },
                })),
                "matrix": or_named(json!({
                    "description": "Axes; the node has one cell per combination. An axis with the name of a param \
                    sets it.",
                    "type": "object",
                    "properties": {
                        "like": { "description": "A node whose axes are copied, before the axes given \
                        here.", "type": "string" },
                    },
                    "additionalProperties": or_named(json!({ "type": "array", "minItems": 1 })),
                })),
            },
            "allOf": branches,
        }),
    );
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "tauflow pipeline",
        "type": "object",
        "additionalProperties": false,
        "anyOf": [{ "required": ["nodes"] }, { "required": ["include"] }],
        "properties": {
            "pipeline": { "description": "Name; results go to OUT/<name>/.", "type": "string", "pattern": NAME },
            "seed": or_named(json!({
                "description": "Seed of everything random; 0 if left out.",
                "type": "integer",
                "minimum": 0,
            })),
            "include": {
                "description": "Pipeline files whose nodes this one continues, relative to this file.",
                "type": "array",
                "items": { "type": "string" },
            },
            "targets": {
                "description": "Nodes, or `node.port`, that a run brings up to date; if left out, all that nobody \
                                reads.",
                "type": "array",
                "items": { "type": "string" },
            },
            "values": {
                "description": "Named values: `last_rung: 256`, written `$last_rung` where it is meant.",
                "type": "object",
                "propertyNames": { "pattern": NAME },
            },
            "profiles": {
                "description": "Sets of overrides, chosen by `--profile`.",
                "type": "object",
                "additionalProperties": {
                    "description": "`node.param: value`, or `values.name: value`.",
                    "type": "object",
                },
            },
            "nodes": {
                "description": "The nodes, by name.",
                "type": "object",
                "propertyNames": { "pattern": NAME },
                "additionalProperties": { "$ref": "#/$defs/node" },
            },
        },
        "$defs": definitions,
    })
}

/// A schema, or the name of a value in its place. Its description stays in sight.
fn or_named(mut schema: Value) -> Value {
    let mut outer = Map::new();
    if let Some(fields) = schema.as_object_mut() {
        for note in ["description", "default"] {
            outer.extend(fields.remove(note).map(|text| (note.to_owned(), text)));
        }
    }
    outer.insert("if".into(), json!({ "$ref": "#/$defs/named_value" }));
    outer.insert("else".into(), schema);
    Value::Object(outer)
}

/// Lets the name of a value stand for every part of a value.
fn open(schema: &mut Value) {
    let Some(fields) = schema.as_object_mut() else { return };
    // If a named value stands for the discriminating field, several branches may match.
    if let Some(branches) = fields.remove("oneOf") {
        fields.insert("anyOf".into(), branches);
    }
    let wrap = |part: &mut Value| {
        if part.is_object() {
            open(part);
            *part = or_named(part.take());
        }
    };
    for keyword in ["items", "additionalProperties"] {
        fields.get_mut(keyword).into_iter().for_each(wrap);
    }
    fields.get_mut("prefixItems").and_then(Value::as_array_mut).into_iter().flatten().for_each(wrap);
    let properties = fields.get_mut("properties").and_then(Value::as_object_mut);
    properties.into_iter().flat_map(|fields| fields.values_mut()).for_each(wrap);
    for keyword in ["anyOf", "allOf"] {
        fields.get_mut(keyword).and_then(Value::as_array_mut).into_iter().flatten().for_each(open);
    }
}

fn params_name(kind: &str) -> String {
    format!("params_{kind}")
}

fn inputs(spec: &KindSpec, port_params: &[&str]) -> Value {
    // The params of such a node declare its ports.
    if spec.inputs.is_empty() && !port_params.is_empty() {
        return json!({ "type": "object", "additionalProperties": { "$ref": "#/$defs/reference" } });
    }
    let properties: Map<String, Value> = spec
        .inputs
        .iter()
        .map(|port| {
            let doc = format!("{} ({})", port.doc, port.media);
            (port.name.to_owned(), json!({ "description": doc, "$ref": "#/$defs/reference" }))
        })
        .collect();
    let required: Vec<&str> = spec.inputs.iter().filter(|p| !p.optional).map(|p| p.name).collect();
    json!({ "type": "object", "additionalProperties": false, "properties": properties, "required": required })
}

/// Moves a schema's own definitions up, under names of their own.
fn lift(schema: &mut Value, kind: &str, definitions: &mut Map<String, Value>) {
    let own = schema.as_object_mut().and_then(|object| {
        object.remove("$schema");
        object.remove("$defs")
    });
    rename(schema, kind);
    if let Some(Value::Object(own)) = own {
        for (name, mut definition) in own {
            rename(&mut definition, kind);
            open(&mut definition);
            definitions.insert(format!("{kind}_{name}"), definition);
        }
    }
}

fn rename(value: &mut Value, kind: &str) {
    match value {
        Value::Object(fields) => {
            for (name, field) in fields {
                match field {
                    Value::String(text) if name == "$ref" => {
                        *text = text.replace("#/$defs/", &format!("#/$defs/{kind}_"));
                    }
                    field => rename(field, kind),
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| rename(item, kind)),
        _ => {}
    }
}
