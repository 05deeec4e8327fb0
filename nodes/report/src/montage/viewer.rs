//! The viewer beside the page: all rungs, refined images and features of the scenes that the page shows.

use super::Pictures;
use crate::ranking::{conditioning_name, extra, method_name, with_baselines};
use std::collections::BTreeSet;
use tauflow_contract::KindError;
use tauflow_data::{
    VarianceTime,
    records::{MethodTable, REASONS, Verdict},
};
use tauflow_viewer::{Content, Frame, Head, Page, Scene, Track};

/// Bytes after which scenes are left out.
const MOST: usize = 24 << 20;
/// The track of the rungs.
const RUNGS: &str = "rungs";
const FEATURES: &str = "G-buffer";

/// The page of the viewer, and the scenes that it shows.
pub struct Viewer {
    /// The page.
    pub html: String,
    scenes: BTreeSet<String>,
    /// Number of scenes that had no room.
    pub left_out: usize,
}

/// The track of a method.
pub fn track_of(table: &MethodTable) -> String {
    let names = [method_name(&table.method), conditioning_name(&table.conditioning), extra(&table.cell)];
    names.into_iter().filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", ")
}

/// The frame of a number of calls.
pub fn frame_of(track: &str, nfe: u64) -> String {
    format!("{track}/NFE {nfe}")
}

/// The frame of a rung.
pub fn rung_of(spp: u64) -> String {
    format!("{RUNGS}/{spp} spp")
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

/// Frames and tracks as they are met.
#[derive(Default)]
struct Shelf {
    frames: Vec<Frame>,
    tracks: Vec<Track>,
}

impl Shelf {
    fn track(&mut self, name: &str, space: &str) -> usize {
        self.tracks.iter().position(|track| track.name == name).unwrap_or_else(|| {
            self.tracks.push(Track { name: name.to_owned(), space: space.to_owned(), raw: false });
            self.tracks.len() - 1
        })
    }

    fn frame(&mut self, frame: Frame) -> usize {
        self.frames.iter().position(|own| own.id == frame.id).unwrap_or_else(|| {
            self.frames.push(frame);
            self.frames.len() - 1
        })
    }
}

impl Pictures<'_> {
    /// The viewer of these scenes and of the first ones of each stratum; none without a scene.
    ///
    /// # Errors
    /// If an image is missing from the store or damaged.
    pub fn viewer(
        &self,
        title: &str,
        more: &[String],
        verdicts: &[(String, Verdict)],
    ) -> Result<Option<Viewer>, KindError> {
        let chosen = self.chosen.iter().map(|(scene, _, _)| scene);
        let scenes: BTreeSet<&String> = more.iter().chain(chosen).collect();
        let (mut shelf, mut page, mut shown) = (Shelf::default(), Page::in_memory(), BTreeSet::new());
        for scene in &scenes {
            self.ctx.check_cancelled()?;
            if page.bytes() > MOST {
                break;
            }
            let verdict = verdicts.iter().find(|(key, _)| key == *scene).map(|(_, verdict)| verdict);
            let images = self.scene(&mut shelf, scene, verdict)?;
            page.add(images, &shelf.frames, &shelf.tracks).map_err(|error| KindError::Input(error.to_string()))?;
            shown.insert((*scene).clone());
        }
        if shown.is_empty() {
            return Ok(None);
        }
        let input = rung_of(self.evaluation.from_spp);
        let head = Head {
            title: title.to_owned(),
            provenance: "The scenes of report.html. Both pages were made by".into(),
            command: "the command that report.html names".into(),
            first: shelf.frames.iter().position(|frame| frame.id == input).unwrap_or(0),
            reasons: REASONS.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect(),
        };
        let html = page.text(&head, &shelf.frames, &shelf.tracks);
        let html = html.map_err(|error| KindError::Internal(error.to_string()))?;
        Ok(Some(Viewer { html, left_out: scenes.len() - shown.len(), scenes: shown }))
    }

    fn scene(&self, shelf: &mut Shelf, key: &str, verdict: Option<&Verdict>) -> Result<Scene, KindError> {
        let stratum = key.rsplit_once('-').map_or("", |(stratum, _)| stratum).to_owned();
        let mut scene = Scene { key: key.to_owned(), stratum, ..Scene::default() };
        if let Some(verdict) = verdict {
            scene.reasons = Some(verdict.reasons.clone());
            scene.measures = verdict.measures.clone();
            scene.exposure = verdict.measures.get(Verdict::EXPOSURE).copied().filter(|v| v.is_finite() && *v > 0.0);
        }
        let Some(packed) = self.scenes.get(key) else { return Ok(scene) };
        let packed = packed.load(self.ctx)?;
        let ends = packed.counts.iter().min().zip(packed.counts.iter().max());
        let clock = ends.and_then(|(first, last)| VarianceTime::new(*first, *last).ok());
        let tau = |count: u64| Some(clock?.tau(count as f64)).filter(|tau| tau.is_finite());
        let radiance = |id: String, track, label: String, order, tau| Frame {
            id,
            track,
            label,
            content: Content::Radiance,
            order,
            tau,
        };
        let track = shelf.track(RUNGS, "exposed linear radiance");
        for (count, state) in packed.counts.iter().zip(packed.states) {
            let frame = radiance(rung_of(*count), track, format!("{count} spp"), *count, tau(*count));
            let frame = shelf.frame(frame);
            scene.reference = Some(frame);
            scene.images.push((frame, state));
        }
        for table in with_baselines(self.evaluation) {
            let Some(images) = self.images.get(&(table.cell.clone(), key)) else { continue };
            let name = track_of(table);
            let track = shelf.track(&name, "exposed linear radiance");
            for (said, image) in images.load(self.ctx)?.images {
                let frame =
                    radiance(frame_of(&name, said.nfe), track, format!("NFE {}", said.nfe), said.nfe, tau(said.to_spp));
                let frame = shelf.frame(frame);
                if scene.images.iter().all(|(own, _)| *own != frame) {
                    scene.images.push((frame, image));
                }
            }
        }
        if let Some(gbuffer) = packed.gbuffer {
            let track = shelf.track(FEATURES, "features of the first hit");
            let layers = [("albedo", Content::Albedo, 0..3), ("normal", Content::Normal, 3..6)];
            for (order, (label, content, channels)) in layers.into_iter().enumerate() {
                let id = format!("{FEATURES}/{label}");
                let frame = Frame { id, track, label: label.into(), content, order: order as u64, tau: None };
                let frame = shelf.frame(frame);
                scene.images.push((frame, gbuffer.channels_of(channels)));
            }
        }
        Ok(scene)
    }
}
