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
    choices::Choices,
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
    let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
    world.with_choices(Choices::default())
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

/// Asserts that the mean of green over the whole image is `expected`, and that its standard error is below 1%.
fn assert_whole(name: &str, film: &Accumulator, expected: f64) {
    let blocks = (SIDE / BLOCK) * (SIDE / BLOCK);
    let (mut mean, mut square) = (0.0, 0.0);
    for number in 0..blocks {
        let (own, error) = block(film, number, 1);
        (mean, square) = (mean + own / blocks as f64, square + error / (blocks * blocks) as f64);
    }
    let error = square.sqrt();
    println!("{name}: {mean:.6} +- {error:.6}, expected {expected:.6}");
    assert!((mean - expected).abs() < 4.5 * error + 1e-5 * expected, "{name}: {mean} +- {error}, expected {expected}");
    assert!(error < 0.01 * expected, "{name}: {error} of {expected} says nothing");
}

#[test]
fn a_concave_white_body_under_a_white_sky_is_not_seen() {
    let mut built = Built::new([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], 40.0, 400);
    let white = built.diffuse([1.0; 3]);
    built.sphere([-0.6, 0.0, 0.0], 0.7, white);
    built.sphere([0.6, 0.2, 0.0], 0.7, white);
    built.sky([1.0; 3]);
    for integrator in [joined(), Integrator::LightTracing] {
        assert_whole(&format!("furnace, {integrator:?}"), &render(&built, integrator, 0, 512), 1.0);
    }
}

#[test]
fn a_mirror_lights_a_floor_as_the_lamps_image_does() {
    // A lamp of two sides over a floor of albedo 1/2, and a mirror of half the light above it. The lamp stands aside,
    // and hides nothing of the light from its image, which is at twice the mirror's height less the lamp's own.
    const ALBEDO: f64 = 0.5;
    const RADIANCE: f64 = 50.0;
    const EYE: f64 = 0.4;
    let (r, h, top, aside) = (0.25f64, 1.0f64, 2.0f64, 0.8f64);
    let mut built = Built::new([0.0, EYE, 0.0], [0.0, 0.0, 1e-3], 50.0, 3);
    let floor = built.diffuse([ALBEDO as f32; 3]);
    built.shape(Geometry::Disk, level(0.3, [0.0; 3], true), floor);
    for up in [false, true] {
        let place = level(r, [aside, if up { h + 1e-3 } else { h }, 0.0], up);
        built.shape(Geometry::Disk, place, floor).emission = Some(Texture::scalar(RADIANCE as f32));
    }
    let mirror = Bsdf::Conductor { eta: [0.0; 3], k: [1.0; 3], alpha: 0.0, specular_reflectance: Texture::scalar(0.5) };
    let mirror = built.material(Bsdf::TwoSided { inner: Box::new(mirror) });
    built.shape(Geometry::Rectangle, level(3.0, [0.0, top, 0.0], false), mirror);
    // The form factor of a parallel disk from aside, and its mean over the square of the floor that the camera sees.
    let factor = |height: f64, square: f64| {
        let (d2, r2) = (height * height + square, r * r);
        0.5 * (1.0 - (d2 - r2) / ((d2 + r2).powi(2) - 4.0 * r2 * square).sqrt())
    };
    let half = EYE * libm::tan(25f64.to_radians());
    // A ray to the image passes the lamp's height at a third of the way, twice as far from its axis as from the floor's
    // point less a third of the image's radius.
    assert!(aside - half > 2.0 * r, "the lamp hides a part of its image");
    let steps: Vec<f64> = (0..64).map(|k| half * ((f64::from(k) + 0.5) / 32.0 - 1.0)).collect();
    let squares = steps.iter().flat_map(|x| steps.iter().map(move |z| (x - aside).powi(2) + z * z));
    let mean = |height: f64| squares.clone().map(|square| factor(height, square)).sum::<f64>() / 4096.0;
    let expected = ALBEDO * RADIANCE * (mean(h) + 0.5 * mean(2.0 * top - h - 1e-3));
    let (alone, both) = (render(&built, Integrator::default(), 0, 4096), render(&built, joined(), 0, 4096));
    assert_whole("mirror, paths from the camera", &alone, expected);
    assert_whole("mirror, light paths, too", &both, expected);
    assert!(alone != both, "light paths take part");
}

#[test]
fn a_slab_of_glass_lets_its_share_of_a_sun_through() {
    // Paths from the camera cannot find a sun behind glass, and light paths beside them leave it out. Alone, they find
    // it: what all reflections inside let through is (1 - R) / (1 + R), R by Fresnel's equations in f64.
    const ALBEDO: f64 = 0.5;
    const INDEX: f64 = 1.5;
    let mut built = Built::new([0.0, 0.4, 0.0], [0.0, 0.0, 1e-3], 50.0, 40);
    let floor = built.diffuse([ALBEDO as f32; 3]);
    built.shape(Geometry::Disk, level(0.4, [0.0; 3], true), floor);
    let glass = built.material(Bsdf::Dielectric {
        int_ior: INDEX as f32,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    });
    let slab = columns([1.2, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 1.2], [0.0, 1.0, 0.0]);
    built.shape(Geometry::Cube, slab, glass);
    let irradiance = 3.0;
    built.scene.emitters.push(Emitter::Directional { direction: [0.6, -1.0, 0.2], irradiance: [irradiance as f32; 3] });
    let cos = 1.0 / (0.6f64 * 0.6 + 1.0 + 0.2 * 0.2).sqrt();
    let inside = (1.0 - (1.0 - cos * cos) / (INDEX * INDEX)).sqrt();
    let across = (cos - INDEX * inside) / (cos + INDEX * inside);
    let along = (INDEX * cos - inside) / (INDEX * cos + inside);
    let reflected = 0.5 * (across * across + along * along);
    let direct = ALBEDO / std::f64::consts::PI * irradiance * cos * (1.0 - reflected) / (1.0 + reflected);
    // The slab mirrors the floor, 1.9 m away from it, nearly upright: both faces reflect 2 R / (1 + R) together.
    let upright = ((INDEX - 1.0) / (INDEX + 1.0)).powi(2);
    let again = ALBEDO * 0.16 / (0.16 + 1.9 * 1.9) * 2.0 * upright / (1.0 + upright);
    assert_whole("slab", &render(&built, Integrator::LightTracing, 0, 2048), direct * (1.0 + again));
    let dark = |integrator: Integrator| render(&built, integrator, 0, 16).pixels.iter().all(|of| of.sum == [0.0; 3]);
    assert!(dark(Integrator::default()) && dark(joined()));
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
