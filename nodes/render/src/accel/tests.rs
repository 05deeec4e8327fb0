//! The hierarchy against brute force, and on geometry made to break it.

use super::{
    Accel, CURVED, Forms, Hit, LEAF, NONE, PLACED, Packet, PlacedMesh, Primitive, RayBatch, STACK, Set, SharedMesh,
    Sweep, block::AnyBlock, build::PIECE,
};
use crate::{
    geometry::{Disk, Map, Ray, Sphere, cube},
    lanes::{Integer, Mask, Real, Triple},
    placement::Placement,
};
use glam::{DVec3, Vec3};
use tauflow_data::{rng::Stream, scene::IDENTITY};
use tauflow_instructions::Instructions;

struct Draw(Stream);

impl Draw {
    fn cube(&mut self, half: f32) -> Vec3 {
        let mut one = || self.0.range(-1.0, 1.0) as f32 * half;
        Vec3::new(one(), one(), one())
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let v = self.cube(1.0);
            if v.length_squared() < 1.0 && v.length_squared() > 1e-4 {
                return v.normalize();
            }
        }
    }
}

fn check(accel: &Accel, draw: &mut Draw, rays: usize, half: f32) -> usize {
    let mut hits = 0;
    for i in 0..rays {
        let mut direction = draw.direction();
        if i % 5 == 0 {
            direction = [Vec3::X, -Vec3::Y, Vec3::Z, Vec3::new(0.0, 1.0, -1.0), Vec3::new(-0.0, -1.0, 0.0)][i / 5 % 5];
        }
        let mut ray = Ray::new(draw.cube(half), direction);
        let expected = accel.closest_by_force(&ray);
        assert_eq!(accel.closest(&ray), expected, "{ray:?}");
        assert_eq!(accel.occluded(&ray), expected.is_some());
        if let Some(hit) = expected {
            hits += 1;
            ray.t_max = hit.t.next_down();
            assert!(!accel.occluded(&ray) && accel.closest(&ray).is_none());
        }
    }
    hits
}

#[test]
fn agrees_with_brute_force_on_random_primitives() {
    let mut draw = Draw(Stream::new(1, &[]));
    for count in [1, 2, 5, 40, 700] {
        let mut primitives: Vec<Primitive> = (0..count)
            .map(|_| {
                let a = draw.cube(10.0);
                Primitive::Triangle([a, a + draw.cube(2.0), a + draw.cube(2.0)])
            })
            .collect();
        for _ in 0..count / 10 {
            let center = draw.cube(10.0).as_dvec3().to_array();
            let map = Map::new(&IDENTITY);
            primitives.push(Primitive::Sphere(Sphere::new(center, 0.7, &map).expect("a plain sphere")));
            let mut affine = IDENTITY;
            for row in &mut affine {
                for value in row.iter_mut() {
                    *value += draw.0.range(-0.5, 0.5);
                }
                row[3] *= 20.0;
            }
            primitives.push(Primitive::Disk(Disk::new(&Map::new(&affine)).expect("not flat")));
        }
        let mut accel = Accel::new(&primitives, Vec3::ZERO);
        let hits = check(&accel, &mut draw, 3000, 15.0);
        batches(&accel, &mut draw, 15.0);
        // As if it were large: rays take turns.
        accel.is_large = true;
        batches(&accel, &mut draw, 15.0);
        sweep_and_packets::<f32>(&accel, &mut draw, 15.0);
        #[cfg(target_arch = "x86_64")]
        sweep_and_packets::<crate::lanes::F4>(&accel, &mut draw, 15.0);
        assert!(count < 700 || hits > 300, "{hits} hits of {count}");
    }
}

/// The primitives of a tree, in order; placed meshes count by their first primitive.
fn census(accel: &Accel, node: u32, into: &mut Vec<u32>) {
    let node = &accel.nodes[node as usize];
    for (lane, child) in node.children.into_iter().enumerate() {
        if node.planes[0][lane] > node.planes[1][lane] {
            continue;
        }
        if child & LEAF == 0 {
            census(accel, child, into);
        } else if child & PLACED == PLACED {
            into.push(accel.roots[(child & !PLACED) as usize].first);
        } else {
            let mut take = |number: u32| match number {
                NONE => {}
                curved if curved & CURVED != 0 => into.push(accel.curved[(curved & !CURVED) as usize].0),
                triangle => into.push(triangle),
            };
            match accel.blocks.at(child & !LEAF) {
                AnyBlock::Narrow(block) => (0..4).for_each(|lane| take(block.primitive(lane))),
                AnyBlock::Wide(block) => (0..8).for_each(|lane| take(block.primitive(lane))),
            }
        }
    }
}

/// Triangles and spheres, more than a piece has, many of them in one place.
fn many(draw: &mut Draw) -> Vec<Primitive> {
    let mut primitives: Vec<Primitive> = Vec::new();
    for k in 0..PIECE + 9000 {
        let a = draw.cube(10.0);
        let b = a + draw.cube(0.3);
        primitives.push(Primitive::Triangle([a, b, a + draw.cube(0.3)]));
        // Two sides of one edge, and many in one place.
        if k % 100 == 0 {
            primitives.push(Primitive::Triangle([b, a, b + draw.cube(0.3)]));
            primitives.push(Primitive::Triangle([Vec3::splat(0.1), Vec3::X, Vec3::Y]));
        }
        if k % 1000 == 0 {
            let center = draw.cube(10.0).as_dvec3().to_array();
            let sphere = Sphere::new(center, 0.3, &Map::new(&IDENTITY));
            primitives.push(Primitive::Sphere(sphere.expect("a plain sphere")));
        }
    }
    primitives
}

#[test]
fn a_tree_of_pieces_agrees_with_brute_force() {
    let mut draw = Draw(Stream::new(6, &[]));
    let primitives = many(&mut draw);
    let mut accel = Accel::new(&primitives, Vec3::ZERO);
    let mut found = Vec::new();
    census(&accel, 0, &mut found);
    found.sort_unstable();
    assert!(found.iter().copied().eq(0..primitives.len() as u32));
    accel.is_large = true;
    assert!(check(&accel, &mut draw, 300, 12.0) > 100);
    batches(&accel, &mut draw, 12.0);
    sweep_and_packets::<f32>(&accel, &mut draw, 12.0);
    // So many that rays are followed before all lists are short.
    let rays: Vec<Ray> = (0..60_000).map(|_| Ray::new(draw.cube(12.0), draw.direction())).collect();
    let mut batch = RayBatch::new(&rays);
    for instructions in Instructions::available() {
        batch.stopped(&accel, instructions);
        assert!(rays.iter().enumerate().all(|(k, ray)| batch.is_stopped(k) == accel.occluded(ray)));
    }
}

#[test]
fn rays_of_no_numbers_meet_nothing_in_small_blocks() {
    let mut draw = Draw(Stream::new(7, &[]));
    let primitives: Vec<Primitive> = (0..PIECE + 5000)
        .map(|_| {
            // Below 0, so that numbers of a block have the sign that curved primitives have.
            let a = draw.cube(10.0) - 30.0;
            Primitive::Triangle([a, a + draw.cube(0.3), a + draw.cube(0.3)])
        })
        .collect();
    let mut accel = Accel::new(&primitives, Vec3::ZERO);
    accel.is_large = true;
    let odd = [
        Ray::new(Vec3::splat(f32::NAN), Vec3::X),
        Ray::new(Vec3::ZERO, Vec3::splat(f32::INFINITY)),
        Ray::new(Vec3::ZERO, Vec3::splat(f32::NEG_INFINITY)),
        Ray::new(Vec3::ZERO, Vec3::splat(f32::NAN)),
        Ray::new(Vec3::splat(f32::INFINITY), Vec3::Y),
        Ray::new(Vec3::ZERO, Vec3::ZERO),
    ];
    assert!(odd.iter().all(|ray| accel.closest(ray).is_none() && !accel.occluded(ray)));
    let rays: Vec<Ray> = odd.iter().cycle().take(240).copied().collect();
    let mut batch = RayBatch::new(&rays);
    for instructions in Instructions::available() {
        batch.nearest(&accel, instructions);
        assert!((0..rays.len()).all(|k| batch.hit(k).is_none()), "{instructions:?}");
        batch.stopped(&accel, instructions);
        assert!((0..rays.len()).all(|k| !batch.is_stopped(k)), "{instructions:?}");
    }
}

#[test]
fn many_placed_meshes_and_a_large_shared_one_agree_with_brute_force() {
    let mut draw = Draw(Stream::new(8, &[]));
    let mut primitives = vec![Primitive::Triangle([Vec3::ZERO, Vec3::X, Vec3::Y])];
    let own = primitives.len() as u32;
    let mut shared = Vec::new();
    for count in [3, PIECE + 500] {
        shared.push(SharedMesh { first: primitives.len() as u32, count });
        for _ in 0..count {
            let a = draw.cube(1.0);
            primitives.push(Primitive::Triangle([a, a + draw.cube(0.6), a + draw.cube(0.6)]));
        }
    }
    let (mut placed, mut first) = (Vec::new(), own);
    for k in 0..PIECE + 2000 {
        let mesh = usize::from(k % 20_000 == 7);
        let affine = crate::placement::tests::draw(&mut draw.0, if mesh == 1 { 2.0 } else { 0.4 }, 10.0);
        let Some(placement) = Placement::new(&Map::new(&affine)) else { continue };
        let SharedMesh { first: from, count } = shared[mesh];
        let bounds = placed_bounds(&placement, &primitives[from as usize..][..count as usize]);
        placed.push(PlacedMesh { mesh, placement, bounds, first });
        first += count;
    }
    let form = |index: u32| primitives[index as usize];
    let mut accel = Accel::over(&Forms { count: own, form: &form }, &shared, &placed, Vec3::ZERO);
    let mut found = Vec::new();
    census(&accel, 0, &mut found);
    found.sort_unstable();
    let mut expected: Vec<u32> = std::iter::once(0).chain(placed.iter().map(|one| one.first)).collect();
    expected.sort_unstable();
    assert_eq!(found, expected);
    accel.is_large = true;
    assert!(check(&accel, &mut draw, 80, 12.0) > 10);
}

#[test]
fn pieces_of_one_place_are_divided() {
    // No plane divides them, and a few are far away.
    let near = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::Y];
    let mut primitives = vec![Primitive::Triangle(near); 2 * PIECE as usize];
    primitives.extend((0..5).map(|k| Primitive::Triangle(near.map(|v| v + 50.0 * k as f32))));
    let accel = Accel::new(&primitives, Vec3::ZERO);
    let hit = accel.closest(&Ray::new(Vec3::Z, -Vec3::Z));
    assert!(hit.is_some_and(|hit| hit.t == 1.0 && hit.primitive == 0), "{hit:?}");
    let far = accel.closest(&Ray::new(Vec3::new(200.0, 200.0, 201.0), -Vec3::Z));
    assert_eq!(far.map(|hit| hit.primitive), Some(2 * PIECE + 4));
}

/// Lists of rays find what every primitive tried one by one gives, by whatever instructions.
fn batches(accel: &Accel, draw: &mut Draw, half: f32) {
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    let rays: Vec<Ray> = (0..900)
        .map(|i| {
            let t_max = if i % 3 == 0 { 4.0 } else { f32::MAX };
            // Many from one place: lists stay long. Some along the axes.
            let origin = if i % 2 == 0 { Vec3::splat(0.3) } else { draw.cube(half) };
            let direction = if i % 11 == 0 { [Vec3::X, -Vec3::Y, -Vec3::Z][i / 11 % 3] } else { draw.direction() };
            Ray { t_max, ..Ray::new(origin, direction) }
        })
        .collect();
    let expected: Vec<Option<Hit>> = rays.iter().map(|ray| accel.closest_by_force(ray)).collect();
    for count in [0, 1, 17, rays.len()] {
        let mut batch = RayBatch::new(&rays[..count]);
        assert!(batch.len() == count && batch.is_empty() == (count == 0));
        for instructions in Instructions::available() {
            batch.nearest(accel, instructions);
            for (k, (ray, expected)) in rays.iter().zip(&expected).take(count).enumerate() {
                assert_eq!(batch.hit(k), *expected, "{instructions:?}, {ray:?}");
            }
            batch.stopped(accel, instructions);
            for (k, (ray, expected)) in rays.iter().zip(&expected).take(count).enumerate() {
                assert_eq!(batch.is_stopped(k), expected.is_some(), "{instructions:?}, {ray:?}");
            }
        }
    }
}

/// Sweeps of many rays and packets of few find what every primitive tried one by one gives.
fn sweep_and_packets<R: Real>(accel: &Accel, draw: &mut Draw, half: f32) {
    let count = 700;
    let rays: Vec<Ray> = (0..count)
        .map(|i| {
            let direction = match i % 7 {
                0 => [Vec3::X, -Vec3::Y, Vec3::Z, Vec3::new(0.0, 1.0, -1.0), Vec3::new(-0.0, -1.0, 0.0)][i / 7 % 5],
                _ => draw.direction(),
            };
            let t_max = if i % 3 == 0 { 4.0 } else { f32::MAX };
            Ray { t_max, ..Ray::new(draw.cube(half), direction) }
        })
        .collect();
    let room = count + 16;
    let row = |value: fn(&Ray) -> f32| -> Vec<f32> { rays.iter().map(value).chain([0.0; 16]).collect() };
    let rows = [
        row(|r| r.origin.x),
        row(|r| r.origin.y),
        row(|r| r.origin.z),
        row(|r| r.direction.x),
        row(|r| r.direction.y),
        row(|r| r.direction.z),
    ];
    let [ox, oy, oz, dx, dy, dz] = &rows;
    let (mut memory, mut stack) = (Sweep::default(), [(0, 0.0); STACK]);
    for any in [false, true] {
        let (mut t, mut u, mut v) = (row(|r| r.t_max), vec![0.0; room], vec![0.0; room]);
        let mut primitive = vec![u32::MAX; room];
        let mut set = Set {
            origin: [ox, oy, oz],
            direction: [dx, dy, dz],
            t: &mut t,
            u: &mut u,
            v: &mut v,
            primitive: &mut primitive,
        };
        if any {
            accel.sweep::<R, R, true>(&mut set, count, &mut memory);
        } else {
            accel.sweep::<R, R, false>(&mut set, count, &mut memory);
        }
        for (at, ray) in rays.iter().enumerate() {
            let expected = accel.closest_by_force(ray);
            if any {
                assert_eq!(t[at] < 0.0, expected.is_some(), "{ray:?}");
            } else {
                let found =
                    (primitive[at] != u32::MAX).then(|| Hit { t: t[at], u: u[at], v: v[at], primitive: primitive[at] });
                assert_eq!(found, expected, "{ray:?}");
            }
        }
    }
    // From one place, as from a camera.
    let eye = draw.cube(half);
    let mut packets = 0;
    for _ in 0..60 {
        let to = draw.direction();
        let ways: Vec<Vec3> = (0..R::N).map(|_| (to + draw.cube(0.05)).normalize()).collect();
        let part = |k: usize| {
            let mut row = [0.0; 16];
            row.iter_mut().zip(&ways).for_each(|(r, way)| *r = way[k]);
            R::load(&row)
        };
        let mask = !R::Mask::from_bits(0);
        let Some(packet) = Packet::new(Triple::splat(eye), Triple::new(part(0), part(1), part(2)), mask) else {
            continue;
        };
        packets += 1;
        let hits = accel.closest_packet::<R, R>(&packet, mask, &mut stack);
        let (mut rows, mut primitive) = ([[0.0; 16]; 3], [0; 16]);
        hits.t.store(&mut rows[0]);
        hits.u.store(&mut rows[1]);
        hits.v.store(&mut rows[2]);
        hits.primitive.store(&mut primitive);
        for (lane, way) in ways.iter().enumerate() {
            let found = (primitive[lane] != u32::MAX).then(|| Hit {
                t: rows[0][lane],
                u: rows[1][lane],
                v: rows[2][lane],
                primitive: primitive[lane],
            });
            assert_eq!(found, accel.closest_by_force(&Ray::new(eye, *way)), "{eye} {way}");
        }
    }
    assert!(packets > 5, "{packets} packets");
}

/// Bounds of triangles where a shape has them.
fn placed_bounds(placement: &Placement, triangles: &[Primitive]) -> (Vec3, Vec3) {
    let mut bounds = (Vec3::MAX, Vec3::MIN);
    for primitive in triangles {
        let Primitive::Triangle(vertices) = primitive else { continue };
        for p in vertices.map(|p| placement.point(p).as_vec3()) {
            bounds = (bounds.0.min(p), bounds.1.max(p));
        }
    }
    bounds
}

/// A world of triangles, bodies, and meshes placed many times: some in one place, so that hits are at one distance.
fn two_levels(draw: &mut Draw) -> Accel {
    let mut primitives: Vec<Primitive> = Vec::new();
    for k in 0..30 {
        let a = draw.cube(10.0);
        primitives.push(Primitive::Triangle([a, a + draw.cube(2.0), a + draw.cube(2.0)]));
        if k % 10 == 0 {
            let center = draw.cube(10.0).as_dvec3().to_array();
            let sphere = Sphere::new(center, 0.7, &Map::new(&IDENTITY));
            primitives.push(Primitive::Sphere(sphere.expect("a plain sphere")));
        }
    }
    let own = primitives.len() as u32;
    let mut shared = Vec::new();
    for count in [1u32, 7, 60] {
        shared.push(SharedMesh { first: primitives.len() as u32, count });
        for _ in 0..count {
            let a = draw.cube(1.0);
            primitives.push(Primitive::Triangle([a, a + draw.cube(0.6), a + draw.cube(0.6)]));
        }
    }
    let (mut placed, mut first) = (Vec::new(), own);
    let mut affine = IDENTITY;
    for k in 0..40 {
        if k % 5 != 4 {
            affine = crate::placement::tests::draw(&mut draw.0, 2.0, 10.0);
        }
        let Some(placement) = Placement::new(&Map::new(&affine)) else { continue };
        let mesh = k / 10 % 3;
        let SharedMesh { first: from, count } = shared[mesh];
        let bounds = placed_bounds(&placement, &primitives[from as usize..][..count as usize]);
        placed.push(PlacedMesh { mesh, placement, bounds, first });
        first += count;
    }
    let form = |at: u32| primitives[at as usize];
    Accel::over(&Forms { count: own, form: &form }, &shared, &placed, Vec3::ZERO)
}

#[test]
fn agrees_with_brute_force_on_two_levels() {
    let mut draw = Draw(Stream::new(11, &[]));
    for _ in 0..4 {
        let mut accel = two_levels(&mut draw);
        let hits = check(&accel, &mut draw, 3000, 15.0);
        batches(&accel, &mut draw, 15.0);
        accel.is_large = true;
        batches(&accel, &mut draw, 15.0);
        sweep_and_packets::<f32>(&accel, &mut draw, 15.0);
        #[cfg(target_arch = "x86_64")]
        sweep_and_packets::<crate::lanes::F4>(&accel, &mut draw, 15.0);
        assert!(hits > 100, "{hits} hits");
    }
    // A mesh placed twice in one place: the lower number counts, and the owner is found.
    let triangle = Primitive::Triangle([Vec3::ZERO, Vec3::X, Vec3::Y]);
    let placement = Placement::new(&Map::new(&IDENTITY)).expect("benign");
    let placed = [7, 5].map(|first| PlacedMesh { mesh: 0, placement, bounds: triangle.bounds(), first });
    let forms = Forms { count: 0, form: &|_| triangle };
    let accel = Accel::over(&forms, &[SharedMesh { first: 0, count: 1 }], &placed, Vec3::Z);
    let ray = Ray::new(Vec3::new(0.2, 0.2, 1.0), -Vec3::Z);
    assert_eq!(accel.closest(&ray).map(|h| h.primitive), Some(5));
    assert_eq!(accel.placements().bytes() > 0, accel.bytes() > accel.placements().bytes());
}

#[test]
fn degenerate_sets_are_fine() {
    let mut draw = Draw(Stream::new(2, &[]));
    let empty = Accel::new(&[], Vec3::ZERO);
    assert_eq!(check(&empty, &mut draw, 10, 1.0), 0);
    // One place many times over; a plane of slivers; tiny and far away.
    let one = Primitive::Triangle([Vec3::ZERO, Vec3::X, Vec3::Y]);
    let same = Accel::new(&vec![one; 100_000], Vec3::ZERO);
    check(&same, &mut draw, 50, 1.0);
    let ray = Ray::new(Vec3::new(0.2, 0.2, 1.0), -Vec3::Z);
    assert_eq!(same.closest(&ray).map(|h| h.primitive), Some(0), "the lowest of those at one distance");
    let sliver = |i: usize| {
        let x = i as f32 * 1e-3;
        Primitive::Triangle([Vec3::new(x, -1.0, 0.0), Vec3::new(x + 1e-3, -1.0, 0.0), Vec3::new(x, 1.0, 0.0)])
    };
    let slivers: Vec<Primitive> = (0..500).map(sliver).collect();
    check(&Accel::new(&slivers, Vec3::ZERO), &mut draw, 500, 1.0);
    let small = |i: usize| {
        let at = Vec3::new(1e4, 1e4, i as f32 * 1e-2);
        Primitive::Triangle([at, at + Vec3::X * 1e-2, at + Vec3::Y * 1e-2])
    };
    let far: Vec<Primitive> = (0..300).map(small).collect();
    let accel = Accel::new(&far, Vec3::ZERO);
    for i in 0..300 {
        let ray = Ray::new(Vec3::new(1e4 + 2e-3, 1e4 + 2e-3, i as f32 * 1e-2 + 5e-3), Vec3::Z);
        assert_eq!(accel.closest(&ray), accel.closest_by_force(&ray));
    }
    // A direction of no length, and one that is not finite, meet nothing and do not panic.
    assert!(same.closest(&Ray::new(Vec3::Z, Vec3::ZERO)).is_none());
    assert!(same.closest(&Ray::new(Vec3::Z, Vec3::splat(f32::NAN))).is_none());
    assert!(same.closest(&Ray::new(Vec3::splat(f32::NAN), Vec3::X)).is_none());
}

/// A sphere of triangles: latitude bands closed at the poles, sharing vertices bit for bit.
fn ball(bands: usize, center: Vec3, radius: f64) -> Vec<[Vec3; 3]> {
    use std::f64::consts::PI;
    let vertex = |i: usize, j: usize| {
        let (theta, phi) = (PI * i as f64 / bands as f64, 2.0 * PI * (j % (2 * bands)) as f64 / (2 * bands) as f64);
        let sin = if i == 0 || i == bands { 0.0 } else { libm::sin(theta) };
        (center.as_dvec3() + DVec3::new(sin * libm::cos(phi), libm::cos(theta), sin * libm::sin(phi)) * radius)
            .as_vec3()
    };
    let mut out = Vec::new();
    for i in 0..bands {
        for j in 0..2 * bands {
            let (a, b, c, d) = (vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1), vertex(i + 1, j));
            out.extend(
                [[a, b, c], [a, c, d]].into_iter().filter(|t| crate::geometry::area_normal(t[0], t[1], t[2]).is_some()),
            );
        }
    }
    out
}

#[test]
fn no_ray_escapes_a_closed_mesh() {
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    let mut draw = Draw(Stream::new(3, &[]));
    let box_mesh = cube();
    let boxed: Vec<[Vec3; 3]> =
        box_mesh.triangles.iter().map(|t| t.map(|i| Vec3::from_array(box_mesh.positions[i as usize]))).collect();
    let far = Vec3::new(300.0, -200.0, 100.0);
    for (center, size, triangles) in [
        (Vec3::ZERO, 1.0f32, ball(24, Vec3::ZERO, 1.0)),
        (far, 0.5, ball(64, far, 0.5)),
        (Vec3::ZERO, 100.0, ball(9, Vec3::ZERO, 100.0)),
        (Vec3::ZERO, 1.0, boxed),
    ] {
        let primitives: Vec<Primitive> = triangles.iter().map(|t| Primitive::Triangle(*t)).collect();
        let accel = Accel::new(&primitives, Vec3::ZERO);
        let rays = if tauflow_testing::slow() { 2_500_000 } else { 60_000 };
        let mut together = Vec::with_capacity(rays);
        for i in 0..rays {
            let origin = center + draw.cube(0.4 * size);
            // Half of the rays aim at shared vertices and edges.
            let triangle = triangles[draw.0.below(triangles.len())];
            let (a, b) = (triangle[i % 3], triangle[(i + 1) % 3]);
            let target = match i % 4 {
                0 => a,
                1 => a + (b - a) * draw.0.uniform() as f32,
                _ => origin + draw.direction(),
            };
            let ray = Ray::new(origin, (target - origin).normalize());
            assert!(accel.closest(&ray).is_some() && accel.occluded(&ray), "{ray:?} of size {size} at {center}");
            together.push(ray);
        }
        // The same by lists, as renders trace them.
        for rays in together.chunks(4096) {
            let mut batch = RayBatch::new(rays);
            for instructions in Instructions::available() {
                batch.nearest(&accel, instructions);
                let lost = (0..rays.len()).find(|k| batch.hit(*k).is_none());
                assert!(lost.is_none(), "{instructions:?}: {lost:?} of size {size} at {center}");
                batch.stopped(&accel, instructions);
                let lost = (0..rays.len()).find(|k| !batch.is_stopped(*k));
                assert!(lost.is_none(), "{instructions:?}: {lost:?} of size {size} at {center}");
            }
        }
    }
}
