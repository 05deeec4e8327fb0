//! Bicycles and scooters.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::Vec3;
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] =
    &[form("bicycle", Family::Bicycle, 8, bicycle), form("scooter", Family::Bicycle, 6, scooter)];

fn spoked(r: f64, spokes: usize, tube_r: f64) -> (Body, Body) {
    let ring: Vec<Vec3> = circle(44, r).into_iter().map(|[x, y]| [x, y, 0.0]).collect();
    let tyre = tube_loop(&ring, 8, tube_r);
    let mut wires = vec![rod([0.0, 0.0, -0.03], [0.0, 0.0, 0.03], 0.018, 10)];
    for k in 0..spokes {
        let a = TAU * k as f64 / spokes as f64;
        let side = if k % 2 == 0 { 0.02 } else { -0.02 };
        wires.push(rod(
            [0.0, 0.0, side],
            [(r - 0.7 * tube_r) * maths::cos(a), (r - 0.7 * tube_r) * maths::sin(a), 0.0],
            0.0012,
            4,
        ));
    }
    let rim: Vec<Vec3> = circle(44, r - 0.9 * tube_r).into_iter().map(|[x, y]| [x, y, 0.0]).collect();
    wires.push(tube_loop(&rim, 6, 0.45 * tube_r));
    (tyre, Body::all(wires))
}

/// It stands along x, on its wheels.
fn bicycle(d: &mut Stream) -> FormVariant {
    let r = d.range(0.31, 0.34);
    let base = d.range(0.98, 1.06);
    let low = d.chance(0.3);
    let paint = *d.pick(&[Stuff::PaintedMetal, Stuff::PaintedMetal, Stuff::Metal]);
    let mut m = Maker::default();
    let rear: Vec3 = [-0.43 * base, r, 0.0];
    let front: Vec3 = [0.57 * base, r, 0.0];
    for hub in [rear, front] {
        let (tyre, wires) = spoked(r - 0.018, 28, 0.018);
        m.add(Stuff::Rubber, tyre.at(hub));
        m.add(Stuff::Metal, wires.at(hub));
    }
    let crank: Vec3 = [0.0, 0.28, 0.0];
    let seat: Vec3 = [-0.17, 0.28 + d.range(0.5, 0.58), 0.0];
    let head: Vec3 = [0.57 * base - 0.16, r + 0.52, 0.0];
    let head_low: Vec3 = [head[0] + 0.04, head[1] - 0.13, 0.0];
    let along = |a: Vec3, b: Vec3, t: f64| [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t);
    let tubes = [
        (crank, seat, 0.016),
        (crank, head_low, 0.02),
        (along(crank, seat, if low { 0.5 } else { 0.93 }), if low { along(head, head_low, 0.7) } else { head }, 0.016),
        (head, head_low, 0.02),
    ];
    for (a, b, k) in tubes {
        m.add(paint, rod(a, b, k, 12));
    }
    for s in [-1.0, 1.0] {
        let z = 0.05 * s;
        m.add(paint, tube(&[crank, [rear[0], rear[1], z]], 8, |t| 0.011 - 0.003 * t));
        m.add(paint, tube(&[along(crank, seat, 0.9), [rear[0], rear[1], z]], 8, |t| 0.01 - 0.003 * t));
        m.add(
            paint,
            tube(&[[head_low[0] + 0.005, head_low[1] - 0.02, 0.6 * z], [front[0], front[1], z]], 8, |t| {
                0.013 - 0.004 * t
            }),
        );
        // Crank and pedal.
        let turn = 0.6 + if s > 0.0 { 0.0 } else { PI };
        let end = [crank[0] + 0.17 * maths::cos(turn), crank[1] + 0.17 * maths::sin(turn) * 0.9, 0.075 * s];
        m.add(Stuff::Metal, rod([crank[0], crank[1], 0.06 * s], end, 0.008, 8));
        m.add(Stuff::Plastic, board([end[0], end[1], end[2] + 0.055 * s], [0.045, 0.012, 0.045]));
    }
    m.add(Stuff::Metal, rod([0.0, 0.28, -0.07], [0.0, 0.28, 0.07], 0.02, 12));
    m.add(Stuff::Metal, extrude_with_holes(&circle(36, 0.095), &[circle(24, 0.07)], 0.004).at([0.0, 0.28, 0.045]));
    m.add(Stuff::Metal, extrude(&circle(20, 0.04), 0.01).at([rear[0], rear[1], 0.045]));
    for (a, b) in [(0.095, 0.04), (-0.095, -0.04)] {
        m.add(
            Stuff::Metal,
            beam([0.0, 0.28 + a, 0.045], [rear[0], rear[1] + b, 0.045], [0.006, 0.006], [0.0, 1.0, 0.0]),
        );
    }
    let top = along(crank, seat, 1.18);
    m.add(Stuff::Metal, rod(along(crank, seat, 0.95), top, 0.012, 10));
    let saddle = slab(8, 8, 0.03, |s, t| {
        let (x, z) = (2.0 * s - 1.0, 1.0 - 2.0 * t);
        let w = 0.075 * (0.3 + 0.7 * maths::pow(0.5 - 0.5 * x, 1.3));
        [top[0] + 0.13 * x, top[1] + 0.035 - 0.012 * x * x - 0.02 * z * z, w * z]
    });
    m.add(Stuff::Leather, saddle);
    let bar = [head[0] - 0.035, head[1] + 0.1, 0.0];
    m.add(Stuff::Metal, rod(head, bar, 0.012, 10));
    let drop = d.chance(0.4);
    for s in [-1.0, 1.0] {
        let path = if drop {
            spline(
                &[
                    [bar[0], bar[1], 0.0],
                    [bar[0] + 0.01, bar[1], 0.19 * s],
                    [bar[0] + 0.1, bar[1] - 0.02, 0.21 * s],
                    [bar[0] + 0.09, bar[1] - 0.12, 0.21 * s],
                    [bar[0] + 0.0, bar[1] - 0.13, 0.21 * s],
                ],
                5,
            )
        } else {
            spline(
                &[
                    [bar[0], bar[1], 0.0],
                    [bar[0] + 0.02, bar[1] + 0.02, 0.15 * s],
                    [bar[0] - 0.05, bar[1] + 0.05, 0.28 * s],
                    [bar[0] - 0.14, bar[1] + 0.05, 0.3 * s],
                ],
                5,
            )
        };
        m.add(Stuff::Metal, tube(&path, 10, |_| 0.012));
        let end = path[path.len() - 1];
        let before = path[path.len() - 6];
        m.add(Stuff::Rubber, rod(before, end, 0.016, 10));
    }
    m.made()
}

fn scooter(d: &mut Stream) -> FormVariant {
    let (l, h, r) = (d.range(0.32, 0.4), d.range(0.7, 1.0), d.range(0.06, 0.11));
    let mut m = Maker::default();
    for x in [-l - 0.08, l + 0.12] {
        let wheel =
            lathe(&[[0.0, -0.012], [0.8 * r, -0.014], [r, -0.008], [r, 0.008], [0.8 * r, 0.014], [0.0, 0.012]], 28);
        m.add(Stuff::Rubber, wheel.turned_x(0.5 * PI).at([x, r, 0.0]));
        m.add(Stuff::Metal, rod([x, r, -0.03], [x, r, 0.03], 0.008, 8));
        for s in [-1.0, 1.0] {
            m.add(
                Stuff::Metal,
                board([x + if x < 0.0 { 0.05 } else { -0.02 }, r + 0.01, 0.024 * s], [0.07, 0.012, 0.003]),
            );
        }
    }
    m.add(*d.pick(&[Stuff::PaintedMetal, Stuff::Wood]), soft_block([0.0, 0.9 * r, 0.0], [l, 0.012, 0.06], 0.008, 2));
    let neck = [l + 0.07, r + 0.05, 0.0];
    let top = [l - 0.02, h, 0.0];
    m.add(Stuff::PaintedMetal, rod([l - 0.03, 0.9 * r, 0.0], neck, 0.016, 10));
    m.add(Stuff::Metal, rod([l + 0.1, r + 0.02, 0.0], top, 0.014, 12));
    m.add(Stuff::Metal, rod([top[0], h, -0.2], [top[0], h, 0.2], 0.011, 10));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Rubber, rod([top[0], h, 0.1 * s], [top[0], h, 0.21 * s], 0.016, 10));
    }
    m.made()
}
