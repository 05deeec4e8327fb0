//! glTF files as the world has them: without cameras and lights, animated, instanced, wrong in several places.

use super::*;
use serde_json::{Value, json};
use tauflow_data::geom::{apply, dot, length, sub, unit};

/// The file of a test with parts of it in other ways.
fn changed(change: impl FnOnce(&mut Value)) -> String {
    let mut file: Value = serde_json::from_str(&gltf_text()).expect("JSON");
    change(&mut file);
    file.to_string()
}

fn bare(file: &mut Value) {
    file["nodes"] = json!([{ "mesh": 0, "translation": [10.0, 0.0, 0.0] }]);
    file["scenes"] = json!([{ "nodes": [0] }]);
}

fn load_in(text: &str, setting: &Setting) -> Result<Loaded, String> {
    let parts = BTreeMap::from([(given::MAIN.to_owned(), text.as_bytes().to_vec())]);
    read("a.gltf", setting, &parts, Options::default()).map_err(|e| e.to_string())
}

fn sky() -> Image {
    Image::from_data(2, 1, 3, vec![1.0; 6]).expect("fits")
}

/// Where a point is in a camera's picture: from -1 to 1 if it is seen.
fn seen(camera: &Camera, aspect: f64, p: [f64; 3]) -> [f64; 2] {
    let forward = unit(sub(camera.target, camera.origin));
    let right = unit(tauflow_data::geom::cross(forward, camera.up));
    let up = tauflow_data::geom::cross(right, forward);
    let d = sub(p, camera.origin);
    let half = tauflow_data::maths::tan(camera.fov_x.to_radians() / 2.0);
    assert!(dot(d, forward) > 0.0, "behind the camera");
    [dot(d, right) / dot(d, forward) / half, aspect * dot(d, up) / dot(d, forward) / half]
}

#[test]
fn a_file_without_camera_and_light_is_framed_under_a_sky_where_that_is_asked_for() {
    let text = changed(bare);
    let told = load_in(&text, &Setting::camera(0)).expect_err("as an item of a pipeline");
    assert!(told.contains("there is no camera"), "{told}");
    let setting = Setting { frame: true, fallback: Some(sky()), ..Setting::camera(0) };
    let loaded = load_in(&text, &setting).expect("framed");
    assert!(loaded.framed && loaded.lit);
    assert!(matches!(loaded.scene.emitters.as_slice(), [Emitter::Envmap { .. }]));
    // One that has both keeps them.
    let own = load_in(&gltf_text(), &setting).expect("as it is");
    assert!(!own.framed && !own.lit && own.scene.emitters.len() == 3);
    assert_eq!(own.scene.camera.origin, [0.0, 1.0, 5.0]);
}

#[test]
fn a_fitted_view_sees_all_and_no_more_than_it_must() {
    let corners = [[10.0, 0.0, 0.0], [14.0, 0.0, 0.0], [10.0, 4.0, 0.0]];
    for aspect in [0.5, 1.0, 3.0] {
        let setting = Setting { view: View::Fit, aspect: Some(aspect), fallback: Some(sky()), ..Setting::camera(0) };
        for (text, from) in [(changed(bare), [0.5, 0.4, 1.0]), (gltf_text(), [0.0, 0.0, 1.0])] {
            let loaded = load_in(&text, &setting).expect("framed");
            let camera = &loaded.scene.camera;
            let places = corners.map(|p| seen(camera, aspect, p));
            let most = places.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
            assert!(places.iter().flatten().all(|v| v.abs() < 1.0) && most > 0.25, "{aspect}: {places:?}");
            assert!(length(sub(unit(sub(camera.origin, camera.target)), unit(from))) < 1e-9, "{camera:?}");
            let [width, height] = loaded.film.expect("a film").map(f64::from);
            assert!((width / height / aspect - 1.0).abs() < 0.01, "{width} x {height}");
        }
    }
}

#[test]
fn an_environment_that_is_asked_for_replaces_that_of_the_file() {
    let setting = Setting { environment: Some(sky()), ..Setting::camera(0) };
    let loaded = load_in(&gltf_text(), &setting).expect("a scene");
    assert_eq!(loaded.scene.emitters.len(), 4);
    let parts = BTreeMap::from([(given::MAIN.to_owned(), xml("<shape type=\"cube\"/>").into_bytes())]);
    let loaded = read("a.xml", &setting, &parts, Options::default()).expect("a scene");
    assert!(matches!(loaded.scene.emitters.as_slice(), [Emitter::Envmap { .. }]), "{:?}", loaded.scene.emitters);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sky.hdr");
    fs::write(&path, b"#?RGBE\n\n-Y 1 +X 2\n\x80\x40\x20\x81\x80\x80\x80\x80").expect("writable");
    assert_eq!(environment_map(&path).expect("a map").width(), 2);
    for name in ["sky.rgbe", "sky.PIC", "sky.exr"] {
        let copy = folder.path().join(name);
        fs::copy(&path, &copy).expect("writable");
        assert_eq!(environment_map(&copy).expect("by its first bytes").width(), 2, "{name}");
    }
    let told = environment_map(&folder.path().join("none.exr")).expect_err("nothing there").to_string();
    assert!(told.contains("none.exr`: ") && told.contains("mend the path"), "{told}");
    assert!(environment_map(&folder.path().join("a.png")).expect_err("a png").to_string().contains("by its ending"));
}

#[test]
fn a_camera_without_an_aspect_ratio_has_that_of_the_picture() {
    let free = changed(|file| {
        file["cameras"][0]["perspective"].as_object_mut().expect("a lens").remove("aspectRatio");
    });
    let half = tauflow_data::maths::tan(0.35);
    for (text, aspect, expected) in [
        (&free, None, 1.0),
        (&free, Some(3.0), 3.0),
        (&free, Some(0.5), 0.5),
        // Its own is kept: the field of view is along the width.
        (&gltf_text(), Some(3.0), 2.0),
    ] {
        let loaded = load_in(text, &Setting { aspect, ..Setting::camera(0) }).expect("a scene");
        let slope = tauflow_data::maths::tan(loaded.scene.camera.fov_x.to_radians() / 2.0);
        assert!((slope / half - expected).abs() < 1e-6, "{aspect:?}: {}", slope / half);
        let [width, height] = loaded.film.expect("by its aspect").map(f64::from);
        assert_eq!(width / height, expected, "{aspect:?}");
    }
}

/// The mesh of a file with these attributes in place of its own: components, and numbers.
fn with_numbers(file: &mut Value, attributes: &[(&str, &str, &[f32])]) {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let primitive = &mut file["meshes"][0]["primitives"][0];
    primitive["attributes"] = json!({});
    let (mut bytes, mut views, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    for (name, sort, numbers) in attributes {
        let own: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
        let width = sort.strip_prefix("VEC").map_or(1, |width| width.parse().expect("a width"));
        primitive["attributes"][name] = json!(accessors.len());
        views.push(json!({ "buffer": 0, "byteOffset": bytes.len(), "byteLength": own.len() }));
        accessors.push(json!({ "bufferView": accessors.len(), "componentType": 5126, "type": sort,
            "count": numbers.len() / width }));
        bytes.extend(own);
    }
    file["bufferViews"] = json!(views);
    file["accessors"] = json!(accessors);
    file["buffers"] = json!([{ "byteLength": bytes.len(),
        "uri": format!("data:application/octet-stream;base64,{}", STANDARD.encode(&bytes)) }]);
}

const TRIANGLE: &[f32] = &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 4.0, 0.0];

/// A tetrahedron, whose triangles face outwards or inwards.
fn body(file: &mut Value, outwards: bool) {
    let corners = [[0.0f32, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
    let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let faces = faces.map(|[a, b, c]| if outwards { [a, b, c] } else { [a, c, b] });
    let numbers: Vec<f32> = faces.iter().flatten().flat_map(|i: &usize| corners[*i]).collect();
    with_numbers(file, &[("POSITION", "VEC3", &numbers)]);
}

#[test]
fn closed_bodies_keep_their_front_side() {
    for outwards in [true, false] {
        let loaded = load_in(&changed(|file| body(file, outwards)), &Setting::camera(0)).expect("a body or a room");
        assert_eq!(tauflow_data::mesh_check::signed_volume(&mesh_of(&loaded, 0)) > 0.0, outwards, "{:?}", loaded.notes);
        assert!(!loaded.notes.iter().any(|note| note.contains("right side out")), "{:?}", loaded.notes);
    }
}

#[test]
fn emission_that_lacks_its_back_is_approximated() {
    let lamp = |change: &dyn Fn(&mut Value)| {
        changed(|file| {
            file["materials"] = json!([{ "doubleSided": true, "emissiveFactor": [1.0, 1.0, 1.0] }]);
            change(file);
            file["meshes"][0]["primitives"][0]["material"] = json!(0);
        })
    };
    let within = |file: &mut Value| file["nodes"][0]["translation"] = json!([-0.5, -0.5, 4.5]);
    let what = "emission of double-sided surfaces is on their front alone";
    for (name, text, lacks) in [
        ("open", lamp(&|_| {}), true),
        ("single-sided", lamp(&|file| file["materials"][0]["doubleSided"] = json!(false)), false),
        ("dark", lamp(&|file| file["materials"][0]["emissiveFactor"] = json!([0.0, 0.0, 0.0])), false),
        ("closed", lamp(&|file| body(file, true)), false),
        ("from inside", lamp(&|file| (body(file, true), within(file)).1), true),
        ("a room", lamp(&|file| (body(file, false), within(file)).1), false),
        ("a room from outside", lamp(&|file| body(file, false)), true),
        (
            "with holes",
            lamp(&|file| {
                body(file, true);
                file["materials"][0]["alphaMode"] = json!("MASK");
            }),
            true,
        ),
    ] {
        let strict = load("a.gltf", &text, &[], false);
        assert_eq!(strict.is_err(), lacks, "{name}");
        if lacks {
            assert!(strict.expect_err(name).contains(what), "{name}");
        }
        let notes = load("a.gltf", &text, &[], true).expect(name).notes;
        assert_eq!(notes.iter().any(|note| note.contains(what)), lacks, "{name}: {notes:?}");
    }
}

#[test]
fn holes_are_cut_by_the_alpha_of_vertex_colours_too() {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let mut png = std::io::Cursor::new(Vec::new());
    let picture = image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([255, 255, 255, [255, 178][x as usize]]));
    picture.write_to(&mut png, image::ImageFormat::Png).expect("in memory");
    let uri = format!("data:image/png;base64,{}", STANDARD.encode(png.into_inner()));
    let file = |alphas: [f32; 3], mode: &str, textured: bool| {
        changed(|file| {
            let colors: Vec<f32> = alphas.iter().flat_map(|alpha| [1.0, 1.0, 1.0, *alpha]).collect();
            let uvs = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0];
            let attributes =
                [("POSITION", "VEC3", TRIANGLE), ("COLOR_0", "VEC4", &colors), ("TEXCOORD_0", "VEC2", &uvs[..])];
            with_numbers(file, &attributes);
            file["meshes"][0]["primitives"][0]["material"] = json!(0);
            file["materials"] = json!([{ "alphaMode": mode }]);
            if textured {
                file["materials"][0]["pbrMetallicRoughness"] = json!({ "baseColorTexture": { "index": 0 } });
                file["textures"] = json!([{ "source": 0 }]);
                file["images"] = json!([{ "uri": uri }]);
            }
        })
    };
    let opacity = |alpha: f32, textured: bool| {
        let loaded = load("a.gltf", &file([alpha; 3], "MASK", textured), &[], false).expect("exact");
        match &loaded.scene.materials[0] {
            Bsdf::Mask { opacity: Texture::Constant { value }, .. } => vec![value[0]],
            Bsdf::Mask { opacity: Texture::Bitmap { image, .. }, .. } => {
                Image::from_bytes(&loaded.blobs[image]).expect("an image").data().to_vec()
            }
            other => panic!("{other:?}"),
        }
    };
    // The cut-off is 0.5, and that of the second texel 0.7.
    assert_eq!([1.0, 0.6, 0.4].map(|alpha| opacity(alpha, false)), [[1.0], [1.0], [0.0]]);
    assert_eq!([1.0, 0.6, 0.4].map(|alpha| opacity(alpha, true)), [[1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
    let varied = file([1.0, 1.0, 0.0], "MASK", true);
    let what = "alpha of vertex colours is left out where holes are cut";
    assert!(load("a.gltf", &varied, &[], false).expect_err("nearly").contains(what));
    assert!(load("a.gltf", &varied, &[], true).expect("allowed").notes.iter().any(|note| note.contains(what)));
    load("a.gltf", &file([1.0, 1.0, 0.0], "OPAQUE", true), &[], false).expect("nothing is cut");
}

#[test]
fn animations_are_a_note_and_what_they_point_at_is_no_damage() {
    let sampler = json!({ "input": 0, "output": 0 });
    let path = json!({ "sampler": 0, "target": { "path": "pointer",
        "extensions": { "KHR_animation_pointer": { "pointer": "/materials/0/emissiveFactor" } } } });
    let plain = json!({ "sampler": 0, "target": { "node": 0, "path": "translation" } });
    for channel in [path, plain] {
        let text = changed(|file| {
            file["animations"] = json!([{ "samplers": [sampler], "channels": [channel] }]);
            file["extensionsUsed"] = json!(["KHR_lights_punctual", "KHR_animation_pointer"]);
            file["extensionsRequired"] = json!(["KHR_animation_pointer"]);
        });
        let loaded = load("a.gltf", &text, &[], false).expect("it stands still");
        let note = "a.gltf: file: animations are left out: it stands in its default pose";
        assert!(loaded.notes.iter().any(|n| n == note), "{:?}", loaded.notes);
    }
    let text = changed(|file| file["animations"] = json!("none"));
    assert!(load("a.gltf", &text, &[], false).expect_err("no list").contains("JSON"));
}

#[test]
fn a_mesh_that_is_shown_often_is_held_once() {
    let node = |x: f64, s: f64| json!({ "mesh": 0, "translation": [x, 0.0, 0.0], "scale": [s, 1.0, 1.0] });
    let text = changed(|file| {
        file["nodes"] = json!([node(10.0, 1.0), { "camera": 0 }, node(20.0, -2.0), node(30.0, 0.5)]);
        file["scenes"] = json!([{ "nodes": [0, 1, 2, 3] }]);
    });
    let setting = Setting { fallback: Some(sky()), ..Setting::camera(0) };
    let loaded = load_in(&text, &setting).expect("three triangles");
    let meshes: BTreeSet<_> = loaded.scene.shapes.iter().map(|s| format!("{:?}", s.geometry)).collect();
    assert_eq!((loaded.scene.shapes.len(), meshes.len()), (3, 1));
    let mesh = mesh_of(&loaded, 0);
    for (shape, corners) in loaded.scene.shapes.iter().zip([[10.0, 14.0], [20.0, 12.0], [30.0, 32.0]]) {
        let x: BTreeSet<i64> =
            mesh.positions.iter().map(|p| apply(&shape.to_world, p.map(f64::from))[0].round() as i64).collect();
        assert_eq!(x, corners.map(|v: f64| v as i64).into_iter().collect(), "{:?}", shape.to_world);
    }
}

#[test]
fn everything_that_is_wrong_is_told_at_once() {
    let text = changed(|file| {
        file["extensionsRequired"] = json!(["EXT_meshopt_compression", "KHR_texture_basisu"]);
        let broken = json!({ "attributes": { "POSITION": 7 } });
        let odd = json!({ "attributes": { "POSITION": 0, "NORMAL": 8 } });
        let whole = file["meshes"][0]["primitives"][0].clone();
        file["meshes"][0]["primitives"] = json!([broken, whole, odd]);
        file["extensions"]["KHR_lights_punctual"]["lights"][0]["type"] = json!("area");
    });
    let told = load("a.gltf", &text, &[], false).expect_err("four mistakes");
    for part in [
        "`EXT_meshopt_compression` is required",
        "`KHR_texture_basisu` is required",
        "accessor 7: there is no such accessor",
        "accessor 8: there is no such accessor",
        "lights of type `area` are not supported",
    ] {
        assert!(told.contains(part), "{part}:\n{told}");
    }
}
