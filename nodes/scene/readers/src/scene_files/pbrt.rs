//! pbrt-v4 files as scenes: the state that directives change, and what stands in the world. Knows nothing of kinds.
//!
//! pbrt's space is left-handed: seen by its own camera, it is the mirror image of what a right-handed camera sees. The
//! scene is therefore mirrored, unless its camera's transform already mirrors it (`Scale -1 1 1`).

mod arguments;
mod lights;
mod materials;
mod shapes;
mod tokens;

use super::{
    build::{Builder, ENDLESS, camera, even, fov_x, mirror, mirrors},
    given::Given,
    mitsuba::{Said, rotation},
    problems::{Place, Problems},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};
use tauflow_data::geom::{Vec3, compose, cross, determinant, dot, scaling, sub, translation, unit};
use tauflow_data::scene::{Affine, Geometry, IDENTITY, Shape};
use tokens::{Directive, Param, Values};

/// Most shapes, instances counted.
const MOST_SHAPES: usize = 1 << 20;

/// The state that directives change until the end of their block.
#[derive(Clone)]
struct State<'t> {
    ctm: Affine,
    material: Surface<'t>,
    /// The light of the shapes that follow.
    light: Option<&'t Directive>,
    reverse: bool,
}

/// The material of the shapes that follow.
#[derive(Clone, Copy)]
enum Surface<'t> {
    /// pbrt's own: grey.
    Default,
    Own(&'t Directive),
    Named(&'t str, &'t Place),
}

struct Reader<'t, 'b, 'g> {
    build: &'b mut Builder<'g>,
    state: State<'t>,
    stack: Vec<(State<'t>, &'t Place)>,
    spaces: BTreeMap<&'t str, Affine>,
    materials: BTreeMap<&'t str, &'t Directive>,
    /// Textures by name; those of colours and of numbers have names of their own.
    textures: BTreeMap<(&'t str, bool), &'t Directive>,
    made: BTreeMap<(usize, usize), Option<usize>>,
    objects: BTreeMap<&'t str, Rc<Vec<Shape>>>,
    /// The object that is being defined.
    object: Option<(&'t str, Vec<Shape>)>,
    camera: Option<(&'t Directive, Affine)>,
    film: [u32; 2],
    /// The exposure of the film.
    exposure: f64,
    max_depth: u32,
    in_world: bool,
    depth: usize,
    /// Materials and textures in the material in the making, and in all: names of names grow quickly.
    visits: [usize; 2],
}

/// The files that a scene names.
pub fn names(name: &str, bytes: &[u8], given: &Given<'_>, problems: &mut Problems) -> BTreeSet<String> {
    tokens::parse(name, bytes, given, problems).files
}

/// Reads a scene into `build`.
pub fn read(name: &str, bytes: &[u8], given: &Given<'_>, build: &mut Builder<'_>) -> Said {
    let parsed = tokens::parse(name, bytes, given, &mut build.problems);
    if let Some(old) = parsed.directives.iter().find(|directive| is_of_v3(directive)) {
        // All else that is said of it would be of no use.
        build.problems.forget();
        let what = format!("{} says that it is a file of pbrt-v3", old.quoted());
        build.problems.error(&old.at, what, "convert it by `pbrt --upgrade old.pbrt > new.pbrt`, with pbrt-v4");
        return Said { camera: None, max_depth: 1, film: [1280, 720], views: 1 };
    }
    let state = State { ctm: IDENTITY, material: Surface::Default, light: None, reverse: false };
    let mut reader = Reader {
        build,
        state,
        stack: Vec::new(),
        spaces: BTreeMap::new(),
        materials: BTreeMap::new(),
        textures: BTreeMap::new(),
        made: BTreeMap::new(),
        objects: BTreeMap::new(),
        object: None,
        camera: None,
        film: [1280, 720],
        exposure: 1.0,
        // pbrt counts bounces, and has five.
        max_depth: 6,
        in_world: false,
        depth: 0,
        visits: [0, 0],
    };
    for directive in &parsed.directives {
        reader.directive(directive);
    }
    if let Some((_, at)) = reader.stack.last() {
        reader.build.problems.error(at, "a block without its end", "add `AttributeEnd`");
    }
    reader.end()
}

/// Materials, integrators and others that pbrt-v4 gave up or renamed.
const OF_V3: [(&str, &[&str]); 6] = [
    (
        "Material",
        &[
            "matte",
            "plastic",
            "glass",
            "metal",
            "mirror",
            "uber",
            "substrate",
            "translucent",
            "fourier",
            "disney",
            "kdsubsurface",
        ],
    ),
    ("Integrator", &["directlighting", "whitted"]),
    ("SurfaceIntegrator", &[]),
    ("Renderer", &[]),
    ("VolumeIntegrator", &[]),
    ("WorldEnd", &[]),
];

/// Whether a directive is one of pbrt-v3 and not of pbrt-v4.
fn is_of_v3(directive: &Directive) -> bool {
    let named = directive.name == "MakeNamedMaterial";
    let name = if named { "Material" } else { directive.name.as_str() };
    let Some((_, sorts)) = OF_V3.iter().find(|(old, _)| *old == name) else { return false };
    let of_type = directive.params.iter().find(|p| named && p.name == "type").and_then(|p| match &p.values {
        Values::Texts(texts) => texts.first(),
        _ => None,
    });
    let sort = if named { of_type } else { directive.texts.first() };
    sorts.is_empty() || sort.is_some_and(|sort| sorts.contains(&sort.as_str()))
}

/// The inverse; none of a map that flattens space.
fn inverse(m: &Affine) -> Option<Affine> {
    let det = determinant(m);
    if !(det.is_finite() && det != 0.0) {
        return None;
    }
    let row = |r: usize| [m[r][0], m[r][1], m[r][2]];
    let columns = [cross(row(1), row(2)), cross(row(2), row(0)), cross(row(0), row(1))];
    let linear = [0, 1, 2].map(|r: usize| [0, 1, 2].map(|c: usize| columns[c][r] / det));
    let shift = [m[0][3], m[1][3], m[2][3]];
    Some(linear.map(|row| [row[0], row[1], row[2], -dot(row, shift)]))
}

impl<'t> Reader<'t, '_, '_> {
    fn unsupported(&mut self, directive: &Directive, remedy: &str) {
        let sort = directive.texts.first().map_or(String::new(), |t| format!(" `{t}`"));
        self.build.problems.error(&directive.at, format!("{}{sort} is not supported", directive.name), remedy);
        directive.params.iter().for_each(|p| p.used.set(true));
    }

    /// So many numbers of a directive.
    fn numbers<const N: usize>(&mut self, directive: &Directive) -> Option<[f64; N]> {
        let found = directive.numbers.as_slice().try_into().ok();
        if found.is_none() {
            let what = format!("{} with {} numbers", directive.name, directive.numbers.len());
            self.build.problems.error(&directive.at, what, &format!("give it {N}"));
        }
        found
    }

    fn name(&mut self, directive: &'t Directive) -> &'t str {
        if directive.texts.is_empty() {
            self.build.problems.error(&directive.at, format!("{} without a name", directive.name), "name it");
        }
        directive.texts.first().map_or("", String::as_str)
    }

    fn apply(&mut self, map: Option<Affine>) {
        if let Some(map) = map {
            self.state.ctm = compose(&self.state.ctm, &map);
        }
    }

    fn matrix(&mut self, directive: &Directive) -> Option<Affine> {
        let n: [f64; 16] = self.numbers(directive)?;
        // Column after column.
        if [n[3], n[7], n[11], n[15]] != [0.0, 0.0, 0.0, 1.0] {
            self.build.problems.error(&directive.at, "a matrix that is not affine", "leave its last row at 0 0 0 1");
            return None;
        }
        Some([0, 1, 2].map(|r: usize| [n[r], n[4 + r], n[8 + r], n[12 + r]]))
    }

    fn directive(&mut self, directive: &'t Directive) {
        match directive.name.as_str() {
            "Identity" => self.state.ctm = IDENTITY,
            "Translate" => {
                let map = self.numbers(directive).map(translation);
                self.apply(map);
            }
            "Scale" => {
                let map = self.numbers(directive).map(scaling);
                self.apply(map);
            }
            "Rotate" => {
                let map = self.numbers(directive).and_then(|[angle, x, y, z]| rotation([x, y, z], angle));
                self.apply(map);
            }
            "LookAt" => {
                let map = self.numbers(directive).and_then(look);
                if map.is_none() {
                    self.build.problems.error(&directive.at, "it looks nowhere", "give a place, a target and an up");
                }
                self.apply(map);
            }
            "Transform" => self.state.ctm = self.matrix(directive).unwrap_or(IDENTITY),
            "ConcatTransform" => {
                let map = self.matrix(directive);
                self.apply(map);
            }
            "CoordinateSystem" => {
                let name = self.name(directive);
                self.spaces.insert(name, self.state.ctm);
            }
            "CoordSysTransform" => {
                let name = self.name(directive);
                match self.spaces.get(name) {
                    Some(map) => self.state.ctm = *map,
                    None => {
                        let what = format!("there is no coordinate system `{name}`");
                        self.build.problems.error(&directive.at, what, "define it before");
                    }
                }
            }
            "AttributeBegin" | "TransformBegin" => self.stack.push((self.state.clone(), &directive.at)),
            "AttributeEnd" | "TransformEnd" => match self.stack.pop() {
                Some((state, _)) if directive.name == "AttributeEnd" => self.state = state,
                Some((state, _)) => self.state.ctm = state.ctm,
                None => self.build.problems.error(&directive.at, "an end without its beginning", "take it out"),
            },
            "ReverseOrientation" => self.state.reverse = !self.state.reverse,
            "WorldBegin" => {
                self.in_world = true;
                self.state.ctm = IDENTITY;
            }
            "Material" => self.state.material = Surface::Own(directive),
            "NamedMaterial" => self.state.material = Surface::Named(self.name(directive), &directive.at),
            "MakeNamedMaterial" => {
                let name = self.name(directive);
                self.materials.insert(name, directive);
            }
            "Texture" => match directive.texts.as_slice() {
                [name, kind, _] => {
                    self.textures.insert((name, kind == "float"), directive);
                }
                _ => {
                    let remedy = "write `Texture \"name\" \"spectrum\" \"class\"`";
                    self.build.problems.error(&directive.at, "a texture without name, type and class", remedy);
                }
            },
            "AreaLightSource" => self.state.light = Some(directive),
            "LightSource" | "Shape" | "ObjectInstance" if !self.in_world => {
                self.build.problems.error(&directive.at, "it stands before `WorldBegin`", "put it behind");
            }
            "LightSource" => self.light(directive),
            "Shape" => self.shape(directive),
            "ObjectBegin" => {
                let name = self.name(directive);
                if self.object.is_some() {
                    self.build.problems.error(&directive.at, "an object in an object", "end the first one before");
                }
                self.stack.push((self.state.clone(), &directive.at));
                self.object = Some((name, Vec::new()));
            }
            "ObjectEnd" => {
                if let Some((name, shapes)) = self.object.take() {
                    self.objects.insert(name, Rc::new(shapes));
                }
                if let Some((state, _)) = self.stack.pop() {
                    self.state = state;
                }
            }
            "ObjectInstance" => self.instance(directive),
            "Camera" => {
                let world = inverse(&self.state.ctm);
                if world.is_none() {
                    self.build.problems.error(&directive.at, "a transform that flattens space", "mend it");
                }
                let world = world.unwrap_or(IDENTITY);
                self.spaces.insert("camera", world);
                self.camera = Some((directive, world));
            }
            "Film" => self.film(directive),
            "Integrator" => self.integrator(directive),
            "PixelFilter" => {
                if self.name(directive) != "box" {
                    let what = "pixels are means over their squares (`box`), whatever the pixel filter";
                    self.build.problems.note(&directive.at, what);
                }
            }
            "Sampler" | "Accelerator" => {}
            "ColorSpace" if directive.texts.first().is_some_and(|t| t == "srgb") => {}
            "MediumInterface" if directive.texts.iter().all(String::is_empty) => {}
            // Until something is filled with it.
            "MakeNamedMedium" => {}
            "Option" => {
                let named =
                    |p: &Param| ["seed", "rendercoordsys", "quiet", "displacementedgescale"].contains(&p.name.as_str());
                if !directive.params.iter().all(named) {
                    self.unsupported(directive, "take it out");
                }
            }
            "ActiveTransform" if directive.texts.is_empty() && directive.numbers.is_empty() => {}
            _ => self.unsupported(directive, "take it out"),
        }
    }

    fn instance(&mut self, directive: &'t Directive) {
        let name = self.name(directive);
        let Some(shapes) = self.objects.get(name).cloned() else {
            let what = format!("there is no object `{name}`");
            return self.build.problems.error(&directive.at, what, "define it before, by `ObjectBegin`");
        };
        if self.object.is_some() {
            return self.build.problems.error(&directive.at, "an instance in an object", "put it into the world");
        }
        let at = &directive.at;
        for shape in shapes.iter() {
            let to_world = compose(&self.state.ctm, &shape.to_world);
            if matches!(shape.geometry, Geometry::Sphere { .. }) && !even(&to_world) {
                let what = "an instance that scales a sphere unevenly is not supported";
                self.build.problems.error(at, what, "use a mesh in its place");
            }
            if self.build.shapes.len() >= MOST_SHAPES {
                let file = Place::file(&at.file);
                return self.build.problems.error(&file, "more than a million shapes", "simplify it");
            }
            if !self.build.count(&shape.geometry, at) {
                return;
            }
            self.build.shape(Shape { to_world, ..shape.clone() }, at);
        }
    }

    fn film(&mut self, directive: &'t Directive) {
        if !matches!(self.name(directive), "rgb" | "gbuffer" | "spectral") {
            self.unsupported(directive, "use `rgb`");
        }
        let mut side = |name: &str, default: f64| {
            let value = self.number(directive, name).unwrap_or(default);
            if !(1.0..=65536.0).contains(&value) {
                self.build.problems.error(&directive.at, format!("a film with {name} {value}"), "use 1 to 65536");
            }
            value.clamp(1.0, 65536.0) as u32
        };
        self.film = [side("xresolution", 1280.0), side("yresolution", 720.0)];
        let sensor = self.text(directive, "sensor").unwrap_or("cie1931");
        if sensor != "cie1931" {
            let what = format!("the sensor `{sensor}` is not supported");
            self.build.problems.error(&directive.at, what, "use `cie1931`, which is pbrt's default");
        }
        // Seconds, and speed of the film in ISO; 100 is 1.
        let seconds = self.number(directive, "exposuretime").unwrap_or(1.0);
        self.exposure = seconds * self.number(directive, "iso").unwrap_or(100.0) / 100.0;
        self.pass_over(directive, &["filename", "savefp16", "diagonal", "coordinatesystem", "nbuckets"]);
        self.finish(directive);
    }

    fn integrator(&mut self, directive: &'t Directive) {
        let sort = self.name(directive);
        match sort {
            "path" | "volpath" => {}
            "simplepath" | "simplevolpath" | "bdpt" | "mlt" | "lightpath" => {
                self.build.problems.note(&directive.at, format!("`{sort}` is rendered by the path tracer"));
            }
            _ => return self.unsupported(directive, "use `path`"),
        }
        // In pbrt, 0 bounces show emitters, which is a path of one segment here.
        let bounces = self.number(directive, "maxdepth").unwrap_or(5.0).max(0.0);
        self.max_depth = (bounces.min(f64::from(ENDLESS - 1)) as u32) + 1;
        if self.flag(directive, "regularize", false) {
            self.build.problems.error(&directive.at, "`regularize` is not supported", "set it to false");
        }
        let how = ["lightsampler", "sampledirect", "samplelights", "samplebsdf", "bootstrapsamples", "chains"];
        self.pass_over(directive, &how);
        self.pass_over(directive, &["mutationsperpixel", "largestepprobability", "sigma", "visualizestrategies"]);
        self.finish(directive);
    }

    fn end(mut self) -> Said {
        let mut said = Said { camera: None, max_depth: self.max_depth, film: self.film, views: 1 };
        let Some((directive, world)) = self.camera else { return said };
        if self.name(directive) != "perspective" {
            self.unsupported(directive, "use `perspective`");
            return said;
        }
        let fov = self.number(directive, "fov").unwrap_or(90.0);
        if self.number(directive, "lensradius").unwrap_or(0.0) != 0.0 {
            let remedy = "set it to 0: nothing is out of focus";
            self.build.problems.error(&directive.at, "`lensradius` is not supported", remedy);
        }
        self.pass_over(directive, &["focaldistance", "shutteropen", "shutterclose"]);
        self.finish(directive);
        match fov_x(fov, "smaller", self.film).filter(|fov| *fov > 0.0 && *fov < 180.0) {
            Some(fov) => {
                // A camera of pbrt stands where its scale has put it, and looks as if it had none.
                let mut camera = camera(&world, fov, 0.0);
                let forward = unit([0, 1, 2].map(|r: usize| world[r][2]));
                camera.target = [0, 1, 2].map(|i: usize| camera.origin[i] + forward[i]);
                camera.up = unit(camera.up);
                self.build.check_camera(&camera, &directive.at);
                if !mirrors(&world) {
                    mirror(self.build, &mut camera);
                }
                said.camera = Some(camera);
            }
            None => {
                let what = format!("a field of view of {fov} degrees");
                self.build.problems.error(&directive.at, what, "use an angle below 180");
            }
        }
        said
    }
}

/// pbrt's `LookAt`: from the world into the space of a camera that looks along +z.
fn look(n: [f64; 9]) -> Option<Affine> {
    let (from, to, up) = ([n[0], n[1], n[2]], [n[3], n[4], n[5]], [n[6], n[7], n[8]]);
    let forward = sub(to, from);
    let right = cross(unit(up), unit(forward));
    if !(dot(forward, forward) > 0.0 && dot(up, up) > 0.0 && dot(right, right) > 0.0) {
        return None;
    }
    let (forward, right): (Vec3, Vec3) = (unit(forward), unit(right));
    let up = cross(forward, right);
    inverse(&[0, 1, 2].map(|r: usize| [right[r], up[r], forward[r], from[r]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverses_undo() {
        let map = compose(&translation([1.0, 2.0, 3.0]), &scaling([2.0, -4.0, 0.5]));
        let both = compose(&map, &inverse(&map).expect("it has one"));
        assert!(both.iter().flatten().zip(IDENTITY.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12), "{both:?}");
        assert_eq!(inverse(&scaling([1.0, 0.0, 1.0])), None);
        let seen = look([0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]).expect("a view");
        assert_eq!(tauflow_data::geom::apply(&seen, [0.0, 0.0, 1.0]), [0.0, 0.0, 4.0]);
    }
}
