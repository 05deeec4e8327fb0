//! Rectangle and cube as meshes.

use tauflow_data::formats::Mesh;

/// The square [-1, 1]^2 in z = 0, normal +z, uv = (xy + 1) / 2.
pub fn rectangle() -> Mesh {
    Mesh {
        positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        uvs: Some(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
        ..Mesh::default()
    }
}

/// The cube [-1, 1]^3 with outward normals; each face has uv over the whole unit square.
pub fn cube() -> Mesh {
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    let uvs = mesh.uvs.get_or_insert_default();
    for axis in 0..3 {
        for side in [-1.0f32, 1.0] {
            let first = mesh.positions.len() as u32;
            // (axis, b, c) is a right-handed frame; for the negative side b and c change places.
            let (b, c) = if side > 0.0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
            for (s, t) in [(-1.0f32, -1.0f32), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let mut p = [0.0f32; 3];
                p[axis] = side;
                p[b] = s;
                p[c] = t;
                mesh.positions.push(p);
                uvs.push([(s + 1.0) * 0.5, (t + 1.0) * 0.5]);
            }
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    mesh
}
