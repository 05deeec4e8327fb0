//! Measures paths per second and core on scenes built by hand, and writes their images:
//! `cargo run --release -p tauflow-render --example paths_per_second [folder]`.
#![expect(clippy::disallowed_methods, reason = "it measures")]

use std::{error::Error, fs, path::PathBuf, time::Instant};
use tauflow_data::{Resolution, image_io::preview_png};
use tauflow_render::{choices::Choices, render::Renderer, world::World};

#[path = "../tests/scenes/mod.rs"]
mod scenes;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).map(PathBuf::from);
    let (side, spp) = (256, 64);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    for (name, built) in [("balls_under_sky", scenes::balls_under_sky()), ("room", scenes::room())] {
        let begun = Instant::now();
        let world = World::new(&built.scene, &mut |digest| built.load(digest))?.with_choices(Choices::default());
        let compiled = begun.elapsed();
        let renderer = Renderer::new(&world, Resolution::new(side, side)?, 0)?;
        let mut film = renderer.begin();
        let begun = Instant::now();
        pool.install(|| renderer.advance(&mut film, spp, &mut |_| Ok(())))?;
        let seconds = begun.elapsed().as_secs_f64();
        println!(
            "{name}: {} primitives, compiled in {:.1} ms; {:.2} M paths/s and {:.2} M segments/s on one core, \
             {:.2} segments per path, {} rejected",
            world.primitive_count(),
            compiled.as_secs_f64() * 1e3,
            (side * side) as f64 * spp as f64 / seconds / 1e6,
            film.segments as f64 / seconds / 1e6,
            film.mean_path_length(),
            film.rejected,
        );
        if let Some(folder) = &folder {
            fs::create_dir_all(folder)?;
            fs::write(folder.join(format!("{name}.png")), preview_png(&film.mean())?)?;
        }
    }
    Ok(())
}
