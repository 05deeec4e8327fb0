//! The top of a large tree: primitives are divided between pieces.
//!
//! Boxes are divided by their centres, where the sum of both sides' areas times their boxes is least (Wald 2007, *On
//! fast Construction of SAH-based Bounding Volume Hierarchies*).

use super::{
    build::{Bounds, Boxed, PIECE, half_area, union},
    piece::{Ground, Part, Piece, Source},
};
use glam::Vec3;
use std::ops::Range;

/// Intervals of centres on each axis.
const BINS: usize = 32;
/// A side has at least this share of the boxes, so that the tree is not deep.
const LEAST: usize = 4;

/// Divides boxes between pieces. Returns the tree of pieces, and which boxes each has.
pub(super) fn split(members: &mut [u32], boxes: &[Boxed], ground: Ground<'_>) -> (Piece, Vec<Range<usize>>) {
    let source = Source::new(Vec::new(), Vec::new(), ground);
    let mut ranges = Vec::new();
    let tree = divide(members, 0, boxes, &source, &mut ranges);
    (Piece::of(tree, &source, usize::MAX), ranges)
}

fn divide(
    members: &mut [u32],
    first: usize,
    boxes: &[Boxed],
    source: &Source<'_>,
    ranges: &mut Vec<Range<usize>>,
) -> Part {
    if members.len() <= PIECE as usize {
        ranges.push(first..first + members.len());
        let bounds = members.iter().map(|at| boxes[*at as usize].0).reduce(union).unwrap_or_default();
        return Part::Piece(bounds, ranges.len() - 1);
    }
    let middle = partition(members, boxes);
    let (a, b) = members.split_at_mut(middle);
    let a = divide(a, first, boxes, source, ranges);
    let b = divide(b, first + middle, boxes, source, ranges);
    source.pair(a, b)
}

/// Twice the centre.
fn center(Boxed((low, high)): &Boxed) -> Vec3 {
    *low + *high
}

/// Orders boxes into two sides; returns how many the first has.
fn partition(members: &mut [u32], boxes: &[Boxed]) -> usize {
    let of = |at: &u32| &boxes[*at as usize];
    let centers = members
        .iter()
        .map(|at| center(of(at)))
        .fold((Vec3::MAX, Vec3::MIN), |all, own| (all.0.min(own), all.1.max(own)));
    let scale = (centers.1 - centers.0).map(|extent| if extent > 0.0 { BINS as f32 / extent } else { 0.0 });
    let bin = |at: &u32, axis: usize| (((center(of(at)) - centers.0)[axis] * scale[axis]) as usize).min(BINS - 1);
    let mut bins = [[(0usize, EMPTY); BINS]; 3];
    for at in members.iter() {
        for (axis, bins) in bins.iter_mut().enumerate() {
            let (count, bounds) = &mut bins[bin(at, axis)];
            *count += 1;
            *bounds = union(*bounds, of(at).0);
        }
    }
    let mut best: Option<(f32, usize, usize)> = None;
    for (axis, bins) in bins.iter().enumerate() {
        for end in 1..BINS {
            let side = |part: &[(usize, Bounds)]| {
                part.iter().fold((0, EMPTY), |all, own| (all.0 + own.0, union(all.1, own.1)))
            };
            let (a, b) = (side(&bins[..end]), side(&bins[end..]));
            if a.0.min(b.0) * LEAST < members.len() {
                continue;
            }
            let cost = half_area(a.1) * a.0 as f32 + half_area(b.1) * b.0 as f32;
            if best.is_none_or(|best| cost < best.0) {
                best = Some((cost, axis, end));
            }
        }
    }
    let Some((_, axis, end)) = best else {
        // Most centres are in one place.
        let middle = members.len() / 2;
        let axis = (centers.1 - centers.0).max_position();
        members
            .select_nth_unstable_by(middle, |a, b| center(of(a))[axis].total_cmp(&center(of(b))[axis]).then(a.cmp(b)));
        return middle;
    };
    let mut middle = 0;
    for at in 0..members.len() {
        if bin(&members[at], axis) < end {
            members.swap(at, middle);
            middle += 1;
        }
    }
    middle
}

/// Bounds of nothing.
const EMPTY: Bounds = (Vec3::MAX, Vec3::MIN);
