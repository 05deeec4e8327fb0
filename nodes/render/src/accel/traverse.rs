//! Traversal by one ray: nearest hit and any hit.

use super::{
    Accel, Hit, LEAF, LEAF_SIZE, PLACED, STACK,
    best::{Best, Cursor, Progress, Slabs, Stack},
    block::{AnyBlock, Block},
    level::{Level, WorldTree},
};
use crate::{
    geometry::{Ray, Rays, Walk, intersect_lanes, intersect_triangle, seen_from},
    lanes::{Mask, Real},
};
use glam::Vec3;

impl Accel {
    /// Takes the hits of a block into account: the best is kept.
    #[inline(always)]
    fn improve<R: Real, const LEN: usize>(&self, block: &Block<'_, LEN>, walk: &Walk, shear: [R; 3], best: &mut Best) {
        let mut at = 0;
        while at < Block::<LEN>::WIDTH {
            let found = intersect_lanes(seen_from(walk, block.triangles, at), shear, R::splat(best.t));
            let mut met = found.met.bits() & Block::<LEN>::LANES;
            if met != 0 {
                let [mut t, mut u, mut v] = [[0.0; LEAF_SIZE as usize]; 3];
                found.t.store(&mut t);
                found.u.store(&mut u);
                found.v.store(&mut v);
                while met != 0 {
                    let lane = met.trailing_zeros() as usize & 7;
                    met &= met - 1;
                    best.take(t[lane], u[lane], v[lane], block.primitive(at + lane));
                }
            }
            let unsure = found.edges.bits() & Block::<LEN>::LANES;
            if unsure != 0 {
                block.decide(walk, unsure << at, best);
            }
            at += R::N;
        }
        if block.has_curved() {
            self.improve_curved(block, walk.origin, walk.direction, best);
        }
    }

    /// Hits with what is curved in a block.
    fn improve_curved<const LEN: usize>(&self, block: &Block<'_, LEN>, origin: Vec3, direction: Vec3, best: &mut Best) {
        let ray = Rays { origin: origin.to_array().map(|v| [v]), direction: direction.to_array().map(|v| [v]) };
        let mut lane = 0;
        while let Some(place) = block.curved(lane) {
            lane += 1;
            let (primitive, curved) = &self.curved[place];
            let ([t, u, v], met) = curved.intersect_all(&ray, &[best.t]);
            if met[0] {
                best.take(t[0], u[0], v[0], *primitive);
            }
        }
    }

    /// [`Accel::closest`] with lanes of at most eight.
    #[inline(always)]
    pub(crate) fn closest_lanes<R: Real>(&self, ray: &Ray, stack: &mut Stack) -> Option<Hit> {
        let mut best = Best::none(ray.t_max);
        if !self.nodes.is_empty() {
            self.closest_from::<R, WorldTree>(0, &Walk::new(ray), &mut best, stack);
        }
        best.hit()
    }

    /// Looks below a node for what is nearer than the best.
    #[inline(always)]
    pub(super) fn closest_from<R: Real, L: Level>(
        &self,
        node: u32,
        walk: &Walk,
        best: &mut Best,
        stack: &mut [(u32, f32)],
    ) {
        let slabs = Slabs::new(walk);
        let mut spot = Cursor { node, height: 0 };
        while !self.step::<R, L>(&mut spot, &slabs, walk, best, stack) {}
    }

    /// One step of a ray: a node, a block or a placed mesh. True if nothing is left for it.
    #[inline(always)]
    pub(super) fn step<R: Real, L: Level>(
        &self,
        spot: &mut Cursor,
        slabs: &Slabs,
        walk: &Walk,
        best: &mut Best,
        stack: &mut [(u32, f32)],
    ) -> bool {
        let current = spot.node;
        if current & LEAF == 0 {
            let node = &self.nodes[current as usize];
            let (enter, mut met) = slabs.enter::<R>(node, best.t);
            if met != 0 {
                let lane = met.trailing_zeros() as usize & 7;
                met &= met - 1;
                let mut nearest = (node.children[lane], enter[lane]);
                // The nearest is next; the others go onto the stack, nearer ones above.
                let base = spot.height;
                while met != 0 {
                    let lane = met.trailing_zeros() as usize & 7;
                    met &= met - 1;
                    let mut entry = (node.children[lane], enter[lane]);
                    if entry.1 < nearest.1 {
                        std::mem::swap(&mut entry, &mut nearest);
                    }
                    let mut at = spot.height;
                    while at > base && stack[at - 1].1 < entry.1 {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = entry;
                    spot.height += 1;
                }
                spot.node = nearest.0;
                return false;
            }
        } else if L::HAS_PLACED && current & PLACED == PLACED {
            L::closest::<R>(self, current & !PLACED, walk, best, &mut stack[spot.height..]);
        } else {
            let shear = [R::splat(walk.shear[0]), R::splat(walk.shear[1]), R::splat(walk.shear[2])];
            match self.blocks.at(current & !LEAF) {
                AnyBlock::Narrow(block) => self.improve::<R, _>(&block, walk, shear, best),
                AnyBlock::Wide(block) => self.improve::<R, _>(&block, walk, shear, best),
            }
        }
        while spot.height > 0 {
            spot.height -= 1;
            let (next, enter) = stack[spot.height];
            if enter <= best.t {
                spot.node = next;
                return false;
            }
        }
        true
    }

    /// [`Accel::occluded`] with lanes of at most eight.
    #[inline(always)]
    pub(crate) fn occluded_lanes<R: Real>(&self, ray: &Ray, stack: &mut Stack) -> bool {
        !self.nodes.is_empty() && self.occluded_from::<R, WorldTree>(0, &Walk::new(ray), ray.t_max, stack)
    }

    /// Whether anything below a node is met.
    #[inline(always)]
    pub(super) fn occluded_from<R: Real, L: Level>(
        &self,
        node: u32,
        walk: &Walk,
        t_max: f32,
        stack: &mut [(u32, f32)],
    ) -> bool {
        let slabs = Slabs::new(walk);
        let mut spot = Cursor { node, height: 0 };
        loop {
            match self.step_to_any::<R, L>(&mut spot, &slabs, walk, t_max, stack) {
                Progress::Left => {}
                Progress::Stopped => return true,
                Progress::Passed => return false,
            }
        }
    }

    /// One step of a ray that anything stops: a node, a block or a placed mesh.
    #[inline(always)]
    pub(super) fn step_to_any<R: Real, L: Level>(
        &self,
        spot: &mut Cursor,
        slabs: &Slabs,
        walk: &Walk,
        t_max: f32,
        stack: &mut [(u32, f32)],
    ) -> Progress {
        let current = spot.node;
        if current & LEAF == 0 {
            let node = &self.nodes[current as usize];
            let (_, mut met) = slabs.enter::<R>(node, t_max);
            while met != 0 {
                let lane = met.trailing_zeros() as usize & 7;
                met &= met - 1;
                stack[spot.height].0 = node.children[lane];
                spot.height += 1;
            }
        } else if L::HAS_PLACED && current & PLACED == PLACED {
            if L::occluded::<R>(self, current & !PLACED, walk, t_max, &mut stack[spot.height..]) {
                return Progress::Stopped;
            }
        } else {
            let shear = [R::splat(walk.shear[0]), R::splat(walk.shear[1]), R::splat(walk.shear[2])];
            let stopped = match self.blocks.at(current & !LEAF) {
                AnyBlock::Narrow(block) => self.stops::<R, _>(&block, walk, shear, t_max),
                AnyBlock::Wide(block) => self.stops::<R, _>(&block, walk, shear, t_max),
            };
            if stopped {
                return Progress::Stopped;
            }
        }
        if spot.height == 0 {
            return Progress::Passed;
        }
        spot.height -= 1;
        spot.node = stack[spot.height].0;
        Progress::Left
    }

    /// Whether anything in a block is met.
    #[inline(always)]
    fn stops<R: Real, const LEN: usize>(&self, block: &Block<'_, LEN>, walk: &Walk, shear: [R; 3], t_max: f32) -> bool {
        let mut at = 0;
        while at < Block::<LEN>::WIDTH {
            let found = intersect_lanes(seen_from(walk, block.triangles, at), shear, R::splat(t_max));
            if found.met.bits() & Block::<LEN>::LANES != 0 {
                return true;
            }
            let unsure = found.edges.bits() & Block::<LEN>::LANES;
            if unsure != 0 {
                let mut best = Best::none(t_max);
                block.decide(walk, unsure << at, &mut best);
                if best.hit().is_some() {
                    return true;
                }
            }
            at += R::N;
        }
        if !block.has_curved() {
            return false;
        }
        let mut best = Best::none(t_max);
        self.improve_curved(block, walk.origin, walk.direction, &mut best);
        best.hit().is_some()
    }

    /// The nearest hit, if any; of several at one distance, that of the lowest primitive.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        self.closest_lanes::<f32>(ray, &mut [(0, 0.0); STACK])
    }

    /// True if anything is met before the ray's end.
    pub fn occluded(&self, ray: &Ray) -> bool {
        self.occluded_lanes::<f32>(ray, &mut [(0, 0.0); STACK])
    }

    /// The nearest hit by trying every primitive: what [`Accel::closest`] must find.
    #[cfg(test)]
    pub(super) fn closest_by_force(&self, ray: &Ray) -> Option<Hit> {
        let mut best = Best::none(ray.t_max);
        self.force(0, &Walk::new(ray), &mut best);
        best.hit()
    }

    #[cfg(test)]
    fn force(&self, node: u32, walk: &Walk, best: &mut Best) {
        let Some(node) = self.nodes.get(node as usize) else { return };
        for child in 0..super::WIDE {
            if node.planes[0][child] > node.planes[1][child] {
                break;
            }
            let which = node.children[child];
            if which & LEAF == 0 {
                self.force(which, walk, best);
            } else if which & PLACED == PLACED {
                let (local, root) = self.enter(which & !PLACED, walk.origin, walk.direction);
                let mut own = Best::none(best.t / root.unit);
                self.force(root.node, &Walk::new(&local), &mut own);
                own.merge(root, best);
            } else {
                match self.blocks.at(which & !LEAF) {
                    AnyBlock::Narrow(block) => self.improve::<f32, _>(&block, walk, walk.shear, best),
                    AnyBlock::Wide(block) => self.improve::<f32, _>(&block, walk, walk.shear, best),
                }
            }
        }
    }
}

impl<const LEN: usize> Block<'_, LEN> {
    /// Decides lanes whose edge the ray goes through.
    #[cold]
    pub(super) fn decide(&self, walk: &Walk, mut unsure: u32, best: &mut Best) {
        while unsure != 0 {
            let lane = unsure.trailing_zeros() as usize;
            unsure &= unsure - 1;
            if let Some(found) = intersect_triangle(walk, &self.triangles.lane(lane), best.t) {
                best.take(found.t, found.u, found.v, self.primitive(lane));
            }
        }
    }
}
