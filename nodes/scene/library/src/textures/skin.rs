//! Maps that belong together: colour, roughness and normals of one stuff, and their exact 8-bit forms.

use super::field::{Field, Size};
use tauflow_data::{Image, maths, mesh::Bitmap};

/// Linear RGB.
pub type Color = [f64; 3];

/// A colour as one picks it by eye, in 0 to 255, as linear RGB by the power 2.2.
pub fn eye(r: f64, g: f64, b: f64) -> Color {
    [r, g, b].map(|c| maths::pow(c / 255.0, 2.2))
}

/// Between two colours.
pub fn blend(a: Color, b: Color, t: f64) -> Color {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

/// A colour times a factor.
pub fn shade(a: Color, k: f64) -> Color {
    a.map(|c| c * k)
}

/// One texel of a stuff.
#[derive(Clone, Copy)]
pub struct Texel {
    /// Albedo, linear RGB.
    pub color: Color,
    /// Perceptual roughness, relative: the material sets its level.
    pub rough: f64,
    /// Height in millimetres.
    pub height: f64,
}

/// Texels of one period.
pub struct Skin {
    size: Size,
    colors: Vec<Color>,
    rough: Vec<f64>,
    height: Field,
}

/// The maps of one stuff.
pub struct Maps {
    /// Albedo: linear, 1 or 3 channels, of the form `(k / 255)^2`.
    pub color: Bitmap,
    /// Perceptual roughness, one channel of `k / 255`.
    pub roughness: Bitmap,
    /// Normals as (n + 1) / 2, three channels of `k / 255`; none where it is flat.
    pub normal: Option<Bitmap>,
}

impl Skin {
    /// Of `f(index, u, v)` at the texels' centres; the index is that of a [`Field`]'s values.
    pub fn new(size: Size, mut f: impl FnMut(usize, f64, f64) -> Texel) -> Self {
        let count = size[0] * size[1];
        let mut skin = Self {
            size,
            colors: Vec::with_capacity(count),
            rough: Vec::with_capacity(count),
            height: Field { size, values: Vec::with_capacity(count) },
        };
        for y in 0..size[1] {
            let v = (y as f64 + 0.5) / size[1] as f64;
            for x in 0..size[0] {
                let texel = f(y * size[0] + x, (x as f64 + 0.5) / size[0] as f64, v);
                skin.colors.push(texel.color);
                skin.rough.push(texel.rough);
                skin.height.values.push(texel.height);
            }
        }
        skin
    }

    /// Puts a layer over it where `f` gives a weight above 0.
    pub fn over(&mut self, mut f: impl FnMut(usize, f64, f64) -> (f64, Texel)) {
        let [width, height] = self.size;
        for i in 0..width * height {
            let (u, v) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let (weight, texel) = f(i, u / width as f64, v / height as f64);
            if weight > 0.0 {
                self.colors[i] = blend(self.colors[i], texel.color, weight);
                self.rough[i] += (texel.rough - self.rough[i]) * weight;
                self.height.values[i] += texel.height * weight;
            }
        }
    }

    /// Its maps; `period` is the size of the whole in metres, and `gray` keeps one channel of colour.
    pub fn maps(&self, period: [f64; 2], gray: bool) -> Maps {
        let [width, height] = self.size;
        let image = |channels, data| Image::from_data(width, height, channels, data).expect("the shape is the data's");
        let color = if gray {
            let luminance = |c: &Color| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
            image(1, self.colors.iter().map(|c| squared(luminance(c))).collect())
        } else {
            image(3, self.colors.iter().flat_map(|c| c.map(squared)).collect())
        };
        Maps {
            color,
            roughness: image(1, self.rough.iter().map(|v| byte(v.max(0.02))).collect()),
            normal: self.normals(period).map(|data| image(3, data)),
        }
    }

    /// Normals by central differences of the heights, the second component upwards in the image (against v), as the
    /// renderer and glTF have it; none where nothing leans by more than half a degree.
    fn normals(&self, period: [f64; 2]) -> Option<Vec<f32>> {
        let [width, height] = self.size;
        // Millimetres over two texels.
        let scale = [0, 1].map(|i| 1e-3 * self.size[i] as f64 / (2.0 * period[i]));
        let (mut data, mut most) = (Vec::with_capacity(width * height * 3), 0.0f64);
        for y in 0..height as i64 {
            for x in 0..width as i64 {
                let du = (self.height.at(x + 1, y) - self.height.at(x - 1, y)) * scale[0];
                let dv = (self.height.at(x, y + 1) - self.height.at(x, y - 1)) * scale[1];
                most = most.max(du * du + dv * dv);
                // Heights of texels are coarser than real flanks: none leans by more than 60 degrees.
                let steep = (du * du + dv * dv).sqrt().max(1e-12);
                let kept = (1.7 / steep).min(1.0);
                let (du, dv) = (du * kept, dv * kept);
                let inverse = 1.0 / (1.0 + du * du + dv * dv).sqrt();
                data.extend([-du * inverse, dv * inverse, inverse].map(|n| byte(0.5 * (n + 1.0))));
            }
        }
        (most > 0.009 * 0.009).then_some(data)
    }
}

/// The nearest `k / 255`.
pub fn byte(v: f64) -> f32 {
    (v.clamp(0.0, 1.0) * 255.0).round() as f32 / 255.0
}

/// The nearest `(k / 255)^2` by its root: dark tones keep their steps.
pub fn squared(v: f64) -> f32 {
    let root = byte(v.clamp(0.0, 1.0).sqrt());
    root * root
}
