//! Textures that cannot be read go with what their factors would do; second sets of coordinates are read where they
//! are a map of the first.

use crate::{default_pose::read, small_assets::Data};
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use serde_json::{Value, json as object};
use tauflow_data::{
    records::AssetBody,
    records::{AssetMaterial, AssetReport},
    scene::{Bsdf, Texture},
};

/// A picture of two texels, (255, 0, 51, 255) and (255, 0, 153, 51): the averages as stored are 1, 0, 0.4 and 0.6.
fn picture() -> Vec<u8> {
    let mut out = Vec::new();
    let texels = [255, 0, 51, 255, 255, 0, 153, 51];
    PngEncoder::new(&mut out).write_image(&texels, 2, 1, ExtendedColorType::Rgba8).expect("a picture");
    out
}

/// A square with sets of texture coordinates, in a material; its report and what it is made of.
fn square(name: &str, sets: &[[f32; 8]], material: Value) -> (AssetReport, AssetMaterial) {
    let mut data = Data::default();
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];
    let mut attributes = object!({ "POSITION": data.floats(&corners, "VEC3", 3) });
    for (number, set) in sets.iter().enumerate() {
        attributes[format!("TEXCOORD_{number}")] = object!(data.floats(set, "VEC2", 2));
    }
    let indices = data.accessor(&[0, 1, 2, 0, 2, 3], 5121, "SCALAR", 6, false);
    let image = data.view(&picture());
    let bytes = data.file(object!({ "materials": [material], "nodes": [{ "mesh": 0 }], "scenes": [{ "nodes": [0] }],
        "images": [{ "bufferView": image, "mimeType": "image/png" }], "textures": [{ "source": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }] }));
    let (report, asset, _) = read(name, &bytes);
    let AssetBody::Object { mut materials, .. } = asset.body else { panic!("no object") };
    (report, materials.remove(0))
}

const PLAIN: [f32; 8] = [0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0];

/// Three corners as they are, and one elsewhere: no map.
const BENT: [f32; 8] = [0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.5, 0.5];

/// (u, v) to (0.5 - 0.25 v, 0.25 + 0.5 u).
const ATLAS: [f32; 8] = [0.5, 0.25, 0.5, 0.75, 0.25, 0.75, 0.25, 0.25];

fn lamp() -> Value {
    object!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } }, "emissiveFactor": [4, 4, 4],
        "emissiveTexture": { "index": 0, "texCoord": 1 } })
}

#[test]
fn an_emissive_texture_on_a_set_that_cannot_be_read_takes_the_glow_along() {
    let (report, material) = square("dark", &[PLAIN, BENT], lamp());
    assert_eq!(material.emission, None);
    let note = "textures of emission on a second set of coordinates are left out with their effect";
    assert!(report.notes.iter().any(|n| n == note), "{report:?}");
    // Without a second set, too; and where the texture is the only one its set is the first.
    assert_eq!(square("darker", &[PLAIN], lamp()).1.emission, None);
    let alone = object!({ "emissiveFactor": [4, 4, 4], "emissiveTexture": { "index": 0, "texCoord": 1 } });
    let (report, material) = square("alone", &[BENT, PLAIN], alone);
    assert!(matches!(material.emission, Some(Texture::Bitmap { scale, .. }) if scale == [4.0; 3]), "{material:?}");
    assert!(report.notes.is_empty(), "{report:?}");
}

#[test]
fn a_second_set_that_is_a_map_of_the_first_is_read() {
    let (report, material) = square("atlas", &[PLAIN, ATLAS], lamp());
    assert!(report.notes.is_empty(), "{report:?}");
    let Some(Texture::Bitmap { uv, .. }) = material.emission else { panic!("{material:?}") };
    let expected = [[0.0, -0.25, 0.5], [0.5, 0.0, 0.25]];
    let near = uv.iter().flatten().zip(expected.iter().flatten()).all(|(found, e)| (found - e).abs() < 1e-6);
    assert!(near, "{uv:?}");
    // A mesh that lacks the set of the most important texture keeps that of the next.
    let mut swapped = lamp();
    swapped["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = object!(5);
    let (report, material) = square("swapped", &[BENT, PLAIN], swapped);
    let Some(Texture::Bitmap { uv, .. }) = material.emission else { panic!("{material:?}") };
    assert_eq!(uv, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert!(report.notes.iter().any(|n| n.starts_with("textures of colour") && n.ends_with("averaged")), "{report:?}");
}

fn principled(bsdf: &Bsdf) -> (Texture, Texture, Texture, f32, f32) {
    let Bsdf::TwoSided { inner } = bsdf else { panic!("{bsdf:?}") };
    let Bsdf::Principled { base_color, metallic, roughness, specular, clearcoat, .. } = &**inner else {
        panic!("{bsdf:?}")
    };
    (base_color.clone(), metallic.clone(), roughness.clone(), *specular, *clearcoat)
}

fn constant(texture: &Texture, expected: [f64; 3]) {
    let Texture::Constant { value } = texture else { panic!("{texture:?}") };
    assert!(value.iter().zip(expected).all(|(v, e)| (f64::from(*v) - e).abs() < 1e-6), "{value:?}, not {expected:?}");
}

#[test]
fn colours_and_roughness_without_coordinates_are_averages() {
    let material = object!({ "alphaMode": "BLEND", "normalTexture": { "index": 0 },
        "pbrMetallicRoughness": { "baseColorFactor": [0.5, 1, 1, 0.5], "metallicFactor": 0.5, "roughnessFactor": 0.75,
            "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 0 } },
        "extensions": { "KHR_materials_specular": { "specularTexture": { "index": 0 } },
            "KHR_materials_clearcoat": { "clearcoatFactor": 1, "clearcoatTexture": { "index": 0 } } } });
    let (report, material) = square("averages", &[], material);
    let Bsdf::Mask { opacity, inner } = &material.own else { panic!("{material:?}") };
    constant(opacity, [0.3; 3]);
    let (color, metallic, roughness, specular, clearcoat) = principled(inner);
    // sRGB: 51 is ((0.2 + 0.055) / 1.055)^2.4 = 0.0331048, and 153 ((0.6 + 0.055) / 1.055)^2.4 = 0.3185468.
    constant(&color, [0.5, 0.0, 0.175_825_8]);
    constant(&metallic, [0.2; 3]);
    constant(&roughness, [0.0; 3]);
    assert!((specular - 0.3).abs() < 1e-6 && clearcoat == 0.0, "{specular} {clearcoat}");
    for what in ["colour", "metal and roughness", "opacity", "bumps", "specular reflection", "clearcoat"] {
        assert!(report.notes.iter().any(|n| n.starts_with(&format!("textures of {what} "))), "{what}: {report:?}");
    }
}

#[test]
fn holes_and_transmission_go_with_their_textures() {
    let material = object!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } },
        "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1,
            "transmissionTexture": { "index": 0 } } } });
    let (report, material) = square("whole", &[], material);
    assert!(matches!(material.own, Bsdf::TwoSided { .. }) && !material.transmissive, "{material:?}");
    for what in ["holes", "transmission"] {
        assert!(report.notes.iter().any(|n| n.starts_with(&format!("textures of {what} "))), "{what}: {report:?}");
    }
}

#[test]
fn coats_are_where_their_texture_says() {
    let coat = object!({ "clearcoatFactor": 0.5, "clearcoatTexture": { "index": 0 }, "clearcoatRoughnessFactor": 0.5,
        "clearcoatRoughnessTexture": { "index": 0 }, "clearcoatNormalTexture": { "index": 0 } });
    let (report, material) = square("coat", &[PLAIN], object!({ "extensions": { "KHR_materials_clearcoat": coat } }));
    let Bsdf::Blend { weight, a, b } = &material.own else { panic!("{material:?}") };
    assert!(matches!(weight, Texture::Bitmap { channel: Some(0), .. }), "{weight:?}");
    assert_eq!((principled(a).4, principled(b).4), (0.0, 0.5));
    let Bsdf::TwoSided { inner } = &**b else { panic!("{b:?}") };
    // The texture's green is 0: no roughness is left of the factor.
    assert!(matches!(**inner, Bsdf::Principled { clearcoat_gloss: 1.0, .. }), "{inner:?}");
    for what in ["clearcoat roughness are averaged", "bumps of clearcoats are left out"] {
        assert!(report.notes.iter().any(|n| n.contains(what)), "{what}: {report:?}");
    }
}

#[test]
fn gloss_and_thickness_are_averaged() {
    let glossy = object!({ "extensions": { "KHR_materials_pbrSpecularGlossiness": { "glossinessFactor": 0.5,
        "specularFactor": [0.06, 0.06, 0.06], "specularGlossinessTexture": { "index": 0 } } } });
    let (report, material) = square("gloss", &[PLAIN], glossy);
    let (_, _, roughness, specular, _) = principled(&material.own);
    // 1 - 0.5 * 0.6, and a mean of 0.06 (1 + 0 + 0.1758258) / 3 of F0 = 0.08 specular.
    constant(&roughness, [0.7; 3]);
    assert!((f64::from(specular) - 0.06 * 1.175_825_8 / 3.0 / 0.08).abs() < 1e-6, "{specular}");
    assert!(report.notes.iter().any(|n| n == "textures of specular colour and gloss are averaged"), "{report:?}");
}
