//! A few rays that have little in common, followed by turns: while one waits for memory, the others go on.
//!
//! A tree that is larger than the caches answers each step of a single ray after a hundred nanoseconds. So what a ray
//! needs next is asked for, and it is its turn again when that is there. What a ray finds is what
//! [`super::Accel::closest_from`] finds: rays know nothing of each other.

use super::{
    STACK,
    best::{Best, Cursor, Slabs, Stack},
};
use crate::geometry::{Ray, Walk};
use glam::Vec3;

/// Rays on their way at once.
pub(super) const TURNS: usize = 16;

/// A ray on its way through a tree.
pub(super) struct Flight {
    pub(super) walk: Walk,
    pub(super) slabs: Slabs,
    pub(super) best: Best,
    /// Its number in the set.
    pub(super) at: usize,
    pub(super) spot: Cursor,
    pub(super) stack: Stack,
}

impl Default for Flight {
    fn default() -> Self {
        let walk = Walk::new(&Ray::new(Vec3::ZERO, Vec3::Z));
        let (slabs, spot) = (Slabs::new(&walk), Cursor { node: 0, height: 0 });
        Self { walk, slabs, best: Best::none(0.0), at: 0, spot, stack: [(0, 0.0); STACK] }
    }
}

impl Flight {
    /// Sets out from a node.
    #[inline(always)]
    pub(super) fn begin(&mut self, node: u32, at: usize, walk: Walk, best: Best) {
        (self.slabs, self.walk) = (Slabs::new(&walk), walk);
        (self.best, self.at, self.spot) = (best, at, Cursor { node, height: 0 });
    }
}
