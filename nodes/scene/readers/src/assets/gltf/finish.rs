//! From pieces in a file's space to meshes in the unit box: repairs, and the frame. Knows nothing of materials.

use super::{primitive::Piece, purpose::Purpose};
use crate::assets::refusal::{Refusal, damaged};
use tauflow_data::{
    geom::{Aabb, Vec3, add, cross, length, sub, unit},
    mesh::Mesh,
    mesh_check::{is_closed, signed_volume},
    records::AssetReport,
    scene::Affine,
};

/// The map into the box: largest side 1, standing on y = 0 about the y axis.
pub struct UnitBox {
    /// From the file's space into the box.
    pub map: Affine,
    /// Largest side before, in the file's unit (metres).
    pub side: f64,
}

/// Triangles that were left out of a mesh.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lost {
    /// With a vertex that is not finite.
    pub not_finite: usize,
}

/// Share of vertices beyond which a far-off few do not count, at either end of an axis.
const STRAY: f64 = 0.0005;

impl UnitBox {
    /// The frame of all pieces together.
    ///
    /// It is that of every vertex in use, unless leaving out one vertex in 2,000 at either end of each axis shrinks it
    /// more than tenfold. Then those are strays (a forgotten helper, a broken vertex), and it is that of the rest.
    ///
    /// # Errors
    /// If no vertex is finite, or all are in one place.
    pub fn around<'a>(
        pieces: impl Iterator<Item = &'a Piece>,
        purpose: Purpose,
        report: &mut AssetReport,
    ) -> Result<Self, Refusal> {
        let mut used: Vec<Vec3> = Vec::new();
        for piece in pieces {
            let mut mark = vec![false; piece.positions.len()];
            piece.triangles.iter().flatten().for_each(|i| mark[*i as usize] = true);
            let finite = piece.positions.iter().zip(mark).filter(|(p, mark)| *mark && p.iter().all(|v| v.is_finite()));
            used.extend(finite.map(|(p, _)| *p));
        }
        let mut full = Aabb::EMPTY;
        used.iter().for_each(|p| full.grow(*p));
        let skip = (used.len() as f64 * STRAY) as usize;
        let mut core = full;
        for axis in 0..3 {
            let mut along: Vec<f64> = used.iter().map(|p| p[axis]).collect();
            along.sort_unstable_by(f64::total_cmp);
            if let (Some(low), Some(high)) =
                (along.get(skip), along.len().checked_sub(skip + 1).and_then(|i| along.get(i)))
            {
                (core.low[axis], core.high[axis]) = (*low, *high);
            }
        }
        let largest = |b: &Aabb| b.size().into_iter().fold(0.0, f64::max);
        let strays = largest(&core) > 0.0 && largest(&full) > 10.0 * largest(&core);
        if strays && purpose == Purpose::Object {
            report.note("strays far from everything else do not count for the size");
        }
        let bounds = if strays { core } else { full };
        let side = largest(&bounds);
        if used.is_empty() {
            return Err(damaged("positions", "no vertex is finite"));
        }
        if !(side > 0.0 && side.is_finite()) {
            return Err(damaged("positions", "the vertices span no finite box"));
        }
        let (center, k) = (bounds.center(), 1.0 / side);
        let row = |r: usize, at: f64| {
            let mut row = [0.0, 0.0, 0.0, -at * k];
            row[r] = k;
            row
        };
        Ok(Self { map: [row(0, center[0]), row(1, bounds.low[1]), row(2, center[2])], side })
    }
}

impl UnitBox {
    /// The map back: an even scale and a shift.
    pub fn back(&self) -> Affine {
        let k = self.map[0][0];
        [0, 1, 2].map(|r: usize| {
            let mut row = [0.0, 0.0, 0.0, -self.map[r][3] / k];
            row[r] = 1.0 / k;
            row
        })
    }
}

/// A mesh of a piece; none if no triangle is left.
///
/// Leaves out triangles with a vertex that is not finite or without an area (in the precision of the mesh), and
/// vertices that none uses; mends normals without a direction; turns a closed body of an object right side out. In a
/// scene it may be a room or a sky, whose front is inside.
pub fn mesh(mut piece: Piece, frame: &UnitBox, purpose: Purpose, report: &mut AssetReport) -> (Option<Mesh>, Lost) {
    piece.transform(&frame.map);
    let single = |p: &Vec3| p.map(|v| v as f32);
    let mut lost = Lost::default();
    let mut degenerate = 0;
    let positions: Vec<[f32; 3]> = piece.positions.iter().map(single).collect();
    piece.triangles.retain(|t| {
        let [a, b, c] = t.map(|i| positions[i as usize].map(f64::from));
        if ![a, b, c].iter().flatten().all(|v| v.is_finite()) {
            lost.not_finite += 1;
            return false;
        }
        let area = length(cross(sub(b, a), sub(c, a)));
        degenerate += u64::from(area <= 0.0);
        area > 0.0
    });
    report.repaired("triangles with vertices that are not finite left out", lost.not_finite as u64);
    report.repaired("triangles without area left out", degenerate);
    if piece.triangles.is_empty() {
        return (None, lost);
    }
    compact(&mut piece);
    mend_normals(&mut piece, report);
    mend_tangents(&mut piece, report);
    let probe = Mesh {
        positions: piece.positions.iter().map(single).collect(),
        triangles: piece.triangles.clone(),
        ..Mesh::default()
    };
    if purpose == Purpose::Object && is_closed(&probe) && signed_volume(&probe) < 0.0 {
        piece.invert();
        report.repaired("closed bodies turned right side out", 1);
    }
    let mesh = Mesh {
        positions: probe.positions,
        triangles: piece.triangles,
        normals: piece.normals.map(|normals| normals.iter().map(single).collect()),
        uvs: piece.uvs,
        colors: piece.colors,
        tangents: piece.tangents.map(|tangents| tangents.iter().map(|t| t.map(|v| v as f32)).collect()),
    };
    (Some(mesh), lost)
}

/// Leaves out vertices that no triangle uses.
fn compact(piece: &mut Piece) {
    const NONE: u32 = u32::MAX;
    let mut place = vec![NONE; piece.positions.len()];
    let mut kept: Vec<usize> = Vec::new();
    for index in piece.triangles.iter_mut().flatten() {
        let old = *index as usize;
        if place[old] == NONE {
            place[old] = kept.len() as u32;
            kept.push(old);
        }
        *index = place[old];
    }
    fn take<T: Copy>(from: &mut Vec<T>, kept: &[usize]) {
        *from = kept.iter().map(|i| from[*i]).collect();
    }
    take(&mut piece.positions, &kept);
    piece.normals.iter_mut().for_each(|v| take(v, &kept));
    piece.uvs.iter_mut().for_each(|v| take(v, &kept));
    piece.colors.iter_mut().for_each(|v| take(v, &kept));
    piece.tangents.iter_mut().for_each(|v| take(v, &kept));
}

/// Gives normals without a direction that of the triangles about their vertex.
fn mend_normals(piece: &mut Piece, report: &mut AssetReport) {
    let Some(normals) = &mut piece.normals else { return };
    let bad: Vec<bool> = normals.iter().map(|n| length(*n) < 0.5).collect();
    let count = bad.iter().filter(|b| **b).count();
    if count == 0 {
        return;
    }
    report.repaired("normals without a direction mended", count as u64);
    let mut sums = vec![[0.0; 3]; normals.len()];
    for t in &piece.triangles {
        let [a, b, c] = t.map(|i| piece.positions[i as usize]);
        let normal = cross(sub(b, a), sub(c, a));
        t.iter().for_each(|i| sums[*i as usize] = add(sums[*i as usize], normal));
    }
    for ((normal, sum), bad) in normals.iter_mut().zip(sums).zip(bad) {
        if bad {
            *normal = unit(sum);
        }
    }
}

/// Leaves tangents out if some have no direction: the renderer then takes those of the texture coordinates.
fn mend_tangents(piece: &mut Piece, report: &mut AssetReport) {
    let bad = |t: &[f64; 4]| length([t[0], t[1], t[2]]) < 0.5 || !t[3].is_finite() || t[3] == 0.0;
    if piece.tangents.as_ref().is_some_and(|tangents| tangents.iter().any(bad)) {
        piece.tangents = None;
        report.repaired("sets of tangents with some without a direction left out", 1);
    }
}
