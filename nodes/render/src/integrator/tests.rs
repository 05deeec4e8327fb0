use super::{Integrator, Path, Strategy, first_solid};
use crate::{
    accumulator::Accumulator,
    choices::Choices,
    render::Renderer,
    rng::{Sampler, render_state},
    scenes::{Built, ball, balls_under_sky, columns, copies, everything, film, level, room},
    world::{Sharing, World},
};
use tauflow_contract::Digest;
use tauflow_data::{
    Image, SamplerKind,
    mesh::Mesh,
    scene::{Bsdf, Emitter, Geometry, Texture},
};
use tauflow_instructions::Instructions;

fn world(built: &Built) -> World {
    World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene")
}

/// A room of a dozen lamps more.
fn many_lamps() -> Built {
    let mut built = room();
    for at in 0..12 {
        let place = level(0.05, [0.1 * f64::from(at) - 0.6, 1.2, 0.3], false);
        built.shape(Geometry::Rectangle, place, 0).emission = Some(Texture::scalar(at as f32));
    }
    built
}

#[test]
fn every_set_of_instructions_has_the_same_bits() {
    tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
    let shared = World::with_sharing(&copies().scene, &mut |digest| copies().load(digest), Sharing::Always);
    let shared = shared.expect("a sound scene");
    assert!(shared.placed_count() > 15 && shared.features.opacity && shared.features.normal_maps);
    let adapted = [everything(), copies(), many_lamps()].map(|built| world(&built).with_choices(Choices::Adapted));
    assert!(adapted.iter().all(|world| world.lights.is_adapted()) && adapted[2].lights.shapes().count() > 10);
    let fixed = [world(&balls_under_sky()), world(&room()), world(&everything()), world(&copies()), shared];
    for world in fixed.into_iter().chain(adapted) {
        let films: Vec<_> = Instructions::available()
            .into_iter()
            .map(|instructions| {
                let (independent, sobol) = (SamplerKind::Independent, SamplerKind::Sobol);
                let joined = Integrator::Bidirectional(Path::default());
                let alone = Integrator::default();
                [(independent, alone), (sobol, alone), (independent, joined)].map(|(sampler, integrator)| {
                    let renderer =
                        Renderer::new(&world, film(24, 20), 3).expect("a film").with_instructions(instructions);
                    let renderer = renderer.with_sampler(sampler).with_integrator(integrator);
                    let mut film = renderer.begin();
                    renderer.advance(&mut film, 7, &mut |_| Ok(())).expect("nothing stops it");
                    film
                })
            })
            .collect();
        assert!(films.iter().all(|film| *film == films[0]), "{:?}", Instructions::available());
    }
}

/// Normal maps on copies placed in every way, without tangents of their own; on triangles without normals or texture
/// coordinates, and whose coordinates are all one point; on spheres and disks. Squares have tangents.
fn normal_maps() -> Built {
    let mut built = copies();
    let mapped = built.scene.materials.iter().find_map(|bsdf| match bsdf {
        Bsdf::TwoSided { inner } => match &**inner {
            Bsdf::NormalMap { map, .. } => Some(map.clone()),
            _ => None,
        },
        _ => None,
    });
    let map = mapped.expect("a normal map");
    // The floor and the masked material stay as they are.
    for (number, bsdf) in built.scene.materials.iter_mut().enumerate() {
        let plain = matches!(bsdf, Bsdf::Diffuse { .. } | Bsdf::Plastic { .. } | Bsdf::Dielectric { .. });
        if number > 0 && plain {
            *bsdf = Bsdf::NormalMap { map: map.clone(), scale: 0.8, inner: Box::new(bsdf.clone()) };
        }
    }
    let (with_tangents, without) = (built.scene.shapes[1].geometry.clone(), built.scene.shapes[2].geometry.clone());
    for shape in &mut built.scene.shapes {
        if shape.geometry == with_tangents {
            shape.geometry = without.clone();
        }
    }
    let pointed = Mesh { uvs: Some(vec![[0.3, 0.4]; ball(8).positions.len()]), ..ball(8) };
    let place = |x: f64| columns([0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3], [x, 1.6, 1.0]);
    for material in [1, 2] {
        let x = 1.4 * f64::from(material as u32) - 2.2;
        built.mesh(&pointed, place(x), material);
        built.shape(Geometry::Disk, place(x + 0.7), material).flip_normals = true;
        built.sphere([x, 2.3, 0.5], 0.3, material).flip_normals = material == 2;
    }
    built
}

#[test]
fn normal_maps_by_lane_have_the_bits_of_single_frames() {
    for sharing in [Sharing::Always, Sharing::Never] {
        let built = normal_maps();
        let mut world = World::with_sharing(&built.scene, &mut |digest| built.load(digest), sharing).expect("sound");
        let render = |world: &World| {
            let renderer = Renderer::new(world, film(48, 40), 3).expect("a film");
            let mut film = renderer.begin();
            renderer.advance(&mut film, 16, &mut |_| Ok(())).expect("nothing stops it");
            film
        };
        let by_lane = |world: &World| world.materials.iter().filter(|m| m.normal_map_by_lane().is_some()).count();
        assert!(by_lane(&world) >= 4, "{}", by_lane(&world));
        assert_eq!(world.placed_count() > 0, sharing == Sharing::Always);
        let film = render(&world);
        // Materials of meshes with tangents get their frames one by one.
        for used in &mut world.materials {
            used.tangents = true;
        }
        assert_eq!(by_lane(&world), 0);
        assert_eq!(film, render(&world));
    }
}

/// Mean squared difference of two films.
fn square_error(a: &Accumulator, b: &Accumulator) -> f64 {
    let (a, b) = (a.mean(), b.mean());
    let pairs = a.data().iter().zip(b.data());
    pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.data().len() as f64
}

#[test]
fn adapted_choices_of_lobes_find_the_same_image_with_less_error() {
    let mut built = balls_under_sky();
    for bsdf in &mut built.scene.materials {
        *bsdf = Bsdf::Principled {
            base_color: Texture::rgb([0.5, 0.4, 0.3]),
            metallic: Texture::scalar(0.0),
            roughness: Texture::scalar(0.5),
            specular: 0.5,
            spec_trans: Texture::scalar(0.0),
            clearcoat: 0.5,
            clearcoat_gloss: 0.5,
        };
    }
    let render = |choices| {
        let world = world(&built).with_choices(choices);
        let renderer = Renderer::new(&world, film(24, 24), 0).expect("a film");
        let mut film = renderer.begin();
        renderer.advance(&mut film, 512, &mut |_| Ok(())).expect("nothing stops it");
        let of = |f: fn(&crate::accumulator::Pixel) -> f64| film.pixels.iter().map(f).sum::<f64>() / 512.0;
        (of(|pixel| pixel.sum[1]), of(|pixel| pixel.m2[1]))
    };
    let ((fixed, spread), (adapted, less)) = (render(Choices::Fixed), render(Choices::Adapted));
    let error = ((spread + less) / 512.0).sqrt();
    assert!((fixed - adapted).abs() < 4.5 * error, "{fixed} {adapted} +- {error}");
    assert!(less * 1.15 < spread, "{less} {spread}");
}

#[test]
fn sobol_points_find_the_same_image_with_less_error() {
    for (name, built, gain) in [("balls", balls_under_sky(), 2.0), ("room", room(), 1.3)] {
        let world = world(&built);
        let render = |sampler, stream, count| {
            let renderer = Renderer::new(&world, film(16, 16), stream).expect("a film").with_sampler(sampler);
            let mut film = renderer.begin();
            // In two goes: samples are numbered, not counted.
            renderer.advance(&mut film, count / 3, &mut |_| Ok(())).expect("nothing stops it");
            renderer.advance(&mut film, count, &mut |_| Ok(())).expect("nothing stops it");
            film
        };
        let reference = render(SamplerKind::Independent, 1, 16384);
        let own = {
            let mean =
                |image: &Image| image.data().iter().map(|v| f64::from(*v)).sum::<f64>() / image.data().len() as f64;
            mean(&reference.variance()) / 16384.0
        };
        let error = |sampler, count| {
            let streams = [2, 3, 4, 5].map(|stream| square_error(&render(sampler, stream, count), &reference) - own);
            streams.iter().sum::<f64>() / 4.0
        };
        // The squared error after 64 samples is that much less, and it falls to the reference's: the mean is the same.
        let (independent, sobol) = (error(SamplerKind::Independent, 64), error(SamplerKind::Sobol, 64));
        assert!(gain * sobol < independent, "{name}: {sobol} {independent}");
        let later = error(SamplerKind::Sobol, 1024);
        assert!(later < 0.1 * sobol, "{name}: {later} {sobol}");
    }
}

#[test]
fn convex_bodies_do_not_shade_themselves() {
    let mut facets = ball(20);
    facets.normals = None;
    // Over twelve orders of magnitude of size, and away from the origin.
    let sizes = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6];
    let away = [(1e-2, 1.0), (1e3, -400.0), (1.0, 300.0), (1e6, 3e7)];
    for (radius, shift) in sizes.map(|size| (size, 0.0)).into_iter().chain(away) {
        let at = [shift, 0.5 * shift, -shift];
        for curved in [false, true] {
            let eye = [at[0], at[1], at[2] + 4.0 * radius];
            let mut built = Built::new(eye, at, 40.0, 2);
            built.scene.camera.near = 0.0;
            let white = built.diffuse([1.0; 3]);
            if curved {
                built.sphere(at, radius, white);
            } else {
                let (x, y, z) = ([radius, 0.0, 0.0], [0.0, radius, 0.0], [0.0, 0.0, radius]);
                built.mesh(&facets, columns(x, y, z, at), white);
            }
            let direction = [-1.0, -0.2, 0.1];
            built.scene.emitters.push(Emitter::Directional { direction, irradiance: [1.0; 3] });
            let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
            let renderer = Renderer::new(&world, film(64, 64), 0).expect("a sound film");
            let mut film = renderer.begin();
            renderer.advance(&mut film, 1, &mut |_| Ok(())).expect("nothing stops it");
            let to_light = -glam::DVec3::from_array(direction).normalize().as_vec3();
            let mut lit = 0;
            for (index, pixel) in film.pixels.iter().enumerate() {
                let at = renderer.pixel(index);
                let sampler = Sampler::new(SamplerKind::Independent, render_state(world.seed, 0), at, 0);
                let Some((_, hit)) = world.meet(&renderer.camera_ray(&sampler, at)) else { continue };
                if hit.geometric.dot(to_light) > 1e-3 {
                    lit += 1;
                    assert!(pixel.sum[0] > 0.0, "shaded at {hit:?}, radius {radius}");
                }
            }
            assert!(lit > 500, "{lit}, radius {radius}, {curved}, {shift}");
        }
    }
}

/// The figures of `benches/mitsuba/normal_maps.py`, which has Mitsuba's beside them.
#[test]
fn normal_maps_turn_with_mirrored_coordinates() {
    // A normal of the map, and the direction of a light of irradiance pi on a white square.
    let (n, l) = ([0.3f64, 0.5], [0.4f64, 0.35]);
    let up = |[x, y]: [f64; 2]| [x, y, (1.0 - x * x - y * y).sqrt()];
    let texel = up(n).map(|v| (0.5 * (v + 1.0)) as f32);
    let plain = [[0.0f32, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    for (mirror, radiance) in
        [([1.0, 1.0], 0.98315), ([-1.0, 1.0], 0.74315), ([1.0, -1.0], 0.63315), ([-1.0, -1.0], 0.39315)]
    {
        // glTF: x of the map along growing u, y against growing v, whichever way round that is.
        let along = n[0] * mirror[0] * l[0] + n[1] * mirror[1] * l[1] + up(n)[2] * up(l)[2];
        assert!((along - radiance).abs() < 1e-5, "{along}");
        let flipped = |c: f32, by: f64| if by < 0.0 { 1.0 - c } else { c };
        for tangents in [false, true] {
            let square = Mesh {
                positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
                triangles: vec![[0, 1, 2], [0, 2, 3]],
                normals: Some(vec![[0.0, 0.0, 1.0]; 4]),
                uvs: Some(plain.map(|[u, v]| [flipped(u, mirror[0]), flipped(v, mirror[1])]).to_vec()),
                tangents: tangents.then(|| vec![[mirror[0] as f32, 0.0, 0.0, (mirror[0] * mirror[1]) as f32]; 4]),
                ..Mesh::default()
            };
            let mut built = Built::new([0.0, 0.0, 6.0], [0.0; 3], 15.0, 2);
            let bytes = Image::from_data(1, 1, 3, texel.to_vec()).expect("one texel").to_bytes();
            let image = Digest::of(&bytes);
            built.blobs.insert(image, bytes);
            let uv = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
            let map = Texture::Bitmap { image, uv, scale: [1.0; 3], channel: None, clamp: false };
            let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(1.0) });
            let white = built.material(Bsdf::NormalMap { map, scale: 1.0, inner });
            built.mesh(&square, tauflow_data::scene::IDENTITY, white);
            let direction = up(l).map(|v| -v);
            let irradiance = [std::f32::consts::PI; 3];
            built.scene.emitters.push(Emitter::Directional { direction, irradiance });
            let world = world(&built);
            let renderer = Renderer::new(&world, film(8, 8), 0).expect("a sound film");
            let mut film = renderer.begin();
            renderer.advance(&mut film, 4, &mut |_| Ok(())).expect("nothing stops it");
            let image = film.mean();
            let off = image.data().iter().map(|v| (f64::from(*v) - radiance).abs()).fold(0.0, f64::max);
            assert!(off < 2e-5, "{mirror:?} {tangents}: off by {off}");
        }
    }
}

#[test]
fn features_are_those_of_shapes_that_are_there() {
    let mut built = room();
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
    let mask = built.material(Bsdf::Mask { opacity: Texture::scalar(0.5), inner });
    let features = |built: &Built| World::new(&built.scene, &mut |d| built.load(d)).expect("sound").features;
    let room = features(&built);
    assert!(room.area_lights && !room.opacity && !room.environment && !room.delta_lights && !room.normal_maps);
    built.shape(Geometry::Rectangle, level(0.1, [0.0, 1.0, 0.0], true), mask);
    built.sky([1.0; 3]);
    assert!(features(&built).opacity && features(&built).environment);
}

#[test]
fn weights_of_densities_that_overflow_are_no_nan() {
    assert_eq!(Strategy::Mis.weight(true, 1.0, f32::INFINITY), 0.0);
    assert_eq!(Strategy::LightsOnly.weight(false, 1.0, 0.0), 1.0);
    assert_eq!(Strategy::ScatteringOnly.weight(true, 1.0, 2.0), 0.0);
}

#[test]
fn rays_through_surfaces_end_where_single_rays_do() {
    // Emission alone, of depth 1: what a path sees is where its first ray ends.
    let mut built = copies();
    built.scene.max_depth = 1;
    let sheet = Bsdf::Mask {
        opacity: Texture::scalar(0.3),
        inner: Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) }),
    };
    let sheet = built.material(sheet);
    for k in 0..5 {
        let at = [0.3, 2.3 + 0.02 * f64::from(k), 3.0];
        built.shape(Geometry::Rectangle, level(1.5, at, k % 2 == 0), sheet);
        built.sphere([-1.0, 2.6, 2.0], 0.3 + 0.1 * f64::from(k), sheet);
    }
    for sharing in [Sharing::Never, Sharing::Always] {
        let world = World::with_sharing(&built.scene, &mut |digest| built.load(digest), sharing).expect("sound");
        let renderer = Renderer::new(&world, film(32, 32), 0).expect("a film");
        let mut film = renderer.begin();
        renderer.advance(&mut film, 1, &mut |_| Ok(())).expect("nothing stops it");
        let (mut passed, mut lamps) = (0, 0);
        for (index, pixel) in film.pixels.iter().enumerate() {
            let at = renderer.pixel(index);
            let sampler = Sampler::new(SamplerKind::Independent, render_state(world.seed, 0), at, 0);
            let ray = renderer.camera_ray(&sampler, at);
            let end = first_solid(&world, &sampler, 0, ray);
            let first = world.meet(&ray).map(|(hit, _)| hit.primitive);
            passed += u32::from(first != end.map(|(hit, _)| hit.primitive));
            let lamp = end.is_some_and(|(_, at)| world.shapes[at.shape as usize].light != crate::table::DARK);
            lamps += u32::from(lamp);
            let sky = end.is_none();
            // The sky's blue, a lamp's light of one colour or of its picture, or nothing.
            assert_eq!(pixel.sum[2] == f64::from(0.4f32), sky, "{at:?} {sharing:?}");
            assert!(lamp || sky || pixel.sum == [0.0; 3], "{at:?} {sharing:?}");
        }
        assert!(passed > 50 && lamps > 5, "{passed} passed, {lamps} lamps, {sharing:?}");
    }
}
