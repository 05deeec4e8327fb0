//! Typed indices of pipeline and engine objects, and rows indexed by them.

use std::{
    fmt,
    marker::PhantomData,
    ops::{Index, IndexMut},
};

/// The number of a thing in a row.
pub trait Id: Copy + Eq + Ord {
    /// The number that stands at a place.
    fn at(place: usize) -> Self;
    /// Its place.
    fn place(self) -> usize;
}

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub struct $name(u32);

        impl Id for $name {
            fn at(place: usize) -> Self {
                Self(u32::try_from(place).expect("fewer than 2^32, or memory would not hold them"))
            }

            fn place(self) -> usize {
                self.0 as usize
            }
        }
    )*};
}

ids! {
    /// A lane of a run.
    LaneId
    /// A slot of a lane.
    SlotId
    /// An output port of a kind, by its place in `KindSpec::outputs`.
    PortId
    /// An input port of a kind, by its place in `KindSpec::inputs`.
    InputId
}

impl PortId {
    /// The port that is meant where none is named: the first.
    pub const DEFAULT: Self = Self(0);
}

/// A shard is named by the first byte of the hash of its items' keys.
impl Id for u8 {
    fn at(place: usize) -> Self {
        Self::try_from(place).expect("there are 256 shards")
    }

    fn place(self) -> usize {
        usize::from(self)
    }
}

/// One thing for each number.
#[derive(Clone)]
pub struct Row<I, T>(Vec<T>, PhantomData<I>);

impl<I: Id, T> Row<I, T> {
    /// An empty one.
    pub fn new() -> Self {
        Self(Vec::new(), PhantomData)
    }

    /// Adds a thing, and gives its number.
    pub fn push(&mut self, thing: T) -> I {
        self.0.push(thing);
        I::at(self.0.len() - 1)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The things, if there is one of this number.
    pub fn get(&self, id: I) -> Option<&T> {
        self.0.get(id.place())
    }

    /// The first.
    pub fn first(&self) -> Option<&T> {
        self.0.first()
    }

    /// All numbers, in order.
    pub fn ids(&self) -> impl DoubleEndedIterator<Item = I> + use<I, T> {
        (0..self.0.len()).map(I::at)
    }

    /// The things, in order.
    pub fn iter(&self) -> std::slice::Iter<'_, T> {
        self.0.iter()
    }

    /// The things, to be changed.
    pub fn iter_mut(&mut self) -> std::slice::IterMut<'_, T> {
        self.0.iter_mut()
    }

    /// The things with their numbers.
    pub fn pairs(&self) -> impl DoubleEndedIterator<Item = (I, &T)> + ExactSizeIterator {
        self.0.iter().enumerate().map(|(place, thing)| (I::at(place), thing))
    }

    /// As a slice.
    pub fn as_slice(&self) -> &[T] {
        &self.0
    }
}

impl<I: Id, T> Default for Row<I, T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<I: Id, T> Index<I> for Row<I, T> {
    type Output = T;

    fn index(&self, id: I) -> &T {
        &self.0[id.place()]
    }
}

impl<I: Id, T> IndexMut<I> for Row<I, T> {
    fn index_mut(&mut self, id: I) -> &mut T {
        &mut self.0[id.place()]
    }
}

impl<I: Id, T> FromIterator<T> for Row<I, T> {
    fn from_iter<A: IntoIterator<Item = T>>(things: A) -> Self {
        Self(things.into_iter().collect(), PhantomData)
    }
}

impl<I, T> IntoIterator for Row<I, T> {
    type Item = T;
    type IntoIter = std::vec::IntoIter<T>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

impl<'a, I, T> IntoIterator for &'a Row<I, T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.iter()
    }
}

impl<I, T: fmt::Debug> fmt::Debug for Row<I, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(&self.0).finish()
    }
}
