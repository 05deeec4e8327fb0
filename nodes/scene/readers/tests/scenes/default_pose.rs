//! Files in their default pose: skins, morph targets and instances, at positions worked out by hand.

use crate::small_assets::{Data, asset, folder, mesh};
use serde_json::{Value, json as object};
use std::fs;
use tauflow_contract::MemoryBlobs;
use tauflow_data::{
    mesh::Mesh,
    records::{Asset, AssetBody, AssetReport},
};

/// A pixel of (128, 128, 255): a normal map that bends nothing.
pub const PNG: &str = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR42mNoaPgPAAODAgA+WCglAAAAAElFTkSuQmCC";

/// Writes and reads a file: its report, its asset and the meshes of its parts.
pub fn read(name: &str, bytes: &[u8]) -> (AssetReport, Asset, Vec<Mesh>) {
    let path = folder("default-pose").join(format!("{name}.glb"));
    fs::write(&path, bytes).expect("writable");
    let blobs = MemoryBlobs::default();
    let (report, asset) = asset(&blobs, &path);
    let AssetBody::Object { parts, .. } = &asset.body else { panic!("no object") };
    let meshes = (0..parts.len()).map(|part| mesh(&blobs, &asset, part)).collect();
    (report, asset, meshes)
}

/// Points in the box of an object: largest side 1, on y = 0, about the y axis.
fn boxed(points: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let along = |c: usize| points.iter().map(move |p| p[c]);
    let low = [0, 1, 2].map(|c| along(c).fold(f64::INFINITY, f64::min));
    let high = [0, 1, 2].map(|c| along(c).fold(f64::NEG_INFINITY, f64::max));
    let side = (0..3).map(|c| high[c] - low[c]).fold(0.0, f64::max);
    let from = [0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])];
    points.iter().map(|p| [0, 1, 2].map(|c| (p[c] - from[c]) / side)).collect()
}

/// Holds a mesh's vertices, in the order of their first use, against points of the file's space. The points of `other`
/// parts count for the box.
fn stands_at(mesh: &Mesh, points: &[[f64; 3]], other: &[[f64; 3]]) {
    let expected = boxed(&[points, other].concat());
    assert_eq!(mesh.positions.len(), points.len(), "{mesh:?}");
    for (found, expected) in mesh.positions.iter().zip(&expected) {
        let near = found.iter().zip(expected).all(|(f, e)| (f64::from(*f) - e).abs() < 1e-5);
        assert!(near, "{found:?} and not {expected:?}: {:?}", mesh.positions);
    }
}

fn points_along(found: &[f32], expected: [f64; 3]) {
    let length = expected.iter().map(|v| v * v).sum::<f64>().sqrt();
    let near = found.iter().zip(expected).all(|(f, e)| (f64::from(*f) - e / length).abs() < 1e-5);
    assert!(near, "{found:?} and not {expected:?}");
}

/// Normal of a mesh's triangle by its winding.
fn winding(mesh: &Mesh, triangle: usize) -> [f32; 3] {
    let [a, b, c] = mesh.triangles[triangle].map(|i| mesh.positions[i as usize]);
    let (u, v) = ([0, 1, 2].map(|i| b[i] - a[i]), [0, 1, 2].map(|i| c[i] - a[i]));
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// A matrix that moves, by columns.
fn moved(x: f32, y: f32, z: f32) -> [f32; 16] {
    [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0]
}

const BUMPS: &str = "a material with a normal map reads tangents";

fn bumpy(rest: &mut Value) {
    let fields = rest.as_object_mut().expect(BUMPS);
    fields.insert("images".into(), object!([{ "uri": format!("data:image/png;base64,{PNG}") }]));
    fields.insert("textures".into(), object!([{ "source": 0 }]));
    fields.insert("materials".into(), object!([{ "normalTexture": { "index": 0 } }]));
}

/// A square of four vertices on two joints of two sets. The second joint turns by 90 degrees about z, is twice as long
/// along its x, and hangs two above the first's origin.
fn arm() -> (Data, Value) {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 3.0, 0.0, 1.0, 2.0, 0.0], "VEC3", 3);
    let slope = core::f32::consts::FRAC_1_SQRT_2;
    let normals = data.floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, slope, slope, 0.0, 0.0, 0.0, 1.0], "VEC3", 3);
    let rest = [1.0, 0.0, 0.0, 1.0];
    let tangents = data.floats(&[rest, rest, [slope, -slope, 0.0, -1.0], rest].concat(), "VEC4", 4);
    let uvs = data.floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0], "VEC2", 2);
    let indices = data.accessor(&[0, 1, 2, 2, 1, 3], 5121, "SCALAR", 6, false);
    // The third vertex hangs on the second joint, and the last one on both, by different sets.
    let joints = data.accessor(&[0, 9, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0], 5121, "VEC4", 4, false);
    let one = [1.0f32, 0.0, 0.0, 0.0];
    let weights = data.floats(&[one, one, one, [0.5, 0.0, 0.0, 0.0]].concat(), "VEC4", 4);
    let second: Vec<u8> =
        [[0u16; 4], [0; 4], [0; 4], [0, 1, 0, 0]].concat().iter().flat_map(|j| j.to_le_bytes()).collect();
    let second = data.accessor(&second, 5123, "VEC4", 4, false);
    let half = data.floats(&[[0.0f32; 4], [0.0; 4], [0.0; 4], [0.0, 0.5, 0.0, 0.0]].concat(), "VEC4", 4);
    let inverse = data.floats(&[moved(0.0, -1.0, 0.0), moved(0.0, -2.0, 0.0)].concat(), "MAT4", 16);
    let mut file = object!({
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": positions, "NORMAL": normals, "TANGENT": tangents,
            "TEXCOORD_0": uvs, "JOINTS_0": joints, "WEIGHTS_0": weights, "JOINTS_1": second, "WEIGHTS_1": half },
            "indices": indices, "material": 0 }] }],
        "skins": [{ "joints": [1, 2], "inverseBindMatrices": inverse }],
        "nodes": [{ "mesh": 0, "skin": 0, "translation": [100, 7, 3] }, { "children": [2], "translation": [0, 1, 0] },
            { "translation": [0, 1, 0], "rotation": [0, 0, slope, slope], "scale": [2, 1, 1] }],
        "scenes": [{ "nodes": [0, 1] }],
    });
    bumpy(&mut file);
    (data, file)
}

/// Where the arm's vertices go. A point p of the second joint: p - (0, 2, 0), x doubled, (x, y) to (-y, x), and
/// + (0, 2, 0). So (0, 3, 0) goes to (-1, 2, 0) and (1, 2, 0) to (0, 4, 0), half-way to itself at (0.5, 3, 0).
const ARM: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [0.5, 3.0, 0.0]];

#[test]
fn skins_stand_where_their_joints_are() {
    let (data, file) = arm();
    let (report, _, meshes) = read("arm", &data.file(file));
    stands_at(&meshes[0], &ARM, &[]);
    assert!(report.repairs.is_empty(), "{report:?}");
    // By the inverse transpose (1, 1) becomes (1/2, 1), and turned (-1, 1/2).
    let normals = meshes[0].normals.as_ref().expect("smooth");
    points_along(&normals[2], [-1.0, 0.5, 0.0]);
    points_along(&normals[0], [0.0, 0.0, 1.0]);
    // (1, -1) becomes (2, -1), and turned (1, 2); nothing is mirrored.
    let tangents = meshes[0].tangents.as_ref().expect(BUMPS);
    points_along(&tangents[2][..3], [1.0, 2.0, 0.0]);
    assert_eq!((tangents[2][3], tangents[0][3]), (-1.0, 1.0));
}

#[test]
fn joints_outside_of_the_scene_are_found_by_their_parents() {
    let (data, mut file) = arm();
    // A parent above the first joint, which moves by 3 along z and lays y down along z, in no scene.
    let half = core::f32::consts::FRAC_1_SQRT_2;
    let nodes = file["nodes"].as_array_mut().expect("nodes");
    nodes.push(object!({ "children": [1], "translation": [0, 0, 3], "rotation": [half, 0, 0, half] }));
    file["scenes"] = object!([{ "nodes": [0] }]);
    let (_, _, meshes) = read("outside", &data.file(file));
    stands_at(&meshes[0], &ARM.map(|[x, y, z]| [x, -z, 3.0 + y]), &[]);
    points_along(&meshes[0].normals.as_ref().expect("smooth")[0], [0.0, -1.0, 0.0]);
}

#[test]
fn a_mesh_on_several_skins_stands_several_times_and_once_on_each() {
    let (data, mut file) = arm();
    // A second pair of joints, 5 further along x. The third node has the first skin again.
    let inverse = file["skins"][0]["inverseBindMatrices"].clone();
    let slope = core::f32::consts::FRAC_1_SQRT_2;
    for node in [
        object!({ "mesh": 0, "skin": 1 }),
        object!({ "mesh": 0, "skin": 0, "translation": [-50, 0, 0] }),
        object!({ "children": [6], "translation": [5, 1, 0] }),
        object!({ "translation": [0, 1, 0], "rotation": [0, 0, slope, slope], "scale": [2, 1, 1] }),
    ] {
        file["nodes"].as_array_mut().expect("nodes").push(node);
    }
    file["skins"].as_array_mut().expect("skins").push(object!({ "joints": [5, 6], "inverseBindMatrices": inverse }));
    file["scenes"] = object!([{ "nodes": [0, 1, 3, 4, 5] }]);
    let (report, _, meshes) = read("crowd", &data.file(file));
    let other = ARM.map(|[x, y, z]| [x + 5.0, y, z]);
    assert_eq!(meshes.len(), 2);
    stands_at(&meshes[0], &ARM, &other);
    stands_at(&meshes[1], &other, &ARM);
    assert_eq!(report.repairs["copies of a skinned mesh on the same joints left out"], 1, "{report:?}");
}

#[test]
fn joints_that_mirror_keep_outside_outside() {
    let (data, mut file) = arm();
    // Both joints mirror x about x = 0.
    file["nodes"][1] = object!({ "children": [2], "scale": [-1, 1, 1] });
    file["nodes"][2] = object!({});
    file["skins"][0].as_object_mut().expect("a skin").remove("inverseBindMatrices");
    let (_, _, meshes) = read("mirror", &data.file(file));
    stands_at(&meshes[0], &[[0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [-1.0, 0.0, 0.0], [-1.0, 2.0, 0.0]], &[]);
    for triangle in 0..2 {
        assert!(winding(&meshes[0], triangle)[2] > 0.0, "{:?}", meshes[0]);
    }
    points_along(&meshes[0].normals.as_ref().expect("smooth")[0], [0.0, 0.0, 1.0]);
    let tangents = meshes[0].tangents.as_ref().expect(BUMPS);
    points_along(&tangents[0][..3], [-1.0, 0.0, 0.0]);
    assert_eq!(tangents[0][3], -1.0);
}

#[test]
fn weights_that_do_not_sum_to_one_are_scaled_and_counted() {
    let (data, mut file) = arm();
    // The second set alone: its last vertex has 0.5 of the second joint, the others have no weight.
    let attributes = file["meshes"][0]["primitives"][0]["attributes"].as_object_mut().expect("attributes");
    for name in ["JOINTS_0", "WEIGHTS_0"] {
        attributes.remove(name);
    }
    for (from, to) in [("JOINTS_1", "JOINTS_0"), ("WEIGHTS_1", "WEIGHTS_0")] {
        let accessor = attributes.remove(from).expect("of the arm");
        attributes.insert(to.to_owned(), accessor);
    }
    let (report, _, meshes) = read("unscaled", &data.file(file));
    stands_at(&meshes[0], &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 4.0, 0.0]], &[]);
    assert_eq!(report.repairs["vertices whose weights of joints do not sum to 1 scaled"], 1, "{report:?}");
    assert_eq!(report.repairs["vertices without a weight moved by their first joint"], 3, "{report:?}");
}

#[test]
fn morph_targets_have_their_default_weights() {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 4.0, 0.0], "VEC3", 3);
    let normals = data.floats(&[0.0, 0.0, 1.0].repeat(3), "VEC3", 3);
    let tangents = data.floats(&[1.0, 0.0, 0.0, 1.0].repeat(3), "VEC4", 4);
    let uvs = data.floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0], "VEC2", 2);
    let up = data.floats(&[0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "VEC3", 3);
    let lean = data.floats(&[2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "VEC3", 3);
    let turn = data.floats(&[0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "VEC3", 3);
    // A sparse target without a buffer view: the last vertex moves by -4 along y.
    let (index, value) = (data.view(&[2]), data.view(&[0.0f32, -4.0, 0.0].map(f32::to_le_bytes).concat()));
    data.accessors.push(object!({ "componentType": 5126, "type": "VEC3", "count": 3, "sparse": { "count": 1,
        "indices": { "bufferView": index, "componentType": 5121 }, "values": { "bufferView": value } } }));
    let sparse = data.accessors.len() - 1;
    let mut file = object!({
        "meshes": [{ "weights": [0.5, 0.25], "primitives": [{
            "attributes": { "POSITION": positions, "NORMAL": normals, "TANGENT": tangents, "TEXCOORD_0": uvs },
            "targets": [{ "POSITION": up, "NORMAL": lean, "TANGENT": turn },
                { "POSITION": sparse, "TEXCOORD_0": uvs }], "material": 0 }] }],
        "nodes": [{ "mesh": 0 }, { "mesh": 0, "weights": [0, 0.75], "translation": [10, 0, 0] }],
        "scenes": [{ "nodes": [0, 1] }],
    });
    bumpy(&mut file);
    let (report, _, meshes) = read("morph", &data.file(file));
    // The mesh's weights: half of 2 up, a quarter of -4 along y. The node's own: three quarters of it.
    let first = [[0.0, 0.0, 1.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]];
    let second = [[10.0, 0.0, 0.0], [14.0, 0.0, 0.0], [10.0, 1.0, 0.0]];
    stands_at(&meshes[0], &first, &second);
    stands_at(&meshes[1], &second, &first);
    points_along(&meshes[0].normals.as_ref().expect("smooth")[0], [1.0, 0.0, 1.0]);
    points_along(&meshes[0].tangents.as_ref().expect(BUMPS)[0][..3], [1.0, 1.0, 0.0]);
    points_along(&meshes[1].normals.as_ref().expect("smooth")[0], [0.0, 0.0, 1.0]);
    assert!(report.notes.iter().any(|note| note.contains("morph targets of texture coordinates")), "{report:?}");
}

/// A triangle that stands three times, at a node that doubles. The second copy is turned by 90 degrees about z, and the
/// third is mirrored.
fn copies() -> (Data, Value) {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0], "VEC3", 3);
    let normals = data.floats(&[0.0, 0.0, 1.0].repeat(3), "VEC3", 3);
    let translations = data.floats(&[0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 5.0, 1.0], "VEC3", 3);
    let scales = data.floats(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, 2.0, 1.0], "VEC3", 3);
    let still = [0i16, 0, 0, i16::MAX];
    let turned = [0i16, 0, 23170, 23170];
    let rotations: Vec<u8> = [still, turned, still].concat().iter().flat_map(|v| v.to_le_bytes()).collect();
    let rotations = data.accessor(&rotations, 5122, "VEC4", 3, true);
    let ids = data.floats(&[0.0, 1.0, 2.0], "SCALAR", 1);
    let attributes = object!({ "TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales, "_ID": ids });
    let file = object!({
        "extensionsUsed": ["EXT_mesh_gpu_instancing"], "extensionsRequired": ["EXT_mesh_gpu_instancing"],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": positions, "NORMAL": normals } }] }],
        "nodes": [{ "mesh": 0, "scale": [2, 2, 2],
            "extensions": { "EXT_mesh_gpu_instancing": { "attributes": attributes } } }],
        "scenes": [{ "nodes": [0] }],
    });
    (data, file)
}

#[test]
fn instances_stand_each_where_they_are() {
    let (data, file) = copies();
    let (report, _, meshes) = read("instances", &data.file(file));
    assert_eq!((report.measures["triangles"], meshes.len()), (3.0, 1));
    // (x, y) is turned to (-y, x), then moved; all is doubled. The mirrored copy has its corners in another order.
    let expected = [
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
        [[10.0, 0.0, 0.0], [10.0, 2.0, 0.0], [6.0, 0.0, 0.0]],
        [[0.0, 10.0, 2.0], [0.0, 18.0, 2.0], [-2.0, 10.0, 2.0]],
    ];
    stands_at(&meshes[0], expected.as_flattened(), &[]);
    for triangle in 0..3 {
        assert!(winding(&meshes[0], triangle)[2] > 0.0, "{:?}", meshes[0]);
    }
    let normals = meshes[0].normals.as_ref().expect("smooth");
    normals.iter().for_each(|normal| points_along(normal, [0.0, 0.0, 1.0]));
    assert!(report.notes.iter().any(|note| note.starts_with("attributes of instances beside")), "{report:?}");
}

#[test]
fn what_a_file_has_and_nothing_reads_is_noted() {
    let (data, mut file) = copies();
    file["extensionsUsed"] = object!(["EXT_mesh_gpu_instancing", "VENDOR_fur\u{7}"]);
    file["nodes"][0]["extensions"]["KHR_lights_punctual"] = object!({ "light": 0 });
    file["animations"] = object!([{ "channels": [], "samplers": [] }]);
    let (report, _, _) = read("noted", &data.file(file));
    for part in ["`VENDOR_fur ` is left out", "lights are left out", "animations are left out"] {
        assert!(report.notes.iter().any(|note| note.contains(part)), "{part}: {report:?}");
    }
}

/// A sound file of all of this: an arm that is morphed, and copies.
pub fn posed() -> (Data, Value) {
    let (mut data, mut file) = arm();
    let deltas = data.floats(&[0.0, 0.0, 0.5].repeat(4), "VEC3", 3);
    let places = data.floats(&[0.0, 0.0, 0.0, 3.0, 0.0, 0.0], "VEC3", 3);
    file["meshes"][0]["primitives"][0]["targets"] = object!([{ "POSITION": deltas, "NORMAL": deltas }]);
    file["meshes"][0]["weights"] = object!([0.5]);
    let attributes = object!({ "TRANSLATION": places });
    file["nodes"].as_array_mut().expect("nodes").push(object!({ "mesh": 0, "weights": [1],
        "extensions": { "EXT_mesh_gpu_instancing": { "attributes": attributes } } }));
    file["scenes"] = object!([{ "nodes": [0, 1, 3] }]);
    (data, file)
}

#[test]
fn poses_go_together() {
    let (data, file) = posed();
    let (report, _, meshes) = read("posed", &data.file(file));
    // Two triangles on joints, and twice two at rest, with no joints: 6.
    assert_eq!((report.measures["triangles"], meshes.len()), (6.0, 2), "{report:?}");
    let rest = [[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [0.0, 3.0, 0.5], [1.0, 2.0, 0.5]];
    let twice = [rest, rest.map(|[x, y, z]| [x + 3.0, y, z])].concat();
    let arm = ARM.map(|[x, y, _]| [x, y, 0.25]);
    stands_at(&meshes[0], &arm, &twice);
    stands_at(&meshes[1], &twice, &arm);
}
