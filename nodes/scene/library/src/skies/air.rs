//! Clear air: light of the sun that is scattered once in a flat layer of molecules and haze, plus a share for what is
//! scattered more often. Own formulation: phase functions of Rayleigh and of Henyey and Greenstein (1941), optical
//! depths by RGB, air masses that stay finite at the horizon, ozone along the sun's way.

use super::{Color, scaled, step};
use tauflow_data::geom::{Vec3, direction, dot};
use tauflow_data::{maths, rng::Stream};

const PI: f64 = core::f64::consts::PI;

/// Vertical optical depth of molecules at about 615, 535 and 445 nm.
const MOLECULES: Color = [0.062, 0.108, 0.232];
/// The absorption of ozone.
const OZONE: Color = [0.03, 0.028, 0.002];

/// Air under a sun of irradiance 1 above the air.
pub struct Air {
    /// Where the sun stands.
    pub sun: Vec3,
    /// Its light on a surface that faces it, on the ground.
    pub direct: Color,
    depth: Color,
    haze: Color,
    /// Air masses to the sun, and the share of the day's light that is left with the sun below the horizon.
    mass: f64,
    left: f64,
}

/// How much air is along a way of height `y` for each vertical one.
fn mass(y: f64) -> f64 {
    let y = y.max(0.0);
    1.0 / (y + 0.028 * maths::exp(-9.0 * y))
}

/// Scattering with mean cosine `g`, over the sphere 1.
fn forward(g: f64, cos: f64) -> f64 {
    let d = 1.0 + g * g - 2.0 * g * cos;
    (1.0 - g * g) / (4.0 * PI * d * d.sqrt())
}

impl Air {
    /// With the sun at an elevation of `elevation` radians, and `haze` as the vertical optical depth of haze.
    pub fn new(draw: &mut Stream, elevation: [f64; 2], haze: [f64; 2]) -> Self {
        let sun = direction(draw.range(0.0, core::f64::consts::TAU), draw.range(elevation[0], elevation[1]));
        let haze = draw.range(haze[0], haze[1]);
        let haze = [0.9 * haze, haze, 1.12 * haze];
        let depth = [0, 1, 2].map(|c| MOLECULES[c] + haze[c]);
        let mass = mass(sun[1]);
        let left = maths::exp(28.0 * sun[1].min(0.0));
        let shown = step(-0.01, 0.01, sun[1]);
        let direct = [0, 1, 2].map(|c| shown * maths::exp(-(depth[c] + OZONE[c]) * mass));
        Self { sun, direct, depth, haze, mass, left }
    }

    /// Radiance of the air towards `w`, without the sun's disc.
    pub fn radiance(&self, w: Vec3) -> Color {
        let cos = dot(w, self.sun);
        let m = mass(w[1]);
        let molecules = 3.0 / (16.0 * PI) * (1.0 + cos * cos);
        let haze = 0.8 * forward(0.72, cos) + 0.2 * forward(0.1, cos);
        // The earth's shadow rises against a sun that has set.
        let dark = if self.sun[1] < 0.0 { 1.0 - 0.6 * step(0.2, -1.0, cos) * step(0.5, 0.0, w[1]) } else { 1.0 };
        [0, 1, 2].map(|c| {
            let depth = self.depth[c];
            let share = (MOLECULES[c] * molecules + self.haze[c] * haze) / depth;
            // Light that comes down through `mass` and is scattered towards us through `m`, over the layer.
            let apart = m - self.mass;
            let once = if apart.abs() < 1e-3 {
                depth * m * maths::exp(-depth * m)
            } else {
                m / apart * (maths::exp(-depth * self.mass) - maths::exp(-depth * m))
            };
            let often = (1.0 - maths::exp(-depth * m)) * (1.0 - maths::exp(-2.0 * depth)) / (4.0 * PI)
                * maths::exp(-0.35 * depth * self.mass);
            let ozone = maths::exp(-OZONE[c] * self.mass);
            (share * once + 1.2 * often) * ozone * self.left * dark
        })
    }

    /// Irradiance of the air on level ground, by a few directions.
    pub fn diffuse(&self) -> Color {
        let mut sum = [0.0; 3];
        let mut weight = 0.0;
        for i in 0..8 {
            for j in 0..5 {
                let elevation = (f64::from(j) + 0.5) * 0.1 * PI;
                let w = direction(f64::from(i) * 0.25 * PI, elevation);
                let share = maths::cos(elevation) * w[1];
                let c = self.radiance(w);
                sum = [0, 1, 2].map(|k| sum[k] + share * c[k]);
                weight += share;
            }
        }
        scaled(sum, PI / weight)
    }

    /// What the sun's disc of `radius` radians adds towards `w`: its irradiance spread over the disc, soft at the rim.
    pub fn disc(&self, w: Vec3, radius: f64) -> Color {
        let cos = dot(w, self.sun);
        let (ends, full) = (maths::cos(1.25 * radius), maths::cos(0.75 * radius));
        if cos <= ends {
            return [0.0; 3];
        }
        let solid_angle = PI * (2.0 - ends - full);
        scaled(self.direct, step(ends, full, cos) / solid_angle)
    }
}
