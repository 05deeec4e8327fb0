//! Leaves met by lists of rays, as many rays side by side as there are lanes.

use super::{
    Accel, CURVED, Curved, NONE, SPARE,
    best::Best,
    block::Block,
    set::{Set, Sweep},
};
use crate::{
    geometry::{Rays, Sphere, intersect_lanes},
    lanes::{Integer, Mask, Real, Triple},
};

/// The best hits of the lanes, and the lanes where they are better than what was known.
struct Bests<R: Real> {
    t: R,
    u: R,
    v: R,
    primitive: R::Integer,
    better: R::Mask,
}

impl<R: Real> Bests<R> {
    /// Takes hits not beyond the best; of those at one distance the lowest primitive counts. `known` are the primitives
    /// that rays have met elsewhere.
    #[inline(always)]
    fn take(&mut self, met: R::Mask, [t, u, v]: [R; 3], primitive: u32, known: &[u32], at: R::Integer) {
        let mut own = met & t.lt(self.t);
        let tie = met & t.equals(self.t);
        let number = R::Integer::splat(primitive as i32);
        if tie.any() {
            let current = R::select_integer(self.better, self.primitive, R::gather_integer(known, at));
            // None is -1, and what ends a ray without being met.
            let none = R::same(current, R::Integer::splat(-1));
            own = own | (tie & (none | R::same(current.max(number), current)));
        }
        self.t = R::select(own, t, self.t);
        self.u = R::select(own, u, self.u);
        self.v = R::select(own, v, self.v);
        self.primitive = R::select_integer(own, number, self.primitive);
        self.better = self.better | own;
    }
}

impl Accel {
    /// Meets what is in a leaf with the first rays of a list.
    #[inline(always)]
    pub(super) fn sweep_block<R: Real, const ANY: bool, const LEN: usize>(
        &self,
        block: &Block<'_, LEN>,
        list: &[u32],
        len: usize,
        axes: [usize; 3],
        set: &mut Set<'_>,
        memory: &mut Sweep,
    ) {
        let [kx, ky, kz] = axes;
        let all = block.triangles;
        for k in (0..len).step_by(R::N) {
            let list = &list[k..];
            let at = R::Integer::load(list);
            let mut mask = R::Mask::from_bits(u32::MAX >> (32 - R::N.min(len - k)));
            let [ox, oy, oz, sx, sy, sz, t, _] = R::columns(&memory.rays, at + at + R::Integer::splat(1));
            if ANY {
                mask = mask & t.ge(R::zero());
                if !mask.any() {
                    continue;
                }
            }
            let none = R::Mask::from_bits(0);
            let mut best = Bests { t, u: R::zero(), v: R::zero(), primitive: R::Integer::splat(-1), better: none };
            for lane in 0..Block::<LEN>::WIDTH {
                let primitive = block.primitive(lane);
                if primitive == NONE {
                    break;
                }
                if primitive & CURVED != 0 {
                    continue;
                }
                macro_rules! vertex {
                    ($v:expr) => {{
                        let (x, y, z) = (all.row($v, kx, lane)[0], all.row($v, ky, lane)[0], all.row($v, kz, lane)[0]);
                        Triple::new(R::splat(x) - ox, R::splat(y) - oy, R::splat(z) - oz)
                    }};
                }
                let found = intersect_lanes([vertex!(0), vertex!(1), vertex!(2)], [sx, sy, sz], best.t);
                let met = found.met & mask;
                if ANY {
                    best.better = best.better | met;
                } else if met.any() {
                    best.take(met, [found.t, found.u, found.v], primitive, set.primitive, at);
                }
                let unsure = (found.edges & mask).bits();
                if unsure != 0 {
                    best = self.sweep_unsure::<R, ANY, LEN>(block, lane, list, unsure, axes, set, memory, best);
                }
            }
            if block.has_curved() {
                self.sweep_curved::<R, ANY, LEN>(block, at, mask, set, &mut best);
            }
            let mut bits = best.better.bits();
            if bits == 0 {
                continue;
            }
            if ANY {
                while bits != 0 {
                    memory.end(list[bits.trailing_zeros() as usize % SPARE] as usize, -1.0);
                    bits &= bits - 1;
                }
                continue;
            }
            let (mut rows, mut primitives) = ([[0.0; SPARE]; 3], [0; SPARE]);
            best.t.store(&mut rows[0]);
            best.u.store(&mut rows[1]);
            best.v.store(&mut rows[2]);
            best.primitive.store(&mut primitives);
            while bits != 0 {
                let ray = bits.trailing_zeros() as usize % SPARE;
                bits &= bits - 1;
                set.keep(list[ray] as usize, rows[1][ray], rows[2][ray], primitives[ray]);
                memory.end(list[ray] as usize, rows[0][ray]);
            }
        }
    }

    /// Decides a triangle whose edge some rays go through.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "what a leaf's loop has at hand")]
    fn sweep_unsure<R: Real, const ANY: bool, const LEN: usize>(
        &self,
        block: &Block<'_, LEN>,
        lane: usize,
        list: &[u32],
        mut unsure: u32,
        axes: [usize; 3],
        set: &Set<'_>,
        memory: &Sweep,
        mut best: Bests<R>,
    ) -> Bests<R> {
        let (mut ends, mut primitives) = ([0.0; SPARE], [0; SPARE]);
        best.t.store(&mut ends);
        best.primitive.store(&mut primitives);
        let better = best.better.bits();
        while unsure != 0 {
            let ray = unsure.trailing_zeros() as usize % SPARE;
            unsure &= unsure - 1;
            let at = list[ray] as usize;
            let walk = memory.walk(at, set, axes);
            let known = if better >> ray & 1 == 1 { primitives[ray] } else { set.primitive[at] };
            let primitive = if ANY { u32::MAX } else { known };
            let mut found = Best { t: ends[ray], u: 0.0, v: 0.0, primitive };
            block.decide(&walk, 1 << lane, &mut found);
            if found.primitive != primitive {
                let own = R::Mask::from_bits(1 << ray);
                best.t = R::select(own, R::splat(found.t), best.t);
                best.u = R::select(own, R::splat(found.u), best.u);
                best.v = R::select(own, R::splat(found.v), best.v);
                best.primitive = R::select_integer(own, R::Integer::splat(found.primitive as i32), best.primitive);
                best.better = best.better | own;
            }
        }
        best
    }

    /// Meets what is curved in a leaf.
    #[inline(always)]
    fn sweep_curved<R: Real, const ANY: bool, const LEN: usize>(
        &self,
        block: &Block<'_, LEN>,
        at: R::Integer,
        mask: R::Mask,
        set: &Set<'_>,
        best: &mut Bests<R>,
    ) {
        let mut rays = Rays { origin: [[0.0; SPARE]; 3], direction: [[0.0; SPARE]; 3] };
        for axis in 0..3 {
            R::gather(set.origin[axis], at).store(&mut rays.origin[axis]);
            R::gather(set.direction[axis], at).store(&mut rays.direction[axis]);
        }
        let mut lane = 0;
        while let Some(place) = block.curved(lane) {
            lane += 1;
            let (primitive, curved) = &self.curved[place];
            let mut ends = [0.0; SPARE];
            best.t.store(&mut ends);
            let (found, met) = curved.intersect_all(&rays, &ends);
            let met = mask & R::Mask::from_bits(bits(&met));
            if ANY {
                best.better = best.better | met;
            } else if met.any() {
                let [t, u, v] = found;
                let hit = [R::load(&t), R::load(&u), R::load(&v)];
                best.take(met, hit, *primitive, set.primitive, at);
            }
        }
    }
}

#[inline(always)]
pub(super) fn bits(met: &[bool; SPARE]) -> u32 {
    met.iter().enumerate().fold(0, |all, (lane, met)| all | u32::from(*met) << lane)
}

impl Curved {
    /// Distances and coordinates of many rays, and which of them meet it.
    #[inline(always)]
    pub(super) fn intersect_all<const N: usize>(&self, rays: &Rays<N>, t_max: &[f32; N]) -> ([[f32; N]; 3], [bool; N]) {
        match self {
            Self::Sphere { center, radius } => {
                let (t, met) = Sphere::intersect_all(*center, *radius, rays, t_max);
                ([t, [0.0; N], [0.0; N]], met)
            }
            Self::Disk(disk) => disk.intersect_all(rays, t_max),
        }
    }
}
