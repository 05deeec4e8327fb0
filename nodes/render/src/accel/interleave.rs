//! A few rays that have little in common, followed by turns: while one waits for memory, the others go on.
//!
//! A tree that is larger than the caches answers each step of a single ray after a hundred nanoseconds. A ray therefore
//! requests its next node, and continues when the node has arrived. A ray finds the same hit as with
//! [`Accel::closest_from`], because rays are independent.

use super::{
    Accel, LEAF, PLACED, STACK,
    level::Level,
    traverse::{Best, Slabs, Spot, Stack},
};
use crate::{
    geometry::{Ray, Walk},
    lanes::{Real, ask_for},
};
use glam::Vec3;

/// Rays on their way at once.
pub(super) const TURNS: usize = 16;

/// A ray on its way through a tree.
pub(super) struct Flight {
    walk: Walk,
    slabs: Slabs,
    pub(super) best: Best,
    /// Its number in the set.
    pub(super) at: usize,
    spot: Spot,
    stack: Stack,
}

impl Default for Flight {
    fn default() -> Self {
        let walk = Walk::new(&Ray::new(Vec3::ZERO, Vec3::Z));
        let (slabs, spot) = (Slabs::new(&walk), Spot { node: 0, height: 0 });
        Self { walk, slabs, best: Best::none(0.0), at: 0, spot, stack: [(0, 0.0); STACK] }
    }
}

impl Flight {
    /// Sets out from a node.
    #[inline(always)]
    pub(super) fn begin(&mut self, node: u32, at: usize, walk: Walk, best: Best) {
        (self.slabs, self.walk) = (Slabs::new(&walk), walk);
        (self.best, self.at, self.spot) = (best, at, Spot { node, height: 0 });
    }
}

impl Accel {
    /// One step of a ray, which then asks for what it needs next. True if nothing is left for it.
    #[inline(always)]
    pub(super) fn take_turn<R: Real, L: Level>(&self, flight: &mut Flight) -> bool {
        let Flight { walk, slabs, best, spot, stack, .. } = flight;
        let done = self.step::<R, L>(spot, slabs, walk, best, stack);
        let next = spot.node;
        if next & LEAF == 0 {
            ask_for(&self.nodes, next as usize);
        } else if next & PLACED != PLACED {
            ask_for(&self.blocks, (next & !LEAF) as usize);
        }
        done
    }
}
