//! Set-ups: light through glass and off metal, things on show, games, a table out of doors.

use super::{
    kit::*,
    tables::{about_room, low_lamp, table},
};
use crate::scene_generation::{
    place::{GAP, SEAM, Surface, Turn},
    props::{Ask, ask},
    stage::{Board, Light, Stage},
};
use core::f64::consts::PI;
use tauflow_data::geom::{Aabb, Vec3};
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// Glasses on a table under a small lamp.
pub fn glass_table(s: &mut Stage<'_>) {
    let room = about_room(s, false);
    let top = table(s, [0.7, 1.1], [0.5, 0.8]);
    let mid = top.part([-0.75, 0.75], [-0.75, 0.75]);
    s.main(&mid, &[F::Vessel, F::Solid, F::Ornament], [0.12, 0.26]);
    let above = [s.any(-0.2, 0.2), 0.74 + s.draw("lamp.height", 0.55, 0.85), -0.2];
    low_lamp(s, above, room.height(), 20.0);
    let n = s.some(12);
    let glass = Ask { glass: true, ..ask(F::Vessel).most(0.2, 0.35, 0.2) };
    let solid = Ask { glass: true, ..SOLID };
    s.scatter(&mid, &[glass, glass, glass, solid, FOOD, PLATE, UTENSIL], n, ANY);
    s.ceiling_lamps(&room, 2.0);
    let _ = s.against(&room.walls[0], &room.floor.clone(), &ask(F::Cabinet).most(1.2, 1.4, 0.5), [-0.8, 0.8]);
    s.look_at(4.0, &mid, 0.25, ROUND, [0.2, 0.9]);
}

/// A prism, balls and lenses in a beam on a pale table.
pub fn prism(s: &mut Stage<'_>) {
    let room = about_room(s, false);
    let size = [s.draw("table.width", 0.9, 1.3), 0.74, s.draw("table.depth", 0.6, 0.8)];
    let top = bench(s, Stuff::Paper, [0.0, 0.0, -0.2], size, Turn::NONE);
    // A screen that stands behind, to catch what light is thrown about.
    let back = top.center[2] - top.half[1] + 0.012;
    s.board(
        "screen",
        Stuff::Plaster,
        Board {
            center: [0.0, top.center[1] + 0.2, back],
            half: [0.9 * top.half[0], 0.2, 0.01],
            inset: [0.0, GAP, 0.0],
            ..Board::PLAIN
        },
    );
    let mid = top.part([-0.6, 0.6], [-0.5, 0.6]);
    s.main(&mid, &[F::Solid], [0.08, 0.18]);
    let solid = Ask { glass: true, ..SOLID };
    let n = s.some(9);
    s.scatter(&mid, &[solid, solid, ask(F::MachinePart).most(0.15, 0.15, 0.15), solid], n, ANY);
    let from = [s.draw("beam.x", -0.9, 0.9), 0.74 + s.draw("beam.height", 0.5, 0.9), 0.35];
    s.board(
        "lamps",
        Stuff::PaintedMetal,
        Board { center: [from[0], from[1] + 0.075, from[2]], half: [0.05, 0.04, 0.05], ..Board::PLAIN },
    );
    let stem = 0.5 * (room.height() - from[1] - 0.116);
    s.board(
        "cord",
        Stuff::Metal,
        // Its middle is lower by the gap to the ceiling. An inset would also part it from the lamp, and change scenes.
        Board { center: [from[0], room.height() - stem - GAP, from[2]], half: [0.01, stem, 0.01], ..Board::PLAIN },
    );
    s.light(Light::Disk(from, [-from[0], 0.74 - from[1], -0.2 - from[2]], 0.045), 30.0);
    s.scatter(&top, &[PAPER, PEN, BOOK_LYING], 3, ABOUT);
    s.ceiling_lamps(&room, 1.5);
    s.look_at(4.0, &mid, 0.2, [-1.0, 1.0], [0.15, 0.8]);
}

/// Rings and bowls of metal under a lamp: the curved lines of light inside them.
pub fn metal_ring(s: &mut Stage<'_>) {
    let room = about_room(s, false);
    let top = table(s, [0.7, 1.0], [0.5, 0.7]);
    let mid = top.part([-0.7, 0.7], [-0.7, 0.7]);
    // A band of metal on the table, open at the top.
    let (radius, high) = (s.draw("ring.radius", 0.06, 0.13), s.draw("ring.height", 0.03, 0.08));
    let around = 48;
    let (cx, cz, y) = (s.draw("ring.x", -0.15, 0.1), mid.center[2], mid.center[1] + 0.001);
    let at = |i: usize, r: f64, h: f64| -> Vec3 {
        let a = 2.0 * PI * i as f64 / around as f64;
        [cx + r * tauflow_data::maths::sin(a), y + h, cz + r * tauflow_data::maths::cos(a)]
    };
    for i in 0..around {
        let (o, n) = (radius, radius - 0.004);
        s.quad("ring", Stuff::Mirror, [at(i, o, 0.0), at(i + 1, o, 0.0), at(i + 1, o, high), at(i, o, high)]);
        s.quad("ring", Stuff::Mirror, [at(i + 1, n, 0.0), at(i, n, 0.0), at(i, n, high), at(i + 1, n, high)]);
        s.quad("ring", Stuff::Mirror, [at(i, o, high), at(i + 1, o, high), at(i + 1, n, high), at(i, n, high)]);
    }
    let solid = crate::scene_generation::place::Solid {
        y: [y, y + high],
        at: [cx, cz],
        turn: Turn::NONE,
        half: [radius, radius],
    };
    s.world.solids.push(solid);
    s.main(&mid, &[F::Vessel, F::MachinePart, F::Ornament, F::Solid], [0.1, 0.24]);
    let from = [cx + s.draw("lamp.x", 0.15, 0.45), 0.74 + s.draw("lamp.height", 0.45, 0.8), cz + s.any(-0.3, 0.3)];
    low_lamp(s, from, room.height(), 18.0);
    let n = s.some(10);
    s.scatter(&mid, &[PART, UTENSIL, PART.most(0.2, 0.2, 0.2), VESSEL, SOLID, TOOL], n, ANY);
    s.ceiling_lamps(&room, 2.0);
    s.look_at(4.0, &mid, 0.15, ROUND, [0.35, 1.0]);
}

/// Something to sell on a sweep of paper, under soft boxes or the sky.
pub fn product_shot(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let floor = ground(s, Stuff::Concrete, 12.0);
    s.studio = s.maybe("studio", 0.7);
    let (wide, deep, high) =
        (s.draw("sweep.width", 0.8, 1.5), s.draw("sweep.depth", 0.5, 0.9), s.draw("sweep.height", 0.7, 1.3));
    let stand = 0.7;
    let stuff = [Stuff::Paper, Stuff::Fabric, Stuff::Plastic][s.choose("sweep", 3)];
    s.board(
        "stand",
        Stuff::Wood,
        Board {
            center: [0.0, 0.5 * stand, 0.0],
            half: [wide, 0.5 * stand, deep],
            inset: [0.0, 2.0 * GAP, 0.0],
            ..Board::PLAIN
        },
    );
    let radius = 0.3;
    let (y, back) = (stand + 0.001, -deep + 0.02);
    let mut line = vec![[y, deep], [y, back + radius]];
    for i in 1..=12 {
        let a = 0.5 * PI * f64::from(i) / 12.0;
        let (sin, cos) = (tauflow_data::maths::sin(a), tauflow_data::maths::cos(a));
        line.push([y + radius * (1.0 - cos), back + radius * (1.0 - sin)]);
    }
    line.push([y + high, back]);
    for pair in line.windows(2) {
        let ([y0, z0], [y1, z1]) = (pair[0], pair[1]);
        s.quad("sweep", stuff, [[-wide, y0, z0], [wide, y0, z0], [wide, y1, z1], [-wide, y1, z1]]);
    }
    s.world.solids.push(crate::scene_generation::place::Solid {
        y: [y + 0.005, y + high],
        at: [0.0, back - 0.01 + 0.5 * 0.12],
        turn: Turn::NONE,
        half: [wide, 0.06],
    });
    let flat =
        Surface::flat([0.0, y, 0.5 * (deep + back + radius)], [wide - 0.05, 0.5 * (deep - back - radius) - 0.01], high);
    s.main(
        &flat.part([-0.5, 0.5], [-0.9, 0.9]),
        &[F::Vessel, F::Ornament, F::Instrument, F::Toy, F::Sculpture],
        [0.15, 0.4],
    );
    let n = s.some(7).max(4);
    s.scatter(
        &flat.part([-0.8, 0.8], [-1.0, 1.0]),
        &[VESSEL, SOLID, BOX.most(0.3, 0.4, 0.3), FOOD, ask(F::Leaves).most(0.3, 0.2, 0.3)],
        n,
        ANY,
    );
    s.scatter(&floor.part([-0.2, 0.2], [-0.25, -0.12]), &[TALL_PLANT, BOX, FLOOR_LAMP], 3, ANY);
    s.look_at(3.0, &flat.part([-0.5, 0.5], [-1.0, 1.0]), 0.35, [-0.6, 0.6], [0.05, 0.5]);
}

/// A game of chess in the open air, pieces standing on their squares.
pub fn chess_board(s: &mut Stage<'_>) {
    let stuff = s.one("ground", &[Stuff::Grass, Stuff::Asphalt, Stuff::Sand]);
    let floor = ground(s, stuff, 25.0);
    let wide = s.draw("table.width", 0.8, 1.2);
    let top = bench(s, Stuff::Stone, [0.0, 0.0, 0.0], [wide, 0.72, 0.8], Turn::NONE);
    let square = s.draw("square", 0.045, 0.06);
    let edge = 4.0 * square;
    let y = top.center[1] + 0.0005;
    let board = s.board(
        "chess rim",
        Stuff::Wood,
        Board {
            center: [0.0, y + 0.01, 0.0],
            half: [edge + 0.03, 0.01, edge + 0.03],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    for i in 0..8 {
        for j in 0..8 {
            let label = if (i + j) % 2 == 0 { "chess dark" } else { "chess light" };
            let stuff = if (i + j) % 2 == 0 { Stuff::Wood } else { Stuff::Paper };
            let (x, z) = (-edge + square * f64::from(i), -edge + square * f64::from(j));
            let h = board.center[1] + 0.0006;
            s.quad(label, stuff, [[x, h, z + square], [x + square, h, z + square], [x + square, h, z], [x, h, z]]);
        }
    }
    let mut cells = Surface::flat([0.0, board.center[1] + 0.0006, 0.0], [edge, edge], 0.5);
    cells.clearance = 0.5;
    let sides = top.part([-0.95, -0.62], [-0.8, 0.8]);
    s.main(&sides, &[F::Vessel, F::Food, F::Ornament], [0.08, 0.2]);
    // Men of some sorts, those of one sort alike.
    let man = [ask(F::Toy), ask(F::Solid), ask(F::Ornament), ask(F::Vessel)][s.choose("men", 4)];
    for colour in 0..2 {
        let man = man.scaled(square, 1.4 * square).most(0.92 * square, 0.3, 0.92 * square);
        let sorts: Vec<_> = (0..3).filter_map(|_| s.pick(&man)).collect();
        let n = s.some(12).min(14);
        for k in 0..n {
            if sorts.is_empty() {
                break;
            }
            let pick = &sorts[if k < 6 { 0 } else { k % sorts.len() }];
            let cell = s.next().below(32);
            let (i, j) = (cell % 8, cell / 8);
            let j = if colour == 0 { j } else { 7 - j };
            let at = [-edge + square * (i as f64 + 0.5), -edge + square * (j as f64 + 0.5)];
            let _ = s.put(pick, &cells, at, 0.0);
        }
    }
    for (x, turn) in [(0.95, -0.5 * PI), (-0.95, 0.5 * PI)] {
        if let Some(pick) = s.pick(&CHAIR) {
            let _ = s.put_at(&pick, &floor, [x, 0.0], Turn::new(turn));
        }
    }
    let near = floor.part([-0.3, 0.3], [-0.4, -0.12]);
    let n = s.some(8);
    s.scatter(&near, &[ask(F::Tree), ask(F::Bush), ask(F::Bench), ask(F::Bin)], n, ANY);
    s.look_at(4.0, &cells, 0.1, ROUND, [0.25, 1.0]);
}

/// A table with glasses under beams and leaves, lamps on a string.
pub fn pergola(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let stuff = s.one("ground", &[Stuff::Stone, Stuff::Tile, Stuff::Sand]);
    let floor = ground(s, stuff, 25.0);
    let (x, z, high) = (s.draw("width", 1.6, 2.2), s.draw("depth", 1.4, 2.0), s.draw("height", 2.3, 2.7));
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        s.board(
            "posts",
            Stuff::Wood,
            Board { center: [sx * x, 0.5 * high, sz * z], half: [0.06, 0.5 * high, 0.06], ..Board::PLAIN },
        );
    }
    for sz in [-1.0, 1.0] {
        s.board(
            "beams",
            Stuff::Wood,
            Board { center: [0.0, high + 0.081, sz * z], half: [x + 0.3, 0.08, 0.05], ..Board::PLAIN },
        );
    }
    let slats = 7 + s.choose("slats", 8);
    for i in 0..slats {
        let cx = (x + 0.2) * ((2 * i + 1) as f64 / slats as f64 - 1.0);
        s.board(
            "beams",
            Stuff::Wood,
            Board { center: [cx, high + 0.215, 0.0], half: [0.025, 0.05, z + 0.3], ..Board::PLAIN },
        );
    }
    // A wall on one side throws light back.
    let wall = s.one("wall", &[Stuff::Brick, Stuff::Plaster, Stuff::Stone]);
    s.board("garden wall", wall, Board { center: [0.0, 1.4, -z - 0.9], half: [x + 2.5, 1.4, 0.15], ..Board::PLAIN });
    let table = s.place(&TABLE, &floor, [0.0, 0.0], 0.0);
    let top = match table.and_then(|t| s.top(t)) {
        Some(top) => top,
        None => bench(s, Stuff::Wood, [0.0; 3], [1.6, 0.74, 0.8], Turn::NONE),
    };
    s.main(&top, &[F::Vessel, F::Food, F::Ornament], [0.15, 0.32]);
    string_lamps(s, [-x, high - 0.05, -z], [x, high - 0.05, z], 8, 30.0);
    string_lamps(s, [-x, high - 0.05, z], [x, high - 0.05, -z], 8, 30.0);
    if let Some(table) = table {
        let seats = 2 + s.choose("seats", 5);
        s.around(table, &CHAIR, seats, &floor);
        lay(s, &top, seats);
    }
    let n = s.some(6);
    s.scatter(&top, &[VESSEL, FOOD, VESSEL, ask(F::Lamp).most(0.15, 0.4, 0.15)], n, ANY);
    let near = floor.part([-0.16, 0.16], [-0.1, 0.12]);
    let n = s.some(8);
    s.scatter(&near, &[TALL_PLANT, POT, TALL_PLANT, ask(F::Bench), BOX, ask(F::Bush)], n, ANY);
    s.look_at(2.0, &top, 0.4, [-1.3, 1.3], [0.1, 0.6]);
    let about = Aabb { low: [-0.6, 0.6, -0.5], high: [0.6, 1.4, 0.5] };
    use crate::scene_generation::stage::From;
    s.eye(2.0, From::Orbit([3.0, 5.0], [-1.2, 1.2], [0.05, 0.25]), about);
}
