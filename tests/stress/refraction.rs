//! Glass beside closed forms: what plane faces reflect and let through, by Fresnel, and where they send light, by
//! Snell, in double precision. A white furnace sees neither.

use super::{
    about,
    rendering::{Add, glass, mean, rendered, within},
    scenes::{Built, level},
};
use tauflow_data::scene::{Geometry, Texture};

/// Unpolarised reflectance of a face of relative index `n` for a cosine of incidence; 1 in total reflection.
fn reflectance(cos: f64, n: f64) -> f64 {
    let squared = 1.0 - (1.0 - cos * cos) / (n * n);
    if squared <= 0.0 {
        return 1.0;
    }
    let inside = squared.sqrt();
    let (s, p) = ((cos - n * inside) / (cos + n * inside), (inside - n * cos) / (inside + n * cos));
    0.5 * (s * s + p * p)
}

pub fn hazards(add: Add<'_>) {
    faces(add);
    slabs(add);
}

/// One face of glass under a sky, with a plate 0.1 m inside, seen as one ray.
fn face(ior: f32, cos: f64, sky: f32, plate: f32) -> Built {
    let mut built = Built::new([-(1.0 - cos * cos).sqrt(), cos, 0.0], [0.0; 3], 1e-3, 4);
    built.scene.camera.up = [0.0, 0.0, 1.0];
    built.scene.camera.near = 0.0;
    let (pane, black) = (built.material(glass(ior, 0.0)), built.diffuse([0.0; 3]));
    built.shape(Geometry::Rectangle, level(20.0, [0.0; 3], true), pane);
    built.shape(Geometry::Rectangle, level(20.0, [0.0, -0.1, 0.0], true), black).emission =
        Some(Texture::scalar(plate));
    if sky > 0.0 {
        built.sky([sky; 3]);
    }
    built
}

fn faces(add: Add<'_>) {
    // What 1.0001 reflects from ahead, 2.5e-9, takes too many paths to see.
    for (ior, cos) in [(1.5f32, 1.0), (4.0, 1.0), (1.0001, 0.01), (4.0, 0.01)] {
        let expected = reflectance(cos, ior.into());
        let came = rendered(&face(ior, cos, 1.0, 0.0), 8, 8, 4096).and_then(|film| within(&film, expected, 0.03));
        add(
            format!(
                "a sky of radiance 1, reflected by a glass face of index {ior} with a black interior, at a cosine of \
                 {cos}"
            ),
            &format!("Fresnel's reflectance, {}, to 3%", about(expected)),
            came,
        );
    }
    for (ior, cos) in [(1.0001f32, 1.0), (4.0, 1.0), (1.0001, 0.01), (4.0, 0.01)] {
        let n = f64::from(ior);
        let expected = (1.0 - reflectance(cos, n)) / (n * n);
        // From ahead, 1.0001 reflects nothing: no noise.
        let (tolerance, told) = if ior < 1.1 && cos == 1.0 { (1e-6, "1e-6") } else { (0.03, "3%") };
        let came = rendered(&face(ior, cos, 0.0, 1.0), 8, 8, 4096).and_then(|film| within(&film, expected, tolerance));
        add(
            format!("a plate of radiance 1 in glass of index {ior}, seen through its face at a cosine of {cos}"),
            &format!("the transmitted share, divided by the squared index: {}, to {told}", about(expected)),
            came,
        );
    }
}

/// Plane faces from above: where each is, its material, and whether its glass lies below.
type Faces<'a> = &'a [(f64, f32, bool)];

/// Where a ray that comes down onto the origin at 60 degrees meets a plane 1 m below the last face, and what share of
/// it gets there without being reflected.
fn landing(faces: Faces<'_>) -> (f64, f64) {
    let (mut index, mut depth, mut x, mut share) = (1.0f64, 0.0f64, 0.0f64, 1.0f64);
    let sine = 0.75f64.sqrt();
    let ahead = |index: f64| (1.0 - (sine / index) * (sine / index)).sqrt();
    for (at, ior, below) in faces {
        let (sin, cos) = (sine / index, ahead(index));
        x += (depth - at) * sin / cos;
        depth = *at;
        let relative = if *below { f64::from(*ior) } else { 1.0 / f64::from(*ior) };
        share *= 1.0 - reflectance(cos, relative);
        index *= relative;
    }
    (x + sine / index / ahead(index), share)
}

/// Those faces, and below them a glowing plate that ends at `edge`: reflections between faces come down beyond it.
fn slab(faces: Faces<'_>, edge: f64, in_one_place: usize) -> Built {
    let mut built = Built::new([-3f64.sqrt(), 1.0, 0.0], [0.0; 3], 1e-6, 64);
    built.scene.camera.up = [0.0, 0.0, 1.0];
    for (at, ior, below) in faces {
        let pane = built.material(glass(*ior, 0.0));
        for _ in 0..in_one_place {
            built.shape(Geometry::Rectangle, level(20.0, [0.0, *at, 0.0], *below), pane);
        }
    }
    let black = built.diffuse([0.0; 3]);
    let bottom = faces.last().map_or(0.0, |face| face.0) - 1.0;
    built.shape(Geometry::Rectangle, level(5.0, [edge - 5.0, bottom, 0.0], true), black).emission =
        Some(Texture::scalar(1.0));
    built
}

/// How well the place is known where the ray comes down, and the light that it brings.
fn found(faces: Faces<'_>, in_one_place: usize) -> Result<String, String> {
    let (x, share) = landing(faces);
    let seen = |edge: f64, spp: u64| rendered(&slab(faces, edge, in_one_place), 8, 8, spp);
    for off in [1e-6, 2e-6, 5e-6, 1e-5, 2e-5] {
        if mean(&seen(x - off, 16)?) == 0.0 && mean(&seen(x + off, 16)?) > 0.0 {
            let said = within(&seen(x + off, 4096)?, share, 0.01)?;
            return Ok(format!("position to {off:.0e} m; light {said}"));
        }
    }
    Err(format!("not within 2e-5 m of {x}, {share} of the light"))
}

fn slabs(add: Add<'_>) {
    let one = |ior: f32| vec![(0.0, ior, true), (-1.0, ior, false)];
    let nested = vec![(0.0, 1.5, true), (-0.3, 1.3, true), (-0.6, 1.3, false), (-1.0, 1.5, false)];
    let apart = vec![(0.0, 1.5, true), (-1.0, 1.5, false), (-1.0001, 1.5, true), (-2.0001, 1.5, false)];
    let cases = [
        ("a slab of glass of index 1.0001, 1 m thick".to_owned(), one(1.0001), 1),
        ("a slab of index 1.5".into(), one(1.5), 1),
        ("a slab of index 4".into(), one(4.0), 1),
        ("a slab of index 1.3 inside a slab of index 1.5".into(), nested, 1),
        ("two slabs of index 1.5, 0.1 mm apart".into(), apart, 1),
        ("two coincident slabs of index 1.5".into(), one(1.5), 2),
    ];
    for (what, faces, in_one_place) in cases {
        let (x, share) = landing(&faces);
        // The ray without glass goes on at 60 degrees.
        let straight = 3f64.sqrt() * (1.0 - faces.last().map_or(0.0, |face| face.0));
        let came = found(&faces, in_one_place);
        add(
            format!("a ray through {what}, at 60 degrees"),
            &format!(
                "it arrives where Snell's law predicts, 1 m below and {} m from the straight line, to 2e-5 m, with the \
                 share of the light that Fresnel's equations predict, {share:.4}, to 1%",
                about(straight - x)
            ),
            came,
        );
    }
}
