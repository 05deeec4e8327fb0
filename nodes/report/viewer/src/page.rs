//! Writes a page: scene by scene, so that memory holds no more than one file may.

use crate::{Content, Frame, Half, Head, ONE_FILE, Scene, Track, ViewerError, thumb::Thumb};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use rayon::prelude::*;
use serde::Serialize;
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};
use tauflow_data::{Image, maths::log10};

const PAGE: &str = include_str!("web/page.html");
const STYLE: &str = include_str!("web/style.css");
/// The parts of the script, in order: declarations before `input.js`, which begins.
const SCRIPTS: [&str; 9] = [
    include_str!("web/data.js"),
    include_str!("web/colour.js"),
    include_str!("web/flip.js"),
    include_str!("web/exr.js"),
    include_str!("web/gl.js"),
    include_str!("web/app.js"),
    include_str!("web/list.js"),
    include_str!("web/panels.js"),
    include_str!("web/input.js"),
];

/// Thumbnails in a part.
const BLOCK: usize = 64;
/// What is added to the square of the reference in a relative error.
const EPSILON: f64 = 0.01;

/// The files of a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The page.
    pub page: PathBuf,
    /// The folder of its data, if it is not one file.
    pub folder: Option<PathBuf>,
    /// Bytes of all of it.
    pub bytes: u64,
    /// Number of scenes.
    pub scenes: usize,
}

/// An image in a part: width, height, channels, errors of its half floats, clipped values, data in base64.
#[derive(Serialize)]
struct Packed {
    w: usize,
    h: usize,
    c: usize,
    e: [f64; 2],
    x: u64,
    d: String,
}

/// A scene in the index.
#[derive(Serialize)]
struct Listed {
    key: String,
    stratum: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    reasons: Option<Vec<String>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exposure: Option<f64>,
    reference: Option<usize>,
}

/// Values by frame and scene.
#[derive(Serialize)]
struct Metric {
    name: &'static str,
    unit: &'static str,
    values: BTreeMap<usize, Vec<Option<f64>>>,
}

#[derive(Serialize)]
struct Index<'a> {
    #[serde(flatten)]
    head: &'a Head,
    /// Folder of the data, from the page; empty if it is one file.
    folder: String,
    thumbs: usize,
    tracks: &'a [Track],
    frames: &'a [Frame],
    scenes: &'a [Listed],
    metrics: [Metric; 2],
    measures: BTreeMap<String, Vec<Option<f64>>>,
}

/// A page that is being written.
pub struct Page {
    path: PathBuf,
    limit: usize,
    /// Parts that are still in memory, by name; none once there is a folder.
    inline: Option<Vec<(String, String)>>,
    inline_bytes: usize,
    folder_bytes: u64,
    scenes: Vec<Listed>,
    thumbs: Vec<Option<Thumb>>,
    /// Relative and squared errors by scene and frame.
    errors: Vec<BTreeMap<usize, [f64; 2]>>,
    measures: Vec<BTreeMap<String, f64>>,
}

impl Page {
    /// A page at `path`, one file up to `limit` bytes ([`ONE_FILE`] unless said otherwise).
    pub fn new(path: impl Into<PathBuf>, limit: Option<usize>) -> Self {
        let path = path.into();
        let (scenes, thumbs, errors, measures) = Default::default();
        let limit = limit.unwrap_or(ONE_FILE);
        Self { path, limit, inline: Some(vec![]), inline_bytes: 0, folder_bytes: 0, scenes, thumbs, errors, measures }
    }

    /// A page that is one text in memory, however large.
    pub fn in_memory() -> Self {
        Self::new(PathBuf::new(), Some(usize::MAX))
    }

    /// Bytes of the data so far.
    pub fn bytes(&self) -> usize {
        self.inline_bytes
    }

    /// Adds a scene, whose images are of the frames and tracks so far.
    ///
    /// # Errors
    /// If an image cannot be shown, or a file cannot be written.
    pub fn add(&mut self, scene: Scene, frames: &[Frame], tracks: &[Track]) -> Result<(), ViewerError> {
        for (frame, image) in &scene.images {
            if image.width() * image.height() == 0 || !matches!(image.channels(), 1 | 3) {
                return Err(ViewerError::Image {
                    scene: scene.key.clone(),
                    frame: frames[*frame].id.clone(),
                    width: image.width(),
                    height: image.height(),
                    channels: image.channels(),
                });
            }
        }
        let packed: BTreeMap<usize, Packed> =
            scene.images.par_iter().map(|(frame, image)| (*frame, packed(image))).collect();
        let number = self.scenes.len();
        let content = serde_json::json!({ "images": packed });
        self.part(format!("s{number:06}"), content.to_string())?;
        let image_of = |frame: usize| scene.images.iter().find(|(own, _)| *own == frame).map(|(_, image)| image);
        let reference = scene.reference.and_then(|frame| Some((frame, image_of(frame)?)));
        let radiance = |frame: &usize| matches!(frames[*frame].content, Content::Radiance | Content::Display);
        let rows = reference.map_or_else(BTreeMap::new, |(own, reference)| {
            let others = scene
                .images
                .par_iter()
                .filter(|(frame, image)| *frame != own && radiance(frame) && image.same_shape(reference));
            others.map(|(frame, image)| (*frame, errors(image, reference))).collect()
        });
        self.errors.push(rows);
        let face = reference.or_else(|| scene.images.iter().rev().find(|(f, _)| radiance(f)).map(|(f, i)| (*f, i)));
        self.thumbs.push(face.map(|(frame, image)| match frames[frame].content {
            Content::Display => Thumb::of_display(image),
            _ => Thumb::of(image, tracks[frames[frame].track].raw),
        }));
        self.measures.push(scene.measures);
        let Scene { key, stratum, reasons, exposure, reference, .. } = scene;
        self.scenes.push(Listed { key, stratum, reasons, exposure, reference });
        Ok(())
    }

    /// Writes the page.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn finish(mut self, head: &Head, frames: &[Frame], tracks: &[Track]) -> Result<Written, ViewerError> {
        let page = self.text(head, frames, tracks)?;
        write(&self.path, page.as_bytes())?;
        let folder = self.inline.is_none().then(|| self.folder());
        if folder.is_none() {
            remove_parts(&self.folder(), 0)?;
        }
        let bytes = page.len() as u64 + self.folder_bytes;
        Ok(Written { page: self.path.clone(), folder, bytes, scenes: self.scenes.len() })
    }

    /// The page as a text, which refers to the files that were written before.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn text(&mut self, head: &Head, frames: &[Frame], tracks: &[Track]) -> Result<String, ViewerError> {
        let thumbs = std::mem::take(&mut self.thumbs);
        for (block, thumbs) in thumbs.chunks(BLOCK).enumerate() {
            self.part(format!("t{block:04}"), serde_json::json!({ "thumbs": thumbs }).to_string())?;
        }
        let column = |frame: usize, of: &dyn Fn([f64; 2]) -> f64| -> Vec<Option<f64>> {
            let value = |row: &BTreeMap<usize, [f64; 2]>| row.get(&frame).map(|e| of(*e)).filter(|v| v.is_finite());
            self.errors.iter().map(|row| value(row).map(rounded)).collect()
        };
        let metric = |name, unit, of: &dyn Fn([f64; 2]) -> f64| {
            let columns = (0..frames.len()).map(|frame| (frame, column(frame, of)));
            Metric { name, unit, values: columns.filter(|(_, values)| values.iter().any(Option::is_some)).collect() }
        };
        let psnr = metric("PSNR", "dB", &|[squared, _]| -10.0 * log10(squared));
        let relative = metric("relMSE", "", &|[_, relative]| relative);
        let names = self.measures.iter().flat_map(BTreeMap::keys).cloned();
        let measure = |name: String| {
            let values = self.measures.iter().map(|own| own.get(&name).copied().map(rounded)).collect();
            (name, values)
        };
        let measures: BTreeMap<_, _> =
            names.collect::<std::collections::BTreeSet<_>>().into_iter().map(measure).collect();
        let folder = if self.inline.is_some() { String::new() } else { name_of(&self.folder()) };
        let index = Index {
            head,
            folder,
            thumbs: BLOCK,
            tracks,
            frames,
            scenes: &self.scenes,
            metrics: [psnr, relative],
            measures,
        };
        let index = serde_json::to_string(&index).expect("plain data");
        let parts = self.inline.iter().flatten().map(|(name, json)| {
            format!("<script type=\"application/json\" id=\"d-{name}\">{}</script>\n", inert(json))
        });
        Ok(filled(&head.title, &inert(&index), &parts.collect::<String>()))
    }

    /// The folder of the data: `NAME_files` beside `NAME.html`.
    fn folder(&self) -> PathBuf {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        self.path.with_file_name(format!("{stem}_files"))
    }

    fn part(&mut self, name: String, json: String) -> Result<(), ViewerError> {
        self.inline_bytes += json.len();
        match &mut self.inline {
            Some(parts) => {
                parts.push((name, json));
                if self.inline_bytes > self.limit {
                    let parts = self.inline.take().expect("it is there");
                    let folder = self.folder();
                    fs::create_dir_all(&folder).map_err(|source| ViewerError::Io { path: folder.clone(), source })?;
                    remove_parts(&folder, 1)?;
                    return parts.iter().try_for_each(|(name, json)| self.script(name, json));
                }
                Ok(())
            }
            None => self.script(&name, &json),
        }
    }

    fn script(&mut self, name: &str, json: &str) -> Result<(), ViewerError> {
        let script = format!("tauflowData(\"{name}\",{json});\n");
        self.folder_bytes += script.len() as u64;
        write(&self.folder().join(format!("{name}.js")), script.as_bytes())
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Removes the parts of an earlier page, and its folder once it is empty and nobody needs it.
fn remove_parts(folder: &Path, keep: u8) -> Result<(), ViewerError> {
    let Ok(entries) = fs::read_dir(folder) else { return Ok(()) };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let digits = name.strip_suffix(".js").and_then(|stem| stem.strip_prefix(['s', 't']));
        if digits.is_some_and(|digits| !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit())) {
            let path = entry.path();
            fs::remove_file(&path).map_err(|source| ViewerError::Io { path, source })?;
        }
    }
    if keep == 0 {
        // It stays if it holds anything else.
        let _ = fs::remove_dir(folder);
    }
    Ok(())
}

/// Four significant digits are enough for a list.
fn rounded(value: f64) -> f64 {
    format!("{value:.4e}").parse().unwrap_or(value)
}

fn packed(image: &Image) -> Packed {
    let half = Half::of(image);
    let (w, h, c) = (image.width(), image.height(), image.channels());
    let d = STANDARD.encode(half.packed(w, h, c));
    Packed { w, h, c, e: [half.absolute, half.relative].map(rounded_up), x: half.clipped, d }
}

/// An upper bound in four digits.
fn rounded_up(value: f64) -> f64 {
    let near = rounded(value);
    if near < value { rounded(value * 1.0001) } else { near }
}

/// Mean squared error, and mean relative squared error.
fn errors(image: &Image, reference: &Image) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (value, real) in image.data().iter().zip(reference.data()) {
        let (value, real) = (f64::from(*value), f64::from(*real));
        let squared = (value - real) * (value - real);
        sums[0] += squared;
        sums[1] += squared / (real * real + EPSILON);
    }
    sums.map(|sum| sum / image.data().len() as f64)
}

/// JSON that cannot end the element it stands in.
fn inert(json: &str) -> String {
    json.replace('<', "\\u003c")
}

fn filled(title: &str, index: &str, data: &str) -> String {
    let title = title.replace('&', "&amp;").replace('<', "&lt;");
    let scripts = SCRIPTS.join("\n");
    // One pass, so that nothing that is filled in is looked at again.
    let mut out = String::with_capacity(PAGE.len() + STYLE.len() + scripts.len() + index.len() + data.len());
    let mut rest = PAGE;
    while let Some((before, after)) = rest.split_once("{{") {
        out.push_str(before);
        let (name, after) = after.split_once("}}").expect("own template");
        out.push_str(match name {
            "TITLE" => &title,
            "STYLE" => STYLE,
            "INDEX" => index,
            "DATA" => data,
            _ => &scripts,
        });
        rest = after;
    }
    out.push_str(rest);
    out
}

/// Writes a file whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Result<(), ViewerError> {
    let failed = |source| ViewerError::Io { path: path.to_owned(), source };
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    let temporary = path.with_file_name(format!(".{}.tmp", name_of(path)));
    fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path)).map_err(|error| {
        // Nobody has a use for half of a page.
        let _ = fs::remove_file(&temporary);
        failed(error)
    })
}
