//! Rooms to live in.

use super::kit::*;
use crate::scene_generation::{
    place::{GAP, SEAM, Turn},
    props::ask,
    shell::Finishes,
    stage::{Board, Light, Stage},
};
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// Sofa, low table on a rug, shelves, a screen, plants, pictures.
pub fn living_room(s: &mut Stage<'_>) {
    let size = [s.draw("width", 4.2, 6.2), s.draw("height", 2.4, 3.0), s.draw("depth", 3.8, 5.4)];
    let made = homely(s);
    let windows = [window(s, 3, size[1], size[2]), window(s, 0, size[1], size[0])];
    let count = 1 + s.choose("windows", 2);
    let room = s.room(size, made, &windows[..count], Some(2));
    let floor = room.floor.clone();
    let half = floor.half[1];
    let sofa = ask(F::Sofa).least(1.3, 0.4, 0.5).most(2.9, 1.3, 1.3);
    let sofa = s.against(&room.walls[2], &floor, &sofa, [-0.6, 0.6]);
    let middle = s.any(-0.1, 0.1);
    let mut on = floor.clone();
    if let Some(rug) = s.place(&ask(F::Rug).most(3.2, 0.05, 2.4), &floor, [middle, 0.12 * half], 0.0) {
        on = s.upon(rug).unwrap_or(on);
    }
    let at = if on.half == floor.half { [middle, 0.12 * half] } else { [0.0; 2] };
    let table = s.place(&LOW_TABLE, &on, at, 0.0);
    let top = match table.and_then(|t| s.top(t)) {
        Some(top) => top,
        None => bench(s, Stuff::Wood, [middle, on.center[1] + 0.001, 0.12 * half], [0.9, 0.42, 0.55], Turn::NONE),
    };
    s.main(&top, &[F::Vessel, F::Ornament, F::Sculpture, F::Food], [0.15, 0.32]);
    let seat = ask(F::Sofa).least(0.4, 0.3, 0.4).most(1.25, 1.3, 1.2);
    for (wall, along) in [(1, [0.3, 1.2]), (3, [-1.2, -0.2])] {
        let _ = s.against(&room.walls[wall], &floor, &seat, along);
    }
    let rack = ask(F::Cabinet).most(2.2, 1.1, 0.65);
    if let Some(rack) = s.against(&room.walls[0], &floor, &rack, [-0.5, 0.5])
        && let Some(top) = s.top(rack)
    {
        s.scatter(&top, &[ask(F::Screen).least(0.4, 0.3, 0.0).most(1.5, 1.0, 0.4)], 1, [0.0, 0.0]);
        let n = s.some(3);
        s.scatter(&top, &[POT, VESSEL, ORNAMENT, TABLE_LAMP], n, ABOUT);
    }
    let lamp = s.scatter(&floor.inset(0.3), &[FLOOR_LAMP], 1, ANY).pop();
    s.lit(lamp, 22.0);
    s.ceiling_lamps(&room, 40.0);
    if let Some(sofa) = sofa {
        for top in s.tops(sofa) {
            s.scatter(&top, &[ask(F::Cushion).most(0.6, 0.6, 0.6)], 2, ABOUT);
        }
    }
    let shelf = SHELF.least(0.5, 0.8, 0.2).most(2.2, 2.3, 0.6);
    if let Some(shelf) = s.against(&room.walls[1], &floor, &shelf, [-1.5, 1.5]) {
        let each = s.some(7);
        fill(s, shelf, &[&[BOOK, BOOK, BOOK_ROW], &[VESSEL, ORNAMENT, POT], &[BOOK]], each);
    }
    s.scatter(&floor.inset(0.25), &[TALL_PLANT], 2, ANY);
    let n = s.some(3);
    s.scatter(&top, &[PAPER, VESSEL, BOOK_LYING, FOOD], n, ANY);
    pictures(s, &room, 2, 2);
    pictures(s, &room, 0, 2);
    let _ = s.on_wall(&room.walls[3], &CLOCK, [-1.0, 1.0], [1.5, 1.8]);
    let focus = room.part([-0.4, 0.4], [0.3, 1.1], [-0.5, 0.5]);
    s.room_eyes(&room, focus);
}

/// Bed, night tables with lamps, wardrobe, chest, rug, curtains.
pub fn bedroom(s: &mut Stage<'_>) {
    let size = [s.draw("width", 3.2, 4.8), s.draw("height", 2.35, 2.8), s.draw("depth", 3.6, 4.6)];
    let made = homely(s);
    let windows = [window(s, 1, size[1], size[2])];
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let bed = s.against(&room.walls[0], &floor, &ask(F::Bed).most(2.3, 1.6, 2.4), [-0.2, 0.2]);
    let mut top = None;
    if let Some(bed) = bed {
        let b = s.things[bed].bounds;
        let set = s.pick(&SIDE_TABLE);
        for (side, edge) in [(-1.0, b.low[0]), (1.0, b.high[0])] {
            let Some(pick) = &set else { continue };
            let x = edge + side * (0.5 * pick.size[0] + 0.06);
            let Some(table) = s.back_to(&room.walls[0], &floor, pick, [x, x]) else { continue };
            let Some(on) = s.top(table) else { continue };
            let lamp = s.scatter(&on, &[TABLE_LAMP], 1, ABOUT).pop();
            s.lit(lamp, 12.0);
            top.get_or_insert(on);
        }
    }
    let chest = ask(F::Cabinet).least(0.6, 0.5, 0.3).most(1.6, 1.2, 0.65);
    if let Some(chest) = s.against(&room.walls[3], &floor, &chest, [-1.0, 1.2])
        && let Some(on) = s.top(chest)
    {
        top = Some(on);
    }
    let top = match top {
        Some(top) => top,
        None => {
            let x = -room.floor.half[0] + 0.4;
            bench(s, Stuff::Wood, [x, 0.0, 0.8], [0.5, 0.75, 0.9], Turn::NONE)
        }
    };
    s.main(&top, &[F::Vessel, F::Ornament, F::Toy, F::Instrument], [0.12, 0.3]);
    if let Some(bed) = bed {
        for top in s.tops(bed) {
            s.scatter(&top, &[ask(F::Cushion), ask(F::Cloth).most(0.9, 0.4, 0.9), BOOK_LYING], 3, ABOUT);
        }
    }
    let _ = s.against(&room.walls[3], &floor, &ask(F::Cabinet).least(0.8, 1.5, 0.4).most(2.4, 2.3, 0.8), [-1.5, 1.5]);
    s.ceiling_lamps(&room, 30.0);
    let _ = s.against(&room.walls[1], &floor, &CHAIR, [-1.2, 1.5]);
    s.scatter(&floor, &[ask(F::Rug).most(1.9, 0.05, 1.6)], 1, ABOUT);
    let n = s.some(4);
    s.scatter(&top, &[BOOK_LYING, ask(F::Clock).most(0.3, 0.3, 0.2), VESSEL, POT], n, ABOUT);
    s.scatter(&floor.inset(0.2), &[TALL_PLANT, BOX, ask(F::Bin).most(0.4, 0.5, 0.4)], 3, ANY);
    pictures(s, &room, 0, 2);
    pictures(s, &room, 3, 1);
    let focus = room.part([-0.4, 0.4], [0.3, 1.0], [-0.8, 0.1]);
    s.room_eyes(&room, focus);
}

/// A row of counters, cupboards above, a table with chairs, pots and food.
pub fn kitchen(s: &mut Stage<'_>) {
    s.bare = true;
    let size = [s.draw("width", 3.0, 4.8), s.draw("height", 2.4, 2.8), s.draw("depth", 2.8, 4.2)];
    let made = Finishes {
        floor: Stuff::Tile,
        walls: [Stuff::Tile, Stuff::Plaster][s.choose("walls", 2)],
        ceiling: Stuff::Plaster,
    };
    let windows = [window(s, 3, size[1], size[2])];
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let (x, z) = (floor.half[0], floor.half[1]);
    let deep = 0.3;
    let long = x - 0.02;
    // Counter along the back wall: doors in front of a body on a recessed foot.
    let back = -z + deep + 0.005;
    s.board(
        "counter foot",
        Stuff::Plastic,
        Board { center: [0.0, 0.05, back - 0.03], half: [long, 0.05, deep - 0.04], ..Board::PLAIN },
    );
    s.board(
        "counter",
        Stuff::PaintedMetal,
        Board { center: [0.0, 0.475, back - 0.012], half: [long, 0.375, deep - 0.018], ..Board::PLAIN },
    );
    let doors = (2.0 * long / 0.55).round().max(2.0);
    for i in 0..doors as usize {
        let w = long / doors;
        let cx = -long + w * (2 * i + 1) as f64;
        s.board(
            "fronts",
            Stuff::Wood,
            Board {
                center: [cx, 0.475, back + deep - 0.02],
                half: [w, 0.365, 0.009],
                inset: [4.0 * GAP, 0.0, 0.0],
                ..Board::PLAIN
            },
        );
        s.board(
            "handles",
            Stuff::Metal,
            Board { center: [cx, 0.8, back + deep - 0.002], half: [0.06, 0.006, 0.006], ..Board::PLAIN },
        );
    }
    let top = s.board(
        "worktop",
        Stuff::Stone,
        Board {
            center: [0.0, 0.87, back + 0.005],
            half: [long, 0.02, deep + 0.01],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    let top = top.part([-0.98, 0.98], [-0.9, 0.92]);
    let span = s.draw("cupboards", 0.4, 0.95);
    let mut cx = -long;
    while cx + 0.6 < -long + 2.0 * long * span {
        s.board(
            "cupboards",
            Stuff::PaintedMetal,
            Board { center: [cx + 0.3, 1.75, -z + 0.17], half: [0.297, 0.33, 0.16], ..Board::PLAIN },
        );
        s.board(
            "fronts",
            Stuff::Wood,
            Board { center: [cx + 0.3, 1.75, -z + 0.341], half: [0.294, 0.327, 0.008], ..Board::PLAIN },
        );
        s.light(Light::Panel([cx + 0.3, 1.419, -z + 0.16], [0.0, -1.0, 0.0], [0.2, 0.02]), 3.0);
        cx += 0.6;
    }
    let mut low = top.clone();
    low.clearance = 0.5;
    s.main(&low, &[F::Vessel, F::Food], [0.12, 0.3]);
    let table = s.place(&TABLE.most(1.6, 0.95, 1.0), &floor, [0.25 * x, 0.35 * z], 0.0);
    if let Some(table) = table {
        s.around(table, &CHAIR, 3, &floor);
        if let Some(on) = s.top(table) {
            let n = s.some(4);
            s.scatter(&on, &[PLATE, VESSEL, FOOD, UTENSIL], n, ANY);
        }
    }
    s.ceiling_lamps(&room, 35.0);
    let n = s.some(10);
    s.scatter(&low, &[VESSEL, FOOD, UTENSIL, PLATE, VESSEL, BOX.most(0.4, 0.45, 0.4), POT], n, ABOUT);
    let _ = s.against(&room.walls[1], &floor, &ask(F::Cabinet).least(0.4, 1.2, 0.3).most(1.2, 2.2, 0.8), [-0.4, 0.8]);
    let _ = s.against(&room.walls[1], &floor, &ask(F::Bin).most(0.5, 0.8, 0.5), [-0.5, 1.2]);
    let _ = s.on_wall(&room.walls[1], &CLOCK, [-0.8, 0.8], [1.5, 1.8]);
    let _ = s.against(&room.walls[2], &floor, &ask(F::Fixture).most(1.3, 0.9, 0.3), [-1.0, 1.0]);
    let focus = room.part([-0.5, 0.5], [0.7, 1.1], [-0.9, 0.2]);
    s.room_eyes(&room, focus);
    s.look_at(1.0, &low.part([-0.4, 0.4], [-1.0, 1.0]), 0.3, [-0.9, 0.9], [0.2, 0.7]);
}

/// A long table with chairs all round, laid, a lamp above it, a sideboard.
pub fn dining_room(s: &mut Stage<'_>) {
    let size = [s.draw("width", 3.8, 5.6), s.draw("height", 2.5, 3.2), s.draw("depth", 3.6, 5.0)];
    let made = homely(s);
    let windows = [window(s, 0, size[1], size[0]), window(s, 1, size[1], size[2])];
    let room = s.room(size, made, &windows, Some(3));
    let floor = room.floor.clone();
    let mut on = floor.clone();
    if s.maybe("rug", 0.4)
        && let Some(rug) = s.place(&ask(F::Rug).least(2.0, 0.0, 1.4).most(3.6, 0.05, 3.0), &floor, [0.0; 2], 0.0)
    {
        on = s.upon(rug).unwrap_or(on);
    }
    let table = s.place(&TABLE, &on, [0.0, 0.0], 0.0);
    let top = match table.and_then(|t| s.top(t)) {
        Some(top) => top,
        None => bench(s, Stuff::Wood, [0.0, on.center[1] + 0.001, 0.0], [1.8, 0.75, 0.9], Turn::NONE),
    };
    s.main(&top.part([-0.45, 0.45], [-0.4, 0.4]), &[F::Vessel, F::Food, F::Ornament], [0.16, 0.32]);
    let seats = 4 + 2 * s.choose("seats", 2);
    if let Some(table) = table {
        s.around(table, &CHAIR, seats, &floor);
    }
    let drop = size[1];
    let lamp = s.hang(&ask(F::CeilingLamp).most(1.2, drop - 1.4, 1.2), [0.0, 0.0], drop, 0.0);
    s.lit(lamp, 45.0);
    if lamp.is_none() {
        s.panel_lamp([0.0, drop, 0.0], [0.3, 0.3], 45.0);
    }
    lay(s, &top, seats);
    s.scatter(&top, &[ask(F::Lamp).most(0.15, 0.45, 0.15), VESSEL, FOOD], 3, ANY);
    let board = ask(F::Cabinet).least(0.8, 0.5, 0.3).most(2.2, 1.2, 0.7);
    if let Some(board) = s.against(&room.walls[2], &floor, &board, [-0.6, 0.6])
        && let Some(on) = s.top(board)
    {
        let n = s.some(5);
        s.scatter(&on, &[VESSEL, TABLE_LAMP, ORNAMENT, PLATE, POT], n, ABOUT);
    }
    s.scatter(&floor.inset(0.25), &[TALL_PLANT], 2, ANY);
    pictures(s, &room, 2, 3);
    let focus = Aabb { low: [-0.7, 0.5, -0.5], high: [0.7, 1.0, 0.5] };
    s.room_eyes(&room, focus);
    s.look_at(1.0, &top, 0.4, ROUND, [0.25, 0.8]);
}

/// Desk at a wall, shelves of books, a reading chair.
pub fn study(s: &mut Stage<'_>) {
    let size = [s.draw("width", 3.2, 4.6), s.draw("height", 2.5, 3.1), s.draw("depth", 3.0, 4.4)];
    let made = homely(s);
    let windows = [window(s, 1, size[1], size[2])];
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let desk = s.against(&room.walls[0], &floor, &ask(F::Desk), [-0.4, 0.4]);
    let top = match desk.and_then(|d| s.top(d)) {
        Some(top) => top,
        None => bench(s, Stuff::Wood, [0.0, 0.0, -floor.half[1] + 0.4], [1.4, 0.74, 0.7], Turn::NONE),
    };
    s.main(&top, &[F::Ornament, F::Sculpture, F::Vessel, F::Instrument], [0.12, 0.28]);
    if let Some(pick) = s.pick(&CHAIR) {
        for step in 0..12 {
            let z = top.center[2] + top.half[1] + 0.1 + 0.06 * f64::from(step);
            let turn = Turn::toward([0.15, -1.0]);
            if s.put_at(&pick, &floor, [top.center[0] + 0.1, z], turn).is_some() {
                break;
            }
        }
    }
    let n = s.some(5);
    desk_things(s, &top, n);
    s.ceiling_lamps(&room, 30.0);
    let shelf = SHELF.least(0.5, 0.8, 0.2).most(2.2, size[1] - 0.1, 0.6);
    for (wall, along) in [(3, [-1.2, -0.2]), (3, [0.4, 1.4])] {
        if let Some(shelf) = s.against(&room.walls[wall], &floor, &shelf, along) {
            let each = s.some(9);
            fill(s, shelf, &[&[BOOK], &[BOOK], &[ORNAMENT, POT, CLOCK, BOX.most(0.3, 0.3, 0.3)]], each);
        }
    }
    s.scatter(&floor.inset(0.3), &[ask(F::Sofa).most(1.2, 1.3, 1.2)], 1, ANY);
    let lamp = s.scatter(&floor.inset(0.2), &[FLOOR_LAMP], 1, ANY).pop();
    s.lit(lamp, 20.0);
    s.scatter(&floor.inset(0.2), &[TALL_PLANT, ask(F::Bin).most(0.4, 0.5, 0.4), BOX, ask(F::Instrument)], 4, ANY);
    pictures(s, &room, 0, 2);
    let focus = room.part([-0.6, 0.4], [0.6, 1.2], [-0.9, 0.0]);
    s.room_eyes(&room, focus);
}
