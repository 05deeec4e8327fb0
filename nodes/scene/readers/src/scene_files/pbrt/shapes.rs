//! pbrt's shapes.

use super::{Directive, PbrtReader, materials::reads_uv};
use crate::scene_files::{
    build::even,
    meshes::{self, ROUND},
    ply::Read,
};
use tauflow_data::{
    geom::{add, compose, cross, dot, length, mul, scaling, sub, translation},
    maths,
    mesh::Mesh,
    scene::{Affine, Geometry, IDENTITY, Shape},
};

/// Cells along each side of a patch that is not flat.
const CURVED: usize = 16;

impl<'t> PbrtReader<'t, '_, '_> {
    pub(super) fn shape(&mut self, directive: &'t Directive) {
        let light = self.state.light;
        if light.is_some() && self.object.is_some() {
            let what = "a light in an object is not supported";
            self.build.problems.error(&directive.at, what, "put the shape into the world");
        }
        let emission = light.map(|light| self.area(light, directive));
        let alpha = self.find(directive, "alpha").filter(|p| p.values != super::Values::Numbers(vec![1.0]));
        let material = self.material(alpha);
        let textured = material.is_some_and(|m| reads_uv(&self.build.materials[m]));
        let made = self.geometry(directive, textured);
        self.finish(directive);
        let (Some((geometry, local)), Some(material)) = (made, material) else { return };
        let emission = match emission {
            Some(None) => return,
            Some(made) => made,
            None => None,
        };
        let to_world = compose(&self.state.ctm, &local);
        let shape = Shape { geometry, to_world, material, emission, flip_normals: self.state.reverse };
        match &mut self.object {
            Some((_, shapes)) => shapes.push(shape),
            None => self.build.shape(shape, &directive.at),
        }
    }

    fn geometry(&mut self, directive: &'t Directive, textured: bool) -> Option<(Geometry, Affine)> {
        let at = &directive.at;
        let key = |what: &str| format!("{what} {}:{} {textured}", at.file, at.line);
        let sort = self.name(directive);
        let mesh = match sort {
            "trianglemesh" => self.triangles(directive)?,
            "plymesh" => {
                let Some(path) = self.text(directive, "filename") else {
                    self.build.problems.error(at, "a mesh without `filename`", "name its file");
                    return None;
                };
                let key = format!("ply {path} {textured}");
                let geometry = self.build.mesh(&key, at, |build| {
                    let read = build.read_mesh(path, "ply", 0, at)?;
                    Some(oriented(read.mesh.clone(), textured))
                })?;
                return Some((geometry, IDENTITY));
            }
            "bilinearmesh" => self.bilinear(directive)?,
            "sphere" => return self.sphere(directive, textured),
            "disk" => {
                let height = self.number(directive, "height").unwrap_or(0.0);
                let radius = self.number(directive, "radius").unwrap_or(1.0);
                let inner = self.number(directive, "innerradius").unwrap_or(0.0);
                let sweep = self.sweep(directive)?;
                if inner == 0.0 && !textured && sweep >= 2.0 * core::f64::consts::PI {
                    let local = compose(&translation([0.0, 0.0, height]), &scaling([radius, radius, 1.0]));
                    return Some((Geometry::Disk, local));
                }
                meshes::ring(radius, inner, height, sweep)
            }
            "cylinder" => {
                let radius = self.number(directive, "radius").unwrap_or(1.0);
                let z = [("zmin", -1.0), ("zmax", 1.0)].map(|(n, d)| self.number(directive, n).unwrap_or(d));
                let sweep = self.sweep(directive)?;
                meshes::cylinder(radius, z, sweep)
            }
            _ => {
                self.unsupported(directive, "export it as a `plymesh`");
                return None;
            }
        };
        if matches!(sort, "disk" | "cylinder") {
            self.build.problems.note(at, format!("a {sort} is tessellated into {ROUND} pieces"));
        }
        // What is built from numbers in the file is built for each place in it; the numbers alone say which it is.
        let key = format!("{} {:p}", key(sort), std::ptr::from_ref(directive));
        let mesh = meshes::checked(Read { mesh, ..Read::default() });
        let mesh = mesh.map_err(|refusal| self.build.problems.refuse(at, sort, &refusal)).ok()?;
        let geometry = self.build.mesh(&key, at, |_| Some(oriented(mesh.mesh, textured)))?;
        Some((geometry, IDENTITY))
    }

    fn sphere(&mut self, directive: &'t Directive, textured: bool) -> Option<(Geometry, Affine)> {
        let radius = self.number(directive, "radius").unwrap_or(1.0);
        let ends = [("zmin", -radius), ("zmax", radius)];
        let ends = ends.map(|(n, d)| self.number(directive, n).unwrap_or(d));
        let sweep = self.sweep(directive)?;
        let [low, high] = ends.map(|z| z.min(radius).max(-radius));
        if !(radius > 0.0 && high > low) {
            let what = format!("a sphere of radius {radius} from {} to {}, of which nothing is left", ends[0], ends[1]);
            self.build.problems.error(&directive.at, what, "give it a radius above 0, and `zmax` above `zmin`");
            return None;
        }
        let whole = low <= -radius && high >= radius && sweep >= 2.0 * core::f64::consts::PI;
        if whole && !textured && even(&self.state.ctm) {
            return Some((Geometry::Sphere { center: [0.0; 3], radius }, IDENTITY));
        }
        self.build.problems.note(&directive.at, format!("a sphere is tessellated into {ROUND} x {} pieces", ROUND / 2));
        let theta = [low, high].map(|z| maths::acos((z / radius).clamp(-1.0, 1.0)));
        // Of radius 1 and scaled: spheres of many radii share a mesh.
        let key = format!("sphere {theta:?} {sweep}");
        let geometry = self.build.mesh(&key, &directive.at, |build| {
            let affordable = build.affords(meshes::grid_bytes([ROUND, ROUND / 2]), &directive.at);
            affordable.then(|| meshes::sphere(1.0, theta, sweep))
        })?;
        Some((geometry, scaling([radius; 3])))
    }

    /// The angle about its axis that is there of a shape, in radians; pbrt takes 360 degrees at most.
    fn sweep(&mut self, directive: &'t Directive) -> Option<f64> {
        let degrees = self.number(directive, "phimax").unwrap_or(360.0);
        if degrees <= 0.0 {
            let what = format!("a `phimax` of {degrees}, which leaves nothing");
            self.build.problems.error(&directive.at, what, "use an angle above 0, up to 360");
            return None;
        }
        Some(degrees.min(360.0).to_radians())
    }

    fn triangles(&mut self, directive: &'t Directive) -> Option<Mesh> {
        let positions = self.needed(directive, "P")?;
        let count = positions.len();
        let triangles = match self.indices(directive, "indices") {
            Some(triangles) => triangles,
            None if count == 3 => vec![[0, 1, 2]],
            None => {
                self.build.problems.error(&directive.at, "a mesh without `indices`", "give it some");
                return None;
            }
        };
        let normals = self.rows(directive, "N");
        let uvs = self.rows(directive, "uv");
        // Tangents do nothing here: no material is anisotropic.
        self.pass_over(directive, &["S", "faceIndices"]);
        if normals.as_ref().is_some_and(|n: &Vec<[f32; 3]>| n.len() != count)
            || uvs.as_ref().is_some_and(|t: &Vec<[f32; 2]>| t.len() != count)
        {
            let what = format!("{count} places, and another number of `N` or `uv`");
            self.build.problems.error(&directive.at, what, "give as many");
            return None;
        }
        Some(Mesh { positions, triangles, normals, uvs, ..Mesh::default() })
    }

    fn needed(&mut self, directive: &'t Directive, name: &str) -> Option<Vec<[f32; 3]>> {
        if directive.params.iter().all(|p| p.name != name) {
            self.build.problems.error(&directive.at, format!("a mesh without `{name}`"), "give it some");
        }
        self.rows(directive, name)
    }

    fn bilinear(&mut self, directive: &'t Directive) -> Option<Mesh> {
        let positions = self.needed(directive, "P")?;
        let patches = match self.indices::<4>(directive, "indices") {
            Some(patches) => patches,
            None if positions.len() == 4 => vec![[0, 1, 2, 3]],
            None => {
                self.build.problems.error(&directive.at, "a mesh without `indices`", "give it some");
                return None;
            }
        };
        let (normals, uvs) = (self.rows::<3>(directive, "N"), self.rows::<2>(directive, "uv"));
        let count = positions.len();
        if patches.iter().flatten().any(|i| *i as usize >= count)
            || normals.as_ref().is_some_and(|n| n.len() != count)
            || uvs.as_ref().is_some_and(|t| t.len() != count)
        {
            let what = "patches of vertices that are not there";
            self.build.problems.error(&directive.at, what, "give as many `N` and `uv` as `P`");
            return None;
        }
        let cells = |patch: &[u32; 4]| -> usize {
            let p = patch.map(|i| positions[i as usize].map(f64::from));
            let gap = sub(add(p[0], p[3]), add(p[1], p[2]));
            let flat = length(gap) <= 1e-6 * length(sub(p[3], p[0]));
            if flat && normals.is_none() { 1 } else { CURVED }
        };
        let bytes: usize = patches.iter().map(|patch| meshes::grid_bytes([cells(patch); 2])).sum();
        if !self.build.affords(bytes, &directive.at) {
            return None;
        }
        if patches.iter().any(|patch| cells(patch) > 1) {
            let what = format!("curved patches are tessellated into {CURVED} x {CURVED} pieces");
            self.build.problems.note(&directive.at, what);
        }
        let mut mesh = Mesh { uvs: Some(Vec::new()), normals: normals.as_ref().map(|_| Vec::new()), ..Mesh::default() };
        for patch in patches {
            let cells = cells(&patch);
            if mesh.positions.len() > meshes::MOST {
                self.build.problems.error(&directive.at, "too many patches", "split the mesh");
                return None;
            }
            let first = mesh.positions.len() as u32;
            for row in 0..=cells {
                for column in 0..=cells {
                    let (u, v) = (column as f64 / cells as f64, row as f64 / cells as f64);
                    let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
                    let mixed = |of: &[[f32; 3]]| {
                        let parts = patch.iter().zip(weights).map(|(i, w)| mul(of[*i as usize].map(f64::from), w));
                        parts.fold([0.0; 3], add).map(|x| x as f32)
                    };
                    mesh.positions.push(mixed(&positions));
                    if let (Some(own), Some(all)) = (&mut mesh.normals, &normals) {
                        own.push(mixed(all));
                    }
                    let uv = match &uvs {
                        Some(all) => [0, 1].map(|c: usize| {
                            patch.iter().zip(weights).map(|(i, w)| f64::from(all[*i as usize][c]) * w).sum::<f64>()
                                as f32
                        }),
                        None => [u as f32, v as f32],
                    };
                    mesh.uvs.get_or_insert_default().push(uv);
                }
            }
            let at = |row: u32, column: u32| first + row * (cells as u32 + 1) + column;
            for (row, column) in (0..cells as u32).flat_map(|r| (0..cells as u32).map(move |c| (r, c))) {
                let (a, b) = (at(row, column), at(row, column + 1));
                let (c, d) = (at(row + 1, column + 1), at(row + 1, column));
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        Some(mesh)
    }
}

/// A mesh whose triangles face as their normals do, with pbrt's own texture coordinates where it lacks some that its
/// material reads: (0, 0), (1, 0), (1, 1) on each triangle.
fn oriented(mut mesh: Mesh, textured: bool) -> Mesh {
    if let Some(normals) = &mesh.normals {
        for triangle in &mut mesh.triangles {
            let p = triangle.map(|i| mesh.positions[i as usize].map(f64::from));
            let facing = cross(sub(p[1], p[0]), sub(p[2], p[0]));
            let shading = triangle.map(|i| normals[i as usize].map(f64::from)).into_iter().fold([0.0; 3], add);
            if dot(facing, shading) < 0.0 {
                triangle.swap(1, 2);
            }
        }
    }
    if textured && mesh.uvs.is_none() {
        let corners: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
        let pick = |of: &[[f32; 3]]| corners.iter().map(|i| of[*i as usize]).collect::<Vec<_>>();
        mesh = Mesh {
            positions: pick(&mesh.positions),
            normals: mesh.normals.as_deref().map(pick),
            uvs: Some([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]].repeat(mesh.triangles.len())),
            triangles: (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            ..Mesh::default()
        };
    }
    mesh
}
