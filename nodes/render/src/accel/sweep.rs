//! Traversal by many rays at once that go nearly the same way in no sense but their signs: nodes are visited with lists
//! of the rays that meet them, as many rays side by side as there are lanes.
//!
//! After Barringer, Akenine-Moeller 2014, *Dynamic Ray Stream Traversal*. A ray finds the same hit as with
//! [`Accel::closest`], independent of the list: the order of visits changes no result.

use super::{
    Accel, LEAF, PLACED, SPARE, STACK, WIDE,
    best::{Best, Progress},
    block::AnyBlock,
    interleave::{Flight, TURNS},
    level::{Level, WorldTree},
    set::{END, Set, Sweep, Visit},
};
use crate::{
    geometry::gamma,
    lanes::{Integer, Mask, Real, Triple, ask_for},
};

/// Lists of no more are followed ray by ray.
const FEW: usize = 4;
/// Lists of no more are followed by turns, where the tree is large and nearest hits are looked for.
const FEW_BY_TURNS: usize = 64;
/// Lists of no more wait to be followed by turns, where the tree is large and anything stops a ray: it may visit nodes
/// in any order.
const FEW_TO_ANY: usize = 16;
/// So many that wait are followed.
const MANY_WAIT: usize = 1024;

/// Octants times longest axes.
const GROUPS: usize = 24;

/// What the rays of a group have in common.
struct Common {
    near: [usize; 3],
    axes: [usize; 3],
    signs: [f32; 3],
}

impl Accel {
    /// Meets all rays of a set: their nearest hits, or with `ANY` whether they are stopped.
    #[inline(always)]
    pub(crate) fn sweep<R: Real, T: Real, const ANY: bool>(&self, set: &mut Set<'_>, count: usize, memory: &mut Sweep) {
        if self.nodes.is_empty() || count == 0 {
            return;
        }
        self.sweep_from::<R, T, WorldTree, ANY>(0, set, count, memory);
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
        let by_turns = self.is_large;
        let few = if !by_turns {
            FEW
        } else if ANY {
            FEW_TO_ANY
        } else {
            FEW_BY_TURNS
        };
        while let Some(visit) = visits.pop() {
            if visit.len <= few {
                let list = &lists[visit.start..visit.start + visit.len];
                if by_turns && (ANY || visit.len > 1) {
                    for at in list {
                        memory.pending.push((visit.node, *at));
                    }
                    if !ANY || memory.pending.len() >= MANY_WAIT {
                        self.follow_by_turns::<T, L, ANY>(&common, set, memory);
                    }
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
                let (list, len, axes) = (&lists[visit.start..], visit.len, common.axes);
                match self.blocks.at(visit.node & !LEAF) {
                    AnyBlock::Narrow(block) => self.sweep_block::<R, ANY, _>(&block, list, len, axes, set, memory),
                    AnyBlock::Wide(block) => self.sweep_block::<R, ANY, _>(&block, list, len, axes, set, memory),
                }
            }
        }
        if by_turns && ANY {
            self.follow_by_turns::<T, L, ANY>(&common, set, memory);
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

    /// The rays that wait, each from its node on, by turns.
    #[inline(always)]
    fn follow_by_turns<T: Real, L: Level, const ANY: bool>(
        &self,
        common: &Common,
        set: &mut Set<'_>,
        memory: &mut Sweep,
    ) {
        let mut flights = std::mem::take(&mut memory.flights);
        if flights.len() < TURNS {
            flights.resize_with(TURNS, Flight::default);
        }
        let mut pending = std::mem::take(&mut memory.pending);
        // Rays that have begun come first.
        let mut order: [usize; TURNS] = std::array::from_fn(|k| k);
        let mut live = 0;
        loop {
            while live < TURNS {
                let Some((node, at)) = pending.pop() else { break };
                let at = at as usize;
                let t = memory.rays[at].0[END];
                if ANY && t < 0.0 {
                    continue;
                }
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
                let Flight { walk, slabs, best, spot, stack, at } = &mut flights[order[turn]];
                let progress = if ANY {
                    self.step_to_any::<T, L>(spot, slabs, walk, best.t, stack)
                } else if self.step::<T, L>(spot, slabs, walk, best, stack) {
                    Progress::Passed
                } else {
                    Progress::Left
                };
                match progress {
                    Progress::Left => {
                        self.ask_for(spot.node);
                        turn += 1;
                        continue;
                    }
                    Progress::Stopped => memory.end(*at, -1.0),
                    Progress::Passed if ANY => {}
                    Progress::Passed => {
                        set.keep(*at, best.u, best.v, best.primitive);
                        memory.end(*at, best.t);
                    }
                }
                live -= 1;
                order.swap(turn, live);
            }
        }
        (memory.flights, memory.pending) = (flights, pending);
    }

    /// Asks the memory for what is visited next.
    #[inline(always)]
    fn ask_for(&self, next: u32) {
        if next & LEAF == 0 {
            ask_for(&self.nodes, next as usize);
        } else if next & PLACED != PLACED {
            self.blocks.ask_for(next & !LEAF);
        }
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
