//! The content of the library, built once per process: forms with their blobs, and lands.
//!
//! A memo of pure functions: what it returns depends on the name asked for alone, never on what was asked before. It
//! is emptied when it grows beyond [`MOST_BYTES`], and what is asked for again is made again.

use super::{
    forms::{Form, Top},
    relief::Relief,
    stuff::Stuff,
};
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};
use tauflow_contract::KindError;
use tauflow_data::geom::{Aabb, cross, length, sub};
use tauflow_data::mesh::Mesh;

/// Bytes of blobs that the memo keeps at most.
const MOST_BYTES: usize = 256 << 20;

/// A part of a form.
pub struct PartFacts {
    /// Its material.
    pub stuff: Stuff,
    /// Area of its surface, square metres.
    pub area: f64,
    /// The box of its uv.
    pub extent: [[f64; 2]; 2],
    /// Its mesh's blob.
    pub blob: Vec<u8>,
}

/// A variant of a form, without its meshes.
pub struct Facts {
    /// The form.
    pub form: &'static Form,
    /// The variant, library included.
    pub variant: u64,
    /// Its parts.
    pub parts: Vec<PartFacts>,
    /// Metres; the foot stands on y = 0.
    pub bounds: Aabb,
    /// Places to stand on.
    pub tops: Vec<Top>,
    /// Boxes that hold it.
    pub solids: Vec<Aabb>,
}

/// A piece of land: a relief and its mesh.
pub struct Land {
    /// Its heights.
    pub relief: Arc<Relief>,
    /// Its mesh's blob.
    pub blob: Vec<u8>,
}

struct Memo<T> {
    made: BTreeMap<(&'static str, u64), Arc<T>>,
    bytes: usize,
}

impl<T> Memo<T> {
    const fn new() -> Self {
        Self { made: BTreeMap::new(), bytes: 0 }
    }
}

/// The entry of `memo` under a name, created if missing. Two threads may make the same; they make the same.
fn remembered<T>(
    memo: &Mutex<Memo<T>>,
    key: (&'static str, u64),
    size: impl Fn(&T) -> usize,
    make: impl FnOnce() -> Result<T, KindError>,
) -> Result<Arc<T>, KindError> {
    let lock = || memo.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(found) = lock().made.get(&key) {
        return Ok(found.clone());
    }
    let made = Arc::new(make()?);
    let mut memo = lock();
    memo.bytes += size(&made);
    if memo.bytes > MOST_BYTES {
        memo.made.clear();
        memo.bytes = size(&made);
    }
    memo.made.insert(key, made.clone());
    Ok(made)
}

/// Area of a mesh.
fn area(mesh: &Mesh) -> f64 {
    let p = |i: u32| mesh.positions[i as usize].map(f64::from);
    mesh.triangles.iter().map(|t| 0.5 * length(cross(sub(p(t[1]), p(t[0])), sub(p(t[2]), p(t[0]))))).sum()
}

/// The box of a mesh's uv; the unit square if it has none.
fn extent(mesh: &Mesh) -> [[f64; 2]; 2] {
    let mut span = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for uv in mesh.uvs.iter().flatten() {
        for k in 0..2 {
            span[0][k] = span[0][k].min(f64::from(uv[k]));
            span[1][k] = span[1][k].max(f64::from(uv[k]));
        }
    }
    if span[0][0] < span[1][0] && span[0][1] < span[1][1] { span } else { [[0.0; 2], [1.0; 2]] }
}

/// A form's variant.
///
/// # Errors
/// If a mesh is too large for a blob.
pub fn facts(form: &'static Form, variant: u64) -> Result<Arc<Facts>, KindError> {
    static MEMO: Mutex<Memo<Facts>> = Mutex::new(Memo::new());
    remembered(
        &MEMO,
        (form.name, variant),
        |f| f.parts.iter().map(|p| p.blob.len()).sum(),
        || {
            let made = form.make(variant);
            let parts = made
                .parts
                .iter()
                .map(|p| {
                    let (area, extent) = (area(&p.mesh), extent(&p.mesh));
                    Ok(PartFacts { stuff: p.stuff, area, extent, blob: p.mesh.to_bytes()? })
                })
                .collect::<Result<_, KindError>>()?;
            let solids = if made.solids.is_empty() { vec![made.bounds] } else { made.solids };
            Ok(Facts { form, variant, parts, bounds: made.bounds, tops: made.tops, solids })
        },
    )
}

/// A land by name and variant.
///
/// # Errors
/// If its mesh is too large for a blob.
pub fn land(name: &'static str, variant: u64, heights: impl FnOnce() -> Relief) -> Result<Arc<Land>, KindError> {
    static MEMO: Mutex<Memo<Land>> = Mutex::new(Memo::new());
    remembered(
        &MEMO,
        (name, variant),
        |l| l.blob.len(),
        || {
            let relief = heights();
            let blob = mesh_of(&relief).to_bytes()?;
            Ok(Land { relief: Arc::new(relief), blob })
        },
    )
}

/// The mesh of a relief: uv in metres, smooth normals.
fn mesh_of(relief: &Relief) -> Mesh {
    let n = relief.cells;
    let step = 2.0 * relief.half / n as f64;
    let at = |i: usize, j: usize| relief.heights[j * (n + 1) + i];
    let mut mesh = Mesh::default();
    let (mut normals, mut uvs) = (Vec::new(), Vec::new());
    for j in 0..=n {
        for i in 0..=n {
            let [x, z] = [i, j].map(|k| k as f64 * step - relief.half);
            mesh.positions.push([x, at(i, j), z].map(|v| v as f32));
            uvs.push([x as f32, z as f32]);
            let (l, r) = (i.saturating_sub(1), (i + 1).min(n));
            let (b, f) = (j.saturating_sub(1), (j + 1).min(n));
            let slope =
                [(at(r, j) - at(l, j)) / (step * (r - l) as f64), (at(i, f) - at(i, b)) / (step * (f - b) as f64)];
            normals.push(tauflow_data::geom::unit([-slope[0], 1.0, -slope[1]]).map(|v| v as f32));
        }
    }
    let index = |i: usize, j: usize| (j * (n + 1) + i) as u32;
    for j in 0..n {
        for i in 0..n {
            let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i, j + 1), index(i + 1, j + 1)];
            mesh.triangles.extend([[a, d, b], [a, c, d]]);
        }
    }
    mesh.normals = Some(normals);
    mesh.uvs = Some(uvs);
    mesh
}
