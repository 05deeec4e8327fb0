//! Open grounds: building sites, car parks, playgrounds, roofs.

use super::kit::*;
use crate::scene_generation::{
    place::{GAP, SEAM, Surface, Turn},
    props::ask,
    shell::Wall,
    stage::{Board, From, Light, Stage},
};
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// Scaffold, planks, bricks, pipes, barriers, a machine, work lamps.
pub fn construction_site(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let stuff = s.one("ground", &[Stuff::Soil, Stuff::Sand, Stuff::Concrete]);
    let floor = ground(s, stuff, 30.0);
    let (x, high) = (s.draw("width", 2.4, 3.6), s.draw("height", 3.2, 4.6));
    let raw = s.one("walls", &[Stuff::Brick, Stuff::Concrete]);
    let mut wall = Wall::new([0.0, 0.0, -2.0], Turn::NONE, 2.0 * x + 2.0, high);
    wall.openings = vec![[-x + 0.2, -x + 1.3, 0.9, 2.2], [0.4, 1.4, 0.0, 2.1]];
    s.wall("raw wall", raw, &wall, 0.3);
    for o in wall.openings.clone() {
        s.reveal("raw wall", raw, &wall, o, 0.3);
    }
    let floors = (high / 2.0).floor() as usize;
    let bays = 3;
    for i in 0..=bays {
        let px = -x + 2.0 * x * f64::from(i) / f64::from(bays);
        for pz in [-1.75, -0.95] {
            s.board(
                "poles",
                Stuff::Metal,
                Board {
                    center: [px, 0.5 * high, pz],
                    half: [0.024, 0.5 * high, 0.024],
                    inset: [0.0, SEAM, 0.0],
                    ..Board::PLAIN
                },
            );
        }
        for k in 1..=floors {
            let py = 1.9 * k as f64;
            s.board(
                "poles",
                Stuff::Metal,
                Board { center: [px, py - 0.06, -1.35], half: [0.02, 0.02, 0.375], ..Board::PLAIN },
            );
        }
    }
    let mut decks = Vec::new();
    for k in 1..=floors {
        let py = 1.9 * k as f64;
        for j in 0..3 {
            let pz = -1.62 + 0.26 * f64::from(j);
            decks.push(s.board(
                "planks",
                Stuff::Wood,
                Board { center: [0.0, py - 0.015, pz], half: [x + 0.1, 0.02, 0.125], ..Board::PLAIN },
            ));
        }
        for rail in [0.5, 1.0] {
            s.board(
                "poles",
                Stuff::Metal,
                Board { center: [0.0, py + rail, -0.92], half: [x + 0.1, 0.018, 0.006], ..Board::PLAIN },
            );
        }
    }
    // A stack of boards and one of bricks.
    let pile = s.board(
        "timber",
        Stuff::Wood,
        Board { center: [-0.6 * x, 0.2, 0.6], half: [0.9, 0.2, 0.35], turn: Turn::new(0.2), inset: [0.0, SEAM, 0.0] },
    );
    let bricks = s.board(
        "bricks",
        Stuff::Brick,
        Board {
            center: [0.75 * x, 0.35, 0.2],
            half: [0.5, 0.35, 0.35],
            turn: Turn::new(-0.15),
            inset: [0.0, SEAM, 0.0],
        },
    );
    s.main(&bricks, &[F::MachinePart, F::Tool, F::Vessel, F::Rock], [0.3, 0.6]);
    let lamps = [[-x - 0.4, 1.6, 0.4], [x + 0.3, 1.9, -0.2]];
    for [lx, ly, lz] in lamps {
        s.board(
            "posts",
            Stuff::PaintedMetal,
            Board {
                center: [lx, 0.5 * ly, lz],
                half: [0.025, 0.5 * ly, 0.025],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
        // Two heads, one on the other: one lights the yard, one the wall. A panel stands clear of its head.
        for (up, aim, power) in [(0.105, [-0.4 * lx, -0.3, 1.0], 55.0), (0.306, [-0.3 * lx, 0.2, -1.0], 40.0)] {
            let turn = Turn::toward([aim[0], aim[2]]);
            s.board(
                "lamps",
                Stuff::PaintedMetal,
                Board { center: [lx, ly + up, lz], half: [0.13, 0.1, 0.04], turn, ..Board::PLAIN },
            );
            let [dx, dz] = turn.apply([0.0, 0.04 + 0.08 * f64::abs(aim[1]) + 0.002]);
            s.light(Light::Panel([lx + dx, ly + up, lz + dz], aim, [0.11, 0.08]), power);
        }
    }
    let n = s.some(5);
    s.scatter(&pile, &[TOOL, PART, ask(F::Box).most(0.5, 0.5, 0.5)], n, ANY);
    let yard = floor.part([-0.15, 0.15], [-0.02, 0.12]);
    let n = s.some(13);
    s.scatter(
        &yard,
        &[
            ask(F::Fence).most(3.0, 2.2, 3.0),
            ask(F::Box),
            ask(F::MachinePart).scaled(0.3, 0.9),
            ask(F::Bin),
            ask(F::Stair),
            ask(F::Rock).scaled(0.2, 0.7),
            ask(F::Vehicle).most(2.5, 2.6, 4.0),
            ask(F::Terrain).named(&["soil_heap"]).most(3.0, 1.6, 3.0),
            ask(F::Rail),
        ],
        n,
        ANY,
    );
    for deck in decks.iter().step_by(3) {
        s.scatter(
            &Surface { clearance: 1.0, ..deck.clone() },
            &[TOOL.most(0.4, 0.5, 0.22), BOX.most(0.4, 0.5, 0.24), ask(F::Vessel).most(0.22, 0.4, 0.22)],
            2,
            ABOUT,
        );
    }
    let focus = Aabb { low: [-0.6 * x, 0.4, -1.6], high: [0.6 * x, 2.0, 0.6] };
    s.eye(3.0, From::Box(Aabb { low: [-x - 0.5, 1.3, 2.6], high: [x + 0.5, 1.8, 5.5] }), focus);
    s.look_at(1.0, &bricks, 0.6, [-1.0, 1.0], [0.1, 0.6]);
}

/// Vehicles in their places, kerbs, hedges, lamps that are off.
pub fn car_park(s: &mut Stage<'_>) {
    let floor = ground(s, Stuff::Asphalt, 50.0);
    let gap = s.draw("gap", 2.5, 2.9);
    let rows = 4;
    for i in 0..=rows {
        let x = gap * (f64::from(i) - 0.5 * f64::from(rows));
        s.facing("marks", Stuff::Paper, [x, 0.0002, -0.2], [0.05, 0.0002, 2.4], Turn::NONE, &[2]);
    }
    s.board(
        "kerb",
        Stuff::Stone,
        Board { center: [0.0, 0.07, -3.1], half: [7.0, 0.07, 0.12], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    let taken = s.some(2).min(4);
    for i in 0..taken {
        let x = gap * (i as f64 - 0.5 * f64::from(rows) + 0.5);
        let jitter = s.any(-0.15, 0.15);
        let _ = s.place(&ask(F::Vehicle).most(2.3, 2.6, 5.0), &floor, [x, -0.2 + jitter], 0.0);
    }
    let top = plinth(s, Stuff::Concrete, [0.4 * gap, 2.2], [0.4, 0.4], 0.35);
    s.main(&top, &[F::Sculpture, F::Vessel, F::MachinePart, F::Solid, F::Instrument], [0.4, 0.9]);
    let green = floor.part([-0.14, 0.14], [-0.12, -0.068]);
    let n = s.some(8);
    s.scatter(&green, &[ask(F::Bush), ask(F::Tree).most(4.0, 7.0, 4.0), ask(F::Grass), ask(F::Bush)], n, ANY);
    let n = s.some(9);
    s.scatter(
        &floor.part([-0.11, 0.11], [0.0, 0.09]),
        &[ask(F::Bicycle), ask(F::Bin), BOX, ask(F::Sign), ask(F::StreetLamp), ask(F::Rail), ask(F::Bench)],
        n,
        ANY,
    );
    s.look_at(1.0, &top, 0.8, [-1.2, 1.2], [0.05, 0.4]);
    let focus = Aabb { low: [-2.5, 0.4, -1.0], high: [2.5, 1.2, 1.5] };
    s.eye(3.0, From::Box(Aabb { low: [-5.0, 1.3, 4.0], high: [5.0, 1.9, 7.5] }), focus);
}

/// Swings, a slide, a sand pit with toys, benches, a fence.
pub fn playground(s: &mut Stage<'_>) {
    let stuff = s.one("ground", &[Stuff::Grass, Stuff::Sand, Stuff::Soil]);
    let floor = ground(s, stuff, 40.0);
    let (pit, high) = (s.draw("pit", 0.9, 1.5), s.draw("frame", 1.9, 2.4));
    // A frame with swings.
    let x = -2.0;
    for side in [-1.0, 1.0] {
        s.board(
            "frame",
            Stuff::PaintedMetal,
            Board {
                center: [x + side * 1.3, 0.5 * high, -1.2],
                half: [0.04, 0.5 * high, 0.04],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    s.board(
        "frame",
        Stuff::PaintedMetal,
        Board { center: [x, high + 0.04, -1.2], half: [1.4, 0.04, 0.04], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    for k in [-0.6, 0.6] {
        for side in [-0.2, 0.2] {
            s.board(
                "ropes",
                Stuff::Metal,
                Board {
                    center: [x + k + side, 0.5 * (high + 0.47), -1.2],
                    half: [0.006, 0.5 * (high - 0.47), 0.006],
                    inset: [0.0, SEAM, 0.0],
                    ..Board::PLAIN
                },
            );
        }
        s.board(
            "swings",
            Stuff::Wood,
            Board { center: [x + k, 0.45, -1.2], half: [0.24, 0.02, 0.1], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
        );
    }
    // A slide: steps up, a sloping sheet of metal down.
    let (sx, sz) = (2.0, -1.4);
    for i in 0..5 {
        let y = 0.26 * f64::from(i + 1);
        s.board(
            "slide steps",
            Stuff::Wood,
            Board { center: [sx, y - 0.02, sz - 0.9 + 0.14 * f64::from(i)], half: [0.22, 0.02, 0.06], ..Board::PLAIN },
        );
    }
    for side in [-1.0, 1.0] {
        s.board(
            "slide posts",
            Stuff::PaintedMetal,
            Board {
                center: [sx + side * 0.26, 0.75, sz - 0.15],
                half: [0.025, 0.75, 0.025],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
        s.board(
            "slide posts",
            Stuff::PaintedMetal,
            Board {
                center: [sx + side * 0.26, 0.35, sz - 0.95],
                half: [0.025, 0.35, 0.025],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    s.board(
        "slide steps",
        Stuff::Wood,
        Board { center: [sx, 1.32, sz - 0.13], half: [0.22, 0.02, 0.2], ..Board::PLAIN },
    );
    for i in 0..8 {
        let (t, u) = (f64::from(i) / 8.0, f64::from(i + 1) / 8.0);
        let (a, b) = ([1.32 - 1.2 * t, sz + 0.08 + 2.0 * t], [1.32 - 1.2 * u, sz + 0.08 + 2.0 * u]);
        s.quad(
            "slide",
            Stuff::Metal,
            [[sx - 0.22, b[0], b[1]], [sx + 0.22, b[0], b[1]], [sx + 0.22, a[0], a[1]], [sx - 0.22, a[0], a[1]]],
        );
        let mid = 0.5 * (a[1] + b[1]);
        s.world.solids.push(crate::scene_generation::place::Solid {
            y: [0.0, a[0]],
            at: [sx, mid],
            turn: Turn::NONE,
            half: [0.25, 0.5 * (b[1] - a[1])],
        });
    }
    // The pit.
    let rim = 0.08;
    for (c, h) in [
        ([0.0, pit], [pit + rim, rim]),
        ([0.0, -pit], [pit + rim, rim]),
        ([pit, 0.0], [rim, pit - rim]),
        ([-pit, 0.0], [rim, pit - rim]),
    ] {
        s.board(
            "pit rim",
            Stuff::Wood,
            Board {
                center: [c[0], 0.12, 1.4 + c[1]],
                half: [h[0], 0.12, h[1]],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    let sand = s.board(
        "sand",
        Stuff::Sand,
        Board { center: [0.0, 0.03, 1.4], half: [pit - rim, 0.03, pit - rim], inset: [GAP, SEAM, GAP], ..Board::PLAIN },
    );
    s.main(&sand, &[F::Toy, F::Vessel, F::Solid, F::Rock], [0.2, 0.5]);
    let n = s.some(9);
    s.scatter(&sand, &[TOY, TOY.scaled(0.1, 0.35), SOLID.scaled(0.1, 0.3), ask(F::Rock).scaled(0.08, 0.2)], n, ANY);
    let n = s.some(9);
    s.scatter(
        &floor.part([-0.12, 0.12], [-0.12, 0.1]),
        &[ask(F::Bench), ask(F::Tree), ask(F::Bush), ask(F::Bin), ask(F::Bicycle), ask(F::Fence), TOY.scaled(0.2, 0.4)],
        n,
        ANY,
    );
    let focus = Aabb { low: [-1.4, 0.2, -0.6], high: [1.4, 1.0, 1.6] };
    s.eye(3.0, From::Orbit([3.5, 6.5], [-1.2, 1.2], [0.08, 0.4]), focus);
    s.look_at(1.0, &sand, 0.3, ROUND, [0.2, 0.7]);
}

/// A flat roof: parapet, deck chairs, plants in tubs, vents and pipes.
pub fn roof_terrace(s: &mut Stage<'_>) {
    let stuff = s.one("ground", &[Stuff::Wood, Stuff::Tile, Stuff::Concrete]);
    let (x, z) = (s.draw("width", 3.0, 4.5), s.draw("depth", 3.0, 4.5));
    let lift = 9.0;
    s.quad("ground", Stuff::Grass, [[-80.0, 0.0, 80.0], [80.0, 0.0, 80.0], [80.0, 0.0, -80.0], [-80.0, 0.0, -80.0]]);
    let top =
        s.board("roof", stuff, Board { center: [0.0, 0.5 * lift, 0.0], half: [x, 0.5 * lift, z], ..Board::PLAIN });
    let roof = Surface { clearance: 100.0, ..top.inset(0.35) };
    for (c, h) in [
        ([0.0, z - 0.1], [x, 0.1]),
        ([0.0, -z + 0.1], [x, 0.1]),
        ([x - 0.1, 0.0], [0.1, z - 0.2]),
        ([-x + 0.1, 0.0], [0.1, z - 0.2]),
    ] {
        s.board(
            "parapet",
            Stuff::Brick,
            Board {
                center: [c[0], lift + 0.35, c[1]],
                half: [h[0], 0.35, h[1]],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    s.board(
        "vent",
        Stuff::Metal,
        Board {
            center: [-0.6 * x, lift + 0.5, -0.65 * z],
            half: [0.35, 0.5, 0.3],
            turn: Turn::new(0.1),
            inset: [0.0, SEAM, 0.0],
        },
    );
    let table = s.place(&ask(F::Table).most(1.6, 0.95, 1.2), &roof, [0.2, 0.1], 0.2);
    let on = match table.and_then(|t| s.top(t)) {
        Some(on) => on,
        None => bench(s, Stuff::Wood, [0.2, lift, 0.1], [1.0, 0.7, 0.7], Turn::NONE),
    };
    s.main(&on, &[F::Vessel, F::Food, F::Ornament, F::Instrument], [0.15, 0.35]);
    if let Some(table) = table {
        s.around(table, &CHAIR, 4, &roof);
    }
    let n = s.some(4);
    s.scatter(&on, &[VESSEL, FOOD, PLATE, BOOK_LYING], n, ANY);
    let n = s.some(13);
    s.scatter(
        &roof,
        &[
            TALL_PLANT,
            POT.most(0.9, 0.9, 0.9),
            ask(F::Bush).most(1.2, 1.2, 1.2),
            CHAIR,
            BOX,
            ask(F::Sofa).most(2.0, 1.2, 1.2),
            ask(F::Bench),
            ask(F::Cushion),
        ],
        n,
        ANY,
    );
    // Other roofs about.
    for (i, (bx, bz)) in [(-14.0, -16.0), (4.0, -20.0), (16.0, -9.0), (-18.0, 4.0)].into_iter().enumerate() {
        let high = s.draw(&format!("block.{i}"), 5.0, 13.0);
        s.board(
            "blocks",
            Stuff::Brick,
            Board { center: [bx, 0.5 * high, bz], half: [4.5, 0.5 * high, 4.0], ..Board::PLAIN },
        );
    }
    let focus = Aabb { low: [-0.8, lift + 0.4, -0.8], high: [0.8, lift + 1.1, 0.8] };
    s.eye(3.0, From::Box(Aabb { low: [-x + 0.5, lift + 1.3, 0.3 * z], high: [x - 0.5, lift + 1.8, z - 0.4] }), focus);
    s.look_at(1.0, &on, 0.3, [-1.4, 1.4], [0.1, 0.6]);
}
