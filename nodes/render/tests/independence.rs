//! Samples are independent of each other and of those of other pixels: what variance time rests on.

mod scenes;

use scenes::{Built, balls_under_sky, everything, film, room};
use tauflow_render::{choices::Choices, render::Renderer, world::World};

const SIDE: usize = 16;
const COUNT: usize = 1024;

/// Luminance-like sums of each sample of each pixel, less the pixel's mean and over its deviation.
fn samples(built: &Built) -> Vec<Vec<f64>> {
    let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
    let world = world.with_choices(Choices::default());
    let renderer = Renderer::new(&world, film(SIDE as u32, SIDE as u32), 0).expect("a film");
    let mut film = renderer.begin();
    let mut all = vec![Vec::new(); SIDE * SIDE];
    let mut before = vec![0.0; SIDE * SIDE];
    for n in 1..=COUNT as u64 {
        renderer.advance(&mut film, n, &mut |_| Ok(())).expect("nothing stops it");
        for (at, pixel) in film.pixels.iter().enumerate() {
            let sum: f64 = pixel.sum.iter().sum();
            // Bright samples would outweigh all others: their square root has as much to say about independence.
            all[at].push((sum - before[at]).max(0.0).sqrt());
            before[at] = sum;
        }
    }
    all.retain_mut(|values| {
        let mean = values.iter().sum::<f64>() / COUNT as f64;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / COUNT as f64;
        values.iter_mut().for_each(|v| *v = (*v - mean) / variance.sqrt());
        variance > 1e-12
    });
    all
}

/// A mean of products of independent values of unit variance, in its standard errors.
fn deviation(sum: f64, count: usize) -> f64 {
    sum / (count as f64).sqrt()
}

#[test]
fn samples_and_pixels_are_independent() {
    for (name, built) in [("balls under a sky", balls_under_sky()), ("room", room()), ("everything", everything())] {
        let pixels = samples(&built);
        assert!(pixels.len() > 100, "{name}: {} pixels with noise", pixels.len());
        // Samples of a pixel, at several distances: the covariance of disjoint blocks is the sum of such.
        for lag in [1, 2, 3, 4, 8, 64, 512] {
            let products = pixels.iter().flat_map(|v| v.iter().zip(&v[lag..]).map(|(a, b)| a * b));
            let (sum, count) = products.fold((0.0, 0), |(sum, count), p| (sum + p, count + 1));
            let z = deviation(sum, count);
            println!("{name}: samples {lag} apart {z:+.2}");
            assert!(z.abs() < 4.5, "{name}: samples {lag} apart are {z} deviations from independence");
        }
        // Pixels, by the same sample.
        for apart in [1, 2, SIDE / 2, SIDE - 1] {
            let products = pixels.iter().zip(&pixels[apart..]).flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b));
            let (sum, count) = products.fold((0.0, 0), |(sum, count), p| (sum + p, count + 1));
            let z = deviation(sum, count);
            println!("{name}: pixels {apart} apart {z:+.2}");
            assert!(z.abs() < 4.5, "{name}: pixels {apart} apart are {z} deviations from independence");
        }
        // The variance of means of n, times n, is that of one.
        for n in [2usize, 4, 16, 64] {
            let (mut sum, mut square, mut count) = (0.0, 0.0, 0.0);
            for values in &pixels {
                for block in values.chunks_exact(n) {
                    let scaled = block.iter().sum::<f64>().powi(2) / n as f64;
                    sum += scaled;
                    square += scaled * scaled;
                    count += 1.0;
                }
            }
            // Each pixel's own mean was taken off, which takes n of COUNT off the variance.
            let (mean, expected) = (sum / count, 1.0 - n as f64 / COUNT as f64);
            let error = ((square / count - mean * mean) / count).sqrt();
            let z = (mean - expected) / error;
            println!("{name}: variance of means of {n}, times {n}: {mean:.4}, {z:+.2} deviations from {expected:.4}");
            assert!(z.abs() < 4.5, "{name}: means of {n} have {mean} of the variance, {z} deviations off");
        }
    }
}
