//! Bathrooms, attics, cellars.

use super::kit::*;
use crate::scene_generation::{
    place::{SEAM, Turn},
    props::ask,
    shell::{Finishes, PLAIN},
    stage::{Board, Light, Stage},
};
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// Tub, basin, mirror, tiles, towels, bottles.
pub fn bathroom(s: &mut Stage<'_>) {
    let size = [s.draw("width", 2.2, 3.4), s.draw("height", 2.3, 2.7), s.draw("depth", 2.2, 3.2)];
    let made = Finishes { floor: Stuff::Tile, walls: Stuff::Tile, ceiling: Stuff::Plaster };
    let windows = [window(s, 3, size[1], size[2])];
    let room = s.room(size, made, &windows, Some(2));
    let floor = room.floor.clone();
    let (x, z) = (floor.half[0], floor.half[1]);
    // A walled tub along the right wall, full of water.
    let (hx, hz) = (0.36, (z - 0.1).min(0.85));
    let (cx, cz) = (x - hx - 0.003, -z + hz + 0.003);
    let high = 0.28;
    for (c, h) in [
        ([cx, high, cz - hz + 0.04], [hx, high, 0.04]),
        ([cx, high, cz + hz - 0.04], [hx, high, 0.04]),
        ([cx - hx + 0.04, high, cz], [0.04, high, hz - 0.08]),
        ([cx + hx - 0.04, high, cz], [0.04, high, hz - 0.08]),
    ] {
        s.board("tub", Stuff::Ceramic, Board { center: c, half: h, ..Board::PLAIN });
    }
    s.board(
        "tub",
        Stuff::Ceramic,
        Board { center: [cx, 0.08, cz], half: [hx - 0.08, 0.08, hz - 0.08], ..Board::PLAIN },
    );
    let level = s.draw("water", 0.3, 0.48);
    let (wx, wz) = (hx - 0.079, hz - 0.079);
    s.quad(
        "water",
        Stuff::Water,
        [[cx - wx, level, cz + wz], [cx + wx, level, cz + wz], [cx + wx, level, cz - wz], [cx - wx, level, cz - wz]],
    );
    // A vanity with a mirror over it on the back wall.
    let (vx, wide) = (-x + 0.55, 0.5);
    s.board("vanity", Stuff::Wood, Board { center: [vx, 0.55, -z + 0.26], half: [wide, 0.25, 0.25], ..Board::PLAIN });
    let top = s.board(
        "vanity top",
        Stuff::Stone,
        Board {
            center: [vx, 0.82, -z + 0.27],
            half: [wide + 0.015, 0.02, 0.265],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    s.main(&top.part([-0.9, 0.9], [-0.8, 0.8]), &[F::Vessel, F::Ornament], [0.1, 0.24]);
    let (my, mh) = (1.45, 0.42);
    s.board(
        "mirror frame",
        Stuff::Metal,
        Board { center: [vx, my, -z - 0.008], half: [wide - 0.02, mh + 0.02, 0.02], ..Board::PLAIN },
    );
    s.quad(
        "mirror",
        Stuff::Mirror,
        [
            [vx - wide + 0.05, my - mh, -z + 0.0135],
            [vx + wide - 0.05, my - mh, -z + 0.0135],
            [vx + wide - 0.05, my + mh, -z + 0.0135],
            [vx - wide + 0.05, my + mh, -z + 0.0135],
        ],
    );
    s.board(
        "lamps",
        Stuff::PaintedMetal,
        Board { center: [vx, my + mh + 0.08, -z + 0.05], half: [0.3, 0.025, 0.04], ..Board::PLAIN },
    );
    s.light(Light::Panel([vx, my + mh + 0.0545, -z + 0.05], [0.0, -1.0, 0.05], [0.28, 0.03]), 12.0);
    s.ceiling_lamps(&room, 25.0);
    let n = s.some(8);
    let bottle = VESSEL.most(0.14, 0.3, 0.14);
    s.scatter(
        &top.inset(0.02),
        &[bottle, bottle, ask(F::Cloth).most(0.35, 0.25, 0.35), POT.most(0.3, 0.4, 0.3)],
        n,
        ABOUT,
    );
    let rim = crate::scene_generation::place::Surface::flat([cx - hx + 0.04, 2.0 * high, cz], [0.04, hz - 0.1], 2.0);
    s.scatter(&rim, &[ask(F::Vessel).most(0.075, 0.25, 0.075), ask(F::Solid).scaled(0.04, 0.07)], 3, ANY);
    s.scatter(&floor, &[ask(F::Rug).most(1.1, 0.05, 0.9)], 1, ABOUT);
    let _ = s.against(&room.walls[1], &floor, &CHAIR.most(0.6, 0.7, 0.6), [-0.8, 1.2]);
    let shelf = SHELF.least(0.3, 0.8, 0.15).most(0.9, 2.0, 0.45);
    if let Some(shelf) = s.against(&room.walls[3], &floor, &shelf, [-1.0, 1.0]) {
        let each = s.some(3);
        fill(s, shelf, &[&[ask(F::Cloth).most(0.4, 0.25, 0.35)], &[VESSEL], &[ORNAMENT]], each);
    }
    s.scatter(&floor.inset(0.1), &[ask(F::Bin).most(0.4, 0.7, 0.4), POT, BOX.most(0.45, 0.5, 0.4)], 3, ANY);
    let _ = s.on_wall(&room.walls[2], &ask(F::Cloth).most(0.8, 1.2, 0.16), [-0.8, 0.8], [0.9, 1.1]);
    let focus = room.part([-0.7, 0.6], [0.5, 1.2], [-0.9, -0.2]);
    s.room_eyes(&room, focus);
}

/// Under the roof: boards, sloping sides, boxes, trunks, what nobody needs any more.
pub fn attic(s: &mut Stage<'_>) {
    s.bare = true;
    let size = [s.draw("width", 4.0, 6.0), s.draw("height", 2.3, 2.9), s.draw("depth", 4.0, 6.5)];
    let made =
        Finishes { floor: Stuff::Wood, walls: [Stuff::Brick, Stuff::Wood][s.choose("walls", 2)], ceiling: Stuff::Wood };
    let windows = [window(s, 0, size[1], size[0] * 0.3)];
    let mut windows = windows;
    windows[0].sill = 0.9;
    windows[0].height = 0.9;
    let room = s.room(size, made, &windows, None);
    let (x, y, z) = (0.5 * size[0], size[1], 0.5 * size[2]);
    let knee = s.draw("knee", 0.7, 1.1);
    let flat = 0.35 * x;
    // Sloping sides from the knee walls up to the ceiling, and rafters under them.
    for sign in [-1.0, 1.0] {
        let (a, b) = ([sign * x, knee], [sign * flat, y]);
        let quad = [[a[0], a[1], sign * z], [a[0], a[1], -sign * z], [b[0], b[1], -sign * z], [b[0], b[1], sign * z]];
        s.quad("slopes", Stuff::Wood, quad);
        let rafters = (size[2] / 0.9).round() as usize;
        for i in 0..=rafters {
            let c = -z + 0.05 + (size[2] - 0.1) * i as f64 / rafters as f64;
            let drop = 0.1;
            for side in [-1.0, 1.0] {
                let e = c + 0.035 * side;
                let quad = [[a[0], a[1], e], [b[0], b[1], e], [b[0], b[1] - drop, e], [a[0], a[1] - drop, e]];
                s.quad("rafters", Stuff::Wood, quad);
            }
            let quad = [
                [a[0], a[1] - drop, c - 0.035],
                [b[0], b[1] - drop, c - 0.035],
                [b[0], b[1] - drop, c + 0.035],
                [a[0], a[1] - drop, c + 0.035],
            ];
            s.quad("rafters", Stuff::Wood, quad);
        }
        // Nothing stands under the slope that would reach it: steps of boxes stand for it.
        for k in 0..8 {
            let t = (f64::from(k) + 0.5) / 8.0;
            let (cx, low) = (a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * (t - 0.0625) - drop_of() - 0.15);
            let half = 0.5 * (x - flat) / 8.0;
            s.world.solids.push(crate::scene_generation::place::Solid {
                y: [low, y],
                at: [cx, 0.0],
                turn: Turn::NONE,
                half: [half, z],
            });
        }
    }
    let floor = room.floor.clone();
    let mut clear = floor.clone();
    clear.half[0] = x - 0.3;
    let chest = s.place(&CRATE.least(0.3, 0.2, 0.25).most(1.2, 0.7, 0.8), &clear, [0.2, -0.4], 0.4);
    let top = match chest.and_then(|c| s.lid(c)) {
        Some(lid) => lid,
        // A chest whose lid nothing can stand on is where this would be.
        None if chest.is_some() => plinth(s, Stuff::Wood, [-0.95, -0.4], [0.3, 0.25], 0.45),
        None => plinth(s, Stuff::Wood, [0.2, -0.4], [0.35, 0.25], 0.45),
    };
    s.main(&top, &[F::Toy, F::Instrument, F::Ornament, F::Vessel], [0.15, 0.35]);
    let lamp = s.hang(&ask(F::CeilingLamp).most(0.8, 0.9, 0.8), [0.0, 0.3], y, 0.0);
    s.lit(lamp, 30.0);
    if lamp.is_none() {
        s.panel_lamp([0.0, y, 0.3], [0.12, 0.12], 30.0);
    }
    let _ = s.against(&room.walls[2], &clear, &ask(F::Cabinet).most(1.6, 1.9, 0.8), [-0.4, 0.4]);
    let n = s.some(14);
    s.scatter(
        &clear,
        &[
            BOX,
            ask(F::Box).most(1.2, 0.9, 0.9),
            CHAIR,
            ask(F::Instrument),
            TOY,
            ask(F::Cabinet).most(1.0, 1.0, 0.7),
            ask(F::Bicycle),
            ask(F::Stair).most(1.0, 1.8, 1.0),
            ask(F::Cushion),
            TOOL,
        ],
        n,
        ANY,
    );
    for _ in 0..s.some(3) {
        let at = [s.any(-0.6, 0.6) * clear.half[0], s.any(-0.8, 0.8) * clear.half[1]];
        s.pile(&clear, &CRATE, at, 3);
    }
    for _ in 0..s.some(2) {
        let at = [s.any(-0.6, 0.6) * clear.half[0], s.any(-0.8, 0.8) * clear.half[1]];
        s.pile(&clear, &BOOK_LYING, at, 5);
    }
    let focus = room.part([-0.4, 0.4], [0.2, 0.9], [-0.5, 0.5]);
    s.inside = Some(Aabb { low: [-0.6 * x, 0.3, -z], high: [0.6 * x, 1.75, z] });
    s.room_eyes(&room, focus);
}

fn drop_of() -> f64 {
    0.12
}

/// Bare walls, racks of bottles and jars, barrels, one lamp.
pub fn cellar(s: &mut Stage<'_>) {
    let size = [s.draw("width", 2.6, 4.4), s.draw("height", 2.1, 2.6), s.draw("depth", 3.4, 6.0)];
    let made = Finishes {
        floor: Stuff::Concrete,
        walls: [Stuff::Brick, Stuff::Stone][s.choose("walls", 2)],
        ceiling: PLAIN.ceiling,
    };
    let mut high = window(s, 0, size[1], size[0]);
    (high.sill, high.height, high.width) = (size[1] - 0.55, 0.4, 0.8);
    let windows = [high];
    let open = usize::from(s.maybe("shaft", 0.4));
    let room = s.room(size, made, &windows[..open], Some(2));
    let floor = room.floor.clone();
    let shelf = SHELF.least(0.5, 0.8, 0.2).most(2.4, size[1] - 0.1, 0.7);
    let mut top = None;
    for (wall, along) in [(1, [-1.0, -0.5]), (3, [-0.8, -0.2]), (1, [0.8, 1.2]), (3, [0.8, 1.4])] {
        let Some(shelf) = s.against(&room.walls[wall], &floor, &shelf, along) else { continue };
        if top.is_none() {
            let tops = s.tops(shelf);
            top = tops.get(tops.len() / 2).cloned();
            if let Some(top) = &top {
                s.main(top, &[F::Vessel, F::Food, F::Tool], [0.12, 0.3]);
            }
        }
        let each = s.some(5);
        fill(s, shelf, &[&[VESSEL], &[VESSEL, BOX.most(0.4, 0.35, 0.4)], &[FOOD, VESSEL], &[TOOL, PART]], each);
    }
    if !s.has_main {
        let top = bench(s, Stuff::Wood, [0.0, 0.0, -0.8], [1.0, 0.8, 0.6], Turn::NONE);
        s.main(&top, &[F::Vessel, F::Food, F::Tool], [0.15, 0.35]);
    }
    let lamp = s.hang(&ask(F::CeilingLamp).most(0.5, 0.7, 0.5), [0.0, -0.3], size[1], 0.0);
    s.lit(lamp, 25.0);
    if lamp.is_none() {
        s.light(Light::Ball([0.0, size[1] - 0.2, -0.3], 0.045), 25.0);
        s.board(
            "cord",
            Stuff::Rubber,
            Board { center: [0.0, size[1] - 0.08, -0.3], half: [0.005, 0.075, 0.005], ..Board::PLAIN },
        );
    }
    let n = s.some(9);
    s.scatter(
        &floor,
        &[
            ask(F::Box).most(0.9, 1.1, 0.9),
            BOX,
            ask(F::Bin),
            ask(F::Vessel).least(0.1, 0.25, 0.1),
            ask(F::Bicycle),
            TOOL,
            ask(F::Stair).most(1.0, 1.9, 1.2),
        ],
        n,
        ANY,
    );
    let focus = room.part([-0.7, 0.7], [0.5, 1.4], [-0.8, 0.2]);
    s.room_eyes(&room, focus);
}
