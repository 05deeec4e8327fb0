//! Boxes that contain a body tightly, for collisions. Knows no thing.

use super::super::shapes::Body;
use tauflow_data::geom::{Aabb, Vec3, cross, sub};

/// Boxes of one body at most.
const BOXES: usize = 6;
/// Boxes of a whole thing at most.
const TOTAL: usize = 24;
/// Places tried for a cut along an axis, beside even ones.
const CUTS: usize = 24;
/// Up to so many faces are cut where their corners lie.
const FEW: usize = 400;

struct Face {
    corners: [Vec3; 3],
    /// Which way it looks along each axis; decides the side of a face that lies in a cut.
    normal: Vec3,
}

fn volume(bounds: &Aabb) -> f64 {
    // Nothing is thinner than 5 mm, so that sheets count.
    let size = bounds.size();
    if size[0] < 0.0 { 0.0 } else { size.map(|v| v.max(0.005)).iter().product() }
}

/// The part of a triangle between `low` and `high` along an axis, as a box.
fn clipped(corners: &[Vec3; 3], axis: usize, low: f64, high: f64) -> Aabb {
    let mut bounds = Aabb::EMPTY;
    for i in 0..3 {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        if a[axis] >= low && a[axis] <= high {
            bounds.grow(a);
        }
        for cut in [low, high] {
            if (a[axis] < cut) != (b[axis] < cut) {
                let t = (cut - a[axis]) / (b[axis] - a[axis]);
                let mut p = [0, 1, 2].map(|k| a[k] + t * (b[k] - a[k]));
                p[axis] = cut;
                bounds.grow(p);
            }
        }
    }
    bounds
}

fn between(face: &Face, axis: usize, low: f64, high: f64) -> Aabb {
    let (min, max) =
        face.corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p[axis]), b.max(p[axis])));
    if max < low || min > high {
        return Aabb::EMPTY;
    }
    if max - min < 1e-9 {
        // A face in the cut belongs to the body behind it.
        let behind_is_below = face.normal[axis] > 0.0;
        let touches_low = (min - low).abs() < 1e-9 && behind_is_below;
        let touches_high = (min - high).abs() < 1e-9 && !behind_is_below;
        if touches_low || touches_high {
            return Aabb::EMPTY;
        }
        return clipped(&face.corners, axis, low, high);
    }
    if (max - low) < 1e-9 || (high - min) < 1e-9 {
        return Aabb::EMPTY;
    }
    clipped(&face.corners, axis, low, high)
}

/// A box and the faces it must hold.
struct Cell {
    bounds: Aabb,
    within: Vec<usize>,
}

fn intersect(a: &Aabb, b: &Aabb) -> Aabb {
    Aabb { low: [0, 1, 2].map(|i| a.low[i].max(b.low[i])), high: [0, 1, 2].map(|i| a.high[i].min(b.high[i])) }
}

/// Places to cut a cell at, in order: where corners lie, for a small mesh, and evenly between.
fn cuts(faces: &[Face], cell: &Cell, axis: usize) -> Vec<f64> {
    let (low, high) = (cell.bounds.low[axis], cell.bounds.high[axis]);
    let even = if cell.within.len() > FEW { 12 } else { 6 };
    let mut places: Vec<f64> = Vec::new();
    if cell.within.len() <= FEW {
        places.extend(cell.within.iter().flat_map(|i| faces[*i].corners).map(|p| p[axis]));
        places.retain(|p| *p > low + 0.004 && *p < high - 0.004);
        places.sort_by(f64::total_cmp);
        places.dedup_by(|a, b| (*a - *b).abs() < 0.002);
        let n = places.len();
        if n > CUTS {
            places = (0..CUTS).map(|k| places[(2 * k + 1) * n / (2 * CUTS)]).collect();
        }
    }
    if high - low > 0.008 {
        places.extend((1..even).map(|k| low + (high - low) * f64::from(k) / f64::from(even)));
    }
    places.sort_by(f64::total_cmp);
    places.dedup();
    places
}

/// The saving of a cut of a cell, and its halves.
type Cut = (f64, Option<[Aabb; 2]>);

/// The best cut of a cell: what is saved, and the two halves.
fn best(faces: &[Face], cell: &Cell) -> (f64, Option<[Aabb; 2]>) {
    let whole = volume(&cell.bounds);
    let mut found = (0.0, None);
    for axis in 0..3 {
        let places = cuts(faces, cell, axis);
        // The content of each slab between two cuts; the box of a half is the union of its slabs' boxes.
        let edge = |k: usize| match k {
            0 => f64::NEG_INFINITY,
            k if k > places.len() => f64::INFINITY,
            k => places[k - 1],
        };
        let mut slabs = vec![Aabb::EMPTY; places.len() + 1];
        for i in &cell.within {
            let face = &faces[*i];
            let along = face.corners.map(|p| p[axis]);
            let (min, max) = (along[0].min(along[1]).min(along[2]), along[0].max(along[1]).max(along[2]));
            let first = places.partition_point(|p| *p < min - 1e-9);
            let last = places.partition_point(|p| *p <= max + 1e-9);
            for (k, slab) in slabs.iter_mut().enumerate().take(last + 1).skip(first) {
                let part = between(face, axis, edge(k), edge(k + 1));
                if part.low[0] <= part.high[0] {
                    *slab = slab.union(&part);
                }
            }
        }
        let mut above = vec![Aabb::EMPTY; slabs.len() + 1];
        for k in (0..slabs.len()).rev() {
            above[k] = joined(&above[k + 1], &slabs[k]);
        }
        let mut below = Aabb::EMPTY;
        for k in 0..places.len() {
            below = joined(&below, &slabs[k]);
            let halves = [intersect(&below, &cell.bounds), intersect(&above[k + 1], &cell.bounds)];
            let saved = whole - volume(&halves[0]) - volume(&halves[1]);
            if saved > found.0 {
                found = (saved, Some(halves));
            }
        }
    }
    found
}

/// The union of two boxes, either of which may be empty.
fn joined(a: &Aabb, b: &Aabb) -> Aabb {
    match (a.low[0] <= a.high[0], b.low[0] <= b.high[0]) {
        (true, true) => a.union(b),
        (true, false) => *a,
        (false, _) => *b,
    }
}

/// Boxes around one body.
pub fn boxes(body: &Body) -> Vec<Aabb> {
    let faces: Vec<Face> = body
        .triangles
        .iter()
        .map(|t| {
            let corners = t.map(|i| body.points[i as usize]);
            Face { corners, normal: cross(sub(corners[1], corners[0]), sub(corners[2], corners[0])) }
        })
        .collect();
    let mut bounds = Aabb::EMPTY;
    faces.iter().flat_map(|f| f.corners).for_each(|p| bounds.grow(p));
    let whole = volume(&bounds);
    let mut cells = vec![(Cell { bounds, within: (0..faces.len()).collect() }, None)];
    // A dozen triangles along the axes are a box already.
    if faces.len() > 12 || faces.iter().any(|f| f.normal.iter().filter(|n| n.abs() > 1e-12).count() > 1) {
        while cells.len() < BOXES {
            for (cell, cut) in &mut cells {
                if cut.is_none() {
                    *cut = Some(best(&faces, cell));
                }
            }
            let saved = |c: &(Cell, Option<Cut>)| c.1.as_ref().map_or(0.0, |cut| cut.0);
            let Some(k) = (0..cells.len()).max_by(|a, b| saved(&cells[*a]).total_cmp(&saved(&cells[*b]))) else {
                break;
            };
            if saved(&cells[k]) < 0.04 * whole {
                break;
            }
            let (cell, cut) = cells.swap_remove(k);
            for bounds in cut.and_then(|(_, halves)| halves).into_iter().flatten() {
                let within = cell.within.iter().copied().filter(|i| overlaps(&faces[*i], &bounds)).collect();
                cells.push((Cell { bounds, within }, None));
            }
        }
    }
    cells.into_iter().map(|(cell, _)| cell.bounds).filter(|b| b.low[0] <= b.high[0]).collect()
}

fn overlaps(face: &Face, bounds: &Aabb) -> bool {
    (0..3).all(|k| {
        face.corners.iter().any(|p| p[k] >= bounds.low[k] - 1e-12)
            && face.corners.iter().any(|p| p[k] <= bounds.high[k] + 1e-12)
    })
}

/// Fewer boxes that hold all of these: pairs that waste least become one, until few are left and none is cheap.
pub fn merged(mut boxes: Vec<Aabb>) -> Vec<Aabb> {
    let whole = volume(&boxes.iter().fold(Aabb::EMPTY, tauflow_data::geom::Aabb::union));
    // Of very many boxes first those that follow one another, so that the search stays small.
    while boxes.len() > 160 {
        boxes = boxes.chunks(2).map(|pair| pair.iter().fold(Aabb::EMPTY, tauflow_data::geom::Aabb::union)).collect();
    }
    let waste = |a: &Aabb, b: &Aabb| volume(&a.union(b)) - volume(a) - volume(b);
    // For each box the later one that it wastes least with; a merge changes few of these.
    let mut live: Vec<usize> = (0..boxes.len()).collect();
    let partner = |boxes: &[Aabb], live: &[usize], i: usize| {
        let later = live.iter().copied().filter(|j| *j > i);
        later.map(|j| (waste(&boxes[i], &boxes[j]), j)).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, i))
    };
    let mut best: Vec<(f64, usize)> = (0..boxes.len()).map(|i| partner(&boxes, &live, i)).collect();
    loop {
        let found = live.iter().copied().min_by(|a, b| best[*a].0.total_cmp(&best[*b].0));
        let Some(i) = found.filter(|i| best[*i].0.is_finite()) else { break };
        let (lost, j) = best[i];
        if live.len() <= TOTAL && lost > 0.003 * whole {
            break;
        }
        boxes[i] = boxes[i].union(&boxes[j]);
        live.retain(|k| *k != j);
        for k in live.clone() {
            if k == i || best[k].1 == i || best[k].1 == j {
                best[k] = partner(&boxes, &live, k);
            } else if k < i {
                let now = waste(&boxes[k], &boxes[i]);
                if now < best[k].0 {
                    best[k] = (now, i);
                }
            }
        }
    }
    live.into_iter().map(|i| boxes[i]).collect()
}
