//! Building: obvhs's PLOC with reinsertion, leaves of a few primitives, collapsed to four children a node.

use super::{Accel, COUNT_SHIFT, LEAF, LEAF_SIZE, Node, Primitive, SPHERE, STACK, Slot, TRIANGLE};
use glam::{Vec3, Vec4};
use obvhs::{Boundable, BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};
use std::time::Duration;

type Bounds = (Vec3, Vec3);

fn union(a: Bounds, b: Bounds) -> Bounds {
    (a.0.min(b.0), a.1.max(b.1))
}

fn half_area(b: Bounds) -> f32 {
    let d = b.1 - b.0;
    d.x * d.y + d.y * d.z + d.z * d.x
}

struct Boxed(Bounds);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        Aabb::new(self.0.0.into(), self.0.1.into())
    }
}

/// A binary tree on the way from obvhs to nodes of four.
enum Tree {
    Inner(Bounds, Box<[Tree; 2]>),
    Leaf(Bounds, u32, u32),
}

impl Tree {
    fn bounds(&self) -> Bounds {
        match self {
            Self::Inner(bounds, _) | Self::Leaf(bounds, ..) => *bounds,
        }
    }
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
        let tight = primitives.iter().map(Primitive::bounds).reduce(union).unwrap_or((Vec3::ZERO, Vec3::ZERO));
        let extent = tight.0.abs().max(tight.1.abs()).max(viewpoint.abs()).max_element();
        // Twice what the intersection of a ray and a primitive rounds at the scene's size.
        let pad = Vec3::splat(extent * 16.0 * f32::EPSILON + f32::MIN_POSITIVE);
        let boxes: Vec<Boxed> = primitives
            .iter()
            .map(|p| {
                let (low, high) = p.bounds();
                Boxed((low - pad, high + pad))
            })
            .collect();
        let mut accel = Self {
            nodes: Vec::new(),
            slots: Vec::new(),
            disks: Vec::new(),
            places: vec![0; primitives.len()],
            bounds: tight,
        };
        if boxes.is_empty() {
            return accel;
        }
        let bvh = build_bvh2(
            &boxes,
            BvhBuildParams { max_prims_per_leaf: LEAF_SIZE, ..BvhBuildParams::medium_build() },
            &mut Duration::default(),
        );
        let order = leaf_order(&bvh);
        let mut tree = tree_of(&bvh, &order, &boxes);
        let mut depth = accel.collapse(&tree);
        if depth * 3 + 1 > STACK {
            // Thousands of primitives in one place make a chain of PLOC; its order, cut in halves, is as good there.
            let sequence: Vec<u32> = order.iter().flat_map(|leaf| leaf.primitives.iter().copied()).collect();
            tree = balanced(&sequence, 0, &boxes);
            accel.nodes.clear();
            depth = accel.collapse(&tree);
        }
        debug_assert!(depth * 3 < STACK);
        for leaf in &order {
            for primitive in &leaf.primitives {
                accel.push_slot(*primitive, &primitives[*primitive as usize]);
            }
        }
        accel
    }

    fn push_slot(&mut self, index: u32, primitive: &Primitive) {
        let row = |v: Vec3, word: u32| [v.x, v.y, v.z, f32::from_bits(word)];
        let rows = match primitive {
            Primitive::Triangle([a, b, c]) => [row(*a, index), row(*b, TRIANGLE), row(*c, 0)],
            Primitive::Sphere(s) => {
                [row(s.center, index), row(Vec3::new(s.radius, 0.0, 0.0), SPHERE), row(Vec3::ZERO, 0)]
            }
            Primitive::Disk(d) => {
                self.disks.push(*d);
                let at = self.disks.len() as u32 - 1;
                [row(Vec3::ZERO, index), row(Vec3::ZERO, SPHERE + 1), row(Vec3::ZERO, at)]
            }
        };
        self.places[index as usize] = self.slots.len() as u32;
        self.slots.push(Slot { rows });
    }

    /// Writes the tree as nodes of four; returns the depth.
    fn collapse(&mut self, tree: &Tree) -> usize {
        let index = self.nodes.len();
        self.nodes.push(Node { planes: [Vec4::ZERO; 6], children: [LEAF; 4] });
        let mut parts: Vec<&Tree> = vec![tree];
        // Opens the inner part of the largest area until there are four.
        while parts.len() < 4 {
            let largest = parts
                .iter()
                .enumerate()
                .filter(|(_, part)| matches!(part, Tree::Inner(..)))
                .max_by(|a, b| half_area(a.1.bounds()).total_cmp(&half_area(b.1.bounds())));
            let Some((at, Tree::Inner(_, pair))) = largest.map(|(at, part)| (at, *part)) else { break };
            parts[at] = &pair[0];
            parts.push(&pair[1]);
        }
        let mut node = Node { planes: [Vec4::ZERO; 6], children: [LEAF; 4] };
        let mut depth = 0;
        for lane in 0..4 {
            let (low, high) = parts.get(lane).map_or((Vec3::MAX, Vec3::MIN), |part| part.bounds());
            for axis in 0..3 {
                node.planes[2 * axis][lane] = low[axis];
                node.planes[2 * axis + 1][lane] = high[axis];
            }
            match parts.get(lane) {
                Some(Tree::Leaf(_, first, count)) => node.children[lane] = LEAF | ((count - 1) << COUNT_SHIFT) | first,
                Some(inner) => {
                    node.children[lane] = self.nodes.len() as u32;
                    depth = depth.max(self.collapse(inner));
                }
                None => {}
            }
        }
        self.nodes[index] = node;
        depth + 1
    }
}

/// Primitives of one leaf of obvhs's tree, and where they begin among all slots.
struct Leaf {
    node: u32,
    first: u32,
    primitives: Vec<u32>,
}

/// The leaves in the order of the tree, so that neighbours are near each other in memory.
fn leaf_order(bvh: &Bvh2) -> Vec<Leaf> {
    let mut leaves = Vec::new();
    let mut first = 0;
    let mut stack = vec![0u32];
    while let Some(at) = stack.pop() {
        let node = &bvh.nodes[at as usize];
        if node.is_leaf() {
            let from = node.first_index as usize;
            let mut primitives = bvh.primitive_indices[from..from + node.prim_count as usize].to_vec();
            primitives.sort_unstable();
            leaves.push(Leaf { node: at, first, primitives });
            first += node.prim_count;
        } else {
            stack.push(node.first_index + 1);
            stack.push(node.first_index);
        }
    }
    leaves
}

/// The tree over the leaves, with bounds of our own.
fn tree_of(bvh: &Bvh2, leaves: &[Leaf], boxes: &[Boxed]) -> Tree {
    let mut done: Vec<Option<Tree>> = (0..bvh.nodes.len()).map(|_| None).collect();
    for leaf in leaves {
        let bounds = leaf.primitives.iter().map(|p| boxes[*p as usize].0).reduce(union).expect("no leaf is empty");
        done[leaf.node as usize] = Some(split_leaf(leaf.first, &leaf.primitives, bounds, boxes));
    }
    let mut stack = vec![(0u32, false)];
    while let Some((at, children_done)) = stack.pop() {
        let node = &bvh.nodes[at as usize];
        if node.is_leaf() {
            continue;
        }
        let (left, right) = (node.first_index, node.first_index + 1);
        if children_done {
            let a = done[left as usize].take().expect("children come first");
            let b = done[right as usize].take().expect("children come first");
            done[at as usize] = Some(Tree::Inner(union(a.bounds(), b.bounds()), Box::new([a, b])));
        } else {
            stack.extend([(at, true), (right, false), (left, false)]);
        }
    }
    done[0].take().expect("the root is done last")
}

fn split_leaf(first: u32, primitives: &[u32], bounds: Bounds, boxes: &[Boxed]) -> Tree {
    if primitives.len() <= LEAF_SIZE as usize {
        return Tree::Leaf(bounds, first, primitives.len() as u32);
    }
    balanced(primitives, first, boxes)
}

/// A tree that halves a sequence of primitives.
fn balanced(primitives: &[u32], first: u32, boxes: &[Boxed]) -> Tree {
    if primitives.len() <= 4 {
        let bounds = primitives.iter().map(|p| boxes[*p as usize].0).reduce(union).expect("no part is empty");
        return Tree::Leaf(bounds, first, primitives.len() as u32);
    }
    let (a, b) = primitives.split_at(primitives.len() / 2);
    let a = balanced(a, first, boxes);
    let b = balanced(b, first + (primitives.len() / 2) as u32, boxes);
    Tree::Inner(union(a.bounds(), b.bounds()), Box::new([a, b]))
}
