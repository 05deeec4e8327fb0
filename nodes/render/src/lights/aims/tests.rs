//! Aimed paths bring what paths that go anywhere bring.

use super::*;
use crate::{
    rng::{Sampler, render_state},
    scenes::{Built, columns, level},
};
use tauflow_data::{
    SamplerKind,
    scene::{Bsdf, Geometry, Texture},
};

const DRAWS: u32 = 200_000;

fn glass(built: &mut Built) -> usize {
    let white = || Texture::scalar(1.0);
    built.material(Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: white(),
        specular_transmittance: white(),
    })
}

/// Balls of glass over a floor, one of which the lamp is in.
fn stage(count: u32) -> Built {
    let mut built = Built::new([0.0, 1.6, 3.0], [0.0, 0.2, 0.0], 40.0, 5);
    let (grey, glass) = (built.diffuse([0.5; 3]), glass(&mut built));
    built.shape(Geometry::Rectangle, level(2.0, [0.0; 3], true), grey);
    for number in 0..count {
        let (x, z) = (f64::from(number % 5) * 0.6 - 1.2, f64::from(number / 5) * 0.6 - 0.6);
        built.sphere([x, 0.3 + 0.1 * x, z], 0.08 + 0.02 * f64::from(number % 3), glass);
    }
    built.sphere([0.5, 1.5, 0.2], 0.7, glass);
    built
}

fn with_lamp(mut built: Built) -> Built {
    let black = built.diffuse([0.0; 3]);
    let turned = columns([0.3, 0.1, 0.0], [-0.1, 0.3, 0.0], [0.0, 0.0, 0.3], [0.4, 1.4, 0.1]);
    built.shape(Geometry::Disk, turned, black).emission = Some(Texture::rgb([3.0, 2.0, 1.0]));
    built.sphere([-0.8, 1.2, 0.3], 0.15, black).emission = Some(Texture::scalar(4.0));
    built
}

/// Mean power that is sent through each of some balls, and in all, with its standard errors.
fn sent(world: &World, aims: &Aims, through: &[Ball]) -> Vec<(f64, f64)> {
    let mut sums = vec![(0.0, 0.0); through.len() + 1];
    for draw in 0..DRAWS {
        let numbers = Sampler::new(SamplerKind::Independent, render_state(7, 1), (draw, 0), 0);
        let Some(pair) = world.lights.pairing(aims, &numbers) else { continue };
        let Some(emitted) = world.lights.emit(world, aims, &pair, &numbers) else { continue };
        assert!(emitted.power.is_finite() && emitted.density > 0.0, "{emitted:?}");
        let power = f64::from(emitted.power.y);
        let meets = |ball: &Ball| {
            let towards = ball.center - emitted.ray.origin;
            let inside = towards.length() < ball.radius;
            let aside = towards.cross(emitted.ray.direction).length() < ball.radius;
            inside || (aside && towards.dot(emitted.ray.direction) > 0.0)
        };
        for (sum, counts) in sums.iter_mut().zip(through.iter().map(meets).chain([true])) {
            if counts {
                *sum = (sum.0 + power, sum.1 + power * power);
            }
        }
    }
    let n = f64::from(DRAWS);
    sums.iter().map(|(sum, square)| (sum / n, ((square / n - (sum / n).powi(2)) / n).sqrt())).collect()
}

fn compare(name: &str, built: &Built) {
    let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
    let aims = Aims::towards_specular(&world).expect("glass and lights");
    let balls = balls(&world);
    assert!(aims.balls.len() <= BALLS);
    for ball in &balls {
        let covered = |by: &Ball| by.center.distance(ball.center) + ball.radius <= by.radius * 1.0001;
        assert!(aims.balls.iter().any(covered), "{name}: nothing covers {ball:?}");
    }
    // Shares that were learnt, too: here from the number of the pair.
    let brought: Vec<f64> = (0..aims.len()).map(|pair| f64::from(pair as u32 % 3)).collect();
    let paths: Vec<u64> = (0..aims.len()).map(|pair| if pair % 2 == 0 { 2 * FEW } else { 1 }).collect();
    let learnt = Aims::towards_specular(&world).and_then(|aims| aims.learnt(&brought, &paths));
    let anywhere = sent(&world, &Aims::anywhere(&world.lights), &balls);
    for (how, aims) in [("caught", aims), ("learnt", learnt.expect("shares"))] {
        let aimed = sent(&world, &aims, &balls);
        for (at, (found, known)) in aimed.iter().zip(&anywhere).enumerate() {
            let deviation = (found.0 - known.0) / (found.1.powi(2) + known.1.powi(2)).sqrt();
            assert!(deviation.abs() < 4.5, "{name}, {how}, ball {at}: {found:?} and {known:?}");
        }
        // Small balls get light with less noise. The made-up shares say nothing of noise.
        let less = aimed[0].1 < 0.5 * anywhere[0].1;
        assert!(less || how == "learnt", "{name}: {:?} and {:?}", aimed[0], anywhere[0]);
    }
}

#[test]
fn aimed_paths_bring_what_paths_that_go_anywhere_bring() {
    for count in [3, 24] {
        compare(&format!("lamps, {count} balls"), &with_lamp(stage(count)));
        let mut sky = stage(count);
        sky.sky([0.5, 0.7, 1.0]);
        compare(&format!("sky, {count} balls"), &sky);
    }
}

#[test]
fn nothing_is_emitted_where_nothing_shines_or_nothing_comes_of_it() {
    let built = |glass: bool, lamp: bool| {
        let built = if glass { stage(2) } else { Built::new([0.0, 1.0, 3.0], [0.0; 3], 40.0, 5) };
        let built = if lamp { with_lamp(built) } else { built };
        let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
        Aims::towards_specular(&world).is_some()
    };
    assert_eq!([(true, true), (true, false), (false, true)].map(|(a, b)| built(a, b)), [true, false, true]);
    let sound = with_lamp(stage(2));
    let world = World::new(&sound.scene, &mut |digest| sound.load(digest)).expect("a sound scene");
    let aims = Aims::towards_specular(&world).expect("glass and lights");
    let pairs = aims.len();
    assert!(aims.learnt(&vec![0.0; pairs], &vec![1; pairs]).is_none(), "nothing was brought");
}
