//! Actions that depend on files which only the program that ran knew of.
//!
//! The key of such an action has two parts. The first is known before it runs: params, inputs, the program. The second
//! is what the program looked at among the files outside ([`Seen`]), which is known once it has run. The store keeps
//! lists of these paths under the first part. A look-up asks the same questions of the paths on a list: if all answers
//! are as they were, the program would do the same again, and the record under both parts counts. A lost list makes the
//! program run again, and nothing else.

use super::records::{ACTION, MEMO, now};
use serde_json::{Value, json};
use std::{
    collections::{BTreeSet, HashMap},
    sync::{Arc, Mutex, PoisonError},
};
use tauflow_cache::{CacheError, Digest, Record, Recorded, Store};
use tauflow_contract::{ActionKey, Basis, MemoKey, Seen};

/// Fields of a key's environment that hold its second part.
const FILES: &str = "files";
const TRACED: &str = "traced";
/// Most lists of paths that are kept for an action: a program may look elsewhere when a file has changed.
const MOST: usize = 8;

/// The part of a key that is known before the program runs.
pub fn first(key: &ActionKey) -> ActionKey {
    let mut key = key.clone();
    if let Value::Object(fields) = &mut key.basis.environment {
        fields.remove(FILES);
        fields.remove(TRACED);
    }
    key
}

/// Both parts of the key of an action whose program saw this.
pub fn full(key: &ActionKey, seen: &Seen) -> ActionKey {
    join(first(key), &second(seen))
}

/// The second part: a summary of the files, and whether all are known.
fn second(seen: &Seen) -> [Value; 2] {
    let traced = seen.untraced.as_ref().map_or_else(|| "yes".to_owned(), |why| format!("no: {why}"));
    [json!(seen.summary()), json!(traced)]
}

fn join(mut first: ActionKey, [files, traced]: &[Value; 2]) -> ActionKey {
    let environment = &mut first.basis.environment;
    if !environment.is_object() {
        *environment = json!({ "own": environment });
    }
    environment[FILES] = files.clone();
    environment[TRACED] = traced.clone();
    first
}

fn memo_key(key: &ActionKey) -> MemoKey {
    let Basis { kind, version, .. } = &key.basis;
    let basis = Basis::new(kind.clone(), *version, "files seen").with(json!({ "action": first(key).hash() }), None);
    MemoKey { basis, inputs: Vec::new() }
}

/// The lists of paths that were looked at, the latest first.
fn lists(store: &Store, memo: &MemoKey) -> Vec<Digest> {
    let record = store.lookup(MEMO, &memo.hash());
    record.and_then(|record| serde_json::from_str(&record.payload).ok()).unwrap_or_default()
}

fn read(store: &Store, list: &Digest) -> Result<Option<Seen>, CacheError> {
    Ok(store.get(list)?.and_then(|bytes| serde_json::from_slice(&bytes).ok()))
}

/// The second parts of keys as the files are now. A list is asked once, however many actions share it.
#[derive(Default)]
pub struct Looks(HashMap<Digest, Option<Arc<[Value; 2]>>>);

impl Looks {
    /// The keys that an action may be recorded under as the files are now, the latest first.
    fn keys(&mut self, store: &Store, key: &ActionKey) -> Result<Vec<ActionKey>, CacheError> {
        let mut keys = Vec::new();
        for list in lists(store, &memo_key(key)) {
            let now = match self.0.get(&list) {
                Some(now) => now.clone(),
                None => {
                    let now = read(store, &list)?.map(|seen| Arc::new(second(&seen.again())));
                    self.0.insert(list, now.clone());
                    now
                }
            };
            keys.extend(now.map(|now| join(first(key), &now)));
        }
        Ok(keys)
    }

    /// The key under which an action is recorded as the files are now, with the record. Without a record: the key that
    /// it would have if the program looked where it did last, or the first part alone.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn find(&mut self, store: &Store, key: &ActionKey) -> Result<(ActionKey, Option<Arc<Record>>), CacheError> {
        let mut keys = self.keys(store, key)?;
        if keys.is_empty() {
            // No program ran, because it was not there.
            keys.push(first(key));
        }
        for full in &keys {
            if let Some(record) = store.lookup(ACTION, &full.hash()) {
                return Ok((full.clone(), Some(record)));
            }
        }
        Ok((keys.swap_remove(0), None))
    }
}

/// Keeps which paths the program of an action looked at.
///
/// # Errors
/// If the store cannot be read or written.
pub fn keep(store: &Store, key: &ActionKey, seen: &Seen) -> Result<(), CacheError> {
    let memo = memo_key(key);
    let own = store.put(&serde_json::to_vec(seen).expect("plain data"))?;
    let mut kept = vec![own];
    for list in lists(store, &memo) {
        // Of two lists of the same paths, the later one has the later times of files.
        if list != own && read(store, &list)?.is_some_and(|other| !other.same_paths(seen)) {
            kept.push(list);
        }
    }
    kept.truncate(MOST);
    let record = Record {
        namespace: MEMO.into(),
        key: memo.hash(),
        label: memo.name(),
        preimage: serde_json::to_string(&memo).expect("a key holds only plain values"),
        payload: serde_json::to_string(&kept).expect("digests always serialise"),
        recipe: String::new(),
        derived: false,
        transient: false,
        refs: kept,
        trees: Vec::new(),
        wall_us: 0,
        bytes: 0,
        when: now(),
    };
    match store.record(&record)? {
        Recorded::New | Recorded::Same => Ok(()),
        Recorded::Conflict { .. } => store.replace(&record),
    }
}

/// A remark about what a program saw, once in a process; none if all is well.
pub fn warning(kind: &str, seen: &Seen) -> Option<String> {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let changed: Vec<&str> = seen.changed().collect();
    let told = match (&seen.untraced, &changed[..]) {
        (Some(why), _) => format!(
            "traced: no: the files that the program of `{kind}` opens are not known ({why}); if a file changes that \
             neither its command line nor `depends` names, it does not run again"
        ),
        (None, []) => return None,
        (None, [first, ..]) => format!(
            "`{first}`{} changed while a program of `{kind}` read it; the action runs again next time",
            if changed.len() > 1 { format!(" and {} more files", changed.len() - 1) } else { String::new() }
        ),
    };
    SAID.lock().unwrap_or_else(PoisonError::into_inner).insert(told.clone()).then_some(told)
}
