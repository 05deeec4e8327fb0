//! Answers of programs about this machine: a run queries and stores them, and read-only commands use the stored
//! answers.

use super::{
    EngineError,
    records::{self, MEMO},
};
use serde_json::{Value, json};
use std::cell::RefCell;
use tauflow_cache::{CacheError, Store};
use tauflow_contract::{Basis, Group, MemoKey, NodeKind, Probe};

/// Asks programs for a run, or the store for a plan.
pub struct Asking<'a> {
    store: &'a Store,
    acts: bool,
    /// The machine on which times are measured, if it is not this one.
    measuring: Option<&'a Value>,
}

impl<'a> Asking<'a> {
    /// Programs are run only if it `acts`.
    pub fn new(store: &'a Store, acts: bool) -> Self {
        Self { store, acts, measuring: None }
    }

    /// The same, with times measured on this machine.
    pub fn measuring(self, machine: Option<&'a Value>) -> Self {
        Self { measuring: machine, ..self }
    }

    /// The environment in the keys of a kind's group; none if only a program can provide it, and no program may run.
    ///
    /// # Errors
    /// If an answer cannot be kept.
    pub fn environment(&self, kind: &dyn NodeKind, params: &Value, group: Group) -> Result<Option<Value>, EngineError> {
        let name = kind.spec().name;
        // Answers are of a version of the kind, as its outputs are: another may ask otherwise.
        let machine = self.measuring.filter(|_| kind.spec_for(params).measures(group.name));
        let basis = Basis::new(name, group.version, "environment");
        let of = Of { asking: self, basis, machine, failed: RefCell::default() };
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
    machine: Option<&'a Value>,
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
        let preimage = serde_json::to_string(&key).expect("a key holds only plain values");
        let record = records::note(MEMO, key.hash(), &key.name(), preimage, answer.to_string());
        // The last answer counts: the same program may tell another version when what it loads has changed.
        let kept = records::keep_last(store, &record);
        if let Err(error) = kept {
            self.failed.borrow_mut().get_or_insert(error);
        }
        Some(answer)
    }

    fn machine(&self) -> Option<Value> {
        self.machine.cloned()
    }
}
