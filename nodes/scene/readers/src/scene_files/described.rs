//! Our own `scene.json`: what it names, and the checks that other formats have in their readers.

use super::{
    Loaded,
    build::Builder,
    files,
    given::Given,
    problems::{Place, Problems},
};
use std::collections::BTreeMap;
use tauflow_contract::{Digest, KindError};
use tauflow_data::{
    Image,
    mesh::Mesh,
    records::SceneRecord,
    scene::{Bsdf, Emitter, Geometry, Scene, Texture},
};

/// Most shapes and materials.
const MOST: usize = 1 << 20;

const REMEDY: &str = "mend it, or export the scene again";

/// Reads a scene and its blobs.
pub(super) fn read(name: &str, bytes: &[u8], given: &Given<'_>, mut problems: Problems) -> Result<Loaded, KindError> {
    let at = Place::file(name);
    let scene: Scene = serde_json::from_slice(bytes).map_err(|e| {
        let line = u32::try_from(e.line()).unwrap_or(0);
        problems.error(&Place { file: name.into(), line }, format!("no scene: {e}"), REMEDY);
        problems.finish().expect_err("an error was told")
    })?;
    let mut build = Builder::new(given, Problems::default());
    let mut blobs = BTreeMap::new();
    for digest in scene.blobs() {
        let path = files::blob(&digest);
        let Some(bytes) = build.bytes(&path, &at) else { continue };
        if Digest::of(&bytes) != digest {
            let what = format!("`{path}` does not hold what its name says");
            build.problems.error(&at, what, "export the scene again");
        }
        blobs.insert(digest, bytes);
    }
    let size = |mesh: &Digest| blobs.get(mesh).and_then(|bytes| Mesh::triangles_in(bytes).ok());
    check(&scene, &size, &mut build, &at);
    for (digest, is_mesh) in sorts(&scene) {
        let Some(bytes) = blobs.get(&digest) else { continue };
        let wrong = if is_mesh { Mesh::from_bytes(bytes).err() } else { Image::from_bytes(bytes).err() };
        if let Some(error) = wrong {
            build.problems.error(&at, format!("`{}`: {error}", files::blob(&digest)), "export the scene again");
        }
    }
    let (_, _, problems) = build.finish(Some(scene.camera.clone()), scene.max_depth, 0, name);
    let recipe = given.get(SceneRecord::RECIPE_FILE).and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let notes = problems.finish()?;
    Ok(Loaded { scene, blobs, notes, film: None, framed: false, lit: false, files: Vec::new(), recipe })
}

/// Checks what a scene says, without its blobs.
///
/// # Errors
/// All that is wrong with it, a line each.
pub fn check_scene(name: &str, scene: &Scene) -> Result<(), KindError> {
    let parts = BTreeMap::new();
    let given = Given::Parts(&parts);
    let mut build = Builder::new(&given, Problems::default());
    check(scene, &|_| None, &mut build, &Place::file(name));
    let (_, _, problems) = build.finish(Some(scene.camera.clone()), scene.max_depth, 0, name);
    problems.finish().map(|_| ())
}

/// The blobs of a scene, and whether each is a mesh. One that is named as both is looked at as both.
fn sorts(scene: &Scene) -> Vec<(Digest, bool)> {
    let mut images = Vec::new();
    scene.materials.iter().for_each(|material| material.images(&mut images));
    scene.shapes.iter().filter_map(|shape| shape.emission.as_ref()).for_each(|texture| texture.images(&mut images));
    images.extend(scene.emitters.iter().filter_map(|emitter| match emitter {
        Emitter::Envmap { image, .. } => Some(*image),
        _ => None,
    }));
    let meshes = scene.shapes.iter().filter_map(|shape| match shape.geometry {
        Geometry::Mesh { mesh } => Some((mesh, true)),
        _ => None,
    });
    let mut all: Vec<(Digest, bool)> = images.into_iter().map(|image| (image, false)).chain(meshes).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Tells what of a scene is wrong; `size` says the triangles of a mesh, if they are known.
fn check(scene: &Scene, size: &dyn Fn(&Digest) -> Option<usize>, build: &mut Builder<'_>, at: &Place) {
    if scene.version != 1 {
        build.problems.error(at, format!("version {} of the format", scene.version), "this program reads version 1");
    }
    if scene.shapes.len() > MOST || scene.materials.len() > MOST {
        let what = format!("more than {MOST} shapes or materials");
        return build.problems.error(at, what, "simplify the scene");
    }
    let fov = scene.camera.fov_x;
    if !(fov > 0.0 && fov < 180.0) {
        build.problems.error(at, format!("a field of view of {fov} degrees"), "use an angle below 180");
    }
    build.check_camera(&scene.camera, at);
    for (index, material) in scene.materials.iter().enumerate() {
        let before = build.problems.is_fine();
        check_material(material, build, at);
        if before && !build.problems.is_fine() {
            // The first is enough to find it.
            build.problems.error(at, format!("material {index} is the first of these"), REMEDY);
        }
    }
    for (index, shape) in scene.shapes.iter().enumerate() {
        if shape.material >= scene.materials.len() {
            let what = format!("shape {index} has material {} of {}", shape.material, scene.materials.len());
            build.problems.error(at, what, REMEDY);
        }
        let triangles = match &shape.geometry {
            Geometry::Mesh { mesh } => size(mesh).unwrap_or(0),
            _ => 0,
        };
        if !build.shows(triangles, at) {
            return;
        }
        if let Some(texture) = &shape.emission {
            check_light(texture, build, at);
        }
        build.shape(shape.clone(), at);
    }
    for emitter in &scene.emitters {
        let light = match emitter {
            Emitter::Constant { radiance } => *radiance,
            Emitter::Envmap { scale, .. } => [*scale; 3],
            Emitter::Point { intensity, .. } | Emitter::Spot { intensity, .. } => *intensity,
            Emitter::Directional { irradiance, .. } => *irradiance,
        };
        build.light(light.map(f64::from), "light", at);
        build.emitter(emitter.clone(), at);
    }
}

fn check_light(texture: &Texture, build: &mut Builder<'_>, at: &Place) {
    match texture {
        Texture::Constant { value }
        | Texture::Bitmap { scale: value, .. }
        | Texture::VertexColor { scale: value, .. } => {
            build.light(value.map(f64::from), "emission", at);
        }
        Texture::Checkerboard { color0, color1, .. } => {
            for value in [color0, color1] {
                build.light(value.map(f64::from), "emission", at);
            }
        }
        Texture::Product { a, b } => {
            check_light(a, build, at);
            check_light(b, build, at);
        }
    }
}

fn check_material(material: &Bsdf, build: &mut Builder<'_>, at: &Place) {
    match material {
        Bsdf::Conductor { alpha, .. } => {
            build.check_alpha(f64::from(*alpha), at);
        }
        Bsdf::Dielectric { int_ior, ext_ior, alpha, .. } | Bsdf::Plastic { int_ior, ext_ior, alpha, .. } => {
            build.check_index(*int_ior, *ext_ior, at);
            build.check_alpha(f64::from(*alpha), at);
        }
        Bsdf::ThinDielectric { int_ior, ext_ior, .. } => build.check_index(*int_ior, *ext_ior, at),
        Bsdf::Diffuse { .. } | Bsdf::Principled { .. } => {}
        Bsdf::Blend { a, b, .. } => {
            build.check_blend(a, b, at);
            check_material(a, build, at);
            check_material(b, build, at);
        }
        Bsdf::Mask { inner, .. }
        | Bsdf::TwoSided { inner }
        | Bsdf::NormalMap { inner, .. }
        | Bsdf::Relief { inner, .. }
        | Bsdf::Finish { inner, .. } => check_material(inner, build, at),
    }
}
