//! Objects: the default scene of a glTF file as meshes in one unit box on the ground, with materials.
//!
//! Source: glTF 2.0, section 3.7.

use super::{
    container::{Document, Externals},
    finish::{self, Frame},
    material::Materials,
    pose::{Copies, Instance, Pose},
    primitive::{self, Piece, Want},
    textures::Features,
};
use crate::assets::{
    blobs::BlobSet,
    refusal::{Refusal, damaged, tame},
};
use tauflow_data::{
    mesh_check::is_closed,
    records::{AssetBody, AssetPart, AssetReport},
    scene::Affine,
};

/// Most triangles of an object.
const MOST_TRIANGLES: usize = 8_000_000;

/// Most vertices of an object: those of as many triangles that share none.
const MOST_VERTICES: usize = 3 * MOST_TRIANGLES;

/// The use of a file, which determines its omitted parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// An object to put into scenes: it brings no lights, and its size is that of most of it.
    Object,
    /// A scene: the caller reads its lights, and undoes the frame that the size decides.
    Scene,
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
    read_as(Purpose::Object, bytes, externals, most, blobs, report).map(|(body, _)| body)
}

/// As [`read`], but as the surfaces of a scene, and with the map from the file's own space into the unit box: an even
/// scale, and a shift.
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
    read_as(Purpose::Scene, bytes, externals, most, blobs, report)
}

fn read_as(
    purpose: Purpose,
    bytes: &[u8],
    externals: &Externals,
    most: usize,
    blobs: &mut BlobSet,
    report: &mut AssetReport,
) -> Result<(AssetBody, Affine), Refusal> {
    let document = Document::open(bytes, externals)?;
    note_what_is_left_out(&document, report);
    let mut pose = Pose::of(&document, purpose, report)?;
    let instances = std::mem::take(&mut pose.instances);
    let mut materials = Materials::new(&document, most);
    let mut pieces: Vec<(Option<usize>, Piece)> = Vec::new();
    let (mut triangles, mut vertices) = (0usize, 0usize);
    for Instance { mesh: number, copies, skin, weights } in &instances {
        let place = format!("mesh {number}");
        let mesh = document.root.meshes.get(*number).ok_or_else(|| damaged(&place, "there is no such mesh"))?;
        let joints = match skin {
            Some(skin) => Some(pose.skin(&document, *skin, report)?),
            None => None,
        };
        for (number, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("{place} primitive {number}");
            let material = primitive.material.map(|m| m.value());
            let (uv_sets, tangents) = materials.reads(material)?;
            let want = Want { uv_sets: &uv_sets, tangents, weights, joints };
            let Some((piece, skinned)) = primitive::read(&document, primitive, &place, want, report)? else {
                continue;
            };
            let count = if skinned { 1 } else { copies.len() };
            if skinned {
                report.repaired(
                    "copies of a skinned mesh on the same joints left out",
                    copies.len().saturating_sub(1) as u64,
                );
            }
            triangles = triangles.saturating_add(piece.triangles.len().saturating_mul(count));
            vertices = vertices.saturating_add(piece.positions.len().saturating_mul(count));
            if triangles > MOST_TRIANGLES || vertices > MOST_VERTICES {
                let what =
                    format!("more than {MOST_TRIANGLES} triangles or {MOST_VERTICES} vertices, instances counted");
                return Err(Refusal::new(place, what, "simplify the object"));
            }
            // Meshes without triangles need no copies.
            if !piece.triangles.is_empty() && count > 0 {
                pieces.push((material, if skinned { piece } else { copied(piece, copies)? }));
            }
        }
    }
    if triangles == 0 {
        return Err(Refusal::new("scene", "it shows no triangles", "export a file with a mesh in its default scene"));
    }
    let frame = Frame::around(pieces.iter().map(|(_, piece)| piece), purpose, report)?;
    let (mut parts, mut dropped, mut bounds) = (Vec::new(), 0, tauflow_data::geom::Aabb::EMPTY);
    for (number, (material, piece)) in pieces.into_iter().enumerate() {
        let sets = piece.sets.clone();
        let (mesh, lost) = finish::mesh(piece, &frame, report);
        dropped += lost.not_finite;
        let Some(mesh) = mesh else { continue };
        mesh.positions.iter().for_each(|p| bounds.grow(p.map(f64::from)));
        let closed = is_closed(&mesh);
        let features = Features { sets, colors: mesh.colors.is_some(), closed };
        let material = materials.get(material, features, blobs, report)?;
        let uv = mesh.uvs.is_some();
        let triangles = mesh.triangles.len();
        let bytes =
            mesh.to_bytes().map_err(|e| Refusal::new(format!("part {number}"), e.to_string(), "split the mesh"))?;
        parts.push(AssetPart { mesh: blobs.add(bytes), material, closed, uv, triangles });
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

/// The copies of a piece as one.
///
/// # Errors
/// If one stands nowhere.
fn copied(mut piece: Piece, copies: &Copies) -> Result<Piece, Refusal> {
    if copies.len() == 1 {
        piece.transform(&copies.map(0)?);
        return Ok(piece);
    }
    let mut all: Option<Piece> = None;
    for i in 0..copies.len() {
        let mut copy = piece.clone();
        copy.transform(&copies.map(i)?);
        match &mut all {
            Some(all) => all.join(copy),
            None => all = Some(copy),
        }
    }
    Ok(all.unwrap_or_default())
}

/// Notes what of the file nothing here reads.
fn note_what_is_left_out(document: &Document<'_>, report: &mut AssetReport) {
    for extension in document.unread().take(16) {
        report.note(format!("the extension `{}` is left out", tame(extension)));
    }
    if document.morphs_more() {
        report.note("morph targets of texture coordinates and colours are left out");
    }
}
