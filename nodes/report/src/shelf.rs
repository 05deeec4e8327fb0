//! The viewer beside a page: frames and tracks as scenes bring them, up to the bytes that one file may have.
//!
//! Knows no artifact, and no other section of the page.

use std::collections::BTreeSet;
use tauflow_contract::KindError;
use tauflow_data::{Image, records::REASONS};
use tauflow_viewer::{Content, Frame, Head, Page, Scene, Track};

/// Bytes after which scenes are left out.
const MOST: usize = 24 << 20;
/// The space of radiance without an exposure.
pub const RAW: &str = "raw linear radiance of the scene";

/// The page of the viewer, and the scenes that it shows.
pub struct Viewer {
    /// The page.
    pub html: String,
    scenes: BTreeSet<String>,
    /// Number of scenes that had no room.
    pub left_out: usize,
}

impl Viewer {
    /// Name of its file.
    pub const FILE: &'static str = "viewer.html";

    /// The address of a frame of a scene, compared with the reference; none for a scene that has no room.
    pub fn address(&self, scene: &str, frame: &str) -> Option<String> {
        let plain = |b: u8| if b.is_ascii_alphanumeric() { char::from(b).to_string() } else { format!("%{b:02X}") };
        let coded = |text: &str| text.bytes().map(plain).collect::<String>();
        self.scenes
            .contains(scene)
            .then(|| format!("{}#scene={}&amp;a={}&amp;mode=wipe", Self::FILE, coded(scene), coded(frame)))
    }
}

/// A viewer that grows by scenes.
pub struct Shelf {
    frames: Vec<Frame>,
    tracks: Vec<Track>,
    page: Page,
    shown: BTreeSet<String>,
    left_out: usize,
}

impl Default for Shelf {
    fn default() -> Self {
        let (frames, tracks, shown) = Default::default();
        Self { frames, tracks, page: Page::in_memory(), shown, left_out: 0 }
    }
}

impl Shelf {
    /// Adds a scene, which `images` reads only if there is room.
    ///
    /// # Errors
    /// Those of `images`, or if an image cannot be shown.
    pub fn put(
        &mut self,
        key: &str,
        images: impl FnOnce(&mut Self) -> Result<Scene, KindError>,
    ) -> Result<(), KindError> {
        if self.page.bytes() > MOST {
            self.left_out += 1;
            return Ok(());
        }
        let scene = images(self)?;
        self.page.add(scene, &self.frames, &self.tracks).map_err(|error| KindError::Input(error.to_string()))?;
        self.shown.insert(key.to_owned());
        Ok(())
    }

    /// The viewer, which opens with the frame `first`; none without an image.
    ///
    /// # Errors
    /// If the page cannot be made.
    pub fn viewer(mut self, title: &str, first: Option<&str>) -> Result<Option<Viewer>, KindError> {
        if self.shown.is_empty() || self.frames.is_empty() {
            return Ok(None);
        }
        let head = Head {
            title: title.to_owned(),
            provenance: "The scenes of the report beside this page. Both pages were made by".into(),
            command: "the command that the report names".into(),
            first: self.frames.iter().position(|frame| Some(frame.id.as_str()) == first).unwrap_or(0),
            reasons: REASONS.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect(),
        };
        let html = self.page.text(&head, &self.frames, &self.tracks);
        let html = html.map_err(|error| KindError::Internal(error.to_string()))?;
        Ok(Some(Viewer { html, left_out: self.left_out, scenes: self.shown }))
    }

    /// The track of this name.
    pub fn track(&mut self, name: &str, space: &str) -> usize {
        self.tracks.iter().position(|track| track.name == name).unwrap_or_else(|| {
            let (name, space, raw) = (name.to_owned(), space.to_owned(), space == RAW);
            self.tracks.push(Track { name, space, raw, between: None });
            self.tracks.len() - 1
        })
    }

    /// A frame of a track; `order` is its place there.
    pub fn frame(&mut self, track: usize, label: &str, content: Content, (order, tau): (u64, Option<f64>)) -> usize {
        let id = format!("{}/{label}", self.tracks[track].name);
        self.place(&id).unwrap_or_else(|| {
            self.frames.push(Frame { id, track, label: label.to_owned(), content, order, tau, before: None });
            self.frames.len() - 1
        })
    }

    /// Says that the states of a track stand between those of another, which somebody rendered.
    pub fn between(&mut self, track: usize, rungs: usize) {
        self.tracks[track].between = Some(rungs).filter(|rungs| *rungs != track);
    }

    /// Says which frame another was made from.
    pub fn made_from(&mut self, frame: usize, id: &str) {
        self.frames[frame].before = self.place(id);
    }

    /// Says that a frame comes after the one before it in its track, and the first of a track after `id`.
    pub fn follow(&mut self, frame: usize, id: &str) {
        let (track, order) = (self.frames[frame].track, self.frames[frame].order);
        let lower = self.frames.iter().enumerate().filter(|(_, of)| of.track == track && of.order < order);
        let lower = lower.max_by_key(|(_, of)| of.order).map(|(place, _)| place);
        self.frames[frame].before = lower.or_else(|| self.place(id));
    }

    fn place(&self, id: &str) -> Option<usize> {
        self.frames.iter().position(|frame| frame.id == id)
    }
}

/// Adds an image, unless the scene has one for this frame.
pub fn add(scene: &mut Scene, frame: usize, image: Image) {
    if scene.images.iter().all(|(own, _)| *own != frame) {
        scene.images.push((frame, image));
    }
}
