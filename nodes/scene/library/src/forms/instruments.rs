//! Musical instruments.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::Vec3;
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("guitar", Family::Instrument, 8, guitar),
    form("drum", Family::Instrument, 6, drum),
    form("piano", Family::Instrument, 6, piano),
    form("xylophone", Family::Instrument, 6, xylophone),
    form("trumpet", Family::Instrument, 6, trumpet),
];

fn guitar(d: &mut Stream) -> FormVariant {
    let (l, w) = (d.range(0.42, 0.5), d.range(0.17, 0.2));
    let deep = d.range(0.04, 0.11);
    let waist = d.range(0.55, 0.75);
    let shape = closed_spline(
        &[
            [0.0, 0.0],
            [0.7 * w, 0.02 * l],
            [w, 0.25 * l],
            [0.85 * w, 0.42 * l],
            [waist * w, 0.58 * l],
            [0.72 * w, 0.82 * l],
            [0.45 * w, 0.98 * l],
            [0.0, l],
            [-0.45 * w, 0.98 * l],
            [-0.72 * w, 0.82 * l],
            [-waist * w, 0.58 * l],
            [-0.85 * w, 0.42 * l],
            [-w, 0.25 * l],
            [-0.7 * w, 0.02 * l],
        ],
        4,
    );
    let acoustic = deep > 0.06;
    let mut m = Maker::default();
    let hole: Vec<[f64; 2]> = circle(28, 0.05).into_iter().map(|[x, y]| [x, y + 0.66 * l]).collect();
    if acoustic {
        m.add(Stuff::Wood, extrude(&shape, deep - 0.004).at([0.0, 0.0, -0.002]));
        m.another(Stuff::Wood, extrude_with_holes(&shape, &[hole], 0.004).at([0.0, 0.0, 0.5 * deep - 0.002]));
    } else {
        m.add(*d.pick(&[Stuff::PaintedMetal, Stuff::Wood]), extrude(&shape, deep).soft());
        for y in [0.5, 0.68] {
            m.add(Stuff::Plastic, board([0.0, y * l, 0.5 * deep + 0.004], [0.04, 0.012, 0.004]));
        }
    }
    let neck = 0.36;
    let z = 0.5 * deep + 0.004;
    m.add(Stuff::Wood, beam([0.0, 0.8 * l, z + 0.002], [0.0, l + neck, z + 0.002], [0.012, 0.05], [0.0, 0.0, 1.0]));
    m.add(Stuff::Wood, beam([0.0, l - 0.02, z - 0.015], [0.0, l + neck, z - 0.01], [0.022, 0.04], [0.0, 0.0, 1.0]));
    m.add(Stuff::Wood, board([0.0, l + neck + 0.075, z - 0.006], [0.035, 0.08, 0.008]));
    m.add(Stuff::Wood, board([0.0, 0.28 * l, z + 0.001], [0.07, 0.012, 0.005]));
    for k in 0..6 {
        let x = 0.018 * (f64::from(k) / 2.5 - 1.0);
        m.add(Stuff::Metal, rod([1.4 * x, 0.28 * l, z + 0.011], [x, l + neck + 0.01, z + 0.011], 0.0006, 4));
        let (side, y) = (if k < 3 { -1.0 } else { 1.0 }, l + neck + 0.03 + 0.045 * f64::from(k % 3));
        m.add(Stuff::Metal, rod([side * 0.03, y, z - 0.006], [side * 0.055, y, z - 0.006], 0.004, 8));
    }
    for k in 1..16 {
        let y = 0.28 * l + (l + neck - 0.28 * l) * maths::exp2(-f64::from(k) / 12.0);
        if y > 0.82 * l {
            m.add(Stuff::Metal, block([0.0, y, z + 0.0085], [0.0245, 0.001, 0.001]));
        }
    }
    m.made()
}

fn drum(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.13, 0.25), d.range(0.12, 0.4));
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Wood, Stuff::PaintedMetal, Stuff::Metal]),
        lathe_loop(&[[r - 0.006, 0.01], [r, 0.01], [r, h - 0.01], [r - 0.006, h - 0.01]], 48),
    );
    for y in [0.004, h - 0.012] {
        m.add(
            Stuff::Metal,
            lathe_loop(&[[r - 0.002, y], [r + 0.012, y], [r + 0.012, y + 0.016], [r - 0.002, y + 0.016]], 48),
        );
    }
    m.add(Stuff::Paper, extrude(&circle(44, r - 0.003), 0.002).turned_x(-0.5 * PI).at([0.0, h - 0.003, 0.0]));
    m.top([0.0, h - 0.002, 0.0], [0.6 * r, 0.6 * r], f64::INFINITY);
    let lugs = 6 + 2 * d.below(3);
    for k in 0..lugs {
        let a = TAU * k as f64 / lugs as f64;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let q = r + 0.016;
        m.add(Stuff::Metal, rod([q * s, 0.0, q * c], [q * s, h + 0.006, q * c], 0.003, 6));
        m.add(Stuff::Metal, soft_block([0.0, 0.5 * h, r + 0.008], [0.008, 0.035, 0.009], 0.004, 2).turned_y(a));
    }
    m.made()
}

fn piano(d: &mut Stream) -> FormVariant {
    let (half, h, deep) = (0.74, d.range(1.1, 1.25), d.range(0.15, 0.18));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Plastic]);
    let mut m = Maker::default();
    m.add(stuff, board([0.0, 0.5 * h, -0.12], [half - 0.03, 0.5 * h - 0.03, deep]));
    m.add(stuff, board([0.0, h - 0.012, -0.115], [half + 0.01, 0.014, deep + 0.02]));
    m.top([0.0, h + 0.002, -0.115], [half - 0.02, deep], f64::INFINITY);
    for s in [-1.0, 1.0] {
        m.add(stuff, board([s * (half - 0.015), 0.5 * (h - 0.03), -0.12], [0.015, 0.5 * (h - 0.03), deep + 0.01]));
        m.add(stuff, board([s * (half - 0.03), 0.66, 0.18], [0.03, 0.06, 0.14]));
        m.add(stuff, tube(&[[s * (half - 0.05), 0.0, 0.26], [s * (half - 0.05), 0.6, 0.26]], 12, |t| 0.022 + 0.01 * t));
    }
    m.add(stuff, board([0.0, 0.6, 0.17], [half - 0.06, 0.03, 0.15]));
    let keys = 52;
    let w = (half - 0.065) / f64::from(keys);
    let white = Body::all(
        (0..keys)
            .map(|k| block([(2.0 * f64::from(k) + 1.0 - f64::from(keys)) * w, 0.642, 0.23], [w * 0.94, 0.011, 0.075])),
    );
    m.add(Stuff::Wax, white);
    let black = Body::all(
        (0..keys - 1)
            .filter(|k| ![2, 6].contains(&(k % 7)))
            .map(|k| block([(2.0 * f64::from(k) + 2.0 - f64::from(keys)) * w, 0.659, 0.205], [w * 0.5, 0.007, 0.05])),
    );
    m.another(Stuff::Plastic, black);
    m.add(stuff, board([0.0, 0.78, 0.055], [half - 0.1, 0.1, 0.008]));
    for x in [-0.05, 0.0, 0.05] {
        m.add(Stuff::Metal, board([x, 0.05, 0.1], [0.012, 0.005, 0.06]));
    }
    m.made()
}

fn xylophone(d: &mut Stream) -> FormVariant {
    let bars = 8 + d.below(8);
    let w = 0.013;
    let mut m = Maker::default();
    let half = 0.016 * bars as f64;
    for s in [-1.0, 1.0] {
        m.add(
            Stuff::Wood,
            beam([-half - 0.02, 0.012, s * 0.065], [half + 0.02, 0.012, s * 0.035], [0.024, 0.02], [0.0, 1.0, 0.0]),
        );
    }
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Wood, Stuff::PaintedMetal]);
    for k in 0..bars {
        let x = 0.032 * (k as f64 + 0.5) - half;
        let l = 0.13 - 0.07 * k as f64 / bars as f64;
        m.another(stuff, board([x, 0.0275, 0.0], [w, 0.003, l]));
    }
    let turn = d.range(-0.5, 0.5);
    let stick = |b: Body| b.turned_y(turn).at([0.0, 0.0, 0.19]);
    m.add(Stuff::Wood, stick(rod([-0.12, 0.012, 0.0], [0.1, 0.012, 0.0], 0.0035, 8)));
    m.add(Stuff::Rubber, stick(ball(0.012, 14).at([0.1, 0.012, 0.0])));
    m.made()
}

fn trumpet(d: &mut Stream) -> FormVariant {
    let l = d.range(0.44, 0.5);
    let mut m = Maker::default();
    let y = 0.065;
    let bell = flat_spline(&[[0.006, 0.0], [0.0065, 0.4 * l], [0.011, 0.75 * l], [0.022, 0.92 * l], [0.06, l]], 5);
    let back = bell.iter().rev().map(|p| [p[0] - 0.0015, p[1] + 0.0004]).collect::<Vec<_>>();
    let profile: Vec<_> = bell.into_iter().chain(back).collect();
    m.add(Stuff::Metal, lathe_loop(&profile, 32).smooth().turned_z(-0.5 * PI).at([-0.4 * l, y, 0.0]));
    let q = 0.045;
    let path: Vec<Vec3> = [[-0.4 * l, y, 0.0]]
        .into_iter()
        .chain(arc([-0.4 * l, y - q], q, 0.5 * PI, 1.5 * PI, 10).into_iter().skip(1).map(|[a, b]| [a, b, 0.0]))
        .chain([[0.2 * l, y - 2.0 * q, 0.0]])
        .collect();
    m.add(Stuff::Metal, tube(&path, 10, |_| 0.006));
    let lead: Vec<Vec3> = [[-0.75 * l, y, 0.025], [0.25 * l, y, 0.025]]
        .into_iter()
        .chain(arc([0.25 * l, y - q], q, 0.5 * PI, -0.5 * PI, 10).into_iter().skip(1).map(|[a, b]| [a, b, 0.025]))
        .chain([[0.0, y - 2.0 * q, 0.025]])
        .collect();
    m.add(Stuff::Metal, tube(&lead, 10, |_| 0.006));
    m.add(
        Stuff::Metal,
        lathe(&[[0.0, 0.0], [0.013, 0.0], [0.011, 0.012], [0.005, 0.03], [0.004, 0.08], [0.0, 0.08]], 16)
            .turned_z(-0.5 * PI)
            .at([-0.75 * l - 0.05, y, 0.025]),
    );
    for k in 0..3 {
        let x = -0.12 + 0.035 * f64::from(k);
        m.add(Stuff::Metal, rod([x, y - 2.0 * q - 0.02, 0.012], [x, y + 0.02, 0.012], 0.0115, 14));
        m.add(Stuff::Metal, rod([x, y + 0.02, 0.012], [x, y + 0.045 - 0.012 * f64::from(k % 2), 0.012], 0.003, 6));
        m.add(
            Stuff::Metal,
            rod(
                [x, y + 0.044 - 0.012 * f64::from(k % 2), 0.012],
                [x, y + 0.048 - 0.012 * f64::from(k % 2), 0.012],
                0.008,
                12,
            ),
        );
    }
    m.made()
}
