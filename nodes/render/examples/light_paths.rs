//! Compares light paths and Sobol' points with independent paths from the camera: error after the same number of
//! samples, and time of a sample. `light_paths SCENE..` takes folders that `tauflow export` writes.
//!
//! The reference is the mean of two renders of 1024 samples with both. Its own error is subtracted. Times are processor
//! times of one thread, so that other programs matter less.

mod exported;

use std::{error::Error, fs, path::Path as Folder};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{Resolution, SamplerKind};
use tauflow_render::{
    accumulator::Accumulator,
    choices::Choices,
    integrator::{Integrator, Path},
    render::Renderer,
    world::World,
};

const SIDE: u32 = 48;
const SAMPLES: u64 = 256;
const STREAMS: u64 = 4;
const REFERENCE: u64 = 1024;

type Failure = Box<dyn Error + Send + Sync>;

/// A way to estimate radiance.
type Method = (Integrator, SamplerKind);

/// Seconds that this thread has had of a processor.
fn seconds() -> Result<f64, Failure> {
    let text = fs::read_to_string("/proc/thread-self/schedstat")?;
    Ok(text.split(' ').next().unwrap_or_default().parse::<f64>()? * 1e-9)
}

fn render(world: &World, (integrator, sampler): Method, stream: u64, samples: u64) -> Result<(Vec<f64>, f64), Failure> {
    let renderer = Renderer::new(world, Resolution::new(SIDE, SIDE)?, stream)?;
    let renderer = renderer.with_integrator(integrator).with_sampler(sampler);
    let mut film: Accumulator = renderer.begin();
    let begun = seconds()?;
    renderer.advance(&mut film, samples, &mut |_| Ok(()))?;
    Ok((film.mean().data().iter().map(|v| f64::from(*v)).collect(), seconds()? - begun))
}

/// Squared errors against the mean of two references: absolute, and over mean^2 + 0.01 at a mean of 1; and the time.
fn errors(world: &World, method: Method, [a, b]: &[Vec<f64>; 2]) -> Result<[f64; 3], Failure> {
    let mean = a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).sum::<f64>() / a.len() as f64;
    let [mut square, mut relative, mut time] = [0.0; 3];
    for stream in 0..STREAMS {
        let (film, took) = render(world, method, stream, SAMPLES)?;
        time += took;
        for (found, (a, b)) in film.iter().zip(a.iter().zip(b)) {
            let (known, own) = (0.5 * (a + b) / mean, 0.5 * (a - b) / mean);
            let error = (found / mean - known).powi(2) - own * own;
            square += error;
            relative += error / (known * known + 0.01);
        }
    }
    Ok([square, relative, time])
}

fn main() -> Result<(), Failure> {
    let (alone, joined) = (Integrator::default(), Integrator::Bidirectional(Path::default()));
    let (independent, sobol) = (SamplerKind::Independent, SamplerKind::Sobol);
    let methods = [("light paths", (joined, independent)), ("Sobol'", (alone, sobol)), ("both", (joined, sobol))];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    println!("| scene | method | squared error | relative squared error | time of a sample |");
    println!("|---|---|---:|---:|---:|");
    for folder in std::env::args().skip(1) {
        let (scene, blobs) = exported::read(Folder::new(&folder))?;
        let mut load = |digest: &Digest| -> Result<Vec<u8>, KindError> {
            blobs.get(digest).cloned().ok_or_else(|| KindError::Input(format!("no blob {digest}")))
        };
        let world = World::new(&scene, &mut load)?.with_choices(Choices::default());
        let name = Folder::new(&folder).file_name().unwrap_or_default().to_string_lossy().into_owned();
        pool.install(|| -> Result<(), Failure> {
            let reference = |stream| Ok::<_, Failure>(render(&world, (joined, sobol), stream, REFERENCE)?.0);
            let references = [reference(100)?, reference(101)?];
            let base = errors(&world, (alone, independent), &references)?;
            for (method, how) in methods {
                let own = errors(&world, how, &references)?;
                let [square, relative, time] = [0, 1, 2].map(|k| own[k] / base[k]);
                println!("| {name} | {method} | {square:.2} | {relative:.2} | {time:.2} |");
            }
            Ok(())
        })?;
    }
    Ok(())
}
