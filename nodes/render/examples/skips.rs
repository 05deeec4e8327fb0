//! Measures each skip: time without it divided by time with it, on one core.
//!
//! `skips FOLDER [SIDE SPP [--together]]`: FOLDER holds scenes as `tauflow export` writes them, `L0-open-000000` and so
//! on. Prints a table: medians over scenes, and how far images differ. With `--together` it prints JSON: how long all
//! scenes take as usual, and with all undone at once.
#![expect(clippy::disallowed_methods, reason = "it measures")]

use exported::{Blobs, read};
use std::{collections::BTreeMap, error::Error, fs, path::Path, time::Instant};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{Resolution, Stratum, scene::Scene};
use tauflow_render::{
    accumulator::Accumulator, choices::Choices, gbuffer::GBufferSurface, render::Renderer, skips::Skip, world::World,
};

mod exported;

/// Times are the least of so many, taken in turns.
const ROUNDS: usize = 5;

fn world(scene: &Scene, blobs: &Blobs) -> Result<World, KindError> {
    let world = World::new(scene, &mut |digest| {
        blobs.get(digest).cloned().ok_or_else(|| KindError::Input(format!("no blob {digest}")))
    })?;
    Ok(world.with_choices(Choices::default()))
}

fn render(world: &World, film: Resolution, spp: u64) -> Result<(f64, Accumulator), KindError> {
    let renderer = Renderer::new(world, film, 0)?;
    let mut film = renderer.begin();
    let begun = Instant::now();
    renderer.advance(&mut film, spp, &mut |_| Ok(()))?;
    Ok((begun.elapsed().as_secs_f64(), film))
}

/// Root mean square difference of two means, over what their variances make of it.
fn deviation(a: &Accumulator, b: &Accumulator) -> f64 {
    let (mut difference, mut variance) = (0.0, 0.0);
    let n = a.count as f64;
    for (p, q) in a.pixels.iter().zip(&b.pixels) {
        for c in 0..3 {
            difference += ((p.sum[c] - q.sum[c]) / n).powi(2);
            variance += (p.m2[c] + q.m2[c]) / (n * (n - 1.0));
        }
    }
    if variance > 0.0 { (difference / variance).sqrt() } else { 0.0 }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Seconds that all scenes take as usual, and with every skip undone.
fn together(
    folder: &Path,
    names: &[String],
    (film, spp): (Resolution, u64),
    pool: &rayon::ThreadPool,
) -> Result<(), Box<dyn Error>> {
    let (mut usual_s, mut undone_s) = (0.0, 0.0);
    for name in names {
        let (scene, blobs) = read(&folder.join(name))?;
        let (mut changed, mut more) = (scene.clone(), blobs.clone());
        for skip in Skip::ALL {
            skip.undo_in_scene(&mut changed, &mut |bytes| {
                let digest = Digest::of(&bytes);
                more.insert(digest, bytes);
                digest
            });
        }
        let (usual, mut undone) = (world(&scene, &blobs)?, world(&changed, &more)?);
        for skip in Skip::ALL {
            skip.undo_in_world(&mut undone);
        }
        let (mut on, mut off) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..ROUNDS {
            on = on.min(pool.install(|| render(&usual, film, spp))?.0);
            off = off.min(pool.install(|| render(&undone, film, spp))?.0);
        }
        usual_s += on;
        undone_s += off;
    }
    println!("{{\"scenes\": {}, \"usual_s\": {usual_s}, \"undone_s\": {undone_s}}}", names.len());
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(args.first().ok_or("usage: skips FOLDER [SIDE SPP]")?);
    let side: u32 = args.get(1).map_or(Ok(96), |v| v.parse())?;
    let film = Resolution::new(side, side)?;
    let spp: u64 = args.get(2).map_or(Ok(16), |v| v.parse())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut names: Vec<String> =
        fs::read_dir(folder)?.filter_map(|entry| entry.ok()?.file_name().into_string().ok()).collect();
    names.retain(|name| Stratum::of_key(name).is_some());
    names.sort();
    if args.iter().any(|word| word == "--together") {
        return together(folder, &names, (film, spp), &pool);
    }
    // By skip and context: ratios and deviations.
    let mut found: BTreeMap<(usize, String), Vec<(f64, f64)>> = BTreeMap::new();
    for name in &names {
        let (scene, blobs) = read(&folder.join(name))?;
        let usual = world(&scene, &blobs)?;
        let context = Stratum::of_key(name).map_or(String::new(), |s| s.0.context.to_string());
        let mut note = |skip: usize, ratio: f64, off: f64| {
            found.entry((skip, context.clone())).or_default().push((ratio, off));
        };
        for (number, skip) in Skip::ALL.into_iter().enumerate() {
            let (mut changed, mut more) = (scene.clone(), blobs.clone());
            let mut put = |bytes: Vec<u8>| {
                let digest = Digest::of(&bytes);
                more.insert(digest, bytes);
                digest
            };
            if !skip.undo_in_scene(&mut changed, &mut put) {
                continue;
            }
            let mut undone = world(&changed, &more)?;
            if !skip.undo_in_world(&mut undone) {
                continue;
            }
            let (mut on, mut off) = (f64::INFINITY, f64::INFINITY);
            let mut films = None;
            for _ in 0..ROUNDS {
                let a = pool.install(|| render(&usual, film, spp))?;
                let b = pool.install(|| render(&undone, film, spp))?;
                (on, off) = (on.min(a.0), off.min(b.0));
                films = Some((a.1, b.1));
            }
            let differs = films.map_or(0.0, |(a, b)| deviation(&a, &b));
            note(number, off / on, differs);
        }
        // Features of the first surface, rendered though nobody reads them.
        let renderer = Renderer::new(&usual, film, 0)?;
        let (mut on, mut features) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..ROUNDS {
            on = on.min(pool.install(|| render(&usual, film, spp))?.0);
            let begun = Instant::now();
            pool.install(|| renderer.gbuffer((0, GBufferSurface::First), spp, &mut |_| Ok(())))?;
            features = features.min(begun.elapsed().as_secs_f64());
        }
        note(Skip::ALL.len(), (on + features) / on, 0.0);
    }
    println!("| skip | context | scenes | time undone / as usual | images differ by (deviations) |");
    println!("|---|---|---:|---:|---:|");
    for ((skip, context), values) in found {
        let name = Skip::ALL.get(skip).map_or("gbuffer", |skip| skip.name());
        let ratio = median(values.iter().map(|v| v.0).collect());
        let off = values.iter().map(|v| v.1).fold(0.0, f64::max);
        println!("| `{name}` | {context} | {} | {ratio:.2} | {off:.2} |", values.len());
    }
    Ok(())
}
