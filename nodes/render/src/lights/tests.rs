//! Lights are sampled as their densities say. With `TAUFLOW_SLOW=1` more draws, and a finer quadrature.

use super::*;
use crate::{
    chi_square,
    choices::Choices,
    geometry::Ray,
    integrator::Strategy,
    render::Renderer,
    scenes::{Built, ball, columns, film, level},
    surface::Form,
};
use tauflow_data::{
    rng::Stream,
    scene::{Geometry, Texture},
};

const ROWS: usize = 24;
const COLUMNS: usize = 48;

/// Bin of a direction by cosine and azimuth about an axis.
fn bin(frame: &[Vec3; 3], d: Vec3) -> usize {
    let [x, y, z] = frame.map(|axis| axis.dot(d));
    let row = ((z * 0.5 + 0.5) * ROWS as f32) as usize;
    let turn = libm::atan2f(y, x) / std::f32::consts::TAU;
    let column = ((turn - turn.floor()) * COLUMNS as f32) as usize;
    row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)
}

/// Draws of a scene's lights from a point, and what the densities of what rays meet make of them, by bin.
///
/// Bins are about the direction to `toward`, within an angle of cosine `near`: all else is one bin.
fn compare(name: &str, built: &Built, p: Vec3, toward: Vec3, near: f64) {
    compare_in(name, &world(built, Choices::Fixed), p, toward, near);
}

fn world(built: &Built, choices: Choices) -> World {
    World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene").with_choices(choices)
}

/// [`compare`] in a world.
fn compare_in(name: &str, world: &World, p: Vec3, toward: Vec3, near: f64) {
    let z = (toward - p).normalize();
    let x = z.any_orthonormal_vector();
    let frame = [x, z.cross(x), z];
    // The cosine is stretched so that [near, 1] fills the rows.
    let stretch = |cos: f64| ((cos - near) / (1.0 - near)).clamp(0.0, 1.0) * 2.0 - 1.0;
    let shrink = |row: f64| near + (1.0 - near) * (row * 0.5 + 0.5);
    let place = |d: Vec3| {
        let cos = f64::from(z.dot(d));
        if cos < near {
            return ROWS * COLUMNS;
        }
        let flat = d - z * z.dot(d);
        let row = stretch(cos) as f32;
        let flat = flat.normalize_or_zero() * (1.0 - row * row).max(0.0).sqrt();
        bin(&frame, flat + z * row)
    };
    let from = (p.into(), world.lights.cell::<f32>(p.into()));
    let (error, normal) = (Vec3::ZERO.into(), Vec3::new(0.0, 1.0, 0.0).into());
    let vantage = Vantage::<f32> { p: from.0, error, normal, cell: from.1 };
    let slow = tauflow_testing::slow();
    // Draws, and directions of the quadrature along a side of a bin.
    let (count, fine) = if slow { (500_000, 160) } else { (200_000, 80) };
    let mut stream = Stream::new(5, &[]).part(name);
    let mut found = vec![0.0; ROWS * COLUMNS + 1];
    for _ in 0..count {
        let mut two = || Pair::new(stream.uniform() as f32, stream.uniform() as f32);
        let numbers = [two(), two(), two(), two()];
        let arrived = world.lights.sample(world, &vantage, None, true, numbers);
        // Points that are turned away have a density, but bring nothing.
        if arrived.pdf > 0.0 {
            found[place(arrived.direction.into())] += 1.0;
        }
    }
    let mut expected = vec![0.0; ROWS * COLUMNS + 1];
    let (rows, columns) = (ROWS * fine, COLUMNS * fine);
    let cell = 2.0 * std::f64::consts::PI * (1.0 - near) / (rows * columns) as f64;
    let mut total = 0.0;
    for row in 0..rows {
        let cos = shrink(2.0 * (row as f64 + 0.5) / rows as f64 - 1.0);
        let sin = (1.0 - cos * cos).sqrt();
        for column in 0..columns {
            let phi = std::f64::consts::TAU * (column as f64 + 0.5) / columns as f64;
            let [x, y, z] = frame.map(Vec3::as_dvec3);
            let d = (x * (sin * libm::cos(phi)) + y * (sin * libm::sin(phi)) + z * cos).as_vec3();
            let mut pdf = f64::from(world.lights.environment_look::<f32>(from, d.into()).1);
            // Lights do not hide each other here, but a shape has a back.
            let mut ray = Ray::new(p, d);
            for _ in 0..4 {
                let Some((_, at)) = world.meet(&ray) else { break };
                let light = world.shapes[at.shape as usize].light;
                if light != crate::table::DARK {
                    pdf += f64::from(world.lights.shape_pdf::<f32>(light, from, at.p.into(), at.geometric.into()));
                    if matches!(world.shapes[at.shape as usize].form, Form::Sphere(_)) {
                        // Of a sphere the cone is sampled, not its two sides.
                        break;
                    }
                }
                ray.origin = crate::geometry::offset_origin(at.p, at.error, at.geometric, d);
            }
            total += pdf * cell;
            expected[(row / fine) * COLUMNS + column / fine] += pdf * cell * f64::from(count);
        }
    }
    // Points outside of the angle.
    expected[ROWS * COLUMNS] = (1.0 - total).max(0.0) * f64::from(count);
    let inside: f64 = found[..ROWS * COLUMNS].iter().sum::<f64>() / f64::from(count);
    assert!((inside - total).abs() < 0.01, "{name}: {inside} drawn, {total} by density");
    let deviation = chi_square::deviation(&found, &expected, 0.012);
    println!("{name}: {deviation:+.2} deviations, {total:.3} within");
    assert!(deviation < chi_square::ALLOWED, "{name}: {deviation}");
}

fn scene() -> Built {
    let mut built = Built::new([0.0, 0.5, 2.0], [0.0; 3], 40.0, 4);
    built.diffuse([0.5; 3]);
    built
}

fn lamp(built: &mut Built, geometry: Geometry, place: tauflow_data::scene::Affine, radiance: f32) {
    built.shape(geometry, place, 0).emission = Some(Texture::scalar(radiance));
}

#[test]
fn shapes_are_sampled_by_their_density() {
    let mut built = scene();
    lamp(&mut built, Geometry::Rectangle, level(0.5, [0.0, 1.0, 0.0], false), 3.0);
    compare("rectangle", &built, Vec3::ZERO, Vec3::Y, 0.6);
    compare("rectangle from aside", &built, Vec3::new(2.0, 0.3, 0.5), Vec3::Y, 0.9);
    let mut built = scene();
    let place = columns([0.7, 0.0, 0.1], [0.0, 0.0, 0.3], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]);
    lamp(&mut built, Geometry::Disk, place, 3.0);
    compare("ellipse", &built, Vec3::new(0.3, 0.1, 0.0), Vec3::Y, 0.5);
    let mut built = scene();
    built.sphere([0.0, 2.0, 0.0], 0.6, 0).emission = Some(Texture::scalar(3.0));
    compare("sphere", &built, Vec3::ZERO, Vec3::new(0.0, 2.0, 0.0), 0.9);
    compare("sphere, close", &built, Vec3::new(0.0, 1.39, 0.0), Vec3::new(0.0, 2.0, 0.0), -1.0);
    let mut built = scene();
    built.mesh(&ball(6), columns([0.6, 0.0, 0.0], [0.0, 0.6, 0.0], [0.0, 0.0, 0.6], [0.0, 2.0, 0.0]), 0).emission =
        Some(Texture::scalar(3.0));
    compare("mesh", &built, Vec3::ZERO, Vec3::new(0.0, 2.0, 0.0), 0.9);
}

#[test]
fn several_lights_are_chosen_by_their_density() {
    let mut built = scene();
    for (x, radiance) in [(-1.5, 1.0), (0.0, 4.0), (1.5, 20.0)] {
        lamp(&mut built, Geometry::Rectangle, level(0.3, [x, 1.0, 0.0], false), radiance);
    }
    compare("three lamps", &built, Vec3::new(0.2, 0.0, 0.1), Vec3::new(0.2, 1.0, 0.0), 0.3);
    built.sky([0.4; 3]);
    compare("three lamps and a sky", &built, Vec3::new(0.2, 0.0, 0.1), Vec3::new(0.2, 1.0, 0.0), -1.0);
    let mut built = scene();
    for i in 0..12 {
        let angle = f64::from(i) * 0.5;
        let at = [2.0 * libm::cos(angle), 1.0, 2.0 * libm::sin(angle)];
        lamp(&mut built, Geometry::Rectangle, level(0.2, at, false), 1.0 + i as f32);
    }
    compare("a dozen", &built, Vec3::ZERO, Vec3::Y, 0.2);
}

/// A floor, a wall across it at x = 0 without a back, and two equal lamps, one on each side.
fn two_rooms() -> Built {
    let mut built = Built::new([0.0, 6.0, 0.1], [0.0; 3], 60.0, 4);
    let grey = built.diffuse([0.5; 3]);
    built.shape(Geometry::Rectangle, level(4.0, [0.0; 3], true), grey);
    let wall = columns([0.0, 0.0, 4.0], [0.0, 2.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
    built.shape(Geometry::Rectangle, wall, grey);
    for x in [-1.0, 1.0] {
        lamp(&mut built, Geometry::Rectangle, level(0.3, [x, 1.5, 0.0], false), 5.0);
    }
    built
}

fn picked(world: &World, p: Vec3) -> Vec<f32> {
    let cell = world.lights.cell::<f32>(p.into());
    (0..world.lights.lights.len()).map(|light| world.lights.picked::<f32>(light, p.into(), cell)).collect()
}

#[test]
fn lamps_behind_a_wall_are_seldom_chosen() {
    let built = two_rooms();
    let (fixed, adapted) = (world(&built, Choices::Fixed), world(&built, Choices::Adapted));
    assert_eq!(adapted.lights.lights.len(), 2);
    for side in [-1.0f32, 1.0] {
        for p in [Vec3::new(side * 0.8, 0.0, 0.5), Vec3::new(side * 1.2, 0.0, -0.7)] {
            let own = usize::from(side > 0.0);
            let (before, now) = (picked(&fixed, p), picked(&adapted, p));
            println!("{p}: {before:?} {now:?}");
            // A twentieth is given to it in any case.
            assert!(now[1 - own] - 0.05 < 0.5 * (before[1 - own] - 0.05), "{p}: {before:?} {now:?}");
            assert!((now.iter().sum::<f32>() - 1.0).abs() < 1e-5 && now[1 - own] > 0.0499, "{now:?}");
        }
    }
    let p = Vec3::new(0.8, 0.0, 0.5);
    compare_in("a lamp on each side", &adapted, p, Vec3::new(0.0, 1.5, 0.0), -0.2);
}

#[test]
fn many_lights_are_chosen_by_where_they_are() {
    let mut built = two_rooms();
    for i in 0..20 {
        let x = if i % 2 == 0 { -1.0 } else { 1.0 } * (0.5 + 0.1 * f64::from(i));
        lamp(&mut built, Geometry::Rectangle, level(0.1, [x, 1.5, 0.2 * f64::from(i) - 2.0], false), 5.0);
    }
    let world = world(&built, Choices::Adapted);
    let count = world.lights.lights.len();
    assert_eq!(count, 22);
    for p in [Vec3::new(1.0, 0.0, 0.3), Vec3::new(-2.0, 0.0, 1.0), Vec3::new(90.0, -70.0, f32::NAN)] {
        let shares = picked(&world, p);
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{shares:?}");
        assert!(shares.iter().all(|share| *share > 0.1 / count as f32), "{shares:?}");
        // Evenly spread numbers draw each light as often as its share says.
        let learnt = world.lights.learnt.as_ref().expect("there is a choice");
        let cell = learnt.cell::<f32>(p.into()) as i32;
        let mut drawn = vec![0u32; count];
        for at in 0..100_000 {
            drawn[learnt.draw::<f32>(cell, (at as f32 + 0.5) / 100_000.0) as usize] += 1;
        }
        for (share, drawn) in shares.iter().zip(&drawn) {
            assert!((share * 1e5 - *drawn as f32).abs() < 2.0, "{shares:?} {drawn:?}");
        }
        assert_eq!(learnt.draw::<f32>(cell, 1.0 - f32::EPSILON / 2.0) as usize, count - 1);
    }
    let p = Vec3::new(1.0, 0.0, 0.3);
    let here: f32 = picked(&world, p).iter().skip(1).step_by(2).sum();
    assert!(here > 0.8, "lamps of this side: {here}");
    compare_in("many lamps", &world, p, Vec3::new(0.0, 1.5, 0.0), -0.2);
}

/// The part that is expected decides between candidates. If it were that of another light, no image would be wrong.
#[test]
fn the_part_that_is_expected_is_that_of_the_light_drawn() {
    let few = two_rooms();
    let mut several = two_rooms();
    for at in 0..5 {
        lamp(&mut several, Geometry::Rectangle, level(0.1, [1.0, 1.0, 0.3 * f64::from(at)], false), 5.0);
    }
    several.sky([0.4; 3]);
    let mut many = two_rooms();
    for at in 0..20 {
        lamp(&mut many, Geometry::Rectangle, level(0.1, [1.0, 1.0, 0.1 * f64::from(at)], false), 5.0);
    }
    for (built, count) in [(few, 2), (several, 8), (many, 22)] {
        let world = world(&built, Choices::Adapted);
        let learnt = world.lights.learnt.as_ref().expect("there is a choice");
        assert_eq!(world.lights.lights.len(), count);
        if count <= GUIDED {
            for cell in 0..512 {
                let parts = learnt.all::<f32>(cell as f32);
                for (light, part) in parts.into_iter().enumerate().take(count) {
                    assert_eq!(part.to_bits(), learnt.arrives::<f32>(cell, light as i32).to_bits());
                }
            }
        }
        let p = Vec3::new(1.2, 0.0, 0.3);
        let (cell, shares) = (world.lights.cell::<f32>(p.into()), picked(&world, p));
        let vantage = Vantage { p: p.into(), error: Vec3::ZERO.into(), normal: Vec3::Y.into(), cell };
        let mut seen = std::collections::BTreeSet::new();
        for at in 0..200 {
            let pick = (at as f32 + 0.5) / 200.0;
            let drawn = if count > GUIDED {
                learnt.draw::<f32>(cell as i32, pick)
            } else {
                let before = |light: &usize| pick >= shares[..*light].iter().fold(0.0, |sum, share| sum + share);
                (0..count).rev().find(before).expect("the first begins at 0") as i32
            };
            let numbers = [Pair::new(pick, 0.3), Pair::new(0.6, 0.2), Pair::new(0.1, 0.7), Pair::new(0.4, 0.5)];
            let arrived = world.lights.sample::<f32>(&world, &vantage, None, true, numbers);
            let part = learnt.arrives::<f32>(cell as i32, drawn);
            assert_eq!(arrived.expected.to_bits(), part.to_bits(), "{count}: {drawn}");
            seen.insert(part.to_bits());
        }
        assert!(seen.len() > 1, "{count}: all parts are the same");
    }
}

#[test]
fn nothing_is_learnt_where_there_is_nothing_to_learn() {
    // One light; none; more than are looked at; a camera that sees nothing.
    let mut one = two_rooms();
    one.scene.shapes.pop();
    let mut none = two_rooms();
    none.scene.shapes.truncate(2);
    let mut blind = two_rooms();
    blind.scene.camera.target = [0.0, 99.0, 0.0];
    for built in [one, none, blind] {
        assert!(world(&built, Choices::Adapted).lights.learnt.is_none());
    }
    let mut many = two_rooms();
    for at in 0..300 {
        lamp(&mut many, Geometry::Rectangle, level(0.01, [1.0, 1.0, 0.01 * f64::from(at)], false), 1.0);
    }
    assert!(world(&many, Choices::Adapted).lights.learnt.is_none());
    assert!(world(&two_rooms(), Choices::Fixed).lights.learnt.is_none());
    // A floor seen from above is flat: it has one layer of cells.
    let mut flat = two_rooms();
    flat.scene.shapes.remove(1);
    flat.sky([0.2; 3]);
    let world = world(&flat, Choices::Adapted);
    let shares = picked(&world, Vec3::new(0.3, 0.0, 0.1));
    assert!(shares.iter().all(|share| *share > 0.03) && world.lights.learnt.is_some(), "{shares:?}");
}

#[test]
fn a_lamp_that_touches_a_floor_takes_no_light_from_others() {
    let mut built = two_rooms();
    built.scene.shapes.remove(1);
    lamp(&mut built, Geometry::Rectangle, level(1.0, [0.5, 1e-4, 0.0], false), 5.0);
    let world = world(&built, Choices::Adapted);
    let learnt = world.lights.learnt.as_ref().expect("there is a choice");
    let most = learnt.arrives_most();
    assert!(most <= 16.0, "{most}");
    let shares = picked(&world, Vec3::new(-1.0, 0.0, 0.0));
    assert!(shares[0] > 0.2, "the lamp above: {shares:?}");
}

#[test]
fn light_from_behind_counts_where_surfaces_let_it_through() {
    // Rough glass, lit from below, and from above by a lamp as far away.
    let of = |through: bool| {
        let mut built = Built::new([0.0, 6.0, 0.1], [0.0; 3], 40.0, 4);
        built.diffuse([0.5; 3]);
        let one = Texture::scalar(1.0);
        let glass = tauflow_data::scene::Bsdf::Dielectric {
            int_ior: 1.5,
            ext_ior: 1.0,
            alpha: 0.4,
            specular_reflectance: one.clone(),
            specular_transmittance: one,
        };
        let pane = built.material(glass);
        built.shape(Geometry::Rectangle, level(3.0, [0.0; 3], true), if through { pane } else { 0 });
        lamp(&mut built, Geometry::Rectangle, level(0.3, [0.0, -1.5, 0.0], true), 5.0);
        lamp(&mut built, Geometry::Rectangle, level(0.3, [0.0, 1.5, 0.0], false), 5.0);
        picked(&world(&built, Choices::Adapted), Vec3::new(0.3, 0.0, 0.2))
    };
    let (glass, paper) = (of(true), of(false));
    assert!((0.35..0.65).contains(&glass[0]), "{glass:?}");
    assert!(paper[0] < 0.1, "{paper:?}");
}

/// Rays begin beside the surface that they leave, and so in another cell where its border is the surface. The way in
/// which lights are weighed then must be that in which they were drawn.
#[test]
fn a_surface_on_a_border_of_cells_is_lit_without_bias() {
    const SPP: u64 = 8192;
    // A ceiling and two lamps below it, one of them large and close.
    let mut built = Built::new([0.0, -2.0, 0.1], [0.0, 1.0, 0.0], 40.0, 3);
    let grey = built.diffuse([0.5; 3]);
    built.shape(Geometry::Rectangle, level(6.0, [0.0, 1.0, 0.0], false), grey);
    lamp(&mut built, Geometry::Rectangle, level(2.0, [1.5, 0.0, 0.0], true), 1.0);
    lamp(&mut built, Geometry::Rectangle, level(0.5, [-2.5, -0.5, 0.0], true), 8.0);
    let mut world = world(&built, Choices::Adapted);
    world.lights.learnt.as_mut().expect("there is a choice").part_at(1.0 - 2e-7);
    // Points on the ceiling are above the border, whatever their rounding, and rays begin below it.
    let here = |y: f32| picked(&world, Vec3::new(0.0, y, 0.0))[0] > 0.5;
    assert_eq!([here(1.0), here(1.0 - 6e-8), here(1.0 - 4e-7)], [false, false, true]);
    let mean = |strategy: Strategy| {
        let renderer = Renderer::new(&world, film(24, 24), 0).expect("a film").with_integrator(strategy);
        let mut film = renderer.begin();
        renderer.advance(&mut film, SPP, &mut |_| Ok(())).expect("nothing stops it");
        let over = |value: fn(&crate::accumulator::Pixel) -> f64| film.pixels.iter().map(value).sum::<f64>() / 576.0;
        let n = SPP as f64;
        (over(|pixel| pixel.sum[0]) / n, (over(|pixel| pixel.m2[0]) / (n * n * 576.0)).sqrt())
    };
    let ((joined, a), (lights, b)) = (mean(Strategy::Mis), mean(Strategy::LightsOnly));
    println!("{joined:.5} +- {a:.5}, lights alone {lights:.5} +- {b:.5}");
    assert!((joined - lights).abs() < 4.5 * (a * a + b * b).sqrt(), "{joined} {lights}");
    assert!(a < 0.01 * joined && b < 0.01 * lights);
}
