//! Tests of the whole library of maps, measured from their texels.

use super::*;
use tauflow_data::{Image, rng::mix};

/// What the first variants of two libraries come to.
const PINNED: u64 = 5_172_931_021_952_591_662;

/// Variants that are looked at: the first of two libraries.
const SOME: [u64; 2] = [0, 8];

fn values(image: &Image, channel: usize) -> impl Iterator<Item = f64> + '_ {
    image.data().iter().skip(channel).step_by(image.channels()).map(|v| f64::from(*v))
}

fn mean(image: &Image, channel: usize) -> f64 {
    values(image, channel).sum::<f64>() / (image.width() * image.height()) as f64
}

/// Mean step between neighbours across columns `left` and `right` of every row, and the same of rows.
fn steps(image: &Image, pairs: &[(usize, usize)], along_rows: bool) -> f64 {
    let lines = if along_rows { image.height() } else { image.width() };
    let at = |place: usize, line: usize| {
        let pixel = if along_rows { image.pixel(place, line) } else { image.pixel(line, place) };
        pixel.iter().map(|v| f64::from(*v)).collect::<Vec<_>>()
    };
    let mut sum = 0.0;
    for (a, b) in pairs {
        for line in 0..lines {
            sum += at(*a, line).iter().zip(at(*b, line)).map(|(x, y)| (x - y).abs()).sum::<f64>();
        }
    }
    sum / (pairs.len() * lines) as f64
}

#[test]
fn names_are_in_order_and_sizes_are_fine() {
    assert!(PATTERNS.is_sorted_by_key(|p| p.name));
    for pattern in &PATTERNS {
        assert_eq!(Pattern::of(pattern.name).name, pattern.name);
        assert!(pattern.size.iter().all(|s| s.is_power_of_two() && (64..=512).contains(s)), "{}", pattern.name);
        // Texels are from a millimetre to 8 mm.
        let texel = pattern.period[0] / pattern.size[0] as f64;
        assert!((0.0004..0.0095).contains(&texel), "{}: {texel}", pattern.name);
    }
}

#[test]
fn the_library_stays_small() {
    // Work and room go with texels: colour of one or three bytes, roughness of one, normals of three.
    let texels = |p: &Pattern| (p.size[0] * p.size[1]) as u64;
    let bytes: u64 = PATTERNS.iter().map(|p| p.variants * texels(p) * if p.gray { 5 } else { 7 }).sum();
    assert!(bytes < 360 << 20, "{} MiB", bytes >> 20);
    let most = PATTERNS.iter().map(texels).max().expect("some");
    assert_eq!(most, 512 * 512);
}

#[test]
fn every_map_is_in_range_varied_and_tiles() {
    for pattern in &PATTERNS {
        for variant in SOME {
            let name = format!("{}-{variant}", pattern.name);
            let maps = pattern.maps(variant);
            let images: Vec<&Image> =
                [Some(&maps.color), Some(&maps.roughness), maps.normal.as_ref()].into_iter().flatten().collect();
            for image in &images {
                assert_eq!([image.width(), image.height()], pattern.size, "{name}");
                assert!(image.data().iter().all(|v| (0.0..=1.0).contains(v)), "{name}");
                // In bytes, with a header.
                assert!(image.to_small_bytes().len() < image.data().len() + 200, "{name}");
                if pattern.tiles {
                    for along_rows in [true, false] {
                        let n = if along_rows { image.width() } else { image.height() };
                        let inside: Vec<(usize, usize)> = (0..n - 1).map(|i| (i, i + 1)).collect();
                        // A joint may lie on the border: no more than the steepest place inside.
                        let most = inside.iter().fold(0.0f64, |m, p| m.max(steps(image, &[*p], along_rows)));
                        let border = steps(image, &[(n - 1, 0)], along_rows);
                        assert!(border <= 1.3 * most + 1e-3, "{name} {along_rows}: {border} of {most}");
                    }
                }
            }
            assert_eq!(maps.color.channels(), if pattern.gray { 1 } else { 3 }, "{name}");
            let spread: f64 = (0..maps.color.channels())
                .map(|c| {
                    let m = mean(&maps.color, c);
                    values(&maps.color, c).map(|v| (v - m) * (v - m)).sum::<f64>()
                })
                .sum::<f64>()
                / maps.color.data().len() as f64;
            // Water has no colours of its own, and lives by its normals.
            if pattern.name == "ripples" {
                assert!(maps.normal.is_some(), "{name}");
            } else {
                assert!(spread.sqrt() > 0.004, "{name}: {}", spread.sqrt());
            }
        }
    }
}

#[test]
fn normals_are_unit_look_outwards_and_lean_to_no_side() {
    let mut bumpy = 0;
    for pattern in &PATTERNS {
        let maps = pattern.maps(1);
        let Some(normal) = &maps.normal else { continue };
        bumpy += 1;
        let mut sum = [0.0; 3];
        for pixel in normal.data().chunks_exact(3) {
            let n = [0, 1, 2].map(|c| 2.0 * f64::from(pixel[c]) - 1.0);
            let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
            // Half a step of 1 / 127.5 a component.
            assert!((length - 1.0).abs() < 0.008 && n[2] > 0.45, "{}: {n:?}", pattern.name);
            sum = [0, 1, 2].map(|c| sum[c] + n[c]);
        }
        let count = (normal.width() * normal.height()) as f64;
        // Slopes of a height that repeats add up to nothing, but for steep places that are cut.
        assert!(sum[0].abs() < 0.03 * count && sum[1].abs() < 0.03 * count, "{}: {sum:?} {count}", pattern.name);
    }
    assert!(bumpy > 30, "{bumpy}");
}

#[test]
fn normals_follow_the_height() {
    // A bump in the middle: to its right u grows and the surface leans to +u; below it v grows, which is down in the
    // image, so that the second component, upwards in the image, is negative.
    let skin = Skin::new([64, 64], |_, u, v| {
        let square = (u - 0.5) * (u - 0.5) + (v - 0.5) * (v - 0.5);
        skin::Texel { color: [0.5; 3], rough: 0.5, height: 20.0 * (0.1 - square).max(0.0) }
    });
    let normal = skin.maps([0.064, 0.064], true).normal.expect("a bump");
    assert!(normal.pixel(42, 32)[0] > 0.54 && normal.pixel(22, 32)[0] < 0.46);
    assert!(normal.pixel(32, 42)[1] < 0.46 && normal.pixel(32, 22)[1] > 0.54);
    // The slope at 10 texels of a millimetre: 20 mm * 2 * 10/64 / 64 mm = 0.0977.
    let expected = 0.5 + 0.5 * 0.0977 / (1.0f64 + 0.0977 * 0.0977).sqrt();
    assert!((f64::from(normal.pixel(42, 31)[0]) - expected).abs() < 0.006, "{:?} {expected}", normal.pixel(42, 31));
    let flat = Skin::new([8, 8], |_, _, _| skin::Texel { color: [0.5; 3], rough: 0.5, height: 1.0 });
    assert!(flat.maps([1.0, 1.0], true).normal.is_none());
}

#[test]
fn colours_are_those_of_their_stuffs() {
    for variant in 0..4 {
        let color = |name: &str| {
            let maps = Pattern::of(name).maps(variant);
            [0, 1, 2].map(|c| mean(&maps.color, c))
        };
        for name in ["veneer", "planks", "parquet", "rust", "soil", "sand", "bark"] {
            let [r, g, b] = color(name);
            assert!(r >= 0.98 * g && g >= 0.95 * b, "{name}-{variant}: {r} {g} {b}");
        }
        for name in ["lawn", "blade"] {
            let [r, g, b] = color(name);
            assert!(g > b && g > 0.85 * r, "{name}-{variant}: {r} {g} {b}");
        }
        for (name, low, high) in
            [("snow", 0.6, 0.95), ("asphalt", 0.02, 0.16), ("concrete", 0.1, 0.5), ("marble", 0.02, 0.8)]
        {
            let [r, g, b] = color(name);
            let most = r.max(g).max(b);
            assert!((low..=high).contains(&most), "{name}-{variant}: {most}");
        }
    }
}

#[test]
fn variants_differ_and_keep_their_bits() {
    let bits = |pattern: &Pattern, variant| {
        let maps = pattern.maps(variant);
        let images = [Some(&maps.color), Some(&maps.roughness), maps.normal.as_ref()];
        let values = images.into_iter().flatten().flat_map(Image::data);
        values.fold(0, |state, v| mix(state, u64::from(v.to_bits())))
    };
    let mut all = 0;
    for pattern in &PATTERNS {
        let own = [0, pattern.variants].map(|v| bits(pattern, v));
        assert_ne!(own[0], own[1], "{}", pattern.name);
        all = own.into_iter().fold(all, mix);
    }
    // The same on every machine: raise VERSION when this changes.
    assert_eq!(all, PINNED);
}
