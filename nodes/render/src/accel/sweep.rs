//! Traversal by many rays at once that go nearly the same way in no sense but their signs: nodes are visited with lists
//! of the rays that meet them, as many rays side by side as there are lanes.
//!
//! After Barringer, Akenine-Moeller 2014, *Dynamic Ray Stream Traversal*. A ray finds the same hit as with
//! [`Accel::closest`], independent of the list: the order of visits changes no result.

use super::{
    Accel, LEAF, PLACED, STACK, WIDE,
    interleave::{Flight, TURNS},
    level::{Level, World},
    traverse::Best,
};
use crate::{
    geometry::{Walk, gamma},
    lanes::{Integer, Mask, Real, Record, Triple},
};
use glam::Vec3;

/// Lanes at most; lists have as many entries to spare.
pub(super) const SPARE: usize = 16;

/// Lists of no more are followed ray by ray.
const FEW: usize = 4;
/// Lists of no more are followed by turns, where the tree is large and nearest hits are looked for. Rays that are to be
/// stopped by anything meet the same nodes first, and gain more from each other.
const FEW_BY_TURNS: usize = 64;

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
    /// What nodes and leaves read of a ray: origin, reciprocal direction and the end of it; origin in the order of the
    /// ray's axes, shear and the end again. A ray that was stopped ends below 0.
    pub(super) rays: Vec<Record>,
    group: Vec<u32>,
    lists: Vec<u32>,
    visits: Vec<Visit>,
    stack: Vec<(u32, f32)>,
    flights: Vec<Flight>,
    /// Data of placed meshes.
    pub(super) below: Option<Box<Below>>,
}

/// Rays in the space of a placed mesh, and what they have met there.
#[derive(Default)]
pub(super) struct Below {
    pub(super) rows: [Vec<f32>; 6],
    pub(super) t: Vec<f32>,
    pub(super) u: Vec<f32>,
    pub(super) v: Vec<f32>,
    pub(super) primitive: Vec<u32>,
    pub(super) sweep: Sweep,
}

impl Below {
    /// Makes room for so many rays.
    pub(super) fn reserve(&mut self, rays: usize) {
        let room = rays + SPARE;
        if self.t.len() < room {
            for row in self.rows.iter_mut().chain([&mut self.t, &mut self.u, &mut self.v]) {
                row.resize(room, 0.0);
            }
            self.primitive.resize(room, u32::MAX);
        }
    }
}

/// Columns of a ray's halves: its end.
const END: usize = 6;

/// A node to be visited by a list of rays.
#[derive(Clone, Copy)]
struct Visit {
    node: u32,
    start: usize,
    len: usize,
    /// Where lists may begin that this visit makes.
    free: usize,
}

/// The common properties of the rays of a group.
struct Common {
    near: [usize; 3],
    axes: [usize; 3],
    signs: [f32; 3],
}

impl Set<'_> {
    #[inline(always)]
    pub(super) fn keep(&mut self, at: usize, u: f32, v: f32, primitive: u32) {
        (self.u[at], self.v[at], self.primitive[at]) = (u, v, primitive);
    }
}

/// A number in the lanes of a mask, 0 in the others.
#[inline(always)]
fn number<R: Real>(mask: R::Mask, value: i32) -> R::Integer {
    R::select_integer(mask, R::Integer::splat(value), R::Integer::splat(0))
}

impl Sweep {
    /// The ray data, and the group of each ray.
    #[inline(always)]
    fn prepare<R: Real>(&mut self, set: &Set<'_>, count: usize) {
        let room = count + SPARE;
        self.rays.resize(self.rays.len().max(room), Record::default());
        self.group.resize(self.group.len().max(room), 0);
        let (one, zero) = (R::one(), R::zero());
        for at in (0..count).step_by(R::N) {
            let (o, d) = (Triple::<R>::load(set.origin, at), Triple::<R>::load(set.direction, at));
            let end = R::load(&set.t[at..]);
            let size = d.abs();
            let inverse = [super::packet::safe(d.x), super::packet::safe(d.y), super::packet::safe(d.z)];
            let negative = [one.copysign(d.x).lt(zero), one.copysign(d.y).lt(zero), one.copysign(d.z).lt(zero)];
            let first = size.x.gt(size.y) & size.x.gt(size.z);
            let second = !size.x.gt(size.y) & size.y.gt(size.z);
            // The axes that follow the longest, in order, and its own; turned where it is negative.
            macro_rules! turned {
                ($x:expr, $y:expr, $z:expr, $turned:expr) => {{
                    let along = R::select(first, $x, R::select(second, $y, $z));
                    let a = R::select(first, $y, R::select(second, $z, $x));
                    let b = R::select(first, $z, R::select(second, $x, $y));
                    [R::select($turned, b, a), R::select($turned, a, b), along]
                }};
            }
            let along = R::select(first, d.x, R::select(second, d.y, d.z));
            let turned = along.lt(zero);
            let [ox, oy, oz] = turned!(o.x, o.y, o.z, turned);
            let [dx, dy, _] = turned!(d.x, d.y, d.z, turned);
            let to = &mut self.rays[at..];
            R::put_columns([o.x, o.y, o.z, inverse[0], inverse[1], inverse[2], end, zero], to, 0);
            R::put_columns([ox, oy, oz, dx / along, dy / along, one / along, end, zero], to, 1);
            let axis = R::select_integer(
                first,
                R::Integer::splat(0),
                R::select_integer(second, R::Integer::splat(8), R::Integer::splat(16)),
            );
            let group = axis + number::<R>(negative[0], 1) + number::<R>(negative[1], 2) + number::<R>(negative[2], 4);
            group.store(&mut self.group[at..]);
        }
    }

    /// A ray ends at what it has met.
    #[inline(always)]
    pub(super) fn end(&mut self, at: usize, t: f32) {
        let ray = &mut self.rays[at].0;
        (ray[END], ray[8 + END]) = (t, t);
    }

    /// Where a ray ends.
    #[inline(always)]
    pub(super) fn end_of(&self, at: usize) -> f32 {
        self.rays[at].0[END]
    }

    /// One ray, as single rays are followed.
    #[inline(always)]
    pub(super) fn walk(&self, at: usize, set: &Set<'_>, axes: [usize; 3]) -> Walk {
        let [x, y, z, ix, iy, iz, _, _, a, b, c, p, q, r, ..] = self.rays[at].0;
        let [dx, dy, dz] = set.direction;
        Walk {
            origin: Vec3::new(x, y, z),
            direction: Vec3::new(dx[at], dy[at], dz[at]),
            inverse: Vec3::new(ix, iy, iz),
            axes,
            start: [a, b, c],
            shear: [p, q, r],
        }
    }
}

impl Accel {
    /// Meets all rays of a set: their nearest hits, or with `ANY` whether they are stopped.
    #[inline(always)]
    pub(crate) fn sweep<R: Real, T: Real, const ANY: bool>(&self, set: &mut Set<'_>, count: usize, memory: &mut Sweep) {
        if self.nodes.is_empty() || count == 0 {
            return;
        }
        self.sweep_from::<R, T, World, ANY>(0, set, count, memory);
    }

    /// [`Accel::sweep`] below a root, for some rays.
    #[inline(always)]
    pub(super) fn sweep_from<R: Real, T: Real, L: Level, const ANY: bool>(
        &self,
        root: u32,
        set: &mut Set<'_>,
        count: usize,
        memory: &mut Sweep,
    ) {
        let mut stack = std::mem::take(&mut memory.stack);
        stack.resize(STACK, (0, 0.0));
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
                let root = Visit { node: root, start, len, free };
                self.sweep_group::<R, T, L, ANY>(group, set, memory, &mut lists, root, &mut stack);
            }
        }
        memory.lists = lists;
        memory.stack = stack;
        for (t, ray) in set.t.iter_mut().zip(&memory.rays[..count]) {
            *t = ray.0[END];
        }
    }

    #[inline(always)]
    fn sweep_group<R: Real, T: Real, L: Level, const ANY: bool>(
        &self,
        group: usize,
        set: &mut Set<'_>,
        memory: &mut Sweep,
        lists: &mut Vec<u32>,
        root: Visit,
        stack: &mut [(u32, f32)],
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
        let by_turns = self.is_large && !ANY;
        let few = if by_turns { FEW_BY_TURNS } else { FEW };
        while let Some(visit) = visits.pop() {
            if visit.len <= few {
                let list = &lists[visit.start..visit.start + visit.len];
                if by_turns && visit.len > 1 {
                    self.follow_by_turns::<T, L>(visit.node, list, &common, set, memory);
                } else {
                    for at in list {
                        self.follow::<T, L, ANY>(visit.node, *at as usize, &common, set, memory, stack);
                    }
                }
            } else if visit.node & LEAF == 0 {
                self.sweep_node::<R>(visit, &common, memory, lists, &mut visits);
            } else if L::HAS_PLACED && visit.node & PLACED == PLACED {
                let list = &lists[visit.start..visit.start + visit.len];
                L::sweep::<R, T, ANY>(self, visit.node & !PLACED, list, set, memory);
            } else {
                let block = &self.blocks[(visit.node & !LEAF) as usize];
                self.sweep_block::<R, ANY>(block, &lists[visit.start..], visit.len, common.axes, set, memory);
            }
        }
        memory.visits = visits;
    }

    /// One ray from a node on.
    #[inline(always)]
    fn follow<T: Real, L: Level, const ANY: bool>(
        &self,
        node: u32,
        at: usize,
        common: &Common,
        set: &mut Set<'_>,
        memory: &mut Sweep,
        stack: &mut [(u32, f32)],
    ) {
        let t = memory.rays[at].0[END];
        if ANY && t < 0.0 {
            return;
        }
        let walk = memory.walk(at, set, common.axes);
        if ANY {
            if self.occluded_from::<T, L>(node, &walk, t, stack) {
                memory.end(at, -1.0);
            }
        } else {
            let mut best = Best { t, u: set.u[at], v: set.v[at], primitive: set.primitive[at] };
            self.closest_from::<T, L>(node, &walk, &mut best, stack);
            set.keep(at, best.u, best.v, best.primitive);
            memory.end(at, best.t);
        }
    }

    /// The rays of a short list from a node on, by turns.
    #[inline(always)]
    fn follow_by_turns<T: Real, L: Level>(
        &self,
        node: u32,
        list: &[u32],
        common: &Common,
        set: &mut Set<'_>,
        memory: &mut Sweep,
    ) {
        let mut flights = std::mem::take(&mut memory.flights);
        if flights.len() < TURNS {
            flights.resize_with(TURNS, Flight::default);
        }
        let mut waiting = list.iter();
        // Those that are on their way come first.
        let mut order: [usize; TURNS] = std::array::from_fn(|k| k);
        let mut live = 0;
        loop {
            while live < TURNS {
                let Some(at) = waiting.next() else { break };
                let at = *at as usize;
                let t = memory.rays[at].0[END];
                let walk = memory.walk(at, set, common.axes);
                let best = Best { t, u: set.u[at], v: set.v[at], primitive: set.primitive[at] };
                flights[order[live]].begin(node, at, walk, best);
                live += 1;
            }
            if live == 0 {
                break;
            }
            let mut turn = 0;
            while turn < live {
                if !self.take_turn::<T, L>(&mut flights[order[turn]]) {
                    turn += 1;
                    continue;
                }
                let Flight { at, best, .. } = &flights[order[turn]];
                set.keep(*at, best.u, best.v, best.primitive);
                memory.end(*at, best.t);
                live -= 1;
                order.swap(turn, live);
            }
        }
        memory.flights = flights;
    }

    /// Sorts the rays of a list into those of the children that they meet.
    #[inline(always)]
    fn sweep_node<R: Real>(
        &self,
        visit: Visit,
        common: &Common,
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
        let mut lens = [0usize; WIDE];
        for k in (0..visit.len).step_by(R::N) {
            let at = R::Integer::load(&lists[visit.start + k..]);
            let mask = R::Mask::from_bits(u32::MAX >> (32 - R::N.min(visit.len - k)));
            let [ox, oy, oz, ix, iy, iz, t, _] = R::columns(&memory.rays, at + at);
            let (o, i) = (Triple::new(ox, oy, oz), Triple::new(ix, iy, iz));
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
                    R::compress_integer(at, met, &mut lists[to..to + SPARE]);
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
}
