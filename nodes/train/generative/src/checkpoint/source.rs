//! What is in a checkpoint file: tensors by name and, if there are any, averaged ones by order. Numbers are read when a
//! tensor is asked for, after its shape was found to be right.

use super::{
    pickle::{self, Heap, Value},
    zip,
};
use safetensors::SafeTensors;
use std::{collections::BTreeMap, ops::Range};

/// The one type of numbers that is read.
pub(super) const F32: &str = "Float";

/// A tensor in a file.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) dtype: String,
    pub(super) shape: Vec<usize>,
    strides: Vec<usize>,
    /// First number, counted in numbers.
    offset: usize,
    /// Bytes of the storage.
    bytes: Range<usize>,
}

/// A checkpoint file.
pub(super) struct Source<'a> {
    bytes: &'a [u8],
    pub(super) named: Vec<(String, Entry)>,
    pub(super) averaged: Option<Vec<Entry>>,
}

/// Row by row.
fn contiguous(shape: &[usize]) -> Vec<usize> {
    let mut strides = vec![1usize; shape.len()];
    for axis in (1..shape.len()).rev() {
        strides[axis - 1] = strides[axis].saturating_mul(shape[axis]);
    }
    strides
}

impl<'a> Source<'a> {
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, Vec<String>> {
        if bytes.starts_with(b"PK") {
            return Self::torch(bytes);
        }
        // A header is JSON, after its length in eight bytes.
        if bytes.get(8) == Some(&b'{') {
            return Self::safetensors(bytes).map_err(|problem| vec![problem]);
        }
        if bytes.first() == Some(&0x80) {
            let told = "it is in PyTorch's old format; load it and `torch.save` it with a PyTorch from 1.6 on";
            return Err(vec![told.into()]);
        }
        Err(vec!["it is neither a safetensors file nor one of `torch.save`".into()])
    }

    fn safetensors(bytes: &'a [u8]) -> Result<Self, String> {
        let bad = |e: safetensors::SafeTensorError| format!("it is no whole safetensors file: {e}; copy it again");
        let file = SafeTensors::deserialize(bytes).map_err(bad)?;
        let start = bytes.as_ptr() as usize;
        let named = file.tensors().into_iter().map(|(name, view)| {
            let first = view.data().as_ptr() as usize - start;
            let dtype = match view.dtype() {
                safetensors::Dtype::F32 => F32.to_owned(),
                other => format!("{other:?}"),
            };
            let (shape, bytes) = (view.shape().to_vec(), first..first + view.data().len());
            (name, Entry { dtype, strides: contiguous(&shape), shape, offset: 0, bytes })
        });
        let mut named: Vec<_> = named.collect();
        named.sort_by(|a, b| a.0.cmp(&b.0));
        Ok(Self { bytes, named, averaged: None })
    }

    fn torch(bytes: &'a [u8]) -> Result<Self, Vec<String>> {
        let one = |problem: String| vec![problem];
        let entries = zip::entries(bytes).map_err(one)?;
        let program = entries.iter().find_map(|(name, at)| Some((name.strip_suffix("/data.pkl")?, at)));
        let (folder, at) =
            program.ok_or_else(|| one("the archive has no `data.pkl`; is it of `torch.save`?".into()))?;
        let (root, heap) = pickle::read(&bytes[at.clone()])?;
        let prefix = format!("{folder}/data/");
        let storages: BTreeMap<&str, &Range<usize>> =
            entries.iter().filter_map(|(name, at)| Some((name.strip_prefix(&prefix)?, at))).collect();
        let top = heap.dict(&root).ok_or_else(|| one("it holds no dictionary of tensors".into()))?;
        let of = |name: &str| top.iter().find(|(key, _)| *key == name).map(|(_, value)| *value);
        let model = match of("model") {
            Some(model) => heap.dict(model).ok_or_else(|| one("its `model` is no dictionary of tensors".into()))?,
            None => top.clone(),
        };
        let mut problems = Vec::new();
        let mut named = Vec::new();
        for (name, value) in model {
            if name.len() > LONGEST_NAME {
                let what = format!("a tensor has a name of {} bytes; at most {LONGEST_NAME} can be read", name.len());
                return Err(one(what));
            }
            match entry(&heap, value, &storages) {
                Ok(entry) => named.push((name.to_owned(), entry)),
                Err(problem) => problems.push(format!("`{name}` {problem}")),
            }
        }
        let shadows = |ema: &Value| {
            let shadows = heap.dict(ema)?.iter().find(|(key, _)| *key == "shadow_params")?.1;
            heap.list(shadows).map(<[Value]>::to_vec)
        };
        // Weights that are not averaged are never taken for averaged ones.
        let averaged = of("ema").map(|ema| shadows(ema).ok_or("its `ema` has no list `shadow_params`")).transpose();
        let averaged = averaged.map_err(|problem| one(problem.into()))?;
        let averaged = averaged.map(|values| {
            let entries = values.iter().enumerate().filter_map(|(at, value)| {
                entry(&heap, value, &storages)
                    .map_err(|problem| problems.push(format!("ema.shadow_params[{at}] {problem}")))
                    .ok()
            });
            entries.collect()
        });
        if problems.is_empty() { Ok(Self { bytes, named, averaged }) } else { Err(problems) }
    }

    /// The numbers of a tensor, row by row. Its shape must have been found to be right.
    pub(super) fn values(&self, entry: &Entry) -> Result<Vec<f32>, String> {
        let storage = &self.bytes[entry.bytes.clone()];
        let cut = || "goes beyond its storage: the file is cut short; copy it again".to_owned();
        let count = entry.shape.iter().try_fold(1usize, |count, size| count.checked_mul(*size)).ok_or_else(cut)?;
        let last =
            entry.shape.iter().zip(&entry.strides).try_fold(entry.offset, |at, (size, stride)| {
                at.checked_add(size.checked_sub(1)?.checked_mul(*stride)?)
            });
        if count == 0 || last.is_none_or(|last| last >= storage.len() / 4) {
            return Err(cut());
        }
        let number = |at: usize| f32::from_le_bytes([0, 1, 2, 3].map(|byte| storage[4 * at + byte]));
        if entry.strides == contiguous(&entry.shape) {
            return Ok((entry.offset..entry.offset + count).map(number).collect());
        }
        let mut values = Vec::with_capacity(count);
        let mut index = vec![0; entry.shape.len()];
        for _ in 0..count {
            let at = index.iter().zip(&entry.strides).map(|(i, stride)| i * stride).sum::<usize>();
            values.push(number(entry.offset + at));
            for axis in (0..index.len()).rev() {
                index[axis] += 1;
                if index[axis] < entry.shape[axis] {
                    break;
                }
                index[axis] = 0;
            }
        }
        Ok(values)
    }
}

/// Most bytes of the name of a tensor.
const LONGEST_NAME: usize = 1000;

fn entry(heap: &Heap, value: &Value, storages: &BTreeMap<&str, &Range<usize>>) -> Result<Entry, String> {
    let tensor = heap.tensor(value).ok_or("is no tensor")?;
    if tensor.shape.len() != tensor.strides.len() {
        return Err(format!("has {} sizes and {} strides", tensor.shape.len(), tensor.strides.len()));
    }
    let storage = storages.get(&*tensor.entry);
    let named = || tensor.entry.chars().take(100).collect::<String>();
    let bytes = storage.ok_or_else(|| format!("lies in the entry `{}`, which the archive lacks", named()))?;
    Ok(Entry {
        dtype: tensor.dtype.trim_end_matches("Storage").to_owned(),
        shape: tensor.shape.clone(),
        strides: tensor.strides.clone(),
        offset: tensor.offset,
        bytes: (*bytes).clone(),
    })
}
