//! Renders independent batches of a scene and times them, for the comparisons in `benches/mitsuba`.
//!
//! `batches SCENE SIDE SPP BATCHES THREADS OUT [late] [fixed]`: SCENE is a folder as `tauflow export` writes it. Each
//! batch has a random stream of its own. OUT gets the batch means, f32 RGB, one after another; standard output one line
//! of JSON.
//! With `late`, paths are ended as Mitsuba ends them; with `fixed`, choices are [`Choices::Fixed`].
#![expect(clippy::disallowed_methods, reason = "it measures")]

mod exported;

use std::{error::Error, fs, path::Path, time::Instant};
use tauflow_contract::{Digest, KindError};
use tauflow_data::Resolution;
use tauflow_render::{choices::Choices, integrator::Roulette, render::Renderer, world::World};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [scene, side, spp, batches, threads, out, how @ ..] = args.as_slice() else {
        return Err("usage: batches SCENE SIDE SPP BATCHES THREADS OUT [late] [fixed]".into());
    };
    let (side, spp, batches): (u32, u64, u64) = (side.parse()?, spp.parse()?, batches.parse()?);
    let (scene, blobs) = exported::read(Path::new(scene))?;
    let mut load = |digest: &Digest| -> Result<Vec<u8>, KindError> {
        blobs.get(digest).cloned().ok_or_else(|| KindError::Input(format!("no blob {digest}")))
    };
    let begun = Instant::now();
    let asked = |word: &str| how.iter().any(|asked| asked == word);
    let choices = if asked("fixed") { Choices::Fixed } else { Choices::default() };
    let world = World::new(&scene, &mut load)?.with_choices(choices);
    let compiled = begun.elapsed().as_secs_f64();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.parse()?).build()?;
    let mut bytes = Vec::new();
    let (mut seconds, mut segments, mut rejected) = (Vec::new(), 0, 0);
    for batch in 0..batches {
        let roulette = if asked("late") { Roulette::LATE } else { Roulette::default() };
        let renderer = Renderer::new(&world, Resolution::new(side, side)?, 1000 + batch)?.with_integrator(roulette);
        let mut film = renderer.begin();
        let begun = Instant::now();
        pool.install(|| renderer.advance(&mut film, spp, &mut |_| Ok(())))?;
        seconds.push(begun.elapsed().as_secs_f64());
        segments += film.segments;
        rejected += film.rejected;
        film.mean().data().iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    fs::write(out, bytes)?;
    let report = serde_json::json!({
        "prepared_s": compiled,
        "seconds": seconds,
        "path_length": segments as f64 / (batches * spp) as f64 / (side * side) as f64,
        "rejected": rejected,
        "primitives": world.primitive_count(),
    });
    println!("{report}");
    Ok(())
}
