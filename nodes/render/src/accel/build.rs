//! Building: obvhs's PLOC with reinsertion, leaves of a few primitives, collapsed to eight children a node.

use super::{Accel, Block, Curved, LEAF, LEAF_SIZE, Node, Primitive, STACK, WIDE};
use glam::Vec3;
use obvhs::{Boundable, BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};
use std::time::Duration;
use tauflow_data::rng::mix;

/// Leaves of a larger share of the scene's surface are worth splitting, being met by many rays.
const LARGE: f32 = 0.05;

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

/// A binary tree on the way from obvhs to nodes of eight.
enum Tree {
    Inner(Bounds, Box<[Tree; 2]>),
    Leaf(Bounds, Vec<u32>),
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
        let empty = (Vec3::ZERO, Vec3::ZERO);
        let tight = primitives.iter().map(Primitive::bounds).reduce(union).unwrap_or(empty);
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
        let mut accel = Self { nodes: Vec::new(), blocks: Vec::new(), curved: Vec::new(), bounds: tight };
        if boxes.is_empty() {
            return accel;
        }
        let groups = group_equal(&boxes);
        let firsts: Vec<Boxed> = groups.iter().map(|group| Boxed(boxes[group[0] as usize].0)).collect();
        let bvh = build_bvh2(
            &firsts,
            BvhBuildParams { max_prims_per_leaf: LEAF_SIZE, ..BvhBuildParams::medium_build() },
            &mut Duration::default(),
        );
        let mut depth = accel.collapse(&tree_of(&bvh, &groups, &boxes), primitives);
        if depth * (WIDE - 1) + 1 > STACK {
            // A chain rather than a tree; its order, cut in halves, is as good.
            accel.nodes.clear();
            accel.blocks.clear();
            accel.curved.clear();
            let order: Vec<u32> = bvh.primitive_indices.iter().flat_map(|g| groups[*g as usize].clone()).collect();
            depth = accel.collapse(&balanced(&order, &boxes), primitives);
        }
        debug_assert!(depth * (WIDE - 1) < STACK);
        accel
    }

    /// Adds a leaf's block; returns its index.
    fn push_block(&mut self, leaf: &[u32], primitives: &[Primitive]) -> u32 {
        let index = self.blocks.len() as u32;
        let mut block = Block {
            vertices: [[[f32::NAN; 8]; 3]; 3],
            primitives: [u32::MAX; 8],
            curved: 0,
            first_curved: self.curved.len() as u32,
        };
        for (lane, primitive) in leaf.iter().enumerate() {
            block.primitives[lane] = *primitive;
            let curved = match &primitives[*primitive as usize] {
                Primitive::Triangle(vertices) => {
                    for (axes, vertex) in block.vertices.iter_mut().zip(vertices) {
                        for axis in 0..3 {
                            axes[axis][lane] = vertex[axis];
                        }
                    }
                    continue;
                }
                Primitive::Sphere(s) => Curved::Sphere { center: s.center, radius: s.radius },
                Primitive::Disk(d) => Curved::Disk(*d),
            };
            block.curved |= 1 << lane;
            self.curved.push(curved);
        }
        self.blocks.push(block);
        index
    }

    /// Writes the tree as nodes of eight; returns the depth.
    fn collapse(&mut self, tree: &Tree, primitives: &[Primitive]) -> usize {
        let index = self.nodes.len();
        self.nodes.push(Node { planes: [[0.0; WIDE]; 6], children: [LEAF; WIDE] });
        let mut parts: Vec<&Tree> = vec![tree];
        // Opens the inner part of the largest area until there are eight.
        while parts.len() < WIDE {
            let largest = parts
                .iter()
                .enumerate()
                .filter(|(_, part)| matches!(part, Tree::Inner(..)))
                .max_by(|a, b| half_area(a.1.bounds()).total_cmp(&half_area(b.1.bounds())));
            let Some((at, Tree::Inner(_, pair))) = largest.map(|(at, part)| (at, *part)) else { break };
            parts[at] = &pair[0];
            parts.push(&pair[1]);
        }
        let mut node = Node { planes: [[0.0; WIDE]; 6], children: [LEAF; WIDE] };
        let mut depth = 0;
        for lane in 0..WIDE {
            let (low, high) = parts.get(lane).map_or((Vec3::MAX, Vec3::MIN), |part| part.bounds());
            for axis in 0..3 {
                node.planes[2 * axis][lane] = low[axis];
                node.planes[2 * axis + 1][lane] = high[axis];
            }
            match parts.get(lane) {
                Some(Tree::Leaf(_, leaf)) => node.children[lane] = LEAF | self.push_block(leaf, primitives),
                Some(inner) => {
                    node.children[lane] = self.nodes.len() as u32;
                    depth = depth.max(self.collapse(inner, primitives));
                }
                None => {}
            }
        }
        self.nodes[index] = node;
        depth + 1
    }
}

/// Primitives of exactly equal boxes together, by their first: many in one place take obvhs quadratic time.
fn group_equal(boxes: &[Boxed]) -> Vec<Vec<u32>> {
    let hash = |b: &Boxed| {
        let numbers = b.0.0.to_array().into_iter().chain(b.0.1.to_array());
        numbers.fold(0, |state, value| mix(state, u64::from(value.to_bits())))
    };
    let mut order: Vec<(u64, u32)> = boxes.iter().enumerate().map(|(at, b)| (hash(b), at as u32)).collect();
    order.sort_unstable();
    let mut groups: Vec<Vec<u32>> = Vec::with_capacity(boxes.len());
    for (at, (hash, primitive)) in order.iter().enumerate() {
        let equal = at > 0 && order[at - 1].0 == *hash;
        match groups.last_mut() {
            Some(group) if equal && boxes[group[0] as usize].0 == boxes[*primitive as usize].0 => {
                group.push(*primitive);
            }
            _ => groups.push(vec![*primitive]),
        }
    }
    groups.sort_unstable_by_key(|group| group[0]);
    groups
}

/// obvhs's tree over groups, with bounds of our own and leaves that fit a block.
fn tree_of(bvh: &Bvh2, groups: &[Vec<u32>], boxes: &[Boxed]) -> Tree {
    let all = boxes.iter().map(|b| b.0).reduce(union).expect("there are boxes");
    let least = LARGE * half_area(all);
    let mut done: Vec<Option<Tree>> = (0..bvh.nodes.len()).map(|_| None).collect();
    let mut stack = vec![(0u32, false)];
    while let Some((at, children_done)) = stack.pop() {
        let node = &bvh.nodes[at as usize];
        let (left, right) = (node.first_index, node.first_index + 1);
        if node.is_leaf() {
            let from = node.first_index as usize;
            let leaf = &bvh.primitive_indices[from..from + node.prim_count as usize];
            let mut leaf: Vec<u32> = leaf.iter().flat_map(|group| groups[*group as usize].iter().copied()).collect();
            leaf.sort_unstable();
            done[at as usize] = Some(part(&leaf, boxes, least));
        } else if children_done {
            let a = done[left as usize].take().expect("children come first");
            let b = done[right as usize].take().expect("children come first");
            done[at as usize] = Some(Tree::Inner(union(a.bounds(), b.bounds()), Box::new([a, b])));
        } else {
            stack.extend([(at, true), (right, false), (left, false)]);
        }
    }
    done[0].take().expect("the root is done last")
}

/// A leaf; or, if its box is larger than `least` and much of it is empty, several: a box that many rays meet had better
/// hold little else than what they meet.
fn part(primitives: &[u32], boxes: &[Boxed], least: f32) -> Tree {
    let bounds = |part: &[u32]| part.iter().map(|p| boxes[*p as usize].0).reduce(union).expect("no part is empty");
    let count = primitives.len();
    let area = half_area(bounds(primitives));
    if count < 2 || count > LEAF_SIZE as usize || area < least {
        return balanced(primitives, boxes);
    }
    let mut best: Option<(f32, Vec<u32>, usize)> = None;
    for axis in 0..3 {
        let mut order = primitives.to_vec();
        let center = |p: u32| boxes[p as usize].0.0[axis] + boxes[p as usize].0.1[axis];
        order.sort_by(|a, b| center(*a).total_cmp(&center(*b)).then(a.cmp(b)));
        for at in 1..count {
            let (a, b) = order.split_at(at);
            let cost = half_area(bounds(a)) * a.len() as f32 + half_area(bounds(b)) * b.len() as f32;
            if best.as_ref().is_none_or(|best| cost < best.0) {
                best = Some((cost, order.clone(), at));
            }
        }
    }
    match best {
        Some((cost, order, at)) if cost + area < area * count as f32 => {
            let (a, b) = (part(&order[..at], boxes, least), part(&order[at..], boxes, least));
            Tree::Inner(union(a.bounds(), b.bounds()), Box::new([a, b]))
        }
        _ => balanced(primitives, boxes),
    }
}

/// A tree that halves a sequence of primitives until the parts fit a block.
fn balanced(primitives: &[u32], boxes: &[Boxed]) -> Tree {
    if primitives.len() <= LEAF_SIZE as usize {
        let bounds = primitives.iter().map(|p| boxes[*p as usize].0).reduce(union).expect("no part is empty");
        return Tree::Leaf(bounds, primitives.to_vec());
    }
    let (a, b) = primitives.split_at(primitives.len() / 2);
    let (a, b) = (balanced(a, boxes), balanced(b, boxes));
    Tree::Inner(union(a.bounds(), b.bounds()), Box::new([a, b]))
}
