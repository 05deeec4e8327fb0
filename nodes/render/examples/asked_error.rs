//! Prints how accurate images are that are rendered to an error, in scenes with caustics: what was asked for, what the
//! render says, and what a reference of other samples shows.
//!
//! `asked_error [SAMPLES]`: samples per pixel of the references, 65536 by default.

use std::error::Error;
use tauflow_contract::KindError;
use tauflow_data::{
    Image, Resolution,
    bins::{KEY, geometric_mean_luminance},
    scene::{Affine, Bsdf, Camera, Emitter, Geometry, Scene, Shape, Texture},
};
use tauflow_render::{
    render::{Goal, Renderer, Setup, render_image},
    until::Until,
    world::World,
};

const ASKED: [f64; 3] = [0.25, 0.1, 0.05];
const FILM: [usize; 2] = [32, 24];
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

/// The error as `until` has it, against a reference.
fn reached(image: &Image, reference: &Image) -> f64 {
    let exposure = KEY / geometric_mean_luminance(reference);
    let of = |(v, r): (&f32, &f32)| {
        let (v, r) = (f64::from(*v) * exposure, f64::from(*r) * exposure);
        (v - r).powi(2) / (r * r + 0.01)
    };
    let sum: f64 = image.data().iter().zip(reference.data()).map(of).sum();
    (sum / image.data().len() as f64).sqrt()
}

fn main() -> Result<(), Box<dyn Error>> {
    let samples: u64 = std::env::args().nth(1).map_or(Ok(1 << 16), |text| text.parse())?;
    let glass = |alpha: f32| Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    };
    let silver =
        Bsdf::Conductor { eta: [0.15; 3], k: [3.5; 3], alpha: 0.02, specular_reflectance: Texture::scalar(1.0) };
    let scenes = [
        ("glass ball, lamp of 0.1", scene(glass(0.0), 0.1, false)),
        ("glass ball in a room, lamp of 0.05", scene(glass(0.0), 0.05, true)),
        ("silver ball in a room, lamp of 0.05", scene(silver, 0.05, true)),
    ];
    let film = Resolution::new(FILM[0] as u32, FILM[1] as u32)?;
    println!("| scene | asked | expected | reached | samples per pixel |\n|---|---:|---:|---:|---:|");
    for (name, scene) in scenes {
        let mut load = |digest: &tauflow_contract::Digest| Err(KindError::MissingBlob(*digest));
        let world = World::new(&scene, &mut load)?;
        let renderer = Renderer::new(&world, film, REFERENCE)?;
        let mut reference = renderer.begin();
        renderer.advance(&mut reference, samples, &mut |_| Ok(()))?;
        let reference = reference.mean();
        for asked in ASKED {
            let goal = Goal::Error(Until::new(asked, 1 << 16));
            let rendered = render_image(&scene, &mut load, Setup::new(film), goal, &mut |_| Ok(()))?;
            let expected = rendered.stats.error.map_or_else(|| "unknown".into(), |error| format!("{error:.3}"));
            let reached = reached(&rendered.image, &reference);
            println!("| {name} | {asked} | {expected} | {reached:.3} | {} |", rendered.stats.samples);
        }
    }
    Ok(())
}
