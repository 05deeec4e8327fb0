//! Writes a scene as Mitsuba 3 reads it, so that both can render the same expectation. Knows no renderer of our own.
//!
//! The folder gets `scene.xml`, meshes as PLY and images as EXR. Radiance is exported as it is; the exposure factor is
//! applied to images afterwards, on both sides alike.

mod ply;
mod textures;

use crate::{
    mesh::Mesh,
    scene::{
        Affine, Bsdf, Camera, DELTA_ALPHA, Distribution, Emitter, Geometry, ReliefForm, Rgb, Scene, Shape, Texture,
    },
};
use ply::ply;
use std::{collections::BTreeSet, fmt::Write as _, fs, path::Path};
use tauflow_contract::{Digest, KindError};
use textures::simplified;

/// Film and sampling of an exported scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Film {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples per pixel.
    pub spp: u64,
}

/// Vertex colours as a texture reads them.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Tint {
    scale: Rgb,
    /// One channel, or all three colours.
    channel: Option<u8>,
}

struct Writer<'a> {
    dir: &'a Path,
    load: &'a mut dyn FnMut(&Digest) -> Result<Vec<u8>, KindError>,
    xml: String,
    indent: usize,
    written: BTreeSet<String>,
    /// Vertex colours modified by textures; every mesh gets all of them.
    tints: Vec<Tint>,
    /// The largest depth of a point in front of the camera.
    reach: f64,
}

/// Mitsuba's own `far_clip`. Cameras see nothing beyond it.
const FAR: f64 = 1e4;

/// Writes `scene.xml` and what it names into `dir`, which is made if it is absent.
///
/// # Errors
/// If a blob is missing or damaged, the folder cannot be written, or a material has no counterpart in Mitsuba.
pub fn export(
    scene: &Scene,
    load: &mut dyn FnMut(&Digest) -> Result<Vec<u8>, KindError>,
    dir: &Path,
    film: Film,
) -> Result<(), KindError> {
    let io = |source| KindError::Environment(format!("cannot write {}: {source}", dir.display()));
    fs::create_dir_all(dir).map_err(io)?;
    let mut writer =
        Writer { dir, load, xml: String::new(), indent: 0, written: BTreeSet::new(), tints: Vec::new(), reach: 0.0 };
    writer.line(OWN);
    writer.open("<scene version=\"3.0.0\">");
    // Passages through what is not opaque are no part of a path's length here. Those that `path` meets are.
    let integrator = if scene.materials.iter().any(has_opacity) { "volpath" } else { "path" };
    writer.open(&format!("<integrator type=\"{integrator}\">"));
    writer.line(&format!("<integer name=\"max_depth\" value=\"{}\"/>", scene.max_depth));
    if scene.hide_emitters {
        writer.line("<boolean name=\"hide_emitters\" value=\"true\"/>");
    }
    writer.close("</integrator>");
    let clip = writer.sensor(scene, film);
    for (index, material) in scene.materials.iter().enumerate() {
        writer.bsdf(material, &format!(" id=\"material-{index}\""))?;
    }
    // Meshes are written with all that reads their colours.
    scene.shapes.iter().filter_map(|shape| shape.emission.as_ref()).for_each(|emission| {
        writer.tint(emission);
    });
    for (index, shape) in scene.shapes.iter().enumerate() {
        writer.shape(index, shape, &scene.camera)?;
    }
    for emitter in &scene.emitters {
        writer.emitter(emitter)?;
    }
    writer.close("</scene>");
    if writer.reach >= FAR {
        let far = format!("    <float name=\"far_clip\" value=\"{:?}\"/>\n", 2.0 * writer.reach);
        writer.xml.insert_str(clip, &far);
    }
    fs::write(dir.join("scene.xml"), &writer.xml).map_err(io)
}

/// Whether an export may write a file of this name.
pub fn writes(name: &str) -> bool {
    let is = |start: &str, end: &str| name.starts_with(start) && name.ends_with(end);
    name == "scene.xml" || is("mesh-", ".ply") || is("image-", ".exr")
}

/// The first line of exported scenes. In their normal maps t is upwards in the image, even where Mitsuba has it
/// downwards, which a reader must know to get the same scene back.
pub const OWN: &str = "<!-- tauflow export: t of normal maps is upwards in the image -->";

fn has_opacity(bsdf: &Bsdf) -> bool {
    match bsdf {
        Bsdf::Mask { .. } => true,
        Bsdf::TwoSided { inner } | Bsdf::NormalMap { inner, .. } | Bsdf::Relief { inner, .. } => has_opacity(inner),
        Bsdf::Blend { a, b, .. } => has_opacity(a) || has_opacity(b),
        _ => false,
    }
}

/// True for a map that turns left into right.
fn mirrors(map: &Affine) -> bool {
    let [a, b, c] = map.map(|row| [row[0], row[1], row[2]]);
    let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
    a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2] < 0.0
}

/// Corners of the box around a mesh.
fn extent(mesh: &Mesh) -> [[f64; 3]; 2] {
    let empty = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    mesh.positions.iter().fold(empty, |[low, high], at| {
        let at = at.map(f64::from);
        let of = |i: usize| (low[i].min(at[i]), high[i].max(at[i]));
        [[of(0).0, of(1).0, of(2).0], [of(0).1, of(1).1, of(2).1]]
    })
}

/// The largest depth of a box in front of a camera, or 0.
fn depth(box_of: &[[f64; 3]; 2], map: &Affine, camera: &Camera) -> f64 {
    let forward = [0, 1, 2].map(|i: usize| camera.target[i] - camera.origin[i]);
    let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let length = dot(&forward, &forward).sqrt();
    let depth = |corner: usize| {
        let local = [0, 1, 2].map(|i: usize| box_of[corner >> i & 1][i]);
        let at = map.map(|row| dot(&[row[0], row[1], row[2]], &local) + row[3]);
        dot(&[0, 1, 2].map(|i: usize| at[i] - camera.origin[i]), &forward) / length
    };
    (0..8).map(depth).filter(|depth| depth.is_finite()).fold(0.0, f64::max)
}

fn rgb(value: &Rgb) -> String {
    format!("{:?}, {:?}, {:?}", value[0], value[1], value[2])
}

fn point(value: &[f64; 3]) -> String {
    format!("{:?}, {:?}, {:?}", value[0], value[1], value[2])
}

impl Writer<'_> {
    fn line(&mut self, text: &str) {
        let _ = writeln!(self.xml, "{:1$}{text}", "", 2 * self.indent);
    }

    fn open(&mut self, text: &str) {
        self.line(text);
        self.indent += 1;
    }

    fn close(&mut self, text: &str) {
        self.indent -= 1;
        self.line(text);
    }

    fn float(&mut self, name: &str, value: impl Into<f64>) {
        self.line(&format!("<float name=\"{name}\" value=\"{:?}\"/>", value.into()));
    }

    fn transform(&mut self, matrix: &Affine) {
        let mut values: Vec<String> = matrix.iter().flatten().map(|v| format!("{v:?}")).collect();
        values.extend(["0", "0", "0", "1"].map(str::to_owned));
        self.open("<transform name=\"to_world\">");
        self.line(&format!("<matrix value=\"{}\"/>", values.join(" ")));
        self.close("</transform>");
    }

    /// The place where `far_clip` goes.
    fn sensor(&mut self, scene: &Scene, film: Film) -> usize {
        let camera = &scene.camera;
        self.open("<sensor type=\"perspective\">");
        self.line("<string name=\"fov_axis\" value=\"x\"/>");
        self.float("fov", camera.fov_x);
        self.float("near_clip", camera.near);
        let clip = self.xml.len();
        self.open("<transform name=\"to_world\">");
        self.line(&format!(
            "<lookat origin=\"{}\" target=\"{}\" up=\"{}\"/>",
            point(&camera.origin),
            point(&camera.target),
            point(&camera.up)
        ));
        self.close("</transform>");
        self.open("<sampler type=\"independent\">");
        self.line(&format!("<integer name=\"sample_count\" value=\"{}\"/>", film.spp));
        self.close("</sampler>");
        self.open("<film type=\"hdrfilm\">");
        self.line(&format!("<integer name=\"width\" value=\"{}\"/>", film.width));
        self.line(&format!("<integer name=\"height\" value=\"{}\"/>", film.height));
        self.line("<string name=\"component_format\" value=\"float32\"/>");
        self.line("<rfilter type=\"box\"/>");
        self.close("</film>");
        self.close("</sensor>");
        clip
    }

    fn bsdf(&mut self, bsdf: &Bsdf, id: &str) -> Result<(), KindError> {
        self.finished(bsdf, id, &Finish::default())
    }

    /// A BSDF in a finish.
    fn finished(&mut self, bsdf: &Bsdf, id: &str, finish: &Finish<'_>) -> Result<(), KindError> {
        match bsdf {
            Bsdf::Finish { distribution, alpha, alpha_v, nonlinear, inner } => {
                let (beckmann, nonlinear) = (*distribution == Distribution::Beckmann, *nonlinear);
                let (alpha, alpha_v) = (alpha.as_ref(), alpha_v.as_ref());
                return self.finished(inner, id, &Finish { beckmann, alpha, alpha_v, nonlinear });
            }
            Bsdf::Diffuse { reflectance } => {
                self.open(&format!("<bsdf type=\"diffuse\"{id}>"));
                self.texture("reflectance", reflectance, false)?;
            }
            Bsdf::Conductor { eta, k, alpha, specular_reflectance } => {
                self.open(&format!("<bsdf type=\"{}\"{id}>", finish.sort("conductor", *alpha)));
                self.facets(*alpha, finish)?;
                self.line(&format!("<rgb name=\"eta\" value=\"{}\"/>", rgb(eta)));
                self.line(&format!("<rgb name=\"k\" value=\"{}\"/>", rgb(k)));
                self.texture("specular_reflectance", specular_reflectance, false)?;
            }
            Bsdf::Dielectric { int_ior, ext_ior, alpha, specular_reflectance, specular_transmittance } => {
                self.open(&format!("<bsdf type=\"{}\"{id}>", finish.sort("dielectric", *alpha)));
                self.facets(*alpha, finish)?;
                self.interface(*int_ior, *ext_ior);
                self.texture("specular_reflectance", specular_reflectance, false)?;
                self.texture("specular_transmittance", specular_transmittance, false)?;
            }
            Bsdf::ThinDielectric { int_ior, ext_ior, specular_reflectance, specular_transmittance } => {
                self.open(&format!("<bsdf type=\"thindielectric\"{id}>"));
                self.interface(*int_ior, *ext_ior);
                self.texture("specular_reflectance", specular_reflectance, false)?;
                self.texture("specular_transmittance", specular_transmittance, false)?;
            }
            Bsdf::Plastic { diffuse_reflectance, int_ior, ext_ior, alpha } => {
                self.open(&format!("<bsdf type=\"{}\"{id}>", finish.sort("plastic", *alpha)));
                self.facets(*alpha, finish)?;
                self.interface(*int_ior, *ext_ior);
                if finish.nonlinear {
                    self.line("<boolean name=\"nonlinear\" value=\"true\"/>");
                }
                self.texture("diffuse_reflectance", diffuse_reflectance, false)?;
            }
            Bsdf::Principled { base_color, metallic, roughness, specular, spec_trans, clearcoat, clearcoat_gloss } => {
                self.open(&format!("<bsdf type=\"principled\"{id}>"));
                self.texture("base_color", base_color, false)?;
                self.texture("metallic", metallic, true)?;
                self.texture("roughness", roughness, true)?;
                self.float("specular", *specular);
                self.texture("spec_trans", spec_trans, true)?;
                self.float("clearcoat", *clearcoat);
                self.float("clearcoat_gloss", *clearcoat_gloss);
            }
            Bsdf::Mask { opacity, inner } => {
                // The product of both opacities.
                if let Texture::Product { a, b } = simplified(opacity) {
                    let inner = Bsdf::Mask { opacity: *b, inner: inner.clone() };
                    return self.bsdf(&Bsdf::Mask { opacity: *a, inner: Box::new(inner) }, id);
                }
                self.open(&format!("<bsdf type=\"mask\"{id}>"));
                self.texture("opacity", opacity, true)?;
                self.bsdf(inner, "")?;
            }
            Bsdf::Blend { weight, a, b } => {
                self.open(&format!("<bsdf type=\"blendbsdf\"{id}>"));
                self.texture("weight", weight, true)?;
                self.bsdf(a, "")?;
                self.bsdf(b, "")?;
            }
            Bsdf::NormalMap { map, scale, inner } => {
                self.open(&format!("<bsdf type=\"normalmap\"{id}>"));
                // Both are on by default: a shadowing term that darkens slopes, and slopes turned towards the viewer.
                self.line("<boolean name=\"use_shadowing_function\" value=\"false\"/>");
                self.line("<boolean name=\"flip_invalid_normals\" value=\"false\"/>");
                self.normals(map, *scale)?;
                self.bsdf(inner, "")?;
            }
            Bsdf::Relief { form, map, scale, flip, shadowing, inner } => {
                let sort = if *form == ReliefForm::Normals { "normalmap" } else { "bumpmap" };
                self.open(&format!("<bsdf type=\"{sort}\"{id}>"));
                self.line(&format!("<boolean name=\"use_shadowing_function\" value=\"{shadowing}\"/>"));
                self.line(&format!("<boolean name=\"flip_invalid_normals\" value=\"{flip}\"/>"));
                match form {
                    ReliefForm::Normals => self.normals(map, *scale)?,
                    ReliefForm::Heights => {
                        self.float("scale", *scale);
                        self.texture("map", map, true)?;
                    }
                }
                self.bsdf(inner, "")?;
            }
            Bsdf::TwoSided { inner } => {
                self.open(&format!("<bsdf type=\"twosided\"{id}>"));
                self.bsdf(inner, "")?;
            }
        }
        self.close("</bsdf>");
        Ok(())
    }

    /// The roughness of a rough surface.
    fn facets(&mut self, alpha: f32, finish: &Finish<'_>) -> Result<(), KindError> {
        if alpha < DELTA_ALPHA && finish.alpha.is_none() {
            return Ok(());
        }
        let name = if finish.beckmann { "beckmann" } else { "ggx" };
        self.line(&format!("<string name=\"distribution\" value=\"{name}\"/>"));
        match (finish.alpha, finish.alpha_v) {
            (Some(along), Some(across)) => {
                self.texture("alpha_u", along, true)?;
                self.texture("alpha_v", across, true)?;
            }
            (Some(texture), None) => self.texture("alpha", texture, true)?,
            _ => self.float("alpha", alpha),
        }
        Ok(())
    }

    fn interface(&mut self, int_ior: f32, ext_ior: f32) {
        self.float("int_ior", int_ior);
        self.float("ext_ior", ext_ior);
    }

    fn shape(&mut self, index: usize, shape: &Shape, camera: &Camera) -> Result<(), KindError> {
        // In Mitsuba, a mirroring map turns meshes without normals inside out.
        let mut turns = false;
        let mut box_of = [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]];
        match &shape.geometry {
            Geometry::Mesh { mesh } => {
                let mesh = Mesh::from_bytes(&(self.load)(mesh)?)?;
                let file = format!("mesh-{index:04}.ply");
                box_of = extent(&mesh);
                fs::write(self.dir.join(&file), ply(&mesh, &self.tints))
                    .map_err(|e| KindError::Environment(format!("cannot write {file}: {e}")))?;
                self.open("<shape type=\"ply\">");
                self.line(&format!("<string name=\"filename\" value=\"{file}\"/>"));
                if mesh.normals.is_none() {
                    self.line("<boolean name=\"face_normals\" value=\"true\"/>");
                    turns = true;
                }
            }
            Geometry::Sphere { center, radius } => {
                self.open("<shape type=\"sphere\">");
                self.line(&format!("<point name=\"center\" value=\"{}\"/>", point(center)));
                self.float("radius", *radius);
                turns = true;
                box_of = [-radius.abs(), radius.abs()].map(|r| center.map(|c| c + r));
            }
            Geometry::Rectangle => self.open("<shape type=\"rectangle\">"),
            Geometry::Disk => self.open("<shape type=\"disk\">"),
            Geometry::Cube => {
                self.open("<shape type=\"cube\">");
                box_of = [[-1.0; 3], [1.0; 3]];
            }
        }
        self.reach = self.reach.max(depth(&box_of, &shape.to_world, camera));
        self.transform(&shape.to_world);
        if shape.flip_normals != (turns && mirrors(&shape.to_world)) {
            self.line("<boolean name=\"flip_normals\" value=\"true\"/>");
        }
        self.line(&format!("<ref id=\"material-{}\"/>", shape.material));
        if let Some(emission) = &shape.emission {
            self.open("<emitter type=\"area\">");
            self.texture("radiance", emission, false)?;
            self.close("</emitter>");
        }
        self.close("</shape>");
        Ok(())
    }

    fn emitter(&mut self, emitter: &Emitter) -> Result<(), KindError> {
        match emitter {
            Emitter::Constant { radiance } => {
                self.open("<emitter type=\"constant\">");
                self.line(&format!("<rgb name=\"radiance\" value=\"{}\"/>", rgb(radiance)));
            }
            Emitter::Envmap { image, scale, to_world } => {
                let file = self.image(image, &[1.0; 3], None, None)?;
                self.open("<emitter type=\"envmap\">");
                self.line(&format!("<string name=\"filename\" value=\"{file}\"/>"));
                self.float("scale", *scale);
                self.transform(to_world);
            }
            Emitter::Point { position, intensity } => {
                self.open("<emitter type=\"point\">");
                self.line(&format!("<point name=\"position\" value=\"{}\"/>", point(position)));
                self.line(&format!("<rgb name=\"intensity\" value=\"{}\"/>", rgb(intensity)));
            }
            Emitter::Spot { to_world, intensity, cutoff_angle, beam_width } => {
                self.open("<emitter type=\"spot\">");
                self.transform(to_world);
                self.line(&format!("<rgb name=\"intensity\" value=\"{}\"/>", rgb(intensity)));
                self.float("cutoff_angle", *cutoff_angle);
                self.float("beam_width", *beam_width);
            }
            Emitter::Directional { direction, irradiance } => {
                self.open("<emitter type=\"directional\">");
                self.line(&format!("<vector name=\"direction\" value=\"{}\"/>", point(direction)));
                self.line(&format!("<rgb name=\"irradiance\" value=\"{}\"/>", rgb(irradiance)));
            }
        }
        self.close("</emitter>");
        Ok(())
    }
}

/// What a [`Bsdf::Finish`] says.
#[derive(Clone, Copy, Default)]
struct Finish<'a> {
    beckmann: bool,
    alpha: Option<&'a Texture>,
    alpha_v: Option<&'a Texture>,
    nonlinear: bool,
}

impl Finish<'_> {
    /// The plugin of a surface.
    fn sort(&self, name: &str, alpha: f32) -> String {
        if alpha >= DELTA_ALPHA || self.alpha.is_some() { format!("rough{name}") } else { name.to_owned() }
    }
}

#[cfg(test)]
mod tests;
