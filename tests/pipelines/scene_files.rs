//! Scene files have the means that Mitsuba 3 gives them. `scene_files.json` holds its means and standard errors;
//! `benches/mitsuba/files.py TAUFLOW --variant scalar_rgb --only NAME .. --reference FILE` writes them.

use crate::{
    mitsuba::{BINS, References, bins, deviation, moments},
    support::root,
};
use tauflow_contract::{Digest, KindError};
use tauflow_data::Resolution;
use tauflow_render::{render::Renderer, world::World};
use tauflow_scene_readers::{Options, load_scene};

/// Independent streams of samples, and samples per pixel of each.
const BATCHES: u64 = 8;
const SPP: u64 = 32;

#[test]
fn scene_files_have_mitsubas_means() {
    let references: References = serde_json::from_str(include_str!("scene_files.json")).expect("a sound file");
    assert!(references.mitsuba.starts_with("3.9") && references.side == 64);
    let film = Resolution::new(64, 64).expect("small");
    let mut squares = 0.0;
    for reference in &references.scenes {
        let name = &reference.scene;
        let path = root().join("benches/mitsuba/files").join(format!("{name}.xml"));
        let loaded = load_scene(&path, None, 0, Options::default()).expect("all of it is supported");
        let load = &mut |digest: &Digest| -> Result<Vec<u8>, KindError> { Ok(loaded.blobs[digest].clone()) };
        let world = World::new(&loaded.scene, load).expect("a sound scene");
        let batch = |stream: u64| {
            let renderer = Renderer::new(&world, film, stream).expect("a film of that size");
            let mut samples = renderer.begin();
            renderer.advance(&mut samples, SPP, &mut |_| Ok(())).expect("nothing stops it");
            assert_eq!(samples.rejected, 0, "{name}");
            bins(&samples.mean())
        };
        let batches: Vec<Vec<f64>> = (0..BATCHES).map(batch).collect();
        let least = references.batches.min(BATCHES as usize) as f64;
        for bin in 0..BINS * BINS {
            let ours = moments(&batches.iter().map(|batch| batch[bin]).collect::<Vec<_>>());
            let theirs = (reference.means[bin], reference.errors[bin].powi(2));
            let (z, _) = deviation(ours, theirs, least);
            assert!(z.abs() < 5.0, "{name}, bin {bin}: {ours:?} here, {theirs:?} there, {z:.1} deviations");
        }
        let whole: Vec<f64> = batches.iter().map(|b| b.iter().sum::<f64>() / b.len() as f64).collect();
        let count = reference.means.len() as f64;
        let mean = reference.means.iter().sum::<f64>() / count;
        let error = reference.errors.iter().map(|e| e * e).sum::<f64>() / (count * count);
        let (z, error) = deviation(moments(&whole), (mean, error), least);
        println!("{name}: {z:+.2} deviations; a bias of {:.2}% would be found", 100.0 * 4.84 * error / mean);
        assert!(z.abs() < 4.0, "{name}: the image's mean is {z:.1} deviations off");
        squares += z * z / references.scenes.len() as f64;
    }
    assert!(squares < 3.0, "deviations are larger than chance makes them: {squares}");
}
