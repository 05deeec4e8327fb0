//! Facts about a node's outputs before a run, such as the rungs of ladders. They follow from its params and from the
//! facts of its inputs. `check` compares them, so that it reports a node that is sure to fail.
//!
//! `const RUNGS: Fact<Vec<u64>> = Fact::new("rungs")` is a fact; kinds that share it share the constant. A fact that is
//! unknown is absent, and is never an error. Knows no fact itself.

use crate::{All, Each, Out};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::{collections::BTreeMap, marker::PhantomData};

/// A fact about the items of a port: its name, and the type of its value.
#[derive(Debug)]
pub struct Fact<T>(&'static str, PhantomData<fn() -> T>);

impl<T> Clone for Fact<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Fact<T> {}

impl<T> Fact<T> {
    /// A fact of this name.
    pub const fn new(name: &'static str) -> Self {
        Self(name, PhantomData)
    }
}

/// The number of items on a port, or more: by it, `plan` counts the actions that follow a gather.
pub const MOST_ITEMS: Fact<u64> = Fact::new("most_items");

/// The known facts of every item of a port.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts(BTreeMap<&'static str, Value>);

impl Facts {
    /// The same with a fact. A value that cannot be written as JSON stays unknown.
    pub fn with<T: Serialize>(mut self, fact: Fact<T>, value: T) -> Self {
        if let Ok(value) = serde_json::to_value(value) {
            self.0.insert(fact.0, value);
        }
        self
    }

    /// The same with a fact, if there is a value.
    pub fn with_some<T: Serialize>(self, fact: Fact<T>, value: Option<T>) -> Self {
        match value {
            Some(value) => self.with(fact, value),
            None => self,
        }
    }

    /// The facts that hold of other items, too.
    pub fn shared(mut self, other: &Self) -> Self {
        self.0.retain(|name, value| other.0.get(name) == Some(value));
        self
    }

    /// The value of a fact, if it is known.
    pub fn get<T: DeserializeOwned>(&self, fact: Fact<T>) -> Option<T> {
        serde_json::from_value(self.0.get(fact.0)?.clone()).ok()
    }
}

/// One collection that feeds an input, with its known facts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Source {
    /// The node and the cell that it comes from, as the pipeline file would name them.
    pub name: String,
    /// The prefix of its items' keys, such as `sampler=sobol`; empty if they come from one cell.
    pub prefix: String,
    /// The known facts of each of its items.
    pub facts: Facts,
}

/// The known facts of the inputs of an action.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Known(BTreeMap<&'static str, Vec<Source>>);

impl Known {
    /// The same with the collections of an input.
    pub fn with(mut self, port: &'static str, sources: Vec<Source>) -> Self {
        self.0.insert(port, sources);
        self
    }

    /// Whether an input is connected.
    pub fn has(&self, port: &str) -> bool {
        self.0.get(port).is_some_and(|sources| !sources.is_empty())
    }

    /// The collection from which a port takes the item; one without facts if it is not connected.
    pub fn each<M>(&self, port: Each<M>) -> Source
    where
        Each<M>: Named,
    {
        self.of(port.named()).first().cloned().unwrap_or_default()
    }

    /// The collections of a port that takes all items.
    pub fn all<M>(&self, port: All<M>) -> &[Source]
    where
        All<M>: Named,
    {
        self.of(port.named())
    }

    fn of(&self, port: &str) -> &[Source] {
        self.0.get(port).map_or(&[], Vec::as_slice)
    }
}

/// An input with a name.
pub trait Named {
    /// The name.
    fn named(&self) -> &'static str;
}

impl<M> Named for Each<M> {
    fn named(&self) -> &'static str {
        self.name()
    }
}

impl<M> Named for All<M> {
    fn named(&self) -> &'static str {
        self.name()
    }
}

/// Where a foreseen problem is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum At {
    /// A param, as a JSON pointer, e.g. `/from`.
    Param(String),
    /// An input.
    Input(&'static str),
}

/// A reason why every action of a node is sure to fail.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Foreseen {
    /// Where.
    pub at: At,
    /// The problem.
    pub message: String,
    /// The remedy.
    pub hint: String,
}

impl Foreseen {
    /// A problem of a param.
    pub fn param(pointer: &str, message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { at: At::Param(pointer.to_owned()), message: message.into(), hint: hint.into() }
    }

    /// A problem of an input.
    pub fn input(port: impl Named, message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { at: At::Input(port.named()), message: message.into(), hint: hint.into() }
    }
}

/// The facts of the outputs, and the reasons why all actions are sure to fail.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outlook {
    outputs: BTreeMap<&'static str, Facts>,
    /// Reasons why they are sure to fail.
    pub problems: Vec<Foreseen>,
}

impl Outlook {
    /// The same with the facts of the items of an output.
    pub fn with<M>(mut self, port: Out<M>, facts: Facts) -> Self {
        self.outputs.insert(port.name(), facts);
        self
    }

    /// The same with problems.
    pub fn but(mut self, problems: impl IntoIterator<Item = Foreseen>) -> Self {
        self.problems.extend(problems);
        self
    }

    /// The known facts of the items of an output.
    pub fn facts(&self, port: &str) -> Facts {
        self.outputs.get(port).cloned().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Files;

    const COUNTS: Fact<Vec<u64>> = Fact::new("counts");
    const SIDE: Fact<u64> = Fact::new("side");

    #[test]
    fn facts_are_known_by_name_and_type() {
        let facts = Facts::default().with(COUNTS, vec![1, 2]).with_some(SIDE, None);
        assert_eq!((facts.get(COUNTS), facts.get(SIDE)), (Some(vec![1, 2]), None));
        // Another type under the same name is not known.
        assert_eq!(facts.get(Fact::<String>::new("counts")), None);
    }

    #[test]
    fn nothing_is_known_of_an_input_that_is_not_connected() {
        const EACH: Each<Files> = Each::new("each", "A file.");
        const ALL: All<Files> = All::new("all", "Files.");
        let source = Source { name: "node".into(), facts: Facts::default().with(SIDE, 4), ..Source::default() };
        let known = Known::default().with(EACH.name(), vec![source]);
        assert_eq!(known.each(EACH).facts.get(SIDE), Some(4));
        assert!(known.has("each") && !known.has("all") && known.all(ALL).is_empty());
    }
}
