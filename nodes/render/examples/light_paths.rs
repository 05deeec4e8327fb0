//! What paths from the lights bring to scenes: the squared error after as many samples, and the time of a sample,
//! against paths from the camera alone: `light_paths SCENE..`, folders as `tauflow export` writes them.
//!
//! Errors are against 1536 samples of another stream with light paths, whose own variance is taken off. Times are those
//! of one core, as the processor counts them for the thread, so that other programs matter less.

mod exported;

use std::{error::Error, fs, path::Path as Folder};
use tauflow_contract::{Digest, KindError};
use tauflow_data::Resolution;
use tauflow_render::{
    accumulator::Accumulator,
    integrator::{Integrator, Path},
    render::Renderer,
    world::World,
};

const SIDE: u32 = 48;
const SAMPLES: u64 = 64;
const STREAMS: u64 = 4;
const REFERENCE: u64 = 1536;

/// Seconds that this thread has had of a processor.
fn seconds() -> Result<f64, Box<dyn Error + Send + Sync>> {
    let text = fs::read_to_string("/proc/thread-self/schedstat")?;
    Ok(text.split(' ').next().unwrap_or_default().parse::<f64>()? * 1e-9)
}

fn render(
    world: &World,
    integrator: Integrator,
    stream: u64,
    samples: u64,
) -> Result<(Accumulator, f64), Box<dyn Error + Send + Sync>> {
    let renderer = Renderer::new(world, Resolution::new(SIDE, SIDE)?, stream)?.with_integrator(integrator);
    let mut film = renderer.begin();
    let begun = seconds()?;
    renderer.advance(&mut film, samples, &mut |_| Ok(()))?;
    Ok((film, seconds()? - begun))
}

/// Squared errors of films against a reference, absolute and over mean^2 + 0.01 at a mean of 1, summed; and the time.
fn errors(
    world: &World,
    integrator: Integrator,
    reference: &Accumulator,
) -> Result<[f64; 3], Box<dyn Error + Send + Sync>> {
    let (truth, own) = (reference.mean(), reference.variance());
    let mean = truth.data().iter().map(|v| f64::from(*v)).sum::<f64>() / truth.data().len() as f64;
    let [mut square, mut relative, mut time] = [0.0; 3];
    for stream in 0..STREAMS {
        let (film, took) = render(world, integrator, stream, SAMPLES)?;
        time += took;
        for ((found, known), variance) in film.mean().data().iter().zip(truth.data()).zip(own.data()) {
            let (known, off) = (f64::from(*known) / mean, f64::from(found - known) / mean);
            let error = off * off - f64::from(*variance) / (mean * mean * REFERENCE as f64);
            square += error;
            relative += error / (known * known + 0.01);
        }
    }
    Ok([square, relative, time])
}

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let joined = Integrator::PathAndLight(Path::default());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    println!("| scene | squared error | relative squared error | time of a sample |\n|---|---:|---:|---:|");
    for folder in std::env::args().skip(1) {
        let (scene, blobs) = exported::read(Folder::new(&folder))?;
        let mut load = |digest: &Digest| -> Result<Vec<u8>, KindError> {
            blobs.get(digest).cloned().ok_or_else(|| KindError::Input(format!("no blob {digest}")))
        };
        let world = World::new(&scene, &mut load)?;
        let (alone, both) = pool.install(|| -> Result<_, Box<dyn Error + Send + Sync>> {
            let (reference, _) = render(&world, joined, 100, REFERENCE)?;
            Ok((errors(&world, Integrator::default(), &reference)?, errors(&world, joined, &reference)?))
        })?;
        let name = Folder::new(&folder).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let [square, relative, time] = [0, 1, 2].map(|k| both[k] / alone[k]);
        println!("| {name} | {square:.2} | {relative:.2} | {time:.2} |");
    }
    Ok(())
}
