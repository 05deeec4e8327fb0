//! Under the open sky: meadow, wood, shore, hills.

use super::kit::*;
use crate::scene_generation::{
    place::{Surface, Turn},
    props::ask,
    stage::{Board, From, Stage},
};
use std::sync::Arc;
use tauflow_data::geom::Aabb;
use tauflow_scene_library::{Land, Relief, forms::Family as F, noise::fractal, stuff::Stuff};

/// Variants of each land.
const LANDS: u64 = 12;

/// Cells along a side of a land.
const CELLS: usize = 72;

/// A land of a kind: heights within about `rise`, over a square of half a side `half`; flat about the middle if `calm`.
fn land(s: &mut Stage<'_>, name: &'static str, half: f64, rise: f64, wave: f64, calm: f64) -> Option<Arc<Land>> {
    let mut d = s.next();
    let variant = s.cast.params.variant(&mut d, LANDS);
    s.params.insert("land".into(), variant as f64);
    let made = tauflow_scene_library::land(name, variant, || {
        let seed = tauflow_data::rng::mix(0x6C61_6E64, variant) ^ name.len() as u64;
        let mut heights = Vec::new();
        for j in 0..=CELLS {
            for i in 0..=CELLS {
                let [x, z] = [i, j].map(|k| half * (2.0 * k as f64 / CELLS as f64 - 1.0));
                let far = ((x * x + z * z).sqrt() / half).min(1.0);
                let amount = rise * (calm + (1.0 - calm) * far);
                heights.push(amount * fractal(seed, [x / wave, 0.3, z / wave], [0; 3], 4));
            }
        }
        Relief { cells: CELLS, half, heights }
    });
    match made {
        Ok(made) => Some(made),
        Err(fault) => {
            s.fault.get_or_insert(fault);
            None
        }
    }
}

/// Uneven ground, and far about it flat ground a little lower.
pub fn uneven(
    s: &mut Stage<'_>,
    name: &'static str,
    stuff: Stuff,
    half: f64,
    rise: f64,
    wave: f64,
    calm: f64,
) -> Surface {
    let low = -0.45 * rise - 0.02;
    let far = 6.0 * half;
    s.quad("far ground", stuff, [[-far, low, far], [far, low, far], [far, low, -far], [-far, low, -far]]);
    match land(s, name, half, rise, wave, calm) {
        Some(land) => s.land("land", stuff, land, [0.0; 3]),
        None => Surface::flat([0.0, low, 0.0], [half; 2], 100.0),
    }
}

pub fn near(on: &Surface, share: f64) -> Surface {
    Surface { half: on.half.map(|h| h * share), ..on.clone() }
}

/// A flat stone or a stump to show something on; set into the ground at a place.
pub fn rest(s: &mut Stage<'_>, on: &Surface, stuff: Stuff, at: [f64; 2], half: f64, height: f64) -> Surface {
    let turn = Turn::new(s.any(0.0, 1.5));
    let [low, high] = on.ground(at, turn, [half, half]).unwrap_or([0.0; 2]);
    let top = high + height;
    let (y, h) = (0.5 * (low - 0.02 + top), 0.5 * (top - low + 0.02));
    let out = s.board("stone", stuff, Board { center: [at[0], y, at[1]], half: [half, h, half], turn, ..Board::PLAIN });
    out.inset(0.02)
}

/// A person's look at things within a few metres of the middle.
pub fn walk(s: &mut Stage<'_>, reach: f64, tall: f64) {
    let at = Aabb { low: [-0.4 * reach, 0.1 * tall, -0.4 * reach], high: [0.4 * reach, 0.7 * tall, 0.4 * reach] };
    s.eye(3.0, From::Orbit([0.8 * reach, 1.7 * reach], ROUND, [0.03, 0.4]), at);
}

/// Grass and flowers, a few trees, stones.
pub fn meadow(s: &mut Stage<'_>) {
    let ground = uneven(s, "meadow", Stuff::Grass, 16.0, 1.2, 9.0, 0.25);
    let top = rest(s, &ground, Stuff::Stone, [0.2, -0.1], 0.45, 0.2);
    s.main(&top, &[F::Vessel, F::Rock, F::Food, F::Sculpture, F::Instrument], [0.3, 0.6]);
    let n = s.some(16);
    s.scatter(
        &near(&ground, 0.16),
        &[ask(F::Grass), ask(F::Grass), ask(F::Grass), ask(F::Rock).scaled(0.1, 0.5), ask(F::Bush), ask(F::Leaves)],
        n,
        ANY,
    );
    let n = s.some(6);
    s.scatter(&near(&ground, 0.6), &[ask(F::Tree), ask(F::Bush), ask(F::Fence)], n, ANY);
    let n = s.some(6);
    s.scatter(&near(&ground, 0.35), &[ask(F::Grass), ask(F::Rock).scaled(0.2, 0.9), ask(F::Bush)], n, ANY);
    walk(s, 3.2, 0.9);
}

/// Trunks all round, fallen leaves, ferns, a log to sit on.
pub fn forest_clearing(s: &mut Stage<'_>) {
    let stuff = s.one("soil", &[Stuff::Soil, Stuff::Grass]);
    let ground = uneven(s, "forest", stuff, 14.0, 1.5, 6.0, 0.2);
    let top = rest(s, &ground, Stuff::Bark, [0.0, 0.0], 0.35, 0.35);
    s.main(&top, &[F::Vessel, F::Rock, F::Sculpture, F::Instrument, F::Tool], [0.3, 0.6]);
    let n = s.some(12);
    let kinds = s.pick(&ask(F::Tree));
    for k in 0..n {
        let a = core::f64::consts::TAU * (k as f64 + s.any(0.0, 0.8)) / n as f64;
        let r = s.any(3.0, 7.5);
        let at = [r * tauflow_data::maths::sin(a), r * tauflow_data::maths::cos(a)];
        let other = if k % 3 == 0 { s.pick(&ask(F::Tree)) } else { kinds.clone() };
        let turn = Turn::new(s.any(0.0, 6.0));
        if let Some(tree) = other {
            let _ = s.put_at(&tree, &ground, at, turn);
        }
    }
    let n = s.some(14);
    s.scatter(
        &near(&ground, 0.22),
        &[
            ask(F::Leaves),
            ask(F::Grass),
            ask(F::Bush),
            ask(F::Rock).scaled(0.15, 0.6),
            ask(F::Bush).most(1.4, 1.2, 1.4),
            ask(F::Leaves),
            // Whoever works or rests here.
            ask(F::Bench),
            ask(F::Box).most(0.6, 0.6, 0.6),
            ask(F::Tool),
        ],
        n,
        ANY,
    );
    walk(s, 3.5, 1.4);
}

/// Boulders and pebbles on a beach of dunes, driftwood, what the sea left.
pub fn rocks_on_sand(s: &mut Stage<'_>) {
    let ground = uneven(s, "dunes", Stuff::Sand, 14.0, 0.9, 4.0, 0.35);
    let top = rest(s, &ground, Stuff::Stone, [0.0, 0.1], 0.4, 0.12);
    s.main(&top, &[F::Rock, F::Vessel, F::Sculpture, F::Solid], [0.25, 0.6]);
    let n = s.some(18);
    s.scatter(
        &near(&ground, 0.14),
        &[
            ask(F::Rock).scaled(0.08, 0.3),
            ask(F::Rock).scaled(0.2, 0.9),
            ask(F::Rock),
            ask(F::Grass),
            ask(F::Leaves),
            ask(F::Vessel).scaled(0.15, 0.3),
        ],
        n,
        ANY,
    );
    let n = s.some(8);
    s.scatter(&near(&ground, 0.45), &[ask(F::Rock).scaled(0.6, 2.2), ask(F::Grass), ask(F::Bush)], n, ANY);
    walk(s, 2.8, 0.8);
}

/// Hills with trees and walls of stone; far away.
pub fn hills(s: &mut Stage<'_>) {
    let stuff = s.one("cover", &[Stuff::Grass, Stuff::Snow, Stuff::Soil, Stuff::Grass]);
    let ground = uneven(s, "hills", stuff, 40.0, 9.0, 22.0, 0.15);
    let top = rest(s, &ground, Stuff::Stone, [0.0, 0.0], 0.9, 0.5);
    s.main(&top, &[F::Rock, F::Sculpture, F::Vessel, F::Solid], [0.7, 1.6]);
    let n = s.some(13);
    s.scatter(
        &near(&ground, 0.25),
        &[ask(F::Tree), ask(F::Rock).scaled(0.5, 2.0), ask(F::Bush), ask(F::Tree), ask(F::Fence)],
        n,
        ANY,
    );
    let n = s.some(14);
    s.scatter(&near(&ground, 0.8), &[ask(F::Tree), ask(F::Tree), ask(F::Rock).scaled(1.0, 3.0)], n, ANY);
    let at = Aabb { low: [-3.0, 0.2, -3.0], high: [3.0, 2.0, 3.0] };
    s.eye(3.0, From::Orbit([6.0, 15.0], ROUND, [0.04, 0.35]), at);
}

/// A bank, water to the far side, reeds, stones, a boat's rail.
pub fn lake_shore(s: &mut Stage<'_>) {
    let stuff = s.one("bank", &[Stuff::Sand, Stuff::Soil, Stuff::Grass]);
    let half = 16.0;
    let slope = 0.1;
    let name = "shore";
    let mut d = s.next();
    let variant = s.cast.params.variant(&mut d, LANDS);
    s.params.insert("land".into(), variant as f64);
    let made = tauflow_scene_library::land(name, variant, || {
        let seed = tauflow_data::rng::mix(0x7368_6F72, variant);
        let mut heights = Vec::new();
        for j in 0..=CELLS {
            for i in 0..=CELLS {
                let [x, z] = [i, j].map(|k| half * (2.0 * k as f64 / CELLS as f64 - 1.0));
                heights.push(slope * z + 0.35 * fractal(seed, [x / 5.0, 0.7, z / 5.0], [0; 3], 4));
            }
        }
        Relief { cells: CELLS, half, heights }
    });
    let ground = match made {
        Ok(land) => s.land("land", stuff, land, [0.0; 3]),
        Err(fault) => {
            s.fault.get_or_insert(fault);
            return;
        }
    };
    s.quad(
        "far ground",
        Stuff::Soil,
        [[-90.0, -1.9, 90.0], [90.0, -1.9, 90.0], [90.0, -1.9, -90.0], [-90.0, -1.9, -90.0]],
    );
    s.quad("water", Stuff::Water, [[-90.0, 0.0, half], [90.0, 0.0, half], [90.0, 0.0, -90.0], [-90.0, 0.0, -90.0]]);
    // A pier of planks.
    let pier = s.draw("pier", -2.0, 2.0);
    for i in 0..14 {
        s.board(
            "pier",
            Stuff::Wood,
            Board { center: [pier, 0.42, 1.2 - 0.3 * f64::from(i)], half: [0.6, 0.02, 0.14], ..Board::PLAIN },
        );
    }
    for i in 0..4 {
        for side in [-1.0, 1.0] {
            s.board(
                "posts",
                Stuff::Wood,
                Board {
                    center: [pier + side * 0.66, 0.0, 1.0 - 1.2 * f64::from(i)],
                    half: [0.05, 0.75, 0.05],
                    ..Board::PLAIN
                },
            );
        }
    }
    let end = Surface { clearance: 50.0, ..Surface::flat([pier, 0.44, -0.6], [0.55, 0.13], 50.0) };
    s.main(&end, &[F::Vessel, F::Tool, F::Food, F::Solid], [0.14, 0.24]);
    let bank = Surface { center: [0.0; 3], half: [6.0, 2.2], ..ground.clone() };
    let dry = Surface { center: [0.0; 3], ..bank };
    let n = s.some(15);
    for _ in 0..n {
        let at = [s.any(-5.0, 5.0), s.any(-1.0, 4.5)];
        let kind = ask(*s.next().pick(&[F::Rock, F::Grass, F::Grass, F::Bush, F::Rock, F::Leaves]));
        let kind = if kind.family == F::Rock { kind.scaled(0.15, 0.9) } else { kind };
        let turn = Turn::new(s.any(0.0, 6.0));
        if let Some(pick) = s.pick(&kind) {
            let _ = s.put_at(&pick, &Surface { half: [half; 2], ..dry.clone() }, at, turn);
        }
    }
    for _ in 0..s.some(5) {
        let at = [s.any(-9.0, 9.0), s.any(4.5, 9.0)];
        let turn = Turn::new(s.any(0.0, 6.0));
        if let Some(pick) = s.pick(&ask(F::Tree)) {
            let _ = s.put_at(&pick, &Surface { half: [half; 2], ..dry.clone() }, at, turn);
        }
    }
    let at = Aabb { low: [-2.5, 0.1, -2.0], high: [2.5, 0.8, 1.0] };
    s.eye(3.0, From::Box(Aabb { low: [-4.0, 1.5, 3.0], high: [4.0, 2.6, 6.5] }), at);
    s.eye(1.0, From::Orbit([3.0, 6.0], [-1.3, 1.3], [0.15, 0.5]), at);
}
