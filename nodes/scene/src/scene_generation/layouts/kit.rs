//! Shared parts of layouts: usual sizes of things, custom tables, filled desks and shelves.

use crate::scene_generation::{
    place::{Surface, Turn},
    props::{Ask, ask},
    shell::{Finishes, Room, Window},
    stage::{Board, Stage},
};
use core::f64::consts::{PI, TAU};
use tauflow_data::geom::Vec3;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// Turned any way.
pub const ANY: [f64; 2] = [-PI, PI];
/// Turned a little.
pub const ABOUT: [f64; 2] = [-0.35, 0.35];
/// All round.
pub const ROUND: [f64; 2] = [0.0, TAU];

/// Small things for tables and shelves.
pub const VESSEL: Ask = ask(F::Vessel).most(0.3, 0.4, 0.3);
/// Books as they lie.
pub const BOOK_LYING: Ask = ask(F::Book).named(&["book"]).most(0.4, 0.4, 0.4).lying();
/// Books on end.
pub const BOOK: Ask = ask(F::Book).named(&["book"]).most(0.12, 0.36, 0.32).upright();
/// Books as they lie about: piles, open ones.
pub const BOOKS_ABOUT: Ask = ask(F::Book).named(&["book_pile", "book_open", "book"]).most(0.5, 0.35, 0.4);
/// Rows of books.
pub const BOOK_ROW: Ask = ask(F::Book).named(&["book_row"]).most(1.2, 0.36, 0.32);
/// Sheets.
pub const PAPER: Ask = ask(F::Paper).most(0.45, 0.2, 0.45);
/// Pens.
pub const PEN: Ask = ask(F::Pen).most(0.3, 0.3, 0.3);
/// Fruit and bread.
pub const FOOD: Ask = ask(F::Food).most(0.4, 0.35, 0.4);
/// Plates and trays.
pub const PLATE: Ask = ask(F::Plate).most(0.45, 0.1, 0.45);
/// Cutlery, pots.
pub const UTENSIL: Ask = ask(F::Utensil).most(0.45, 0.4, 0.45);
/// Ornaments.
pub const ORNAMENT: Ask = ask(F::Ornament).most(0.35, 0.45, 0.35);
/// Toys.
pub const TOY: Ask = ask(F::Toy).most(0.5, 0.5, 0.5);
/// Tools.
pub const TOOL: Ask = ask(F::Tool).most(0.6, 0.5, 0.6);
/// Machine parts.
pub const PART: Ask = ask(F::MachinePart).most(0.4, 0.4, 0.4);
/// Plants in small pots.
pub const POT: Ask = ask(F::Plant).most(0.6, 0.6, 0.6);
/// Plants that stand on the floor.
pub const TALL_PLANT: Ask = ask(F::Plant).least(0.0, 0.6, 0.0).most(1.4, 2.2, 1.4);
/// Lamps for tables.
pub const TABLE_LAMP: Ask = ask(F::Lamp).most(0.5, 0.75, 0.5);
/// Lamps that stand on the floor.
pub const FLOOR_LAMP: Ask = ask(F::Lamp).least(0.0, 1.1, 0.0).most(0.9, 2.1, 0.9);
/// Chairs.
pub const CHAIR: Ask = ask(F::Chair).most(0.9, 1.3, 0.9);
/// Boxes that one can carry.
pub const BOX: Ask = ask(F::Box).most(0.7, 0.6, 0.7);
/// Shelves with closed boards, which small things do not fall through.
pub const SHELF: Ask = ask(F::Shelf).named(&["bookcase", "shelf_ladder", "shelf_cubes"]);
/// Boxes with flat lids.
pub const CRATE: Ask = ask(F::Box).named(&["carton", "suitcase"]).most(0.7, 0.6, 0.7);
/// Clocks.
pub const CLOCK: Ask = ask(F::Clock).most(0.6, 0.6, 0.15);
/// Pictures.
pub const FRAME: Ask = ask(F::Frame).most(1.6, 1.3, 0.12);
/// Dining tables.
pub const TABLE: Ask = ask(F::Table).least(0.9, 0.62, 0.6).most(2.8, 0.95, 1.6);
/// Low tables.
pub const LOW_TABLE: Ask = ask(F::Table).least(0.4, 0.2, 0.3).most(1.6, 0.58, 1.2);
/// Small tables beside beds and sofas.
pub const SIDE_TABLE: Ask = ask(F::Table).most(0.75, 0.95, 0.75);
/// Solids and gems.
pub const SOLID: Ask = ask(F::Solid).scaled(0.04, 0.14);

/// A middling window on a wall.
pub fn window(s: &mut Stage<'_>, wall: usize, tall: f64, wide: f64) -> Window {
    let sill = s.draw(&format!("sill.{wall}"), 0.75, 1.0);
    Window {
        wall,
        s: s.draw(&format!("window.{wall}.at"), -0.25, 0.25) * wide,
        width: s.draw(&format!("window.{wall}.width"), 0.9, 2.2).min(wide - 0.6),
        sill,
        height: (tall - sill - 0.3).min(1.5),
    }
}

/// A homely finish.
pub fn homely(s: &mut Stage<'_>) -> Finishes {
    let floor = [Stuff::Wood, Stuff::Wood, Stuff::Carpet, Stuff::Tile][s.choose("floor", 4)];
    let walls = [Stuff::Plaster, Stuff::Wallpaper, Stuff::Plaster, Stuff::Wallpaper][s.choose("walls", 4)];
    Finishes { floor, walls, ceiling: Stuff::Plaster }
}

/// The ground of a place in the open: a square of half a side `half`.
pub fn ground(s: &mut Stage<'_>, stuff: Stuff, half: f64) -> Surface {
    let (l, h) = (-half, half);
    s.quad("ground", stuff, [[l, 0.0, h], [h, 0.0, h], [h, 0.0, l], [l, 0.0, l]]);
    Surface::flat([0.0; 3], [half; 2], 100.0)
}

/// A table made to measure: top, four legs; gives its top. `center` is the middle of its foot.
pub fn bench(s: &mut Stage<'_>, stuff: Stuff, center: Vec3, size: [f64; 3], turn: Turn) -> Surface {
    let [width, height, depth] = size;
    let thick = 0.02;
    let (x, z) = (0.5 * width, 0.5 * depth);
    let leg = (0.03 + 0.01 * width).min(0.06);
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let [dx, dz] = turn.apply([sx * (x - leg - 0.03), sz * (z - leg - 0.03)]);
        let foot = [center[0] + dx, center[1] + 0.5 * height - thick, center[2] + dz];
        s.board(
            "bench legs",
            stuff,
            Board { center: foot, half: [leg, 0.5 * height - thick, leg], turn, ..Board::PLAIN },
        );
    }
    let top = [center[0], center[1] + height - thick, center[2]];
    s.board("bench", stuff, Board { center: top, half: [x, thick, z], turn, ..Board::PLAIN })
}

/// A plinth or pedestal; gives its top.
pub fn plinth(s: &mut Stage<'_>, stuff: Stuff, at: [f64; 2], half: [f64; 2], height: f64) -> Surface {
    let center = [at[0], 0.5 * height, at[1]];
    s.board("plinths", stuff, Board { center, half: [half[0], 0.5 * height, half[1]], ..Board::PLAIN })
}

/// Things on a desk.
pub fn desk_things(s: &mut Stage<'_>, top: &Surface, n: usize) {
    let back = top.part([-0.95, 0.95], [-0.95, -0.1]);
    let screen = ask(F::Screen).most(0.75, 0.7, 0.45).least(0.15, 0.1, 0.0);
    if let Some(pick) = s.pick(&screen) {
        let x = s.any(-0.3, 0.3) * top.half[0];
        let z = -top.half[1] + 0.5 * pick.size[2] + 0.05;
        let _ = s.put(&pick, top, [x, z], 0.0);
    }
    if let Some(lamp) = s.scatter(&back, &[TABLE_LAMP], 1, ABOUT).pop() {
        s.lit(Some(lamp), 14.0);
    }
    let at = [s.any(-0.7, 0.7) * top.half[0], s.any(-0.4, 0.4) * top.half[1]];
    let piled = 2 + s.next().below(3);
    s.pile(top, &BOOK_LYING, at, piled);
    s.scatter(top, &[PAPER, PEN, PAPER, PEN, VESSEL, BOOKS_ABOUT, ask(F::Clock).most(0.3, 0.3, 0.2), POT], n, ABOUT);
}

/// Fills the boards of a shelf: rows of these asks on each board.
pub fn fill(s: &mut Stage<'_>, shelf: usize, asks: &[&[Ask]], each: usize) {
    for (number, board) in s.tops(shelf).into_iter().enumerate() {
        let kind = asks[(number + s.next().below(asks.len())) % asks.len()];
        let before = s.things.len();
        let share = s.any(0.55, 1.0);
        let books = kind.iter().all(|a| a.family == F::Book);
        let most = s.most;
        s.most = most.min(before + each);
        let gap = if books { [0.001, 0.003] } else { [0.02, 0.12] };
        s.row(&board, kind, gap, if books { 0.6 } else { 0.0 }, share);
        s.most = most;
    }
}

/// A table laid for its seats: plates, glasses, cutlery, something in the middle.
pub fn lay(s: &mut Stage<'_>, top: &Surface, seats: usize) {
    let long = top.half[0] >= top.half[1];
    let (along, across) = if long { (top.half[0], top.half[1]) } else { (top.half[1], top.half[0]) };
    let per = seats.div_ceil(2).max(1);
    let plate = s.pick(&PLATE);
    let glass = s.pick(&ask(F::Vessel).most(0.12, 0.28, 0.12));
    let fork = s.pick(&ask(F::Utensil).most(0.25, 0.06, 0.25));
    for i in 0..seats {
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        let shift = along * ((2 * (i / 2) + 1) as f64 / per as f64 - 1.0);
        let spot = |shift: f64, deep: f64| {
            let (a, c) = (shift, side * deep);
            if long { [a, c] } else { [c, a] }
        };
        let turn = if side > 0.0 { 0.0 } else { PI } + if long { 0.0 } else { 0.5 * PI };
        if let Some(pick) = &plate {
            let deep = across - 0.5 * pick.size[2] - 0.04;
            let _ = s.put(pick, top, spot(shift, deep), turn);
        }
        if let Some(pick) = &glass {
            let _ = s.put(pick, top, spot(shift + 0.13 * side, across - 0.36), turn);
        }
        if let Some(pick) = &fork {
            let deep = across - 0.5 * pick.size[2].max(pick.size[0]) - 0.04;
            let _ = s.put(pick, top, spot(shift - 0.2 * side, deep), turn);
        }
    }
}

/// Lights a number of lamps strung between two places, sagging.
pub fn string_lamps(s: &mut Stage<'_>, from: Vec3, to: Vec3, n: usize, power: f64) {
    use crate::scene_generation::stage::Light;
    for i in 0..n {
        let t = (i as f64 + 0.5) / n as f64;
        let sag = 0.5 * t * (1.0 - t);
        let at = [0, 1, 2].map(|k| from[k] + (to[k] - from[k]) * t);
        let at = [at[0], at[1] - sag, at[2]].map(crate::scene_generation::place::tenth);
        s.light(Light::Ball(at, 0.03), power / n as f64);
        // The cord, in short straight pieces.
        let next = (i as f64 + 1.5) / n as f64;
        if i + 1 < n {
            let to = [0, 1, 2].map(|k| from[k] + (to[k] - from[k]) * next);
            let to = [to[0], to[1] - 0.5 * next * (1.0 - next) + 0.035, to[2]];
            let from = [at[0], at[1] + 0.035, at[2]];
            let w = 0.004;
            s.quad(
                "cord",
                Stuff::Rubber,
                [
                    [from[0], from[1] - w, from[2]],
                    [to[0], to[1] - w, to[2]],
                    [to[0], to[1] + w, to[2]],
                    [from[0], from[1] + w, from[2]],
                ],
            );
        }
    }
}

/// Pictures in a row on a wall.
pub fn pictures(s: &mut Stage<'_>, room: &Room, wall: usize, n: usize) -> Vec<usize> {
    let wall = room.walls[wall].clone();
    let mut out = Vec::new();
    for i in 0..n {
        let at = wall.length * ((i as f64 + 0.5) / n as f64 - 0.5);
        let most = ask(F::Frame).most((wall.length / n as f64 - 0.15).max(0.3), 1.3, 0.12);
        out.extend(s.on_wall(&wall, &most, [at - 0.05, at + 0.05], [1.05, 1.35]));
    }
    out
}
