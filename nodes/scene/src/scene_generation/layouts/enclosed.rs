//! Enclosed layouts: closed rooms, lit from inside; no environment.

use super::Template;
use crate::{
    geom::Vec3,
    scene_generation::stage::{Role, Stage},
};

pub(super) const TEMPLATES: [Template; 5] = [
    ("box_room", box_room),
    ("cornell", cornell),
    ("corridor", corridor),
    ("panel_room", panel_room),
    ("partition", partition),
];

/// The camera stands before the objects, towards +z.
fn look_in(s: &mut Stage, side: f64) {
    s.view.azimuth = [-side, side];
    s.view.elevation = [0.05, 0.4];
}

/// Moves every spot but the first so that it stays off the walls.
fn keep_in(s: &mut Stage, half: [f64; 2]) {
    for spot in &mut s.spots {
        for (axis, half) in [(0, half[0]), (2, half[1])] {
            let most = (half - 0.62 * spot.size).max(0.0);
            spot.position[axis] = spot.position[axis].clamp(-most, most);
        }
    }
}

fn main_place(s: &mut Stage, depth: f64) -> Vec3 {
    [s.draw("main.x", -0.25, 0.25), 0.0, s.draw("main.z", -0.18, -0.02) * depth]
}

/// A room with a lamp under the ceiling.
fn box_room(s: &mut Stage, others: usize) {
    let (w, h, d) = (s.draw("room.width", 3.2, 4.8), s.draw("room.height", 2.4, 3.2), s.draw("room.depth", 4.0, 5.5));
    s.room(w, h, d);
    let lamps = 1 + s.choose("lamps", 2);
    for k in 0..lamps {
        let x = s.draw(&format!("lamp.{k}.x"), -0.25, 0.25) * w;
        let z = s.draw(&format!("lamp.{k}.z"), -0.25, 0.2) * d;
        let half = [s.draw(&format!("lamp.{k}.half_x"), 0.2, 0.6), s.draw(&format!("lamp.{k}.half_z"), 0.2, 0.6)];
        s.light(&format!("lamp.{k}"), [x, h - 0.04, z], [x, 0.0, z], half, [40.0, 90.0]);
    }
    let at = main_place(s, d);
    s.ring(at, [0.9, 1.2], [0.4, 0.7], others);
    keep_in(s, [0.5 * w, 0.5 * d]);
    look_in(s, 0.5);
}

/// The Cornell box: cubic, coloured side walls, one square lamp.
fn cornell(s: &mut Stage, others: usize) {
    let size = s.draw("box.size", 2.4, 3.0);
    let depth = size * s.draw("box.depth", 1.35, 1.7);
    s.room(size, size, depth);
    let half = s.draw("lamp.half", 0.25, 0.5);
    let z = s.draw("lamp.z", -0.2, 0.0) * depth;
    s.light("lamp", [0.0, size - 0.03, z], [0.0, 0.0, z], [half, half], [30.0, 60.0]);
    let at = [s.draw("main.x", -0.3, 0.3), 0.0, -0.2 * depth];
    s.ring(at, [0.8, 1.1], [0.4, 0.6], others);
    keep_in(s, [0.5 * size, 0.5 * depth]);
    look_in(s, 0.12);
    s.view.elevation = [0.1, 0.25];
}

/// A long corridor with lamps in a row along the ceiling, and a niche wall at its end.
fn corridor(s: &mut Stage, others: usize) {
    let (w, h, d) = (s.draw("room.width", 2.4, 3.2), s.draw("room.height", 2.3, 2.9), s.draw("room.depth", 7.0, 10.0));
    s.room(w, h, d);
    let lamps = 2 + s.choose("lamps", 3);
    let half = [s.draw("lamps.half_x", 0.15, 0.5), s.draw("lamps.half_z", 0.1, 0.35)];
    let power = s.draw("lamps.power", 20.0, 45.0);
    for k in 0..lamps {
        let z = d * ((k as f64 + 0.5) / lamps as f64 - 0.5) * 0.9;
        s.lights.push(crate::scene_generation::stage::Light {
            position: [0.0, h - 0.04, z],
            aim: [0.0, 0.0, z],
            half,
            power,
            spot: false,
        });
    }
    let at = [s.draw("main.x", -0.2, 0.2), 0.0, s.draw("main.z", -0.1, 0.12) * d];
    s.ring(at, [0.8, 1.1], [0.35, 0.55], others);
    keep_in(s, [0.5 * w, 0.5 * d]);
    look_in(s, 0.25);
    s.view.elevation = [0.06, 0.25];
}

/// A room lit by upright panels on its side walls, with a low plinth.
fn panel_room(s: &mut Stage, others: usize) {
    let (w, h, d) = (s.draw("room.width", 3.4, 4.6), s.draw("room.height", 2.4, 3.0), s.draw("room.depth", 4.0, 5.2));
    s.room(w, h, d);
    let panels = 1 + s.choose("panels", 3);
    for k in 0..panels {
        let side = if k % 2 == 0 { -1.0 } else { 1.0 };
        let z = s.draw(&format!("panel.{k}.z"), -0.3, 0.3) * d;
        let half = [s.draw(&format!("panel.{k}.half_z"), 0.15, 0.45), s.draw(&format!("panel.{k}.half_y"), 0.4, 0.8)];
        let at = [side * (0.5 * w - 0.04), s.draw(&format!("panel.{k}.y"), 1.0, 1.4), z];
        s.light(&format!("panel.{k}"), at, [0.0, at[1], z], half, [30.0, 70.0]);
    }
    let rise = s.draw("plinth.rise", 0.1, 0.3);
    let at = main_place(s, d);
    s.plinth([at[0], 0.5 * rise, at[2]], [0.75, 0.5 * rise, 0.75]);
    s.ring(at, [0.8, 1.1], [0.35, 0.6], others);
    s.spots[0].position[1] = rise;
    for spot in &mut s.spots[1..] {
        let (dx, dz) = (spot.position[0] - at[0], spot.position[2] - at[2]);
        let far = (dx * dx + dz * dz).sqrt();
        let least = 1.08 + 0.6 * spot.size;
        if far < least {
            spot.position[0] = at[0] + dx * least / far;
            spot.position[2] = at[2] + dz * least / far;
        }
    }
    keep_in(s, [0.5 * w, 0.5 * d]);
    look_in(s, 0.5);
}

/// Two rooms in one: a wall with an opening between the lamp and part of the scene, so that much light comes in turns.
fn partition(s: &mut Stage, others: usize) {
    let (w, h, d) = (s.draw("room.width", 4.2, 5.4), s.draw("room.height", 2.4, 3.0), s.draw("room.depth", 4.0, 5.4));
    s.room(w, h, d);
    let x = s.draw("wall.x", 0.1, 0.22) * w;
    let opening = s.draw("opening.half", 0.5, 0.9);
    let z = s.draw("opening.z", -0.1, 0.1) * d;
    let (back, front) = (-0.5 * d, 0.5 * d);
    let thick = 0.05;
    for (low, high) in [(back, z - opening), (z + opening, front)] {
        s.block([x, 0.5 * h, 0.5 * (low + high)], [thick, 0.5 * h, 0.5 * (high - low)], Role::Wall(1));
    }
    let lintel = s.draw("opening.height", 1.7, 2.1).min(h - 0.1);
    s.block([x, 0.5 * (h + lintel), z], [thick, 0.5 * (h - lintel), opening], Role::Wall(1));
    let half = s.draw("lamp.half", 0.25, 0.5);
    let lamp_x = 0.5 * (x + 0.5 * w);
    s.light("lamp", [lamp_x, h - 0.04, z], [lamp_x, 0.0, z], [half, half], [90.0, 180.0]);
    let fill = s.draw("fill.half", 0.12, 0.25);
    s.light("fill", [-0.3 * w, h - 0.04, -0.2 * d], [-0.3 * w, 0.0, -0.2 * d], [fill, fill], [8.0, 25.0]);
    let at = [s.draw("main.x", -0.2, -0.1) * w, 0.0, s.draw("main.z", -0.15, 0.0) * d];
    s.ring(at, [0.8, 1.1], [0.35, 0.6], others);
    for spot in &mut s.spots {
        let most = x - thick - 0.62 * spot.size;
        spot.position[0] = spot.position[0].min(most);
    }
    keep_in(s, [0.5 * w, 0.5 * d]);
    s.view.room = s.view.room.map(|mut room| {
        room.high[0] = x - thick;
        room
    });
    s.view.azimuth = [-0.7, 0.2];
    s.view.elevation = [0.05, 0.35];
}
