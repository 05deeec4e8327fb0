//! Small scenes that show much, or name the same again and again, beside those of [`crate::hostile_scenes`].

use crate::{
    fuzz::held_by,
    hostile_scenes::{mitsuba, pbrt, read, refused},
    small_assets::{Data, folder},
    support::{act, kind, load},
};
use serde_json::{Value, json};
use std::{collections::BTreeMap, fmt::Write as _, fs};
use tauflow_contract::MemoryBlobs;
use tauflow_data::records::AssetReport;
use tauflow_scene_readers::{Options, Setting, View, load_scene_in};

/// A glTF file of one triangle whose buffer has these URIs.
fn spelt(uris: &[String]) -> String {
    let buffers: Vec<Value> = uris.iter().map(|uri| json!({ "byteLength": 36, "uri": uri })).collect();
    json!({
        "asset": { "version": "2.0" },
        "scenes": [{ "nodes": [0, 1] }],
        "nodes": [{ "mesh": 0 }, { "camera": 0, "translation": [0, 0, 4] }],
        "cameras": [{ "type": "perspective", "perspective": { "yfov": 0.6, "znear": 0.1 } }],
        "extensions": { "KHR_lights_punctual": { "lights": [{ "type": "point" }] } },
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "buffers": buffers,
    })
    .to_string()
}

/// As many spellings of a file name as are asked for: each letter as it is, or by its number.
fn spellings(name: &str, count: usize) -> Vec<String> {
    let one = |bits: usize| {
        name.bytes().enumerate().fold(String::new(), |mut text, (i, letter)| {
            match bits >> i & 1 {
                0 => text.push(char::from(letter)),
                _ => write!(text, "%{letter:02x}").expect("in memory"),
            }
            text
        })
    };
    (0..count).map(one).collect()
}

#[test]
fn a_file_of_many_spellings_is_read_once() {
    let name = "abcdefghijklmn.bin";
    let scene = spelt(&spellings(name, 7000));
    let mut buffer: Vec<u8> = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].map(f32::to_le_bytes).concat();
    buffer.resize(500_000, 0);
    let place = folder("spellings");
    fs::write(place.join("a.gltf"), &scene).expect("writable");
    fs::write(place.join(name), &buffer).expect("writable");
    let setting = Setting {
        fallback: Some(tauflow_data::Image::from_data(2, 1, 3, vec![1.0; 6]).expect("fits")),
        ..Setting::camera(0)
    };
    let (loaded, held) = held_by(|| load_scene_in(&place.join("a.gltf"), None, &setting, Options::default()));
    assert_eq!(loaded.expect("a scene").scene.shapes.len(), 1);
    assert!(held < 1 << 26, "{held} bytes");
    // As an asset, it is one file, too.
    let (kind, blobs) = (kind("assets"), MemoryBlobs::default());
    let params = kind.resolve(&json!({ "files": [place.join("a.gltf")] })).expect("fine params");
    let items = kind.items(&params).expect("a file");
    assert_eq!(items[0].files.len(), 2);
    let outputs = act(&blobs, kind.as_ref(), &params, Some(&items[0]), BTreeMap::new()).expect("a report");
    let report: AssetReport = load(&blobs, &outputs.items["reports"]);
    assert!(report.accepted, "{:?}", report.reason);
}

/// A GLB whose mesh of so many primitives stands at places that no bytes hold.
fn instances(count: usize, primitives: usize) -> Vec<u8> {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3", 3);
    data.accessors.push(json!({ "componentType": 5126, "count": count, "type": "VEC3" }));
    let places = data.accessors.len() - 1;
    let primitive = json!({ "attributes": { "POSITION": positions } });
    data.file(json!({
        "extensionsUsed": ["EXT_mesh_gpu_instancing"],
        "meshes": [{ "primitives": vec![primitive; primitives] }],
        "nodes": [{ "mesh": 0,
            "extensions": { "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": places } } } }],
        "scenes": [{ "nodes": [0] }],
    }))
}

#[test]
fn instances_cost_what_the_file_holds() {
    let told = refused(&[("a.glb", &instances(1 << 20, 1))]);
    assert!(told.contains("1048576 instances: with those before more than 6") && told.contains("bytes; "), "{told}");
    let told = refused(&[("a.glb", &instances(1 << 16, 100))]);
    assert!(told.contains("more than 1048576 shapes, each copy of each primitive counted"), "{told}");
    // As many as are read are framed.
    let place = folder("instances");
    fs::write(place.join("a.glb"), instances(1 << 16, 10)).expect("writable");
    let sky = tauflow_data::Image::from_data(2, 1, 3, vec![1.0; 6]).expect("fits");
    let setting = Setting { view: View::Fit, fallback: Some(sky), ..Setting::camera(0) };
    let (loaded, held) = held_by(|| load_scene_in(&place.join("a.glb"), None, &setting, Options::default()));
    assert_eq!(loaded.expect("a scene").scene.shapes.len(), 10 << 16);
    assert!(held < 1 << 29, "{held} bytes");
}

#[test]
fn namespaces_are_refused_before_they_are_read() {
    let open: String = (0..3000).map(|i| format!("<a xmlns:b{i}=\"{i}\">")).collect();
    let told = refused(&[("a.xml", mitsuba(&(open + &"</a>".repeat(3000))).as_bytes())]);
    assert!(told.starts_with("a.xml: line 4: more than 16 namespaces"), "{told}");
    let few = "<shape type=\"cube\" xmlns:dc=\"about:blank\"/>";
    assert_eq!(read(&[("a.xml", mitsuba(few).as_bytes())]).map(|l| l.scene.shapes.len()), Ok(1));
}

fn hdr(side: usize) -> Vec<u8> {
    let mut file = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {side} +X {side}\n").into_bytes();
    let mut line = vec![2, 2, (side >> 8) as u8, side as u8];
    for value in [128, 128, 128, 129] {
        let mut left = side;
        while left > 0 {
            let run = left.min(127);
            line.extend([128 + run as u8, value]);
            left -= run;
        }
    }
    (0..side).for_each(|_| file.extend(&line));
    file
}

#[test]
fn large_maps_are_spread_quickly() {
    let scene = "Camera \"perspective\"\nWorldBegin\nLightSource \"infinite\" \"string filename\" \"p.hdr\"\nShape \
                 \"sphere\"\n";
    let loaded = read(&[("a.pbrt", scene.as_bytes()), ("p.hdr", &hdr(2000))]).expect("a scene");
    assert_eq!(loaded.scene.emitters.len(), 1);
}

/// BSDFs of a thousand parts: blends of blends.
fn blends() -> String {
    (1..=10).fold("<bsdf type=\"diffuse\" id=\"b0\"/>\n".to_owned(), |mut text, i| {
        let inner = format!("<ref id=\"b{}\"/>", i - 1);
        writeln!(text, "<bsdf type=\"blendbsdf\" id=\"b{i}\">{inner}{inner}</bsdf>").expect("in memory");
        text
    })
}

#[test]
fn materials_are_looked_through_once_however_often_they_are_shown() {
    let mesh = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                property float u\nproperty float v\nelement face 1\nproperty list uchar int vertex_indices\n\
                end_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n";
    let mapped = "<bsdf type=\"normalmap\"><rgb name=\"normalmap\" value=\".5 .5 1\"/><boolean \
                  name=\"flip_invalid_normals\" value=\"false\"/><boolean name=\"use_shadowing_function\" \
                  value=\"false\"/><ref id=\"b10\"/></bsdf>";
    let group = format!(
        "<shape type=\"shapegroup\" id=\"g\"><shape type=\"ply\"><string name=\"filename\" \
         value=\"t.ply\"/>{mapped}</shape></shape>\n"
    );
    let instances = "<shape type=\"instance\"><ref id=\"g\"/></shape>\n".repeat(20_000);
    let scene = mitsuba(&(blends() + &group + &instances));
    let loaded = read(&[("a.xml", scene.as_bytes()), ("t.ply", mesh.as_bytes())]).expect("a scene");
    assert_eq!((loaded.scene.shapes.len(), loaded.scene.materials.len()), (20_000, 2));
    // Passages through masks, of a path that ends.
    let plain = "<shape type=\"rectangle\"><ref id=\"b10\"/></shape>".repeat(1000);
    let group = format!("<shape type=\"shapegroup\" id=\"g\">{plain}</shape>");
    let instances = "<shape type=\"instance\"><ref id=\"g\"/></shape>\n".repeat(1000);
    let scene = mitsuba(&(blends() + &group + &instances));
    let ends = "<integrator type=\"path\"><integer name=\"max_depth\" value=\"5\"/></integrator>";
    let scene = scene.replace("<integrator type=\"path\"/>", ends);
    assert_eq!(read(&[("a.xml", scene.as_bytes())]).map(|l| l.scene.shapes.len()), Ok(1_000_000));
}

#[test]
fn what_is_given_once_and_unknown_is_told_once() {
    let many: String = (0..10_000).map(|i| format!("<float name=\"n{i}\" value=\"1\"/>")).collect();
    let group = format!("<shape type=\"shapegroup\" id=\"g\"><shape type=\"cube\">{many}</shape></shape>\n");
    let instances = "<shape type=\"instance\"><ref id=\"g\"/></shape>\n".repeat(12_000);
    let told = refused(&[("a.xml", mitsuba(&(group + &instances)).as_bytes())]);
    assert!(told.contains("the parameter `n0` of the shape `cube` is not supported"), "{told}");
    let points: String = (0..40_000).map(|i| format!("{:.2} 1 ", 300.0 + 0.01 * f64::from(i))).collect();
    let shapes = "Shape \"sphere\"\n".repeat(30_000);
    let world = format!("AreaLightSource \"diffuse\" \"spectrum L\" [{points}]\n{shapes}");
    assert_eq!(read(&[("a.pbrt", pbrt(&world).as_bytes())]).map(|l| l.scene.shapes.len()), Ok(30_000));
    let many: String = (0..30_000).map(|i| format!("\"float n{i}\" 1 ")).collect();
    let world = format!("Attribute \"shape\" {many}\n{shapes}");
    assert_eq!(read(&[("a.pbrt", pbrt(&world).as_bytes())]).map(|l| l.scene.shapes.len()), Ok(30_000));
    let many: String = (0..30_000).map(|i| format!("\"float n{i}\" 1 ")).collect();
    let alpha = "Shape \"sphere\" \"float alpha\" .5\n".repeat(15_000);
    let world = format!("MakeNamedMaterial \"m\" \"string type\" \"diffuse\" {many}\nNamedMaterial \"m\"\n{alpha}");
    assert!(refused(&[("a.pbrt", pbrt(&world).as_bytes())]).contains("`n0` of MakeNamedMaterial"));
}

fn described(change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let grey = json!({ "type": "constant", "value": [0.5, 0.5, 0.5] });
    let shape = json!({ "geometry": { "type": "sphere", "center": [0, 0, 0], "radius": 1 }, "material": 0,
        "to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]] });
    let mut scene = json!({
        "version": 1, "seed": 1, "max_depth": 4,
        "camera": { "origin": [0, 0, 4], "target": [0, 0, 0], "up": [0, 1, 0], "fov_x": 40, "near": 0 },
        "shapes": [shape], "materials": [{ "type": "diffuse", "reflectance": grey }],
        "emitters": [{ "type": "constant", "radiance": [1, 1, 1] }],
    });
    change(&mut scene);
    scene.to_string().into_bytes()
}

#[test]
fn our_own_scenes_are_held_to_the_same_bounds() {
    assert_eq!(read(&[("scene.json", &described(|_| {}))]).map(|l| l.scene.shapes.len()), Ok(1));
    let white = json!({ "type": "constant", "value": [1, 1, 1] });
    let mask = json!({ "type": "mask", "opacity": white, "inner": { "type": "diffuse", "reflectance": white } });
    let cases: [(&str, Value, &str); 11] = [
        ("/version", json!(2), "version 2 of the format"),
        ("/camera/fov_x", json!(-5), "a field of view of -5 degrees"),
        ("/camera/target", json!([0, 0, 4]), "a camera whose transform leaves it no view"),
        ("/shapes/0/geometry/radius", json!(-1), "a sphere of radius -1"),
        ("/shapes/0/to_world/0/0", json!(1e300), "not finite"),
        ("/shapes/0/material", json!(7), "shape 0 has material 7 of 1"),
        ("/shapes/0/emission", json!({ "type": "constant", "value": [-1, 0, 0] }), "`emission` is"),
        ("/emitters/0/radiance", json!([-1, 1, 1]), "`light` is"),
        ("/emitters", json!([]), "nothing in it gives light"),
        (
            "/materials/0",
            json!({ "type": "conductor", "eta": [0, 0, 0], "k": [1, 1, 1], "alpha": 1000,
            "specular_reflectance": white }),
            "a roughness of 1000",
        ),
        ("/materials/0", json!({ "type": "blend", "weight": white, "a": mask, "b": mask }), "a blend of materials"),
    ];
    for (pointer, value, what) in cases {
        let scene = described(|scene| {
            let (parent, last) = pointer.rsplit_once('/').expect("a pointer");
            match scene.pointer_mut(parent).expect("there") {
                Value::Array(items) => items[last.parse::<usize>().expect("a number")] = value.clone(),
                other => other[last] = value.clone(),
            }
        });
        let told = refused(&[("scene.json", &scene)]);
        assert!(told.contains(what), "{pointer}: {told}");
    }
    let second = described(|scene| {
        let emitter = scene["emitters"][0].clone();
        scene["emitters"] = json!([emitter, emitter]);
    });
    assert!(refused(&[("scene.json", &second)]).contains("a second environment"));
    // Words that are no scene have their line.
    let told = refused(&[("scene.json", b"{\n\"version\": 1,\n\"sead\": 3}")]);
    assert!(told.starts_with("scene.json: line 3: no scene: unknown field `sead`"), "{told}");
}
