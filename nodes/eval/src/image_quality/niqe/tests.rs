//! The method against another implementation, and its parts by their definitions.

use super::*;
use tauflow_data::rng::Stream;

/// A hash of two whole numbers, as in `benches/niqe.py`.
fn mixed(a: u32, b: u32) -> u32 {
    let h = a.wrapping_mul(0x9E37_79B1).wrapping_add(b.wrapping_mul(0x85EB_CA77)).wrapping_add(0xC2B2_AE3D);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h ^ (h >> 13)
}

/// The picture of `benches/niqe.py`, in grey.
fn picture(width: u32, height: u32, seed: u32) -> Image {
    let value = |x: u32, y: u32| {
        let strength = 1 + mixed(x / 96 + seed, y / 96) % 4;
        let fine = mixed(x + seed, y) % 64 * strength / 4;
        let coarse = mixed(x / 5 + seed, y / 5) % 128 * (5 - strength) / 4;
        (fine + coarse + (x + y) / 4 % 64).min(255) as f32 / 255.0
    };
    let values = (0..height).flat_map(|y| (0..width).flat_map(move |x| [value(x, y); 3])).collect();
    Image::from_data(width as usize, height as usize, 3, values).expect("fits")
}

#[test]
fn the_distances_are_those_of_pyiqa() {
    let niqe = Niqe::new();
    for (side, expected) in [(96, [4.506_518_319_86, 3.533_214_267_87]), (32, [1.378_512_937_12, 1.191_997_309_48])] {
        let law = |width, height, seed| {
            let patches = niqe.patches(&picture(width, height, seed), side);
            assert_eq!((patches.features.len(), patches.flat), (width as usize / side * (height as usize / side), 0));
            Moments::of(&patches.features).law().expect("patches")
        };
        let clean = law(960, 768, 1000);
        for (seed, expected) in [7, 1000].into_iter().zip(expected) {
            let found = law(290, 200, seed).distance(&clean);
            // pyiqa finds shapes in single precision.
            assert!((found / expected - 1.0).abs() < 1e-4, "side {side}, seed {seed}: {found} {expected}");
        }
    }
}

#[test]
fn shapes_of_known_laws_are_found() {
    let niqe = Niqe::new();
    let mut stream = Stream::new(4, &[]);
    let normal: Vec<f64> = (0..40_000).map(|_| 3.0 * stream.normal()).collect();
    let [shape, left, right] = niqe.fitted(&normal).expect("both signs");
    // A Gaussian has shape 2 and scale sqrt(2) sigma; a Laplacian shape 1 and scale b.
    assert!((shape - 2.0).abs() < 0.06 && (left / 4.243 - 1.0).abs() < 0.03 && (right / 4.243 - 1.0).abs() < 0.03);
    let laplacian = |scale: f64, of: &mut Stream| -scale * tauflow_data::maths::log(1.0 - of.uniform());
    let skewed: Vec<f64> = (0..60_000)
        .map(|at| if at % 3 == 0 { -laplacian(1.0, &mut stream) } else { laplacian(2.0, &mut stream) })
        .collect();
    let [shape, left, right] = niqe.fitted(&skewed).expect("both signs");
    assert!((shape - 1.0).abs() < 0.04 && (left - 1.0).abs() < 0.05 && (right - 2.0).abs() < 0.1, "{shape}");
    assert!(niqe.fitted(&[1.0, 2.0]).is_none() && niqe.fitted(&[0.0; 4]).is_none());
}

#[test]
fn laws_pool_patches_with_their_weights() {
    let mut stream = Stream::new(5, &[]);
    let patches: Vec<Features> = (0..50).map(|_| std::array::from_fn(|_| stream.normal())).collect();
    let (first, second) = patches.split_at(20);
    let mut pooled = Moments::none();
    pooled.add(&Moments::of(first), 2.0);
    pooled.add(&Moments::of(second), 1.0);
    let listed = Moments::of(first.iter().chain(first).chain(second)).law().expect("patches");
    let pooled = pooled.law().expect("patches");
    assert!(listed.distance(&pooled) < 1e-6);
    // One law moved along one axis of a covariance that is nearly 1.
    let wide: Vec<Features> = (0..20_000).map(|_| std::array::from_fn(|_| stream.normal())).collect();
    let law = Moments::of(&wide).law().expect("patches");
    let mut moved = law.clone();
    moved.mean[3] += 2.0;
    assert!((law.distance(&moved) - 2.0).abs() < 0.05, "{}", law.distance(&moved));
    assert!(Moments::of(&patches[..1]).law().is_none());
}

#[test]
fn only_sharp_patches_make_the_model_and_flat_ones_are_counted() {
    let niqe = Niqe::new();
    // Four patches: strong noise, weak noise, nothing, strong noise.
    let noise = picture(64, 64, 3);
    let mut image = Image::new(64, 64, 3);
    for (x, y) in (0..64).flat_map(|y| (0..64).map(move |x| (x, y))) {
        let strength = [[1.0, 0.2], [0.0, 1.0]][y / 32][x / 32];
        let value = noise.pixel(x, y)[0] * strength;
        image.pixel_mut(x, y).copy_from_slice(&[value; 3]);
    }
    let patches = niqe.patches(&image, 32);
    assert_eq!((patches.features.len() + patches.flat, patches.sharp().count()), (4, 2));
    let black = niqe.patches(&Image::new(64, 64, 3), 32);
    assert_eq!((black.features.len(), black.flat), (0, 4));
}

#[test]
fn small_images_have_small_patches() {
    assert_eq!([16, 31, 32, 64, 190, 192, 512].map(patch_side), [8, 14, 16, 32, 94, 96, 96]);
    assert!(!stands_alone(191) && stands_alone(192));
}
