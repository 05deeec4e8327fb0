//! The operators of the head by burn's own operations: for devices that are no CPU. burn finds their gradients itself.

use super::{
    head::{Answer, BRIGHTEST, Blend, OWN, Shade},
    loss::{
        BRIGHT, DARK, DIM, EDGES, Loss, MeanLoss, NEGLIGIBLE, PREVIEWS, SLOPES, SQUARED_TO, STRUCTURE, Shown, TONES,
    },
    structure::{C1, C2, WINDOW, taps},
};
use burn::tensor::{
    Tensor,
    activation::{sigmoid, softmax},
};
use tauflow_ops::LOCAL_MODELS;
use tauflow_tensors::{OnDevice, constant, flat};

impl OnDevice<2> for Shade {
    fn by_tensors(&self, [mean, shade]: [Tensor<1>; 2]) -> Tensor<1> {
        const { assert!(BRIGHTEST == 4.0, "its logarithm is 2 ln 2") };
        // The same factor without exponentials, whose squares would be too large in a gradient.
        let part = sigmoid(shade - 2.0 * core::f32::consts::LN_2);
        mean * (part * (BRIGHTEST - 1.0 / BRIGHTEST) + 1.0 / BRIGHTEST)
    }
}

impl OnDevice<2> for Blend {
    fn by_tensors(&self, [mean, numbers]: [Tensor<1>; 2]) -> Tensor<1> {
        let (pixels, models, device) = (mean.dims()[0] / 3, LOCAL_MODELS, mean.device());
        let own = Tensor::full([pixels, 1], OWN, &device);
        let shares = softmax(Tensor::cat(vec![own, numbers.reshape([pixels, models])], 1), 1);
        let fits = constant(&self.fits, [pixels, models, 3], &device);
        let all = Tensor::cat(vec![mean.reshape([pixels, 1, 3]), fits], 1);
        flat((all * shares.reshape([pixels, models + 1, 1])).sum_dim(1))
    }
}

impl OnDevice<1> for Answer {
    fn by_tensors(&self, [mean]: [Tensor<1>; 1]) -> Tensor<1> {
        let device = mean.device();
        let shape = [self.gain.len(), self.state.len() / self.gain.len().max(1)];
        let mut value = mean.reshape(shape);
        if let Some(albedo) = &self.albedo {
            value = value * constant(albedo, shape, &device);
        }
        if self.log {
            value = value.clone().sign() * value.abs().log1p();
        }
        let gain = constant(&self.gain, [shape[0], 1], &device);
        flat((value - constant(&self.state, shape, &device)) * gain)
    }
}

impl OnDevice<1> for MeanLoss {
    fn by_tensors(&self, [prediction]: [Tensor<1>; 1]) -> Tensor<1> {
        let device = prediction.device();
        let target = constant(&self.target, [self.target.len()], &device);
        let difference = prediction.clone() - target.clone();
        let losses = match self.loss {
            Loss::Squared => difference.square(),
            Loss::Absolute | Loss::Tonal | Loss::Preview => difference.abs(),
            // The part up to the bound counts by its square, the rest by its size.
            Loss::UnbiasedPreview | Loss::Structural => {
                let near = difference.clone().abs().clamp_max(SQUARED_TO);
                near.clone().square() + (difference.abs() - near) * (2.0 * SQUARED_TO)
            }
        };
        if let Some(shown) = self.shown.as_ref().filter(|_| self.loss.is_unbiased()) {
            return unbiased(losses, prediction, shown) / self.count as f64;
        }
        let mut total = losses.sum();
        if let Some(Shown { state, side, .. }) = &self.shown {
            let state = constant(state, [state.len()], &device);
            let tone = if self.loss == Loss::Preview { preview } else { tone };
            let tones = tone(state.clone() - prediction) - tone(state - target);
            let [across, down] = edges(tones.clone(), *side);
            total = if self.loss == Loss::Preview {
                total + tones.square().sum() * PREVIEWS + (across.square().sum() + down.square().sum()) * SLOPES
            } else {
                total + tones.abs().sum() * TONES + (across.abs().sum() + down.abs().sum()) * EDGES
            };
        }
        total / self.count as f64
    }
}

/// Differences of neighbours to the right and below in images [N x side x side x 3].
fn edges(images: Tensor<1>, side: usize) -> [Tensor<4>; 2] {
    let images = images.reshape([-1, side as i32, side as i32, 3]);
    let count = images.dims()[0];
    let across = images.clone().slice([0..count, 0..side, 1..side, 0..3])
        - images.clone().slice([0..count, 0..side, 0..side - 1, 0..3]);
    let down =
        images.clone().slice([0..count, 1..side, 0..side, 0..3]) - images.slice([0..count, 0..side - 1, 0..side, 0..3]);
    [across, down]
}

/// Means over the windows of images [N x side x side x 3] that lie inside.
fn windowed(images: Tensor<1>, side: usize) -> Tensor<4> {
    let images = images.reshape([-1, side as i32, side as i32, 3]);
    let (count, inner) = (images.dims()[0], side + 1 - WINDOW);
    let sum = |parts: Vec<Tensor<4>>| parts.into_iter().reduce(|a, b| a + b).expect("a window has taps");
    let across = |(i, tap): (usize, f32)| images.clone().slice([0..count, 0..side, i..i + inner, 0..3]) * tap;
    let rows = sum(taps().into_iter().enumerate().map(across).collect());
    let down = |(i, tap): (usize, f32)| rows.clone().slice([0..count, i..i + inner, 0..inner, 0..3]) * tap;
    sum(taps().into_iter().enumerate().map(down).collect())
}

/// The mean similarity of each image [N x side x side x 3] to its target, whose noise has these variances: [N, 1].
fn similarity([image, target, noise]: [Tensor<1>; 3], side: usize) -> Tensor<2> {
    let moments =
        [image.clone(), target.clone(), image.clone().square(), target.clone().square(), image * target, noise];
    let [x, y, xx, yy, xy, noise] = moments.map(|values| windowed(values, side));
    let of_target = (yy - y.clone().square() - noise).clamp_min(0.0);
    let of_image = (xx - x.clone().square()).clamp_min(0.0);
    let product = x.clone() * y.clone();
    let luminance = (product.clone() * 2.0 + C1) / (x.square() + y.square() + C1);
    let structure = ((xy - product) * 2.0 + C2) / (of_image + of_target + C2);
    let all = luminance * structure;
    let examples = all.dims()[0] as i32;
    all.reshape([examples, -1]).mean_dim(1)
}

/// The sum of [`Loss::UnbiasedPreview`] or [`Loss::Structural`] over values, of the squares of logarithms and of the
/// prediction.
fn unbiased(squares: Tensor<1>, prediction: Tensor<1>, shown: &Shown) -> Tensor<1> {
    let Shown { state, side, previews, noise } = shown;
    let (device, size) = (prediction.device(), 3 * side * side);
    let previews = previews.as_ref().expect("batches for this loss have previews");
    let target = constant(previews, [previews.len()], &device);
    let image = preview(constant(state, [state.len()], &device) - prediction);
    let off = image.clone() - target.clone();
    let examples = (state.len() / size) as i32;
    let edges = edges(off.clone(), *side).map(|edges| edges.square().reshape([examples, -1]).sum_dim(1));
    let [across, down] = edges;
    let previews = off.square().reshape([examples, -1]).sum_dim(1) * PREVIEWS + (across + down) * SLOPES;
    let logarithm = |sums: Tensor<2>| (sums / (size as f32 * NEGLIGIBLE)).log1p();
    let both = logarithm(squares.reshape([examples, -1]).sum_dim(1)) + logarithm(previews);
    let mut sum = both.sum() * 0.5;
    if let Some(noise) = noise {
        let noise = constant(noise, [noise.len()], &device);
        sum = sum + (-similarity([image, target, noise], *side) + 1.0).sum() * STRUCTURE;
    }
    sum * size as f32
}

/// Tones of logarithms.
fn tone(log: Tensor<1>) -> Tensor<1> {
    let size = log.clone().abs();
    let radiance = size.clone().clamp_max(BRIGHT).exp() - 1.0;
    log.sign() * ((radiance * DARK).log1p() + (size - BRIGHT).clamp_min(0.0))
}

/// Previews of logarithms.
fn preview(log: Tensor<1>) -> Tensor<1> {
    let radiance = log.clamp(0.0, BRIGHT).exp() - 1.0 + DIM;
    (radiance.clone() / (radiance + 1.0)).sqrt()
}

#[cfg(test)]
mod tests;
