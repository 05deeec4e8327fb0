//! Public rooms: galleries, museums, lobbies, baths.

use super::kit::*;
use crate::scene_generation::{
    place::{SEAM, Solid, Surface, Turn},
    props::ask,
    shell::{Finishes, Window},
    stage::{Board, From, Light, Stage},
};
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// White walls, framed pictures under spots, sculptures on plinths, a bench.
pub fn gallery(s: &mut Stage<'_>) {
    let size = [s.draw("width", 5.0, 8.5), s.draw("height", 3.2, 4.2), s.draw("depth", 5.0, 8.0)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Wood, Stuff::Concrete, Stuff::Stone]),
        walls: Stuff::Plaster,
        ceiling: Stuff::Plaster,
    };
    let room = s.room(size, made, &[], Some(2));
    let floor = room.floor.clone();
    let top = plinth(s, Stuff::Plaster, [0.0, 0.1], [0.3, 0.3], 0.95);
    s.main(&top, &[F::Sculpture, F::Vessel, F::Solid], [0.35, 0.8]);
    s.spot_lamp([0.3, size[1], 0.9], [0.0, 1.2, 0.1], 26.0);
    let others = s.some(3).min(4);
    for i in 0..others {
        let at = [[-0.55, -0.4], [0.55, -0.45], [-0.5, 0.55], [0.6, 0.5]][i];
        let at = [at[0] * floor.half[0], at[1] * floor.half[1]];
        let high = s.any(0.5, 1.1);
        let on = plinth(s, Stuff::Plaster, at, [0.24, 0.24], high);
        s.scatter(
            &on,
            &[ask(F::Sculpture).scaled(0.3, 0.7), ask(F::Vessel).scaled(0.3, 0.5), ask(F::Solid).scaled(0.2, 0.4)],
            1,
            ANY,
        );
        s.spot_lamp([at[0] + 0.3, size[1], at[1] + 0.6], [at[0], high + 0.2, at[1]], 16.0);
    }
    let mut hung = Vec::new();
    for wall in [0, 1, 3] {
        let n = s.some(3).min(4);
        hung.extend(pictures(s, &room, wall, n));
    }
    for picture in hung {
        let c = s.things[picture].bounds.center();
        let toward = [c[0] * 0.72, size[1], c[2] * 0.72];
        s.spot_lamp(toward, c, 9.0);
    }
    s.scatter(&floor.part([-0.5, 0.5], [0.3, 0.8]), &[ask(F::Bench)], 1, [0.0, 0.0]);
    let stand = ask(F::Sculpture).scaled(0.9, 1.8);
    s.scatter(&floor.inset(0.6), &[stand], 1, ANY);
    s.ceiling_lamps(&room, 20.0);
    let focus = room.part([-0.5, 0.5], [0.9, 1.6], [-0.9, 0.2]);
    s.room_eyes(&room, focus);
}

/// A case with panes over finds on stands, labels, other cases along the walls.
pub fn museum_case(s: &mut Stage<'_>) {
    let size = [s.draw("width", 3.6, 5.5), s.draw("height", 2.8, 3.6), s.draw("depth", 3.6, 5.0)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Stone, Stuff::Wood, Stuff::Carpet]),
        walls: s.one("walls", &[Stuff::Plaster, Stuff::Stone, Stuff::Fabric]),
        ceiling: Stuff::Plaster,
    };
    let room = s.room(size, made, &[], Some(2));
    let floor = room.floor.clone();
    let wide = s.draw("case.width", 0.5, 0.9);
    let (deep, base, high) = (0.35, 0.9, s.draw("case.height", 0.5, 0.8));
    s.board(
        "case",
        Stuff::Wood,
        Board { center: [0.0, 0.5 * base - 0.02, 0.0], half: [wide, 0.5 * base - 0.0205, deep], ..Board::PLAIN },
    );
    let mut bed = s.board(
        "case lining",
        Stuff::Fabric,
        Board { center: [0.0, base - 0.02, 0.0], half: [wide, 0.02, deep], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    bed.clearance = high - 0.06;
    let (w, d) = (wide - 0.012, deep - 0.012);
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        s.board(
            "case posts",
            Stuff::Metal,
            Board {
                center: [sx * w, base + 0.5 * high, sz * d],
                half: [0.011, 0.5 * high, 0.011],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    s.board(
        "case lid",
        Stuff::Wood,
        Board { center: [0.0, base + high + 0.0205, 0.0], half: [wide, 0.02, deep], ..Board::PLAIN },
    );
    for i in 0..3 {
        let x = wide * (0.6 * f64::from(i) - 0.6);
        s.light(Light::Disk([x, base + high - 0.002, 0.15], [0.0, -1.0, -0.2], 0.02), 6.0);
    }
    if s.glassy() {
        let p = |x: f64, y: f64, z: f64| [x, y, z];
        let (y0, y1) = (base, base + high);
        s.quad("panes", Stuff::Pane, [p(-w, y0, d), p(w, y0, d), p(w, y1, d), p(-w, y1, d)]);
        s.quad("panes", Stuff::Pane, [p(w, y0, -d), p(-w, y0, -d), p(-w, y1, -d), p(w, y1, -d)]);
        s.quad("panes", Stuff::Pane, [p(w, y0, d), p(w, y0, -d), p(w, y1, -d), p(w, y1, d)]);
        s.quad("panes", Stuff::Pane, [p(-w, y0, -d), p(-w, y0, d), p(-w, y1, d), p(-w, y1, -d)]);
    }
    let inner = bed.inset(0.03);
    s.main(&inner, &[F::Vessel, F::Sculpture, F::Ornament, F::Rock], [0.15, 0.34]);
    let find = [
        ask(F::Vessel).most(0.3, high - 0.08, 0.3),
        ask(F::Ornament).most(0.3, high - 0.08, 0.3),
        ask(F::Rock).scaled(0.06, 0.16),
        ask(F::Solid).scaled(0.04, 0.12),
        TOOL.most(0.35, high - 0.08, 0.2),
    ];
    let n = s.some(9);
    s.scatter(&inner, &find, n, ANY);
    for i in 0..s.some(3).min(5) {
        let at = [[-0.65, -0.65], [0.65, -0.65], [-0.7, 0.2], [0.7, 0.25], [0.0, -0.7]][i];
        let at = [at[0] * floor.half[0], at[1] * floor.half[1]];
        let on = plinth(s, Stuff::Wood, at, [0.22, 0.22], 1.0);
        s.scatter(
            &on,
            &[ask(F::Sculpture).scaled(0.25, 0.5), ask(F::Vessel).scaled(0.2, 0.4), ask(F::Rock).scaled(0.2, 0.35)],
            1,
            ANY,
        );
        s.spot_lamp([at[0] * 0.8, size[1], at[1] + 0.7], [at[0], 1.2, at[1]], 12.0);
    }
    let n = s.some(3).min(3);
    pictures(s, &room, 0, n);
    s.ceiling_lamps(&room, 12.0);
    s.look_at(3.0, &inner, high, ROUND, [0.0, 0.5]);
    let focus = room.part([-0.5, 0.5], [0.9, 1.4], [-0.5, 0.5]);
    s.room_eyes(&room, focus);
}

/// Columns, armchairs, a reception, plants, luggage, a clock.
pub fn hotel_lobby(s: &mut Stage<'_>) {
    let size = [s.draw("width", 6.5, 9.5), s.draw("height", 3.2, 4.4), s.draw("depth", 6.0, 8.5)];
    let made = Finishes {
        floor: s.one("floor", &[Stuff::Stone, Stuff::Tile, Stuff::Carpet]),
        walls: s.one("walls", &[Stuff::Wood, Stuff::Stone, Stuff::Wallpaper, Stuff::Plaster]),
        ceiling: Stuff::Plaster,
    };
    let mut tall = window(s, 3, size[1], size[2]);
    (tall.sill, tall.height, tall.width) = (0.3, size[1] - 0.9, 2.2);
    let room = s.room(size, made, &[tall], Some(2));
    let floor = room.floor.clone();
    let (x, z) = (floor.half[0], floor.half[1]);
    let wide = s.draw("reception", 1.2, 2.0);
    s.board(
        "reception",
        Stuff::Wood,
        Board { center: [0.0, 0.54, -z + 1.3], half: [wide, 0.539, 0.3], ..Board::PLAIN },
    );
    let top = s.board(
        "reception top",
        Stuff::Stone,
        Board { center: [0.0, 1.1005, -z + 1.32], half: [wide + 0.05, 0.02, 0.36], ..Board::PLAIN },
    );
    s.main(&top.part([-0.9, 0.9], [-0.8, 0.8]), &[F::Vessel, F::Sculpture, F::Ornament], [0.2, 0.45]);
    let columns = s.pick(&ask(F::Column).most(0.8, size[1] - 0.02, 0.8).least(0.0, 1.2, 0.0));
    if let Some(columns) = &columns {
        for (u, v) in [(-0.6, -0.2), (0.6, -0.2), (-0.6, 0.5), (0.6, 0.5)] {
            let _ = s.put(columns, &floor, [u * x, v * z], 0.0);
        }
    }
    let mut on = floor.clone();
    let mut middle = [0.0, 0.3 * z];
    if let Some(rug) = s.place(&ask(F::Rug).most(3.4, 0.05, 2.8), &floor, middle, 0.0) {
        on = s.upon(rug).unwrap_or(on);
        middle = [0.0; 2];
    }
    let table = s.place(&LOW_TABLE, &on, middle, 0.0);
    if let Some(table) = table {
        let seat = ask(F::Sofa).most(1.3, 1.3, 1.3);
        s.around(table, &seat, 4, &floor);
        if let Some(on) = s.top(table) {
            let n = s.some(3);
            s.scatter(&on, &[BOOK_LYING, VESSEL, PAPER, ORNAMENT], n, ANY);
        }
    }
    let sofa = ask(F::Sofa).least(1.3, 0.3, 0.5);
    for wall in [1, 3] {
        let _ = s.against(&room.walls[wall], &floor, &sofa, [0.0, 0.6 * z]);
    }
    let lamp =
        s.hang(&ask(F::CeilingLamp).least(0.3, 0.2, 0.3).most(1.8, size[1] - 2.1, 1.8), [0.0, 0.2 * z], size[1], 0.0);
    s.lit(lamp, 70.0);
    s.ceiling_lamps(&room, 45.0);
    let n = s.some(9);
    s.scatter(
        &floor.inset(0.3),
        &[TALL_PLANT, ask(F::Box), BOX, FLOOR_LAMP, TALL_PLANT, ask(F::Sculpture).scaled(0.8, 1.6), CHAIR],
        n,
        ANY,
    );
    let n = s.some(6);
    s.scatter(
        &top,
        &[VESSEL, PAPER, PEN, ask(F::Screen).most(0.6, 0.5, 0.4), TABLE_LAMP, ask(F::Clock).most(0.3, 0.3, 0.2)],
        n,
        ABOUT,
    );
    let _ = s.on_wall(&room.walls[0], &CLOCK, [-0.6, 0.6], [2.2, 2.4]);
    pictures(s, &room, 1, 3);
    let focus = room.part([-0.4, 0.4], [0.6, 1.4], [-0.6, 0.4]);
    s.room_eyes(&room, focus);
}

/// A basin of water in a tiled hall, steps into it, rails, chairs, balls, lamps over it.
pub fn swimming_hall(s: &mut Stage<'_>) {
    let size = [s.draw("width", 6.0, 9.0), s.draw("height", 3.0, 4.2), s.draw("depth", 7.0, 10.0)];
    let (x, z) = (0.5 * size[0], 0.5 * size[2]);
    let made = Finishes {
        floor: Stuff::Tile,
        walls: s.one("walls", &[Stuff::Tile, Stuff::Plaster, Stuff::Stone]),
        ceiling: Stuff::Plaster,
    };
    let mut windows = Vec::new();
    for i in 0..3 {
        windows.push(Window {
            wall: 3,
            s: 0.3 * size[2] * (f64::from(i) - 1.0),
            width: 0.25 * size[2],
            sill: 0.5,
            height: size[1] - 1.2,
        });
    }
    let room = s.room(size, made, &windows, Some(1));
    // The floor of the room is the bottom of the basin; decks of boxes stand round it.
    let high = 1.0;
    let (bx, bz) = (0.52 * x, 0.6 * z);
    let deck = |s: &mut Stage<'_>, c: [f64; 2], h: [f64; 2]| {
        s.board(
            "deck",
            Stuff::Tile,
            Board { center: [c[0], 0.5 * high, c[1]], half: [h[0], 0.5 * high, h[1]], ..Board::PLAIN },
        )
    };
    let (sx, sz) = (0.5 * (x - bx), 0.5 * (z - bz));
    let left = deck(s, [-bx - sx, 0.0], [sx - 0.001, z - 0.001]);
    let right = deck(s, [bx + sx, 0.0], [sx - 0.001, z - 0.001]);
    let back = deck(s, [0.0, -bz - sz], [bx, sz - 0.001]);
    let front = deck(s, [0.0, bz + sz], [bx, sz - 0.001]);
    let level = high - s.draw("water", 0.06, 0.2);
    let (wx, wz) = (bx + 0.001, bz + 0.001);
    s.quad("water", Stuff::Water, [[-wx, level, wz], [wx, level, wz], [wx, level, -wz], [-wx, level, -wz]]);
    s.world.keep.push(Solid { y: [0.0, high], at: [0.0, 0.0], turn: Turn::NONE, half: [bx, bz] });
    let stand = plinth_on(s, &back, [0.0, 0.0], 0.4);
    s.main(&stand, &[F::Sculpture, F::Vessel, F::Solid], [0.3, 0.7]);
    let goods = [
        CHAIR,
        TALL_PLANT,
        ask(F::Bench),
        BOX,
        ask(F::Toy).scaled(0.15, 0.35),
        ask(F::Solid).scaled(0.15, 0.35),
        ask(F::Cloth).most(0.6, 0.3, 0.6),
        ask(F::Bin),
    ];
    for (on, n) in [(left, 5), (right, 5), (back, 3), (front, 3)] {
        let n = s.some(n);
        s.scatter(&on.inset(0.1), &goods, n, ANY);
    }
    for i in 0..4 {
        let at = [if i % 2 == 0 { -0.5 * bx } else { 0.5 * bx }, size[1], if i < 2 { -0.5 * bz } else { 0.5 * bz }];
        s.panel_lamp(at, [0.2, 0.2], 22.0);
    }
    let _ = s.on_wall(&room.walls[0], &CLOCK, [-1.0, 1.0], [2.2, 2.4]);
    let focus = Aabb { low: [-bx, high - 0.2, -z], high: [bx, high + 0.6, 0.3 * bz] };
    let tall = (size[1] - 0.3).min(high + 1.7);
    s.inside = Some(Aabb { low: [-x, high + 0.2, -z], high: [x, size[1], z] });
    s.eye(3.0, From::Box(Aabb { low: [-x + 0.3, high + 1.1, bz], high: [x - 0.3, tall, z - 0.3] }), focus);
    s.eye(1.0, From::Box(Aabb { low: [bx, high + 0.8, -0.5 * bz], high: [x - 0.3, tall, bz] }), focus);
}

fn plinth_on(s: &mut Stage<'_>, on: &Surface, at: [f64; 2], height: f64) -> Surface {
    let [x, y, z] = on.point(at);
    s.board(
        "plinths",
        Stuff::Stone,
        Board {
            center: [x, y + 0.5 * height, z],
            half: [0.3, 0.5 * height, 0.3],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    )
}
