//! Bounding volume hierarchy: obvhs builds a binary tree, which is collapsed into nodes of eight boxes side by
//! side.
//!
//! The hierarchy has two levels: the tree of the world contains triangles, bodies, and one box per shared mesh. Such a
//! mesh has a tree of its own, in its own space, into which rays are brought where they meet its box.
//!
//! Knows forms, not what they are made of. Its result does not depend on the tree: boxes are padded beyond the rounding
//! of what is in them, and of several hits at one distance the lowest primitive counts. Traversal after Ylitie,
//! Karras, Laine 2017 in its ordering of children; the exit distance is widened as by Ize 2013, *Robust BVH Ray
//! Traversal*.

mod batch;
mod best;
mod block;
mod build;
mod interleave;
mod leaves;
mod level;
mod packet;
mod packet_walk;
mod piece;
mod placed;
mod plan;
mod set;
mod sweep;
mod top;
mod traverse;

pub use batch::RayBatch;
pub(crate) use best::Stack;
use block::Blocks;
pub(crate) use build::{Forms, PlacedMesh, SharedMesh};
pub(crate) use packet::Packet;
pub(crate) use set::{Set, Sweep};

use crate::{
    geometry::{Disk, Sphere},
    lanes::Real,
    placement::Placements,
};
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

/// Eight boxes. Planes are lower x, upper x, lower y, upper y, lower z, upper z; a box that is not used is inverted.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Node {
    planes: [[f32; 8]; 6],
    /// Index of an inner node; or, with [`LEAF`], place of a block; or, with [`PLACED`], index of a placed mesh.
    children: [u32; 8],
}

const LEAF: u32 = 1 << 31;
/// A leaf that is a mesh placed there.
const PLACED: u32 = LEAF | 1 << 30;
/// A primitive that is no triangle.
const CURVED: u32 = 1 << 31;
/// No primitive.
const NONE: u32 = u32::MAX;
/// Children of a node.
const WIDE: usize = 8;
/// Lanes at most; rows and lists have as many entries to spare.
const SPARE: usize = 16;
/// Most primitives in a leaf.
const LEAF_SIZE: u32 = 8;
/// Entries of the traversal stack that a tree takes; trees that need more are balanced.
const TREE_STACK: usize = 288;
/// Bytes of nodes and blocks of a large tree: many times a core's own caches.
const LARGE_TREE: usize = 32 << 20;
/// Entries of the traversal stack: of the world's tree, and of the tree of a mesh that is placed in it.
pub(crate) const STACK: usize = 2 * TREE_STACK;

/// Finite reciprocals, as [`crate::geometry::Walk`] has them.
#[inline(always)]
fn safe<R: Real>(v: R) -> R {
    R::select(v.abs().gt(R::splat(1e-18)), R::one() / v, R::splat(1e18).copysign(v))
}

/// Where the tree of a placed mesh begins, the number of its first primitive, and how much longer distances are in the
/// world: a power of two.
#[derive(Clone, Copy, Debug)]
struct Root {
    node: u32,
    first: u32,
    unit: f32,
}

/// The hierarchy over a scene's primitives; and below it, over each mesh that several shapes share, in its own space.
#[derive(Default)]
pub struct Accel {
    nodes: Vec<Node>,
    blocks: Blocks,
    /// Forms with their primitives.
    curved: Vec<(u32, Curved)>,
    roots: Vec<Root>,
    placements: Placements,
    bounds: (Vec3, Vec3),
    /// Whether it is so large that hardly a node is there when it is needed.
    is_large: bool,
}

impl Accel {
    /// Smallest and largest coordinates of all primitives; both 0 if there is none.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.bounds
    }

    /// Where shared meshes stand.
    #[inline(always)]
    pub(crate) fn placements(&self) -> &Placements {
        &self.placements
    }

    /// The placed mesh of a primitive, and its number there; `None` if it is of the world.
    #[inline]
    pub(crate) fn owner(&self, primitive: u32) -> Option<(u32, u32)> {
        let after = self.roots.partition_point(|root| root.first <= primitive);
        let which = after.checked_sub(1)?;
        Some((which as u32, primitive - self.roots[which].first))
    }

    /// Memory that it takes.
    pub fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>()
            + self.blocks.bytes()
            + self.curved.capacity() * size_of::<(u32, Curved)>()
            + self.roots.capacity() * size_of::<Root>()
            + self.placements.bytes()
    }
}

#[cfg(test)]
mod tests;
