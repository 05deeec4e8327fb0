//! Bounding volume hierarchy: obvhs builds a binary tree, which is collapsed into nodes of four boxes side by side.
//!
//! Knows forms, not what they are made of. Its result does not depend on the tree: boxes are padded beyond the rounding
//! of what is in them, and of several hits at one distance the lowest primitive counts. Traversal after Ylitie,
//! Karras, Laine 2017 in its ordering of children; the exit distance is widened as by Ize 2013, *Robust BVH Ray
//! Traversal*.

mod build;
mod traverse;

use crate::geometry::{Disk, Four, Sphere};
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
    /// Its block, times four, and its lane.
    place: u32,
}

/// A form that is no triangle.
#[derive(Clone, Copy, Debug)]
enum Curved {
    Sphere { center: Vec3, radius: f32 },
    Disk(Disk),
}

/// Up to four primitives, side by side. The fourth axis of the first vertices holds indices of the primitives; of the
/// second, in its first lane, bits of the lanes that are curved; of the third, indices of these. Other lanes hold
/// NaN, which meets nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Block {
    vertices: Four,
}

impl Block {
    #[inline]
    fn primitive(&self, lane: usize) -> u32 {
        self.vertices[0][3][lane].to_bits()
    }

    #[inline]
    fn curved(&self) -> u32 {
        self.vertices[1][3].x.to_bits()
    }
}

/// Four boxes. Planes are lower x, upper x, lower y, upper y, lower z, upper z; a box that is not used is inverted.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Node {
    planes: [Vec4; 6],
    /// Index of an inner node; or, with [`LEAF`], of a block.
    children: [u32; 4],
}

const LEAF: u32 = 1 << 31;
/// Most primitives in a leaf: those of a block.
const LEAF_SIZE: u32 = 4;
/// Entries of the traversal stack; trees that need more are balanced.
const STACK: usize = 96;

/// The hierarchy over a scene's primitives.
pub struct Accel {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    curved: Vec<Curved>,
    /// Block and lane of each primitive.
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
        std::mem::size_of_val(self.nodes.as_slice()) + std::mem::size_of_val(self.blocks.as_slice())
    }

    /// Vertices of a triangle by its primitive.
    #[inline]
    pub fn triangle(&self, primitive: u32) -> [Vec3; 3] {
        self.at(self.places[primitive as usize])
    }

    /// Vertices of the triangle that was hit.
    #[inline]
    pub fn vertices(&self, hit: &Hit) -> [Vec3; 3] {
        self.at(hit.place)
    }

    #[inline]
    fn at(&self, place: u32) -> [Vec3; 3] {
        let lane = (place & 3) as usize;
        let block = &self.blocks[(place >> 2) as usize];
        block.vertices.map(|axes| Vec3::new(axes[0][lane], axes[1][lane], axes[2][lane]))
    }
}

#[cfg(test)]
mod tests;
