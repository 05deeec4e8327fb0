//! Tests of materials by stuff: what each regime may hold, shares within bounds, real sizes, shared blobs.

use super::*;
use crate::stuff::Stuff;
use std::{collections::BTreeSet, sync::atomic::AtomicBool};
use stored::{Facts, Stored};
use surface::Place;
use tauflow_contract::{Blobs, Digest, MemoryBlobs, Silent};
use tauflow_data::{
    Image, Regime,
    rng::Stream,
    scene::{Rgb, Texture},
};

const ALL: [Stuff; 35] = [
    Stuff::Wood,
    Stuff::Bark,
    Stuff::Stone,
    Stuff::Concrete,
    Stuff::Brick,
    Stuff::Plaster,
    Stuff::Tile,
    Stuff::Wallpaper,
    Stuff::Fabric,
    Stuff::Carpet,
    Stuff::Leather,
    Stuff::Paper,
    Stuff::Print,
    Stuff::Metal,
    Stuff::PaintedMetal,
    Stuff::Plastic,
    Stuff::Rubber,
    Stuff::Ceramic,
    Stuff::Clay,
    Stuff::Pane,
    Stuff::Glass,
    Stuff::Mirror,
    Stuff::Water,
    Stuff::Leaf,
    Stuff::Grass,
    Stuff::Soil,
    Stuff::Sand,
    Stuff::Asphalt,
    Stuff::Snow,
    Stuff::Wax,
    Stuff::Food,
    Stuff::Glow,
    Stuff::Screen,
    Stuff::Metal,
    Stuff::Metal,
];

fn with<R>(blobs: &MemoryBlobs, ranges: &Ranges, f: impl FnOnce(&Materials<'_, '_>) -> R) -> R {
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &cancel);
    f(&Materials { ctx: &ctx, ranges, palette: Palette::new(&mut Stream::new(11, &[])) })
}

/// Every texture that is a share of light, with its channels, and every lobe by name.
fn walk(bsdf: &Bsdf, lobes: &mut BTreeSet<&'static str>, shares: &mut Vec<Texture>) {
    match bsdf {
        Bsdf::Diffuse { reflectance } => {
            lobes.insert("diffuse");
            shares.push(reflectance.clone());
        }
        Bsdf::Conductor { alpha, specular_reflectance, .. } => {
            lobes.insert(if *alpha < tauflow_data::scene::DELTA_ALPHA { "mirror" } else { "conductor" });
            shares.push(specular_reflectance.clone());
        }
        Bsdf::Dielectric { alpha, specular_transmittance, .. } => {
            lobes.insert(if *alpha < tauflow_data::scene::DELTA_ALPHA { "clear" } else { "frosted" });
            shares.push(specular_transmittance.clone());
        }
        Bsdf::ThinDielectric { specular_transmittance, .. } => {
            lobes.insert("pane");
            shares.push(specular_transmittance.clone());
        }
        Bsdf::Plastic { diffuse_reflectance, .. } => {
            lobes.insert("plastic");
            shares.push(diffuse_reflectance.clone());
        }
        Bsdf::Principled { base_color, metallic, roughness, spec_trans, .. } => {
            lobes.insert("principled");
            assert_eq!(*spec_trans, Texture::scalar(0.0));
            shares.extend([base_color, metallic, roughness].map(Clone::clone));
        }
        Bsdf::Mask { .. } => panic!("no stuff is cut out"),
        Bsdf::Finish { .. } | Bsdf::Relief { .. } => panic!("only scene files have these"),
        Bsdf::Blend { weight, a, b } => {
            shares.push(weight.clone());
            for part in [a, b] {
                assert!(!matches!(**part, Bsdf::NormalMap { .. } | Bsdf::Mask { .. }), "inside a blend");
                walk(part, lobes, shares);
            }
        }
        Bsdf::NormalMap { inner, scale, .. } => {
            assert!((0.0..=1.2).contains(scale));
            walk(inner, lobes, shares);
        }
        Bsdf::TwoSided { inner } => {
            assert!(!matches!(**inner, Bsdf::Dielectric { .. } | Bsdf::ThinDielectric { .. }));
            walk(inner, lobes, shares);
        }
    }
}

/// Mean and largest value of each channel.
fn measured(blobs: &MemoryBlobs, texture: &Texture) -> ([f64; 3], [f64; 3]) {
    match texture {
        Texture::Constant { value } => (value.map(f64::from), value.map(f64::from)),
        Texture::Bitmap { image, scale, .. } => {
            let image = Image::from_bytes(&blobs.get(image).expect("in memory").expect("stored")).expect("a bitmap");
            let facts = Facts::of(&crate::textures::Maps { roughness: image.clone(), color: image, normal: None });
            let k = scale.map(f64::from);
            ([0, 1, 2].map(|c| k[c] * facts.mean[c]), [0, 1, 2].map(|c| k[c] * facts.most[c]))
        }
        other => panic!("{other:?}"),
    }
}

fn lobes_of(regime: Regime) -> &'static [&'static str] {
    match regime {
        Regime::L0 => &["diffuse"],
        Regime::L1 => &["diffuse", "plastic", "conductor", "principled"],
        Regime::L2 => &["diffuse", "plastic", "principled", "frosted", "pane"],
        Regime::L3 => &["diffuse", "plastic", "principled", "conductor", "clear", "mirror", "pane"],
    }
}

#[test]
fn each_regime_holds_its_lobes_and_all_shares_are_shares() {
    let blobs = MemoryBlobs::default();
    let ranges = Ranges::default();
    with(&blobs, &ranges, |materials| {
        for regime in Regime::ALL {
            let mut seen = BTreeSet::new();
            for (number, stuff) in ALL.into_iter().enumerate() {
                for (special, per_metre) in [(false, [1.0; 2]), (true, [1.0; 2]), (false, [0.25, 0.4])] {
                    let mut draw = Stream::new(7, &[number as u64]).part(&format!("{special} {per_metre:?}"));
                    let bsdf = materials.stuff(stuff, regime, special, per_metre, &mut draw).expect("stored");
                    let (mut lobes, mut shares) = (BTreeSet::new(), Vec::new());
                    walk(&bsdf, &mut lobes, &mut shares);
                    let name = format!("{stuff:?} {regime} {special}: {lobes:?}");
                    assert!(lobes.iter().all(|l| lobes_of(regime).contains(l)), "{name}");
                    for share in &shares {
                        let (_, most) = measured(&blobs, share);
                        assert!(most.iter().all(|m| (0.0..=1.0 + 1e-6).contains(m)), "{name} {share:?} {most:?}");
                    }
                    let shows: &[&str] = match (regime, special, stuff) {
                        (Regime::L1, true, Stuff::Wood | Stuff::Fabric | Stuff::Stone) => &["plastic", "principled"],
                        (Regime::L2, _, Stuff::Glass) | (Regime::L2, true, Stuff::Clay) => &["frosted"],
                        (Regime::L3, _, Stuff::Glass) | (Regime::L3, true, Stuff::Ceramic) => &["clear"],
                        (Regime::L3, _, Stuff::Mirror) | (Regime::L3, true, Stuff::Metal) => &["mirror"],
                        (Regime::L3, _, Stuff::Water) => &["clear"],
                        (Regime::L2 | Regime::L3, _, Stuff::Pane) => &["pane"],
                        _ => &[],
                    };
                    assert!(shows.is_empty() || shows.iter().any(|s| lobes.contains(s)), "{name}");
                    seen.extend(lobes);
                }
            }
            assert_eq!(seen, lobes_of(regime).iter().copied().collect(), "{regime}");
        }
    });
}

#[test]
fn mean_albedos_lie_within_the_range_but_for_what_is_black_or_white() {
    let blobs = MemoryBlobs::default();
    for range in [[0.2, 0.8], [0.4, 0.5]] {
        let mut ranges = Ranges::default();
        ranges.diffuse.albedo = range;
        with(&blobs, &ranges, |materials| {
            for stuff in ALL {
                if matches!(
                    stuff,
                    Stuff::Asphalt
                        | Stuff::Soil
                        | Stuff::Snow
                        | Stuff::Rubber
                        | Stuff::Print
                        | Stuff::Screen
                        | Stuff::Glow
                        | Stuff::Grass
                        | Stuff::Metal
                ) {
                    continue;
                }
                for index in 0..4 {
                    // A form, so that no dirt lies on it.
                    let mut draw = Stream::new(9, &[index]);
                    let bsdf = materials.stuff(stuff, Regime::L0, false, [1.0; 2], &mut draw).expect("stored");
                    let (mut lobes, mut shares) = (BTreeSet::new(), Vec::new());
                    walk(&bsdf, &mut lobes, &mut shares);
                    let (mean, most) = measured(&blobs, &shares[0]);
                    let level = mean.iter().fold(0.0f64, |m, v| m.max(*v));
                    // A bright texel may keep a contrasty map below its level.
                    let low = if most.iter().any(|m| *m > 0.95) { 0.0 } else { range[0] };
                    assert!((low - 1e-3..=range[1] + 1e-3).contains(&level), "{stuff:?} {range:?}: {level}");
                }
            }
        });
    }
}

#[test]
fn maps_have_their_real_size_on_forms_and_rectangles() {
    let period = [2.0, 1.92];
    // On a form one metre of uv is one metre.
    let [row, _] = Place::Repeated([1.0; 2]).matrix(period, [0.0; 2]);
    assert!((row[0] * 2.0 - 1.0).abs() < 1e-12);
    // A wall of 6 m has uv from 0 to 1: three periods.
    let [row, column] = Place::Repeated([1.0 / 6.0, 1.0 / 3.0]).matrix(period, [0.25, 0.0]);
    assert!((row[0] - 3.0).abs() < 1e-12 && (row[2] - 0.25).abs() < 1e-12);
    assert!((column[1] - 3.0 / 1.92).abs() < 1e-12);
    // A picture over a rectangle stands upright: v = 1 is row 0.
    let [row, column] = Place::Once([[0.0, 1.0], [1.0, 0.0]]).matrix(period, [0.0; 2]);
    let at = |r: [f64; 3], u: f64, v: f64| r[0] * u + r[1] * v + r[2];
    assert_eq!((at(row, 0.25, 1.0), at(column, 0.25, 1.0), at(column, 0.25, 0.0)), (0.25, 0.0, 1.0));
    // The sixth of sixteen parts.
    let [row, column] = Place::part([[1.0, 2.0], [1.5, 3.0]], 4, 5).matrix(period, [0.0; 2]);
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    near(at(row, 1.0, 2.0), 0.25);
    near(at(row, 1.5, 2.0), 0.5);
    near(at(column, 1.0, 2.0), 0.25);
    near(at(column, 1.0, 3.0), 0.5);
}

#[test]
fn light_has_the_radiance_that_is_asked_for() {
    let blobs = MemoryBlobs::default();
    let ranges = Ranges::default();
    with(&blobs, &ranges, |materials| {
        let radiance: Rgb = [3.0, 2.0, 1.0];
        let mut textured = 0;
        for index in 0..6 {
            for stuff in [Stuff::Screen, Stuff::Glow] {
                let texture = materials.glow(stuff, &mut Stream::new(1, &[index]), radiance).expect("stored");
                let (mean, _) = measured(&blobs, &texture);
                let share = [0, 1, 2].map(|c| mean[c] / f64::from(radiance[c]));
                let luminance = 0.2126 * share[0] + 0.7152 * share[1] + 0.0722 * share[2];
                assert!((luminance - 1.0).abs() < 1e-4, "{stuff:?} {index}: {luminance}");
                textured += u32::from(matches!(texture, Texture::Bitmap { .. }));
            }
        }
        assert!(textured >= 7, "{textured}");
    });
}

#[test]
fn maps_are_made_once_a_store_and_shared() {
    let blobs = MemoryBlobs::default();
    let ranges = Ranges::default();
    with(&blobs, &ranges, |materials| {
        let pattern = crate::textures::Pattern::of("leaf");
        let first = Stored::of(materials.ctx, pattern, 2).expect("made");
        let again = Stored::of(materials.ctx, pattern, 2).expect("found");
        assert_eq!(first, again);
        let maps = pattern.maps(2);
        assert_eq!(first.facts, Facts::of(&maps));
        assert_eq!(first.color, Digest::of(&maps.color.to_small_bytes()));
        // Many scenes: the blobs are those of few variants.
        let mut digests = Vec::new();
        for index in 0..60 {
            let mut draw = Stream::new(3, &[index]);
            let bsdf = materials.stuff(Stuff::Leaf, Regime::L0, false, [1.0; 2], &mut draw).expect("stored");
            bsdf.images(&mut digests);
        }
        let distinct: BTreeSet<_> = digests.iter().map(ToString::to_string).collect();
        assert!(distinct.len() as u64 <= 2 * pattern.variants && distinct.len() > 4, "{}", distinct.len());
    });
}

#[test]
fn a_share_of_textures_of_0_gives_plain_surfaces() {
    let blobs = MemoryBlobs::default();
    let mut ranges = Ranges::default();
    ranges.diffuse.textured = 0.0;
    with(&blobs, &ranges, |materials| {
        for stuff in ALL.into_iter().filter(|s| *s != Stuff::Water) {
            for regime in Regime::ALL {
                let mut digests = Vec::new();
                let bsdf = materials.stuff(stuff, regime, false, [1.0; 2], &mut Stream::new(3, &[])).expect("stored");
                bsdf.images(&mut digests);
                assert!(digests.is_empty(), "{stuff:?} {regime}: {bsdf:?}");
            }
        }
    });
}
