//! OpenEXR and PNG files.

use crate::{DataError, Image, image::preview};
use exr::prelude::*;
use std::{collections::BTreeMap, path::Path};

/// Named layers of one EXR file; an image of 3 channels is R, G, B.
pub fn write_exr(path: &Path, layers: &[(&str, &Image)]) -> std::result::Result<(), DataError> {
    let Some((_, first)) = layers.first() else {
        return Err(DataError::Format("an EXR file needs at least one layer".into()));
    };
    let size = Vec2(first.width(), first.height());
    let mut channels = Vec::new();
    for (name, image) in layers {
        if (image.width(), image.height()) != (size.0, size.1) {
            return Err(DataError::Format(format!("layer `{name}` has another size than the first")));
        }
        let letters: &[&str] = match image.channels() {
            1 => &["Y"],
            3 => &["R", "G", "B"],
            4 => &["R", "G", "B", "A"],
            n => return Err(DataError::Format(format!("layer `{name}` has {n} channels; 1, 3 or 4 can be written"))),
        };
        for (c, letter) in letters.iter().enumerate() {
            let full = if name.is_empty() { (*letter).to_owned() } else { format!("{name}.{letter}") };
            let values = image.data().iter().skip(c).step_by(image.channels()).copied().collect();
            channels.push(AnyChannel::new(full.as_str(), FlatSamples::F32(values)));
        }
    }
    let layer = Layer::new(
        size,
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(channels.into_iter().collect()),
    );
    let failed = |e: exr::error::Error| match e {
        exr::error::Error::Io(source) => DataError::Io { path: path.display().to_string(), source },
        other => DataError::Format(format!("{}: {other}", path.display())),
    };
    exr::image::Image::from_layer(layer).write().to_file(path).map_err(failed)
}

/// The layers of three colours in an EXR file, by name; the one without a name is named "". Samples outside the data
/// window are 0.
///
/// # Errors
/// If the file cannot be read, or a layer has not R, G and B (or X, Y and Z) at full resolution.
pub fn read_exr(path: &Path) -> std::result::Result<BTreeMap<String, Image>, DataError> {
    let failed = |what: String| DataError::Format(format!("{}: {what}", path.display()));
    let file = read_first_flat_layer_from_file(path).map_err(|e| match e {
        exr::error::Error::Io(source) => DataError::Io { path: path.display().to_string(), source },
        other => failed(format!("no OpenEXR file that can be read: {other}")),
    })?;
    let size = file.layer_data.size;
    let mut images: BTreeMap<String, Image> = BTreeMap::new();
    for channel in &file.layer_data.channel_data.list {
        let full = channel.name.to_string();
        let (layer, letter) = full.rsplit_once('.').unwrap_or(("", &full));
        let Some(c) = ["R", "G", "B"].iter().chain(&["X", "Y", "Z"]).position(|l| l.eq_ignore_ascii_case(letter))
        else {
            continue;
        };
        if channel.sampling != Vec2(1, 1) || channel.sample_data.len() != size.area() {
            return Err(failed(format!("its channel `{full}` is subsampled; save it at full resolution")));
        }
        let image = images.entry(layer.to_owned()).or_insert_with(|| Image::new(size.0, size.1, 3));
        for (target, value) in
            image.data_mut().iter_mut().skip(c % 3).step_by(3).zip(channel.sample_data.values_as_f32())
        {
            *target = value;
        }
    }
    if images.is_empty() {
        return Err(failed("it has no channels R, G and B".into()));
    }
    Ok(images)
}

/// A PNG of 8-bit RGB through the display transform [`preview`]; input is exposed linear radiance, 3 channels.
///
/// # Errors
/// If the image has not 3 channels.
pub fn preview_png(image: &Image) -> std::result::Result<Vec<u8>, DataError> {
    encode_png(&image.map(preview))
}

/// A PNG of 8-bit RGB of values that are already in [0, 1] and display-encoded.
///
/// # Errors
/// If the image has not 3 channels.
pub fn encode_png(image: &Image) -> std::result::Result<Vec<u8>, DataError> {
    if image.channels() != 3 {
        return Err(DataError::Format(format!("a PNG of {} channels; 3 can be written", image.channels())));
    }
    let bytes: Vec<u8> = image.data().iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    let mut out = Vec::new();
    let failed = |e: png::EncodingError| DataError::Format(format!("cannot encode a PNG: {e}"));
    let mut encoder = png::Encoder::new(&mut out, image.width() as u32, image.height() as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(&bytes).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exr_layers_read_back() {
        let dir = std::env::temp_dir().join(format!("tauflow-exr-{}", std::process::id()));
        std::fs::create_dir_all(&dir).expect("a temporary folder");
        let path = dir.join("x.exr");
        let image = crate::Image::from_data(2, 1, 3, vec![0.5, 1.0, 2.0, -1.0, 1e5, 3.0]).expect("fits");
        write_exr(&path, &[("", &image), ("albedo", &image)]).expect("written");
        let back = exr::prelude::read_first_flat_layer_from_file(&path).expect("readable");
        assert_eq!(back.layer_data.channel_data.list.len(), 6);
        let layers = read_exr(&path).expect("own file");
        assert_eq!(layers.keys().collect::<Vec<_>>(), ["", "albedo"]);
        assert!(layers.values().all(|layer| layer == &image));
        std::fs::write(&path, b"v/1\x01 no picture").expect("written");
        assert!(read_exr(&path).expect_err("damaged").to_string().contains("x.exr"));
        std::fs::remove_dir_all(&dir).expect("removed");
    }

    #[test]
    fn previews_are_pngs() {
        let image = crate::Image::new(3, 2, 3);
        assert!(preview_png(&image).expect("3 channels").starts_with(b"\x89PNG"));
        assert!(preview_png(&crate::Image::new(1, 1, 1)).is_err());
    }
}
