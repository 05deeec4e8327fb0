//! Framed pictures and mirrors.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::geom::Vec3;
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("picture_frame", Family::Frame, 12, picture),
    form("mirror_frame", Family::Frame, 8, mirror),
    form("photo_standing", Family::Frame, 8, photo),
];

/// Four mitred sides of a moulded section round an opening of `half` size, upright about (0, `y`).
fn moulding(half: [f64; 2], wide: f64, deep: f64, y: f64) -> Body {
    let section = [[0.0, 0.0], [0.0, 0.6], [0.25, 0.75], [0.4, 1.0], [0.75, 0.9], [1.0, 0.55], [1.0, 0.0]];
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    Body::all((0..4).map(|k| {
        let (a, b) = (corners[k], corners[(k + 1) % 4]);
        let ring = |c: (f64, f64)| {
            section
                .iter()
                .map(|[o, z]| [c.0 * (half[0] + o * wide), y + c.1 * (half[1] + o * wide), z * deep])
                .collect::<Vec<Vec3>>()
        };
        skin(&[ring(a), ring(b)], [true, false], [true, true]).across()
    }))
}

fn framed(m: &mut Maker, d: &mut Stream, half: [f64; 2], face: Stuff) -> f64 {
    let (wide, deep) = (d.range(0.015, 0.06), d.range(0.012, 0.03));
    let stuff = *d.pick(&[Stuff::Wood, Stuff::Wood, Stuff::Metal, Stuff::Plastic]);
    let y = half[1] + wide;
    m.add(stuff, moulding(half, wide, deep, y));
    m.add(Stuff::Paper, panel([0.0, y, 0.0015], [half[0] + 0.3 * wide, half[1] + 0.3 * wide, 0.0015]));
    let mount = if face == Stuff::Print && d.chance(0.5) { 0.15 * half[0].min(half[1]) } else { 0.0 };
    let z = 0.0032;
    m.add(face, sheet(1, 1, |s, t| [(half[0] - mount) * (2.0 * s - 1.0), y + (half[1] - mount) * (2.0 * t - 1.0), z]));
    y
}

fn picture(d: &mut Stream) -> FormVariant {
    let a = d.range(0.1, 0.5);
    let ratio = d.range(0.6, 1.0);
    let half = if d.chance(0.5) { [a, a * ratio] } else { [a * ratio, a] };
    let mut m = Maker::default();
    let y = framed(&mut m, d, half, Stuff::Print);
    if d.chance(0.3) {
        m.add(Stuff::Pane, sheet(1, 1, |s, t| [half[0] * (2.0 * s - 1.0), y + half[1] * (2.0 * t - 1.0), 0.006]));
    }
    m.made()
}

fn mirror(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    if d.chance(0.5) {
        let half = [d.range(0.15, 0.4), d.range(0.2, 0.7)];
        framed(&mut m, d, half, Stuff::Mirror);
    } else {
        let (r, rim) = (d.range(0.15, 0.4), d.range(0.02, 0.05));
        let oval = d.range(1.0, 1.5);
        let y = (r + rim) * oval;
        let ring = lathe_loop(&[[r, 0.0], [r + rim, 0.0], [r + rim, 0.012], [r + 0.5 * rim, 0.024], [r, 0.01]], 56)
            .turned_x(0.5 * PI)
            .scaled([1.0, oval, 1.0]);
        m.add(*d.pick(&[Stuff::Wood, Stuff::Metal]), ring.at([0.0, y, 0.0]));
        let disc: Vec<[f64; 2]> = circle(56, r + 0.002).into_iter().map(|[a, b]| [a, b * oval]).collect();
        m.add(Stuff::Mirror, extrude(&disc, 0.004).at([0.0, y, 0.004]));
    }
    m.made()
}

fn photo(d: &mut Stream) -> FormVariant {
    let half = [d.range(0.05, 0.1), d.range(0.06, 0.12)];
    let mut inner = Maker::default();
    framed(&mut inner, d, half, Stuff::Print);
    let lean = d.range(0.15, 0.3);
    let mut m = Maker::default();
    inner.bodies().into_iter().for_each(|(stuff, body)| m.add(stuff, body.turned_x(-lean)));
    let high = 1.3 * half[1];
    m.add(
        Stuff::Plastic,
        beam(
            [0.0, high * maths::cos(lean), -high * maths::sin(lean) - 0.001],
            [0.0, 0.002, -1.05 * half[1]],
            [0.003, 0.03],
            [0.0, 0.0, 1.0],
        ),
    );
    m.made()
}
