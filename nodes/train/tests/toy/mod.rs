//! Toy scenes: smooth shapes under heavy-tailed noise whose rungs are nested means of the same samples.

use std::sync::atomic::AtomicBool;
use tauflow_contract::{Collection, Context, ItemKey, Media, MemoryBlobs, Silent};
use tauflow_data::{Image, records::PackedScene, rng::Stream};

/// A scene of `side` pixels with the rungs `counts`.
pub fn scene(seed: u64, side: usize, counts: &[u64]) -> PackedScene {
    let mut stream = Stream::new(seed, &[]).part("scene");
    let shapes: Vec<[f64; 7]> = (0..8)
        .map(|_| {
            let at = [stream.range(0.0, 1.0), stream.range(0.0, 1.0), stream.range(0.05, 0.4)];
            let bright = if stream.chance(0.1) { 8.0 } else { 0.5 };
            let rgb = [stream.range(0.0, bright), stream.range(0.0, bright), stream.range(0.0, bright)];
            [at[0], at[1], at[2], rgb[0], rgb[1], rgb[2], f64::from(u8::from(stream.chance(0.5)))]
        })
        .collect();
    let mut albedo = Image::new(side, side, 6);
    let last = counts[counts.len() - 1];
    let mut states = vec![Image::new(side, side, 3); counts.len()];
    for y in 0..side {
        for x in 0..side {
            let (px, py) = (x as f64 / side as f64, y as f64 / side as f64);
            let mut clean = [0.1, 0.1, 0.12];
            let mut surface = [0.2, 0.2, 0.2, 0.0, 0.0, 1.0];
            for shape in &shapes {
                let (dx, dy) = ((px - shape[0]) / shape[2], (py - shape[1]) / shape[2]);
                if dx * dx + dy * dy < 1.0 {
                    let fade = if shape[6] > 0.0 { 1.0 } else { 1.0 - dx * dx - dy * dy };
                    for c in 0..3 {
                        clean[c] = shape[3 + c] * fade + 0.02;
                        surface[c] = (shape[3 + c] / 8.0) as f32;
                    }
                    surface[3..].copy_from_slice(&[dx as f32, dy as f32, (1.0 - dx * dx - dy * dy).sqrt() as f32]);
                }
            }
            albedo.pixel_mut(x, y).copy_from_slice(&surface);
            let mut sum = [0.0; 3];
            let mut rung = 0;
            for n in 1..=last {
                let mut noise = if stream.chance(0.5) { 0.0 } else { 1.6 * -(1.0 - stream.uniform()).ln() };
                if stream.chance(0.004) {
                    noise += 50.0;
                }
                for (sum, clean) in sum.iter_mut().zip(clean) {
                    *sum += clean * noise;
                }
                if n == counts[rung] {
                    states[rung].pixel_mut(x, y).copy_from_slice(&sum.map(|sum| (sum / n as f64) as f32));
                    rung += 1;
                }
            }
        }
    }
    PackedScene { counts: counts.to_vec(), states, gbuffer: Some(albedo), sampler: Default::default() }
}

/// Stores scenes `from..to` as a collection.
pub fn collection(blobs: &MemoryBlobs, range: std::ops::Range<u64>, side: usize, counts: &[u64]) -> Collection {
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &cancel);
    range
        .map(|i| {
            let stored = scene(i, side, counts).store(&ctx).expect("consistent");
            (ItemKey::new(format!("toy-{i:04}")).expect("plain"), stored.into_artifact())
        })
        .collect()
}

/// PSNR with peak 1, negatives as 0.
pub fn psnr(image: &Image, reference: &Image) -> f64 {
    let square = |(a, b): (&f32, &f32)| f64::from(a.max(0.0) - b.max(0.0)).powi(2);
    let mse = image.data().iter().zip(reference.data()).map(square).sum::<f64>() / image.data().len() as f64;
    -10.0 * mse.log10()
}
