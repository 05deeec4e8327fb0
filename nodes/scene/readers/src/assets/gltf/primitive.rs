//! Primitives: attributes and indices as triangles, in the space of their node. Knows nothing of materials.

use super::{
    accessor::{self, Values},
    container::Document,
    deform, draco,
    uv_sets::UvSet,
};
use crate::assets::refusal::{Refusal, damaged};
use gltf::json::{
    mesh::{Mode, Primitive, Semantic},
    validation::Checked,
};
use tauflow_data::{
    geom::{Vec3, apply, cross, determinant, unit},
    records::AssetReport,
    scene::Affine,
};

/// Triangles with attributes, before they become a mesh of the scene format.
#[derive(Clone, Debug, Default)]
pub struct Piece {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Vertex normals; flat without.
    pub normals: Option<Vec<Vec3>>,
    /// Texture coordinates of the set that the material reads first.
    pub uvs: Option<Vec<[f32; 2]>>,
    /// The sets that these coordinates stand for.
    pub sets: Vec<UvSet>,
    /// Vertex colours, linear.
    pub colors: Option<Vec<[f32; 4]>>,
    /// Tangents and handedness.
    pub tangents: Option<Vec<[f64; 4]>>,
}

/// The requested parts of a primitive.
#[derive(Clone, Copy, Debug)]
pub struct Want<'a> {
    /// The sets of texture coordinates that are read, the most important one first.
    pub uv_sets: &'a [u32],
    /// True if tangents are read.
    pub tangents: bool,
    /// Weights of the morph targets.
    pub weights: &'a [f64],
    /// The joint transforms, if there is a skin.
    pub joints: Option<&'a [Affine]>,
}

/// Where attributes come from.
pub struct Source<'a> {
    /// The file.
    pub document: &'a Document<'a>,
    /// The primitive.
    pub primitive: &'a Primitive,
    /// Its compressed attributes.
    pub draco: Option<draco::Decoded>,
    /// Its name in errors.
    pub place: &'a str,
}

/// The effect of a linear map on normals and tangents.
pub struct Directions {
    rows: [Vec3; 3],
    cofactors: [Vec3; 3],
    /// True if it mirrors.
    pub mirrors: bool,
}

impl Directions {
    /// Of a map's linear part.
    pub fn of(map: &Affine) -> Self {
        let row = |r: usize| [map[r][0], map[r][1], map[r][2]];
        // Rows of the cofactor matrix, which maps normals, times the determinant's sign.
        let cofactors = [cross(row(1), row(2)), cross(row(2), row(0)), cross(row(0), row(1))];
        Self { rows: [row(0), row(1), row(2)], cofactors, mirrors: determinant(map) < 0.0 }
    }

    fn sign(&self) -> f64 {
        if self.mirrors { -1.0 } else { 1.0 }
    }

    /// A normal, of length 1; zero if it has no direction.
    pub fn normal(&self, n: Vec3) -> Vec3 {
        scaled_unit(linear(&self.cofactors, n), self.sign())
    }

    /// A tangent of length 1 with its handedness, which a mirror turns over.
    pub fn tangent(&self, t: [f64; 4]) -> [f64; 4] {
        let [x, y, z] = scaled_unit(linear(&self.rows, [t[0], t[1], t[2]]), 1.0);
        [x, y, z, t[3] * self.sign()]
    }
}

fn linear(rows: &[Vec3; 3], v: Vec3) -> Vec3 {
    rows.map(|r| r[0] * v[0] + r[1] * v[1] + r[2] * v[2])
}

impl Source<'_> {
    /// The numbers of an attribute, one vector for each of `count` positions; none if it is not there.
    ///
    /// # Errors
    /// If its accessor is damaged, or of another width or length.
    pub fn get(&self, semantic: Semantic, name: &str, count: Option<usize>) -> Result<Option<Values>, Refusal> {
        let Some(index) = self.primitive.attributes.get(&Checked::Valid(semantic)) else { return Ok(None) };
        let packed = self.draco.as_ref().and_then(|draco| draco.attribute(name));
        let values = match packed {
            Some(values) => values,
            None => accessor::values(self.document, index.value())?,
        };
        let place = format!("{} {name}", self.place);
        let widths: &[usize] = match name {
            "POSITION" | "NORMAL" => &[3],
            "TANGENT" => &[4],
            "COLOR_0" => &[3, 4],
            _ if name.starts_with("JOINTS_") || name.starts_with("WEIGHTS_") => &[4],
            _ => &[2],
        };
        if !widths.contains(&values.width) {
            return Err(damaged(place, format!("vectors of {} numbers", values.width)));
        }
        if let Some(count) = count.filter(|count| *count != values.len()) {
            return Err(damaged(place, format!("{} elements for {count} positions", values.len())));
        }
        Ok(Some(values))
    }
}

/// The triangles of a primitive, morphed and on its joints, and whether it has joints; none if it has no surface
/// (points, lines, no positions).
///
/// # Errors
/// If an accessor is damaged, an index names no vertex, or attributes differ in length.
pub fn read(
    document: &Document<'_>,
    primitive: &Primitive,
    place: &str,
    want: Want<'_>,
    report: &mut AssetReport,
) -> Result<Option<(Piece, bool)>, Refusal> {
    let mode = match &primitive.mode {
        Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => *mode,
        Checked::Valid(_) => {
            report.repaired("primitives of points or lines left out", 1);
            return Ok(None);
        }
        Checked::Invalid => return Err(damaged(place, "a mode that does not exist")),
    };
    let extension = primitive.extensions.as_ref().and_then(|e| e.others.get("KHR_draco_mesh_compression"));
    let draco = match extension {
        Some(extension) => {
            let view = extension.get("bufferView").and_then(serde_json::Value::as_u64).unwrap_or(u64::MAX);
            let (bytes, _) = document.view(usize::try_from(view).unwrap_or(usize::MAX))?;
            Some(draco::decode(bytes, extension, place)?)
        }
        None => None,
    };
    let source = Source { document, primitive, draco, place };
    let Some(positions) = source.get(Semantic::Positions, "POSITION", None)? else {
        report.repaired("primitives without positions left out", 1);
        return Ok(None);
    };
    let count = positions.len();
    let indices: Vec<u32> = match (&source.draco, primitive.indices) {
        (Some(draco), _) => draco.indices.clone(),
        (None, None) => (0..count as u32).collect(),
        (None, Some(index)) => {
            let values = accessor::values(document, index.value())?;
            if values.width != 1 || !values.integers {
                return Err(damaged(format!("{place} indices"), "they are no whole numbers"));
            }
            values.data.into_iter().map(|v| v as u32).collect()
        }
    };
    if let Some(beyond) = indices.iter().find(|i| **i as usize >= count) {
        return Err(damaged(format!("{place} indices"), format!("vertex {beyond} of {count} is named")));
    }
    let (uvs, sets) = coordinates(&source, want.uv_sets, count, report)?;
    let tangents = if want.tangents { source.get(Semantic::Tangents, "TANGENT", Some(count))? } else { None };
    let colors = colors(&source, count)?;
    let mut piece = Piece {
        positions: positions.vectors::<3>(0.0),
        triangles: triangles(mode, &indices, report),
        normals: source.get(Semantic::Normals, "NORMAL", Some(count))?.map(|v| v.vectors::<3>(0.0)),
        uvs,
        sets,
        colors: colors.map(|v| {
            let within = |x: f64| if x.is_finite() { x.clamp(0.0, 1.0) } else { 1.0 };
            mended(v.vectors::<4>(1.0), within, "values of vertex colours outside of 0 to 1 cut to it", report)
        }),
        tangents: tangents.map(|v| v.vectors::<4>(1.0)),
    };
    deform::morph(&source, want.weights, &mut piece, report)?;
    let skinned = match want.joints {
        Some(joints) => deform::skin(&source, joints, &mut piece, report)?,
        None => false,
    };
    if want.joints.is_some() && !skinned {
        report.note("primitives of skinned meshes that have no joints stand where their node does");
    }
    Ok(Some((piece, skinned)))
}

/// The texture coordinates that a mesh keeps, and the sets that they stand for.
type Coordinates = (Option<Vec<[f32; 2]>>, Vec<UvSet>);

/// The texture coordinates of the first set that is there, and what they stand for.
fn coordinates(
    source: &Source<'_>,
    wanted: &[u32],
    count: usize,
    report: &mut AssetReport,
) -> Result<Coordinates, Refusal> {
    let (mut kept, mut sets): (Option<Vec<[f32; 2]>>, _) = (None, Vec::new());
    for set in wanted {
        let Some(values) = source.get(Semantic::TexCoords(*set), &format!("TEXCOORD_{set}"), Some(count))? else {
            continue;
        };
        let finite = |x: f64| if x.is_finite() { x } else { 0.0 };
        let what = "texture coordinates that are not finite set to 0";
        let uvs = mended(values.vectors::<2>(0.0), finite, what, report);
        match &kept {
            None => {
                sets.push(UvSet::kept(*set));
                kept = Some(uvs);
            }
            Some(kept) => sets.extend(UvSet::mapped(*set, kept, &uvs)),
        }
    }
    Ok((kept, sets))
}

/// Vectors with `mend` applied to their values; those that it changes are counted.
fn mended<const N: usize>(
    vectors: Vec<[f64; N]>,
    mend: impl Fn(f64) -> f64,
    what: &str,
    report: &mut AssetReport,
) -> Vec<[f32; N]> {
    let mut changed = 0;
    let mut one = |value: f64| {
        let mended = mend(value);
        changed += u64::from(mended != value);
        mended as f32
    };
    let out = vectors.into_iter().map(|vector| vector.map(&mut one)).collect();
    report.repaired(what, changed);
    out
}

/// Vertex colours; those of a Draco stream are whole numbers where the accessor says that they are normalised.
fn colors(source: &Source<'_>, count: usize) -> Result<Option<Values>, Refusal> {
    let Some(mut values) = source.get(Semantic::Colors(0), "COLOR_0", Some(count))? else { return Ok(None) };
    if source.draco.is_some() {
        let most = values.data.iter().copied().fold(0.0, f64::max);
        let unit = if most <= 1.0 {
            1.0
        } else if most <= 255.0 {
            255.0
        } else {
            65535.0
        };
        values.data.iter_mut().for_each(|v| *v /= unit);
    }
    Ok(Some(values))
}

/// Triangles of a list, strip or fan (glTF 2.0, section 3.7.2.1).
fn triangles(mode: Mode, indices: &[u32], report: &mut AssetReport) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => indices
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] })
            .collect(),
        Mode::TriangleFan => match indices.split_first() {
            Some((first, rest)) => rest.windows(2).map(|w| [w[0], w[1], *first]).collect(),
            None => Vec::new(),
        },
        _ => {
            report.repaired("indices beyond the last whole triangle left out", (indices.len() % 3) as u64);
            indices.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
        }
    }
}

impl Piece {
    /// Maps it into another space; a mirroring map turns the triangles round, so that outside stays outside.
    pub fn transform(&mut self, map: &Affine) {
        self.positions.iter_mut().for_each(|p| *p = apply(map, *p));
        let directions = Directions::of(map);
        if let Some(normals) = &mut self.normals {
            normals.iter_mut().for_each(|n| *n = directions.normal(*n));
        }
        if let Some(tangents) = &mut self.tangents {
            tangents.iter_mut().for_each(|t| *t = directions.tangent(*t));
        }
        if directions.mirrors {
            self.turn();
        }
    }

    /// Puts another piece with the same attributes beside it.
    pub fn join(&mut self, other: Self) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.triangles.extend(other.triangles.into_iter().map(|t| t.map(|i| first + i)));
        fn both<T>(own: &mut Option<Vec<T>>, other: Option<Vec<T>>) {
            if let (Some(own), Some(other)) = (own, other) {
                own.extend(other);
            }
        }
        both(&mut self.normals, other.normals);
        both(&mut self.uvs, other.uvs);
        both(&mut self.colors, other.colors);
        both(&mut self.tangents, other.tangents);
    }

    /// Turns every triangle round, leaving normals.
    fn turn(&mut self) {
        self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }

    /// Turns the surface inside out: triangles and normals.
    pub fn invert(&mut self) {
        self.turn();
        if let Some(normals) = &mut self.normals {
            normals.iter_mut().for_each(|n| *n = n.map(|v| -v));
        }
    }
}

/// `v` scaled to length 1 and a sign; zero if it has no direction.
fn scaled_unit(v: Vec3, sign: f64) -> Vec3 {
    let usable = v.iter().all(|x| x.is_finite()) && v.iter().any(|x| *x != 0.0);
    if usable { unit(v).map(|x| x * sign) } else { [0.0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_keep_their_winding() {
        let mut report = AssetReport::default();
        let of = |mode, report: &mut AssetReport| triangles(mode, &[0, 1, 2, 3, 4], report);
        assert_eq!(of(Mode::TriangleStrip, &mut report), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(of(Mode::TriangleFan, &mut report), [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
        assert_eq!(of(Mode::Triangles, &mut report), [[0, 1, 2]]);
        assert_eq!(report.repairs.values().sum::<u64>(), 2);
        assert!(triangles(Mode::TriangleFan, &[], &mut report).is_empty());
    }

    #[test]
    fn mirrors_keep_outside_outside() {
        let mut piece = Piece {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            normals: Some(vec![[0.0, 0.0, 1.0]; 3]),
            tangents: Some(vec![[1.0, 0.0, 0.0, 1.0]; 3]),
            ..Piece::default()
        };
        piece.transform(&tauflow_data::geom::scaling([-2.0, 1.0, 3.0]));
        let [a, b, c] = piece.triangles[0].map(|i| piece.positions[i as usize]);
        let facing = cross(tauflow_data::geom::sub(b, a), tauflow_data::geom::sub(c, a));
        assert!(facing[2] > 0.0, "{facing:?}");
        assert_eq!(piece.normals.as_ref().expect("kept")[0], [0.0, 0.0, 1.0]);
        assert_eq!(piece.tangents.as_ref().expect("kept")[0], [-1.0, 0.0, 0.0, -1.0]);
    }
}
