//! Manifests: what an ONNX model is, and how to check that it gives the scores that it should.
//!
//! Knows no runtime.

use serde::Deserialize;
use std::{
    fs::File,
    io::BufReader,
    path::{Path, PathBuf},
};
use tauflow_contract::{KindError, read_regular};
use tauflow_data::{
    Image,
    outside::{contents, digest},
    records::{Better, ScoreColumn},
};

/// Most bytes of a manifest.
const MOST_BYTES: u64 = 1 << 20;
/// Most pixels of a side of a model's input or of a parity image.
const MOST_SIDE: u32 = 8192;

/// A manifest: a JSON file beside its model.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Manifest {
    /// The metric's name, such as `clipiqa`.
    pub(crate) metric: String,
    /// Which values are better.
    pub(crate) better: Better,
    /// The model's file, from the manifest's folder.
    pub(crate) model: PathBuf,
    /// Digest of the model's file.
    pub(crate) digest: String,
    /// Width and height that the model takes; none if it takes any.
    #[serde(default)]
    pub(crate) size: Option<[u32; 2]>,
    /// Taken from display values, by channel.
    #[serde(default)]
    pub(crate) mean: [f32; 3],
    /// Display values less the mean are divided by it, by channel.
    #[serde(default = "ones")]
    pub(crate) deviation: [f32; 3],
    /// An image with the score that it must get.
    pub(crate) parity: Parity,
}

/// An image with the score that it must get.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Parity {
    /// A PNG of 8-bit RGB, from the manifest's folder.
    pub(crate) image: PathBuf,
    /// Its score.
    pub(crate) score: f64,
    /// How far off the score may be.
    pub(crate) tolerance: f64,
}

fn ones() -> [f32; 3] {
    [1.0; 3]
}

/// A manifest with the files that it names.
pub(crate) struct Files {
    /// Where the manifest is, for messages.
    pub(crate) at: String,
    /// What it says.
    pub(crate) manifest: Manifest,
    /// The model's file.
    pub(crate) model: PathBuf,
    /// The parity image's file.
    pub(crate) parity: PathBuf,
}

impl Files {
    /// Reads a manifest; none if there is no such file.
    ///
    /// # Errors
    /// If it cannot be read, or says what cannot be.
    pub(crate) fn read(path: &str) -> Result<Option<Self>, KindError> {
        let file = Path::new(path);
        if !file.exists() {
            return Ok(None);
        }
        let bytes = read_regular(file, MOST_BYTES)
            .map_err(|e| KindError::Environment(format!("the manifest `{path}` cannot be read: {e}")))?;
        let wrong = |what: &str| KindError::Input(format!("the manifest `{path}`: {what}"));
        let manifest: Manifest = serde_json::from_slice(&bytes).map_err(|e| wrong(&e.to_string()))?;
        let fine = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        if manifest.metric.is_empty() || !manifest.metric.chars().all(fine) {
            return Err(wrong("`metric` needs lower-case letters, digits and `_`, such as `topiq_nr`"));
        }
        if manifest.deviation.iter().any(|d| !(d.is_finite() && *d > 0.0)) {
            return Err(wrong("`deviation` needs three numbers above 0"));
        }
        if manifest.size.is_some_and(|size| size.iter().any(|side| *side == 0 || *side > MOST_SIDE)) {
            return Err(wrong(&format!("`size` needs a width and a height from 1 to {MOST_SIDE}")));
        }
        if !(manifest.parity.tolerance >= 0.0 && manifest.parity.score.is_finite()) {
            return Err(wrong("`parity` needs a score, and a tolerance of 0 or more"));
        }
        let folder = file.parent().unwrap_or(Path::new("."));
        let (model, parity) = (folder.join(&manifest.model), folder.join(&manifest.parity.image));
        Ok(Some(Self { at: path.to_owned(), manifest, model, parity }))
    }

    /// The manifest, model and parity image by their contents: what decides the scores.
    pub(crate) fn identity(path: &str) -> serde_json::Value {
        let of = |file: &Path| if file.is_file() { contents(file) } else { "missing".to_owned() };
        match Self::read(path) {
            Ok(Some(files)) => {
                serde_json::json!([of(Path::new(path)), of(&files.model), of(&files.parity)])
            }
            // One that cannot be read is told by the action.
            Ok(None) | Err(_) => serde_json::json!([of(Path::new(path))]),
        }
    }

    /// The metric as a column.
    pub(crate) fn column(&self) -> ScoreColumn {
        ScoreColumn { name: self.manifest.metric.clone(), better: self.manifest.better }
    }

    /// Holds the model's file against its digest.
    ///
    /// # Errors
    /// If it is another file.
    pub(crate) fn check_digest(&self) -> Result<(), KindError> {
        let found = digest(&self.model).ok_or_else(|| {
            KindError::Environment(format!("the model `{}` of `{}` cannot be read", self.model.display(), self.at))
        })?;
        if found.to_string() == self.manifest.digest {
            return Ok(());
        }
        Err(KindError::Input(format!(
            "the model `{}` has the digest {found}, but `digest` of the manifest `{}` is {}; use the file that the \
             manifest was written for, or write a manifest for this one",
            self.model.display(),
            self.at,
            self.manifest.digest
        )))
    }

    /// The parity image.
    ///
    /// # Errors
    /// If it is no PNG of 8-bit RGB.
    pub(crate) fn parity_image(&self) -> Result<Image, KindError> {
        let wrong = |what: String| {
            KindError::Input(format!("the parity image `{}` of `{}`: {what}", self.parity.display(), self.at))
        };
        let file = File::open(&self.parity).map_err(|e| wrong(e.to_string()))?;
        let mut reader = png::Decoder::new(BufReader::new(file)).read_info().map_err(|e| wrong(e.to_string()))?;
        let info = reader.info();
        let (width, height) = (info.width, info.height);
        if (info.color_type, info.bit_depth) != (png::ColorType::Rgb, png::BitDepth::Eight) {
            return Err(wrong("a PNG of 8-bit RGB is needed".into()));
        }
        if width > MOST_SIDE || height > MOST_SIDE {
            return Err(wrong(format!("{width} x {height} pixels; at most {MOST_SIDE} on each side can be read")));
        }
        let (width, height) = (width as usize, height as usize);
        let mut bytes = vec![0; width * height * 3];
        reader.next_frame(&mut bytes).map_err(|e| wrong(e.to_string()))?;
        let values = bytes.into_iter().map(|byte| f32::from(byte) / 255.0).collect();
        Ok(Image::from_data(width, height, 3, values)?)
    }
}
