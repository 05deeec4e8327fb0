//! Surfaces and environment maps have the values that Mitsuba 3 gives them (`mitsuba/values.py` asked it).

use glam::{Vec2, Vec3, Vec4};
use serde::Deserialize;
use std::sync::Arc;
use tauflow_contract::Digest;
use tauflow_data::{
    Image,
    scene::{self, Affine, Bsdf, Emitter},
};
use tauflow_render::{
    bsdf::{Material, Surface},
    environment::Environment,
    texture::Texture,
};

const AT: Surface = Surface { uv: Vec2::ZERO, color: Vec4::ONE };

#[derive(Deserialize)]
struct Values {
    mitsuba: String,
    smooth: Vec<Compared<Pair>>,
    delta: Vec<Compared<Draw>>,
    environment: EnvironmentCase,
    image: Texels,
    textures: Vec<Read>,
}

#[derive(Deserialize)]
struct Compared<T> {
    name: String,
    bsdf: Bsdf,
    cases: Vec<T>,
}

#[derive(Deserialize)]
struct Pair {
    wo: [f32; 3],
    wi: [f32; 3],
    value: [f32; 3],
}

#[derive(Deserialize)]
struct Draw {
    wo: [f32; 3],
    lobe: f32,
    wi: [f32; 3],
    value: [f32; 3],
}

#[derive(Deserialize)]
struct EnvironmentCase {
    width: usize,
    height: usize,
    pixels: Vec<f32>,
    scale: f32,
    to_world: Affine,
    cases: Vec<Look>,
}

#[derive(Deserialize)]
struct Look {
    direction: [f32; 3],
    value: [f32; 3],
}

#[derive(Deserialize)]
struct Texels {
    columns: usize,
    rows: usize,
    texels: Vec<f32>,
}

#[derive(Deserialize)]
struct Read {
    texture: scene::Texture,
    cases: Vec<At>,
}

#[derive(Deserialize)]
struct At {
    uv: [f32; 2],
    value: [f32; 3],
}

fn values() -> Values {
    let values: Values = serde_json::from_str(include_str!("mitsuba/values.json")).expect("a sound file");
    assert_eq!(values.mitsuba, "3.9.1");
    values
}

fn unit(v: [f32; 3]) -> Vec3 {
    Vec3::from_array(v).normalize()
}

fn material(bsdf: &Bsdf) -> Material {
    Material::compile(bsdf, &mut |_| unreachable!("no images here")).expect("sound numbers")
}

/// Largest difference, relative to the value or to a thousandth.
fn off(found: Vec3, expected: [f32; 3]) -> f32 {
    let expected = Vec3::from_array(expected);
    ((found - expected).abs() / expected.abs().max(Vec3::splat(1e-3))).max_element()
}

#[test]
fn smooth_lobes_have_mitsubas_values() {
    let mut failures = Vec::new();
    for of in values().smooth {
        let material = material(&of.bsdf);
        let bsdf = material.at(&AT);
        // Mitsuba integrates the coat's transmittance numerically, and so do we, over other points.
        let limit = if of.name.ends_with("plastic") { 5e-4 } else { 2e-5 };
        for case in &of.cases {
            let found = bsdf.eval(unit(case.wo), unit(case.wi));
            let off = off(found, case.value);
            if off > limit {
                failures.push(format!("{}: {:?} {:?}: {found} {:?}", of.name, case.wo, case.wi, case.value));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn specular_lobes_go_where_mitsubas_go() {
    for of in values().delta {
        let material = material(&of.bsdf);
        for case in &of.cases {
            let sample = material.at(&AT).sample(unit(case.wo), case.lobe, Vec2::new(0.3, 0.6));
            let what = format!("{} {:?} {}: {sample:?} {:?}", of.name, case.wo, case.lobe, case.value);
            let Some(sample) = sample else {
                assert_eq!(case.value, [0.0; 3], "{what}");
                continue;
            };
            assert!(sample.delta && sample.pdf == 0.0, "{what}");
            assert!((sample.wi - Vec3::from_array(case.wi)).length() < 1e-5, "{what}");
            assert!(off(sample.weight, case.value) < 1e-4, "{what}");
        }
    }
}

#[test]
fn environment_maps_have_mitsubas_values() {
    let map = values().environment;
    let image = Image::from_data(map.width, map.height, 3, map.pixels).expect("fits");
    let emitter = Emitter::Envmap { image: Digest::of(b"map"), scale: map.scale, to_world: map.to_world };
    let environment = Environment::compile(&emitter, &mut |_| Ok(Arc::new(image.clone().into()))).expect("a sound map");
    for case in &map.cases {
        let found = environment.look(unit(case.direction)).0;
        assert!(off(found, case.value) < 1e-4, "{:?}: {found} {:?}", case.direction, case.value);
    }
}

#[test]
fn textures_have_mitsubas_values() {
    let Values { image, textures, .. } = values();
    let image = Image::from_data(image.columns, image.rows, 3, image.texels).expect("fits");
    for read in textures {
        let texture =
            Texture::compile(&read.texture, &mut |_| Ok(Arc::new(image.clone().into()))).expect("a sound texture");
        for at in &read.cases {
            let found = texture.eval(&Surface { uv: Vec2::from_array(at.uv), ..AT });
            assert!(off(found, at.value) < 1e-4, "{:?} {:?}: {found} {:?}", read.texture, at.uv, at.value);
        }
    }
}
