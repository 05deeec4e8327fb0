//! Which nodes of a binary tree become nodes of eight children.
//!
//! Ylitie, Karras, Laine 2017, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs*, section 3.3:
//! of all ways to join nodes, that in which a ray is expected to visit the fewest nodes and children, by their areas.

use super::WIDE;

/// The cost of testing a child of a node, compared with the node itself. A single ray tests all children at once, and
/// lists of rays test one after another.
const EACH: f32 = 0.1;

/// A node of the binary tree, for each number of children of a wide node that may represent it.
#[derive(Clone, Copy)]
pub(super) struct Plan {
    /// Cost of the wide nodes below, and of its own if it is one.
    cost: [f32; WIDE],
    /// How many of the children represent its first half; 0 if one child less represents it better.
    first: [u8; WIDE],
    /// Number of children, if this becomes a wide node.
    children: u8,
}

impl Plan {
    /// The plan of a leaf, which is not opened.
    pub(super) const LEAF: Self = Self { cost: [0.0; WIDE], first: [0; WIDE], children: 0 };

    /// The plan of a node, by its area and the plans of its halves.
    pub(super) fn new(area: f32, a: &Self, b: &Self) -> Self {
        let mut own = Self { children: WIDE as u8, ..Self::LEAF };
        let mut whole = f32::INFINITY;
        for children in 2..=WIDE {
            let at = children - 1;
            // Even halves, unless others cost less: areas may be 0, or too large for a number.
            let even = children / 2;
            let mut best = (a.cost[even - 1] + b.cost[children - even - 1], even as u8);
            for first in 1..children {
                let cost = a.cost[first - 1] + b.cost[children - first - 1];
                if cost < best.0 {
                    best = (cost, first as u8);
                }
            }
            (own.cost[at], own.first[at]) = best;
            let cost = area + best.0 + EACH * area * children as f32;
            if cost <= whole {
                whole = cost;
                own.children = children as u8;
            }
        }
        own.cost[0] = whole;
        for at in 1..WIDE {
            // Not where they are equal, as of boxes without extent: a wide node is opened in any case.
            if own.cost[at - 1] < own.cost[at] {
                (own.cost[at], own.first[at]) = (own.cost[at - 1], 0);
            }
        }
        own
    }

    /// How many children this has if it becomes a wide node.
    pub(super) fn children(&self) -> usize {
        usize::from(self.children)
    }

    /// How many of so many children represent each half; `None` if one represents the whole.
    pub(super) fn first_of(&self, mut children: usize) -> Option<(usize, usize)> {
        while children > 1 {
            match self.first[children - 1] {
                0 => children -= 1,
                first => return Some((usize::from(first), children - usize::from(first))),
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_nodes_are_opened_whatever_the_areas() {
        for area in [1.0, 0.0, 1e-45, f32::MAX, f32::INFINITY, f32::NAN] {
            let mut plan = Plan::LEAF;
            for _ in 0..20 {
                plan = Plan::new(area, &plan, &Plan::LEAF);
                assert!(plan.first_of(plan.children()).is_some(), "{area}");
            }
        }
    }

    #[test]
    fn eight_leaves_of_one_size_are_one_node() {
        let mut level = [Plan::LEAF; 8];
        for count in [4, 2, 1] {
            for at in 0..count {
                level[at] = Plan::new(1.0, &level[2 * at], &level[2 * at + 1]);
            }
        }
        let own = &level[0];
        assert_eq!((own.children(), own.first_of(8), own.first_of(1)), (8, Some((4, 4)), None));
        assert!((own.cost[0] - 1.8).abs() < 1e-6);
    }
}
