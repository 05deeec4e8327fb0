//! Textures as Mitsuba reads them: what its plugins do not multiply is worked into pictures and vertex colours.

use super::{Tint, Writer, rgb};
use crate::{
    Image,
    image_io::write_exr,
    scene::{Rgb, Texture},
};
use std::fmt::Write as _;
use tauflow_contract::{Digest, KindError};

/// A component of a normal that is encoded as (n + 1) / 2, scaled. It also holds for interpolated values, because it is
/// linear. Flat values are unchanged to the bit.
fn bent(value: f32, scale: f32) -> f32 {
    scale * (value - 0.5) + 0.5
}

/// A texture without constant factors: those of products go into the other factor.
pub(super) fn simplified(texture: &Texture) -> Texture {
    let Texture::Product { a, b } = texture else { return texture.clone() };
    let times = |scale: &Rgb, by: &Rgb| [0, 1, 2].map(|c| scale[c] * by[c]);
    match (simplified(a), simplified(b)) {
        (Texture::Constant { value }, other) | (other, Texture::Constant { value }) => match other {
            Texture::Constant { value: other } => Texture::Constant { value: times(&other, &value) },
            Texture::Checkerboard { color0, color1, scale } => {
                Texture::Checkerboard { color0: times(&color0, &value), color1: times(&color1, &value), scale }
            }
            Texture::Bitmap { image, uv, scale, channel, clamp } => {
                Texture::Bitmap { image, uv, scale: times(&scale, &value), channel, clamp }
            }
            Texture::VertexColor { scale, channel } => Texture::VertexColor { scale: times(&scale, &value), channel },
            product @ Texture::Product { .. } => {
                Texture::Product { a: Box::new(Texture::Constant { value }), b: Box::new(product) }
            }
        },
        (a, b) => Texture::Product { a: Box::new(a), b: Box::new(b) },
    }
}

impl Writer<'_> {
    /// The index of what a texture makes of vertex colours, if that is what it is.
    pub(super) fn tint(&mut self, texture: &Texture) -> Option<usize> {
        let Texture::VertexColor { scale, channel } = simplified(texture) else { return None };
        let tint = Tint { scale, channel };
        Some(self.tints.iter().position(|other| *other == tint).unwrap_or_else(|| {
            self.tints.push(tint);
            self.tints.len() - 1
        }))
    }

    /// Writes an image, once; `bend` is what the first two components of the normals that it encodes are scaled by.
    pub(super) fn image(
        &mut self,
        digest: &Digest,
        scale: &Rgb,
        channel: Option<u8>,
        bend: Option<f32>,
    ) -> Result<String, KindError> {
        let mut name = format!("image-{}", digest.short());
        if *scale != [1.0; 3] {
            let _ = write!(name, "-x{:08x}{:08x}{:08x}", scale[0].to_bits(), scale[1].to_bits(), scale[2].to_bits());
        }
        if let Some(channel) = channel {
            let _ = write!(name, "-c{channel}");
        }
        if let Some(bend) = bend {
            let _ = write!(name, "-n{:08x}", bend.to_bits());
        }
        name.push_str(".exr");
        if self.written.insert(name.clone()) {
            let image = Image::from_bytes(&(self.load)(digest)?)?;
            let count = image.channels();
            let read = |pixel: &[f32], c: usize| match (channel, count) {
                (Some(channel), 1) if channel < 3 => pixel[0],
                (Some(channel), _) => pixel.get(usize::from(channel)).copied().unwrap_or(1.0),
                (None, 1) => pixel[0],
                (None, _) => pixel[c],
            };
            let bent = |value: f32, c: usize| match bend {
                Some(scale) if c < 2 => bent(value, scale),
                _ => value,
            };
            let data = image
                .data()
                .chunks_exact(count)
                .flat_map(|pixel| [0, 1, 2].map(|c| bent(read(pixel, c) * scale[c], c)))
                .collect();
            let image = Image::from_data(image.width(), image.height(), 3, data)?;
            write_exr(&self.dir.join(&name), &[("", &image)])?;
        }
        Ok(name)
    }

    /// A texture in the role `name`; scalars are exported as the mean of equal channels, which is exact.
    pub(super) fn texture(&mut self, name: &str, texture: &Texture, scalar: bool) -> Result<(), KindError> {
        let texture = &simplified(texture);
        match texture {
            Texture::Constant { value } if scalar => self.float(name, value[0]),
            Texture::Constant { value } => self.line(&format!("<rgb name=\"{name}\" value=\"{}\"/>", rgb(value))),
            Texture::Checkerboard { color0, color1, scale } => {
                self.open(&format!("<texture type=\"checkerboard\" name=\"{name}\">"));
                self.line(&format!("<rgb name=\"color0\" value=\"{}\"/>", rgb(color0)));
                self.line(&format!("<rgb name=\"color1\" value=\"{}\"/>", rgb(color1)));
                self.open("<transform name=\"to_uv\">");
                self.line(&format!("<scale x=\"{:?}\" y=\"{:?}\"/>", 0.5 * scale[0], 0.5 * scale[1]));
                self.close("</transform>");
                self.close("</texture>");
            }
            Texture::Bitmap { image, uv, scale, channel, clamp } => {
                let file = self.image(image, scale, *channel, None)?;
                self.bitmap(name, &file, uv, *clamp);
            }
            Texture::VertexColor { .. } => {
                let index = self.tint(texture).unwrap_or_default();
                self.open(&format!("<texture type=\"mesh_attribute\" name=\"{name}\">"));
                self.line(&format!("<string name=\"name\" value=\"vertex_c{index}_color\"/>"));
                self.close("</texture>");
            }
            Texture::Product { .. } => {
                return Err(KindError::Input(format!(
                    "`{name}` is a product of textures, which Mitsuba does not support; export a scene without it"
                )));
            }
        }
        Ok(())
    }

    fn bitmap(&mut self, name: &str, file: &str, [a, b]: &[[f64; 3]; 2], clamp: bool) {
        self.open(&format!("<texture type=\"bitmap\" name=\"{name}\">"));
        self.line(&format!("<string name=\"filename\" value=\"{file}\"/>"));
        self.line("<boolean name=\"raw\" value=\"true\"/>");
        self.line(&format!("<string name=\"wrap_mode\" value=\"{}\"/>", if clamp { "clamp" } else { "repeat" }));
        self.open("<transform name=\"to_uv\">");
        // Mitsuba interprets the third column of nine numbers as z, which would drop an offset.
        let [a, b] = [a, b].map(|row| format!("{:?} {:?} 0 {:?}", row[0], row[1], row[2]));
        self.line(&format!("<matrix value=\"{a} {b} 0 0 1 0 0 0 0 1\"/>"));
        self.close("</transform>");
        self.close("</texture>");
    }

    /// The map of a `normalmap`, its first two components scaled.
    pub(super) fn normals(&mut self, map: &Texture, scale: f32) -> Result<(), KindError> {
        let of = |value: Rgb| [bent(value[0], scale), bent(value[1], scale), value[2]];
        match simplified(map) {
            map if scale == 1.0 => self.texture("normalmap", &map, false)?,
            Texture::Bitmap { image, uv, scale: factor, channel, clamp } => {
                let file = self.image(&image, &factor, channel, Some(scale))?;
                self.bitmap("normalmap", &file, &uv, clamp);
            }
            Texture::Constant { value } => {
                self.texture("normalmap", &Texture::Constant { value: of(value) }, false)?;
            }
            Texture::Checkerboard { color0, color1, scale: squares } => {
                let map = Texture::Checkerboard { color0: of(color0), color1: of(color1), scale: squares };
                self.texture("normalmap", &map, false)?;
            }
            Texture::VertexColor { .. } | Texture::Product { .. } => {
                return Err(KindError::Input(
                    "a scaled normal map of vertex colours, which Mitsuba does not support; export a scene without it"
                        .into(),
                ));
            }
        }
        Ok(())
    }
}
