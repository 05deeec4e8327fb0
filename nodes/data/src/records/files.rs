//! Shared export of several records: images by sample count, as EXR and as preview.

use crate::{
    DataError, Image,
    image_io::{exr_bytes, parse_exr, preview_png},
};
use tauflow_contract::{KindError, ReadFiles, WriteFiles};

const PREFIX: &str = "spp-";

/// Name, without its ending, of the files of the image of so many samples.
pub(super) fn count_name(count: u64) -> String {
    format!("{PREFIX}{count:06}")
}

/// The sample counts that a folder has an image of, increasing.
pub(super) fn counts_of(from: &dyn ReadFiles) -> Result<Vec<u64>, KindError> {
    let names = from.names()?;
    let count = |name: &String| name.strip_prefix(PREFIX)?.strip_suffix(".exr")?.parse::<u64>().ok();
    let mut counts: Vec<u64> = names.iter().filter_map(count).collect();
    counts.sort_unstable();
    if counts.is_empty() || counts[0] == 0 || counts.windows(2).any(|pair| pair[0] == pair[1]) {
        return Err(KindError::Input(format!(
            "there must be an image for each sample count, from 1 up, named as `{}.exr`; found {counts:?}",
            count_name(1)
        )));
    }
    Ok(counts)
}

/// Writes an image as `name.exr`, and as a preview `name.png` if it has three channels.
pub(super) fn put_image(to: &mut dyn WriteFiles, name: &str, image: &Image) -> Result<(), KindError> {
    to.put(&format!("{name}.exr"), &exr_bytes(&[("", image)])?)?;
    if image.channels() == 3 {
        to.put(&format!("{name}.png"), &preview_png(image)?)?;
    }
    Ok(())
}

/// Reads the unnamed layer of an EXR file.
pub(super) fn read_image(from: &dyn ReadFiles, file: &str) -> Result<Image, KindError> {
    let [image] = read_layers(file, &from.need(file)?, [""])?;
    Ok(image)
}

/// Reads layers of an EXR file.
pub(super) fn read_layers<const N: usize>(file: &str, bytes: &[u8], names: [&str; N]) -> Result<[Image; N], KindError> {
    let mut layers = parse_exr(file, bytes)?;
    let mut found = Vec::with_capacity(N);
    for name in names {
        let layer = layers.remove(name).ok_or_else(|| {
            let what = if name.is_empty() { "unnamed layer".to_owned() } else { format!("layer `{name}`") };
            DataError::Format(format!("{file}: it has no {what} with channels R, G and B"))
        })?;
        found.push(layer);
    }
    found.try_into().map_err(|_| KindError::Internal("as many layers as names".into()))
}
