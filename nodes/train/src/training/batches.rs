//! Training batches out of packed scenes, all in memory. The batch of a step is a function of the seed and the step.

use crate::{
    network::features::{Encoding, Sample},
    parameterization::Conditioning,
};
use std::sync::Arc;
use tauflow_contract::{Collection, Context, KindError};
use tauflow_data::{Image, formats::PackedScene, rng::Stream};

/// Scenes with the same rungs, of the same size.
#[derive(Debug)]
pub(crate) struct DataSet {
    pub(crate) counts: Vec<u64>,
    width: usize,
    height: usize,
    scenes: Vec<PackedScene>,
}

/// Examples of one shape: what the network is told, and what it should say.
pub(crate) struct Batch {
    states: Vec<Vec<f32>>,
    gbuffers: Vec<Option<Vec<f32>>>,
    tau: Vec<f64>,
    /// [N, H, W, 3].
    pub(crate) targets: Arc<Vec<f32>>,
    /// Height and width.
    pub(crate) side: usize,
}

/// One example: which scene, rung, window and turn.
#[derive(Clone, Copy, Debug)]
struct Pick {
    scene: usize,
    /// The scene that the target is taken from: `scene`, unless targets are shuffled.
    target: usize,
    rung: usize,
    t: f64,
    left: usize,
    top: usize,
    /// 0..8: quarter turns, and a flip from 4 on.
    turn: usize,
}

impl DataSet {
    /// Loads a collection of packed scenes.
    ///
    /// # Errors
    /// If it is empty, scenes differ in rungs or size, or G-buffers are missing where they are needed.
    pub(crate) fn load(
        ctx: &Context<'_>,
        collection: &Collection,
        port: &str,
        conditioning: Conditioning,
    ) -> Result<Self, KindError> {
        let mut scenes = Vec::with_capacity(collection.len());
        for (key, artifact) in collection.iter() {
            let scene = PackedScene::from_bytes(&ctx.part(artifact, "")?)
                .map_err(|e| KindError::Input(format!("scene {key} of input `{port}`: {e}")))?;
            scenes.push((key.as_str(), scene));
        }
        Self::new(scenes, port, conditioning)
    }

    pub(crate) fn new(
        scenes: Vec<(&str, PackedScene)>,
        port: &str,
        conditioning: Conditioning,
    ) -> Result<Self, KindError> {
        let Some((first_key, first)) = scenes.first() else {
            return Err(KindError::Input(format!("input `{port}` has no scenes; raise the quota of its sampling")));
        };
        let shape = |scene: &PackedScene| scene.states.first().map(|s| (s.width(), s.height()));
        let (counts, size) = (first.counts.clone(), shape(first).unwrap_or_default());
        if counts.len() < 2 {
            return Err(KindError::Input(format!(
                "scene {first_key} of input `{port}` has {} rungs; a solver learns from at least two",
                counts.len()
            )));
        }
        for (key, scene) in &scenes {
            if scene.counts != counts || shape(scene) != Some(size) {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` has rungs {:?} at {:?}, but {first_key} has {counts:?} at {size:?}; \
                     render all with the same `rungs` and `resolution`",
                    scene.counts,
                    shape(scene).unwrap_or_default()
                )));
            }
            if let Some(image) = scene.states.iter().find(|s| s.data().iter().any(|v| !v.is_finite())) {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` holds a value that is not finite in an image of {} x {}; the gate \
                     should have rejected it",
                    image.width(),
                    image.height()
                )));
            }
            let fits = |g: &Image| (g.width(), g.height(), g.channels()) == (size.0, size.1, 6);
            if conditioning == Conditioning::Gbuffer && !scene.gbuffer.as_ref().is_some_and(fits) {
                return Err(KindError::Input(format!(
                    "scene {key} of input `{port}` has no G-buffer of its size, and `conditioning` is gbuffer; connect \
                     `gbuffers` of its `dataset_packing`"
                )));
            }
        }
        let scenes = scenes.into_iter().map(|(_, scene)| scene).collect();
        Ok(Self { counts, width: size.0, height: size.1, scenes })
    }

    /// Number of scenes.
    pub(crate) fn len(&self) -> usize {
        self.scenes.len()
    }

    /// The side of the square windows that training sees: `wanted`, cut to what images and network allow.
    ///
    /// # Errors
    /// If images are smaller than the network's coarsest pixel.
    pub(crate) fn side(&self, wanted: usize, multiple: usize) -> Result<usize, KindError> {
        let side = wanted.min(self.width).min(self.height) / multiple * multiple;
        if side == 0 {
            return Err(KindError::Input(format!(
                "a crop of {wanted} from images of {} x {} is less than the {multiple} pixels that the network needs; \
                 raise `crop` or the `resolution`",
                self.width, self.height
            )));
        }
        Ok(side)
    }

    /// The batch of a training step.
    pub(crate) fn draw(&self, encoding: &Encoding, draw: &Draw, step: u64) -> Batch {
        let mut stream = Stream::new(draw.seed, &[step]).part("batch");
        let picks: Vec<Pick> = (0..draw.batch)
            .map(|_| {
                let scene = stream.below(self.scenes.len());
                let other = (scene + 1 + stream.below(self.scenes.len().max(2) - 1)) % self.scenes.len();
                Pick {
                    scene,
                    target: if draw.shuffle_targets { other } else { scene },
                    rung: stream.below(self.counts.len() - 1),
                    t: stream.uniform(),
                    left: stream.below(self.width - draw.side + 1),
                    top: stream.below(self.height - draw.side + 1),
                    turn: stream.below(8),
                }
            })
            .collect();
        self.batch(encoding, &picks, draw.side)
    }

    /// Every scene at every rung below the last, unturned, in the middle of the image, in batches of up to `batch`.
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
                Pick { scene, target: scene, rung, t, left: middle(self.width), top: middle(self.height), turn: 0 }
            })
            .collect();
        let batches: Vec<Vec<Pick>> = picks.chunks(batch).map(<[Pick]>::to_vec).collect();
        batches.into_iter().map(move |picks| self.batch(encoding, &picks, side))
    }

    fn batch(&self, encoding: &Encoding, picks: &[Pick], side: usize) -> Batch {
        let mut targets = Vec::with_capacity(picks.len() * side * side * 3);
        let mut batch =
            Batch { states: Vec::new(), gbuffers: Vec::new(), tau: Vec::new(), targets: Arc::default(), side };
        let last = self.counts.len() - 1;
        for pick in picks {
            let places = pick.places(self.width, side);
            let window = |image: &Image| gather(image, &places);
            let read = |scene: usize| -> Vec<Option<Vec<f32>>> {
                let needed = |i: usize| i == 0 || i == last || i == pick.rung || i == pick.rung + 1;
                let encoded = |image: &Image| window(image).into_iter().map(|v| encoding.space.encode(v)).collect();
                let states = self.scenes[scene].states.iter().enumerate();
                states.map(|(i, image)| needed(i).then(|| encoded(image))).collect()
            };
            let example = |rungs: &[Option<Vec<f32>>]| -> (Vec<f32>, Vec<f32>) {
                let value = |rung: usize, at: usize| rungs[rung].as_ref().map_or(0.0, |r| r[at]);
                (0..side * side * 3)
                    .map(|at| {
                        let rung = |rung| value(rung, at);
                        encoding.parameterization.example(&encoding.clock, &self.counts, pick.rung, pick.t, rung)
                    })
                    .unzip()
            };
            let (state, target) = example(&read(pick.scene));
            targets.extend(if pick.target == pick.scene { target } else { example(&read(pick.target)).1 });
            batch.states.push(state);
            let gbuffer = self.scenes[pick.scene].gbuffer.as_ref().filter(|_| encoding.gbuffer);
            batch.gbuffers.push(gbuffer.map(window));
            batch.tau.push(encoding.parameterization.time(&encoding.clock, &self.counts, pick.rung, pick.t));
        }
        batch.targets = Arc::new(targets);
        batch
    }
}

/// How batches are drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Draw {
    pub(crate) seed: u64,
    pub(crate) batch: usize,
    pub(crate) side: usize,
    pub(crate) shuffle_targets: bool,
}

impl Batch {
    /// The examples as the network's samples.
    pub(crate) fn samples(&self) -> Vec<Sample<'_>> {
        let parts = self.states.iter().zip(&self.gbuffers).zip(&self.tau);
        parts.map(|((state, gbuffer), tau)| Sample { state, gbuffer: gbuffer.as_deref(), tau: *tau }).collect()
    }
}

impl Pick {
    /// For each pixel of the turned window, where it lies in the image.
    fn places(&self, width: usize, side: usize) -> Vec<usize> {
        let place = |x: usize, y: usize| {
            let x = if self.turn >= 4 { side - 1 - x } else { x };
            let (x, y) = match self.turn % 4 {
                0 => (x, y),
                1 => (y, side - 1 - x),
                2 => (side - 1 - x, side - 1 - y),
                _ => (side - 1 - y, x),
            };
            (self.top + y) * width + self.left + x
        };
        (0..side * side).map(|i| place(i % side, i / side)).collect()
    }
}

fn gather(image: &Image, places: &[usize]) -> Vec<f32> {
    let channels = image.channels();
    places.iter().flat_map(|at| &image.data()[at * channels..(at + 1) * channels]).copied().collect()
}
