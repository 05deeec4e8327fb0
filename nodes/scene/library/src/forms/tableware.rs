//! Plates, cutlery, pans.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::{Maker, one},
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("plate", Family::Plate, 8, plate),
    form("plate_soup", Family::Plate, 6, soup),
    form("tray", Family::Plate, 6, tray),
    form("fork", Family::Utensil, 6, fork),
    form("knife", Family::Utensil, 6, knife),
    form("spoon", Family::Utensil, 6, spoon),
    form("pan_frying", Family::Utensil, 6, pan),
    form("pot_cooking", Family::Utensil, 6, pot),
    form("chopping_board", Family::Utensil, 6, chopping),
    form("whisk", Family::Utensil, 4, whisk),
];

fn plate(d: &mut Stream) -> FormVariant {
    let (r, rim) = (d.range(0.08, 0.14), d.range(0.012, 0.025));
    let foot = r * d.range(0.55, 0.7);
    let mut m = Maker::default();
    let profile = [
        [0.0, 0.002],
        [foot - 0.004, 0.002],
        [foot - 0.003, 0.0],
        [foot, 0.0],
        [0.8 * r, 0.45 * rim],
        [r, rim],
        [r, rim + 0.002],
        [0.78 * r, 0.45 * rim + 0.003],
        [0.68 * r, 0.006],
        [0.0, 0.0055],
    ];
    m.add(*d.pick(&[Stuff::Ceramic, Stuff::Ceramic, Stuff::Metal]), lathe(&profile, 48).soft());
    m.top([0.0, 0.0057, 0.0], [0.45 * r, 0.45 * r], f64::INFINITY);
    m.made()
}

fn soup(d: &mut Stream) -> FormVariant {
    let (r, deep) = (d.range(0.1, 0.125), d.range(0.03, 0.045));
    let well = r * d.range(0.66, 0.75);
    let outer = flat_spline(
        &[[0.5 * well, 0.0], [0.55 * well, 0.002], [0.95 * well, 0.6 * deep], [1.05 * well, 0.85 * deep], [r, deep]],
        4,
    );
    let inner = flat_spline(
        &[
            [r, deep + 0.002],
            [1.03 * well, 0.85 * deep + 0.003],
            [0.91 * well, 0.6 * deep],
            [0.5 * well, 0.006],
            [0.0, 0.005],
        ],
        4,
    );
    let profile: Vec<_> = [[0.0, 0.0]].into_iter().chain(outer).chain(inner).collect();
    one(Stuff::Ceramic, lathe(&profile, 48).smooth())
}

fn tray(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.17, 0.25), d.range(0.12, 0.18)];
    let rim = d.range(0.02, 0.045);
    let r = d.range(0.02, 0.09);
    let ring = |k: f64, y: f64| {
        rounded_rect([half[0] + k, half[1] + k], r + k * 0.5, 6)
            .into_iter()
            .rev()
            .map(|[x, z]| [x, y, z])
            .collect::<Vec<_>>()
    };
    let t = 0.005;
    let lean = d.range(0.0, 0.02);
    let rings = [ring(0.0, 0.0), ring(lean, rim), ring(lean - t, rim), ring(-t, t)];
    let mut m = Maker::default();
    m.add(*d.pick(&[Stuff::Wood, Stuff::Metal, Stuff::Plastic]), skin(&rings, [true, false], [true, true]));
    m.top([0.0, t, 0.0], [half[0] - 0.5 * r - t, half[1] - 0.5 * r - t], f64::INFINITY);
    m.made()
}

/// A flat handle that lies along x from 0 to `l`.
fn grip(l: f64, w: f64, arch: f64) -> Body {
    slab(14, 3, 0.0025, |s, t| {
        let k = w * (0.45 + 0.55 * maths::pow(s, 1.5)) * if s > 0.95 { 0.8 } else { 1.0 };
        [l * s, 0.004 + arch * maths::sin(PI * s), -k * (2.0 * t - 1.0)]
    })
}

fn fork(d: &mut Stream) -> FormVariant {
    let (l, w, tines) = (d.range(0.11, 0.13), d.range(0.007, 0.01), 3 + d.below(2));
    let mut m = Maker::default();
    m.add(Stuff::Metal, grip(l, w, 0.006));
    let head = d.range(0.011, 0.014);
    m.add(
        Stuff::Metal,
        slab(5, 4, 0.002, |s, t| {
            let k = head * (0.35 + 0.65 * maths::sin(0.5 * PI * s));
            [-0.022 * s + 0.001, 0.004 - 0.003 * s, k * (2.0 * t - 1.0)]
        }),
    );
    for k in 0..tines {
        let z = head * 0.86 * (2.0 * k as f64 / (tines - 1) as f64 - 1.0);
        let path = spline(&[[-0.019, 0.0003, z], [-0.035, 0.0002, z], [-0.05, 0.004, z], [-0.06, 0.009, z]], 3);
        m.add(
            Stuff::Metal,
            sweep(
                &path,
                &[[0.0008, -0.0014], [0.0008, 0.0014], [-0.0008, 0.0014], [-0.0008, -0.0014]],
                [0.0, 1.0, 0.0],
                |t| 1.0 - 0.5 * t,
            ),
        );
    }
    m.made()
}

fn knife(d: &mut Stream) -> FormVariant {
    let (l, blade_l, h) = (d.range(0.09, 0.12), d.range(0.1, 0.2), d.range(0.009, 0.02));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Metal, Stuff::Plastic]);
    m.add(stuff, soft_block([0.5 * l, 0.007, 0.0], [0.5 * l, 0.007, 0.009], 0.006, 2));
    // Lying on its side: the blade is a wedge in the plane y = const, its edge towards +z.
    let outline: Vec<[f64; 2]> = (0..=12)
        .map(|k| {
            let t = f64::from(k) / 12.0;
            [-blade_l * t, h * maths::pow(1.0 - t, 0.35)]
        })
        .chain([[0.0, -0.4 * h]])
        .collect();
    let outline: Vec<[f64; 2]> = outline.into_iter().chain([[0.003, -0.4 * h], [0.003, 0.5 * h]]).collect();
    m.add(Stuff::Metal, extrude(&outline, 0.0016).turned_x(0.5 * PI).at([0.0, 0.007, 0.0]));
    m.made()
}

fn spoon(d: &mut Stream) -> FormVariant {
    let (l, w, bowl) = (d.range(0.09, 0.14), d.range(0.006, 0.009), d.range(0.012, 0.021));
    let long = 1.5 * bowl;
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Metal, Stuff::Wood]);
    m.add(stuff, grip(l, w, 0.006));
    let deep = 0.45 * bowl;
    m.add(
        stuff,
        skin(
            &(0..=8)
                .map(|j| {
                    // Over the inside of the bowl and back under it.
                    let t = f64::from(j) / 8.0;
                    let (k, low) = if t < 0.5 { (2.0 * t, 0.0012) } else { (2.0 - 2.0 * t, 0.0) };
                    circle(24, k.max(0.0))
                        .into_iter()
                        .map(|[c, s]| [-long + long * c * 1.02, 0.0015 + deep * k * k + low, bowl * s])
                        .collect()
                })
                .collect::<Vec<_>>(),
            [true, false],
            [false; 2],
        )
        .smooth(),
    );
    m.made()
}

fn pan(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.1, 0.15), d.range(0.035, 0.06));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.0],
                [0.82 * r, 0.0],
                [0.88 * r, 0.004],
                [r, h],
                [r - 0.003, h + 0.001],
                [0.86 * r, 0.007],
                [0.8 * r, 0.004],
                [0.0, 0.004],
            ],
            48,
        ),
    );
    m.top([0.0, 0.004, 0.0], [0.5 * r, 0.5 * r], f64::INFINITY);
    let l = d.range(0.15, 0.2);
    let path = spline(
        &[[0.95 * r, 0.75 * h, 0.0], [r + 0.03, h, 0.0], [r + 0.5 * l, h + 0.02, 0.0], [r + l, h + 0.025, 0.0]],
        4,
    );
    m.add(
        *d.pick(&[Stuff::Wood, Stuff::Plastic, Stuff::Metal]),
        sweep(&path, &rounded_rect([0.006, 0.011], 0.005, 2), [0.0, 1.0, 0.0], |t| 0.75 + 0.25 * t),
    );
    m.made()
}

fn pot(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.08, 0.13), d.range(0.08, 0.18));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.0],
                [r - 0.006, 0.0],
                [r, 0.006],
                [r, h],
                [r + 0.003, h + 0.002],
                [r - 0.003, h + 0.002],
                [r - 0.003, 0.005],
                [0.0, 0.005],
            ],
            48,
        ),
    );
    for s in [-1.0, 1.0] {
        let y = 0.8 * h;
        let path = spline(
            &[
                [s * (r - 0.001), y, -0.035],
                [s * (r + 0.025), y, -0.025],
                [s * (r + 0.025), y, 0.025],
                [s * (r - 0.001), y, 0.035],
            ],
            4,
        );
        m.add(stuff, tube(&path, 8, |_| 0.005));
    }
    if d.chance(0.6) {
        let y = h + 0.0025;
        m.add(
            stuff,
            lathe(
                &[
                    [0.0, y],
                    [r + 0.001, y],
                    [r + 0.001, y + 0.003],
                    [0.6 * r, y + 0.016],
                    [0.02, y + 0.022],
                    [0.008, y + 0.026],
                    [0.016, y + 0.04],
                    [0.0, y + 0.043],
                ],
                40,
            )
            .soft(),
        );
    }
    m.made()
}

fn chopping(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.12, 0.2), d.range(0.09, 0.13)];
    let t = d.range(0.012, 0.03);
    let mut m = Maker::default();
    let hole: Vec<_> = circle(16, 0.012).into_iter().map(|[x, y]| [x + half[0] - 0.03, y]).collect();
    m.add(
        Stuff::Wood,
        extrude_with_holes(&rounded_rect(half, 0.02, 4), &[hole], t).turned_x(-0.5 * PI).at([0.0, 0.5 * t, 0.0]),
    );
    m.top([-0.025, t, 0.0], [half[0] - 0.05, half[1] - 0.02], f64::INFINITY);
    m.made()
}

fn whisk(d: &mut Stream) -> FormVariant {
    let (l, head, w) = (d.range(0.1, 0.13), d.range(0.12, 0.16), d.range(0.025, 0.035));
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Metal, Stuff::Wood]),
        tube(&[[0.0, w, 0.0], [0.5 * l, w, 0.0], [l, w, 0.0]], 12, |t| 0.007 + 0.002 * maths::sin(PI * t)),
    );
    for k in 0..5 {
        let a = PI * f64::from(k) / 5.0;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let path: Vec<_> = (0..=20)
            .map(|j| {
                let b = TAU * f64::from(j) / 20.0;
                let (x, y) =
                    (0.5 * (1.0 - maths::cos(b)), maths::sin(b) * maths::pow(0.5 * (1.0 - maths::cos(b)), 0.7));
                [0.004 - head * x, w + w * y * c, w * y * s]
            })
            .collect();
        m.add(Stuff::Metal, tube(&path, 5, |_| 0.0009));
    }
    m.made()
}
