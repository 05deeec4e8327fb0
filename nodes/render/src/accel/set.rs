//! Many rays side by side, and the memory of a sweep over them.

use super::{SPARE, interleave::Flight, safe};
use crate::{
    geometry::Walk,
    lanes::{Integer, Real, Record, Triple},
};
use glam::Vec3;

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
    pub(super) group: Vec<u32>,
    pub(super) lists: Vec<u32>,
    pub(super) visits: Vec<Visit>,
    pub(super) stack: Vec<(u32, f32)>,
    pub(super) flights: Vec<Flight>,
    /// Nodes and rays that are to visit them.
    pub(super) pending: Vec<(u32, u32)>,
    /// Of placed meshes.
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
pub(super) const END: usize = 6;

/// A node to be visited by a list of rays.
#[derive(Clone, Copy)]
pub(super) struct Visit {
    pub(super) node: u32,
    pub(super) start: usize,
    pub(super) len: usize,
    /// Where lists may begin that this visit makes.
    pub(super) free: usize,
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
    /// What is read of the rays, and the group of each.
    #[inline(always)]
    pub(super) fn prepare<R: Real>(&mut self, set: &Set<'_>, count: usize) {
        let room = count + SPARE;
        self.rays.resize(self.rays.len().max(room), Record::default());
        self.group.resize(self.group.len().max(room), 0);
        let (one, zero) = (R::one(), R::zero());
        for at in (0..count).step_by(R::N) {
            let (o, d) = (Triple::<R>::load(set.origin, at), Triple::<R>::load(set.direction, at));
            let end = R::load(&set.t[at..]);
            let size = d.abs();
            let inverse = [safe(d.x), safe(d.y), safe(d.z)];
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
