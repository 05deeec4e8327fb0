//! The viewer beside the page: all rungs, images of methods, states of solvers, features and variances of scenes.
//!
//! Knows scores by the names of methods alone, and needs none.

use crate::{
    material::{Cell, cell_of_key},
    ranking::{conditioning_name, extra, method_name, with_baselines},
    shelf::{RAW, Shelf, Viewer, add},
};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Context, Handle, Items, KindError};
use tauflow_data::{
    VarianceTime,
    methods::axes::CONDITIONING,
    records::{Evaluation, Ladder, MethodTable, PackedScene, Refined, Rollout, Rung, Verdict},
};
use tauflow_viewer::{Content, Scene};

/// The track of the rungs.
const RUNGS: &str = "rungs";
const PREVIEW: &str = "preview";
const FEATURES: &str = "G-buffer";
const EXPOSED: &str = "exposed linear radiance";

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

/// A rung of a track, which comes after the next lower one.
fn rung(shelf: &mut Shelf, track: usize, spp: u64, tau: Option<f64>) -> usize {
    let frame = shelf.frame(track, &format!("{spp} spp"), Content::Radiance, (spp, tau));
    shelf.follow(frame, "");
    frame
}

/// The time of a sample count, by the clock of a ladder.
fn clock(counts: &[u64]) -> impl Fn(f64) -> Option<f64> + use<> {
    let ends = counts.iter().min().zip(counts.iter().max());
    let clock = ends.and_then(|(first, last)| VarianceTime::new(*first, *last).ok());
    move |count| Some(clock?.tau(count)).filter(|tau| tau.is_finite())
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
    states: ByScene<'a, Rollout>,
    previews: ByScene<'a, Ladder>,
}

impl<'a> Album<'a> {
    /// The images of these inputs. The evaluation names the methods, if there is one.
    pub fn new(
        ctx: &'a Context<'a>,
        evaluation: Option<&'a Evaluation>,
        packed: Option<Items<'a, PackedScene>>,
        (refined, states): (Option<Items<'a, Refined>>, Option<Items<'a, Rollout>>),
        [ladders, previews]: [Option<Items<'a, Ladder>>; 2],
    ) -> Self {
        let (packed, refined, states) = (by_scene(packed), by_scene(refined), by_scene(states));
        Self { ctx, evaluation, packed, refined, ladders: by_scene(ladders), states, previews: by_scene(previews) }
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
        let verdicts: BTreeMap<&str, &Verdict> =
            verdicts.iter().map(|(key, verdict)| (key.as_str(), verdict)).collect();
        let input = self.evaluation.map(|of| rung_of(of.from_spp));
        let mut shelf = Shelf::default();
        for scene in scenes {
            self.ctx.check_cancelled()?;
            shelf.put(scene, |shelf| self.scene(shelf, scene, verdicts.get(scene).copied()))?;
        }
        shelf.viewer(title, input.as_deref())
    }

    fn scene(&self, shelf: &mut Shelf, key: &str, verdict: Option<&Verdict>) -> Result<Scene, KindError> {
        let mut scene = Scene { key: key.to_owned(), stratum: stratum_of(key).to_owned(), ..Scene::default() };
        if let Some(verdict) = verdict {
            scene.reasons = Some(verdict.reasons.clone());
            scene.measures = verdict.measures.clone();
            scene.exposure = verdict.measures.get(Verdict::EXPOSURE).copied().filter(|v| v.is_finite() && *v > 0.0);
        }
        self.packed(shelf, &mut scene)?;
        self.ladders(shelf, &mut scene, (&self.ladders, RUNGS))?;
        self.refined(shelf, &mut scene)?;
        self.states(shelf, &mut scene)?;
        // Scenes that the gate rejected have nothing else.
        if scene.images.is_empty() {
            self.ladders(shelf, &mut scene, (&self.previews, PREVIEW))?;
        }
        Ok(scene)
    }

    /// Rungs and features of packed scenes.
    fn packed(&self, shelf: &mut Shelf, scene: &mut Scene) -> Result<(), KindError> {
        for (cell, packed) in self.packed.get(scene.key.as_str()).into_iter().flatten() {
            let packed = packed.load(self.ctx)?;
            let (tau, track) = (clock(&packed.counts), shelf.track(&rungs_of(cell), EXPOSED));
            for (count, state) in packed.counts.iter().zip(packed.states) {
                let frame = rung(shelf, track, *count, tau(*count as f64));
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
    fn ladders(
        &self,
        shelf: &mut Shelf,
        scene: &mut Scene,
        (ladders, what): (&ByScene<'_, Ladder>, &str),
    ) -> Result<(), KindError> {
        let packed = scene.reference.is_some();
        let mut most = 0;
        for (cell, ladder) in ladders.get(scene.key.as_str()).into_iter().flatten() {
            let ladder = ladder.load(self.ctx)?;
            if !packed {
                let (tau, factor) = (clock(&ladder.meta.counts), scene.exposure);
                let space = if factor.is_some() { EXPOSED } else { RAW };
                let track = shelf.track(&of_cell(what, cell), space);
                for Rung { spp, image } in ladder.rungs {
                    let frame = rung(shelf, track, spp, tau(spp as f64));
                    // All are compared with the render of the most samples.
                    if spp > most && what == RUNGS {
                        (most, scene.reference) = (spp, Some(frame));
                    }
                    let image = match factor {
                        Some(factor) => image.map(|v| (f64::from(v) * factor) as f32),
                        None => image,
                    };
                    add(scene, frame, image);
                }
            }
            let name = if what == RUNGS { "variance" } else { "variance of the preview" };
            let track = shelf.track(&of_cell(name, cell), RAW);
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
        let tau = clock(&self.counts(scene)?);
        for (place, cell, item) in images {
            for (said, image) in item.load(self.ctx)?.images {
                let name = place.map_or_else(|| name_of(cell, &said.method), |place| track_of(tables[place]));
                let track = shelf.track(&name, EXPOSED);
                let (label, at) = (format!("NFE {}", said.nfe), (said.nfe, tau(said.to_spp as f64)));
                let frame = shelf.frame(track, &label, Content::Radiance, at);
                shelf.made_from(frame, &rung_of(said.from_spp));
                add(scene, frame, image);
            }
        }
        Ok(())
    }

    /// The sample counts of the rungs, by which everything has its time.
    fn counts(&self, scene: &Scene) -> Result<Vec<u64>, KindError> {
        let counts = self.packed.get(scene.key.as_str()).and_then(|all| all.first());
        let counts = counts.map(|(_, packed)| packed.load(self.ctx)).transpose()?.map(|packed| packed.counts);
        Ok(counts.unwrap_or_default())
    }

    /// The states of solvers between their calls: a track for each rollout.
    fn states(&self, shelf: &mut Shelf, scene: &mut Scene) -> Result<(), KindError> {
        let Some(rollouts) = self.states.get(scene.key.as_str()) else { return Ok(()) };
        let tau = clock(&self.counts(scene)?);
        for (cell, item) in rollouts {
            let tables: Vec<&MethodTable> = self.evaluation.map(with_baselines).unwrap_or_default();
            let table = tables.into_iter().find(|table| table.cell == *cell);
            let Rollout { clock: own, states } = item.load(self.ctx)?;
            let time = own.time().ok();
            // The only state of one call is the result, which the method's own track has.
            for (said, image) in states.into_iter().filter(|(said, _)| said.nfe > 1) {
                let name = table.map_or_else(|| name_of(cell, &said.method), track_of);
                let track = shelf.track(&format!("{name}: states of NFE {}", said.nfe), EXPOSED);
                let rungs = shelf.track(RUNGS, EXPOSED);
                shelf.between(track, rungs);
                // A solver may have been trained by another clock than that of these rungs.
                let count =
                    if said.calls == said.nfe { Some(own.n_max as f64) } else { time.map(|t| t.count(said.tau)) };
                let (label, at) = (format!("call {} of {}", said.calls, said.nfe), (said.calls, count.and_then(&tau)));
                let frame = shelf.frame(track, &label, Content::Radiance, at);
                shelf.follow(frame, &rung_of(said.from_spp));
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
    of_cell(RUNGS, cell)
}

fn of_cell(what: &str, cell: &Cell) -> String {
    let values: Vec<&str> = cell.values().map(String::as_str).collect();
    if values.is_empty() { what.to_owned() } else { format!("{what}: {}", values.join(", ")) }
}

/// The name of a method that no evaluation knows: its own, and the values of its cell.
pub fn name_of(cell: &Cell, method: &str) -> String {
    let conditioning = cell.get(CONDITIONING).map(|value| conditioning_name(value));
    let names = [Some(method_name(method)), conditioning, Some(extra(cell))];
    names.into_iter().flatten().filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", ")
}
