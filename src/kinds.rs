//! The table of kinds for the engine. Knows none by name.

use crate::diagnostics::did_you_mean;
use std::{collections::BTreeMap, sync::Arc};
use tauflow_contract::NodeKind;

/// Kinds by name.
#[derive(Clone, Default)]
pub struct Registry {
    kinds: BTreeMap<&'static str, Arc<dyn NodeKind>>,
}

impl Registry {
    /// A table of these kinds; of two with one name the later stays.
    pub fn new(kinds: impl IntoIterator<Item = Box<dyn NodeKind>>) -> Self {
        Self { kinds: kinds.into_iter().map(|kind| (kind.spec().name, Arc::from(kind))).collect() }
    }

    /// The kind of that name.
    pub fn get(&self, name: &str) -> Option<&Arc<dyn NodeKind>> {
        self.kinds.get(name)
    }

    /// All kinds, by name.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<dyn NodeKind>> {
        self.kinds.values()
    }

    /// All names.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + Clone + '_ {
        self.kinds.keys().copied()
    }

    /// A hint for a name that is not here.
    pub fn hint(&self, name: &str) -> String {
        did_you_mean(name, "kinds", self.names())
    }
}
