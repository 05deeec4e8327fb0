//! Prints how accurate images are that are rendered to an error: what was asked for, what the render says, what a
//! reference of other samples shows, and what it cost. The cost counts the samples that decided, and is divided by the
//! samples that an oracle would take, by the variance of the reference.
//!
//! `asked_error [SAMPLES [SCENE..]]`: samples per pixel of the references, 65536 by default, and folders that `tauflow
//! export` writes. Without folders, three scenes with caustics are rendered at 32 x 24 pixels; others at 128 x 128.

mod exported;

use std::{error::Error, path::Path};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{
    Resolution,
    bins::{KEY, geometric_mean_luminance},
    scene::{Affine, Bsdf, Camera, Emitter, Geometry, Scene, Shape, Texture},
};
use tauflow_render::{accumulator::Accumulator, choices::Choices, render::Renderer, until::Until, world::World};

const ASKED: [f64; 3] = [0.25, 0.1, 0.05];
/// Pixels of the scenes with caustics, and of the scenes of folders.
const FILMS: [[u32; 2]; 2] = [[32, 24], [128, 128]];
/// Samples per pixel at most.
const MOST: u64 = 1 << 14;
/// An image that is at most so many times less accurate than it was asked for keeps what it promised.
const KEPT: f64 = 1.2;
/// The stream of the references; images are of stream 0.
const REFERENCE: u64 = 1 << 40;

fn moved(scale: f64, at: [f64; 3]) -> Affine {
    [0, 1, 2].map(|r: usize| {
        let mut row = [0.0, 0.0, 0.0, at[r]];
        row[r] = scale;
        row
    })
}

/// A square of this half side, facing up or down.
fn level(half: f64, at: [f64; 3], up: bool) -> Affine {
    let side = if up { 1.0 } else { -1.0 };
    [[half, 0.0, 0.0, at[0]], [0.0, 0.0, side * half, at[1]], [0.0, -side * half, 0.0, at[2]]]
}

fn shape(geometry: Geometry, to_world: Affine, material: usize) -> Shape {
    Shape { geometry, to_world, material, emission: None, flip_normals: false }
}

/// A floor, a body, and a small lamp; in a room if `walls`.
fn scene(body: Bsdf, lamp: f64, walls: bool) -> Scene {
    let white = Bsdf::Diffuse { reflectance: Texture::scalar(0.7) };
    let sphere = |radius: f64| Geometry::Sphere { center: [0.0; 3], radius };
    let mut shapes = vec![
        shape(Geometry::Rectangle, level(3.0, [0.0; 3], true), 0),
        shape(sphere(0.6), moved(1.0, [0.0, 0.6, 0.0]), 1),
    ];
    let mut light = shape(sphere(lamp), moved(1.0, [0.8, 2.2, 0.4]), 0);
    light.emission = Some(Texture::scalar((0.5 / (lamp * lamp)) as f32));
    shapes.push(light);
    if walls {
        let mut room = shape(Geometry::Cube, moved(2.9, [0.0, 2.9, 0.0]), 0);
        room.flip_normals = true;
        shapes.push(room);
    }
    let emitters = if walls { Vec::new() } else { vec![Emitter::Constant { radiance: [0.02; 3] }] };
    let camera =
        Camera { origin: [0.0, 1.6, 2.8], target: [0.0, 0.5, 0.0], up: [0.0, 1.0, 0.0], fov_x: 50.0, near: 0.01 };
    Scene {
        version: 1,
        seed: 3,
        camera,
        max_depth: 12,
        shapes,
        materials: vec![white, body],
        emitters,
        hide_emitters: false,
    }
}

/// Scenes with light that few paths find, by name.
fn with_caustics() -> [(&'static str, Scene); 3] {
    let glass = |alpha: f32| Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    };
    let silver =
        Bsdf::Conductor { eta: [0.15; 3], k: [3.5; 3], alpha: 0.02, specular_reflectance: Texture::scalar(1.0) };
    [
        ("glass ball, lamp of 0.1", scene(glass(0.0), 0.1, false)),
        ("glass ball in a room, lamp of 0.05", scene(glass(0.0), 0.05, true)),
        ("silver ball in a room, lamp of 0.05", scene(silver, 0.05, true)),
    ]
}

/// The known image of a scene.
struct Known {
    /// Mean and variance of single samples of each value, exposed.
    values: Vec<(f64, f64)>,
    exposure: f64,
    samples: f64,
}

impl Known {
    fn of(reference: &Accumulator) -> Self {
        let (mean, variance) = (reference.mean(), reference.variance());
        let exposure = KEY / geometric_mean_luminance(&mean);
        let exposed = |(m, v): (&f32, &f32)| (f64::from(*m) * exposure, f64::from(*v) * exposure * exposure);
        let values = mean.data().iter().zip(variance.data()).map(exposed).collect();
        Self { values, exposure, samples: reference.count as f64 }
    }

    /// The error of an image by the measure of `until`, without the reference's own noise.
    fn error(&self, image: &Accumulator) -> f64 {
        let of = |(value, (known, variance)): (&f32, &(f64, f64))| {
            let error = f64::from(*value) * self.exposure - known;
            (error * error - variance / self.samples) / (known * known + 0.01)
        };
        let sum: f64 = image.mean().data().iter().zip(&self.values).map(of).sum();
        (sum / self.values.len() as f64).max(0.0).sqrt()
    }

    /// The samples after which this error is to be expected.
    fn samples(&self, error: f64) -> f64 {
        let sum: f64 = self.values.iter().map(|(known, variance)| variance / (known * known + 0.01)).sum();
        (sum / self.values.len() as f64 / (error * error)).max(1.0)
    }
}

/// An image that was asked for: the error that is expected, the image, and the samples that decided.
fn asked(world: &World, film: Resolution, error: f64) -> Result<(f64, Accumulator, u64), KindError> {
    let until = Until::new(error, MOST);
    let on = |stream| Renderer::new(world, film, stream);
    let image = on(0)?;
    let mut decided = 0;
    let (stop, expected) = until.decide(
        0,
        1,
        || image.begin(),
        |state, stream, trial| {
            decided += trial - state.count;
            on(stream)?.advance(state, trial, &mut |_| Ok(()))
        },
    )?;
    let (samples, expected) = until.least(stop, 1, expected);
    let mut state = image.begin();
    image.advance(&mut state, samples, &mut |_| Ok(()))?;
    Ok((expected, state, decided))
}

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let mut given = std::env::args().skip(1);
    let samples: u64 = given.next().map_or(Ok(1 << 16), |text| text.parse())?;
    let mut scenes = Vec::new();
    for folder in given {
        let (scene, blobs) = exported::read(Path::new(&folder))?;
        let name = Path::new(&folder).file_name().unwrap_or_default().to_string_lossy().into_owned();
        scenes.push((name, scene, blobs));
    }
    let [width, height] = FILMS[usize::from(!scenes.is_empty())];
    let film = Resolution::new(width, height)?;
    if scenes.is_empty() {
        scenes = with_caustics().map(|(name, scene)| (name.to_owned(), scene, exported::Blobs::new())).into();
    }
    println!("| scene | asked | expected | reached | samples per pixel | cost / oracle |");
    println!("|---|---:|---:|---:|---:|---:|");
    let (mut kept, mut promised, mut costs) = (0, 0, Vec::new());
    for (name, scene, blobs) in scenes {
        let mut load = |digest: &Digest| blobs.get(digest).cloned().ok_or(KindError::MissingBlob(*digest));
        let world = World::new(&scene, &mut load)?.with_choices(Choices::default());
        let renderer = Renderer::new(&world, film, REFERENCE)?;
        let mut reference = renderer.begin();
        renderer.advance(&mut reference, samples, &mut |_| Ok(()))?;
        let known = Known::of(&reference);
        for error in ASKED {
            let (expected, image, decided) = asked(&world, film, error)?;
            let (reached, count) = (known.error(&image), image.count);
            let cost = (count + decided) as f64 / known.samples(error);
            println!("| {name} | {error} | {expected:.3} | {reached:.3} | {count} | {cost:.2} |");
            if expected <= error {
                promised += 1;
                kept += usize::from(reached <= KEPT * error);
                costs.push(cost);
            }
        }
    }
    costs.sort_by(f64::total_cmp);
    let (middle, cheap) = (costs.get(costs.len() / 2), costs.iter().filter(|cost| **cost <= 2.0).count());
    println!("{kept} of {promised} are at most {KEPT} times what was asked; {cheap} cost at most twice the oracle's");
    println!("median cost: {:.2}", middle.copied().unwrap_or(f64::NAN));
    Ok(())
}
