//! Rows of numbers by path, and what is in which.

use crate::{
    bsdf::SLOTS,
    lanes::{Mask, Real, Triple},
};
use glam::Vec3;

/// Widest lanes: rows have so many numbers to spare.
pub(super) const SPARE: usize = 16;
/// Rows of numbers, one for each path that lives.
pub(super) struct Rows<const N: usize> {
    pub(super) rows: [Vec<f32>; N],
    pub(super) ids: Vec<u32>,
    pub(super) len: usize,
}

impl<const N: usize> Default for Rows<N> {
    fn default() -> Self {
        Self { rows: std::array::from_fn(|_| Vec::new()), ids: Vec::new(), len: 0 }
    }
}

impl<const N: usize> Rows<N> {
    /// Makes room for so many.
    pub(super) fn reserve(&mut self, room: usize) {
        if self.ids.len() < room + SPARE {
            self.rows.iter_mut().for_each(|row| row.resize(room + SPARE, 0.0));
            self.ids.resize(room + SPARE, 0);
        }
    }

    /// Appends the lanes of a mask.
    #[inline(always)]
    pub(super) fn push<R: Real>(&mut self, mask: R::Mask, values: [R; N], ids: &[u32; SPARE]) {
        for (row, value) in self.rows.iter_mut().zip(values) {
            value.compress(mask, &mut row[self.len..self.len + SPARE]);
        }
        let mut bits = mask.bits();
        while bits != 0 {
            self.ids[self.len] = ids[bits.trailing_zeros() as usize % SPARE];
            bits &= bits - 1;
            self.len += 1;
        }
    }

    /// Sets the numbers of one.
    pub(super) fn set(&mut self, at: usize, values: [f32; N], id: u32) {
        for (row, value) in self.rows.iter_mut().zip(values) {
            row[at] = value;
        }
        self.ids[at] = id;
    }

    #[inline(always)]
    pub(super) fn triple<R: Real>(&self, first: usize, at: R::Integer) -> Triple<R> {
        Triple::new(
            R::gather(&self.rows[first], at),
            R::gather(&self.rows[first + 1], at),
            R::gather(&self.rows[first + 2], at),
        )
    }

    #[inline(always)]
    pub(super) fn put<R: Real>(&mut self, first: usize, at: usize, value: Triple<R>) {
        value.x.store(&mut self.rows[first][at..]);
        value.y.store(&mut self.rows[first + 1][at..]);
        value.z.store(&mut self.rows[first + 2][at..]);
    }

    #[inline(always)]
    pub(super) fn row<R: Real>(&self, first: usize, at: usize) -> Triple<R> {
        Triple::load([&self.rows[first], &self.rows[first + 1], &self.rows[first + 2]], at)
    }

    #[inline(always)]
    pub(super) fn vector(&self, first: usize, at: usize) -> Vec3 {
        Vec3::new(self.rows[first][at], self.rows[first + 1][at], self.rows[first + 2][at])
    }
}

/// Rows of a path: origin, direction, throughput, product of relative indices, density of the last scattering
/// (0 or less where nothing but it can find the light), cell of the vertex before among those of lights.
pub(super) type Paths = Rows<12>;
pub(super) const ORIGIN: usize = 0;
pub(super) const DIRECTION: usize = 3;
pub(super) const THROUGHPUT: usize = 6;
pub(super) const ETA: usize = 9;
pub(super) const PDF: usize = 10;
pub(super) const CELL: usize = 11;
/// Row of a path: its density so far, over that of a light path along it but for the emission; 0 where light paths do
/// not find it.
pub(super) type Rivals = Rows<1>;
/// Rows of a shadow ray: origin, direction, its end, what arrives if nothing is in between.
pub(super) type Shadows = Rows<10>;
pub(super) const END: usize = 6;
pub(super) const ARRIVES: usize = 7;
/// Rows of a ray that goes on through surfaces: origin, direction, its end, the share of light that is left. Its number
/// is that of the path or of the shadow ray.
pub(super) type Through = Rows<8>;
pub(super) const SHARE: usize = 7;
/// Rows of a vertex, in the order of materials: point, bound on its error, geometric normal, shading normal, normal and
/// first tangent of its own frame. Then direction and throughput of the path, texture coordinates, vertex colour and
/// alpha, values of the textures.
pub(super) const POINT: usize = 0;
pub(super) const ERROR: usize = 3;
pub(super) const GEOMETRIC: usize = 6;
pub(super) const SHADING: usize = 9;
pub(super) const MAPPED: usize = 12;
pub(super) const ALONG: usize = 15;
pub(super) const ARRIVED_BY: usize = 18;
pub(super) const CARRIES: usize = 21;
pub(super) const UV: usize = 24;
pub(super) const COLOR: usize = 26;
pub(super) const TEXTURES: usize = 30;
/// Rows of light that may arrive: direction, shadow ray (origin, direction, end), radiance over density, density,
/// density of the emission of light paths. Without light the radiance is 0.
pub(super) const TOWARDS: usize = TEXTURES + 3 * SLOTS;
pub(super) const SHADOW: usize = TOWARDS + 3;
pub(super) const WEIGHT: usize = SHADOW + 7;
pub(super) const LIGHT_PDF: usize = WEIGHT + 3;
pub(super) const EMITS: usize = LIGHT_PDF + 1;
pub(super) const VERTEX: usize = EMITS + 1;
