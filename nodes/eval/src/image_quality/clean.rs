//! What samples are compared with: the features of held-out renders, and what clean renders and Gaussian images say.
//!
//! Knows no generated image.

use super::{
    distances::{Gram, Slices, directions},
    features::{FeatureSet, RandomFeatures, Standard},
    niqe::{Law, Moments, Niqe, Patches, patch_side},
    pictures::{Size, at_size, clean},
};
use rayon::prelude::*;
use tauflow_contract::{Context, Handle, ItemKey, Items, KindError};
use tauflow_data::{Image, records::PackedScene, rng::Stream};

/// Training renders that are in memory at once.
const CHUNK: usize = 32;

/// What turns an image into numbers.
pub(crate) struct Tools {
    network: RandomFeatures,
    niqe: Niqe,
    /// Directions of the sliced distance.
    pub(crate) directions: Vec<Vec<f64>>,
}

/// The numbers of an image.
#[derive(Clone)]
pub(crate) struct Numbers {
    /// Its features, as they come.
    pub(crate) features: Vec<f64>,
    /// Its patches.
    pub(crate) patches: Patches,
}

impl Tools {
    /// Those of the definition.
    pub(crate) fn new() -> Self {
        Self { network: RandomFeatures::new(), niqe: Niqe::new(), directions: directions() }
    }

    /// The numbers of an image.
    pub(crate) fn numbers(&self, image: &Image) -> Numbers {
        let side = patch_side(image.width().min(image.height()));
        Numbers { features: self.network.of(image), patches: self.niqe.patches(image, side) }
    }
}

/// What samples of one size are compared with.
pub(crate) struct Clean {
    /// Units of the features.
    pub(crate) standard: Standard,
    /// The held-out renders.
    pub(crate) references: FeatureSet,
    /// The kernel among them.
    pub(crate) among: Gram,
    /// Their projections.
    pub(crate) slices: Slices,
    /// NIQE's model of clean renders; none where they have fewer than two patches.
    pub(crate) law: Option<Law>,
    /// Number of patches that it is fitted to.
    pub(crate) patches: f64,
    /// Gaussian images; none without a training set.
    pub(crate) gaussian: Option<FeatureSet>,
}

/// The renders, not loaded yet.
#[derive(Clone, Copy)]
pub(crate) struct Renders<'a> {
    /// Held-out ones.
    pub(crate) references: Items<'a, PackedScene>,
    /// Those of the training set.
    pub(crate) training: Option<Items<'a, PackedScene>>,
}

impl Clean {
    /// Reads the renders at a size, and draws as many Gaussian images as is said.
    ///
    /// # Errors
    /// If a render is missing, damaged, or of another size than the others.
    pub(crate) fn new(
        ctx: &Context<'_>,
        tools: &Tools,
        renders: Renders<'_>,
        size: Size,
        gaussians: usize,
        seed: u64,
    ) -> Result<Self, KindError> {
        let held_out: Vec<(&ItemKey, Handle<'_, PackedScene>)> = renders.references.iter().collect();
        let mut numbers = Vec::with_capacity(held_out.len());
        for chunk in held_out.chunks(CHUNK) {
            ctx.check_cancelled()?;
            numbers.extend(load(ctx, tools, chunk, size)?.into_iter().map(|(_, numbers)| numbers));
        }
        let (fitted_to, gaussian) = match renders.training {
            None => (numbers.clone(), None),
            Some(training) => {
                let (numbers, images) = read_training(ctx, tools, training, size, gaussians, seed)?;
                let features = |image: &Image| tools.network.of(image);
                (numbers, Some(images.par_iter().map(features).collect::<Vec<_>>()))
            }
        };
        let features = |numbers: &[Numbers]| numbers.iter().map(|n| n.features.clone()).collect::<Vec<_>>();
        let standard = Standard::of(&features(&fitted_to));
        let references = standard.apply(&features(&numbers));
        let model = Moments::of(fitted_to.iter().flat_map(|numbers| numbers.patches.sharp()));
        Ok(Self {
            among: Gram::new(&references, &references),
            slices: Slices::new(&references, &tools.directions),
            law: model.law(),
            patches: model.patches(),
            gaussian: gaussian.map(|rows| standard.apply(&rows)),
            references,
            standard,
        })
    }
}

/// Renders at a size, with their numbers.
fn load(
    ctx: &Context<'_>,
    tools: &Tools,
    of: &[(&ItemKey, Handle<'_, PackedScene>)],
    size: Size,
) -> Result<Vec<(Image, Numbers)>, KindError> {
    let one = |(key, scene): &(&ItemKey, Handle<'_, PackedScene>)| {
        let image = at_size(clean(ctx, *scene)?, size, &format!("the render of `{key}`"))?;
        let numbers = tools.numbers(&image);
        Ok((image, numbers))
    };
    of.par_iter().map(one).collect()
}

/// The numbers of a training set, and Gaussian images of its mean and covariance: the mean, plus every render's
/// difference from it times a normal number over sqrt(n - 1); clipped to display values.
fn read_training(
    ctx: &Context<'_>,
    tools: &Tools,
    training: Items<'_, PackedScene>,
    size: Size,
    gaussians: usize,
    seed: u64,
) -> Result<(Vec<Numbers>, Vec<Image>), KindError> {
    let values = 3 * size[0] * size[1];
    let mut mean = vec![0.0f64; values];
    // Sums of the renders times normal numbers, the sum of these, and where they come from.
    let stream = |at: usize| Stream::new(seed, &[at as u64]).part("gaussian image");
    let mut sums: Vec<(Vec<f32>, f64, Stream)> =
        (0..gaussians).map(|at| (vec![0.0; values], 0.0, stream(at))).collect();
    let renders: Vec<(&ItemKey, Handle<'_, PackedScene>)> = training.iter().collect();
    let mut numbers = Vec::with_capacity(renders.len());
    for chunk in renders.chunks(CHUNK) {
        ctx.check_cancelled()?;
        let loaded = load(ctx, tools, chunk, size)?;
        for (image, _) in &loaded {
            mean.iter_mut().zip(image.data()).for_each(|(sum, value)| *sum += f64::from(*value));
        }
        sums.par_iter_mut().for_each(|(sum, weights, stream)| {
            for (image, _) in &loaded {
                let weight = stream.normal();
                *weights += weight;
                sum.iter_mut().zip(image.data()).for_each(|(sum, value)| *sum += weight as f32 * value);
            }
        });
        numbers.extend(loaded.into_iter().map(|(_, numbers)| numbers));
    }
    let number = renders.len() as f64;
    mean.iter_mut().for_each(|sum| *sum /= number);
    let spread = 1.0 / (number - 1.0).sqrt();
    let image = |(sum, weights, _): (Vec<f32>, f64, Stream)| {
        let value =
            |(sum, mean): (&f32, &f64)| (mean + spread * (f64::from(*sum) - weights * mean)).clamp(0.0, 1.0) as f32;
        Ok(Image::from_data(size[0], size[1], 3, sum.iter().zip(&mean).map(value).collect())?)
    };
    Ok((numbers, sums.into_iter().map(image).collect::<Result<_, KindError>>()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;
    use tauflow_contract::{Collection, Media, MemoryBlobs, Silent};

    #[test]
    fn gaussian_images_have_the_moments_of_the_training_set() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let mut stream = Stream::new(1, &[]);
        // Renders whose display values stay away from both ends: a level of their own, and pixels about it.
        let render = |level: f64, stream: &mut Stream| {
            let data = (0..768).map(|_| (level + 0.1 * stream.normal()).abs() as f32).collect();
            Image::from_data(16, 16, 3, data).expect("fits")
        };
        let mut displayed = Vec::new();
        let items: Collection = (0..40)
            .map(|at| {
                let level = 1.0 + 0.2 * stream.normal();
                let state = render(level, &mut stream);
                displayed.push(state.map(tauflow_data::image::preview));
                let scene =
                    PackedScene { counts: vec![4], states: vec![state], gbuffer: None, sampler: Default::default() };
                let key = ItemKey::new(format!("L0-open-{at:06}")).expect("a key");
                (key, scene.store(&ctx).expect("in memory").into_artifact())
            })
            .collect();
        let training = Items::new(&items).expect("packed scenes");
        let (numbers, images) = read_training(&ctx, &Tools::new(), training, [16, 16], 4000, 3).expect("whole");
        assert_eq!((numbers.len(), images.len()), (40, 4000));
        let moments = |of: &[Image], a: usize, b: usize| {
            let mean = |at: usize| of.iter().map(|i| f64::from(i.data()[at])).sum::<f64>() / of.len() as f64;
            let (first, second) = (mean(a), mean(b));
            let product = |i: &Image| (f64::from(i.data()[a]) - first) * (f64::from(i.data()[b]) - second);
            (first, of.iter().map(product).sum::<f64>() / (of.len() - 1) as f64)
        };
        for (a, b) in [(0, 0), (0, 5), (100, 700), (767, 767)] {
            let ((mean, covariance), (found, drawn)) = (moments(&displayed, a, b), moments(&images, a, b));
            let deviation = moments(&displayed, a, a).1.sqrt();
            // Standard errors of 4000 draws: deviation/63 and about covariance/45.
            assert!((found - mean).abs() < 5.0 * deviation / 63.0, "{found} {mean}");
            let scale = deviation * moments(&displayed, b, b).1.sqrt();
            assert!((drawn - covariance).abs() < 5.0 * scale / 40.0, "{drawn} {covariance}");
        }
    }
}
