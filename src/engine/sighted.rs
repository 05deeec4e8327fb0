//! Actions that depend on files which only the program that ran knew of.
//!
//! The key of such an action has two parts. The first is known before it runs: params, inputs, the program. The second
//! is what the program looked at among the files outside ([`Seen`]), which is known once it has run. The store keeps
//! lists of these paths under the first part. A look-up asks the same questions of the paths on a list: if all answers
//! are as they were, the program would do the same again, and the record under both parts counts. A lost list makes the
//! program run again, and nothing else.

use super::records::{ACTION, SEEN, maker, now};
use serde_json::{Value, json};
use std::{
    collections::{BTreeSet, HashMap},
    sync::{Arc, Mutex, PoisonError},
};
use tauflow_cache::{CacheError, Digest, Key, Record, Recorded, Store};
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

/// The key of the lists of paths that belong to an action record; none if no program was traced for it.
pub fn of_record(record: &Record) -> Option<Key> {
    let key: ActionKey = serde_json::from_str(&record.preimage).ok()?;
    key.basis.environment.get(FILES)?;
    Some(memo_key(&key).hash())
}

/// The lists of paths that were looked at, by a record under a [`memo_key`], the latest first.
fn lists(record: Option<Arc<Record>>) -> Vec<Digest> {
    record.and_then(|record| serde_json::from_str(&record.payload).ok()).unwrap_or_default()
}

/// Reads lists of paths together; none for a list that is lost.
fn read(store: &Store, lists: &[Digest]) -> Result<Vec<Option<Seen>>, CacheError> {
    let read = store.get_many(lists)?.into_iter();
    Ok(read.map(|bytes| serde_json::from_slice(&bytes?).ok()).collect())
}

/// An action as the files outside are now.
#[derive(Clone)]
pub struct Sighted {
    /// The key under which it is recorded. Without a record: the key that it would have if the program looked where it
    /// did last, or the first part alone.
    pub key: ActionKey,
    /// Its hash.
    pub hash: Key,
    /// The record.
    pub record: Option<Arc<Record>>,
}

/// Finds actions by their keys, in order. The store is asked three times, however many actions there are: for the
/// lists of paths of all, for the content of the lists, and for the records of all candidates.
///
/// # Errors
/// If the store cannot be read.
pub fn find_many(store: &Store, keys: &[&ActionKey]) -> Result<Vec<Sighted>, CacheError> {
    let memos: Vec<Key> = keys.iter().map(|key| memo_key(key).hash()).collect();
    let lists: Vec<Vec<Digest>> = store.lookup_many(SEEN, &memos).into_iter().map(lists).collect();
    // Actions share lists; the files of a list are looked at once.
    let distinct: Vec<Digest> = lists.iter().flatten().copied().collect::<BTreeSet<_>>().into_iter().collect();
    let seen = read(store, &distinct)?.into_iter().map(|seen| Some(second(&seen?.again())));
    let now: HashMap<Digest, Option<[Value; 2]>> = distinct.iter().copied().zip(seen).collect();
    let candidates = |(key, lists): (&&ActionKey, &Vec<Digest>)| {
        let known = lists.iter().filter_map(|list| now.get(list)?.as_ref());
        let mut found: Vec<ActionKey> = known.map(|now| join(first(key), now)).collect();
        if found.is_empty() {
            // No program ran, because it was not there.
            found.push(first(key));
        }
        found.into_iter().map(|key| (key.hash(), key)).collect::<Vec<_>>()
    };
    let candidates: Vec<Vec<(Key, ActionKey)>> = keys.iter().zip(&lists).map(candidates).collect();
    let hashes: Vec<Key> = candidates.iter().flatten().map(|(hash, _)| *hash).collect();
    let mut records = store.lookup_many(ACTION, &hashes).into_iter();
    let sighted = |candidates: Vec<(Key, ActionKey)>| {
        let all = candidates.into_iter().zip(records.by_ref());
        let mut all: Vec<_> = all.map(|((hash, key), record)| Sighted { key, hash, record }).collect();
        let recorded = all.iter().position(|of| of.record.is_some());
        all.swap_remove(recorded.unwrap_or(0)) // an action has a candidate at least
    };
    Ok(candidates.into_iter().map(sighted).collect())
}

/// Keeps which paths the program of an action looked at.
///
/// # Errors
/// If the store cannot be read or written.
pub fn keep(store: &Store, key: &ActionKey, seen: &Seen) -> Result<(), CacheError> {
    let memo = memo_key(key);
    let own = store.put(&serde_json::to_vec(seen).expect("plain data"))?;
    let mut before = lists(store.lookup(SEEN, &memo.hash()));
    before.retain(|list| *list != own);
    // The later of two lists of the same paths has the later times of files.
    let others = before.iter().zip(read(store, &before)?);
    let differs = |(list, other): (&Digest, Option<Seen>)| other.is_some_and(|o| !o.same_paths(seen)).then_some(*list);
    let mut kept = vec![own];
    kept.extend(others.filter_map(differs));
    kept.truncate(MOST);
    let record = Record {
        namespace: SEEN.into(),
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
        maker: maker(),
        fetched: false,
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
