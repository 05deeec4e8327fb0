//! Parts of rooms and houses: walls with openings, windows with a bright background, doors, panels.

use super::{
    place::{GAP, Solid, Surface, Turn},
    props::ask,
    stage::{Board, From, Light, Stage},
};
use tauflow_data::geom::{Aabb, Vec3, add};
use tauflow_scene_library::{forms::Family, stuff::Stuff};

/// An upright wall: what faces the room.
#[derive(Clone, Debug)]
pub struct Wall {
    /// Middle of its lower edge.
    pub origin: Vec3,
    /// Takes +z into the room and +x along the wall.
    pub turn: Turn,
    /// Its length.
    pub length: f64,
    /// Its height.
    pub height: f64,
    /// Openings: from and to along the wall, from and to in height.
    pub openings: Vec<[f64; 4]>,
}

impl Wall {
    /// A wall; `turn` takes +z to where it faces.
    pub fn new(origin: Vec3, turn: Turn, length: f64, height: f64) -> Self {
        Self { origin, turn, length, height, openings: Vec::new() }
    }

    /// The world's place of `s` along, `y` up and `out` of the wall.
    pub fn point(&self, s: f64, y: f64, out: f64) -> Vec3 {
        let [x, z] = self.turn.apply([s, out]);
        add(self.origin, [x, y, z])
    }

    /// Into the room.
    pub fn normal(&self) -> Vec3 {
        let [x, z] = self.turn.apply([0.0, 1.0]);
        [x, 0.0, z]
    }

    /// True if something of a width and height there would cover an opening.
    pub fn hides(&self, s: f64, width: f64, height: f64, y: f64) -> bool {
        self.openings.iter().any(|o| {
            s + 0.5 * width > o[0] - 0.06
                && s - 0.5 * width < o[1] + 0.06
                && y < o[3] + 0.06
                && y + height > o[2] - 0.06
        })
    }
}

/// The materials of a room.
#[derive(Clone, Copy)]
pub struct Finishes {
    /// The floor.
    pub floor: Stuff,
    /// The walls.
    pub walls: Stuff,
    /// The ceiling.
    pub ceiling: Stuff,
}

/// A plain room.
pub const PLAIN: Finishes = Finishes { floor: Stuff::Wood, walls: Stuff::Plaster, ceiling: Stuff::Plaster };

/// A room: its floor, its walls (behind, right, before, left, seen from +z) and its inner size.
pub struct Room {
    /// The floor, a little smaller than the room.
    pub floor: Surface,
    /// Walls at -z, +x, +z and -x.
    pub walls: [Wall; 4],
    /// Inner box.
    pub inner: Aabb,
}

impl Room {
    /// Height of the ceiling.
    pub fn height(&self) -> f64 {
        self.inner.high[1]
    }

    /// A part of its box: shares from -1 to 1 of width and depth, heights in metres.
    pub fn part(&self, u: [f64; 2], y: [f64; 2], v: [f64; 2]) -> Aabb {
        let [x, z] = [0.5 * self.inner.size()[0], 0.5 * self.inner.size()[2]];
        Aabb { low: [u[0] * x, y[0], v[0] * z], high: [u[1] * x, y[1], v[1] * z] }
    }
}

/// A window that is to be: wall, middle along it, width, sill, height.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// Number of the wall.
    pub wall: usize,
    /// Its middle along the wall.
    pub s: f64,
    /// Its width.
    pub width: f64,
    /// Height of the sill.
    pub sill: f64,
    /// Its height.
    pub height: f64,
}

impl<'a> Stage<'a> {
    /// The four walls of a box room on the origin.
    fn walls(width: f64, height: f64, depth: f64) -> [Wall; 4] {
        let (x, z) = (0.5 * width, 0.5 * depth);
        [
            Wall::new([0.0, 0.0, -z], Turn::toward([0.0, 1.0]), width, height),
            Wall::new([x, 0.0, 0.0], Turn::toward([-1.0, 0.0]), depth, height),
            Wall::new([0.0, 0.0, z], Turn::toward([0.0, -1.0]), width, height),
            Wall::new([-x, 0.0, 0.0], Turn::toward([1.0, 0.0]), depth, height),
        ]
    }

    /// A closed room on the origin, floor at 0, with windows and, on a wall, a door.
    ///
    /// Floor and ceiling reach past the walls, and walls 1 cm past their corners, so that no crack shows the void.
    pub fn room(&mut self, size: [f64; 3], made: Finishes, windows: &[Window], door: Option<usize>) -> Room {
        let [width, height, depth] = size;
        let (x, z) = (0.5 * width, 0.5 * depth);
        let mut walls = Self::walls(width, height, depth);
        let past = 0.05;
        let corner = |sx: f64, sz: f64, y: f64| [sx * (x + past), y, sz * (z + past)];
        self.quad(
            "floor",
            made.floor,
            [corner(-1.0, 1.0, 0.0), corner(1.0, 1.0, 0.0), corner(1.0, -1.0, 0.0), corner(-1.0, -1.0, 0.0)],
        );
        self.quad(
            "ceiling",
            made.ceiling,
            [
                corner(-1.0, -1.0, height),
                corner(1.0, -1.0, height),
                corner(1.0, 1.0, height),
                corner(-1.0, 1.0, height),
            ],
        );
        for w in windows {
            let wall = &mut walls[w.wall];
            let most = 0.5 * wall.length - 0.15;
            let (from, to) = ((w.s - 0.5 * w.width).max(-most), (w.s + 0.5 * w.width).min(most));
            if to - from > 0.3 && !wall.hides(0.5 * (from + to), to - from, w.height, w.sill) {
                wall.openings.push([from, to, w.sill, (w.sill + w.height).min(height - 0.1)]);
            }
        }
        let inner = Aabb { low: [-x, 0.0, -z], high: [x, height, z] };
        self.world.solids.push(Solid {
            y: [height, height + 0.3],
            at: [0.0; 2],
            turn: Turn::NONE,
            half: [x + past, z + past],
        });
        self.inside = Some(inner);
        for (number, wall) in walls.iter().enumerate() {
            self.wall("walls", made.walls, wall, 0.2);
            for opening in wall.openings.clone() {
                self.window(wall, opening);
            }
            self.skirting(wall, number);
        }
        let mut room = Room { floor: Surface::flat([0.0; 3], [x - 0.02, z - 0.02], height - 0.02), walls, inner };
        if let Some(door) = door {
            self.door(&mut room, door);
        }
        room
    }

    /// A wall with its openings cut out, in the way of all things; its back is not seen.
    pub fn wall(&mut self, label: &str, stuff: Stuff, wall: &Wall, thick: f64) {
        let past = 0.01;
        let half = 0.5 * wall.length;
        let mut across = vec![-half - past, half + past];
        let mut up = vec![-past, wall.height + past];
        for o in &wall.openings {
            across.extend([o[0], o[1]]);
            up.extend([o[2], o[3]]);
        }
        across.sort_by(f64::total_cmp);
        up.sort_by(f64::total_cmp);
        let open = |s: f64, y: f64| wall.openings.iter().any(|o| s > o[0] && s < o[1] && y > o[2] && y < o[3]);
        for s in across.windows(2) {
            for y in up.windows(2) {
                if s[1] - s[0] < 1e-6 || y[1] - y[0] < 1e-6 || open(0.5 * (s[0] + s[1]), 0.5 * (y[0] + y[1])) {
                    continue;
                }
                let corners = [(s[0], y[0]), (s[1], y[0]), (s[1], y[1]), (s[0], y[1])];
                self.quad(label, stuff, corners.map(|(s, y)| wall.point(s, y, 0.0)));
                let middle = wall.point(0.5 * (s[0] + s[1]), 0.0, -0.5 * thick);
                self.world.solids.push(Solid {
                    y: [y[0], y[1]].map(|y| wall.origin[1] + y),
                    at: [middle[0], middle[2]],
                    turn: wall.turn,
                    half: [0.5 * (s[1] - s[0]), 0.5 * thick],
                });
            }
        }
    }

    /// The four sides of an opening, going in.
    pub fn reveal(&mut self, label: &str, stuff: Stuff, wall: &Wall, o: [f64; 4], deep: f64) {
        let p = |s: f64, y: f64, out: f64| wall.point(s, y, out);
        let back = -deep;
        self.quad(label, stuff, [p(o[0], o[2], 0.0), p(o[1], o[2], 0.0), p(o[1], o[2], back), p(o[0], o[2], back)]);
        self.quad(label, stuff, [p(o[0], o[3], back), p(o[1], o[3], back), p(o[1], o[3], 0.0), p(o[0], o[3], 0.0)]);
        self.quad(label, stuff, [p(o[0], o[2], 0.0), p(o[0], o[2], back), p(o[0], o[3], back), p(o[0], o[3], 0.0)]);
        self.quad(label, stuff, [p(o[1], o[2], back), p(o[1], o[2], 0.0), p(o[1], o[3], 0.0), p(o[1], o[3], back)]);
    }

    /// A window in an opening: reveal, frame, bars, a pane where the regime has glass, daylight behind, and before it
    /// curtains or a blind now and then.
    pub fn window(&mut self, wall: &Wall, o: [f64; 4]) {
        self.reveal("reveal", Stuff::Plaster, wall, o, 0.22);
        let (width, height) = (o[1] - o[0], o[3] - o[2]);
        let middle = 0.5 * (o[0] + o[1]);
        let half_up = 0.5 * height;
        let bar = |s: &mut Self, at: f64, y: f64, half: [f64; 2]| {
            let center = wall.point(at, y, -0.11);
            s.board(
                "frame",
                Stuff::PaintedMetal,
                Board { center, half: [half[0], half[1], 0.022], turn: wall.turn, ..Board::PLAIN },
            );
        };
        let edge = 0.03;
        bar(self, o[0] + edge, o[2] + half_up, [edge, half_up]);
        bar(self, o[1] - edge, o[2] + half_up, [edge, half_up]);
        bar(self, middle, o[2] + edge, [0.5 * width - 2.0 * edge, edge]);
        bar(self, middle, o[3] - edge, [0.5 * width - 2.0 * edge, edge]);
        let lights = (width / 0.9).ceil() as usize;
        for i in 1..lights {
            let s = o[0] + width * i as f64 / lights as f64;
            bar(self, s, o[2] + half_up, [0.02, half_up - 2.0 * edge]);
        }
        let bright = self.draw("outside", 4.0, 16.0);
        let panel = wall.point(middle, o[2] + half_up, -0.215);
        self.light(Light::Outside(panel, wall.normal(), [0.5 * width + 0.005, half_up + 0.005]), bright);
        if self.glassy() {
            let p = |s: f64, y: f64| wall.point(s, y, -0.15);
            self.quad("panes", Stuff::Pane, [p(o[0], o[2]), p(o[1], o[2]), p(o[1], o[3]), p(o[0], o[3])]);
        }
        // A sill on low walls.
        if o[2] > 0.3 {
            let center = wall.point(middle, o[2] - 0.02, -0.03);
            self.board(
                "sill",
                Stuff::Stone,
                Board { center, half: [0.5 * width + 0.05, 0.018, 0.07], turn: wall.turn, ..Board::PLAIN },
            );
        }
        let kind = if self.bare { 3 } else { self.next().below(4) };
        let tall = wall.height;
        match kind {
            0 => {
                let low = ask(Family::Curtain).named(&["curtain_single"]).most(1.4, tall - 0.05, 0.3).least(
                    0.1,
                    0.5 * height,
                    0.0,
                );
                if let Some(pick) = self.pick(&low) {
                    let y = (o[3] + 0.1).min(tall - 0.03) - pick.size[1];
                    for side in [-1.0, 1.0] {
                        let s = middle + side * 0.5 * (width + 0.4 * pick.size[0]);
                        let _ = self.hang_on(wall, &pick, [s, s], [y.max(0.02), y.max(0.02)], true);
                    }
                }
            }
            1 => {
                let low = ask(Family::Blind).most(width + 0.6, tall, 0.3).least(width + 0.04, 0.0, 0.0);
                if let Some(pick) = self.pick(&low) {
                    let y = (o[3] + 0.05).min(tall - 0.03) - pick.size[1];
                    let _ = self.hang_on(wall, &pick, [middle, middle], [y.max(0.02), y.max(0.02)], true);
                }
            }
            _ => {}
        }
    }

    fn skirting(&mut self, wall: &Wall, _number: usize) {
        // A door's frame or a low window would stand in it.
        if wall.openings.iter().any(|o| o[2] < 0.1) || self.choose("skirting", 3) == 0 {
            return;
        }
        let center = wall.point(0.0, 0.035, 0.004);
        self.facing("skirting", Stuff::Wood, center, [0.5 * wall.length, 0.035, 0.004], wall.turn, &[2, 4]);
    }

    /// A closed door in a wall, with its frame and handle, in the way of what would stand before it.
    pub fn door(&mut self, room: &mut Room, number: usize) {
        let wall = room.walls[number].clone();
        let most = 0.5 * wall.length - 0.65;
        let s = (self.stream.part("door").range(-0.8, 0.8) * most * 1e3).round() / 1e3;
        if most < 0.0 || wall.hides(s, 1.0, 2.1, 0.0) {
            return;
        }
        room.walls[number].openings.push([s - 0.5, s + 0.5, 0.0, 2.1]);
        let turn = wall.turn;
        self.board(
            "door",
            Stuff::Wood,
            Board { center: wall.point(s, 1.015, 0.012), half: [0.42, 1.01, 0.011], turn, ..Board::PLAIN },
        );
        for side in [-1.0, 1.0] {
            self.board(
                "frame",
                Stuff::PaintedMetal,
                Board {
                    center: wall.point(s + side * 0.46, 1.03, 0.02),
                    half: [0.035, 1.03, 0.019],
                    turn,
                    inset: [0.0, 2.0 * GAP, 0.0],
                },
            );
            self.board(
                "door",
                Stuff::Wood,
                Board {
                    center: wall.point(s + side * 0.2, 0.6, 0.027),
                    half: [0.14, 0.42, 0.004],
                    turn,
                    ..Board::PLAIN
                },
            );
            self.board(
                "door",
                Stuff::Wood,
                Board {
                    center: wall.point(s + side * 0.2, 1.55, 0.027),
                    half: [0.14, 0.35, 0.004],
                    turn,
                    ..Board::PLAIN
                },
            );
        }
        self.board(
            "frame",
            Stuff::PaintedMetal,
            Board { center: wall.point(s, 2.09, 0.02), half: [0.495, 0.03, 0.019], turn, ..Board::PLAIN },
        );
        self.board(
            "handle",
            Stuff::Metal,
            Board { center: wall.point(s + 0.34, 1.05, 0.05), half: [0.05, 0.01, 0.01], turn, ..Board::PLAIN },
        );
        self.board(
            "handle",
            Stuff::Metal,
            Board { center: wall.point(s + 0.38, 1.05, 0.032), half: [0.01, 0.01, 0.0085], turn, ..Board::PLAIN },
        );
        // Nothing stands in the way of the door.
        let free = wall.point(s, 0.0, 0.35);
        let (y, half) = ([0.0, 2.0], [0.45, 0.29]);
        self.world.keep.push(Solid { y, at: [free[0], free[2]], turn, half });
    }

    /// True if a box can be built there.
    pub fn roomy(&self, center: Vec3, half: Vec3) -> bool {
        self.world.free(&[Solid::of(&Aabb::around([0.0; 3], half), Turn::NONE, center)])
    }

    /// A lamp panel under a ceiling or a board: a flat body with a bright lower side.
    pub fn panel_lamp(&mut self, center: Vec3, half: [f64; 2], power: f64) {
        let body = add(center, [0.0, -0.021, 0.0]);
        if !self.roomy(body, [half[0] + 0.01, 0.02, half[1] + 0.01]) {
            return;
        }
        self.board(
            "lamps",
            Stuff::PaintedMetal,
            Board { center: body, half: [half[0] + 0.01, 0.02, half[1] + 0.01], ..Board::PLAIN },
        );
        self.light(Light::Panel(add(center, [0.0, -0.0425, 0.0]), [0.0, -1.0, 0.0], half), power);
    }

    /// A small spot in a short body under a ceiling, aimed at a place.
    pub fn spot_lamp(&mut self, at: Vec3, aim: Vec3, power: f64) {
        let body = add(at, [0.0, -0.042, 0.0]);
        if !self.roomy(body, [0.05, 0.04, 0.05]) {
            return;
        }
        self.board("lamps", Stuff::PaintedMetal, Board { center: body, half: [0.05, 0.04, 0.05], ..Board::PLAIN });
        self.light(Light::Spot(add(at, [0.0, -0.09, 0.0]), aim, 38.0), power);
    }

    /// Lamps under a ceiling as rooms have them: a lamp that hangs, panels, or spots in a grid.
    pub fn ceiling_lamps(&mut self, room: &Room, power: f64) {
        let (height, size) = (room.height(), room.inner.size());
        let kind = self.choose("ceiling.lamps", 3);
        if kind == 0 {
            let x = self.any(-0.15, 0.15) * size[0];
            let ask = ask(Family::CeilingLamp).most(1.2, height - 1.7, 1.2);
            if let Some(lamp) = self.hang(&ask, [x, 0.0], height, 0.0) {
                self.lit(Some(lamp), power);
                return;
            }
        }
        let (nx, nz) = ((size[0] / 2.2).round().max(1.0) as usize, (size[2] / 2.2).round().max(1.0) as usize);
        let count = (nx * nz) as f64;
        for i in 0..nx {
            for j in 0..nz {
                let x = size[0] * ((i as f64 + 0.5) / nx as f64 - 0.5);
                let z = size[2] * ((j as f64 + 0.5) / nz as f64 - 0.5);
                if kind == 1 {
                    self.panel_lamp([x, height, z], [0.3, 0.15], power / count);
                } else {
                    let at = [x, height, z];
                    self.spot_lamp(at, add(at, [0.15 * x.signum(), -1.0, 0.0]), power / count);
                }
            }
        }
    }

    /// Cameras as people stand in a room: from near its walls at eye height, and seated.
    pub fn room_eyes(&mut self, room: &Room, focus: Aabb) {
        let size = room.inner.size();
        let (x, z) = (0.5 * size[0] - 0.25, 0.5 * size[2] - 0.25);
        let tall = (room.height() - 0.3).min(1.75);
        let corners: Vec<Aabb> = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
            .iter()
            .map(|(sx, sz)| {
                let mut corner = Aabb::EMPTY;
                corner.grow([sx * x, 1.2f64.min(tall), sz * z]);
                corner.grow([sx * x * 0.3, tall, sz * z * 0.3]);
                corner
            })
            .collect();
        let c = focus.center();
        for corner in corners {
            // Corners that the focus is not in see it better.
            let m = corner.center();
            let far = ((m[0] - c[0]) * (m[0] - c[0]) + (m[2] - c[2]) * (m[2] - c[2])).sqrt();
            self.eye(0.2 + far, From::Box(corner), focus);
        }
        self.eye(0.5, From::Box(Aabb { low: [-x, 0.9, -z], high: [x, 1.3, z] }), focus);
    }
}
