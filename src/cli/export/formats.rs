//! Exports for other programs: arrays as npz, safetensors or WebDataset, rungs as Open Image Denoise's training toolkit
//! reads them, and scores as CSV or Parquet.
//!
//! All formats begin with the files of the folder format, so that they hold the same values for every media type.

use clap::ValueEnum;
use serde_json::{Map, Value};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_contract::{Artifact, Context, FileTree, ItemKey, KindError, Radiance, WriteFiles};
use tauflow_data::{
    DataError, Image, TensorFile,
    image_io::{exr_bytes, parse_exr},
    records::media,
    tabular::csv_field,
};

/// What an export is written as.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// A folder per item with EXR, PNG and JSON files, and a manifest.
    #[default]
    Folder,
    /// `KEY.npz`: images as float32 arrays, with the metadata.
    Npz,
    /// `KEY.safetensors`: images as float32 tensors, with the metadata.
    Safetensors,
    /// `NODE-000000.tar` and on: samples of `.npy` files and metadata, as WebDataset reads them.
    Webdataset,
    /// `KEY_0001spp.hdr.exr`, `.alb.exr`, `.nrm.exr` and `KEY_ref.hdr.exr`, as OIDN's training toolkit reads them.
    Oidn,
    /// `NODE.csv`: scores and other numbers, one row each, axes as columns.
    Csv,
    /// `NODE.parquet`: the rows of `csv`, in typed columns.
    Parquet,
    /// `scene0000.zip` and on, `noisebase.yaml`: single samples of ladders, rendered anew, as noisebase reads them.
    Noisebase,
}

/// Bytes after which a new archive begins.
const SHARD: usize = 512 << 20;

/// An item as other programs take it: its arrays and its metadata.
struct Plain {
    key: ItemKey,
    images: BTreeMap<String, Image>,
    meta: Map<String, Value>,
}

/// The files of one item in memory.
struct Collected {
    files: FileTree,
    radiance: Radiance,
}

impl WriteFiles for Collected {
    fn put(&mut self, name: &str, bytes: &[u8]) -> Result<(), KindError> {
        // Previews hold nothing that the images do not.
        if !name.ends_with(".png") {
            self.files.insert(name.to_owned(), bytes.to_vec());
        }
        Ok(())
    }

    fn radiance(&self) -> Radiance {
        self.radiance
    }
}

impl Plain {
    fn of(ctx: &Context<'_>, key: &ItemKey, artifact: &Artifact, radiance: Radiance) -> Result<Self, KindError> {
        let mut to = Collected { files: FileTree::new(), radiance };
        let row = media(&artifact.media)
            .ok_or_else(|| KindError::Input(format!("there is no media type `{}`", artifact.media)))?;
        (row.export)(ctx, artifact, &mut to)?;
        let (mut images, mut meta) = (BTreeMap::new(), Map::new());
        for (name, bytes) in &to.files {
            if let Some(stem) = name.strip_suffix(".exr") {
                for (layer, image) in parse_exr(name, bytes)? {
                    let name = if layer.is_empty() { stem.to_owned() } else { format!("{stem}.{layer}") };
                    images.insert(name, image);
                }
            } else if ["meta.json", "value.json", "bridge.json"].contains(&name.as_str())
                && let Ok(Value::Object(object)) = serde_json::from_slice(bytes)
            {
                meta.extend(object);
            }
        }
        Ok(Self { key: key.clone(), images, meta })
    }

    /// Its key with the media type of its values, as JSON.
    fn json(&self) -> String {
        let mut all = self.meta.clone();
        all.insert("item".into(), self.key.as_str().into());
        serde_json::to_string_pretty(&all).expect("plain data")
    }

    fn with_images(self) -> Result<Self, KindError> {
        if self.images.is_empty() {
            return Err(KindError::Input("it has no images; use `--format folder`, `csv` or `parquet`".into()));
        }
        Ok(self)
    }

    fn safetensors(&self) -> Result<Vec<u8>, DataError> {
        let tensors =
            self.images.iter().fold(TensorFile::default(), |file, (name, image)| file.with_image(name, image));
        tensors.note("meta", self.json()).to_bytes()
    }

    fn npz(&self) -> Vec<u8> {
        let arrays = self.images.iter().map(|(name, image)| (format!("{name}.npy"), npy(image)));
        zip(&arrays.chain([("meta.json".to_owned(), self.json().into_bytes())]).collect::<Vec<_>>())
    }

    /// Rungs with features, as OIDN's training toolkit groups them: the last rung is the reference.
    fn oidn(&self) -> Result<Vec<(String, Vec<u8>)>, KindError> {
        let spp = |name: &String| name.strip_prefix("spp-")?.parse::<u64>().ok();
        let rungs: BTreeMap<u64, &Image> = self.images.iter().filter_map(|(n, image)| Some((spp(n)?, image))).collect();
        let Some(last) = rungs.keys().next_back().filter(|_| rungs.len() > 1) else {
            let has = if rungs.is_empty() { "no rungs" } else { "one rung, and no reference for it" };
            let message = format!("it has {has}; `--format oidn` needs ladders or packed scenes of two rungs or more");
            return Err(KindError::Input(message));
        };
        let key = self.key.as_str().replace('/', "+");
        let mut files = Vec::new();
        for (count, image) in &rungs {
            let name = if count == last { format!("{key}_ref") } else { format!("{key}_{count:04}spp") };
            files.push((format!("{name}.hdr.exr"), exr_bytes(&[("", image)])?));
            for (layer, feature) in [("albedo", "alb"), ("normal", "nrm")] {
                if let Some(image) = self.images.get(&format!("gbuffer.{layer}")) {
                    files.push((format!("{name}.{feature}.exr"), exr_bytes(&[("", image)])?));
                }
            }
        }
        files.push((format!("{key}.json"), self.json().into_bytes()));
        Ok(files)
    }

    /// Rows of numbers and texts: one for each score, or one of all plain values.
    fn rows(&self) -> Vec<Map<String, Value>> {
        let (cell, own) = self.key.split_cell().unwrap_or(("", self.key.as_str()));
        let mut base = Map::from_iter([("item".to_owned(), Value::from(own))]);
        let pairs = cell.split(['/', '+']).filter_map(|pair| pair.split_once('='));
        base.extend(pairs.map(|(axis, value)| (axis.to_owned(), Value::from(value))));
        let plain = |object: &Map<String, Value>| -> Map<String, Value> {
            let fits = |value: &Value| value.is_number() || value.is_string() || value.is_boolean() || value.is_null();
            let mut row = base.clone();
            for (name, value) in object {
                match value {
                    Value::Object(inner) => row.extend(inner.clone().into_iter().filter(|(_, value)| fits(value))),
                    value if fits(value) => drop(row.insert(name.clone(), value.clone())),
                    _ => {}
                }
            }
            row
        };
        match self.meta.get("scores") {
            Some(Value::Array(scores)) => scores.iter().filter_map(Value::as_object).map(plain).collect(),
            _ => vec![plain(&self.meta)],
        }
    }
}

/// A NumPy array file of float32, [height, width, channels].
fn npy(image: &Image) -> Vec<u8> {
    let mut head = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}, {}), }}",
        image.height(),
        image.width(),
        image.channels()
    );
    // The header ends at a multiple of 64 bytes.
    while (10 + head.len() + 1) % 64 != 0 {
        head.push(' ');
    }
    head.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((head.len() as u16).to_le_bytes());
    out.extend(head.bytes());
    out.extend(image.data().iter().flat_map(|value| value.to_le_bytes()));
    out
}

/// CRC-32 as in ZIP files.
fn crc(bytes: &[u8]) -> u32 {
    let table: Vec<u32> = (0..256u32)
        .map(|byte| (0..8).fold(byte, |crc, _| if crc & 1 == 1 { 0xedb8_8320 ^ (crc >> 1) } else { crc >> 1 }))
        .collect();
    !bytes.iter().fold(!0u32, |crc, byte| table[((crc ^ u32::from(*byte)) & 255) as usize] ^ (crc >> 8))
}

/// A ZIP archive of uncompressed files, all with the date 1980-01-01: equal files give equal bytes.
pub(super) fn zip(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in files {
        let start = out.len() as u32;
        let mut fields = vec![20u8, 0, 0, 0, 0, 0, 0, 0, 0x21, 0];
        fields.extend(crc(bytes).to_le_bytes());
        fields.extend((bytes.len() as u32).to_le_bytes());
        fields.extend((bytes.len() as u32).to_le_bytes());
        fields.extend((name.len() as u16).to_le_bytes());
        fields.extend([0, 0]);
        out.extend(b"PK\x03\x04");
        out.extend(&fields);
        out.extend(name.bytes());
        out.extend(bytes);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&fields);
        directory.extend([0; 10]);
        directory.extend(start.to_le_bytes());
        directory.extend(name.bytes());
    }
    let (start, count) = (out.len() as u32, (files.len() as u16).to_le_bytes());
    out.extend(&directory);
    out.extend(b"PK\x05\x06\x00\x00\x00\x00");
    out.extend([count, count].concat());
    out.extend((directory.len() as u32).to_le_bytes());
    out.extend(start.to_le_bytes());
    out.extend([0, 0]);
    out
}

/// Adds a file to a tar archive (ustar), with fixed owner and time.
fn tar(out: &mut Vec<u8>, name: &str, bytes: &[u8]) -> Result<(), KindError> {
    let split = if name.len() <= 100 {
        Some(("", name))
    } else {
        name.match_indices('/').map(|(at, _)| (&name[..at], &name[at + 1..])).find(|(_, own)| own.len() <= 100)
    };
    let Some((prefix, own)) = split.filter(|(prefix, _)| prefix.len() <= 155) else {
        return Err(KindError::Input(format!("`{name}` is too long for a tar archive; use `--format npz`")));
    };
    let mut head = [0u8; 512];
    let mut put = |at: usize, text: &str| head[at..at + text.len()].copy_from_slice(text.as_bytes());
    put(0, own);
    put(100, "0000644\0");
    put(108, "0000000\0");
    put(116, "0000000\0");
    put(124, &format!("{:011o}\0", bytes.len()));
    put(136, "00000000000\0");
    put(148, "        ");
    put(156, "0");
    put(257, "ustar\x0000");
    put(345, prefix);
    let sum: u32 = head.iter().map(|byte| u32::from(*byte)).sum();
    head[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    out.extend(head);
    out.extend(bytes);
    out.resize(out.len().next_multiple_of(512), 0);
    Ok(())
}

/// What takes the files of an export.
pub(super) type Put<'a> = dyn FnMut(&str, &[u8]) -> Result<(), KindError> + 'a;

/// The items of an export in a format, one after the other.
pub(super) struct Writer {
    format: Format,
    node: String,
    archive: Vec<u8>,
    archives: usize,
    rows: Vec<Map<String, Value>>,
}

impl Writer {
    pub(super) fn new(format: Format, node: &str) -> Self {
        Self { format, node: node.to_owned(), archive: Vec::new(), archives: 0, rows: Vec::new() }
    }

    /// Adds an item.
    pub(super) fn add(
        &mut self,
        ctx: &Context<'_>,
        (key, artifact): (&ItemKey, &Artifact),
        radiance: Radiance,
        put: &mut Put<'_>,
    ) -> Result<(), KindError> {
        let plain = Plain::of(ctx, key, artifact, radiance)?;
        match self.format {
            Format::Folder | Format::Noisebase => Err(KindError::Internal("it is written elsewhere".into())),
            Format::Npz => {
                let plain = plain.with_images()?;
                let size: usize = plain.images.values().map(|image| image.data().len() * 4 + 256).sum();
                if size >= 1 << 31 {
                    return Err(KindError::Input("it has more than 2 GiB; use `--format safetensors`".into()));
                }
                put(&format!("{key}.npz"), &plain.npz())
            }
            Format::Safetensors => put(&format!("{key}.safetensors"), &plain.with_images()?.safetensors()?),
            Format::Oidn => plain.oidn()?.iter().try_for_each(|(name, bytes)| put(name, bytes)),
            Format::Csv | Format::Parquet => {
                if plain.images.is_empty() && plain.meta.is_empty() {
                    return Err(KindError::Input(
                        "it has no scores or values to make rows of; export it without `--format`: if it is a table, \
                         its own files are, too"
                            .into(),
                    ));
                }
                self.rows.extend(plain.rows());
                Ok(())
            }
            Format::Webdataset => {
                let plain = plain.with_images()?;
                // The part before the first point is the sample's key.
                let own = key.as_str().replace('.', "_");
                for (name, image) in &plain.images {
                    tar(&mut self.archive, &format!("{own}.{name}.npy"), &npy(image))?;
                }
                tar(&mut self.archive, &format!("{own}.meta.json"), plain.json().as_bytes())?;
                if self.archive.len() >= SHARD { self.shard(put) } else { Ok(()) }
            }
        }
    }

    /// Writes what is left.
    pub(super) fn finish(mut self, put: &mut Put<'_>) -> Result<(), KindError> {
        if !self.archive.is_empty() {
            self.shard(put)?;
        }
        if self.format == Format::Csv {
            put(&format!("{}.csv", self.node), csv(&self.rows).as_bytes())?;
        }
        if self.format == Format::Parquet {
            put(&format!("{}.parquet", self.node), &super::parquet::file(&names(&self.rows), &self.rows)?)?;
        }
        Ok(())
    }

    fn shard(&mut self, put: &mut Put<'_>) -> Result<(), KindError> {
        let mut archive = std::mem::take(&mut self.archive);
        // Two empty blocks end an archive.
        archive.resize(archive.len() + 1024, 0);
        let name = format!("{}-{:06}.tar", self.node, self.archives);
        self.archives += 1;
        put(&name, &archive)
    }
}

/// Names of the columns, in order of first appearance.
fn names(rows: &[Map<String, Value>]) -> Vec<&String> {
    let mut names: Vec<&String> = Vec::new();
    for name in rows.iter().flat_map(Map::keys) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// Rows as CSV, with a column for every name.
fn csv(rows: &[Map<String, Value>]) -> String {
    let names = names(rows);
    let heads: Vec<String> = names.iter().map(|name| csv_field(name)).collect();
    let mut out = heads.join(",");
    for row in rows {
        let field = |name: &&String| match row.get(*name) {
            None | Some(Value::Null) => String::new(),
            Some(Value::String(text)) => csv_field(text),
            Some(value) => value.to_string(),
        };
        let _ = write!(out, "\n{}", names.iter().map(field).collect::<Vec<_>>().join(","));
    }
    out.push('\n');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_zip() {
        assert_eq!(crc(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn headers_are_aligned() {
        let bytes = npy(&Image::new(5, 3, 3));
        let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!(((10 + length) % 64, bytes.len()), (0, 10 + length + 5 * 3 * 3 * 4));
    }

    #[test]
    fn long_names_are_split_or_refused() {
        let mut out = Vec::new();
        let long = format!("{}/{}", "a".repeat(90), "b".repeat(90));
        tar(&mut out, &long, b"x").expect("it fits");
        assert_eq!(out.len(), 1024);
        assert_eq!(&out[345..435], "a".repeat(90).as_bytes());
        assert!(tar(&mut out, &"c".repeat(101), b"").is_err());
    }

    #[test]
    fn rows_with_other_columns_are_padded() {
        let row = |pairs: &[(&str, Value)]| Map::from_iter(pairs.iter().map(|(k, v)| ((*k).to_owned(), v.clone())));
        let rows =
            [row(&[("item", "a,b".into()), ("x", 1.5.into())]), row(&[("item", "c".into()), ("y", Value::Null)])];
        assert_eq!(csv(&rows), "item,x,y\n\"a,b\",1.5,\nc,,\n");
    }
}
