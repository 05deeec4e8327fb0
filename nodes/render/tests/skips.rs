//! Skips change nothing: undone, the image keeps its bits, or its expectation.

mod scenes;

use scenes::{Built, balls_under_sky, everything, film, room};
use std::collections::BTreeMap;
use tauflow_contract::Digest;
use tauflow_render::{accumulator::Accumulator, render::Renderer, skips::Skip, world::World};

/// Renders with a skip undone; `None` if the scene needs what is skipped.
fn render(built: &Built, undone: Option<Skip>, spp: u64) -> Option<Accumulator> {
    let mut scene = built.scene.clone();
    let mut more: BTreeMap<Digest, Vec<u8>> = BTreeMap::new();
    let mut put = |bytes: Vec<u8>| {
        let digest = Digest::of(&bytes);
        more.insert(digest, bytes);
        digest
    };
    if undone.is_some_and(|skip| !skip.undo_in_scene(&mut scene, &mut put)) {
        return None;
    }
    let mut load = |digest: &Digest| match more.get(digest) {
        Some(bytes) => Ok(bytes.clone()),
        None => built.load(digest),
    };
    let mut world = World::new(&scene, &mut load).expect("a sound scene");
    if undone.is_some_and(|skip| !skip.undo_in_world(&mut world)) {
        return None;
    }
    let renderer = Renderer::new(&world, film(24, 24), 0).expect("a film");
    let mut film = renderer.begin();
    renderer.advance(&mut film, spp, &mut |_| Ok(())).expect("nothing stops it");
    Some(film)
}

#[test]
fn undone_they_give_the_same_image() {
    let mut applied = 0;
    for (name, built) in [("balls under a sky", balls_under_sky()), ("room", room()), ("everything", everything())] {
        for skip in Skip::ALL {
            let spp = if skip.is_exact() { 16 } else { 512 };
            let usual = render(&built, None, spp).expect("a film");
            let Some(undone) = render(&built, Some(skip), spp) else { continue };
            applied += 1;
            if skip.is_exact() {
                assert!(usual.pixels == undone.pixels, "{name}: {} changes bits", skip.name());
                continue;
            }
            // Blocks of pixels; random numbers are shared as far as they go, so that errors are smaller than this says.
            let n = spp as f64;
            let mut worst = 0.0f64;
            for block in 0..36 {
                let (mut difference, mut square, mut sum) = (0.0, 0.0, 0.0);
                for i in 0..16 {
                    let at = (block / 6 * 4 + i / 4) * 24 + block % 6 * 4 + i % 4;
                    for c in 0..3 {
                        let (a, b) = (&usual.pixels[at], &undone.pixels[at]);
                        difference += (a.sum[c] - b.sum[c]) / n;
                        square += (a.m2[c] + b.m2[c]) / (n * (n - 1.0));
                        sum += a.sum[c] / n;
                    }
                }
                let error = square.sqrt() + 1e-5 * sum;
                worst = worst.max(if error > 0.0 { difference.abs() / error } else { 0.0 });
            }
            println!("{name}: {} differs by {worst:.2} deviations at most", skip.name());
            assert!(worst < 4.5, "{name}: {} differs by {worst} deviations", skip.name());
        }
    }
    assert_eq!(applied, 13, "all but for the sky that two scenes need anyway");
}
