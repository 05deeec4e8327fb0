//! Named tensors in one blob, in the safetensors format: any tool reads them in a line.

use crate::{DataError, Image};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::collections::{BTreeMap, HashMap};

/// Most bytes of the header of a file that is read: far above what ours have, as memory is taken by what it says.
const MAX_HEADER: u64 = 16 << 20;

/// A tensor of f32, row-major.
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
        let raw: Vec<(&String, &Vec<usize>, Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, t)| (name, &t.shape, t.data.iter().flat_map(|v| v.to_le_bytes()).collect()))
            .collect();
        let mut views = Vec::with_capacity(raw.len());
        for (name, shape, bytes) in &raw {
            let view = TensorView::new(Dtype::F32, (*shape).clone(), bytes)
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

    /// Reads safetensors bytes whose tensors are all f32.
    ///
    /// # Errors
    /// If they are damaged or hold another type.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        let bad = |e: safetensors::SafeTensorError| DataError::Format(format!("not a readable safetensors file: {e}"));
        let header = bytes.first_chunk().map_or(0, |length| u64::from_le_bytes(*length));
        if header > MAX_HEADER {
            return Err(DataError::Format(format!(
                "a safetensors file with a header of {header} bytes; those of tauflow have less than {MAX_HEADER}"
            )));
        }
        let file = SafeTensors::deserialize(bytes).map_err(bad)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(bad)?;
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
            if view.dtype() != Dtype::F32 {
                return Err(DataError::Format(format!("tensor `{name}` is {:?}, expected F32", view.dtype())));
            }
            let data = view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            out.tensors.insert(name, Tensor { shape: view.shape().to_vec(), data });
        }
        Ok(out)
    }
}

impl Image {
    /// The image as a safetensors blob with one tensor, `image` [height, width, channels].
    pub fn to_bytes(&self) -> Vec<u8> {
        TensorFile::default().with_image("image", self).to_bytes().expect("an image's shape fits its data")
    }

    /// Reads what [`Image::to_bytes`] wrote.
    ///
    /// # Errors
    /// If the bytes are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        TensorFile::from_bytes(bytes)?.image("image")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let image = Image::from_data(2, 1, 3, vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).expect("fits");
        assert_eq!(Image::from_bytes(&image.to_bytes()).expect("own bytes"), image);
    }
}
