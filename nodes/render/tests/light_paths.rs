//! Paths from the lights: against paths from the camera, against a closed form, and bit for bit on any threads.

mod scenes;

use scenes::{Built, ball, balls_under_sky, columns, copies, everything, film, level, room};
use tauflow_contract::Digest;
use tauflow_data::{
    Image, SamplerKind,
    scene::{Bsdf, Emitter, Geometry, Texture},
};
use tauflow_render::{
    accumulator::Accumulator,
    integrator::{Integrator, Path},
    render::Renderer,
    world::World,
};

const SIDE: usize = 24;
const BLOCK: usize = 8;

fn joined() -> Integrator {
    Integrator::Bidirectional(Path::default())
}

fn world(built: &Built) -> World {
    World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene")
}

fn render(built: &Built, integrator: Integrator, stream: u64, spp: u64) -> Accumulator {
    let world = world(built);
    let renderer = Renderer::new(&world, film(SIDE as u32, SIDE as u32), stream).expect("a film");
    let renderer = renderer.with_integrator(integrator);
    let mut film = renderer.begin();
    renderer.advance(&mut film, spp, &mut |_| Ok(())).expect("nothing stops it");
    film
}

/// Mean over a block and channel, and its squared standard error.
fn block(film: &Accumulator, number: usize, channel: usize) -> (f64, f64) {
    let across = SIDE / BLOCK;
    let (left, top) = (number % across * BLOCK, number / across * BLOCK);
    let (mut sum, mut square) = (0.0, 0.0);
    for y in top..top + BLOCK {
        for x in left..left + BLOCK {
            let pixel = &film.pixels[y * SIDE + x];
            sum += pixel.sum[channel];
            square += pixel.m2[channel];
        }
    }
    let (n, area) = (film.count as f64, (BLOCK * BLOCK) as f64);
    (sum / (n * area), square / ((n - 1.0) * n * area * area))
}

/// That two integrators have the same mean in every block, by z-tests, and in the whole to a percent or so.
fn agree(name: &str, built: &Built, a: Integrator, b: Integrator, spp: u64) {
    let (first, second) = (render(built, a, 1, spp), render(built, b, 2, spp));
    let blocks = (SIDE / BLOCK) * (SIDE / BLOCK);
    let (mut worst, mut whole, mut error) = (0.0f64, [0.0; 2], 0.0);
    for number in 0..blocks {
        for channel in 0..3 {
            let ((x, of_x), (y, of_y)) = (block(&first, number, channel), block(&second, number, channel));
            whole = [whole[0] + x, whole[1] + y];
            error += of_x + of_y;
            let z = (x - y) / (of_x + of_y).sqrt().max(1e-12);
            assert!(z.abs() < 4.7, "{name}, block {number}, channel {channel}: {x} and {y}, z = {z}");
            worst = worst.max(z.abs());
        }
    }
    let relative = error.sqrt() / whole[0];
    println!("{name}: {:.5} and {:.5}, to {:.2}%, worst z {worst:.2}", whole[0], whole[1], 100.0 * relative);
    assert!(relative < 0.05, "{name}: too few samples to say anything");
}

/// A scene without anything specular: glass is rough, and thin sheets are painted.
fn without_specular(mut built: Built) -> Built {
    for bsdf in &mut built.scene.materials {
        match bsdf {
            Bsdf::Dielectric { alpha, .. } => *alpha = alpha.max(0.3),
            Bsdf::ThinDielectric { .. } => *bsdf = Bsdf::Diffuse { reflectance: Texture::scalar(0.5) },
            _ => {}
        }
    }
    built
}

/// A small floor with a ball on it, without light.
fn stage() -> Built {
    let mut built = Built::new([0.0, 1.6, 3.0], [0.0, 0.2, 0.0], 40.0, 5);
    let (floor, grey) = (built.diffuse([0.5, 0.4, 0.6]), built.diffuse([0.7; 3]));
    built.shape(Geometry::Rectangle, level(1.4, [0.0; 3], true), floor);
    built.mesh(&ball(12), columns([0.4, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.4], [0.3, 0.4, 0.0]), grey);
    built
}

#[test]
fn every_light_is_found_from_both_ends() {
    let lamp = |geometry: Geometry, turned: bool| {
        let mut built = stage();
        let black = built.diffuse([0.0; 3]);
        let lamp = built.shape(geometry, level(0.4, [-0.3, 1.5, 0.2], turned), black);
        lamp.emission = Some(Texture::rgb([3.0, 2.0, 1.0]));
        // One that faces up is turned round as a whole.
        lamp.flip_normals = turned;
        built
    };
    let emitter = |emitter: Emitter| {
        let mut built = stage();
        built.scene.emitters.push(emitter);
        built
    };
    let sphere = Geometry::Sphere { center: [0.0; 3], radius: 0.6 };
    let down = columns([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.0, 2.0, 0.0]);
    let spot = Emitter::Spot { to_world: down, intensity: [4.0; 3], cutoff_angle: 40.0, beam_width: 20.0 };
    let scenes = [
        ("disk", lamp(Geometry::Disk, false)),
        ("turned disk", lamp(Geometry::Disk, true)),
        ("rectangle", lamp(Geometry::Rectangle, false)),
        ("turned rectangle", lamp(Geometry::Rectangle, true)),
        ("cube", lamp(Geometry::Cube, false)),
        ("sphere", lamp(sphere, false)),
        ("point", emitter(Emitter::Point { position: [0.2, 2.0, 0.5], intensity: [2.0; 3] })),
        ("spot", emitter(spot)),
        ("sun", emitter(Emitter::Directional { direction: [1.0, -2.0, -0.5], irradiance: [2.0; 3] })),
        ("sky", emitter(Emitter::Constant { radiance: [0.5, 0.7, 1.0] })),
    ];
    for (name, built) in scenes {
        agree(name, &built, Integrator::default(), Integrator::LightTracing, 512);
    }
}

#[test]
fn light_tracing_agrees_with_path_tracing() {
    agree("room", &room(), Integrator::default(), Integrator::LightTracing, 512);
    let everything = without_specular(everything());
    agree("everything rough", &everything, Integrator::default(), Integrator::LightTracing, 3072);
    let copies = without_specular(copies());
    agree("rough copies", &copies, Integrator::default(), Integrator::LightTracing, 2048);
}

/// A ball of glass under a lamp, and a mirror.
fn caustics(lamp: f64, radiance: f32, mirrored: bool) -> Built {
    let mut built = stage();
    let white = || Texture::scalar(1.0);
    let glass = built.material(Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: white(),
        specular_transmittance: Texture::rgb([0.9, 1.0, 0.8]),
    });
    let mirror = built.material(Bsdf::TwoSided {
        inner: Box::new(Bsdf::Conductor {
            eta: [0.2, 0.9, 1.1],
            k: [3.9, 2.4, 2.2],
            alpha: 0.0,
            specular_reflectance: white(),
        }),
    });
    let black = built.diffuse([0.0; 3]);
    built.scene.max_depth = 7;
    // Facets with smooth normals: shading normals off the geometric ones.
    built.mesh(&ball(8), columns([0.35, 0.0, 0.0], [0.0, 0.35, 0.0], [0.0, 0.0, 0.35], [-0.5, 0.6, 0.3]), glass);
    let wall = columns([0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 1.0], [0.2, 0.5, -0.8]);
    if mirrored {
        built.shape(Geometry::Rectangle, wall, mirror);
    }
    let lamp = built.shape(Geometry::Disk, level(lamp, [-0.6, 2.2, 0.4], false), black);
    lamp.emission = Some(Texture::scalar(radiance));
    built
}

/// A closed room with a ball of glass, walls of several kinds, and a lamp of this half width: caustics light its walls.
fn room_of_glass(lamp: f64, radiance: f32) -> Built {
    let mut built = room();
    let glass = built.material(Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    });
    let coated = |alpha: f32| Bsdf::Plastic {
        diffuse_reflectance: Texture::rgb([0.6, 0.5, 0.3]),
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha,
    };
    let (smooth, rough) = (built.material(coated(0.0)), built.material(coated(0.2)));
    let shapes = built.scene.shapes.len();
    built.scene.shapes[2].material = rough;
    built.scene.shapes[shapes - 3].material = smooth;
    built.scene.shapes[shapes - 2].material = glass;
    let place = level(lamp, [0.1, 1.99, 0.1], false);
    built.scene.shapes[shapes - 1].to_world = place;
    built.scene.shapes[shapes - 1].emission = Some(Texture::scalar(radiance));
    built
}

/// A corner under many lamps, turned in every way, and a picture of the sky that is half black.
fn corner_of_lamps(max_depth: u32) -> Built {
    let mut built = caustics(0.3, 4.0, true);
    built.scene.max_depth = max_depth;
    let black = built.diffuse([0.0; 3]);
    for number in 0..9 {
        let (x, z) = (f64::from(number % 3) * 0.9 - 0.9, f64::from(number / 3) * 0.8 - 0.6);
        let height = 1.6 + 0.1 * f64::from(number);
        let lamp = match number % 3 {
            0 => built.shape(Geometry::Rectangle, level(0.15, [x, height, z], true), black),
            1 => built.sphere([x, height, z], 0.1, black),
            _ => built.shape(Geometry::Disk, level(0.15, [x, height, z], false), black),
        };
        lamp.flip_normals = number % 3 == 0;
        lamp.emission = Some(Texture::scalar(1.0 + number as f32));
    }
    let sky = Image::from_data(4, 4, 3, (0..48).map(|at| if at < 24 { 0.8 } else { 0.0 }).collect()).expect("an image");
    let bytes = sky.to_bytes();
    let digest = Digest::of(&bytes);
    built.blobs.insert(digest, bytes);
    let to_world = columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
    built.scene.emitters.push(Emitter::Envmap { image: digest, scale: 1.0, to_world });
    built
}

#[test]
fn many_lamps_and_a_black_sky_are_found_from_both_ends() {
    for depth in [2, 3, 6] {
        let built = corner_of_lamps(depth);
        agree(&format!("a corner, {depth} segments"), &built, Integrator::default(), joined(), 1024);
        assert_eq!(render(&built, joined(), 3, 16).rejected, 0, "{depth} segments");
    }
}

#[test]
fn caustics_are_found_from_both_ends() {
    agree("a room", &room_of_glass(0.35, 9.0), Integrator::default(), joined(), 4096);
    agree("a wide lamp", &caustics(0.5, 6.0, true), Integrator::default(), joined(), 2048);
    let mut sky = caustics(0.5, 6.0, true);
    sky.scene.emitters.push(Emitter::Constant { radiance: [0.5, 0.7, 1.0] });
    agree("a lamp and a sky", &sky, Integrator::default(), joined(), 2048);
    agree("everything", &everything(), Integrator::default(), joined(), 2048);
    agree("copies", &copies(), Integrator::default(), joined(), 2048);
}

#[test]
fn what_shines_through_a_dome_has_its_closed_form() {
    // Index-matched glass bends nothing, and is a chain of specular vertices all the same. A floor of albedo 1/2 under
    // a sky of 1 has radiance 1/2, whoever finds the light.
    let mut built = Built::new([0.0, 0.25, 0.0], [0.0, 0.0, 0.01], 60.0, 6);
    let floor = built.diffuse([0.5; 3]);
    built.shape(Geometry::Disk, level(0.28, [0.0; 3], true), floor);
    let glass = built.material(Bsdf::Dielectric {
        int_ior: 1.0,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    });
    for radius in [0.4, 0.3] {
        built.sphere([0.0; 3], radius, glass);
    }
    built.sky([1.0; 3]);
    for (integrator, spp) in [(Integrator::LightTracing, 2048), (joined(), 256)] {
        let found = render(&built, integrator, 0, spp);
        for number in 0..(SIDE / BLOCK) * (SIDE / BLOCK) {
            let (mean, square) = block(&found, number, 0);
            let error = square.sqrt();
            assert!((mean - 0.5).abs() < 4.5 * error + 1e-4, "{integrator:?}, block {number}: {mean} +- {error}");
            assert!(error > 0.0 && error < 0.02, "{integrator:?}, block {number}: {error} says nothing");
        }
    }
}

#[test]
fn small_lamps_make_caustics_with_less_noise() {
    // The variance of a path tracer is that of few bright samples: if anything, it is underestimated.
    let built = caustics(0.08, 200.0, false);
    let mean = |film: &Accumulator| {
        let image = film.variance();
        image.data().iter().map(|v| f64::from(*v)).sum::<f64>() / image.data().len() as f64
    };
    let (alone, both) =
        (mean(&render(&built, Integrator::default(), 1, 2048)), mean(&render(&built, joined(), 1, 2048)));
    println!("variance of a sample: {alone:.3} alone, {both:.3} with light paths");
    assert!(both < 0.5 * alone, "{both} {alone}");
}

#[test]
fn light_paths_have_the_same_bits_on_any_threads_and_in_any_goes() {
    for (built, integrator) in
        [(caustics(0.3, 9.0, true), joined()), (balls_under_sky(), Integrator::LightTracing), (copies(), joined())]
    {
        let world = world(&built);
        let render = |threads: usize, stops: &[u64]| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let renderer = Renderer::new(&world, film(40, 30), 5).expect("a film").with_integrator(integrator);
            let renderer = renderer.with_sampler(SamplerKind::Independent);
            let mut film = renderer.begin();
            for stop in stops {
                pool.install(|| renderer.advance(&mut film, *stop, &mut |_| Ok(()))).expect("nothing stops it");
            }
            film
        };
        let once = render(1, &[7]);
        assert!(render(3, &[7]) == once, "three threads");
        assert!(render(2, &[1, 2, 5, 7]) == once, "in four goes");
    }
}
