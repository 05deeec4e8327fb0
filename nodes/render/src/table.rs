//! What the shading of a hit reads, in one row for each primitive: positions, normals, texture coordinates, and which
//! material and light it is of.

use crate::lanes::{Integer, Pair, Real, Record, Triple};
use glam::{Vec2, Vec3};

/// Records of a primitive.
const WIDTH: usize = 2;

/// The light of primitives that do not emit.
pub(crate) const DARK: u32 = u32::MAX;

/// A triangle, by its vertices.
pub(crate) const TRIANGLE: u32 = 0;
/// A disk: centre and images of the unit vectors instead of vertices.
pub(crate) const DISK: u32 = 1;
/// A sphere: its centre, and its radius as the first number of the second vertex; the next is -1 if it is turned inside
/// out.
pub(crate) const SPHERE: u32 = 2;

/// What is known of all primitives.
#[derive(Default)]
pub(crate) struct Table {
    /// Of each, two records: vertices, normal and vertex normals, texture coordinates.
    rows: Vec<Record>,
    /// Material of each.
    pub(crate) material: Vec<u32>,
    /// Light of each, or [`DARK`].
    pub(crate) light: Vec<u32>,
    /// What each is: [`TRIANGLE`], [`DISK`] or [`SPHERE`].
    pub(crate) form: Vec<u32>,
}

/// What is known of primitives, by lane.
pub(crate) struct Facts<R> {
    pub(crate) positions: [Triple<R>; 3],
    /// Geometric normal.
    pub(crate) normal: Triple<R>,
    normals: [Triple<R>; 3],
    /// u and v of each vertex.
    uvs: [R; 6],
}

/// A triangle's row.
pub(crate) struct Row {
    pub(crate) positions: [Vec3; 3],
    /// Unit normal on the shape's outer side.
    pub(crate) normal: Vec3,
    /// Unit normals at the vertices.
    pub(crate) normals: [Vec3; 3],
    pub(crate) uvs: [Vec2; 3],
}

impl Table {
    pub(crate) fn push(&mut self, row: &Row, material: u32, form: u32) {
        let all = row.positions.iter().chain([&row.normal]).chain(&row.normals).flat_map(glam::Vec3::to_array);
        let mut records = [Record::default(); WIDTH];
        let places = records.iter_mut().flat_map(|record| &mut record.0);
        for (place, value) in places.zip(all.chain(row.uvs.iter().flat_map(glam::Vec2::to_array))) {
            *place = value;
        }
        self.rows.extend(records);
        self.material.push(material);
        self.light.push(DARK);
        self.form.push(form);
    }

    /// Vertices of a primitive.
    pub(crate) fn triangle(&self, primitive: u32) -> [Vec3; 3] {
        self.facts::<f32>(primitive as i32).positions.map(Into::into)
    }

    /// The normal of some primitives, if all have the same.
    pub(crate) fn flat(&self, first: usize, count: usize) -> Option<Vec3> {
        let normal = |at: usize| Vec3::from(self.facts::<f32>(at as i32).normal);
        let same = |at: usize| normal(at).dot(normal(first)) > 0.999;
        (count > 0 && (first..first + count).all(same)).then(|| normal(first))
    }

    /// What is known of primitives.
    #[inline(always)]
    pub(crate) fn facts<R: Real>(&self, primitive: R::Integer) -> Facts<R> {
        let first = primitive * R::Integer::splat(2 * WIDTH as i32);
        let [ax, ay, az, bx, by, bz, cx, cy] = R::columns(&self.rows, first);
        let [cz, nx, ny, nz, px, py, pz, qx] = R::columns(&self.rows, first + R::Integer::splat(1));
        let [qy, qz, rx, ry, rz, pu, pv, qu] = R::columns(&self.rows, first + R::Integer::splat(2));
        let [qv, ru, rv, ..] = R::columns(&self.rows, first + R::Integer::splat(3));
        Facts {
            positions: [Triple::new(ax, ay, az), Triple::new(bx, by, bz), Triple::new(cx, cy, cz)],
            normal: Triple::new(nx, ny, nz),
            normals: [Triple::new(px, py, pz), Triple::new(qx, qy, qz), Triple::new(rx, ry, rz)],
            uvs: [pu, pv, qu, qv, ru, rv],
        }
    }
}

impl<R: Real> Facts<R> {
    /// Mean of the vertex normals, not of unit length.
    #[inline(always)]
    pub(crate) fn shading(&self, [a, b, c]: [R; 3]) -> Triple<R> {
        let [p, q, r] = self.normals;
        p * a + q * b + r * c
    }

    /// Texture coordinates.
    #[inline(always)]
    pub(crate) fn uv(&self, [a, b, c]: [R; 3]) -> Pair<R> {
        let [pu, pv, qu, qv, ru, rv] = self.uvs;
        Pair::new(pu * a + qu * b + ru * c, pv * a + qv * b + rv * c)
    }
}
