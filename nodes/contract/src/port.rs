//! Ports: typed constants, which a kind lists in its spec and uses to read and write artifacts.
//!
//! `const SCENES: Each<Scene> = Each::new("scenes", "The scenes to render.")` is an input, `action.read(ctx, SCENES)`
//! its value. The engine sees them as [`InputPort`] and [`OutputPort`], which name media types by text. A kind can also
//! make these two from its params ([`crate::Kind::spec_for`]), with names that [`crate::interned`] keeps.

use crate::{Any, Media};
use std::marker::PhantomData;

/// The data that an input port passes to an action.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Takes {
    /// The item of the same key. The first such port that is connected decides which items there are.
    Item,
    /// The whole collection.
    Collection,
}

/// The reproducibility of an action.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Determinism {
    /// The same bits.
    Bitwise,
    /// The same bits on this machine; [`crate::Kind::environment`] says what of it decides them. Taints what is made
    /// from it.
    Local,
    /// A measurement, such as a time; taints what is made from it.
    Measured,
}

/// Output ports that one action makes together. A group that nobody reads does not run.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct Group {
    /// Its name.
    pub name: &'static str,
    /// Goes up when the outputs of the same action change.
    pub version: u32,
}

impl Group {
    /// A group of this name.
    pub const fn new(name: &'static str, version: u32) -> Self {
        Self { name, version }
    }

    /// The only group of a kind.
    pub const fn main(version: u32) -> Self {
        Self::new("main", version)
    }
}

/// An input of a kind, as the engine sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputPort {
    /// Name in the pipeline file.
    pub name: &'static str,
    /// Name of the media type of its items; `*` takes any.
    pub media: &'static str,
    /// The data that it passes to an action.
    pub takes: Takes,
    /// True if it may be left unconnected.
    pub optional: bool,
    /// True if its collection has at most one item.
    pub single: bool,
    /// A line for people.
    pub doc: &'static str,
}

/// An output of a kind, as the engine sees it. The first port is the node's default output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputPort {
    /// Name in the pipeline file.
    pub name: &'static str,
    /// Name of the media type of its items.
    pub media: &'static str,
    /// The ports that are made with it.
    pub group: Group,
    /// True if an action may leave its item out of this port (a filter).
    pub filter: bool,
    /// Whether its bits are reproducible. An action that makes nothing but measurements has the machine to itself.
    pub determinism: Determinism,
    /// True if the collection that a gather makes has one item.
    pub single: bool,
    /// True if the parts are also written as files below `OUT/<pipeline>/` when the node is a target.
    pub publish: bool,
    /// A line for people.
    pub doc: &'static str,
}

impl OutputPort {
    /// The same port without bits that are the same on all machines: what was bitwise is decided by the machine, too.
    pub fn of_machine(self) -> Self {
        let determinism = match self.determinism {
            Determinism::Bitwise => Determinism::Local,
            other => other,
        };
        Self { determinism, ..self }
    }
}

/// An input that hands over the item of the same key.
#[derive(Debug)]
pub struct Each<M>(InputPort, PhantomData<fn() -> M>);

/// An input that hands over the whole collection.
#[derive(Debug)]
pub struct All<M>(InputPort, PhantomData<fn() -> M>);

/// An output.
#[derive(Debug)]
pub struct Out<M>(OutputPort, PhantomData<fn() -> M>);

macro_rules! input {
    ($port:ident, $takes:expr) => {
        impl<M> Clone for $port<M> {
            fn clone(&self) -> Self {
                *self
            }
        }

        impl<M> Copy for $port<M> {}

        impl<M: Media> $port<M> {
            /// A required port.
            pub const fn new(name: &'static str, doc: &'static str) -> Self {
                Self(
                    InputPort { name, media: M::NAME, takes: $takes, optional: false, single: false, doc },
                    PhantomData,
                )
            }
        }

        impl $port<Any> {
            /// A required port that takes any media type.
            pub const fn any(name: &'static str, doc: &'static str) -> Self {
                Self(
                    InputPort { name, media: Any::NAME, takes: $takes, optional: false, single: false, doc },
                    PhantomData,
                )
            }
        }

        impl<M> $port<M> {
            /// The same port, which may be left unconnected.
            pub const fn or_none(mut self) -> Self {
                self.0.optional = true;
                self
            }

            /// Its name.
            pub const fn name(self) -> &'static str {
                self.0.name
            }

            /// The port as the engine sees it.
            pub const fn port(self) -> InputPort {
                self.0
            }
        }
    };
}

input!(Each, Takes::Item);
input!(All, Takes::Collection);

impl<M> All<M> {
    /// The same port, whose collection has at most one item ([`crate::Action::only`]).
    pub const fn single(mut self) -> Self {
        self.0.single = true;
        self
    }
}

impl<M> Clone for Out<M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for Out<M> {}

impl<M: Media> Out<M> {
    /// A bitwise, unfiltered port.
    pub const fn new(group: Group, name: &'static str, doc: &'static str) -> Self {
        let (filter, determinism, single, publish) = (false, Determinism::Bitwise, false, false);
        Self(OutputPort { name, media: M::NAME, group, filter, determinism, single, publish, doc }, PhantomData)
    }
}

impl<M> Out<M> {
    /// The same port, as a filter.
    pub const fn filtering(mut self) -> Self {
        self.0.filter = true;
        self
    }

    /// The same port, as a measurement.
    pub const fn measured(mut self) -> Self {
        self.0.determinism = Determinism::Measured;
        self
    }

    /// The same port, decided by the machine, too.
    pub const fn local(mut self) -> Self {
        self.0.determinism = Determinism::Local;
        self
    }

    /// The same port, on which a gather puts one item ([`crate::Outputs::put_one`]).
    pub const fn single(mut self) -> Self {
        self.0.single = true;
        self
    }

    /// The same port, published as files.
    pub const fn published(mut self) -> Self {
        self.0.publish = true;
        self
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        self.0.name
    }

    /// The port as the engine sees it.
    pub const fn port(self) -> OutputPort {
        self.0
    }
}
