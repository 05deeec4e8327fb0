//! Traversal by as many rays as there are lanes, for rays that go nearly the same way, as those of one pixel do.

use super::{
    Accel, Block, CURVED, LEAF, NONE, PLACED, Root, Stack, WIDE,
    leaves::bits,
    level::{Level, World},
    sweep::SPARE,
};
use crate::{
    geometry::{Ray, Rays, Walk, gamma, intersect_lanes, intersect_triangle, lane_of},
    lanes::{Integer, Mask, Real, Triple},
};

/// Hits by lane; a primitive of -1 is none.
pub(crate) struct PacketHits<R: Real> {
    pub(crate) t: R,
    pub(crate) u: R,
    pub(crate) v: R,
    pub(crate) primitive: R::Integer,
}

/// Rays by lane, without end, and what all have in common.
pub(crate) struct Packet<R: Real> {
    origin: Triple<R>,
    direction: Triple<R>,
    inverse: Triple<R>,
    near: [usize; 3],
    axes: [usize; 3],
    shear: [R; 3],
}

#[inline(always)]
fn axis<R: Real>(v: &Triple<R>, axis: usize) -> R {
    match axis {
        0 => v.x,
        1 => v.y,
        _ => v.z,
    }
}

/// 0 if no lane of `all` is in a mask, 1 if all are.
#[inline(always)]
fn side(mask: u32, all: u32) -> Option<usize> {
    match mask & all {
        0 => Some(0),
        some if some == all => Some(1),
        _ => None,
    }
}

/// Finite reciprocals, as [`Walk`] has them.
#[inline(always)]
pub(super) fn safe<R: Real>(v: R) -> R {
    R::select(v.abs().gt(R::splat(1e-18)), R::one() / v, R::splat(1e18).copysign(v))
}

impl<R: Real> Packet<R> {
    /// `None` if the rays of the mask differ in the signs of their directions or in the longest axis.
    #[inline(always)]
    pub(crate) fn new(origin: Triple<R>, direction: Triple<R>, mask: R::Mask) -> Option<Self> {
        let zero = R::zero();
        let size = direction.abs();
        let all = mask.bits();
        // As a single ray's walk has it: the signs of reciprocals, which those of -0 are part of.
        let one = R::one();
        let negative = [
            one.copysign(direction.x).lt(zero).bits(),
            one.copysign(direction.y).lt(zero).bits(),
            one.copysign(direction.z).lt(zero).bits(),
        ];
        let signs = [side(negative[0], all)?, side(negative[1], all)?, side(negative[2], all)?];
        let xy = side(size.x.gt(size.y).bits(), all)?;
        let xz = side(size.x.gt(size.z).bits(), all)?;
        let yz = side(size.y.gt(size.z).bits(), all)?;
        let kz = match (xy, xz, yz) {
            (1, 1, _) => 0,
            (1, 0, _) => 2,
            (_, _, 1) => 1,
            _ => 2,
        };
        let mut kx = (kz + 1) % 3;
        let mut ky = (kx + 1) % 3;
        let longest = axis(&direction, kz);
        if side(longest.lt(zero).bits(), all)? == 1 {
            std::mem::swap(&mut kx, &mut ky);
        }
        Some(Self {
            origin,
            direction,
            inverse: Triple::new(safe(direction.x), safe(direction.y), safe(direction.z)),
            near: [signs[0], 2 + signs[1], 4 + signs[2]],
            axes: [kx, ky, kz],
            shear: [axis(&direction, kx) / longest, axis(&direction, ky) / longest, one / longest],
        })
    }

    /// The rays by component.
    #[inline(always)]
    pub(super) fn rows(&self) -> Rays<SPARE> {
        let mut own = Rays { origin: [[0.0; SPARE]; 3], direction: [[0.0; SPARE]; 3] };
        let (o, d) = (self.origin, self.direction);
        for (axis, (o, d)) in [(o.x, d.x), (o.y, d.y), (o.z, d.z)].into_iter().enumerate() {
            o.store(&mut own.origin[axis]);
            d.store(&mut own.direction[axis]);
        }
        own
    }

    /// The ray of one lane.
    fn walk(&self, lane: usize) -> Walk {
        Walk::new(&Ray::new(self.origin.lane(lane), self.direction.lane(lane)))
    }
}

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
            self.closest_packet_from::<R, T, World>(0, rays, mask, &mut best, stack);
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
                self.meet_packet(&self.blocks[(current & !LEAF) as usize], rays, mask, best);
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
    fn meet_packet<R: Real>(&self, block: &Block, rays: &Packet<R>, mask: R::Mask, best: &mut PacketHits<R>) {
        let [kx, ky, kz] = rays.axes;
        let (ox, oy, oz) = (axis(&rays.origin, kx), axis(&rays.origin, ky), axis(&rays.origin, kz));
        for lane in 0..8 {
            let primitive = block.primitives[lane];
            if primitive == NONE {
                break;
            }
            if primitive & CURVED != 0 {
                continue;
            }
            macro_rules! vertex {
                ($v:expr) => {{
                    let at = &block.vertices[$v];
                    Triple::new(R::splat(at[kx][lane]) - ox, R::splat(at[ky][lane]) - oy, R::splat(at[kz][lane]) - oz)
                }};
            }
            let found = intersect_lanes([vertex!(0), vertex!(1), vertex!(2)], rays.shear, best.t);
            best.improve(found.t, found.u, found.v, R::Integer::splat(primitive as i32), found.met & mask);
            let mut unsure = (found.edges & mask).bits();
            while unsure != 0 {
                let ray = unsure.trailing_zeros() as usize;
                unsure &= unsure - 1;
                if let Some(hit) = intersect_triangle(&rays.walk(ray), &lane_of(&block.vertices, lane), f32::MAX) {
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
    fn meet_packet_curved<R: Real>(&self, block: &Block, rays: &Packet<R>, mask: R::Mask, best: &mut PacketHits<R>) {
        let own = rays.rows();
        for place in block.primitives {
            if place == NONE || place & CURVED == 0 {
                break;
            }
            let (primitive, curved) = &self.curved[(place & !CURVED) as usize];
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
