//! `scene_statistics` on scenes whose shares are known.

mod scenes;

use scenes::{Built, film, floor_point, level, recipe, room};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Context, Kind, Media, MemoryBlobs, Silent};
use tauflow_data::{
    records::{SceneRecord, SceneStatistics},
    scene::{Bsdf, Emitter, Geometry, Texture},
};
use tauflow_render::scene_statistics::{SceneStatisticsKind, SceneStatisticsParams};

fn measure(built: &Built) -> SceneStatistics {
    let (blobs, cancel) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &cancel);
    for bytes in built.blobs.values() {
        ctx.put(bytes).expect("memory");
    }
    let record = SceneRecord { scene: built.scene.clone(), recipe: recipe(0.0) };
    let scene = record.store(&ctx).expect("memory").into_artifact();
    let params = SceneStatisticsParams { resolution: film(8, 8), spp: 2048, ..SceneStatisticsParams::default() };
    let each = BTreeMap::from([("scenes", &scene)]);
    let action = Action { params, item: None, group: "main", seed: 0, each, all: BTreeMap::new() };
    let outputs = SceneStatisticsKind::run(&ctx, &action).expect("a sound scene");
    let statistics = SceneStatistics::load(&ctx, &outputs.items["statistics"]).expect("an artifact of its type");
    println!("{statistics:?}");
    statistics
}

#[test]
fn light_from_infinity_has_its_share() {
    let mut built = floor_point();
    built.sky([1.0; 3]);
    let alone = measure(&built);
    assert_eq!((alone.environment_share, alone.diffuse_share, alone.caustic_share), (1.0, 1.0, 0.0));
    // A disk above hides a share of the sky, and gives as much light as it hides times its radiance.
    let (r, h) = (0.8f64, 1.5f64);
    built.shape(Geometry::Disk, level(r, [0.0, h, 0.0], false), 0).emission = Some(Texture::scalar(2.0));
    let hidden = r * r / (r * r + h * h);
    let sky = 1.0 - hidden;
    let found = measure(&built).environment_share;
    assert!((found - sky / (sky + 2.0 * hidden)).abs() < 0.01, "{found}");
    assert_eq!(measure(&room()).environment_share, 0.0);
}

#[test]
fn a_mirror_gives_light_by_the_lamps_image() {
    // A lamp of two sides over the floor, and a mirror of half the light above it: below, the lamp's image is seen at
    // twice the mirror's height less the lamp's own. The lamp stands aside, so that it hides nothing of that.
    let mut built = floor_point();
    let (r, h, top, aside) = (0.25f64, 1.0f64, 2.0f64, 0.6f64);
    for faces_up in [false, true] {
        let height = if faces_up { h + 1e-3 } else { h };
        let place = level(r, [aside, height, 0.0], faces_up);
        built.shape(Geometry::Disk, place, 0).emission = Some(Texture::scalar(50.0));
    }
    let mirror = Bsdf::Conductor { eta: [0.0; 3], k: [1.0; 3], alpha: 0.0, specular_reflectance: Texture::scalar(0.5) };
    built.scene.materials.push(Bsdf::TwoSided { inner: Box::new(mirror) });
    let mirror = built.scene.materials.len() - 1;
    built.shape(Geometry::Rectangle, level(6.0, [0.0, top, 0.0], false), mirror);
    built.scene.max_depth = 3;
    let found = measure(&built);
    // The form factor of a parallel disk from aside.
    let factor = |height: f64| {
        let (d2, r2) = (height * height + aside * aside, r * r);
        0.5 * (1.0 - (d2 - r2) / ((d2 + r2).powi(2) - 4.0 * r2 * aside * aside).sqrt())
    };
    let image = 0.5 * factor(2.0 * top - h);
    let expected = image / (factor(h) + image);
    assert!((found.caustic_share / expected - 1.0).abs() < 0.1, "{found:?}, expected {expected}");
    assert!((found.diffuse_share - (1.0 - expected)).abs() < 0.02 && found.refractive_share == 0.0, "{found:?}");
}

#[test]
fn light_from_a_point_is_no_caustic_but_what_a_mirror_makes_of_it_cannot_be_found() {
    let mut built = floor_point();
    built.scene.emitters.push(Emitter::Point { position: [0.0, 1.0, 0.0], intensity: [4.0; 3] });
    let mirror = Bsdf::Conductor { eta: [0.0; 3], k: [1.0; 3], alpha: 0.0, specular_reflectance: Texture::scalar(0.5) };
    built.scene.materials.push(Bsdf::TwoSided { inner: Box::new(mirror) });
    let mirror = built.scene.materials.len() - 1;
    built.shape(Geometry::Rectangle, level(6.0, [0.0, 2.0, 0.0], false), mirror);
    built.scene.max_depth = 3;
    let found = measure(&built);
    assert!(found.caustic_share == 0.0 && found.diffuse_share > 0.999, "{found:?}");
}

#[test]
fn what_passes_a_pane_is_no_caustic_but_meets_glass() {
    let mut built = floor_point();
    built.shape(Geometry::Disk, level(0.3, [0.0, 1.5, 0.0], false), 0).emission = Some(Texture::scalar(20.0));
    built.scene.materials.push(Bsdf::ThinDielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    });
    let pane = built.scene.materials.len() - 1;
    built.shape(Geometry::Rectangle, level(6.0, [0.0, 1.0, 0.0], false), pane);
    built.scene.max_depth = 4;
    let found = measure(&built);
    // Seen from below the pane, all light has passed it; a little has been thrown back and forth in between.
    assert!(found.refractive_share > 0.999 && found.caustic_share < 0.005, "{found:?}");
    assert!(found.diffuse_share < 1e-9 && found.slope.is_some_and(|slope| (slope + 0.5).abs() < 0.1), "{found:?}");
    // A block of glass bends it.
    built.scene.materials[pane] = Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    };
    built.scene.shapes.pop();
    built.sphere([0.0, 0.9, 0.0], 0.4, pane);
    built.scene.max_depth = 6;
    let found = measure(&built);
    assert!(found.caustic_share > 0.95 && found.refractive_share > 0.95, "{found:?}");
}
