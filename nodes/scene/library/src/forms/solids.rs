//! Simple solids, gems, crystals.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant,
    maker::one,
    solid,
};
use tauflow_data::geom::{Vec3, mul, unit};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    solid("sphere", Family::Solid, 3, sphere),
    solid("block_rounded", Family::Solid, 12, rounded),
    solid("torus", Family::Solid, 10, torus),
    solid("knot", Family::Solid, 10, knot),
    solid("superellipsoid", Family::Solid, 12, superellipsoid),
    solid("gem", Family::Solid, 10, gem),
    solid("crystal", Family::Solid, 10, crystal),
    solid("star_prism", Family::Solid, 8, star),
    solid("capsule", Family::Solid, 6, pill),
    solid("cone", Family::Solid, 8, cone),
    solid("polyhedron", Family::Solid, 5, polyhedron),
    solid("prism_glass", Family::Solid, 5, glass_prism),
    solid("drop", Family::Solid, 6, drop),
];

fn solid_stuff(d: &mut Stream) -> Stuff {
    *d.pick(&[Stuff::Glass, Stuff::Ceramic, Stuff::Metal, Stuff::Stone, Stuff::Plastic, Stuff::Wood])
}

fn sphere(d: &mut Stream) -> FormVariant {
    let r = d.range(0.03, 0.12);
    let stuff = solid_stuff(d);
    one(stuff, ball(r, 48))
}

fn rounded(d: &mut Stream) -> FormVariant {
    let a = d.range(0.03, 0.12);
    let half = [a, a * d.range(0.35, 1.0), a * d.range(0.5, 1.0)];
    let r = d.range(0.03, 0.4) * half[1];
    let stuff = solid_stuff(d);
    one(stuff, soft_block([0.0; 3], half, r, 5))
}

fn torus(d: &mut Stream) -> FormVariant {
    let r = d.range(0.04, 0.12);
    let minor = r * d.range(0.2, 0.48);
    let body = tube_loop(&ring_path(r, minor, 64), 28, minor);
    let stuff = solid_stuff(d);
    one(stuff, if d.chance(0.4) { body.turned_x(0.5 * PI) } else { body })
}

fn knot(d: &mut Stream) -> FormVariant {
    let (p, q) = *d.pick(&[(2.0, 3.0), (3.0, 2.0), (2.0, 5.0), (3.0, 4.0)]);
    let s = d.range(0.03, 0.08);
    let path: Vec<Vec3> = (0..220)
        .map(|k| {
            let t = f64::from(k) / 220.0;
            let (a, b) = (p * TAU * t, q * TAU * t);
            let r = 2.0 + 0.85 * maths::cos(b);
            mul([r * maths::cos(a), 0.85 * maths::sin(b), r * maths::sin(a)], s)
        })
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, tube_loop(&path, 16, s * d.range(0.24, 0.36)))
}

fn superellipsoid(d: &mut Stream) -> FormVariant {
    let (e1, e2) = (d.range(0.3, 1.9), d.range(0.3, 1.9));
    let s = d.range(0.04, 0.1);
    let (sy, sz) = (s * d.range(0.6, 1.3), s * d.range(0.7, 1.0));
    let power = |v: f64, e: f64| if v < 0.0 { -maths::pow(-v, e) } else { maths::pow(v, e) };
    let rows = 36;
    let rings: Vec<Vec<Vec3>> = (0..=rows)
        .map(|j| {
            let b = PI * (j as f64 / rows as f64 - 0.5);
            let c = if j == 0 || j == rows { 0.0 } else { power(maths::cos(b).max(0.0), e1) };
            circle(60, 1.0)
                .into_iter()
                .map(|[x, y]| [s * c * power(y, e2), sy * power(maths::sin(b), e1), sz * c * power(x, e2)])
                .collect()
        })
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, skin(&rings, [true, false], [false; 2]))
}

/// A brilliant: a table, a crown, a girdle, a pavilion, lying on a facet's side of it.
fn gem(d: &mut Stream) -> FormVariant {
    let (r, n) = (d.range(0.02, 0.05), 6 + 2 * d.below(3));
    let (crown, pavilion, table) = (d.range(0.55, 0.75), d.range(0.68, 0.8), d.range(0.28, 0.4));
    let mut planes: Vec<Vec3> = vec![[0.0, 1.0 / table, 0.0]];
    for k in 0..n {
        let a = TAU * k as f64 / n as f64;
        let b = a + PI / n as f64;
        planes.push([maths::sin(a) * maths::cos(crown), maths::sin(crown), maths::cos(a) * maths::cos(crown)]);
        planes.push(mul(
            [
                maths::sin(b) * maths::cos(crown * 1.25),
                maths::sin(crown * 1.25),
                maths::cos(b) * maths::cos(crown * 1.25),
            ],
            1.07,
        ));
        planes.push([
            maths::sin(a) * maths::cos(pavilion),
            -maths::sin(pavilion),
            maths::cos(a) * maths::cos(pavilion),
        ]);
        planes.push(mul(
            [maths::sin(b) * maths::cos(pavilion), -maths::sin(pavilion), maths::cos(b) * maths::cos(pavilion)],
            1.01,
        ));
        planes.push(mul([maths::sin(b), 0.0, maths::cos(b)], 0.98));
    }
    let body = faceted(&planes).scaled([r, r, r]);
    one(Stuff::Glass, if d.chance(0.5) { body.turned_x(0.5 * PI + pavilion) } else { body.turned_x(PI) })
}

fn crystal(d: &mut Stream) -> FormVariant {
    let sides = 5 + d.below(3);
    let (w, h) = (d.range(0.02, 0.05), d.range(2.0, 4.0));
    let mut planes: Vec<Vec3> = vec![[0.0, -1.0 / (0.5 * h), 0.0]];
    let phase = d.range(0.0, TAU);
    for k in 0..sides {
        let a = TAU * k as f64 / sides as f64 + phase;
        let (s, c) = (maths::sin(a), maths::cos(a));
        planes.push(mul([s, 0.0, c], 1.0 / d.range(0.8, 1.1)));
        let lean = d.range(0.6, 0.8);
        planes.push(mul(
            [s * maths::cos(lean), maths::sin(lean), c * maths::cos(lean)],
            1.0 / (0.36 * h * d.range(0.9, 1.15)),
        ));
    }
    one(Stuff::Glass, faceted(&planes).scaled([w, w, w]))
}

fn star(d: &mut Stream) -> FormVariant {
    let (points, inner, r) = (4 + d.below(5), d.range(0.4, 0.7), d.range(0.04, 0.1));
    let outline: Vec<[f64; 2]> = (0..2 * points)
        .map(|i| {
            let k = if i % 2 == 0 { r } else { inner * r };
            let a = TAU * i as f64 / (2 * points) as f64 + 0.5 * PI;
            [k * maths::cos(a), k * maths::sin(a)]
        })
        .collect();
    let stuff = solid_stuff(d);
    let thick = r * d.range(0.3, 1.2);
    one(stuff, extrude(&outline, thick).turned_x(if d.chance(0.5) { 0.5 * PI } else { 0.0 }))
}

fn pill(d: &mut Stream) -> FormVariant {
    let (r, l) = (d.range(0.02, 0.05), d.range(0.03, 0.1));
    let profile: Vec<_> = arc([0.0, -l], r, -0.5 * PI, 0.0, 8)
        .into_iter()
        .chain(arc([0.0, l], r, 0.0, 0.5 * PI, 8))
        .map(|[x, y]| [if x < 1e-9 { 0.0 } else { x }, y])
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, lathe(&profile, 36).smooth().turned_z(if d.chance(0.5) { 0.5 * PI } else { 0.0 }))
}

fn cone(d: &mut Stream) -> FormVariant {
    let (r, h, tip) = (d.range(0.03, 0.08), d.range(1.2, 2.6), d.range(0.0, 0.6));
    let tip = if tip < 0.2 { 0.0 } else { tip };
    let e = 0.03 * r;
    let mut profile = vec![[0.0, 0.0], [r - e, 0.0], [r, e], [tip * r + e * 0.3, h * r - e]];
    if tip > 0.0 {
        profile.push([tip * r - e, h * r]);
    }
    profile.push([0.0, h * r]);
    let stuff = solid_stuff(d);
    one(stuff, lathe(&profile, 44))
}

fn polyhedron(d: &mut Stream) -> FormVariant {
    let r = d.range(0.03, 0.08);
    let g = 0.5 * (1.0 + 5f64.sqrt());
    let mut planes: Vec<Vec3> = Vec::new();
    let signs = [-1.0, 1.0];
    match d.below(4) {
        0 => planes.extend([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]),
        1 => (0..8).for_each(|k| planes.push([signs[k & 1], signs[k >> 1 & 1], signs[k >> 2]])),
        2 => {
            for a in signs {
                for b in signs {
                    planes.extend([[0.0, a, b * g], [a, b * g, 0.0], [b * g, 0.0, a]]);
                }
            }
        }
        _ => {
            for a in signs {
                for b in signs {
                    planes.extend([[0.0, a / g, b * g], [a / g, b * g, 0.0], [b * g, 0.0, a / g]]);
                    signs.iter().for_each(|c| planes.push([a, b, *c]));
                }
            }
        }
    }
    // All faces at one distance; the first one is turned down.
    let planes: Vec<Vec3> = planes.into_iter().map(unit).collect();
    let first = planes[0];
    let tilt = maths::acos(-first[1]);
    let axis = maths::atan2(first[0], first[2]);
    let body = faceted(&planes).turned_y(-axis).turned_x(tilt).scaled([r, r, r]);
    let stuff = solid_stuff(d);
    one(stuff, body)
}

fn glass_prism(d: &mut Stream) -> FormVariant {
    let (r, l) = (d.range(0.02, 0.04), d.range(0.05, 0.12));
    let outline: Vec<[f64; 2]> =
        (0..3).map(|k| PI * (0.5 + 2.0 / 3.0 * f64::from(k))).map(|a| [r * maths::cos(a), r * maths::sin(a)]).collect();
    one(Stuff::Glass, extrude(&outline, l))
}

fn drop(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.02, 0.05), d.range(2.2, 3.4));
    let profile: Vec<_> = (0..=24)
        .map(|k| {
            let a = PI * f64::from(k) / 24.0;
            let s = maths::sin(a) * maths::pow(maths::sin(0.5 * a), 1.4);
            [if k == 0 || k == 24 { 0.0 } else { r * 1.3 * s.max(0.002) }, 0.5 * h * r * (1.0 + maths::cos(a))]
        })
        .rev()
        .collect();
    let stuff = solid_stuff(d);
    one(stuff, lathe(&profile, 36).smooth())
}
