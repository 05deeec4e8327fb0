//! Shading data, shared between shapes with the same mesh: half a record per triangle, with its vertex indices, normal
//! and shape; and half a record per vertex.
//!
//! The vertices of a mesh that is placed once are in the world, and turned as its shape says. Those of a mesh that
//! several shapes share are in its own space: [`crate::placement`] brings what is read of them into the world.

use crate::{
    lanes::{Mask, Pair, Real, Record, Triple},
    pages::settled,
};
use glam::{Vec2, Vec3};

/// The light of shapes that do not emit.
pub(crate) const DARK: u32 = u32::MAX;

/// A triangle, by its vertices.
pub(crate) const TRIANGLE: u32 = 0;
/// A disk: centre and images of the unit vectors instead of vertices.
pub(crate) const DISK: u32 = 1;
/// A sphere: its centre, and its radius as the first number of the second vertex; the next is -1 if it is turned inside
/// out.
pub(crate) const SPHERE: u32 = 2;
/// A triangle of a shared mesh, whose shape turns its normals round.
pub(crate) const TURNED: u32 = 3;

/// Half records, one after another.
#[derive(Debug, Default)]
pub(crate) struct Halves {
    records: Vec<Record>,
    len: usize,
}

impl Halves {
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Makes room for so many more, and no more than these.
    pub(crate) fn reserve(&mut self, more: usize) {
        self.records.reserve_exact((self.len + more).div_ceil(2).saturating_sub(self.records.len()));
    }

    pub(crate) fn push(&mut self, numbers: [f32; 8]) {
        if self.len.is_multiple_of(2) {
            self.records.push(Record::default());
        }
        if let Some(record) = self.records.last_mut() {
            record.0[8 * (self.len % 2)..][..8].copy_from_slice(&numbers);
        }
        self.len += 1;
    }

    #[inline(always)]
    pub(crate) fn columns<R: Real>(&self, index: R::Integer) -> [R; 8] {
        R::columns(&self.records, index)
    }

    /// Lets go of room that is not used.
    pub(crate) fn settle(&mut self) {
        self.records = settled(std::mem::take(&mut self.records));
    }

    pub(crate) fn bytes(&self) -> usize {
        self.records.capacity() * size_of::<Record>()
    }
}

/// Missing attributes of a triangle's vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Lacks {
    pub(crate) normals: bool,
    pub(crate) uvs: bool,
}

/// Data of all primitives.
#[derive(Default)]
pub(crate) struct Table {
    /// Of each vertex: position, normal, texture coordinates.
    vertices: Halves,
    /// Of each primitive: numbers of its vertices, normal on the outer side, shape, what its vertices lack.
    triangles: Halves,
}

/// Data of primitives, by lane.
pub(crate) struct Facts<R: Real> {
    pub(crate) positions: [Triple<R>; 3],
    /// Geometric normal.
    pub(crate) normal: Triple<R>,
    pub(crate) normals: [Triple<R>; 3],
    /// u and v of each vertex.
    uvs: [R; 6],
    /// Triangles without vertex normals.
    pub(crate) flat: R::Mask,
    /// Triangles without texture coordinates.
    pub(crate) bare: R::Mask,
}

impl Table {
    /// Number of primitives.
    pub(crate) fn len(&self) -> usize {
        self.triangles.len()
    }

    /// The number that the next vertex gets.
    pub(crate) fn next_vertex(&self) -> u32 {
        self.vertices.len() as u32
    }

    /// Makes room.
    pub(crate) fn reserve(&mut self, vertices: usize, triangles: usize) {
        self.vertices.reserve(vertices);
        self.triangles.reserve(triangles);
    }

    /// Adds a vertex.
    pub(crate) fn push_vertex(&mut self, position: Vec3, normal: Vec3, uv: Vec2) {
        let ([x, y, z], [p, q, r]) = (position.to_array(), normal.to_array());
        self.vertices.push([x, y, z, p, q, r, uv.x, uv.y]);
    }

    /// Adds a primitive of vertices, with the unit normal of its outer side.
    pub(crate) fn push(&mut self, vertices: [u32; 3], normal: Vec3, shape: u32, lacks: Lacks) {
        let [a, b, c] = vertices.map(f32::from_bits);
        let lacks = f32::from(u8::from(lacks.normals)) + 2.0 * f32::from(u8::from(lacks.uvs));
        self.triangles.push([a, b, c, normal.x, normal.y, normal.z, f32::from_bits(shape), lacks]);
    }

    /// Lets go of room that is not used.
    pub(crate) fn settle(&mut self) {
        self.vertices.settle();
        self.triangles.settle();
    }

    pub(crate) fn bytes(&self) -> usize {
        self.vertices.bytes() + self.triangles.bytes()
    }

    /// The shape of a primitive; the first of several.
    #[inline]
    pub(crate) fn shape(&self, primitive: u32) -> u32 {
        self.triangles.columns::<f32>(primitive as i32)[6].to_bits()
    }

    /// Numbers of a primitive's vertices.
    #[inline]
    pub(crate) fn corners(&self, primitive: u32) -> [u32; 3] {
        let [a, b, c, ..] = self.triangles.columns::<f32>(primitive as i32);
        [a, b, c].map(f32::to_bits)
    }

    /// Missing attributes of a primitive's vertices.
    #[inline]
    pub(crate) fn lacks(&self, primitive: u32) -> Lacks {
        let lacks = self.triangles.columns::<f32>(primitive as i32)[7];
        Lacks { normals: lacks == 1.0 || lacks == 3.0, uvs: lacks >= 2.0 }
    }

    /// Vertices of a primitive.
    pub(crate) fn triangle(&self, primitive: u32) -> [Vec3; 3] {
        self.corners(primitive).map(|corner| {
            let [x, y, z, ..] = self.vertices.columns::<f32>(corner as i32);
            Vec3::new(x, y, z)
        })
    }

    /// The normal of a primitive's outer side.
    pub(crate) fn normal(&self, primitive: u32) -> Vec3 {
        let [_, _, _, x, y, z, ..] = self.triangles.columns::<f32>(primitive as i32);
        Vec3::new(x, y, z)
    }

    /// Data of primitives.
    #[inline(always)]
    pub(crate) fn facts<R: Real>(&self, primitive: R::Integer) -> Facts<R> {
        let [i, j, k, nx, ny, nz, _, lacks] = self.triangles.columns::<R>(primitive);
        let [ax, ay, az, px, py, pz, pu, pv] = self.vertices.columns::<R>(i.bits());
        let [bx, by, bz, qx, qy, qz, qu, qv] = self.vertices.columns::<R>(j.bits());
        let [cx, cy, cz, rx, ry, rz, ru, rv] = self.vertices.columns::<R>(k.bits());
        let normal = Triple::new(nx, ny, nz);
        let mut normals = [Triple::new(px, py, pz), Triple::new(qx, qy, qz), Triple::new(rx, ry, rz)];
        let mut uvs = [pu, pv, qu, qv, ru, rv];
        let (one, zero) = (R::one(), R::zero());
        let bare = lacks.ge(R::splat(2.0));
        let flat = lacks.equals(one) | lacks.equals(R::splat(3.0));
        if flat.any() {
            for own in &mut normals {
                *own = Triple::select(flat, normal, *own);
            }
        }
        if bare.any() {
            // Without coordinates of its own a triangle has its weights.
            let weights = [zero, zero, one, zero, zero, one];
            for (uv, weight) in uvs.iter_mut().zip(weights) {
                *uv = R::select(bare, weight, *uv);
            }
        }
        let positions = [Triple::new(ax, ay, az), Triple::new(bx, by, bz), Triple::new(cx, cy, cz)];
        Facts { positions, normal, normals, uvs, flat, bare }
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

    /// u and v of each vertex.
    #[inline(always)]
    pub(crate) fn uvs(&self) -> [Pair<R>; 3] {
        let [pu, pv, qu, qv, ru, rv] = self.uvs;
        [Pair::new(pu, pv), Pair::new(qu, qv), Pair::new(ru, rv)]
    }
}
