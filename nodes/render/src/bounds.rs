//! Bounds of texture values, so that unphysical materials are refused instead of clamped. Knows no material.
//!
//! Bounds are those of the parts: a product of textures lies within the product of their bounds, wherever on the
//! surface each is reached.

use crate::{
    texels::Texels,
    texture::{LoadBitmap, Texture},
};
use tauflow_contract::KindError;
use tauflow_data::{mesh::Mesh, scene};

/// Least and largest value of a channel.
type Bounds = (f32, f32);

/// How far beyond 1 a share may be by the rounding of its factors; what is beyond 1 is cut where the surface is shaded,
/// so that at most this is lost.
const ROUNDING: f32 = 1e-6;

/// Least and largest value of each channel of texels; none if a value is not finite.
fn of_texels(texels: &Texels) -> Option<Vec<Bounds>> {
    let (values, together) = texels.values();
    if together == 1 {
        return of_numbers(values, texels.channels());
    }
    let mut all = Vec::new();
    for channel in values.chunks(together) {
        all.extend(of_numbers(channel, 1)?);
    }
    Some(all)
}

/// Least and largest of every so many numbers; none if one is not finite.
fn of_numbers(values: &[f32], channels: usize) -> Option<Vec<Bounds>> {
    /// Values side by side: as many as a few pixels have, so that the loop over them is one over lanes.
    const BLOCK: usize = 16;
    let mut lows = vec![[f32::MAX; BLOCK]; channels];
    let mut highs = vec![[f32::MIN; BLOCK]; channels];
    let mut finite = true;
    let (blocks, rest) = values.as_chunks::<BLOCK>();
    // Sixteen pixels are as many blocks as there are channels.
    for (index, block) in blocks.iter().enumerate() {
        let (low, high) = (&mut lows[index % channels], &mut highs[index % channels]);
        for i in 0..BLOCK {
            let value = block[i];
            finite &= value.is_finite();
            low[i] = if value < low[i] { value } else { low[i] };
            high[i] = if value > high[i] { value } else { high[i] };
        }
    }
    let mut bounds = vec![(f32::MAX, f32::MIN); channels];
    let of_blocks = lows.iter().flatten().zip(highs.iter().flatten()).map(|(low, high)| (*low, *high));
    for (index, (low, high)) in of_blocks.enumerate() {
        let bounds = &mut bounds[index % channels];
        *bounds = (bounds.0.min(low), bounds.1.max(high));
    }
    for (index, value) in rest.iter().enumerate() {
        finite &= value.is_finite();
        let bounds = &mut bounds[(blocks.len() * BLOCK + index) % channels];
        *bounds = (bounds.0.min(*value), bounds.1.max(*value));
    }
    finite.then_some(bounds)
}

fn times((a, b): Bounds, (c, d): Bounds) -> Bounds {
    let products = [a * c, a * d, b * c, b * d];
    (products.into_iter().fold(f32::MAX, f32::min), products.into_iter().fold(f32::MIN, f32::max))
}

impl Texture {
    /// Bounds of its three values, vertex colours taken as within 0 and 1; none if a value is not finite.
    pub(crate) fn bounds(&self) -> Option<[Bounds; 3]> {
        let bounds = match self {
            Self::Constant(value) => value.to_array().map(|v| (v, v)),
            Self::Checkerboard { colors: [a, b], .. } => {
                let (low, high) = (a.min(*b).to_array(), a.max(*b).to_array());
                [0, 1, 2].map(|c| (low[c], high[c]))
            }
            Self::Bitmap(bitmap) => {
                let (image, scale) = (of_texels(bitmap.texels())?, bitmap.scale().to_array());
                [0, 1, 2].map(|c| {
                    // An image without alpha is opaque.
                    let read = bitmap.reads(c).map_or((1.0, 1.0), |channel| image[channel]);
                    times(read, (scale[c], scale[c]))
                })
            }
            Self::VertexColor { scale, .. } => scale.to_array().map(|v| times((0.0, 1.0), (v, v))),
            Self::Product(factors) => {
                let mut product = [(1.0, 1.0); 3];
                for factor in factors {
                    let bounds = factor.bounds()?;
                    product = [0, 1, 2].map(|c| times(product[c], bounds[c]));
                }
                product
            }
        };
        bounds.iter().all(|(low, high)| low.is_finite() && high.is_finite()).then_some(bounds)
    }
}

fn beyond(name: &str, what: &str) -> KindError {
    KindError::Input(format!(
        "a material's `{name}` {what}; shares of light and of materials are finite numbers from 0 to 1, so change the \
         value, or the `scale` or the texels of its texture"
    ))
}

fn compiled(texture: &scene::Texture, name: &str, channels: usize, load: LoadBitmap<'_>) -> Result<Texture, KindError> {
    let texture = Texture::compile(texture, load).map_err(|error| match error {
        KindError::Input(told) => KindError::Input(format!("`{name}`: {told}")),
        other => other,
    })?;
    let bounds = texture.bounds().ok_or_else(|| beyond(name, "has values that are not finite"))?;
    let (low, high) =
        bounds[..channels].iter().fold((f32::MAX, f32::MIN), |(low, high), (a, b)| (low.min(*a), high.max(*b)));
    if low < 0.0 {
        Err(beyond(name, &format!("goes down to {low}")))
    } else if high > 1.0 + ROUNDING {
        Err(beyond(name, &format!("goes up to {high}")))
    } else {
        Ok(texture)
    }
}

/// Compiles a texture of colours that are shares of light: reflectances and transmittances.
///
/// # Errors
/// As [`Texture::compile`], and if it has values outside of 0 to 1, or such that are not finite.
pub(crate) fn colors(texture: &scene::Texture, name: &str, load: LoadBitmap<'_>) -> Result<Texture, KindError> {
    compiled(texture, name, 3, load)
}

/// Compiles a texture that is read as one number from 0 to 1.
///
/// # Errors
/// As [`colors`].
pub(crate) fn share(texture: &scene::Texture, name: &str, load: LoadBitmap<'_>) -> Result<Texture, KindError> {
    compiled(texture, name, 1, load)
}

/// Compiles a normal map and looks at the scale of its normals.
///
/// # Errors
/// As [`Texture::compile`], and if a texel or the scale is not finite.
pub(crate) fn normals(texture: &scene::Texture, scale: f32, load: LoadBitmap<'_>) -> Result<Texture, KindError> {
    let map = Texture::compile(texture, load)?;
    if scale.is_finite() && map.bounds().is_some() {
        return Ok(map);
    }
    Err(KindError::Input(format!(
        "a normal map of scale {scale}, or with texels that are not finite; use finite numbers, 1 for the scale"
    )))
}

/// A bump map.
///
/// # Errors
/// If its scale or a texel is not finite, or it is no single picture, whose slopes are known.
pub(crate) fn heights(texture: &scene::Texture, scale: f32, load: LoadBitmap<'_>) -> Result<Texture, KindError> {
    let map = Texture::compile(texture, load)?;
    if !matches!(map, Texture::Constant(_) | Texture::Bitmap(_)) {
        let what = "a bump map that is no picture; bake it into one";
        return Err(KindError::Input(what.into()));
    }
    if scale.is_finite() && map.bounds().is_some() {
        return Ok(map);
    }
    Err(KindError::Input(format!(
        "a bump map of scale {scale}, or with texels that are not finite; use finite numbers"
    )))
}

/// A number from 0 to 1.
///
/// # Errors
/// If it is outside of that, or not finite.
pub(crate) fn level(value: f32, name: &str) -> Result<f32, KindError> {
    if (0.0..=1.0).contains(&value) { Ok(value) } else { Err(beyond(name, &format!("is {value}"))) }
}

/// Complex indices of refraction, by RGB: finite and not negative.
///
/// # Errors
/// If they are not.
pub(crate) fn indices(value: scene::Rgb, name: &str) -> Result<glam::Vec3, KindError> {
    if value.iter().all(|v| v.is_finite() && *v >= 0.0) {
        Ok(glam::Vec3::from_array(value))
    } else {
        Err(KindError::Input(format!("a conductor's `{name}` is {value:?}; use finite numbers from 0")))
    }
}

/// Vertex colours that a material, or only an emission, reads.
///
/// # Errors
/// If a material's are not from 0 to 1, or an emission's not finite numbers from 0.
pub(crate) fn vertex_colors(mesh: &Mesh, material: bool, emission: bool) -> Result<(), KindError> {
    let most = if material { 1.0 } else { f32::MAX };
    let colors = mesh.colors.iter().flatten().flatten().filter(|_| material || emission);
    let bad = colors.filter(|v| !(0.0..=most).contains(*v)).count();
    if bad == 0 {
        return Ok(());
    }
    Err(KindError::Input(format!(
        "{bad} values of the mesh's vertex colours are {}; scale them, or have no {} read them",
        if material { "not from 0 to 1" } else { "negative or not finite" },
        if material { "material" } else { "emission" }
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::Texture as Source;
    use tauflow_contract::Digest;
    use tauflow_data::Image;

    fn bitmap(texels: [f32; 6], scale: f32, channel: Option<u8>) -> (Source, Image) {
        let source = Source::Bitmap {
            image: Digest::of(b"x"),
            uv: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            scale: [scale; 3],
            channel,
            clamp: false,
        };
        (source, Image::from_data(2, 1, 3, texels.to_vec()).expect("fits"))
    }

    fn times(a: Source, b: Source) -> Source {
        Source::Product { a: Box::new(a), b: Box::new(b) }
    }

    #[test]
    fn bounds_are_by_channel_in_images_of_any_size() {
        for channels in [1, 2, 3, 4, 5, 7] {
            for width in [1, 5, 16, 37, 5000] {
                let values = (0..width * channels).map(|i| ((i * 7919) % 101) as f32 + 1000.0 * (i % channels) as f32);
                let image = Image::from_data(width, 1, channels, values.collect()).expect("fits");
                let slow: Vec<Bounds> = (0..channels)
                    .map(|c| {
                        let of = || image.data().iter().skip(c).step_by(channels).copied();
                        (of().fold(f32::MAX, f32::min), of().fold(f32::MIN, f32::max))
                    })
                    .collect();
                assert_eq!(of_texels(&image.clone().into()), Some(slow), "{width} x {channels}");
                for at in [0, width * channels - 1] {
                    let mut data = image.data().to_vec();
                    data[at] = f32::NAN;
                    let broken = Image::from_data(width, 1, channels, data).expect("fits");
                    assert_eq!(of_texels(&broken.into()), None, "{width} x {channels}, {at}");
                }
            }
        }
    }

    #[test]
    fn textures_within_a_unit_are_taken_and_others_told() {
        let texels = [0.0, 0.1, 0.2, 0.5, 0.25, 2.0];
        let taken = |(source, image): (Source, Image), colored: bool| {
            let load = &mut |_: &Digest| Ok(std::sync::Arc::new(image.clone().into()));
            if colored { colors(&source, "base_color", load) } else { share(&source, "metallic", load) }
                .map(|_| ())
                .map_err(|e| e.to_string())
        };
        let told = taken(bitmap(texels, 1.0, None), true).expect_err("beyond 1");
        assert!(told.contains("`base_color`") && told.contains("up to 2") && told.contains("`scale`"), "{told}");
        // Half of it is within; a number is read from its own channel, or from the first.
        assert_eq!(taken(bitmap(texels, 0.5, None), true), Ok(()));
        assert_eq!(taken(bitmap(texels, 1.0, None), false), Ok(()));
        assert!(taken(bitmap(texels, 1.0, Some(2)), false).is_err());
        assert_eq!(taken(bitmap(texels, 1.0, Some(3)), false), Ok(()));
        let told = taken(bitmap(texels, -1.0, None), true).expect_err("below 0");
        assert!(told.contains("down to -2"), "{told}");
        for value in [f32::NAN, f32::INFINITY] {
            let told = taken(bitmap([0.0, 0.1, 0.2, 0.5, value, 0.1], 1.0, None), true).expect_err("no number");
            assert!(told.contains("not finite"), "{told}");
        }
        // Products by their bounds, and what rounding makes of them.
        let (half, image) = bitmap(texels, 1.0, None);
        assert_eq!(taken((times(half.clone(), Source::scalar(0.5)), image.clone()), true), Ok(()));
        assert!(taken((times(half, Source::scalar(0.6)), image.clone()), true).is_err());
        assert_eq!(taken((times(Source::scalar(3.0), Source::scalar(1.0 / 3.0)), image.clone()), true), Ok(()));
        assert_eq!(taken((Source::scalar(1.0 + f32::EPSILON), image.clone()), true), Ok(()));
        assert!(taken((Source::scalar(1.0 + 1e-5), image), true).is_err());
    }

    #[test]
    fn vertex_colors_are_held_to_what_reads_them() {
        let mesh = |value: f32| Mesh { colors: Some(vec![[0.5, value, 1.0, 1.0]]), ..Mesh::default() };
        assert!(vertex_colors(&mesh(1.0), true, false).is_ok());
        let told = vertex_colors(&mesh(1.5), true, true).expect_err("beyond").to_string();
        assert!(told.contains("1 values") && told.contains("not from 0 to 1"), "{told}");
        assert!(vertex_colors(&mesh(1.5), false, true).is_ok());
        assert!(vertex_colors(&mesh(-0.5), false, true).is_err());
        assert!(vertex_colors(&mesh(f32::NAN), false, true).is_err());
        assert!(vertex_colors(&mesh(f32::NAN), false, false).is_ok());
    }
}
