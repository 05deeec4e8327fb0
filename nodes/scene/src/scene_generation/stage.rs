//! The choices of a layout: placement, structures, lights, positions of cameras.
//!
//! A stage is plain data and knows no materials; [`super::assemble`] makes a scene of it. Draws that decide a layout
//! go through [`Stage::draw`], which records them for the recipe and so for the signature.

use super::{
    cast::Cast,
    place::{Solid, Surface, Turn, World, tenth},
};
use std::{collections::BTreeMap, sync::Arc};
use tauflow_contract::KindError;
use tauflow_data::{
    Regime, Stratum,
    geom::{Aabb, Vec3, add},
    records::Asset,
    rng::Stream,
    scene::Affine,
};
use tauflow_scene_library::{Facts, Land, forms::Family, stuff::Stuff};

/// How a thing is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rest {
    /// Stands or lies on what is below.
    Stands,
    /// Grows out of the ground, or is set into it.
    Rooted,
    /// Hangs from what is above.
    Hangs,
    /// Hangs on the wall behind it.
    Wall,
}

/// The type of a thing.
#[derive(Clone)]
pub enum Body<'a> {
    /// A variant of a form.
    Form(Arc<Facts>),
    /// An asset.
    Asset(&'a Asset),
}

impl Body<'_> {
    /// The name it has in a recipe.
    pub fn name(&self) -> String {
        match self {
            Self::Form(facts) => format!("procedural/{}-{:02}", facts.form.name, facts.variant),
            Self::Asset(asset) => asset.name.clone(),
        }
    }
}

/// A thing in its place.
pub struct Thing<'a> {
    /// Its type.
    pub body: Body<'a>,
    /// Where it stands.
    pub to_world: Affine,
    /// How it is held, which tests look at.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests hold things to it"))]
    pub rest: Rest,
    /// True if it shows the regime.
    pub special: bool,
    /// True if, where the regime has glass, it is of glass or a mirror.
    pub glass: bool,
    /// True if it is the main object, or what shows the regime beside it.
    pub main: bool,
    /// Things of one set have the same materials.
    pub set: u32,
    /// The power of its lamps, if it is lit.
    pub power: Option<f64>,
    /// Its boxes in the world, as a range of [`Stage::world`]'s.
    pub solids: core::ops::Range<usize>,
    /// Its flat places.
    pub tops: Vec<Surface>,
    /// Its box.
    pub bounds: Aabb,
}

/// A box to build.
#[derive(Clone, Copy, Debug)]
pub struct Board {
    /// Its middle.
    pub center: Vec3,
    /// Half sizes along its own axes, to where it meets its neighbours.
    pub half: Vec3,
    /// Its turn.
    pub turn: Turn,
    /// How much less it reaches along each axis, so that it touches nobody: [`SEAM`] or
    /// [`GAP`](super::place::GAP) where something is.
    ///
    /// [`SEAM`]: super::place::SEAM
    pub inset: Vec3,
}

impl Board {
    /// Not turned, next to nothing.
    pub const PLAIN: Self = Self { center: [0.0; 3], half: [0.0; 3], turn: Turn::NONE, inset: [0.0; 3] };
}

/// Surfaces of one material: quads with corners counter-clockwise from outside, and reliefs.
pub struct Skin {
    /// Its material.
    pub stuff: Stuff,
    /// True if it shows the regime.
    pub special: bool,
    /// Quads.
    pub quads: Vec<[Vec3; 4]>,
    /// Land with its place.
    pub lands: Vec<(Arc<Land>, Affine)>,
}

/// Lights other than lit things.
pub enum Light {
    /// A rectangle, as of a ceiling panel: centre, normal, half sizes.
    Panel(Vec3, Vec3, [f64; 2]),
    /// A disk: centre, normal, radius.
    Disk(Vec3, Vec3, f64),
    /// A ball.
    Ball(Vec3, f64),
    /// A spot light of no size: from, toward, half angle in degrees. Regimes with glass have a disk in its place.
    Spot(Vec3, Vec3, f64),
    /// The panel behind a window: centre, normal into the room, half sizes. Its power is a radiance.
    Outside(Vec3, Vec3, [f64; 2]),
}

/// Where cameras may stand and what they look at.
pub struct Eye {
    /// Where from.
    pub from: From,
    /// Looks at a place in this box.
    pub at: Aabb,
    /// How often, against the others.
    pub weight: f64,
}

/// Where a camera stands.
pub enum From {
    /// In a box.
    Box(Aabb),
    /// About what it looks at: distances, azimuths (from +z towards +x) and elevations, radians.
    Orbit([f64; 2], [f64; 2], [f64; 2]),
}

/// A layout's decisions.
pub struct Stage<'a> {
    /// The layout's name.
    pub layout: &'static str,
    /// The scene's stratum.
    pub stratum: Stratum,
    /// The available assets.
    pub cast: &'a Cast<'a>,
    /// Draws that decide the layout, by name.
    pub params: BTreeMap<String, f64>,
    /// Things.
    pub things: Vec<Thing<'a>>,
    /// How many things may stand; more once the places that are kept are given back.
    pub most: usize,
    /// Places kept for the main object and what shows the regime beside it, until they stand.
    pub kept: usize,
    /// Structures by label.
    pub skins: BTreeMap<String, Skin>,
    /// Lights with their powers; true for daylight.
    pub lights: Vec<(Light, f64, bool)>,
    /// Level of the environment; 0 for none.
    pub sky: f64,
    /// True if the environment is a studio and no sky.
    pub studio: bool,
    /// True if nothing hangs before windows, as what is built there would be in the way.
    pub bare: bool,
    /// From where the main object may be looked at closely: azimuths from +z towards +x.
    pub front: [f64; 2],
    /// Cameras.
    pub eyes: Vec<Eye>,
    /// Cameras stay in here.
    pub inside: Option<Aabb>,
    /// Everything that is in the way.
    pub world: World,
    /// True once the main object stands.
    pub has_main: bool,
    /// Errors during construction.
    pub fault: Option<KindError>,
    pub(super) sets: u32,
    pub(super) stream: Stream,
    pub(super) drawn: u64,
}

impl<'a> Stage<'a> {
    /// An empty stage for so many things at most.
    pub fn new(layout: &'static str, stratum: Stratum, cast: &'a Cast<'a>, stream: &Stream, most: usize) -> Self {
        Self {
            layout,
            stratum,
            cast,
            params: BTreeMap::new(),
            things: Vec::new(),
            most: most - most.min(3),
            kept: most.min(3),
            skins: BTreeMap::new(),
            lights: Vec::new(),
            sky: 0.0,
            studio: false,
            bare: false,
            front: [0.0, core::f64::consts::TAU],
            eyes: Vec::new(),
            inside: None,
            world: World::default(),
            has_main: false,
            fault: None,
            sets: 0,
            stream: stream.part(layout),
            drawn: 0,
        }
    }

    /// True if the scene has glass.
    pub fn glassy(&self) -> bool {
        matches!(self.stratum.regime, Regime::L2 | Regime::L3)
    }

    /// A recorded draw. Each name has a stream of its own, so that layouts can grow.
    pub fn draw(&mut self, name: &str, low: f64, high: f64) -> f64 {
        let value = (self.stream.part(name).range(low, high) * 1e3).round() / 1e3;
        self.params.insert(name.to_owned(), value);
        value
    }

    /// A recorded choice among 0..n.
    pub fn choose(&mut self, name: &str, n: usize) -> usize {
        let value = self.stream.part(name).below(n);
        self.params.insert(name.to_owned(), value as f64);
        value
    }

    /// A recorded choice of one of these.
    pub fn one<T: Copy>(&mut self, name: &str, of: &[T]) -> T {
        of[self.choose(name, of.len())]
    }

    /// A recorded chance.
    pub fn maybe(&mut self, name: &str, p: f64) -> bool {
        let value = self.stream.part(name).chance(p);
        self.params.insert(name.to_owned(), f64::from(u8::from(value)));
        value
    }

    /// A stream of its own for the next step of the layout.
    pub fn next(&mut self) -> Stream {
        self.drawn += 1;
        self.stream.part(&format!("step.{}", self.drawn))
    }

    /// A draw that is not recorded.
    pub fn any(&mut self, low: f64, high: f64) -> f64 {
        self.next().range(low, high)
    }

    /// How many things may still come.
    pub fn left(&self) -> usize {
        self.most.saturating_sub(self.things.len())
    }

    /// The share of the things asked for that `n` in a usual scene of 30 stand for, at least one.
    pub fn some(&self, n: usize) -> usize {
        (n * (self.most + self.kept)).div_ceil(30).max(1)
    }

    /// A set of its own, for things that share materials.
    pub fn new_set(&mut self) -> u32 {
        self.sets += 1;
        self.sets
    }

    /// A quad of a material.
    pub fn quad(&mut self, label: &str, stuff: Stuff, corners: [Vec3; 4]) {
        let corners = corners.map(|c| c.map(tenth));
        self.skin(label, stuff).quads.push(corners);
    }

    fn skin(&mut self, label: &str, stuff: Stuff) -> &mut Skin {
        let special = match self.stratum.regime {
            // A polished floor or a lacquered wall now and then, where gloss is the subject.
            Regime::L1 => self.stream.part(&format!("skin.{label}")).chance(0.3),
            _ => false,
        };
        let new = Skin { stuff, special, quads: Vec::new(), lands: Vec::new() };
        self.skins.entry(label.to_owned()).or_insert(new)
    }

    /// Land of a material, its height 0 at `center`'s y.
    pub fn land(&mut self, label: &str, stuff: Stuff, land: Arc<Land>, center: Vec3) -> Surface {
        let half = land.relief.half;
        let surface = Surface { relief: Some(land.relief.clone()), ..Surface::flat(center, [half; 2], 100.0) };
        self.skin(label, stuff).lands.push((land, Turn::NONE.map(center)));
        surface
    }

    /// A box of a material, in the way of others; gives its top.
    pub fn board(&mut self, label: &str, stuff: Stuff, board: Board) -> Surface {
        let Board { center, half, turn, inset } = board;
        let center = center.map(tenth);
        let half = [0, 1, 2].map(|axis| half[axis] - inset[axis]);
        let local = Aabb::around([0.0; 3], half);
        self.world.solids.push(Solid::of(&local, turn, center));
        self.facing(label, stuff, center, half, turn, &[0, 1, 2, 3, 4, 5]);
        let top = add(center, [0.0, half[1], 0.0]);
        Surface { turn, ..Surface::flat(top, [half[0], half[2]], 100.0) }
    }

    /// Some sides of a box, in nobody's way: 0 and 1 are +x and -x, 2 and 3 top and bottom, 4 and 5 +z and -z.
    pub fn facing(&mut self, label: &str, stuff: Stuff, center: Vec3, half: Vec3, turn: Turn, sides: &[usize]) {
        for side in sides {
            // Outward normal n and tangents a, b with a x b = n, b upright on upright sides.
            let (n, a, b): (Vec3, Vec3, Vec3) = match side {
                0 => ([1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]),
                1 => ([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]),
                2 => ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
                3 => ([0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
                4 => ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
                _ => ([0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
            };
            let corner = |s: f64, t: f64| {
                let local = [0, 1, 2].map(|i| (n[i] + s * a[i] + t * b[i]) * half[i]);
                let [x, z] = turn.apply([local[0], local[2]]);
                add(center, [x, local[1], z])
            };
            let quad = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
            self.quad(label, stuff, quad);
        }
    }

    /// Adds a camera's region.
    pub fn eye(&mut self, weight: f64, from: From, at: Aabb) {
        self.eyes.push(Eye { from, at, weight });
    }

    /// A camera about a surface, its distance by the size of what stands there.
    pub fn look_at(&mut self, weight: f64, on: &Surface, height: f64, azimuth: [f64; 2], elevation: [f64; 2]) {
        let size = 2.0 * (on.half[0] * on.half[0] + on.half[1] * on.half[1] + 0.25 * height * height).sqrt();
        let mut at = on.bounds(height);
        let (c, s) = (at.center(), at.size());
        at = Aabb::around(c, [0.25 * s[0], 0.3 * s[1], 0.25 * s[2]]);
        self.eye(weight, From::Orbit([0.75 * size, 1.5 * size], azimuth, elevation), at);
    }

    /// A light.
    pub fn light(&mut self, light: Light, power: f64) {
        let day = matches!(light, Light::Outside(..));
        self.lights.push((light, power, day));
    }

    /// Lights a thing's lamps.
    pub fn lit(&mut self, thing: Option<usize>, power: f64) {
        if let Some(thing) = thing {
            self.things[thing].power = Some(power);
        }
    }

    /// The largest flat place of a thing.
    pub fn top(&self, thing: usize) -> Option<Surface> {
        let area = |s: &Surface| s.half[0] * s.half[1];
        self.things[thing].tops.iter().max_by(|a, b| area(a).total_cmp(&area(b))).cloned()
    }

    /// All flat places of a thing, lowest first.
    pub fn tops(&self, thing: usize) -> Vec<Surface> {
        let mut tops = self.things[thing].tops.clone();
        tops.sort_by(|a, b| a.center[1].total_cmp(&b.center[1]));
        tops
    }

    /// The upper side of a rug or a blanket.
    pub fn upon(&self, thing: usize) -> Option<Surface> {
        self.top(thing).or_else(|| self.lid(thing))
    }

    /// Things on top of a thing's bounding box: for boxes and books, whose tops are flat.
    pub fn lid(&self, thing: usize) -> Option<Surface> {
        let last = &self.world.solids[self.things[thing].solids.clone()];
        let [only] = last else { return None };
        Some(Surface { turn: only.turn, ..Surface::flat([only.at[0], only.y[1], only.at[1]], only.half, 100.0) })
    }

    /// True for families that lamps are of.
    pub fn is_lamp(family: Family) -> bool {
        matches!(family, Family::Lamp | Family::CeilingLamp | Family::StreetLamp)
    }
}

/// The identity, for what is built in place.
pub const HERE: Affine = tauflow_data::scene::IDENTITY;
