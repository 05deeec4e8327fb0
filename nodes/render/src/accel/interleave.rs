//! A few rays that have little in common, followed by turns: while one waits for memory, the others go on.
//!
//! A tree that is larger than the caches answers each step of a single ray after a hundred nanoseconds. So what a ray
//! needs next is asked for, and it is its turn again when that is there. What a ray finds is what
//! [`Accel::closest_from`] finds: rays know nothing of each other.

use super::{
    Accel, LEAF, PLACED, TREE_STACK,
    level::Level,
    traverse::{Best, Slabs},
};
use crate::{geometry::Walk, lanes::Real};

/// Rays on their way at once.
pub(super) const TURNS: usize = 16;

/// A ray on its way through a tree.
pub(super) struct Flight {
    walk: Walk,
    slabs: Slabs,
    pub(super) best: Best,
    /// Its number in the set.
    pub(super) at: usize,
    current: u32,
    height: usize,
    stack: [(u32, f32); 2 * TREE_STACK],
}

impl Default for Flight {
    fn default() -> Self {
        let walk = Walk::new(&crate::geometry::Ray::new(glam::Vec3::ZERO, glam::Vec3::Z));
        let slabs = Slabs::new(&walk);
        let (best, stack) = (Best::none(0.0), [(0, 0.0); 2 * TREE_STACK]);
        Self { walk, slabs, best, at: 0, current: 0, height: 0, stack }
    }
}

impl Flight {
    /// Sets out from a node.
    #[inline(always)]
    pub(super) fn begin(&mut self, node: u32, at: usize, walk: Walk, best: Best) {
        (self.slabs, self.walk) = (Slabs::new(&walk), walk);
        (self.best, self.at, self.current, self.height) = (best, at, node, 0);
    }
}

impl Accel {
    /// Asks for a node or a block that is about to be read.
    #[inline(always)]
    pub(super) fn ask_for(&self, which: u32) {
        if which & LEAF == 0 {
            crate::lanes::ask_for(&self.nodes, which as usize);
        } else if which & PLACED != PLACED {
            crate::lanes::ask_for(&self.blocks, (which & !LEAF) as usize);
        }
    }

    /// One step of a ray: a node or a block. True if it has arrived: there is nothing left for it.
    #[inline(always)]
    pub(super) fn step<R: Real, L: Level>(&self, flight: &mut Flight) -> bool {
        let Flight { walk, slabs, best, current, height, stack, .. } = flight;
        let shear = [R::splat(walk.shear[0]), R::splat(walk.shear[1]), R::splat(walk.shear[2])];
        if *current & LEAF == 0 {
            let node = &self.nodes[*current as usize];
            let (enter, mut met) = slabs.enter::<R>(node, best.t);
            if met != 0 {
                let lane = met.trailing_zeros() as usize & 7;
                met &= met - 1;
                let mut nearest = (node.children[lane], enter[lane]);
                let base = *height;
                while met != 0 {
                    let lane = met.trailing_zeros() as usize & 7;
                    met &= met - 1;
                    let mut entry = (node.children[lane], enter[lane]);
                    if entry.1 < nearest.1 {
                        std::mem::swap(&mut entry, &mut nearest);
                    }
                    let mut at = *height;
                    while at > base && stack[at - 1].1 < entry.1 {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = entry;
                    *height += 1;
                }
                *current = nearest.0;
                self.ask_for(nearest.0);
                return false;
            }
        } else if L::HAS_PLACED && *current & PLACED == PLACED {
            L::closest::<R>(self, *current & !PLACED, walk, best, &mut stack[*height..]);
        } else {
            self.improve::<R>(*current & !LEAF, walk, shear, best);
        }
        while *height > 0 {
            *height -= 1;
            let (next, enter) = stack[*height];
            if enter <= best.t {
                *current = next;
                self.ask_for(next);
                return false;
            }
        }
        true
    }
}
