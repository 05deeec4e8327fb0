//! Traversal: nearest hit and any hit.

use super::{Accel, Block, Curved, Hit, LEAF, Node, STACK};
use crate::geometry::{FourHits, Ray, Sphere, Walk, gamma, intersect_four};
use glam::Vec4;

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
    /// Hits with the primitives of a block.
    #[inline(always)]
    fn meet(&self, block: &Block, walk: &Walk, t_max: f32) -> FourHits {
        let mut hits = intersect_four(walk, &block.vertices, t_max);
        let mut curved = block.curved();
        while curved != 0 {
            let lane = curved.trailing_zeros() as usize;
            curved &= curved - 1;
            let found = match &self.curved[block.vertices[2][3][lane].to_bits() as usize] {
                Curved::Sphere { center, radius } => {
                    Sphere::intersect(*center, *radius, walk.origin, walk.direction, t_max)
                }
                Curved::Disk(disk) => disk.intersect(walk.origin, walk.direction, t_max),
            };
            hits.met &= !(1 << lane);
            if let Some(found) = found {
                hits.met |= 1 << lane;
                (hits.t[lane], hits.u[lane], hits.v[lane]) = (found.t, found.u, found.v);
            }
        }
        hits
    }

    /// Takes the best of a block's hits into account.
    #[inline(always)]
    fn improve(&self, index: u32, walk: &Walk, t_max: f32, best: &mut Option<Hit>) {
        let block = &self.blocks[index as usize];
        let hits = self.meet(block, walk, t_max);
        let mut met = hits.met;
        while met != 0 {
            let lane = met.trailing_zeros() as usize;
            met &= met - 1;
            let (t, primitive) = (hits.t[lane], block.primitive(lane));
            if best.is_none_or(|b| t < b.t || (t == b.t && primitive < b.primitive)) {
                let place = index << 2 | lane as u32;
                *best = Some(Hit { t, u: hits.u[lane], v: hits.v[lane], primitive, place });
            }
        }
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
                self.improve(current & !LEAF, &walk, t_max, &mut best);
                if let Some(hit) = &best {
                    t_max = hit.t;
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
            } else if self.meet(&self.blocks[(current & !LEAF) as usize], &walk, ray.t_max).met != 0 {
                return true;
            }
        }
        false
    }

    /// The nearest hit by trying every primitive: what [`Accel::closest`] must find.
    #[cfg(test)]
    pub(super) fn closest_by_force(&self, ray: &Ray) -> Option<Hit> {
        let walk = Walk::new(ray);
        let mut best: Option<Hit> = None;
        for index in 0..self.blocks.len() as u32 {
            self.improve(index, &walk, ray.t_max, &mut best);
        }
        best
    }
}
