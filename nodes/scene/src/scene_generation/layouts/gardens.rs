//! Gardens, lawns, pools.

use super::{
    kit::*,
    nature::{near, rest, uneven, walk},
};
use crate::scene_generation::{
    place::{Surface, Turn},
    props::ask,
    stage::{Board, From, Stage},
};
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{forms::Family as F, stuff::Stuff};

/// Clipped hedges and paths, urns, a bench, steps.
pub fn hedge_garden(s: &mut Stage<'_>) {
    let path = s.one("paths", &[Stuff::Sand, Stuff::Stone, Stuff::Brick]);
    let floor = ground(s, Stuff::Grass, 40.0);
    s.facing("paths", path, [0.0, 0.0001, 0.0], [0.8, 0.0001, 9.0], Turn::NONE, &[2]);
    s.facing("paths", path, [0.0, 0.0002, 0.0], [6.0, 0.0002, 0.8], Turn::NONE, &[2]);
    let hedge = s.pick(&ask(F::Bush).named(&["hedge"]).most(4.0, 2.0, 2.0));
    if let Some(hedge) = &hedge {
        let (w, _) = (hedge.size[0].max(0.4) + 0.02, hedge.size[2]);
        let n = s.some(8);
        for k in 0..n {
            let side = if k % 2 == 0 { -1.0 } else { 1.0 };
            let row = (k / 2) as f64;
            let _ = s.put(hedge, &floor, [side * (1.2 + 0.5 * w), 2.0 - w * row], 0.0);
        }
    }
    let top = plinth(s, Stuff::Stone, [0.0, -0.2], [0.35, 0.35], 0.7);
    s.main(&top, &[F::Sculpture, F::Vessel, F::Solid], [0.5, 1.0]);
    let n = s.some(4);
    for k in 0..n {
        let at = [if k % 2 == 0 { -1.0 } else { 1.0 }, -1.2 - 1.3 * (k / 2) as f64];
        let high = 0.4;
        let on = plinth(s, Stuff::Stone, at, [0.2, 0.2], high);
        s.scatter(
            &on,
            &[ask(F::Vessel).scaled(0.3, 0.6), POT.most(0.4, 0.6, 0.4), ask(F::Solid).scaled(0.25, 0.4)],
            1,
            ANY,
        );
    }
    let n = s.some(13);
    s.scatter(
        &floor.part([-0.2, 0.2], [-0.2, 0.12]),
        &[
            ask(F::Bush),
            ask(F::Tree),
            TALL_PLANT,
            ask(F::Bench),
            ask(F::Grass),
            ask(F::Fence),
            ask(F::Bush),
            POT.most(0.8, 0.8, 0.8),
        ],
        n,
        ANY,
    );
    let at = Aabb { low: [-0.8, 0.4, -2.5], high: [0.8, 1.3, 0.5] };
    s.eye(3.0, From::Box(Aabb { low: [-0.7, 1.3, 2.5], high: [0.7, 1.8, 6.0] }), at);
    s.look_at(1.0, &top, 0.8, ROUND, [0.05, 0.4]);
}

/// A cloth on the grass with food, plates, a basket, shoes of trees about.
pub fn picnic(s: &mut Stage<'_>) {
    let floor = ground(s, Stuff::Grass, 40.0);
    let rug = s.place(&ask(F::Rug).least(1.3, 0.0, 1.0).most(3.0, 0.06, 2.6), &floor, [0.0, 0.0], 0.2);
    let on = match rug.and_then(|r| s.upon(r)) {
        Some(on) => on,
        None => s.board(
            "blanket",
            Stuff::Fabric,
            Board { center: [0.0, 0.004, 0.0], half: [0.9, 0.0035, 0.7], turn: Turn::new(0.2), ..Board::PLAIN },
        ),
    };
    let on = Surface { clearance: 100.0, ..on.inset(0.04) };
    s.main(&on, &[F::Food, F::Vessel, F::Instrument, F::Toy], [0.2, 0.45]);
    let n = s.some(16);
    s.scatter(
        &on,
        &[
            FOOD,
            PLATE,
            VESSEL,
            FOOD,
            UTENSIL,
            ask(F::Cushion),
            BOX.most(0.45, 0.4, 0.45),
            BOOK_LYING,
            ask(F::Cloth).most(0.4, 0.2, 0.4),
        ],
        n,
        ANY,
    );
    let n = s.some(9);
    s.scatter(
        &floor.part([-0.09, 0.09], [-0.09, 0.09]),
        &[ask(F::Grass), ask(F::Grass), ask(F::Bush), ask(F::Bicycle), ask(F::Rock).scaled(0.15, 0.5), TOY, CHAIR],
        n,
        ANY,
    );
    let n = s.some(4);
    s.scatter(&floor.part([-0.3, 0.3], [-0.35, -0.1]), &[ask(F::Tree), ask(F::Bush)], n, ANY);
    s.look_at(3.0, &on, 0.3, ROUND, [0.2, 0.7]);
    walk(s, 3.0, 0.7);
}

/// A pool with the sun in it, tiles, loungers, balls.
pub fn pool(s: &mut Stage<'_>) {
    let (x, z) = (s.draw("width", 1.6, 2.6), s.draw("length", 2.2, 3.8));
    let deep = s.draw("depth", 0.7, 1.2);
    let stuff = s.one("deck", &[Stuff::Stone, Stuff::Wood, Stuff::Tile, Stuff::Concrete]);
    // Ground with a hole in it.
    let far = 40.0;
    for (c, h) in [
        ([0.0, 0.5 * (far + z)], [far, 0.5 * (far - z)]),
        ([0.0, -0.5 * (far + z)], [far, 0.5 * (far - z)]),
        ([0.5 * (far + x), 0.0], [0.5 * (far - x), z]),
        ([-0.5 * (far + x), 0.0], [0.5 * (far - x), z]),
    ] {
        s.facing("deck", stuff, [c[0], -0.1, c[1]], [h[0], 0.1, h[1]], Turn::NONE, &[2]);
    }
    // Inner sides and the bed, wound to face inwards.
    let (y0, y1) = (-deep, 0.0);
    s.quad("basin", Stuff::Tile, [[-x, y0, z], [x, y0, z], [x, y0, -z], [-x, y0, -z]]);
    s.quad("basin", Stuff::Tile, [[-x, y0, -z], [x, y0, -z], [x, y1, -z], [-x, y1, -z]]);
    s.quad("basin", Stuff::Tile, [[x, y0, z], [-x, y0, z], [-x, y1, z], [x, y1, z]]);
    s.quad("basin", Stuff::Tile, [[-x, y0, z], [-x, y0, -z], [-x, y1, -z], [-x, y1, z]]);
    s.quad("basin", Stuff::Tile, [[x, y0, -z], [x, y0, z], [x, y1, z], [x, y1, -z]]);
    let level = -0.09;
    s.quad("water", Stuff::Water, [[-x, level, z], [x, level, z], [x, level, -z], [-x, level, -z]]);
    // A rim about it.
    let rim = 0.15;
    for (c, h) in [
        ([0.0, z + rim], [x + 2.0 * rim, rim]),
        ([0.0, -z - rim], [x + 2.0 * rim, rim]),
        ([x + rim, 0.0], [rim, z]),
        ([-x - rim, 0.0], [rim, z]),
    ] {
        s.board("rim", Stuff::Stone, Board { center: [c[0], 0.0, c[1]], half: [h[0], 0.03, h[1]], ..Board::PLAIN });
    }
    let bed = Surface::flat([0.0, y0, 0.0], [x - 0.1, z - 0.1], deep - 0.15);
    let deck = Surface::flat([0.0; 3], [x + 3.0, z + 3.0], 100.0);
    s.world.keep.push(crate::scene_generation::place::Solid {
        y: [-0.02, 3.0],
        at: [0.0, 0.0],
        turn: Turn::NONE,
        half: [x + 0.3, z + 0.3],
    });
    let side = Surface::flat([x + 1.2, 0.0, 0.3], [0.7, 1.5], 100.0);
    s.main(&side, &[F::Vessel, F::Sculpture, F::Solid, F::Toy], [0.3, 0.7]);
    let n = s.some(4);
    s.scatter(
        &bed,
        &[ask(F::Solid).scaled(0.15, 0.35), ask(F::Rock).scaled(0.1, 0.3), ask(F::Toy).scaled(0.1, 0.25)],
        n,
        ANY,
    );
    let n = s.some(15);
    s.scatter(
        &deck,
        &[
            CHAIR,
            TALL_PLANT,
            ask(F::Bench),
            SOLID.scaled(0.2, 0.4),
            BOX,
            POT,
            ask(F::Table).most(1.0, 0.8, 1.0),
            TOY,
            ask(F::Sofa).most(2.2, 1.0, 1.2),
            ask(F::Cloth).most(0.8, 0.3, 0.8),
        ],
        n,
        ANY,
    );
    let back = Surface::flat([0.0, 0.0, -z - 6.0], [8.0, 2.0], 100.0);
    let n = s.some(7);
    s.scatter(&back, &[ask(F::Tree), ask(F::Bush), ask(F::Bush), ask(F::Fence)], n, ANY);
    let at = Aabb { low: [-0.6 * x, -0.2, -0.7 * z], high: [0.6 * x, 0.3, 0.4 * z] };
    s.eye(3.0, From::Orbit([2.6, 5.5], [-1.2, 1.2], [0.25, 0.75]), at);
    s.eye(1.0, From::Box(Aabb { low: [-x - 1.0, 1.3, z + 0.5], high: [x + 1.0, 1.8, z + 2.2] }), at);
}

/// Sculptures and great stones on a lawn, paths, trees far about.
pub fn sculpture_park(s: &mut Stage<'_>) {
    let ground = uneven(s, "lawn", Stuff::Grass, 20.0, 0.8, 12.0, 0.2);
    let stuff = s.one("slabs", &[Stuff::Concrete, Stuff::Stone]);
    let top = rest(s, &ground, stuff, [0.0, 0.0], 0.7, 0.25);
    s.main(&top, &[F::Sculpture, F::Solid, F::Vessel, F::MachinePart], [0.8, 1.8]);
    let n = s.some(6);
    for k in 0..n {
        let a = core::f64::consts::TAU * (k as f64 + 0.3) / n as f64;
        let r = s.any(2.6, 5.5);
        let at = [r * tauflow_data::maths::sin(a), r * tauflow_data::maths::cos(a)];
        let on = rest(s, &ground, stuff, at, 0.55, 0.2);
        s.scatter(
            &on,
            &[
                ask(F::Sculpture).scaled(0.6, 1.6),
                ask(F::Column).most(1.0, 3.0, 1.0),
                ask(F::Solid).scaled(0.5, 0.9),
                ask(F::Rock).scaled(0.5, 1.0),
            ],
            1,
            ANY,
        );
    }
    let n = s.some(13);
    s.scatter(
        &near(&ground, 0.35),
        &[ask(F::Bench), ask(F::Grass), ask(F::Bush), ask(F::Rock).scaled(0.3, 0.9), ask(F::Bin), ask(F::Grass)],
        n,
        ANY,
    );
    let n = s.some(7);
    s.scatter(&near(&ground, 0.8), &[ask(F::Tree), ask(F::Tree), ask(F::Bush)], n, ANY);
    walk(s, 4.5, 1.6);
}
