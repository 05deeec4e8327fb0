//! pbrt-v4 files as scenes: the state that directives change, and what stands in the world. Knows nothing of kinds.
//!
//! pbrt's space is left-handed: seen by its own camera, it is the mirror image of what a right-handed camera sees. The
//! scene is therefore mirrored, unless its camera's transform already mirrors it (`Scale -1 1 1`).

mod arguments;
mod lights;
mod materials;
mod options;
mod outdated;
mod shapes;
mod tokens;

use super::{
    build::{Builder, even},
    given::Given,
    mitsuba::{Said, rotation},
    problems::{Place, Problems},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};
use tauflow_data::{
    geom::{compose, scaling, translation},
    scene::{Affine, Geometry, IDENTITY, Shape},
};
use tokens::{Directive, Param, Values};

/// Most shapes, instances counted.
const MOST_SHAPES: usize = 1 << 20;

/// Most `Attribute` directives that hold at once.
const MOST_ATTRIBUTES: usize = 256;

/// Colour spaces whose white is that of sRGB, with their maps to linear sRGB.
const SPACES: [(&str, [[f64; 3]; 3]); 2] = [
    (
        "rec2020",
        [
            [1.660_491_0, -0.587_641_1, -0.072_849_9],
            [-0.124_550_5, 1.132_899_9, -0.008_349_4],
            [-0.018_150_8, -0.100_578_9, 1.118_729_7],
        ],
    ),
    (
        "dci-p3",
        [[1.224_940_2, -0.224_940_2, 0.0], [-0.042_057_0, 1.042_057_0, 0.0], [-0.019_637_6, -0.078_636_1, 1.098_273_6]],
    ),
];

/// The state that directives change until the end of their block.
#[derive(Clone)]
struct State<'t> {
    ctm: Affine,
    material: Surface<'t>,
    /// The light of the shapes that follow.
    light: Option<&'t Directive>,
    reverse: bool,
    /// Parameters that `Attribute` gives to what follows.
    attributes: Rc<Vec<&'t Directive>>,
    /// From the colour space of `rgb` values to linear sRGB; none of sRGB itself.
    space: Option<&'static [[f64; 3]; 3]>,
}

/// The material of the shapes that follow.
#[derive(Clone, Copy)]
enum Surface<'t> {
    /// pbrt's own: grey.
    Default,
    Own(&'t Directive),
    Named(&'t str, &'t Place),
}

struct PbrtReader<'t, 'b, 'g> {
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
    /// The speed of the film over ISO 100, and the seconds that the shutter is open.
    exposure: [f64; 2],
    /// What `Attribute` gives to directives, and what turns `rgb` parameters into linear sRGB; by where these lie.
    given: BTreeMap<usize, Rc<Vec<&'t Directive>>>,
    converted: BTreeMap<usize, &'static [[f64; 3]; 3]>,
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
    if let Some(old) = parsed.directives.iter().find(|directive| outdated::is_of_v3(directive)) {
        // All else that is said of it would be of no use.
        build.problems.forget();
        let what = format!("{} says that it is a file of pbrt-v3", old.quoted());
        build.problems.error(&old.at, what, "convert it by `pbrt --upgrade old.pbrt > new.pbrt`, with pbrt-v4");
        return Said { camera: None, max_depth: 1, film: [1280, 720], views: 1 };
    }
    let (attributes, space) = (Rc::default(), None);
    let state = State { ctm: IDENTITY, material: Surface::Default, light: None, reverse: false, attributes, space };
    let mut reader = PbrtReader {
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
        exposure: [1.0; 2],
        given: BTreeMap::new(),
        converted: BTreeMap::new(),
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

impl<'t> PbrtReader<'t, '_, '_> {
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
        if !self.state.attributes.is_empty() {
            self.given.insert(std::ptr::from_ref(directive) as usize, Rc::clone(&self.state.attributes));
        }
        if let Some(space) = self.state.space {
            let params = directive.params.iter().filter(|param| param.sort == "rgb");
            self.converted.extend(params.map(|param| (std::ptr::from_ref(param) as usize, space)));
        }
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
                let map = self.numbers(directive).and_then(options::look);
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
                let world = options::inverse(&self.state.ctm);
                if world.is_none() {
                    self.build.problems.error(&directive.at, "a transform that flattens space", "mend it");
                }
                let world = world.unwrap_or(IDENTITY);
                self.spaces.insert("camera", world);
                let mut time = |name: &str, default: f64| self.number(directive, name).unwrap_or(default);
                let open = time("shutterclose", 1.0) - time("shutteropen", 0.0);
                if !(open > 0.0 && open.is_finite()) {
                    let what = format!("a shutter that is open for {open} s");
                    self.build.problems.error(&directive.at, what, "close it after it opens");
                }
                self.exposure[1] = open;
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
            "ColorSpace" => {
                let name = self.name(directive);
                match SPACES.iter().find(|(known, _)| *known == name) {
                    Some((_, map)) => self.state.space = Some(map),
                    None if name == "srgb" => self.state.space = None,
                    None => self.unsupported(directive, "use `srgb`, `rec2020` or `dci-p3`"),
                }
            }
            "Attribute" => {
                let target = self.name(directive);
                if !matches!(target, "shape" | "light" | "material" | "texture" | "medium") {
                    return self.unsupported(directive, "name `shape`, `light`, `material`, `texture` or `medium`");
                }
                if self.state.attributes.len() >= MOST_ATTRIBUTES {
                    let what = format!("more than {MOST_ATTRIBUTES} attributes at once");
                    return self.build.problems.error(&directive.at, what, "write parameters where they are used");
                }
                Rc::make_mut(&mut self.state.attributes).push(directive);
                // What nothing reads is no mistake here.
                directive.params.iter().for_each(|param| param.used.set(true));
            }
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
}
