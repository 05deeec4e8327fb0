//! Rays a second of the hierarchy's kernels beside obvhs's own traversal, and build times; on one core.
//!
//! `traversal [FOLDER]`: meshes of 1 k to 1 M triangles, a bumpy ball seen from within; camera rays, rays scattered
//! where these end, and shadow rays from there to points about the middle. FOLDER gets meshes and rays for
//! `benches/embree`.
#![expect(clippy::disallowed_methods, reason = "it measures")]

use glam::{Vec3, Vec3A};
use obvhs::{
    BvhBuildParams,
    bvh2::builder::build_bvh2_from_tris,
    cwbvh::builder::build_cwbvh_from_tris,
    ray::{Ray as ObvhsRay, RayHit},
    triangle::Triangle,
};
use std::{
    error::Error,
    fs,
    path::PathBuf,
    time::{Duration, Instant},
};
use tauflow_data::{maths, rng::Stream};
use tauflow_render::{
    Instructions,
    accel::{Accel, Primitive, RayBatch},
    geometry::{Ray, area_normal},
};

/// Camera rays along a side.
const SIDE: usize = 512;
/// Rays that are traced together.
const BATCH: usize = 4096;
const ROUNDS: usize = 5;

/// A ball of 2 n^2 triangles with bumps.
fn ball(n: usize) -> Vec<[Vec3; 3]> {
    let point = |row: usize, column: usize| {
        let theta = std::f64::consts::PI * row as f64 / n as f64;
        let phi = std::f64::consts::TAU * (column % n) as f64 / n as f64;
        let bump = 1.0 + 0.1 * maths::sin(9.0 * theta) * maths::sin(7.0 * phi) + 0.02 * maths::sin(61.0 * phi + theta);
        let r = maths::sin(theta) * bump;
        Vec3::new((r * maths::cos(phi)) as f32, (maths::cos(theta) * bump) as f32, (r * maths::sin(phi)) as f32)
    };
    let mut triangles = Vec::new();
    for row in 0..n {
        for column in 0..n {
            let [a, b] = [point(row, column), point(row, column + 1)];
            let [c, d] = [point(row + 1, column), point(row + 1, column + 1)];
            triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    triangles.retain(|[a, b, c]| area_normal(*a, *b, *c).is_some());
    triangles
}

fn least(mut work: impl FnMut()) -> f64 {
    let mut least = f64::INFINITY;
    for _ in 0..ROUNDS {
        let begun = Instant::now();
        work();
        least = least.min(begun.elapsed().as_secs_f64());
    }
    least
}

fn primary() -> Vec<Ray> {
    let origin = Vec3::new(0.1, 0.05, -0.2);
    // Pixel by pixel in blocks, as a renderer takes them.
    (0..SIDE * SIDE)
        .map(|i| {
            let (block, within) = (i / 64, i % 64);
            let (x, y) = (block % (SIDE / 8) * 8 + within % 8, block / (SIDE / 8) * 8 + within / 8);
            let at = |v: usize| (v as f32 + 0.5) / SIDE as f32 * 2.0 - 1.0;
            Ray::new(origin, Vec3::new(at(x), at(y), 1.0).normalize())
        })
        .collect()
}

/// Rays from where others ended: scattered by the cosine, and to points about the middle.
fn secondary(triangles: &[[Vec3; 3]], rays: &[Ray], batches: &[RayBatch]) -> [Vec<Ray>; 2] {
    let mut stream = Stream::new(1, &[]);
    let (mut bounce, mut shadow) = (Vec::new(), Vec::new());
    for (index, ray) in rays.iter().enumerate() {
        let Some(hit) = batches[index / BATCH].hit(index % BATCH) else { continue };
        let [a, b, c] = triangles[hit.primitive as usize];
        let n = (b - a).cross(c - a).normalize();
        let n = if n.dot(ray.direction) > 0.0 { -n } else { n };
        let p = ray.at(hit.t) + n * 1e-4;
        let mut unit = || {
            let (z, phi) = (stream.range(-1.0, 1.0), stream.range(0.0, std::f64::consts::TAU));
            let r = (1.0 - z * z).sqrt();
            Vec3::new((r * maths::cos(phi)) as f32, (r * maths::sin(phi)) as f32, z as f32)
        };
        bounce.push(Ray::new(p, (n + unit() * 0.999).normalize()));
        let end = unit() * 0.3;
        shadow.push(Ray { origin: p, direction: end - p, t_max: 1.0 });
    }
    [bounce, shadow]
}

fn write(folder: &std::path::Path, name: &str, triangles: &[[Vec3; 3]], sets: &[&[Ray]]) -> Result<(), Box<dyn Error>> {
    let mut bytes = Vec::new();
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for value in triangles.iter().flatten().flat_map(glam::Vec3::to_array) {
        bytes.extend(value.to_le_bytes());
    }
    for rays in sets {
        bytes.extend((rays.len() as u32).to_le_bytes());
        for ray in *rays {
            let [o, d] = [ray.origin.to_array(), ray.direction.to_array()];
            for value in o.into_iter().chain(d).chain([ray.t_max]) {
                bytes.extend(value.to_le_bytes());
            }
        }
    }
    fs::create_dir_all(folder)?;
    Ok(fs::write(folder.join(name), bytes)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).map(PathBuf::from);
    let instructions = Instructions::best();
    println!("{instructions:?}; millions of rays per second on one core, best of {ROUNDS}");
    println!("| triangles | rays | lists of {BATCH} | obvhs, 8 wide | obvhs, binary | ours / the better |");
    println!("|---:|---|---:|---:|---:|---:|");
    let mut builds = String::new();
    for n in [22, 71, 224, 707] {
        let triangles = ball(n);
        let primitives: Vec<Primitive> = triangles.iter().map(|t| Primitive::Triangle(*t)).collect();
        let theirs: Vec<Triangle> = triangles
            .iter()
            .map(|[a, b, c]| Triangle { v0: Vec3A::from(*a), v1: Vec3A::from(*b), v2: Vec3A::from(*c) })
            .collect();
        let begun = Instant::now();
        let accel = Accel::new(&primitives, Vec3::ZERO);
        let own_build = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        let wide = build_cwbvh_from_tris(&theirs, BvhBuildParams::medium_build(), &mut Duration::default());
        let wide_build = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        let binary = build_bvh2_from_tris(&theirs, BvhBuildParams::medium_build(), &mut Duration::default());
        let binary_build = begun.elapsed().as_secs_f64();
        builds += &format!(
            "| {} | {:.1} | {:.1} | {:.1} |\n",
            triangles.len(),
            own_build * 1e3,
            wide_build * 1e3,
            binary_build * 1e3
        );
        // Triangles in the order of their tree, as its author has it.
        let of_wide: Vec<Triangle> = wide.primitive_indices.iter().map(|i| theirs[*i as usize]).collect();
        let of_binary: Vec<Triangle> = binary.primitive_indices.iter().map(|i| theirs[*i as usize]).collect();

        let first = primary();
        let mut batches: Vec<RayBatch> = first.chunks(BATCH).map(RayBatch::new).collect();
        batches.iter_mut().for_each(|batch| batch.nearest(&accel, instructions));
        let [bounce, shadow] = secondary(&triangles, &first, &batches);
        if let Some(folder) = &folder {
            write(folder, &format!("{n}.rays"), &triangles, &[&first, &bounce, &shadow])?;
        }
        for (name, rays, any) in [("camera", &first, false), ("scattered", &bounce, false), ("shadow", &shadow, true)] {
            let mut batches: Vec<RayBatch> = rays.chunks(BATCH).map(RayBatch::new).collect();
            let own = least(|| {
                for batch in &mut batches {
                    if any { batch.stopped(&accel, instructions) } else { batch.nearest(&accel, instructions) }
                }
            });
            let met = rays.iter().enumerate().filter(|(i, _)| {
                let batch = &batches[i / BATCH];
                if any { batch.is_stopped(i % BATCH) } else { batch.hit(i % BATCH).is_some() }
            });
            let met = met.count();
            let make = |ray: &Ray| ObvhsRay::new(ray.origin.into(), ray.direction.into(), 0.0, ray.t_max);
            let (mut by_wide, mut by_binary) = (0, 0);
            let wide_time = least(|| {
                by_wide = 0;
                for ray in rays {
                    let hit = if any {
                        wide.ray_traverse_miss(make(ray), |ray, id| of_wide[id].intersect(ray))
                    } else {
                        let mut hit = RayHit::none();
                        !wide.ray_traverse(make(ray), &mut hit, |ray, id| of_wide[id].intersect(ray))
                    };
                    by_wide += usize::from(!hit);
                }
            });
            let binary_time = least(|| {
                by_binary = 0;
                for ray in rays {
                    let hit = if any {
                        binary.ray_traverse_miss(make(ray), |ray, id| of_binary[id].intersect(ray))
                    } else {
                        let mut hit = RayHit::none();
                        !binary.ray_traverse(make(ray), &mut hit, |ray, id| of_binary[id].intersect(ray))
                    };
                    by_binary += usize::from(!hit);
                }
            });
            // Their triangles lose a ray at an edge now and then.
            let off = by_wide.abs_diff(met).max(by_binary.abs_diff(met));
            if off * 1000 > rays.len() {
                return Err(format!("{name}: {met} met here, {by_wide} and {by_binary} there").into());
            }
            let rate = |seconds: f64| rays.len() as f64 / seconds / 1e6;
            println!(
                "| {} | {name} | {:.2} | {:.2} | {:.2} | {:.2} |",
                triangles.len(),
                rate(own),
                rate(wide_time),
                rate(binary_time),
                wide_time.min(binary_time) / own
            );
        }
    }
    println!(
        "\nBuilding, ms:\n\n| triangles | ours | obvhs, 8 wide | obvhs, binary |\n|---:|---:|---:|---:|\n{builds}"
    );
    Ok(())
}
