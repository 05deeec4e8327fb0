//! Objects: the default scene of a glTF file as meshes in one unit box on the ground, with materials.
//!
//! Source: glTF 2.0, sections 3.5 (scenes, nodes, transforms) and 3.7.

use super::{
    container::{Document, Externals},
    finish::{self, Frame},
    material::{Features, Materials},
    primitive::{self, Piece, Want},
};
use crate::{
    assets::{
        blobs::BlobSet,
        refusal::{Refusal, damaged},
    },
    geom::compose,
    mesh_check::is_closed,
};
use gltf::json::{Index, scene::Node};
use std::collections::BTreeSet;
use tauflow_data::{
    records::{AssetBody, AssetPart, AssetReport},
    scene::{Affine, IDENTITY},
};

/// Most triangles of an object.
const MOST_TRIANGLES: usize = 8_000_000;

/// Most vertices of an object: those of as many triangles that share none.
const MOST_VERTICES: usize = 3 * MOST_TRIANGLES;

/// A mesh where it stands.
struct Instance {
    mesh: usize,
    map: Affine,
}

/// Reads an object; its blobs go to `blobs`, images reduced to `most` texels a side.
///
/// # Errors
/// If the file is damaged, needs what is not supported, or has no surface.
pub fn read(
    bytes: &[u8],
    externals: &Externals,
    most: usize,
    blobs: &mut BlobSet,
    report: &mut AssetReport,
) -> Result<AssetBody, Refusal> {
    read_in_place(bytes, externals, most, blobs, report).map(|(body, _)| body)
}

/// As [`read`], with the map from the file's own space into the unit box: an even scale, and a shift.
///
/// # Errors
/// As [`read`].
pub fn read_in_place(
    bytes: &[u8],
    externals: &Externals,
    most: usize,
    blobs: &mut BlobSet,
    report: &mut AssetReport,
) -> Result<(AssetBody, Affine), Refusal> {
    let document = Document::open(bytes, externals)?;
    let instances = instances(&document, report)?;
    let mut materials = Materials::new(&document, most);
    let mut pieces: Vec<(Option<usize>, Piece)> = Vec::new();
    let (mut triangles, mut vertices) = (0usize, 0usize);
    for instance in &instances {
        let place = format!("mesh {}", instance.mesh);
        let mesh = document.root.meshes.get(instance.mesh).ok_or_else(|| damaged(&place, "there is no such mesh"))?;
        if mesh.primitives.iter().any(|p| p.targets.is_some()) {
            report.note("morph targets are at rest");
        }
        for (number, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("{place} primitive {number}");
            let material = primitive.material.map(|m| m.value());
            let (uv_set, tangents) = materials.reads(material)?;
            let Some(mut piece) = primitive::read(&document, primitive, &place, Want { uv_set, tangents }, report)?
            else {
                continue;
            };
            piece.transform(&instance.map);
            triangles += piece.triangles.len();
            vertices += piece.positions.len();
            if triangles > MOST_TRIANGLES || vertices > MOST_VERTICES {
                let what =
                    format!("more than {MOST_TRIANGLES} triangles or {MOST_VERTICES} vertices, instances counted");
                return Err(Refusal::new(place, what, "simplify the object"));
            }
            pieces.push((material, piece));
        }
    }
    if triangles == 0 {
        return Err(Refusal::new("scene", "it shows no triangles", "export a file with a mesh in its default scene"));
    }
    let frame = Frame::around(pieces.iter().map(|(_, piece)| piece), report)?;
    let (mut parts, mut dropped, mut bounds) = (Vec::new(), 0, crate::geom::Aabb::EMPTY);
    for (number, (material, piece)) in pieces.into_iter().enumerate() {
        let (mesh, lost) = finish::mesh(piece, &frame, report);
        dropped += lost.not_finite;
        let Some(mesh) = mesh else { continue };
        mesh.positions.iter().for_each(|p| bounds.grow(p.map(f64::from)));
        let closed = is_closed(&mesh);
        let features = Features { uv: mesh.uvs.is_some(), colors: mesh.colors.is_some(), closed };
        let material = materials.get(material, features, blobs, report)?;
        let triangles = mesh.triangles.len();
        let bytes =
            mesh.to_bytes().map_err(|e| Refusal::new(format!("part {number}"), e.to_string(), "split the mesh"))?;
        parts.push(AssetPart { mesh: blobs.add(bytes), material, closed, uv: features.uv, triangles });
    }
    // A stray vertex is mended; a file full of them is damaged.
    if dropped * 10 > triangles {
        return Err(damaged(
            "positions",
            format!("{dropped} of {triangles} triangles have vertices that are not finite"),
        ));
    }
    if parts.is_empty() {
        return Err(damaged("scene", "no triangle has an area"));
    }
    let kept: usize = parts.iter().map(|p| p.triangles).sum();
    report.measure("triangles", kept as f64);
    report.measure("parts", parts.len() as f64);
    report.measure("closed_parts", parts.iter().filter(|p| p.closed).count() as f64);
    report.measure("materials", materials.list.len() as f64);
    report.measure("metres", frame.side);
    Ok((AssetBody::Object { parts, materials: materials.list, bounds: [bounds.low, bounds.high] }, frame.map))
}

/// Every mesh of the default scene, where it stands.
fn instances(document: &Document<'_>, report: &mut AssetReport) -> Result<Vec<Instance>, Refusal> {
    let root = &document.root;
    let number = root.scene.map_or(0, |s| s.value());
    let roots: Vec<usize> = match root.scenes.get(number) {
        Some(scene) => scene.nodes.iter().map(Index::value).collect(),
        None if root.scenes.is_empty() => {
            // Without scenes: every node that is nobody's child.
            let children: BTreeSet<usize> =
                root.nodes.iter().flat_map(|n| n.children.iter().flatten().map(Index::value)).collect();
            (0..root.nodes.len()).filter(|n| !children.contains(n)).collect()
        }
        None => return Err(damaged("scene", format!("scene {number} is not there"))),
    };
    if root.nodes.iter().any(|n| n.skin.is_some()) {
        report.note("skins are in their bind pose");
    }
    let mut seen = vec![false; root.nodes.len()];
    let mut out = Vec::new();
    let mut stack: Vec<(usize, Affine)> = roots.into_iter().rev().map(|n| (n, IDENTITY)).collect();
    while let Some((number, above)) = stack.pop() {
        let place = format!("node {number}");
        let node = root.nodes.get(number).ok_or_else(|| damaged(&place, "there is no such node"))?;
        // A node has one parent, so being seen twice means a loop or two parents.
        if std::mem::replace(&mut seen[number], true) {
            return Err(damaged(place, "it is its own ancestor, or a child of two nodes"));
        }
        let map = compose(&above, &local(node));
        if !map.iter().flatten().all(|v| v.is_finite()) {
            return Err(damaged(place, "its transform is not finite"));
        }
        if let Some(mesh) = node.mesh {
            // A skin's mesh stands where its joints put it, whatever its node's transform (section 3.7.3.3).
            out.push(Instance { mesh: mesh.value(), map: if node.skin.is_some() { IDENTITY } else { map } });
        }
        stack.extend(node.children.iter().flatten().rev().map(|child| (child.value(), map)));
    }
    Ok(out)
}

/// A node's own transform: its matrix, or scale, then rotation, then translation.
fn local(node: &Node) -> Affine {
    if let Some(m) = &node.matrix {
        let m = m.map(f64::from);
        return [0, 1, 2].map(|r| [m[r], m[4 + r], m[8 + r], m[12 + r]]);
    }
    let t = node.translation.unwrap_or([0.0; 3]).map(f64::from);
    let s = node.scale.unwrap_or([1.0; 3]).map(f64::from);
    let [x, y, z, w] = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |q| q.0.map(f64::from));
    // Files hold quaternions to f32 or less: this form is a rotation for any length but 0.
    let n = x * x + y * y + z * z + w * w;
    let k = if n > 0.0 { 2.0 / n } else { 0.0 };
    let rows = [
        [1.0 - k * (y * y + z * z), k * (x * y - z * w), k * (x * z + y * w)],
        [k * (x * y + z * w), 1.0 - k * (x * x + z * z), k * (y * z - x * w)],
        [k * (x * z - y * w), k * (y * z + x * w), 1.0 - k * (x * x + y * y)],
    ];
    [0, 1, 2].map(|r| [rows[r][0] * s[0], rows[r][1] * s[1], rows[r][2] * s[2], t[r]])
}
