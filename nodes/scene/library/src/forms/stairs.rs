//! Stairs and ladders.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("stairs_solid", Family::Stair, 8, stairs),
    form("stairs_open", Family::Stair, 6, stairs_open),
    form("stairs_spiral", Family::Stair, 6, spiral),
    form("stepladder", Family::Stair, 6, stepladder),
];

fn stairs(d: &mut Stream) -> FormVariant {
    let (count, rise, going, half) = (3 + d.below(8), d.range(0.15, 0.19), d.range(0.25, 0.32), d.range(0.4, 0.8));
    let stuff = *d.pick(&[Stuff::Stone, Stuff::Concrete, Stuff::Wood, Stuff::Brick]);
    let mut m = Maker::default();
    let nose = d.range(0.0, 0.025);
    for k in 0..count {
        let (y, z) = (rise * k as f64, -going * k as f64);
        m.add(stuff, board([0.0, 0.5 * (y + rise - 0.03), z], [half, 0.5 * (y + rise - 0.03), 0.5 * going]));
        m.add(stuff, board([0.0, y + rise - 0.015, z + 0.5 * nose], [half + 0.4 * nose, 0.015, 0.5 * (going + nose)]));
        m.top([0.0, y + rise, z + 0.02], [half - 0.02, 0.5 * going - 0.04], f64::INFINITY);
    }
    m.made()
}

fn stairs_open(d: &mut Stream) -> FormVariant {
    let (count, rise, going, half) = (6 + d.below(8), d.range(0.17, 0.2), d.range(0.22, 0.27), d.range(0.35, 0.5));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    let end = [rise * count as f64, -going * count as f64];
    for s in [-1.0, 1.0] {
        m.add(
            stuff,
            beam(
                [s * (half + 0.02), 0.05, 0.3 * going],
                [s * (half + 0.02), end[0], end[1] + going * 0.55],
                [0.22, 0.04],
                [0.0, 1.0, 0.0],
            ),
        );
        // A handrail on posts.
        m.add(
            Stuff::Metal,
            rod(
                [s * (half + 0.02), 0.95, 0.3 * going],
                [s * (half + 0.02), end[0] + 0.9, end[1] + 0.55 * going],
                0.02,
                10,
            ),
        );
        for k in 0..count {
            if k % 3 == 0 || k + 1 == count {
                let (y, z) = (rise * k as f64 + 0.08, -going * (k as f64 - 0.1));
                m.add(Stuff::Metal, rod([s * (half + 0.02), y, z], [s * (half + 0.02), y + 0.96, z], 0.01, 8));
            }
        }
    }
    for k in 0..count {
        let (y, z) = (rise * (k as f64 + 1.0), -going * k as f64);
        m.add(Stuff::Wood, board([0.0, y - 0.018, z], [half, 0.018, 0.5 * going + 0.015]));
        m.top([0.0, y, z + 0.04], [half - 0.02, 0.5 * going - 0.05], 1.0);
    }
    m.made()
}

fn spiral(d: &mut Stream) -> FormVariant {
    let (count, r, rise) = (10 + d.below(8), d.range(0.6, 0.9), d.range(0.17, 0.2));
    let step = d.range(0.38, 0.5);
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Wood, Stuff::Metal]);
    let mut m = Maker::default();
    let h = rise * count as f64;
    m.add(Stuff::PaintedMetal, rod([0.0, 0.0, 0.0], [0.0, h + 0.95, 0.0], 0.05, 20));
    let mut rail = Vec::new();
    for k in 0..count {
        let a = step * k as f64;
        let far = arc([0.0, 0.0], r, -0.55 * step, 0.55 * step, 6);
        let tread: Vec<[f64; 2]> = [[0.045, -0.03]].into_iter().chain(far).chain([[0.045, 0.03]]).collect();
        let y = rise * (k as f64 + 1.0);
        m.add(stuff, extrude(&tread, 0.035).turned_x(-0.5 * PI).turned_y(-a).at([0.0, y - 0.0175, 0.0]));
        let edge = [(r - 0.03) * maths::cos(a), y, (r - 0.03) * maths::sin(a)];
        m.add(Stuff::Metal, rod([edge[0], y - 0.01, edge[2]], [edge[0], y + 0.9, edge[2]], 0.008, 8));
        rail.push([edge[0], y + 0.9, edge[2]]);
    }
    m.add(Stuff::Metal, tube(&spline(&rail, 3), 10, |_| 0.018));
    m.made()
}

fn stepladder(d: &mut Stream) -> FormVariant {
    let (count, w) = (3 + d.below(5), d.range(0.18, 0.24));
    let h = 0.25 * count as f64;
    let (front, back) = (0.25 * h, 0.35 * h);
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Wood, Stuff::PaintedMetal]);
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        m.add(stuff, beam([s * (w + 0.05), 0.0, front], [s * w, h, 0.0], [0.05, 0.02], [0.0, 0.0, 1.0]));
        m.add(stuff, beam([s * (w + 0.04), 0.0, -back], [s * (w - 0.02), h, -0.03], [0.03, 0.02], [0.0, 0.0, 1.0]));
        m.add(
            Stuff::Metal,
            beam([s * w, 0.55 * h, 0.45 * front], [s * w, 0.55 * h, -0.45 * back], [0.014, 0.004], [0.0, 1.0, 0.0]),
        );
    }
    for k in 1..=count {
        let t = k as f64 / count as f64;
        let y = h * t;
        let z = front * (1.0 - t);
        let wide = w + 0.05 * (1.0 - t) - 0.011;
        m.add(stuff, board([0.0, y - 0.02, z + 0.01], [wide, 0.012, 0.04]));
    }
    m.add(stuff, board([0.0, h + 0.01, -0.02], [w + 0.03, 0.012, 0.09]));
    m.top([0.0, h + 0.022, -0.02], [w, 0.07], f64::INFINITY);
    for y in [0.25, 0.6] {
        let z = -back + (back - 0.03) * y;
        m.add(stuff, rod([-w - 0.02, y * h, z], [w + 0.02, y * h, z], 0.009, 8));
    }
    m.made()
}
