//! In town: yards, streets and squares between houses.

use super::kit::*;
use crate::scene_generation::{
    place::{GAP, SEAM, Surface, Turn},
    props::ask,
    shell::Wall,
    stage::{Board, From, Light, Stage},
};
use core::f64::consts::PI;
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// A house front with rows of windows, some lit, cornice and door.
pub fn facade(s: &mut Stage<'_>, name: &str, wall: &Wall, floors: usize, bays: usize) {
    let stuff = s.one(&format!("{name}.walls"), &[Stuff::Brick, Stuff::Plaster, Stuff::Stone, Stuff::Concrete]);
    let mut wall = wall.clone();
    let (bay, tall) = (wall.length / bays as f64, wall.height / floors as f64);
    let (width, height) = (bay * s.any(0.4, 0.6), tall * s.any(0.5, 0.62));
    let door = s.next().below(bays);
    for floor in 0..floors {
        for i in 0..bays {
            let at = bay * (i as f64 + 0.5) - 0.5 * wall.length;
            let sill = tall * floor as f64 + 0.28 * tall;
            if floor == 0 && i == door {
                wall.openings.push([at - 0.5, at + 0.5, 0.0, 2.15]);
            } else {
                wall.openings.push([at - 0.5 * width, at + 0.5 * width, sill, sill + height]);
            }
        }
    }
    let label = format!("{name} wall");
    s.wall(&label, stuff, &wall, 0.35);
    let deep = 0.16;
    for o in wall.openings.clone() {
        s.reveal(&label, stuff, &wall, o, deep);
        let (w, h) = (0.5 * (o[1] - o[0]), 0.5 * (o[3] - o[2]));
        let c = wall.point(0.5 * (o[0] + o[1]), 0.5 * (o[2] + o[3]), -deep);
        let p = |s: f64, y: f64, out: f64| wall.point(s, y, out);
        if o[2] == 0.0 {
            s.board(
                "doors",
                Stuff::Wood,
                Board { center: c, half: [w, h, 0.03], turn: wall.turn, inset: [SEAM, SEAM, 0.0] },
            );
            continue;
        }
        let lit = s.next().below(4) == 0;
        let back = [p(o[0], o[2], -deep), p(o[1], o[2], -deep), p(o[1], o[3], -deep), p(o[0], o[3], -deep)];
        if lit {
            s.light(Light::Panel(c, wall.normal(), [w, h]), 9.0);
        } else {
            s.quad("dark windows", Stuff::PaintedMetal, back);
        }
        let bar = |s: &mut Stage<'_>, at: f64, y: f64, half: [f64; 2]| {
            s.board(
                "window bars",
                Stuff::PaintedMetal,
                Board {
                    center: wall.point(at, y, -0.1),
                    half: [half[0], half[1], 0.02],
                    turn: wall.turn,
                    ..Board::PLAIN
                },
            );
        };
        let (ms, my) = (0.5 * (o[0] + o[1]), 0.5 * (o[2] + o[3]));
        bar(s, ms, my, [0.025, h]);
        bar(s, ms, o[3] - 0.35 * h, [w, 0.02]);
        s.board(
            "sills",
            Stuff::Stone,
            Board {
                center: wall.point(ms, o[2] - 0.04, 0.03),
                half: [w + 0.08, 0.035, 0.07],
                turn: wall.turn,
                ..Board::PLAIN
            },
        );
    }
    s.board(
        "cornice",
        Stuff::Stone,
        Board {
            center: wall.point(0.0, wall.height - 0.12, 0.1),
            half: [0.5 * wall.length, 0.12, 0.1],
            turn: wall.turn,
            inset: [0.0, 0.0, GAP],
        },
    );
    s.board(
        "base",
        Stuff::Stone,
        Board {
            center: wall.point(0.0, wall.height / floors as f64 - 0.1, 0.03),
            half: [0.5 * wall.length, 0.06, 0.029],
            turn: wall.turn,
            ..Board::PLAIN
        },
    );
}

/// Four walls round a paved yard, a tree, benches, pots, bicycles, lit windows.
pub fn courtyard(s: &mut Stage<'_>) {
    let stuff = s.one("ground", &[Stuff::Stone, Stuff::Asphalt, Stuff::Sand, Stuff::Brick]);
    ground(s, stuff, 20.0);
    let (x, z, high) = (s.draw("width", 4.0, 6.5), s.draw("depth", 4.0, 6.5), s.draw("height", 4.5, 8.0));
    let floors = (high / 2.8).round().max(1.0) as usize;
    for (name, origin, toward, length) in [
        ("a", [0.0, 0.0, -z], [0.0, 1.0], 2.0 * x),
        ("b", [x, 0.0, 0.0], [-1.0, 0.0], 2.0 * z),
        ("c", [-x, 0.0, 0.0], [1.0, 0.0], 2.0 * z),
    ] {
        let wall = Wall::new(origin, Turn::toward(toward), length, high);
        facade(s, name, &wall, floors, (length / 2.6).round().max(2.0) as usize);
    }
    let yard = Surface::flat([0.0; 3], [x - 0.4, z - 0.4], 100.0);
    let top = plinth(s, Stuff::Stone, [0.4, 0.2], [0.45, 0.45], 0.6);
    s.main(&top, &[F::Sculpture, F::Vessel, F::Solid, F::Rock], [0.5, 1.0]);
    let lamp = s.place(&ask(F::StreetLamp).most(1.6, 5.0, 1.6), &yard, [-0.5 * x, 0.2], 0.0);
    s.lit(lamp, 60.0);
    if lamp.is_none() {
        string_lamps(s, [-x + 0.1, 3.2, -1.0], [x - 0.1, 3.2, 1.0], 12, 60.0);
    }
    s.scatter(&yard.part([-0.7, 0.7], [-0.7, 0.2]), &[ask(F::Tree).most(4.0, 6.0, 4.0)], 1, ANY);
    let n = s.some(11);
    s.scatter(
        &yard,
        &[
            ask(F::Bench),
            TALL_PLANT,
            ask(F::Bicycle),
            POT.most(0.8, 0.8, 0.8),
            ask(F::Bin),
            BOX,
            CHAIR,
            ask(F::Table).most(1.2, 0.9, 1.2),
        ],
        n,
        ANY,
    );
    let focus = Aabb { low: [-0.5 * x, 0.5, -0.7 * z], high: [0.5 * x, 1.8, 0.3] };
    s.eye(3.0, From::Box(Aabb { low: [-0.8 * x, 1.3, 0.4 * z], high: [0.8 * x, 1.8, 0.95 * z] }), focus);
    s.look_at(1.0, &top, 0.8, [-1.2, 1.2], [0.05, 0.5]);
}

/// House fronts to both sides, lamps, vehicles, bins, trees along the kerb.
pub fn street(s: &mut Stage<'_>) {
    let road = ground(s, Stuff::Asphalt, 60.0);
    let (wide, high) = (s.draw("width", 4.0, 6.0), s.draw("height", 6.0, 9.5));
    let pave = 1.3;
    for (side, name) in [(-1.0, "left"), (1.0, "right")] {
        let floors = (high / 2.9).round() as usize;
        for k in 0..2 {
            let turn = Turn::toward([-side, 0.0]);
            let tall = high + s.any(-1.0, 1.0);
            let wall = Wall::new([side * wide, 0.0, -6.0 + 10.02 * f64::from(k)], turn, 10.0, tall);
            facade(s, &format!("{name}.{k}"), &wall, floors, 4);
        }
        s.board(
            "kerb",
            Stuff::Stone,
            Board {
                // Beside the house, not inset from it: the kerb keeps its whole width.
                center: [side * (wide - 0.5 * pave - GAP), 0.06, -1.0],
                half: [0.5 * pave, 0.06, 10.0],
                inset: [0.0, SEAM, 0.0],
                ..Board::PLAIN
            },
        );
    }
    // The end of the street.
    let wall = Wall::new([0.0, 0.0, -11.5], Turn::NONE, 2.0 * wide + 2.0, high + 1.0);
    facade(s, "end", &wall, 3, 4);
    let walk = |side: f64| Surface::flat([side * (wide - 0.5 * pave), 0.1195, -1.5], [0.5 * pave - 0.1, 8.0], 100.0);
    let (left, right) = (walk(-1.0), walk(1.0));
    let lamp = s.pick(&ask(F::StreetLamp).most(1.8, 6.5, 1.8));
    if let Some(lamp) = &lamp {
        for (side, on) in [(-1.0, &left), (1.0, &right)] {
            for at in [-4.5, 1.0, 5.0] {
                let put = s.put(lamp, on, [0.35 * -side, at], 0.0);
                s.lit(put, 55.0);
            }
        }
    }
    let stand = s.board(
        "plinths",
        Stuff::Stone,
        Board { center: [0.55 * -wide, 0.36, 0.6], half: [0.3, 0.24, 0.3], ..Board::PLAIN },
    );
    s.main(&stand, &[F::Sculpture, F::Vessel, F::Solid], [0.5, 1.0]);
    let road = road.part([-0.6 * (wide - pave) / 60.0, 0.6 * (wide - pave) / 60.0], [-0.14, 0.06]);
    let n = s.some(3);
    s.scatter(&road, &[ask(F::Vehicle)], n, [-0.08, 0.08]);
    let n = s.some(6);
    let goods = [
        ask(F::Bench),
        ask(F::Bin),
        ask(F::Bicycle),
        TALL_PLANT,
        ask(F::Tree).most(3.0, 6.0, 3.0),
        BOX,
        ask(F::Rail),
        ask(F::Sign),
        CHAIR,
    ];
    s.scatter(&left, &goods, n, ABOUT);
    s.scatter(&right, &goods, n, ABOUT);
    let focus = Aabb { low: [-0.5 * wide, 0.8, -6.0], high: [0.5 * wide, 2.2, 0.0] };
    s.eye(4.0, From::Box(Aabb { low: [-0.7 * wide, 1.4, 3.0], high: [0.7 * wide, 1.9, 7.5] }), focus);
}

/// A shelter with panes and a bench, a sign, a bin, the road and a vehicle, a lamp.
pub fn bus_stop(s: &mut Stage<'_>) {
    s.front = [-1.2, 1.2];
    let floor = ground(s, Stuff::Asphalt, 50.0);
    let pave = s.board(
        "pavement",
        Stuff::Stone,
        Board { center: [0.0, 0.06, -1.2], half: [12.0, 0.06, 1.6], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
    );
    let (x, deep, high) = (s.draw("width", 1.4, 2.2), 0.7, 2.3);
    let y = 0.12;
    let z = -1.6;
    for side in [-1.0, 1.0] {
        for (dz, tall) in [(-deep, high), (deep, high)] {
            s.board(
                "posts",
                Stuff::PaintedMetal,
                Board {
                    center: [side * x, y + 0.5 * tall, z + dz],
                    half: [0.03, 0.5 * tall, 0.03],
                    inset: [0.0, SEAM, 0.0],
                    ..Board::PLAIN
                },
            );
        }
    }
    s.board(
        "shelter roof",
        Stuff::PaintedMetal,
        Board {
            center: [0.0, y + high + 0.04, z],
            half: [x + 0.15, 0.04, deep + 0.2],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    if s.glassy() {
        let p = |px: f64, py: f64| [px, y + py, z - deep];
        s.quad("panes", Stuff::Pane, [p(-x, 0.15), p(x, 0.15), p(x, 2.1), p(-x, 2.1)]);
        s.world.solids.push(crate::scene_generation::place::Solid {
            y: [y + 0.15, y + 2.1],
            at: [0.0, z - deep],
            turn: Turn::NONE,
            half: [x, 0.01],
        });
    } else {
        s.board(
            "shelter back",
            Stuff::PaintedMetal,
            Board { center: [0.0, y + 0.5, z - deep], half: [x - 0.035, 0.35, 0.012], ..Board::PLAIN },
        );
    }
    let poster = [x - 0.06, y + 1.25, z];
    s.board(
        "poster case",
        Stuff::PaintedMetal,
        Board { center: [x, y + 1.25, z], half: [0.04, 0.9, 0.6], ..Board::PLAIN },
    );
    s.light(Light::Panel([poster[0] + 0.019, poster[1], poster[2]], [-1.0, 0.0, 0.0], [0.55, 0.82]), 30.0);
    s.panel_lamp([0.0, y + high, z], [0.5, 0.06], 26.0);
    let inner =
        Surface { clearance: high - 0.1, ..Surface::flat([0.0, pave.center[1], z], [x - 0.1, deep - 0.1], high - 0.1) };
    let seat = s.place(&ask(F::Bench).most(2.0 * x - 0.4, 1.2, 0.8), &inner, [-0.15, -0.25], 0.0);
    let top = match seat.and_then(|b| s.top(b)) {
        Some(top) => top,
        None => bench(s, Stuff::Wood, [0.0, pave.center[1], z - 0.35], [1.4, 0.45, 0.4], Turn::NONE),
    };
    s.main(&top, &[F::Vessel, F::Toy, F::Instrument, F::Food], [0.2, 0.4]);
    if !s.has_main {
        s.main(&inner.part([0.2, 0.9], [0.0, 0.9]), &[F::Sculpture, F::Instrument, F::Toy], [0.3, 0.5]);
    }
    let walk = pave.part([-0.35, 0.35], [-0.8, 0.9]);
    let lamp = s.scatter(&walk, &[ask(F::StreetLamp).most(1.8, 6.0, 1.8)], 1, ABOUT).pop();
    s.lit(lamp, 50.0);
    let n = s.some(9);
    s.scatter(
        &walk,
        &[ask(F::Bin), ask(F::Sign), BOX, ask(F::Bicycle), TALL_PLANT, ask(F::Rail), ask(F::Bush)],
        n,
        ABOUT,
    );
    s.scatter(&inner, &[BOX.most(0.5, 0.6, 0.4), ask(F::Paper), ask(F::Leaves).most(0.4, 0.2, 0.4)], 3, ANY);
    s.scatter(&floor.part([-0.12, 0.12], [0.05, 0.1]), &[ask(F::Vehicle)], 1, [1.4, 1.7]);
    let house = Wall::new([0.0, 0.0, -4.2], Turn::NONE, 16.0, 6.0);
    facade(s, "house", &house, 2, 6);
    let focus = Aabb { low: [-0.8, 0.7, z - 0.3], high: [0.8, 1.5, z + 0.3] };
    s.eye(3.0, From::Box(Aabb { low: [-3.5, 1.3, 1.5], high: [3.5, 1.8, 4.0] }), focus);
    s.eye(
        1.0,
        From::Box(Aabb { low: [-x + 0.3, 1.2, z + 0.3], high: [x - 0.3, 1.6, z + 1.2] }),
        Aabb::around([0.0, 0.8, z - 0.4], [0.5, 0.2, 0.1]),
    );
}

/// A basin with water and a column of bowls in a square.
pub fn fountain(s: &mut Stage<'_>) {
    let stuff = s.one("ground", &[Stuff::Stone, Stuff::Tile, Stuff::Asphalt]);
    let floor = ground(s, stuff, 40.0);
    let (radius, high) = (s.draw("radius", 1.1, 1.9), 0.5);
    let sides = 12;
    let stone = s.one("basin", &[Stuff::Stone, Stuff::Concrete, Stuff::Brick]);
    let thick = 0.14;
    for i in 0..sides {
        let a = 2.0 * PI * (f64::from(i) + 0.5) / f64::from(sides);
        let turn = Turn::new(a);
        let [dx, dz] = turn.apply([0.0, radius]);
        let half = (radius + thick) * tauflow_data::maths::tan(PI / f64::from(sides));
        s.board(
            "basin",
            stone,
            Board { center: [dx, 0.5 * high, dz], half: [half, 0.5 * high, thick], turn, ..Board::PLAIN },
        );
    }
    s.board(
        "basin bed",
        stone,
        Board {
            center: [0.0, 0.04, 0.0],
            half: [0.7 * radius, 0.04, 0.7 * radius],
            inset: [0.0, SEAM, 0.0],
            ..Board::PLAIN
        },
    );
    let level = high - 0.08;
    let w = radius - 0.02;
    // An octagon of water, as two quads and the corners between them.
    let at = |k: usize| {
        let a = 2.0 * PI * k as f64 / f64::from(sides);
        let r = w / tauflow_data::maths::cos(PI / f64::from(sides));
        [r * tauflow_data::maths::sin(a), level, r * tauflow_data::maths::cos(a)]
    };
    for k in 0..(sides as usize / 2 - 1) {
        let n = sides as usize;
        s.quad("water", Stuff::Water, [at(k), at(k + 1), at(n - k - 2), at(n - k - 1)]);
    }
    let column = s.board("plinths", stone, Board { center: [0.0, 0.45, 0.0], half: [0.2, 0.37, 0.2], ..Board::PLAIN });
    let top = s.board(
        "plinths",
        stone,
        Board { center: [0.0, column.center[1] + 0.051, 0.0], half: [0.34, 0.05, 0.34], ..Board::PLAIN },
    );
    s.main(&top, &[F::Sculpture, F::Vessel, F::Solid], [0.5, 0.9]);
    let rim = Surface { clearance: 100.0, ..Surface::flat([0.0, high, radius], [0.3, 0.1], 100.0) };
    s.scatter(&rim, &[ask(F::Vessel).most(0.18, 0.4, 0.18), ask(F::Leaves).most(0.18, 0.1, 0.18)], 2, ANY);
    let walls =
        [("a", [0.0, 0.0, -6.5], [0.0, 1.0]), ("b", [-7.0, 0.0, 0.0], [1.0, 0.0]), ("c", [7.0, 0.0, 0.0], [-1.0, 0.0])];
    for (name, origin, toward) in walls {
        let wall = Wall::new(origin, Turn::toward(toward), 13.0, 6.5);
        facade(s, name, &wall, 2, 5);
    }
    let lamp = s.pick(&ask(F::StreetLamp).most(1.6, 5.0, 1.6));
    for at in [[-3.2, 1.2], [3.2, 1.4], [0.0, -4.5]] {
        let put = lamp.as_ref().and_then(|l| s.put(l, &floor, at, 0.0));
        s.lit(put, 55.0);
        if put.is_none() {
            s.board(
                "posts",
                Stuff::Metal,
                Board { center: [at[0], 1.3, at[1]], half: [0.03, 1.3, 0.03], inset: [0.0, SEAM, 0.0], ..Board::PLAIN },
            );
            s.light(Light::Ball([at[0], 2.68, at[1]], 0.08), 50.0);
        }
    }
    let square = floor.part([-0.13, 0.13], [-0.13, 0.11]);
    let n = s.some(12);
    s.scatter(
        &square,
        &[
            ask(F::Bench),
            TALL_PLANT,
            ask(F::Bin),
            ask(F::Bicycle),
            ask(F::Tree).most(4.0, 6.0, 4.0),
            CHAIR,
            ask(F::Rail),
            POT.most(0.8, 0.8, 0.8),
        ],
        n,
        ANY,
    );
    let focus = Aabb { low: [-0.8, 0.4, -0.8], high: [0.8, 1.5, 0.8] };
    s.eye(3.0, From::Orbit([3.2, 5.8], [-1.2, 1.2], [0.08, 0.4]), focus);
}
