//! Why an action runs: its key, and how it differs from the nearest key that was run before.

use super::{event::Ended, lanes::Lane, records::ACTION};
use crate::pipeline::Pipeline;
use serde_json::Value;
use std::collections::BTreeSet;
use tauflow_cache::{Record, Store};
use tauflow_contract::{ActionKey, ItemKey};

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
    /// Its key.
    pub key: Box<ActionKey>,
}

pub(super) fn planned(
    pipeline: &Pipeline,
    lanes: &[Lane],
    keys: Vec<(usize, Option<ItemKey>, Ended, Box<ActionKey>)>,
) -> Vec<Planned> {
    keys.into_iter()
        .map(|(lane, item, ended, key)| {
            let cell = lanes[lane].cell;
            Planned { node: pipeline.cells[cell].node, cell, item, ended, key }
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
}

impl History {
    /// Reads what was run of a kind.
    pub fn of(store: &Store, kind: &str) -> Self {
        let read = |record: Record| serde_json::from_str(&record.preimage).ok().map(|value| (record, value));
        Self { keys: store.by_label(ACTION, kind).into_iter().filter_map(read).collect() }
    }

    /// Mean wall time of an action in seconds, as far as it is known.
    pub fn mean_seconds(&self) -> Option<f64> {
        let total: u64 = self.keys.iter().map(|(record, _)| record.wall_us).sum();
        (!self.keys.is_empty()).then(|| total as f64 / 1e6 / self.keys.len() as f64)
    }

    /// The earlier key of the same group that differs least; the latest of those that differ equally.
    pub fn nearest(&self, key: &ActionKey) -> Option<Nearest> {
        let now = serde_json::to_value(key).expect("a key holds only plain values");
        let of_group = self.keys.iter().filter(|(_, before)| before["group"] == now["group"]);
        let (_, _, record, differences) = of_group
            .map(|(record, before)| {
                let mut found = Vec::new();
                differences("", before, &now, &mut found);
                // A change of the seed says that it is another item: everything else is nearer.
                let far = found.iter().filter(|d| d.field == "/seed").count();
                (far * 1000 + found.len(), std::cmp::Reverse(record.when), record, found)
            })
            .min_by_key(|(count, when, ..)| (*count, *when))?;
        Some(Nearest { record: record.clone(), differences })
    }
}

/// A line for people: which parts of the key changed.
pub fn reason(nearest: Option<&Nearest>) -> String {
    let Some(nearest) = nearest else { return "never run before".into() };
    if nearest.differences.is_empty() {
        return "its outputs are no longer in the store".into();
    }
    let names: BTreeSet<String> = nearest
        .differences
        .iter()
        .map(|d| match d.field.split('/').nth(1) {
            Some("params") => format!("param {}", d.field.trim_start_matches("/params/").replace('/', ".")),
            Some("inputs") => format!("input {}", d.field.trim_start_matches("/inputs/")),
            Some("seed") => "another item or seed".into(),
            Some("version") => "version of the kind".into(),
            _ => d.field.trim_start_matches('/').into(),
        })
        .collect();
    format!("changed: {}", names.into_iter().collect::<Vec<_>>().join(", "))
}

fn differences(at: &str, before: &Value, now: &Value, found: &mut Vec<Difference>) {
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
}
