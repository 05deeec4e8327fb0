//! Plants in pots and flowers in vases.

use super::{
    super::{noise::noise, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::{Vec3, add, cross, mul, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("plant_leafy", Family::Plant, 8, leafy),
    form("plant_fern", Family::Plant, 8, fern),
    form("plant_cactus", Family::Plant, 8, cactus),
    form("plant_succulent", Family::Plant, 8, succulent),
    form("plant_strap", Family::Plant, 8, strap),
    form("flowers_vase", Family::Plant, 8, flowers),
];

/// A pot with soil; gives the soil's height.
fn pot(m: &mut Maker, d: &mut Stream, r: f64) -> f64 {
    let h = r * d.range(1.2, 2.0);
    let foot = r * d.range(0.65, 0.95);
    let stuff = *d.pick(&[Stuff::Clay, Stuff::Clay, Stuff::Ceramic, Stuff::Plastic, Stuff::Concrete]);
    let t = 0.06 * r + 0.002;
    let rim = if d.chance(0.5) { 0.08 * r } else { 0.0 };
    let mut profile = vec![[0.0, 0.0], [foot, 0.0]];
    if rim > 0.0 {
        profile.extend([[r, 0.8 * h], [r + rim, 0.8 * h], [r + rim, h], [r - t, h]]);
    } else {
        profile.extend([[r, h], [r - t, h]]);
    }
    let soil = 0.88 * h;
    profile.extend([[r - t - 0.01 * r, soil - 0.05 * h], [0.0, soil - 0.05 * h]]);
    m.add(stuff, lathe(&profile, 36));
    let seed = d.bits();
    let inner = r - t - 0.002;
    let rings: Vec<Vec<Vec3>> = (0..=4)
        .map(|j| {
            let k = inner * f64::from(4 - j) / 4.0;
            circle(24, k)
                .into_iter()
                .map(|[c, s]| [s, soil + 0.06 * r * noise(seed, [5.0 * s / r, 0.0, 5.0 * c / r], [0; 3]), c])
                .collect()
        })
        .collect();
    m.add(Stuff::Soil, skin(&rings, [true, false], [false; 2]).smooth());
    soil
}

pub(super) fn outwards(a: f64, rise: f64) -> Vec3 {
    [maths::cos(rise) * maths::sin(a), maths::sin(rise), maths::cos(rise) * maths::cos(a)]
}

fn leafy(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let r = d.range(0.07, 0.18);
    let soil = pot(&mut m, d, r);
    let stems = 5 + d.below(8);
    let size = r * d.range(1.0, 1.8);
    let (mut wood, mut leaves) = (Vec::new(), Vec::new());
    for k in 0..stems {
        let a = 2.399_963 * k as f64 + d.range(-0.3, 0.3);
        let rise = d.range(0.7, 1.4);
        let l = r * d.range(1.5, 4.0);
        let way = outwards(a, rise);
        let path = spline(
            &[
                [0.0, soil - 0.02, 0.0],
                add([0.0, soil, 0.0], mul(way, 0.55 * l)),
                add([0.0, soil, 0.0], add(mul(way, l), mul(outwards(a, 0.0), 0.2 * l))),
            ],
            4,
        );
        wood.push(tube(&path, 6, |t| 0.02 * r + 0.03 * r * (1.0 - t)));
        for j in 0..4 {
            let at = path[path.len() - 1 - j];
            let side = a + [0.0, 0.9, -0.9, 1.8][j];
            leaves.push(leaf(
                at,
                outwards(side, d.range(-0.2, 0.6)),
                [size * d.range(0.8, 1.2), size * d.range(0.5, 0.8)],
                d.range(0.1, 0.4),
            ));
        }
    }
    m.add(Stuff::Leaf, Body::all(leaves));
    m.add(Stuff::Bark, Body::all(wood));
    m.made()
}

fn fern(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let r = d.range(0.07, 0.13);
    let soil = pot(&mut m, d, r);
    let mut leaves = Vec::new();
    let fronds = 10 + d.below(8);
    for k in 0..fronds {
        let a = 2.399_963 * k as f64;
        let (l, rise) = (r * d.range(2.2, 4.0), d.range(0.6, 1.35));
        let path: Vec<Vec3> = (0..=10)
            .map(|j| {
                let t = f64::from(j) / 10.0;
                let p = mul(outwards(a, rise), l * t);
                [p[0], soil + p[1] - 0.75 * l * t * t * t, p[2]]
            })
            .collect();
        leaves.push(tube(&path, 3, |t| 0.004 * (1.2 - t)).smooth());
        for j in 2..22 {
            let t = f64::from(j) / 22.0 * 10.0;
            let (i, f) = (t as usize, t - t.floor());
            let p = add(mul(path[i], 1.0 - f), mul(path[(i + 1).min(10)], f));
            let w = 0.3 * l * maths::pow(maths::sin(PI * (0.1 + 0.85 * t / 10.0)), 0.8);
            for s in [-1.0, 1.0] {
                leaves.push(blade(p, unit(outwards(a + s * 1.25, 0.1)), [w, 0.035 * l], 0.25, 2));
            }
        }
    }
    m.add(Stuff::Leaf, Body::all(leaves));
    m.made()
}

fn ribbed(r: f64, h: f64, ribs: usize, deep: f64) -> Body {
    let n = ribs * 4;
    let rows = 14;
    let rings: Vec<Vec<Vec3>> = (0..=rows)
        .map(|j| {
            let t = j as f64 / rows as f64;
            let k = if t < 0.75 {
                0.85 + 0.15 * maths::sin(PI * t / 1.5)
            } else {
                maths::cos(0.5 * PI * (t - 0.75) / 0.25).max(0.0).sqrt()
            };
            let k = if j == rows { 0.0 } else { k };
            (0..n)
                .map(|i| {
                    let a = TAU * i as f64 / n as f64;
                    let rib = 1.0 - deep + deep * maths::cos(ribs as f64 * a);
                    [r * k * rib * maths::sin(a), h * t, r * k * rib * maths::cos(a)]
                })
                .collect()
        })
        .collect();
    skin(&rings, [true, false], [true, false]).smooth()
}

fn cactus(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let r = d.range(0.05, 0.12);
    let soil = pot(&mut m, d, r);
    let (w, h, ribs) = (r * d.range(0.4, 0.7), r * d.range(1.5, 5.0), 8 + d.below(8));
    m.add(Stuff::Leaf, ribbed(w, h, ribs, 0.12).at([0.0, soil - 0.01, 0.0]));
    if h > 3.0 * r {
        let arms = 1 + d.below(3);
        for k in 0..arms {
            let a = TAU * k as f64 / arms as f64 + 0.4;
            let (y, l) = (soil + h * d.range(0.3, 0.55), h * d.range(0.2, 0.35));
            let p = |x: f64, y: f64| [x * maths::sin(a), y, x * maths::cos(a)];
            let path =
                spline(&[p(0.5 * w, y), p(1.6 * w, y + 0.1 * w), p(2.0 * w, y + 0.8 * w), p(2.0 * w, y + l + w)], 5);
            m.add(Stuff::Leaf, tube(&path, 14, |t| 0.5 * w * (1.0 - maths::pow(t, 8.0)).max(0.0).sqrt().max(0.05)));
        }
    }
    // Spines in rows.
    let mut spines = Vec::new();
    for k in 0..ribs {
        let a = TAU * k as f64 / ribs as f64;
        for j in 1..8 {
            let y = soil + h * 0.1 * f64::from(j);
            let p = [0.97 * w * maths::sin(a), y, 0.97 * w * maths::cos(a)];
            for s in [-0.5, 0.5] {
                spines.push(tube(&[p, add(p, mul(outwards(a + s, 0.3), 0.12 * r))], 3, |t| 0.0008 * (1.05 - t)));
            }
        }
    }
    m.add(Stuff::Wax, Body::all(spines));
    m.made()
}

fn succulent(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let r = d.range(0.04, 0.09);
    let soil = pot(&mut m, d, r);
    let count = 24 + d.below(24);
    let long = d.range(0.7, 1.3);
    for k in (0..count).rev() {
        let t = k as f64 / count as f64;
        let a = 2.399_963 * k as f64;
        let l = r * long * (0.3 + 0.8 * t);
        let rise = 1.35 - 1.25 * t;
        let w = 0.24 * l + 0.05 * r;
        let petal = tube(&line([0.0; 3], [0.0, 0.0, l], 6), 8, |s| {
            w * (0.25 + 0.75 * maths::sin(PI * (0.1 + 0.8 * s))) * if s > 0.99 { 0.15 } else { 1.0 }
        });
        let petal = petal.smooth().scaled([1.0, 0.35, 1.0]).turned_x(-rise).turned_y(a);
        m.add(Stuff::Leaf, petal.at([0.0, soil + 0.12 * r + 0.25 * r * (1.0 - t), 0.0]));
    }
    m.made()
}

fn strap(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let r = d.range(0.06, 0.14);
    let soil = pot(&mut m, d, r);
    let count = 9 + d.below(12);
    let mut leaves = Vec::new();
    let droop = d.range(0.0, 0.5);
    for k in 0..count {
        let a = 2.399_963 * k as f64;
        let t = k as f64 / count as f64;
        let l = r * d.range(3.0, 6.0);
        let root = [0.35 * r * t * maths::sin(a), soil - 0.01, 0.35 * r * t * maths::cos(a)];
        leaves.push(blade(root, outwards(a, 1.5 - 0.6 * t), [l, r * d.range(0.35, 0.55)], droop * t, 8));
    }
    m.add(Stuff::Leaf, Body::all(leaves));
    m.made()
}

/// Cut flowers in a vase.
fn flowers(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let (h, w) = (d.range(0.15, 0.26), d.range(0.035, 0.055));
    let neck = w * d.range(0.5, 0.9);
    let outer = flat_spline(&[[0.7 * w, 0.0], [w, 0.3 * h], [neck, 0.8 * h], [1.2 * neck, h]], 5);
    let inner = outer.iter().rev().filter(|p| p[1] > 0.02).map(|p| [p[0] - 0.003, p[1]]).collect::<Vec<_>>();
    let profile: Vec<_> = [[0.0, 0.0]].into_iter().chain(outer).chain(inner).chain([[0.0, 0.015]]).collect();
    m.add(*d.pick(&[Stuff::Ceramic, Stuff::Clay]), lathe(&profile, 32).smooth());
    let count = 5 + d.below(8);
    let petals = 5 + d.below(9);
    let size = d.range(0.02, 0.045);
    let (mut stems, mut blooms, mut hearts, mut green) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for k in 0..count {
        let a = 2.399_963 * k as f64;
        let t = (k as f64 / count as f64).sqrt();
        let head = [0.13 * t * maths::sin(a), h + d.range(0.08, 0.2) - 0.05 * t, 0.13 * t * maths::cos(a)];
        let way = outwards(a, 1.4 - 0.9 * t);
        let path =
            spline(&[[0.0, 0.03, 0.0], [0.6 * neck * t * maths::sin(a), h, 0.6 * neck * t * maths::cos(a)], head], 5);
        stems.push(tube(&path, 5, |_| 0.0018));
        for j in 0..petals {
            let b = TAU * j as f64 / petals as f64;
            let side = unit([way[1], -way[0], 0.1 * way[0]]);
            let other = cross(way, side);
            let out = add(mul(side, maths::cos(b)), mul(other, maths::sin(b)));
            blooms.push(leaf(head, unit(add(out, mul(way, 0.45))), [size, 0.55 * size], 0.05));
        }
        hearts.push(ball(0.24 * size, 8).at(add(head, mul(way, 0.08 * size))));
        green.push(leaf(path[7], outwards(a + 1.0, 0.5), [0.06, 0.022], 0.3));
    }
    m.add(Stuff::Leaf, Body::all(stems).with(Body::all(green)));
    m.another(Stuff::Leaf, Body::all(blooms));
    m.add(Stuff::Food, Body::all(hearts));
    m.made()
}
