//! Answers of programs about this machine: a run queries and stores them, and read-only commands use the stored
//! answers.

use super::{
    EngineError,
    records::{MEMO, maker, now},
};
use serde_json::{Value, json};
use std::cell::RefCell;
use tauflow_cache::{CacheError, Record, Recorded, Store};
use tauflow_contract::{Basis, Group, MemoKey, NodeKind, Probe};

/// Asks programs for a run, or the store for a plan.
pub struct Asking<'a> {
    store: &'a Store,
    acts: bool,
}

impl<'a> Asking<'a> {
    /// Programs are run only if it `acts`.
    pub fn new(store: &'a Store, acts: bool) -> Self {
        Self { store, acts }
    }

    /// The environment in the keys of a kind's group; none if only a program can provide it, and no program may run.
    ///
    /// # Errors
    /// If an answer cannot be kept.
    pub fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError> {
        let name = kind.spec().name;
        // Answers are of a version of the kind, as its outputs are: another may ask otherwise.
        let of = Of { asking: self, basis: Basis::new(name, group.version, "environment"), failed: RefCell::default() };
        let environment = kind.environment(params, group.name, &of);
        if let Some(error) = of.failed.into_inner() {
            return Err(error.into());
        }
        if environment.is_none() && self.acts {
            return Err(EngineError::Request(format!(
                "internal error: `{name}` does not know what of this machine decides its outputs; please report it"
            )));
        }
        Ok(environment)
    }
}

/// The placeholder in keys for an unknown environment. No run has it, so no such key is found.
pub fn unknown() -> Value {
    json!({ "unknown": null })
}

/// The questions of one kind.
struct Of<'a> {
    asking: &'a Asking<'a>,
    basis: Basis,
    failed: RefCell<Option<CacheError>>,
}

impl Probe for Of<'_> {
    fn answer(&self, question: &Value, ask: &dyn Fn() -> Value) -> Option<Value> {
        let key = MemoKey { basis: self.basis.with(question.clone(), None), inputs: Vec::new() };
        let store = self.asking.store;
        if !self.asking.acts {
            return serde_json::from_str(&store.lookup(MEMO, &key.hash())?.payload).ok();
        }
        let answer = ask();
        let record = Record {
            namespace: MEMO.into(),
            key: key.hash(),
            label: key.name(),
            preimage: serde_json::to_string(&key).expect("a key holds only plain values"),
            payload: answer.to_string(),
            recipe: String::new(),
            derived: false,
            transient: false,
            refs: Vec::new(),
            trees: Vec::new(),
            wall_us: 0,
            bytes: 0,
            when: now(),
            maker: maker(),
            fetched: false,
        };
        // The last answer counts: the same program may tell another version when what it loads has changed.
        let kept = match store.record(&record) {
            Ok(Recorded::New | Recorded::Same) => Ok(()),
            Ok(Recorded::Conflict { .. }) => store.replace(&record),
            Err(error) => Err(error),
        };
        if let Err(error) = kept {
            self.failed.borrow_mut().get_or_insert(error);
        }
        Some(answer)
    }
}
