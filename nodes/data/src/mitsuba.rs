//! Writes a scene as Mitsuba 3 reads it, so that both can render the same expectation. Knows no renderer of our own.
//!
//! The folder gets `scene.xml`, meshes as PLY and images as EXR. Radiance is exported as it is; the exposure factor is
//! applied to images afterwards, on both sides alike.

mod ply;

use crate::{
    Image,
    image_io::write_exr,
    mesh::Mesh,
    scene::{Affine, Bsdf, DELTA_ALPHA, Emitter, Geometry, Rgb, Scene, Shape, Texture},
};
use ply::ply;
use std::{collections::BTreeSet, fmt::Write as _, fs, path::Path};
use tauflow_contract::{Digest, KindError};

/// Film and sampling of an exported scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Film {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples a pixel.
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
    /// What textures make of vertex colours; every mesh gets all of them.
    tints: Vec<Tint>,
}

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
    let mut writer = Writer { dir, load, xml: String::new(), indent: 0, written: BTreeSet::new(), tints: Vec::new() };
    writer.open("<scene version=\"3.0.0\">");
    writer.open("<integrator type=\"path\">");
    writer.line(&format!("<integer name=\"max_depth\" value=\"{}\"/>", scene.max_depth));
    writer.close("</integrator>");
    writer.sensor(scene, film);
    for (index, material) in scene.materials.iter().enumerate() {
        writer.bsdf(material, &format!(" id=\"material-{index}\""))?;
    }
    // Meshes are written with all that reads their colours.
    scene.shapes.iter().filter_map(|shape| shape.emission.as_ref()).for_each(|emission| {
        writer.tint(emission);
    });
    for (index, shape) in scene.shapes.iter().enumerate() {
        writer.shape(index, shape)?;
    }
    for emitter in &scene.emitters {
        writer.emitter(emitter)?;
    }
    writer.close("</scene>");
    fs::write(dir.join("scene.xml"), &writer.xml).map_err(io)
}

/// A texture without constant factors: those of products go into the other factor.
fn simplified(texture: &Texture) -> Texture {
    let Texture::Product { a, b } = texture else { return texture.clone() };
    let times = |scale: &Rgb, by: &Rgb| [0, 1, 2].map(|c| scale[c] * by[c]);
    match (simplified(a), simplified(b)) {
        (Texture::Constant { value }, other) | (other, Texture::Constant { value }) => match other {
            Texture::Constant { value: other } => Texture::Constant { value: times(&other, &value) },
            Texture::Checkerboard { color0, color1, scale } => {
                Texture::Checkerboard { color0: times(&color0, &value), color1: times(&color1, &value), scale }
            }
            Texture::Bitmap { image, uv, scale, channel, clamp } => {
                Texture::Bitmap { image, uv, scale: times(&scale, &value), channel, clamp }
            }
            Texture::VertexColor { scale, channel } => Texture::VertexColor { scale: times(&scale, &value), channel },
            product @ Texture::Product { .. } => {
                Texture::Product { a: Box::new(Texture::Constant { value }), b: Box::new(product) }
            }
        },
        (a, b) => Texture::Product { a: Box::new(a), b: Box::new(b) },
    }
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

    fn sensor(&mut self, scene: &Scene, film: Film) {
        let camera = &scene.camera;
        self.open("<sensor type=\"perspective\">");
        self.line("<string name=\"fov_axis\" value=\"x\"/>");
        self.float("fov", camera.fov_x);
        self.float("near_clip", camera.near);
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
    }

    /// The index of what a texture makes of vertex colours, if that is what it is.
    fn tint(&mut self, texture: &Texture) -> Option<usize> {
        let Texture::VertexColor { scale, channel } = simplified(texture) else { return None };
        let tint = Tint { scale, channel };
        Some(self.tints.iter().position(|other| *other == tint).unwrap_or_else(|| {
            self.tints.push(tint);
            self.tints.len() - 1
        }))
    }

    /// Writes an image, once; `bend` is what the first two components of the normals that it encodes are scaled by.
    fn image(
        &mut self,
        digest: &Digest,
        scale: &Rgb,
        channel: Option<u8>,
        bend: Option<f32>,
    ) -> Result<String, KindError> {
        let mut name = format!("image-{}", digest.short());
        if *scale != [1.0; 3] {
            let _ = write!(name, "-x{:08x}{:08x}{:08x}", scale[0].to_bits(), scale[1].to_bits(), scale[2].to_bits());
        }
        if let Some(channel) = channel {
            let _ = write!(name, "-c{channel}");
        }
        if let Some(bend) = bend {
            let _ = write!(name, "-n{:08x}", bend.to_bits());
        }
        name.push_str(".exr");
        if self.written.insert(name.clone()) {
            let image = Image::from_bytes(&(self.load)(digest)?)?;
            let count = image.channels();
            let read = |pixel: &[f32], c: usize| match (channel, count) {
                (Some(channel), 1) if channel < 3 => pixel[0],
                (Some(channel), _) => pixel.get(usize::from(channel)).copied().unwrap_or(1.0),
                (None, 1) => pixel[0],
                (None, _) => pixel[c],
            };
            // Of values that are looked up between texels, too: this is linear.
            let bent = |value: f32, c: usize| match bend {
                Some(bend) if c < 2 => bend * value + 0.5 * (1.0 - bend),
                _ => value,
            };
            let data = image
                .data()
                .chunks_exact(count)
                .flat_map(|pixel| [0, 1, 2].map(|c| bent(read(pixel, c) * scale[c], c)))
                .collect();
            let image = Image::from_data(image.width(), image.height(), 3, data)?;
            write_exr(&self.dir.join(&name), &[("", &image)])?;
        }
        Ok(name)
    }

    /// A texture in the role `name`; scalars are exported as the mean of equal channels, which is exact.
    fn texture(&mut self, name: &str, texture: &Texture, scalar: bool) -> Result<(), KindError> {
        let texture = &simplified(texture);
        match texture {
            Texture::Constant { value } if scalar => self.float(name, value[0]),
            Texture::Constant { value } => self.line(&format!("<rgb name=\"{name}\" value=\"{}\"/>", rgb(value))),
            Texture::Checkerboard { color0, color1, scale } => {
                self.open(&format!("<texture type=\"checkerboard\" name=\"{name}\">"));
                self.line(&format!("<rgb name=\"color0\" value=\"{}\"/>", rgb(color0)));
                self.line(&format!("<rgb name=\"color1\" value=\"{}\"/>", rgb(color1)));
                self.open("<transform name=\"to_uv\">");
                self.line(&format!("<scale x=\"{:?}\" y=\"{:?}\"/>", 0.5 * scale[0], 0.5 * scale[1]));
                self.close("</transform>");
                self.close("</texture>");
            }
            Texture::Bitmap { image, uv, scale, channel, clamp } => {
                let file = self.image(image, scale, *channel, None)?;
                self.bitmap(name, &file, uv, *clamp);
            }
            Texture::VertexColor { .. } => {
                let index = self.tint(texture).unwrap_or_default();
                self.open(&format!("<texture type=\"mesh_attribute\" name=\"{name}\">"));
                self.line(&format!("<string name=\"name\" value=\"vertex_c{index}_color\"/>"));
                self.close("</texture>");
            }
            Texture::Product { .. } => {
                return Err(KindError::Input(format!(
                    "`{name}` is a product of textures, which Mitsuba's plugins do not express; \
                     export a scene without it"
                )));
            }
        }
        Ok(())
    }

    fn bitmap(&mut self, name: &str, file: &str, [a, b]: &[[f64; 3]; 2], clamp: bool) {
        self.open(&format!("<texture type=\"bitmap\" name=\"{name}\">"));
        self.line(&format!("<string name=\"filename\" value=\"{file}\"/>"));
        self.line("<boolean name=\"raw\" value=\"true\"/>");
        self.line(&format!("<string name=\"wrap_mode\" value=\"{}\"/>", if clamp { "clamp" } else { "repeat" }));
        self.open("<transform name=\"to_uv\">");
        // Of nine numbers Mitsuba takes the third column for z, and an offset would be lost.
        let [a, b] = [a, b].map(|row| format!("{:?} {:?} 0 {:?}", row[0], row[1], row[2]));
        self.line(&format!("<matrix value=\"{a} {b} 0 0 1 0 0 0 0 1\"/>"));
        self.close("</transform>");
        self.close("</texture>");
    }

    fn bsdf(&mut self, bsdf: &Bsdf, id: &str) -> Result<(), KindError> {
        match bsdf {
            Bsdf::Diffuse { reflectance } => {
                self.open(&format!("<bsdf type=\"diffuse\"{id}>"));
                self.texture("reflectance", reflectance, false)?;
            }
            Bsdf::Conductor { eta, k, alpha, specular_reflectance } => {
                self.open(&format!("<bsdf type=\"{}\"{id}>", rough("conductor", *alpha)));
                self.ggx(*alpha);
                self.line(&format!("<rgb name=\"eta\" value=\"{}\"/>", rgb(eta)));
                self.line(&format!("<rgb name=\"k\" value=\"{}\"/>", rgb(k)));
                self.texture("specular_reflectance", specular_reflectance, false)?;
            }
            Bsdf::Dielectric { int_ior, ext_ior, alpha, specular_reflectance, specular_transmittance } => {
                self.open(&format!("<bsdf type=\"{}\"{id}>", rough("dielectric", *alpha)));
                self.ggx(*alpha);
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
                self.open(&format!("<bsdf type=\"{}\"{id}>", rough("plastic", *alpha)));
                self.ggx(*alpha);
                self.interface(*int_ior, *ext_ior);
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
                // What both factors let through, one after the other.
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
                // Our renderer has neither.
                self.line("<boolean name=\"use_shadowing_function\" value=\"false\"/>");
                self.line("<boolean name=\"flip_invalid_normals\" value=\"false\"/>");
                match simplified(map) {
                    Texture::Bitmap { image, uv, scale: factor, channel, clamp } if *scale != 1.0 => {
                        let file = self.image(&image, &factor, channel, Some(*scale))?;
                        self.bitmap("normalmap", &file, &uv, clamp);
                    }
                    map => self.texture("normalmap", &map, false)?,
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

    fn ggx(&mut self, alpha: f32) {
        if alpha >= DELTA_ALPHA {
            self.line("<string name=\"distribution\" value=\"ggx\"/>");
            self.float("alpha", alpha);
        }
    }

    fn interface(&mut self, int_ior: f32, ext_ior: f32) {
        self.float("int_ior", int_ior);
        self.float("ext_ior", ext_ior);
    }

    fn shape(&mut self, index: usize, shape: &Shape) -> Result<(), KindError> {
        match &shape.geometry {
            Geometry::Mesh { mesh } => {
                let mesh = Mesh::from_bytes(&(self.load)(mesh)?)?;
                let file = format!("mesh-{index:04}.ply");
                fs::write(self.dir.join(&file), ply(&mesh, &self.tints))
                    .map_err(|e| KindError::Environment(format!("cannot write {file}: {e}")))?;
                self.open("<shape type=\"ply\">");
                self.line(&format!("<string name=\"filename\" value=\"{file}\"/>"));
                if mesh.normals.is_none() {
                    self.line("<boolean name=\"face_normals\" value=\"true\"/>");
                }
            }
            Geometry::Sphere { center, radius } => {
                self.open("<shape type=\"sphere\">");
                self.line(&format!("<point name=\"center\" value=\"{}\"/>", point(center)));
                self.float("radius", *radius);
            }
            Geometry::Rectangle => self.open("<shape type=\"rectangle\">"),
            Geometry::Disk => self.open("<shape type=\"disk\">"),
            Geometry::Cube => self.open("<shape type=\"cube\">"),
        }
        self.transform(&shape.to_world);
        if shape.flip_normals {
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

fn rough(name: &str, alpha: f32) -> String {
    if alpha >= DELTA_ALPHA { format!("rough{name}") } else { name.to_owned() }
}

#[cfg(test)]
mod tests;
