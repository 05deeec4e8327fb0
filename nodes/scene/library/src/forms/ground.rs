//! Rocks, ground, cloth, rugs.

use super::{
    super::{
        noise::{fractal, noise},
        shapes::*,
        stuff::Stuff,
    },
    Family, Form, FormVariant, form,
    maker::{Maker, one},
};
use tauflow_data::geom::{Vec3, dot, mul, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("rock", Family::Rock, 12, rock),
    form("pebbles", Family::Rock, 8, pebbles),
    form("rock_slabs", Family::Rock, 6, slabs),
    form("rock_strata", Family::Rock, 6, strata),
    form("terrain_hills", Family::Terrain, 8, hills),
    form("terrain_dunes", Family::Terrain, 6, dunes),
    form("terrain_snow", Family::Terrain, 6, snow),
    form("soil_heap", Family::Terrain, 6, heap),
    form("tablecloth", Family::Cloth, 6, tablecloth),
    form("cloth_draped_box", Family::Cloth, 6, draped),
    form("cloth_hung", Family::Cloth, 6, hung),
    form("towels_folded", Family::Cloth, 8, towels),
    form("rug", Family::Rug, 8, rug),
    form("rug_round", Family::Rug, 6, rug_round),
    form("doormat", Family::Rug, 6, doormat),
];

fn stone(d: &mut Stream, size: f64, levels: u32) -> Body {
    let seed = d.bits();
    let (amount, cells) = (d.range(0.15, 0.4), d.range(1.0, 2.0));
    let planes: Vec<(Vec3, f64)> =
        (0..7).map(|_| (unit([d.normal(), d.normal(), d.normal()]), d.range(0.62, 0.95))).collect();
    let shape = [1.0, d.range(0.55, 0.9), d.range(0.7, 1.0)];
    icosphere(levels, |p| {
        // Planes cut a ball; noise roughens what is left.
        let cut = planes.iter().fold(1.0f64, |r, (n, o)| {
            let along = dot(p, *n);
            if along > 0.05 { r.min(o / along) } else { r }
        });
        size * cut * (1.0 + amount * fractal(seed, mul(p, cells), [0; 3], 5) + 0.02 * noise(seed, mul(p, 14.0), [0; 3]))
    })
    .scaled(shape)
}

/// Cut off below, so that it rests broadly.
fn settled(body: Body, share: f64) -> Body {
    let low = body.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let high = body.points.iter().map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
    let floor = low + share * (high - low);
    // Lower points become nearly flat, but no triangle may vanish.
    body.bent(|p| if p[1] < floor { [p[0], floor + 0.02 * (p[1] - floor), p[2]] } else { p })
}

fn rock(d: &mut Stream) -> FormVariant {
    let size = d.range(0.15, 0.7);
    one(Stuff::Stone, settled(stone(d, size, 4), 0.18))
}

fn pebbles(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let count = 7 + d.below(14);
    let r = d.range(0.08, 0.2);
    for k in 0..count {
        let size = r * d.range(0.08, 0.2);
        let t = ((k as f64 + 0.5) / count as f64).sqrt();
        let a = 2.399_963 * k as f64;
        let (flat, turn) = (d.range(0.45, 0.8), d.range(0.0, TAU));
        let seed = d.bits();
        let body = icosphere(2, |p| size * (1.0 + 0.18 * noise(seed, mul(p, 1.3), [0; 3])))
            .scaled([1.0, flat, 0.8])
            .turned_y(turn);
        let low = body.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
        m.add(Stuff::Stone, body.at([r * t * maths::sin(a), -low, r * t * maths::cos(a)]));
    }
    m.made()
}

fn slabs(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let count = 3 + d.below(4);
    let mut y = 0.0;
    let mut r = d.range(0.2, 0.4);
    for k in 0..count {
        let thick = r * d.range(0.25, 0.45);
        let n = 9 + d.below(5);
        let (phase, seed) = (d.range(0.0, TAU), d.bits());
        let outline = |scale: f64| {
            (0..n)
                .map(|i| {
                    let a = TAU * i as f64 / n as f64 + phase;
                    let q =
                        r * scale * (1.0 + 0.3 * noise(seed, [2.0 * maths::cos(a), 2.0 * maths::sin(a), 0.5], [0; 3]));
                    [q * maths::sin(a), q * maths::cos(a)]
                })
                .collect::<Vec<_>>()
        };
        let ring = |scale: f64, y: f64| outline(scale).into_iter().map(|[x, z]| [x, y, z]).collect::<Vec<Vec3>>();
        let (dx, dz) = (0.1 * r * d.range(-1.0, 1.0), 0.1 * r * d.range(-1.0, 1.0));
        let rings = [ring(0.9, 0.0), ring(1.0, 0.2 * thick), ring(0.97, 0.8 * thick), ring(0.86, thick)];
        m.add(Stuff::Stone, skin(&rings, [true, false], [true, true]).at([dx, y, dz]));
        y += thick;
        if k + 1 == count {
            m.top([dx, y, dz], [0.3 * r, 0.3 * r], f64::INFINITY);
        }
        r *= d.range(0.72, 0.92);
    }
    m.made()
}

/// A block with ledges, by a stepped distance field.
fn strata(d: &mut Stream) -> FormVariant {
    let (r, h, seed) = (d.range(0.3, 0.6), d.range(0.4, 0.9), d.bits());
    let layers = d.range(7.0, 12.0);
    let distance = move |p: Vec3| {
        let y = p[1] / h;
        let layer = (y * layers + 0.6 * noise(seed, [2.0 * p[0] / r, 0.0, 2.0 * p[2] / r], [0; 3])).floor();
        let wide = r * (0.95 - 0.35 * y + 0.16 * noise(seed ^ 7, [0.0, layer * 3.7, 0.0], [0; 3]));
        let wild = 0.18 * r * fractal(seed, mul(p, 2.5 / r), [0; 3], 4);
        let flat = (p[0] * p[0] + p[2] * p[2]).sqrt() - wide + wild;
        (0.7 * flat).max(-p[1]).max(p[1] - h * 0.9 + 0.4 * wild)
    };
    one(
        Stuff::Stone,
        Field { distance, low: [-1.3 * r, -0.01, -1.3 * r], high: [1.3 * r, 1.05 * h, 1.3 * r] }.body(0.068 * r),
    )
}

/// Ground of `half` size with height `f(x, z)`, with walls down to a flat foot.
fn ground(half: [f64; 2], n: usize, f: impl Fn(f64, f64) -> f64) -> Body {
    let top = |i: usize, j: usize| {
        let (x, z) = (half[0] * (2.0 * i as f64 / n as f64 - 1.0), half[1] * (1.0 - 2.0 * j as f64 / n as f64));
        [x, f(x, z).max(0.01), z]
    };
    let rings: Vec<Vec<Vec3>> = (0..=n).map(|j| (0..=n).map(|i| top(i, j)).collect()).collect();
    let mut body = skin(&rings, [false, false], [false; 2]).smooth();
    // Round the edge, seen from above counter-clockwise.
    let mut edge: Vec<Vec3> = (0..n).map(|i| top(i, 0)).collect();
    edge.extend((0..n).map(|j| top(n, j)));
    edge.extend((0..n).map(|i| top(n - i, n)));
    edge.extend((0..n).map(|j| top(0, n - j)));
    let foot: Vec<Vec3> = edge.iter().map(|p| [p[0], 0.0, p[2]]).collect();
    body = body.with(skin(&[foot, edge], [true, false], [true, false]));
    body
}

fn hills(d: &mut Stream) -> FormVariant {
    let (half, h, seed) = (d.range(2.0, 4.0), d.range(0.3, 1.0), d.bits());
    let cells = d.range(0.6, 1.1);
    let body = ground([half, half], 72, |x, z| {
        let p = [x / half * 1.6 * cells, 0.0, z / half * 1.6 * cells];
        h * (0.5 + 0.5 * fractal(seed, p, [0; 3], 6)) + 0.02
    });
    one(*d.pick(&[Stuff::Soil, Stuff::Grass, Stuff::Stone]), body)
}

fn dunes(d: &mut Stream) -> FormVariant {
    let (half, h, seed) = (d.range(2.0, 4.0), d.range(0.15, 0.45), d.bits());
    let waves = d.range(2.0, 4.0);
    let body = ground([half, half], 84, |x, z| {
        let bend = 0.8 * noise(seed, [x / half, 0.0, z / half * 1.5], [0; 3]);
        let t = waves * (x / half + bend);
        let t = t - t.floor();
        // A long windward slope and a short lee.
        let dune =
            if t < 0.7 { 0.5 - 0.5 * maths::cos(PI * t / 0.7) } else { 0.5 + 0.5 * maths::cos(PI * (t - 0.7) / 0.3) };
        let ripple =
            0.008 * maths::sin(38.0 * (x + 0.6 * bend) + 3.0 * noise(seed ^ 3, [2.0 * x, 0.0, 2.0 * z], [0; 3]));
        0.03 + h * dune * (0.7 + 0.3 * noise(seed ^ 1, [x / half * 2.0, 0.0, z / half], [0; 3])) + ripple
    });
    one(Stuff::Sand, body)
}

fn snow(d: &mut Stream) -> FormVariant {
    let (half, h, seed) = (d.range(1.0, 2.5), d.range(0.1, 0.35), d.bits());
    let body = ground([half, half * d.range(0.6, 1.0)], 60, |x, z| {
        let v = fractal(seed, [1.3 * x / half, 0.0, 1.3 * z / half], [0; 3], 3);
        let edge = (1.0 - maths::pow((x / half).abs(), 4.0)) * (1.0 - maths::pow((z / half).abs().min(1.0), 4.0));
        0.02 + h * (0.55 + 0.45 * v) * edge.max(0.05)
    });
    one(Stuff::Snow, body)
}

fn heap(d: &mut Stream) -> FormVariant {
    let (r, h, seed) = (d.range(0.3, 0.9), d.range(0.25, 0.5), d.bits());
    let stuff = *d.pick(&[Stuff::Soil, Stuff::Sand, Stuff::Snow]);
    let rings: Vec<Vec<Vec3>> = (0..=24)
        .map(|j| {
            let t = 1.0 - f64::from(j) / 24.0;
            circle(56, r * t)
                .into_iter()
                .map(|[c, s]| {
                    let k = 1.0 + 0.25 * noise(seed, [c / r * 1.5, 3.0, s / r * 1.5], [0; 3]) * t;
                    let y = h * r * 1.6 * maths::pow(1.0 - t, 0.9) * (1.0 - 0.35 * maths::exp(-20.0 * t * t));
                    [
                        s * k,
                        (y + 0.06 * r * fractal(seed, [4.0 * s / r, 0.0, 4.0 * c / r], [0; 3], 4) * (1.0 - t * t))
                            .max(0.0),
                        c * k,
                    ]
                })
                .collect()
        })
        .collect();
    one(stuff, skin(&rings, [true, false], [true, false]).smooth())
}

/// Pushes a point out of a box, by the nearest side but never downwards.
fn outside_box(p: Vec3, half: [f64; 2], top: f64) -> Vec3 {
    let (dx, dz, dy) = (half[0] - p[0].abs(), half[1] - p[2].abs(), top - p[1]);
    let p = if dx <= 0.0 || dz <= 0.0 || dy <= 0.0 {
        p
    } else if dy < dx && dy < dz {
        [p[0], top, p[2]]
    } else if dx < dz {
        [half[0] * if p[0] < 0.0 { -1.0 } else { 1.0 }, p[1], p[2]]
    } else {
        [p[0], p[1], half[1] * if p[2] < 0.0 { -1.0 } else { 1.0 }]
    };
    [p[0], p[1].max(0.003), p[2]]
}

/// A square cloth laid flat at height `top`, turned a little; what lies on the support stays, the rest falls.
fn cloth_over(
    d: &mut Stream,
    top: f64,
    size: [f64; 2],
    support: impl Fn(Vec3) -> bool,
    keep: impl Fn(Vec3) -> Vec3,
) -> Body {
    let turn = d.range(-0.4, 0.4);
    let shift = [0.06 * size[0] * d.range(-1.0, 1.0), 0.06 * size[1] * d.range(-1.0, 1.0)];
    let seed = d.bits();
    let (sn, cs) = (maths::sin(turn), maths::cos(turn));
    let lay = |s: f64, t: f64| {
        let (x, z) = (size[0] * (2.0 * s - 1.0), size[1] * (1.0 - 2.0 * t));
        let p = [x * cs + z * sn + shift[0], top, z * cs - x * sn + shift[1]];
        // A little unevenness, where it hangs, lets folds begin.
        let wild = 0.006 * noise(seed, [9.0 * x, 0.0, 9.0 * z], [0; 3]);
        if support(p) { p } else { [p[0] + wild, p[1] + wild, p[2] - wild] }
    };
    Cloth::new(42, 42, 0.02, lay).pinned(|s, t| support(lay(s, t))).fallen(80, keep).sheet()
}

/// A cloth on a round table, the table below it.
fn tablecloth(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let (r, height) = (d.range(0.35, 0.5), d.range(0.7, 0.75));
    m.add(
        Stuff::Wood,
        lathe(
            &[[0.0, 0.0], [0.55 * r, 0.0], [0.5 * r, 0.03], [0.05, 0.06], [0.04, height - 0.03], [0.0, height - 0.03]],
            24,
        ),
    );
    m.add(
        Stuff::Wood,
        lathe(
            &[
                [0.0, height - 0.03],
                [r - 0.03, height - 0.03],
                [r - 0.02, height - 0.02],
                [r - 0.02, height - 0.012],
                [r - 0.032, height],
                [0.0, height],
            ],
            48,
        ),
    );
    let size = r + d.range(0.2, 0.4);
    // The cloth keeps a distance, so that between its points it does not cut the edge.
    let (wide, top) = (r + 0.012, height + 0.003);
    let keep = |p: Vec3| {
        let l = (p[0] * p[0] + p[2] * p[2]).sqrt();
        let (inside, deep) = (wide - l, top - p[1]);
        let p = if inside <= 0.0 || deep <= 0.0 || deep > 0.2 {
            p
        } else if deep < inside {
            [p[0], top, p[2]]
        } else {
            [p[0] * wide / l, p[1], p[2] * wide / l]
        };
        [p[0], p[1].max(0.003), p[2]]
    };
    let on = |p: Vec3| (p[0] * p[0] + p[2] * p[2]).sqrt() < 0.97 * r;
    let cloth = cloth_over(d, top, [size, size], on, keep);
    m.add(Stuff::Fabric, cloth);
    m.top([0.0, top, 0.0], [0.6 * r, 0.6 * r], f64::INFINITY);
    m.made()
}

fn draped(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let (half, height) = ([d.range(0.15, 0.35), d.range(0.15, 0.3)], d.range(0.2, 0.6));
    m.add(
        Stuff::Wood,
        soft_block([0.0, 0.5 * height, 0.0], [half[0] - 0.012, 0.5 * height, half[1] - 0.012], 0.014, 2),
    );
    let size = [half[0] + d.range(0.12, 0.4), half[1] + d.range(0.12, 0.4)];
    let (wide, top) = (half.map(|h| h + 0.012), height + 0.003);
    let on = |p: Vec3| p[0].abs() < half[0] && p[2].abs() < half[1];
    let cloth = cloth_over(d, top, size, on, |p| outside_box(p, wide, top));
    m.add(Stuff::Fabric, cloth);
    m.top([0.0, top, 0.0], [half[0] - 0.04, half[1] - 0.04], f64::INFINITY);
    m.made()
}

/// A cloth hung from two or three points.
fn hung(d: &mut Stream) -> FormVariant {
    let (w, h) = (d.range(0.4, 0.8), d.range(0.5, 1.2));
    let points = 2 + d.below(3);
    let narrow = d.range(0.75, 0.95);
    let seed = d.bits();
    let cloth = Cloth::new(36, 36, 0.02, |s, t| {
        let x = w * (2.0 * s - 1.0);
        // Drawn together at its upper edge; the slack makes folds.
        let wave = 0.03 * maths::sin(TAU * 4.0 * s) + 0.01 * noise(seed, [6.0 * s, 6.0 * t, 0.0], [0; 3]);
        [x * narrow, h * (1.0 + t) * 0.5 + 0.5, wave]
    })
    .pinned(|s, t| t > 0.999 && (0..points).any(|k| (s - k as f64 / (points - 1) as f64).abs() < 0.02))
    .fallen(70, |p| [p[0], p[1], p[2].max(-0.12)]);
    let mut m = Maker::default();
    m.add(Stuff::Fabric, cloth.sheet());
    m.made()
}

fn towels(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let half = [d.range(0.14, 0.2), d.range(0.1, 0.15)];
    let count = 1 + d.below(5);
    let mut y = 0.0;
    for _ in 0..count {
        let t = d.range(0.014, 0.022);
        let (dx, dz) = (d.range(-0.006, 0.006), d.range(-0.006, 0.006));
        // Folded: three layers, of which the outer two meet in a fold to one side.
        let side = if d.chance(0.5) { 1.0 } else { -1.0 };
        let layer = |k: f64, x: f64| {
            soft_block([side * x, t * (k + 0.5), 0.0], [half[0] - x.abs(), 0.5 * t, half[1]], 0.48 * t, 3)
        };
        let body = layer(0.0, 0.0).with(layer(1.0, 0.004)).with(layer(2.0, -0.006));
        let (low, high) = (0.0, 3.0 * t);
        m.another(Stuff::Fabric, body.at([dx, y - low, dz]));
        y += high - low + 0.0005;
    }
    m.top([0.0, y - 0.0005, 0.0], [half[0] - 0.06, half[1] - 0.02], f64::INFINITY);
    m.made()
}

fn rug(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.5, 1.2), d.range(0.35, 0.8)];
    let t = d.range(0.008, 0.018);
    let mut m = Maker::default();
    m.add(Stuff::Carpet, soft_block([0.0, 0.5 * t, 0.0], [half[0], 0.5 * t, half[1]], 0.004, 1));
    m.top([0.0, t, 0.0], [half[0] - 0.02, half[1] - 0.02], f64::INFINITY);
    if d.chance(0.6) {
        let count = (half[1] / 0.012) as usize;
        let mut fringe = Vec::new();
        for s in [-1.0, 1.0] {
            for k in 0..count {
                let z = half[1] * (2.0 * (k as f64 + 0.5) / count as f64 - 1.0);
                let l = d.range(0.04, 0.07);
                let path = [
                    [s * (half[0] - 0.003), 0.4 * t, z],
                    [s * (half[0] + 0.4 * l), 0.004, z + d.range(-0.004, 0.004)],
                    [s * (half[0] + l), 0.003, z + d.range(-0.01, 0.01)],
                ];
                fringe.push(tube(&path, 4, |_| 0.0028).smooth());
            }
        }
        m.add(Stuff::Fabric, Body::all(fringe));
    }
    m.made()
}

fn rug_round(d: &mut Stream) -> FormVariant {
    let (r, t) = (d.range(0.4, 1.0), d.range(0.01, 0.02));
    let mut m = Maker::default();
    let disc = extrude(&circle(64, r), t).turned_x(-0.5 * PI).at([0.0, 0.5 * t, 0.0]);
    m.add(Stuff::Carpet, disc);
    m.top([0.0, t, 0.0], [0.65 * r, 0.65 * r], f64::INFINITY);
    m.made()
}

fn doormat(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.3, 0.4), d.range(0.2, 0.26)];
    let mut m = Maker::default();
    m.add(Stuff::Rubber, soft_block([0.0, 0.004, 0.0], [half[0], 0.004, half[1]], 0.003, 1));
    m.add(Stuff::Carpet, soft_block([0.0, 0.011, 0.0], [half[0] - 0.02, 0.005, half[1] - 0.02], 0.003, 1));
    let text = *d.pick(&["WELCOME", "HELLO", "HOME", "MIND THE STEP"]);
    let height = (0.14f64).min(0.14 * (half[0] * 1.5) / text_width(text, 0.14));
    m.add(Stuff::Rubber, lettering(text, height, 0.16, 0.004).turned_x(-0.5 * PI).at([0.0, 0.0165, 0.0]));
    m.made()
}
