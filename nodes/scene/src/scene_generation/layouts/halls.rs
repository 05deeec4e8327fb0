//! Passages, stairs and rooms full of shelves or panes.

use super::kit::*;
use crate::scene_generation::{
    place::{GAP, SEAM, Surface, Turn},
    props::ask,
    shell::{Finishes, Window},
    stage::{Board, From, Stage},
};
use tauflow_data::geom::{Aabb, Vec3};
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// A long passage: doors, lamps in a row, a runner, chairs and plants along the walls.
pub fn corridor(s: &mut Stage<'_>) {
    let size = [s.draw("width", 1.6, 2.8), s.draw("height", 2.4, 3.0), s.draw("depth", 7.0, 14.0)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Tile, Stuff::Wood, Stuff::Carpet, Stuff::Stone]),
        walls: s.one("walls", &[Stuff::Plaster, Stuff::Wallpaper, Stuff::Brick]),
        ceiling: Stuff::Plaster,
    };
    let windows = [Window { wall: 2, s: 0.0, width: 0.9, sill: 0.9, height: 1.2 }];
    let open = usize::from(s.maybe("end window", 0.5));
    let mut room = s.room(size, made, &windows[..open], Some(0));
    let (x, z) = (0.5 * size[0], 0.5 * size[2]);
    // Doors to the sides.
    for side in [1, 3] {
        s.door(&mut room, side);
    }
    let floor = room.floor.clone();
    let lamps = (size[2] / 2.4).round() as usize;
    let pick = s.pick(&ask(F::CeilingLamp).most(0.7, size[1] - 2.0, 0.7));
    for i in 0..lamps {
        let at = size[2] * ((i as f64 + 0.5) / lamps as f64 - 0.5);
        let hung = pick.as_ref().filter(|_| i % 2 == 0).and_then(|p| s.hang_pick(p, [0.0, at], size[1], 0.0));
        s.lit(hung, 14.0);
        if hung.is_none() {
            s.panel_lamp([0.0, size[1], at], [0.25, 0.25], 12.0);
        }
    }
    let side = ask(F::Table).most(1.4, 1.0, 0.55);
    let table = s.against(&room.walls[1], &floor, &side, [-0.3 * z, 0.3 * z]);
    let top = match table.and_then(|t| s.top(t)) {
        Some(top) => top,
        None => plinth(s, Stuff::Wood, [x - 0.25, -0.2 * z], [0.2, 0.4], 0.8),
    };
    s.main(&top, &[F::Vessel, F::Sculpture, F::Ornament], [0.2, 0.45]);
    if !s.has_main {
        s.main(&floor.part([-0.6, 0.6], [-0.6, 0.6]), &[F::Sculpture, F::Vessel, F::Instrument], [0.3, 0.8]);
    }
    let seats = s.pick(&CHAIR);
    for i in 0..s.some(4).min(6) {
        if let Some(pick) = &seats {
            let at = z * (0.5 * i as f64 - 0.9);
            let _ = s.back_to(&room.walls[3].clone(), &floor, pick, [at, at + 0.3]);
        }
    }
    for i in 0..s.some(5) {
        let wall = room.walls[1 + 2 * (i % 2)].clone();
        let along = [-0.9 * z, 0.9 * z];
        let _ = s.on_wall(&wall, &FRAME.most(1.0, 1.1, 0.1), along, [1.2, 1.4]);
    }
    for wall in [1, 3] {
        let _ =
            s.against(&room.walls[wall].clone(), &floor, &ask(F::Cabinet).most(1.2, 2.0, 0.45), [-0.9 * z, 0.9 * z]);
        let _ = s.against(&room.walls[wall].clone(), &floor, &ask(F::Bench).most(1.8, 1.1, 0.6), [-0.9 * z, 0.9 * z]);
        let _ = s.against(&room.walls[wall].clone(), &floor, &TALL_PLANT.most(0.7, 1.8, 0.7), [-0.9 * z, 0.9 * z]);
    }
    let _ = s.on_wall(&room.walls[0].clone(), &CLOCK, [-0.2, 0.2], [2.1, 2.2]);
    s.scatter(&floor.part([-0.9, 0.9], [-0.9, 0.9]), &[ask(F::Bin).most(0.4, 0.8, 0.4), BOX], 2, ABOUT);
    let near = Aabb { low: [-0.5 * x, 0.8, -0.9 * z], high: [0.5 * x, 1.6, -0.2 * z] };
    s.eye(4.0, From::Box(Aabb { low: [-0.5 * x, 1.2, 0.4 * z], high: [0.5 * x, 1.75, 0.95 * z] }), near);
    let focus = room.part([-0.6, 0.9], [0.6, 1.3], [-0.4, 0.4]);
    s.eye(1.0, From::Box(room.part([-0.7, 0.3], [1.2, 1.7], [-0.8, 0.8])), focus);
}

/// A stair against a wall, rails, a landing with a window, plants and pictures on the way up.
pub fn stairwell(s: &mut Stage<'_>) {
    s.bare = true;
    let size = [s.draw("width", 3.2, 4.6), s.draw("height", 4.2, 5.6), s.draw("depth", 4.0, 5.5)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Stone, Stuff::Tile, Stuff::Wood]),
        walls: s.one("walls", &[Stuff::Plaster, Stuff::Wallpaper, Stuff::Concrete]),
        ceiling: Stuff::Plaster,
    };
    let windows = [Window { wall: 0, s: 0.4, width: 1.0, sill: 2.4, height: 1.4 }];
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let (x, z) = (0.5 * size[0], 0.5 * size[2]);
    // Steps up along the left wall to a landing along the back.
    let (wide, steps) = (0.5, 12);
    let rise = 2.05 / f64::from(steps);
    let tread = (size[2] - 1.5) / f64::from(steps);
    let stone = s.one("steps", &[Stuff::Wood, Stuff::Stone, Stuff::Concrete]);
    // Beside the wall, not inset from it: the steps keep their whole width.
    let left = -x + wide + GAP;
    let start = z - 0.35;
    for i in 0..steps {
        let top = rise * f64::from(i + 1);
        let at = start - tread * (f64::from(i) + 0.5);
        s.board(
            "steps",
            stone,
            Board {
                center: [left, 0.5 * top, at],
                half: [wide, 0.5 * top, 0.5 * tread],
                inset: [0.0, SEAM, 2e-4],
                ..Board::PLAIN
            },
        );
        // A baluster on the free side, under the rail.
        s.board(
            "balusters",
            Stuff::PaintedMetal,
            Board { center: [left + wide - 0.03, top + 0.45, at], half: [0.009, 0.4485, 0.009], ..Board::PLAIN },
        );
    }
    let edge = start - tread * f64::from(steps);
    let (a, b) =
        ([left + wide - 0.03, rise + 0.91, start - 0.5 * tread], [left + wide - 0.03, 2.05 + 0.91, edge + 0.5 * tread]);
    let w = 0.022;
    let p = |q: Vec3, dx: f64, dy: f64| [q[0] + dx, q[1] + dy, q[2]];
    for quad in [
        [p(a, -w, w), p(a, w, w), p(b, w, w), p(b, -w, w)],
        [p(a, w, -w), p(b, w, -w), p(b, w, w), p(a, w, w)],
        [p(b, -w, -w), p(a, -w, -w), p(a, -w, w), p(b, -w, w)],
        [p(a, -w, -w), p(b, -w, -w), p(b, w, -w), p(a, w, -w)],
    ] {
        s.quad("rail", Stuff::Wood, quad);
    }
    let deep = 0.5 * (edge + z) - 0.001;
    let landing = s.board(
        "steps",
        stone,
        Board {
            center: [0.0, 1.95, -z + deep + 0.0005],
            half: [x, 0.1, deep],
            inset: [GAP, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    for i in 0..14 {
        let bx = left + wide + 0.05 + (x - 0.05 - left - wide) * f64::from(i) / 14.0;
        s.board(
            "balusters",
            Stuff::PaintedMetal,
            Board { center: [bx, 2.05 + 0.45, edge - 0.06], half: [0.009, 0.4485, 0.009], ..Board::PLAIN },
        );
    }
    s.board(
        "rail",
        Stuff::Wood,
        Board {
            center: [0.5 * (left + wide + x), 2.05 + 0.92, edge - 0.06],
            half: [0.5 * (x - left - wide) - 0.03, 0.02, 0.02],
            ..Board::PLAIN
        },
    );
    let under = floor.part([-0.05, 0.95], [-0.9, 0.4]);
    let mut low = under.clone();
    low.clearance = 1.8;
    let table = s.place(&ask(F::Table).most(1.4, 1.0, 0.7), &low, [0.3, 0.2], 0.0);
    let top = match table.and_then(|t| s.top(t)) {
        Some(top) => top,
        None => plinth(s, Stuff::Wood, [0.4 * x, 0.0], [0.25, 0.25], 0.8),
    };
    s.main(&top, &[F::Vessel, F::Sculpture, F::Ornament], [0.2, 0.45]);
    let lamp = s.hang(&ask(F::CeilingLamp).most(1.0, 1.6, 1.0), [0.2, 0.6], size[1], 0.0);
    s.lit(lamp, 45.0);
    if lamp.is_none() {
        s.panel_lamp([0.2, size[1], 0.6], [0.3, 0.3], 45.0);
    }
    s.panel_lamp([0.4, 1.85, -0.5 * (z - edge)], [0.15, 0.15], 8.0);
    let n = s.some(5);
    s.scatter(&landing.part([-0.2, 0.95], [-0.9, 0.5]), &[TALL_PLANT, CHAIR, BOX, POT, VESSEL], n, ANY);
    s.scatter(&low, &[TALL_PLANT, CHAIR, ask(F::Bicycle), ask(F::Bench), BOX, ask(F::Bin)], n + 2, ANY);
    for i in 0..s.some(4).min(6) {
        let wall = room.walls[1 + i % 2].clone();
        let _ = s.on_wall(&wall, &FRAME.most(0.9, 1.0, 0.1), [-0.8 * z, 0.8 * z], [1.3, 1.5]);
    }
    let _ = s.on_wall(&room.walls[3].clone(), &FRAME.most(0.7, 0.8, 0.1), [-0.5 * z, 0.2 * z], [3.0, 3.2]);
    let focus = room.part([-0.6, 0.3], [0.8, 2.4], [-0.6, 0.3]);
    s.eye(3.0, From::Box(room.part([0.2, 0.9], [1.2, 1.75], [0.5, 0.95])), focus);
    s.eye(
        1.0,
        From::Box(room.part([0.0, 0.9], [3.3, 3.8], [-0.95, -0.7])),
        room.part([-0.5, 0.5], [0.3, 1.5], [0.0, 0.8]),
    );
}

/// Between two cases of books, a lamp at the end, a ladder, a reading table.
pub fn library_aisle(s: &mut Stage<'_>) {
    let size = [s.draw("width", 2.6, 3.6), s.draw("height", 2.7, 3.4), s.draw("depth", 5.0, 8.0)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Wood, Stuff::Carpet]),
        walls: s.one("walls", &[Stuff::Wood, Stuff::Plaster]),
        ceiling: Stuff::Plaster,
    };
    let windows = [Window { wall: 0, s: 0.0, width: 0.9, sill: 0.9, height: size[1] - 1.3 }];
    let room = s.room(size, made, &windows, None);
    let floor = room.floor.clone();
    let (x, z) = (0.5 * size[0], 0.5 * size[2]);
    let table = bench(s, Stuff::Wood, [0.0, 0.0, -z + 0.6], [0.9, 0.75, 0.6], Turn::NONE);
    s.main(&table, &[F::Sculpture, F::Vessel, F::Ornament, F::Instrument], [0.2, 0.4]);
    let lamp = s.scatter(&table, &[TABLE_LAMP], 1, ABOUT).pop();
    s.lit(lamp, 14.0);
    // Cases to both sides, built in, boards every 36 cm, blocks of books as backs of the upper boards.
    let deep = 0.14;
    let (wide, bays) = (0.5, (size[2] / 1.04).floor() as usize);
    let mut boards: Vec<Surface> = Vec::new();
    for side in [-1.0, 1.0] {
        let cx = side * (x - deep - 0.002);
        for bay in 0..bays {
            let cz = -z + 0.05 + 1.04 * (bay as f64 + 0.5);
            s.board(
                "cases",
                Stuff::Wood,
                // Not 1.1 inset by a gap: it rounds to another height, and so makes other scenes.
                Board { center: [cx, 1.1, cz - 0.51], half: [deep, 1.099, 0.009], ..Board::PLAIN },
            );
            for i in 0..6 {
                let y = 0.09 + 0.38 * f64::from(i);
                let (half, inset) = ([deep, 0.01, wide], [0.0, 0.0, GAP]);
                s.board("cases", Stuff::Wood, Board { center: [cx, y, cz], half, inset, ..Board::PLAIN });
                let turn = Turn::toward([-side, 0.0]);
                let clearance = if i == 5 { 0.4 } else { 0.355 };
                boards.push(Surface { turn, ..Surface::flat([cx, y + 0.01, cz], [wide, deep], clearance) });
            }
        }
    }
    // Books: packed rows of boxes each with its own cover, cheap, and some real ones at eye height.
    let real: Vec<usize> = (0..boards.len()).filter(|i| (i % 6 == 2 || i % 6 == 3) && (i / 6) % bays < bays).collect();
    let shown = s.some(3).min(real.len());
    let first = s.next().below(real.len().max(1));
    let chosen: Vec<usize> = (0..shown).map(|k| real[(first + k * 5) % real.len()]).collect();
    for (i, board) in boards.iter().enumerate() {
        if chosen.contains(&i) {
            let most = s.most;
            let n = s.some(7);
            s.most = most.min(s.things.len() + n);
            s.row(board, &[BOOK.most(0.1, 0.34, 0.27), BOOK.most(0.1, 0.34, 0.27)], [0.001, 0.003], 0.8, 1.0);
            s.most = most;
            continue;
        }
        let mut d = s.next();
        let mut at = -board.half[0] + 0.01;
        let end = board.half[0] * d.range(0.5, 1.0) - 0.01;
        while at < end - 0.06 {
            let (thick, tall, back) = (d.range(0.018, 0.055), d.range(0.19, 0.33), d.range(0.08, 0.12));
            let run = d.below(3) + 1;
            let label = format!("covers {}", d.below(6));
            for _ in 0..run {
                if at + thick > end {
                    break;
                }
                let p = board.point([at + 0.5 * thick, board.half[1] - back - 0.01]);
                let half = [0.5 * thick - 0.0005, 0.5 * tall, back];
                let c = [p[0], p[1] + 0.0005 + 0.5 * tall, p[2]];
                s.facing(&label, Stuff::Print, c, half, board.turn, &[2, 4]);
                s.facing(&label, Stuff::Print, c, half, board.turn, &[0, 1]);
                at += thick;
            }
        }
    }
    let n = s.some(6);
    s.scatter(&table, &[BOOK_LYING, BOOK_LYING, PAPER, PEN, VESSEL.most(0.12, 0.25, 0.12)], n, ANY);
    s.pile(&table, &BOOK_LYING, [0.2, 0.0], 5);
    let aisle = floor.part([-0.62, 0.62], [-0.95, 0.8]);
    s.scatter(&aisle, &[ask(F::Stair).most(0.9, 2.1, 1.2), CHAIR, BOX, TALL_PLANT, CHAIR], 4, ANY);
    for _ in 0..s.some(2) {
        let at = [s.any(-0.8, 0.8) * aisle.half[0], s.any(-0.5, 0.8) * aisle.half[1]];
        s.pile(&aisle, &BOOK_LYING, at, 6);
    }
    let lamps = (size[2] / 2.0).round() as usize;
    for i in 0..lamps {
        let at = size[2] * ((i as f64 + 0.5) / lamps as f64 - 0.5);
        s.panel_lamp([0.0, size[1], at], [0.1, 0.4], 14.0);
    }
    let focus = Aabb { low: [-x, 0.8, -z], high: [x, 1.7, 0.2 * z] };
    s.eye(4.0, From::Box(Aabb { low: [-0.4 * x, 1.3, 0.3 * z], high: [0.4 * x, 1.75, 0.95 * z] }), focus);
    s.look_at(1.0, &table, 0.4, [-0.5, 0.5], [0.1, 0.6]);
}

/// A house of bars and bright panes, benches full of pots, cans and tools.
pub fn greenhouse(s: &mut Stage<'_>) {
    s.bare = true;
    let size = [s.draw("width", 2.8, 4.2), s.draw("height", 2.3, 2.9), s.draw("depth", 4.0, 6.5)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Soil, Stuff::Sand, Stuff::Stone]),
        walls: s.one("walls", &[Stuff::PaintedMetal, Stuff::Brick, Stuff::Wood]),
        ceiling: Stuff::PaintedMetal,
    };
    let mut windows = Vec::new();
    for wall in [1, 3] {
        let n = (size[2] / 1.1).floor() as usize;
        for i in 0..n {
            let at = size[2] * ((i as f64 + 0.5) / n as f64 - 0.5);
            windows.push(Window { wall, s: at, width: size[2] / n as f64 - 0.1, sill: 0.7, height: size[1] - 0.9 });
        }
    }
    windows.push(Window { wall: 0, s: 0.0, width: size[0] - 0.8, sill: 0.7, height: size[1] - 0.9 });
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let (x, z) = (floor.half[0], floor.half[1]);
    let long = 2.0 * z - 1.2;
    let side = bench(s, Stuff::Wood, [-x + 0.4, 0.0, -0.3], [0.6, 0.72, long], Turn::NONE);
    let other = bench(s, Stuff::Wood, [x - 0.4, 0.0, -0.3], [0.6, 0.72, long], Turn::NONE);
    s.main(&side, &[F::Vessel, F::Food, F::Tool], [0.18, 0.36]);
    let n = s.some(11);
    let pots = [POT, POT, POT, VESSEL, TOOL, ask(F::Plant).most(0.55, 1.2, 0.55), FOOD];
    s.scatter(&side, &pots, n, ANY);
    s.scatter(&other, &pots, n, ANY);
    let aisle = floor.part([-0.4, 0.4], [-0.95, 0.9]);
    let n = s.some(6);
    s.scatter(&aisle, &[TALL_PLANT, BOX, ask(F::Bin), POT, TOOL, ask(F::Stair).most(0.7, 1.6, 0.9)], n, ANY);
    s.panel_lamp([0.0, size[1], 0.0], [0.05, 0.6], 8.0);
    let focus = room.part([-0.7, 0.7], [0.6, 1.3], [-0.9, 0.2]);
    s.eye(3.0, From::Box(room.part([-0.35, 0.35], [1.2, 1.7], [0.4, 0.9])), focus);
    s.look_at(1.0, &side.part([-1.0, 1.0], [-0.3, 0.3]), 0.4, [0.8, 2.2], [0.1, 0.5]);
}
