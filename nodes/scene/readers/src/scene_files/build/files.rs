//! Pictures and meshes of a scene in the making: each file is read once, within what a scene may cost.

use super::{Bound, Builder, Channels, holds, mirrors};
use crate::{
    assets::{Refusal, alpha, damaged, ending, picture, radiance, radiance_alpha},
    scene_files::{given::normalised, meshes, obj, ply, ply::Read, problems::Place, spectra},
};
use std::rc::Rc;
use tauflow_contract::Digest;
use tauflow_data::{
    Image,
    geom::Aabb,
    mesh::Mesh,
    scene::{Bsdf, Geometry, ReliefForm, Shape},
};

/// Most triangles that all shapes show together, each instance counted.
const MOST_TRIANGLES: usize = 1 << 26;

impl Builder<'_> {
    /// The blob of a picture.
    pub fn picture(&mut self, path: &str, raw: bool, channels: Channels, bound: Bound, at: &Place) -> Option<Digest> {
        // A path may be spelt in many ways.
        let key = (normalised(path).unwrap_or_else(|| path.to_owned()), raw, channels);
        let made = match self.pictures.get(&key) {
            Some(made) => *made,
            None => {
                let made = self.read_picture(path, raw, channels, at);
                self.pictures.insert(key, made);
                made
            }
        };
        let (digest, most) = made?;
        if bound == Bound::Share && most > 1.0 + 1e-6 {
            self.problems.error(at, format!("`{path}` has values up to {most}"), "use values from 0 to 1");
        }
        Some(digest)
    }

    /// The values of a picture.
    pub fn image(&mut self, path: &str, raw: bool, at: &Place) -> Option<Image> {
        self.image_of(path, raw, Channels::Colors, at)
    }

    /// The values of a picture: its colours, or one channel if `channels` asks for a number that is one of them.
    fn image_of(&mut self, path: &str, raw: bool, channels: Channels, at: &Place) -> Option<Image> {
        if self.spent {
            return None;
        }
        let bytes = self.bytes(path, at)?;
        let is_radiance = matches!(ending(path).as_str(), "exr" | "hdr" | "rgbe" | "pic");
        let alone = match channels {
            Channels::Number if is_radiance => radiance_alpha(path, &bytes),
            Channels::Number => alpha(&bytes, "picture", raw, &mut self.left),
            _ => Ok(None),
        };
        let read = match alone {
            Ok(None) if is_radiance => radiance(path, &bytes),
            Ok(None) => picture(&bytes, "picture", raw, &mut self.left),
            Ok(Some(image)) => Ok(image),
            Err(refusal) => Err(refusal),
        };
        let read = read.and_then(|image| {
            let texels = if is_radiance { image.width() * image.height() } else { 0 };
            self.left.read("picture", texels).map(|()| image)
        });
        let sound = read.and_then(|image| {
            let bad = image.data().iter().filter(|v| !(v.is_finite() && **v >= 0.0)).count();
            if bad == 0 {
                Ok(image)
            } else {
                Err(damaged("texels", format!("{bad} values are negative or not finite")))
            }
        });
        sound.map_err(|refusal| self.problems.refuse(at, path, &refusal)).ok()
    }

    /// Whether a mesh of so many bytes can be made, which is held three times while it becomes a blob. If not, this is
    /// told.
    pub fn affords(&mut self, bytes: usize, at: &Place) -> bool {
        let most = bytes.saturating_mul(3);
        let asked = self.left.make("mesh", most);
        if asked.is_ok() {
            self.left.give_back(most);
        }
        self.affordable(asked, at)
    }

    /// Whether so many texels of a picture can be looked up; if not, this is told.
    pub fn looks_up(&mut self, texels: usize, at: &Place) -> bool {
        let asked = self.left.read("picture", texels);
        self.affordable(asked, at)
    }

    fn affordable(&mut self, asked: Result<(), Refusal>, at: &Place) -> bool {
        if let Err(refusal) = asked
            && !std::mem::replace(&mut self.spent, true)
        {
            self.problems.refuse(at, &at.file, &refusal);
        }
        !self.spent
    }

    fn read_picture(&mut self, path: &str, raw: bool, channels: Channels, at: &Place) -> Option<(Digest, f32)> {
        let image = self.image_of(path, raw, channels, at)?;
        let image = match channels {
            Channels::Colors => image,
            _ if image.channels() == 1 => image,
            _ if image.data().chunks_exact(3).all(|t| t[0] == t[1] && t[1] == t[2]) => image,
            _ => {
                let one = |t: &[f32]| {
                    let [r, g, b] = [t[0], t[1], t[2]].map(f64::from);
                    match channels {
                        Channels::Number => ((r + g + b) / 3.0) as f32,
                        _ => spectra::luminance([r, g, b]) as f32,
                    }
                };
                let data = image.data().chunks_exact(3).map(one).collect();
                Image::from_data(image.width(), image.height(), 1, data).ok()?
            }
        };
        let bytes = size_of_val(image.data());
        let asked = self.left.make("picture", bytes);
        if !self.affordable(asked, at) {
            return None;
        }
        let most = image.data().iter().copied().fold(0.0, f32::max);
        Some((self.blobs.add(image.to_bytes()), most))
    }

    /// The blob of a mesh that is made once for each `key`.
    pub fn mesh(&mut self, key: &str, at: &Place, make: impl FnOnce(&mut Self) -> Option<Mesh>) -> Option<Geometry> {
        let made = match self.meshes.get(key) {
            Some(made) => *made,
            None if self.spent => None,
            None => {
                let made = make(self).filter(|mesh| self.affords(meshes::bytes(mesh), at)).and_then(|mesh| {
                    let bytes = mesh.to_bytes().map_err(|e| self.problems.error(at, e.to_string(), "split the mesh"));
                    let bytes = bytes.ok()?;
                    let asked = self.left.make("mesh", bytes.len());
                    if !self.affordable(asked, at) {
                        return None;
                    }
                    let mut bounds = Aabb::EMPTY;
                    let finite = mesh.positions.iter().filter(|p| p.iter().all(|v| v.is_finite()));
                    finite.for_each(|p| bounds.grow(p.map(f64::from)));
                    let digest = self.blobs.add(bytes);
                    self.turns.insert(digest, turns(&mesh));
                    self.sizes.insert(digest, (mesh.triangles.len(), bounds));
                    Some(digest)
                });
                self.meshes.insert(key.to_owned(), made);
                made
            }
        };
        let geometry = Geometry::Mesh { mesh: made? };
        self.count(&geometry, at).then_some(geometry)
    }

    /// The material of a shape as Mitsuba has it: its normal maps have t = n x s, and ours have t upwards in the image.
    /// These are the same unless texture coordinates turn as triangles do.
    pub fn mapped_as_mitsuba(&mut self, shape: &Shape) -> usize {
        let Geometry::Mesh { mesh } = shape.geometry else { return shape.material };
        let [along, against] = self.turns.get(&mesh).copied().unwrap_or_default();
        let turned = shape.flip_normals != mirrors(&shape.to_world);
        if !(if turned { against } else { along }) {
            return shape.material;
        }
        // Once for each material: there may be a million shapes.
        if let Some(mapped) = self.mapped.get(&shape.material) {
            return *mapped;
        }
        let bsdf = &self.materials[shape.material];
        let mapped = if holds(bsdf, |b| matches!(b, Bsdf::NormalMap { .. })) {
            let mut bsdf = bsdf.clone();
            plain_relief(&mut bsdf);
            self.material(bsdf)
        } else {
            shape.material
        };
        self.mapped.insert(shape.material, mapped);
        mapped
    }

    /// Counts what is shown once more; false if it is too much.
    pub fn count(&mut self, geometry: &Geometry, at: &Place) -> bool {
        let triangles = match geometry {
            Geometry::Mesh { mesh } => self.sizes.get(mesh).map_or(0, |size| size.0),
            _ => 0,
        };
        self.shows(triangles, at)
    }

    /// Counts a shape of so many triangles; false if it is too much.
    pub fn shows(&mut self, triangles: usize, at: &Place) -> bool {
        self.triangles = self.triangles.saturating_add(triangles);
        if self.triangles > MOST_TRIANGLES {
            let what = format!("more than {MOST_TRIANGLES} triangles, instances counted");
            self.problems.error(&Place::file(&at.file), what, "simplify the scene");
        }
        self.triangles <= MOST_TRIANGLES
    }

    /// Reads a mesh's file by its ending; what is wrong is told.
    pub fn read_mesh(&mut self, path: &str, sort: &str, index: usize, at: &Place) -> Option<Rc<Read>> {
        let key = (normalised(path).unwrap_or_else(|| path.to_owned()), index);
        if let Some(read) = self.read.get(&key) {
            return Some(Rc::clone(read));
        }
        if self.spent || self.damaged.contains(&key.0) {
            return None;
        }
        let bytes = self.bytes(path, at)?;
        let read = match sort {
            "obj" => obj::read(&bytes),
            "serialized" => meshes::serialized(&bytes, index),
            _ => ply::read(&bytes).and_then(meshes::checked),
        };
        let read = match read {
            Ok(read) => Rc::new(read),
            Err(refusal) => {
                self.problems.refuse(at, path, &refusal);
                self.damaged.insert(key.0);
                return None;
            }
        };
        // What is unpacked again and again has been read again and again.
        let asked = self.left.read("mesh", read.cost);
        if !self.affordable(asked, at) {
            return None;
        }
        if let Some(note) = &read.note {
            self.problems.note(at, format!("`{path}`: {note}"));
        }
        let bad = read.mesh.positions.iter().filter(|p| !p.iter().all(|v| v.is_finite())).count();
        if bad > 0 {
            let what = format!("{bad} vertices of `{path}` are not finite, and their triangles are left out");
            self.problems.note(at, what);
        }
        let bytes = read.bytes();
        if bytes <= self.room {
            self.room -= bytes;
            self.read.insert(key, Rc::clone(&read));
        }
        Some(read)
    }
}

/// Turns normal maps into those of Mitsuba's plugin without its options.
fn plain_relief(bsdf: &mut Bsdf) {
    match bsdf {
        Bsdf::Mask { inner, .. } | Bsdf::TwoSided { inner } => plain_relief(inner),
        Bsdf::NormalMap { map, scale, inner } => {
            let (map, scale, inner) = (map.clone(), *scale, inner.clone());
            *bsdf = Bsdf::Relief { form: ReliefForm::Normals, map, scale, flip: false, shadowing: false, inner };
        }
        _ => {}
    }
}

/// Whether texture coordinates of some triangles turn as the triangles do, and those of some the other way.
fn turns(mesh: &Mesh) -> [bool; 2] {
    let Some(uvs) = &mesh.uvs else { return [false; 2] };
    let mut found = [false; 2];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| uvs[i as usize].map(f64::from));
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        found[0] |= area > 0.0;
        found[1] |= area < 0.0;
    }
    found
}
