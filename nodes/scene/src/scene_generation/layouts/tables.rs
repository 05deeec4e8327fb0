//! Close by: tables, boards and shelves.

use super::kit::*;
use crate::scene_generation::{
    place::{SEAM, Surface, Turn},
    props::ask,
    shell::{Finishes, Room, Window},
    stage::{Board, Light, Stage},
};
use core::f64::consts::PI;
use tauflow_data::geom::{Aabb, Vec3};
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// A room about a table, dim or with a window.
pub fn about_room(s: &mut Stage<'_>, lit: bool) -> Room {
    let size = [s.draw("width", 2.6, 3.8), s.draw("height", 2.3, 2.7), s.draw("depth", 2.6, 3.6)];
    let made = homely(s);
    let windows = [window(s, 3, size[1], size[2])];
    let open = usize::from(lit || s.maybe("window", 0.5));
    s.room(size, made, &windows[..open], Some(2))
}

/// A table top at hand, with what it stands on, in the middle of a room.
pub fn table(s: &mut Stage<'_>, width: [f64; 2], depth: [f64; 2]) -> Surface {
    let stuff = [Stuff::Wood, Stuff::Wood, Stuff::Stone, Stuff::Plastic][s.choose("table", 4)];
    let size = [s.draw("table.width", width[0], width[1]), 0.74, s.draw("table.depth", depth[0], depth[1])];
    bench(s, stuff, [0.0, 0.0, -0.2], size, Turn::NONE)
}

/// A lamp of small size over a place: a short shade round a ball, on a stem from above.
pub fn low_lamp(s: &mut Stage<'_>, at: Vec3, ceiling: f64, power: f64) {
    let radius = 0.035;
    s.light(Light::Ball(at, radius), power);
    let stem = 0.5 * (ceiling - at[1] - 0.05);
    s.board(
        "cord",
        Stuff::Rubber,
        Board { center: [at[0], at[1] + 0.05 + stem, at[2]], half: [0.004, stem, 0.004], ..Board::PLAIN },
    );
    for (dx, dz, hx, hz) in
        [(0.0, 0.09, 0.09, 0.004), (0.0, -0.09, 0.09, 0.004), (0.09, 0.0, 0.004, 0.086), (-0.09, 0.0, 0.004, 0.086)]
    {
        s.board(
            "shade",
            Stuff::PaintedMetal,
            Board { center: [at[0] + dx, at[1] + 0.03, at[2] + dz], half: [hx, 0.06, hz], ..Board::PLAIN },
        );
    }
    s.board(
        "shade",
        Stuff::PaintedMetal,
        Board { center: [at[0], at[1] + 0.092, at[2]], half: [0.094, 0.002, 0.094], ..Board::PLAIN },
    );
}

/// Fruit, bottles, cloth and a board on a table.
pub fn still_life(s: &mut Stage<'_>) {
    let room = about_room(s, true);
    let top = table(s, [0.8, 1.2], [0.5, 0.7]);
    let mid = top.part([-0.7, 0.7], [-0.7, 0.7]);
    s.main(&mid, &[F::Vessel, F::Ornament, F::Food, F::Sculpture], [0.16, 0.34]);
    s.scatter(&top, &[ask(F::Cloth).most(0.5, 0.3, 0.4)], 1, ABOUT);
    let n = s.some(14);
    s.scatter(
        &mid,
        &[FOOD, FOOD, VESSEL, VESSEL, PLATE, ORNAMENT, BOOK_LYING, ask(F::Leaves).most(0.3, 0.2, 0.3)],
        n,
        ANY,
    );
    let lamp = s.scatter(&top, &[TABLE_LAMP], 1, ANY).pop();
    s.lit(lamp, 10.0);
    s.ceiling_lamps(&room, 15.0);
    s.look_at(3.0, &mid, 0.35, [-0.8, 0.8], [0.08, 0.6]);
}

/// A worktop: chopping, jars, pots, vegetables.
pub fn kitchen_counter(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    s.bare = true;
    let size = [s.draw("width", 2.4, 3.4), 2.5, s.draw("depth", 2.2, 3.0)];
    let made = Finishes { floor: Stuff::Tile, walls: Stuff::Tile, ceiling: Stuff::Plaster };
    let windows = [window(s, 3, 2.5, size[2])];
    let room = s.room(size, made, &windows, Some(2));
    let (x, z) = (room.floor.half[0], room.floor.half[1]);
    s.board(
        "counter",
        Stuff::PaintedMetal,
        Board { center: [0.0, 0.425, -z + 0.29], half: [x - 0.02, 0.4245, 0.285], ..Board::PLAIN },
    );
    let top = s.board(
        "worktop",
        Stuff::Stone,
        Board { center: [0.0, 0.87, -z + 0.3], half: [x - 0.02, 0.02, 0.3], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    let part = top.part([-0.75, 0.75], [-0.9, 0.92]);
    // A wooden board to cut on, and a rail with hooks above.
    let cut = s.board(
        "chopping",
        Stuff::Wood,
        Board { center: [0.1, 0.9055, -z + 0.36], half: [0.2, 0.0145, 0.14], turn: Turn::new(0.2), ..Board::PLAIN },
    );
    s.main(&part, &[F::Vessel, F::Food], [0.14, 0.3]);
    s.scatter(&cut, &[FOOD.most(0.2, 0.2, 0.2), UTENSIL.most(0.3, 0.1, 0.2)], 3, ANY);
    s.board("rail", Stuff::Metal, Board { center: [0.0, 1.5, -z + 0.03], half: [0.6, 0.008, 0.008], ..Board::PLAIN });
    let shelf = s.board(
        "wall shelf",
        Stuff::Wood,
        Board { center: [0.0, 1.62, -z + 0.112], half: [0.7, 0.012, 0.11], ..Board::PLAIN },
    );
    s.light(Light::Panel([0.0, 1.607, -z + 0.15], [0.0, -1.0, 0.0], [0.5, 0.012]), 7.0);
    let n = s.some(5);
    s.row(
        &shelf,
        &[VESSEL.most(0.2, 0.3, 0.2), VESSEL.most(0.16, 0.25, 0.16), POT.most(0.2, 0.3, 0.2)],
        [0.03, 0.15],
        0.0,
        0.9,
    );
    s.scatter(&part, &[UTENSIL, VESSEL, FOOD, VESSEL, FOOD, PLATE, POT.most(0.35, 0.45, 0.35)], 2 * n, ABOUT);
    s.ceiling_lamps(&room, 20.0);
    s.look_at(3.0, &part.part([-0.5, 0.5], [-1.0, 1.0]), 0.5, [-0.7, 0.7], [0.1, 0.6]);
}

/// A sill before a window, with plants and small things, seen from the room.
pub fn window_sill(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    s.bare = true;
    let size = [s.draw("width", 2.4, 3.6), s.draw("height", 2.3, 2.7), s.draw("depth", 2.4, 3.4)];
    let made = homely(s);
    let wide = s.draw("window.width", 1.2, 1.9);
    let windows = [Window { wall: 0, s: 0.0, width: wide, sill: 0.85, height: size[1] - 1.15 }];
    let room = s.room(size, made, &windows, Some(2));
    let z = 0.5 * size[2];
    let sill = s.board(
        "deep sill",
        Stuff::Stone,
        Board { center: [0.0, 0.8745, -z + 0.155], half: [0.5 * wide + 0.1, 0.02, 0.15], ..Board::PLAIN },
    );
    s.board(
        "radiator",
        Stuff::PaintedMetal,
        Board { center: [0.0, 0.5, -z + 0.09], half: [0.45 * wide, 0.3, 0.045], ..Board::PLAIN },
    );
    for i in 0..12 {
        let x = 0.45 * wide * ((f64::from(i) + 0.5) / 6.0 - 1.0);
        s.board(
            "radiator",
            Stuff::PaintedMetal,
            Board { center: [x, 0.5, -z + 0.14], half: [0.025, 0.29, 0.0045], ..Board::PLAIN },
        );
    }
    s.main(&sill, &[F::Vessel, F::Ornament, F::Sculpture, F::Toy], [0.12, 0.26]);
    let small = POT.most(0.45, 0.7, 0.28);
    s.row(
        &sill,
        &[small, VESSEL.most(0.22, 0.35, 0.22), small, ORNAMENT.most(0.22, 0.35, 0.22)],
        [0.03, 0.2],
        0.0,
        1.0,
    );
    let n = s.some(3);
    s.scatter(&sill, &[FOOD.most(0.15, 0.2, 0.15), BOOK_LYING.most(0.25, 0.06, 0.2), SOLID], n, ABOUT);
    let _ = s.against(&room.walls[1], &room.floor.clone(), &CHAIR, [0.0, 0.5]);
    let _ = s.against(&room.walls[3], &room.floor.clone(), &TALL_PLANT, [0.2, 0.8]);
    s.ceiling_lamps(&room, 8.0);
    s.look_at(3.0, &sill, 0.5, [-0.8, 0.8], [0.0, 0.5]);
}

/// A table laid for guests under a hanging lamp, seen from a seat.
pub fn dinner_table(s: &mut Stage<'_>) {
    let room = about_room(s, false);
    let stuff = [Stuff::Wood, Stuff::Fabric][s.choose("top", 2)];
    let size = [s.draw("table.width", 1.4, 2.0), 0.75, s.draw("table.depth", 0.85, 1.0)];
    let top = bench(s, stuff, [0.0, 0.0, -0.1], size, Turn::NONE);
    s.main(&top.part([-0.4, 0.4], [-0.35, 0.35]), &[F::Vessel, F::Food, F::Ornament], [0.16, 0.32]);
    let seats = 4 + 2 * s.choose("seats", 2);
    lay(s, &top, seats);
    let drop = size[1] + s.draw("lamp.height", 0.6, 0.9);
    let at = [0.0, drop, -0.1];
    low_lamp(s, at, room.height(), 22.0);
    let n = s.some(8);
    s.scatter(&top, &[VESSEL, FOOD, PLATE, ask(F::Lamp).most(0.14, 0.4, 0.14), UTENSIL, FOOD], n, ANY);
    s.ceiling_lamps(&room, 6.0);
    let chair = s.pick(&CHAIR);
    for (x, z, turn) in [(-0.4, 0.75, PI), (0.4, 0.75, PI), (-0.4, -0.95, 0.0), (0.4, -0.95, 0.0)] {
        if let Some(chair) = &chair {
            let _ = s.put_at(chair, &room.floor.clone(), [x, z], Turn::new(turn));
        }
    }
    s.look_at(3.0, &top, 0.3, ROUND, [0.2, 0.7]);
}

/// Shelf boards filled with toys, and a box of them on the floor.
pub fn toy_shelf(s: &mut Stage<'_>) {
    let room = about_room(s, true);
    let floor = room.floor.clone();
    let shelf = SHELF.least(0.6, 0.6, 0.2).most(2.2, 2.2, 0.6);
    if let Some(shelf) = s.against(&room.walls[0], &floor, &shelf, [-0.3, 0.3]) {
        let tops = s.tops(shelf);
        if let Some(board) = tops.get(tops.len() / 2) {
            s.main(board, &[F::Toy, F::Solid, F::Instrument], [0.12, 0.28]);
        }
        let each = s.some(6);
        fill(s, shelf, &[&[TOY], &[TOY, SOLID], &[BOOK, BOOK, BOOK_ROW], &[TOY, BOX.most(0.35, 0.3, 0.35)]], each);
    }
    if !s.has_main {
        let top = plinth(s, Stuff::Wood, [0.0, -0.7], [0.6, 0.25], 0.5);
        s.main(&top, &[F::Toy, F::Solid, F::Instrument], [0.15, 0.35]);
    }
    let rug = s.place(&ask(F::Rug).most(2.0, 0.05, 1.6), &floor, [0.0, 0.2], 0.0);
    let on = rug.and_then(|r| s.upon(r)).unwrap_or_else(|| floor.part([-0.6, 0.6], [-0.3, 0.6]));
    let n = s.some(9);
    s.scatter(&on, &[TOY, TOY, SOLID.scaled(0.05, 0.2), BOOK_LYING], n, ANY);
    s.scatter(&floor, &[BOX, ask(F::Cushion), CHAIR.most(0.7, 0.9, 0.7)], 3, ANY);
    s.ceiling_lamps(&room, 25.0);
    let _ = s.on_wall(&room.walls[1], &FRAME, [-0.5, 0.5], [1.1, 1.4]);
    let focus = room.part([-0.4, 0.4], [0.3, 1.0], [-1.0, 0.2]);
    s.room_eyes(&room, focus);
}

/// Books on end, lying, leaning in piles, with ornaments between: a bookcase close by.
pub fn bookshelf(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let room = about_room(s, false);
    let (x, z) = (room.floor.half[0], room.floor.half[1]);
    let wide = s.draw("shelf.width", 0.5, 0.9).min(0.9 * x);
    let deep = 0.15;
    let boards = 4;
    let rise = s.draw("rise", 0.32, 0.4);
    let at = -z + deep + 0.004;
    for side in [-1.0, 1.0] {
        let h = 0.5 * (rise * f64::from(boards) + 0.12);
        s.board(
            "case",
            Stuff::Wood,
            Board { center: [side * (wide + 0.011), h, at], half: [0.0105, h, deep], ..Board::PLAIN },
        );
    }
    let mut tops = Vec::new();
    for i in 0..=boards {
        let y = 0.1 + rise * f64::from(i);
        let mut top =
            s.board("case", Stuff::Wood, Board { center: [0.0, y, at], half: [wide, 0.01, deep], ..Board::PLAIN });
        top.clearance = if i == boards { 0.5 } else { rise - 0.022 };
        tops.push(top);
    }
    s.main(&tops[3].part([-0.7, 0.7], [-0.8, 0.8]), &[F::Ornament, F::Vessel, F::Sculpture, F::Toy], [0.12, 0.24]);
    for (i, top) in tops.iter().enumerate().rev() {
        let before = s.most;
        let each = s.some(12);
        s.most = before.min(s.things.len() + each);
        if i == 4 {
            s.row(
                top,
                &[ORNAMENT, POT.most(0.35, 0.45, 0.28), VESSEL, BOX.most(0.4, 0.3, 0.28)],
                [0.05, 0.3],
                0.0,
                0.95,
            );
        } else {
            let share = s.any(0.5, 1.0);
            let tall = BOOK.most(0.1, rise - 0.03, 0.28);
            s.row(top, &[tall], [0.001, 0.003], 0.7, share);
            let x = s.any(0.2, 0.8) * wide;
            s.pile(top, &BOOK_LYING.most(0.28, 0.08, 0.28), [x, 0.0], 3);
            s.scatter(top, &[ORNAMENT.most(0.2, rise - 0.05, 0.25), VESSEL.most(0.2, rise - 0.05, 0.2)], 1, ABOUT);
        }
        s.most = before;
    }
    s.ceiling_lamps(&room, 22.0);
    let spot = [0.3, room.height(), at + 0.9];
    s.spot_lamp(spot, [0.0, 1.2, at], 10.0);
    let face = Aabb { low: [-0.5 * wide, 0.5, at], high: [0.5 * wide, 1.4, at + deep] };
    use crate::scene_generation::stage::From;
    s.eye(3.0, From::Orbit([0.7, 1.8], [-0.7, 0.7], [-0.1, 0.4]), face);
}
