//! Rectangle and cube as meshes. Their tangents say what normal maps are read by: s along growing u and t = n x s, as
//! Mitsuba has it.

use tauflow_data::mesh::Mesh;

/// The square [-1, 1]^2 in z = 0, normal +z, uv = (xy + 1) / 2.
pub fn rectangle() -> Mesh {
    Mesh {
        positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        uvs: Some(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
        tangents: Some(vec![[1.0, 0.0, 0.0, 1.0]; 4]),
        ..Mesh::default()
    }
}

/// The cube [-1, 1]^3 with outward normals; each face has uv over the whole unit square, turned as in Mitsuba's `cube`.
pub fn cube() -> Mesh {
    // Corners of each face, counter-clockwise from outside: at uv (0, 1), (1, 1), (1, 0), (0, 0).
    const FACES: [[[f32; 3]; 4]; 6] = [
        [[1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, -1.0, -1.0]],
        [[1.0, 1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]],
        [[1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]],
        [[1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0]],
        [[-1.0, -1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]],
        [[1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]],
    ];
    let mut mesh = Mesh { uvs: Some(Vec::new()), tangents: Some(Vec::new()), ..Mesh::default() };
    for corners in FACES {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(corners);
        mesh.uvs.get_or_insert_default().extend([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
        let [x, y, z] = [0, 1, 2].map(|i| 0.5 * (corners[1][i] - corners[0][i]));
        mesh.tangents.get_or_insert_default().extend([[x, y, z, 1.0]; 4]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first + 3, first, first + 2]]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn faces_look_outward_and_have_the_whole_of_uv() {
        let mesh = cube();
        let uvs = mesh.uvs.as_ref().expect("it has some");
        let tangents = mesh.tangents.as_ref().expect("it has some");
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| Vec3::from_array(mesh.positions[i as usize]));
            let normal = (b - a).cross(c - a);
            assert!(normal.dot(a + b + c) > 0.0 && (normal.length() - 4.0).abs() < 1e-6);
            let [p, q, r] = triangle.map(|i| glam::Vec2::from_array(uvs[i as usize]));
            let (d1, d2) = (q - p, r - p);
            let turned = d1.perp_dot(d2);
            assert_eq!(turned.abs(), 1.0);
            let dp_du = ((b - a) * d2.y - (c - a) * d1.y) * (0.5 * turned);
            assert_eq!(dp_du.extend(1.0).to_array(), tangents[triangle[0] as usize]);
        }
        // What Mitsuba 3.9 says of its cube: on top, u grows towards -x and v towards -z.
        let top = |x: f32, z: f32| {
            let at = mesh.positions[4..8].iter().position(|p| *p == [x, 1.0, z]).expect("a corner of the top");
            uvs[4 + at]
        };
        assert_eq!([top(1.0, 1.0), top(-1.0, 1.0), top(1.0, -1.0)], [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
    }
}
