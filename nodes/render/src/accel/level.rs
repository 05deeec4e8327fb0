//! The two levels of a hierarchy: the world's tree, some of whose leaves are placed meshes, and the trees of these,
//! which have none.
//!
//! Kernels are generic over the level that they traverse, so that each is one straight function. A ray in a mesh's
//! space has the distances of the ray in the world but for a power of two, so that hits compare without rounding.

use super::{
    Accel, Root,
    packet::{Packet, PacketHits},
    sweep::{SPARE, Set, Sweep},
    traverse::Best,
};
use crate::{
    geometry::{Ray, Rays, Walk},
    lanes::{Integer, Mask, Real, Triple},
};
use glam::Vec3;

/// The action at a placed mesh.
pub(super) trait Level {
    /// Whether there are any.
    const HAS_PLACED: bool;

    /// One ray's nearest hit.
    fn closest<T: Real>(accel: &Accel, which: u32, walk: &Walk, best: &mut Best, stack: &mut [(u32, f32)]);

    /// Whether one ray meets anything.
    fn occluded<T: Real>(accel: &Accel, which: u32, walk: &Walk, t_max: f32, stack: &mut [(u32, f32)]) -> bool;

    /// A list of rays.
    fn sweep<R: Real, T: Real, const ANY: bool>(
        accel: &Accel,
        which: u32,
        list: &[u32],
        set: &mut Set<'_>,
        memory: &mut Sweep,
    );

    /// Rays that go nearly the same way.
    fn packet<R: Real, T: Real>(
        accel: &Accel,
        which: u32,
        rays: &Packet<R>,
        mask: R::Mask,
        best: &mut PacketHits<R>,
        stack: &mut [(u32, f32)],
    );
}

/// The world's tree.
pub(super) struct World;

/// The tree of a placed mesh.
pub(super) struct Mesh;

impl Accel {
    /// A ray in the space of a placed mesh, and the mesh's tree.
    #[inline(always)]
    pub(super) fn enter(&self, which: u32, origin: Vec3, direction: Vec3) -> (Ray, Root) {
        let ray = Rays { origin: origin.to_array().map(|v| [v]), direction: direction.to_array().map(|v| [v]) };
        let root = self.roots[which as usize];
        let own = self.placements.enter(which, root.unit, &ray);
        let [[ox], [oy], [oz]] = own.origin;
        let [[dx], [dy], [dz]] = own.direction;
        (Ray::new(Vec3::new(ox, oy, oz), Vec3::new(dx, dy, dz)), root)
    }
}

impl Level for World {
    const HAS_PLACED: bool = true;

    #[inline(always)]
    fn closest<T: Real>(accel: &Accel, which: u32, walk: &Walk, best: &mut Best, stack: &mut [(u32, f32)]) {
        let (ray, root) = accel.enter(which, walk.origin, walk.direction);
        let mut own = Best::none(best.t / root.unit);
        accel.closest_from::<T, Mesh>(root.node, &Walk::new(&ray), &mut own, stack);
        own.merge(root, best);
    }

    #[inline(always)]
    fn occluded<T: Real>(accel: &Accel, which: u32, walk: &Walk, t_max: f32, stack: &mut [(u32, f32)]) -> bool {
        let (ray, root) = accel.enter(which, walk.origin, walk.direction);
        accel.occluded_from::<T, Mesh>(root.node, &Walk::new(&ray), t_max / root.unit, stack)
    }

    #[inline(always)]
    fn sweep<R: Real, T: Real, const ANY: bool>(
        accel: &Accel,
        which: u32,
        list: &[u32],
        set: &mut Set<'_>,
        memory: &mut Sweep,
    ) {
        let root = accel.roots[which as usize];
        let mut own = memory.below.take().unwrap_or_default();
        own.reserve(list.len());
        for from in (0..list.len()).step_by(SPARE) {
            let part = &list[from..list.len().min(from + SPARE)];
            let mut rays = Rays { origin: [[0.0; SPARE]; 3], direction: [[0.0; SPARE]; 3] };
            for (k, at) in part.iter().enumerate() {
                let at = *at as usize;
                for axis in 0..3 {
                    rays.origin[axis][k] = set.origin[axis][at];
                    rays.direction[axis][k] = set.direction[axis][at];
                }
                own.t[from + k] = memory.end_of(at) / root.unit;
            }
            let rays = accel.placements.enter(which, root.unit, &rays);
            for axis in 0..3 {
                own.rows[axis][from..from + SPARE].copy_from_slice(&rays.origin[axis]);
                own.rows[3 + axis][from..from + SPARE].copy_from_slice(&rays.direction[axis]);
            }
        }
        own.primitive[..list.len()].fill(super::NONE);
        let [ox, oy, oz, dx, dy, dz] = &own.rows;
        let mut found = Set {
            origin: [ox, oy, oz],
            direction: [dx, dy, dz],
            t: &mut own.t,
            u: &mut own.u,
            v: &mut own.v,
            primitive: &mut own.primitive,
        };
        accel.sweep_from::<R, T, Mesh, ANY>(root.node, &mut found, list.len(), &mut own.sweep);
        for (k, at) in list.iter().enumerate() {
            let at = *at as usize;
            if ANY {
                if own.t[k] < 0.0 {
                    memory.end(at, -1.0);
                }
            } else if own.primitive[k] != super::NONE {
                let best = Best { t: own.t[k], u: own.u[k], v: own.v[k], primitive: own.primitive[k] };
                let mut known = Best { t: memory.end_of(at), u: set.u[at], v: set.v[at], primitive: set.primitive[at] };
                best.merge(root, &mut known);
                set.keep(at, known.u, known.v, known.primitive);
                memory.end(at, known.t);
            }
        }
        memory.below = Some(own);
    }

    #[inline(always)]
    fn packet<R: Real, T: Real>(
        accel: &Accel,
        which: u32,
        rays: &Packet<R>,
        mask: R::Mask,
        best: &mut PacketHits<R>,
        stack: &mut [(u32, f32)],
    ) {
        let root = accel.roots[which as usize];
        let own = accel.placements.enter(which, root.unit, &rays.rows());
        let ([ox, oy, oz], [dx, dy, dz]) = (&own.origin, &own.direction);
        let (origin, direction) = (Triple::load([ox, oy, oz], 0), Triple::load([dx, dy, dz], 0));
        // Any primitive is lower than this one: of hits at one distance the mesh's are yet to be compared.
        let mut found =
            PacketHits { t: best.t / root.unit, u: R::zero(), v: R::zero(), primitive: R::Integer::splat(i32::MAX) };
        if let Some(packet) = Packet::new(origin, direction, mask) {
            accel.closest_packet_from::<R, T, Mesh>(root.node, &packet, mask, &mut found, stack);
        } else {
            let (mut rows, mut primitives) = ([[0.0; SPARE]; 3], [0; SPARE]);
            found.t.store(&mut rows[0]);
            found.primitive.store(&mut primitives);
            let mut bits = mask.bits();
            while bits != 0 {
                let lane = bits.trailing_zeros() as usize % SPARE;
                bits &= bits - 1;
                let mut one = Best::none(rows[0][lane]);
                let ray = Ray::new(origin.lane(lane), direction.lane(lane));
                accel.closest_from::<T, Mesh>(root.node, &Walk::new(&ray), &mut one, stack);
                if one.primitive != super::NONE {
                    (rows[0][lane], rows[1][lane], rows[2][lane]) = (one.t, one.u, one.v);
                    primitives[lane] = one.primitive;
                }
            }
            found.t = R::load(&rows[0]);
            found.u = R::load(&rows[1]);
            found.v = R::load(&rows[2]);
            found.primitive = R::Integer::load(&primitives);
        }
        let met = mask & !R::same(found.primitive, R::Integer::splat(i32::MAX));
        best.merge(&found, root, met);
    }
}

impl Level for Mesh {
    const HAS_PLACED: bool = false;

    #[inline(always)]
    fn closest<T: Real>(_: &Accel, _: u32, _: &Walk, _: &mut Best, _: &mut [(u32, f32)]) {}

    #[inline(always)]
    fn occluded<T: Real>(_: &Accel, _: u32, _: &Walk, _: f32, _: &mut [(u32, f32)]) -> bool {
        false
    }

    #[inline(always)]
    fn sweep<R: Real, T: Real, const ANY: bool>(_: &Accel, _: u32, _: &[u32], _: &mut Set<'_>, _: &mut Sweep) {}

    #[inline(always)]
    fn packet<R: Real, T: Real>(
        _: &Accel,
        _: u32,
        _: &Packet<R>,
        _: R::Mask,
        _: &mut PacketHits<R>,
        _: &mut [(u32, f32)],
    ) {
    }
}
