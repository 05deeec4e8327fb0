//! Under arches and beams: colonnades, arcades, bridges, a balcony.

use super::{kit::*, town::facade};
use crate::scene_generation::{
    place::{GAP, SEAM, Surface, Turn},
    props::ask,
    shell::Wall,
    stage::{Board, From, Light, Stage},
};
use core::f64::consts::PI;
use tauflow_data::geom::{Aabb, add};
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// Columns in two rows under a roof, a stone floor, statues between.
pub fn colonnade(s: &mut Stage<'_>) {
    let stuff = s.one("ground", &[Stuff::Stone, Stuff::Tile]);
    let floor = ground(s, stuff, 25.0);
    let (wide, step, high) = (s.draw("width", 1.4, 2.2), s.draw("step", 1.5, 2.4), s.draw("height", 2.6, 3.6));
    let column = s.pick(&ask(F::Column).least(0.0, 1.6, 0.0).most(0.9, high, 0.9));
    let tall = column.as_ref().map_or(high, |c| c.size[1]);
    let rows = 5;
    for i in 0..rows {
        let at = step * (i as f64 - 0.5 * f64::from(rows - 1));
        for side in [-1.0, 1.0] {
            match &column {
                Some(column) if s.left() > 6 => {
                    let _ = s.put(column, &floor, [side * wide, at], 0.0);
                }
                _ => {
                    s.board(
                        "piers",
                        Stuff::Stone,
                        Board {
                            center: [side * wide, 0.5 * tall, at],
                            half: [0.16, 0.5 * tall, 0.16],
                            inset: [0.0, GAP, 0.0],
                            ..Board::PLAIN
                        },
                    );
                }
            }
        }
    }
    let long = 0.5 * step * f64::from(rows);
    for side in [-1.0, 1.0] {
        s.board(
            "entablature",
            Stuff::Stone,
            Board { center: [side * wide, tall + 0.173, 0.0], half: [0.28, 0.17, long], ..Board::PLAIN },
        );
    }
    s.board(
        "roof",
        Stuff::Wood,
        Board { center: [0.0, tall + 0.4005, 0.0], half: [wide + 0.35, 0.055, long + 0.1], ..Board::PLAIN },
    );
    let wall = s.one("back", &[Stuff::Plaster, Stuff::Brick, Stuff::Stone]);
    s.board(
        "back wall",
        wall,
        Board {
            center: [-wide - 1.4, 0.5 * (tall + 0.9), 0.0],
            half: [0.15, 0.5 * (tall + 0.9), long + 1.5],
            ..Board::PLAIN
        },
    );
    let top = plinth(s, Stuff::Stone, [0.0, -0.9], [0.3, 0.3], 0.85);
    s.main(&top, &[F::Sculpture, F::Vessel, F::Solid], [0.4, 0.9]);
    for i in 0..3 {
        let at = step * (f64::from(i) - 1.0);
        let lamp = s.hang(&ask(F::CeilingLamp).most(0.7, tall - 1.6, 0.7), [0.0, at], tall + 0.3455, 0.0);
        s.lit(lamp, 22.0);
        if lamp.is_none() {
            s.panel_lamp([0.0, tall + 0.345, at], [0.12, 0.12], 22.0);
        }
    }
    let walk = Surface::flat([0.0; 3], [wide - 0.3, long], 2.2);
    let n = s.some(9);
    s.scatter(
        &walk,
        &[
            ask(F::Sculpture).scaled(0.7, 1.5),
            ask(F::Bench),
            TALL_PLANT.most(1.0, 2.0, 1.0),
            ask(F::Vessel).scaled(0.4, 0.8),
            ask(F::Bush).most(0.9, 1.2, 0.9),
            ask(F::Leaves).most(0.6, 0.2, 0.6),
        ],
        n,
        ANY,
    );
    let focus = Aabb { low: [-wide, 0.6, -long], high: [wide, 2.0, 0.0] };
    s.eye(3.0, From::Box(Aabb { low: [-0.6 * wide, 1.3, 0.4 * long], high: [0.6 * wide, 1.8, 1.2 * long] }), focus);
    s.eye(2.0, From::Orbit([3.5, 6.0], [0.4, 1.9], [0.02, 0.3]), Aabb::around([0.0, 1.3, 0.0], [0.8, 0.5, 1.5]));
}

/// Arches along a front with shops behind: lamps under the vault, tables, signs.
pub fn arcade(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let stuff = s.one("ground", &[Stuff::Stone, Stuff::Tile, Stuff::Asphalt]);
    let floor = ground(s, stuff, 30.0);
    let (span, deep, high) = (s.draw("span", 1.8, 2.8), s.draw("depth", 2.0, 3.0), s.draw("height", 3.4, 4.2));
    let arches = 4;
    let half = 0.5 * span * f64::from(arches);
    let pier = 0.2;
    let stone = s.one("stone", &[Stuff::Stone, Stuff::Brick, Stuff::Plaster]);
    let radius = 0.5 * span - pier;
    let spring = high - radius - 0.55;
    for i in 0..=arches {
        let x = -half + span * f64::from(i);
        s.board(
            "arches",
            stone,
            Board { center: [x, 0.5 * spring, 0.0], half: [pier, 0.5 * spring, 0.22], ..Board::PLAIN },
        );
        // From here up the wall between the arches, in upright slices that follow the curves.
        if i == arches {
            break;
        }
        let c = x + 0.5 * span;
        let slices = 20;
        let at = |k: usize| {
            let a = PI * (1.0 - k as f64 / slices as f64);
            [c + radius * tauflow_data::maths::cos(a), spring + radius * tauflow_data::maths::sin(a)]
        };
        for k in 0..slices {
            let (p, q) = (at(k), at(k + 1));
            let quad = |z: f64| [[p[0], p[1], z], [q[0], q[1], z], [q[0], high, z], [p[0], high, z]];
            s.quad("arches", stone, quad(0.22));
            let mut behind = quad(-0.22);
            behind.reverse();
            s.quad("arches", stone, behind);
            s.quad("arches", stone, [[p[0], p[1], -0.22], [q[0], q[1], -0.22], [q[0], q[1], 0.22], [p[0], p[1], 0.22]]);
        }
        s.world.solids.push(crate::scene_generation::place::Solid {
            y: [high - 0.5, high],
            at: [c, 0.0],
            turn: Turn::NONE,
            half: [0.5 * span, 0.22],
        });
    }
    for i in 0..=arches {
        let x = -half + span * f64::from(i);
        s.board(
            "arches",
            stone,
            Board {
                center: [x, 0.5 * (spring + high), 0.0],
                half: [pier, 0.5 * (high - spring), 0.22],
                inset: [SEAM, 0.0, SEAM],
                ..Board::PLAIN
            },
        );
    }
    let z = -deep - 0.22;
    s.board(
        "upper",
        stone,
        Board {
            center: [0.0, high + 0.75, 0.0],
            half: [half + pier, 0.75, 0.22],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    s.board(
        "vault",
        Stuff::Plaster,
        Board {
            center: [0.0, high + 0.05, 0.5 * z - 0.12],
            half: [half + pier, 0.05, 0.5 * -z - 0.1],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    let wall = Wall::new([0.0, 0.0, z], Turn::NONE, 2.0 * half, high);
    facade(s, "shops", &wall, 1, arches as usize);
    let ends = s.one("ends", &[Stuff::Plaster, Stuff::Stone]);
    s.board(
        "end wall",
        ends,
        Board {
            center: [-half - pier - 0.07, 0.5 * high, 0.5 * z],
            half: [0.07, 0.5 * high, 0.5 * -z],
            inset: [SEAM, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    let walk = Surface::flat([0.0, 0.0, 0.5 * z], [half - 0.3, 0.5 * deep - 0.25], high - 0.5);
    let top = plinth(s, Stuff::Stone, [0.2 * half, 0.5 * z], [0.28, 0.28], 0.8);
    s.main(&top, &[F::Sculpture, F::Vessel, F::Solid], [0.4, 0.8]);
    for i in 0..arches {
        let x = -half + span * (f64::from(i) + 0.5);
        let lamp = s.hang(&ask(F::CeilingLamp).most(0.7, high - 2.2, 0.7), [x, 0.5 * z], high, 0.0);
        s.lit(lamp, 20.0);
        if lamp.is_none() {
            s.panel_lamp([x, high, 0.5 * z], [0.12, 0.12], 20.0);
        }
    }
    let n = s.some(8);
    s.scatter(
        &walk,
        &[
            ask(F::Table).most(0.9, 0.9, 0.9),
            CHAIR,
            CHAIR,
            TALL_PLANT,
            ask(F::Sign),
            ask(F::Bench),
            ask(F::Bicycle),
            BOX,
        ],
        n,
        ANY,
    );
    let before = floor.part([-0.1, 0.1], [0.03, 0.14]);
    let n = s.some(5);
    s.scatter(
        &before,
        &[ask(F::Bicycle), ask(F::Bench), ask(F::Tree).most(3.0, 5.0, 3.0), ask(F::Bin), TALL_PLANT],
        n,
        ANY,
    );
    let focus = Aabb { low: [-0.5 * half, 0.8, z], high: [0.5 * half, 2.0, 0.0] };
    s.eye(3.0, From::Box(Aabb { low: [-half, 1.3, 2.2], high: [half, 1.8, 5.5] }), focus);
    s.eye(
        2.0,
        From::Box(Aabb { low: [0.6 * half, 1.3, 0.8 * z], high: [0.95 * half, 1.8, 0.3 * z] }),
        Aabb { low: [-half, 0.8, z], high: [0.0, 1.8, 0.0] },
    );
}

/// A balcony with rail, table, plants in boxes, the wall of the house, lamps.
pub fn balcony(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let far = ground(s, Stuff::Grass, 60.0);
    let lift = 3.0;
    let (x, deep) = (s.draw("width", 1.5, 2.4), s.draw("depth", 1.5, 2.2));
    let stuff = s.one("slab", &[Stuff::Concrete, Stuff::Tile, Stuff::Wood]);
    let slab = s.board(
        "slab",
        stuff,
        Board { center: [0.0, lift - 0.1, 0.5 * deep], half: [x, 0.1, 0.5 * deep], ..Board::PLAIN },
    );
    let wall = s.one("house", &[Stuff::Brick, Stuff::Plaster, Stuff::Wood]);
    let mut house = Wall::new([0.0, 0.0, -0.001], Turn::NONE, 10.0, 7.0);
    house.openings =
        vec![[-0.9, 0.5, lift, lift + 2.15], [-4.0, -2.8, lift + 0.8, lift + 2.1], [2.8, 4.0, lift + 0.8, lift + 2.1]];
    s.wall("house", wall, &house, 0.3);
    for o in house.openings.clone() {
        s.reveal("reveal", Stuff::Plaster, &house, o, 0.2);
        let c = house.point(0.5 * (o[0] + o[1]), 0.5 * (o[2] + o[3]), -0.195);
        s.light(Light::Panel(c, [0.0, 0.0, 1.0], [0.5 * (o[1] - o[0]), 0.5 * (o[3] - o[2])]), 16.0);
        s.board(
            "frame",
            Stuff::PaintedMetal,
            Board {
                center: add(c, [0.0, 0.0, 0.06]),
                half: [0.03, 0.5 * (o[3] - o[2]), 0.02],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    for (a, b) in [([-x, deep], [x, deep]), ([-x, 0.0], [-x, deep]), ([x, 0.0], [x, deep])] {
        let n = (((b[0] - a[0]).abs() + (b[1] - a[1]).abs()) / 0.12).round() as usize;
        for i in 0..n {
            let t = (i as f64 + 0.5) / n as f64;
            let (cx, cz) = (a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t);
            s.board(
                "rail",
                Stuff::PaintedMetal,
                Board { center: [cx * 0.985, lift + 0.48, cz * 0.985], half: [0.007, 0.478, 0.007], ..Board::PLAIN },
            );
        }
        let (cx, cz) = (0.5 * (a[0] + b[0]) * 0.985, 0.5 * (a[1] + b[1]) * 0.985);
        let half = [0.5 * (b[0] - a[0]).abs() + 0.01, 0.02, 0.5 * (b[1] - a[1]).abs() + 0.01];
        s.board("rail", Stuff::Wood, Board { center: [cx, lift + 0.985, cz], half, ..Board::PLAIN });
    }
    let inner = Surface { clearance: 100.0, ..slab.inset(0.12) };
    let table = s.place(&ask(F::Table).most(1.0, 0.9, 1.0).least(0.4, 0.4, 0.4), &inner, [0.3, 0.1], 0.0);
    let top = match table.and_then(|t| s.top(t)) {
        Some(top) => top,
        None => bench(s, Stuff::Metal, [0.3, lift, 0.5 * deep + 0.1], [0.6, 0.7, 0.6], Turn::NONE),
    };
    s.main(&top, &[F::Vessel, F::Food, F::Ornament], [0.14, 0.3]);
    if !s.has_main {
        s.main(&inner, &[F::Sculpture, F::Toy, F::Instrument, F::Vessel], [0.2, 0.6]);
    }
    if let Some(table) = table {
        s.around(table, &CHAIR, 2, &inner);
    }
    string_lamps(s, [-x, lift + 2.2, 0.1], [x, lift + 2.2, deep - 0.1], 10, 26.0);
    let n = s.some(4);
    s.scatter(&top, &[VESSEL, FOOD, BOOK_LYING, PLATE, POT.most(0.25, 0.4, 0.25)], n, ANY);
    let n = s.some(8);
    s.scatter(
        &inner,
        &[
            POT,
            TALL_PLANT.most(0.8, 1.6, 0.8),
            POT,
            BOX.most(0.5, 0.5, 0.5),
            ask(F::Bicycle),
            ask(F::Rug).most(1.0, 0.05, 0.7),
        ],
        n,
        ANY,
    );
    let n = s.some(5);
    s.scatter(&far.part([-0.4, 0.4], [0.25, 0.7]), &[ask(F::Tree), ask(F::Bush)], n, ANY);
    let focus = Aabb { low: [-0.6, lift + 0.4, 0.1], high: [0.8, lift + 1.1, 0.8 * deep] };
    s.eye(3.0, From::Box(Aabb { low: [-x + 0.2, lift + 1.2, 0.2], high: [x - 0.2, lift + 1.75, deep - 0.2] }), focus);
    s.eye(2.0, From::Box(Aabb { low: [-x, lift + 0.9, deep + 0.6], high: [x, lift + 2.2, deep + 2.0] }), focus);
    s.look_at(1.0, &top, 0.3, [-1.3, 1.3], [0.2, 0.7]);
}

/// A bridge of stone over a stream, rails, lamps, walls of the banks.
pub fn bridge(s: &mut Stage<'_>) {
    let bed = ground(s, Stuff::Sand, 40.0);
    let (wide, span, high) = (s.draw("width", 1.1, 1.7), s.draw("span", 2.4, 3.6), s.draw("rise", 1.6, 2.2));
    let stone = s.one("stone", &[Stuff::Stone, Stuff::Brick, Stuff::Concrete]);
    let level = 0.3;
    let bank = 1.0;
    // Banks to both sides of the stream, which runs along z under the bridge that goes along x.
    let water = Stuff::Water;
    s.quad(
        "water",
        water,
        [
            [-span - 0.3, level, 40.0],
            [span + 0.3, level, 40.0],
            [span + 0.3, level, -40.0],
            [-span - 0.3, level, -40.0],
        ],
    );
    let mut shores = Vec::new();
    for side in [-1.0, 1.0] {
        let top = s.board(
            "bank",
            stone,
            Board { center: [side * (span + 6.3), 0.5 * bank, 0.0], half: [6.0, 0.5 * bank, 14.0], ..Board::PLAIN },
        );
        shores.push(top);
    }
    // The arch: a barrel in slices, and the road in steps above it.
    let slices = 24;
    let at = |k: usize| {
        let a = PI * (1.0 - k as f64 / slices as f64);
        [span * tauflow_data::maths::cos(a), (high - 0.35) * tauflow_data::maths::sin(a) + 0.05]
    };
    let road = |x: f64| bank + (high - bank) * (1.0 - (x / (span + 1.6)) * (x / (span + 1.6))).max(0.0);
    for k in 0..slices {
        let (p, q) = (at(k), at(k + 1));
        let (rp, rq) = (road(p[0]), road(q[0]));
        s.quad("bridge", stone, [[p[0], p[1], -wide], [q[0], q[1], -wide], [q[0], q[1], wide], [p[0], p[1], wide]]);
        s.quad("bridge", stone, [[p[0], p[1], wide], [q[0], q[1], wide], [q[0], rq, wide], [p[0], rp, wide]]);
        s.quad("bridge", stone, [[q[0], q[1], -wide], [p[0], p[1], -wide], [p[0], rp, -wide], [q[0], rq, -wide]]);
        s.quad("road", Stuff::Stone, [[p[0], rp, wide], [q[0], rq, wide], [q[0], rq, -wide], [p[0], rp, -wide]]);
        let (mid, low) = (0.5 * (p[0] + q[0]), p[1].min(q[1]));
        let top = rp.max(rq);
        let solid = crate::scene_generation::place::Solid {
            y: [low, top],
            at: [mid, 0.0],
            turn: Turn::NONE,
            half: [0.5 * (q[0] - p[0]), wide],
        };
        s.world.solids.push(solid);
        for side in [-1.0, 1.0] {
            let z = side * (wide - 0.1);
            let y = 0.5 * (rp + rq);
            s.board(
                "parapet",
                stone,
                Board {
                    center: [mid, y + 0.38, z],
                    half: [0.5 * (q[0] - p[0]) + 0.002, 0.45, 0.1],
                    inset: [0.0, 0.0, SEAM],
                    ..Board::PLAIN
                },
            );
        }
    }
    let on = shores[1].part([-0.98, -0.55], [-0.2, 0.25]);
    let [cx, _, cz] = on.center;
    let stand = s.board(
        "plinths",
        Stuff::Stone,
        Board { center: [cx, bank + 0.3, cz + 1.2], half: [0.35, 0.3, 0.35], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    s.main(&stand, &[F::Sculpture, F::Vessel, F::Solid, F::Rock], [0.5, 1.0]);
    let lamp = s.pick(&ask(F::StreetLamp).most(1.6, 5.0, 1.6));
    for shore in &shores {
        let near = if shore.center[0] > 0.0 { -0.9 } else { 0.9 };
        for v in [-0.16, 0.16] {
            let put = lamp.as_ref().and_then(|l| s.put(l, shore, [near * shore.half[0], v * shore.half[1]], 0.0));
            s.lit(put, 60.0);
            if put.is_none() {
                let [x, y, z] = shore.point([near * shore.half[0], v * shore.half[1]]);
                s.board(
                    "posts",
                    Stuff::Metal,
                    Board { center: [x, y + 1.2, z], half: [0.03, 1.2, 0.03], inset: [0.0, GAP, 0.0], ..Board::PLAIN },
                );
                s.light(Light::Ball([x, y + 2.48, z], 0.07), 40.0);
            }
        }
        let n = s.some(6);
        s.scatter(
            shore,
            &[
                ask(F::Tree).most(4.0, 7.0, 4.0),
                ask(F::Bush),
                ask(F::Bench),
                ask(F::Bin),
                ask(F::Bicycle),
                TALL_PLANT,
                ask(F::Fence).most(3.0, 1.4, 3.0),
            ],
            n,
            ANY,
        );
    }
    let shallow = Surface { half: [0.8 * span, 6.0], ..bed.clone() };
    let n = s.some(8);
    s.scatter(&Surface { clearance: 1.2, ..shallow }, &[ask(F::Rock).scaled(0.25, 0.9)], n, ANY);
    let focus = Aabb { low: [-0.6 * span, 0.6, -0.5], high: [0.6 * span, high + 0.3, 0.5] };
    s.eye(3.0, From::Orbit([5.5, 9.0], [-0.9, 0.9], [0.05, 0.3]), focus);
    s.eye(1.0, From::Box(Aabb { low: [span + 1.0, bank + 1.3, 2.0], high: [span + 3.0, bank + 1.8, 6.0] }), focus);
}

/// Under a bridge of concrete: piers, pipes, a lamp row, bins, a bicycle, light at both ends.
pub fn underpass(s: &mut Stage<'_>) {
    let stuff = s.one("ground", &[Stuff::Asphalt, Stuff::Concrete]);
    let floor = ground(s, stuff, 40.0);
    let (x, high, long) = (s.draw("width", 2.4, 3.8), s.draw("height", 2.8, 3.8), s.draw("length", 6.0, 10.0));
    let walls = s.one("walls", &[Stuff::Concrete, Stuff::Tile, Stuff::Brick]);
    let half = 0.5 * long;
    for side in [-1.0, 1.0] {
        s.board(
            "side walls",
            walls,
            Board {
                center: [side * (x + 0.3), 0.5 * high, 0.0],
                half: [0.3, 0.5 * high, half],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    s.board(
        "deck above",
        Stuff::Concrete,
        Board { center: [0.0, high + 0.4, 0.0], half: [x + 0.6, 0.4, half], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    for i in 0..4 {
        let z = long * ((f64::from(i) + 0.5) / 4.0 - 0.5);
        s.board(
            "ribs",
            Stuff::Concrete,
            Board { center: [0.0, high - 0.13, z - 0.5], half: [x, 0.129, 0.12], ..Board::PLAIN },
        );
        s.panel_lamp([0.6 * x, high, z], [0.06, 0.3], 20.0);
    }
    for k in 0..3 {
        let y = high - 0.35 - 0.14 * f64::from(k);
        s.board(
            "pipes",
            Stuff::Metal,
            Board { center: [-x + 0.06, y, 0.0], half: [0.045, 0.045, half], ..Board::PLAIN },
        );
    }
    let top = plinth(s, Stuff::Concrete, [-0.5 * x, -0.3], [0.3, 0.3], 0.5);
    s.main(&top, &[F::Sculpture, F::Vessel, F::MachinePart, F::Instrument], [0.35, 0.7]);
    let way = Surface::flat([0.0; 3], [x - 0.25, half + 1.0], 2.2);
    let n = s.some(13);
    s.scatter(
        &way,
        &[
            ask(F::Bin),
            ask(F::Bicycle),
            BOX,
            ask(F::Box).most(1.0, 1.1, 1.0),
            ask(F::Bench),
            ask(F::Rail),
            ask(F::Sign),
            ask(F::Leaves).most(0.6, 0.2, 0.6),
            ask(F::Paper),
        ],
        n,
        ANY,
    );
    let n = s.some(4);
    s.scatter(&floor.part([-0.2, 0.2], [-0.5, -0.25]), &[ask(F::Tree), ask(F::Bush), ask(F::Vehicle)], n, ANY);
    let focus = Aabb { low: [-0.6 * x, 0.6, -half], high: [0.6 * x, 1.6, 0.0] };
    s.eye(4.0, From::Box(Aabb { low: [-0.7 * x, 1.3, 0.2 * half], high: [0.7 * x, 1.8, half + 1.5] }), focus);
}
