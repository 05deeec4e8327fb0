//! What the shading of a hit reads, in one row for each primitive: positions, normals, texture coordinates, and which
//! material and light it is of.

use crate::lanes::{Pair, Real, Triple, Whole};
use glam::{Vec2, Vec3};

/// Numbers in a row.
const WIDTH: usize = 32;
const NORMAL: usize = 9;
const VERTEX_NORMALS: usize = 12;
const UVS: usize = 21;

/// The light of primitives that do not emit.
pub(crate) const DARK: u32 = u32::MAX;

/// A triangle, by its vertices.
pub(crate) const TRIANGLE: u32 = 0;
/// A disk: centre and images of the unit vectors instead of vertices.
pub(crate) const DISK: u32 = 1;
/// A sphere: its centre, and its radius as the first number of the second vertex; the next is -1 if it is turned inside
/// out.
pub(crate) const SPHERE: u32 = 2;

/// Rows of all primitives.
#[derive(Default)]
pub(crate) struct Table {
    rows: Vec<f32>,
    /// Material of each.
    pub(crate) material: Vec<u32>,
    /// Light of each, or [`DARK`].
    pub(crate) light: Vec<u32>,
    /// What each is: [`TRIANGLE`], [`DISK`] or [`SPHERE`].
    pub(crate) form: Vec<u32>,
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
        let all = row.positions.iter().chain([&row.normal]).chain(&row.normals).flat_map(|v| v.to_array());
        self.rows.extend(all.chain(row.uvs.iter().flat_map(|v| v.to_array())));
        self.rows.resize((self.material.len() + 1) * WIDTH, 0.0);
        self.material.push(material);
        self.light.push(DARK);
        self.form.push(form);
    }

    /// Vertices of a primitive.
    pub(crate) fn triangle(&self, primitive: u32) -> [Vec3; 3] {
        self.positions::<f32>(primitive as i32).map(Into::into)
    }

    /// The normal of some primitives, if all have the same.
    pub(crate) fn flat(&self, first: usize, count: usize) -> Option<Vec3> {
        let normal = |at: usize| Vec3::from(self.normal::<f32>(at as i32));
        let same = |at: usize| normal(at).dot(normal(first)) > 0.999;
        (count > 0 && (first..first + count).all(same)).then(|| normal(first))
    }

    #[inline(always)]
    fn read<R: Real>(&self, row: R::Whole, at: usize) -> R {
        R::gather(&self.rows, row + R::Whole::splat(at as i32))
    }

    #[inline(always)]
    fn triple<R: Real>(&self, row: R::Whole, at: usize) -> Triple<R> {
        Triple::new(self.read(row, at), self.read(row, at + 1), self.read(row, at + 2))
    }

    #[inline(always)]
    fn row<R: Real>(primitive: R::Whole) -> R::Whole {
        primitive * R::Whole::splat(WIDTH as i32)
    }

    /// Vertices.
    #[inline(always)]
    pub(crate) fn positions<R: Real>(&self, primitive: R::Whole) -> [Triple<R>; 3] {
        let row = Self::row::<R>(primitive);
        [self.triple(row, 0), self.triple(row, 3), self.triple(row, 6)]
    }

    /// Geometric normal.
    #[inline(always)]
    pub(crate) fn normal<R: Real>(&self, primitive: R::Whole) -> Triple<R> {
        self.triple(Self::row::<R>(primitive), NORMAL)
    }

    /// Mean of the vertex normals, not of unit length.
    #[inline(always)]
    pub(crate) fn shading<R: Real>(&self, primitive: R::Whole, weights: [R; 3]) -> Triple<R> {
        let row = Self::row::<R>(primitive);
        let [a, b, c] = weights;
        self.triple(row, VERTEX_NORMALS) * a
            + self.triple(row, VERTEX_NORMALS + 3) * b
            + self.triple(row, VERTEX_NORMALS + 6) * c
    }

    /// Texture coordinates.
    #[inline(always)]
    pub(crate) fn uv<R: Real>(&self, primitive: R::Whole, weights: [R; 3]) -> Pair<R> {
        let row = Self::row::<R>(primitive);
        let [a, b, c] = weights;
        let u = self.read::<R>(row, UVS) * a + self.read::<R>(row, UVS + 2) * b + self.read::<R>(row, UVS + 4) * c;
        let v = self.read::<R>(row, UVS + 1) * a + self.read::<R>(row, UVS + 3) * b + self.read::<R>(row, UVS + 5) * c;
        Pair::new(u, v)
    }
}
