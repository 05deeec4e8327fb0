//! Objects: the default scene of a glTF file as meshes in one unit box on the ground, with materials.
//!
//! Source: glTF 2.0, section 3.7.

use super::{
    container::{Document, Externals},
    finish::{self, UnitBox},
    material::Materials,
    pose::{Copies, Instance, Pose},
    primitive::{self, Piece, Want},
    purpose::Purpose,
    textures::Features,
    two_sided,
};
use crate::assets::{
    blobs::BlobSet,
    refusal::{Refusal, damaged, tame},
};
use std::collections::{BTreeMap, btree_map::Entry};
use tauflow_data::{
    geom::{Aabb, Vec3, compose},
    mesh::Mesh,
    mesh_check::is_closed,
    records::{AssetBody, AssetMaterial, AssetPart, AssetReport},
    scene::Affine,
};

/// Most triangles of an object.
const MOST_TRIANGLES: usize = 8_000_000;

/// Most mistakes in single primitives and materials that are told.
const MOST_TOLD: usize = 200;

/// Most shapes that a scene shows, each copy of each primitive.
const MOST_SHOWN: usize = 1 << 20;

/// Most vertices of an object: those of as many triangles that share none.
const MOST_VERTICES: usize = 3 * MOST_TRIANGLES;

/// The surfaces of a scene, where they stand.
pub struct Surfaces {
    /// Meshes, each with a material and where it stands: once, or as often as it is shown.
    pub parts: Vec<(AssetPart, Vec<Affine>)>,
    /// The materials.
    pub materials: Vec<AssetMaterial>,
}

/// What was read of a file.
struct Whole {
    surfaces: Surfaces,
    bounds: Aabb,
}

/// A piece, and where it is shown if that is not where it is.
struct Shown {
    material: Option<usize>,
    piece: Piece,
    copies: Option<Vec<Affine>>,
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
    let document = Document::open(bytes, externals)?;
    let mut told = Vec::new();
    let whole = read_as((Purpose::Object, None), &document, most, blobs, report, &mut told);
    if let Some(first) = told.into_iter().next() {
        return Err(first);
    }
    let Whole { surfaces: Surfaces { parts, materials }, bounds } = whole?;
    let parts = parts.into_iter().map(|(part, _)| part).collect();
    Ok(AssetBody::Object { parts, materials, bounds: [bounds.low, bounds.high] })
}

/// Reads the surfaces of a scene, which a camera at `eye` sees. A mesh that is shown in several places is there once.
///
/// # Errors
/// All that is wrong with them.
pub fn read_in_place(
    document: &Document<'_>,
    eye: Option<Vec3>,
    most: usize,
    blobs: &mut BlobSet,
    report: &mut AssetReport,
) -> Result<Surfaces, Vec<Refusal>> {
    let mut told = Vec::new();
    let whole = read_as((Purpose::Scene, eye), document, most, blobs, report, &mut told);
    match whole {
        Ok(whole) if told.is_empty() => Ok(whole.surfaces),
        Ok(_) => Err(told),
        Err(last) => {
            told.push(last);
            Err(told)
        }
    }
}

/// Puts what is wrong with a part of the file where it is told; reading goes on with the next part.
fn tell<T>(made: Result<T, Refusal>, told: &mut Vec<Refusal>) -> Option<T> {
    made.map_err(|refusal| {
        if told.len() < MOST_TOLD {
            told.push(refusal);
        }
    })
    .ok()
}

/// Reads a file; what is wrong with single primitives and materials goes to `told`.
fn read_as(
    (purpose, eye): (Purpose, Option<Vec3>),
    document: &Document<'_>,
    most: usize,
    blobs: &mut BlobSet,
    report: &mut AssetReport,
    told: &mut Vec<Refusal>,
) -> Result<Whole, Refusal> {
    note_what_is_left_out(document, purpose, report);
    let mut pose = Pose::of(document, purpose, report)?;
    let instances = std::mem::take(&mut pose.instances);
    let instances = if purpose == Purpose::Scene { gathered(instances) } else { instances };
    let mut materials = Materials::new(document, most);
    let mut pieces: Vec<Shown> = Vec::new();
    let (mut triangles, mut vertices, mut shown) = (0usize, 0usize, 0usize);
    for Instance { mesh: number, copies, skin, weights } in &instances {
        let place = format!("mesh {number}");
        let mesh = document.root.meshes.get(*number).ok_or_else(|| damaged(&place, "there is no such mesh"))?;
        let joints = match skin {
            Some(skin) => Some(pose.skin(document, *skin, report)?),
            None => None,
        };
        let count: usize = copies.iter().map(Copies::len).sum();
        for (number, primitive) in mesh.primitives.iter().enumerate() {
            if told.first().is_some_and(|_| purpose == Purpose::Object) {
                return Err(damaged("scene", "part of it cannot be read"));
            }
            let place = format!("{place} primitive {number}");
            let material = primitive.material.map(|m| m.value());
            let Some((uv_sets, tangents)) = tell(materials.reads(material), told) else { continue };
            let want = Want { uv_sets: &uv_sets, tangents, weights, joints };
            let read = primitive::read(document, primitive, &place, want, report);
            let Some(Some((piece, skinned))) = tell(read, told) else { continue };
            let shared = purpose == Purpose::Scene && !skinned && count > 1;
            if skinned {
                report.repaired("copies of a skinned mesh on the same joints left out", count.saturating_sub(1) as u64);
            }
            // The caller counts what a shared mesh shows.
            let here = if skinned || shared { 1 } else { count };
            triangles = triangles.saturating_add(piece.triangles.len().saturating_mul(here));
            vertices = vertices.saturating_add(piece.positions.len().saturating_mul(here));
            if triangles > MOST_TRIANGLES || vertices > MOST_VERTICES {
                let what =
                    format!("more than {MOST_TRIANGLES} triangles or {MOST_VERTICES} vertices, instances counted");
                return Err(Refusal::new(place, what, "simplify the object"));
            }
            shown = shown.saturating_add(if shared { count } else { 1 });
            if shown > MOST_SHOWN {
                let what = format!("more than {MOST_SHOWN} shapes, each copy of each primitive counted");
                return Err(Refusal::new(place, what, "join the primitives of a mesh, or show fewer copies"));
            }
            // Meshes without triangles need no copies.
            if piece.triangles.is_empty() || count == 0 {
                continue;
            }
            let made = match () {
                () if skinned => Ok((piece, None)),
                () if shared => maps(copies).map(|maps| (piece, Some(maps))),
                () => copied(piece, copies).map(|piece| (piece, None)),
            };
            pieces.extend(tell(made, told).map(|(piece, copies)| Shown { material, piece, copies }));
        }
    }
    if triangles == 0 {
        return Err(Refusal::new("scene", "it shows no triangles", "export a file with a mesh in its default scene"));
    }
    let own = |shown: &&Shown| shown.copies.is_none();
    let frame = match pieces.iter().any(|shown| shown.copies.is_none()) {
        true => Some(UnitBox::around(pieces.iter().filter(own).map(|shown| &shown.piece), purpose, report)?),
        false => None,
    };
    let (mut parts, mut dropped, mut bounds) = (Vec::new(), 0, Aabb::EMPTY);
    for (number, Shown { material, piece, copies }) in pieces.into_iter().enumerate() {
        let sets = piece.sets.clone();
        let alone = match (&copies, &frame) {
            (None, Some(_)) => None,
            _ => match tell(UnitBox::around([&piece].into_iter(), purpose, report), told) {
                Some(alone) => Some(alone),
                None => continue,
            },
        };
        let Some(frame) = alone.as_ref().or(frame.as_ref()) else { continue };
        let back = frame.back();
        let (mesh, lost) = finish::mesh(piece, frame, purpose, report);
        dropped += lost.not_finite;
        let Some(mesh) = mesh else { continue };
        mesh.positions.iter().for_each(|p| bounds.grow(p.map(f64::from)));
        let closed = is_closed(&mesh);
        let features = Features { sets, colors: mesh.colors.is_some(), alpha: alpha(&mesh), closed };
        let double_sided = materials.is_double_sided(material);
        let Some(material) = tell(materials.get(material, features, blobs, report), told) else { continue };
        let uv = mesh.uvs.is_some();
        let triangles = mesh.triangles.len();
        let bytes = mesh.to_bytes();
        let bytes = bytes.map_err(|e| Refusal::new(format!("part {number}"), e.to_string(), "split the mesh"));
        let Some(bytes) = tell(bytes, told) else { continue };
        let maps = match copies {
            None => vec![back],
            Some(maps) => maps.iter().map(|map| compose(map, &back)).collect(),
        };
        let made = &materials.list[material];
        if double_sided && made.emission.is_some() && two_sided::shows_back(&mesh, closed, made, &maps, eye) {
            report.note(two_sided::NOTE);
        }
        parts.push((AssetPart { mesh: blobs.add(bytes), material, closed, uv, triangles }, maps));
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
    let kept: usize = parts.iter().map(|(part, _)| part.triangles).sum();
    report.measure("triangles", kept as f64);
    report.measure("parts", parts.len() as f64);
    report.measure("closed_parts", parts.iter().filter(|(part, _)| part.closed).count() as f64);
    report.measure("materials", materials.list.len() as f64);
    if let Some(frame) = &frame {
        report.measure("metres", frame.side);
    }
    Ok(Whole { surfaces: Surfaces { parts, materials: materials.list }, bounds })
}

/// Instances with those that show the same mesh in the same shape gathered into one, where it is first shown.
fn gathered(instances: Vec<Instance>) -> Vec<Instance> {
    let mut places: BTreeMap<(usize, Vec<u64>), usize> = BTreeMap::new();
    let mut out: Vec<Instance> = Vec::new();
    for instance in instances {
        if instance.skin.is_some() {
            out.push(instance);
            continue;
        }
        let bits = instance.weights.iter().map(|w| w.to_bits()).collect();
        match places.entry((instance.mesh, bits)) {
            Entry::Occupied(first) => out[*first.get()].copies.extend(instance.copies),
            Entry::Vacant(free) => {
                free.insert(out.len());
                out.push(instance);
            }
        }
    }
    out
}

/// Where all copies stand.
///
/// # Errors
/// If one stands nowhere.
fn maps(copies: &[Copies]) -> Result<Vec<Affine>, Refusal> {
    copies.iter().flat_map(|of| (0..of.len()).map(|i| of.map(i))).collect()
}

/// The copies of a piece as one.
///
/// # Errors
/// If one stands nowhere.
fn copied(mut piece: Piece, copies: &[Copies]) -> Result<Piece, Refusal> {
    let maps = maps(copies)?;
    if let [map] = maps.as_slice() {
        piece.transform(map);
        return Ok(piece);
    }
    let mut all: Option<Piece> = None;
    for map in &maps {
        let mut copy = piece.clone();
        copy.transform(map);
        match &mut all {
            Some(all) => all.join(copy),
            None => all = Some(copy),
        }
    }
    Ok(all.unwrap_or_default())
}

/// The alpha of a mesh's vertex colours if it is the same everywhere, by its bits.
fn alpha(mesh: &Mesh) -> Option<u32> {
    let mut all = mesh.colors.iter().flatten().map(|color| color[3].to_bits());
    let first = all.next().unwrap_or(1.0f32.to_bits());
    all.all(|alpha| alpha == first).then_some(first)
}

/// Notes what of the file nothing here reads.
fn note_what_is_left_out(document: &Document<'_>, purpose: Purpose, report: &mut AssetReport) {
    for extension in document.unread().take(16) {
        report.note(format!("the extension `{}` is left out", tame(extension)));
    }
    if document.morphs_more() {
        report.note("morph targets of texture coordinates and colours are left out");
    }
    if document.is_animated() && purpose == Purpose::Object {
        report.note("animations are left out: it stands in its default pose");
    }
}
