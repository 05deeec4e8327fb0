//! The time of day of a scene.

use tauflow_data::{Regime, Stratum, rng::Stream};

/// The time of day, as factors of lamps, daylight and the sky.
pub struct Hour {
    /// Factor of lamps.
    pub lamps: f64,
    /// Factor of daylight behind windows.
    pub windows: f64,
    /// Factor of the sky.
    pub sky: f64,
}

impl Hour {
    /// An hour.
    pub fn draw(stratum: Stratum, d: &mut Stream) -> Self {
        let windows = match d.below(5) {
            0 | 1 => d.range(0.7, 1.3),
            2 | 3 => d.range(0.1, 0.5),
            _ => d.range(0.005, 0.03),
        };
        // Caustics are seen where small lamps outdo the broad light.
        let (windows, lamps) = match stratum.regime {
            Regime::L3 => (0.15 * windows, d.range(0.8, 1.6)),
            _ => (windows, d.range(0.3, 1.5)),
        };
        Self { lamps, windows, sky: d.range(0.5, 1.6) }
    }
}
