//! Clouds on a plane overhead: fractal noise for how thick they are, lit through what lies towards the sun.

use super::{Color, step};
use crate::textures::field::Field;
use tauflow_data::geom::Vec3;
use tauflow_data::{maths, rng::Stream};

/// A layer of clouds.
pub struct Clouds {
    field: Field,
    fine: Field,
    /// Noise above which there is cloud, and over how much it grows thick.
    from: f64,
    over: f64,
    /// Optical depth of the thickest.
    depth: f64,
    /// Periods of the field a unit of the plane.
    scale: f64,
    /// Towards the sun on the plane.
    towards: [f64; 2],
}

impl Clouds {
    /// A layer; the lower `from`, the more of the sky it covers.
    pub fn new(draw: &mut Stream, from: f64, over: f64, depth: f64, sun: Vec3) -> Self {
        let k = 0.035 / (sun[1].max(0.0) + 0.25);
        Self {
            field: Field::fractal([256, 256], draw.bits(), [5, 5], 5, 0.52),
            fine: Field::fractal([256, 256], draw.bits(), [12, 12], 4, 0.6),
            from,
            over,
            depth,
            scale: draw.range(0.16, 0.3),
            towards: [sun[0] * k, sun[2] * k],
        }
    }

    fn thickness(&self, x: f64, z: f64) -> f64 {
        let n = self.field.sample(x * self.scale, z * self.scale);
        let n = n + 0.25 * self.fine.sample(x * self.scale * 1.7 + 0.3, z * self.scale * 1.7);
        step(self.from, self.from + self.over, n)
    }

    /// How much of what lies behind is hidden towards `w`, and how much sun reaches the cloud there, both 0 to 1.
    pub fn at(&self, w: Vec3) -> (f64, f64) {
        if w[1] <= 0.0 {
            return (0.0, 1.0);
        }
        let k = 1.0 / (w[1] + 0.09);
        let (x, z) = (w[0] * k, w[2] * k);
        let own = self.thickness(x, z);
        if own <= 0.0 {
            return (0.0, 1.0);
        }
        let mut way = 0.5 * own;
        for i in 1..4 {
            let t = f64::from(i);
            way += self.thickness(x + t * self.towards[0] / self.scale, z + t * self.towards[1] / self.scale);
        }
        let hidden = 1.0 - maths::exp(-self.depth * own);
        (hidden, maths::exp(-0.55 * way))
    }
}

/// Radiance of a cloud: sun that comes through and back, and the sky's light from all sides.
pub fn lit(sun: Color, sky: Color, through: f64, cos: f64) -> Color {
    // Thin parts near the sun glow.
    let silver = 1.0 + 1.6 * maths::exp(-14.0 * (1.0 - cos)) * through;
    let share = (0.12 + 0.88 * through) * silver / core::f64::consts::PI;
    [0, 1, 2].map(|c| 0.75 * sun[c] * share + 0.9 * sky[c] / core::f64::consts::PI)
}
