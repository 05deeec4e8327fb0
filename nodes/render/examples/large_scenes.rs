//! Memory and speed of large scenes, on one core: `large_scenes SCENE [SECONDS [never|always]]`, a scene a
//! process, as peaks of memory are the process's. The last word says whether meshes are shared, instead of the rule.
//!
//! `inside`: a ball of 1.3 million triangles seen from within. `copies N BANDS`: N smooth balls of one mesh of about
//! 4 BANDS^2 triangles, on a floor under a sky. `leaves`: a crown of 4,000 leaves cut out by opacity, above a floor.
//! `room`, `balls`, `everything`: the scenes of tests.
use scenes::{Built, ball, columns, film, level};
use std::{error::Error, fs};
use tauflow_contract::Digest;
use tauflow_data::{
    Image,
    mesh::Mesh,
    rng::Stream,
    scene::{Bsdf, Geometry, Texture},
};
use tauflow_render::{
    choices::Choices,
    render::Renderer,
    world::{Sharing, World},
};

#[path = "../tests/scenes/mod.rs"]
mod scenes;

/// Film's side.
const SIDE: u32 = 256;

/// A line of the process's status, in MB.
fn status(name: &str) -> f64 {
    let text = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with(name));
    let kilobytes = line.and_then(|line| line.split_whitespace().nth(1)).and_then(|v| v.parse::<f64>().ok());
    kilobytes.unwrap_or(f64::NAN) / 1024.0
}

/// Seconds of a processor that the process has had: those that the clock shows belong to whatever else runs.
fn processor() -> Result<f64, Box<dyn Error>> {
    let mut nanoseconds = 0;
    for task in fs::read_dir("/proc/self/task")? {
        let text = fs::read_to_string(task?.path().join("schedstat"))?;
        nanoseconds += text.split_whitespace().next().unwrap_or("0").parse::<u64>()?;
    }
    Ok(nanoseconds as f64 * 1e-9)
}

/// A ball seen from within, lit by a lamp.
fn inside() -> Built {
    let mut built = Built::new([0.1, 0.05, -0.2], [0.3, 0.1, 1.0], 70.0, 8);
    let white = built.diffuse([0.7; 3]);
    let sphere = columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
    built.mesh(&ball(570), sphere, white).flip_normals = true;
    built.shape(Geometry::Rectangle, level(0.2, [0.0, 0.7, 0.0], false), white).emission = Some(Texture::scalar(9.0));
    built
}

/// A turned copy's place on a grid of a side.
fn place(stream: &mut Stream, at: [f64; 3], scale: f64) -> tauflow_data::scene::Affine {
    let (u, v) = (stream.range(0.0, std::f64::consts::TAU), stream.range(-0.5, 0.5));
    let (s, c) = (tauflow_data::maths::sin(u), tauflow_data::maths::cos(u));
    let (p, q) = (tauflow_data::maths::sin(v), tauflow_data::maths::cos(v));
    let scaled = |axis: [f64; 3]| axis.map(|value| value * scale);
    columns(scaled([c, 0.0, -s]), scaled([s * p, q, c * p]), scaled([s * q, -p, c * q]), at)
}

/// Smooth balls of one mesh.
fn copies(count: usize, bands: u32) -> Built {
    let mut built = Built::new([0.0, 6.0, 14.0], [0.0, 0.5, 0.0], 50.0, 5);
    let floor = built.diffuse([0.5; 3]);
    let colors: Vec<usize> =
        (0..4).map(|k| built.diffuse([0.2 + 0.15 * k as f32, 0.5, 0.7 - 0.15 * k as f32])).collect();
    built.shape(Geometry::Rectangle, level(20.0, [0.0; 3], true), floor);
    let mesh = ball(bands);
    let side = (count as f64).sqrt().ceil() as usize;
    let step = 16.0 / side as f64;
    let mut stream = Stream::new(5, &[]);
    for k in 0..count {
        let at = [(k % side) as f64 * step - 8.0, 0.45 * step, (k / side) as f64 * step - 8.0];
        let place = place(&mut stream, at, 0.45 * step);
        built.mesh(&mesh, place, colors[k % colors.len()]);
    }
    built.sky([0.8, 0.9, 1.0]);
    built
}

/// A crown of leaves: squares of a picture whose second channel cuts the leaf out.
fn leaves() -> Built {
    let mut built = Built::new([0.0, 1.5, 5.0], [0.0, 1.6, 0.0], 45.0, 6);
    let floor = built.diffuse([0.5; 3]);
    built.shape(Geometry::Rectangle, level(10.0, [0.0; 3], true), floor);
    let side = 64;
    let mut data = Vec::new();
    for at in 0..side * side {
        let (x, y) = ((at % side) as f32 / side as f32 * 2.0 - 1.0, (at / side) as f32 / side as f32 * 2.0 - 1.0);
        let inside = x * x * (2.2 - y) + y * y * 0.9 < 0.8;
        data.extend([if inside { 1.0 } else { 0.0 }; 3]);
    }
    let bytes = Image::from_data(side, side, 3, data).expect("fits").to_bytes();
    let digest = Digest::of(&bytes);
    built.blobs.insert(digest, bytes);
    let opacity = Texture::Bitmap {
        image: digest,
        uv: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        scale: [1.0; 3],
        channel: Some(0),
        clamp: false,
    };
    let inner = Bsdf::TwoSided { inner: Box::new(Bsdf::Diffuse { reflectance: Texture::rgb([0.2, 0.5, 0.1]) }) };
    let leaf = built.material(Bsdf::Mask { opacity, inner: Box::new(inner) });
    let mut stream = Stream::new(9, &[]);
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    for _ in 0..4000 {
        let mut draw = || stream.range(-1.0, 1.0);
        let at = loop {
            let at = [draw(), draw(), draw()];
            if at.iter().map(|v| v * v).sum::<f64>() < 1.0 {
                break [at[0] * 1.4, 1.7 + at[1] * 1.2, at[2] * 1.4];
            }
        };
        let (a, b) = ([draw() * 0.1, draw() * 0.1, draw() * 0.1], [draw() * 0.1, draw() * 0.1, draw() * 0.1]);
        let first = mesh.positions.len() as u32;
        for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            mesh.positions.push(std::array::from_fn(|k| (at[k] + s * a[k] + t * b[k]) as f32));
            let uv = [(s + 1.0) * 0.5, (t + 1.0) * 0.5].map(|v: f64| v as f32);
            mesh.uvs.get_or_insert_default().push(uv);
        }
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    built.mesh(&mesh, tauflow_data::scene::IDENTITY, leaf);
    let lamp = level(1.0, [2.0, 5.0, 1.0], false);
    built.shape(Geometry::Rectangle, lamp, floor).emission = Some(Texture::scalar(20.0));
    built.sky([0.4, 0.5, 0.6]);
    built
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let number = |words: &mut std::iter::Skip<std::env::Args>| words.next().and_then(|w| w.parse::<u32>().ok());
    let name = words.next().unwrap_or_default();
    let built = match name.as_str() {
        "inside" => inside(),
        "leaves" => leaves(),
        "room" => scenes::room(),
        "balls" => scenes::balls_under_sky(),
        "everything" => scenes::everything(),
        "copies" => {
            let (count, bands) = (number(&mut words), number(&mut words));
            copies(count.ok_or("how many copies?")? as usize, bands.ok_or("how many bands?")?)
        }
        _ => return Err("name a scene: inside, leaves, room, balls, everything, or copies N BANDS".into()),
    };
    let seconds = f64::from(number(&mut words).unwrap_or(4));
    let sharing = match words.next().as_deref() {
        None => Sharing::Worthwhile,
        Some("never") => Sharing::Never,
        Some("always") => Sharing::Always,
        Some(other) => return Err(format!("sharing is never or always, and not {other}").into()),
    };
    let (before, begun) = (status("VmRSS"), processor()?);
    let world = World::with_sharing(&built.scene, &mut |digest| built.load(digest), sharing)?;
    let world = world.with_choices(Choices::default());
    let compiled = processor()? - begun;
    let (held, peak) = (status("VmRSS"), status("VmHWM"));
    let renderer = Renderer::new(&world, film(SIDE, SIDE), 0)?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut image = renderer.begin();
    // Times of the same samples, of which the least counts.
    let (mut least, mut spent) = (f64::INFINITY, 0.0);
    while spent < seconds {
        image = renderer.begin();
        let begun = processor()?;
        pool.install(|| renderer.advance(&mut image, 8, &mut |_| Ok(())))?;
        let own = processor()? - begun;
        least = least.min(own);
        spent += own;
    }
    let sum: f64 = image.mean().data().iter().map(|v| f64::from(*v)).sum();
    println!(
        "{name}: {} primitives, compiled in {:.0} ms; {:.0} MB held and {:.0} MB at the peak beyond {:.0} MB; \
         {:.3} M paths/s on one core, {:.2} segments per path; image {} of mean {:.6}",
        world.primitive_count(),
        compiled * 1e3,
        held - before,
        peak - before,
        before,
        8.0 * f64::from(SIDE * SIDE) / least / 1e6,
        image.mean_path_length(),
        &Digest::of(&image.mean().to_bytes()).to_string()[..12],
        sum / image.mean().data().len() as f64,
    );
    Ok(())
}
