//! Meshes as binary PLY, the way Mitsuba reads them.

use super::Tint;
use crate::mesh::Mesh;
use std::fmt::Write as _;

/// A mesh, with its colours in each of these tints as the attributes `vertex_c0_color`, `vertex_c1_color` and so on; a
/// mesh without colours is white.
pub(super) fn ply(mesh: &Mesh, tints: &[Tint]) -> Vec<u8> {
    let mut head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.positions.len());
    let mut property = |names: &[&str]| names.iter().for_each(|n| head.push_str(&format!("property float {n}\n")));
    property(&["x", "y", "z"]);
    if mesh.normals.is_some() {
        property(&["nx", "ny", "nz"]);
    }
    if mesh.uvs.is_some() {
        property(&["u", "v"]);
    }
    for index in 0..tints.len() {
        let channels = ["r", "g", "b"].map(|channel| format!("c{index}_{channel}"));
        property(&channels.each_ref().map(String::as_str));
    }
    let _ = write!(head, "element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.triangles.len());
    let mut out = head.into_bytes();
    let mut put = |values: &[f32]| values.iter().for_each(|v| out.extend(v.to_le_bytes()));
    for (i, position) in mesh.positions.iter().enumerate() {
        put(position);
        if let Some(normals) = &mesh.normals {
            put(&normals[i]);
        }
        if let Some(uvs) = &mesh.uvs {
            put(&uvs[i]);
        }
        let color = mesh.colors.as_ref().map_or([1.0; 4], |colors| colors[i]);
        for Tint { scale, channel } in tints {
            let value = |c: usize| channel.map_or(color[c], |channel| color[usize::from(channel).min(3)]);
            put(&[0, 1, 2].map(|c| value(c) * scale[c]));
        }
    }
    for triangle in &mesh.triangles {
        out.push(3);
        triangle.iter().for_each(|i| out.extend(i.to_le_bytes()));
    }
    out
}
