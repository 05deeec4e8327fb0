//! Environments out of doors: air, sun and clouds above, a skyline around, ground below.

use super::{
    Color,
    air::Air,
    clouds::{Clouds, lit},
    mix3, scaled, step,
};
use crate::textures::field::{Field, fract, hash};
use tauflow_data::{
    geom::{Vec3, dot},
    maths,
    rng::Stream,
};

const TAU: f64 = core::f64::consts::TAU;

/// The surroundings: height and colour.
struct Skyline {
    field: Field,
    town: bool,
    seed: u64,
    high: f64,
    albedo: Color,
}

impl Skyline {
    fn new(draw: &mut Stream, town: bool) -> Self {
        let albedo = if town { [0.32, 0.29, 0.26] } else { *draw.pick(&[[0.07, 0.1, 0.05], [0.12, 0.11, 0.07]]) };
        Self {
            field: Field::fractal([1024, 8], draw.bits(), [7, 1], 7, 0.62),
            town,
            seed: draw.bits(),
            high: if draw.chance(0.15) { 0.0 } else { draw.range(0.04, 0.2) },
            albedo,
        }
    }

    /// Height of the skyline at an azimuth (as a share of a turn), the sine of its elevation.
    fn height(&self, turn: f64) -> f64 {
        let hills = self.high * (0.45 + 0.6 * self.field.sample(turn, 0.5)).max(0.0);
        if !self.town {
            return hills;
        }
        let block = (turn * 90.0).floor() as i64;
        let own = hash(self.seed, [block, 0]);
        (0.3 * hills).max(self.high * (0.25 + 1.1 * own * own))
    }

    /// How much of a window there is at an azimuth and height, and its own number.
    fn window(&self, turn: f64, y: f64) -> (f64, f64) {
        let (x, row) = (turn * 720.0, y * 110.0);
        let id = hash(self.seed ^ 5, [x.floor() as i64, row.floor() as i64]);
        let inside = (fract(x) - 0.5).abs() < 0.3 && (fract(row) - 0.5).abs() < 0.3;
        (f64::from(u8::from(self.town && inside)), id)
    }
}

/// Radiance by direction.
pub fn radiance(name: &str, draw: &Stream) -> Box<dyn Fn(Vec3) -> Color> {
    let mut d = draw.part("air");
    let degrees = |low: f64, high: f64| [low.to_radians(), high.to_radians()];
    // Elevation of the sun, haze, radius of its disc in degrees (0: hidden), where clouds begin, how thick they are.
    let (elevation, haze, disc, clouds): ([f64; 2], [f64; 2], [f64; 2], Option<[f64; 3]>) = match name {
        "afternoon" => (degrees(22.0, 42.0), [0.03, 0.14], [0.8, 1.3], None),
        "noon" => (degrees(45.0, 70.0), [0.02, 0.12], [0.8, 1.3], None),
        "morning" => (degrees(7.0, 14.0), [0.04, 0.1], [0.9, 1.6], Some([0.35, 0.5, 2.0])),
        "fair" => (degrees(25.0, 62.0), [0.03, 0.12], [0.8, 1.3], Some([0.08, 0.45, 5.0])),
        "hazy" => (degrees(18.0, 50.0), [0.5, 0.9], [5.0, 9.0], Some([0.1, 0.9, 0.8])),
        "cloudy" => (degrees(25.0, 60.0), [0.1, 0.25], [0.0, 0.0], Some([-0.42, 0.7, 6.0])),
        "overcast" => (degrees(25.0, 60.0), [0.2, 0.4], [0.0, 0.0], Some([-1.4, 1.9, 5.0])),
        "fog" => (degrees(20.0, 60.0), [0.5, 0.9], [0.0, 0.0], Some([-2.6, 2.0, 9.0])),
        "dusk" => (degrees(-5.0, -0.5), [0.05, 0.2], [0.0, 0.0], Some([0.0, 0.7, 1.4])),
        _ => (degrees(-3.0, -2.0), [0.05, 0.2], [0.0, 0.0], Some([0.1, 0.8, 0.8])),
    };
    let night = name == "night";
    let covered = matches!(name, "overcast" | "fog" | "cloudy");
    let air = Air::new(&mut d, elevation, haze);
    let radius = d.range(disc[0], disc[1]).to_radians();
    let thin = d.chance(0.5);
    let clouds = match clouds {
        Some([from, over, depth]) => {
            Some(Clouds::new(&mut d, from + d_range(draw, "cover", 0.12), over, depth, air.sun))
        }
        // Wisps in a clear sky, now and then.
        None if thin => Some(Clouds::new(&mut d, 0.3, 1.2, 0.7, air.sun)),
        None => None,
    };
    let mut g = draw.part("ground");
    let town = night || g.chance(0.45);
    let skyline = Skyline::new(&mut g.part("skyline"), town);
    let soil = *g.pick(&[[0.1, 0.13, 0.06], [0.2, 0.19, 0.18], [0.26, 0.22, 0.16], [0.16, 0.14, 0.11]]);
    let patch = Field::fractal([256, 256], g.bits(), [6, 6], 5, 0.6);
    let glow_seed = g.bits();
    let lights = Field::fractal([256, 8], g.bits(), [5, 1], 4, 0.6);
    let fogged = if name == "fog" { 0.85 } else { 0.0 };
    let above = air.diffuse();
    // The light of the clouds: the reddened sun, with a minimum after sunset.
    let through = if covered { 0.12 } else { 1.0 };
    let sunlit = if air.sun[1] > 0.0 { air.direct } else { scaled(air.radiance([air.sun[0], 0.06, air.sun[2]]), 1.2) };
    let level = air.sun[1].max(0.0) * through;
    let onto = [0, 1, 2].map(|c| air.direct[c] * level + above[c]);
    let moon = draw.part("moon").range(0.5, 1.1);
    let moon_at = tauflow_data::geom::direction(draw.part("moon at").range(0.0, TAU), moon);
    // Light of the night beside the little that the sun has left.
    let dark: f64 = if night { 0.006 } else { 1.0 };
    Box::new(move |w| {
        let turn = fract(maths::atan2(w[0], w[2]) / TAU);
        let horizon = skyline.height(turn);
        let away = step(horizon - 0.0035, horizon + 0.0035, w[1]);
        let mut out = [0.0; 3];
        if away > 0.0 {
            let up = [w[0], w[1].max(0.0), w[2]];
            let behind = scaled(air.radiance(up), dark);
            let disc = if radius > 0.0 { air.disc(w, radius) } else { [0.0; 3] };
            out = behind;
            let mut open = 1.0;
            if let Some(clouds) = &clouds {
                let (hidden, sun) = clouds.at(w);
                let cos = dot(w, air.sun);
                // Far clouds drown in haze; where the sun shows, they leave it free.
                let far = if covered { 1.0 } else { step(0.0, 0.08, w[1]) };
                let free = if radius > 0.0 { step(0.996, 0.97, cos) } else { 1.0 };
                let hidden = hidden * far * free;
                let white = lit(sunlit, above, sun, cos);
                // Under a closed cover the light is that of its upper side, spread: brighter overhead.
                let white = if covered { covering(&above, &air, w, sun) } else { white };
                out = mix3(out, scaled(white, dark), hidden);
                open = 1.0 - hidden;
            }
            out = [0, 1, 2].map(|c| out[c] + open * disc[c]);
            if night {
                out = heaven(out, w, open, &lights, turn, moon_at, glow_seed);
            }
            if fogged > 0.0 {
                let gray = 0.3 * (onto[0] + onto[1] + onto[2]) / core::f64::consts::PI;
                out = mix3(out, [gray * 0.97, gray, gray * 1.03], fogged * (1.0 - 0.5 * w[1].max(0.0)));
            }
        }
        if away < 1.0 {
            let below = if w[1] > 0.0 {
                let shade = 0.7 + 0.4 * hash(skyline.seed ^ 9, [(turn * 90.0).floor() as i64, 1]);
                let own = skyline.albedo.map(|a| a * shade);
                let facing = 0.35 + 0.65 * (0.5 - 0.5 * (w[0] * air.sun[0] + w[2] * air.sun[2]));
                let face = [0, 1, 2].map(|c| own[c] * (0.6 * above[c] + level.max(0.1) * air.direct[c] * facing));
                let (window, id) = skyline.window(turn, w[1]);
                let face = scaled(face, dark * 0.32 * (1.0 - 0.4 * window));
                let lamp = if night && id > 0.72 { 0.0006 * (0.3 + id) } else { 0.0 };
                [0, 1, 2].map(|c| face[c] + window * lamp * [1.0, 0.72, 0.4][c])
            } else {
                let k = 1.0 / (0.05 - w[1]);
                let (x, z) = (w[0] * k, w[2] * k);
                let fine = 0.7 * patch.sample(0.7 * x, 0.7 * z) * step(0.05, 0.4, -w[1]);
                let n = patch.sample(0.06 * x, 0.06 * z) * step(0.0, 0.2, -w[1]) + fine;
                let tone = (1.0 + 0.5 * n) * dark / core::f64::consts::PI;
                // At night lamps light it.
                let lamps = if night { 0.00012 * (1.0 + 0.5 * n) } else { 0.0 };
                [0, 1, 2].map(|c| soil[c] * (onto[c] * tone + lamps * [1.0, 0.75, 0.5][c]))
            };
            // Far things are seen through air.
            let hidden = if w[1] > -0.02 { 0.3 } else { 0.3 * step(-0.2, -0.02, w[1]) };
            let veil = scaled(air.radiance([w[0], 0.03, w[2]]), dark * if covered { 0.5 } else { 1.0 });
            let below = mix3(below, veil, hidden.max(fogged * step(-0.6, 0.0, w[1])));
            out = mix3(below, out, away);
        }
        out
    })
}

fn d_range(draw: &Stream, name: &str, amount: f64) -> f64 {
    draw.part(name).range(-amount, amount)
}

/// A closed cover from below: three times as bright overhead as at the horizon (Moon and Spencer 1942), with what
/// thick and thin parts make of it.
fn covering(above: &Color, air: &Air, w: Vec3, sun: f64) -> Color {
    let spread = (1.0 + 2.0 * w[1].max(0.0)) / 3.0;
    let near = 1.0 + 0.35 * maths::exp(-3.0 * (1.0 - dot(w, air.sun)));
    [0, 1, 2].map(|c| {
        let through = 0.3 * air.direct[c] * air.sun[1].max(0.0) + 0.5 * above[c];
        through * (0.55 + 0.75 * sun) * spread * near / core::f64::consts::PI * 1.6
    })
}

/// Stars, a moon, and the glow of towns on the horizon.
fn heaven(sky: Color, w: Vec3, open: f64, lights: &Field, turn: f64, moon: Vec3, seed: u64) -> Color {
    let glow = maths::exp(-9.0 * w[1].max(0.0)) * (0.5 + 1.2 * lights.sample(turn, 0.5)).max(0.05);
    let cell = [0, 1, 2].map(|c| (w[c] * 140.0).floor() as i64);
    let star = hash(seed, [cell[0] * 1000 + cell[1], cell[2]]);
    let star = if star > 0.9985 { 0.0012 * open * step(0.05, 0.3, w[1]) } else { 0.0 };
    let cos = dot(w, moon);
    let disc = step(maths::cos(0.035), maths::cos(0.024), cos) * open.max(0.3);
    let halo = 0.00012 * maths::exp(-60.0 * (1.0 - cos));
    [0, 1, 2].map(|c| {
        sky[c]
            + 0.00075 * glow * [1.0, 0.62, 0.32][c]
            + star
            + disc * 0.012 * [1.0, 0.97, 0.9][c]
            + halo
            + 0.00003 * [0.6, 0.75, 1.0][c]
    })
}
