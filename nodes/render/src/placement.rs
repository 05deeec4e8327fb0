//! Shapes that share a mesh: where each stands, and which may share at all.
//!
//! A shared mesh stays in its own space. Rays are brought there in f64 and rounded once; distances along a ray are the
//! same in both spaces, but for a power of two. What is read of a hit is brought into the world in f32, with a bound on
//! its error that covers the rounding of rays that leave from there: so origins are offset as on any other surface. The
//! numbers of the map into the mesh's space, rounded to f32, are what the placement is; the map into the world is their
//! inverse. A mesh is as watertight as in the world; between meshes that only touch, rounding differs.
//!
//! # Which shapes share
//! Those whose mesh (by its digest) has at least [`LEAST`] triangles and at least two benign placements, if at least
//! [`WORTH`] triangles are saved. From there on sharing is faster, too, as measured on separate bodies
//! (`examples/large_scenes.rs`); with fewer, one hierarchy of the world is as fast, and small.
//!
//! Placements are not benign that are flat, not finite, more than 2^20 times larger or smaller, or stretched more than
//! 256 times (by norms of map and inverse). They are copied into the world, and treated there as any mesh.

use crate::{
    geometry::{Map, Rays, gamma},
    lanes::{Integer, Real, Triple},
    table::Halves,
};
use glam::{DMat3, DVec3, Vec3};

/// Triangles that sharing must save.
pub(crate) const WORTH: usize = 1 << 15;
/// Triangles of a mesh that is worth a hierarchy of its own.
pub(crate) const LEAST: usize = 1 << 8;
/// Scales are within this and its reciprocal.
const SCALE: f64 = (1u32 << 20) as f64;
/// Bound on the product of the norms of a map and its inverse.
const STRETCH: f64 = 256.0;
/// Half records of a placement.
const WIDTH: usize = 3;

/// Which meshes are shared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sharing {
    /// None: every shape has triangles of its own in the world.
    Never,
    /// Those that are worth it.
    #[default]
    Worthwhile,
    /// All that can be.
    Always,
}

impl Sharing {
    /// Whether a mesh of so many triangles is shared by so many benign placements.
    pub(crate) fn shares(self, placements: usize, triangles: usize) -> bool {
        match self {
            Self::Never => false,
            Self::Worthwhile => {
                placements > 1 && triangles >= LEAST && (placements - 1).saturating_mul(triangles) >= WORTH
            }
            Self::Always => placements > 1 && triangles > 0,
        }
    }
}

/// Where one shape stands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    /// Rows of the map into the mesh's space, each with its shift.
    local: [[f32; 4]; 3],
    /// The map into the world: images of the unit vectors, and of the origin.
    linear: DMat3,
    shift: DVec3,
    /// Its scale as a power of two.
    unit: f32,
}

fn widest(m: &DMat3) -> f64 {
    let size = [m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs()];
    (size[0] + size[1] + size[2]).max_element()
}

impl Placement {
    /// `None` if the map is not benign.
    pub(crate) fn new(map: &Map) -> Option<Self> {
        let [x, y, z] = map.columns();
        let linear = DMat3::from_cols(x, y, z);
        let shift = map.shift();
        let det = linear.determinant();
        let scale = widest(&linear);
        let sound = linear.is_finite() && shift.is_finite() && det != 0.0 && det.is_finite();
        if !(sound && (SCALE.recip()..=SCALE).contains(&scale)) {
            return None;
        }
        let inverse = linear.inverse();
        // Flat within rounding has an inverse that is large.
        if !(inverse.is_finite() && widest(&inverse) * scale <= STRETCH) {
            return None;
        }
        let rounded = inverse.as_mat3();
        let exact = rounded.as_dmat3();
        let back = -(exact * shift);
        let rows = rounded.transpose();
        let row = |row: Vec3, shift: f64| [row.x, row.y, row.z, shift as f32];
        let local = [row(rows.x_axis, back.x), row(rows.y_axis, back.y), row(rows.z_axis, back.z)];
        let linear = exact.inverse();
        let back = DVec3::new(local[0][3].into(), local[1][3].into(), local[2][3].into());
        let shift = -(linear * back);
        // The power of two below the scale: its exponent alone.
        let unit = f64::from_bits(scale.to_bits() & (0x7FF << 52)) as f32;
        (back.is_finite() && shift.is_finite()).then_some(Self { local, linear, shift, unit })
    }

    /// A point of the mesh in the world.
    pub(crate) fn point(&self, p: Vec3) -> DVec3 {
        self.linear * p.as_dvec3() + self.shift
    }

    /// True if it turns right hands into left hands.
    pub(crate) fn mirrors(&self) -> bool {
        self.linear.determinant() < 0.0
    }

    /// Its scale as a power of two: directions of rays are that much longer in the mesh's space than the map makes
    /// them, and distances shorter. Directions therefore keep about their length, on which error bounds of hits rely,
    /// and no distance is rounded.
    pub(crate) fn unit(&self) -> f32 {
        self.unit
    }

    /// How far points can be from the origin of the mesh's space that are no farther than this from the world's.
    pub(crate) fn reach(&self, extent: f64) -> f64 {
        let row = |r: &[f32; 4]| (f64::from(r[0].abs()) + f64::from(r[1].abs()) + f64::from(r[2].abs())) * extent;
        self.local.iter().map(|r| row(r) + f64::from(r[3].abs())).fold(0.0, f64::max)
    }

    /// How far things are apart in the world that are that far apart in the mesh's space.
    pub(crate) fn spread(&self, distance: f64) -> f64 {
        widest(&self.linear) * distance
    }

    /// The square of its scale, if it turns and scales evenly.
    pub(crate) fn even(&self) -> Option<f64> {
        let [x, y, z] = [self.linear.x_axis, self.linear.y_axis, self.linear.z_axis];
        let square = x.length_squared();
        let off = [y.length_squared() - square, z.length_squared() - square, x.dot(y), y.dot(z), z.dot(x)];
        off.iter().all(|v| v.abs() <= 1e-6 * square).then_some(square)
    }
}

/// Where shapes stand, by their numbers.
#[derive(Default)]
pub(crate) struct Placements {
    halves: Halves,
}

/// [`Placement`] by lane.
pub(crate) struct Placed<R> {
    /// Images of the unit vectors, and of the origin.
    linear: [Triple<R>; 3],
    shift: Triple<R>,
    /// Rows of the inverse.
    inverse: [Triple<R>; 3],
}

impl Placements {
    /// Makes room.
    pub(crate) fn reserve(&mut self, count: usize) {
        self.halves.reserve(WIDTH * count);
    }

    pub(crate) fn push(&mut self, placement: &Placement) {
        let m = placement.linear.as_mat3();
        let s = placement.shift.as_vec3();
        let ([x, y, z], [p, q, r]) = ([m.x_axis, m.y_axis, m.z_axis], placement.local);
        self.halves.push([x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y]);
        self.halves.push([z.z, s.x, s.y, s.z, p[0], p[1], p[2], q[0]]);
        self.halves.push([q[1], q[2], r[0], r[1], r[2], p[3], q[3], r[3]]);
    }

    pub(crate) fn bytes(&self) -> usize {
        self.halves.bytes()
    }

    /// Rays in the space of a placed mesh, whose [`Placement::unit`] this is: worked out in f64, rounded once.
    #[inline(always)]
    pub(crate) fn enter<const N: usize>(&self, number: u32, unit: f32, rays: &Rays<N>) -> Rays<N> {
        let at = (WIDTH as u32 * number) as i32;
        let [_, _, _, _, pa, pb, pc, qa] = self.halves.columns::<f32>(at + 1);
        let [qb, qc, ra, rb, rc, ps, qs, rs] = self.halves.columns::<f32>(at + 2);
        let rows = [[pa, pb, pc, ps], [qa, qb, qc, qs], [ra, rb, rc, rs]];
        let mut out = Rays { origin: [[0.0; N]; 3], direction: [[0.0; N]; 3] };
        let ([ox, oy, oz], [dx, dy, dz]) = (&rays.origin, &rays.direction);
        for (axis, row) in rows.into_iter().enumerate() {
            let (a, b, c, s) = (f64::from(row[0]), f64::from(row[1]), f64::from(row[2]), f64::from(row[3]));
            for k in 0..N {
                let origin = a * f64::from(ox[k]) + b * f64::from(oy[k]) + c * f64::from(oz[k]) + s;
                let direction = a * f64::from(dx[k]) + b * f64::from(dy[k]) + c * f64::from(dz[k]);
                out.origin[axis][k] = origin as f32;
                out.direction[axis][k] = (direction * f64::from(unit)) as f32;
            }
        }
        out
    }

    /// Where shapes stand.
    #[inline(always)]
    pub(crate) fn placed<R: Real>(&self, number: R::Integer) -> Placed<R> {
        let at = number * R::Integer::splat(WIDTH as i32);
        let [xx, xy, xz, yx, yy, yz, zx, zy] = self.halves.columns::<R>(at);
        let [zz, sx, sy, sz, pa, pb, pc, qa] = self.halves.columns::<R>(at + R::Integer::splat(1));
        let [qb, qc, ra, rb, rc, ..] = self.halves.columns::<R>(at + R::Integer::splat(2));
        Placed {
            linear: [Triple::new(xx, xy, xz), Triple::new(yx, yy, yz), Triple::new(zx, zy, zz)],
            shift: Triple::new(sx, sy, sz),
            inverse: [Triple::new(pa, pb, pc), Triple::new(qa, qb, qc), Triple::new(ra, rb, rc)],
        }
    }
}

impl<R: Real> Placed<R> {
    /// Points of the mesh, known to within `error`, in the world, and how well they are known there: the bound is also
    /// one for the rounding of rays that begin there, on their way back.
    #[inline(always)]
    pub(crate) fn point(&self, p: Triple<R>, error: Triple<R>) -> (Triple<R>, Triple<R>) {
        let [x, y, z] = self.linear;
        let (a, b, c) = (x * p.x, y * p.y, z * p.z);
        // One rounding each of the map, the product and three sums; one of the ray's origin in the mesh's space.
        let reach = a.abs() + b.abs() + c.abs() + self.shift.abs();
        let known = x.abs() * error.x + y.abs() * error.y + z.abs() * error.z;
        (a + b + c + self.shift, known * R::splat(1.0 + gamma(4)) + reach * R::splat(gamma(9)))
    }

    /// Unit normals in the world.
    #[inline(always)]
    pub(crate) fn normal(&self, n: Triple<R>) -> Triple<R> {
        let [p, q, r] = self.inverse;
        (p * n.x + q * n.y + r * n.z).normalize()
    }

    /// Directions in the world.
    #[inline(always)]
    pub(crate) fn vector(&self, v: Triple<R>) -> Triple<R> {
        let [x, y, z] = self.linear;
        x * v.x + y * v.y + z * v.z
    }
}

impl Placed<f32> {
    /// True if it turns right hands into left hands.
    pub(crate) fn mirrors(&self) -> bool {
        let [x, y, z] = self.linear;
        x.cross(y).dot(z) < 0.0
    }
}

#[cfg(test)]
pub(crate) mod tests;
