//! Materials beyond what surfaces can do, which are refused; and the few values that are cut on purpose, with what that
//! loses.

use super::{
    Hazard, data, held,
    rendering::{Add, difference, furnace, glass, rendered, world},
    scenes::{Built, floor_point},
};
use tauflow_contract::Digest;
use tauflow_data::{
    Image,
    mesh::Mesh,
    scene::{Bsdf, Geometry, IDENTITY, Texture},
};
use tauflow_denoise::{GuidedFilterParams, filtered};

const AREA: &str = "Materials and clamping";

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    numbers(&mut add);
    textures(&mut add);
    cuts(&mut add);
    imports(&mut add);
    filters(&mut add);
    out
}

fn diffuse(value: f32) -> Bsdf {
    Bsdf::Diffuse { reflectance: Texture::scalar(value) }
}

fn metal(eta: f32, k: f32, tint: f32) -> Bsdf {
    Bsdf::Conductor { eta: [eta; 3], k: [k; 3], alpha: 0.1, specular_reflectance: Texture::scalar(tint) }
}

fn plastic(base: f32) -> Bsdf {
    Bsdf::Plastic { diffuse_reflectance: Texture::scalar(base), int_ior: 1.5, ext_ior: 1.0, alpha: 0.1 }
}

/// A principled surface of these: base colour, metallic, roughness, transmission.
fn textured([base, metallic, roughness, transmission]: [f32; 4]) -> Bsdf {
    principled([base, metallic, roughness, transmission], [0.5, 0.5, 0.5])
}

/// A principled surface of those, and specular level, clearcoat and its gloss.
fn principled(textures: [f32; 4], [specular, clearcoat, clearcoat_gloss]: [f32; 3]) -> Bsdf {
    let [base_color, metallic, roughness, spec_trans] = textures.map(Texture::scalar);
    Bsdf::Principled { base_color, metallic, roughness, specular, spec_trans, clearcoat, clearcoat_gloss }
}

/// What a scene of a floor and this material says: it must name what is wrong, where, and what to do.
fn refused(built: &Built, words: &[&str]) -> Result<String, String> {
    match world(built) {
        Ok(_) => Err("accepted".into()),
        Err(told) => {
            held(words.iter().all(|word| told.contains(word)), told).map(|_| "refused, with place and remedy".into())
        }
    }
}

fn of(bsdf: Bsdf) -> Built {
    furnace(bsdf, 4)
}

fn numbers(add: Add<'_>) {
    let tinted = |reflectance: f32, transmittance: f32| Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: Texture::scalar(reflectance),
        specular_transmittance: Texture::scalar(transmittance),
    };
    let pane = |reflectance: f32, transmittance: f32| Bsdf::ThinDielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        specular_reflectance: Texture::scalar(reflectance),
        specular_transmittance: Texture::scalar(transmittance),
    };
    let mask = |opacity: f32| Bsdf::Mask { opacity: Texture::scalar(opacity), inner: Box::new(diffuse(0.5)) };
    let blend = |weight: f32| Bsdf::Blend {
        weight: Texture::scalar(weight),
        a: Box::new(diffuse(0.5)),
        b: Box::new(metal(0.0, 3.0, 1.0)),
    };
    type Make<'a> = &'a dyn Fn(f32) -> Bsdf;
    let fields: [(&str, Make<'_>); 19] = [
        ("reflectance", &diffuse),
        ("specular_reflectance", &|v| metal(0.0, 3.0, v)),
        ("specular_reflectance", &|v| tinted(v, 1.0)),
        ("specular_transmittance", &|v| tinted(1.0, v)),
        ("specular_reflectance", &|v| pane(v, 1.0)),
        ("specular_transmittance", &|v| pane(1.0, v)),
        ("diffuse_reflectance", &plastic),
        ("base_color", &|v| textured([v, 0.0, 0.5, 0.0])),
        ("metallic", &|v| textured([0.5, v, 0.5, 0.0])),
        ("roughness", &|v| textured([0.5, 0.0, v, 0.0])),
        ("spec_trans", &|v| textured([0.5, 0.0, 0.5, v])),
        ("specular", &|v| principled([0.5; 4], [v, 0.5, 0.5])),
        ("clearcoat", &|v| principled([0.5; 4], [0.5, v, 0.5])),
        ("clearcoat_gloss", &|v| principled([0.5; 4], [0.5, 0.5, v])),
        ("opacity", &mask),
        ("weight", &blend),
        ("alpha", &|v| glass(1.5, v)),
        ("eta", &|v| metal(if v > 1.0 { f32::INFINITY } else { v }, 3.0, 1.0)),
        ("k", &|v| metal(0.2, if v > 1.0 { f32::INFINITY } else { v }, 1.0)),
    ];
    for value in [1.5f32, -0.5, f32::NAN] {
        let came = fields.iter().try_for_each(|(field, make)| {
            let found = match world(&of(make(value))) {
                Ok(_) => Err("accepted".to_owned()),
                Err(told) => {
                    let where_ = told.contains("material 0: ") && told.contains(field);
                    held(where_ && (told.contains("0 to 1") || told.contains("use ")), told)
                }
            };
            let found = found.map_err(|told| format!("{field}: {told}"));
            // What lies within must be taken, or the field is refused for nothing.
            found.and_then(|_| world(&of(make(0.75))).map(|_| ()).map_err(|told| format!("{field} of 0.75: {told}")))
        });
        let what = if value > 1.0 { "1.5 (of `eta` and `k` infinity)".to_owned() } else { value.to_string() };
        add(
            format!(
                "each number of each material, 19 in all, at {what}: reflectances, transmittances, metallic, \
                 roughness, transmission, specular, clearcoat, opacity, weights, indices of metals"
            ),
            "refused, with material, field and remedy; and 0.75 is accepted",
            came.map(|()| "each refused, with place and remedy; 0.75 accepted for each".into()),
        );
    }
}

/// The ball with an image on it, whose last texel is this.
fn painted(texel: f32, scale: f32) -> Built {
    let mut built = of(diffuse(0.5));
    let mut image = Image::from_data(2, 1, 3, vec![0.25; 6]).expect("fits");
    image.pixel_mut(1, 0)[2] = texel;
    let bytes = image.to_bytes();
    let digest = Digest::of(&bytes);
    built.blobs.insert(digest, bytes);
    let uv = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let reflectance = Texture::Bitmap { image: digest, uv, scale: [scale; 3], channel: None, clamp: false };
    built.scene.materials[0] = Bsdf::Diffuse { reflectance };
    built
}

fn textures(add: Add<'_>) {
    for value in [1.5f32, -0.1, f32::NAN, f32::INFINITY] {
        add(
            format!("an albedo texture with one texel of {value}"),
            "refused, with material, field and remedy",
            refused(&painted(value, 1.0), &["material 0: ", "`reflectance`", "texels"]),
        );
    }
    let came = refused(&painted(0.5, 3.0), &["material 0: ", "`reflectance`", "up to 1.5", "`scale`"]);
    let came = came.and_then(|said| {
        let second = rendered(&painted(1.5, 0.5), 4, 4, 4).map_err(|told| format!("the second: {told}"));
        second.map(|_| format!("the first {said}; the second accepted and rendered"))
    });
    add(
        "an albedo texture of 0.5 scaled by 3; one of 1.5 scaled by 0.5".into(),
        "the first is refused, the second accepted",
        came,
    );
    let corners = |value: f32| Mesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2]],
        colors: Some(vec![[0.5, 0.5, value, 1.0]; 3]),
        ..Mesh::default()
    };
    let colored = |value: f32, emission: bool| {
        let mut built = floor_point();
        let color = Texture::VertexColor { scale: [1.0; 3], channel: None };
        let material = if emission { diffuse(0.5) } else { Bsdf::Diffuse { reflectance: color.clone() } };
        let material = built.material(material);
        built.mesh(&corners(value), IDENTITY, material).emission = emission.then_some(color);
        built
    };
    let came = refused(&colored(1.5, false), &["shape ", "vertex colours", "not from 0 to 1"])
        .and_then(|said| refused(&colored(f32::NAN, true), &["shape ", "not finite"]).map(|_| said))
        .and_then(|said| {
            rendered(&colored(1.5, true), 4, 4, 4).map(|_| format!("two {said}; the third accepted and rendered"))
        });
    add(
        "vertex colours of 1.5 as albedo; of NaN as emission; of 1.5 as emission".into(),
        "refused, with the shape; refused; accepted",
        came,
    );
    let shining = |texel: f32| {
        let mut built = painted(texel, 1.0);
        let Bsdf::Diffuse { reflectance } = built.scene.materials[0].clone() else { return built };
        built.scene.materials[0] = diffuse(0.5);
        built.shape(Geometry::Rectangle, IDENTITY, 0).emission = Some(reflectance);
        built
    };
    let came = refused(&shining(f32::NAN), &["shape 1: ", "emission", "not finite"])
        .and_then(|said| refused(&shining(-1.0), &["shape 1: ", "negative emission"]).map(|_| said))
        .and_then(|said| {
            rendered(&shining(1e6), 4, 4, 4).map(|_| format!("two {said}; the third accepted and rendered"))
        });
    add("an emission texture with a texel of NaN, of -1, of 1e6".into(), "refused; refused; accepted", came);
}

/// What is cut where a surface is shaded, and what that changes.
fn cuts(add: Add<'_>) {
    let mut pair = |fed: &str, must: &str, [given, counts_as, other]: [Bsdf; 3]| {
        let image = |bsdf: Bsdf| rendered(&of(bsdf), 8, 8, 64);
        let came = image(given).and_then(|given| {
            let off = difference(&given, &image(counts_as)?);
            // Were nothing to show in this scene, the row could not fail.
            let seen = difference(&given, &image(other)?);
            held(off == 0.0 && seen > 0.0, format!("largest difference {off}"))
        });
        add(fed.into(), must, came);
    };
    pair(
        "an albedo of 1 + 2^-23, as products of textures can round",
        "accepted and clamped: the image of albedo 1",
        [diffuse(1.0 + f32::EPSILON), diffuse(1.0), diffuse(0.999)],
    );
    pair(
        "a principled metal of roughness 0",
        "the image of roughness 0.0316, an alpha of 0.001, as in Mitsuba",
        [textured([0.9, 1.0, 0.0, 0.0]), textured([0.9, 1.0, 0.0316, 0.0]), textured([0.9, 1.0, 0.1, 0.0])],
    );
    let level = |specular: f32| principled([0.5, 0.0, 0.3, 0.0], [specular, 0.0, 0.5]);
    pair(
        "a principled surface of specular level 0",
        "the image of level 0.001, as in Mitsuba",
        [level(0.0), level(0.001), level(0.1)],
    );
    let mapped = |normal: [f32; 3]| Bsdf::NormalMap {
        map: Texture::rgb(normal),
        scale: 1.0,
        inner: Box::new(metal(0.0, 3.0, 1.0)),
    };
    pair(
        "a normal map that points straight below the surface",
        "the image of a normal map that points straight up: the normal is raised to 0.001 above the surface",
        [mapped([0.5, 0.5, 0.0]), mapped([0.5, 0.5, 1.0]), mapped([0.9, 0.5, 0.9])],
    );
}

/// Objects whose factors the format does not allow.
fn imports(add: Add<'_>) {
    let gltf = |base: &str, rest: &str| {
        format!(
            r#"{{ "asset": {{ "version": "2.0" }}, "scenes": [{{ "nodes": [0] }}], "nodes": [{{ "mesh": 0 }}],
            "buffers": [{{ "byteLength": 36,
                "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA" }}],
            "bufferViews": [{{ "buffer": 0, "byteLength": 36 }}],
            "accessors": [{{ "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3 }}],
            "meshes": [{{ "primitives": [{{ "attributes": {{ "POSITION": 0 }}, "material": 0 }}] }}],
            "materials": [{{ "pbrMetallicRoughness": {{ "baseColorFactor": {base} }} {rest} }}] }}"#
        )
    };
    let came = data::import("wild.gltf", gltf("[2, 0.5, -1, 1]", "").as_bytes()).and_then(|(report, _, body)| {
        let count = report.repairs.values().sum::<u64>();
        let calm = data::import("calm.gltf", gltf("[1, 0.5, 0, 1]", "").as_bytes())?;
        let clean = calm.0.repairs.is_empty() && calm.2.is_some();
        held(
            body.is_some() && count == 2 && clean,
            format!("both imported: {count} factors of the first clamped and counted, none of the second"),
        )
    });
    add(
        "a glTF material of base colour 2, 0.5, -1; and one of 1, 0.5, 0".into(),
        "imported, with the clamped factors counted in the report; nothing clamped",
        came,
    );
    let rest = r#", "emissiveFactor": [1, 1, 1],
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 1e9 },
            "KHR_materials_ior": { "ior": 2.4 } }"#;
    let came = data::import("bright.gltf", gltf("[1, 1, 1, 1]", rest).as_bytes()).and_then(|(report, _, body)| {
        let noted = report.notes.iter().any(|note| note.contains("reflect 8%"));
        let cut = report.repairs.get("radiances outside of 0 to 1e6 cut to it") == Some(&3);
        held(body.is_some() && noted && cut, "3 radiances clamped and counted; the index noted".into())
    });
    add(
        "a glTF emission of 1e9, and an index of refraction of 2.4, beyond the range of `principled`".into(),
        "a radiance of 1e6, counted; an index of 1.79, noted: 8% of the light reflected at normal incidence, instead \
         of 17%",
        came,
    );
}

fn filters(add: Add<'_>) {
    let image = |left: f32, right: f32| {
        let data = (0..16 * 16).flat_map(|at| [if at % 16 < 8 { left } else { right }; 3]).collect();
        Image::from_data(16, 16, 3, data).expect("fits")
    };
    let params = GuidedFilterParams { colour: Some(0.2), ..GuidedFilterParams::default() };
    let params = GuidedFilterParams { demodulate: false, ..params };
    let given = image(-100.0, 0.0);
    let came = filtered(&given, None, &params).map_err(|e| e.to_string()).and_then(|out| {
        let off = out.data().iter().zip(given.data()).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
        held(off < 1.0, format!("off by {} of 100", super::about(off)))
    });
    add(
        "an image of -100 next to 0, filtered by colour".into(),
        "both unchanged, to 1%: negative values are not treated as black",
        came,
    );
    let came = match filtered(&image(1.0, f32::NAN), None, &params) {
        Err(told) => held(told.to_string().contains("384 of the 768"), "refused, with their number".into()),
        Ok(_) => Err("accepted".into()),
    };
    add("an image in which half of the values are not finite, filtered".into(), "refused with a specific error", came);
}
