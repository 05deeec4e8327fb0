//! Building: obvhs's PLOC with reinsertion, leaves of a few primitives, collapsed to eight children a node.
//!
//! Scenes of a million triangles are common, so nothing is kept for each of them but its box: forms are asked for when
//! they are needed, and obvhs's tree is collapsed as it lies.

use super::{
    Accel, CURVED, Curved, LARGE_TREE, LEAF, LEAF_SIZE, Node, PLACED, Primitive, Root, TREE_STACK, WIDE, plan::Plan,
};
use crate::{pages::settled, placement::Placement};
use glam::Vec3;
use obvhs::{Boundable, BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};
use std::time::Duration;
use tauflow_data::rng::mix;

/// Leaves of a larger share of the scene's surface are worth splitting, being met by many rays.
const LARGE: f32 = 0.05;

/// Trees of more boxes are larger than the caches, and have small blocks. In smaller trees, large ones are faster, as no
/// row of them is in two lines of the cache.
const MANY: usize = 1 << 16;

type Bounds = (Vec3, Vec3);

fn union(a: Bounds, b: Bounds) -> Bounds {
    (a.0.min(b.0), a.1.max(b.1))
}

fn half_area(b: Bounds) -> f32 {
    let d = b.1 - b.0;
    d.x * d.y + d.y * d.z + d.z * d.x
}

struct Boxed(Bounds);

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
    pub(crate) form: &'a dyn Fn(u32) -> Primitive,
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

/// Part of a binary tree on its way to nodes of eight.
enum Part {
    /// An inner node of obvhs's tree.
    Node(u32),
    Inner(Bounds, Box<([Part; 2], Plan)>),
    Leaf(Bounds, Vec<u32>),
    /// A placed mesh.
    Placed(Bounds, u32),
}

/// Boxes in groups of equal ones: many in one place take obvhs quadratic time.
struct Groups {
    members: Vec<u32>,
    /// Where each group begins, and how many it has.
    runs: Vec<(u32, u32)>,
}

/// The input of the build.
struct Source<'a> {
    boxes: &'a [Boxed],
    /// `None` if all are different.
    groups: Option<Groups>,
    bvh: Bvh2,
    /// Boxes from here on are of placed meshes.
    placed: u32,
    form: &'a dyn Fn(u32) -> Primitive,
    /// Area from which leaves are worth splitting.
    least: f32,
    /// Of the nodes of obvhs's tree.
    plans: Vec<Plan>,
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
        let mut boxes: Vec<Boxed> = Vec::with_capacity(forms.count as usize + placed.len());
        boxes.extend((0..forms.count).map(|at| Boxed::new((forms.form)(at).bounds(), pad)));
        // How far from the origin rays of each mesh begin, in its own space.
        let mut reaches = vec![0.0f64; shared.len()];
        for one in placed {
            let reach = one.placement.reach(extent.into());
            reaches[one.mesh] = reaches[one.mesh].max(reach);
            // The same rounding, of the ray in the mesh's space.
            let own = one.placement.spread(reach * 16.0 * f64::from(f32::EPSILON)) as f32;
            boxes.push(Boxed::new(one.bounds, pad + own));
        }
        let mut accel = Self { bounds: tight, ..Self::default() };
        accel.grow(&boxes, forms.count, forms.form);
        drop(boxes);
        let mut trees = Vec::with_capacity(shared.len());
        for (mesh, reach) in shared.iter().zip(reaches) {
            let form = |at: u32| (forms.form)(mesh.first + at);
            let pad = (reach * 16.0 * f64::from(f32::EPSILON)) as f32 + f32::MIN_POSITIVE;
            let boxes: Vec<Boxed> = (0..mesh.count).map(|at| Boxed::new(form(at).bounds(), pad)).collect();
            trees.push(accel.grow(&boxes, mesh.count, &form));
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
    fn grow(&mut self, boxes: &[Boxed], placed: u32, form: &dyn Fn(u32) -> Primitive) -> u32 {
        let groups = Groups::of(boxes);
        let params = BvhBuildParams { max_prims_per_leaf: LEAF_SIZE, ..BvhBuildParams::medium_build() };
        let bvh = match &groups {
            None => build_bvh2(boxes, params, &mut Duration::default()),
            Some(groups) => {
                let firsts = groups.runs.iter().map(|run| groups.members[run.0 as usize]);
                let firsts: Vec<Boxed> = firsts.map(|at| Boxed(boxes[at as usize].0)).collect();
                build_bvh2(&firsts, params, &mut Duration::default())
            }
        };
        let all = boxes.iter().map(|b| b.0).reduce(union).unwrap_or_default();
        let least = LARGE * half_area(all);
        let mut source = Source { boxes, groups, bvh, placed, form, least, plans: Vec::new() };
        source.plan();
        let before = (self.nodes.len(), self.blocks.len(), self.curved.len());
        let mut depth = self.collapse(source.part(0), &source);
        if depth * (WIDE - 1) + 1 > TREE_STACK {
            // A chain rather than a tree; its order, cut in halves, is as good.
            self.nodes.truncate(before.0);
            self.blocks.truncate(before.1);
            self.curved.truncate(before.2);
            let order = source.members(&source.bvh.primitive_indices);
            depth = self.collapse(source.balanced(&order), &source);
        }
        debug_assert!(depth * (WIDE - 1) < TREE_STACK);
        before.0 as u32
    }

    /// Adds a leaf's block; returns its place.
    fn push_block(&mut self, leaf: &[u32], source: &Source<'_>) -> u32 {
        let (mut primitives, mut vertices) = (Vec::with_capacity(leaf.len()), Vec::with_capacity(leaf.len()));
        let mut triangles = Vec::with_capacity(leaf.len());
        for primitive in leaf {
            let curved = match (source.form)(*primitive) {
                Primitive::Triangle(own) => {
                    triangles.push((*primitive, own.map(|vertex| vertex.to_array())));
                    continue;
                }
                Primitive::Sphere(s) => Curved::Sphere { center: s.center, radius: s.radius },
                Primitive::Disk(d) => Curved::Disk(d),
            };
            primitives.push(CURVED | self.curved.len() as u32);
            vertices.push([[f32::NAN; 3]; 3]);
            self.curved.push((*primitive, curved));
        }
        for (primitive, own) in triangles {
            primitives.push(primitive);
            vertices.push(own);
        }
        self.blocks.push(&primitives, &vertices, source.boxes.len() > MANY)
    }

    /// Writes the tree as nodes of eight; returns the depth.
    fn collapse(&mut self, tree: Part, source: &Source<'_>) -> usize {
        let index = self.nodes.len();
        self.nodes.push(Node { planes: [[0.0; WIDE]; 6], children: [LEAF; WIDE] });
        let mut parts = Vec::with_capacity(WIDE);
        source.open(tree, WIDE, &mut parts);
        let mut node = Node { planes: [[0.0; WIDE]; 6], children: [LEAF; WIDE] };
        let mut depth = 0;
        let mut parts = parts.into_iter();
        for lane in 0..WIDE {
            let part = parts.next();
            let (low, high) = part.as_ref().map_or((Vec3::MAX, Vec3::MIN), |part| source.bounds(part));
            for axis in 0..3 {
                node.planes[2 * axis][lane] = low[axis];
                node.planes[2 * axis + 1][lane] = high[axis];
            }
            match part {
                Some(Part::Leaf(_, leaf)) => node.children[lane] = LEAF | self.push_block(&leaf, source),
                Some(Part::Placed(_, which)) => node.children[lane] = PLACED | which,
                Some(inner) => {
                    node.children[lane] = self.nodes.len() as u32;
                    depth = depth.max(self.collapse(inner, source));
                }
                None => {}
            }
        }
        self.nodes[index] = node;
        depth + 1
    }
}

impl Groups {
    /// Boxes by their first equal one; `None` if no two are equal.
    fn of(boxes: &[Boxed]) -> Option<Self> {
        let hash = |b: &Boxed| {
            let numbers = b.0.0.to_array().into_iter().chain(b.0.1.to_array());
            numbers.fold(0, |state, value| mix(state, u64::from(value.to_bits())))
        };
        let mut order: Vec<(u64, u32)> = boxes.iter().enumerate().map(|(at, b)| (hash(b), at as u32)).collect();
        order.sort_unstable();
        if order.windows(2).all(|pair| pair[0].0 != pair[1].0) {
            return None;
        }
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for (at, (hash, which)) in order.iter().enumerate() {
            let equal = at > 0 && order[at - 1].0 == *hash;
            match runs.last_mut() {
                Some(run) if equal && boxes[order[run.0 as usize].1 as usize].0 == boxes[*which as usize].0 => {
                    run.1 += 1;
                }
                _ => runs.push((at as u32, 1)),
            }
        }
        runs.sort_unstable_by_key(|run| order[run.0 as usize].1);
        Some(Self { members: order.into_iter().map(|(_, which)| which).collect(), runs })
    }
}

impl Source<'_> {
    fn bounds(&self, part: &Part) -> Bounds {
        match part {
            Part::Node(node) => {
                let aabb = self.bvh.nodes[*node as usize].aabb();
                (aabb.min.into(), aabb.max.into())
            }
            Part::Inner(bounds, _) | Part::Leaf(bounds, _) | Part::Placed(bounds, _) => *bounds,
        }
    }

    fn union(&self, boxes: &[u32]) -> Bounds {
        boxes.iter().map(|at| self.boxes[*at as usize].0).reduce(union).unwrap_or_default()
    }

    /// Boxes of groups.
    fn members(&self, groups: &[u32]) -> Vec<u32> {
        let Some(all) = &self.groups else { return groups.to_vec() };
        let run = |group: &u32| all.runs[*group as usize];
        groups
            .iter()
            .map(run)
            .flat_map(|(from, count)| &all.members[from as usize..][..count as usize])
            .copied()
            .collect()
    }

    /// A node of obvhs's tree, its leaves with bounds of our own, and such that they fit a block.
    fn part(&self, at: u32) -> Part {
        let node = &self.bvh.nodes[at as usize];
        if !node.is_leaf() {
            return Part::Node(at);
        }
        let from = node.first_index as usize;
        let mut leaf = self.members(&self.bvh.primitive_indices[from..from + node.prim_count as usize]);
        leaf.sort_unstable();
        // Placed meshes have the largest numbers.
        let own = leaf.partition_point(|at| *at < self.placed);
        match (own > 0, own < leaf.len()) {
            (true, true) => self.pair(self.split(&leaf[..own]), self.balanced(&leaf[own..])),
            (true, false) => self.split(&leaf),
            _ => self.balanced(&leaf),
        }
    }

    fn pair(&self, a: Part, b: Part) -> Part {
        let bounds = union(self.bounds(&a), self.bounds(&b));
        let plan = Plan::new(half_area(bounds), self.plan_of(&a), self.plan_of(&b));
        Part::Inner(bounds, Box::new(([a, b], plan)))
    }

    fn plan_of<'b>(&'b self, part: &'b Part) -> &'b Plan {
        match part {
            Part::Node(at) => &self.plans[*at as usize],
            Part::Inner(_, inner) => &inner.1,
            Part::Leaf(..) | Part::Placed(..) => &Plan::LEAF,
        }
    }

    /// Plans obvhs's nodes, each after its halves.
    fn plan(&mut self) {
        let nodes = &self.bvh.nodes;
        let mut order: Vec<u32> = Vec::with_capacity(nodes.len());
        let mut open = vec![0];
        while let Some(at) = open.pop() {
            order.push(at);
            let node = &nodes[at as usize];
            if !node.is_leaf() {
                open.extend([node.first_index, node.first_index + 1]);
            }
        }
        let mut plans = vec![Plan::LEAF; nodes.len()];
        for at in order.into_iter().rev() {
            let (node, part) = (&nodes[at as usize], Part::Node(at));
            plans[at as usize] = if !node.is_leaf() {
                let first = node.first_index as usize;
                Plan::new(half_area(self.bounds(&part)), &plans[first], &plans[first + 1])
            } else if self.is_plain() && node.prim_count <= LEAF_SIZE && half_area(self.bounds(&part)) < self.least {
                Plan::LEAF
            } else {
                *self.plan_of(&self.part(at))
            };
        }
        self.plans = plans;
    }

    /// Whether all boxes are different, and of primitives of the world.
    fn is_plain(&self) -> bool {
        self.groups.is_none() && self.placed as usize == self.boxes.len()
    }

    /// The children that represent a part in a wide node, of which there are at most so many; all of them for the part
    /// that is the node itself.
    fn open(&self, part: Part, children: usize, into: &mut Vec<Part>) {
        let Some((first, second)) = self.plan_of(&part).first_of(children) else {
            into.push(part);
            return;
        };
        let [a, b] = match part {
            Part::Inner(_, inner) => inner.0,
            Part::Node(at) => {
                let first = self.bvh.nodes[at as usize].first_index;
                [self.part(first), self.part(first + 1)]
            }
            leaf => {
                into.push(leaf);
                return;
            }
        };
        self.open(a, first, into);
        self.open(b, second, into);
    }

    /// A leaf of primitives, or of one placed mesh.
    fn leaf(&self, boxes: &[u32]) -> Part {
        let bounds = self.union(boxes);
        match boxes {
            [one] if *one >= self.placed => Part::Placed(bounds, *one - self.placed),
            _ => Part::Leaf(bounds, boxes.to_vec()),
        }
    }

    /// A leaf; or, if its box is larger than `least` and much of it is empty, several: a box that many rays meet had
    /// better hold little else than what they meet.
    fn split(&self, primitives: &[u32]) -> Part {
        let count = primitives.len();
        let area = half_area(self.union(primitives));
        if count < 2 || count > LEAF_SIZE as usize || area < self.least {
            return self.balanced(primitives);
        }
        let mut best: Option<(f32, Vec<u32>, usize)> = None;
        for axis in 0..3 {
            let mut order = primitives.to_vec();
            let center = |p: u32| self.boxes[p as usize].0.0[axis] + self.boxes[p as usize].0.1[axis];
            order.sort_by(|a, b| center(*a).total_cmp(&center(*b)).then(a.cmp(b)));
            for at in 1..count {
                let (a, b) = order.split_at(at);
                let cost = half_area(self.union(a)) * a.len() as f32 + half_area(self.union(b)) * b.len() as f32;
                if best.as_ref().is_none_or(|best| cost < best.0) {
                    best = Some((cost, order.clone(), at));
                }
            }
        }
        match best {
            Some((cost, order, at)) if cost + area < area * count as f32 => {
                self.pair(self.split(&order[..at]), self.split(&order[at..]))
            }
            _ => self.balanced(primitives),
        }
    }

    /// A tree that halves a sequence of boxes until the parts fit a block, and placed meshes are alone.
    fn balanced(&self, boxes: &[u32]) -> Part {
        let fits = boxes.len() <= LEAF_SIZE as usize && boxes.iter().all(|at| *at < self.placed);
        if fits || boxes.len() < 2 {
            return self.leaf(boxes);
        }
        let (a, b) = boxes.split_at(boxes.len() / 2);
        self.pair(self.balanced(a), self.balanced(b))
    }
}
