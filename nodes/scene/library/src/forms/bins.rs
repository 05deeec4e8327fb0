//! Bins and buckets.

use super::{
    super::{noise::noise, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("waste_basket", Family::Bin, 6, waste),
    form("wheelie_bin", Family::Bin, 6, wheelie),
    form("street_bin", Family::Bin, 6, street),
    form("bucket", Family::Bin, 6, bucket),
];

fn waste(d: &mut Stream) -> FormVariant {
    let (r, h, flare) = (d.range(0.1, 0.15), d.range(0.24, 0.35), d.range(1.05, 1.4));
    let mut m = Maker::default();
    if d.chance(0.5) {
        let mut wires = Vec::new();
        for k in 0..40 {
            let a = TAU * f64::from(k) / 40.0;
            let b = a + 0.35;
            for (from, to) in [(a, b), (b, a)] {
                wires.push(
                    rod(
                        [r * maths::sin(from), 0.004, r * maths::cos(from)],
                        [r * flare * maths::sin(to), h, r * flare * maths::cos(to)],
                        0.0012,
                        4,
                    )
                    .smooth(),
                );
            }
        }
        m.add(Stuff::Metal, Body::all(wires));
        m.add(Stuff::Metal, tube_loop(&ring_path(r * flare, h, 40), 6, 0.004));
        m.add(Stuff::Metal, lathe(&[[0.0, 0.0], [r + 0.002, 0.0], [r + 0.002, 0.008], [0.0, 0.008]], 40));
    } else {
        let t = 0.003;
        m.add(
            *d.pick(&[Stuff::Plastic, Stuff::PaintedMetal]),
            lathe(
                &[
                    [0.0, 0.0],
                    [r, 0.0],
                    [r * flare, h],
                    [r * flare + 0.006, h],
                    [r * flare + 0.006, h + 0.006],
                    [r * flare - t, h + 0.006],
                    [r - t, t],
                    [0.0, t],
                ],
                40,
            ),
        );
    }
    let balls = d.below(4);
    for k in 0..balls {
        let a = 2.0 * k as f64;
        let seed = d.bits();
        let body = icosphere(2, |p| 0.035 * (0.8 + 0.4 * noise(seed, p.map(|v| 3.0 * v), [0; 3]).abs())).flat();
        m.add(Stuff::Paper, body.at([0.05 * maths::sin(a), 0.06 + 0.03 * k as f64, 0.05 * maths::cos(a)]));
    }
    m.made()
}

fn wheelie(d: &mut Stream) -> FormVariant {
    let (h, w) = (d.range(0.9, 1.05), d.range(0.24, 0.29));
    let mut m = Maker::default();
    let ring = |a: f64, z0: f64, z1: f64, y: f64| vec![[-a, y, z1], [a, y, z1], [a, y, z0], [-a, y, z0]];
    let rings = [
        ring(0.78 * w, -0.2, 0.2, 0.04),
        ring(w, -0.26, 0.3, 0.88 * h),
        ring(w + 0.015, -0.275, 0.315, 0.88 * h),
        ring(w + 0.015, -0.275, 0.315, 0.92 * h),
    ];
    m.add(Stuff::Plastic, skin(&rings, [true, false], [true, true]));
    let lid = slab(6, 6, 0.02, |s, t| {
        let (x, z) = ((w + 0.025) * (2.0 * s - 1.0), 0.33 - 0.61 * t);
        [x, 0.925 * h + 0.02 + 0.05 * maths::sin(0.5 * PI * t) + 0.02 * (1.0 - (2.0 * s - 1.0) * (2.0 * s - 1.0)), z]
    });
    m.another(Stuff::Plastic, lid);
    m.add(
        Stuff::Plastic,
        tube(
            &fillet(
                &[
                    [-0.8 * w, 0.88 * h, -0.26],
                    [-0.8 * w, 0.95 * h, -0.33],
                    [0.8 * w, 0.95 * h, -0.33],
                    [0.8 * w, 0.88 * h, -0.26],
                ],
                0.03,
                3,
            ),
            8,
            |_| 0.014,
        ),
    );
    for s in [-1.0, 1.0] {
        let wheel = lathe(&[[0.0, -0.02], [0.06, -0.025], [0.1, -0.025], [0.1, 0.025], [0.06, 0.025], [0.0, 0.02]], 24);
        m.add(Stuff::Rubber, wheel.turned_z(0.5 * PI).at([s * (0.8 * w + 0.035), 0.1, -0.2]));
    }
    m.made()
}

fn street(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.2, 0.26), d.range(0.75, 0.95));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Wood, Stuff::Metal]);
    m.add(
        Stuff::PaintedMetal,
        lathe(&[[0.0, 0.0], [r, 0.0], [r, 0.05], [r - 0.02, 0.06], [r - 0.02, h - 0.1], [0.0, h - 0.1]], 32),
    );
    let slats = 20;
    for k in 0..slats {
        let a = TAU * f64::from(k) / f64::from(slats);
        let slat = board([0.0, 0.5 * h, r], [PI * r / f64::from(slats) * 0.8, 0.5 * h - 0.07, 0.008]);
        m.add(stuff, slat.turned_y(a));
    }
    let top = h + d.range(0.0, 0.12);
    m.add(
        Stuff::PaintedMetal,
        lathe(&[[0.0, top], [r + 0.02, top], [r + 0.02, top + 0.02], [0.5 * r, top + 0.07], [0.0, top + 0.08]], 32),
    );
    for (x, z) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        m.add(
            Stuff::PaintedMetal,
            rod([x * (r - 0.03), h - 0.12, z * (r - 0.03)], [x * (r - 0.03), top + 0.005, z * (r - 0.03)], 0.01, 8),
        );
    }
    m.made()
}

fn bucket(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.085, 0.15), d.range(0.18, 0.34));
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Plastic, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    let k = r * d.range(1.12, 1.42);
    m.add(
        stuff,
        lathe(
            &[
                [0.0, 0.008],
                [r - 0.004, 0.008],
                [r - 0.004, 0.0],
                [r, 0.0],
                [k, h],
                [k + 0.006, h],
                [k + 0.006, h + 0.006],
                [k - 0.003, h + 0.006],
                [r - 0.003, 0.012],
                [0.0, 0.012],
            ],
            40,
        ),
    );
    let down = d.chance(0.5);
    let path: Vec<_> = (0..=20)
        .map(|j| PI * f64::from(j) / 20.0)
        .map(|a| {
            let (x, q) = ((k + 0.008) * maths::cos(a), 1.02 * k * maths::sin(a));
            if down { [x, h - 0.015 + 0.12 * q, 1.12 * q] } else { [x, h - 0.015 + q, 0.15 * q] }
        })
        .collect();
    m.add(Stuff::Metal, tube(&path, 6, |_| 0.0028));
    m.made()
}
