//! Grass, reeds, loose leaves, ivy.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
    potted::outwards,
    trees::foliage,
};
use tauflow_data::geom::{add, mul, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("grass_tuft", Family::Grass, 8, tuft),
    form("grass_patch", Family::Grass, 8, patch),
    form("reeds", Family::Grass, 6, reeds),
    form("leaves_fallen", Family::Leaves, 8, fallen),
    form("twig_leaves", Family::Leaves, 8, twig),
    form("ivy", Family::Leaves, 6, ivy),
];

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

fn tuft(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let (r, h) = (d.range(0.02, 0.06), d.range(0.08, 0.3));
    let count = 50 + d.below(90);
    let body = blades(d, count, [r, r], h, 0.006);
    m.add(Stuff::Grass, body);
    m.made()
}

/// A square metre of lawn or meadow on a thin layer of soil.
fn patch(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let half = d.range(0.4, 0.55);
    let h = d.range(0.04, 0.16);
    let wide = d.range(0.006, 0.011);
    let body = blades(d, 2600, [half, half], h, wide);
    m.add(Stuff::Grass, body);
    m.add(Stuff::Soil, sheet(2, 2, |s, t| [half * (2.0 * s - 1.0), 0.001, half * (1.0 - 2.0 * t)]));
    m.made()
}

fn reeds(d: &mut Stream) -> FormVariant {
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

fn fallen(d: &mut Stream) -> FormVariant {
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

fn twig(d: &mut Stream) -> FormVariant {
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
fn ivy(d: &mut Stream) -> FormVariant {
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
