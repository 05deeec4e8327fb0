//! Emission of double-sided materials, which is on the front alone here: whether its lack on the back can be seen.
//!
//! Source of the solid angle: van Oosterom and Strackee, *The Solid Angle of a Plane Triangle*, 1983.

use tauflow_data::{
    geom::{Aabb, Vec3, apply, cross, dot, length, sub},
    maths::atan2,
    mesh::Mesh,
    mesh_check::signed_volume,
    records::AssetMaterial,
    scene::{Affine, Bsdf},
};

/// The note on it.
pub const NOTE: &str = "emission of double-sided surfaces is on their front alone";

/// Whether the back of a mesh can be seen where `maps` put it, by an `eye` or, without one, from outside.
///
/// A closed opaque body hides its back from all that is on its front side.
pub fn shows_back(mesh: &Mesh, closed: bool, material: &AssetMaterial, maps: &[Affine], eye: Option<Vec3>) -> bool {
    if !closed || material.transmissive || matches!(material.own, Bsdf::Mask { .. }) {
        return true;
    }
    let mut own = Aabb::EMPTY;
    mesh.positions.iter().for_each(|p| own.grow(p.map(f64::from)));
    let near = |map: &&Affine| {
        let Aabb { low, high } = own.mapped(map);
        eye.is_some_and(|eye| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&eye[axis])))
    };
    let front_is_inside = signed_volume(mesh) < 0.0;
    match (maps, eye) {
        ([map], Some(eye)) if near(&map) => encloses(mesh, map, eye) != front_is_inside,
        // Each copy would have to be searched.
        _ => front_is_inside || maps.iter().any(|map| near(&map)),
    }
}

/// Whether a closed mesh has a point inside: the solid angle of its triangles is then that of a sphere, otherwise 0.
fn encloses(mesh: &Mesh, map: &Affine, eye: Vec3) -> bool {
    let corner = |i: u32| sub(apply(map, mesh.positions[i as usize].map(f64::from)), eye);
    let halves = mesh.triangles.iter().map(|triangle| {
        let [a, b, c] = triangle.map(corner);
        let [la, lb, lc] = [a, b, c].map(length);
        let below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
        atan2(dot(a, cross(b, c)), below)
    });
    halves.sum::<f64>().abs() > core::f64::consts::PI
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{
        geom::{scaling, translation},
        scene::{IDENTITY, Texture},
    };

    /// A tetrahedron that faces outwards or inwards.
    fn body(outwards: bool) -> Mesh {
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        Mesh {
            positions: vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]],
            triangles: faces.map(|[a, b, c]| if outwards { [a, b, c] } else { [a, c, b] }).to_vec(),
            ..Mesh::default()
        }
    }

    #[test]
    fn a_body_hides_its_back_from_those_on_its_front_side() {
        let own = Bsdf::Diffuse { reflectance: Texture::scalar(0.5) };
        let opaque = AssetMaterial { own: own.clone(), diffuse: own, transmissive: false, emission: None };
        let (inside, beside, outside) = ([0.5; 3], [3.0; 3], [9.0, 0.0, 0.0]);
        let shows = |outwards, maps: &[Affine], eye| shows_back(&body(outwards), true, &opaque, maps, eye);
        for map in [IDENTITY, scaling([1.0, 1.0, -1.0])] {
            let at = |eye: Vec3| Some(apply(&map, eye));
            for (eye, is_inside) in [(at(inside), true), (at(beside), false), (at(outside), false), (None, false)] {
                assert_eq!(shows(true, &[map], eye), is_inside, "{eye:?}");
                assert_eq!(shows(false, &[map], eye), !is_inside, "{eye:?}");
            }
        }
        // Of several copies, none may be near.
        let copies = [IDENTITY, translation([20.0, 0.0, 0.0])];
        assert!(!shows(true, &copies, Some(outside)) && shows(true, &copies, Some(beside)));
        assert!(shows(false, &copies, Some(inside)));
        assert!(shows_back(&body(true), false, &opaque, &[IDENTITY], None), "an open one");
        let clear = AssetMaterial { transmissive: true, ..opaque };
        assert!(shows_back(&body(true), true, &clear, &[IDENTITY], None), "a transparent one");
    }
}
