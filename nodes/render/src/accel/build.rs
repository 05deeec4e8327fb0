//! Building: many primitives in pieces, as building takes several times the memory of what is built, and pieces can be
//! built side by side.
//!
//! Scenes of a million triangles are common, so little is kept for each of them: forms are asked for when they are
//! needed, and so are boxes after the division into pieces.

use super::{
    Accel, LARGE_TREE, LEAF, PLACED, Primitive, Root, TREE_STACK, WIDE,
    piece::{Ground, Piece},
    top::split,
};
use crate::{pages::settled, placement::Placement};
use glam::Vec3;
use obvhs::{Boundable, aabb::Aabb};
use rayon::prelude::*;
use std::ops::Range;

/// Most boxes of a piece.
pub(super) const PIECE: u32 = 1 << 16;
/// Trees of more boxes are larger than the caches, and have small blocks. In smaller trees, large ones are faster, as
/// none of their rows is in two lines of the cache.
const MANY: u32 = 1 << 16;
/// Most nodes above each other: 20 of the top of 2^24 boxes, as each side of a division has a quarter of them, and 16
/// of a piece of placed meshes that is cut in halves. The rest is for more boxes.
const DEEPEST: usize = (TREE_STACK - 1) / (WIDE - 1);

pub(super) type Bounds = (Vec3, Vec3);

pub(super) fn union(a: Bounds, b: Bounds) -> Bounds {
    (a.0.min(b.0), a.1.max(b.1))
}

pub(super) fn half_area(b: Bounds) -> f32 {
    let d = b.1 - b.0;
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// A box, beyond the rounding of what is in it.
#[derive(Clone, Copy)]
pub(super) struct Boxed(pub(super) Bounds);

impl Boxed {
    fn new((low, high): Bounds, pad: f32) -> Self {
        Self((low - pad, high + pad))
    }
}

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        Aabb::new(self.0.0.into(), self.0.1.into())
    }
}

/// Primitives by number: those of the world first, then those of the shared meshes.
pub(crate) struct Forms<'a> {
    /// How many are of the world.
    pub(crate) count: u32,
    pub(crate) form: &'a (dyn Fn(u32) -> Primitive + Sync),
}

/// A mesh that several shapes share: its primitives among the forms.
pub(crate) struct SharedMesh {
    pub(crate) first: u32,
    pub(crate) count: u32,
}

/// Where a shape has a shared mesh.
pub(crate) struct PlacedMesh {
    /// Which mesh.
    pub(crate) mesh: usize,
    pub(crate) placement: Placement,
    /// In the world.
    pub(crate) bounds: Bounds,
    /// What hits of its first primitive are numbered.
    pub(crate) first: u32,
}

impl Primitive {
    /// Smallest and largest coordinates.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        match self {
            Self::Triangle([a, b, c]) => (a.min(*b).min(*c), a.max(*b).max(*c)),
            Self::Sphere(s) => (s.center - Vec3::splat(s.radius), s.center + Vec3::splat(s.radius)),
            Self::Disk(d) => {
                let reach = (d.x * d.x + d.y * d.y).map(f32::sqrt);
                (d.center - reach, d.center + reach)
            }
        }
    }
}

impl Accel {
    /// Builds the hierarchy. Primitives must be finite. `viewpoint` is where rays may begin outside the primitives.
    pub fn new(primitives: &[Primitive], viewpoint: Vec3) -> Self {
        let form = |index: u32| primitives[index as usize];
        Self::over(&Forms { count: primitives.len() as u32, form: &form }, &[], &[], viewpoint)
    }

    /// Builds the hierarchy of a world that has shared meshes.
    pub(crate) fn over(forms: &Forms<'_>, shared: &[SharedMesh], placed: &[PlacedMesh], viewpoint: Vec3) -> Self {
        let own = (0..forms.count).map(|at| (forms.form)(at).bounds());
        let Some(tight) = own.chain(placed.iter().map(|p| p.bounds)).reduce(union) else { return Self::default() };
        let extent = tight.0.abs().max(tight.1.abs()).max(viewpoint.abs()).max_element();
        // Twice what the intersection of a ray and a primitive rounds at the scene's size.
        let pad = extent * 16.0 * f32::EPSILON + f32::MIN_POSITIVE;
        // How far from the origin rays of each mesh begin, in its own space.
        let mut reaches = vec![0.0f64; shared.len()];
        let mut placed_boxes = Vec::with_capacity(placed.len());
        for one in placed {
            let reach = one.placement.reach(extent.into());
            reaches[one.mesh] = reaches[one.mesh].max(reach);
            // The same rounding, of the ray in the mesh's space.
            let own = one.placement.spread(reach * 16.0 * f64::from(f32::EPSILON)) as f32;
            placed_boxes.push(Boxed::new(one.bounds, pad + own));
        }
        let boxed = |at: u32| match at.checked_sub(forms.count) {
            Some(which) => placed_boxes[which as usize],
            None => Boxed::new((forms.form)(at).bounds(), pad),
        };
        let mut accel = Self { bounds: tight, ..Self::default() };
        accel.grow(forms.count + placed.len() as u32, forms.count, &boxed, forms.form);
        let mut trees = Vec::with_capacity(shared.len());
        for (mesh, reach) in shared.iter().zip(reaches) {
            let form = |at: u32| (forms.form)(mesh.first + at);
            let pad = (reach * 16.0 * f64::from(f32::EPSILON)) as f32 + f32::MIN_POSITIVE;
            let boxed = |at: u32| Boxed::new(form(at).bounds(), pad);
            trees.push(accel.grow(mesh.count, mesh.count, &boxed, &form));
        }
        accel.placements.reserve(placed.len());
        for one in placed {
            accel.placements.push(&one.placement);
            accel.roots.push(Root { node: trees[one.mesh], first: one.first, unit: one.placement.unit() });
        }
        accel.nodes = settled(std::mem::take(&mut accel.nodes));
        accel.blocks.finish();
        accel.curved.shrink_to_fit();
        accel.roots.shrink_to_fit();
        accel.is_large = size_of_val(&accel.nodes[..]) + accel.blocks.bytes() > LARGE_TREE;
        accel
    }

    /// Grows a tree over boxes, of which there is one; those from `placed` on are of placed meshes. Returns its root.
    fn grow(
        &mut self,
        count: u32,
        placed: u32,
        boxed: &(dyn Fn(u32) -> Boxed + Sync),
        form: &(dyn Fn(u32) -> Primitive + Sync),
    ) -> u32 {
        let all: Vec<Boxed> = (0..count).map(boxed).collect();
        let area = half_area(all.iter().map(|b| b.0).reduce(union).unwrap_or_default());
        let ground = Ground { boxed, placed, form, area, small_blocks: count > MANY };
        let mut members: Vec<u32> = (0..count).collect();
        if count <= PIECE {
            return self.append(Piece::grow(members, ground, DEEPEST));
        }
        let (top, ranges) = split(&mut members, &all, ground);
        drop(all);
        let (deepest, joints) = (DEEPEST.saturating_sub(top.depth), top.joints.clone());
        let (root, before) = (self.append(top), self.blocks.len());
        let mut roots = Vec::with_capacity(ranges.len());
        // Few at once: memory is short while a large tree grows.
        for some in ranges.chunks(rayon::current_num_threads()) {
            let grow = |range: &Range<usize>| Piece::grow(members[range.clone()].to_vec(), ground, deepest);
            let pieces: Vec<Piece> = some.par_iter().map(grow).collect();
            roots.extend(pieces.into_iter().map(|piece| self.append(piece)));
            if roots.len() == some.len() {
                // The others are probably about as large. Room that is not used takes no memory.
                let done: usize = ranges[..roots.len()].iter().map(Range::len).sum();
                let lines = (self.blocks.len() - before) as f64 * f64::from(count) / done as f64;
                self.blocks.reserve(before + (1.2 * lines) as usize);
            }
        }
        for (node, lane, piece) in joints {
            self.nodes[root as usize + node].children[lane] = roots[piece];
        }
        root
    }

    /// Adds a tree. Returns its root.
    fn append(&mut self, piece: Piece) -> u32 {
        debug_assert!(piece.depth <= DEEPEST);
        let (nodes, curved) = (self.nodes.len() as u32, self.curved.len() as u32);
        let blocks = self.blocks.append(piece.blocks, curved);
        self.nodes.extend(piece.nodes.into_iter().map(|mut node| {
            for (lane, child) in node.children.iter_mut().enumerate() {
                if node.planes[0][lane] > node.planes[1][lane] {
                    break;
                }
                if *child & LEAF == 0 {
                    *child += nodes;
                } else if *child & PLACED != PLACED {
                    *child += blocks;
                }
            }
            node
        }));
        self.curved.extend(piece.curved);
        nodes
    }
}
