//! The operators of the head by burn's own operations: for devices that are no CPU. burn finds their gradients itself.

use super::head::{
    Answer, BRIGHT, BRIGHTEST, Blend, DARK, DIM, EDGES, Loss, MeanLoss, NEGLIGIBLE, OWN, PREVIEWS, SLOPES, SQUARED_TO,
    Shade, Shown, TONES,
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
            Loss::UnbiasedPreview => {
                let near = difference.clone().abs().clamp_max(SQUARED_TO);
                near.clone().square() + (difference.abs() - near) * (2.0 * SQUARED_TO)
            }
        };
        if let (Loss::UnbiasedPreview, Some(shown)) = (self.loss, &self.shown) {
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

/// The sum of [`Loss::UnbiasedPreview`] over values, of the squares of logarithms and of the prediction.
fn unbiased(squares: Tensor<1>, prediction: Tensor<1>, shown: &Shown) -> Tensor<1> {
    let Shown { state, side, previews } = shown;
    let (device, size) = (prediction.device(), 3 * side * side);
    let previews = previews.as_ref().expect("batches for this loss have previews");
    let off =
        preview(constant(state, [state.len()], &device) - prediction) - constant(previews, [previews.len()], &device);
    let examples = (state.len() / size) as i32;
    let edges = edges(off.clone(), *side).map(|edges| edges.square().reshape([examples, -1]).sum_dim(1));
    let [across, down] = edges;
    let previews = off.square().reshape([examples, -1]).sum_dim(1) * PREVIEWS + (across + down) * SLOPES;
    let logarithm = |sums: Tensor<2>| (sums / (size as f32 * NEGLIGIBLE)).log1p();
    let both = logarithm(squares.reshape([examples, -1]).sum_dim(1)) + logarithm(previews);
    both.sum() * (0.5 * size as f32)
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
