//! Screens, books, paper, pens.

use super::{
    super::{noise::noise, shapes::*, stuff::Stuff},
    Family, Form, FormVariant, form,
    maker::Maker,
};
use tauflow_data::{maths, rng::Stream};

pub(super) const FORMS: &[Form] = &[
    form("monitor", Family::Screen, 8, monitor),
    form("laptop", Family::Screen, 8, laptop),
    form("television", Family::Screen, 6, television),
    form("telephone", Family::Screen, 6, telephone),
    form("keyboard", Family::Tool, 6, keyboard),
    form("book", Family::Book, 12, book),
    form("book_row", Family::Book, 16, row),
    form("book_pile", Family::Book, 12, pile),
    form("book_open", Family::Book, 8, open),
    form("paper_sheets", Family::Paper, 8, sheets),
    form("paper_crumpled", Family::Paper, 8, crumpled),
    form("paper_roll", Family::Paper, 6, roll),
    form("envelopes", Family::Paper, 6, envelopes),
    form("pen", Family::Pen, 8, pen),
    form("pencil", Family::Pen, 6, pencil),
    form("pen_pot", Family::Pen, 8, pot),
];

fn screen_face(half: [f64; 2], z: f64, y: f64) -> Body {
    sheet(1, 1, |s, t| [(2.0 * s - 1.0) * half[0], y + (2.0 * t - 1.0) * half[1], z])
}

fn monitor(d: &mut Stream) -> FormVariant {
    let w = d.range(0.24, 0.4);
    let h = w * *d.pick(&[0.5625, 0.625, 0.43]);
    let (edge, lift) = (d.range(0.005, 0.02), d.range(0.08, 0.16));
    let y = lift + h + edge;
    let mut m = Maker::default();
    m.add(Stuff::Plastic, board([0.0, y, 0.0], [w + edge, h + edge, 0.012]));
    m.add(Stuff::Screen, screen_face([w, h], 0.0126, y));
    m.add(Stuff::Plastic, soft_block([0.0, y, -0.025], [0.5 * w, 0.55 * h, 0.02], 0.015, 2));
    let stuff = *d.pick(&[Stuff::Plastic, Stuff::Metal]);
    m.add(stuff, beam([0.0, 0.01, -0.07], [0.0, y, -0.05], [0.012, 0.06], [0.0, 0.0, 1.0]));
    m.add(stuff, extrude(&rounded_rect([0.12, 0.09], 0.02, 4), 0.012).turned_x(-0.5 * PI).at([0.0, 0.006, -0.02]));
    m.made()
}

fn laptop(d: &mut Stream) -> FormVariant {
    let w = d.range(0.145, 0.19);
    let deep = w * d.range(0.63, 0.7);
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Plastic]);
    let mut m = Maker::default();
    m.add(stuff, extrude(&rounded_rect([w, deep], 0.012, 4), 0.014).turned_x(-0.5 * PI).at([0.0, 0.008, 0.0]));
    let mut keys = Body::default();
    for r in 0..5 {
        for c in 0..13 {
            let x = (f64::from(c) - 6.0) * w * 0.138;
            let z = -deep * 0.62 + f64::from(r) * w * 0.135;
            keys = keys.with(block([x, 0.0157, z], [w * 0.06, 0.001, w * 0.058]));
        }
    }
    m.add(Stuff::Plastic, keys);
    m.add(Stuff::Plastic, block([0.0, 0.0152, deep * 0.6], [w * 0.35, 0.0004, deep * 0.28]));
    let tilt = -d.range(0.1, 0.55);
    let place = |b: Body| b.turned_x(tilt).at([0.0, 0.012, -deep]);
    m.add(stuff, place(extrude(&rounded_rect([w, deep], 0.012, 4), 0.007).at([0.0, deep + 0.004, 0.0])));
    m.add(Stuff::Screen, place(screen_face([w - 0.008, deep - 0.01], 0.004, deep + 0.004)));
    for s in [-1.0, 1.0] {
        m.add(Stuff::Rubber, rod([s * (w - 0.02), 0.0, -0.7 * deep], [s * (w - 0.02), 0.0015, -0.7 * deep], 0.006, 8));
        m.add(Stuff::Rubber, rod([s * (w - 0.02), 0.0, 0.7 * deep], [s * (w - 0.02), 0.0015, 0.7 * deep], 0.006, 8));
    }
    m.made()
}

fn television(d: &mut Stream) -> FormVariant {
    let w = d.range(0.4, 0.75);
    let h = 0.5625 * w;
    let mut m = Maker::default();
    let y = h + 0.075;
    m.add(Stuff::Plastic, board([0.0, y, 0.0], [w + 0.008, h + 0.01, 0.018]));
    m.add(Stuff::Screen, screen_face([w, h], 0.0186, y + 0.001));
    m.add(Stuff::Plastic, soft_block([0.0, y - 0.3 * h, -0.03], [0.7 * w, 0.5 * h, 0.02], 0.015, 2));
    for s in [-1.0, 1.0] {
        let x = s * 0.6 * w;
        for z in [-0.13, 0.13] {
            m.add(Stuff::Metal, beam([x, 0.07, 0.0], [x + 0.02 * s, 0.006, z], [0.012, 0.02], [0.0, 1.0, 0.0]));
        }
    }
    m.made()
}

fn telephone(d: &mut Stream) -> FormVariant {
    let (w, h) = (d.range(0.034, 0.04), d.range(0.07, 0.083));
    let mut m = Maker::default();
    m.add(
        *d.pick(&[Stuff::Metal, Stuff::Plastic]),
        extrude(&rounded_rect([w, h], 0.009, 5), 0.008).turned_x(-0.5 * PI).at([0.0, 0.004, 0.0]),
    );
    let face = sheet(1, 1, |s, t| [(2.0 * s - 1.0) * (w - 0.003), 0.0083, (1.0 - 2.0 * t) * (h - 0.003)]);
    m.add(Stuff::Screen, face);
    m.made()
}

fn keyboard(d: &mut Stream) -> FormVariant {
    let columns = 15 + d.below(2) * 4;
    let pitch = 0.019;
    let half = [0.5 * pitch * columns as f64 + 0.008, 0.5 * pitch * 6.0 + 0.008];
    let mut m = Maker::default();
    let slope = d.range(0.0, 0.07);
    let tilt = |b: Body| b.turned_x(slope);
    m.add(Stuff::Plastic, tilt(soft_block([0.0, 0.01, 0.0], [half[0], 0.008, half[1]], 0.005, 2)));
    let mut keys = Body::default().flat();
    for r in 0..6 {
        let mut x = -0.5 * pitch * columns as f64;
        let right = -x;
        let mut c = 0;
        while x < right - 1e-6 {
            let mut wide = if r == 5 && c == 3 {
                6.0
            } else if c == 0 && r > 1 {
                1.5
            } else {
                1.0
            } * pitch;
            if x + wide > right - 0.3 * pitch {
                wide = right - x;
            }
            let z = pitch * (f64::from(r) - 2.5);
            let ring = |k: f64, y: f64| {
                let (a, b) = (0.5 * wide - 0.001 - k, 0.5 * pitch - 0.001 - k);
                let cx = x + 0.5 * wide;
                vec![[cx - a, y, z + b], [cx + a, y, z + b], [cx + a, y, z - b], [cx - a, y, z - b]]
            };
            keys = keys.with(skin(&[ring(0.0, 0.0175), ring(0.0025, 0.0245)], [true, false], [false, true]));
            x += wide;
            c += 1;
        }
    }
    m.another(Stuff::Plastic, tilt(keys));
    m.made()
}

/// A closed book lying flat with its spine to -x: two boards, a rounded spine, a block of pages.
fn volume(d: &mut Stream, size: [f64; 3], cover: &mut Vec<Body>, pages: &mut Vec<Body>, place: &dyn Fn(Body) -> Body) {
    let [w, thick, h] = size;
    let board_thick = if d.chance(0.6) { 0.0025 } else { 0.0008 };
    let over = if board_thick > 0.001 { 0.003 } else { 0.0003 };
    let t = 0.5 * thick;
    for s in [-1.0, 1.0] {
        cover.push(place(panel([0.0, t + s * (t - 0.5 * board_thick), 0.0], [0.5 * w, 0.5 * board_thick, 0.5 * h])));
    }
    let spine = d.range(0.0, 0.006);
    let path: Vec<[f64; 2]> = (0..=6)
        .map(|k| {
            let a = PI * (f64::from(k) / 6.0 - 0.5);
            [-0.5 * w - spine * maths::cos(a) - 0.0005, t + t * maths::sin(a)]
        })
        .collect();
    let back: Vec<[f64; 2]> = path.iter().rev().map(|p| [p[0] + board_thick + 0.0006, t + (p[1] - t) * 0.98]).collect();
    let outline: Vec<_> = path.into_iter().chain(back).collect();
    cover.push(place(extrude(&outline, h)));
    pages.push(place(block([-0.5 * over, t, 0.0], [0.5 * w - over, t - board_thick, 0.5 * h - over])));
}

fn flush(m: &mut Maker, cover: Vec<Body>, pages: Vec<Body>) {
    m.another(Stuff::Print, Body::all(cover));
    m.add(Stuff::Paper, Body::all(pages));
}

fn format(d: &mut Stream) -> [f64; 3] {
    let h = d.range(0.17, 0.3);
    [h * d.range(0.6, 0.8), d.range(0.01, 0.05), h]
}

fn book(d: &mut Stream) -> FormVariant {
    let size = format(d);
    let mut m = Maker::default();
    let (mut cover, mut pages) = (Vec::new(), Vec::new());
    volume(d, size, &mut cover, &mut pages, &|b| b);
    flush(&mut m, cover, pages);
    m.top([0.0, size[1], 0.0], [0.46 * size[0], 0.46 * size[2]], f64::INFINITY);
    m.made()
}

/// A row of upright books, their spines to +z, the last ones leaning.
fn row(d: &mut Stream) -> FormVariant {
    let count = 5 + d.below(9);
    let base = d.range(0.18, 0.27);
    let mut m = Maker::default();
    let mut x = 0.0;
    let lean_from = if d.chance(0.5) { count - 1 } else { count };
    for k in 0..count {
        let h = base * d.range(0.82, 1.08);
        let size = [h * d.range(0.62, 0.76), d.range(0.012, 0.045), h];
        let (mut cover, mut pages) = (Vec::new(), Vec::new());
        let lean = if k >= lean_from { d.range(0.12, 0.25) } else { 0.0 };
        // Lying: x wide, y thick, z high. Upright: spine (-x) to +z, thickness along x, height up.
        let stand = |b: Body| {
            b.mapped(&[[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.5 * size[2]], [-1.0, 0.0, 0.0, -0.5 * size[0]]])
                .turned_z(lean)
                .at([x + if lean > 0.0 { maths::sin(lean) * size[2] + 0.001 } else { 0.0 }, 0.0, 0.0])
        };
        volume(d, size, &mut cover, &mut pages, &stand);
        flush(&mut m, cover, pages);
        x += size[1] + d.range(0.0003, 0.002);
    }
    m.made()
}

fn pile(d: &mut Stream) -> FormVariant {
    let count = 2 + d.below(5);
    let mut m = Maker::default();
    let mut y = 0.0;
    let mut size = format(d);
    size[2] = size[2].max(0.22);
    size[0] = size[2] * 0.72;
    for k in 0..count {
        let thick = d.range(0.012, 0.045);
        let own = [size[0], thick, size[2]];
        let (turn, dx, dz) = (d.range(-0.3, 0.3), d.range(-0.012, 0.012), d.range(-0.012, 0.012));
        let back = d.chance(0.3);
        let (mut cover, mut pages) = (Vec::new(), Vec::new());
        let lay = |b: Body| b.turned_y(turn + if back { PI } else { 0.0 }).at([dx, y, dz]);
        volume(d, own, &mut cover, &mut pages, &lay);
        flush(&mut m, cover, pages);
        y += thick + 0.0002;
        if k + 1 == count {
            m.top([dx, y - 0.0002, dz], [0.33 * size[0], 0.36 * size[2]], f64::INFINITY);
        }
        size = [size[0] * d.range(0.85, 1.0), 0.0, size[2] * d.range(0.85, 1.0)];
    }
    m.made()
}

fn open(d: &mut Stream) -> FormVariant {
    let (h, w, thick) = (d.range(0.2, 0.3), d.range(0.14, 0.2), d.range(0.01, 0.025));
    let mut m = Maker::default();
    let split = d.range(0.35, 0.65);
    for s in [-1.0, 1.0] {
        let t = thick * if s < 0.0 { split } else { 1.0 - split } * 2.0;
        // A block of pages that bulges from the fold.
        let top: Vec<[f64; 2]> = (0..=12)
            .map(|k| {
                let x = f64::from(k) / 12.0;
                [
                    s * w * x,
                    0.003
                        + t * (0.25 + 0.75 * maths::pow(maths::sin(PI * (0.08 + 0.62 * x)), 0.5))
                            * (1.0 - maths::pow(1.0 - x, 6.0) * 0.6),
                ]
            })
            .collect();
        let outline: Vec<_> = [[s * w, 0.003], [0.0, 0.003]].into_iter().chain(top).collect();
        m.add(Stuff::Print, extrude(&outline, h));
        m.add(
            Stuff::Leather,
            panel([s * 0.5 * (w + 0.004), 0.0015, 0.0], [0.5 * (w + 0.004), 0.0014, 0.5 * h + 0.003]),
        );
    }
    m.made()
}

fn sheets(d: &mut Stream) -> FormVariant {
    let count = 1 + d.below(12);
    let half = [0.105, 0.1485];
    let mut m = Maker::default();
    if d.chance(0.3) {
        let t = d.range(0.005, 0.05);
        m.add(Stuff::Paper, panel([0.0, 0.5 * t, 0.0], [half[0], 0.5 * t, half[1]]));
        m.top([0.0, t, 0.0], [half[0] - 0.01, half[1] - 0.01], f64::INFINITY);
        return m.made();
    }
    let spread = d.range(0.002, 0.03);
    for k in 0..count {
        let (turn, dx, dz) = (d.normal() * 2.0 * spread, d.normal() * spread, d.normal() * spread);
        let (curl, side) = (d.range(0.0, 0.012), d.range(-1.0, 1.0));
        let y = 0.0006 * k as f64;
        let page = sheet(8, 8, |s, t| {
            let (x, z) = (2.0 * s - 1.0, 1.0 - 2.0 * t);
            let lift = curl * maths::pow((0.5 * (x * side + z) + 0.3).max(0.0), 3.0);
            [x * half[0], y + lift, z * half[1]]
        });
        let stuff = if k % 3 == 0 { Stuff::Print } else { Stuff::Paper };
        m.add(stuff, page.turned_y(turn).at([dx, 0.0, dz]));
    }
    m.made()
}

fn crumpled(d: &mut Stream) -> FormVariant {
    let (seed, r) = (d.bits(), d.range(0.025, 0.045));
    let cells = d.range(1.6, 2.4);
    let body = icosphere(3, |p| {
        // Ridges where noise changes its sign, as folds are.
        let ridge = |seed: u64, k: f64| noise(seed, p.map(|v| v * k), [0; 3]).abs();
        r * (1.0 - 0.3 * ridge(seed, cells) - 0.2 * ridge(seed ^ 5, 1.7 * cells))
    });
    let mut m = Maker::default();
    m.add(Stuff::Paper, body.flat());
    m.made()
}

fn roll(d: &mut Stream) -> FormVariant {
    let (l, r) = (d.range(0.2, 0.45), d.range(0.015, 0.03));
    let turns = d.range(1.6, 3.0);
    let n = 40;
    let sheet = sheet(n, 1, |s, t| {
        let a = TAU * turns * s;
        let rr = r * (0.75 + 0.25 * s);
        [l * (2.0 * t - 1.0), rr * maths::sin(a) + r, rr * maths::cos(a)]
    });
    let mut m = Maker::default();
    m.add(*d.pick(&[Stuff::Print, Stuff::Paper]), sheet.smooth());
    m.made()
}

fn envelopes(d: &mut Stream) -> FormVariant {
    let count = 1 + d.below(5);
    let mut m = Maker::default();
    for k in 0..count {
        let half = [d.range(0.08, 0.115), d.range(0.055, 0.08)];
        let t = 0.0012;
        let y = 2.2 * t * k as f64;
        let turn = d.range(-0.5, 0.5);
        let (dx, dz) = (d.range(-0.02, 0.02), d.range(-0.02, 0.02));
        let place = |b: Body| b.turned_y(turn).at([dx, y, dz]);
        m.another(Stuff::Paper, place(panel([0.0, 0.5 * t, 0.0], [half[0], 0.5 * t, half[1]])));
        let mut flap = Body::default();
        let ids =
            [[-half[0], t + 0.0004, -half[1]], [0.0, t + 0.0009, 0.15 * half[1]], [half[0], t + 0.0004, -half[1]]]
                .map(|p| flap.point(p, [p[0], p[2]]));
        flap.triangles.push([ids[0], ids[1], ids[2]]);
        m.add(Stuff::Paper, place(flap));
        if d.chance(0.6) {
            m.add(Stuff::Print, place(panel([0.7 * half[0], t + 0.0003, 0.6 * half[1]], [0.011, 0.0003, 0.013])));
        }
    }
    m.made()
}

fn pen_body(d: &mut Stream, m: &mut Maker, place: &dyn Fn(Body) -> Body) {
    let (l, r) = (d.range(0.125, 0.15), d.range(0.004, 0.0065));
    m.add(
        Stuff::Metal,
        place(lathe(&[[0.0, 0.0], [0.0006, 0.001], [0.0015, 0.008], [0.6 * r, 0.016], [0.0, 0.0165]], 10)),
    );
    let body = [
        [0.0, 0.0155],
        [0.7 * r, 0.0155],
        [r, 0.03],
        [r, 0.6 * l],
        [1.12 * r, 0.6 * l + 0.001],
        [1.05 * r, l - 0.003],
        [0.7 * r, l],
        [0.0, l],
    ];
    m.add(Stuff::Plastic, place(lathe(&body, 14)));
    m.add(Stuff::Metal, place(board([1.3 * r, 0.78 * l, 0.0], [0.0007, 0.16 * l, 0.0018])));
}

fn pencil_body(d: &mut Stream, m: &mut Maker, place: &dyn Fn(Body) -> Body) {
    let (l, r) = (d.range(0.09, 0.178), 0.0037);
    let hex = circle(6, r);
    let ring = |k: f64, y: f64| hex.iter().map(|[c, s]| [k * s, y, k * c]).collect::<Vec<_>>();
    m.add(Stuff::Wood, place(skin(&[ring(0.28, 0.006), ring(0.97, 0.022)], [true, false], [true, true])));
    m.add(Stuff::Rubber, place(skin(&[ring(0.05, 0.0), ring(0.27, 0.0062)], [true, false], [true, true])));
    m.add(Stuff::Plastic, place(skin(&[ring(1.0, 0.021), ring(1.0, l)], [true, false], [true, true])));
    if d.chance(0.5) {
        m.add(Stuff::Metal, place(rod([0.0, l - 0.001, 0.0], [0.0, l + 0.012, 0.0], 0.0038, 12)));
        m.add(Stuff::Rubber, place(rod([0.0, l + 0.011, 0.0], [0.0, l + 0.022, 0.0], 0.0034, 12)));
    }
}

fn pen(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let turn = d.range(-0.4, 0.4);
    pen_body(d, &mut m, &|b| b.turned_y(2.2).turned_z(0.5 * PI).turned_y(turn));
    m.made()
}

fn pencil(d: &mut Stream) -> FormVariant {
    let mut m = Maker::default();
    let turn = d.range(-0.4, 0.4);
    pencil_body(d, &mut m, &|b| b.turned_z(0.5 * PI).turned_y(turn));
    m.made()
}

fn pot(d: &mut Stream) -> FormVariant {
    let (r, h) = (d.range(0.032, 0.045), d.range(0.085, 0.115));
    let mut m = Maker::default();
    let stuff = *d.pick(&[Stuff::Metal, Stuff::Plastic, Stuff::Ceramic, Stuff::Wood]);
    m.add(stuff, lathe(&[[0.0, 0.0], [r, 0.0], [r, h], [r - 0.0025, h], [r - 0.0025, 0.003], [0.0, 0.003]], 28));
    let count = 3 + d.below(5);
    for k in 0..count {
        let a = TAU * (k as f64 + d.range(0.0, 0.6)) / count as f64;
        let (s, c) = (maths::sin(a), maths::cos(a));
        let foot = 0.3 * r;
        let lean = maths::atan((r - 0.008 + foot * 0.6) / h);
        let place = |b: Body| b.turned_x(lean).turned_y(a).at([-foot * s, 0.005, -foot * c]);
        if d.chance(0.5) { pen_body(d, &mut m, &place) } else { pencil_body(d, &mut m, &place) }
    }
    m.made()
}
