//! Whether a mesh is closed, and which way it faces. Knows nothing of where the mesh comes from.

use crate::{
    geom::{cross, dot},
    mesh::Mesh,
};
use std::collections::BTreeMap;

/// The mesh's vertices welded by position: for each vertex, the number of its place.
pub fn welded(mesh: &Mesh) -> Vec<u32> {
    let mut places: BTreeMap<[u32; 3], u32> = BTreeMap::new();
    mesh.positions
        .iter()
        .map(|p| {
            // Adding 0 turns -0 into 0.
            let bits = p.map(|v| (v + 0.0).to_bits());
            let next = places.len() as u32;
            *places.entry(bits).or_insert(next)
        })
        .collect()
}

/// True if every edge, vertices welded by position, is used as often in one direction as in the other.
///
/// Triangles without area after welding do not count.
pub fn is_closed(mesh: &Mesh) -> bool {
    if mesh.triangles.is_empty() {
        return false;
    }
    let place = welded(mesh);
    let mut edges: Vec<(u32, u32, i32)> = Vec::with_capacity(mesh.triangles.len() * 3);
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| place[i as usize]);
        if a == b || b == c || c == a {
            continue;
        }
        for (x, y) in [(a, b), (b, c), (c, a)] {
            edges.push((x.min(y), x.max(y), if x < y { 1 } else { -1 }));
        }
    }
    edges.sort_unstable();
    edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).all(|run| run.iter().map(|e| e.2).sum::<i32>() == 0)
}

/// The volume enclosed, positive if triangles face outwards.
pub fn signed_volume(mesh: &Mesh) -> f64 {
    let p = |i: u32| mesh.positions[i as usize].map(f64::from);
    mesh.triangles.iter().map(|t| dot(p(t[0]), cross(p(t[1]), p(t[2])))).sum::<f64>() / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_face_opens_a_body() {
        let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        let mut mesh = Mesh { positions, triangles, ..Mesh::default() };
        assert!(is_closed(&mesh));
        assert!((signed_volume(&mesh) - 1.0 / 6.0).abs() < 1e-12);
        mesh.triangles.pop();
        assert!(!is_closed(&mesh));
    }
}
