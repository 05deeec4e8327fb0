//! Worlds whose shapes share meshes, beside the same with copies.

use super::*;
use crate::{
    accel::RayBatch,
    geometry::{Map, offset_origin},
    render::Renderer,
    scenes::{Built, ball, columns, copies, film},
};
use glam::Vec3;
use tauflow_data::{rng::Stream, scene::IDENTITY};
use tauflow_instructions::Instructions;

fn world(built: &Built, sharing: Sharing) -> World {
    World::with_sharing(&built.scene, &mut |digest| built.load(digest), sharing).expect("a sound scene")
}

fn direction(stream: &mut Stream) -> Vec3 {
    loop {
        let mut one = || stream.range(-1.0, 1.0) as f32;
        let v = Vec3::new(one(), one(), one());
        if v.length_squared() < 1.0 && v.length_squared() > 1e-4 {
            return v.normalize();
        }
    }
}

/// Axes of a map that turns.
fn turned(angle: f64, tilt: f64) -> [[f64; 3]; 3] {
    let (s, c) = (tauflow_data::maths::sin(angle), tauflow_data::maths::cos(angle));
    let (p, q) = (tauflow_data::maths::sin(tilt), tauflow_data::maths::cos(tilt));
    [[c, 0.0, -s], [s * p, q, c * p], [s * q, -p, c * q]]
}

fn scaled(axes: [[f64; 3]; 3], by: [f64; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|k| axes[k].map(|v| v * by[k]))
}

#[test]
fn rays_meet_shared_meshes_where_they_meet_copies() {
    let built = copies();
    let (shared, copied) = (world(&built, Sharing::Always), world(&built, Sharing::Never));
    assert!(shared.placed_count() > 15 && copied.placed_count() == 0);
    assert!(shared.geometry_bytes() < copied.geometry_bytes());
    let mut stream = Stream::new(6, &[]);
    let (mut both, mut apart) = (0, 0);
    for _ in 0..20_000 {
        let origin = direction(&mut stream) * 5.0 + Vec3::Y;
        let target = Vec3::new(0.0, 0.8, 0.0) + direction(&mut stream) * 2.5;
        let ray = Ray::new(origin, (target - origin).normalize());
        let (a, b) = (shared.meet(&ray), copied.meet(&ray));
        match (a, b) {
            (Some((hit, at)), Some((other, its))) if at.shape == its.shape => {
                both += 1;
                if (hit.t - other.t).abs() > 1e-5 * other.t {
                    // At a silhouette one meets the back.
                    apart += 1;
                    continue;
                }
                assert!((at.p - its.p).length() < 1e-5 * other.t, "{at:?} {its:?}");
                // Beyond an edge the facet is another.
                if (at.geometric - its.geometric).length() > 1e-4 {
                    apart += 1;
                    continue;
                }
                assert!((at.shading - its.shading).length() < 1e-4, "{at:?} {its:?}");
                assert!((at.surface.uv - its.surface.uv).length() < 1e-3, "{at:?} {its:?}");
                assert!((at.surface.color - its.surface.color).length() < 1e-3, "{at:?} {its:?}");
                let frames = [
                    shared.shading_frame(&hit, shared.place(hit.primitive).1, &at, -ray.direction),
                    copied.shading_frame(&other, copied.place(other.primitive).1, &its, -ray.direction),
                ];
                assert!((frames[0].n - frames[1].n).length() < 2e-3, "{frames:?} {at:?}");
            }
            (None, None) => {}
            _ => apart += 1,
        }
    }
    assert!(both > 8000 && apart * 1000 < both, "{both} alike, {apart} not");
}

#[test]
fn images_of_shared_meshes_are_those_of_copies() {
    let built = copies();
    let spp = 512;
    let films = [Sharing::Always, Sharing::Never].map(|sharing| {
        let world = world(&built, sharing);
        let renderer = Renderer::new(&world, film(24, 24), 0).expect("a film");
        let mut film = renderer.begin();
        renderer.advance(&mut film, spp, &mut |_| Ok(())).expect("nothing stops it");
        assert_eq!(film.rejected, 0);
        film
    });
    // Random numbers are the same, so that errors are smaller than this says.
    let (n, mut worst) = (spp as f64, 0.0f64);
    for block in 0..36 {
        let (mut difference, mut square, mut sum) = (0.0, 0.0, 0.0);
        for i in 0..16 {
            let at = (block / 6 * 4 + i / 4) * 24 + block % 6 * 4 + i % 4;
            for c in 0..3 {
                let (a, b) = (&films[0].pixels[at], &films[1].pixels[at]);
                difference += (a.sum[c] - b.sum[c]) / n;
                square += (a.m2[c] + b.m2[c]) / (n * (n - 1.0));
                sum += a.sum[c] / n;
            }
        }
        worst = worst.max(difference.abs() / (square.sqrt() + 1e-5 * sum));
    }
    assert!(worst < 4.0, "{worst} deviations");
    let mean = |k: usize| films[k].pixels.iter().map(|p| p.sum[0] + p.sum[1] + p.sum[2]).sum::<f64>();
    assert!((mean(0) / mean(1) - 1.0).abs() < 0.01, "{} {}", mean(0), mean(1));
}

#[test]
fn a_thousand_copies_take_the_memory_of_one() {
    // 4 BANDS^2 triangles.
    let mesh = ball(50);
    let scene = |count: usize| {
        let mut built = Built::new([0.0, 0.0, 90.0], [0.0; 3], 50.0, 4);
        let white = built.diffuse([0.5; 3]);
        for k in 0..count {
            let at = [(k % 10) as f64 * 3.0, (k / 10 % 10) as f64 * 3.0, (k / 100) as f64 * 3.0];
            let [x, y, z] = turned(k as f64, 0.3 * k as f64);
            built.mesh(&mesh, columns(x, y, z, at), white);
        }
        built.sky([1.0; 3]);
        built
    };
    let (one, many) = (world(&scene(1), Sharing::Worthwhile), world(&scene(1000), Sharing::Worthwhile));
    assert!(one.placed_count() == 0 && many.placed_count() == 1000);
    assert!(one.primitive_count() >= 9_800 && many.primitive_count() >= 9_800_000);
    let (alone, all) = (one.geometry_bytes(), many.geometry_bytes());
    println!("{alone} bytes of one, {all} of a thousand: {:.3}", all as f64 / alone as f64);
    assert!(all * 10 < alone * 12, "{alone} bytes of one, {all} of a thousand");
    // One takes no more than this for a triangle.
    assert!(alone < 170 * one.primitive_count(), "{alone} of {}", one.primitive_count());
}

/// Two copies of a mesh: one with these axes at a place, the other far below it.
fn pair(mesh: &tauflow_data::mesh::Mesh, [x, y, z]: [[f64; 3]; 3], at: [f64; 3], size: f64) -> Built {
    let eye = [at[0], at[1], at[2] + 4.0 * size];
    let mut built = Built::new(eye, at, 40.0, 2);
    built.scene.camera.near = 0.0;
    let white = built.diffuse([1.0; 3]);
    built.mesh(mesh, columns(x, y, z, at), white);
    built.mesh(mesh, columns(x, y, z, [at[0], at[1] - 20.0 * size, at[2]]), white);
    built
}

/// Placements over nine orders of magnitude, near and far, stretched and mirrored.
fn placements() -> Vec<([[f64; 3]; 3], [f64; 3], f64)> {
    let mut all = Vec::new();
    for (k, size) in [1e-4, 1e-3, 0.01, 0.1, 1.0, 10.0, 1e3, 1e4].into_iter().enumerate() {
        for away in [0.0, 100.0 * size, 3000.0 * size] {
            for by in [[1.0, 1.0, 1.0], [1.0, 0.2, 2.0], [-1.0, 1.0, 0.6]] {
                let axes = scaled(turned(0.7 + k as f64, 0.4 * k as f64), by.map(|v| v * size));
                all.push((axes, [away, 0.5 * away, -away], size));
            }
        }
    }
    all
}

#[test]
fn no_ray_escapes_a_shared_closed_mesh() {
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    // Without a seam, so that the mesh is closed.
    let mut mesh = ball(16);
    let columns = 33;
    for row in 0..17 {
        mesh.positions[row * columns + 32] = mesh.positions[row * columns];
    }
    for j in 0..columns {
        (mesh.positions[j], mesh.positions[16 * columns + j]) = ([0.0, 1.0, 0.0], [0.0, -1.0, 0.0]);
    }
    let mut stream = Stream::new(8, &[]);
    for (axes, at, size) in placements() {
        let built = pair(&mesh, axes, at, size);
        let world = world(&built, Sharing::Always);
        assert_eq!(world.placed_count(), 2);
        let center = DVec3::from_array(at).as_vec3();
        let axes = axes.map(|axis| DVec3::from_array(axis).as_vec3());
        let rays: Vec<Ray> = (0..3000)
            .map(|i| {
                let within = direction(&mut stream) * 0.5;
                let origin = center + axes[0] * within.x + axes[1] * within.y + axes[2] * within.z;
                let [x, y, z] = mesh.positions[stream.below(mesh.positions.len())];
                let vertex = center + axes[0] * x + axes[1] * y + axes[2] * z;
                let towards = if i % 2 == 0 { vertex - origin } else { direction(&mut stream) };
                Ray::new(origin, towards.normalize())
            })
            .collect();
        let mut batch = RayBatch::new(&rays);
        for instructions in Instructions::available() {
            batch.nearest(&world.accel, instructions);
            let found: Vec<Option<Hit>> = (0..rays.len()).map(|k| batch.hit(k)).collect();
            for (ray, hit) in rays.iter().zip(&found) {
                assert!(hit.is_some_and(|hit| hit.primitive < 2 * mesh.triangles.len() as u32), "{ray:?} of {size}");
                assert_eq!(*hit, world.accel.closest(ray), "{instructions:?}");
            }
            batch.stopped(&world.accel, instructions);
            assert!((0..rays.len()).all(|k| batch.is_stopped(k)), "{instructions:?} of {size} at {at:?}");
        }
    }
}

#[test]
fn shared_meshes_do_not_shade_themselves() {
    let mut facets = ball(20);
    facets.normals = None;
    let mut stream = Stream::new(9, &[]);
    for (axes, at, size) in placements() {
        let built = pair(&facets, axes, at, size);
        let world = world(&built, Sharing::Always);
        assert_eq!(world.placed_count(), 2);
        let center = DVec3::from_array(at).as_vec3();
        let mut left = 0;
        for _ in 0..1500 {
            let out = direction(&mut stream);
            let from = center + out * (3.0 * size as f32);
            let Some((_, hit)) = world.meet(&Ray::new(from, -out)) else { continue };
            assert_eq!(hit.shape, 0);
            // Nothing of a convex body is above its own surface, nor anything of it behind when it is entered.
            for side in [1.0, -1.0] {
                let way = loop {
                    let way = direction(&mut stream);
                    if way.dot(hit.geometric) * side > 0.02 {
                        break way;
                    }
                };
                let origin = offset_origin(hit.p, hit.error, hit.geometric, way);
                let next = world.meet(&Ray::new(origin, way)).filter(|(_, next)| next.shape == 0);
                assert_eq!(next.is_some(), side < 0.0, "{hit:?} towards {way}, {size} at {at:?}");
                if let Some((again, _)) = next {
                    assert!(again.t > 0.0);
                    left += 1;
                }
            }
        }
        assert!(left > 1000, "{left}, {size}");
    }
}

#[test]
fn hostile_maps_are_treated_as_without_sharing() {
    let mesh = ball(6);
    let mut built = Built::new([0.0, 1.0, 6.0], [0.0; 3], 40.0, 4);
    let white = built.diffuse([0.5; 3]);
    let diagonal = |x: f64, y: f64, z: f64, s: f64| columns([x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z], [s, 0.0, 0.0]);
    let hostile = [
        diagonal(1.0, 1.0, 0.0, -1.0),
        diagonal(0.0, 0.0, 0.0, 0.5),
        diagonal(1e-30, 1e-30, 1e-30, 0.0),
        diagonal(1e-9, 1e-9, 1e-9, 1.0),
        diagonal(f64::NAN, 1.0, 1.0, 0.0),
        diagonal(1.0, f64::INFINITY, 1.0, 0.0),
        diagonal(1e39, 1.0, 1.0, 0.0),
        diagonal(0.5, 0.001, 0.5, 1.5),
    ];
    for affine in hostile {
        built.mesh(&mesh, affine, white);
    }
    built.sky([1.0; 3]);
    let render = |world: &World| {
        let renderer = Renderer::new(world, film(16, 16), 0).expect("a film");
        let mut film = renderer.begin();
        renderer.advance(&mut film, 8, &mut |_| Ok(())).expect("nothing stops it");
        film
    };
    let (shared, copied) = (world(&built, Sharing::Always), world(&built, Sharing::Never));
    assert_eq!((shared.placed_count(), shared.dropped), (0, copied.dropped));
    assert!(copied.dropped.degenerate > 0 && copied.dropped.not_finite > 0);
    assert!(render(&shared).pixels == render(&copied).pixels);
    // Beside them, benign ones share; and a mesh that is not finite does not.
    for k in 0..2 {
        built.mesh(&mesh, diagonal(0.3, 0.3, 0.3, k as f64), white);
    }
    assert_eq!(world(&built, Sharing::Always).placed_count(), 2);
    assert_eq!(world(&built, Sharing::Worthwhile).placed_count(), 0);
    let mut broken = mesh.clone();
    broken.positions[3][1] = f32::NAN;
    let mut built = Built::new([0.0, 1.0, 6.0], [0.0; 3], 40.0, 4);
    let white = built.diffuse([0.5; 3]);
    for _ in 0..2 {
        built.mesh(&broken, IDENTITY, white);
    }
    let broken = world(&built, Sharing::Always);
    assert!(broken.placed_count() == 0 && broken.dropped.not_finite > 0);
}

#[test]
fn lamps_that_share_a_mesh_have_their_own_area() {
    // Light of a lamp on a point under it, over its area and the cosines: the same however it is scaled.
    for (sharing, size) in [(Sharing::Never, 1.0), (Sharing::Always, 1.0), (Sharing::Always, 2.5)] {
        let mut built = crate::scenes::floor_point();
        let square = crate::geometry::rectangle();
        for away in [0.0, 500.0] {
            let place = crate::scenes::level(size, [away, 10.0 * size, 0.0], false);
            let lamp = built.mesh(&square, place, 0);
            lamp.emission = Some(tauflow_data::scene::Texture::scalar(5.0));
        }
        let world = world(&built, sharing);
        assert_eq!(world.placed_count(), if sharing == Sharing::Always { 2 } else { 0 });
        let renderer = Renderer::new(&world, film(1, 1), 0).expect("a film");
        let mut film = renderer.begin();
        renderer.advance(&mut film, 20_000, &mut |_| Ok(())).expect("nothing stops it");
        let mean = film.pixels[0].sum[0] / 20_000.0;
        // 0.5 / pi times 5 times the solid angle of a square of side 2 at 10, by the cosine: its form factor.
        let form = 4.0 * 0.1 / (1.01f64).sqrt() * libm::atan(0.1 / (1.01f64).sqrt()) / std::f64::consts::TAU * 2.0;
        let expected = 0.5 * 5.0 * form;
        assert!((mean / expected - 1.0).abs() < 0.01, "{mean} {expected}, {sharing:?} of {size}");
    }
    let map = Map::new(&IDENTITY);
    assert_eq!(map.shift(), DVec3::ZERO);
}

#[test]
fn copies_are_counted_before_they_are_made() {
    let mut built = Built::new([0.0, 1.0, 6.0], [0.0; 3], 40.0, 4);
    let white = built.diffuse([0.5; 3]);
    let mesh = ball(64);
    // Too stretched to be shared.
    let stretched = [[1000.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    built.mesh(&mesh, stretched, white);
    let count = (1 << 24) / mesh.triangles.len() + 1;
    let copy = built.scene.shapes[0].clone();
    built.scene.shapes.resize(count, copy);
    let mut reads = 0;
    let mut load = |digest: &Digest| {
        reads += 1;
        built.load(digest)
    };
    let told = World::with_sharing(&built.scene, &mut load, Sharing::Worthwhile);
    let told = told.map(|_| ()).expect_err("too much").to_string();
    assert!(told.contains("triangles and bodies") && told.contains("at most"), "{told}");
    assert!(reads < 4, "{reads} reads of one mesh");
}
