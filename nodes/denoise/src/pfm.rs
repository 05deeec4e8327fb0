//! Portable float maps in place of EXR files, for programs without a library that reads EXR.

use tauflow_contract::{FileTree, KindError};
use tauflow_data::{
    Image,
    image_io::{exr_bytes, parse_exr},
};

/// The same files with images as portable float maps, one for each layer, and without previews.
///
/// # Errors
/// If an image has a number of channels that the format lacks.
pub(crate) fn as_pfm(files: &FileTree) -> Result<FileTree, KindError> {
    let mut found = FileTree::new();
    for (name, bytes) in files {
        if let Some(stem) = name.strip_suffix(".exr") {
            for (layer, image) in parse_exr(name, bytes)? {
                let dot = if layer.is_empty() { "" } else { "." };
                found.insert(format!("{stem}{dot}{layer}.pfm"), pfm(name, &image)?);
            }
        } else if !name.strip_suffix(".png").is_some_and(|stem| files.contains_key(&format!("{stem}.exr"))) {
            found.insert(name.clone(), bytes.clone());
        }
    }
    Ok(found)
}

/// A portable float map of an image.
fn pfm(name: &str, image: &Image) -> Result<Vec<u8>, KindError> {
    let (width, height, channels) = (image.width(), image.height(), image.channels());
    let magic = match channels {
        1 => "Pf",
        3 => "PF",
        _ => {
            return Err(KindError::Input(format!(
                "`{name}` has {channels} channels, a portable float map 1 or 3; write `images: exr`"
            )));
        }
    };
    let mut bytes = format!("{magic}\n{width} {height}\n-1.0\n").into_bytes();
    // The lowest row comes first.
    for y in (0..height).rev() {
        for x in 0..width {
            image.pixel(x, y).iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        }
    }
    Ok(bytes)
}

/// The same files with portable float maps as EXR.
///
/// # Errors
/// If one is damaged.
pub(crate) fn from_pfm(files: FileTree) -> Result<FileTree, KindError> {
    let convert = |(name, bytes): (String, Vec<u8>)| match name.strip_suffix(".pfm") {
        Some(stem) => Ok((format!("{stem}.exr"), exr_bytes(&[("", &parse_pfm(&name, &bytes)?)])?)),
        None => Ok((name, bytes)),
    };
    files.into_iter().map(convert).collect()
}

fn parse_pfm(name: &str, bytes: &[u8]) -> Result<Image, KindError> {
    let wrong = |what: &str| KindError::Input(format!("`{name}` is no portable float map: {what}"));
    let mut rest = bytes;
    let mut word = || {
        let start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let end = start + rest[start..].iter().position(u8::is_ascii_whitespace)?;
        let word = std::str::from_utf8(&rest[start..end]).ok()?;
        rest = &rest[end + 1..];
        Some(word)
    };
    let channels = match word() {
        Some("PF") => 3,
        Some("Pf") => 1,
        _ => return Err(wrong("it does not begin with `PF` or `Pf`")),
    };
    let mut number = || word().and_then(|word| word.parse::<usize>().ok()).filter(|n| (1..=1 << 16).contains(n));
    let (Some(width), Some(height)) = (number(), number()) else { return Err(wrong("it has no width and height")) };
    let scale: f32 = word().and_then(|word| word.parse().ok()).ok_or_else(|| wrong("it has no scale"))?;
    let count = width * height * channels;
    if rest.len() != 4 * count {
        return Err(wrong(&format!("{width} x {height} pixels take {} bytes, there are {}", 4 * count, rest.len())));
    }
    let value = |bytes: &[u8]| {
        let bytes = [bytes[0], bytes[1], bytes[2], bytes[3]];
        if scale < 0.0 { f32::from_le_bytes(bytes) } else { f32::from_be_bytes(bytes) }
    };
    let values: Vec<f32> = rest.chunks_exact(4).map(value).collect();
    let data = values.chunks_exact(width * channels).rev().flatten().copied().collect();
    Image::from_data(width, height, channels, data).map_err(|e| wrong(&e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_round_trip_and_damaged_ones_are_refused() {
        for channels in [1, 3] {
            let data: Vec<f32> = (0..6 * channels).map(|i| i as f32 - 1.5).collect();
            let image = Image::from_data(3, 2, channels, data).expect("fits");
            let bytes = pfm("a", &image).expect("1 or 3 channels");
            assert_eq!(parse_pfm("a", &bytes).expect("its own"), image);
            for cut in [0, 2, 5, 9, bytes.len() - 1] {
                assert!(parse_pfm("a", &bytes[..cut]).expect_err("cut").to_string().contains("`a`"), "{cut}");
            }
        }
        assert!(pfm("a", &Image::new(1, 1, 2)).expect_err("two").to_string().contains("images: exr"));
        let big = b"Pf 2 1 1.0\n\x3f\x80\0\0\x40\0\0\0";
        assert_eq!(parse_pfm("a", big).expect("big-endian").data(), [1.0, 2.0]);
    }

    #[test]
    fn layers_become_files_and_previews_go() {
        let image = Image::new(1, 1, 3);
        let exr = exr_bytes(&[("albedo", &image), ("normal", &image)]).expect("plain");
        let files = [("g.exr", exr), ("g.png", vec![1]), ("own.png", vec![2])];
        let files = files.map(|(name, bytes)| (name.to_owned(), bytes)).into_iter().collect();
        let names: Vec<String> = as_pfm(&files).expect("whole").into_keys().collect();
        assert_eq!(names, ["g.albedo.pfm", "g.normal.pfm", "own.png"]);
    }
}
