//! Wood, bark and leaves.

use super::{
    field::{Cells, Field, Size, fract, hash, step},
    skin::{Color, Skin, Texel, blend, eye, shade},
};
use tauflow_data::{maths, rng::Stream};

const TAU: f64 = core::f64::consts::TAU;

/// Light and dark tones of timbers.
fn timber(draw: &mut Stream) -> (Color, Color) {
    let (light, dark) = *draw.pick(&[
        ([222.0, 184.0, 135.0], [172.0, 122.0, 74.0]),  // pine
        ([196.0, 152.0, 102.0], [138.0, 94.0, 56.0]),   // oak
        ([150.0, 104.0, 68.0], [92.0, 58.0, 36.0]),     // walnut
        ([164.0, 106.0, 74.0], [112.0, 64.0, 44.0]),    // cherry
        ([226.0, 202.0, 164.0], [190.0, 158.0, 116.0]), // maple
        ([120.0, 86.0, 64.0], [72.0, 48.0, 36.0]),      // smoked oak
        ([178.0, 164.0, 146.0], [128.0, 114.0, 98.0]),  // weathered
    ]);
    let [a, b] = [light, dark].map(|c: [f64; 3]| eye(c[0], c[1], c[2]));
    let k = draw.range(0.85, 1.12);
    (shade(a, k), shade(b, k))
}

/// Grain along u over one period; looked up by boards with offsets of their own.
struct Grain {
    bend: Field,
    streak: Field,
    pores: Field,
}

impl Grain {
    fn new(size: Size, draw: &mut Stream, across: usize) -> Self {
        Self {
            bend: Field::fractal(size, draw.bits(), [1, across.max(2)], 3, 0.4),
            streak: Field::fractal(size, draw.bits(), [4, size[1] / 8], 3, 0.7),
            pores: Field::noise(size, draw.bits(), [size[0] / 16, size[1] / 2]),
        }
    }

    /// Share of the dark tone, and height in millimetres, at `u`, `v`; `across` counts rings and is where in them.
    fn at(&self, u: f64, v: f64, across: f64) -> (f64, f64) {
        let ring = fract(across + 1.1 * self.bend.sample(u, v));
        // Early wood grows dark slowly, late wood ends at once.
        let year = step(0.0, 0.85, ring) * (1.0 - step(0.88, 1.0, ring));
        let streak = self.streak.sample(u, v);
        let pore = step(0.25, 0.75, self.pores.sample(u, v));
        let dark = (0.12 + 0.5 * year + 0.26 * streak + 0.3 * pore).clamp(0.0, 1.0);
        (dark, -0.12 * pore - 0.05 * year + 0.04 * streak)
    }
}

/// Floor boards of 12 cm, twelve in a period, two to a row.
pub fn planks(draw: &mut Stream, size: Size) -> Skin {
    let (light, dark) = timber(draw);
    let seed = draw.bits();
    let contrast = draw.range(0.08, 0.22);
    let grain = Grain::new(size, draw, 6);
    let wear = Field::fractal(size, draw.bits(), [3, 3], 4, 0.5);
    Skin::new(size, |i, u, v| {
        let row = (v * 12.0).floor() as i64;
        let y = fract(v * 12.0);
        let joint = hash(seed, [row, 0]);
        let along = fract(u - joint) * 2.0;
        let (board, x) = (along.floor() as i64, fract(along));
        let own = |k| hash(seed, [row * 2 + board, k]);
        let (shadow, height) = grain.at(u + own(2), v + own(3), own(4) + y * (1.2 + 2.4 * own(5)));
        let tone = 1.0 + contrast * (2.0 * own(6) - 1.0);
        let warm = [1.0, 1.0 - 0.06 * own(7), 1.0 - 0.12 * own(7)];
        let color = blend(light, dark, shadow);
        // Metres from the nearest edge: boards are 0.12 wide and 0.72 long.
        let edge = (0.12 * y.min(1.0 - y)).min(0.72 * x.min(1.0 - x));
        let gap = 1.0 - step(0.0008, 0.0032, edge);
        let color = [0, 1, 2].map(|c| color[c] * tone * warm[c] * (1.0 - 0.75 * gap));
        let rough = 0.62 + 0.1 * shadow + 0.12 * wear.values[i] + 0.2 * gap;
        Texel { color, rough, height: height - 1.6 * gap }
    })
}

/// A veneer or a wide board without joints.
pub fn veneer(draw: &mut Stream, size: Size) -> Skin {
    let (light, dark) = timber(draw);
    let grain = Grain::new(size, draw, 3);
    let rings = 4.0 + draw.below(8) as f64;
    let figure = Field::fractal(size, draw.bits(), [3, 2], 2, 0.5);
    Skin::new(size, |i, u, v| {
        let (shadow, height) = grain.at(u, v, rings * v);
        let sheen = 0.06 * figure.values[i];
        Texel {
            color: shade(blend(light, dark, shadow), 1.0 + sheen),
            rough: 0.6 + 0.12 * shadow + sheen,
            height: 0.6 * height,
        }
    })
}

/// Parquet in a basket weave: squares of four staves that lie crosswise in turns.
pub fn parquet(draw: &mut Stream, size: Size) -> Skin {
    let (light, dark) = timber(draw);
    let seed = draw.bits();
    let grain = Grain::new(size, draw, 8);
    let turned = Grain::new(size, draw, 8);
    Skin::new(size, |_, u, v| {
        let (bx, by) = ((u * 4.0).floor() as i64, (v * 4.0).floor() as i64);
        let crosswise = (bx + by) % 2 == 0;
        let (x, y) = (fract(u * 4.0), fract(v * 4.0));
        let (along, across, a, b) = if crosswise { (x, y, u, v) } else { (y, x, v, u) };
        let stave = (across * 4.0).floor() as i64;
        let own = |k| hash(seed, [(by * 4 + bx) * 4 + stave, k]);
        let y = fract(across * 4.0);
        let source = if crosswise { &grain } else { &turned };
        let (shadow, height) = source.at(a + own(1), b + own(2), own(3) + y * (1.0 + own(4)));
        let edge = (0.06 * y.min(1.0 - y)).min(0.24 * along.min(1.0 - along));
        let gap = 1.0 - step(0.0006, 0.0024, edge);
        let tone = 0.86 + 0.28 * own(5);
        let color = shade(blend(light, dark, shadow), tone * (1.0 - 0.7 * gap));
        Texel { color, rough: 0.6 + 0.15 * shadow + 0.2 * gap, height: height - 0.8 * gap }
    })
}

/// Bark: plates between furrows that run along v, as trunks' uv do.
pub fn bark(draw: &mut Stream, size: Size) -> Skin {
    let birch = draw.chance(0.2);
    let tone = draw.range(0.8, 1.2);
    let (light, deep) = if birch {
        (eye(205.0, 200.0, 190.0), eye(70.0, 62.0, 56.0))
    } else {
        let base = *draw.pick(&[[128.0, 104.0, 82.0], [112.0, 100.0, 90.0], [138.0, 98.0, 72.0]]);
        (shade(eye(base[0], base[1], base[2]), tone), eye(48.0, 38.0, 30.0))
    };
    let moss = eye(92.0, 104.0, 52.0);
    let bend = Field::fractal(size, draw.bits(), [3, 2], 4, 0.5);
    let cells = if birch { [3, 9] } else { [9, 4] };
    let plates = Cells::new(size, draw.bits(), cells, 0.95, |u, v| {
        let b = bend.sample(u, v);
        [0.9 * b, 0.9 * bend.sample(v + 0.3, u)]
    });
    let edge = plates.edge();
    let fine = Field::fractal(size, draw.bits(), [16, 8], 4, 0.6);
    let green = Field::fractal(size, draw.bits(), [2, 2], 4, 0.55);
    let mossy = draw.range(0.35, 1.2);
    Skin::new(size, |i, _, _| {
        let plate = step(0.02, if birch { 0.1 } else { 0.42 }, edge.values[i]);
        let color = blend(deep, shade(light, 0.75 + 0.4 * plates.id.values[i]), plate);
        let color = shade(color, 1.0 + 0.3 * fine.values[i]);
        let cover = step(mossy, mossy + 0.5, green.values[i]) * 0.7;
        let height = if birch { 0.8 } else { 9.0 } * plate + 1.2 * fine.values[i];
        Texel { color: blend(color, moss, cover), rough: 0.92, height }
    })
}

/// A leaf: a midrib along u at half of v, side veins, and the tissue between. One leaf to a period.
pub fn leaf(draw: &mut Stream, size: Size) -> Skin {
    let autumn = draw.chance(0.2);
    let (r, g, b) = if autumn {
        *draw.pick(&[(196.0, 120.0, 36.0), (170.0, 62.0, 34.0), (206.0, 168.0, 52.0)])
    } else {
        *draw.pick(&[(74.0, 116.0, 42.0), (96.0, 138.0, 54.0), (54.0, 98.0, 50.0), (118.0, 146.0, 72.0)])
    };
    let body = eye(r, g, b);
    let rib = blend(body, eye(206.0, 210.0, 140.0), 0.55);
    let pairs = 6.0 + draw.below(5) as f64;
    let lean = draw.range(0.5, 1.1);
    let net = Cells::new(size, draw.bits(), [36, 24], 0.95, |_, _| [0.0; 2]);
    let edge = net.edge();
    let blotch = Field::fractal(size, draw.bits(), [3, 3], 4, 0.55);
    let brown = eye(110.0, 80.0, 40.0);
    let ill = draw.range(0.7, 1.6);
    Skin::new(size, |i, u, v| {
        let off = (v - 0.5).abs();
        let mid = 1.0 - step(0.006, 0.018, off);
        let phase = fract((u + lean * off) * pairs);
        let side = (1.0 - step(0.02, 0.09, phase.min(1.0 - phase))) * (1.0 - step(0.3, 0.5, off));
        let vein = mid.max(0.7 * side);
        let mesh = 1.0 - step(0.0, 0.16, edge.values[i]);
        let tone = 1.0 + 0.18 * blotch.values[i] - 0.1 * mesh;
        let color = blend(shade(body, tone), rib, 0.8 * vein);
        let spot = step(ill, ill + 0.3, blotch.values[i]);
        // The blade bulges between its veins.
        let bulge = maths::sin(0.5 * TAU * phase);
        Texel { color: blend(color, brown, 0.8 * spot), rough: 0.6 + 0.1 * vein, height: 0.5 * bulge - 0.3 * mid }
    })
}

/// Blades of grass: fine ribs along v, paler to one end.
pub fn blade(draw: &mut Stream, size: Size) -> Skin {
    let (r, g, b) = *draw.pick(&[(92.0, 130.0, 48.0), (116.0, 142.0, 62.0), (72.0, 112.0, 46.0), (150.0, 148.0, 84.0)]);
    let body = eye(r, g, b);
    let rib = Field::noise(size, draw.bits(), [size[0] / 6, 2]);
    let tone = Field::fractal(size, draw.bits(), [4, 3], 3, 0.5);
    let dry = eye(176.0, 160.0, 96.0);
    Skin::new(size, |i, _, _| {
        let color = shade(body, 1.0 + 0.16 * rib.values[i] + 0.2 * tone.values[i]);
        let aged = 0.5 * step(0.5, 1.3, tone.values[i]);
        Texel { color: blend(color, dry, aged), rough: 0.65, height: 0.12 * rib.values[i] }
    })
}

/// Boards outdoors: planks that have gone gray, with wider gaps and nails.
pub fn weathered(draw: &mut Stream, size: Size) -> Skin {
    let mut skin = planks(draw, size);
    let gray = eye(142.0, 138.0, 130.0);
    let share = draw.range(0.7, 0.95);
    let cloud = Field::fractal(size, draw.bits(), [3, 12], 5, 0.6);
    let crack = Field::fractal(size, draw.bits(), [4, 60], 3, 0.6);
    skin.over(|i, _, _| {
        let bleached = (share + 0.25 * cloud.values[i]).clamp(0.0, 0.95);
        let color = shade(gray, 1.0 + 0.25 * crack.values[i] + 0.1 * cloud.values[i]);
        // Gaps and knots stay dark, as a part of what lies below stays.
        (0.8 * bleached, Texel { color, rough: 0.92, height: 0.5 * crack.values[i] })
    });
    skin.over(|_, u, v| {
        let (x, y) = (fract(u * 4.0) - 0.5, fract(v * 12.0));
        let off = (0.12 * (y - 0.2)).min(0.12 * (0.8 - y)).abs();
        let near = ((0.36 * x) * (0.36 * x) + off * off).sqrt();
        let head = 1.0 - step(0.002, 0.004, near);
        (head, Texel { color: eye(70.0, 62.0, 58.0), rough: 0.7, height: -0.4 })
    });
    skin
}
