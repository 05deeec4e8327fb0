//! Training batches out of packed scenes, all in memory. The batch of a step is a function of the seed and the step.

mod pick;
mod targets;

use self::{
    pick::{COLOURS, Pick, Tiles},
    targets::{others, unbiased},
};
use super::patches::Patches;
use crate::{
    model::Model,
    network::{
        features::{Encoding, Sample},
        loss::{Loss, Shown, preview_of},
    },
    parameterization::ParameterizationMaths as _,
    rollout::{Course, rollout},
};
use rayon::prelude::*;
use std::sync::Arc;
use tauflow_contract::{All, Context, Items, KindError};
use tauflow_data::{
    Image, SamplerKind, maths, methods::Conditioning, records::PackedScene, rng::Stream, time::TimeGrid,
};

/// Scenes with rungs of one ladder, of which some may have only the first.
#[derive(Debug)]
pub(crate) struct DataSet {
    /// The rungs of the longest ladder.
    pub(crate) counts: Vec<u64>,
    pub(crate) sampler: SamplerKind,
    scenes: Vec<PackedScene>,
    /// Whether targets are corrected for the bias that noise has after a curve.
    unbiased: bool,
    /// Whether the noise of their previews must be known.
    with_noise: bool,
}

/// Examples of one shape: what the network is told, and what it should say.
pub(crate) struct Batch {
    states: Vec<Vec<f32>>,
    gbuffers: Vec<Option<Vec<f32>>>,
    tau: Vec<Option<f64>>,
    /// [N, H, W, 3].
    pub(crate) targets: Arc<Vec<f32>>,
    /// The previews of the clean images, [N, H, W, 3], if targets are corrected.
    previews: Option<Arc<Vec<f32>>>,
    /// The variance of the noise in these previews, if the loss needs it.
    noise: Option<Arc<Vec<f32>>>,
    /// Height and width.
    pub(crate) side: usize,
}

/// The window of a pick.
struct Example {
    /// [H, W, 3], like targets and previews.
    state: Vec<f32>,
    target: Vec<f32>,
    /// The target's previews; empty if targets are not corrected.
    previews: Vec<f32>,
    /// The variance of their noise; empty where it is not needed.
    noise: Vec<f32>,
    /// [H, W, 6].
    gbuffer: Option<Vec<f32>>,
}

/// Test scenes whose gain is watched during training.
const WATCHED: usize = 8;

impl DataSet {
    /// Loads a collection of packed scenes.
    ///
    /// # Errors
    /// If it is empty, scenes have rungs that are not the first of one ladder, or G-buffers are missing where they are
    /// needed.
    pub(crate) fn load(
        ctx: &Context<'_>,
        items: Items<'_, PackedScene>,
        port: All<PackedScene>,
        conditioning: Conditioning,
    ) -> Result<Self, KindError> {
        let mut scenes = Vec::with_capacity(items.len());
        for (key, scene) in items.iter() {
            let scene = scene.load(ctx).map_err(|error| match error {
                KindError::Input(told) => KindError::Input(format!("scene {key} of input `{}`: {told}", port.name())),
                error => error,
            })?;
            scenes.push((key.as_str(), scene));
        }
        Self::new(scenes, port.name(), conditioning)
    }

    pub(crate) fn new(
        scenes: Vec<(&str, PackedScene)>,
        port: &str,
        conditioning: Conditioning,
    ) -> Result<Self, KindError> {
        let Some((first_key, first)) = scenes.first() else {
            return Err(KindError::Input(format!("input `{port}` has no scenes; raise the quota of its sampling")));
        };
        let sampler = first.sampler;
        let (mut longest, mut counts) = (first_key, first.counts.clone());
        for (key, scene) in &scenes {
            if scene.counts.len() > counts.len() {
                (longest, counts) = (key, scene.counts.clone());
            }
        }
        for (key, scene) in &scenes {
            if scene.counts.len() < 2 {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` has {} rungs; training needs at least two",
                    scene.counts.len()
                )));
            }
            if !counts.starts_with(&scene.counts) {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` has rungs {:?}, but {longest} has {counts:?}; render all with the \
                     same `rungs`, or with the first of them",
                    scene.counts
                )));
            }
            if scene.sampler != sampler {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` has samples by `{}`, but {first_key} by `{}`; render all with the \
                    same `sampler`",
                    scene.sampler.name(),
                    sampler.name()
                )));
            }
            if let Some(image) = scene.states.iter().find(|s| s.data().iter().any(|v| !v.is_finite())) {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` contains a value that is not finite in an image of {} x {}; check \
                    why the gate accepted it",
                    image.width(),
                    image.height()
                )));
            }
            if scene.gbuffer.as_ref().is_some_and(|g| g.data().iter().any(|v| !v.is_finite())) {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` contains a value that is not finite in its G-buffer; render it \
                    again, or omit `gbuffers`"
                )));
            }
            let (width, height) = size(scene);
            let fits = |g: &Image| (g.width(), g.height(), g.channels()) == (width, height, 6);
            if conditioning == Conditioning::Gbuffer && !scene.gbuffer.as_ref().is_some_and(fits) {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` has no G-buffer of its size, but `conditioning` is gbuffer; \
                    connect `gbuffers` of its `dataset_packing`"
                )));
            }
        }
        // Unused data takes no memory.
        let kept = |scene: PackedScene| match conditioning {
            Conditioning::Gbuffer => scene,
            Conditioning::Rgb => PackedScene { gbuffer: None, ..scene },
        };
        let scenes = scenes.into_iter().map(|(_, scene)| kept(scene)).collect();
        Ok(Self { counts, sampler, scenes, unbiased: false, with_noise: false })
    }

    /// The same scenes, with the targets that a loss asks for.
    ///
    /// # Errors
    /// If they cannot be had: the correction rests on independent samples.
    pub(crate) fn for_loss(self, loss: Loss) -> Result<Self, KindError> {
        if loss.is_unbiased() && !self.sampler.is_independent() {
            return Err(KindError::Input(
                "`loss: unbiased_preview` and `loss: structural` need independent samples, but those of the scenes are \
                correlated; render them with `sampler: independent`, or use `loss: preview`"
                    .into(),
            ));
        }
        Ok(Self { unbiased: loss.is_unbiased(), with_noise: loss.is_structural(), ..self })
    }

    /// Whether all scenes have the whole ladder.
    pub(crate) fn is_whole(&self) -> bool {
        self.scenes.iter().all(|scene| self.has_all(scene))
    }

    fn has_all(&self, scene: &PackedScene) -> bool {
        scene.counts.len() == self.counts.len()
    }

    /// Number of scenes.
    pub(crate) fn len(&self) -> usize {
        self.scenes.len()
    }

    /// The side of the square windows that training sees: `wanted`, cut to what the smallest image and the network
    /// allow.
    ///
    /// # Errors
    /// If an image is smaller than the network's coarsest pixel, or than what the loss judges.
    pub(crate) fn side(&self, wanted: usize, multiple: usize, loss: Loss) -> Result<usize, KindError> {
        let sizes = self.scenes.iter().map(size);
        let (width, height) = sizes.min_by_key(|(width, height)| width.min(height).to_owned()).unwrap_or_default();
        let side = wanted.min(width).min(height) / multiple * multiple;
        if side < loss.least_side() {
            let least = loss.least_side().next_multiple_of(multiple);
            return Err(KindError::Input(format!(
                "a crop of {wanted} pixels from images of {width} x {height} is below the minimum of {least} pixels; \
                increase `crop` or `resolution`"
            )));
        }
        Ok(side)
    }

    /// The mean gain of one network call from the first rung to the last over the first rung itself, on the first
    /// scenes: dB of PSNR against the last.
    ///
    /// # Errors
    /// If the model refuses the scenes.
    pub(crate) fn gain(&self, model: &Model) -> Result<f64, KindError> {
        let scenes = &self.scenes[..self.scenes.len().min(WATCHED)];
        let gains: Vec<f64> = scenes
            .iter()
            .map(|scene| {
                let (first, last) = (&scene.states[0], &scene.states[scene.states.len() - 1]);
                let course = Course { from: self.counts[0], steps: 1, grid: TimeGrid::Ladder };
                let refined = rollout(model, first, scene.gbuffer.as_ref(), course)?;
                let [before, after] = [first, &refined].map(|image| square_error(image, last));
                // A noise-free image has no gain.
                Ok(if before > 0.0 && after > 0.0 { 10.0 * maths::log10(before / after) } else { 0.0 })
            })
            .collect::<Result<_, KindError>>()?;
        Ok(gains.iter().sum::<f64>() / gains.len() as f64)
    }

    /// The batch of a training step.
    pub(crate) fn draw(&self, encoding: &Encoding, draw: &Draw, step: u64) -> Batch {
        let mut stream = Stream::new(draw.seed, &[step]).part("batch");
        let mut untold = Stream::new(draw.seed, &[step]).part("unknown counts");
        let mut uneven = Stream::new(draw.seed, &[step]).part("uneven counts");
        let mut patched = Stream::new(draw.seed, &[step]).part("patches");
        let shares = draw.shares(&self.counts[..self.counts.len() - 1]);
        let picks: Vec<Pick> = (0..draw.batch)
            .map(|_| {
                let tiled = uneven.uniform() < draw.uneven_counts;
                let scene = stream.below(self.scenes.len());
                let (width, height) = size(&self.scenes[scene]);
                let other = (scene + 1 + stream.below(self.scenes.len().max(2) - 1)) % self.scenes.len();
                let target = if draw.shuffle_targets { other } else { scene };
                // A count says how far the last rung of the whole ladder is, which a shorter one lacks.
                let told = untold.uniform() >= draw.unknown_counts && self.has_all(&self.scenes[scene]);
                let rungs = [scene, target].map(|scene| self.scenes[scene].counts.len() - 1);
                let rungs = rungs[0].min(rungs[1]);
                let tiles = Tiles::draw(&mut uneven, rungs);
                Pick {
                    scene,
                    target,
                    rung: match &shares {
                        None => stream.below(rungs),
                        Some(shares) => {
                            let at = stream.uniform() * shares[rungs - 1];
                            shares.iter().position(|share| at < *share).unwrap_or(rungs - 1)
                        }
                    },
                    t: stream.uniform(),
                    left: stream.below(width - draw.side + 1),
                    top: stream.below(height - draw.side + 1),
                    turn: stream.below(8),
                    scale: maths::exp2(draw.exposure_jitter * (2.0 * stream.uniform() - 1.0)) as f32,
                    colours: if draw.permute_colours { stream.below(COLOURS.len()) } else { 0 },
                    told,
                    apart: draw.independent_targets && !told,
                    patches: patched.chance(draw.patches).then(|| patched.bits()),
                    tiles: (tiled && !told).then_some(tiles),
                }
            })
            .collect();
        self.batch(encoding, &picks, draw.side)
    }

    /// Every scene at every rung below the last, unturned, in the middle of the image, in batches of up to `batch`. All
    /// scenes must have the whole ladder.
    pub(crate) fn all<'a>(
        &'a self,
        encoding: &'a Encoding,
        side: usize,
        batch: usize,
    ) -> impl Iterator<Item = Batch> + 'a {
        let (rungs, middle) = (self.counts.len() - 1, |length: usize| (length - side) / 2);
        let picks: Vec<Pick> = (0..self.scenes.len() * rungs)
            .map(|i| {
                let (scene, rung) = (i / rungs, i % rungs);
                // One time for each rung, spread evenly and shifted from scene to scene.
                let shift = (scene as f64 + 0.5) / self.scenes.len() as f64;
                let t = (rung as f64 + shift) / rungs as f64;
                let (width, height) = size(&self.scenes[scene]);
                let (left, top) = (middle(width), middle(height));
                let (turn, scale, colours, told, apart, patches, tiles) = (0, 1.0, 0, true, false, None, None);
                Pick { scene, target: scene, rung, t, left, top, turn, scale, colours, told, apart, patches, tiles }
            })
            .collect();
        let batches: Vec<Vec<Pick>> = picks.chunks(batch).map(<[Pick]>::to_vec).collect();
        batches.into_iter().map(move |picks| self.batch(encoding, &picks, side))
    }

    fn batch(&self, encoding: &Encoding, picks: &[Pick], side: usize) -> Batch {
        let examples: Vec<_> = picks.par_iter().map(|pick| self.example(encoding, pick, side)).collect();
        let mut targets = Vec::with_capacity(picks.len() * side * side * 3);
        let mut previews = Vec::with_capacity(if self.unbiased { targets.capacity() } else { 0 });
        let mut noise = Vec::with_capacity(if self.with_noise { targets.capacity() } else { 0 });
        let mut batch = Batch {
            states: Vec::new(),
            gbuffers: Vec::new(),
            tau: Vec::new(),
            targets: Arc::default(),
            previews: None,
            noise: None,
            side,
        };
        for (pick, example) in picks.iter().zip(examples) {
            targets.extend(example.target);
            previews.extend(example.previews);
            noise.extend(example.noise);
            batch.states.push(example.state);
            batch.gbuffers.push(example.gbuffer);
            let tau =
                encoding.factors.parameterization().time(&encoding.factors.clock(), &self.counts, pick.rung, pick.t);
            batch.tau.push(pick.told.then_some(tau));
        }
        batch.targets = Arc::new(targets);
        batch.previews = self.unbiased.then(|| Arc::new(previews));
        batch.noise = self.with_noise.then(|| Arc::new(noise));
        batch
    }

    /// The window of a pick, with the target that the network learns.
    fn example(&self, encoding: &Encoding, pick: &Pick, side: usize) -> Example {
        let patches = |scene: usize| pick.patches.map(|seed| Patches::draw(seed, side, &self.scenes[scene].counts));
        let read = |scene: usize, patches: Option<&Patches>| -> [Vec<f32>; 4] {
            let counts = &self.scenes[scene].counts;
            let lesson =
                encoding.factors.parameterization().lesson(&encoding.factors.clock(), counts, pick.rung, pick.t);
            let places = pick.places(size(&self.scenes[scene]), side);
            let encode = |v: f32| encoding.space.encode(v * pick.scale);
            let preview = |v: f32| preview_of(v * pick.scale);
            let rung = |i: usize| {
                let pixels = pick.colours(&self.scenes[scene].states[i], &places).enumerate();
                pixels.map(move |(at, pixel)| patches.map_or(pixel, |patches| patches.over(i, at, pixel)))
            };
            let (to_count, half_count) = (counts[lesson.to] as f32, counts[lesson.to - 1] as f32);
            let second = pick.tiles.map_or(lesson.from, |tiles| tiles.rung);
            let mut halves = self.unbiased.then(|| rung(lesson.to - 1));
            let mut previews = Vec::with_capacity(if self.unbiased { 3 * side * side } else { 0 });
            let mut noise = Vec::with_capacity(if self.with_noise { 3 * side * side } else { 0 });
            let triples = rung(lesson.from).zip(rung(second)).zip(rung(lesson.to)).enumerate();
            let pixels = triples.map(|(i, ((first, second_state), all))| {
                let tiled = pick.tiles.is_some_and(|tiles| tiles.has(i % side, i / side));
                let (from, at) = if tiled { (second_state, second) } else { (first, lesson.from) };
                let from_count = counts[at] as f32;
                let to = match pick.apart {
                    true => [0, 1, 2].map(|c| others((from[c], from_count), (all[c], to_count))),
                    false => all,
                };
                let mut ends = to.map(encode);
                if let Some(half) = halves.as_mut().and_then(Iterator::next) {
                    for c in [0, 1, 2] {
                        let rungs = [(from[c], from_count), (half[c], half_count), (all[c], to_count)];
                        ends[c] = unbiased(rungs, pick.apart, encode).0;
                        let (shown, variance) = unbiased(rungs, pick.apart, preview);
                        previews.push(shown);
                        if self.with_noise {
                            noise.push(variance);
                        }
                    }
                }
                let parts = [0, 1, 2].map(|c| lesson.example(encode(from[c]), ends[c]));
                (parts.map(|(state, _)| state), parts.map(|(_, target)| target))
            });
            let (states, targets): (Vec<[f32; 3]>, Vec<[f32; 3]>) = pixels.unzip();
            [states.into_flattened(), targets.into_flattened(), previews, noise]
        };
        let own = patches(pick.scene);
        let [state, mut target, mut previews, mut noise] = read(pick.scene, own.as_ref());
        if pick.target != pick.scene {
            [_, target, previews, noise] = read(pick.target, patches(pick.target).as_ref());
        }
        let gbuffer = self.scenes[pick.scene].gbuffer.as_ref().filter(|_| encoding.gbuffer);
        let gbuffer = gbuffer.map(|gbuffer| {
            let mut gbuffer = pick.turned(gbuffer, &pick.places((gbuffer.width(), gbuffer.height()), side));
            if let Some(patches) = &own {
                patches.over_gbuffer(&mut gbuffer);
            }
            gbuffer
        });
        Example { state, target, previews, noise, gbuffer }
    }
}

/// Width and height of a scene's images.
fn size(scene: &PackedScene) -> (usize, usize) {
    scene.states.first().map(|s| (s.width(), s.height())).unwrap_or_default()
}

fn square_error(a: &Image, b: &Image) -> f64 {
    a.data().iter().zip(b.data()).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum()
}

/// How batches are drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Draw {
    pub(crate) seed: u64,
    pub(crate) batch: usize,
    pub(crate) side: usize,
    pub(crate) shuffle_targets: bool,
    /// Largest change of exposure, in EV.
    pub(crate) exposure_jitter: f64,
    pub(crate) permute_colours: bool,
    /// Rungs of n samples are drawn in proportion to n to minus this.
    pub(crate) rung_exponent: f64,
    /// Share of the examples for which the network is not told the sample count.
    pub(crate) unknown_counts: f64,
    /// Whether their targets leave out the samples of the input.
    pub(crate) independent_targets: bool,
    /// Share of them that have tiles of two sample counts.
    pub(crate) uneven_counts: f64,
    /// Share of all examples that are partly covered by patches without noise.
    pub(crate) patches: f64,
}

impl Draw {
    /// Nothing is changed, and all rungs are drawn as often.
    pub(crate) const PLAIN: Self = Self {
        seed: 0,
        batch: 1,
        side: 8,
        shuffle_targets: false,
        exposure_jitter: 0.0,
        permute_colours: false,
        rung_exponent: 0.0,
        unknown_counts: 0.0,
        independent_targets: false,
        uneven_counts: 0.0,
        patches: 0.0,
    };

    /// Running sums of what rungs with these sample counts are drawn in proportion to; none if all are alike.
    fn shares(&self, counts: &[u64]) -> Option<Vec<f64>> {
        (self.rung_exponent != 0.0).then(|| {
            let share = |n: &u64| maths::exp2(-self.rung_exponent * maths::log2(*n as f64));
            let add = |sum: &mut f64, share: f64| {
                *sum += share;
                Some(*sum)
            };
            counts.iter().map(share).scan(0.0, add).collect()
        })
    }
}

impl Batch {
    /// The examples in their order, in at most so many batches as even as they can be.
    pub(crate) fn parts(&self, most: usize) -> Vec<Self> {
        let examples = self.states.len();
        let count = most.min(examples);
        let size = self.targets.len() / examples.max(1);
        let part = |i: usize| {
            let of = i * examples / count..(i + 1) * examples / count;
            let part_of = |values: &Option<Arc<Vec<f32>>>| {
                values.as_ref().map(|values| Arc::new(values[of.start * size..of.end * size].to_vec()))
            };
            Self {
                states: self.states[of.clone()].to_vec(),
                gbuffers: self.gbuffers[of.clone()].to_vec(),
                tau: self.tau[of.clone()].to_vec(),
                targets: Arc::new(self.targets[of.start * size..of.end * size].to_vec()),
                previews: part_of(&self.previews),
                noise: part_of(&self.noise),
                side: self.side,
            }
        };
        (0..count).map(part).collect()
    }

    /// The states as images.
    pub(crate) fn shown(&self) -> Shown {
        let (previews, noise) = (self.previews.clone(), self.noise.clone());
        Shown { state: Arc::new(self.states.concat()), side: self.side, previews, noise }
    }

    /// The examples as the network's samples.
    pub(crate) fn samples(&self) -> Vec<Sample<'_>> {
        let parts = self.states.iter().zip(&self.gbuffers).zip(&self.tau);
        parts.map(|((state, gbuffer), tau)| Sample { state, gbuffer: gbuffer.as_deref(), tau: *tau }).collect()
    }
}

#[cfg(test)]
mod tests;
