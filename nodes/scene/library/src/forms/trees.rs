//! Trees, bushes, hedges.

use super::{
    super::{noise::fractal, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
    potted::outwards,
};
use tauflow_data::geom::{Vec3, add, mul, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("tree_broadleaf", Family::Tree, 8, broadleaf),
    form("tree_poplar", Family::Tree, 6, poplar),
    form("tree_bare", Family::Tree, 6, bare),
    form("tree_conifer", Family::Tree, 8, conifer),
    form("tree_palm", Family::Tree, 6, palm),
    form("bush_round", Family::Bush, 8, bush),
    form("hedge", Family::Bush, 8, hedge),
];

/// At most `most` leaves over the buds; large ones in eight triangles, those of trees in two.
pub(super) fn foliage(d: &mut Stream, buds: &[(Vec3, Vec3)], size: f64, wide: f64, most: usize) -> Body {
    let count = buds.len().min(most);
    Body::all((0..count).map(|k| {
        let (p, w) = buds[k * buds.len() / count];
        let length = size * d.range(0.7, 1.3);
        let droop = d.range(0.05, 0.35);
        if count > 800 {
            small_leaf(p, w, [length, length * wide], droop)
        } else {
            leaf(p, w, [length, length * wide], droop)
        }
    }))
}

fn broadleaf(d: &mut Stream) -> FormVariant {
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
    let tree = Branching::grown(d, &growth, [0.0; 3], way, h, r, 18);
    let mut m = Maker::default();
    m.add(Stuff::Bark, tree.wood);
    let leaves = foliage(d, &tree.buds, 0.15, 0.7, 4000);
    m.add(Stuff::Leaf, leaves);
    m.made()
}

fn poplar(d: &mut Stream) -> FormVariant {
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
    let tree = Branching::grown(d, &growth, [0.0; 3], [0.0, 1.0, 0.0], h, 0.1, 14);
    let mut m = Maker::default();
    m.add(Stuff::Bark, tree.wood);
    let leaves = foliage(d, &tree.buds, 0.17, 0.8, 4000);
    m.add(Stuff::Leaf, leaves);
    m.made()
}

fn bare(d: &mut Stream) -> FormVariant {
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

fn conifer(d: &mut Stream) -> FormVariant {
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

fn palm(d: &mut Stream) -> FormVariant {
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

fn bush(d: &mut Stream) -> FormVariant {
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
        let lump = 1.0 + 0.22 * fractal(seed, mul(way, 2.2), [0; 3], 3);
        let k = r * lump * (0.6 + 0.4 * d.uniform().sqrt());
        let p = [way[0] * k, (r + way[1] * k) * squash + 0.05, way[2] * k];
        let turned = unit(add(way, [d.range(-0.7, 0.7), d.range(-0.2, 0.8), d.range(-0.7, 0.7)]));
        leaf(p, turned, [size * d.range(0.7, 1.2), 0.6 * size], 0.2)
    }));
    m.add(Stuff::Leaf, leaves);
    m.made()
}

fn hedge(d: &mut Stream) -> FormVariant {
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
