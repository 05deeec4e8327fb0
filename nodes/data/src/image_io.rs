//! OpenEXR and PNG files.

use crate::{DataError, Image, image::preview};
use exr::{
    block::{self, reader::ChunksReader as _},
    meta::header::Header,
    prelude::*,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    io::{BufReader, Cursor, Read, Seek},
    path::Path,
};
use tauflow_contract::open_regular;

/// A layer of an EXR file.
#[derive(Clone, Copy, Debug)]
pub struct ExrLayer<'a> {
    /// Its name; the one without a name is the image itself.
    pub name: &'a str,
    /// What its channels are called.
    pub letters: &'a [&'a str],
    /// Its pixels.
    pub image: &'a Image,
}

impl<'a> ExrLayer<'a> {
    /// A layer of colours: Y, RGB or RGBA.
    pub fn colors(name: &'a str, image: &'a Image) -> Self {
        let letters: &[&str] = match image.channels() {
            1 => &["Y"],
            4 => &["R", "G", "B", "A"],
            _ => &["R", "G", "B"],
        };
        Self { name, letters, image }
    }
}

/// Named layers as the bytes of one EXR file; an image of 3 channels is R, G, B.
///
/// # Errors
/// If there is no layer, layers differ in size, or one has another number of channels than 1, 3 or 4.
pub fn exr_bytes(layers: &[(&str, &Image)]) -> std::result::Result<Vec<u8>, DataError> {
    let layers: Vec<ExrLayer<'_>> = layers.iter().map(|(name, image)| ExrLayer::colors(name, image)).collect();
    exr_file(&layers)
}

/// Layers as the bytes of one EXR file.
///
/// # Errors
/// If there is no layer, layers differ in size, or one has another number of channels than letters.
pub fn exr_file(layers: &[ExrLayer<'_>]) -> std::result::Result<Vec<u8>, DataError> {
    let Some(ExrLayer { image: first, .. }) = layers.first() else {
        return Err(DataError::Format("an EXR file needs at least one layer".into()));
    };
    let size = Vec2(first.width(), first.height());
    let mut channels = Vec::new();
    for ExrLayer { name, letters, image } in layers {
        if (image.width(), image.height()) != (size.0, size.1) {
            return Err(DataError::Format(format!("layer `{name}` differs in size from the first layer")));
        }
        if image.channels() != letters.len() {
            let n = image.channels();
            return Err(DataError::Format(format!("layer `{name}` has {n} channels; only 1, 3 or 4 are supported")));
        }
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
    let mut bytes = Cursor::new(Vec::new());
    let failed = |e: exr::error::Error| DataError::Format(format!("cannot encode an EXR file: {e}"));
    exr::image::Image::from_layer(layer).write().to_buffered(&mut bytes).map_err(failed)?;
    Ok(bytes.into_inner())
}

/// Named layers as one EXR file; see [`exr_bytes`].
///
/// # Errors
/// As [`exr_bytes`], and if the file cannot be written.
pub fn write_exr(path: &Path, layers: &[(&str, &Image)]) -> std::result::Result<(), DataError> {
    let bytes = exr_bytes(layers)?;
    std::fs::write(path, bytes).map_err(|source| DataError::Io { path: path.display().to_string(), source })
}

/// Most pixels of a picture that is read.
const MOST_PIXELS: usize = 1 << 26;
/// Most channels of a picture that is read.
const MOST_CHANNELS: usize = 1024;
/// Most numbers of a picture that is read, over all channels: 2 GiB.
const MOST_SAMPLES: usize = 1 << 29;
/// Most bytes of an EXR file.
const MOST_BYTES: u64 = 1 << 32;
/// Numbers that a picture of any file may have; few bytes can claim many.
const FREE_SAMPLES: usize = 1 << 26;
/// More of them for each byte of the file: half of what the best compression of zeros says.
const SAMPLES_PER_BYTE: usize = 512;

/// The layers of three colours in an EXR file, by name; the one without a name is named "". Layers are parts of the
/// file, or share one part as `layer.R`. If several parts have a layer of one name, the parts' names come before it.
/// Pictures have the size of the display window; outside the data window they are 0.
///
/// # Errors
/// If the file cannot be read, is deep or larger than 2^26 pixels, claims more numbers than its bytes can say, or holds
/// no layer with R, G and B (or, for normals, X, Y and Z) at full resolution.
pub fn read_exr(path: &Path) -> std::result::Result<BTreeMap<String, Image>, DataError> {
    read_exr_layers(path, &|_| true)
}

/// The layers of a file whose names are wanted. Only these take memory.
///
/// # Errors
/// As [`read_exr`], whether or not a layer is wanted.
pub fn read_exr_layers(
    path: &Path,
    wanted: &dyn Fn(&str) -> bool,
) -> std::result::Result<BTreeMap<String, Image>, DataError> {
    let (name, size, source) = opened(path)?;
    layers(&name, size, source, wanted)
}

/// Names of the layers that [`read_exr`] reads, and the matrix `worldToCamera` of the file, row by row.
///
/// # Errors
/// As [`read_exr`], as far as headers tell.
pub fn exr_names(path: &Path) -> std::result::Result<(Vec<String>, Option<[f32; 16]>), DataError> {
    let (name, size, source) = opened(path)?;
    let meta = checked(&name, size, source)?;
    let camera = meta.headers.iter().find_map(|header| header.own_attributes.world_to_camera);
    Ok((colours(&name, &meta.headers)?.into_keys().collect(), camera))
}

/// The alpha of a layer that [`read_exr`] reads, one channel; none if it has none at full resolution.
///
/// # Errors
/// As [`read_exr`].
pub fn read_exr_alpha(path: &Path, layer: &str) -> std::result::Result<Option<Image>, DataError> {
    let (name, size, mut source) = opened(path)?;
    let meta = checked(&name, size, &mut source)?;
    match colours(&name, &meta.headers)?.get(layer).and_then(|colours| colours.alpha) {
        None => Ok(None),
        Some(at) => Ok(planes(&name, &meta, source, &[&[at]])?.pop()),
    }
}

/// The layers of the bytes of an EXR file, as [`read_exr`] gives them; `name` is what errors call it.
///
/// # Errors
/// As [`read_exr`].
pub fn parse_exr(name: &str, bytes: &[u8]) -> std::result::Result<BTreeMap<String, Image>, DataError> {
    layers(name, bytes.len() as u64, Cursor::new(bytes), &|_| true)
}

/// A file: what errors call it, its size, and where its bytes come from.
fn opened(path: &Path) -> std::result::Result<(String, u64, BufReader<std::fs::File>), DataError> {
    let name = path.display().to_string();
    let failed = |source| DataError::Io { path: name.clone(), source };
    let file = open_regular(path).map_err(failed)?;
    let size = file.metadata().map_err(failed)?.len();
    if size > MOST_BYTES {
        let large = format!("it has {size} bytes; the limit is {MOST_BYTES}");
        return Err(failed(std::io::Error::new(std::io::ErrorKind::FileTooLarge, large)));
    }
    Ok((name, size, BufReader::new(file)))
}

fn broken(name: &str) -> impl Fn(exr::error::Error) -> DataError + '_ {
    move |e| DataError::Format(format!("{name}: no OpenEXR file that can be read: {e}"))
}

/// The headers, checked before anything of the size that they claim is made.
fn checked(name: &str, size: u64, source: impl Read) -> std::result::Result<MetaData, DataError> {
    let failed = |what: String| DataError::Format(format!("{name}: {what}"));
    let meta = MetaData::read_from_buffered(source, false).map_err(broken(name))?;
    let size = usize::try_from(size).unwrap_or(usize::MAX);
    let most = size.saturating_mul(SAMPLES_PER_BYTE).saturating_add(FREE_SAMPLES).min(MOST_SAMPLES);
    let mut samples = 0usize;
    for header in &meta.headers {
        let sizes = [header.layer_size, header.shared_attributes.display_window.size];
        for size in sizes {
            if size.width().checked_mul(size.height()).is_none_or(|n| n == 0 || n > MOST_PIXELS) {
                return Err(failed(format!("{} x {} pixels; 1 to 2^26 can be read", size.width(), size.height())));
            }
        }
        // Each channel becomes a plane of the size of the display window.
        let [layer, window] = sizes.map(Vec2::area);
        let channels = header.channels.list.len();
        samples = samples.saturating_add(layer.max(window).saturating_mul(channels));
        if channels > MOST_CHANNELS || samples > most {
            return Err(failed(format!(
                "{channels} channels, {samples} numbers in {size} bytes; at most {MOST_CHANNELS} and {most} can be \
                 read; take layers out, crop the display window, or write the file without compression"
            )));
        }
        if header.deep {
            return Err(failed("deep data; flatten the picture".into()));
        }
    }
    Ok(meta)
}

/// The channels at full resolution whose name ends in a single letter: the name of their layer, the letter, the part of
/// the file, and the place in it.
fn channels(headers: &[Header]) -> impl Iterator<Item = (String, char, Place)> {
    headers.iter().enumerate().flat_map(|(part, header)| {
        let own = header.own_attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default();
        header.channels.list.iter().enumerate().filter_map(move |(at, channel)| {
            let full = channel.name.to_string();
            let (layer, letter) = full.rsplit_once('.').unwrap_or(("", &full));
            let letter = letter.chars().next().filter(|_| letter.len() == 1 && channel.sampling == Vec2(1, 1))?;
            let layer = if layer.is_empty() { own.clone() } else { layer.to_owned() };
            Some((layer, letter.to_ascii_uppercase(), (part, at)))
        })
    })
}

/// A channel: of which part of the file, and which of its channels.
type Place = (usize, usize);

/// A layer of three colours.
struct Colours {
    places: [Place; 3],
    /// The channel A of the same part.
    alpha: Option<Place>,
}

impl Colours {
    /// From the channels of one layer, by letter. A layer without a name needs R, G and B; others may have X, Y and Z.
    fn of(channels: &BTreeMap<char, Place>, named: bool) -> Option<Self> {
        let all = |letters: [char; 3]| {
            let [a, b, c] = letters.map(|letter| channels.get(&letter).copied());
            Some([a?, b?, c?])
        };
        let normals = || all(['X', 'Y', 'Z']).filter(|_| named);
        all(['R', 'G', 'B']).or_else(normals).map(|places| Self { places, alpha: channels.get(&'A').copied() })
    }
}

/// The layers of three colours, by name. If several parts have a layer of one name, as files of two views do, the names
/// of the parts come before it.
fn colours(name: &str, headers: &[Header]) -> std::result::Result<BTreeMap<String, Colours>, DataError> {
    let failed = |what: String| DataError::Format(format!("{name}: {what}"));
    // Channels by layer, part and letter first: letters alone do not say whether a Z is a depth or part of a normal.
    let mut found: BTreeMap<String, BTreeMap<usize, BTreeMap<char, Place>>> = BTreeMap::new();
    for (layer, letter, at) in channels(headers).filter(|(_, letter, _)| "RGBAXYZ".contains(*letter)) {
        found.entry(layer).or_default().entry(at.0).or_default().insert(letter, at);
    }
    let mut layers = BTreeMap::new();
    for (layer, parts) in found {
        let of = |channels| Colours::of(channels, !layer.is_empty());
        let mut whole: Vec<(usize, Colours)> =
            parts.iter().filter_map(|(part, channels)| Some((*part, of(channels)?))).collect();
        match whole.len() {
            // Each channel may be a part of its own.
            0 => {
                let all = parts.values().flatten().map(|(letter, at)| (*letter, *at)).collect();
                let Some(all) = of(&all) else { continue };
                let has = |letter: &char| parts.values().filter(|part| part.contains_key(letter)).count();
                if let Some(letter) = "RGBXYZ".chars().find(|letter| has(letter) > 1) {
                    let what =
                        format!("the channel {letter} of the layer `{layer}` is in several parts; give the parts");
                    return Err(failed(format!("{what} different names of layers")));
                }
                layers.insert(layer, all);
            }
            1 => _ = layers.insert(layer, whole.remove(0).1),
            _ => {
                for (part, colours) in whole {
                    let own = headers[part].own_attributes.layer_name.as_ref().map(ToString::to_string);
                    let own = own.filter(|own| !own.is_empty());
                    let named = own.map(|own| if own == layer { own } else { format!("{own}.{layer}") });
                    let named = named.filter(|named| !layers.contains_key(named));
                    let Some(named) = named else {
                        let what = format!("several parts have a layer `{layer}`; give the parts different names");
                        return Err(failed(what));
                    };
                    layers.insert(named, colours);
                }
            }
        }
    }
    if layers.is_empty() {
        return Err(failed("it has no layer with channels R, G and B at full resolution".into()));
    }
    Ok(layers)
}

fn layers<R: Read + Seek>(
    name: &str,
    size: u64,
    mut source: R,
    wanted: &dyn Fn(&str) -> bool,
) -> std::result::Result<BTreeMap<String, Image>, DataError> {
    let meta = checked(name, size, &mut source)?;
    let chosen: Vec<(String, Colours)> =
        colours(name, &meta.headers)?.into_iter().filter(|(layer, _)| wanted(layer)).collect();
    let channels: Vec<&[Place]> = chosen.iter().map(|(_, colours)| &colours.places[..]).collect();
    let images = planes(name, &meta, source, &channels)?;
    Ok(chosen.into_iter().map(|(name, _)| name).zip(images).collect())
}

/// An image for each list of channels (part and place in it), of the size of the display window. Reads block by block,
/// so that no copy of the picture is made beside them.
fn planes<R: Read + Seek>(
    name: &str,
    meta: &MetaData,
    mut source: R,
    chosen: &[&[Place]],
) -> std::result::Result<Vec<Image>, DataError> {
    source.rewind().map_err(|e| broken(name)(e.into()))?;
    let window = meta.headers.first().map(|header| header.shared_attributes.display_window);
    let window = window.ok_or_else(|| DataError::Format(format!("{name}: it has no part")))?;
    let mut images: Vec<Image> =
        chosen.iter().map(|channels| Image::new(window.size.width(), window.size.height(), channels.len())).collect();
    // Where a channel of a part goes: images and places in their pixels.
    let mut places: Vec<Vec<Vec<(usize, usize)>>> =
        meta.headers.iter().map(|header| vec![Vec::new(); header.channels.list.len()]).collect();
    for (image, channels) in chosen.iter().enumerate() {
        for (place, (part, channel)) in channels.iter().enumerate() {
            places[*part][*channel].push((image, place));
        }
    }
    let parts: Vec<bool> = places.iter().map(|channels| channels.iter().any(|places| !places.is_empty())).collect();
    let chunks = block::read(source, false)
        .and_then(|reader| reader.filter_chunks(false, |_, _, block| parts[block.layer] && block.level == Vec2(0, 0)))
        .map_err(broken(name))?;
    let mut row = Vec::new();
    // Where blocks of a part begin that have been read, and how many pixels they have.
    let mut read: Vec<(BTreeSet<(usize, usize)>, usize)> = vec![Default::default(); meta.headers.len()];
    chunks
        .decompress_parallel(false, |meta, block| {
            let header = &meta.headers[block.index.layer];
            let (begun, pixels) = &mut read[block.index.layer];
            if !begun.insert((block.index.pixel_position.x(), block.index.pixel_position.y())) {
                return Err(Error::Invalid("a block of pixels is there twice; copy the file again".into()));
            }
            *pixels += block.index.pixel_size.area();
            let places = &places[block.index.layer];
            let offset = |axis: fn(Vec2<i32>) -> i32| {
                i64::from(axis(header.own_attributes.layer_position)) - i64::from(axis(window.position))
            };
            let (left, top) = (offset(Vec2::x), offset(Vec2::y));
            for line in block.lines(&header.channels) {
                let places = &places[line.location.channel];
                if places.is_empty() {
                    continue;
                }
                row.clear();
                match header.channels.list[line.location.channel].sample_type {
                    SampleType::F16 => {
                        for value in line.read_samples::<f16>() {
                            row.push(value?.to_f32());
                        }
                    }
                    SampleType::F32 => {
                        for value in line.read_samples::<f32>() {
                            row.push(value?);
                        }
                    }
                    SampleType::U32 => {
                        for value in line.read_samples::<u32>() {
                            row.push(value? as f32);
                        }
                    }
                }
                let y = line.location.position.y() as i64 + top;
                let first = line.location.position.x() as i64 + left;
                for (image, place) in places {
                    let image = &mut images[*image];
                    if !(0..image.height() as i64).contains(&y) {
                        continue;
                    }
                    let width = image.width() as i64;
                    for (x, value) in (first..).zip(&row).filter(|(x, _)| (0..width).contains(x)) {
                        image.pixel_mut(x as usize, y as usize)[*place] = *value;
                    }
                }
            }
            Ok(())
        })
        .map_err(broken(name))?;
    let of_parts = meta.headers.iter().zip(&read).zip(&parts);
    if of_parts.into_iter().any(|((header, (_, pixels)), wanted)| *wanted && *pixels != header.layer_size.area()) {
        return Err(DataError::Format(format!("{name}: blocks of pixels are missing; copy the file again")));
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
        return Err(DataError::Format(format!("a PNG with {} channels; only 3 are supported", image.channels())));
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
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("x.exr");
        let image = crate::Image::from_data(2, 1, 3, vec![0.5, 1.0, 2.0, -1.0, 1e5, 3.0]).expect("fits");
        write_exr(&path, &[("", &image), ("albedo", &image)]).expect("written");
        let back = exr::prelude::read_first_flat_layer_from_file(&path).expect("readable");
        assert_eq!(back.layer_data.channel_data.list.len(), 6);
        let layers = read_exr(&path).expect("own file");
        assert_eq!(layers.keys().collect::<Vec<_>>(), ["", "albedo"]);
        assert!(layers.values().all(|layer| layer == &image));
        let albedo = read_exr_layers(&path, &|name| name == "albedo").expect("own file");
        assert_eq!(albedo.into_iter().collect::<Vec<_>>(), [("albedo".to_owned(), image.clone())]);
        assert_eq!(exr_names(&path).expect("own file"), (vec![String::new(), "albedo".to_owned()], None));
        assert_eq!(read_exr_alpha(&path, "albedo").expect("own file"), None);
        // Depth is no blue, and no picture; a part of a colour is none either.
        let written = |names: &[&str], position: i32, window: i32| {
            let channels = names
                .iter()
                .enumerate()
                .map(|(i, name)| AnyChannel::new(*name, FlatSamples::F32(vec![i as f32 + 1.0; 2])));
            let mut layer = Layer::new(
                Vec2(2, 1),
                LayerAttributes::default(),
                Encoding::UNCOMPRESSED,
                AnyChannels::sort(channels.collect()),
            );
            layer.attributes.layer_position = Vec2(position, 0);
            let mut file = exr::image::Image::from_layer(layer);
            file.attributes.display_window = IntegerBounds::from_dimensions(Vec2(window as usize, 1));
            file.write().to_file(&path).expect("written");
        };
        written(&["B", "G", "R", "Z"], 0, 2);
        assert_eq!(read_exr(&path).expect("a picture with depth")[""].pixel(1, 0), [3.0, 2.0, 1.0]);
        for names in [&["Z"][..], &["R"], &["X", "Y", "Z"]] {
            written(names, 0, 2);
            assert!(read_exr(&path).expect_err("no picture").to_string().contains("R, G and B"), "{names:?}");
        }
        written(&["B", "G", "R"], 2, 4);
        assert_eq!(
            read_exr(&path).expect("a cropped picture")[""].data()[..9],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 2.0, 1.0]
        );
        std::fs::write(&path, b"v/1\x01 no picture").expect("written");
        assert!(read_exr(&path).expect_err("damaged").to_string().contains("x.exr"));
    }

    #[test]
    fn alpha_is_that_of_the_layer_in_its_part() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("x.exr");
        let part = |name: &str, names: &[&str], value: f32| {
            let channel = |name: &&str| AnyChannel::new(*name, FlatSamples::F32(vec![value; 2]));
            let attributes = LayerAttributes::named(name);
            let channels = AnyChannels::sort(names.iter().map(channel).collect());
            Layer::new(Vec2(2, 1), attributes, Encoding::UNCOMPRESSED, channels)
        };
        let (albedo, rgba) = (part("albedo", &["R", "G", "B", "A"], 0.25), part("rgba", &["R", "G", "B", "A"], 0.5));
        let both = part("both", &["x.R", "x.G", "x.B", "x.A", "y.R", "y.G", "y.B"], 0.75);
        let parts: Layers<AnyChannels<FlatSamples>> = [albedo, rgba, both].into_iter().collect();
        let attributes = ImageAttributes::new(IntegerBounds::from_dimensions(Vec2(2, 1)));
        exr::image::Image::from_layers(attributes, parts).write().to_file(&path).expect("written");
        for (layer, value) in [("albedo", Some(0.25)), ("rgba", Some(0.5)), ("x", Some(0.75)), ("y", None)] {
            let alpha = read_exr_alpha(&path, layer).expect("own file");
            assert_eq!(alpha.map(|alpha| (alpha.channels(), alpha.data().to_vec())), value.map(|v| (1, vec![v; 2])));
        }
    }

    #[test]
    fn layers_of_several_parts_are_never_mixed() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join("x.exr");
        let write = |parts: &[(&str, &[&str], f32)]| {
            let part = |(name, names, value): &(&str, &[&str], f32)| {
                let channel = |name: &&str| AnyChannel::new(*name, FlatSamples::F32(vec![*value; 2]));
                let channels = AnyChannels::sort(names.iter().map(channel).collect());
                Layer::new(Vec2(2, 1), LayerAttributes::named(*name), Encoding::UNCOMPRESSED, channels)
            };
            let attributes = ImageAttributes::new(IntegerBounds::from_dimensions(Vec2(2, 1)));
            let parts: Layers<AnyChannels<FlatSamples>> = parts.iter().map(part).collect();
            exr::image::Image::from_layers(attributes, parts).write().to_file(&path).expect("written");
        };
        let first = |layer: &crate::Image| layer.pixel(0, 0).to_vec();
        // Two views, each with its alpha.
        let view = ["x.R", "x.G", "x.B", "x.A"];
        write(&[("left", &view, 0.25), ("right", &view, 0.75)]);
        let layers = read_exr(&path).expect("two views");
        assert_eq!(layers.keys().collect::<Vec<_>>(), ["left.x", "right.x"]);
        for (name, value) in [("left.x", 0.25), ("right.x", 0.75)] {
            assert_eq!(first(&layers[name]), [value; 3]);
            assert_eq!(read_exr_alpha(&path, name).expect("own file").expect("it has one").data(), [value; 2]);
        }
        // A whole layer, and a channel of its name in another part.
        write(&[("left", &["x.R", "x.G", "x.B"], 1.0), ("right", &["x.R", "x.A"], 5.0)]);
        assert_eq!(first(&read_exr(&path).expect("a layer")["x"]), [1.0; 3]);
        assert_eq!(read_exr_alpha(&path, "x").expect("own file"), None, "it is of another part");
        // Channels that are parts of their own make a layer; two of one letter make none.
        write(&[("r", &["x.R"], 1.0), ("g", &["x.G"], 2.0), ("b", &["x.B"], 3.0)]);
        assert_eq!(first(&read_exr(&path).expect("a layer")["x"]), [1.0, 2.0, 3.0]);
        write(&[("r", &["x.R"], 1.0), ("g", &["x.G", "x.R"], 2.0), ("b", &["x.B"], 3.0)]);
        let told = read_exr(&path).expect_err("two channels R").to_string();
        assert!(told.contains("the channel R of the layer `x` is in several parts"), "{told}");
    }

    #[test]
    fn tiles_at_the_edges_of_a_picture_are_whole() {
        for (width, height) in [(50, 30), (16, 16), (1, 1), (17, 33)] {
            let channel = |name: &&str| AnyChannel::new(*name, FlatSamples::F32(vec![1.5; width * height]));
            let layer = Layer::new(
                Vec2(width, height),
                LayerAttributes::default(),
                Encoding { blocks: Blocks::Tiles(Vec2(16, 16)), ..Encoding::SMALL_LOSSLESS },
                AnyChannels::sort(["R", "G", "B"].iter().map(channel).collect()),
            );
            let mut bytes = Cursor::new(Vec::new());
            exr::image::Image::from_layer(layer).write().to_buffered(&mut bytes).expect("memory");
            let read = parse_exr("x", &bytes.into_inner()).expect("whole");
            assert!(read[""].data().iter().all(|value| *value == 1.5), "{width} x {height}");
        }
    }

    #[test]
    fn blocks_that_are_missing_or_there_twice_are_told() {
        let layer = Layer::new(
            Vec2(2, 6),
            LayerAttributes::default(),
            Encoding { line_order: LineOrder::Increasing, ..Encoding::UNCOMPRESSED },
            AnyChannels::sort(
                ["R", "G", "B"]
                    .into_iter()
                    .map(|name| AnyChannel::new(name, FlatSamples::F32(vec![1.5; 12])))
                    .collect(),
            ),
        );
        let mut bytes = Cursor::new(Vec::new());
        exr::image::Image::from_layer(layer).write().to_buffered(&mut bytes).expect("memory");
        let whole = bytes.into_inner();
        assert_eq!(parse_exr("x", &whole).expect("whole")[""].height(), 6);
        // Blocks of lines are at the end of the file: y, bytes, and 3 x 2 numbers.
        let start = whole.len() - 6 * (8 + 24);
        assert_eq!(whole[start..start + 8], [0, 0, 0, 0, 24, 0, 0, 0], "a block of one line");
        let mut twice = whole.clone();
        twice[start + 3 * 32] = 4;
        let told = parse_exr("x", &twice).expect_err("line 3 is missing").to_string();
        assert!(told.contains("x: ") && told.contains("twice"), "{told}");
    }

    #[test]
    fn what_a_small_file_claims_is_bounded_before_memory_is_taken() {
        let written = |size: Vec2<usize>, window: Vec2<usize>, names: usize| {
            let zeros = || FlatSamples::F32(vec![0.0; size.area()]);
            let channels = (0..names).map(|i| AnyChannel::new(format!("l{i:04}.R").as_str(), zeros()));
            let attributes = LayerAttributes::default();
            let layer = Layer::new(size, attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels.collect()));
            let mut file = exr::image::Image::from_layer(layer);
            file.attributes.display_window = IntegerBounds::from_dimensions(window);
            let mut bytes = Cursor::new(Vec::new());
            file.write().to_buffered(&mut bytes).expect("written");
            bytes.into_inner()
        };
        let refused = |bytes: &[u8], part: &str| {
            let told = parse_exr("x.exr", bytes).expect_err("too much").to_string();
            assert!(told.starts_with("x.exr: ") && told.contains(part) && told.contains("; take layers out"), "{told}");
        };
        refused(&written(Vec2(1, 1), Vec2(1, 1), 3000), "3000 channels");
        // One pixel in a window of 2^26, a plane of which would be 256 MiB for each of its channels.
        refused(&written(Vec2(1, 1), Vec2(1 << 13, 1 << 13), 100), "6710886400 numbers");
        let small = written(Vec2(64, 64), Vec2(64, 64), 3);
        assert!(parse_exr("x.exr", &small).expect_err("no colours").to_string().contains("R, G and B"));
    }

    #[test]
    fn previews_are_pngs() {
        let image = crate::Image::new(3, 2, 3);
        assert!(preview_png(&image).expect("3 channels").starts_with(b"\x89PNG"));
        assert!(preview_png(&crate::Image::new(1, 1, 1)).is_err());
    }
}
