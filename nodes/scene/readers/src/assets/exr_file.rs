//! Reader of OpenEXR pictures through the crate `exr`: R, G and B, or Y alone, of one layer of the first part.
//!
//! Channels without a layer, as `R`, are the image itself. A file without them may have a layer `Combined`, as Blender
//! writes it, or one layer of colours. Knows nothing of what the picture is for.

use super::{
    bounds,
    refusal::{Refusal, damaged},
};
use exr::{
    meta::MetaData,
    prelude::{FlatSamples, ReadChannels, ReadLayers, read as exr_read},
};
use std::{collections::BTreeMap, io::Cursor};
use tauflow_data::Image;

/// Reads a picture; linear RGB over its display window, row 0 on top, black outside its data window.
///
/// # Errors
/// If the bytes are no such picture, it has no colours that can be read, or too many texels.
pub fn read(bytes: &[u8]) -> Result<Image, Refusal> {
    let image = planes(bytes, |names| colours(names).map(|all| all.to_vec()))?;
    image.ok_or_else(|| damaged("channels", "there are none"))
}

/// The channel A beside R, G and B without a layer, as an image of one channel; none if there is no such channel.
///
/// # Errors
/// As for [`read`].
pub fn alpha(bytes: &[u8]) -> Result<Option<Image>, Refusal> {
    planes(bytes, |names| {
        let found = ["R", "G", "B", "A"].map(|letter| names.iter().position(|name| name == letter));
        Ok(if found.iter().all(Option::is_some) { found[3].into_iter().collect() } else { Vec::new() })
    })
}

/// The channels that are picked by their names, as an image over the display window; none if none are picked.
fn planes(bytes: &[u8], pick: impl FnOnce(&[String]) -> Result<Vec<usize>, Refusal>) -> Result<Option<Image>, Refusal> {
    let failed = |e: exr::error::Error| match e {
        exr::error::Error::NotSupported(what) => {
            Refusal::new("picture", format!("not supported: {what}"), "save it with ZIP or PIZ compression")
        }
        other => damaged("picture", other.to_string()),
    };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(failed)?;
    for header in &meta.headers {
        if header.deep {
            return Err(Refusal::new("header", "deep data", "flatten the picture"));
        }
        // Pixels outside of the data are black, and take the same memory.
        let (size, window) = (header.layer_size, header.shared_attributes.display_window.size);
        bounds::texels("display window", window.width(), window.height(), bytes.len())?;
        let texels = bounds::texels("data window", size.width(), size.height(), bytes.len())?;
        bounds::channels("channels", header.channels.list.len(), texels, bytes.len())?;
    }
    let picture = exr_read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(failed)?;
    let layer = &picture.layer_data;
    let list = &layer.channel_data.list;
    let names: Vec<String> = list.iter().map(|channel| channel.name.to_string()).collect();
    let channels: Vec<_> = pick(&names)?.into_iter().map(|at| &list[at]).collect();
    if channels.is_empty() {
        return Ok(None);
    }
    let window = picture.attributes.display_window;
    let (width, height) = (window.size.width(), window.size.height());
    let (own_width, own_height) = (layer.size.width(), layer.size.height());
    let mut image = Image::new(width, height, channels.len());
    let offset = |axis: fn(&exr::math::Vec2<i32>) -> i32| {
        i64::from(axis(&layer.attributes.layer_position)) - i64::from(axis(&window.position))
    };
    let (left, top) = (offset(|p| p.x()), offset(|p| p.y()));
    for (c, channel) in channels.into_iter().enumerate() {
        if channel.sampling.x() != 1 || channel.sampling.y() != 1 || channel.sample_data.len() != own_width * own_height
        {
            return Err(Refusal::new("channels", "subsampled colours", "save the picture at full resolution"));
        }
        for own_y in 0..own_height {
            let y = own_y as i64 + top;
            if y < 0 || y >= height as i64 {
                continue;
            }
            for own_x in 0..own_width {
                let x = own_x as i64 + left;
                if x >= 0 && x < width as i64 {
                    let at = own_y * own_width + own_x;
                    image.pixel_mut(x as usize, y as usize)[c] = match &channel.sample_data {
                        FlatSamples::F16(values) => values[at].to_f32(),
                        FlatSamples::F32(values) => values[at],
                        FlatSamples::U32(values) => values[at] as f32,
                    };
                }
            }
        }
    }
    Ok(Some(image))
}

/// Which of the channels are red, green and blue of the image.
///
/// # Errors
/// If no layer has colours, or several have that are not the image by their names.
fn colours(names: &[String]) -> Result<[usize; 3], Refusal> {
    let mut layers: BTreeMap<&str, BTreeMap<String, usize>> = BTreeMap::new();
    for (at, name) in names.iter().enumerate() {
        let (layer, letter) = name.rsplit_once('.').unwrap_or(("", name));
        layers.entry(layer).or_default().entry(letter.to_ascii_uppercase()).or_insert(at);
    }
    let colours = |layer: &BTreeMap<String, usize>| {
        let [r, g, b, x, y] = ["R", "G", "B", "X", "Y"].map(|letter| layer.get(letter).copied());
        match ([r, g, b], x, y) {
            ([Some(r), Some(g), Some(b)], _, _) => Some([r, g, b]),
            // Beside an X, it is part of a direction.
            ([None, None, None], None, Some(y)) => Some([y; 3]),
            _ => None,
        }
    };
    let found: Vec<(&str, [usize; 3])> =
        layers.iter().filter_map(|(name, layer)| Some((*name, colours(layer)?))).collect();
    let combined = |name: &str| name.rsplit('.').next() == Some("Combined");
    let is_image: [&dyn Fn(&str) -> bool; 3] = [&str::is_empty, &combined, &|_| true];
    for is in is_image {
        let such: Vec<&(&str, [usize; 3])> = found.iter().filter(|(name, _)| is(name)).collect();
        match such[..] {
            [] => {}
            [(_, channels)] => return Ok(*channels),
            _ => {
                let names: Vec<&str> = such.iter().map(|(name, _)| *name).collect();
                let what = format!("several layers of colours, `{}`", names.join("`, `"));
                return Err(Refusal::new("channels", what, "keep one, or name the channels of the image R, G and B"));
            }
        }
    }
    Err(Refusal::new("channels", format!("`{}`", names.join("`, `")), "name them R, G, B, or one Y"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::image_io::{ExrLayer, exr_file};

    /// Reads a file whose layers have these names, letters and values.
    fn read_of(layers: &[(&str, &[&str], f32)]) -> Result<[f32; 3], String> {
        let image = |letters: &[&str], value: f32| {
            let data = (0..letters.len()).map(|c| value + c as f32).collect();
            Image::from_data(1, 1, letters.len(), data).expect("fits")
        };
        let images: Vec<Image> = layers.iter().map(|(_, letters, value)| image(letters, *value)).collect();
        let layers: Vec<ExrLayer<'_>> =
            layers.iter().zip(&images).map(|((name, letters, _), image)| ExrLayer { name, letters, image }).collect();
        let image = read(&exr_file(&layers).expect("in memory")).map_err(|refusal| refusal.to_string())?;
        Ok([0, 1, 2].map(|c: usize| image.pixel(0, 0)[c]))
    }

    const RGB: &[&str] = &["R", "G", "B"];

    #[test]
    fn the_image_is_the_layer_without_a_name_or_the_combined_one_or_the_only_one() {
        let own = Ok([1.0, 2.0, 3.0]);
        // Names before and after the image's own in the order of the file.
        for other in ["Albedo", "albedo"] {
            assert_eq!(read_of(&[(other, RGB, 7.0), ("", RGB, 1.0)]), own);
            assert_eq!(read_of(&[(other, &["R"], 7.0), ("", RGB, 1.0)]), own);
            assert_eq!(read_of(&[(other, &["R"], 7.0), ("x", RGB, 1.0)]), own);
            assert_eq!(read_of(&[(other, RGB, 7.0), ("", &["Y"], 1.0)]), Ok([1.0; 3]));
        }
        assert_eq!(read_of(&[("", &["r", "g", "b"], 1.0)]), own);
        let pass = ("ViewLayer.AO", RGB, 7.0);
        assert_eq!(read_of(&[pass, ("ViewLayer.Combined", RGB, 1.0), ("ViewLayer.Depth", &["Z"], 5.0)]), own);
        assert_eq!(read_of(&[("a.Normal", &["X", "Y", "Z"], 5.0), ("a.Light", RGB, 1.0)]), own);
    }

    #[test]
    fn alpha_stands_beside_the_colours_of_the_image() {
        let image = Image::from_data(1, 1, 4, vec![1.0, 2.0, 3.0, 0.25]).expect("fits");
        let file = |name: &str| tauflow_data::image_io::exr_bytes(&[(name, &image)]).expect("in memory");
        assert_eq!(alpha(&file("")).expect("read").expect("there").data(), [0.25]);
        assert_eq!(alpha(&file("a")), Ok(None));
        assert_eq!(read(&file("a")).expect("read").data(), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn layers_that_may_each_be_the_image_are_named() {
        let told = read_of(&[("Albedo", RGB, 7.0), ("Light", RGB, 1.0), ("", &["Z"], 1.0)]).expect_err("two layers");
        assert!(told.contains("several layers of colours, `Albedo`, `Light`; keep one"), "{told}");
        let told = read_of(&[("a.Combined", RGB, 7.0), ("b.Combined", RGB, 1.0)]).expect_err("two layers");
        assert!(told.contains("`a.Combined`, `b.Combined`"), "{told}");
        let told = read_of(&[("a", &["R", "G"], 7.0), ("b", &["B"], 1.0)]).expect_err("no layer");
        assert!(told.contains("channels: `a.G`, `a.R`, `b.B`; name them R, G, B"), "{told}");
        let told = read_of(&[("Normal", &["X", "Y", "Z"], 7.0)]).expect_err("no colours");
        assert!(told.contains("name them"), "{told}");
    }
}
