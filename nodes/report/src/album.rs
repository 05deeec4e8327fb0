//! The viewer beside the page: all rungs, images of methods, features and variances of scenes.
//!
//! Knows scores by the names of methods alone, and needs none.

use crate::{
    material::{Cell, cell_of_key},
    ranking::{conditioning_name, extra, method_name, with_baselines},
};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Context, Handle, Items, KindError};
use tauflow_data::{
    Image, VarianceTime,
    methods::axes::CONDITIONING,
    records::{Evaluation, Ladder, MethodTable, PackedScene, REASONS, Refined, Verdict},
};
use tauflow_viewer::{Content, Frame, Head, Page, Scene, Track};

/// Bytes after which scenes are left out.
const MOST: usize = 24 << 20;
/// The track of the rungs.
const RUNGS: &str = "rungs";
const FEATURES: &str = "G-buffer";
const EXPOSED: &str = "exposed linear radiance";
const RAW: &str = "raw linear radiance of the scene";

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
            let (name, space, raw) = (name.to_owned(), space.to_owned(), space == RAW);
            self.tracks.push(Track { name, space, raw, between: None });
            self.tracks.len() - 1
        })
    }

    /// A frame of a track; `order` is its place there.
    fn frame(&mut self, track: usize, label: &str, content: Content, (order, tau): (u64, Option<f64>)) -> usize {
        let id = format!("{}/{label}", self.tracks[track].name);
        self.frames.iter().position(|own| own.id == id).unwrap_or_else(|| {
            self.frames.push(Frame { id, track, label: label.to_owned(), content, order, tau, before: None });
            self.frames.len() - 1
        })
    }

    /// A rung of a track, which comes after the next lower one.
    fn rung(&mut self, track: usize, spp: u64, tau: Option<f64>) -> usize {
        let frame = self.frame(track, &format!("{spp} spp"), Content::Radiance, (spp, tau));
        let lower = self.frames.iter().enumerate().filter(|(_, of)| of.track == track && of.order < spp);
        self.frames[frame].before = lower.max_by_key(|(_, of)| of.order).map(|(place, _)| place);
        frame
    }
}

/// Adds an image, unless the scene has one for this frame.
fn add(scene: &mut Scene, frame: usize, image: Image) {
    if scene.images.iter().all(|(own, _)| *own != frame) {
        scene.images.push((frame, image));
    }
}

/// The time of a sample count, by the clock of a ladder.
fn clock(counts: &[u64]) -> impl Fn(u64) -> Option<f64> + use<> {
    let ends = counts.iter().min().zip(counts.iter().max());
    let clock = ends.and_then(|(first, last)| VarianceTime::new(*first, *last).ok());
    move |count| Some(clock?.tau(count as f64)).filter(|tau| tau.is_finite())
}

/// Items by scene and cell.
type ByScene<'a, M> = BTreeMap<&'a str, Vec<(Cell, Handle<'a, M>)>>;

fn by_scene<M: tauflow_contract::Media>(items: Option<Items<'_, M>>) -> ByScene<'_, M> {
    let mut found = ByScene::new();
    for (key, item) in items.into_iter().flat_map(Items::iter) {
        let own = key.split_cell().map_or(key.as_str(), |(_, own)| own);
        found.entry(own).or_default().push((cell_of_key(key.as_str()), item));
    }
    found
}

/// All images that a report reads.
pub struct Album<'a> {
    ctx: &'a Context<'a>,
    evaluation: Option<&'a Evaluation>,
    packed: ByScene<'a, PackedScene>,
    refined: ByScene<'a, Refined>,
    ladders: ByScene<'a, Ladder>,
}

impl<'a> Album<'a> {
    /// The images of these inputs. The evaluation names the methods, if there is one.
    pub fn new(
        ctx: &'a Context<'a>,
        evaluation: Option<&'a Evaluation>,
        packed: Option<Items<'a, PackedScene>>,
        refined: Option<Items<'a, Refined>>,
        ladders: Option<Items<'a, Ladder>>,
    ) -> Self {
        let (packed, refined, ladders) = (by_scene(packed), by_scene(refined), by_scene(ladders));
        Self { ctx, evaluation, packed, refined, ladders }
    }

    /// The scenes that must be shown, then the first of each stratum.
    fn chosen<'s>(&'s self, first: &'s [String], per_stratum: usize) -> Vec<&'s str> {
        let known = self.packed.keys().chain(self.ladders.keys()).copied().collect::<BTreeSet<_>>();
        let mut taken: BTreeMap<&str, usize> = BTreeMap::new();
        let mut chosen: Vec<&str> = first.iter().map(String::as_str).collect();
        for scene in known {
            let count = taken.entry(stratum_of(scene)).or_default();
            *count += 1;
            if *count <= per_stratum && !chosen.contains(&scene) {
                chosen.push(scene);
            }
        }
        chosen
    }

    /// The viewer of these scenes and of so many of each stratum; none without a scene.
    ///
    /// # Errors
    /// If an image is missing from the store or damaged.
    pub fn viewer(
        &self,
        title: &str,
        (first, per_stratum): (&[String], usize),
        verdicts: &[(String, Verdict)],
    ) -> Result<Option<Viewer>, KindError> {
        let scenes = self.chosen(first, per_stratum);
        let (mut shelf, mut page, mut shown) = (Shelf::default(), Page::in_memory(), BTreeSet::new());
        for scene in &scenes {
            self.ctx.check_cancelled()?;
            if page.bytes() > MOST {
                break;
            }
            let verdict = verdicts.iter().find(|(key, _)| key == *scene).map(|(_, verdict)| verdict);
            let images = self.scene(&mut shelf, scene, verdict)?;
            page.add(images, &shelf.frames, &shelf.tracks).map_err(|error| KindError::Input(error.to_string()))?;
            shown.insert((*scene).to_owned());
        }
        if shown.is_empty() || shelf.frames.is_empty() {
            return Ok(None);
        }
        let input = self.evaluation.map(|of| rung_of(of.from_spp));
        let head = Head {
            title: title.to_owned(),
            provenance: "The scenes of the report beside this page. Both pages were made by".into(),
            command: "the command that the report names".into(),
            first: shelf.frames.iter().position(|frame| Some(&frame.id) == input.as_ref()).unwrap_or(0),
            reasons: REASONS.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect(),
        };
        let html = page.text(&head, &shelf.frames, &shelf.tracks);
        let html = html.map_err(|error| KindError::Internal(error.to_string()))?;
        Ok(Some(Viewer { html, left_out: scenes.len() - shown.len(), scenes: shown }))
    }

    fn scene(&self, shelf: &mut Shelf, key: &str, verdict: Option<&Verdict>) -> Result<Scene, KindError> {
        let mut scene = Scene { key: key.to_owned(), stratum: stratum_of(key).to_owned(), ..Scene::default() };
        if let Some(verdict) = verdict {
            scene.reasons = Some(verdict.reasons.clone());
            scene.measures = verdict.measures.clone();
            scene.exposure = verdict.measures.get(Verdict::EXPOSURE).copied().filter(|v| v.is_finite() && *v > 0.0);
        }
        self.packed(shelf, &mut scene)?;
        self.ladders(shelf, &mut scene)?;
        self.refined(shelf, &mut scene)?;
        Ok(scene)
    }

    /// Rungs and features of packed scenes.
    fn packed(&self, shelf: &mut Shelf, scene: &mut Scene) -> Result<(), KindError> {
        for (cell, packed) in self.packed.get(scene.key.as_str()).into_iter().flatten() {
            let packed = packed.load(self.ctx)?;
            let (tau, track) = (clock(&packed.counts), shelf.track(&rungs_of(cell), EXPOSED));
            for (count, state) in packed.counts.iter().zip(packed.states) {
                let frame = shelf.rung(track, *count, tau(*count));
                scene.reference = Some(frame);
                add(scene, frame, state);
            }
            let Some(gbuffer) = packed.gbuffer else { continue };
            let track = shelf.track(FEATURES, "features of the first hit");
            let layers = [("albedo", Content::Albedo, 0..3), ("normal", Content::Normal, 3..6)];
            for (order, (label, content, channels)) in (0..).zip(layers) {
                let frame = shelf.frame(track, label, content, (order, None));
                add(scene, frame, gbuffer.channels_of(channels));
            }
        }
        Ok(())
    }

    /// The variance of ladders, and their rungs where no packed scene has them.
    fn ladders(&self, shelf: &mut Shelf, scene: &mut Scene) -> Result<(), KindError> {
        let packed = scene.reference.is_some();
        let mut most = 0;
        for (cell, ladder) in self.ladders.get(scene.key.as_str()).into_iter().flatten() {
            let ladder = ladder.load(self.ctx)?;
            if !packed {
                let (tau, factor) = (clock(&ladder.meta.counts), scene.exposure);
                let track = shelf.track(&rungs_of(cell), if factor.is_some() { EXPOSED } else { RAW });
                for rung in ladder.rungs {
                    let frame = shelf.rung(track, rung.spp, tau(rung.spp));
                    // All are compared with the render of the most samples.
                    if rung.spp > most {
                        (most, scene.reference) = (rung.spp, Some(frame));
                    }
                    let image = match factor {
                        Some(factor) => rung.image.map(|v| (f64::from(v) * factor) as f32),
                        None => rung.image,
                    };
                    add(scene, frame, image);
                }
            }
            let name = rungs_of(cell).replacen(RUNGS, "variance", 1);
            let track = shelf.track(&name, RAW);
            let frame = shelf.frame(track, "per sample", Content::Variance, (0, None));
            add(scene, frame, ladder.variance);
        }
        Ok(())
    }

    /// The images of methods, those of the evaluation first.
    fn refined(&self, shelf: &mut Shelf, scene: &mut Scene) -> Result<(), KindError> {
        let tables: Vec<&MethodTable> = self.evaluation.map(with_baselines).unwrap_or_default();
        let place = |cell: &Cell| tables.iter().position(|table| table.cell == *cell);
        let Some(images) = self.refined.get(scene.key.as_str()) else { return Ok(()) };
        let mut images: Vec<_> = images.iter().map(|(cell, item)| (place(cell), cell, item)).collect();
        images.sort_by_key(|(place, cell, _)| (place.unwrap_or(usize::MAX), *cell));
        let counts = self.packed.get(scene.key.as_str()).and_then(|all| all.first());
        let counts = counts.map(|(_, packed)| packed.load(self.ctx)).transpose()?.map(|packed| packed.counts);
        let tau = clock(&counts.unwrap_or_default());
        for (place, cell, item) in images {
            for (said, image) in item.load(self.ctx)?.images {
                let name = place.map_or_else(|| name_of(cell, &said.method), |place| track_of(tables[place]));
                let track = shelf.track(&name, EXPOSED);
                let (label, at) = (format!("NFE {}", said.nfe), (said.nfe, tau(said.to_spp)));
                let frame = shelf.frame(track, &label, Content::Radiance, at);
                let from = rung_of(said.from_spp);
                shelf.frames[frame].before = shelf.frames.iter().position(|own| own.id == from);
                add(scene, frame, image);
            }
        }
        Ok(())
    }
}

/// The stratum in the key of a scene; empty for none.
fn stratum_of(key: &str) -> &str {
    key.rsplit_once('-').filter(|(_, index)| index.bytes().all(|b| b.is_ascii_digit())).map_or("", |(own, _)| own)
}

/// The track of the rungs of a cell.
pub fn rungs_of(cell: &Cell) -> String {
    let values: Vec<&str> = cell.values().map(String::as_str).collect();
    if values.is_empty() { RUNGS.to_owned() } else { format!("{RUNGS}: {}", values.join(", ")) }
}

/// The name of a method that no evaluation knows: its own, and the values of its cell.
pub fn name_of(cell: &Cell, method: &str) -> String {
    let conditioning = cell.get(CONDITIONING).map(|value| conditioning_name(value));
    let names = [Some(method_name(method)), conditioning, Some(extra(cell))];
    names.into_iter().flatten().filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", ")
}
