//! Meshes of files and of forms: Mitsuba's serialized format, tessellated forms, normals. Knows nothing of scenes.

use super::ply::Read;
use crate::assets::{Refusal, damaged};
use flate2::read::ZlibDecoder;
use std::{collections::BTreeMap, io::Read as _};
use tauflow_data::{
    geom::{Vec3, add, cross, determinant, dot, length, mul, sub, unit},
    maths,
    mesh::Mesh,
    scene::Affine,
};

/// Most vertices and triangles of a mesh: what a blob can number.
pub const MOST: usize = (1 << 24) - 1;

/// Checks what a mesh has, and that its blob can hold it.
///
/// # Errors
/// If it is too large, or a triangle names no vertex.
pub fn checked(read: Read) -> Result<Read, Refusal> {
    let (vertices, triangles) = (read.mesh.positions.len(), read.mesh.triangles.len());
    if vertices > MOST || triangles > 4 * MOST {
        let what = format!("{vertices} vertices and {triangles} triangles");
        return Err(Refusal::new("mesh", what, "split it into meshes of fewer than 2^24 vertices"));
    }
    if let Some(bad) = read.mesh.triangles.iter().flatten().find(|i| **i as usize >= vertices) {
        return Err(damaged("faces", format!("vertex {bad} of {vertices} is named")));
    }
    Ok(read)
}

/// Reads mesh `index` of Mitsuba's serialized format (versions 3 and 4).
///
/// # Errors
/// If the file is damaged or holds no such mesh.
pub fn serialized(bytes: &[u8], index: usize) -> Result<Read, Refusal> {
    let short = || damaged("data", "the file ends too early");
    let word = |at: usize| -> Option<u16> { Some(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?)) };
    let version = word(2).ok_or_else(short)?;
    if word(0) != Some(0x041c) || !(3..=4).contains(&version) {
        return Err(damaged("header", "no mesh of Mitsuba's serialized format in version 3 or 4"));
    }
    let start = if index == 0 {
        0
    } else {
        // At the end: offsets of all meshes, and their number.
        let width = if version == 4 { 8 } else { 4 };
        let tail = bytes.len().checked_sub(4).ok_or_else(short)?;
        let count = u32::from_le_bytes(bytes[tail..].try_into().map_err(|_| short())?) as usize;
        let at = (count <= tail / width && index < count).then(|| tail - width * (count - index));
        let at = at.ok_or_else(|| damaged("header", format!("there is no mesh {index}")))?;
        bytes[at..at + width].iter().rev().fold(0usize, |sum, b| (sum << 8) | usize::from(*b))
    };
    let packed = start.checked_add(4).and_then(|at| bytes.get(at..)).ok_or_else(short)?;
    // Numbers hardly pack: a file that asks for more than this is a bomb.
    let most = packed.len().saturating_mul(64).saturating_add(1 << 20).min(1 << 31);
    let mut body = Vec::new();
    let decoded = ZlibDecoder::new(packed).take(most as u64).read_to_end(&mut body);
    if body.len() == most {
        return Err(damaged("data", format!("it unpacks to {most} bytes and more")));
    }
    // Data after the mesh are not compressed; a premature end is detected below.
    decoded.map(|_| ()).or_else(|e| if body.is_empty() { Err(damaged("data", e.to_string())) } else { Ok(()) })?;
    let mut rest = body.as_slice();
    let mut take = |count: usize| -> Result<&[u8], Refusal> {
        let (own, after) = rest.split_at_checked(count).ok_or_else(short)?;
        rest = after;
        Ok(own)
    };
    let flags = take(4)?.iter().rev().fold(0u32, |sum, b| (sum << 8) | u32::from(*b));
    if version == 4 {
        while take(1)? != [0] {}
    }
    let mut count = || -> Result<usize, Refusal> {
        let count = take(8)?.iter().rev().fold(0u64, |sum, b| (sum << 8) | u64::from(*b));
        usize::try_from(count).ok().filter(|c| *c <= MOST).ok_or_else(|| damaged("data", format!("{count} elements")))
    };
    let (vertices, triangles) = (count()?, count()?);
    let wide = flags & 0x2000 != 0;
    let mut floats = |width: usize| -> Result<Vec<f32>, Refusal> {
        let size = if wide { 8 } else { 4 };
        let own = take(vertices * width * size)?;
        let number = |b: &[u8]| match wide {
            true => f64::from_le_bytes(b.try_into().expect("eight bytes")) as f32,
            false => f32::from_le_bytes(b.try_into().expect("four bytes")),
        };
        Ok(own.chunks_exact(size).map(number).collect())
    };
    let triples = |all: Vec<f32>| all.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
    let mut mesh = Mesh { positions: triples(floats(3)?), ..Mesh::default() };
    if flags & 1 != 0 {
        mesh.normals = Some(triples(floats(3)?));
    }
    if flags & 2 != 0 {
        mesh.uvs = Some(floats(2)?.chunks_exact(2).map(|p| [p[0], p[1]]).collect());
    }
    let mut attributes = BTreeMap::new();
    if flags & 8 != 0 {
        attributes.insert("vertex_color".to_owned(), triples(floats(3)?));
    }
    let indices = take(triangles * 12)?.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let indices: Vec<u32> = indices.collect();
    mesh.triangles = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    if flags & 0x10 != 0 {
        mesh.normals = None;
    }
    checked(Read { mesh, attributes, cost: body.len(), note: None })
}

/// Gives a mesh vertex normals: those of its triangles, weighted by their angles, where a map puts it.
///
/// They face as the triangles do in the mesh's own space, whether the map mirrors or not.
///
/// Source: Thürmer and Wüthrich, *Computing Vertex Normals from Polygonal Facets*, 1998, as in Mitsuba.
pub fn smooth(mesh: &mut Mesh, map: &Affine) {
    let linear = map.map(|[a, b, c, _]| [a, b, c]);
    let placed = |p: [f32; 3]| linear.map(|row| dot(row, p.map(f64::from)));
    // The transpose takes a normal in the world back to the mesh's own.
    let back = |n: Vec3| [0, 1, 2].map(|c: usize| dot([linear[0][c], linear[1][c], linear[2][c]], n));
    let side = if determinant(map) < 0.0 { -1.0 } else { 1.0 };
    let mut sums = vec![[0.0f64; 3]; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let p = triangle.map(|i| placed(mesh.positions[i as usize]));
        let normal = cross(sub(p[1], p[0]), sub(p[2], p[0]));
        let size = length(normal);
        if !(size > 0.0 && size.is_finite()) {
            continue;
        }
        for i in 0..3 {
            let (a, b) = (unit(sub(p[(i + 1) % 3], p[i])), unit(sub(p[(i + 2) % 3], p[i])));
            let angle = maths::acos(dot(a, b).clamp(-1.0, 1.0));
            let at = &mut sums[triangle[i] as usize];
            *at = add(*at, mul(normal, angle / size));
        }
    }
    mesh.normals = Some(sums.into_iter().map(|n| mul(unit(back(unit(n))), side).map(|v| v as f32)).collect());
}

/// Bytes that a mesh takes in memory, and about those of its blob.
pub fn bytes(mesh: &Mesh) -> usize {
    fn of<T>(rows: Option<&Vec<T>>) -> usize {
        rows.map_or(0, |rows| size_of_val(rows.as_slice()))
    }
    size_of_val(mesh.positions.as_slice())
        + size_of_val(mesh.triangles.as_slice())
        + of(mesh.normals.as_ref())
        + of(mesh.uvs.as_ref())
        + of(mesh.colors.as_ref())
        + of(mesh.tangents.as_ref())
}

/// Bytes that a mesh of [`grid`] takes.
pub fn grid_bytes([columns, rows]: [usize; 2]) -> usize {
    (columns + 1) * (rows + 1) * size_of::<[f32; 8]>() + 2 * columns * rows * size_of::<[u32; 3]>()
}

/// A surface over u and v in 0 to 1: places and normals on a grid of this many cells.
pub fn grid(cells: [usize; 2], of: impl Fn(f64, f64) -> (Vec3, Vec3)) -> Mesh {
    let [columns, rows] = cells;
    let mut mesh = Mesh { normals: Some(Vec::new()), uvs: Some(Vec::new()), ..Mesh::default() };
    for row in 0..=rows {
        for column in 0..=columns {
            let (u, v) = (column as f64 / columns as f64, row as f64 / rows as f64);
            let (place, normal) = of(u, v);
            mesh.positions.push(place.map(|x| x as f32));
            mesh.normals.get_or_insert_default().push(normal.map(|x| x as f32));
            mesh.uvs.get_or_insert_default().push([u as f32, v as f32]);
        }
    }
    let at = |row: usize, column: usize| (row * (columns + 1) + column) as u32;
    for row in 0..rows {
        for column in 0..columns {
            let (a, b) = (at(row, column), at(row, column + 1));
            let (c, d) = (at(row + 1, column + 1), at(row + 1, column));
            for triangle in [[a, b, c], [a, c, d]] {
                let p = triangle.map(|i| mesh.positions[i as usize].map(f64::from));
                // At a pole or a centre one of them has no area.
                let normal = cross(sub(p[1], p[0]), sub(p[2], p[0]));
                if length(normal) > 0.0 {
                    let sum = mesh.normals.as_ref().map_or([0.0; 3], |n| n[a as usize].map(f64::from));
                    let other = mesh.normals.as_ref().map_or([0.0; 3], |n| n[c as usize].map(f64::from));
                    let outward = dot(normal, add(sum, other)) >= 0.0;
                    mesh.triangles.push(if outward { triangle } else { [triangle[0], triangle[2], triangle[1]] });
                }
            }
        }
    }
    mesh
}

/// Cells about an axis of a tessellated form: inscribed, it lacks 1 - cos(pi / 512) = 2e-5 of its radius.
pub const ROUND: usize = 512;

/// A cylinder about +z from `z[0]` to `z[1]`, open at its ends, over angles up to `sweep`, facing outwards.
pub fn cylinder(radius: f64, z: [f64; 2], sweep: f64) -> Mesh {
    grid([ROUND, 1], |u, v| {
        let (s, c) = (maths::sin(u * sweep), maths::cos(u * sweep));
        ([radius * c, radius * s, z[0] + (z[1] - z[0]) * v], [c, s, 0.0])
    })
}

/// A sphere about the origin between the polar angles `theta` from +z, over angles up to `sweep`.
pub fn sphere(radius: f64, theta: [f64; 2], sweep: f64) -> Mesh {
    grid([ROUND, ROUND / 2], |u, v| {
        let angle = theta[0] + (theta[1] - theta[0]) * v;
        let (s, c) = (maths::sin(u * sweep), maths::cos(u * sweep));
        let (ring, height) = (maths::sin(angle), maths::cos(angle));
        let normal = [ring * c, ring * s, height];
        (mul(normal, radius), normal)
    })
}

/// A disk or ring at height `z`, facing +z; v is 0 on its outer edge.
pub fn ring(radius: f64, inner: f64, z: f64, sweep: f64) -> Mesh {
    grid([ROUND, 1], |u, v| {
        let r = radius + (inner - radius) * v;
        ([r * maths::cos(u * sweep), r * maths::sin(u * sweep), z], [0.0, 0.0, 1.0])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::{Compression, write::ZlibEncoder};
    use std::io::Write;
    use tauflow_data::geom::scaling;
    use tauflow_data::scene::IDENTITY;

    #[test]
    fn serialized_meshes_are_unpacked_within_bounds() {
        let mut body = 1u32.to_le_bytes().to_vec();
        body.extend(b"name\0");
        body.extend(3u64.to_le_bytes());
        body.extend(1u64.to_le_bytes());
        for value in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().chain(&[0.0, 0.0, 1.0].repeat(3)) {
            body.extend(value.to_le_bytes());
        }
        [0u32, 1, 2].iter().for_each(|i| body.extend(i.to_le_bytes()));
        let packed = |body: &[u8]| {
            let mut zip = ZlibEncoder::new(vec![0x1c, 0x04, 4, 0], Compression::default());
            zip.write_all(body).expect("in memory");
            zip.finish().expect("in memory")
        };
        let one = packed(&body);
        let mut file = one.clone();
        file.extend(&one);
        file.extend(0u64.to_le_bytes());
        file.extend((one.len() as u64).to_le_bytes());
        file.extend(2u32.to_le_bytes());
        for index in [0, 1] {
            let mesh = serialized(&file, index).expect("a triangle").mesh;
            assert_eq!((mesh.triangles, mesh.positions[1]), (vec![[0, 1, 2]], [1.0, 0.0, 0.0]));
            assert_eq!(mesh.normals.expect("given")[2], [0.0, 0.0, 1.0]);
        }
        assert!(serialized(&file, 2).is_err() && serialized(&[], 0).is_err());
        assert!(serialized(&packed(&vec![0; 1 << 26]), 0).expect_err("a bomb").to_string().contains("unpacks"));
        let last = body.len() - 1;
        body[last - 3] = 9;
        assert!(serialized(&packed(&body), 0).is_err(), "a vertex that is not there");
    }

    #[test]
    fn forms_have_their_areas_and_face_outwards() {
        let area = |mesh: &Mesh| -> f64 {
            let p = |i: u32| mesh.positions[i as usize].map(f64::from);
            mesh.triangles.iter().map(|t| 0.5 * length(cross(sub(p(t[1]), p(t[0])), sub(p(t[2]), p(t[0]))))).sum()
        };
        let pi = core::f64::consts::PI;
        let ball = sphere(2.0, [0.0, pi], 2.0 * pi);
        assert!((area(&ball) / (16.0 * pi) - 1.0).abs() < 1e-4);
        assert!((tauflow_data::mesh_check::signed_volume(&ball) / (32.0 * pi / 3.0) - 1.0).abs() < 1e-4);
        assert!((area(&cylinder(0.5, [0.0, 3.0], 2.0 * pi)) / (3.0 * pi) - 1.0).abs() < 1e-4);
        assert!((area(&ring(2.0, 1.0, 0.0, pi)) / (1.5 * pi) - 1.0).abs() < 1e-4);
        let mut flat = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 2, 1]],
            ..Mesh::default()
        };
        smooth(&mut flat, &IDENTITY);
        assert_eq!(flat.normals.expect("made")[0], [0.0, 1.0, 0.0]);
    }

    #[test]
    fn made_normals_are_those_of_the_mesh_where_it_stands() {
        // Two sides of a roof: their normals are weighted by the angles at the ridge that the stretched roof has.
        let roof = |height: f32| Mesh {
            positions: vec![[0.0, height, 0.0], [-1.0, 0.0, 0.0], [0.0, height, 1.0], [4.0, 0.0, 1.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        for height in [2.0, -2.0] {
            let (mut low, mut high) = (roof(1.0), roof(height));
            smooth(&mut low, &scaling([1.0, f64::from(height), 1.0]));
            smooth(&mut high, &IDENTITY);
            let (low, high) = (low.normals.expect("made"), high.normals.expect("made"));
            for (low, high) in low.iter().zip(&high) {
                // A normal goes into the world by the inverse transpose; a mirrored roof's own faces the other way.
                let there = unit([low[0], low[1] / height, low[2]].map(|v| f64::from(v * height.signum())));
                assert!(length(sub(there, high.map(f64::from))) < 1e-6, "{there:?} {high:?}");
            }
        }
        let (mut own, mut stretched) = (roof(1.0), roof(1.0));
        smooth(&mut own, &IDENTITY);
        smooth(&mut stretched, &scaling([1.0, 2.0, 1.0]));
        assert_ne!(own.normals, stretched.normals, "angles change with the map");
    }
}
