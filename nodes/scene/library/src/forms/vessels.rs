//! Vessels: cups, bottles, glasses, vases, bowls, jars.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::{Maker, one},
    solid,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    solid("bottle", Family::Vessel, 16, bottle),
    solid("tumbler", Family::Vessel, 12, tumbler),
    solid("wine_glass", Family::Vessel, 12, wine_glass),
    solid("vase", Family::Vessel, 16, vase),
    solid("vase_twisted", Family::Vessel, 8, twisted),
    solid("bowl", Family::Vessel, 12, bowl),
    solid("decanter", Family::Vessel, 8, decanter),
    form("cup", Family::Vessel, 10, cup),
    form("jug", Family::Vessel, 8, jug),
    form("teapot", Family::Vessel, 8, teapot),
    form("jar_lidded", Family::Vessel, 8, jar),
    form("can", Family::Vessel, 6, can),
];

/// A vessel's profile from the axis below, up the outside `outer`, and down the inside at `thick` to a bottom.
fn hollow(outer: &[[f64; 2]], thick: f64, bottom: f64) -> Vec<[f64; 2]> {
    let first = outer[0];
    let [r, y] = outer[outer.len() - 1];
    let mut profile = vec![[0.0, first[1]]];
    profile.extend(outer);
    profile.push([r - 0.5 * thick, y + 0.35 * thick]);
    profile.extend(
        outer.iter().rev().filter(|p| p[1] > bottom + 0.3 * thick).map(|p| [(p[0] - thick).max(0.15 * p[0]), p[1]]),
    );
    let last = profile[profile.len() - 1];
    profile.push([0.8 * last[0], bottom + 0.1 * thick]);
    profile.push([0.0, bottom]);
    profile
}

fn bottle(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.03, 0.045), d.range(0.2, 0.33));
    let neck = d.range(0.011, 0.015);
    let (shoulder, top) = (h * d.range(0.5, 0.68), h * d.range(0.75, 0.85));
    let outer = flat_spline(
        &[
            [0.9 * r, 0.0],
            [r, 0.006],
            [r, 0.3 * shoulder],
            [r, 0.7 * shoulder],
            [r, shoulder],
            [0.55 * (r + neck), 0.5 * (shoulder + top)],
            [neck, top],
            [neck, h - 0.015],
            [1.15 * neck, h - 0.012],
            [1.15 * neck, h],
        ],
        4,
    );
    one(Stuff::Glass, lathe(&hollow(&outer, 0.0025, 0.008), 36).smooth())
}

fn tumbler(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.03, 0.045), d.range(0.08, 0.15));
    let flare = d.range(0.0, 0.2);
    let belly = d.range(-0.03, 0.06);
    let outer: Vec<_> = (0..=10)
        .map(|k| f64::from(k) / 10.0)
        .map(|t| {
            [r * (0.96 - flare + flare * t + belly * maths::sin(PI * t)) + if t == 0.0 { -0.0015 } else { 0.0 }, h * t]
        })
        .collect();
    one(Stuff::Glass, lathe(&hollow(&outer, 0.002, 0.009), 40).smooth())
}

fn wine_glass(d: &mut Stream) -> FormVariant {
    let (foot, stem, bowl, high) =
        (d.range(0.03, 0.036), d.range(0.06, 0.1), d.range(0.028, 0.045), d.range(0.07, 0.12));
    let lip = bowl * d.range(0.7, 1.0);
    let at = d.range(0.3, 0.5);
    let outer = flat_spline(
        &[
            [foot, 0.0],
            [foot, 0.0018],
            [0.4 * foot, 0.005],
            [0.0045, 0.015],
            [0.0035, 0.5 * stem],
            [0.005, stem],
            [0.7 * bowl, stem + 0.14 * high],
            [bowl, stem + at * high],
            [0.5 * (bowl + lip), stem + 0.75 * high],
            [lip, stem + high],
        ],
        4,
    );
    let bottom = stem + 0.07 * high;
    let mut profile = vec![[0.0, 0.0]];
    profile.extend(&outer);
    profile.extend(outer.iter().rev().filter(|p| p[1] > bottom).map(|p| [(p[0] - 0.0013).max(0.002), p[1] + 0.0003]));
    profile.push([0.0, bottom]);
    one(Stuff::Glass, lathe(&profile, 40).smooth())
}

fn vase_outline(d: &mut Stream, h: f64) -> Vec<[f64; 2]> {
    let w = h * d.range(0.2, 0.36);
    let (foot, neck, lip) = (w * d.range(0.4, 0.8), w * d.range(0.25, 0.7), w * d.range(0.35, 0.9));
    let (belly, collar) = (h * d.range(0.25, 0.55), h * d.range(0.75, 0.88));
    flat_spline(
        &[
            [foot, 0.0],
            [1.02 * foot, 0.004],
            [0.5 * (foot + w), 0.5 * belly],
            [w, belly],
            [0.6 * w + 0.4 * neck, 0.6 * belly + 0.4 * collar],
            [neck, collar],
            [lip, h],
        ],
        5,
    )
}

fn vase(d: &mut Stream) -> FormVariant {
    let h = d.range(0.14, 0.45);
    let outer = vase_outline(d, h);
    let stuff = *d.pick(&[Stuff::Ceramic, Stuff::Clay, Stuff::Glass, Stuff::Ceramic]);
    one(stuff, lathe(&hollow(&outer, 0.004, 0.01), 44).smooth())
}

/// A vase of a lobed section that turns as it rises.
fn twisted(d: &mut Stream) -> FormVariant {
    let h = d.range(0.18, 0.4);
    let outer = vase_outline(d, h);
    let (lobes, depth, twist) = (4 + d.below(6), d.range(0.04, 0.12), d.range(-2.5, 2.5));
    let n = 64;
    let profile = hollow(&outer, 0.005, 0.012);
    let rings: Vec<Vec<_>> = profile
        .iter()
        .map(|[r, y]| {
            (0..n)
                .map(|i| {
                    let a = TAU * i as f64 / n as f64;
                    let k = r * (1.0 + depth * maths::cos(lobes as f64 * (a + twist * y / h)));
                    [k * maths::sin(a), *y, k * maths::cos(a)]
                })
                .collect()
        })
        .collect();
    one(Stuff::Glass, skin(&rings, [true, false], [false; 2]).smooth())
}

fn bowl(d: &mut Stream) -> FormVariant {
    let r = d.range(0.06, 0.15);
    let h = r * d.range(0.45, 0.85);
    let foot = r * d.range(0.3, 0.5);
    let full = d.range(0.25, 0.6);
    let outer = flat_spline(
        &[[foot, 0.0], [foot, 0.006], [0.6 * r + 0.3 * full * r, 0.35 * h], [0.93 * r, 0.7 * h], [r, h]],
        5,
    );
    one(*d.pick(&[Stuff::Ceramic, Stuff::Glass, Stuff::Wood]), lathe(&hollow(&outer, 0.0045, 0.011), 44).smooth())
}

fn decanter(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.06, 0.1), d.range(0.22, 0.3));
    let neck = d.range(0.014, 0.02);
    let outer = flat_spline(
        &[
            [0.8 * r, 0.0],
            [0.97 * r, 0.01],
            [r, 0.16 * h],
            [0.6 * r, 0.36 * h],
            [1.1 * neck, 0.55 * h],
            [neck, 0.75 * h],
            [1.2 * neck, 0.9 * h],
            [2.0 * neck, h],
        ],
        5,
    );
    one(Stuff::Glass, lathe(&hollow(&outer, 0.003, 0.01), 44).smooth())
}

/// A handle in the plane z = 0, its ends inside the wall at `x`.
fn handle(x: f64, low: f64, high: f64, out: f64, r: f64) -> Body {
    let path = spline(
        &[
            [x - 0.001, high, 0.0],
            [x + 0.7 * out, high + 0.004, 0.0],
            [x + out, 0.5 * (low + high), 0.0],
            [x + 0.6 * out, low + 0.002, 0.0],
            [x - 0.001, low, 0.0],
        ],
        6,
    );
    sweep(
        &path,
        &circle(10, 1.0).into_iter().map(|[a, b]| [r * a, 1.5 * r * b]).collect::<Vec<_>>(),
        [0.0, 1.0, 0.0],
        |_| 1.0,
    )
}

fn cup(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.034, 0.046), d.range(0.06, 0.1));
    let stuff = *d.pick(&[Stuff::Ceramic, Stuff::Ceramic, Stuff::PaintedMetal, Stuff::Clay]);
    let mut m = Maker::default();
    let foot = r * d.range(0.6, 0.95);
    let full = r * d.range(0.92, 1.06);
    let outer = flat_spline(&[[foot, 0.0], [0.5 * (foot + full), 0.12 * h], [full, 0.4 * h], [r, 0.75 * h], [r, h]], 4);
    m.add(stuff, lathe(&hollow(&outer, 0.003, 0.005), 36).smooth());
    m.add(stuff, handle(r - 0.001, 0.28 * h, 0.82 * h, d.range(0.018, 0.028), 0.0032));
    if d.chance(0.5) {
        // Something to drink, just below the rim.
        let level = 0.85 * h;
        m.add(
            Stuff::Food,
            lathe(&[[0.0, level - 0.001], [r - 0.0032, level - 0.001], [r - 0.0032, level], [0.0, level]], 36),
        );
    }
    m.made()
}

fn jug(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.05, 0.075), d.range(0.15, 0.25));
    let neck = r * d.range(0.55, 0.8);
    let outer = flat_spline(
        &[
            [0.7 * r, 0.0],
            [0.9 * r, 0.1 * h],
            [r, 0.3 * h],
            [0.85 * r, 0.55 * h],
            [neck, 0.75 * h],
            [neck, 0.85 * h],
            [1.15 * neck, h],
        ],
        4,
    );
    let profile = hollow(&outer, 0.004, 0.008);
    let spout = d.range(0.2, 0.4);
    // The lip is drawn out towards -x.
    let body = lathe(&profile, 40).smooth().bent(|p| {
        let t = ((p[1] / h - 0.8) / 0.2).clamp(0.0, 1.2);
        let l = (p[0] * p[0] + p[2] * p[2]).sqrt().max(1e-9);
        let toward = (-p[0] / l).max(0.0);
        let k = 1.0 + spout * t * maths::pow(toward, 6.0);
        [p[0] * k, p[1] + 0.05 * h * t * maths::pow(toward, 6.0), p[2] * (1.0 - 0.1 * t * toward)]
    });
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Ceramic, Stuff::Clay, Stuff::Metal]);
    m.add(stuff, body);
    m.add(
        stuff,
        handle(0.9 * neck, 0.35 * h, 0.9 * h, r * 0.8, 0.005).bent(|p| {
            [
                p[0] + if p[1] < 0.6 * h {
                    (r * 0.93 - neck * 0.9) * (1.0 - p[1] / (0.6 * h)).max(0.0) * 2.2
                } else {
                    0.0
                },
                p[1],
                p[2],
            ]
        }),
    );
    m.made()
}

fn teapot(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.06, 0.085), d.range(0.09, 0.13));
    let stuff = *d.pick(&[Stuff::Ceramic, Stuff::Metal, Stuff::Clay]);
    let mut m = Maker::default();
    let outer = flat_spline(&[[0.6 * r, 0.0], [0.65 * r, 0.006], [r, 0.42 * h], [0.8 * r, 0.8 * h], [0.45 * r, h]], 5);
    m.add(stuff, lathe(&hollow(&outer, 0.004, 0.008), 40).smooth());
    let lid = flat_spline(
        &[
            [0.47 * r, h + 0.001],
            [0.35 * r, h + 0.012],
            [0.12 * r, h + 0.018],
            [0.09 * r, h + 0.024],
            [0.14 * r, h + 0.033],
            [0.05 * r, h + 0.04],
        ],
        3,
    );
    let profile: Vec<_> = [[0.0, h + 0.001]].into_iter().chain(lid).chain([[0.0, h + 0.04]]).collect();
    m.add(stuff, lathe(&profile, 28).smooth());
    let spout = spline(
        &[
            [-0.85 * r, 0.35 * h, 0.0],
            [-1.35 * r, 0.45 * h, 0.0],
            [-1.55 * r, 0.8 * h, 0.0],
            [-1.85 * r, 1.02 * h, 0.0],
        ],
        5,
    );
    m.add(stuff, tube(&spout, 12, |t| r * (0.25 - 0.14 * t)));
    m.add(stuff, handle(0.9 * r, 0.25 * h, 0.85 * h, 0.65 * r, 0.0042));
    m.made()
}

fn jar(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.035, 0.06), d.range(0.08, 0.2));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Glass, Stuff::Ceramic, Stuff::Glass]);
    let outer =
        flat_spline(&[[0.9 * r, 0.0], [r, 0.006], [r, 0.4 * h], [r, 0.78 * h], [0.85 * r, 0.9 * h], [0.85 * r, h]], 4);
    m.add(stuff, lathe(&hollow(&outer, 0.003, 0.006), 36).smooth());
    if stuff == Stuff::Glass {
        let fill = h * d.range(0.3, 0.7);
        let k = r - 0.0034;
        m.add(
            *d.pick(&[Stuff::Food, Stuff::Sand]),
            lathe(&[[0.0, 0.0065], [0.85 * k, 0.0065], [k, 0.012], [k, fill], [0.0, fill + 0.004]], 30),
        );
    }
    let lid = [[0.0, h + 0.0015], [0.9 * r, h + 0.0015], [0.9 * r, h + 0.018], [0.86 * r, h + 0.021], [0.0, h + 0.022]];
    m.add(*d.pick(&[Stuff::Metal, Stuff::Wood, Stuff::PaintedMetal]), lathe(&lid, 32));
    m.top([0.0, h + 0.0215, 0.0], [0.5 * r, 0.5 * r], f64::INFINITY);
    m.made()
}

fn can(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.026, 0.052), d.range(0.07, 0.15));
    let mut m = Maker::default();
    let lip = 0.003;
    m.add(
        Stuff::Metal,
        lathe(
            &[
                [0.0, 0.002],
                [r - 0.004, 0.002],
                [r - 0.003, 0.0],
                [r, 0.0],
                [r, 0.004],
                [r - 0.001, 0.005],
                [r - 0.001, h - 0.005],
                [r, h - 0.004],
                [r, h],
                [r - 0.003, h],
                [r - 0.004, h - lip],
                [0.0, h - lip],
            ],
            36,
        ),
    );
    m.add(
        Stuff::Print,
        lathe_loop(&[[r - 0.0009, 0.007], [r + 0.0002, 0.007], [r + 0.0002, h - 0.007], [r - 0.0009, h - 0.007]], 36),
    );
    m.made()
}
