//! Values over surfaces. Definitions of Mitsuba 3's `bitmap` (bilinear, raw) and `checkerboard`.

use crate::bsdf::Surface;
use glam::{Vec2, Vec3};
use std::sync::Arc;
use tauflow_contract::{Digest, KindError};
use tauflow_data::{Image, scene};

/// Hands out the image of a blob.
pub type LoadBitmap<'a> = &'a mut dyn FnMut(&Digest) -> Result<Image, KindError>;

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
    /// The product of two.
    Product(Box<(Texture, Texture)>),
}

/// An image over uv.
#[derive(Clone, Debug)]
pub struct Bitmap {
    image: Arc<Image>,
    rows: [[f32; 3]; 2],
    scale: Vec3,
    channel: Option<u8>,
    clamp: bool,
}

impl Texture {
    /// Compiles a texture.
    ///
    /// # Errors
    /// If an image is missing, damaged or empty, or a number is not finite.
    pub fn compile(texture: &scene::Texture, load: LoadBitmap<'_>) -> Result<Self, KindError> {
        let rgb = |value: &scene::Rgb| -> Result<Vec3, KindError> {
            if value.iter().all(|v| v.is_finite()) {
                Ok(Vec3::from_array(*value))
            } else {
                Err(KindError::Input(format!("a texture of value {value:?}; use finite numbers")))
            }
        };
        Ok(match texture {
            scene::Texture::Constant { value } => Self::Constant(rgb(value)?),
            scene::Texture::Checkerboard { color0, color1, scale } => Self::Checkerboard {
                colors: [rgb(color0)?, rgb(color1)?],
                scale: Vec2::new(scale[0] as f32, scale[1] as f32),
            },
            scene::Texture::Bitmap { image, uv, scale, channel, clamp } => {
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
                    image: Arc::new(pixels),
                    rows: uv.map(|row| row.map(|v| v as f32)),
                    scale: rgb(scale)?,
                    channel: *channel,
                    clamp: *clamp,
                })
            }
            scene::Texture::VertexColor { scale, channel } => {
                Self::VertexColor { scale: rgb(scale)?, channel: *channel }
            }
            scene::Texture::Product { a, b } => {
                Self::Product(Box::new((Self::compile(a, load)?, Self::compile(b, load)?)))
            }
        })
    }

    /// Its value at a point of a surface.
    #[inline]
    pub fn eval(&self, at: &Surface) -> Vec3 {
        match self {
            Self::Constant(value) => *value,
            Self::Checkerboard { colors, scale } => {
                let square = (at.uv * *scale).floor();
                // The sum of two whole numbers is odd if and only if half of it is not whole.
                let half = (square.x + square.y) * 0.5;
                colors[usize::from(half != half.floor())]
            }
            Self::Bitmap(bitmap) => bitmap.eval(at.uv),
            Self::VertexColor { scale, channel } => match channel {
                Some(channel) => Vec3::splat(at.color[usize::from(*channel).min(3)]) * *scale,
                None => at.color.truncate() * *scale,
            },
            Self::Product(both) => both.0.eval(at) * both.1.eval(at),
        }
    }

    /// Its value where it is used as a number.
    #[inline]
    pub fn scalar(&self, at: &Surface) -> f32 {
        self.eval(at).x
    }
}

impl Bitmap {
    #[inline]
    fn eval(&self, uv: Vec2) -> Vec3 {
        let [a, b] = &self.rows;
        let (width, height) = (self.image.width(), self.image.height());
        let x = (a[0] * uv.x + a[1] * uv.y + a[2]) * width as f32 - 0.5;
        let y = (b[0] * uv.x + b[1] * uv.y + b[2]) * height as f32 - 0.5;
        if !(x.is_finite() && y.is_finite()) {
            return Vec3::ZERO;
        }
        let (left, top) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - top);
        let place = |at: f32, size: usize| -> usize {
            // i64 holds every f32 below 2^63; beyond that one texel is as good as another.
            let at = at as i64;
            (if self.clamp { at.clamp(0, size as i64 - 1) } else { at.rem_euclid(size as i64) }) as usize
        };
        let (x0, x1) = (place(left, width), place(left + 1.0, width));
        let (y0, y1) = (place(top, height), place(top + 1.0, height));
        let upper = self.texel(x0, y0) * (1.0 - fx) + self.texel(x1, y0) * fx;
        let lower = self.texel(x0, y1) * (1.0 - fx) + self.texel(x1, y1) * fx;
        (upper * (1.0 - fy) + lower * fy) * self.scale
    }

    #[inline]
    fn texel(&self, x: usize, y: usize) -> Vec3 {
        let pixel = self.image.pixel(x, y);
        match (self.channel, pixel.len()) {
            (Some(channel), 1) if channel < 3 => Vec3::splat(pixel[0]),
            // An image without alpha is opaque.
            (Some(channel), _) => Vec3::splat(pixel.get(usize::from(channel)).copied().unwrap_or(1.0)),
            (None, 1) => Vec3::splat(pixel[0]),
            (None, _) => Vec3::new(pixel[0], pixel[1], pixel[2]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec4;

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
        Texture::compile(&texture, &mut |_| Ok(image.clone())).expect("a sound image")
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
        let product = Texture::Product(Box::new((color, Texture::Constant(Vec3::new(1.0, 0.5, 0.0)))));
        assert!((product.eval(&at(0.0, 0.0)) - Vec3::new(0.2, 0.2, 0.0)).length() < 1e-7);
    }
}
