//! A tree over some primitives: obvhs's PLOC with reinsertion, leaves of a few primitives, collapsed to at most eight
//! children a node.

use super::{
    CURVED, Curved, LEAF, LEAF_SIZE, Node, PLACED, Primitive, WIDE,
    block::Blocks,
    build::{Bounds, Boxed, half_area, union},
    plan::Plan,
};
use glam::Vec3;
use obvhs::{BvhBuildParams, bvh2::Bvh2, bvh2::builder::build_bvh2};
use std::time::Duration;
use tauflow_data::rng::mix;

/// Leaves of a larger share of the scene's surface are worth splitting, being met by many rays.
const LARGE: f32 = 0.05;

/// A tree with numbers of its own: its root is node 0.
#[derive(Default)]
pub(super) struct Piece {
    pub(super) nodes: Vec<Node>,
    pub(super) blocks: Blocks,
    pub(super) curved: Vec<(u32, Curved)>,
    /// Children that are other pieces: node, lane and piece.
    pub(super) joints: Vec<(usize, usize, usize)>,
    pub(super) depth: usize,
}

/// The boxes and primitives of a tree, and how it is built over them.
#[derive(Clone, Copy)]
pub(super) struct Ground<'a> {
    /// Boxes of primitives and placed meshes, by number.
    pub(super) boxed: &'a (dyn Fn(u32) -> Boxed + Sync),
    /// Boxes from here on are of placed meshes.
    pub(super) placed: u32,
    pub(super) form: &'a (dyn Fn(u32) -> Primitive + Sync),
    /// Half the area of all.
    pub(super) area: f32,
    /// Whether blocks are small where a few primitives are in them.
    pub(super) small_blocks: bool,
}

/// Part of a binary tree on its way to nodes of eight.
pub(super) enum Part {
    /// An inner node of obvhs's tree.
    Node(u32),
    Inner(Bounds, Box<([Part; 2], Plan)>),
    Leaf(Bounds, Vec<u32>),
    /// A placed mesh.
    Placed(Bounds, u32),
    /// Another piece.
    Piece(Bounds, usize),
}

/// Boxes in groups of equal ones: many in one place take obvhs quadratic time.
struct Groups {
    members: Vec<u32>,
    /// Where each group begins, and how many it has.
    runs: Vec<(u32, u32)>,
}

/// The input of a piece.
pub(super) struct Source<'a> {
    ground: Ground<'a>,
    /// Numbers of the boxes, in ascending order.
    members: Vec<u32>,
    boxes: Vec<Boxed>,
    /// `None` if all are different.
    groups: Option<Groups>,
    bvh: Bvh2,
    /// Boxes from here on are of placed meshes.
    placed: u32,
    /// Area from which leaves are worth splitting.
    least: f32,
    /// Plans of the nodes of obvhs's tree.
    plans: Vec<Plan>,
}

impl Piece {
    /// Grows a tree over boxes by number, of which there is one. It is balanced if it would otherwise have more nodes
    /// above each other than `deepest`.
    pub(super) fn grow(mut members: Vec<u32>, ground: Ground<'_>, deepest: usize) -> Self {
        members.sort_unstable();
        let boxes: Vec<Boxed> = members.iter().map(|at| (ground.boxed)(*at)).collect();
        let groups = Groups::of(&boxes);
        let params = BvhBuildParams { max_prims_per_leaf: LEAF_SIZE, ..BvhBuildParams::medium_build() };
        let bvh = match &groups {
            None => build_bvh2(&boxes, params, &mut Duration::default()),
            Some(groups) => {
                let firsts = groups.runs.iter().map(|run| groups.members[run.0 as usize]);
                let firsts: Vec<Boxed> = firsts.map(|at| Boxed(boxes[at as usize].0)).collect();
                build_bvh2(&firsts, params, &mut Duration::default())
            }
        };
        let mut source = Source { groups, bvh, ..Source::new(members, boxes, ground) };
        source.plan();
        let tree = Self::of(source.part(0), &source, deepest);
        if tree.depth <= deepest {
            return tree;
        }
        // A chain rather than a tree; its order, cut in halves, is as good.
        let order = source.members(&source.bvh.primitive_indices);
        Self::of(source.balanced(&order), &source, usize::MAX)
    }

    /// Writes a binary tree. It is not whole if it would have more nodes above each other than `deepest`.
    pub(super) fn of(tree: Part, source: &Source<'_>, deepest: usize) -> Self {
        let mut own = Self::default();
        own.depth = own.collapse(tree, source, deepest);
        own
    }

    /// Adds a leaf's block; returns its place.
    fn push_block(&mut self, leaf: &[u32], source: &Source<'_>) -> u32 {
        let (mut primitives, mut vertices) = (Vec::with_capacity(leaf.len()), Vec::with_capacity(leaf.len()));
        let mut triangles = Vec::with_capacity(leaf.len());
        for member in leaf {
            let primitive = source.members[*member as usize];
            let curved = match (source.ground.form)(primitive) {
                Primitive::Triangle(own) => {
                    triangles.push((primitive, own.map(|vertex| vertex.to_array())));
                    continue;
                }
                Primitive::Sphere(s) => Curved::Sphere { center: s.center, radius: s.radius },
                Primitive::Disk(d) => Curved::Disk(d),
            };
            primitives.push(CURVED | self.curved.len() as u32);
            vertices.push([[f32::NAN; 3]; 3]);
            self.curved.push((primitive, curved));
        }
        for (primitive, own) in triangles {
            primitives.push(primitive);
            vertices.push(own);
        }
        self.blocks.push(&primitives, &vertices, source.ground.small_blocks)
    }

    /// Writes the tree as nodes of eight, down to a depth. Returns how many are above each other, with those that are
    /// missing.
    fn collapse(&mut self, tree: Part, source: &Source<'_>, deepest: usize) -> usize {
        let Some(below) = deepest.checked_sub(1) else { return 1 };
        let index = self.nodes.len();
        self.nodes.push(Node { planes: [[0.0; WIDE]; 6], children: [LEAF; WIDE] });
        let mut parts = Vec::with_capacity(WIDE);
        let children = source.plan_of(&tree).children();
        source.open(tree, children, &mut parts);
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
                Some(Part::Piece(_, which)) => self.joints.push((index, lane, which)),
                Some(inner) => {
                    node.children[lane] = self.nodes.len() as u32;
                    depth = depth.max(self.collapse(inner, source, below));
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

impl<'a> Source<'a> {
    /// Takes boxes and their numbers, which ascend. It has no tree yet.
    pub(super) fn new(members: Vec<u32>, boxes: Vec<Boxed>, ground: Ground<'a>) -> Self {
        let placed = members.partition_point(|at| *at < ground.placed) as u32;
        let least = LARGE * ground.area;
        Self { ground, members, boxes, groups: None, bvh: Bvh2::default(), placed, least, plans: Vec::new() }
    }

    fn bounds(&self, part: &Part) -> Bounds {
        match part {
            Part::Node(node) => {
                let aabb = self.bvh.nodes[*node as usize].aabb();
                (aabb.min.into(), aabb.max.into())
            }
            Part::Inner(bounds, _) | Part::Leaf(bounds, _) | Part::Placed(bounds, _) | Part::Piece(bounds, _) => {
                *bounds
            }
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

    pub(super) fn pair(&self, a: Part, b: Part) -> Part {
        let bounds = union(self.bounds(&a), self.bounds(&b));
        let plan = Plan::new(half_area(bounds), self.plan_of(&a), self.plan_of(&b));
        Part::Inner(bounds, Box::new(([a, b], plan)))
    }

    fn plan_of<'b>(&'b self, part: &'b Part) -> &'b Plan {
        match part {
            Part::Node(at) => &self.plans[*at as usize],
            Part::Inner(_, inner) => &inner.1,
            Part::Leaf(..) | Part::Placed(..) | Part::Piece(..) => &Plan::LEAF,
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

    /// Whether all boxes are different, and of primitives rather than placed meshes.
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
            // Their plans have no halves.
            leaf @ (Part::Leaf(..) | Part::Placed(..) | Part::Piece(..)) => {
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
            [one] if *one >= self.placed => Part::Placed(bounds, self.members[*one as usize] - self.ground.placed),
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
