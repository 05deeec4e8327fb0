//! Which nodes of a binary tree become nodes of eight children.
//!
//! Ylitie, Karras, Laine 2017, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs*, section 3.3:
//! of all ways to join nodes, that with the least sum of areas, which is the expected number of nodes that a ray visits.

use super::WIDE;

/// A node of the binary tree, for each number of children of a wide node that may represent it.
#[derive(Clone, Copy)]
pub(super) struct Plan {
    /// Sum of the areas of the wide nodes below, and of its own if it is one.
    cost: [f32; WIDE],
    /// How many of the children represent its first half; 0 if it is better represented by one child less.
    first: [u8; WIDE],
}

impl Plan {
    /// Of what is not opened.
    pub(super) const LEAF: Self = Self { cost: [0.0; WIDE], first: [0; WIDE] };

    /// Of a node of an area and two halves.
    pub(super) fn new(area: f32, a: &Self, b: &Self) -> Self {
        let mut own = Self::LEAF;
        let mut opened = f32::INFINITY;
        for children in 2..=WIDE {
            let at = children - 1;
            let mut best = (f32::INFINITY, 1);
            for first in 1..children {
                let cost = a.cost[first - 1] + b.cost[children - first - 1];
                if cost < best.0 {
                    best = (cost, first as u8);
                }
            }
            (own.cost[at], own.first[at]) = best;
            opened = best.0;
        }
        own.cost[0] = area + opened;
        for at in 1..WIDE {
            if own.cost[at] >= own.cost[at - 1] && at + 1 < WIDE {
                (own.cost[at], own.first[at]) = (own.cost[at - 1], 0);
            }
        }
        own
    }

    /// How many of so many children represent the first half; `None` if one represents the whole.
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
