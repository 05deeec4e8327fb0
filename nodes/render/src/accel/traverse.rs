//! Traversal: nearest hit and any hit.

use super::{Accel, COUNT_SHIFT, Hit, LEAF, Node, STACK, Slot, TRIANGLE};
use crate::geometry::{Candidate, Ray, Sphere, Walk, gamma, intersect_triangle};
use glam::{Vec3, Vec4};

/// Rows of a node's planes that a ray enters and leaves by.
#[derive(Clone, Copy)]
struct Slabs {
    near: [usize; 3],
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
}

impl Slabs {
    #[inline]
    fn new(walk: &Walk) -> Self {
        let side = |v: f32| usize::from(v < 0.0);
        let inverse = walk.inverse;
        Self {
            near: [side(inverse.x), 2 + side(inverse.y), 4 + side(inverse.z)],
            origin: [walk.origin.x, walk.origin.y, walk.origin.z].map(Vec4::splat),
            inverse: [inverse.x, inverse.y, inverse.z].map(Vec4::splat),
        }
    }

    /// Entry distances of the four boxes, and which of them are met in [0, t_max].
    #[inline]
    fn enter(&self, node: &Node, t_max: f32) -> ([f32; 4], u32) {
        let at = |axis: usize, row: usize| (node.planes[row] - self.origin[axis]) * self.inverse[axis];
        let enter = at(0, self.near[0]).max(at(1, self.near[1])).max(at(2, self.near[2]).max(Vec4::ZERO));
        let leave = at(0, self.near[0] ^ 1).min(at(1, self.near[1] ^ 1)).min(at(2, self.near[2] ^ 1));
        let leave = (leave * (1.0 + 2.0 * gamma(3))).min(Vec4::splat(t_max));
        (enter.to_array(), enter.cmple(leave).bitmask())
    }
}

impl Accel {
    #[inline(always)]
    fn meet(&self, slot: &Slot, walk: &Walk, t_max: f32) -> Option<Candidate> {
        let kind = slot.rows[1][3].to_bits();
        if kind == TRIANGLE {
            return intersect_triangle(walk, &slot.rows, t_max);
        }
        if kind == super::SPHERE {
            let [x, y, z, _] = slot.rows[0];
            return Sphere::intersect(Vec3::new(x, y, z), slot.rows[1][0], walk.origin, walk.direction, t_max);
        }
        self.disks[slot.rows[2][3].to_bits() as usize].intersect(walk.origin, walk.direction, t_max)
    }

    /// The nearest hit, if any; of several at one distance, that of the lowest primitive.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        if self.nodes.is_empty() {
            return None;
        }
        let walk = Walk::new(ray);
        let slabs = Slabs::new(&walk);
        let mut best: Option<Hit> = None;
        let mut t_max = ray.t_max;
        let mut stack = [(0u32, 0.0f32); STACK];
        let mut height = 0;
        let mut current = 0u32;
        loop {
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
                let (enter, mut met) = slabs.enter(node, t_max);
                if met != 0 {
                    // Sorts the few children that are met onto the stack, the nearest on top.
                    let base = height;
                    while met != 0 {
                        let lane = met.trailing_zeros() as usize;
                        met &= met - 1;
                        let entry = (node.children[lane], enter[lane]);
                        let mut at = height;
                        while at > base && stack[at - 1].1 < entry.1 {
                            stack[at] = stack[at - 1];
                            at -= 1;
                        }
                        stack[at] = entry;
                        height += 1;
                    }
                }
            } else {
                let first = current & ((1 << COUNT_SHIFT) - 1);
                let count = ((current & !LEAF) >> COUNT_SHIFT) + 1;
                for at in first..first + count {
                    let slot = &self.slots[at as usize];
                    if let Some(Candidate { t, u, v }) = self.meet(slot, &walk, t_max) {
                        let primitive = slot.primitive();
                        if best.is_none_or(|b| t < b.t || primitive < b.primitive) {
                            best = Some(Hit { t, u, v, primitive, slot: at });
                            t_max = t;
                        }
                    }
                }
            }
            loop {
                if height == 0 {
                    return best;
                }
                height -= 1;
                let (next, enter) = stack[height];
                if enter <= t_max {
                    current = next;
                    break;
                }
            }
        }
    }

    /// True if anything is met before the ray's end.
    pub fn occluded(&self, ray: &Ray) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let walk = Walk::new(ray);
        let slabs = Slabs::new(&walk);
        let mut stack = [0u32; STACK];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let current = stack[height];
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
                let (_, mut met) = slabs.enter(node, ray.t_max);
                while met != 0 {
                    let lane = met.trailing_zeros() as usize;
                    met &= met - 1;
                    stack[height] = node.children[lane];
                    height += 1;
                }
            } else {
                let first = (current & ((1 << COUNT_SHIFT) - 1)) as usize;
                let count = (((current & !LEAF) >> COUNT_SHIFT) + 1) as usize;
                if self.slots[first..first + count].iter().any(|slot| self.meet(slot, &walk, ray.t_max).is_some()) {
                    return true;
                }
            }
        }
        false
    }

    /// The nearest hit by trying every primitive: what [`Accel::closest`] must find.
    #[cfg(test)]
    pub(super) fn closest_by_force(&self, ray: &Ray) -> Option<Hit> {
        let walk = Walk::new(ray);
        let mut best: Option<Hit> = None;
        for (at, slot) in self.slots.iter().enumerate() {
            if let Some(Candidate { t, u, v }) = self.meet(slot, &walk, ray.t_max) {
                let primitive = slot.primitive();
                if best.is_none_or(|b| (t, primitive) < (b.t, b.primitive)) {
                    best = Some(Hit { t, u, v, primitive, slot: at as u32 });
                }
            }
        }
        best
    }
}
