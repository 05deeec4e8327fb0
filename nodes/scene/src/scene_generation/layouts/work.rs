//! Where people work and learn.

use super::kit::*;
use crate::scene_generation::{
    place::Turn,
    props::ask,
    shell::Finishes,
    stage::{Board, From, Stage},
};
use core::f64::consts::PI;
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// A desk close by: keyboard, screen, papers, cups, cables of a day's work.
pub fn office_desk(s: &mut Stage<'_>) {
    let size = [s.draw("width", 2.8, 4.2), 2.6, s.draw("depth", 2.6, 3.8)];
    let made = Finishes { floor: Stuff::Carpet, walls: Stuff::Plaster, ceiling: Stuff::Tile };
    let windows = [window(s, 3, 2.6, size[2])];
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let top = {
        let wide = s.draw("desk.width", 1.3, 1.8);
        let stuff = s.one("desk", &[Stuff::Wood, Stuff::Plastic, Stuff::Wood]);
        bench(s, stuff, [0.0, 0.0, -floor.half[1] + 0.42], [wide, 0.74, 0.75], Turn::NONE)
    };
    s.main(&top.part([-0.8, 0.8], [-0.6, 0.8]), &[F::Ornament, F::Vessel, F::Toy, F::MachinePart], [0.1, 0.24]);
    // A keyboard: a tray with rows of keys.
    let (kx, kz, y) = (s.any(-0.1, 0.1), top.center[2] + 0.14, top.center[1]);
    let keys = crate::scene_generation::place::Solid {
        y: [y + 0.002, y + 0.03],
        at: [kx, kz],
        turn: Turn::NONE,
        half: [0.22, 0.075],
    };
    if s.world.free(&[keys]) {
        s.board(
            "keyboard",
            Stuff::Plastic,
            Board { center: [kx, y + 0.0085, kz], half: [0.22, 0.0075, 0.075], ..Board::PLAIN },
        );
        for row in 0..5 {
            for key in 0..15 {
                let c = [kx - 0.196 + 0.028 * f64::from(key), y + 0.0195, kz - 0.056 + 0.028 * f64::from(row)];
                s.facing("keys", Stuff::Plastic, c, [0.012, 0.0035, 0.012], Turn::NONE, &[0, 1, 2, 4, 5]);
            }
        }
        s.world.solids.push(keys);
    }
    let n = s.some(12);
    desk_things(s, &top, n);
    if let Some(chair) = s.pick(&CHAIR) {
        let _ = s.put_at(&chair, &floor, [0.5, top.center[2] + 0.9], Turn::new(PI - 0.5));
    }
    if s.left() > 6 {
        s.scatter(
            &floor,
            &[ask(F::Bin).most(0.4, 0.5, 0.4), BOX, TALL_PLANT, ask(F::Cabinet).most(0.8, 1.2, 0.7)],
            3,
            ANY,
        );
    }
    let shelf = s.board(
        "wall shelf",
        Stuff::Wood,
        Board { center: [0.0, 1.5, -floor.half[1] + 0.13], half: [0.6, 0.0125, 0.125], ..Board::PLAIN },
    );
    let most = s.most;
    let n = s.some(7);
    s.most = most.min(s.things.len() + n);
    s.row(&shelf, &[BOOK, BOOK, BOX.most(0.3, 0.3, 0.22)], [0.001, 0.004], 0.0, 0.9);
    s.most = most;
    s.ceiling_lamps(&room, 25.0);
    let close = top.part([-0.6, 0.6], [-0.8, 0.8]);
    s.look_at(3.0, &close, 0.4, [-0.7, 0.7], [0.15, 0.7]);
    let focus = room.part([-0.4, 0.4], [0.7, 1.2], [-1.0, -0.4]);
    s.room_eyes(&room, focus);
}

/// A bench with a vice, tools on the wall, parts in boxes, a hard lamp.
pub fn workshop(s: &mut Stage<'_>) {
    let size = [s.draw("width", 3.4, 5.0), s.draw("height", 2.5, 3.2), s.draw("depth", 3.0, 4.6)];
    let made = Finishes {
        floor: Stuff::Concrete,
        walls: s.one("walls", &[Stuff::Brick, Stuff::Concrete, Stuff::Plaster]),
        ceiling: Stuff::Concrete,
    };
    let windows = [window(s, 3, size[1], size[2])];
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let wide = s.draw("bench.width", 1.8, 2.6).min(2.0 * floor.half[0] - 0.3);
    let top = bench(s, Stuff::Wood, [0.0, 0.0, -floor.half[1] + 0.37], [wide, 0.88, 0.7], Turn::NONE);
    s.main(&top.part([-0.8, 0.8], [-0.7, 0.7]), &[F::MachinePart, F::Tool, F::Vessel], [0.15, 0.35]);
    let n = s.some(12);
    s.scatter(&top, &[PART, TOOL, PART, TOOL, BOX.most(0.4, 0.3, 0.3), VESSEL, PAPER, PEN], n, ANY);
    // A board with pegs, tools hung flat against it.
    let wall = room.walls[0].clone();
    let hung = s.some(7).min(9);
    for i in 0..hung {
        let at = wide * ((i as f64 + 0.5) / hung as f64 - 0.5);
        let flat = ask(F::Tool).most(0.35, 0.6, 0.14);
        let _ = s.on_wall(&wall, &flat, [at - 0.03, at + 0.03], [1.25, 1.5]);
    }
    let lamp = s.scatter(&top.part([-0.9, 0.9], [-0.95, 0.0]), &[TABLE_LAMP], 1, ABOUT).pop();
    s.lit(lamp, 16.0);
    s.panel_lamp([0.0, size[1], -floor.half[1] + 0.8], [0.6, 0.06], 22.0);
    let shelf = SHELF.least(0.5, 0.8, 0.2).most(2.2, size[1] - 0.1, 0.7);
    if let Some(shelf) = s.against(&room.walls[1], &floor, &shelf, [-1.0, 1.0]) {
        let each = s.some(4);
        fill(s, shelf, &[&[BOX.most(0.45, 0.4, 0.45)], &[PART, TOOL], &[VESSEL, BOX.most(0.4, 0.3, 0.4)]], each);
    }
    let n = s.some(6);
    s.scatter(
        &floor.inset(0.15),
        &[
            CHAIR.most(0.6, 0.9, 0.6),
            ask(F::Box).most(0.9, 0.9, 0.9),
            ask(F::Bin),
            ask(F::Stair).most(1.0, 1.9, 1.2),
            ask(F::Bicycle),
        ],
        n,
        ANY,
    );
    let focus = room.part([-0.5, 0.5], [0.7, 1.3], [-1.0, -0.2]);
    s.room_eyes(&room, focus);
    s.look_at(1.5, &top.part([-0.5, 0.5], [-1.0, 1.0]), 0.3, [-0.8, 0.8], [0.2, 0.8]);
}

/// Rows of desks and chairs, a black board, a teacher's table, a globe or a model.
pub fn classroom(s: &mut Stage<'_>) {
    let size = [s.draw("width", 5.0, 7.5), s.draw("height", 2.8, 3.4), s.draw("depth", 5.0, 7.0)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Wood, Stuff::Tile, Stuff::Plastic]),
        walls: Stuff::Plaster,
        ceiling: Stuff::Plaster,
    };
    let mut windows = Vec::new();
    for i in 0..3 {
        let at = size[2] * (f64::from(i) - 1.0) * 0.3;
        windows.push(crate::scene_generation::shell::Window {
            wall: 3,
            s: at,
            width: 0.25 * size[2],
            sill: 0.95,
            height: size[1] - 1.4,
        });
    }
    let room = s.room(size, made, &windows, Some(1));
    let floor = room.floor.clone();
    let z = floor.half[1];
    let wall = room.walls[0].clone();
    s.board(
        "blackboard",
        Stuff::Paper,
        Board { center: wall.point(0.0, 1.55, 0.012), half: [1.25, 0.62, 0.01], ..Board::PLAIN },
    );
    s.board(
        "blackboard frame",
        Stuff::Wood,
        Board { center: wall.point(0.0, 0.915, 0.04), half: [1.25, 0.0145, 0.035], ..Board::PLAIN },
    );
    let front = s.place(&ask(F::Desk), &floor, [0.9, -z + 1.1], PI);
    let top = match front.and_then(|d| s.top(d)) {
        Some(top) => top,
        None => bench(s, Stuff::Wood, [0.9, 0.0, -z + 1.1], [1.3, 0.75, 0.65], Turn::NONE),
    };
    s.main(&top, &[F::Sculpture, F::Vessel, F::Instrument, F::Solid, F::MachinePart], [0.2, 0.4]);
    let n = s.some(3);
    s.scatter(&top, &[BOOK_LYING, PAPER, PEN, FOOD.most(0.12, 0.12, 0.12)], n, ANY);
    let kinds: Vec<f64> = (0..2).map(|i| 22.0 + f64::from(i)).collect();
    for i in 0..2 {
        for j in 0..2 {
            let at = [size[0] * (0.5 * f64::from(i) - 0.25), size[1], size[2] * (0.5 * f64::from(j) - 0.25)];
            s.panel_lamp(at, [0.6, 0.1], kinds[0] * 0.5);
        }
    }
    let desk = s.pick(&ask(F::Table).least(0.5, 0.6, 0.4).most(1.5, 0.85, 0.8));
    let chair = s.pick(&CHAIR);
    let (columns, rows) = (3, 1 + s.some(6).min(4) / 2);
    for j in 0..rows {
        for i in 0..columns {
            let x = 0.62 * floor.half[0] * (i as f64 - 1.0);
            let at = [x, -z + 2.7 + 1.35 * j as f64];
            let Some(put) = desk.as_ref().and_then(|d| s.put(d, &floor, at, 0.0)) else { continue };
            let deep = 0.5 * desk.as_ref().map_or(0.5, |d| d.size[2]);
            if let Some(chair) = &chair {
                for step in 0..10 {
                    let far = at[1] + deep + 0.15 + 0.05 * f64::from(step);
                    if s.put(chair, &floor, [x, far], PI).is_some() {
                        break;
                    }
                }
            }
            if let Some(top) = s.top(put) {
                s.scatter(&top, &[BOOK_LYING, PAPER, PEN, ask(F::Pen)], 1, ABOUT);
            }
        }
    }
    let _ = s.on_wall(&wall, &CLOCK, [1.8, 2.2], [1.8, 2.1]);
    let _ = s.on_wall(&room.walls[1], &FRAME, [-1.0, 1.0], [1.2, 1.5]);
    let _ = s.against(&room.walls[2], &floor, &ask(F::Cabinet), [-1.5, 1.5]);
    let shelf = SHELF.least(0.5, 0.8, 0.2).most(2.2, 2.2, 0.6);
    if let Some(shelf) = s.against(&room.walls[1], &floor, &shelf, [0.0, 2.0]) {
        let each = s.some(3);
        fill(s, shelf, &[&[BOOK, BOOK, BOOK_ROW], &[BOX.most(0.4, 0.3, 0.4), TOY]], each);
    }
    let _ = s.against(&room.walls[0], &floor, &TALL_PLANT, [-2.5, -1.5]);
    let focus = Aabb { low: [-1.2, 0.6, -z + 0.5], high: [1.2, 1.5, 0.2] };
    s.room_eyes(&room, focus);
    s.eye(3.0, From::Box(room.part([-0.8, 0.8], [1.1, 1.7], [0.6, 0.95])), focus);
}

/// A garage: a vehicle, tyres, tools on shelves, a workbench, cans, bicycles.
pub fn garage(s: &mut Stage<'_>) {
    let size = [s.draw("width", 4.2, 6.0), s.draw("height", 2.4, 3.0), s.draw("depth", 5.5, 7.5)];
    let made = Finishes {
        floor: Stuff::Concrete,
        walls: s.one("walls", &[Stuff::Concrete, Stuff::Brick, Stuff::Plaster]),
        ceiling: Stuff::Concrete,
    };
    let mut high = window(s, 3, size[1], size[2]);
    (high.sill, high.height) = (1.5, 0.55);
    let room = s.room(size, made, &[high], None);
    let floor = room.floor.clone();
    // The gate: ribs across the front.
    let z = 0.5 * size[2];
    let ribs = 9;
    for i in 0..ribs {
        let h = 2.1 / f64::from(ribs);
        s.board(
            "gate",
            Stuff::PaintedMetal,
            Board {
                center: [0.0, h * (f64::from(i) + 0.5), z - 0.025],
                half: [1.25, 0.5 * h - 0.008, 0.02],
                ..Board::PLAIN
            },
        );
    }
    let vehicle = ask(F::Vehicle).most(2.2, 2.2, 4.8);
    let car = s.place(&vehicle, &floor.part([-0.4, 0.4], [-0.5, 0.7]), [0.0, 0.0], 0.0);
    if car.is_none() {
        s.scatter(&floor, &[vehicle, ask(F::Vehicle), ask(F::Bicycle)], 1, ANY);
    }
    let x = floor.half[0];
    let top = bench(s, Stuff::Wood, [-x + 0.35, 0.0, -z + 1.1], [0.6, 0.9, 1.6], Turn::NONE);
    s.main(&top.inset(0.02), &[F::MachinePart, F::Tool, F::Vessel], [0.15, 0.35]);
    let n = s.some(8);
    s.scatter(&top, &[TOOL, PART, TOOL, PART, VESSEL, BOX.most(0.35, 0.3, 0.35)], n, ANY);
    s.panel_lamp([0.0, size[1], -0.2 * z], [0.6, 0.07], 30.0);
    s.panel_lamp([0.0, size[1], 0.5 * z], [0.6, 0.07], 20.0);
    let shelf = SHELF.least(0.5, 0.8, 0.2).most(2.2, size[1] - 0.1, 0.7);
    for along in [[-2.0, -0.5], [0.5, 2.0]] {
        if let Some(shelf) = s.against(&room.walls[1], &floor, &shelf, along) {
            let each = s.some(4);
            fill(
                s,
                shelf,
                &[&[BOX.most(0.5, 0.4, 0.5)], &[TOOL, PART, VESSEL], &[VESSEL, BOX.most(0.4, 0.4, 0.4)]],
                each,
            );
        }
    }
    for i in 0..s.some(4).min(6) {
        let at = -1.2 + 0.5 * i as f64;
        let _ = s.on_wall(&room.walls[3], &ask(F::Tool).most(0.4, 0.7, 0.16), [at - 0.05, at + 0.05], [1.15, 1.25]);
    }
    let n = s.some(8);
    s.scatter(
        &floor.inset(0.15),
        &[
            ask(F::Bicycle),
            BOX,
            ask(F::Bin),
            ask(F::Stair).most(1.0, 2.0, 1.2),
            ask(F::Box),
            ask(F::MachinePart).least(0.2, 0.1, 0.2),
        ],
        n,
        ANY,
    );
    let focus = room.part([-0.6, 0.6], [0.4, 1.2], [-0.8, 0.4]);
    s.room_eyes(&room, focus);
}
