//! Traversal by packets.

use super::{
    Accel, CURVED, LEAF, NONE, PLACED, Root, SPARE, Stack, WIDE,
    block::{AnyBlock, Block},
    leaves::bits,
    level::{Level, WorldTree},
    packet::{Packet, PacketHits, axis},
};
use crate::{
    geometry::{gamma, intersect_lanes, intersect_triangle},
    lanes::{Integer, Mask, Real, Triple},
};

impl Accel {
    /// The nearest hits of a packet: those of [`Accel::closest`], ray by ray.
    #[inline(always)]
    pub(crate) fn closest_packet<R: Real, T: Real>(
        &self,
        rays: &Packet<R>,
        mask: R::Mask,
        stack: &mut Stack,
    ) -> PacketHits<R> {
        let none = R::Integer::splat(-1);
        let mut best = PacketHits { t: R::splat(f32::MAX), u: R::zero(), v: R::zero(), primitive: none };
        if !self.nodes.is_empty() {
            self.closest_packet_from::<R, T, WorldTree>(0, rays, mask, &mut best, stack);
        }
        best
    }

    /// Looks below a root for what is nearer than the best hits of a packet.
    #[inline(always)]
    pub(super) fn closest_packet_from<R: Real, T: Real, L: Level>(
        &self,
        root: u32,
        rays: &Packet<R>,
        mask: R::Mask,
        best: &mut PacketHits<R>,
        stack: &mut [(u32, f32)],
    ) {
        stack[0].0 = root;
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (current, _) = stack[height];
            if L::HAS_PLACED && current & PLACED == PLACED {
                L::packet::<R, T>(self, current & !PLACED, rays, mask, best, &mut stack[height..]);
                continue;
            }
            if current & LEAF != 0 {
                match self.blocks.at(current & !LEAF) {
                    AnyBlock::Narrow(block) => self.meet_packet(&block, rays, mask, best),
                    AnyBlock::Wide(block) => self.meet_packet(&block, rays, mask, best),
                }
                continue;
            }
            let node = &self.nodes[current as usize];
            let base = height;
            for child in 0..WIDE {
                let plane = |row: usize| node.planes[row][child];
                if plane(0) > plane(1) {
                    // Used children come first.
                    break;
                }
                macro_rules! distance {
                    ($axis:ident, $row:expr) => {
                        (R::splat(plane($row)) - rays.origin.$axis) * rays.inverse.$axis
                    };
                }
                let [a, b, c] = rays.near;
                let enter = distance!(x, a).max(distance!(y, b)).max(distance!(z, c).max(R::zero()));
                let leave = distance!(x, a ^ 1).min(distance!(y, b ^ 1)).min(distance!(z, c ^ 1));
                let leave = (leave * (1.0 + 2.0 * gamma(3))).min(best.t);
                let met = (enter.le(leave) & mask).bits();
                if met != 0 {
                    let mut entries = [0.0; 16];
                    enter.store(&mut entries);
                    let entry = (node.children[child], entries[met.trailing_zeros() as usize & 15]);
                    let mut at = height;
                    while at > base && stack[at - 1].1 < entry.1 {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = entry;
                    height += 1;
                }
            }
        }
    }

    #[inline(always)]
    fn meet_packet<R: Real, const LEN: usize>(
        &self,
        block: &Block<'_, LEN>,
        rays: &Packet<R>,
        mask: R::Mask,
        best: &mut PacketHits<R>,
    ) {
        let [kx, ky, kz] = rays.axes;
        let all = block.triangles;
        let (ox, oy, oz) = (axis(&rays.origin, kx), axis(&rays.origin, ky), axis(&rays.origin, kz));
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
            let found = intersect_lanes([vertex!(0), vertex!(1), vertex!(2)], rays.shear, best.t);
            best.improve(found.t, found.u, found.v, R::Integer::splat(primitive as i32), found.met & mask);
            let mut unsure = (found.edges & mask).bits();
            while unsure != 0 {
                let ray = unsure.trailing_zeros() as usize;
                unsure &= unsure - 1;
                if let Some(hit) = intersect_triangle(&rays.walk(ray), &block.triangles.lane(lane), f32::MAX) {
                    let own = R::Mask::from_bits(1 << ray);
                    let [t, u, v] = [hit.t, hit.u, hit.v].map(R::splat);
                    best.improve(t, u, v, R::Integer::splat(primitive as i32), own & t.le(best.t));
                }
            }
        }
        if block.has_curved() {
            self.meet_packet_curved(block, rays, mask, best);
        }
    }

    #[inline(always)]
    fn meet_packet_curved<R: Real, const LEN: usize>(
        &self,
        block: &Block<'_, LEN>,
        rays: &Packet<R>,
        mask: R::Mask,
        best: &mut PacketHits<R>,
    ) {
        let own = rays.rows();
        let mut lane = 0;
        while let Some(place) = block.curved(lane) {
            lane += 1;
            let (primitive, curved) = &self.curved[place];
            let mut ends = [0.0; SPARE];
            best.t.store(&mut ends);
            let ([t, u, v], met) = curved.intersect_all(&own, &ends);
            let met = mask & R::Mask::from_bits(bits(&met));
            let number = R::Integer::splat(*primitive as i32);
            best.improve(R::load(&t), R::load(&u), R::load(&v), number, met);
        }
    }
}

impl<R: Real> PacketHits<R> {
    /// Takes hits not beyond the best into account; of those at one distance the lowest primitive counts.
    #[inline(always)]
    fn improve(&mut self, t: R, u: R, v: R, number: R::Integer, met: R::Mask) {
        if !met.any() {
            return;
        }
        let lower = R::same(self.primitive.max(number), self.primitive);
        let better = met & (t.lt(self.t) | lower);
        self.t = R::select(better, t, self.t);
        self.u = R::select(better, u, self.u);
        self.v = R::select(better, v, self.v);
        self.primitive = R::select_integer(better, number, self.primitive);
    }

    /// Takes the hits of a mask with a placed mesh.
    #[inline(always)]
    pub(super) fn merge(&mut self, found: &Self, root: Root, met: R::Mask) {
        let number = found.primitive + R::Integer::splat(root.first as i32);
        self.improve(found.t * root.unit, found.u, found.v, number, met);
    }
}
