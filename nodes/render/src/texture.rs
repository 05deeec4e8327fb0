//! Values over surfaces. Definitions of Mitsuba 3's `bitmap` (bilinear, raw) and `checkerboard`.

use crate::{
    bsdf::{Points, Surface},
    lanes::{Integer, Pair, Real, Triple},
    texels::Texels,
};
use glam::{Vec2, Vec3};
use std::sync::Arc;
use tauflow_contract::{Digest, KindError};
use tauflow_data::scene;

/// Hands out the image of a blob.
pub type LoadBitmap<'a> = &'a mut dyn FnMut(&Digest) -> Result<Arc<Texels>, KindError>;

/// A texture ready to be read.
#[derive(Clone, Debug)]
pub enum Texture {
    /// The same everywhere.
    Constant(Vec3),
    /// Two colours in squares.
    Checkerboard {
        /// Colours of even and odd squares.
        colors: [Vec3; 2],
        /// Squares a unit of uv.
        scale: Vec2,
    },
    /// An image.
    Bitmap(Bitmap),
    /// The mesh's vertex colours.
    VertexColor {
        /// Factor.
        scale: Vec3,
        /// One channel, or RGB.
        channel: Option<u8>,
    },
    /// The product of several.
    Product(Vec<Texture>),
}

/// An image over uv.
#[derive(Clone, Debug)]
pub struct Bitmap {
    texels: Arc<Texels>,
    rows: [[f32; 3]; 2],
    scale: Vec3,
    channel: Option<u8>,
    clamp: bool,
}

impl Texture {
    /// Compiles a texture.
    ///
    /// # Errors
    /// If an image is missing, damaged or empty, or a number of the description is not finite in single precision.
    pub fn compile(texture: &scene::Texture, load: LoadBitmap<'_>) -> Result<Self, KindError> {
        let single = |values: &[f64]| -> Result<(), KindError> {
            if values.iter().all(|v| (*v as f32).is_finite()) {
                Ok(())
            } else {
                Err(KindError::Input(format!(
                    "a texture with coordinates scaled by {values:?}; use finite numbers of single precision"
                )))
            }
        };
        let rgb = |value: &scene::Rgb| -> Result<Vec3, KindError> {
            if value.iter().all(|v| v.is_finite()) {
                Ok(Vec3::from_array(*value))
            } else {
                Err(KindError::Input(format!("a texture has the value {value:?}; use finite numbers")))
            }
        };
        Ok(match texture {
            scene::Texture::Constant { value } => Self::Constant(rgb(value)?),
            scene::Texture::Checkerboard { color0, color1, scale } => {
                single(scale)?;
                Self::Checkerboard {
                    colors: [rgb(color0)?, rgb(color1)?],
                    scale: Vec2::new(scale[0] as f32, scale[1] as f32),
                }
            }
            scene::Texture::Bitmap { image, uv, scale, channel, clamp } => {
                single(uv.as_flattened())?;
                let pixels = load(image)?;
                if pixels.width() == 0 || pixels.height() == 0 || ![1, 3, 4].contains(&pixels.channels()) {
                    return Err(KindError::Input(format!(
                        "image {} has {} x {} pixels of {} channels; a texture has 1, 3 or 4 and is not empty",
                        image.short(),
                        pixels.width(),
                        pixels.height(),
                        pixels.channels()
                    )));
                }
                Self::Bitmap(Bitmap {
                    texels: pixels,
                    rows: uv.map(|row| row.map(|v| v as f32)),
                    scale: rgb(scale)?,
                    channel: *channel,
                    clamp: *clamp,
                })
            }
            scene::Texture::VertexColor { scale, channel } => {
                Self::VertexColor { scale: rgb(scale)?, channel: *channel }
            }
            scene::Texture::Product { a, b } => Self::compile(a, load)?.times(Self::compile(b, load)?),
        })
    }

    /// The product with another; no product holds a product.
    pub(crate) fn times(self, other: Self) -> Self {
        let mut factors = Vec::new();
        for texture in [self, other] {
            match texture {
                Self::Product(own) => factors.extend(own),
                simple => factors.push(simple),
            }
        }
        Self::Product(factors)
    }

    /// Whether it has values below 0 anywhere; of products, any factor.
    pub(crate) fn is_negative(&self) -> bool {
        match self {
            Self::Constant(value) => value.min_element() < 0.0,
            Self::Checkerboard { colors, .. } => colors.iter().any(|c| c.min_element() < 0.0),
            Self::Bitmap(bitmap) => {
                bitmap.scale.min_element() < 0.0 || bitmap.texels.values().0.iter().any(|v| *v < 0.0)
            }
            Self::VertexColor { scale, .. } => scale.min_element() < 0.0,
            Self::Product(factors) => factors.iter().any(Self::is_negative),
        }
    }

    /// Whether it reads texture coordinates.
    pub(crate) fn reads_uv(&self) -> bool {
        match self {
            Self::Constant(_) | Self::VertexColor { .. } => false,
            Self::Checkerboard { .. } | Self::Bitmap(_) => true,
            Self::Product(factors) => factors.iter().any(Self::reads_uv),
        }
    }

    /// Whether it reads vertex colours.
    pub(crate) fn reads_colors(&self) -> bool {
        match self {
            Self::VertexColor { .. } => true,
            Self::Constant(_) | Self::Checkerboard { .. } | Self::Bitmap(_) => false,
            Self::Product(factors) => factors.iter().any(Self::reads_colors),
        }
    }

    /// Its value at a point of a surface.
    pub fn eval(&self, at: &Surface) -> Vec3 {
        self.at(&at.into()).into()
    }

    /// Its value where it is used as a number.
    pub fn scalar(&self, at: &Surface) -> f32 {
        self.at(&at.into()).x
    }

    /// The change of its first channel along u and along v; none where it is no picture.
    ///
    /// Mitsuba multiplies by the picture's sides after it has mapped coordinates back, and so does this.
    pub(crate) fn slopes(&self, at: &Surface) -> Vec2 {
        match self {
            Self::Bitmap(bitmap) => bitmap.slopes(at.uv),
            Self::Constant(_) | Self::Checkerboard { .. } | Self::VertexColor { .. } | Self::Product(_) => Vec2::ZERO,
        }
    }

    /// Its value at a point.
    pub(crate) fn at(&self, at: &Points<f32>) -> Triple<f32> {
        self.lanes::<f32>(at)
    }

    /// Its values at points, lane after lane unless it is constant: for what is rarely anything else.
    #[inline(always)]
    pub(crate) fn one_by_one<R: Real>(&self, at: &Points<R>) -> Triple<R> {
        if let Self::Constant(value) = self {
            return Triple::splat(*value);
        }
        let mut rows = [[0.0f32; 16]; 9];
        at.uv.x.store(&mut rows[0]);
        at.uv.y.store(&mut rows[1]);
        at.color.x.store(&mut rows[2]);
        at.color.y.store(&mut rows[3]);
        at.color.z.store(&mut rows[4]);
        at.alpha.store(&mut rows[5]);
        self.rows(&mut rows, R::N);
        Triple::load([&rows[6], &rows[7], &rows[8]], 0)
    }

    #[inline(never)]
    fn rows(&self, rows: &mut [[f32; 16]; 9], lanes: usize) {
        let [us, vs, reds, greens, blues, alphas, x, y, z] = rows;
        for lane in 0..lanes.min(16) {
            let uv = Pair::new(us[lane], vs[lane]);
            let color = Triple::new(reds[lane], greens[lane], blues[lane]);
            let value = self.at(&Points { uv, color, alpha: alphas[lane] });
            (x[lane], y[lane], z[lane]) = (value.x, value.y, value.z);
        }
    }

    /// Its values at points, by lane.
    #[inline(always)]
    pub(crate) fn lanes<R: Real>(&self, at: &Points<R>) -> Triple<R> {
        match self {
            Self::Product(factors) => {
                let mut product = Triple::all(R::one());
                for factor in factors {
                    product *= factor.simple(at);
                }
                product
            }
            simple => simple.simple(at),
        }
    }

    #[inline(always)]
    fn simple<R: Real>(&self, at: &Points<R>) -> Triple<R> {
        match self {
            Self::Constant(value) => Triple::splat(*value),
            Self::Checkerboard { colors, scale } => {
                // The sum of two whole numbers is odd if and only if half of it is not whole.
                let half = ((at.uv.x * scale.x).floor() + (at.uv.y * scale.y).floor()) * 0.5;
                Triple::select(half.equals(half.floor()), Triple::splat(colors[0]), Triple::splat(colors[1]))
            }
            Self::Bitmap(bitmap) => bitmap.lanes(at),
            Self::VertexColor { scale, channel } => {
                let color = match channel {
                    None => at.color,
                    Some(0) => Triple::all(at.color.x),
                    Some(1) => Triple::all(at.color.y),
                    Some(2) => Triple::all(at.color.z),
                    Some(_) => Triple::all(at.alpha),
                };
                color * Triple::splat(*scale)
            }
            Self::Product(_) => Triple::all(R::one()),
        }
    }
}

impl Bitmap {
    /// The image's texels.
    pub(crate) fn texels(&self) -> &Texels {
        &self.texels
    }

    /// Factor on the image's values.
    pub(crate) fn scale(&self) -> Vec3 {
        self.scale
    }

    /// The one channel that all three values are read from, if there is one; beyond those of the image it is 1.
    #[inline(always)]
    fn single(&self) -> Option<u8> {
        match (self.channel, self.texels.channels()) {
            (Some(channel), 1) if channel < 3 => Some(0),
            (Some(channel), _) => Some(channel),
            (None, 1) => Some(0),
            (None, _) => None,
        }
    }

    /// The channel of the image that a value is read from; none where it is 1.
    pub(crate) fn reads(&self, value: usize) -> Option<usize> {
        Some(self.single().map_or(value, usize::from)).filter(|channel| *channel < self.texels.channels())
    }

    #[inline(always)]
    fn lanes<R: Real>(&self, at: &Points<R>) -> Triple<R> {
        let [a, b] = &self.rows;
        let (width, height, channels) = (self.texels.width(), self.texels.height(), self.texels.channels());
        let x = (at.uv.x * a[0] + at.uv.y * a[1] + a[2]) * width as f32 - 0.5;
        let y = (at.uv.x * b[0] + at.uv.y * b[1] + b[2]) * height as f32 - 0.5;
        let sound = x.finite() & y.finite();
        let (left, top) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - top);
        let (x0, x1) = (self.place(left, width), self.place(left + 1.0, width));
        let (y0, y1) = (self.place(top, height), self.place(top + 1.0, height));
        let (row, step) = (R::Integer::splat(width as i32), R::Integer::splat(channels as i32));
        let texels = &*self.texels;
        let corners = [(y0 * row + x0) * step, (y0 * row + x1) * step, (y1 * row + x0) * step, (y1 * row + x1) * step];
        macro_rules! mix {
            ($channel:expr) => {{
                let [a, b, c, d] = corners;
                let channel = usize::from($channel);
                let upper = texels.read::<R>(a, channel) * (R::one() - fx) + texels.read::<R>(b, channel) * fx;
                let lower = texels.read::<R>(c, channel) * (R::one() - fx) + texels.read::<R>(d, channel) * fx;
                upper * (R::one() - fy) + lower * fy
            }};
        }
        let value = match self.single() {
            None => Triple::new(mix!(0u8), mix!(1u8), mix!(2u8)),
            Some(channel) if usize::from(channel) < channels => Triple::all(mix!(channel)),
            // An image without alpha is opaque.
            Some(_) => Triple::all(R::one()),
        };
        (value * Triple::splat(self.scale)).only(sound)
    }

    fn slopes(&self, uv: Vec2) -> Vec2 {
        let [a, b] = &self.rows;
        let (width, height, channels) = (self.texels.width(), self.texels.height(), self.texels.channels());
        let x = (uv.x * a[0] + uv.y * a[1] + a[2]) * width as f32 - 0.5;
        let y = (uv.x * b[0] + uv.y * b[1] + b[2]) * height as f32 - 0.5;
        let Some(channel) = self.reads(0).filter(|_| x.is_finite() && y.is_finite()) else { return Vec2::ZERO };
        let (left, top) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - top);
        let texel = |x: f32, y: f32| {
            let at = (self.place(y, height) as usize * width + self.place(x, width) as usize) * channels;
            self.texels.read::<f32>(at as i32, channel)
        };
        let (upper, lower) =
            ([texel(left, top), texel(left + 1.0, top)], [texel(left, top + 1.0), texel(left + 1.0, top + 1.0)]);
        let along = (upper[1] - upper[0]) * (1.0 - fy) + (lower[1] - lower[0]) * fy;
        let across = (lower[0] - upper[0]) * (1.0 - fx) + (lower[1] - upper[1]) * fx;
        let (width, height) = (width as f32, height as f32);
        Vec2::new(width * (a[0] * along + b[0] * across), height * (a[1] * along + b[1] * across)) * self.scale.x
    }

    /// Column or row of a texel, repeated or clamped; beyond 2^24 one is as good as another.
    #[inline(always)]
    fn place<R: Real>(&self, at: R, size: usize) -> R::Integer {
        let wrapped = if self.clamp { at } else { at - (at / size as f32).floor() * size as f32 };
        wrapped.clamp(0.0, (size - 1) as f32).to_integer()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec4;
    use tauflow_data::Image;

    fn at(u: f32, v: f32) -> Surface {
        Surface { uv: Vec2::new(u, v), color: Vec4::new(0.1, 0.2, 0.3, 0.4) }
    }

    fn bitmap(clamp: bool, channel: Option<u8>) -> Texture {
        let image = Image::from_data(2, 1, 3, vec![0.0, 0.0, 0.0, 1.0, 2.0, 4.0]).expect("fits");
        let texture = scene::Texture::Bitmap {
            image: Digest::of(b"x"),
            uv: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            scale: [1.0, 1.0, 0.5],
            channel,
            clamp,
        };
        Texture::compile(&texture, &mut |_| Ok(Arc::new(image.clone().into()))).expect("a sound image")
    }

    #[test]
    fn bitmaps_are_bilinear_and_repeat_or_clamp() {
        let repeated = bitmap(false, None);
        assert_eq!(repeated.eval(&at(0.25, 0.5)), Vec3::ZERO);
        assert_eq!(repeated.eval(&at(0.75, 0.3)), Vec3::new(1.0, 2.0, 2.0));
        assert_eq!(repeated.eval(&at(0.5, 0.5)), Vec3::new(0.5, 1.0, 1.0));
        assert_eq!(repeated.eval(&at(0.0, 0.5)), Vec3::new(0.5, 1.0, 1.0));
        assert_eq!(repeated.eval(&at(-0.25, 7.5)), Vec3::new(1.0, 2.0, 2.0));
        assert_eq!(bitmap(true, None).eval(&at(0.0, 0.5)), Vec3::ZERO);
        assert_eq!(bitmap(true, Some(1)).scalar(&at(9.0, 0.5)), 2.0);
        assert_eq!(bitmap(false, Some(3)).scalar(&at(0.3, 0.5)), 1.0);
        assert_eq!(repeated.eval(&at(f32::NAN, 0.5)), Vec3::ZERO);
    }

    #[test]
    fn squares_and_products() {
        let squares = Texture::Checkerboard { colors: [Vec3::ONE, Vec3::ZERO], scale: Vec2::new(2.0, 4.0) };
        assert_eq!(squares.eval(&at(0.1, 0.1)), Vec3::ONE);
        assert_eq!(squares.eval(&at(0.6, 0.1)), Vec3::ZERO);
        assert_eq!(squares.eval(&at(-0.1, 0.1)), Vec3::ZERO);
        assert_eq!(squares.eval(&at(0.6, 0.3)), Vec3::ONE);
        let color = Texture::VertexColor { scale: Vec3::splat(2.0), channel: None };
        let product = color.times(Texture::Constant(Vec3::new(1.0, 0.5, 0.0)));
        assert!((product.eval(&at(0.0, 0.0)) - Vec3::new(0.2, 0.2, 0.0)).length() < 1e-7);
    }
}
