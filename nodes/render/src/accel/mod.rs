//! Bounding volume hierarchy: obvhs builds a binary tree, which is collapsed into nodes of eight boxes side by
//! side.
//!
//! Knows forms, not what they are made of. Its result does not depend on the tree: boxes are padded beyond the rounding
//! of what is in them, and of several hits at one distance the lowest primitive counts. Traversal after Ylitie,
//! Karras, Laine 2017 in its ordering of children; the exit distance is widened as by Ize 2013, *Robust BVH Ray
//! Traversal*.

mod batch;
mod build;
mod leaves;
mod packet;
mod sweep;
mod traverse;

pub use batch::RayBatch;
pub(crate) use packet::Packet;
pub(crate) use sweep::{Set, Sweep};
pub(crate) use traverse::Stack;

use crate::geometry::{Disk, Eight, Sphere};
use glam::Vec3;

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
}

/// A form that is no triangle.
#[derive(Clone, Copy, Debug)]
enum Curved {
    Sphere { center: Vec3, radius: f32 },
    Disk(Disk),
}

/// Up to eight primitives, side by side. Lanes that are not used hold NaN, which meets nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Block {
    /// By vertex and axis.
    vertices: Eight,
    primitives: [u32; 8],
    /// Bits of the lanes that are curved, and the first of these in [`Accel::curved`].
    curved: u32,
    first_curved: u32,
}

/// Eight boxes. Planes are lower x, upper x, lower y, upper y, lower z, upper z; a box that is not used is inverted.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Node {
    planes: [[f32; 8]; 6],
    /// Index of an inner node; or, with [`LEAF`], of a block.
    children: [u32; 8],
}

const LEAF: u32 = 1 << 31;
/// Children of a node.
const WIDE: usize = 8;
/// Most primitives in a leaf.
const LEAF_SIZE: u32 = 8;
/// Entries of the traversal stack; trees that need more are balanced.
pub(crate) const STACK: usize = 160;

/// The hierarchy over a scene's primitives.
pub struct Accel {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    curved: Vec<Curved>,
    bounds: (Vec3, Vec3),
}

impl Accel {
    /// Smallest and largest coordinates of all primitives; both 0 if there is none.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.bounds
    }
}

#[cfg(test)]
mod tests;
