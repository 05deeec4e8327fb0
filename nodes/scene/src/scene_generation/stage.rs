//! What a layout template decides: architecture, lights, places for objects, where a camera may stand.
//!
//! A stage is plain data and knows neither materials nor objects; [`super::assemble`] makes a scene of it. Every
//! continuous draw goes through [`Stage::draw`], which records it for the recipe and so for the signature.

use crate::geom::{Aabb, Vec3, add, compose, facing, mul, scaling, sub, translation, unit};
use std::collections::BTreeMap;
use tauflow_data::{
    Regime,
    mesh::Mesh,
    rng::Stream,
    scene::{Affine, IDENTITY},
};

/// What a piece of architecture is; pieces of one role share a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// What one stands on.
    Floor,
    /// Overhead.
    Ceiling,
    /// A wall, by number.
    Wall(u8),
    /// Columns, pedestals, tables.
    Furniture,
}

/// The form of a piece.
pub enum Form {
    /// The square [-1, 1]^2 in z = 0.
    Rectangle,
    /// The unit disk in z = 0.
    Disk,
    /// The cube [-1, 1]^3.
    Cube,
    /// A mesh.
    Mesh(Mesh),
}

/// A piece of architecture.
pub struct Piece {
    /// Its form.
    pub form: Form,
    /// Where it stands.
    pub to_world: Affine,
    /// What it is.
    pub role: Role,
    /// How often a texture repeats over its uv square.
    pub tiling: f64,
}

/// A light that a template wants; its form depends on the regime.
pub struct Light {
    /// Its centre.
    pub position: Vec3,
    /// What it shines at.
    pub aim: Vec3,
    /// Half sizes of its rectangle.
    pub half: [f64; 2],
    /// Radiant power, watts by channel before colour.
    pub power: f64,
    /// True for a spot light where the regime allows one.
    pub spot: bool,
}

/// A place for an object.
pub struct Spot {
    /// Where its foot stands, or its centre if it floats.
    pub position: Vec3,
    /// Its largest side.
    pub size: f64,
    /// True if it hangs free in any orientation.
    pub floating: bool,
}

/// Where the camera may stand, seen from the objects.
pub struct View {
    /// Azimuths, radians about +y from +z.
    pub azimuth: [f64; 2],
    /// Elevations, radians.
    pub elevation: [f64; 2],
    /// The room that must hold it.
    pub room: Option<Aabb>,
}

/// A template's decisions.
pub struct Stage {
    /// The template's name.
    pub layout: &'static str,
    /// The scene's regime.
    pub regime: Regime,
    /// Every continuous draw, by name.
    pub params: BTreeMap<String, f64>,
    /// Architecture.
    pub pieces: Vec<Piece>,
    /// Lights.
    pub lights: Vec<Light>,
    /// Places for objects, the main one first.
    pub spots: Vec<Spot>,
    /// Level of the environment; 0 for none.
    pub sky: f64,
    /// Where the camera may stand.
    pub view: View,
    /// What would hide the objects from a camera.
    pub obstacles: Vec<Aabb>,
    stream: Stream,
}

impl Stage {
    /// An empty stage.
    pub fn new(layout: &'static str, regime: Regime, stream: &Stream) -> Self {
        Self {
            layout,
            regime,
            params: BTreeMap::new(),
            pieces: Vec::new(),
            lights: Vec::new(),
            spots: Vec::new(),
            sky: 0.0,
            view: View { azimuth: [0.0, core::f64::consts::TAU], elevation: [0.15, 0.7], room: None },
            obstacles: Vec::new(),
            stream: stream.part(layout),
        }
    }

    /// A recorded draw. Each name has a stream of its own, so that templates can grow.
    pub fn draw(&mut self, name: &str, low: f64, high: f64) -> f64 {
        let value = self.stream.part(name).range(low, high);
        self.params.insert(name.to_owned(), value);
        value
    }

    /// A recorded choice among 0..n.
    pub fn choose(&mut self, name: &str, n: usize) -> usize {
        let value = self.stream.part(name).below(n);
        self.params.insert(name.to_owned(), value as f64);
        value
    }

    /// Adds a piece.
    pub fn piece(&mut self, form: Form, to_world: Affine, role: Role, tiling: f64) {
        self.pieces.push(Piece { form, to_world, role, tiling });
    }

    /// A round floor at y = 0.
    pub fn ground(&mut self, radius: f64) {
        let to_world = facing([0.0; 3], [0.0, 1.0, 0.0], [radius, radius]);
        self.piece(Form::Disk, to_world, Role::Floor, radius);
    }

    /// A rectangle at `center` facing along `normal`; not an obstacle.
    pub fn panel(&mut self, center: Vec3, normal: Vec3, half: [f64; 2], role: Role) {
        self.piece(Form::Rectangle, facing(center, normal, half), role, half[0].max(half[1]));
    }

    /// A block along the axes, and an obstacle to the camera.
    pub fn block(&mut self, center: Vec3, half: Vec3, role: Role) {
        self.piece(Form::Cube, compose(&translation(center), &scaling(half)), role, 1.0);
        self.obstacles.push(Aabb::around(center, half));
    }

    /// A block that objects stand on, which therefore hides nothing.
    pub fn plinth(&mut self, center: Vec3, half: Vec3) {
        self.piece(Form::Cube, compose(&translation(center), &scaling(half)), Role::Furniture, 1.0);
    }

    /// A mesh where it stands, an obstacle if `bounds` are given.
    pub fn mesh(&mut self, mesh: Mesh, to_world: Affine, role: Role, bounds: Option<Aabb>) {
        self.piece(Form::Mesh(mesh), to_world, role, 1.0);
        self.obstacles.extend(bounds.map(|b| b.mapped(&to_world)));
    }

    /// A closed box room, x and z centred, floor at y = 0, open to nowhere.
    ///
    /// The walls reach 1 cm past the corners, so that no crack shows the void.
    pub fn room(&mut self, width: f64, height: f64, depth: f64) {
        let (x, y, z) = (0.5 * width, 0.5 * height, 0.5 * depth);
        let past = 0.01;
        self.panel([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [x + past, z + past], Role::Floor);
        self.panel([0.0, height, 0.0], [0.0, -1.0, 0.0], [x + past, z + past], Role::Ceiling);
        for (number, sign) in [(0, -1.0), (1, 1.0)] {
            self.panel([sign * x, y, 0.0], [-sign, 0.0, 0.0], [z + past, y + past], Role::Wall(number));
            self.panel([0.0, y, sign * z], [0.0, 0.0, -sign], [x + past, y + past], Role::Wall(2));
        }
        self.view.room = Some(Aabb { low: [-x, 0.0, -z], high: [x, height, z] });
    }

    /// A recorded light of a power drawn from `power`, of fixed place and half sizes.
    pub fn light(&mut self, name: &str, position: Vec3, aim: Vec3, half: [f64; 2], power: [f64; 2]) {
        let power = self.draw(&format!("{name}.power"), power[0], power[1]);
        self.lights.push(Light { position, aim, half, power, spot: false });
    }

    /// Places for objects round `center`: the main one there, `others` about it.
    pub fn ring(&mut self, center: Vec3, main: [f64; 2], other: [f64; 2], others: usize) {
        let size = self.draw("main.size", main[0], main[1]);
        let turn = self.draw("ring.turn", 0.0, core::f64::consts::TAU);
        self.spots.push(Spot { position: center, size, floating: false });
        for i in 0..others {
            let small = self.draw(&format!("ring.{i}.size"), other[0], other[1]);
            let gap = self.draw(&format!("ring.{i}.gap"), 0.08, 0.4);
            let jitter = self.draw(&format!("ring.{i}.jitter"), -0.25, 0.25);
            let angle = turn + core::f64::consts::TAU * (i as f64 / others as f64) + jitter;
            let radius = 0.62 * (size + small) + gap;
            let toward = crate::geom::direction(angle, 0.0);
            self.spots.push(Spot { position: add(center, mul(toward, radius)), size: small, floating: false });
        }
    }

    /// The identity, for meshes made in place.
    pub const HERE: Affine = IDENTITY;
}

/// A unit vector from `a` towards `b`.
pub fn toward(a: Vec3, b: Vec3) -> Vec3 {
    unit(sub(b, a))
}
