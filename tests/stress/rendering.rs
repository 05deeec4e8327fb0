//! Geometry, light, materials and films.

use super::{
    Hazard, about, held,
    scenes::{Built, balls_under_sky, columns, floor_point, level, room},
};
use tauflow_contract::Digest;
use tauflow_data::{
    Image, Resolution,
    scene::{Bsdf, Emitter, Geometry, IDENTITY, Texture},
};
use tauflow_render::{
    accumulator::{Accumulator, Pixel},
    choices::Choices,
    integrator::Roulette,
    render::Renderer,
    world::World,
};

const AREA: &str = "Rendering";

pub(super) fn world(built: &Built) -> Result<World, String> {
    let world = World::new(&built.scene, &mut |digest| built.load(digest)).map_err(|e| e.to_string())?;
    Ok(world.with_choices(Choices::default()))
}

pub(super) fn rendered(built: &Built, width: u32, height: u32, spp: u64) -> Result<Accumulator, String> {
    let world = world(built)?;
    let film = Resolution::new(width, height).map_err(|e| e.to_string())?;
    film_of(&Renderer::new(&world, film, 0).map_err(|e| e.to_string())?, spp)
}

/// What a renderer makes, if all of it counts.
fn film_of(renderer: &Renderer<'_>, spp: u64) -> Result<Accumulator, String> {
    let mut film = renderer.begin();
    renderer.advance(&mut film, spp, &mut |_| Ok(())).map_err(|e| e.to_string())?;
    let image = film.mean();
    if film.rejected > 0 || image.data().iter().any(|v| !v.is_finite()) {
        return Err(format!(
            "{} contributions rejected, {} values not finite",
            film.rejected,
            image.data().iter().filter(|v| !v.is_finite()).count()
        ));
    }
    Ok(film)
}

pub(super) fn mean(film: &Accumulator) -> f64 {
    let image = film.mean();
    image.data().iter().map(|v| f64::from(*v)).sum::<f64>() / image.data().len() as f64
}

/// The largest difference of a pixel, relative to the mean.
pub(super) fn difference(a: &Accumulator, b: &Accumulator) -> f64 {
    let pairs = a.mean();
    let largest = pairs.data().iter().zip(b.mean().data()).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    largest / mean(b).max(1e-30)
}

pub(super) fn glass(ior: f32, alpha: f32) -> Bsdf {
    Bsdf::Dielectric {
        int_ior: ior,
        ext_ior: 1.0,
        alpha,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    }
}

/// A ball of a material under a sky of 1 everywhere, filling the view.
pub(super) fn furnace(bsdf: Bsdf, max_depth: u32) -> Built {
    let mut built = Built::new([0.0, 0.0, 4.0], [0.0; 3], 20.0, max_depth);
    let material = built.material(bsdf);
    built.sphere([0.0; 3], 1.0, material);
    built.sky([1.0; 3]);
    built
}

/// Inside a closed cube that shines by itself: L = 1 + albedo + albedo^2 + ..., as far as paths go.
pub(super) fn glowing(albedo: f32, depth: u32) -> Built {
    let mut shell = Built::new([0.0; 3], [1.0, 0.0, 0.0], 60.0, depth);
    let grey = shell.diffuse([albedo; 3]);
    let wall = shell.shape(Geometry::Cube, IDENTITY, grey);
    wall.flip_normals = true;
    wall.emission = Some(Texture::scalar(1.0));
    shell
}

/// A scene scaled about the origin and moved.
fn moved(built: &Built, scale: f64, shift: f64) -> Built {
    let mut out = built.clone();
    let point = |p: &mut [f64; 3]| p.iter_mut().for_each(|v| *v = *v * scale + shift);
    point(&mut out.scene.camera.origin);
    point(&mut out.scene.camera.target);
    out.scene.camera.near *= scale;
    for shape in &mut out.scene.shapes {
        for row in &mut shape.to_world {
            row[..3].iter_mut().for_each(|v| *v *= scale);
            row[3] = row[3] * scale + shift;
        }
    }
    out
}

pub(super) fn within(film: &Accumulator, expected: f64, tolerance: f64) -> Result<String, String> {
    let off = (mean(film) / expected - 1.0).abs();
    held(off <= tolerance, format!("off by {} of the expected value, no sample rejected", about(off)))
}

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    space(&mut add);
    light(&mut add);
    materials(&mut add);
    super::refraction::hazards(&mut add);
    super::geometry::hazards(&mut add);
    films(&mut add);
    out
}

pub(super) type Add<'a> = &'a mut dyn FnMut(String, &str, Result<String, String>);

fn space(add: Add<'_>) {
    let base = balls_under_sky();
    let reference = rendered(&base, 16, 16, 16);
    for scale in [1e-6, 1e-3, 1e3, 1e6] {
        let came = reference.clone().and_then(|reference| {
            let off = (mean(&rendered(&moved(&base, scale, 0.0), 16, 16, 16)?) / mean(&reference) - 1.0).abs();
            held(off < 2e-3, format!("mean off by {}", about(off)))
        });
        add(format!("a scene of balls, scaled by {scale:.0e}"), "the same mean to 0.2%", came);
    }
    for (shift, tolerance) in [(1e2, 1e-3), (1e4, 2e-3), (1e6, 0.01)] {
        let came = reference.clone().and_then(|reference| {
            let off = (mean(&rendered(&moved(&base, 1.0, shift), 16, 16, 16)?) / mean(&reference) - 1.0).abs();
            held(
                off < tolerance,
                format!(
                    "mean off by {}: neighbouring single-precision numbers are {} m apart there",
                    about(off),
                    about(f64::from(f32::EPSILON) * shift)
                ),
            )
        });
        let must = format!("finite; the mean to {tolerance}");
        add(format!("the same scene, moved by {shift:.0e} m along every axis"), &must, came);
    }
}

fn light(add: Add<'_>) {
    // A floor of albedo 1/2 under a light from straight above: radiance = irradiance/2/pi.
    for irradiance in [1e5f32, 1e8] {
        let mut built = floor_point();
        built.scene.emitters.push(Emitter::Directional { direction: [0.0, -1.0, 0.0], irradiance: [irradiance; 3] });
        let expected = 0.5 * f64::from(irradiance) / std::f64::consts::PI;
        let came = rendered(&built, 4, 4, 4).and_then(|film| within(&film, expected, 1e-5));
        add(format!("a sun of irradiance {irradiance:.0e} on a floor"), "irradiance x albedo/pi", came);
    }
    let black = Built::new([0.0; 3], [1.0, 0.0, 0.0], 40.0, 4);
    let came = rendered(&black, 8, 8, 4).and_then(|film| held(mean(&film) == 0.0, about(mean(&film))));
    add("no shape and no light".into(), "exactly 0", came);
    let mut dark = room();
    dark.scene.shapes.iter_mut().for_each(|shape| shape.emission = None);
    let came = rendered(&dark, 8, 8, 4).and_then(|film| held(mean(&film) == 0.0, about(mean(&film))));
    add("a closed room with its lamp switched off".into(), "exactly 0", came);
    // A lamp so small that it is a point: E = L A cos/d^2 of a floor point below.
    for half in [1e-2, 1e-4, 1e-6] {
        let mut built = floor_point();
        let lamp = built.diffuse([0.0; 3]);
        let radiance = (1.0 / (half * half)) as f32;
        built.shape(Geometry::Rectangle, level(half, [0.0, 2.0, 0.0], false), lamp).emission =
            Some(Texture::scalar(radiance));
        // The camera sees a small patch of the floor around the point below the lamp.
        let expected = 0.5 / std::f64::consts::PI * f64::from(radiance) * 4.0 * half * half / 4.0;
        let came = rendered(&built, 4, 4, 64).and_then(|film| within(&film, expected, 0.01));
        add(
            format!(
                "a square lamp of {:.0e} m, two metres above a floor, with the same power at every size",
                2.0 * half
            ),
            "its irradiance times albedo/pi, to 1%",
            came,
        );
    }
    // A sun at the horizon: the cosine is all that is left of it.
    for elevation in [1e-1f64, 1e-3, 1e-5] {
        let mut built = floor_point();
        let direction = [-elevation.cos(), -elevation.sin(), 0.0];
        built.scene.emitters.push(Emitter::Directional { direction, irradiance: [1e6; 3] });
        let expected = 0.5 * 1e6 * elevation.sin() / std::f64::consts::PI;
        let came = rendered(&built, 4, 4, 4).and_then(|film| within(&film, expected, 1e-4));
        add(
            format!("a sun {elevation:.0e} radians above the horizon"),
            "irradiance x albedo/pi x sin(elevation), to 1e-4",
            came,
        );
    }
    // Nearly in the plane of the floor: little light, but not none, and no sparkle.
    let (half, away, height) = (0.5f64, 3.0f64, 1e-4f64);
    let mut built = floor_point();
    let lamp = built.diffuse([0.0; 3]);
    built.shape(Geometry::Rectangle, level(half, [away, height, 0.0], false), lamp).emission =
        Some(Texture::scalar(1.0));
    // The film shows a few hundredths of a millimetre of floor: E at its middle, L h^2/r^4 summed over the lamp.
    let cells = 100i32;
    let side = 2.0 * half / f64::from(cells);
    let middle = |i: i32| (f64::from(i) + 0.5) * side - half;
    let irradiance: f64 = (0..cells * cells)
        .map(|at| {
            let (x, z) = (away + middle(at % cells), middle(at / cells));
            let square = x * x + height * height + z * z;
            side * side * height * height / (square * square)
        })
        .sum();
    let expected = 0.5 / std::f64::consts::PI * irradiance;
    let came = rendered(&built, 8, 8, 64).and_then(|film| {
        let largest = f64::from(film.mean().data().iter().fold(0.0f32, |m, v| m.max(*v)));
        // 4096 samples, whose spread is half of what they are: one in a hundred. A pixel has 64 of them.
        let said = within(&film, expected, 0.05)?;
        held(largest < 1.5 * expected, format!("{said}; at most {} of the lamp's radiance", about(largest)))
    });
    add(
        "a lamp 0.1 mm above the floor, three metres away".into(),
        &format!(
            "its irradiance times albedo/pi, {} of its radiance, to 5%; no pixel above 1.5 times this value",
            about(expected)
        ),
        came,
    );
}

fn materials(add: Add<'_>) {
    // Glass that absorbs nothing under a sky of 1 everywhere is not seen.
    for ior in [1.0001f32, 1.5, 4.0] {
        let came = rendered(&furnace(glass(ior, 0.0), 200), 8, 8, 4096).and_then(|film| within(&film, 1.0, 2e-3));
        add(format!("a glass ball of index {ior} under a sky of 1"), "1 everywhere, to 0.2%", came);
    }
    for alpha in [0.0f32, 9.9e-4, 1e-3, 1.01e-3, 1e-2] {
        let bsdf = Bsdf::Conductor { eta: [0.0; 3], k: [1e4; 3], alpha, specular_reflectance: Texture::scalar(1.0) };
        let came = rendered(&furnace(bsdf, 8), 8, 8, 64).and_then(|film| within(&film, 1.0, 2e-3));
        add(format!("a perfect mirror ball of roughness {alpha}, around the threshold of 0.001"), "1, to 0.2%", came);
    }
    for alpha in [9.9e-4f32, 1e-3, 1.01e-3] {
        let came = rendered(&furnace(glass(1.5, alpha), 200), 8, 8, 4096).and_then(|film| within(&film, 1.0, 2e-3));
        add(format!("a glass ball of roughness {alpha}, around the threshold of 0.001"), "1, to 0.2%", came);
    }
    let mut nested = furnace(glass(1.5, 0.0), 400);
    let (inner, air) = (nested.material(glass(1.3, 0.0)), nested.material(glass(1.0 / 1.3, 0.0)));
    nested.sphere([0.0; 3], 0.7, inner);
    nested.sphere([0.0; 3], 0.4, air);
    let came = rendered(&nested, 8, 8, 4096).and_then(|film| within(&film, 1.0, 2e-3));
    add("three glass balls inside each other under a sky of 1".into(), "1, to 0.2%", came);
    let mut touching = furnace(glass(1.5, 0.0), 400);
    touching.sphere([2.0, 0.0, 0.0], 1.0, 0);
    touching.scene.camera.target = [1.0, 0.0, 0.0];
    touching.scene.camera.origin = [1.0, 0.0, 4.0];
    let came = rendered(&touching, 8, 8, 4096).and_then(|film| within(&film, 1.0, 2e-3));
    add("two touching glass balls, with the point of contact in view".into(), "1, to 0.2%", came);
    let mut twice = furnace(glass(1.5, 0.0), 400);
    twice.sphere([0.0; 3], 1.0, 0);
    let came = rendered(&twice, 8, 8, 4096).and_then(|film| within(&film, 1.0, 2e-3));
    add("two coincident glass balls".into(), "1, to 0.2%", came);
    for depth in [1u32, 2, 1000] {
        let shell = glowing(0.5, depth);
        let expected = 2.0 - 0.5f64.powi(depth.min(60) as i32 - 1);
        let came = rendered(&shell, 8, 8, 256).and_then(|film| within(&film, expected, 0.01));
        add(
            format!("a glowing closed cube of albedo 1/2, paths of at most {depth} segments"),
            "the sum of all reflections, to 1%",
            came,
        );
    }
    for depth in [100u32, 1000] {
        let shell = glowing(0.999, depth);
        let expected = (1.0 - 0.999f64.powi(depth as i32)) / (1.0 - 0.999);
        let came = world(&shell).and_then(|world| {
            // No path ends by chance: all go as far as they may.
            let whole = Roulette { from: depth, gain: 1.0 };
            let renderer = Renderer::new(&world, Resolution::new(8, 8).expect("small"), 0)
                .map_err(|e| e.to_string())?
                .with_integrator(whole);
            within(&film_of(&renderer, 64)?, expected, 0.01)
        });
        add(
            format!("the same cube with albedo 0.999, without Russian roulette, at most {depth} segments"),
            "the sum of all reflections, to 1%",
            came,
        );
    }
}

fn films(add: Add<'_>) {
    for value in [f32::NAN, f32::INFINITY, -1.0] {
        let mut built = floor_point();
        let mut sky = Image::from_data(8, 4, 3, vec![1.0; 96]).expect("fits");
        sky.pixel_mut(3, 1)[1] = value;
        let bytes = sky.to_bytes();
        let digest = Digest::of(&bytes);
        built.blobs.insert(digest, bytes);
        built.scene.emitters.push(Emitter::Envmap { image: digest, scale: 1.0, to_world: IDENTITY });
        let came = match world(&built) {
            Err(told) => held(
                told.contains("environment") || told.contains("finite") || told.contains("negative"),
                format!("refused: {told}"),
            ),
            Ok(_) => Err("accepted".into()),
        };
        add(
            format!("an environment map with a texel of {value}"),
            "refused with a specific error (`assets` repairs and counts these texels)",
            came,
        );
    }
    let mut built = floor_point();
    let mut sky = Image::from_data(8, 4, 3, vec![0.1; 96]).expect("fits");
    sky.pixel_mut(3, 1).fill(65504.0);
    let bytes = sky.to_bytes();
    let digest = Digest::of(&bytes);
    built.blobs.insert(digest, bytes);
    built.scene.emitters.push(Emitter::Envmap { image: digest, scale: 1e3, to_world: IDENTITY });
    // Between texels the map is linear: the texel is a tent 2/8 of a turn wide, and from the pole over 60 degrees to
    // 120, of which the floor sees what is above 90. E = scale (0.1 pi + (65504 - 0.1) 2 pi/8 (tent sin cos over the
    // polar angle)).
    let (cells, quarter) = (10_000i32, std::f64::consts::FRAC_PI_2);
    let tent: f64 = (0..cells)
        .map(|at| {
            let polar = (f64::from(at) + 0.5) / f64::from(cells) * quarter;
            (1.0 - (polar * 3.0 / std::f64::consts::PI - 1.0).abs()) * polar.sin() * polar.cos()
        })
        .sum::<f64>()
        * quarter
        / f64::from(cells);
    let expected = 0.5 * 1e3 * (0.1 + (65504.0 - 0.1) * 0.25 * tent);
    let came = rendered(&built, 8, 8, 4096).and_then(|film| within(&film, expected, 0.01));
    add(
        "an environment map at the largest half-precision number, scaled by a thousand, over a floor".into(),
        &format!("its irradiance times albedo/pi, {}, to 1%", about(expected)),
        came,
    );
    for (width, height) in [(1, 1), (1, 17), (31, 3), (33, 17)] {
        let came = rendered(&glowing(0.5, 1000), width, height, 4096 / (width * height) as u64 * 16).and_then(|film| {
            let fits = (film.width(), film.height()) == (width as usize, height as usize);
            within(&film, 2.0, 0.02).and_then(|said| held(fits, said))
        });
        add(format!("a film of {width} x {height} inside the glowing cube"), "2, to 2%", came);
    }
    // Each sample is the same number of 24 binary digits: 2^20 of them have 44, and their mean is exact.
    let mut lamp = Built::new([0.0, 0.0, 4.0], [0.0; 3], 20.0, 1);
    let black = lamp.diffuse([0.0; 3]);
    let square = columns([2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
    lamp.shape(Geometry::Rectangle, square, black).emission = Some(Texture::scalar(0.1));
    let came = rendered(&lamp, 1, 1, 1 << 20).and_then(|film| {
        let off = (mean(&film) - f64::from(0.1f32)).abs();
        held(off == 0.0, format!("off by {}", about(off)))
    });
    add("2^20 paths of one pixel to a lamp of radiance 0.1".into(), "0.1 in single precision, exactly", came);
    // Samples of 1 and of 1 + 2^-20 by turns: the mean is known to the bit.
    let mut pixel = Pixel::default();
    let (low, high) = (1.0f32, 1.0 + 2f32.powi(-20));
    let count = 1u64 << 20;
    (0..count).for_each(|n| pixel.add(n, [if n % 2 == 0 { low } else { high }; 3]));
    let mean = pixel.sum[0] / count as f64;
    let off = (mean - (1.0 + 2f64.powi(-21))).abs();
    add(
        "2^20 samples of one pixel, alternating between 1 and 1 + 2^-20".into(),
        "their exact mean",
        held(off == 0.0, format!("off by {}", about(off))),
    );
    let mut pixel = Pixel::default();
    (0..count).for_each(|n| pixel.add(n, [if n == 0 { 1e8 } else { 1e-3 }; 3]));
    let exact = 1e8 + (count - 1) as f64 * f64::from(1e-3f32);
    let off = (pixel.sum[0] / exact - 1.0).abs();
    add(
        "a firefly of 1e8, then 2^20 samples of 1e-3".into(),
        "their sum to 1e-10",
        held(off < 1e-10, format!("off by {}", about(off))),
    );
}
