//! Named tensors in one blob, in the safetensors format: any tool reads them in a line.

use crate::{DataError, Image};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::collections::{BTreeMap, HashMap};

/// Most bytes of the header of a file that is read: far above what ours have, as memory is taken by what it says.
const MAX_HEADER: u64 = 16 << 20;

/// A tensor of f32, row-major. Files may hold it in less: see [`Image::to_small_bytes`].
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Sizes of its axes.
    pub shape: Vec<usize>,
    /// Its values.
    pub data: Vec<f32>,
}

/// Named f32 tensors, with text metadata.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct TensorFile {
    /// The tensors.
    pub tensors: BTreeMap<String, Tensor>,
    /// Notes, e.g. a configuration as JSON.
    pub metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// Adds a tensor.
    pub fn with(mut self, name: &str, shape: &[usize], data: Vec<f32>) -> Self {
        self.tensors.insert(name.to_owned(), Tensor { shape: shape.to_vec(), data });
        self
    }

    /// Adds an image as a tensor of shape [height, width, channels].
    pub fn with_image(self, name: &str, image: &Image) -> Self {
        self.with(name, &[image.height(), image.width(), image.channels()], image.data().to_vec())
    }

    /// Adds a note.
    pub fn note(mut self, name: &str, value: impl Into<String>) -> Self {
        self.metadata.insert(name.to_owned(), value.into());
        self
    }

    /// The tensor of this name.
    ///
    /// # Errors
    /// If there is none.
    pub fn get(&self, name: &str) -> Result<&Tensor, DataError> {
        self.tensors.get(name).ok_or_else(|| DataError::Format(format!("the tensor file holds no tensor `{name}`")))
    }

    /// The image of this name.
    ///
    /// # Errors
    /// If there is none, it has not three axes, or it is empty: one without pixels could say any number of rows.
    pub fn image(&self, name: &str) -> Result<Image, DataError> {
        let tensor = self.get(name)?;
        let [height, width, channels] = tensor.shape[..] else {
            return Err(DataError::Format(format!("tensor `{name}` has {} axes, an image has 3", tensor.shape.len())));
        };
        if tensor.data.is_empty() {
            return Err(DataError::Format(format!(
                "tensor `{name}` has shape {:?}, which holds nothing",
                tensor.shape
            )));
        }
        Image::from_data(width, height, channels, tensor.data.clone())
    }

    /// The safetensors bytes; the same tensors give the same bytes.
    ///
    /// # Errors
    /// If a shape does not fit its data.
    pub fn to_bytes(&self) -> Result<Vec<u8>, DataError> {
        self.written(Dtype::F32, f32::to_le_bytes)
    }

    /// The same with all values rounded to half precision, in half of the bytes.
    ///
    /// # Errors
    /// If a shape does not fit its data, or a value exceeds half precision.
    pub fn to_half_bytes(&self) -> Result<Vec<u8>, DataError> {
        for (name, tensor) in &self.tensors {
            if let Some(value) = tensor.data.iter().find(|value| !half::f16::from_f32(**value).is_finite()) {
                return Err(DataError::Format(format!("{value} of tensor `{name}` exceeds half precision (65504)")));
            }
        }
        self.written(Dtype::F16, |value| half::f16::from_f32(value).to_le_bytes())
    }

    fn written<const N: usize>(&self, dtype: Dtype, bytes: impl Fn(f32) -> [u8; N]) -> Result<Vec<u8>, DataError> {
        let raw: Vec<(&String, &Vec<usize>, Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, t)| (name, &t.shape, t.data.iter().flat_map(|v| bytes(*v)).collect()))
            .collect();
        let mut views = Vec::with_capacity(raw.len());
        for (name, shape, bytes) in &raw {
            let view = TensorView::new(dtype, (*shape).clone(), bytes)
                .map_err(|e| DataError::Format(format!("tensor `{name}`: {e}")))?;
            views.push(((*name).clone(), view));
        }
        // The format writes metadata in hash order: one note holding JSON keeps the bytes the same.
        let notes = (!self.metadata.is_empty()).then(|| {
            let json = serde_json::to_string(&self.metadata).expect("a map of strings");
            HashMap::from([("tauflow".to_owned(), json)])
        });
        safetensors::serialize(views, notes).map_err(|e| DataError::Format(e.to_string()))
    }

    /// The shape of a tensor in safetensors bytes, whose data are not read; none if there is no such tensor.
    ///
    /// # Errors
    /// If the header is damaged.
    pub fn shape_in(bytes: &[u8], name: &str) -> Result<Option<Vec<usize>>, DataError> {
        check_header(bytes)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
        Ok(header.info(name).map(|tensor| tensor.shape.clone()))
    }

    /// Reads safetensors bytes. Tensors of f32 are read as they are, those of f16 exactly; a byte `k` is `k / 255`.
    ///
    /// # Errors
    /// If they are damaged or hold another type.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        check_header(bytes)?;
        let file = SafeTensors::deserialize(bytes).map_err(unreadable)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
        let mut out = Self::default();
        if let Some(notes) = header.metadata() {
            if let Some(json) = notes.get("tauflow") {
                out.metadata =
                    serde_json::from_str(json).map_err(|e| DataError::Format(format!("safetensors notes: {e}")))?;
            } else {
                out.metadata = notes.iter().map(|(k, v)| (k.clone(), v.clone())).collect();
            }
        }
        for (name, view) in file.tensors() {
            let raw = view.data();
            let data = match view.dtype() {
                Dtype::F32 => raw.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
                Dtype::F16 => raw.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect(),
                Dtype::U8 => raw.iter().map(|k| of_byte(*k)).collect(),
                other => {
                    let told = format!("tensor `{name}` is {other:?}, expected F32, F16 or U8");
                    return Err(DataError::Format(told));
                }
            };
            out.tensors.insert(name, Tensor { shape: view.shape().to_vec(), data });
        }
        Ok(out)
    }
}

fn unreadable(error: safetensors::SafeTensorError) -> DataError {
    DataError::Format(format!("not a readable safetensors file: {error}"))
}

/// Refuses a file whose header is longer than any of ours.
fn check_header(bytes: &[u8]) -> Result<(), DataError> {
    let header = bytes.first_chunk().map_or(0, |length| u64::from_le_bytes(*length));
    if header > MAX_HEADER {
        return Err(DataError::Format(format!(
            "a safetensors file with a header of {header} bytes; those of tauflow have less than {MAX_HEADER}"
        )));
    }
    Ok(())
}

/// The number that a byte stands for.
fn of_byte(k: u8) -> f32 {
    f32::from(k) / 255.0
}

/// Name of the tensor that holds the roots of an image's values.
const ROOTS: &str = "image_roots";

impl Image {
    /// The image as a safetensors blob with one tensor, `image` [height, width, channels].
    pub fn to_bytes(&self) -> Vec<u8> {
        TensorFile::default().with_image("image", self).to_bytes().expect("an image's shape fits its data")
    }

    /// The smallest blob that [`Image::from_bytes`] reads back to the same bits: `image` as bytes `k` for `k / 255`,
    /// `image_roots` as bytes for `(k / 255)^2` (dark tones keep their steps), `image` as f16, or [`Image::to_bytes`].
    pub fn to_small_bytes(&self) -> Vec<u8> {
        let data = self.data();
        let bytes = |back: fn(u8) -> f32, forth: fn(f32) -> f32| -> Option<Vec<u8>> {
            data.iter()
                .map(|v| {
                    let k = (forth(*v) * 255.0).round() as u8;
                    (back(k).to_bits() == v.to_bits()).then_some(k)
                })
                .collect()
        };
        let blob = |name: &str, dtype, raw: &[u8]| {
            let shape = vec![self.height(), self.width(), self.channels()];
            let view = TensorView::new(dtype, shape, raw).expect("an image's shape fits its data");
            safetensors::serialize([(name, view)], None).expect("one tensor of a fitting shape")
        };
        if let Some(raw) = bytes(of_byte, |v| v) {
            return blob("image", Dtype::U8, &raw);
        }
        if let Some(raw) = bytes(|k| of_byte(k) * of_byte(k), f32::sqrt) {
            return blob(ROOTS, Dtype::U8, &raw);
        }
        let halves: Vec<half::f16> = data.iter().map(|v| half::f16::from_f32(*v)).collect();
        if halves.iter().zip(data).all(|(h, v)| h.to_f32().to_bits() == v.to_bits()) {
            let raw: Vec<u8> = halves.iter().flat_map(|h| h.to_le_bytes()).collect();
            return blob("image", Dtype::F16, &raw);
        }
        self.to_bytes()
    }

    /// Reads what [`Image::to_bytes`] or [`Image::to_small_bytes`] wrote.
    ///
    /// # Errors
    /// If the bytes are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        let file = TensorFile::from_bytes(bytes)?;
        if file.tensors.contains_key(ROOTS) && !file.tensors.contains_key("image") {
            return Ok(file.image(ROOTS)?.map(|root| root * root));
        }
        file.image("image")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_take_the_smallest_form_that_keeps_their_bits() {
        let all: Vec<f32> = (0..=255).map(of_byte).collect();
        let header = 200;
        for (values, size) in [
            (all.clone(), 256),
            (all.iter().map(|v| v * v).collect(), 256),
            (all.iter().map(|v| half::f16::from_f32(v * 100.0).to_f32()).collect(), 512),
            (all.iter().map(|v| v * 0.7).collect(), 1024),
            (vec![-0.0; 256], 512),
            (vec![1e6; 256], 1024),
        ] {
            let image = Image::from_data(16, 16, 1, values).expect("fits");
            let bytes = image.to_small_bytes();
            assert!((size..size + header).contains(&bytes.len()), "{} bytes for {size}", bytes.len());
            let back = Image::from_bytes(&bytes).expect("own bytes");
            let bits = |i: &Image| i.data().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&back), bits(&image));
            assert_eq!(bytes, image.to_small_bytes());
        }
    }

    #[test]
    fn bytes_round_trip_and_are_stable() {
        let file = TensorFile::default()
            .with("b", &[2, 2], vec![1.0, -2.0, 3.5, f32::MIN_POSITIVE])
            .with("a", &[1], vec![0.0])
            .note("x", "1")
            .note("y", "{}")
            .note("z", "w");
        let bytes = file.to_bytes().expect("shapes fit");
        assert_eq!(bytes, file.to_bytes().expect("shapes fit"));
        assert_eq!(TensorFile::from_bytes(&bytes).expect("own bytes"), file);
        assert!(TensorFile::from_bytes(&bytes[..bytes.len() - 3]).is_err());
        let long = TensorFile::from_bytes(&(MAX_HEADER + 1).to_le_bytes()).expect_err("too long").to_string();
        assert!(long.contains("header of 16777217 bytes"), "{long}");
        for shape in [[0, 1 << 40, 3], [1 << 20, 0, 3], [2, 2, 0]] {
            let empty = TensorFile::default().with("image", &shape, Vec::new()).to_bytes().expect("the shape fits");
            let error = Image::from_bytes(&empty).expect_err("nothing in it").to_string();
            assert!(error.contains("holds nothing"), "{error}");
        }
        let halves = TensorFile::from_bytes(&file.to_half_bytes().expect("small numbers")).expect("own bytes");
        assert_eq!((&halves.metadata, &halves.tensors["b"].data), (&file.metadata, &vec![1.0, -2.0, 3.5, 0.0]));
        assert_eq!(halves.to_half_bytes().expect("small numbers"), file.to_half_bytes().expect("small numbers"));
        let large = TensorFile::default().with("large", &[1], vec![1e5]).to_half_bytes().expect_err("too large");
        assert!(large.to_string().contains("`large`"), "{large}");
        let image = Image::from_data(2, 1, 3, vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).expect("fits");
        assert_eq!(Image::from_bytes(&image.to_bytes()).expect("own bytes"), image);
    }
}
