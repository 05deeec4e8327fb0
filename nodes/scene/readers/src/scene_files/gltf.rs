//! glTF files as whole scenes: their meshes where they stand, their cameras, and `KHR_lights_punctual`.
//!
//! Sources: glTF 2.0, sections 3.5 and 3.10; `KHR_lights_punctual`, where point and spot lights are in candela and
//! directional ones in lux. Cameras and lights look along -z of their nodes.

use super::{
    build::{Builder, UNMIRROR, camera, fov_x, mirror, mirrors},
    given::Given,
    mitsuba::Said,
    problems::Place,
    setting::{Setting, View},
};
use crate::assets::{Document, Externals, Refusal, Surfaces, read_in_place, relative_path, uris};
use gltf::json::{Index, camera::Type, scene::Node, validation::Checked};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeSet;
use tauflow_data::{
    geom::{Vec3, apply, compose, length, unit},
    records::AssetReport,
    scene::{Affine, Camera, Emitter, Geometry, IDENTITY, Shape},
};

/// The conversion of a light's intensity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LightUnit {
    /// Candela and lux as they are, so that the image is in candela per square metre, as emissive surfaces are.
    #[default]
    Candela,
    /// Divided by 683 lumen per watt, so that they are in watts: for files of exporters that multiplied by it.
    Watt,
}

impl LightUnit {
    fn factor(self) -> f64 {
        match self {
            Self::Candela => 1.0,
            Self::Watt => 1.0 / 683.0,
        }
    }
}

/// Most texels along a side of a texture; larger ones are reduced.
const MOST_TEXELS: usize = 1 << 14;

const LIGHTS: &str = "KHR_lights_punctual";

/// The files that a scene names, by their paths.
pub fn names(bytes: &[u8]) -> BTreeSet<String> {
    uris(bytes).iter().filter_map(|uri| relative_path(uri)).collect()
}

/// How many cameras stand in the default scene; 0 for a file that cannot be read.
pub fn cameras(bytes: &[u8]) -> usize {
    // Buffers need not be there to count.
    let Ok(root) = Document::json(bytes) else { return 0 };
    placed(&root).map_or(0, |nodes| nodes.iter().filter(|(node, _)| node.camera.is_some()).count())
}

/// A node's own transform: its matrix, or scale, then rotation, then translation.
fn local(node: &Node) -> Affine {
    if let Some(m) = &node.matrix {
        let m = m.map(f64::from);
        return [0, 1, 2].map(|r: usize| [m[r], m[4 + r], m[8 + r], m[12 + r]]);
    }
    let t = node.translation.unwrap_or([0.0; 3]).map(f64::from);
    let s = node.scale.unwrap_or([1.0; 3]).map(f64::from);
    let [x, y, z, w] = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |q| q.0.map(f64::from));
    let n = x * x + y * y + z * z + w * w;
    let k = if n > 0.0 { 2.0 / n } else { 0.0 };
    let rows = [
        [1.0 - k * (y * y + z * z), k * (x * y - z * w), k * (x * z + y * w)],
        [k * (x * y + z * w), 1.0 - k * (x * x + z * z), k * (y * z - x * w)],
        [k * (x * z - y * w), k * (y * z + x * w), 1.0 - k * (x * x + y * y)],
    ];
    [0, 1, 2].map(|r: usize| [rows[r][0] * s[0], rows[r][1] * s[1], rows[r][2] * s[2], t[r]])
}

/// The nodes of the default scene with their maps into the world, parents first; none if they form no tree.
fn placed(root: &gltf::json::Root) -> Option<Vec<(&Node, Affine)>> {
    let roots: Vec<usize> = match root.scenes.get(root.scene.map_or(0, |s| s.value())) {
        Some(scene) => scene.nodes.iter().map(Index::value).collect(),
        None => {
            let children = root.nodes.iter().flat_map(|n| n.children.iter().flatten().map(Index::value));
            let children: BTreeSet<usize> = children.collect();
            (0..root.nodes.len()).filter(|n| !children.contains(n)).collect()
        }
    };
    let mut seen = vec![false; root.nodes.len()];
    let (mut out, mut stack) = (Vec::new(), roots.into_iter().rev().map(|n| (n, IDENTITY)).collect::<Vec<_>>());
    while let Some((number, above)) = stack.pop() {
        let node = root.nodes.get(number)?;
        if std::mem::replace(seen.get_mut(number)?, true) {
            return None;
        }
        let map = compose(&above, &local(node));
        out.push((node, map));
        stack.extend(node.children.iter().flatten().rev().map(|child| (child.value(), map)));
    }
    Some(out)
}

/// Looking along -z, +x to the right, as what looks along +z with +x to its left: directions without their scale.
fn turned(map: &Affine) -> Affine {
    let column = |c: usize| unit([0, 1, 2].map(|r: usize| map[r][c]));
    let (x, y, z) = (column(0), column(1), column(2));
    [0, 1, 2].map(|r: usize| [-x[r], y[r], -z[r], map[r][3]])
}

/// Reads a scene into `build`, as the setting's view sees it. A camera without an aspect ratio has that of the picture,
/// if it is known.
pub fn read(
    name: &str,
    bytes: &[u8],
    setting: &Setting,
    given: &Given<'_>,
    build: &mut Builder<'_>,
    unit: LightUnit,
) -> Said {
    let mut said = Said { camera: None, max_depth: super::build::ENDLESS, film: [512, 512], views: 1 };
    let at = Place::file(name);
    let mut externals = Externals::new();
    for path in names(bytes) {
        if let Some(bytes) = given.get(&path) {
            externals.insert(path, bytes);
        }
    }
    let document = match Document::open_anyway(bytes, &externals) {
        Ok((document, lacks)) => {
            lacks.iter().for_each(|refusal| build.problems.refuse(&at, name, refusal));
            document
        }
        Err(refusal) => {
            build.problems.refuse(&at, name, &refusal);
            return said;
        }
    };
    if document.is_animated() {
        build.problems.note(&at, "animations are left out: it stands in its default pose");
    }
    let root = &document.root;
    let Some(nodes) = placed(root) else {
        build.problems.error(&at, "its nodes form no tree", "export it again");
        return said;
    };
    let mut mirrored = false;
    said.views = nodes.iter().filter(|(node, _)| node.camera.is_some()).count();
    let (view, from_camera) = match setting.view {
        View::Camera(view) => (view, true),
        View::Fit => (0, false),
    };
    let seen = nodes.iter().filter_map(|(node, map)| Some((node.camera?.value(), map))).nth(view);
    if let Some((camera, map)) = seen {
        mirrored = mirrors(map);
        match view_of(root, camera, setting.aspect, map) {
            Ok((camera, film)) => {
                build.check_camera(&camera, &at);
                (said.camera, said.film) = (Some(camera), film);
            }
            Err(refusal) => build.problems.refuse(&at, name, &refusal),
        }
    }
    let eye = said.camera.as_ref().filter(|_| from_camera).map(|camera| camera.origin);
    meshes(name, &document, eye, build);
    let list = root.extensions.as_ref().and_then(|e| e.others.get(LIGHTS)?.get("lights")?.as_array());
    for (node, map) in &nodes {
        let light = node.extensions.as_ref().and_then(|e| e.others.get(LIGHTS)?.get("light")?.as_u64());
        let Some(light) = light else { continue };
        match list.and_then(|list| list.get(usize::try_from(light).ok()?)) {
            Some(light) => emitter(light, map, unit, &at, build),
            None => build.problems.error(&at, format!("there is no light {light}"), "export it again"),
        }
    }
    if mirrored && let Some(camera) = &mut said.camera {
        mirror(build, camera, &at, UNMIRROR);
    }
    said
}

/// Adds the surfaces of the default scene, which a camera at `eye` sees.
fn meshes(name: &str, document: &Document<'_>, eye: Option<Vec3>, build: &mut Builder<'_>) {
    let at = Place::file(name);
    let mut report = AssetReport::default();
    let read = read_in_place(document, eye, MOST_TEXELS, &mut build.blobs, &mut report);
    for note in report.notes {
        build.problems.approximated(&at, note, "export the scene without it");
    }
    for (what, count) in report.repairs {
        build.problems.note(&at, format!("{count} x {what}"));
    }
    let Surfaces { parts, materials } = match read {
        Ok(read) => read,
        Err(all) => return all.iter().for_each(|refusal| build.problems.refuse(&at, name, refusal)),
    };
    for (part, maps) in parts {
        let material = &materials[part.material];
        let index = build.material(material.own.clone());
        for to_world in maps {
            if !build.shows(part.triangles, &at) {
                return;
            }
            let shape = Shape {
                geometry: Geometry::Mesh { mesh: part.mesh },
                to_world,
                material: index,
                emission: material.emission.clone(),
                flip_normals: false,
            };
            build.shape(shape, &at);
        }
    }
}

/// A camera, and the pixels of its film.
type Lens = (Camera, [u32; 2]);

fn view_of(root: &gltf::json::Root, number: usize, aspect: Option<f64>, map: &Affine) -> Result<Lens, Refusal> {
    let place = || format!("camera {number}");
    let missing = || Refusal::new(place(), "it is not there, or has no field of view", "export it again");
    let source = root.cameras.get(number).ok_or_else(missing)?;
    if !matches!(source.type_, Checked::Valid(Type::Perspective)) {
        return Err(Refusal::new(place(), "orthographic cameras are not supported", "use a perspective one"));
    }
    let lens = source.perspective.as_ref().ok_or_else(missing)?;
    let aspect = lens.aspect_ratio.map(f64::from).or(aspect).unwrap_or(1.0);
    let film = [(512.0 * aspect).round().clamp(1.0, 16384.0) as u32, 512];
    let fov = fov_x(f64::from(lens.yfov).to_degrees(), "y", film).filter(|fov| *fov > 0.0 && *fov < 180.0);
    let made = camera(&turned(map), fov.ok_or_else(missing)?, f64::from(lens.znear));
    Ok((made, film))
}

fn emitter(light: &Value, map: &Affine, unit_of: LightUnit, at: &Place, build: &mut Builder<'_>) {
    let number = |object: &Value, name: &str, default: f64| object.get(name).and_then(Value::as_f64).unwrap_or(default);
    let color = light.get("color").and_then(Value::as_array);
    let color = [0, 1, 2].map(|c: usize| color.and_then(|list| list.get(c)?.as_f64()).unwrap_or(1.0));
    let strength = number(light, "intensity", 1.0) * unit_of.factor();
    let value = build.light(color.map(|c| c * strength), "intensity", at);
    let made = match light.get("type").and_then(Value::as_str) {
        Some("point") => Emitter::Point { position: apply(map, [0.0; 3]), intensity: value },
        Some("directional") => {
            let away = [0, 1, 2].map(|r: usize| -map[r][2]);
            if length(away) == 0.0 {
                return build.problems.error(at, "a light without a direction", "export it again");
            }
            Emitter::Directional { direction: unit(away), irradiance: value }
        }
        Some("spot") => {
            let cone = light.get("spot").unwrap_or(&Value::Null);
            let outer = number(cone, "outerConeAngle", core::f64::consts::FRAC_PI_4).to_degrees();
            let inner = number(cone, "innerConeAngle", 0.0).to_degrees();
            build.problems.note(at, "spot lights fall linearly with the angle between their two cones");
            Emitter::Spot { to_world: turned(map), intensity: value, cutoff_angle: outer, beam_width: inner.min(outer) }
        }
        other => {
            let what = format!("lights of type `{}` are not supported", other.unwrap_or("none"));
            return build.problems.error(at, what, "use point, spot or directional");
        }
    };
    if light.get("range").is_some() {
        build.problems.note(at, "the `range` of a light is left out: it only says where light no longer matters");
    }
    build.emitter(made, at);
}
