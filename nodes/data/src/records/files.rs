//! Shared export of several records: images by sample count, as EXR and as preview.

use crate::{
    DataError, Image,
    image_io::{exr_bytes, parse_exr, preview_png},
};
use serde::{Deserialize, Serialize};
use tauflow_contract::{KindError, Radiance, ReadFiles, WriteFiles};

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

/// The space of the images of an item, as its `meta.json` names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Space {
    /// Linear radiance of the scene.
    RawRadiance,
    /// Linear radiance times the exposure.
    ExposedRadiance,
}

/// What `meta.json` says of the values of all images of an item.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Values {
    pub(super) space: Space,
    /// The factor that radiance was multiplied by: 1 in raw radiance; none if it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    exposure: Option<f64>,
    /// The exposure of the scene, whatever the images were multiplied by; none if it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scene_exposure: Option<f64>,
}

impl Values {
    /// The values of raw images as they are written.
    pub(super) fn of_raw(to: &dyn WriteFiles) -> Self {
        Self { space: Space::RawRadiance, exposure: Some(1.0), scene_exposure: to.radiance().exposure }
    }

    /// The values of exposed images as they are written.
    ///
    /// # Errors
    /// If raw radiance is wanted, and the exposure is not known.
    pub(super) fn of_exposed(to: &dyn WriteFiles) -> Result<Self, KindError> {
        let Radiance { exposure, raw } = to.radiance();
        if !raw {
            return Ok(Self { space: Space::ExposedRadiance, exposure, scene_exposure: exposure });
        }
        let known = exposure.filter(|factor| factor.is_finite() && *factor > 0.0);
        match known {
            Some(_) => Ok(Self { space: Space::RawRadiance, exposure: Some(1.0), scene_exposure: known }),
            None => Err(KindError::Input(
                "its exposure is not known, and its images cannot be written as raw radiance; export without `--raw`"
                    .into(),
            )),
        }
    }

    /// An exposed image in the space of its file.
    pub(super) fn written(&self, image: &Image) -> Image {
        match (self.space, self.scene_exposure) {
            (Space::RawRadiance, Some(factor)) => image.map(|v| (f64::from(v) / factor) as f32),
            _ => image.clone(),
        }
    }

    /// An image of a file, exposed.
    ///
    /// # Errors
    /// If it is raw, and the exposure of the scene is not said.
    pub(super) fn exposed(&self, image: Image) -> Result<Image, KindError> {
        match (self.space, self.scene_exposure) {
            (Space::ExposedRadiance, _) => Ok(image),
            (Space::RawRadiance, Some(factor)) if factor.is_finite() && factor > 0.0 => {
                Ok(image.map(|v| (f64::from(v) * factor) as f32))
            }
            (Space::RawRadiance, _) => Err(KindError::Input(
                "`meta.json` says that its images are raw radiance; add `scene_exposure`, a factor above 0".into(),
            )),
        }
    }
}

/// Metadata beside the values of the images.
#[derive(Serialize, Deserialize)]
pub(super) struct Described<M> {
    #[serde(flatten)]
    pub(super) meta: M,
    /// None in files of other programs, or of earlier versions.
    #[serde(flatten)]
    pub(super) values: Option<Values>,
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
