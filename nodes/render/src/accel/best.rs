//! One ray on its way through a tree: what it visits next, and its best hit so far.

use super::{Hit, NONE, Node, Root, STACK, WIDE};
use crate::{
    geometry::{Walk, gamma},
    lanes::{Mask, Real},
};

/// Nodes to be visited, and where the ray enters them.
pub(crate) type Stack = [(u32, f32); STACK];

/// Rows of a node's planes that a ray enters and leaves by.
#[derive(Clone, Copy)]
pub(super) struct Slabs {
    near: [usize; 3],
    origin: [f32; 3],
    inverse: [f32; 3],
}

impl Slabs {
    #[inline(always)]
    pub(super) fn new(walk: &Walk) -> Self {
        let side = |v: f32| usize::from(v < 0.0);
        let inverse = walk.inverse;
        Self {
            near: [side(inverse.x), 2 + side(inverse.y), 4 + side(inverse.z)],
            origin: walk.origin.to_array(),
            inverse: inverse.to_array(),
        }
    }

    /// Entry distances of the eight boxes, and which of them are met in [0, t_max].
    #[inline(always)]
    pub(super) fn enter<R: Real>(&self, node: &Node, t_max: f32) -> ([f32; WIDE], u32) {
        let (mut entries, mut met, mut at) = ([0.0; WIDE], 0, 0);
        while at < WIDE {
            macro_rules! distance {
                ($axis:expr, $row:expr) => {
                    (R::load(&node.planes[$row][at..]) - self.origin[$axis]) * self.inverse[$axis]
                };
            }
            let [x, y, z] = self.near;
            let enter = distance!(0, x).max(distance!(1, y)).max(distance!(2, z).max(R::zero()));
            let leave = distance!(0, x ^ 1).min(distance!(1, y ^ 1)).min(distance!(2, z ^ 1));
            let leave = (leave * (1.0 + 2.0 * gamma(3))).min(R::splat(t_max));
            met |= enter.le(leave).bits() << at;
            enter.store(&mut entries[at..]);
            at += R::N;
        }
        (entries, met)
    }
}

/// Where a ray is on its way through a tree: what it visits next, and how much is on its stack.
#[derive(Clone, Copy)]
pub(super) struct Cursor {
    pub(super) node: u32,
    pub(super) height: usize,
}

/// How far a ray is.
pub(super) enum Progress {
    /// Something is left to be visited.
    Left,
    /// It was stopped.
    Stopped,
    /// Nothing is left.
    Passed,
}

/// The best hit so far.
pub(super) struct Best {
    pub(super) t: f32,
    pub(super) u: f32,
    pub(super) v: f32,
    /// Its primitive, or [`NONE`].
    pub(super) primitive: u32,
}

impl Best {
    #[inline(always)]
    pub(super) fn none(t_max: f32) -> Self {
        Self { t: t_max, u: 0.0, v: 0.0, primitive: NONE }
    }

    /// Takes a hit not beyond the best; of those at one distance the lowest primitive counts.
    #[inline(always)]
    pub(super) fn take(&mut self, t: f32, u: f32, v: f32, primitive: u32) {
        if t < self.t || (t == self.t && primitive < self.primitive) {
            *self = Self { t, u, v, primitive };
        }
    }

    /// Takes the best hit with a placed mesh into that in the world.
    #[inline(always)]
    pub(super) fn merge(&self, root: Root, into: &mut Self) {
        if self.primitive != NONE {
            into.take(self.t * root.unit, self.u, self.v, root.first + self.primitive);
        }
    }

    #[inline(always)]
    pub(super) fn hit(&self) -> Option<Hit> {
        (self.primitive != NONE).then_some(Hit { t: self.t, u: self.u, v: self.v, primitive: self.primitive })
    }
}
