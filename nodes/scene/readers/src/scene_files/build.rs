//! A scene in the making: shapes, materials, emitters and the checks that all file formats share.

mod files;
mod views;

pub use views::{UNMIRROR, camera, chained, even, fov_x, mirror, mirrors};

use super::{
    given::Given,
    ply::Read,
    problems::{Place, Problems},
};
use crate::assets::{Allowance, BlobSet};
use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};
use tauflow_contract::Digest;
use tauflow_data::{
    geom::{Aabb, apply, cross, determinant, dot, length, sub, unit},
    scene::{Bsdf, Camera, Emitter, Geometry, Scene, Shape, Texture},
};

/// Bytes of mesh files that are held as they were read.
const MOST_READ: usize = 1 << 26;

/// Longest path where a file asks for no end: roulette ends them long before.
pub const ENDLESS: u32 = 65_535;

/// How the texels of a picture are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channels {
    /// Red, green and blue.
    Colors,
    /// One number: luminance. Pictures that are grey stay as they are.
    Luminance,
    /// One number, as pbrt takes it: alpha beside colours if it is not 1 everywhere, otherwise the mean.
    Number,
}

/// The range of a picture's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Bound {
    /// From 0 to 1.
    Share,
    /// From 0.
    Positive,
}

/// A scene in the making.
pub struct Builder<'a> {
    given: &'a Given<'a>,
    /// Problems so far.
    pub problems: Problems,
    /// Meshes and images.
    pub blobs: BlobSet,
    /// The shapes.
    pub shapes: Vec<Shape>,
    /// The materials, each once.
    pub materials: Vec<Bsdf>,
    /// Those of them that have a digest in common; almost always one.
    numbers: BTreeMap<Digest, Vec<usize>>,
    /// The emitters.
    pub emitters: Vec<Emitter>,
    /// Whether the camera does not see them.
    pub hide_emitters: bool,
    /// Keys of the meshes whose files give them no normals, or whose normals are not to be used.
    pub bare: BTreeSet<String>,
    pictures: BTreeMap<(String, bool, Channels), Option<(Digest, f32)>>,
    meshes: BTreeMap<String, Option<Digest>>,
    /// Mesh files as they were read, for shapes that need them in another way.
    read: BTreeMap<(String, usize), Rc<Read>>,
    /// Mesh files that could not be read, which was told.
    damaged: BTreeSet<String>,
    /// Bytes that these may still take.
    room: usize,
    left: Allowance,
    /// True once the file has used up what it may cost: nothing more is made.
    spent: bool,
    /// Materials as Mitsuba maps their normals, for those that were asked for.
    mapped: BTreeMap<usize, usize>,
    /// Whether texture coordinates of a mesh turn as its triangles do, and whether they turn the other way.
    turns: BTreeMap<Digest, [bool; 2]>,
    /// Triangles and boxes of the meshes, and the triangles that are shown.
    sizes: BTreeMap<Digest, (usize, Aabb)>,
    triangles: usize,
}

impl<'a> Builder<'a> {
    /// Nothing yet.
    pub fn new(given: &'a Given<'a>, problems: Problems) -> Self {
        let bytes = match given {
            Given::Parts(parts) => parts.values().map(Vec::len).sum(),
            Given::Disk { .. } => 0,
        };
        Self {
            given,
            problems,
            blobs: BlobSet::default(),
            shapes: Vec::new(),
            materials: Vec::new(),
            numbers: BTreeMap::new(),
            emitters: Vec::new(),
            hide_emitters: false,
            bare: BTreeSet::new(),
            pictures: BTreeMap::new(),
            meshes: BTreeMap::new(),
            read: BTreeMap::new(),
            damaged: BTreeSet::new(),
            room: MOST_READ,
            left: Allowance::of(bytes),
            spent: false,
            mapped: BTreeMap::new(),
            turns: BTreeMap::new(),
            sizes: BTreeMap::new(),
            triangles: 0,
        }
    }

    /// The bytes of a file of the scene.
    pub fn bytes(&mut self, path: &str, at: &Place) -> Option<Vec<u8>> {
        self.given.read(path, at, &mut self.problems)
    }

    /// The index of a material, which is added if it is new.
    pub fn material(&mut self, bsdf: Bsdf) -> usize {
        let digest = Digest::of(&serde_json::to_vec(&bsdf).unwrap_or_default());
        let same = self.numbers.entry(digest).or_default();
        if let Some(number) = same.iter().find(|number| self.materials[**number] == bsdf) {
            return *number;
        }
        same.push(self.materials.len());
        self.materials.push(bsdf);
        self.materials.len() - 1
    }

    /// A share of 0 to 1, such as a reflectance; what is beyond is told.
    pub fn share(&mut self, value: [f64; 3], what: &str, at: &Place) -> [f32; 3] {
        if !value.iter().all(|v| (0.0..=1.0).contains(v)) {
            self.problems.error(at, format!("`{what}` is {value:?}"), "use values from 0 to 1");
        }
        value.map(|v| v as f32)
    }

    /// Light; what is negative or not finite is told.
    pub fn light(&mut self, value: [f64; 3], what: &str, at: &Place) -> [f32; 3] {
        if !value.iter().all(|v| *v >= 0.0 && (*v as f32).is_finite()) {
            self.problems.error(at, format!("`{what}` is {value:?}"), "use finite values from 0");
        }
        value.map(|v| v as f32)
    }

    /// Tells of an index of refraction that no surface has.
    pub fn check_index(&mut self, inside: f32, outside: f32, at: &Place) {
        let ratio = inside / outside;
        if !(inside > 0.0 && outside > 0.0 && (0.05..=20.0).contains(&ratio)) {
            let what = format!("indices of refraction {inside} inside and {outside} outside");
            self.problems.error(at, what, "use indices such as 1.5 and 1, whose ratio is between 0.05 and 20");
        }
    }

    /// GGX's alpha, from 0 to 1; what is beyond is told.
    pub fn check_alpha(&mut self, alpha: f64, at: &Place) -> f32 {
        if !(0.0..=1.0).contains(&alpha) {
            self.problems.error(at, format!("a roughness of {alpha}"), "use a number from 0 to 1");
        }
        alpha.clamp(0.0, 1.0) as f32
    }

    /// A blend of two materials; opacity and mapped normals inside of it are told.
    pub fn blend(&mut self, weight: Texture, a: Bsdf, b: Bsdf, at: &Place) -> Bsdf {
        self.check_blend(&a, &b, at);
        Bsdf::Blend { weight, a: Box::new(a), b: Box::new(b) }
    }

    /// Tells of opacity and mapped normals in a blend of two materials.
    pub fn check_blend(&mut self, a: &Bsdf, b: &Bsdf, at: &Place) {
        let outer = |bsdf: &Bsdf| matches!(bsdf, Bsdf::Mask { .. } | Bsdf::NormalMap { .. } | Bsdf::Relief { .. });
        if holds(a, outer) || holds(b, outer) {
            let what = "a blend of materials with opacity or a normal map of their own is not supported";
            self.problems.error(at, what, "put these around the blend");
        }
    }

    /// Adds a shape; what stands nowhere is told.
    pub fn shape(&mut self, shape: Shape, at: &Place) {
        let map = &shape.to_world;
        let column = |c: usize| [0, 1, 2].map(|r: usize| map[r][c]);
        let fits = |v: f64| v.is_finite() && (v as f32).is_finite();
        let wrong = match &shape.geometry {
            _ if !map.iter().flatten().all(|v| fits(*v)) => {
                Some("a transform of numbers that are not finite".to_owned())
            }
            Geometry::Sphere { radius, center } => {
                let world = radius * length(column(0));
                let bad = !(world as f32 > 0.0 && fits(world) && center.iter().all(|v| fits(*v)));
                bad.then(|| format!("a sphere of radius {radius}, which is {world} in the world"))
            }
            Geometry::Disk => {
                let area = length(cross(column(0), column(1)));
                (area as f32 <= 0.0 || !fits(area)).then(|| "a disk without area".to_owned())
            }
            Geometry::Rectangle | Geometry::Cube | Geometry::Mesh { .. } => None,
        };
        if let Some(what) = wrong {
            self.problems.error(at, what, "give it a size above 0 and a transform that keeps one");
        }
        self.shapes.push(shape);
    }

    /// How far the scene reaches along the view of a camera, at most.
    pub fn reach(&self, camera: &Camera) -> f64 {
        let forward = unit(sub(camera.target, camera.origin));
        let box_of = |geometry: &Geometry| match geometry {
            Geometry::Sphere { center, radius } => Aabb::around(*center, [radius.abs(); 3]),
            Geometry::Mesh { mesh } => self.sizes.get(mesh).map_or(Aabb::EMPTY, |size| size.1),
            Geometry::Disk | Geometry::Rectangle => Aabb::around([0.0; 3], [1.0, 1.0, 0.0]),
            Geometry::Cube => Aabb::around([0.0; 3], [1.0; 3]),
        };
        let corners = |shape: &Shape| {
            let local = box_of(&shape.geometry);
            let map = shape.to_world;
            (0..8).map(move |corner: usize| {
                let pick = |i: usize| if corner >> i & 1 == 0 { local.low[i] } else { local.high[i] };
                apply(&map, [pick(0), pick(1), pick(2)])
            })
        };
        let depths = self.shapes.iter().flat_map(corners).map(|p| dot(sub(p, camera.origin), forward));
        depths.filter(|depth| depth.is_finite()).fold(0.0, f64::max)
    }

    /// Adds an emitter; what gives no light that can be rendered is told.
    pub fn emitter(&mut self, emitter: Emitter, at: &Place) {
        let around = |e: &Emitter| matches!(e, Emitter::Constant { .. } | Emitter::Envmap { .. });
        if around(&emitter) && self.emitters.iter().any(around) {
            self.problems.error(at, "a second environment", "keep one of them");
        }
        let finite = |values: &[f64]| values.iter().all(|v| v.is_finite() && (*v as f32).is_finite());
        let placed = match &emitter {
            Emitter::Constant { .. } => true,
            Emitter::Envmap { to_world, .. } => finite(to_world.as_flattened()) && determinant(to_world) != 0.0,
            Emitter::Point { position, .. } => finite(position),
            Emitter::Spot { to_world, cutoff_angle, beam_width, .. } => {
                let forward = length([0, 1, 2].map(|r: usize| to_world[r][2]));
                if !(*cutoff_angle > 0.0 && *cutoff_angle <= 180.0 && (0.0..=*cutoff_angle).contains(beam_width)) {
                    let what = format!("a spot of {cutoff_angle} degrees that falls from {beam_width} degrees on");
                    self.problems.error(at, what, "use angles of up to 180 degrees, the inner one the smaller");
                }
                finite(to_world.as_flattened()) && forward > 0.0
            }
            Emitter::Directional { direction, .. } => finite(direction) && length(*direction) > 0.0,
        };
        if !placed {
            let what = "an emitter whose transform or direction leads nowhere";
            self.problems.error(at, what, "give it finite numbers and a direction");
        }
        self.emitters.push(emitter);
    }

    /// Tells of a camera that looks nowhere.
    pub fn check_camera(&mut self, camera: &Camera, at: &Place) {
        let forward = sub(camera.target, camera.origin);
        let side = cross(forward, camera.up);
        let seen = |v: f64| v > 0.0 && (v as f32).is_finite() && v as f32 > 0.0;
        let finite = camera.origin.iter().all(|v| (*v as f32).is_finite());
        if !(finite && seen(dot(forward, forward)) && seen(dot(side, side))) {
            let what = "a camera whose transform leaves it no view";
            self.problems.error(at, what, "give it a direction, and an up that is not along it");
        }
        let near = camera.near as f32;
        if !(near >= 0.0 && near.is_finite()) {
            self.problems.error(at, format!("a camera that sees from {} on", camera.near), "use a distance from 0");
        }
    }

    /// The scene, if it has what a picture takes.
    pub fn finish(
        mut self,
        camera: Option<Camera>,
        max_depth: u32,
        seed: u64,
        file: &str,
    ) -> (Scene, BlobSet, Problems) {
        let at = Place::file(file);
        if camera.is_none() && self.problems.is_fine() {
            self.problems.error(&at, "there is no camera", "add one to the scene");
        }
        if self.emitters.is_empty() && self.shapes.iter().all(|s| s.emission.is_none()) && self.problems.is_fine() {
            self.problems.error(&at, "nothing in it gives light", "add an emitter");
        }
        let nowhere = Camera { origin: [0.0; 3], target: [0.0, 0.0, 1.0], up: [0.0, 1.0, 0.0], fov_x: 90.0, near: 0.0 };
        let scene = Scene {
            version: 1,
            seed,
            camera: camera.unwrap_or(nowhere),
            max_depth,
            shapes: self.shapes,
            materials: self.materials,
            emitters: self.emitters,
            hide_emitters: self.hide_emitters,
        };
        (scene, self.blobs, self.problems)
    }
}

/// True for a material that `is` of a kind, or has such a one inside.
pub fn holds(bsdf: &Bsdf, is: fn(&Bsdf) -> bool) -> bool {
    is(bsdf)
        || match bsdf {
            Bsdf::Mask { inner, .. }
            | Bsdf::TwoSided { inner }
            | Bsdf::NormalMap { inner, .. }
            | Bsdf::Relief { inner, .. }
            | Bsdf::Finish { inner, .. } => holds(inner, is),
            Bsdf::Blend { a, b, .. } => holds(a, is) || holds(b, is),
            _ => false,
        }
}

/// The product of a texture and a colour.
pub fn scaled(texture: Texture, by: [f32; 3]) -> Texture {
    let times = |a: [f32; 3]| [a[0] * by[0], a[1] * by[1], a[2] * by[2]];
    if by == [1.0; 3] {
        return texture;
    }
    match texture {
        Texture::Constant { value } => Texture::Constant { value: times(value) },
        Texture::Checkerboard { color0, color1, scale } => {
            Texture::Checkerboard { color0: times(color0), color1: times(color1), scale }
        }
        Texture::Bitmap { image, uv, scale, channel, clamp } => {
            Texture::Bitmap { image, uv, scale: times(scale), channel, clamp }
        }
        Texture::VertexColor { scale, channel } => Texture::VertexColor { scale: times(scale), channel },
        product @ Texture::Product { .. } => Texture::Product { a: Box::new(product), b: Box::new(Texture::rgb(by)) },
    }
}
