//! Mitsuba's shapes: meshes, forms, groups and their instances. Knows no BSDF from the inside.

use super::{DEEPEST, MOST_VISITS, Material, MitsubaReader, Plugin, textures::Role};
use crate::scene_files::{
    build::{chained, even, mirrors},
    meshes,
};
use tauflow_data::{
    geom::{compose, cross, length, scaling, sub, translation, unit},
    mesh::Mesh,
    scene::{Affine, Bsdf, Geometry, IDENTITY, Shape, Texture},
};

/// The form of a shape.
struct Form {
    geometry: Geometry,
    /// Into the shape's own space.
    local: Affine,
    /// True if a shape's transform that mirrors turns its normals round.
    turns: bool,
}

impl<'t> MitsubaReader<'t, '_, '_> {
    /// Adds a shape that stands in a space that `above` maps into the world.
    pub(super) fn shape(&mut self, plugin: &'t Plugin, above: &Affine, depth: usize) {
        self.visits[1] += 1;
        if depth > DEEPEST || self.visits[1] > MOST_VISITS[1] {
            return self.build.problems.error(
                &plugin.at,
                "shapes in shapes without end, or too many of them",
                "take some out",
            );
        }
        match plugin.sort.as_str() {
            // Seen through its instances alone.
            "shapegroup" if depth == 0 => return,
            "shapegroup" | "merge" => {
                for (_, inner) in self.inside(plugin, "shape") {
                    self.shape(inner, above, depth + 1);
                }
                return self.finish(plugin);
            }
            "instance" if depth > 0 => {
                let what = "an instance in a group is not supported";
                self.build.problems.error(&plugin.at, what, "put it into the scene");
                return plugin.properties.iter().for_each(|p| p.used.set(true));
            }
            "instance" => {
                let map = chained(above, &self.placed(plugin));
                let groups = self.inside(plugin, "shape");
                if groups.len() != 1 || groups[0].1.sort != "shapegroup" {
                    self.build.problems.error(&plugin.at, "an instance of no group", "refer to one `shapegroup`");
                }
                for (_, group) in groups {
                    self.shape(group, &map, depth + 1);
                }
                return self.finish(plugin);
            }
            _ => {}
        }
        let own = self.placed(plugin);
        let map = chained(above, &own);
        let emission = self.emission(plugin);
        let material = self.shape_material(plugin, emission.is_some());
        let mut reads = material.as_ref().map_or([None, None], |m| m.reads.clone());
        if let Some((_, Some(name))) = &emission
            && reads[0].get_or_insert_with(|| name.clone()) != name
        {
            let what = "emission and material by two attributes of vertices are not supported";
            self.build.problems.error(&plugin.at, what, "use one for both");
        }
        let made = self.geometry(plugin, &reads, &own);
        let flip_normals = self.flag(plugin, "flip_normals", false);
        self.finish(plugin);
        let (Some(Form { geometry, local, turns }), Some(material)) = (made, material) else { return };
        // In Mitsuba, a mirroring map turns a shape inside out, unless it has normals.
        let flip_normals = flip_normals != (turns && mirrors(&own));
        let to_world = chained(&map, &local);
        if matches!(geometry, Geometry::Sphere { .. }) && !even(&to_world) {
            let what = "a sphere that is scaled unevenly is not supported";
            self.build.problems.error(&plugin.at, what, "use a mesh in its place");
        }
        let emission = match emission {
            Some((Some(texture), _)) => Some(texture),
            Some((None, _)) => return,
            None => None,
        };
        let mut shape = Shape { geometry, to_world, material: material.index, emission, flip_normals };
        if !self.own {
            shape.material = self.build.mapped_as_mitsuba(&shape);
        }
        self.build.shape(shape, &plugin.at);
    }

    /// The radiance of a shape that is an emitter, and the attribute of vertices that it reads.
    fn emission(&mut self, plugin: &'t Plugin) -> Option<(Option<Texture>, Option<String>)> {
        let inside = self.inside(plugin, "emitter");
        let (_, first) = *inside.first()?;
        if inside.len() > 1 || first.sort != "area" {
            self.unsupported(first, "use one `area` emitter");
            return Some((None, None));
        }
        self.reads = [None, None];
        let radiance = match self.find(first, "radiance") {
            Some(property) => self.texture(property, Role::Light),
            None => Some(Texture::scalar(1.0)),
        };
        self.pass_over(first, &["sampling_weight"]);
        self.finish(first);
        let [name, _] = std::mem::take(&mut self.reads);
        Some((radiance, name))
    }

    fn shape_material(&mut self, plugin: &'t Plugin, shines: bool) -> Option<Material> {
        let inside = self.inside(plugin, "bsdf");
        if inside.len() > 1 {
            self.build.problems.error(&plugin.at, "a shape with several BSDFs", "leave one");
        }
        match inside.first() {
            Some((number, _)) => self.material(*number),
            None => {
                // As in Mitsuba: what shines reflects nothing if it is not said.
                let reflectance = Texture::scalar(if shines { 0.0 } else { 0.5 });
                Some(Material { index: self.build.material(Bsdf::Diffuse { reflectance }), reads: [None, None] })
            }
        }
    }

    /// The form of a shape that its own transform puts where `map` says.
    fn geometry(&mut self, plugin: &'t Plugin, reads: &[Option<String>; 2], map: &Affine) -> Option<Form> {
        let own = |geometry, turns| Some(Form { geometry, local: IDENTITY, turns });
        let sort = plugin.sort.as_str();
        if !matches!(sort, "obj" | "ply" | "serialized") && reads.iter().any(Option::is_some) {
            self.build.problems.error(&plugin.at, "vertex attributes on what is no mesh file", "use a PLY file");
        }
        match sort {
            "rectangle" => own(Geometry::Rectangle, false),
            "cube" => own(Geometry::Cube, false),
            "disk" => own(Geometry::Disk, false),
            "sphere" => {
                let center = self.vector(plugin, "center").unwrap_or([0.0; 3]);
                let radius = self.number(plugin, "radius").unwrap_or(1.0);
                own(Geometry::Sphere { center, radius }, true)
            }
            "cylinder" => {
                let p0 = self.vector(plugin, "p0").unwrap_or([0.0; 3]);
                let p1 = self.vector(plugin, "p1").unwrap_or([0.0, 0.0, 1.0]);
                let radius = self.number(plugin, "radius").unwrap_or(1.0);
                let axis = sub(p1, p0);
                let (n, size) = (unit(axis), length(axis));
                if !(size > 0.0 && radius > 0.0) {
                    self.build.problems.error(&plugin.at, "a cylinder without length or radius", "give it both");
                    return None;
                }
                self.build.problems.note(&plugin.at, "a cylinder is tessellated into 512 strips");
                let s = unit(cross(if n[0].abs() > 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] }, n));
                let t = cross(n, s);
                let turn = [0, 1, 2].map(|r: usize| [s[r], t[r], n[r], 0.0]);
                let local = compose(&translation(p0), &compose(&turn, &scaling([radius, radius, size])));
                let make = |_: &mut _| Some(meshes::cylinder(1.0, [0.0, 1.0], 2.0 * core::f64::consts::PI));
                let geometry = self.build.mesh("cylinder", &plugin.at, make)?;
                Some(Form { geometry, local, turns: false })
            }
            "obj" | "ply" | "serialized" => self.file(plugin, sort, reads, map),
            _ => {
                self.unsupported(plugin, "export it as a mesh");
                // Its arguments are unused.
                plugin.properties.iter().for_each(|p| p.used.set(true));
                None
            }
        }
    }

    fn file(&mut self, plugin: &'t Plugin, sort: &str, reads: &[Option<String>; 2], map: &Affine) -> Option<Form> {
        let flat = self.flag(plugin, "face_normals", false);
        let turned = self.flag(plugin, "flip_tex_coords", sort == "obj");
        let index = self.number(plugin, "shape_index").unwrap_or(0.0).max(0.0) as usize;
        let Some(path) = self.text(plugin, "filename") else {
            self.build.problems.error(&plugin.at, "a mesh without `filename`", "name its file");
            return None;
        };
        let at = &plugin.at;
        // Normals that are made are those of the mesh where it stands.
        let stands = if flat || even(map) { IDENTITY } else { *map };
        let key = format!("{sort}\n{path}\n{index}\n{flat}\n{turned}\n{reads:?}\n{stands:?}");
        let geometry = self.build.mesh(&key, at, |build| {
            let read = build.read_mesh(path, sort, index, at)?;
            let mut mesh = read.mesh.clone();
            if flat {
                mesh.normals = None;
            }
            if mesh.normals.is_none() {
                build.bare.insert(key.clone());
            }
            if !flat && mesh.normals.is_none() {
                meshes::smooth(&mut mesh, &stands);
            }
            if turned {
                mesh.uvs.iter_mut().flatten().for_each(|uv| uv[1] = 1.0 - uv[1]);
            }
            let count = mesh.positions.len();
            let mut attribute = |name: &Option<String>| -> Option<Option<Vec<[f32; 3]>>> {
                let Some(name) = name else { return Some(None) };
                let found = read.attributes.get(name).filter(|a| a.len() == count).cloned();
                if found.is_none() {
                    let what = format!("`{path}` has no attribute `{name}`");
                    build.problems.error(at, what, "write it into the file as r, g and b");
                }
                found.map(Some)
            };
            let (colors, numbers) = (attribute(&reads[0])?, attribute(&reads[1])?);
            paint(&mut mesh, colors.as_deref(), numbers.as_deref());
            Some(mesh)
        })?;
        Some(Form { geometry, local: IDENTITY, turns: self.build.bare.contains(&key) })
    }
}

/// Puts attributes into vertex colours: the first as colours, the luminance of the second as alpha.
fn paint(mesh: &mut Mesh, colors: Option<&[[f32; 3]]>, numbers: Option<&[[f32; 3]]>) {
    if colors.is_none() && numbers.is_none() {
        return;
    }
    let number = |n: [f32; 3]| {
        let grey = n[0] == n[1] && n[1] == n[2];
        if grey { n[0] } else { crate::scene_files::spectra::luminance(n.map(f64::from)) as f32 }
    };
    let color = |i: usize| {
        let [r, g, b] = colors.map_or([1.0; 3], |c| c[i]);
        [r, g, b, numbers.map_or(1.0, |n| number(n[i]))]
    };
    mesh.colors = Some((0..mesh.positions.len()).map(color).collect());
}
