//! A few colours that go together, and the variants that a scene prefers.

use tauflow_data::{maths, rng::Stream, scene::Rgb};

/// A few colours that go together; linear RGB, largest channel 1.
pub struct Palette {
    colors: Vec<[f64; 3]>,
    /// The source of the scene's preferred variants.
    house: Stream,
}

fn hsv(h: f64, s: f64, v: f64) -> [f64; 3] {
    // Display-referred, then to linear by the power 2.2: palettes are picked by eye.
    [0.0, 4.0, 2.0].map(|shift| {
        let k = (h * 6.0 + shift) % 6.0;
        let t = ((k - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        maths::pow(v * (1.0 - s + s * t), 2.2)
    })
}

impl Palette {
    /// A palette: a base hue, and others by a scheme of harmony.
    pub fn new(draw: &mut Stream) -> Self {
        let base = draw.uniform();
        let hues: &[f64] = match draw.below(4) {
            0 => &[0.0, 0.06, -0.06, 0.5],
            1 => &[0.0, 0.33, 0.67, 0.05],
            2 => &[0.0, 0.5, 0.46, 0.08],
            _ => &[0.0, 0.08, 0.16, -0.08],
        };
        let saturation = draw.range(0.25, 0.75);
        let mut colors: Vec<[f64; 3]> = hues
            .iter()
            .map(|shift| {
                let h = base + shift + 1.0 + draw.range(-0.02, 0.02);
                let s = (saturation * draw.range(0.7, 1.3)).min(0.85);
                hsv(h - h.floor(), s, 1.0)
            })
            .collect();
        colors.push(hsv(base, 0.06, 1.0));
        Self { colors, house: draw.part("house") }
    }

    /// One of its colours.
    pub fn pick(&self, draw: &mut Stream) -> [f64; 3] {
        *draw.pick(&self.colors)
    }

    /// A pale tone of one of its colours, for walls and floors.
    pub fn pale(&self, draw: &mut Stream) -> [f64; 3] {
        let t = draw.range(0.55, 0.95);
        self.pick(draw).map(|c| c + (1.0 - c) * t)
    }

    /// The stream that a choice comes from: the scene's own three times in five, so that its woods, say, are mostly
    /// one wood, else the part's.
    pub fn house(&self, what: &str, draw: &mut Stream) -> Stream {
        if draw.chance(0.6) { self.house.part(what) } else { draw.part(what) }
    }
}

/// Scales a colour to a largest channel within `range`.
pub fn within(color: [f64; 3], range: [f64; 2], draw: &mut Stream) -> Rgb {
    let level = draw.range(range[0], range[1]);
    at_level(color, level)
}

/// Scales a colour to a largest channel of `level`.
pub fn at_level(color: [f64; 3], level: f64) -> Rgb {
    let most = color[0].max(color[1]).max(color[2]).max(1e-6);
    color.map(|c| (c / most * level) as f32)
}
