//! Explains why an action runs: its key, and the differences to the most similar earlier key.

use super::{event::Ended, ids::LaneId, lanes::Lanes, records::ACTION};
use crate::pipeline::Pipeline;
use serde::Serialize;
use serde_json::Value;
use std::{
    collections::{BTreeSet, HashMap},
    fmt,
};
use tauflow_cache::{Key, Record, Store};
use tauflow_contract::{ActionKey, ItemKey, canonical_bytes};

/// An action that a plan looked at.
#[derive(Clone, Debug)]
pub struct Planned {
    /// Its node.
    pub node: usize,
    /// Its cell.
    pub cell: usize,
    /// Its item.
    pub item: Option<ItemKey>,
    /// Hit, or would run.
    pub ended: Ended,
    /// Its key; none that a run has if `unknown`.
    pub key: Box<ActionKey>,
    /// A program would have to run before its key is known, and looking runs none: it may be done or not.
    pub unknown: bool,
}

pub(super) fn planned(
    pipeline: &Pipeline,
    lanes: &Lanes,
    keys: Vec<(LaneId, Option<ItemKey>, Ended, Box<ActionKey>)>,
) -> Vec<Planned> {
    keys.into_iter()
        .map(|(lane, item, ended, key)| {
            let cell = lanes[lane].cell;
            Planned { node: pipeline.cells[cell].node, cell, item, ended, key, unknown: lanes[lane].unknown }
        })
        .collect()
}

/// One field in which two keys differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// JSON pointer into the key, e.g. `/params/rungs/dyadic`.
    pub field: String,
    /// The value of the earlier key; none if it had none.
    pub before: Option<Value>,
    /// The value now; none if there is none.
    pub now: Option<Value>,
}

/// The earlier key that differs least, and how.
#[derive(Clone, Debug)]
pub struct Nearest {
    /// Its record.
    pub record: Record,
    /// The fields that differ.
    pub differences: Vec<Difference>,
}

/// The actions of a kind that were run before, with their keys read.
#[derive(Default)]
pub struct History {
    keys: Vec<(Record, Value)>,
    /// The latest actions for each key without one of its fields, the latest first: what differs in one field alone is
    /// found at once, however many actions there are.
    but_one: HashMap<Key, [Option<u32>; ALIKE]>,
}

/// Actions that are kept for each key without one of its fields: nodes of one kind may differ in that field.
const ALIKE: usize = 4;
/// Earlier actions that are looked at where more than one field differs.
const LOOKED_AT: usize = 256;
/// Bytes of the longest key that is read; those of actions have a few thousand.
const LONGEST: usize = 1 << 20;
/// Fields of a key, params and inputs one by one, above which it is not sought by all of them but one: that takes their
/// square.
const MOST_FIELDS: usize = 256;
/// Bytes of memory that all keys of a kind may take, about: a hundred thousand of the usual size.
const MOST_MEMORY: usize = 512 << 20;

/// About how many bytes a value takes, and a little more; as JSON it may have a hundredth of them.
fn memory(value: &Value) -> usize {
    let inner = match value {
        Value::Null | Value::Bool(_) | Value::Number(_) => 0,
        Value::String(text) => text.len(),
        Value::Array(values) => values.iter().map(memory).sum(),
        Value::Object(fields) => {
            let entries: usize = fields.iter().map(|(name, value)| name.len() + 24 + memory(value)).sum();
            // A map has room for eleven entries at once.
            entries + 700 * (1 + fields.len() / 6)
        }
    };
    size_of::<Value>() + inner
}

impl History {
    /// Reads what was run of a kind, the latest first, as far as memory for it goes.
    pub fn of(store: &Store, kind: &str) -> Self {
        let read = |key: Key| {
            let record = store.read(ACTION, &key).filter(|record| record.preimage.len() <= LONGEST)?;
            let value: Value = serde_json::from_str(&record.preimage).ok()?;
            // The texts and the blobs are not needed any more, and are most of it.
            let (preimage, payload, recipe) = Default::default();
            Some((Record { preimage, payload, recipe, refs: Vec::new(), trees: Vec::new(), ..record }, value))
        };
        let mut left = MOST_MEMORY;
        let fits = |(_, value): &(Record, Value)| {
            left = left.saturating_sub(memory(value) + size_of::<Record>());
            left > 0
        };
        let mut keys: Vec<(Record, Value)> =
            store.keys_by_label(ACTION, kind).into_iter().rev().filter_map(read).take_while(fits).collect();
        // Oldest first, so that the latest stays.
        keys.reverse();
        let mut found: HashMap<Key, [Option<u32>; ALIKE]> = HashMap::new();
        for (n, (_, key)) in keys.iter().enumerate() {
            for key in but_one(key) {
                let latest = found.entry(key).or_default();
                latest.rotate_right(1);
                latest[0] = u32::try_from(n).ok();
            }
        }
        Self { keys, but_one: found }
    }

    /// The earlier key of the same group that differs least: in the fewest fields, then in the values of these, and the
    /// latest of those that differ equally. Where the nearest differ in several fields, it is sought among the latest.
    pub fn nearest(&self, key: &ActionKey) -> Option<Nearest> {
        let now = serde_json::to_value(key).expect("a key holds only plain values");
        let exact = but_one(&now).into_iter().filter_map(|key| self.but_one.get(&key)).flatten().flatten();
        let exact: BTreeSet<u32> = exact.copied().collect();
        // A key that differs in one field has no nearer; else the latest ones may differ less than any that was found.
        let more = if exact.is_empty() { LOOKED_AT } else { 0 };
        let latest = self.keys.iter().rev().filter(|(_, before)| before["group"] == now["group"]).take(more);
        let candidates = exact.into_iter().map(|n| &self.keys[n as usize]).chain(latest);
        let (_, record, differences) = candidates
            .filter(|(_, before)| before["group"] == now["group"])
            .map(|(record, before)| {
                let mut found = Vec::new();
                differences("", before, &now, &mut found);
                if !is_sighted(&now) {
                    found.retain(|difference| !is_of_sight(&difference.field));
                }
                // A change of the seed says that it is another item: everything else is nearer.
                let far = found.iter().filter(|d| d.field == "/seed").count();
                let apart: usize = found.iter().map(apart).sum();
                ((far * 1000 + found.len(), apart, std::cmp::Reverse(record.when)), record, found)
            })
            .min_by_key(|(order, ..)| *order)?;
        Some(Nearest { record: record.clone(), differences })
    }
}

/// How far two values are apart, as texts: what is left without a common start and end.
fn apart(difference: &Difference) -> usize {
    let text = |value: &Option<Value>| value.as_ref().map(Value::to_string).unwrap_or_default();
    let (before, now) = (text(&difference.before), text(&difference.now));
    let least = before.len().min(now.len());
    let start = before.bytes().zip(now.bytes()).take_while(|(a, b)| a == b).count();
    let end = before.bytes().rev().zip(now.bytes().rev()).take(least - start).take_while(|(a, b)| a == b).count();
    before.len().max(now.len()) - start - end
}

/// Whether a key says what its program looked at. Before the program has run, nothing is known of that, and an earlier
/// key that says so does not differ by it.
fn is_sighted(key: &Value) -> bool {
    ["files", "traced"].iter().any(|field| key["environment"].get(field).is_some())
}

fn is_of_sight(field: &str) -> bool {
    field == "/environment/traced" || field == "/environment/files" || field.starts_with("/environment/files/")
}

/// Hashes of a key without one of its fields, for each field; params and inputs count one by one.
fn but_one(key: &Value) -> Vec<Key> {
    let Value::Object(fields) = key else { return Vec::new() };
    let mut leaves: Vec<(String, Vec<u8>)> = Vec::new();
    for (name, value) in fields {
        match value {
            Value::Object(inner) => {
                leaves.extend(inner.iter().map(|(leaf, value)| (format!("{name}/{leaf}"), canonical_bytes(value))));
            }
            value => leaves.push((name.clone(), canonical_bytes(value))),
        }
    }
    if leaves.len() > MOST_FIELDS {
        return Vec::new();
    }
    let without = |left: usize| {
        let mut bytes = leaves[left].0.clone().into_bytes();
        for (name, value) in leaves.iter().enumerate().filter(|(n, _)| *n != left).map(|(_, leaf)| leaf) {
            bytes.extend(name.as_bytes());
            bytes.push(0);
            bytes.extend((value.len() as u64).to_le_bytes());
            bytes.extend(value);
        }
        Key::of(&bytes)
    };
    (0..leaves.len()).map(without).collect()
}

/// Why an action runs, or may.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// These parts of its key changed since the nearest earlier one.
    Changed(Vec<String>),
    /// Its outputs are no longer there.
    Lost,
    /// Its kind never ran.
    Never,
    /// A program has to tell its version first, and looking runs none.
    Undecided,
}

impl Reason {
    /// The record of the earlier key that differs least, if there is one.
    pub fn of(nearest: Option<&Nearest>) -> Self {
        let Some(nearest) = nearest else { return Self::Never };
        if nearest.differences.is_empty() {
            return Self::Lost;
        }
        let part = |difference: &Difference| match difference.field.split('/').nth(1) {
            Some("params") => format!("param {}", difference.field.trim_start_matches("/params/").replace('/', ".")),
            Some("inputs") => format!("input {}", difference.field.trim_start_matches("/inputs/")),
            Some("seed") => "item or seed".into(),
            Some("environment") => of_environment(&difference.field),
            Some("version") => "version of the output group".into(),
            _ => difference.field.trim_start_matches('/').into(),
        };
        let parts: BTreeSet<String> = nearest.differences.iter().map(part).collect();
        Self::Changed(parts.into_iter().collect())
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Changed(parts) => write!(f, "changed: {}", parts.join(", ")),
            Self::Lost => f.write_str("its outputs are no longer in the store"),
            Self::Never => f.write_str("has never run"),
            Self::Undecided => f.write_str("unknown: the version of a program is needed, and only a run asks for it"),
        }
    }
}

/// The meaning of a field of the environment, in words.
fn of_environment(field: &str) -> String {
    let below = |place: &str| field.strip_prefix("/environment/")?.strip_prefix(place)?.strip_prefix('/');
    if let Some(file) = ["files", "program", "depends"].iter().find_map(|place| below(place)) {
        return format!("file {file}");
    }
    if let Some(variable) = below("variables") {
        return format!("environment variable {variable}");
    }
    if let Some(library) = below("oidn") {
        return format!("file {library} of Open Image Denoise");
    }
    match field.split('/').nth(2) {
        Some("version") => "the version of the program".into(),
        Some("oidn") => "the library of Open Image Denoise".into(),
        Some("machine") => "the machine".into(),
        _ => "the machine, or a library of it".into(),
    }
}

/// Where two values differ, as pointers below `at`.
pub(super) fn differences(at: &str, before: &Value, now: &Value, found: &mut Vec<Difference>) {
    // Digests are {hash, size} pairs, and mean something only as a whole.
    let whole = at.starts_with("/inputs/");
    match (before, now) {
        (Value::Object(a), Value::Object(b)) if !whole => {
            let names: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for name in names {
                let at = format!("{at}/{name}");
                match (a.get(name), b.get(name)) {
                    (Some(a), Some(b)) => differences(&at, a, b, found),
                    (before, now) => found.push(Difference { field: at, before: before.cloned(), now: now.cloned() }),
                }
            }
        }
        _ if before == now => {}
        _ => found.push(Difference { field: at.to_owned(), before: Some(before.clone()), now: Some(now.clone()) }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn values_are_as_far_apart_as_what_they_do_not_share() {
        let of = |before: Value, now: Value| {
            apart(&Difference { field: "/params/rungs".into(), before: Some(before), now: Some(now) })
        };
        // The ladder of another node, and that of this one before it became longer.
        let [other, own] = [json!([1, 2, 3, 4]), json!([1, 2, 4, 8, 16])];
        let now = json!([1, 2, 4, 8, 16, 32]);
        assert!(of(own.clone(), now.clone()) < of(other, now.clone()) && of(now.clone(), now) == 0);
        assert_eq!((of(json!(11), json!(111)), of(json!(0.5), json!(0.7))), (1, 1));
    }

    #[test]
    fn differences_name_the_fields() {
        let mut found = Vec::new();
        let before = json!({"params": {"rungs": {"dyadic": 8}, "x": 1}, "inputs": {"a": "1-2"}});
        let now = json!({"params": {"rungs": {"dyadic": 16}}, "inputs": {"a": "3-4"}});
        differences("", &before, &now, &mut found);
        let fields: Vec<&str> = found.iter().map(|d| d.field.as_str()).collect();
        assert_eq!(fields, ["/inputs/a", "/params/rungs/dyadic", "/params/x"]);
        assert_eq!((found[1].before.clone(), found[1].now.clone()), (Some(json!(8)), Some(json!(16))));
        assert_eq!(found[2].now, None);
    }

    #[test]
    fn files_that_only_an_earlier_key_knows_are_no_difference() {
        let before = json!({"environment": {"program": {"a.py": "1"}, "files": {"/b.py": "2"}, "traced": "yes"}});
        let now = json!({"environment": {"program": {"a.py": "3"}}});
        let mut found = Vec::new();
        differences("", &before, &now, &mut found);
        assert!(!is_sighted(&now) && is_sighted(&before));
        found.retain(|difference| !is_of_sight(&difference.field));
        let fields: Vec<&str> = found.iter().map(|d| d.field.as_str()).collect();
        assert_eq!(fields, ["/environment/program/a.py"]);
        for (field, words) in [
            ("/environment/program/a.py", "file a.py"),
            ("/environment/oidn/libtbb", "file libtbb of Open Image Denoise"),
            ("/environment/oidn", "the library of Open Image Denoise"),
            ("/environment/machine/cores", "the machine"),
            ("/environment/version/a", "the version of the program"),
        ] {
            assert_eq!(of_environment(field), words);
        }
    }

    #[test]
    fn keys_of_many_fields_are_not_sought_by_all_of_them_but_one() {
        let of = |count: usize| {
            let params: serde_json::Map<String, Value> = (0..count).map(|n| (n.to_string(), json!(n))).collect();
            but_one(&json!({ "params": params })).len()
        };
        assert_eq!((of(3), of(MOST_FIELDS), of(MOST_FIELDS + 1)), (3, MOST_FIELDS, 0));
        assert!(memory(&json!([{"a": 0}, {"b": 0}])) > 2 * 700, "small maps are not small");
    }
}
