//! Light transport against closed forms, and its strategies against each other.

mod scenes;

use scenes::{Built, ball, columns, everything, film, floor_point, level, room};
use std::{collections::BTreeMap, f64::consts::PI};
use tauflow_data::{
    Image,
    scene::{Bsdf, Emitter, Geometry, IDENTITY, Texture},
};
use tauflow_render::{
    accumulator::Accumulator, choices::Choices, integrator::Strategy, render::Renderer, world::World,
};

/// How light is found, and how lobes and lights are chosen.
type Way = (Strategy, Choices);

fn render(built: &Built, side: u32, spp: u64, (strategy, choices): Way) -> Accumulator {
    let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
    let world = world.with_choices(choices);
    let renderer = Renderer::new(&world, film(side, side), 0).expect("a sound film").with_integrator(strategy);
    let mut film = renderer.begin();
    renderer.advance(&mut film, spp, &mut |_| Ok(())).expect("nothing stops it");
    assert_eq!(film.rejected, 0);
    film
}

/// Mean of a channel over the film, and its standard error.
fn estimate(film: &Accumulator, channel: usize) -> (f64, f64) {
    let (pixels, n) = (film.pixels.len() as f64, film.count as f64);
    let mean = film.pixels.iter().map(|p| p.sum[channel]).sum::<f64>() / (pixels * n);
    let variance = film.pixels.iter().map(|p| p.m2[channel]).sum::<f64>() / (n - 1.0) / pixels;
    (mean, (variance / (pixels * n)).sqrt())
}

/// Asserts that the mean is `expected` within five standard errors and a relative rounding of 2e-5.
fn assert_mean(name: &str, film: &Accumulator, expected: f64) {
    let (mean, error) = estimate(film, 0);
    println!("{name}: {mean:.6} +- {error:.6}, expected {expected:.6}");
    assert!((mean - expected).abs() < 5.0 * error + 2e-5 * expected, "{name}: {mean} +- {error}, expected {expected}");
    assert!(error < 0.05 * expected, "{name}: too few samples to say anything, {error} of {expected}");
}

const MIS: Way = (Strategy::Mis, Choices::Adapted);
const ALL: [Way; 6] = [
    MIS,
    (Strategy::LightsOnly, Choices::Adapted),
    (Strategy::ScatteringOnly, Choices::Adapted),
    (Strategy::Mis, Choices::Fixed),
    (Strategy::LightsOnly, Choices::Fixed),
    (Strategy::ScatteringOnly, Choices::Fixed),
];

#[test]
fn white_furnace() {
    // A convex body of albedo 1 under light of 1 from everywhere cannot be seen; nor one of facets, or a floor.
    for depth in [2, 12] {
        let mut built = Built::new([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], 40.0, depth);
        let white = built.diffuse([1.0; 3]);
        built.sphere([-0.6, 0.0, 0.0], 0.5, white);
        built.sky([1.0; 3]);
        for strategy in ALL {
            assert_mean("furnace", &render(&built, 16, 256, strategy), 1.0);
        }
        built.scene.shapes.clear();
        let mut facets = ball(12);
        facets.normals = None;
        built.mesh(&facets, IDENTITY, white);
        assert_mean("faceted furnace", &render(&built, 16, 256, MIS), 1.0);
    }
    // In a concave one each order of reflection fills in what the last left out.
    let mut built = Built::new([0.0, 0.0, 4.0], [0.0, 0.0, 0.0], 40.0, 400);
    let white = built.diffuse([1.0; 3]);
    built.sphere([-0.6, 0.0, 0.0], 0.7, white);
    built.sphere([0.6, 0.2, 0.0], 0.7, white);
    built.sky([1.0; 3]);
    assert_mean("concave furnace", &render(&built, 16, 256, MIS), 1.0);
}

#[test]
fn a_glowing_shell_sums_its_reflections() {
    for (depth, albedo) in [(1, 0.7), (2, 0.7), (3, 0.7), (9, 0.7), (60, 0.5)] {
        let mut built = Built::new([0.1, 0.2, 0.3], [0.0, 0.0, -1.0], 60.0, depth);
        let wall = built.diffuse([albedo as f32; 3]);
        let shell = built.sphere([0.0; 3], 2.0, wall);
        shell.emission = Some(Texture::scalar(0.5));
        shell.flip_normals = true;
        let expected = 0.5 * (1.0 - f64::powi(albedo, depth as i32)) / (1.0 - albedo);
        for strategy in ALL {
            assert_mean(&format!("shell {depth}"), &render(&built, 16, 256, strategy), expected);
        }
        built.scene.shapes.clear();
        let shell = built.shape(Geometry::Cube, IDENTITY, wall);
        shell.emission = Some(Texture::scalar(0.5));
        shell.flip_normals = true;
        assert_mean(&format!("cube {depth}"), &render(&built, 16, 256, MIS), expected);
    }
}

#[test]
fn direct_light_has_its_closed_form() {
    // Radiance = albedo / pi * irradiance, for an albedo of 0.5.
    let expect = |irradiance: f64| 0.5 / PI * irradiance;
    // A disk of radius r at height h: pi L r^2 / (r^2 + h^2).
    let mut disk = floor_point();
    disk.shape(Geometry::Disk, level(0.8, [0.0, 1.5, 0.0], false), 0).emission = Some(Texture::scalar(3.0));
    // A rectangle 2a by 2b: by the form factor of a patch below its centre (four corner rectangles).
    let mut rectangle = floor_point();
    let place = columns([0.7, 0.0, 0.0], [0.0, 0.0, 1.1], [0.0, -1.0, 0.0], [0.0, 1.2, 0.0]);
    rectangle.shape(Geometry::Rectangle, place, 0).emission = Some(Texture::scalar(3.0));
    let (a, b) = (0.7f64 / 1.2, 1.1f64 / 1.2);
    let (ra, rb) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
    let factor = (a / ra * (b / ra).atan() + b / rb * (a / rb).atan()) / (2.0 * PI);
    // A sphere of radius r at height h: pi L (r / h)^2.
    let mut sphere = floor_point();
    sphere.sphere([0.0, 2.0, 0.0], 0.6, 0).emission = Some(Texture::scalar(3.0));
    let mut faceted = floor_point();
    faceted.mesh(&ball(48), columns([0.6, 0.0, 0.0], [0.0, 0.6, 0.0], [0.0, 0.0, 0.6], [0.0, 2.0, 0.0]), 0).emission =
        Some(Texture::scalar(3.0));
    for strategy in ALL {
        assert_mean("disk", &render(&disk, 8, 4096, strategy), expect(PI * 3.0 * 0.64 / (0.64 + 2.25)));
        assert_mean("rectangle", &render(&rectangle, 8, 4096, strategy), expect(PI * 3.0 * 4.0 * factor));
        assert_mean("sphere", &render(&sphere, 8, 4096, strategy), expect(PI * 3.0 * 0.09));
    }
    // The inscribed ball is smaller by up to (pi / 96)^2 / 2 in radius.
    let (mean, error) = estimate(&render(&faceted, 8, 4096, MIS), 0);
    let ratio = mean / expect(PI * 3.0 * 0.09);
    assert!((0.997 - 5.0 * error..1.0 + 5.0 * error).contains(&ratio), "faceted sphere: {ratio}");
}

#[test]
fn a_choice_between_sky_and_lamps_adds_up() {
    // Seen from below, a disk of radius r at height h takes r^2 / (r^2 + h^2) of the sky's light and gives its own.
    let mut built = floor_point();
    built.sky([1.0; 3]);
    let (mut share, mut lamps) = (1.0, 0.0);
    for (radius, radiance, aside) in [(0.3, 40.0, 0.0), (0.2, 5.0, 1.5)] {
        let height = 1.2f64;
        let lamp = built.shape(Geometry::Disk, level(radius, [aside, height, 0.0], false), 0);
        lamp.emission = Some(Texture::scalar(radiance as f32));
        // From aside: the form factor of a parallel disk.
        let (h, r) = (height * height, radius * radius);
        let z = h + aside * aside + r;
        let factor = 0.5 * (1.0 - (h + aside * aside - r) / (z * z - 4.0 * r * aside * aside).sqrt());
        share -= factor;
        lamps += radiance * factor;
    }
    for strategy in ALL {
        assert_mean("sky and lamps", &render(&built, 16, 8192, strategy), 0.5 * (share + lamps));
    }
}

#[test]
fn adapted_choices_find_the_same_light_with_less_variance() {
    // Two lamps, of which a wall hides one from what is seen, and a sky that it hides in part.
    let mut built = Built::new([3.0, 4.0, 0.1], [3.0, 0.0, 0.0], 40.0, 6);
    let grey = built.diffuse([0.5; 3]);
    built.shape(Geometry::Rectangle, level(8.0, [0.0; 3], true), grey);
    let wall = columns([0.0, 0.0, 8.0], [0.0, 6.0, 0.0], [1.0, 0.0, 0.0], [1.0, 6.0, 0.0]);
    built.shape(Geometry::Rectangle, wall, grey);
    for (x, radiance) in [(0.5, 60.0), (5.5, 2.0)] {
        let place = level(0.3, [x, 2.0, 0.0], false);
        built.shape(Geometry::Rectangle, place, grey).emission = Some(Texture::scalar(radiance));
    }
    for sky in [false, true] {
        if sky {
            built.sky([0.05; 3]);
        }
        let of = |choices| render(&built, 24, 1024, (Strategy::Mis, choices));
        let ((a, fixed), (b, adapted)) = (estimate(&of(Choices::Fixed), 0), estimate(&of(Choices::Adapted), 0));
        println!("sky {sky}: {a:.5} +- {fixed:.5}, {b:.5} +- {adapted:.5}");
        assert!((a - b).abs() < 4.5 * (fixed * fixed + adapted * adapted).sqrt(), "sky {sky}: {a} {b}");
        assert!(adapted * adapted * 1.5 < fixed * fixed, "sky {sky}: {fixed} {adapted}");
        // Where weights of scattering and of lights do not add up to 1, these differ.
        for strategy in [Strategy::LightsOnly, Strategy::ScatteringOnly] {
            let (c, error) = estimate(&render(&built, 24, 4096, (strategy, Choices::Adapted)), 0);
            assert!((b - c).abs() < 4.5 * (error * error + adapted * adapted).sqrt(), "sky {sky}: {b} {c} +- {error}");
        }
    }
}

#[test]
fn lights_without_extent_have_their_closed_form() {
    let emitters = [
        (Emitter::Point { position: [0.0, 2.0, 0.0], intensity: [4.0; 3] }, 4.0 / 4.0),
        (Emitter::Directional { direction: [3.0, -4.0, 0.0], irradiance: [2.0; 3] }, 2.0 * 0.8),
        (
            Emitter::Spot {
                to_world: columns([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.0, 2.0, 0.0]),
                intensity: [4.0; 3],
                cutoff_angle: 30.0,
                beam_width: 20.0,
            },
            4.0 / 4.0,
        ),
        (
            // Seen at 25 degrees off its axis: half of the fall.
            Emitter::Spot {
                to_world: columns(
                    [1.0, 0.0, 0.0],
                    [0.0, 0.0, 1.0],
                    [0.0, -(25f64.to_radians().cos()), 25f64.to_radians().sin()],
                    [0.0, 2.0, 0.0],
                ),
                intensity: [4.0; 3],
                cutoff_angle: 30.0,
                beam_width: 20.0,
            },
            0.5 * 4.0 / 4.0,
        ),
    ];
    for (emitter, irradiance) in emitters {
        let mut built = floor_point();
        built.scene.emitters.push(emitter.clone());
        assert_mean(&format!("{emitter:?}"), &render(&built, 4, 16, MIS), 0.5 / PI * irradiance);
        // Halved by a second light of another sort, whose choice is random.
        built.sky([0.3; 3]);
        assert_mean("with a sky", &render(&built, 8, 2048, MIS), 0.5 / PI * irradiance + 0.5 * 0.3);
        // And black in the shadow of a disk.
        built.scene.emitters.truncate(1);
        built.shape(Geometry::Disk, level(0.9, [0.2, 0.5, 0.0], true), 0);
        built.scene.camera.origin = [0.0, 0.1, 2.0];
        let film = render(&built, 4, 16, MIS);
        assert_eq!(estimate(&film, 0).0, 0.0, "{emitter:?}");
    }
}

#[test]
fn strategies_agree_on_a_room() {
    let films = ALL.map(|strategy| render(&room(), 24, 256, strategy));
    let mut sums = Vec::new();
    for film in &films {
        for channel in 0..3 {
            sums.push(estimate(film, channel));
        }
    }
    println!("{sums:?}");
    for channel in 0..3 {
        for other in [1, 2] {
            let (a, b) = (sums[channel], sums[3 * other + channel]);
            let z = (a.0 - b.0) / (a.1 * a.1 + b.1 * b.1).sqrt();
            assert!(z.abs() < 4.5, "channel {channel}, {:?}: z = {z}", ALL[other]);
        }
    }
    assert!(sums[0].1 < sums[3].1.max(sums[6].1), "the weighted estimate is no worse than the worse of the two");
}

#[test]
fn opacity_lets_its_share_through() {
    // The sky of 1 through two sheets of opacity 0.3, of black.
    let mut built = Built::new([0.0, 0.0, 4.0], [0.0; 3], 20.0, 3);
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
    let sheet = built.material(Bsdf::Mask { opacity: Texture::scalar(0.3), inner });
    for z in [-1.0, 1.0] {
        built.shape(
            Geometry::Rectangle,
            columns([4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, z]),
            sheet,
        );
    }
    built.sky([1.0; 3]);
    assert_mean("two sheets", &render(&built, 16, 256, MIS), 0.49);
    // The shadow of such a sheet, from lights that only shadow rays find and from lights that both find.
    for emitter in [
        Emitter::Directional { direction: [0.0, -1.0, 0.0], irradiance: [1.0; 3] },
        Emitter::Point { position: [0.0, 1.0, 0.0], intensity: [1.0; 3] },
    ] {
        let mut built = floor_point();
        let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
        let sheet = built.material(Bsdf::Mask { opacity: Texture::scalar(0.3), inner });
        built.shape(Geometry::Rectangle, level(0.2, [0.0, 0.3, 0.0], true), sheet);
        built.shape(Geometry::Rectangle, level(0.2, [0.0, 0.4, 0.0], true), sheet);
        built.scene.emitters.push(emitter);
        assert_mean("shadow", &render(&built, 4, 64, MIS), 0.5 / PI * 0.49);
    }
    let mut built = floor_point();
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
    let sheet = built.material(Bsdf::Mask { opacity: Texture::scalar(0.3), inner });
    built.shape(Geometry::Disk, level(0.8, [0.0, 1.5, 0.0], false), 0).emission = Some(Texture::scalar(3.0));
    built.shape(Geometry::Rectangle, level(3.0, [0.0, 1.0, 0.0], true), sheet);
    built.scene.camera.origin = [0.0, 0.5, 4.0];
    for strategy in ALL {
        let expected = 0.7 * 0.5 * 3.0 * 0.64 / (0.64 + 2.25);
        assert_mean("disk through a sheet", &render(&built, 8, 4096, strategy), expected);
    }
}

#[test]
fn emission_by_vertex_colours_is_that_of_the_colour() {
    let lit = |emission: Texture| {
        let mut built = floor_point();
        let mut lamp = ball(6);
        lamp.colors = Some(vec![[0.5, 0.5, 0.5, 1.0]; lamp.positions.len()]);
        let black = built.diffuse([0.0; 3]);
        let place = columns([0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3], [0.0, 1.0, 0.0]);
        built.mesh(&lamp, place, black).emission = Some(emission);
        // Seen, too.
        built.scene.camera.fov_x = 60.0;
        render(&built, 16, 64, MIS)
    };
    let colored = lit(Texture::VertexColor { scale: [3.0; 3], channel: None });
    let plain = lit(Texture::scalar(1.5));
    assert!(estimate(&plain, 0).0 > 0.01);
    // But for the rounding of sums of thirds.
    for (a, b) in colored.pixels.iter().zip(&plain.pixels) {
        assert!((a.sum[0] - b.sum[0]).abs() <= 1e-5 * b.sum[0], "{a:?} {b:?}");
    }
}

#[test]
fn a_lamp_with_holes_is_found_alike_by_light_and_by_scattering() {
    let mut built = floor_point();
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
    let opacity = Texture::Checkerboard { color0: [1.0; 3], color1: [0.2; 3], scale: [6.0, 5.0] };
    let holes = built.material(Bsdf::Mask { opacity, inner });
    built.sphere([0.2, 0.9, 0.1], 0.4, holes).emission = Some(Texture::scalar(2.0));
    let [both, others @ ..] = ALL.map(|way| estimate(&render(&built, 8, 4096, way), 0));
    for other in others {
        let deviation = (both.0 - other.0) / (both.1 * both.1 + other.1 * other.1).sqrt();
        assert!(deviation.abs() < 4.5 && both.1 < 0.01 * both.0, "{both:?} {other:?}");
    }
}

#[test]
fn an_image_of_several_textures_is_loaded_once() {
    let built = everything();
    let mut loads = BTreeMap::new();
    World::new(&built.scene, &mut |digest| {
        *loads.entry(*digest).or_insert(0) += 1;
        built.load(digest)
    })
    .expect("a sound scene");
    let bitmaps: Vec<u32> = loads
        .iter()
        .filter(|(digest, _)| Image::from_bytes(&built.blobs[digest]).is_ok())
        .map(|(_, loads)| *loads)
        .collect();
    assert_eq!(bitmaps, [1; 3], "a sky, colours of several materials, and a normal map");
}

#[test]
fn scenes_that_cannot_be_rendered_are_refused_and_poor_ones_repaired() {
    let refuse = |change: fn(&mut Built)| {
        let mut built = room();
        change(&mut built);
        World::new(&built.scene, &mut |digest| built.load(digest)).err().map(|e| e.to_string()).unwrap_or_default()
    };
    assert!(refuse(|b| b.scene.shapes[2].material = 99).contains("shape 2: material 99 does not exist"));
    assert!(refuse(|b| b.scene.version = 2).contains("format version 2"));
    assert!(refuse(|b| b.blobs.clear()).contains("missing"));
    assert!(refuse(|b| (0..2).for_each(|_| b.sky([1.0; 3]))).contains("two environments"));
    assert!(refuse(|b| b.sphere([0.0; 3], f64::NAN, 0).flip_normals = true).contains("shape 8: a sphere"));
    assert!(
        refuse(|b| b.scene.shapes[7].emission = Some(Texture::scalar(-1.0))).contains("shape 7: negative emission")
    );
    let below = |b: &mut Built| {
        let squares = Texture::Checkerboard { color0: [1.0; 3], color1: [-1.0; 3], scale: [2.0, 2.0] };
        b.scene.shapes[7].emission = Some(squares);
    };
    assert!(refuse(below).contains("shape 7: negative emission"));
    let point = |b: &mut Built| {
        b.scene.emitters.push(Emitter::Point { position: [f64::INFINITY, 0.0, 0.0], intensity: [1.0; 3] });
    };
    assert!(refuse(point).contains("point light"));
    // Bad triangles are dropped and counted; the rest is rendered.
    let mut built = floor_point();
    built.sky([1.0; 3]);
    let mut mesh = ball(8);
    mesh.positions[40] = [f32::NAN, 0.0, 0.0];
    built.mesh(&mesh, IDENTITY, 0);
    let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("still a scene");
    assert_eq!(world.dropped.not_finite, 6);
    assert!(world.dropped.degenerate >= 16, "a pole of {:?}", world.dropped);
    render(&built, 8, 4, MIS);
    // Nothing at all is black, and an emitter of 0 is no light.
    let mut empty = Built::new([0.0; 3], [1.0, 0.0, 0.0], 40.0, 4);
    assert_eq!(estimate(&render(&empty, 4, 2, MIS), 0).0, 0.0);
    let black = empty.diffuse([0.0; 3]);
    empty.sphere([3.0, 0.0, 0.0], 1.0, black).emission = Some(Texture::scalar(0.0));
    assert_eq!(estimate(&render(&empty, 4, 2, MIS), 0).0, 0.0);
}
