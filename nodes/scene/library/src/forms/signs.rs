//! Signs and letters.

use super::{
    super::{shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("sign_board", Family::Sign, 10, sign_board),
    form("sign_letters", Family::Sign, 10, letters),
    form("sign_post", Family::Sign, 8, sign_post),
    form("sign_easel", Family::Sign, 6, easel),
];

const WORDS: &[&str] = &[
    "OPEN",
    "CAFE",
    "HOTEL",
    "EXIT",
    "BOOKS",
    "BAKERY",
    "TAXI",
    "STOP",
    "ROOM 24",
    "PLATFORM 9",
    "MUSEUM",
    "GARAGE",
    "FLOWERS",
    "TEA",
    "BAR",
];

fn sign_board(d: &mut Stream) -> FormVariant {
    let text = *d.pick(WORDS);
    let height = d.range(0.08, 0.2);
    let half = [0.5 * text_width(text, height) + 0.4 * height, 0.5 * height + 0.35 * height];
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Wood, Stuff::PaintedMetal, Stuff::Plastic]),
        board([0.0, half[1], 0.0], [half[0], half[1], 0.012]),
    );
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Plastic]);
    m.another(stuff, lettering(text, height, 0.15, 0.012).at([0.0, half[1], 0.0172]));
    if d.chance(0.5) {
        for s in [-1.0, 1.0] {
            m.add(
                Stuff::Metal,
                rod(
                    [s * 0.8 * half[0], 2.0 * half[1] - 0.005, 0.0],
                    [s * 0.8 * half[0], 2.0 * half[1] + 0.15, 0.0],
                    0.003,
                    6,
                ),
            );
        }
    }
    m.made()
}

fn letters(d: &mut Stream) -> FormVariant {
    let text = *d.pick(WORDS);
    let height = d.range(0.08, 0.4);
    let depth = height * d.range(0.15, 0.35);
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::PaintedMetal, Stuff::Metal, Stuff::Wood, Stuff::Plastic, Stuff::Glow]);
    m.add(stuff, lettering(text, height, d.range(0.12, 0.2), depth).at([0.0, 0.5 * height, 0.0]));
    m.made()
}

fn sign_post(d: &mut Stream) -> FormVariant {
    let h = d.range(1.9, 2.6);
    let mut m = Maker::default();
    m.add(Stuff::Metal, rod([0.0, 0.0, 0.0], [0.0, h, 0.0], 0.03, 14));
    let r = d.range(0.2, 0.32);
    let sides = *d.pick(&[3usize, 4, 8, 40]);
    let spin = if sides == 3 {
        0.5 * PI
    } else if sides == 4 {
        0.25 * PI
    } else {
        PI / sides as f64
    };
    let plate = extrude(&circle(sides, r), 0.006).turned_z(spin).at([0.0, h - 0.8 * r, 0.037]);
    m.add(Stuff::PaintedMetal, plate);
    m.another(
        Stuff::PaintedMetal,
        extrude(&circle(sides, 0.86 * r), 0.002).turned_z(spin).at([0.0, h - 0.8 * r, 0.0412]),
    );
    let text = *d.pick(&["STOP", "30", "50", "TAXI", "BUS", "P"]);
    let height = (0.55 * r).min(0.55 * r * 1.1 * r / text_width(text, 0.55 * r));
    m.another(Stuff::PaintedMetal, lettering(text, height, 0.17, 0.002).at([0.0, h - 0.85 * r, 0.0432]));
    m.made()
}

/// A board that stands on the pavement.
fn easel(d: &mut Stream) -> FormVariant {
    let (w, h) = (d.range(0.25, 0.35), d.range(0.8, 1.1));
    let lean = 0.2;
    let mut m = Maker::default();
    for s in [-1.0, 1.0] {
        let tilt = |b: Body| b.turned_x(-s * lean).at([0.0, 0.0, s * (h * maths::sin(lean) + 0.012)]);
        for x in [-1.0, 1.0] {
            m.add(Stuff::Wood, tilt(board([x * w, 0.5 * h, 0.0], [0.02, 0.5 * h, 0.012])));
        }
        for y in [0.12, h - 0.03] {
            m.add(Stuff::Wood, tilt(board([0.0, y, 0.0], [w - 0.02, 0.02, 0.011])));
        }
        m.another(
            Stuff::Plastic,
            tilt(board([0.0, 0.5 * (h + 0.09), 0.0], [w - 0.02, 0.5 * (h - 0.15) - 0.02, 0.006])),
        );
        if s > 0.0 {
            for k in 0..3 {
                let text = *d.pick(WORDS);
                let size = (0.09f64).min(0.09 * 1.5 * w / text_width(text, 0.09));
                m.add(
                    Stuff::Paper,
                    tilt(lettering(text, size, 0.14, 0.0012).at([0.0, h * (0.75 - 0.2 * f64::from(k)), 0.0068])),
                );
            }
        }
    }
    m.made()
}
