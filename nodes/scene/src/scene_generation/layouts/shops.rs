//! Where things are sold and people are served.

use super::kit::*;
use crate::scene_generation::{
    place::{GAP, SEAM, Surface, Turn},
    props::ask,
    shell::{Finishes, Wall},
    stage::{Board, From, Light, Stage},
};
use tauflow_data::geom::{Aabb, add};
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// A glazed front of a lit shop at dusk, goods on steps behind it, the pavement before.
pub fn shop_window(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let floor = ground(s, Stuff::Asphalt, 30.0);
    let wide = s.draw("window.width", 1.8, 3.2);
    let (sill, high) = (0.5, s.draw("window.height", 1.4, 1.9));
    let stuff = s.one("front", &[Stuff::Brick, Stuff::Stone, Stuff::Plaster, Stuff::Tile]);
    let mut wall = Wall::new([0.0, 0.0, 0.0], Turn::NONE, 9.0, 5.0);
    let o = [-0.5 * wide, 0.5 * wide, sill, sill + high];
    wall.openings.push(o);
    wall.openings.push([0.5 * wide + 0.5, 0.5 * wide + 1.5, 0.0, 2.2]);
    s.wall("front", stuff, &wall, 0.25);
    for opening in wall.openings.clone() {
        s.reveal("reveal", stuff, &wall, opening, 0.25);
    }
    // The door, set back.
    let mid = 0.5 * wide + 1.0;
    s.board(
        "shop door",
        Stuff::Wood,
        // Not 1.1 inset by a gap: it rounds to another height, and so makes other scenes.
        Board { center: [mid, 1.1, -0.2], half: [0.5, 1.099, 0.03], inset: [GAP, 0.0, 0.0], ..Board::PLAIN },
    );
    s.board(
        "handle",
        Stuff::Metal,
        Board { center: [mid - 0.38, 1.05, -0.14], half: [0.012, 0.15, 0.02], ..Board::PLAIN },
    );
    // The display: a box open to the front.
    let deep = 0.6;
    let (cy, cz) = (sill + 0.5 * high, -0.25 - 0.5 * deep);
    let inside = Turn::NONE;
    let half = [0.5 * wide + 0.01, 0.5 * high + 0.01, 0.5 * deep];
    for (center, half) in [
        ([0.0, cy, cz - half[2] - 0.02], [half[0] + 0.04, half[1] + 0.04, 0.02]),
        ([half[0] + 0.02, cy, cz], [0.02, half[1] + 0.04, half[2]]),
        ([-half[0] - 0.02, cy, cz], [0.02, half[1] + 0.04, half[2]]),
        ([0.0, sill + high + 0.03, cz], [half[0], 0.02, half[2]]),
    ] {
        s.board("display", Stuff::Plaster, Board { center, half, turn: inside, ..Board::PLAIN });
    }
    let base = s.board(
        "display floor",
        Stuff::Wood,
        Board { center: [0.0, sill - 0.01, cz], half: [half[0], 0.02, half[2]], turn: inside, inset: [0.0, SEAM, 0.0] },
    );
    let mut stepped = base.clone();
    stepped.clearance = high - 0.1;
    let step = s.board(
        "steps",
        Stuff::Wood,
        Board {
            center: [0.0, sill + 0.13, cz - 0.16],
            half: [half[0] - 0.1, 0.12, 0.13],
            turn: inside,
            inset: [0.0, SEAM, 0.0],
        },
    );
    let mut step = step;
    step.clearance = high - 0.35;
    for i in 0..3 {
        let x = wide * (f64::from(i) / 3.0 - 0.333);
        s.spot_lamp([x, sill + high + 0.008, cz + 0.1], [x, sill, cz - 0.05], 14.0);
    }
    s.main(
        &stepped.part([-0.8, 0.8], [0.05, 0.9]),
        &[F::Vessel, F::Toy, F::Ornament, F::Instrument, F::Sculpture],
        [0.18, 0.4],
    );
    let kind = s.choose("goods", 4);
    let goods: [&[_]; 4] = [
        &[VESSEL, ORNAMENT, POT, SOLID],
        &[TOY, TOY, BOX.most(0.4, 0.4, 0.25), BOOK],
        &[ask(F::Instrument).most(0.6, 1.0, 0.5), BOOK_LYING, ask(F::Clock).most(0.4, 0.4, 0.2)],
        &[TOOL.most(0.4, 0.5, 0.25), PART, UTENSIL, BOX.most(0.4, 0.4, 0.25)],
    ];
    s.row(&step, goods[kind], [0.04, 0.14], 0.0, 1.0);
    let n = s.some(6);
    s.scatter(&stepped.part([-0.95, 0.95], [0.0, 0.95]), goods[kind], n, ABOUT);
    if s.glassy() {
        let p = |x: f64, y: f64| [x, y, -0.06];
        s.quad("panes", Stuff::Pane, [p(o[0], o[2]), p(o[1], o[2]), p(o[1], o[3]), p(o[0], o[3])]);
    }
    let sign = ask(F::Sign).most(2.4, 0.7, 0.3);
    let _ = s.on_wall(&wall, &sign, [-0.3, 0.3], [sill + high + 0.15, sill + high + 0.3]);
    let street = floor.part([-0.12, 0.12], [0.02, 0.12]);
    let n = s.some(5);
    s.scatter(&street, &[TALL_PLANT, ask(F::Bicycle), ask(F::Bin), ask(F::Bench), POT], n, ANY);
    let focus = Aabb { low: [-0.6, sill + 0.1, -0.6], high: [0.6, sill + 0.8, -0.3] };
    s.eye(3.0, From::Box(Aabb { low: [-1.8, 1.2, 1.2], high: [1.8, 1.75, 3.0] }), focus);
    s.eye(
        1.0,
        From::Box(Aabb { low: [-3.5, 1.4, 3.0], high: [3.5, 1.75, 5.5] }),
        Aabb::around([0.3, 1.3, 0.0], [0.6, 0.4, 0.1]),
    );
}

/// Small tables and chairs before a house, cups and cakes, sunshades, lamps on a string.
pub fn cafe_terrace(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let stuff = s.one("ground", &[Stuff::Stone, Stuff::Tile, Stuff::Asphalt]);
    let floor = ground(s, stuff, 30.0);
    let front = s.one("front", &[Stuff::Plaster, Stuff::Brick, Stuff::Stone]);
    let mut wall = Wall::new([0.0, 0.0, -2.6], Turn::NONE, 10.0, 4.5);
    wall.openings = vec![[-3.0, -1.2, 0.9, 2.4], [0.2, 1.2, 0.0, 2.2], [2.0, 3.8, 0.9, 2.4]];
    s.wall("front", front, &wall, 0.3);
    for (i, o) in wall.openings.clone().into_iter().enumerate() {
        s.reveal("reveal", front, &wall, o, 0.3);
        let c = wall.point(0.5 * (o[0] + o[1]), 0.5 * (o[2] + o[3]), -0.29);
        let half = [0.5 * (o[1] - o[0]), 0.5 * (o[3] - o[2])];
        if i == 1 {
            s.board(
                "door",
                Stuff::Wood,
                Board {
                    center: add(c, [0.0, 0.0, 0.03]),
                    half: [half[0], half[1], 0.02],
                    inset: [GAP, GAP, 0.0],
                    ..Board::PLAIN
                },
            );
        } else {
            // Lit from within.
            s.light(Light::Panel(c, [0.0, 0.0, 1.0], half), 14.0);
            s.board(
                "frame",
                Stuff::Wood,
                Board {
                    center: add(c, [0.0, 0.0, 0.06]),
                    half: [0.025, half[1], 0.02],
                    inset: [0.0, GAP, 0.0],
                    ..Board::PLAIN
                },
            );
            s.board(
                "frame",
                Stuff::Wood,
                Board {
                    center: add(c, [0.0, 0.0, 0.06]),
                    half: [half[0], 0.02, 0.02],
                    inset: [GAP, 0.0, SEAM],
                    ..Board::PLAIN
                },
            );
        }
    }
    string_lamps(s, [-4.0, 2.9, -2.2], [4.0, 2.9, 1.8], 12, 45.0);
    let table = s.pick(&ask(F::Table).most(1.0, 0.95, 1.0).least(0.4, 0.6, 0.4));
    let tables = 1 + s.some(5).min(5);
    let mut first: Option<Surface> = None;
    for i in 0..tables {
        let x = 1.9 * ((i % 3) as f64 - 1.0) + s.any(-0.15, 0.15);
        let z = if i < 3 { -1.2 } else { 0.7 } + s.any(-0.15, 0.15);
        let put = table.as_ref().and_then(|t| s.put_at(t, &floor, [x, z], Turn::new(s_turn(i))));
        let top = match put.and_then(|t| s.top(t)) {
            Some(top) => top,
            None => bench(s, Stuff::Metal, [x, 0.0, z], [0.6, 0.72, 0.6], Turn::NONE),
        };
        if first.is_none() {
            s.main(&top.inset(0.03), &[F::Vessel, F::Food], [0.1, 0.24]);
            first = Some(top.clone());
        }
        if let Some(put) = put {
            s.around(put, &CHAIR, 2 + i % 2, &floor);
        }
        let n = s.some(4).min(4);
        s.scatter(
            &top,
            &[
                VESSEL.most(0.14, 0.3, 0.14),
                PLATE.most(0.25, 0.1, 0.25),
                FOOD.most(0.2, 0.2, 0.2),
                ask(F::Lamp).most(0.14, 0.4, 0.14),
            ],
            n,
            ANY,
        );
    }
    s.scatter(
        &floor.part([-0.15, 0.15], [-0.07, 0.1]),
        &[TALL_PLANT, TALL_PLANT, ask(F::Sign).most(0.9, 1.4, 0.9), ask(F::Bicycle)],
        4,
        ANY,
    );
    let focus = Aabb { low: [-1.5, 0.6, -1.5], high: [1.5, 1.2, 0.5] };
    s.eye(3.0, From::Orbit([2.5, 5.5], [-1.1, 1.1], [0.05, 0.35]), focus);
    if let Some(top) = first {
        s.look_at(1.5, &top, 0.3, [-1.2, 1.2], [0.2, 0.6]);
    }
}

fn s_turn(i: usize) -> f64 {
    0.4 * i as f64
}

/// A stall with a roof of cloth, slanting trays of fruit, crates, a price board, a bare bulb.
pub fn market_stall(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let stuff = s.one("ground", &[Stuff::Stone, Stuff::Asphalt]);
    let floor = ground(s, stuff, 30.0);
    let (wide, deep, high) = (s.draw("width", 0.9, 1.4), 0.55, s.draw("height", 2.1, 2.5));
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let tall = if sz > 0.0 { high - 0.25 } else { high };
        s.board(
            "posts",
            Stuff::Wood,
            Board {
                center: [sx * (wide + 0.1), 0.5 * tall, sz * (deep + 0.12)],
                half: [0.025, 0.5 * tall, 0.025],
                ..Board::PLAIN
            },
        );
    }
    let (w, d) = (wide + 0.25, deep + 0.3);
    s.quad(
        "awning",
        Stuff::Fabric,
        [[-w, high - 0.28, d], [w, high - 0.28, d], [w, high + 0.06, -d], [-w, high + 0.06, -d]],
    );
    s.quad(
        "awning",
        Stuff::Fabric,
        [[-w, high - 0.5, d], [w, high - 0.5, d], [w, high - 0.28, d], [-w, high - 0.28, d]],
    );
    let top = bench(s, Stuff::Wood, [0.0, 0.0, 0.0], [2.0 * wide, 0.85, 2.0 * deep], Turn::NONE);
    s.main(&top.part([-0.3, 0.3], [-0.8, 0.8]), &[F::Food, F::Vessel, F::Toy], [0.15, 0.35]);
    s.light(Light::Ball([0.1, high - 0.35, 0.05], 0.045), 35.0);
    // Trays with rims, in a row, each full of one thing.
    let trays = 3 + s.choose("trays", 2);
    let w = wide / trays as f64;
    let y = top.center[1];
    for i in 0..trays {
        let cx = -wide + w * (2 * i + 1) as f64;
        let (hx, hz) = (w - 0.02, 0.2);
        let cz = deep - hz - 0.02;
        if !s.world.free(&[crate::scene_generation::place::Solid {
            y: [y + 0.002, y + 0.08],
            at: [cx, cz],
            turn: Turn::NONE,
            half: [hx, hz],
        }]) {
            continue;
        }
        let bed =
            s.board("trays", Stuff::Wood, Board { center: [cx, y + 0.006, cz], half: [hx, 0.005, hz], ..Board::PLAIN });
        for (c, h) in [
            ([0.0, hz - 0.006], [hx, 0.006]),
            ([0.0, -hz + 0.006], [hx, 0.006]),
            ([hx - 0.006, 0.0], [0.006, hz - 0.012]),
            ([-hx + 0.006, 0.0], [0.006, hz - 0.012]),
        ] {
            s.board(
                "trays",
                Stuff::Wood,
                Board { center: [cx + c[0], y + 0.041, cz + c[1]], half: [h[0], 0.03, h[1]], ..Board::PLAIN },
            );
        }
        let n = s.some(8).min(12);
        s.repeat(&FOOD.most(0.13, 0.14, 0.13), &bed.inset(0.012), n, ANY);
    }
    let n = s.some(6);
    s.scatter(&top, &[FOOD, VESSEL, BOX.most(0.35, 0.3, 0.3), ask(F::Sign).most(0.4, 0.4, 0.2)], n, ABOUT);
    let near = floor.part([-0.08, 0.08], [-0.06, 0.06]);
    let n = s.some(8);
    s.scatter(&near, &[BOX, ask(F::Box).most(0.9, 0.9, 0.9), BOX, TALL_PLANT, ask(F::Bicycle), ask(F::Sign)], n, ANY);
    // The next house.
    let house = s.one("house", &[Stuff::Brick, Stuff::Plaster]);
    let wall = Wall::new([0.0, 0.0, -2.4], Turn::NONE, 14.0, 5.0);
    s.wall("house", house, &wall, 0.3);
    let focus = Aabb { low: [-0.6 * wide, 0.7, -0.2], high: [0.6 * wide, 1.3, 0.5] };
    s.eye(3.0, From::Orbit([1.6, 3.4], [-0.9, 0.9], [0.05, 0.4]), focus);
    s.look_at(1.0, &top, 0.3, [-0.8, 0.8], [0.3, 0.8]);
}

/// A counter with cakes and cups, small tables, lamps that hang.
pub fn cafe(s: &mut Stage<'_>) {
    s.bare = true;
    let size = [s.draw("width", 4.5, 6.5), s.draw("height", 2.7, 3.4), s.draw("depth", 4.0, 6.0)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Tile, Stuff::Wood]),
        walls: s.one("walls", &[Stuff::Brick, Stuff::Plaster, Stuff::Tile]),
        ceiling: Stuff::Plaster,
    };
    let mut big = window(s, 3, size[1], size[2]);
    (big.sill, big.height, big.width) = (0.4, size[1] - 0.8, 2.0);
    let room = s.room(size, made, &[big], Some(2));
    let floor = room.floor.clone();
    let z = floor.half[1];
    let wide = 0.55 * floor.half[0];
    let at = -z + 1.1;
    s.board("bar", Stuff::Wood, Board { center: [0.3, 0.52, at], half: [wide, 0.519, 0.28], ..Board::PLAIN });
    let bar = s.board(
        "bar top",
        Stuff::Stone,
        Board { center: [0.3, 1.0595, at], half: [wide + 0.03, 0.02, 0.32], ..Board::PLAIN },
    );
    s.main(&bar.part([-0.8, 0.8], [-0.7, 0.7]), &[F::Vessel, F::Food, F::MachinePart], [0.15, 0.36]);
    let shelf_y = 1.5;
    for i in 0..2 {
        let mut board = s.board(
            "wall shelf",
            Stuff::Wood,
            Board {
                center: [0.3, shelf_y + 0.4 * f64::from(i), -z + 0.11],
                half: [wide, 0.014, 0.105],
                ..Board::PLAIN
            },
        );
        board.clearance = 0.36;
        let n = s.some(6);
        let most = s.most;
        s.most = most.min(s.things.len() + n);
        s.row(
            &board,
            &[VESSEL.most(0.15, 0.34, 0.18), VESSEL.most(0.12, 0.3, 0.15), BOX.most(0.2, 0.25, 0.18)],
            [0.03, 0.12],
            0.0,
            1.0,
        );
        s.most = most;
    }
    for i in 0..3 {
        let x = 0.3 + wide * (f64::from(i) - 1.0) * 0.7;
        let lamp = s.hang(&ask(F::CeilingLamp).most(0.6, size[1] - 1.8, 0.6), [x, at], size[1], 0.0);
        s.lit(lamp, 14.0);
    }
    let table = s.pick(&ask(F::Table).most(1.0, 0.95, 1.0).least(0.4, 0.6, 0.4));
    for (u, v) in [(-0.55, 0.2), (0.5, 0.3), (-0.1, 0.6), (0.6, 0.75), (-0.65, 0.75)] {
        let at = [u * floor.half[0], v * z];
        let Some(put) = table.as_ref().and_then(|t| s.put(t, &floor, at, 0.0)) else { continue };
        s.around(put, &CHAIR, 2, &floor);
        if let Some(top) = s.top(put) {
            let n = s.some(3).min(3);
            s.scatter(
                &top,
                &[VESSEL.most(0.14, 0.2, 0.14), PLATE.most(0.25, 0.1, 0.25), FOOD.most(0.2, 0.2, 0.2), PAPER],
                n,
                ANY,
            );
        }
    }
    let n = s.some(5);
    s.scatter(&bar, &[VESSEL, FOOD, PLATE, ask(F::Sign).most(0.3, 0.4, 0.2), POT.most(0.3, 0.4, 0.3)], n, ABOUT);
    s.scatter(&floor.inset(0.2), &[TALL_PLANT], 2, ANY);
    s.ceiling_lamps(&room, 15.0);
    pictures(s, &room, 1, 3);
    let focus = room.part([-0.5, 0.5], [0.7, 1.3], [-0.6, 0.3]);
    s.room_eyes(&room, focus);
}

/// A case of glass with rings, gems and watches on velvet, small hard lamps.
pub fn jeweller(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let size = [s.draw("width", 2.8, 4.0), 2.6, s.draw("depth", 2.6, 3.6)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Carpet, Stuff::Stone, Stuff::Wood]),
        walls: s.one("walls", &[Stuff::Wallpaper, Stuff::Wood, Stuff::Plaster]),
        ceiling: Stuff::Plaster,
    };
    let room = s.room(size, made, &[], Some(2));
    let wide = s.draw("case.width", 0.5, 0.8);
    let (deep, base) = (0.28, 0.85);
    let z = -0.3;
    s.board(
        "case body",
        Stuff::Wood,
        Board { center: [0.0, 0.5 * base - 0.02, z], half: [wide, 0.5 * base - 0.021, deep], ..Board::PLAIN },
    );
    let velvet = s.board(
        "velvet",
        Stuff::Fabric,
        Board { center: [0.0, base - 0.02, z], half: [wide, 0.02, deep], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    // Stands of several heights.
    let mut stands: Vec<Surface> = Vec::new();
    for i in 0..5 {
        let x = wide * (0.36 * f64::from(i) - 0.72);
        let high = 0.02 + 0.05 * s.any(0.0, 1.0);
        let y = base + high;
        stands.push(s.board(
            "stands",
            Stuff::Leather,
            Board { center: [x, y, z - 0.13], half: [0.05, high, 0.05], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
        ));
    }
    let show = [ask(F::Solid).scaled(0.02, 0.06), ask(F::Ornament).scaled(0.05, 0.12), ask(F::Clock).scaled(0.05, 0.1)];
    s.main(&velvet.part([-0.8, 0.8], [-0.1, 0.8]), &[F::Solid, F::Ornament, F::Vessel], [0.05, 0.12]);
    for stand in &stands {
        s.scatter(&stand.inset(0.002), &show, 1, ANY);
    }
    let n = s.some(16);
    s.scatter(&velvet.part([-0.95, 0.95], [-0.1, 0.95]), &show, n, ANY);
    for i in 0..3 {
        let x = wide * (0.6 * f64::from(i) - 0.6);
        let y = base + 0.55;
        s.board(
            "lamp rail",
            Stuff::Metal,
            Board {
                center: [x, y + 0.5 * (2.6 - y), z + 0.1],
                half: [0.006, 0.5 * (2.6 - y), 0.006],
                inset: [0.0, GAP, 0.0],
                ..Board::PLAIN
            },
        );
        s.board(
            "lamps",
            Stuff::PaintedMetal,
            Board { center: [x, y - 0.025, z + 0.1], half: [0.03, 0.0245, 0.03], ..Board::PLAIN },
        );
        s.light(Light::Disk([x, y - 0.051, z + 0.1], [0.0, -1.0, -0.15], 0.022), 9.0);
    }
    if s.glassy() {
        let (w, d, y0, y1) = (wide - 0.003, deep - 0.003, base, base + 0.35);
        let p = |x: f64, y: f64, dz: f64| [x, y, z + dz];
        s.quad("panes", Stuff::Pane, [p(-w, y0, d), p(w, y0, d), p(w, y1, d), p(-w, y1, d)]);
        s.quad("panes", Stuff::Pane, [p(w, y0, d), p(w, y0, -d), p(w, y1, -d), p(w, y1, d)]);
        s.quad("panes", Stuff::Pane, [p(-w, y0, -d), p(-w, y0, d), p(-w, y1, d), p(-w, y1, -d)]);
    }
    for side in [-1.0, 1.0] {
        let _ = s.against(
            &room.walls[0],
            &room.floor.clone(),
            &ask(F::Cabinet).most(1.2, 2.0, 0.5),
            [side * 0.5, side * 1.2],
        );
    }
    let _ = s.against(&room.walls[1], &room.floor.clone(), &CHAIR, [-0.5, 0.5]);
    let _ = s.against(&room.walls[3], &room.floor.clone(), &TALL_PLANT, [-0.5, 0.5]);
    pictures(s, &room, 1, 2);
    s.ceiling_lamps(&room, 6.0);
    s.look_at(4.0, &velvet.part([-0.6, 0.6], [-0.6, 0.9]), 0.2, [-0.9, 0.9], [0.25, 0.9]);
}
