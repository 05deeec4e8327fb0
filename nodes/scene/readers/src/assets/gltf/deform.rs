//! Morph targets and skins: vertices in the default pose. Knows nothing of nodes but the matrices that they make.
//!
//! Source: glTF 2.0, sections 3.7.2.2 (morph targets) and 3.7.3 (skins).

use super::{
    accessor::{self, Values},
    primitive::{Directions, Piece, Source},
};
use crate::assets::refusal::{Refusal, damaged};
use gltf::json::{Index, accessor::Accessor, mesh::Semantic};
use tauflow_data::{
    geom::{Vec3, add, apply, mul},
    records::AssetReport,
    scene::Affine,
};

/// Sum of a vertex's weights beyond whose distance from 1 they are wrong, and not only rounded.
const ROUNDED: f64 = 0.01;

/// Adds morph targets by their weights: to positions, normals and tangents.
///
/// # Errors
/// If there are more weights than targets, or a target is damaged.
pub fn morph(source: &Source<'_>, weights: &[f64], piece: &mut Piece, report: &mut AssetReport) -> Result<(), Refusal> {
    let targets = source.primitive.targets.as_deref().unwrap_or_default();
    if targets.is_empty() {
        if weights.iter().any(|w| *w != 0.0) {
            report.note("primitives without morph targets stay as they are, whatever their mesh's weights");
        }
        return Ok(());
    }
    if weights.len() > targets.len() {
        let what = format!("{} weights for {} morph targets", weights.len(), targets.len());
        return Err(damaged(source.place, what));
    }
    for (number, (target, weight)) in targets.iter().zip(weights).enumerate().filter(|(_, (_, w))| **w != 0.0) {
        let count = piece.positions.len();
        let deltas = |accessor: Option<Index<Accessor>>, name: &str| -> Result<Vec<Vec3>, Refusal> {
            let Some(index) = accessor else { return Ok(Vec::new()) };
            let values = accessor::values(source.document, index.value())?;
            let place = format!("{} target {number} {name}", source.place);
            if values.width != 3 {
                return Err(damaged(place, format!("vectors of {} numbers", values.width)));
            }
            if values.len() != count {
                return Err(damaged(place, format!("{} elements for {count} positions", values.len())));
            }
            Ok(values.vectors::<3>(0.0))
        };
        for (position, delta) in piece.positions.iter_mut().zip(deltas(target.positions, "POSITION")?) {
            *position = add(*position, mul(delta, *weight));
        }
        if let Some(normals) = &mut piece.normals {
            for (normal, delta) in normals.iter_mut().zip(deltas(target.normals, "NORMAL")?) {
                *normal = add(*normal, mul(delta, *weight));
            }
        }
        if let Some(tangents) = &mut piece.tangents {
            for (tangent, delta) in tangents.iter_mut().zip(deltas(target.tangents, "TANGENT")?) {
                let [x, y, z] = add([tangent[0], tangent[1], tangent[2]], mul(delta, *weight));
                *tangent = [x, y, z, tangent[3]];
            }
        }
    }
    Ok(())
}

/// Joints of four to a vertex, and their weights.
struct Set {
    joints: Values,
    weights: Values,
}

fn sets(source: &Source<'_>, count: usize) -> Result<Vec<Set>, Refusal> {
    let mut out = Vec::new();
    loop {
        let set = out.len() as u32;
        let names = [format!("JOINTS_{set}"), format!("WEIGHTS_{set}")];
        let joints = source.get(Semantic::Joints(set), &names[0], Some(count))?;
        let weights = source.get(Semantic::Weights(set), &names[1], Some(count))?;
        match (joints, weights) {
            (Some(joints), Some(weights)) => {
                let whole = joints.integers || source.draco.is_some();
                if !whole {
                    return Err(damaged(format!("{} {}", source.place, names[0]), "they are no whole numbers"));
                }
                out.push(Set { joints, weights });
            }
            (None, None) => return Ok(out),
            _ => {
                let what = format!("only one of {} and {}", names[0], names[1]);
                return Err(damaged(source.place, what));
            }
        }
    }
}

/// Moves a piece by what its joints do to vertices; false if it has no joints.
///
/// Triangles whose joints mirror them are turned round, so that outside stays outside.
///
/// # Errors
/// If a vertex names a joint that is not there, or has a weight that is negative or not finite.
pub fn skin(
    source: &Source<'_>,
    matrices: &[Affine],
    piece: &mut Piece,
    report: &mut AssetReport,
) -> Result<bool, Refusal> {
    let count = piece.positions.len();
    let sets = sets(source, count)?;
    if sets.is_empty() {
        return Ok(false);
    }
    let joint = |set: usize, at: usize| {
        let joint = sets[set].joints.data[at];
        let matrix = (joint >= 0.0).then(|| matrices.get(joint as usize)).flatten();
        matrix.ok_or_else(|| {
            let what = format!("vertex {} names joint {joint} of {}", at / 4, matrices.len());
            damaged(format!("{} JOINTS_{set}", source.place), what)
        })
    };
    let (mut off, mut free) = (0, 0);
    let mut mirrored = vec![false; count];
    for vertex in 0..count {
        let (mut sum, mut blend) = (0.0, [[0.0; 4]; 3]);
        for (number, set) in sets.iter().enumerate() {
            for at in 4 * vertex..4 * vertex + 4 {
                let weight = set.weights.data[at];
                if !(weight >= 0.0 && weight.is_finite()) {
                    let place = format!("{} WEIGHTS_{number}", source.place);
                    return Err(damaged(place, format!("vertex {vertex} has a weight of {weight}")));
                }
                // A joint without weight may be any number.
                if weight > 0.0 {
                    let matrix = joint(number, at)?;
                    let cells = blend.iter_mut().flatten().zip(matrix.iter().flatten());
                    cells.for_each(|(cell, value)| *cell += weight * value);
                    sum += weight;
                }
            }
        }
        if sum > 0.0 {
            off += u64::from((sum - 1.0f64).abs() > ROUNDED && source.draco.is_none());
            blend.iter_mut().flatten().for_each(|cell| *cell /= sum);
        } else {
            free += 1;
            blend = *joint(0, 4 * vertex)?;
        }
        piece.positions[vertex] = apply(&blend, piece.positions[vertex]);
        let directions = Directions::of(&blend);
        if let Some(normals) = &mut piece.normals {
            normals[vertex] = directions.normal(normals[vertex]);
        }
        if let Some(tangents) = &mut piece.tangents {
            tangents[vertex] = directions.tangent(tangents[vertex]);
        }
        mirrored[vertex] = directions.mirrors;
    }
    report.repaired("vertices whose weights of joints do not sum to 1 scaled", off);
    report.repaired("vertices without a weight moved by their first joint", free);
    for triangle in &mut piece.triangles {
        if triangle.iter().filter(|i| mirrored[**i as usize]).count() > 1 {
            triangle.swap(1, 2);
        }
    }
    Ok(true)
}
