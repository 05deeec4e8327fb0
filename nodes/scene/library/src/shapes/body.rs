//! A surface in the making, and how it becomes a mesh with shading normals. Knows no way to build one.

use tauflow_data::geom::{
    Vec3, add, apply, cross, determinant, dot, length, mul, rotation_x, rotation_y, rotation_z, sub,
};
use tauflow_data::{mesh::Mesh, scene::Affine};

/// A triangle surface in f64. Edges sharper than `crease` stay sharp when shaded.
#[derive(Clone, Debug)]
pub struct Body {
    /// Points, metres.
    pub points: Vec<Vec3>,
    /// Texture coordinates, metres, v downwards.
    pub uvs: Vec<[f64; 2]>,
    /// Corners of each triangle, counter-clockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Cosine of the angle between faces above which their edge is smooth.
    pub crease: f64,
}

impl Default for Body {
    fn default() -> Self {
        // The cosine of 42 degrees: a tube of ten sides is smooth, a box of chamfers of 45 degrees is not.
        Self { points: Vec::new(), uvs: Vec::new(), triangles: Vec::new(), crease: 0.743 }
    }
}

impl Body {
    /// Adds a point and gives its number.
    pub fn point(&mut self, p: Vec3, uv: [f64; 2]) -> u32 {
        self.points.push(p);
        self.uvs.push(uv);
        self.points.len() as u32 - 1
    }

    /// Two triangles over four points in order.
    pub fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        self.triangles.extend([[a, b, c], [a, c, d]]);
    }

    /// Smooth over edges of up to 85 degrees.
    pub fn smooth(mut self) -> Self {
        self.crease = 0.087;
        self
    }

    /// Smooth over edges of up to 62 degrees: chamfers are.
    pub fn soft(mut self) -> Self {
        self.crease = 0.47;
        self
    }

    /// Sharp at every edge.
    pub fn flat(mut self) -> Self {
        self.crease = 0.9999;
        self
    }

    /// Moved by `by`.
    pub fn at(mut self, by: Vec3) -> Self {
        self.points.iter_mut().for_each(|p| *p = add(*p, by));
        self
    }

    /// Under an affine map; mirrored maps turn the triangles.
    pub fn mapped(mut self, m: &Affine) -> Self {
        self.points.iter_mut().for_each(|p| *p = apply(m, *p));
        if determinant(m) < 0.0 { self.flipped() } else { self }
    }

    /// Turned about +x by radians.
    pub fn turned_x(self, angle: f64) -> Self {
        self.mapped(&rotation_x(angle))
    }

    /// Turned about +y by radians.
    pub fn turned_y(self, angle: f64) -> Self {
        self.mapped(&rotation_y(angle))
    }

    /// Turned about +z by radians.
    pub fn turned_z(self, angle: f64) -> Self {
        self.mapped(&rotation_z(angle))
    }

    /// Scaled along the axes; uv stays.
    pub fn scaled(mut self, s: Vec3) -> Self {
        self.points.iter_mut().for_each(|p| *p = [p[0] * s[0], p[1] * s[1], p[2] * s[2]]);
        if s[0] * s[1] * s[2] < 0.0 { self.flipped() } else { self }
    }

    /// Every point mapped by `f`, which must not mirror.
    pub fn bent(mut self, f: impl Fn(Vec3) -> Vec3) -> Self {
        self.points.iter_mut().for_each(|p| *p = f(*p));
        self
    }

    /// Facing the other way.
    pub fn flipped(mut self) -> Self {
        self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        self
    }

    /// With u and v exchanged, and v turned so that nothing is mirrored.
    pub fn across(mut self) -> Self {
        self.uvs.iter_mut().for_each(|uv| *uv = [-uv[1], uv[0]]);
        self
    }

    /// This and another as one surface, with this one's crease.
    pub fn with(mut self, other: Self) -> Self {
        let base = self.points.len() as u32;
        self.points.extend(other.points);
        self.uvs.extend(other.uvs);
        self.triangles.extend(other.triangles.into_iter().map(|t| t.map(|i| i + base)));
        self
    }

    /// Several bodies as one.
    pub fn all(bodies: impl IntoIterator<Item = Self>) -> Self {
        let mut bodies = bodies.into_iter();
        let first = bodies.next().unwrap_or_default();
        bodies.fold(first, Self::with)
    }

    /// Texture coordinates by projection along the axis that each face looks along most.
    pub fn box_mapped(self) -> Self {
        let mut out = Self { crease: self.crease, ..Self::default() };
        let mut known = vec![[u32::MAX; 6]; self.points.len()];
        for t in &self.triangles {
            let [a, b, c] = t.map(|i| self.points[i as usize]);
            let n = cross(sub(b, a), sub(c, a));
            let axis = (0..3).max_by(|i, j| n[*i].abs().total_cmp(&n[*j].abs())).unwrap_or(1);
            let side = 2 * axis + usize::from(n[axis] < 0.0);
            let sign = if n[axis] < 0.0 { -1.0 } else { 1.0 };
            let corner = t.map(|i| {
                let slot = &mut known[i as usize][side];
                if *slot == u32::MAX {
                    let p = self.points[i as usize];
                    let uv = match axis {
                        0 => [-sign * p[2], -p[1]],
                        1 => [p[0], sign * p[2]],
                        _ => [sign * p[0], -p[1]],
                    };
                    *slot = out.point(p, uv);
                }
                *slot
            });
            out.triangles.push(corner);
        }
        out
    }

    /// The mesh, moved by `by`: f32, normals by area over smooth edges, no triangle with two corners in one place.
    pub fn mesh(&self, by: Vec3) -> Mesh {
        let positions: Vec<[f32; 3]> = self.points.iter().map(|p| add(*p, by).map(|v| v as f32)).collect();
        let place = welded(&positions);
        let at = |i: u32| positions[i as usize].map(f64::from);
        let kept = |t: &&[u32; 3]| {
            let [a, b, c] = t.map(|i| place[i as usize]);
            a != b && b != c && c != a
        };
        let triangles: Vec<[u32; 3]> = self.triangles.iter().filter(kept).copied().collect();
        let faces: Vec<(Vec3, f64)> = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(at);
                let n = cross(sub(b, a), sub(c, a));
                (n, length(n).max(1e-300))
            })
            .collect();
        let mut starts = vec![0u32; positions.len() + 1];
        triangles.iter().flatten().for_each(|i| starts[place[*i as usize] as usize + 1] += 1);
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut around = vec![0u32; triangles.len() * 3];
        let mut next = starts.clone();
        for (face, t) in triangles.iter().enumerate() {
            for i in t {
                let slot = &mut next[place[*i as usize] as usize];
                around[*slot as usize] = face as u32;
                *slot += 1;
            }
        }
        let mut mesh = Mesh { normals: Some(Vec::new()), uvs: Some(Vec::new()), ..Mesh::default() };
        let (mut normals, mut uvs) = (Vec::new(), Vec::new());
        // Vertices made of each point so far.
        let mut made: Vec<Vec<u32>> = vec![Vec::new(); positions.len()];
        for (face, t) in triangles.iter().enumerate() {
            let (own, own_length) = faces[face];
            let corners = t.map(|i| {
                let spot = place[i as usize] as usize;
                let mut sum = [0.0; 3];
                for other in &around[starts[spot] as usize..starts[spot + 1] as usize] {
                    let (n, l) = faces[*other as usize];
                    if *other as usize == face || dot(n, own) >= self.crease * l * own_length {
                        sum = add(sum, n);
                    }
                }
                let l = length(sum);
                let normal = (if l > 0.0 { mul(sum, 1.0 / l) } else { mul(own, 1.0 / own_length) }).map(|v| v as f32);
                let found = made[i as usize].iter().find(|k| normals[**k as usize] == normal).copied();
                found.unwrap_or_else(|| {
                    let k = mesh.positions.len() as u32;
                    mesh.positions.push(positions[i as usize]);
                    normals.push(normal);
                    uvs.push(self.uvs[i as usize].map(|v| v as f32));
                    made[i as usize].push(k);
                    k
                })
            });
            mesh.triangles.push(corners);
        }
        mesh.normals = Some(normals);
        mesh.uvs = Some(uvs);
        mesh
    }
}

/// The first number of each point's place.
fn welded(positions: &[[f32; 3]]) -> Vec<u32> {
    // Adding 0 turns -0 into 0.
    let key = |i: u32| positions[i as usize].map(|v| (v + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.sort_unstable_by_key(|i| (key(*i), *i));
    let mut place = vec![0; positions.len()];
    let mut first = 0;
    for (k, i) in order.iter().enumerate() {
        if k == 0 || key(order[k - 1]) != key(*i) {
            first = *i;
        }
        place[*i as usize] = first;
    }
    place
}
