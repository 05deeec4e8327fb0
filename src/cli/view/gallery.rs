//! The images of scenes as frames of a viewer: rungs, refined images, G-buffers, variance.

use super::{CliError, Failure, Sources, unread};
use crate::{
    ids::{Id as _, PortId},
    query::Exposures,
};
use std::collections::BTreeMap;
use tauflow_contract::{Artifact, Context, ItemKey, KindError, Media as _};
use tauflow_data::{
    Image, VarianceTime,
    records::{
        BridgeSteps, GBuffer, Generated, Ladder, PackedScene, Refined, RefinedImages, Rollout, Variant, Verdict,
    },
};
use tauflow_viewer::{Content, Frame, Scene, Track};

const EXPOSED: &str = "exposed linear radiance";
const RAW: &str = "raw linear radiance of the scene";
const DISPLAY: &str = "display values in [0, 1], with the curve of sRGB";

/// The frames and tracks that were met so far.
pub(super) struct Gallery<'a> {
    ctx: &'a Context<'a>,
    sources: &'a Sources<'a>,
    exposures: &'a [Exposures],
    tracks: Vec<Track>,
    frames: Vec<Frame>,
    /// Numbers of tracks by name, and of frames by identity.
    places: BTreeMap<String, usize>,
    /// The sample counts that each frame stands at, and that it was made from, if it has any. A solver's state stands
    /// between two counts.
    counts: Vec<Counts>,
    /// The frame that is shown first: of the output that was asked for.
    first: Option<usize>,
}

/// Where a frame stands, and what it was made from, in samples per pixel.
#[derive(Clone, Copy, Default)]
struct Counts {
    at: Option<f64>,
    from: Option<u64>,
}

impl Counts {
    fn rung(count: u64) -> Self {
        Self { at: Some(count as f64), from: None }
    }
}

/// A scene as it grows.
struct Growing<'s> {
    scene: Scene,
    name: &'s str,
}

impl<'a> Gallery<'a> {
    pub(super) fn new(ctx: &'a Context<'a>, sources: &'a Sources<'a>, exposures: &'a [Exposures]) -> Self {
        let (tracks, frames, places, counts) = Default::default();
        Self { ctx, sources, exposures, tracks, frames, places, counts, first: None }
    }

    /// The scenes that are wanted.
    pub(super) fn scenes(&self) -> Vec<String> {
        self.sources.scenes.iter().cloned().collect()
    }

    /// The frames so far.
    pub(super) fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// The tracks so far.
    pub(super) fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// The frame that is shown first, beside the reference: the noisiest rung, or without rungs an image of the output
    /// that was asked for.
    pub(super) fn first(&self) -> usize {
        let rungs = self.frames.iter().zip(&self.counts).enumerate().filter(|(_, (frame, _))| frame.track == 0);
        let least = rungs.filter_map(|(place, (_, counts))| Some((counts.at?, place)));
        least.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, place)| place).or(self.first).unwrap_or(0)
    }

    /// Frames with their times and the frames before them, and tracks.
    pub(super) fn finished(&self) -> (Vec<Frame>, Vec<Track>) {
        // The clock of everything is that of the first ladder.
        let rungs = self.frames.iter().zip(&self.counts).enumerate().filter(|(_, (frame, _))| frame.track == 0);
        let rungs: Vec<(f64, usize)> = rungs.filter_map(|(place, (_, counts))| Some((counts.at?, place))).collect();
        let count = |least: bool| {
            let counts = rungs.iter().map(|(count, _)| *count);
            if least { counts.reduce(f64::min) } else { counts.reduce(f64::max) }
        };
        let ends = count(true).zip(count(false));
        let clock = ends.and_then(|(first, last)| VarianceTime::new(first as u64, last as u64).ok());
        let tau = |count: Option<f64>| Some(clock?.tau(count?)).filter(|tau| tau.is_finite());
        let rung = |count: u64| rungs.iter().find(|(own, _)| *own == count as f64).map(|(_, place)| *place);
        let timed = |(place, (frame, counts)): (usize, (&Frame, &Counts))| {
            // Rungs and states follow each other; other images were made from a rung.
            let follows = counts.at.is_some() && (frame.track == 0 || self.tracks[frame.track].between.is_some());
            let before = if follows { self.kin(place) } else { frame.before };
            Frame { tau: tau(counts.at), before: before.or(counts.from.and_then(rung)), ..frame.clone() }
        };
        (self.frames.iter().zip(&self.counts).enumerate().map(timed).collect(), self.tracks.clone())
    }

    /// The frame before another of the same track.
    fn kin(&self, place: usize) -> Option<usize> {
        let own = &self.frames[place];
        let earlier = self.frames.iter().enumerate().filter(|(_, of)| of.track == own.track && of.order < own.order);
        earlier.max_by_key(|(_, of)| of.order).map(|(place, _)| place)
    }

    fn track(&mut self, name: &str, space: &str) -> usize {
        let key = format!("track {name}");
        *self.places.entry(key).or_insert_with(|| {
            self.tracks.push(Track {
                name: name.to_owned(),
                space: space.to_owned(),
                raw: space == RAW,
                between: None,
            });
            self.tracks.len() - 1
        })
    }

    fn frame(&mut self, track: usize, label: &str, content: Content, (order, counts): (u64, Counts)) -> usize {
        let id = format!("{}/{label}", self.tracks[track].name);
        *self.places.entry(format!("frame {id}")).or_insert_with(|| {
            self.frames.push(Frame { id, track, label: label.to_owned(), content, order, tau: None, before: None });
            self.counts.push(counts);
            self.frames.len() - 1
        })
    }

    /// All images of a scene.
    pub(super) fn scene(&mut self, name: &str) -> Result<Scene, Failure> {
        let stratum = name.rsplit_once('-').filter(|(_, index)| index.bytes().all(|b| b.is_ascii_digit()));
        let stratum = stratum.map_or("", |(stratum, _)| stratum).to_owned();
        let scene = Scene { key: name.to_owned(), stratum, ..Scene::default() };
        let mut growing = Growing { scene, name };
        let key = ItemKey::new(name).map_err(|error| CliError::Bad(error.to_string()))?;
        growing.scene.exposure = self.exposures.iter().find_map(|exposures| exposures.of_item(&key));
        let sources = self.sources;
        let family = &sources.family;
        for output in &family.verdicts {
            self.verdict(*output, &mut growing)?;
        }
        for output in &family.packed {
            self.packed(*output, &mut growing)?;
        }
        for output in &family.ladders {
            self.ladder(*output, &mut growing)?;
        }
        for output in &family.refined {
            self.refined(*output, &mut growing)?;
        }
        for output in &family.gbuffers {
            self.gbuffer(*output, &mut growing)?;
        }
        for output in &family.generated {
            self.generated(*output, &mut growing)?;
        }
        Ok(growing.scene)
    }

    /// Reads an item; what is lost is told apart from what cannot be read.
    fn read<T>(
        &self,
        output: (usize, PortId),
        key: &ItemKey,
        load: impl FnOnce(&Context<'_>) -> Result<T, KindError>,
    ) -> Result<T, Failure> {
        load(self.ctx).map_err(|error| match error {
            KindError::MissingBlob(_) => Failure::Lost(output),
            other => Failure::Error(unread(key.as_str(), other)),
        })
    }

    fn items(&self, output: (usize, PortId), name: &str) -> Vec<(ItemKey, Artifact)> {
        self.sources.of_scene(output, name).to_vec()
    }

    fn node(&self, output: (usize, PortId)) -> &str {
        &self.sources.pipeline.nodes[output.0].name
    }

    /// Name of the track of a node's cell.
    fn name(&self, output: (usize, PortId), key: &ItemKey, more: &str) -> String {
        let cell = key.split_cell().map_or("", |(cell, _)| cell);
        let values: Vec<&str> =
            cell.split(['+', '/']).filter_map(|pair| pair.split_once('=')).map(|(_, v)| v).collect();
        let told: Vec<&str> = values.into_iter().chain([more]).filter(|text| !text.is_empty()).collect();
        if told.is_empty() {
            self.node(output).to_owned()
        } else {
            format!("{}: {}", self.node(output), told.join(", "))
        }
    }

    /// Marks a frame as the first to be shown, if the output that was asked for has it.
    fn begin_at(&mut self, output: (usize, PortId), frame: usize) {
        if output == self.sources.own && self.first.is_none() {
            self.first = Some(frame);
        }
    }

    fn verdict(&self, output: (usize, PortId), growing: &mut Growing<'_>) -> Result<(), Failure> {
        for (key, artifact) in self.items(output, growing.name) {
            let verdict = self.read(output, &key, |ctx| Verdict::load(ctx, &artifact))?;
            let factor = verdict.measures.get(Verdict::EXPOSURE).copied();
            growing.scene.exposure = growing.scene.exposure.or(factor).filter(|v| v.is_finite() && *v > 0.0);
            growing.scene.reasons = Some(verdict.reasons);
            growing.scene.measures = verdict.measures;
        }
        Ok(())
    }

    fn packed(&mut self, output: (usize, PortId), growing: &mut Growing<'_>) -> Result<(), Failure> {
        for (key, artifact) in self.items(output, growing.name) {
            let packed = self.read(output, &key, |ctx| PackedScene::load(ctx, &artifact))?;
            let name = self.name(output, &key, "rungs");
            let track = self.track(&name, EXPOSED);
            let mut own = None;
            for (count, state) in packed.counts.iter().zip(packed.states) {
                let frame = self.rung(track, *count);
                self.begin_at(output, frame);
                own = Some(frame);
                growing.scene.images.push((frame, state));
            }
            growing.scene.reference = own.or(growing.scene.reference);
            if let Some(gbuffer) = packed.gbuffer {
                self.features(growing, gbuffer.channels_of(0..3), gbuffer.channels_of(3..6));
            }
        }
        Ok(())
    }

    fn rung(&mut self, track: usize, count: u64) -> usize {
        self.frame(track, &format!("{count} spp"), Content::Radiance, (count, Counts::rung(count)))
    }

    /// The rungs of a ladder that is not packed, and the variance of its samples.
    fn ladder(&mut self, output: (usize, PortId), growing: &mut Growing<'_>) -> Result<(), Failure> {
        let packed = growing.scene.reference.is_some();
        for (key, artifact) in self.items(output, growing.name) {
            let ladder = self.read(output, &key, |ctx| Ladder::load(ctx, &artifact))?;
            if !packed {
                let name = self.name(output, &key, "rungs");
                let factor = growing.scene.exposure;
                let track = self.track(&name, if factor.is_some() { EXPOSED } else { RAW });
                for rung in ladder.rungs {
                    let frame = self.rung(track, rung.spp);
                    self.begin_at(output, frame);
                    growing.scene.reference = Some(frame);
                    let image = match factor {
                        Some(factor) => rung.image.map(|v| (f64::from(v) * factor) as f32),
                        None => rung.image,
                    };
                    growing.scene.images.push((frame, image));
                }
            }
            let name = self.name(output, &key, "variance");
            let track = self.track(&name, RAW);
            let frame = self.frame(track, "per sample", Content::Variance, (0, Counts::default()));
            growing.scene.images.push((frame, ladder.variance));
        }
        Ok(())
    }

    /// The states of a solver between its calls: a track for each rollout.
    fn states(&mut self, output: (usize, PortId), growing: &mut Growing<'_>) -> Result<(), Failure> {
        for (key, artifact) in self.items(output, growing.name) {
            let Rollout { clock, states } = self.read(output, &key, |ctx| Rollout::load(ctx, &artifact))?;
            let time = clock.time().ok();
            for (said, image) in states {
                let method =
                    if key.as_str().contains(&format!("={}", said.method)) { "" } else { said.method.as_str() };
                let from = (!key.as_str().contains("from=")).then(|| format!("from {} spp", said.from_spp));
                let rollout = format!("states of NFE {}", said.nfe);
                let more = [Some(method), from.as_deref(), Some(&rollout)].into_iter().flatten();
                let more: Vec<&str> = more.filter(|text| !text.is_empty()).collect();
                let track = self.track(&self.name(output, &key, &more.join(", ")), EXPOSED);
                self.tracks[track].between = (track != 0).then_some(0);
                let at =
                    if said.calls == said.nfe { Some(clock.n_max as f64) } else { time.map(|t| t.count(said.tau)) };
                let label = format!("call {} of {}", said.calls, said.nfe);
                let counts = Counts { at, from: Some(said.from_spp) };
                let frame = self.frame(track, &label, Content::Radiance, (said.calls, counts));
                self.begin_at(output, frame);
                growing.scene.images.push((frame, image));
            }
        }
        Ok(())
    }

    fn refined(&mut self, output: (usize, PortId), growing: &mut Growing<'_>) -> Result<(), Failure> {
        if self.sources.pipeline.nodes[output.0].spec.outputs[output.1.place()].media == Rollout::NAME {
            return self.states(output, growing);
        }
        for (key, artifact) in self.items(output, growing.name) {
            let images: RefinedImages = self.read(output, &key, |ctx| {
                if artifact.media == Refined::NAME {
                    Ok(Refined::load(ctx, &artifact)?.images)
                } else {
                    Ok(BridgeSteps::load(ctx, &artifact)?.images)
                }
            })?;
            let bridge = artifact.media == BridgeSteps::NAME;
            // The last image of the first cell is shown first.
            let fresh = self.first.is_none();
            for (said, image) in images {
                let cell = key.split_cell().map_or("", |(cell, _)| cell);
                let method = if cell.contains(&format!("={}", said.method)) { "" } else { said.method.as_str() };
                // The stops of a bridge are one track: from each rung to the next, and to the last.
                let from = (!bridge && !cell.contains("from=")).then(|| format!("from {} spp", said.from_spp));
                let more = [Some(method), from.as_deref()].into_iter().flatten().filter(|text| !text.is_empty());
                let more: Vec<&str> = more.collect();
                let track = self.track(&self.name(output, &key, &more.join(", ")), EXPOSED);
                let (label, order) = if bridge {
                    (
                        format!("{} \u{2192} {} spp", said.from_spp, said.to_spp),
                        said.from_spp.saturating_mul(1 << 20).saturating_add(said.to_spp),
                    )
                } else {
                    (format!("NFE {}", said.nfe), said.nfe)
                };
                let counts = Counts { at: Some(said.to_spp as f64), from: Some(said.from_spp) };
                let frame = self.frame(track, &label, Content::Radiance, (order, counts));
                if fresh && output == self.sources.own {
                    self.first = Some(frame);
                }
                growing.scene.images.push((frame, image));
            }
        }
        Ok(())
    }

    /// A sample of a generative backbone in all variants, each compared with the frozen one, and how they came about.
    fn generated(&mut self, output: (usize, PortId), growing: &mut Growing<'_>) -> Result<(), Failure> {
        for (key, artifact) in self.items(output, growing.name) {
            let generated = self.read(output, &key, |ctx| Generated::load(ctx, &artifact))?;
            let mut frozen = None;
            for its in generated.variants {
                let (label, place) = (its.variant.label(), its.variant as u64);
                let track = self.track(&self.name(output, &key, ""), DISPLAY);
                let frame = self.frame(track, label, Content::Display, (place, Counts::default()));
                if its.variant == Variant::Frozen {
                    frozen = Some(frame);
                    growing.scene.reference = frozen;
                } else {
                    self.frames[frame].before = frozen;
                    self.begin_at(output, frame);
                }
                growing.scene.images.push((frame, its.image));
                for own in its.frames {
                    let track = self.track(&self.name(output, &key, &format!("trajectory, {label}")), DISPLAY);
                    let label = format!("step {}", own.step);
                    let frame = self.frame(track, &label, Content::Display, (own.step, Counts::default()));
                    self.frames[frame].before = self.kin(frame);
                    growing.scene.images.push((frame, own.image));
                }
            }
        }
        Ok(())
    }

    fn gbuffer(&mut self, output: (usize, PortId), growing: &mut Growing<'_>) -> Result<(), Failure> {
        for (key, artifact) in self.items(output, growing.name) {
            let gbuffer = self.read(output, &key, |ctx| GBuffer::load(ctx, &artifact))?;
            self.features(growing, gbuffer.albedo, gbuffer.normal);
        }
        Ok(())
    }

    /// Albedo and normal, once for a scene.
    fn features(&mut self, growing: &mut Growing<'_>, albedo: Image, normal: Image) {
        let track = self.track("G-buffer", "features of the first hit");
        for (order, label, content, image) in
            [(0, "albedo", Content::Albedo, albedo), (1, "normal", Content::Normal, normal)]
        {
            let frame = self.frame(track, label, content, (order, Counts::default()));
            if growing.scene.images.iter().all(|(own, _)| *own != frame) {
                growing.scene.images.push((frame, image));
            }
        }
    }
}
