//! Bounding volume hierarchy: obvhs builds a binary tree, which is collapsed into nodes of four boxes side by side.
//!
//! Knows forms, not what they are made of. Its result does not depend on the tree: boxes are padded beyond the rounding
//! of what is in them, and of several hits at one distance the lowest primitive counts. Traversal after Ylitie,
//! Karras, Laine 2017 in its ordering of children; the exit distance is widened as by Ize 2013, *Robust BVH Ray
//! Traversal*.

mod build;
mod traverse;

use crate::geometry::{Disk, Sphere};
use glam::{Vec3, Vec4};

/// A primitive's form.
#[derive(Clone, Copy, Debug)]
pub enum Primitive {
    /// A triangle by its vertices.
    Triangle([Vec3; 3]),
    /// A sphere.
    Sphere(Sphere),
    /// A disk.
    Disk(Disk),
}

/// The nearest hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray.
    pub t: f32,
    /// First coordinate of the form: weight of a triangle's second vertex, `a` of a disk.
    pub u: f32,
    /// Second coordinate of the form.
    pub v: f32,
    /// Index of the primitive, in the order given to [`Accel::new`].
    pub primitive: u32,
    /// Where its vertices are.
    slot: u32,
}

const TRIANGLE: u32 = 0;
const SPHERE: u32 = 1;

/// A primitive in leaf order: rows of three numbers and a word. The words: index of the primitive; sort of form; index
/// among the disks.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
struct Slot {
    rows: [[f32; 4]; 3],
}

impl Slot {
    fn primitive(&self) -> u32 {
        self.rows[0][3].to_bits()
    }
}

/// Four boxes. Planes are lower x, upper x, lower y, upper y, lower z, upper z; a box that is not used is inverted.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Node {
    planes: [Vec4; 6],
    /// Index of an inner node; or, with [`LEAF`], first slot, and above it the number of slots less one.
    children: [u32; 4],
}

const LEAF: u32 = 1 << 31;
const COUNT_SHIFT: u32 = 27;
/// Most primitives in a leaf.
const LEAF_SIZE: u32 = 8;
/// Entries of the traversal stack; trees that need more are balanced.
const STACK: usize = 96;

/// The hierarchy over a scene's primitives.
pub struct Accel {
    nodes: Vec<Node>,
    slots: Vec<Slot>,
    disks: Vec<Disk>,
    /// Slot of each primitive.
    places: Vec<u32>,
    bounds: (Vec3, Vec3),
}

impl Accel {
    /// Smallest and largest coordinates of all primitives; both 0 if there is none.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.bounds
    }

    /// Bytes of nodes and primitives.
    pub fn size(&self) -> usize {
        std::mem::size_of_val(self.nodes.as_slice()) + std::mem::size_of_val(self.slots.as_slice())
    }

    /// Vertices of a triangle by its primitive.
    #[inline]
    pub fn triangle(&self, primitive: u32) -> [Vec3; 3] {
        self.slots[self.places[primitive as usize] as usize].rows.map(|row| Vec3::new(row[0], row[1], row[2]))
    }

    /// Vertices of the triangle that was hit.
    #[inline]
    pub fn vertices(&self, hit: &Hit) -> [Vec3; 3] {
        self.slots[hit.slot as usize].rows.map(|row| Vec3::new(row[0], row[1], row[2]))
    }
}

#[cfg(test)]
mod tests;
