//! Tests of the library of environments: measured from their pixels.

use super::*;
use tauflow_data::image::luminance;

/// Luminance and area of every texel, brightest first.
fn texels(image: &Image) -> Vec<(f64, f64)> {
    let mut texels: Vec<(f64, f64)> = Vec::new();
    for y in 0..image.height() {
        let area = maths::sin(core::f64::consts::PI * (y as f64 + 0.5) / image.height() as f64);
        texels.extend((0..image.width()).map(|x| (f64::from(luminance(image.pixel(x, y))), area)));
    }
    texels.sort_by(|a, b| b.0.total_cmp(&a.0));
    texels
}

/// Share of the light that comes from the brightest `part` of the sphere.
fn share(texels: &[(f64, f64)], part: f64) -> f64 {
    let (light, area) = texels.iter().fold((0.0, 0.0), |(l, s), (v, a)| (l + v * a, s + a));
    let (mut top, mut seen) = (0.0, 0.0);
    for (l, a) in texels {
        if seen > part * area {
            break;
        }
        top += l * a;
        seen += a;
    }
    top / light
}

#[test]
fn skies_have_unit_mean_and_the_light_they_claim() {
    assert!(SKIES.is_sorted_by_key(|sky| sky.name));
    for sky_kind in SKIES {
        // Some of two libraries.
        for variant in (0..2 * VARIANTS).step_by(7) {
            let name = format!("{}-{variant}", sky_kind.name);
            let image = sky(sky_kind.name, variant);
            let texels = texels(&image);
            let area: f64 = texels.iter().map(|t| t.1).sum();
            let mean = texels.iter().map(|t| t.0 * t.1).sum::<f64>() / area;
            assert!((mean - 1.0).abs() < 1e-3, "{name}: {mean}");
            let top = share(&texels, 0.01);
            match sky_kind.light {
                Light::Soft => assert!(top < 0.08, "{name}: {top}"),
                Light::Mixed => assert!(top > 0.06 && top < 0.45, "{name}: {top}"),
                Light::Sun => assert!(top > 0.4, "{name}: {top}"),
            }
            assert!(image.data().iter().all(|v| *v >= 0.0 && f64::from(*v) <= BRIGHTEST), "{name}");
            // Nothing is flat: neighbours differ on most of the map.
            let differ = (1..image.width()).filter(|x| image.pixel(*x, 40) != image.pixel(x - 1, 40)).count();
            assert!(2 * differ > image.width(), "{name}: {differ}");
        }
    }
}

#[test]
fn skies_are_stored_in_halves_and_once() {
    let image = sky("cloudy", 3);
    let bytes = image.to_small_bytes();
    assert!(bytes.len() < 2 * image.data().len() + 200, "{}", bytes.len());
    assert_eq!(Image::from_bytes(&bytes).expect("own bytes"), image);
    for (value, expected) in
        [(0.0, 0.0), (1.0, 1.0), (1.0 + 1.0 / 2048.0, 1.0), (3e-8, 5.960_464_5e-8), (15_999.0, 16_000.0)]
    {
        assert_eq!(half(value), expected, "{value}");
    }
}

#[test]
fn suns_keep_the_irradiance_of_the_air_whatever_their_size() {
    let mut draw = Stream::new(5, &[]);
    let air = air::Air::new(&mut draw, [0.6, 0.6001], [0.1, 0.1001]);
    for radius in [0.8f64, 1.3, 9.0] {
        let radius = radius.to_radians();
        // Over rings about the sun.
        let rings = 4000;
        let sum: f64 = (0..rings)
            .map(|i| {
                let angle = 1.3 * radius * (f64::from(i) + 0.5) / f64::from(rings);
                let aside = [-air.sun[2], 0.0, air.sun[0]];
                let aside = tauflow_data::geom::unit(aside);
                let w = [0, 1, 2].map(|k| air.sun[k] * maths::cos(angle) + aside[k] * maths::sin(angle));
                let ring = core::f64::consts::TAU * maths::sin(angle) * 1.3 * radius / f64::from(rings);
                ring * air.disc(w, radius)[1]
            })
            .sum();
        assert!((sum / air.direct[1] - 1.0).abs() < 0.02, "{radius}: {sum} {}", air.direct[1]);
    }
    // Blue above, red where the sun stands low, and no sun below the horizon.
    let zenith = air.radiance([0.0, 1.0, 0.0]);
    assert!(zenith[2] > 1.5 * zenith[0], "{zenith:?}");
    let low = air::Air::new(&mut draw, [0.05, 0.06], [0.1, 0.1001]);
    assert!(low.direct[0] > 3.0 * low.direct[2] && low.direct[0] < air.direct[0], "{:?}", low.direct);
    let set = air::Air::new(&mut draw, [-0.06, -0.05], [0.1, 0.1001]);
    assert_eq!(set.direct, [0.0; 3]);
}
