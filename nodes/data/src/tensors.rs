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
        self.written(self.tensors.iter().map(|(name, tensor)| Raw::singles(name, tensor)).collect())
    }

    /// The same with values rounded to half precision, in half of the bytes. Matrices that `integers` names become
    /// integers of 8 bits, times a number for each column that the tensor `NAME.scale` holds.
    ///
    /// # Errors
    /// If a shape does not fit its data, a value exceeds half precision, one that becomes an integer is not finite, or
    /// there is a tensor `NAME.scale` already.
    pub fn to_rounded_bytes(&self, integers: impl Fn(&str) -> bool) -> Result<Vec<u8>, DataError> {
        let mut raw = Vec::with_capacity(self.tensors.len());
        for (name, tensor) in &self.tensors {
            if integers(name) {
                if self.tensors.contains_key(&scale_of(name)) {
                    return Err(DataError::Format(format!("there is a tensor `{}` already", scale_of(name))));
                }
                raw.extend(Raw::integers(name, tensor)?);
            } else {
                raw.push(Raw::halves(name, tensor)?);
            }
        }
        self.written(raw)
    }

    fn written(&self, raw: Vec<Raw>) -> Result<Vec<u8>, DataError> {
        let mut views = Vec::with_capacity(raw.len());
        for Raw { name, dtype, shape, bytes } in &raw {
            let view = TensorView::new(*dtype, shape.clone(), bytes)
                .map_err(|e| DataError::Format(format!("tensor `{name}`: {e}")))?;
            views.push((name.clone(), view));
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

    /// Reads safetensors bytes. Tensors of f32 are read as they are, those of f16 exactly; an unsigned byte `k` is
    /// `k / 255`. A matrix of signed bytes is multiplied by its `NAME.scale`, which is not a tensor of its own then.
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
        let mut scaled = Vec::new();
        for (name, view) in file.tensors() {
            let raw = view.data();
            let data = match view.dtype() {
                Dtype::F32 => raw.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
                Dtype::F16 => raw.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect(),
                Dtype::U8 => raw.iter().map(|k| of_byte(*k)).collect(),
                Dtype::I8 => {
                    scaled.push(name.clone());
                    raw.iter().map(|k| f32::from(k.cast_signed())).collect()
                }
                other => {
                    let told = format!("tensor `{name}` is {other:?}, expected F32, F16, U8 or I8");
                    return Err(DataError::Format(told));
                }
            };
            out.tensors.insert(name, Tensor { shape: view.shape().to_vec(), data });
        }
        for name in scaled {
            let scale = scale_of(&name);
            let single = file.tensor(&scale).is_ok_and(|view| view.dtype() == Dtype::F32);
            let scales = out.tensors.remove(&scale).filter(|_| single);
            let (Some(scales), Some(tensor)) = (scales, out.tensors.get_mut(&name)) else {
                return Err(DataError::Format(format!("tensor `{name}` is I8, but there is no `{scale}` of F32")));
            };
            if tensor.shape.len() != 2 || scales.shape != [1, tensor.shape[1]] {
                return Err(DataError::Format(format!(
                    "tensor `{name}` has shape {:?}, which does not fit the shape {:?} of `{scale}`",
                    tensor.shape, scales.shape
                )));
            }
            for row in tensor.data.chunks_exact_mut(scales.data.len().max(1)) {
                row.iter_mut().zip(&scales.data).for_each(|(value, scale)| *value *= scale);
            }
        }
        Ok(out)
    }
}

/// A tensor as a file holds it.
struct Raw {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Raw {
    fn singles(name: &str, tensor: &Tensor) -> Self {
        let bytes = tensor.data.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { name: name.to_owned(), dtype: Dtype::F32, shape: tensor.shape.clone(), bytes }
    }

    fn halves(name: &str, tensor: &Tensor) -> Result<Self, DataError> {
        if let Some(value) = tensor.data.iter().find(|value| !half::f16::from_f32(**value).is_finite()) {
            return Err(DataError::Format(format!("{value} of tensor `{name}` exceeds half precision (65504)")));
        }
        let bytes = tensor.data.iter().flat_map(|value| half::f16::from_f32(*value).to_le_bytes()).collect();
        Ok(Self { name: name.to_owned(), dtype: Dtype::F16, shape: tensor.shape.clone(), bytes })
    }

    /// A matrix as integers from -127 to 127, and the number for each column that they are multiplied with.
    fn integers(name: &str, tensor: &Tensor) -> Result<[Self; 2], DataError> {
        let [rows, columns] = tensor.shape[..] else {
            return Err(DataError::Format(format!("tensor `{name}` has {} axes, a matrix has 2", tensor.shape.len())));
        };
        if tensor.data.len() != rows * columns {
            return Err(DataError::Format(format!("tensor `{name}`: its shape does not fit its data")));
        }
        if let Some(value) = tensor.data.iter().find(|value| !value.is_finite() || value.abs() > f32::MAX / 2.0) {
            return Err(DataError::Format(format!("{value} of tensor `{name}` cannot become an integer")));
        }
        let mut most = vec![0.0f32; columns];
        for row in tensor.data.chunks_exact(columns.max(1)) {
            most.iter_mut().zip(row).for_each(|(most, value)| *most = most.max(value.abs()));
        }
        // Rounded up to 17 significant bits: products with integers are exact, so that rounding twice changes nothing.
        let scales: Vec<f32> =
            most.iter().map(|most| f32::from_bits(((most / 127.0).to_bits() + 0x7f) & !0x7f)).collect();
        let integer =
            |(value, scale): (&f32, &f32)| if *scale >= f32::MIN_POSITIVE { (value / scale).round() as i8 } else { 0 };
        let rows = tensor.data.chunks_exact(columns.max(1));
        let bytes = rows.flat_map(|row| row.iter().zip(&scales).map(integer)).map(i8::cast_unsigned).collect();
        let whole = Self { name: name.to_owned(), dtype: Dtype::I8, shape: tensor.shape.clone(), bytes };
        let scales = Tensor { shape: vec![1, columns], data: scales };
        Ok([whole, Self::singles(&scale_of(name), &scales)])
    }
}

/// The name of the tensor that holds what the columns of a matrix of integers are multiplied with.
fn scale_of(name: &str) -> String {
    format!("{name}.scale")
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
    fn matrices_of_integers_are_near_and_rounding_twice_changes_nothing() {
        let values: Vec<f32> = (0..600).map(|i| ((i * i) as f32).sin() * if i % 3 == 0 { 1e5 } else { 0.3 }).collect();
        let zeros = |column: usize| (0..600).map(move |i| if i % 3 == column { 0.0 } else { 1.0 });
        let values: Vec<f32> = values.iter().zip(zeros(2)).map(|(value, keep)| value * keep).collect();
        let file = TensorFile::default().with("a", &[200, 3], values.clone()).with("b", &[1], vec![0.1]);
        let rounded = |file: &TensorFile| file.to_rounded_bytes(|name| name == "a").expect("fits");
        let bytes = rounded(&file);
        let back = TensorFile::from_bytes(&bytes).expect("own bytes");
        assert_eq!(back.tensors.keys().collect::<Vec<_>>(), ["a", "b"]);
        for (column, most) in [(0, 1e5), (1, 0.3), (2, 0.0)] {
            for (found, value) in back.tensors["a"].data.iter().zip(&values).skip(column).step_by(3) {
                assert!((found - value).abs() <= most / 253.9, "{column}: {found} {value}");
            }
        }
        assert_eq!(rounded(&back), bytes);
        assert!(bytes.len() < 600 + 500, "{}", bytes.len());
        assert!(file.to_rounded_bytes(|_| true).is_err(), "a vector is no matrix");
        for (name, value) in [("a", f32::NAN), ("a", f32::INFINITY), ("a.scale", 1.0)] {
            let file = TensorFile::default().with("a", &[1, 1], vec![0.5]).with(name, &[1, 1], vec![value]);
            assert!(file.to_rounded_bytes(|name| name == "a").is_err(), "{name} {value}");
        }
        // Without its scales, or with those of another matrix, it is told.
        let view = |shape: &[usize], bytes| TensorView::new(Dtype::I8, shape.to_vec(), bytes).expect("fits");
        let alone = safetensors::serialize([("a", view(&[1, 2], &[1, 255]))], None).expect("serialises");
        let told = TensorFile::from_bytes(&alone).expect_err("no scales").to_string();
        assert!(told.contains("`a` is I8, but there is no `a.scale` of F32"), "{told}");
        let one = 1.0f32.to_le_bytes();
        let scale = TensorView::new(Dtype::F32, vec![1, 1], &one).expect("fits");
        let other = safetensors::serialize([("a", view(&[1, 2], &[1, 255])), ("a.scale", scale)], None);
        let told = TensorFile::from_bytes(&other.expect("serialises")).expect_err("one scale").to_string();
        assert!(told.contains("does not fit"), "{told}");
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
        let halved = |file: &TensorFile| file.to_rounded_bytes(|_| false);
        let halves = TensorFile::from_bytes(&halved(&file).expect("small numbers")).expect("own bytes");
        assert_eq!((&halves.metadata, &halves.tensors["b"].data), (&file.metadata, &vec![1.0, -2.0, 3.5, 0.0]));
        assert_eq!(halved(&halves).expect("small numbers"), halved(&file).expect("small numbers"));
        let large = halved(&TensorFile::default().with("large", &[1], vec![1e5])).expect_err("too large");
        assert!(large.to_string().contains("`large`"), "{large}");
        let image = Image::from_data(2, 1, 3, vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).expect("fits");
        assert_eq!(Image::from_bytes(&image.to_bytes()).expect("own bytes"), image);
    }
}
