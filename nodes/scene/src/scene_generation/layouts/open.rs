//! Open layouts of many bounces: walls, columns and tables under lamps and a dim sky.

use super::Template;
use crate::{
    geom::{compose, direction, scaling, translation},
    scene_generation::{
        forms::normalised,
        stage::{Role, Stage},
        surfaces::{boxes, lathe},
    },
};
use tauflow_data::Regime;

pub(super) const TEMPLATES: [Template; 5] =
    [("courtyard", courtyard), ("colonnade", colonnade), ("table", table), ("passage", passage), ("podium", podium)];

fn sky(s: &mut Stage) {
    // A caustic must not drown in skylight.
    let most = if s.regime == Regime::L3 { 0.25 } else { 0.6 };
    s.sky = s.draw("sky.level", 0.08, most);
}

/// Ground, a back wall, one or two side walls, a lamp overhead.
fn courtyard(s: &mut Stage, others: usize) {
    let (half, height) = (s.draw("yard.half", 1.8, 2.6), s.draw("wall.height", 1.6, 3.0));
    s.panel([0.0; 3], [0.0, 1.0, 0.0], [3.0 * half, 3.0 * half], Role::Floor);
    s.block([0.0, 0.5 * height, -half - 0.1], [half + 0.2, 0.5 * height, 0.1], Role::Wall(2));
    let sides = s.choose("sides", 3);
    if sides != 1 {
        s.block([-half - 0.1, 0.5 * height, 0.0], [0.1, 0.5 * height, half], Role::Wall(0));
    }
    if sides != 0 {
        s.block([half + 0.1, 0.5 * height, 0.0], [0.1, 0.5 * height, half], Role::Wall(1));
    }
    let at = [s.draw("lamp.x", -1.2, 1.2), s.draw("lamp.y", 2.6, 3.6), s.draw("lamp.z", -0.4, 1.0)];
    let half_lamp = s.draw("lamp.half", 0.3, 0.7);
    s.light("lamp", at, [0.0, 0.3, 0.0], [half_lamp, half_lamp], [60.0, 140.0]);
    s.ring([0.0; 3], [0.9, 1.3], [0.4, 0.7], others);
    sky(s);
    s.view.azimuth = match sides {
        0 => [0.0, 0.9],
        1 => [-0.9, 0.0],
        _ => [-0.5, 0.5],
    };
    s.view.elevation = [0.12, 0.55];
}

/// Two rows of columns with a lintel each; light comes in from one side.
fn colonnade(s: &mut Stage, others: usize) {
    let (gap, aisle) = (s.draw("columns.gap", 1.1, 1.6), s.draw("aisle.half", 1.3, 1.8));
    let (height, thick) = (s.draw("columns.height", 2.2, 3.0), s.draw("columns.radius", 0.12, 0.2));
    s.panel([0.0; 3], [0.0, 1.0, 0.0], [8.0, 8.0], Role::Floor);
    let profile =
        [[0.0, 0.0], [1.3, 0.0], [1.3, 0.25], [1.0, 0.5], [1.0, 4.0], [0.9, 8.0], [1.3, 8.6], [1.3, 9.0], [0.0, 9.0]];
    let (column, bounds) = normalised(lathe(&profile, 24, 36));
    let size = bounds.size();
    let to = scaling([2.0 * thick / size[0], height / size[1], 2.0 * thick / size[2]]);
    for side in [-1.0, 1.0] {
        for k in -2..=2 {
            let at = translation([side * aisle, 0.0, gap * f64::from(k)]);
            s.mesh(column.clone(), compose(&at, &to), Role::Furniture, Some(bounds));
        }
        s.block([side * aisle, height + 0.15, 0.0], [1.6 * thick, 0.15, 2.6 * gap], Role::Wall(0));
    }
    let azimuth = s.draw("lamp.azimuth", -0.6, 0.6);
    let side = if s.choose("lamp.side", 2) == 0 { 1.0 } else { -1.0 };
    let from = direction(side * (core::f64::consts::FRAC_PI_2 + azimuth), 0.0);
    let lamp_height = s.draw("lamp.y", 1.6, 3.2);
    let half = s.draw("lamp.half", 0.5, 0.9);
    s.light("lamp", [from[0] * 3.6, lamp_height, from[2] * 3.6], [0.0, 0.4, 0.0], [half, half], [120.0, 260.0]);
    s.ring([0.0; 3], [0.9, 1.2], [0.35, 0.55], others);
    sky(s);
    s.view.azimuth = [-0.45, 0.45];
    s.view.elevation = [0.08, 0.35];
}

/// A table before a wall, two soft boxes.
fn table(s: &mut Stage, others: usize) {
    let (half, depth, height) =
        (s.draw("table.half", 1.1, 1.6), s.draw("table.depth", 0.9, 1.2), s.draw("table.y", 0.6, 0.9));
    s.panel([0.0; 3], [0.0, 1.0, 0.0], [6.0, 6.0], Role::Floor);
    let leg = 0.06;
    let mut parts = vec![([0.0, height - 0.04, 0.0], [half, 0.04, depth])];
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let (x, z) = (x * (half - 2.0 * leg), z * (depth - 2.0 * leg));
        parts.push(([x, 0.5 * height - 0.04, z], [leg, 0.5 * height - 0.04, leg]));
    }
    s.mesh(boxes(&parts), Stage::HERE, Role::Furniture, None);
    let wall = s.draw("wall.z", 1.5, 2.4);
    let tall = s.draw("wall.height", 2.4, 3.4);
    s.block([0.0, 0.5 * tall, -wall - 0.1], [4.0, 0.5 * tall, 0.1], Role::Wall(2));
    for (name, side) in [("key", 1.0), ("fill", -1.0)] {
        let at = [
            side * s.draw(&format!("{name}.x"), 1.2, 2.2),
            s.draw(&format!("{name}.y"), 2.2, 3.2),
            s.draw(&format!("{name}.z"), 0.2, 1.8),
        ];
        let size = s.draw(&format!("{name}.half"), 0.25, 0.6);
        let power = if name == "key" { [70.0, 130.0] } else { [10.0, 50.0] };
        s.light(name, at, [0.0, height, 0.0], [size, size], power);
    }
    s.ring([0.0, height, 0.0], [0.6, 0.85], [0.25, 0.45], others);
    keep_on(s, half - 0.1, depth - 0.1);
    sky(s);
    s.view.azimuth = [-0.7, 0.7];
    s.view.elevation = [0.15, 0.6];
}

/// Pulls objects in so that they stay on a table top.
fn keep_on(s: &mut Stage, half: f64, depth: f64) {
    for spot in &mut s.spots[1..] {
        let reach = 0.5 * spot.size;
        let shrink = ((half - reach) / spot.position[0].abs().max(1e-9))
            .min((depth - reach) / spot.position[2].abs().max(1e-9))
            .min(1.0);
        spot.position[0] *= shrink;
        spot.position[2] *= shrink;
        spot.size = spot.size.min(0.45);
    }
}

/// Two long walls, open at the ends and above, with a strip light across.
fn passage(s: &mut Stage, others: usize) {
    let (half, height) = (s.draw("passage.half", 1.4, 2.0), s.draw("wall.height", 2.0, 3.2));
    s.panel([0.0; 3], [0.0, 1.0, 0.0], [6.0, 8.0], Role::Floor);
    for (number, side) in [(0, -1.0), (1, 1.0)] {
        s.block([side * (half + 0.1), 0.5 * height, 0.0], [0.1, 0.5 * height, 5.0], Role::Wall(number));
    }
    let back = s.choose("back", 2);
    if back == 1 {
        s.block([0.0, 0.3 * height, -4.0], [half, 0.3 * height, 0.1], Role::Wall(2));
    }
    let z = s.draw("strip.z", -0.8, 0.8);
    let wide = s.draw("strip.half", 0.12, 0.3);
    s.light("strip", [0.0, height + 0.1, z], [0.0, 0.0, 0.3 * z], [0.8 * half, wide], [60.0, 140.0]);
    s.ring([0.0; 3], [0.9, 1.2], [0.35, 0.6], others);
    for spot in &mut s.spots[1..] {
        let most = half - 0.5 * spot.size - 0.05;
        spot.position[0] = spot.position[0].clamp(-most, most);
    }
    sky(s);
    s.view.azimuth = [-0.35, 0.35];
    s.view.elevation = [0.1, 0.4];
}

/// A round platform before an angled screen, lit by spots (or lamps, where caustics want a light that can be hit).
fn podium(s: &mut Stage, others: usize) {
    s.panel([0.0; 3], [0.0, 1.0, 0.0], [6.0, 6.0], Role::Floor);
    let (radius, rise) = (s.draw("platform.radius", 1.3, 1.9), s.draw("platform.rise", 0.08, 0.25));
    let (slab, bounds) =
        normalised(lathe(&[[0.0, 0.0], [1.0, 0.0], [1.0, 0.02], [1.0, 0.18], [1.0, 0.2], [0.0, 0.2]], 48, 20));
    let size = bounds.size();
    s.mesh(slab, scaling([2.0 * radius / size[0], rise / size[1], 2.0 * radius / size[2]]), Role::Furniture, None);
    let screens = 2 + s.choose("screens", 3);
    let (far, tall) = (s.draw("screen.distance", 2.1, 2.8), s.draw("screen.height", 1.8, 2.8));
    for k in 0..screens {
        let angle = core::f64::consts::PI + 0.75 * (k as f64 - 0.5 * (screens as f64 - 1.0));
        let toward = direction(angle, 0.0);
        let center = [toward[0] * far, 0.5 * tall, toward[2] * far];
        let inward = [-toward[0], 0.0, -toward[2]];
        s.panel(center, inward, [0.36 * far, 0.5 * tall], Role::Wall((k % 3) as u8));
    }
    let count = 1 + s.choose("spots", 3);
    for k in 0..count {
        let azimuth = s.draw(&format!("spot.{k}.azimuth"), -1.3, 1.3);
        let at = direction(azimuth, 0.9);
        let far = s.draw(&format!("spot.{k}.distance"), 3.0, 4.0);
        let power = s.draw(&format!("spot.{k}.power"), 50.0, 120.0);
        s.lights.push(crate::scene_generation::stage::Light {
            position: [at[0] * far, at[1] * far, at[2] * far],
            aim: [0.0, 0.4, 0.0],
            half: [0.3, 0.3],
            power,
            spot: true,
        });
    }
    s.ring([0.0, rise, 0.0], [0.9, 1.2], [0.35, 0.6], others);
    keep_on(s, radius * 0.75, radius * 0.75);
    sky(s);
    s.view.azimuth = [-0.9, 0.9];
    s.view.elevation = [0.12, 0.6];
}
