//! A scene in the making: blobs, pictures, meshes, materials, and the checks that all file formats share.

use super::{
    given::{Given, normalised},
    meshes,
    ply::Read,
    problems::{Place, Problems},
    spectra,
};
use crate::assets::{Allowance, BlobSet, Refusal, damaged, ending, picture, radiance};
use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};
use tauflow_contract::Digest;
use tauflow_data::{
    Image,
    geom::{Aabb, apply, compose, cross, determinant, dot, length, sub, unit},
    mesh::Mesh,
    scene::{Affine, Bsdf, Camera, Emitter, Geometry, IDENTITY, ReliefForm, Scene, Shape, Texture},
};

/// Most triangles that all shapes show together, each instance counted.
const MOST_TRIANGLES: usize = 1 << 26;

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
    /// One number: the mean.
    Mean,
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
        let outer = |bsdf: &Bsdf| matches!(bsdf, Bsdf::Mask { .. } | Bsdf::NormalMap { .. } | Bsdf::Relief { .. });
        if holds(&a, outer) || holds(&b, outer) {
            let what = "a blend of materials with opacity or a normal map of their own is not supported";
            self.problems.error(at, what, "put these around the blend");
        }
        Bsdf::Blend { weight, a: Box::new(a), b: Box::new(b) }
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
        if self.spent {
            return None;
        }
        let bytes = self.bytes(path, at)?;
        let read = match ending(path).as_str() {
            "exr" | "hdr" | "rgbe" | "pic" => radiance(path, &bytes)
                .and_then(|image| self.left.read("picture", image.width() * image.height()).map(|()| image)),
            _ => picture(&bytes, "picture", raw, &mut self.left),
        };
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
        let image = self.image(path, raw, at)?;
        let image = match channels {
            Channels::Colors => image,
            _ if image.data().chunks_exact(3).all(|t| t[0] == t[1] && t[1] == t[2]) => image,
            _ => {
                let one = |t: &[f32]| {
                    let [r, g, b] = [t[0], t[1], t[2]].map(f64::from);
                    match channels {
                        Channels::Mean => ((r + g + b) / 3.0) as f32,
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
        let bsdf = &self.materials[shape.material];
        if !(if turned { against } else { along }) || !holds(bsdf, |b| matches!(b, Bsdf::NormalMap { .. })) {
            return shape.material;
        }
        let mut bsdf = bsdf.clone();
        plain_relief(&mut bsdf);
        self.material(bsdf)
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
            "obj" => meshes::obj(&bytes),
            "serialized" => meshes::serialized(&bytes, index),
            _ => super::ply::read(&bytes).and_then(meshes::checked),
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

/// `a` after `b`, to the bit where one of them does nothing: a product would turn -0 into 0.
pub fn chained(a: &Affine, b: &Affine) -> Affine {
    if *a == IDENTITY {
        *b
    } else if *b == IDENTITY {
        *a
    } else {
        compose(a, b)
    }
}

/// A camera looks along `to_world`'s +z with +y up; its picture's right is its -x, as in a right-handed space.
pub fn camera(to_world: &Affine, fov_x: f64, near: f64) -> Camera {
    let column = |c: usize| [0, 1, 2].map(|r: usize| to_world[r][c]);
    let (origin, forward) = (column(3), column(2));
    Camera { origin, target: tauflow_data::geom::add(origin, forward), up: column(1), fov_x, near }
}

/// Turns left into right in all of a scene but its camera, which was mirrored: its picture is that of a plain camera in
/// the mirrored scene.
pub fn mirror(builder: &mut Builder<'_>, camera: &mut Camera) {
    const LEFT: Affine = [[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    let flip = |v: &mut [f64; 3]| v[0] = -v[0];
    for shape in &mut builder.shapes {
        shape.to_world = compose(&LEFT, &shape.to_world);
    }
    for emitter in &mut builder.emitters {
        match emitter {
            Emitter::Constant { .. } => {}
            Emitter::Envmap { to_world, .. } | Emitter::Spot { to_world, .. } => *to_world = compose(&LEFT, to_world),
            Emitter::Point { position, .. } => flip(position),
            Emitter::Directional { direction, .. } => flip(direction),
        }
    }
    [&mut camera.origin, &mut camera.target, &mut camera.up].into_iter().for_each(flip);
    if builder.materials.iter().any(|bsdf| holds(bsdf, maps_normals)) {
        let at = Place::file("scene");
        builder.problems.approximated(
            &at,
            "a mirrored camera with normal maps, whose green is then upside down",
            "take the mirroring scale out of the camera's transform",
        );
    }
}

/// True for a camera or a shape whose transform mirrors.
pub fn mirrors(map: &Affine) -> bool {
    determinant(map) < 0.0
}

/// True for a map that scales evenly, which leaves a sphere a sphere.
pub fn even(map: &Affine) -> bool {
    let column = |c: usize| [0, 1, 2].map(|r: usize| map[r][c]);
    let axes = [column(0), column(1), column(2)];
    let scale = length(axes[0]);
    let pairs = [(0, 1), (1, 2), (2, 0)];
    axes.iter().all(|a| (length(*a) - scale).abs() <= 1e-6 * scale)
        && pairs.iter().all(|(a, b): &(usize, usize)| dot(axes[*a], axes[*b]).abs() <= 1e-6 * scale * scale)
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

/// True for a normal map, whose tangent frame has a handedness.
fn maps_normals(bsdf: &Bsdf) -> bool {
    matches!(bsdf, Bsdf::NormalMap { .. } | Bsdf::Relief { form: ReliefForm::Normals, .. })
}

/// Field of view along x of one that is given along another axis of a film.
///
/// `axis` is `x`, `y`, `diagonal`, `smaller` or `larger`; none for another word.
pub fn fov_x(degrees: f64, axis: &str, [width, height]: [u32; 2]) -> Option<f64> {
    use tauflow_data::maths::{atan, tan};
    let aspect = f64::from(width) / f64::from(height);
    let half = tan(degrees.to_radians() * 0.5);
    let along = |slope: f64| 2.0 * atan(slope).to_degrees();
    let y = || along(half * aspect);
    Some(match axis {
        "x" => degrees,
        "y" => y(),
        "diagonal" => along(half / (1.0 + 1.0 / (aspect * aspect)).sqrt()),
        "smaller" if aspect > 1.0 => y(),
        "larger" if aspect < 1.0 => y(),
        "smaller" | "larger" => degrees,
        _ => return None,
    })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_view_are_those_of_mitsuba() {
        // From Mitsuba 3.9.1: 40 degrees along each axis of a film of 200 x 100.
        for (axis, degrees) in
            [("x", 40.0), ("y", 72.10477), ("diagonal", 36.06479), ("smaller", 72.10477), ("larger", 40.0)]
        {
            let found = fov_x(40.0, axis, [200, 100]).expect("an axis");
            assert!((found - degrees).abs() < 1e-4, "{axis}: {found}");
        }
        assert_eq!(fov_x(40.0, "z", [1, 1]), None);
        // The same of a lens of 35 mm: `focal_length`.
        let diagonal = 2.0 * tauflow_data::maths::atan((36.0f64 * 36.0 + 24.0 * 24.0).sqrt() / 70.0).to_degrees();
        assert!((fov_x(diagonal, "diagonal", [200, 100]).expect("an axis") - 57.871_193).abs() < 1e-4);
    }
}
