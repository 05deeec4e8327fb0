//! Traversal by many rays at once that go nearly the same way in no sense but their signs: nodes are visited with lists of
//! the rays that meet them, as many rays side by side as there are lanes.
//!
//! After Barringer, Akenine-Moeller 2014, *Dynamic Ray Stream Traversal*. What a ray finds is what [`Accel::closest`]
//! finds, whatever else is in the list: the order of visits changes no result.

use super::{Accel, Block, LEAF, Stack, WIDE, traverse::Best};
use crate::{
    geometry::{Ray, Walk, gamma, intersect_lanes},
    lanes::{Mask, Real, Triple, Whole},
};
use glam::Vec3;

/// Lanes at most; lists have as many entries to spare.
const SPARE: usize = 16;
/// Lists that are shorter are followed ray by ray.
const FEW: usize = 2;
/// Octants times longest axes.
const GROUPS: usize = 24;

/// Rays by rows, and what they have met. Rows have lanes to spare.
pub(crate) struct Set<'a> {
    pub(crate) origin: [&'a [f32]; 3],
    pub(crate) direction: [&'a [f32]; 3],
    /// Ends; distances of what was met. Below 0 for rays that were stopped.
    pub(crate) t: &'a mut [f32],
    pub(crate) u: &'a mut [f32],
    pub(crate) v: &'a mut [f32],
    pub(crate) primitive: &'a mut [u32],
}

/// Memory that is kept from sweep to sweep.
#[derive(Default)]
pub(crate) struct Sweep {
    inverse: [Vec<f32>; 3],
    shear: [Vec<f32>; 3],
    group: Vec<u32>,
    lists: Vec<u32>,
    visits: Vec<Visit>,
}

/// A node to be visited by a list of rays.
#[derive(Clone, Copy)]
struct Visit {
    node: u32,
    start: usize,
    len: usize,
    /// Where lists may begin that this visit makes.
    free: usize,
}

/// What the rays of a group have in common.
struct Common {
    near: [usize; 3],
    axes: [usize; 3],
    signs: [f32; 3],
}

#[inline(always)]
fn gathered<R: Real>(rows: [&[f32]; 3], at: R::Whole) -> Triple<R> {
    Triple::new(R::gather(rows[0], at), R::gather(rows[1], at), R::gather(rows[2], at))
}

impl Set<'_> {
    #[inline(always)]
    fn ray(&self, at: usize) -> Ray {
        let ([ox, oy, oz], [dx, dy, dz]) = (self.origin, self.direction);
        let (origin, direction) = (Vec3::new(ox[at], oy[at], oz[at]), Vec3::new(dx[at], dy[at], dz[at]));
        Ray { origin, direction, t_max: self.t[at] }
    }

    #[inline(always)]
    fn best(&self, at: usize) -> Best {
        Best { t: self.t[at], u: self.u[at], v: self.v[at], primitive: self.primitive[at] }
    }

    #[inline(always)]
    fn keep(&mut self, at: usize, best: &Best) {
        (self.t[at], self.u[at], self.v[at], self.primitive[at]) = (best.t, best.u, best.v, best.primitive);
    }
}

/// A number in the lanes of a mask, 0 in the others.
#[inline(always)]
fn number<R: Real>(mask: R::Mask, value: i32) -> R::Whole {
    R::select_whole(mask, R::Whole::splat(value), R::Whole::splat(0))
}

impl Sweep {
    /// Reciprocals and shears, and the group of each ray.
    #[inline(always)]
    fn prepare<R: Real>(&mut self, set: &Set<'_>, count: usize) {
        let room = count + SPARE;
        for row in self.inverse.iter_mut().chain(&mut self.shear) {
            row.resize(row.len().max(room), 0.0);
        }
        self.group.resize(self.group.len().max(room), 0);
        let one = R::one();
        for at in (0..count).step_by(R::N) {
            let d = Triple::<R>::load(set.direction, at);
            let size = Triple::new(d.x.abs(), d.y.abs(), d.z.abs());
            super::packet::safe(d.x).store(&mut self.inverse[0][at..]);
            super::packet::safe(d.y).store(&mut self.inverse[1][at..]);
            super::packet::safe(d.z).store(&mut self.inverse[2][at..]);
            let zero = R::zero();
            let negative = [one.copysign(d.x).lt(zero), one.copysign(d.y).lt(zero), one.copysign(d.z).lt(zero)];
            let first = size.x.gt(size.y) & size.x.gt(size.z);
            let second = !size.x.gt(size.y) & size.y.gt(size.z);
            // The axes that follow the longest, in order, and its own; turned where it is negative.
            let along = R::select(first, d.x, R::select(second, d.y, d.z));
            let a = R::select(first, d.y, R::select(second, d.z, d.x));
            let b = R::select(first, d.z, R::select(second, d.x, d.y));
            let turned = along.lt(zero);
            (R::select(turned, b, a) / along).store(&mut self.shear[0][at..]);
            (R::select(turned, a, b) / along).store(&mut self.shear[1][at..]);
            (one / along).store(&mut self.shear[2][at..]);
            let axis = R::select_whole(
                first,
                R::Whole::splat(0),
                R::select_whole(second, R::Whole::splat(8), R::Whole::splat(16)),
            );
            let group = axis + number::<R>(negative[0], 1) + number::<R>(negative[1], 2) + number::<R>(negative[2], 4);
            group.store(&mut self.group[at..]);
        }
    }
}

impl Accel {
    /// Meets all rays of a set: their nearest hits, or with `ANY` whether they are stopped.
    #[inline(always)]
    pub(crate) fn sweep<R: Real, T: Real, const ANY: bool>(
        &self,
        set: &mut Set<'_>,
        count: usize,
        memory: &mut Sweep,
        stack: &mut Stack,
    ) {
        if self.nodes.is_empty() || count == 0 {
            return;
        }
        memory.prepare::<R>(set, count);
        let mut starts = [0usize; GROUPS + 1];
        for group in &memory.group[..count] {
            starts[*group as usize % GROUPS + 1] += 1;
        }
        for k in 0..GROUPS {
            starts[k + 1] += starts[k];
        }
        let mut lists = std::mem::take(&mut memory.lists);
        lists.resize(lists.len().max(count + SPARE), 0);
        let mut ends = starts;
        for (at, group) in memory.group[..count].iter().enumerate() {
            let end = &mut ends[*group as usize % GROUPS];
            lists[*end] = at as u32;
            *end += 1;
        }
        for group in 0..GROUPS {
            let (start, len) = (starts[group], starts[group + 1] - starts[group]);
            if len > 0 {
                let free = count + SPARE;
                self.sweep_group::<R, T, ANY>(
                    group,
                    set,
                    memory,
                    &mut lists,
                    Visit { node: 0, start, len, free },
                    stack,
                );
            }
        }
        memory.lists = lists;
    }

    #[inline(always)]
    fn sweep_group<R: Real, T: Real, const ANY: bool>(
        &self,
        group: usize,
        set: &mut Set<'_>,
        memory: &mut Sweep,
        lists: &mut Vec<u32>,
        root: Visit,
        stack: &mut Stack,
    ) {
        let sign = [group & 1, group >> 1 & 1, group >> 2 & 1];
        let kz = group >> 3;
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        if sign[kz] == 1 {
            std::mem::swap(&mut kx, &mut ky);
        }
        let signs = [1.0 - 2.0 * sign[0] as f32, 1.0 - 2.0 * sign[1] as f32, 1.0 - 2.0 * sign[2] as f32];
        let common = Common { near: [sign[0], 2 + sign[1], 4 + sign[2]], axes: [kx, ky, kz], signs };
        let mut visits = std::mem::take(&mut memory.visits);
        visits.clear();
        visits.push(root);
        while let Some(visit) = visits.pop() {
            if visit.len <= FEW {
                for at in &lists[visit.start..visit.start + visit.len] {
                    self.follow::<T, ANY>(visit.node, *at as usize, set, stack);
                }
            } else if visit.node & LEAF == 0 {
                self.sweep_node::<R>(visit, &common, set, memory, lists, &mut visits);
            } else {
                let block = &self.blocks[(visit.node & !LEAF) as usize];
                self.sweep_block::<R, ANY>(block, visit, &common, set, memory, lists);
            }
        }
        memory.visits = visits;
    }

    /// One ray from a node on.
    #[inline(always)]
    fn follow<T: Real, const ANY: bool>(&self, node: u32, at: usize, set: &mut Set<'_>, stack: &mut Stack) {
        let ray = set.ray(at);
        if ANY {
            if ray.t_max >= 0.0 && self.occluded_from::<T>(node, &ray, stack) {
                set.t[at] = -1.0;
            }
        } else {
            let mut best = set.best(at);
            self.closest_from::<T>(node, &ray, &mut best, stack);
            set.keep(at, &best);
        }
    }

    /// Sorts the rays of a list into those of the children that they meet.
    #[inline(always)]
    fn sweep_node<R: Real>(
        &self,
        visit: Visit,
        common: &Common,
        set: &Set<'_>,
        memory: &Sweep,
        lists: &mut Vec<u32>,
        visits: &mut Vec<Visit>,
    ) {
        let node = &self.nodes[visit.node as usize];
        let room = visit.len + SPARE;
        let free = visit.free + WIDE * room;
        if lists.len() < free {
            lists.resize(2 * free, 0);
        }
        let inverse = [memory.inverse[0].as_slice(), &memory.inverse[1], &memory.inverse[2]];
        let mut lens = [0usize; WIDE];
        for k in (0..visit.len).step_by(R::N) {
            let at = R::Whole::load(&lists[visit.start + k..]);
            let mask = R::Mask::from_bits(u32::MAX >> (32 - R::N.min(visit.len - k)));
            let (o, i) = (gathered::<R>(set.origin, at), gathered::<R>(inverse, at));
            let t = R::gather(set.t, at);
            for (child, len) in lens.iter_mut().enumerate() {
                if node.planes[0][child] > node.planes[1][child] {
                    // Used children come first.
                    break;
                }
                macro_rules! distance {
                    ($axis:ident, $row:expr) => {
                        (R::splat(node.planes[$row][child]) - o.$axis) * i.$axis
                    };
                }
                let [a, b, c] = common.near;
                let enter = distance!(x, a).max(distance!(y, b)).max(distance!(z, c).max(R::zero()));
                let leave = distance!(x, a ^ 1).min(distance!(y, b ^ 1)).min(distance!(z, c ^ 1));
                let leave = (leave * (1.0 + 2.0 * gamma(3))).min(t);
                let met = enter.le(leave) & mask;
                let bits = met.bits();
                if bits != 0 {
                    let to = visit.free + child * room + *len;
                    R::compress_whole(at, met, &mut lists[to..to + SPARE]);
                    *len += bits.count_ones() as usize;
                }
            }
        }
        // Nearer children last, so that they are visited first.
        let base = visits.len();
        let mut keys = [0.0f32; WIDE];
        for (child, len) in lens.into_iter().enumerate() {
            if len == 0 {
                continue;
            }
            let near = |axis: usize| common.signs[axis] * node.planes[common.near[axis]][child];
            let key = near(0) + near(1) + near(2);
            let mut at = visits.len();
            let start = visit.free + child * room;
            visits.push(Visit { node: node.children[child], start, len, free });
            while at > base && keys[at - 1 - base] < key {
                visits.swap(at, at - 1);
                keys[at - base] = keys[at - 1 - base];
                at -= 1;
            }
            keys[at - base] = key;
        }
    }

    /// Meets the triangles of a block.
    #[inline(always)]
    fn sweep_block<R: Real, const ANY: bool>(
        &self,
        block: &Block,
        visit: Visit,
        common: &Common,
        set: &mut Set<'_>,
        memory: &Sweep,
        lists: &[u32],
    ) {
        let [kx, ky, kz] = common.axes;
        for k in (0..visit.len).step_by(R::N) {
            let list = &lists[visit.start + k..];
            let at = R::Whole::load(list);
            let mask = R::Mask::from_bits(u32::MAX >> (32 - R::N.min(visit.len - k)));
            let [sx, sy, sz] = &memory.shear;
            let shear = [R::gather(sx, at), R::gather(sy, at), R::gather(sz, at)];
            let (ox, oy, oz) =
                (R::gather(set.origin[kx], at), R::gather(set.origin[ky], at), R::gather(set.origin[kz], at));
            let mut t = R::gather(set.t, at);
            for (lane, primitive) in block.primitives.into_iter().enumerate() {
                if primitive == u32::MAX {
                    break;
                }
                macro_rules! vertex {
                    ($v:expr) => {{
                        let at = &block.vertices[$v];
                        Triple::new(
                            R::splat(at[kx][lane]) - ox,
                            R::splat(at[ky][lane]) - oy,
                            R::splat(at[kz][lane]) - oz,
                        )
                    }};
                }
                let found = intersect_lanes([vertex!(0), vertex!(1), vertex!(2)], shear, t);
                let mut bits = (found.met & mask).bits();
                let mut unsure = (found.edges & mask).bits();
                if bits | unsure == 0 {
                    continue;
                }
                if ANY {
                    while bits != 0 {
                        set.t[list[bits.trailing_zeros() as usize % SPARE] as usize] = -1.0;
                        bits &= bits - 1;
                    }
                } else if bits != 0 {
                    let mut rows = [[0.0; SPARE]; 3];
                    found.t.store(&mut rows[0]);
                    found.u.store(&mut rows[1]);
                    found.v.store(&mut rows[2]);
                    while bits != 0 {
                        let ray = bits.trailing_zeros() as usize % SPARE;
                        bits &= bits - 1;
                        let index = list[ray] as usize;
                        let mut best = set.best(index);
                        best.take(rows[0][ray], rows[1][ray], rows[2][ray], primitive);
                        set.keep(index, &best);
                    }
                }
                while unsure != 0 {
                    let index = list[unsure.trailing_zeros() as usize % SPARE] as usize;
                    unsure &= unsure - 1;
                    self.sweep_unsure::<ANY>(block, lane, index, set);
                }
                t = R::gather(set.t, at);
            }
            if block.curved != 0 {
                for index in &list[..R::N.min(visit.len - k)] {
                    self.sweep_curved::<ANY>(block, *index as usize, set);
                }
            }
        }
    }

    /// Decides a triangle whose edge a ray goes through.
    #[cold]
    fn sweep_unsure<const ANY: bool>(&self, block: &Block, lane: usize, at: usize, set: &mut Set<'_>) {
        let mut best = if ANY { Best::none(set.t[at]) } else { set.best(at) };
        if best.t >= 0.0 {
            block.decide(&Walk::new(&set.ray(at)), 1 << lane, &mut best);
            set.note::<ANY>(at, &best);
        }
    }

    fn sweep_curved<const ANY: bool>(&self, block: &Block, at: usize, set: &mut Set<'_>) {
        let mut best = if ANY { Best::none(set.t[at]) } else { set.best(at) };
        if best.t >= 0.0 {
            let ray = set.ray(at);
            self.improve_curved(block, ray.origin, ray.direction, &mut best);
            set.note::<ANY>(at, &best);
        }
    }
}

impl Set<'_> {
    fn note<const ANY: bool>(&mut self, at: usize, best: &Best) {
        if !ANY {
            self.keep(at, best);
        } else if best.hit().is_some() {
            self.t[at] = -1.0;
        }
    }
}
