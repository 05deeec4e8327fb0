//! The container of a glTF file: GLB chunks or plain JSON, buffers (chunk, data URI, external file), and what the file
//! requires. Knows nothing of geometry or materials.
//!
//! Source: glTF 2.0 specification, sections 3.6 and 4.4. The JSON is parsed by `gltf::json`; indices and enums are
//! checked where they are used, as the crate's own accessors panic on bad ones.

use crate::assets::refusal::{Refusal, damaged};
use base64::{Engine as _, engine::general_purpose};
use gltf::json::Root;
use serde::{Deserialize, de::IgnoredAny};
use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
};

/// External files by their [`relative_path`]: a file that has several spellings is there once.
pub type Externals = BTreeMap<String, Vec<u8>>;

/// A file taken apart.
pub struct Document<'a> {
    /// The JSON.
    pub root: Root,
    buffers: Vec<Cow<'a, [u8]>>,
    externals: &'a Externals,
    bytes: usize,
    morphs_more: bool,
    animated: bool,
}

/// Extensions that a file may require. Animations are left out, and so is what they point at.
const SUPPORTED: [&str; 20] = [
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_animation_pointer",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// The remedy for an unsupported extension.
fn remedy(extension: &str) -> &'static str {
    match extension {
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "meshopt compression is not read: decompress it, e.g. `gltf-transform copy IN OUT`"
        }
        "KHR_texture_basisu" => "KTX2 textures are not read: convert them to PNG, e.g. `gltf-transform ktxdecompress`",
        "EXT_texture_avif" => "AVIF textures are not read: convert them to PNG",
        _ => "export the file without it",
    }
}

/// The parts of a GLB: JSON and binary chunk.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Refusal> {
    let word = |at: usize| -> Option<usize> {
        let four: [u8; 4] = bytes.get(at..at + 4)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(four)).ok()
    };
    let version = word(4).ok_or_else(|| damaged("GLB header", format!("the file ends after {} bytes", bytes.len())))?;
    if version != 2 {
        return Err(Refusal::new("GLB header", format!("version {version}"), "export it as glTF 2.0"));
    }
    let length = word(8).ok_or_else(|| damaged("GLB header", format!("the file ends after {} bytes", bytes.len())))?;
    if length != bytes.len() {
        return Err(damaged("GLB header", format!("it states {length} bytes, the file has {}", bytes.len())));
    }
    let (mut at, mut number) = (12, 0);
    let (mut json, mut binary) = (None, None);
    while at < bytes.len() {
        let place = format!("GLB chunk {number}");
        let (Some(size), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) else {
            return Err(damaged(place, "its header is cut short"));
        };
        let body = bytes.get(at + 8..).and_then(|rest| rest.get(..size)).ok_or_else(|| {
            damaged(&place, format!("it states {size} bytes, {} are left", bytes.len().saturating_sub(at + 8)))
        })?;
        match kind {
            b"JSON" if number == 0 => json = Some(body),
            b"BIN\0" if binary.is_none() => binary = Some(body),
            _ if number == 0 => return Err(damaged(place, "the first chunk is not JSON")),
            // The specification wants chunks of other types skipped.
            _ => {}
        }
        at += 8 + size;
        number += 1;
    }
    Ok((json.ok_or_else(|| damaged("GLB chunk 0", "there is no JSON chunk"))?, binary))
}

/// A file's JSON, and what goes with it.
struct Parsed<'a> {
    root: Root,
    binary: Option<&'a [u8]>,
    morphs_more: bool,
    animated: bool,
}

fn parse(bytes: &[u8]) -> Result<Parsed<'_>, Refusal> {
    let (json, binary) = if bytes.starts_with(b"glTF") {
        chunks(bytes)?
    } else if bytes.iter().find(|b| !b.is_ascii_whitespace() && !b"\xef\xbb\xbf".contains(b)) == Some(&b'{') {
        (bytes, None)
    } else {
        return Err(damaged("header", "neither a GLB (`glTF` at the start) nor JSON"));
    };
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    // Some exporters pad the chunk with zero bytes.
    let end = json.iter().rposition(|b| *b != 0).map_or(0, |last| last + 1);
    let json = &json[..end];
    let (root, animated) = root_of(json)?;
    let morphs = root.meshes.iter().flat_map(|mesh| &mesh.primitives).any(|p| p.targets.is_some());
    let morphs_more = morphs && morphs_more(json);
    Ok(Parsed { root, binary, morphs_more, animated })
}

/// The JSON, and whether it has animations. These are left out, so that the crate's types need not hold them.
fn root_of(json: &[u8]) -> Result<(Root, bool), Refusal> {
    let broken = |e: serde_json::Error| damaged("JSON", e.to_string());
    let first = match gltf::json::deserialize::from_slice::<Root>(json) {
        Ok(mut root) => {
            let animated = !std::mem::take(&mut root.animations).is_empty();
            return Ok((root, animated));
        }
        Err(error) => error,
    };
    let Ok(mut value) = serde_json::from_slice::<serde_json::Value>(json) else { return Err(broken(first)) };
    let animations = value.as_object_mut().and_then(|root| root.remove("animations"));
    if animations.is_none_or(|a| !a.is_array()) {
        return Err(broken(first));
    }
    let text = serde_json::to_vec(&value).map_err(broken)?;
    let root = gltf::json::deserialize::from_slice::<Root>(&text).map_err(|_| broken(first))?;
    Ok((root, true))
}

/// Whether morph targets have attributes that the crate's types leave out.
fn morphs_more(json: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct File {
        #[serde(default)]
        meshes: Vec<Mesh>,
    }
    #[derive(Deserialize)]
    struct Mesh {
        primitives: Vec<Primitive>,
    }
    #[derive(Deserialize)]
    struct Primitive {
        #[serde(default)]
        targets: Vec<BTreeMap<String, IgnoredAny>>,
    }
    let Ok(File { meshes }) = serde_json::from_slice(json) else { return false };
    let names = meshes.iter().flat_map(|mesh| &mesh.primitives).flat_map(|p| &p.targets).flat_map(BTreeMap::keys);
    names.into_iter().any(|name| !["POSITION", "NORMAL", "TANGENT"].contains(&name.as_str()) && !name.starts_with('_'))
}

/// True for a URI that holds its data itself.
fn is_data(uri: &str) -> bool {
    uri.starts_with("data:")
}

/// The external files that a file names, sorted, without repeats; none if it cannot be read.
pub fn uris(bytes: &[u8]) -> Vec<String> {
    let Ok(Parsed { root, .. }) = parse(bytes) else { return Vec::new() };
    let named =
        root.buffers.iter().filter_map(|b| b.uri.as_ref()).chain(root.images.iter().filter_map(|i| i.uri.as_ref()));
    named.filter(|uri| !is_data(uri)).cloned().collect::<BTreeSet<_>>().into_iter().collect()
}

/// The path of an external file, relative to the file that names it; none if it leaves that file's folder or is a link
/// into the net.
pub fn relative_path(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((first, after)) = rest.split_first() {
        let hex = after.get(..2).and_then(|two| std::str::from_utf8(two).ok());
        match (first, hex.and_then(|two| u8::from_str_radix(two, 16).ok())) {
            (b'%', Some(byte)) => {
                bytes.push(byte);
                rest = &after[2..];
            }
            _ => {
                bytes.push(*first);
                rest = after;
            }
        }
    }
    let path = String::from_utf8(bytes).ok()?.replace('\\', "/");
    let inside =
        !path.is_empty() && !path.contains(['\0', ':']) && path.split('/').all(|part| !part.is_empty() && part != "..");
    let parts: Vec<&str> = path.split('/').filter(|part| *part != ".").collect();
    (inside && !parts.is_empty()).then(|| parts.join("/"))
}

fn data_uri(uri: &str) -> Option<Vec<u8>> {
    let (head, body) = uri.strip_prefix("data:")?.split_once(',')?;
    if !head.ends_with(";base64") {
        return None;
    }
    let body = body.trim_end_matches('=');
    general_purpose::STANDARD_NO_PAD.decode(body).or_else(|_| general_purpose::URL_SAFE_NO_PAD.decode(body)).ok()
}

impl<'a> Document<'a> {
    /// The JSON of a file alone.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn json(bytes: &[u8]) -> Result<Root, Refusal> {
        Ok(parse(bytes)?.root)
    }

    /// Takes a file apart.
    ///
    /// # Errors
    /// If it is damaged, needs another version or an extension that is not supported, or an external file is missing.
    pub fn open(bytes: &'a [u8], externals: &'a Externals) -> Result<Self, Refusal> {
        let (document, told) = Self::open_anyway(bytes, externals)?;
        told.into_iter().next().map_or(Ok(document), Err)
    }

    /// Takes a file apart, and lists what it requires beyond what is supported.
    ///
    /// # Errors
    /// If it is damaged, needs another version, or an external file is missing.
    pub fn open_anyway(bytes: &'a [u8], externals: &'a Externals) -> Result<(Self, Vec<Refusal>), Refusal> {
        let Parsed { root, binary, morphs_more, animated } = parse(bytes)?;
        if !root.asset.version.starts_with("2.") {
            return Err(Refusal::new("asset", format!("version {}", root.asset.version), "export it as glTF 2.0"));
        }
        let lacks = root.extensions_required.iter().filter(|e| !SUPPORTED.contains(&e.as_str())).take(64);
        let lacks: Vec<Refusal> =
            lacks.map(|e| Refusal::new("extensionsRequired", format!("`{e}` is required"), remedy(e))).collect();
        let bytes = bytes.len() + externals.values().map(Vec::len).sum::<usize>();
        let mut document = Self { root, buffers: Vec::new(), externals, bytes, morphs_more, animated };
        let opened = document.open_buffers(binary);
        // A buffer that cannot be read may be one of an extension that is not read.
        match (opened, lacks.first()) {
            (Err(_), Some(lack)) => return Err(Refusal::clone(lack)),
            (opened, _) => opened?,
        }
        Ok((document, lacks))
    }

    /// Opens the buffers, and checks the views of them.
    fn open_buffers(&mut self, binary: Option<&'a [u8]>) -> Result<(), Refusal> {
        for (number, buffer) in self.root.buffers.iter().enumerate() {
            let place = format!("buffer {number}");
            let data = match (&buffer.uri, binary) {
                (Some(uri), _) => self.fetch(uri, &place)?,
                (None, Some(binary)) if number == 0 => Cow::Borrowed(binary),
                (None, _) => return Err(damaged(place, "it has neither a URI nor a binary chunk")),
            };
            if (data.len() as u64) < buffer.byte_length.0 {
                return Err(damaged(place, format!("{} of its {} bytes are there", data.len(), buffer.byte_length.0)));
            }
            self.buffers.push(data);
        }
        for number in 0..self.root.buffer_views.len() {
            self.view(number)?;
        }
        Ok(())
    }

    /// Whether it has animations.
    pub fn is_animated(&self) -> bool {
        self.animated
    }

    /// The extensions that the file uses without requiring them, and that are not read.
    pub fn unread(&self) -> impl Iterator<Item = &str> {
        self.root.extensions_used.iter().map(String::as_str).filter(|e| !SUPPORTED.contains(e))
    }

    /// Whether morph targets move more than positions, normals and tangents.
    pub fn morphs_more(&self) -> bool {
        self.morphs_more
    }

    /// Bytes of the file and of its external files.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// The bytes behind a URI.
    ///
    /// # Errors
    /// If they are missing or not base64.
    pub fn fetch(&self, uri: &str, place: &str) -> Result<Cow<'a, [u8]>, Refusal> {
        if is_data(uri) {
            return data_uri(uri).map(Cow::Owned).ok_or_else(|| damaged(place, "a data URI that is not base64"));
        }
        let Some(path) = relative_path(uri) else {
            return Err(Refusal::new(
                place,
                format!("`{uri}` lies outside the file's folder"),
                "put it beside the file or below and name it by a relative path",
            ));
        };
        let found = self.externals.get(&path).map(|bytes| Cow::Borrowed(bytes.as_slice()));
        found.ok_or_else(|| Refusal::new(place, format!("`{uri}` is not there"), "put it beside the file"))
    }

    /// The bytes of a buffer view, and its stride if it states one.
    ///
    /// # Errors
    /// If it leaves its buffer.
    pub fn view(&self, number: usize) -> Result<(&[u8], Option<usize>), Refusal> {
        let place = || format!("bufferView {number}");
        let view = self.root.buffer_views.get(number).ok_or_else(|| damaged(place(), "there is no such view"))?;
        let buffer = view.buffer.value();
        // While buffers are being opened, later ones are not there yet; views are looked at afterwards only.
        let data = self
            .buffers
            .get(buffer)
            .ok_or_else(|| damaged(place(), format!("it names buffer {buffer}, which is not there")))?;
        let (start, length) = (view.byte_offset.map_or(0, |o| o.0), view.byte_length.0);
        let end = start.checked_add(length).filter(|end| *end <= data.len() as u64).ok_or_else(|| {
            damaged(place(), format!("bytes {start}..{start}+{length} leave buffer {buffer} of {} bytes", data.len()))
        })?;
        Ok((&data[start as usize..end as usize], view.byte_stride.map(|s| s.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_in_the_folder() {
        assert_eq!(relative_path("a%20b/c.png").as_deref(), Some("a b/c.png"));
        assert_eq!(relative_path("100%.png").as_deref(), Some("100%.png"));
        assert_eq!(relative_path("./a/%2E/./b.png").as_deref(), Some("a/b.png"));
        for bad in
            ["", ".", "./.", "/etc/passwd", "../x", "a/../../x", "%2e%2e/x", "http://x/y", "C:\\x", "a//b", "..\\x"]
        {
            assert_eq!(relative_path(bad), None, "{bad}");
        }
    }

    #[test]
    fn data_uris_are_base64_with_or_without_padding() {
        assert_eq!(data_uri("data:application/octet-stream;base64,AAEC").as_deref(), Some(&[0u8, 1, 2][..]));
        assert_eq!(data_uri("data:;base64,AAE=").as_deref(), Some(&[0u8, 1][..]));
        assert_eq!(data_uri("data:;base64,AAE").as_deref(), Some(&[0u8, 1][..]));
        assert_eq!(data_uri("data:text/plain,abc"), None);
        assert_eq!(data_uri("data:;base64,A*"), None);
    }
}
