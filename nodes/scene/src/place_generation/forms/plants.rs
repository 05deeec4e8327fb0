//! Plants: potted, trees, bushes, grass, leaves.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, Made, form,
    maker::Maker,
};
use crate::geom::{Vec3, add, mul, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("plant_leafy", Family::Plant, 8, leafy),
    form("plant_fern", Family::Plant, 8, fern),
    form("plant_cactus", Family::Plant, 8, cactus),
    form("plant_succulent", Family::Plant, 8, succulent),
    form("plant_strap", Family::Plant, 8, strap),
    form("flowers_vase", Family::Plant, 8, flowers),
    form("tree_broadleaf", Family::Tree, 8, broadleaf),
    form("tree_conifer", Family::Tree, 8, conifer),
    form("tree_palm", Family::Tree, 6, palm),
    form("tree_bare", Family::Tree, 6, bare),
    form("tree_poplar", Family::Tree, 6, poplar),
    form("bush_round", Family::Bush, 8, bush),
    form("hedge", Family::Bush, 8, hedge),
    form("grass_tuft", Family::Grass, 8, tuft),
    form("grass_patch", Family::Grass, 8, patch),
    form("reeds", Family::Grass, 6, reeds),
    form("leaves_fallen", Family::Leaves, 8, fallen),
    form("twig_leaves", Family::Leaves, 8, twig),
    form("ivy", Family::Leaves, 6, ivy),
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
                .map(|[c, s]| {
                    [s, soil + 0.06 * r * super::super::noise::noise(seed, [5.0 * s / r, 0.0, 5.0 * c / r], [0; 3]), c]
                })
                .collect()
        })
        .collect();
    m.add(Stuff::Soil, skin(&rings, [true, false], [false; 2]).smooth());
    soil
}

fn outwards(a: f64, rise: f64) -> Vec3 {
    [maths::cos(rise) * maths::sin(a), maths::sin(rise), maths::cos(rise) * maths::cos(a)]
}

fn leafy(d: &mut Stream) -> Made {
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

fn fern(d: &mut Stream) -> Made {
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

fn cactus(d: &mut Stream) -> Made {
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

fn succulent(d: &mut Stream) -> Made {
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

fn strap(d: &mut Stream) -> Made {
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
fn flowers(d: &mut Stream) -> Made {
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
            let other = crate::geom::cross(way, side);
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

fn foliage(d: &mut Stream, buds: &[(Vec3, Vec3)], size: f64, wide: f64, most: usize) -> Body {
    let step = (buds.len() / most).max(1);
    Body::all(buds.iter().step_by(step).map(|(p, w)| {
        let length = size * d.range(0.7, 1.3);
        leaf(*p, *w, [length, length * wide], d.range(0.05, 0.35))
    }))
}

fn broadleaf(d: &mut Stream) -> Made {
    let growth = Growth {
        levels: 3,
        children: 5 + d.below(2),
        shorter: d.range(0.55, 0.68),
        thinner: 0.5,
        angle: d.range(0.6, 0.95),
        from: 0.4,
        bend: 0.14,
        lift: d.range(0.0, 0.12),
    };
    let h = d.range(1.6, 2.6);
    let r = d.range(0.07, 0.13);
    let way = [d.range(-0.08, 0.08), 1.0, d.range(-0.08, 0.08)];
    let tree = Branching::grown(d, &growth, [0.0; 3], way, h, r, 14);
    let mut m = Maker::default();
    m.add(Stuff::Bark, tree.wood);
    let leaves = foliage(d, &tree.buds, 0.17, 0.62, 1700);
    m.add(Stuff::Leaf, leaves);
    m.made()
}

fn poplar(d: &mut Stream) -> Made {
    let growth = Growth {
        levels: 2,
        children: 16,
        shorter: 0.26,
        thinner: 0.3,
        angle: d.range(0.3, 0.5),
        from: 0.12,
        bend: 0.06,
        lift: 0.15,
    };
    let h = d.range(4.0, 6.5);
    let tree = Branching::grown(d, &growth, [0.0; 3], [0.0, 1.0, 0.0], h, 0.1, 9);
    let mut m = Maker::default();
    m.add(Stuff::Bark, tree.wood);
    let leaves = foliage(d, &tree.buds, 0.16, 0.75, 1700);
    m.add(Stuff::Leaf, leaves);
    m.made()
}

fn bare(d: &mut Stream) -> Made {
    let growth = Growth {
        levels: 4,
        children: 4,
        shorter: d.range(0.58, 0.7),
        thinner: 0.52,
        angle: d.range(0.5, 0.8),
        from: 0.45,
        bend: 0.22,
        lift: d.range(0.0, 0.15),
    };
    let h = d.range(1.3, 2.2);
    let r = d.range(0.06, 0.12);
    let tree = Branching::grown(d, &growth, [0.0; 3], [0.0, 1.0, 0.0], h, r, 0);
    let mut m = Maker::default();
    m.add(Stuff::Bark, tree.wood);
    m.made()
}

fn conifer(d: &mut Stream) -> Made {
    let (h, wide) = (d.range(2.0, 5.0), d.range(0.2, 0.32));
    let mut m = Maker::default();
    m.add(Stuff::Bark, tube(&line([0.0; 3], [0.0, h, 0.0], 8), 9, |t| 0.022 * h * (1.05 - t)));
    let rows = 20 + d.below(8);
    let mut needles = Vec::new();
    let mut twigs = Vec::new();
    for k in 0..rows {
        let t = k as f64 / rows as f64;
        let y = h * (0.12 + 0.86 * t);
        let l = wide * h * maths::pow(1.0 - t, 0.85) + 0.03 * h;
        let around = 7 + ((1.0 - t) * 5.0) as usize;
        for i in 0..around {
            let a = TAU * i as f64 / around as f64 + 0.7 * k as f64 + d.range(-0.2, 0.2);
            let droop = d.range(0.15, 0.3) * (1.0 - t);
            let l = l * d.range(0.8, 1.1);
            let at = |s: f64| [l * s * maths::sin(a), y - droop * l * s + 0.12 * l * s * s, l * s * maths::cos(a)];
            twigs.push(tube(&[at(0.0), at(0.5), at(1.0)], 3, |s| 0.004 * h * (1.05 - s)).smooth());
            for j in 1..6 {
                let s = f64::from(j) / 6.0;
                let n = l * 0.42 * (1.1 - s) + 0.02 * h;
                for side in [-1.0, 1.0] {
                    needles.push(blade(at(s), outwards(a + side * 0.95, -0.15), [n, 0.28 * n], 0.15, 1));
                }
            }
            needles.push(blade(at(0.75), outwards(a, 0.0), [0.35 * l, 0.06 * l], 0.1, 2));
        }
    }
    m.add(Stuff::Bark, Body::all(twigs));
    m.add(Stuff::Leaf, Body::all(needles));
    m.made()
}

fn palm(d: &mut Stream) -> Made {
    let (h, lean) = (d.range(2.5, 5.0), d.range(-0.8, 0.8));
    let mut m = Maker::default();
    let path: Vec<Vec3> = (0..=24).map(|k| f64::from(k) / 24.0).map(|t| [lean * t * t, h * t, 0.0]).collect();
    let rings = 24.0;
    m.add(
        Stuff::Bark,
        tube(&path, 12, |t| 0.11 - 0.04 * t + 0.012 * maths::sin(PI * rings * t).abs() + 0.06 * maths::exp(-20.0 * t)),
    );
    let top = path[24];
    let mut leaves = Vec::new();
    let fronds = 13 + d.below(7);
    for k in 0..fronds {
        let a = 2.399_963 * k as f64;
        let rise = 1.15 - 1.1 * k as f64 / fronds as f64;
        let l = d.range(1.2, 1.7);
        let at = |t: f64| {
            let p = mul(outwards(a, rise), l * t);
            [top[0] + p[0], top[1] + p[1] - 0.7 * l * t * t, top[2] + p[2]]
        };
        leaves.push(
            tube(&(0..=6).map(|j| at(f64::from(j) / 6.0)).collect::<Vec<_>>(), 3, |t| 0.014 * (1.1 - t)).smooth(),
        );
        for j in 3..26 {
            let t = f64::from(j) / 26.0;
            let n = 0.5 * maths::pow(maths::sin(PI * (0.08 + 0.86 * t)), 0.7);
            for s in [-1.0, 1.0] {
                leaves.push(blade(at(t), outwards(a + s * 0.9, -0.35), [n, 0.035], 0.45, 3));
            }
        }
    }
    m.add(Stuff::Leaf, Body::all(leaves));
    m.made()
}

fn bush(d: &mut Stream) -> Made {
    let (r, squash) = (d.range(0.25, 0.6), d.range(0.7, 1.1));
    let mut m = Maker::default();
    let mut wood = Vec::new();
    for k in 0..9 {
        let way = outwards(2.399_963 * f64::from(k), d.range(0.6, 1.4));
        wood.push(tube(
            &spline(&[[0.0; 3], mul(way, 0.6 * r), add(mul(way, 1.1 * r), [0.0, 0.3 * r, 0.0])], 3),
            5,
            |t| 0.025 * r * (1.2 - t),
        ));
    }
    m.add(Stuff::Bark, Body::all(wood));
    let seed = d.bits();
    let count = 1300 + d.below(500);
    let size = r * d.range(0.13, 0.22);
    let leaves = Body::all((0..count).map(|k| {
        // Even over the ball, denser near its skin.
        let z = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
        let a = 2.399_963 * k as f64;
        let c = (1.0 - z * z).sqrt();
        let way = [c * maths::sin(a), z, c * maths::cos(a)];
        let lump = 1.0 + 0.22 * super::super::noise::fractal(seed, mul(way, 2.2), [0; 3], 3);
        let k = r * lump * (0.8 + 0.2 * d.uniform());
        let p = [way[0] * k, (r + way[1] * k) * squash + 0.05, way[2] * k];
        let turned = unit(add(way, [d.range(-0.7, 0.7), d.range(-0.2, 0.8), d.range(-0.7, 0.7)]));
        leaf(p, turned, [size * d.range(0.7, 1.2), 0.6 * size], 0.2)
    }));
    m.add(Stuff::Leaf, leaves);
    m.made()
}

fn hedge(d: &mut Stream) -> Made {
    let half = [d.range(0.5, 1.0), d.range(0.3, 0.75), d.range(0.18, 0.3)];
    let mut m = Maker::default();
    // A dark core that stops the view, and leaves over it.
    m.add(Stuff::Leaf, soft_block([0.0, half[1], 0.0], [half[0] - 0.05, half[1] - 0.03, half[2] - 0.05], 0.05, 2));
    let size = d.range(0.05, 0.075);
    let areas = [half[0] * half[1], half[0] * half[2], half[1] * half[2]];
    let total: f64 = 2.0 * areas[0] + areas[1] + 2.0 * areas[2];
    let mut leaves = Vec::new();
    for _ in 0..2200 {
        let pick = d.range(0.0, total);
        let (u, v) = (d.range(-1.0, 1.0), d.range(-1.0, 1.0));
        let side = if d.chance(0.5) { 1.0 } else { -1.0 };
        let (p, n) = if pick < 2.0 * areas[0] {
            ([u * half[0], half[1] * (1.0 + v), side * half[2]], [0.0, 0.0, side])
        } else if pick < 2.0 * areas[0] + areas[1] {
            ([u * half[0], 2.0 * half[1], v * half[2]], [0.0, 1.0, 0.0])
        } else {
            ([side * half[0], half[1] * (1.0 + u), v * half[2]], [side, 0.0, 0.0])
        };
        let way = unit(add(n, [d.range(-0.9, 0.9), d.range(-0.5, 0.9), d.range(-0.9, 0.9)]));
        let p = add(p, mul(n, d.range(-0.05, 0.0) - 0.6 * size * 0.5));
        leaves.push(leaf([p[0], p[1].max(0.6 * size), p[2]], way, [size * d.range(0.7, 1.2), 0.65 * size], 0.15));
    }
    m.another(Stuff::Leaf, Body::all(leaves));
    m.made()
}

fn blades(d: &mut Stream, count: usize, spread: [f64; 2], h: f64, wide: f64) -> Body {
    Body::all((0..count).map(|_| {
        let (u, v) = (d.range(-1.0, 1.0), d.range(-1.0, 1.0));
        let a = d.range(0.0, TAU);
        blade(
            [u * spread[0], 0.0, v * spread[1]],
            outwards(a, d.range(1.0, 1.5)),
            [h * d.range(0.5, 1.2), wide * d.range(0.7, 1.2)],
            d.range(0.05, 0.5),
            3,
        )
    }))
}

fn tuft(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let (r, h) = (d.range(0.02, 0.06), d.range(0.08, 0.3));
    let count = 50 + d.below(90);
    let body = blades(d, count, [r, r], h, 0.006);
    m.add(Stuff::Grass, body);
    m.made()
}

/// A square metre of lawn or meadow on a thin layer of soil.
fn patch(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let half = d.range(0.4, 0.55);
    let h = d.range(0.04, 0.16);
    let wide = d.range(0.006, 0.011);
    let body = blades(d, 2600, [half, half], h, wide);
    m.add(Stuff::Grass, body);
    m.add(Stuff::Soil, sheet(2, 2, |s, t| [half * (2.0 * s - 1.0), 0.001, half * (1.0 - 2.0 * t)]));
    m.made()
}

fn reeds(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let h = d.range(0.8, 1.6);
    let count = 10 + d.below(14);
    let (mut stalks, mut heads, mut straps) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..count {
        let a = 2.399_963 * k as f64;
        let t = (k as f64 / count as f64).sqrt();
        let root = [0.22 * t * maths::sin(a), 0.0, 0.22 * t * maths::cos(a)];
        let l = h * d.range(0.7, 1.1);
        let way = outwards(a, d.range(1.35, 1.52));
        let tip = add(root, mul(way, l));
        if k % 2 == 0 {
            stalks.push(tube(&[root, tip], 5, |_| 0.004));
            let n = d.range(0.1, 0.16);
            heads.push(tube(&line(add(root, mul(way, l - 1.3 * n)), add(root, mul(way, l - 0.2 * n)), 5), 8, |t| {
                0.012 * maths::pow(maths::sin(PI * (0.1 + 0.8 * t)), 0.3)
            }));
        }
        for _ in 0..3 {
            straps.push(blade(
                root,
                outwards(a + d.range(-1.0, 1.0), d.range(1.2, 1.5)),
                [l * d.range(0.5, 0.9), 0.018],
                d.range(0.02, 0.3),
                6,
            ));
        }
    }
    m.add(Stuff::Grass, Body::all(stalks).with(Body::all(straps)));
    m.add(Stuff::Bark, Body::all(heads));
    m.made()
}

fn fallen(d: &mut Stream) -> Made {
    let mut m = Maker::default();
    let (r, count) = (d.range(0.2, 0.6), 30 + d.below(90));
    for part in 0..3 {
        let leaves = Body::all((0..count / 3).map(|_| {
            let (a, k) = (d.range(0.0, TAU), r * d.uniform().sqrt());
            let l = d.range(0.04, 0.09);
            let lift = d.range(0.0, 0.25);
            leaf(
                [k * maths::sin(a), 0.001 + d.range(0.0, 0.006), k * maths::cos(a)],
                outwards(d.range(0.0, TAU), lift),
                [l, 0.6 * l],
                0.6 * lift,
            )
        }));
        if part == 0 { m.add(Stuff::Leaf, leaves) } else { m.another(Stuff::Leaf, leaves) }
    }
    m.made()
}

fn twig(d: &mut Stream) -> Made {
    let growth =
        Growth { levels: 2, children: 5, shorter: 0.5, thinner: 0.55, angle: 0.8, from: 0.25, bend: 0.18, lift: 0.0 };
    let l = d.range(0.3, 0.6);
    let tree = Branching::grown(d, &growth, [0.0; 3], [0.0, 0.25, 1.0], l, 0.006, 4);
    let mut m = Maker::default();
    let leaves = foliage(d, &tree.buds, 0.055, 0.5, 400);
    m.add(Stuff::Bark, tree.wood);
    m.add(Stuff::Leaf, leaves);
    m.made()
}

/// Ivy that climbs a wall behind it (in the plane z = const).
fn ivy(d: &mut Stream) -> Made {
    let (w, h) = (d.range(0.4, 0.9), d.range(0.8, 1.8));
    let mut m = Maker::default();
    let (mut stems, mut leaves) = (Vec::new(), Vec::new());
    for _ in 0..14 {
        let mut p = [d.range(-0.6, 0.6) * w, 0.0, 0.004];
        let mut a = d.range(-0.4, 0.4);
        let mut path = vec![p];
        let steps = 10 + d.below(16);
        for _ in 0..steps {
            a = (a + d.range(-0.5, 0.5)).clamp(-1.2, 1.2);
            let l = h / 22.0;
            p = [(p[0] + l * maths::sin(a)).clamp(-w, w), p[1] + l * maths::cos(a), 0.004 + d.range(0.0, 0.012)];
            path.push(p);
            for _ in 0..3 {
                let size = d.range(0.045, 0.085);
                let b = d.range(0.0, TAU);
                let q = [p[0] + d.range(-0.03, 0.03), (p[1] + d.range(-0.03, 0.03)).max(0.03), p[2] + 0.01];
                leaves.push(leaf(
                    q,
                    unit([maths::sin(b), maths::cos(b) * 0.6 - 0.4, d.range(0.3, 0.9)]),
                    [size, 0.8 * size],
                    0.1,
                ));
            }
        }
        stems.push(tube(&path, 4, |t| 0.005 * (1.2 - t)));
    }
    m.add(Stuff::Bark, Body::all(stems));
    m.add(Stuff::Leaf, Body::all(leaves));
    m.made()
}
