//! Reader of OpenEXR pictures through the crate `exr`: the first flat layer's R, G, B, or Y alone.
//!
//! Knows nothing of what the picture is for.

use super::{
    bounds,
    refusal::{Refusal, damaged},
};
use exr::{
    meta::MetaData,
    prelude::{FlatSamples, ReadChannels, ReadLayers, read as exr_read},
};
use std::io::Cursor;
use tauflow_data::Image;

/// Reads a picture; linear RGB over its display window, row 0 on top, black outside its data window.
///
/// # Errors
/// If the bytes are no such picture, it has no colours that can be read, or too many texels.
pub fn read(bytes: &[u8]) -> Result<Image, Refusal> {
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
    let named = |name: &str| {
        list.iter().find(|channel| {
            let text = channel.name.to_string();
            text.rsplit('.').next().is_some_and(|last| last.eq_ignore_ascii_case(name))
        })
    };
    let channels = match (named("R"), named("G"), named("B"), named("Y")) {
        (Some(r), Some(g), Some(b), _) => [r, g, b],
        (None, None, None, Some(y)) => [y, y, y],
        _ => {
            let names: Vec<String> = list.iter().map(|c| c.name.to_string()).collect();
            return Err(Refusal::new("channels", format!("`{}`", names.join("`, `")), "name them R, G, B, or one Y"));
        }
    };
    let window = picture.attributes.display_window;
    let (width, height) = (window.size.width(), window.size.height());
    let (own_width, own_height) = (layer.size.width(), layer.size.height());
    let mut image = Image::new(width, height, 3);
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
    Ok(image)
}
