//! Lights are sampled as their densities say. With `TAUFLOW_SLOW=1` more draws, and a finer quadrature.

use super::*;
use crate::{
    chi_square,
    geometry::Ray,
    scenes::{Built, ball, columns, level},
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
    let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
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
    let vantage = Vantage::<f32> { p: p.into(), error: Vec3::ZERO.into(), normal: Vec3::new(0.0, 1.0, 0.0).into() };
    let slow = tauflow_testing::slow();
    // Draws, and directions of the quadrature along a side of a bin.
    let (count, fine) = if slow { (500_000, 160) } else { (200_000, 80) };
    let mut stream = Stream::new(5, &[]).part(name);
    let mut found = vec![0.0; ROWS * COLUMNS + 1];
    for _ in 0..count {
        let mut two = || Pair::new(stream.uniform() as f32, stream.uniform() as f32);
        let numbers = [two(), two(), two(), two()];
        let arrived = world.lights.sample(&world, &vantage, None, true, numbers);
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
            let mut pdf = f64::from(world.lights.environment_look::<f32>(p.into(), d.into()).1);
            // Lights do not hide each other here, but a shape has a back.
            let mut ray = Ray::new(p, d);
            for _ in 0..4 {
                let Some((_, at)) = world.meet(&ray) else { break };
                let light = world.shapes[at.shape as usize].light;
                if light != crate::table::DARK {
                    pdf += f64::from(world.lights.shape_pdf::<f32>(light, p.into(), at.p.into(), at.geometric.into()));
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
