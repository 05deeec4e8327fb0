//! Folders and files that are made to cost much: they cost little, and whatever is beside them goes on.

use crate::{
    fuzz::held_by,
    reports::report_on,
    small_assets::{Data, folder},
    support::{act, kind, load},
};
use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, LayerAttributes, Vec2, WritableImage as _};
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use serde_json::{Value, json as object};
use std::{
    collections::BTreeMap,
    fs,
    io::Cursor,
    os::unix::{fs::symlink, net::UnixListener},
    path::PathBuf,
    process::Command,
    sync::mpsc,
    time::{Duration, Instant},
};
use tauflow_contract::MemoryBlobs;
use tauflow_data::records::AssetReport;
use tauflow_testing::{Need, skip};

const MAP: &[u8] = b"#?RGBE\n\n-Y 1 +X 2\n\x80\x40\x20\x81\x80\x80\x80\x80";

/// An empty folder.
fn empty(name: &str) -> PathBuf {
    let folder = folder(name);
    fs::remove_dir_all(&folder).expect("a folder of these tests");
    fs::create_dir_all(&folder).expect("writable");
    folder
}

/// The reports of all items, by key. What waits for ever is a failure after a minute.
fn reports(params: Value) -> BTreeMap<String, AssetReport> {
    let (done, wait) = mpsc::channel();
    std::thread::spawn(move || {
        let (kind, blobs) = (kind("assets"), MemoryBlobs::default());
        let params = kind.resolve(&params).expect("fine params");
        let mut reports = BTreeMap::new();
        for item in kind.items(&params).expect("files") {
            let outputs = act(&blobs, kind.as_ref(), &params, Some(&item), BTreeMap::new()).expect("a report");
            assert!(reports.insert(item.key.to_string(), load(&blobs, &outputs.items["reports"])).is_none());
        }
        done.send(reports)
    });
    wait.recv_timeout(Duration::from_secs(60)).expect("nothing here takes long")
}

#[test]
#[expect(clippy::disallowed_methods, reason = "a socket's name decides no output")]
fn only_regular_files_are_read_and_the_rest_is_refused_by_name() {
    let folder = empty("irregular");
    fs::write(folder.join("sound.hdr"), MAP).expect("writable");
    symlink("sound.hdr", folder.join("linked.hdr")).expect("writable");
    symlink("/dev/zero", folder.join("device.hdr")).expect("writable");
    symlink("nowhere.glb", folder.join("dangling.glb")).expect("writable");
    symlink("itself.gltf", folder.join("itself.gltf")).expect("writable");
    // The path of a socket is short, so it is linked to.
    let short = std::env::temp_dir().join(format!("tauflow-socket-{}", std::process::id()));
    let socket = UnixListener::bind(&short).expect("a socket");
    symlink(&short, folder.join("socket.exr")).expect("writable");
    let mut refused = vec!["dangling.glb", "device.hdr", "itself.gltf", "socket.exr"];
    match Command::new("mkfifo").arg(folder.join("fifo.exr")).status() {
        Ok(status) if status.success() => refused.push("fifo.exr"),
        other => skip(Need::Fifo, format_args!("FIFOs cannot be made here: {other:?}")),
    }
    refused.sort_unstable();
    for params in [object!({ "folders": [folder] }), object!({ "files": [folder.join("*")] })] {
        let reports = reports(params);
        let accepted: Vec<&str> = reports.values().filter(|r| r.accepted).map(|r| r.name.as_str()).collect();
        assert_eq!(accepted, ["linked.hdr", "sound.hdr"]);
        let told: Vec<&String> = reports.values().filter_map(|r| r.reason.as_ref()).collect();
        assert_eq!(told.len(), refused.len(), "{told:?}");
        for (name, line) in refused.iter().zip(told) {
            assert!(line.starts_with(&format!("{name}: file: no regular file")) && line.contains("; put"), "{line}");
        }
    }
    drop(socket);
    fs::remove_file(&short).expect("made here");
}

#[test]
fn external_files_are_regular_ones() {
    let folder = empty("externals");
    let buffers = object!([{ "uri": "data.bin", "byteLength": 4 }]);
    let file = object!({ "asset": { "version": "2.0" }, "buffers": buffers });
    fs::write(folder.join("x.gltf"), file.to_string()).expect("writable");
    symlink("/dev/zero", folder.join("data.bin")).expect("writable");
    let told = reports(object!({ "folders": [folder] }))["x.gltf"].reason.clone().expect("refused");
    assert!(told.contains("`data.bin` is not there"), "{told}");
}

#[test]
fn loops_of_links_are_walked_once() {
    let folder = empty("loops");
    // Two links to the top in each of four folders: every path of them would be a folder of its own.
    let mut at = folder.clone();
    for depth in 0..4 {
        at = at.join(format!("f{depth}"));
        fs::create_dir(&at).expect("writable");
        symlink(&folder, at.join("a-loop")).expect("writable");
        symlink(&folder, at.join("z-loop")).expect("writable");
        fs::write(at.join(format!("{depth}.hdr")), MAP).expect("writable");
    }
    let elsewhere = empty("loops-elsewhere");
    fs::write(elsewhere.join("other.hdr"), MAP).expect("writable");
    symlink(&elsewhere, folder.join("a-link")).expect("writable");
    symlink(&elsewhere, folder.join("b-link")).expect("writable");
    let found = reports(object!({ "folders": [folder, folder.join("f0/a-loop")] }));
    let names: Vec<&str> = found.keys().map(String::as_str).collect();
    assert_eq!(names, ["0.hdr", "1.hdr", "2.hdr", "3.hdr", "other.hdr"]);
    // A pattern walks a loop no further: `*/*` is a folder once, too.
    let found = reports(object!({ "files": [folder.join("*/*/*/*/*/*/*/*/*/*/*/*/*/*/*/*/*.hdr")] }));
    assert!(!found.is_empty() && found.len() <= 5, "{found:?}");
}

#[test]
fn files_far_below_are_found() {
    let folder = empty("deep");
    let deep: PathBuf = std::iter::repeat_n("f", 30).collect();
    fs::create_dir_all(folder.join(&deep)).expect("writable");
    fs::write(folder.join(&deep).join("deep.hdr"), MAP).expect("writable");
    assert_eq!(reports(object!({ "folders": [folder] })).len(), 1);
}

#[test]
fn names_that_meet_stay_apart() {
    let folder = empty("meeting");
    for path in ["b/x.hdr", "c/b/x.hdr", "2-b-x.hdr"] {
        let path = folder.join(path);
        fs::create_dir_all(path.parent().expect("below")).expect("writable");
        fs::write(path, MAP).expect("writable");
    }
    let names: Vec<String> = reports(object!({ "folders": [folder] })).into_keys().collect();
    assert_eq!(names, ["2-b-x.hdr", "3-b-x.hdr", "b-x.hdr"]);
}

/// What the kind says of bytes, and how many it holds at most.
fn told(name: &str, bytes: &[u8]) -> (AssetReport, isize) {
    let kind = kind("assets");
    let params = kind.resolve(&object!({ "files": ["unused"], "max_texture": 64 })).expect("fine params");
    held_by(|| report_on(kind.as_ref(), &params, name, bytes))
}

fn refused(name: &str, bytes: &[u8], parts: &[&str]) {
    let (report, held) = told(name, bytes);
    let line = report.reason.unwrap_or_else(|| panic!("{name} is accepted"));
    assert!(line.starts_with(name) && line.contains("; "), "{line}");
    assert!(parts.iter().all(|part| line.contains(part)), "{line}");
    assert!(held < 1 << 27, "{held} bytes for {line}");
}

/// An EXR of zeros.
fn exr(width: usize, height: usize, channels: usize) -> Vec<u8> {
    let names = (0..channels).map(|c| if c < 3 { "RGB"[c..=c].to_owned() } else { format!("x{c:04}") });
    let list = names.map(|name| AnyChannel::new(name.as_str(), FlatSamples::F32(vec![0.0; width * height])));
    let layer = Layer::new(
        Vec2(width, height),
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(list.collect()),
    );
    let mut bytes = Cursor::new(Vec::new());
    exr::image::Image::from_layer(layer).write().to_buffered(&mut bytes).expect("written");
    bytes.into_inner()
}

#[test]
fn pictures_of_more_than_their_bytes_can_say_are_refused_from_their_headers() {
    // 16 bytes for 2^26 texels, as old runs can say them.
    let mut runs = b"#?RGBE\n\n-Y 8192 +X 8192\n".to_vec();
    runs.extend([1, 1, 1, 1].repeat(16_384));
    refused("runs.hdr", &runs, &["8192 x 8192", "bytes", "make the picture smaller"]);
    let wide = exr(4096, 4096, 1);
    refused("wide.exr", &wide, &["4096 x 4096", &format!("{} bytes", wide.len()), "make the picture smaller"]);
    refused("many.exr", &exr(1, 1, 3000), &["3000 channels", "1024", "take out"]);
}

fn png(width: u32, height: u32, color: ExtendedColorType, fill: u8) -> Vec<u8> {
    let bits = color.bits_per_pixel() as usize;
    let mut out = Vec::new();
    let data = vec![fill; width as usize * height as usize * bits / 8];
    PngEncoder::new(&mut out).write_image(&data, width, height, color).expect("a picture");
    out
}

/// A GLB whose primitives each have a material of their own, over images.
fn object_of(images: &[Vec<u8>], materials: &[Value]) -> Vec<u8> {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3", 3);
    let uvs = data.floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0], "VEC2", 2);
    let list: Vec<Value> =
        images.iter().map(|i| object!({ "bufferView": data.view(i), "mimeType": "image/png" })).collect();
    let textures: Vec<Value> = (0..images.len()).map(|i| object!({ "source": i })).collect();
    let attributes = object!({ "POSITION": positions, "TEXCOORD_0": uvs });
    let primitives: Vec<Value> =
        (0..materials.len()).map(|m| object!({ "attributes": attributes, "material": m })).collect();
    data.file(object!({ "images": list, "textures": textures, "materials": materials,
        "meshes": [{ "primitives": primitives }], "nodes": [{ "mesh": 0 }], "scenes": [{ "nodes": [0] }] }))
}

fn colored(image: usize) -> Value {
    object!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": image } } })
}

#[test]
fn images_of_too_many_texels_are_refused_from_their_headers() {
    // The header of a sound PNG of 8 x 8, made to claim more, with the checksum that this needs.
    let mut bytes = png(8, 8, ExtendedColorType::Rgb8, 7);
    bytes[16..20].copy_from_slice(&16_384u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&16_384u32.to_be_bytes());
    let mut sum = u32::MAX;
    for byte in &bytes[12..29] {
        sum ^= u32::from(*byte);
        (0..8).for_each(|_| sum = if sum & 1 == 1 { sum >> 1 ^ 0xedb8_8320 } else { sum >> 1 });
    }
    bytes[29..33].copy_from_slice(&(!sum).to_be_bytes());
    refused("bomb.glb", &object_of(&[bytes], &[colored(0)]), &["image 0: 16384 x 16384", "67108864", "smaller"]);
}

#[test]
fn an_image_may_be_larger_than_what_a_decoder_may_take_beside_it() {
    let (report, _) = told("large.glb", &object_of(&[png(8192, 6144, ExtendedColorType::Rgb8, 9)], &[colored(0)]));
    assert!(report.accepted, "{report:?}");
    assert!(report.notes.iter().any(|note| note.contains("8192 x 6144 reduced by 128")), "{report:?}");
}

#[test]
fn decoded_images_are_let_go() {
    let images: Vec<Vec<u8>> = (0..24).map(|i| png(2048, 2048, ExtendedColorType::Rgb8, i)).collect();
    let materials: Vec<Value> = (0..24).map(colored).collect();
    let (report, held) = told("many.glb", &object_of(&images, &materials));
    assert!(report.accepted && report.measures["images"] == 24.0, "{report:?}");
    // All at once they would be 302 MB.
    assert!(held < 200 << 20, "{held} bytes");
}

#[test]
fn uses_of_images_by_a_small_file_are_counted() {
    // Each cutoff reads all of the image, and makes another bitmap.
    let image = png(4096, 4096, ExtendedColorType::Rgba8, 100);
    let cut = |m: usize| {
        object!({ "alphaMode": "MASK", "alphaCutoff": m as f64 / 64.0,
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } })
    };
    let bytes = object_of(&[image], &(0..64).map(cut).collect::<Vec<_>>());
    let report = told("cutoffs.glb", &bytes).0;
    let line = report.reason.expect("refused");
    assert!(line.contains("texels to be read") && line.contains("one alpha cutoff"), "{line}");
}

#[test]
fn instances_of_many_vertices_are_counted() {
    // 87,000 vertices of which one triangle is shown, 400 times.
    let mut data = Data::default();
    let positions = data.floats(&[0.5, 0.0, 1.0].repeat(87_000), "VEC3", 3);
    let indices = data.accessor(&[0, 1, 2], 5121, "SCALAR", 3, false);
    let nodes: Vec<Value> = (0..400).map(|_| object!({ "mesh": 0 })).collect();
    let bytes = data.file(object!({ "nodes": nodes,
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": positions }, "indices": indices }] }] }));
    let line = told("forest.glb", &bytes).0.reason.expect("refused");
    assert!(line.contains("24000000 vertices"), "{line}");
}

/// A triangle on one joint, whose file is changed before it is written.
fn on_a_joint(joint: u8, weight: f32, change: impl FnOnce(&mut Data, &mut Value)) -> Vec<u8> {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3", 3);
    let joints = data.accessor(&[0, 0, 0, 0, 0, 0, 0, 0, joint, 0, 0, 0], 5121, "VEC4", 3, false);
    let weights = data.floats(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, weight, 0.0, 0.0, 0.0], "VEC4", 4);
    let attributes = object!({ "POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights });
    let mut file = object!({ "meshes": [{ "primitives": [{ "attributes": attributes }] }],
        "skins": [{ "joints": [1] }], "nodes": [{ "mesh": 0, "skin": 0 }, {}], "scenes": [{ "nodes": [0, 1] }] });
    change(&mut data, &mut file);
    data.file(file)
}

#[test]
fn joints_and_weights_that_cannot_be_are_refused_by_vertex() {
    let as_is = |_: &mut Data, _: &mut Value| {};
    assert!(told("sound.glb", &on_a_joint(0, 1.0, as_is)).0.accepted);
    refused("joint.glb", &on_a_joint(7, 1.0, as_is), &["primitive 0 JOINTS_0: vertex 2 names joint 7 of 1"]);
    // A joint without weight may be any number, as exporters leave it; but what moves a vertex must be there.
    refused("unweighted.glb", &on_a_joint(7, 0.0, as_is), &["vertex 2 names joint 7 of 1"]);
    refused("nan.glb", &on_a_joint(0, f32::NAN, as_is), &["WEIGHTS_0: vertex 2 has a weight of NaN"]);
    refused("infinite.glb", &on_a_joint(0, f32::INFINITY, as_is), &["vertex 2 has a weight of inf"]);
    refused("negative.glb", &on_a_joint(0, -0.5, as_is), &["vertex 2 has a weight of -0.5"]);
    let (report, _) = told("sum.glb", &on_a_joint(0, 3.0, as_is));
    assert_eq!(report.repairs["vertices whose weights of joints do not sum to 1 scaled"], 1, "{report:?}");
    refused(
        "lone.glb",
        &on_a_joint(0, 1.0, |_, file| {
            file["meshes"][0]["primitives"][0]["attributes"].as_object_mut().expect("attributes").remove("WEIGHTS_0");
        }),
        &["only one of JOINTS_0 and WEIGHTS_0"],
    );
    refused("skin.glb", &on_a_joint(0, 1.0, |_, file| file["nodes"][0]["skin"] = object!(4)), &["skin 4: there is no"]);
    refused(
        "node.glb",
        &on_a_joint(0, 1.0, |_, file| file["skins"][0]["joints"] = object!([9])),
        &["node 9: there is no"],
    );
    let inverse = |values: &[f32], sort: &str, width: usize| {
        on_a_joint(0, 1.0, |data, file| {
            file["skins"][0]["inverseBindMatrices"] = object!(data.floats(values, sort, width));
        })
    };
    refused("few.glb", &inverse(&[], "MAT4", 16), &["skin 0: 0 inverse bind matrices for 1 joints"]);
    refused("none.glb", &inverse(&[0.0; 4], "VEC4", 4), &["skin 0: inverse bind matrices that are none"]);
    refused("nan-matrix.glb", &inverse(&[f32::NAN; 16], "MAT4", 16), &["skin 0 joint 0: its matrix is not finite"]);
}

#[test]
fn cyclic_skeletons_are_refused() {
    // Joints beside the scene, each the other's child; one that is its own; and one with two parents.
    for (name, nodes) in [
        ("ring.glb", object!([{ "mesh": 0, "skin": 0 }, { "children": [2] }, { "children": [1] }])),
        ("self.glb", object!([{ "mesh": 0, "skin": 0 }, { "children": [1] }])),
        ("two.glb", object!([{ "mesh": 0, "skin": 0 }, {}, { "children": [1] }, { "children": [1] }])),
    ] {
        let bytes = on_a_joint(0, 1.0, |_, file| {
            file["nodes"] = nodes;
            file["scenes"] = object!([{ "nodes": [0] }]);
        });
        refused(name, &bytes, &["node ", "its own ancestor"]);
    }
    refused(
        "child.glb",
        &on_a_joint(0, 1.0, |_, file| {
            file["nodes"] = object!([{ "mesh": 0, "skin": 0 }, {}, { "children": [77] }]);
            file["scenes"] = object!([{ "nodes": [0] }]);
        }),
        &["node 77: there is no such node"],
    );
}

#[test]
fn morph_targets_that_do_not_fit_are_refused() {
    let morphed = |weights: Value, values: &[f32]| {
        on_a_joint(0, 1.0, |data, file| {
            let target = data.floats(values, "VEC3", 3);
            file["meshes"][0]["primitives"][0]["targets"] = object!([{ "POSITION": target }]);
            file["meshes"][0]["weights"] = weights;
        })
    };
    assert!(told("fits.glb", &morphed(object!([1]), &[0.0; 9])).0.accepted);
    refused("short.glb", &morphed(object!([1]), &[0.0; 6]), &["target 0 POSITION: 2 elements for 3 positions"]);
    refused("many.glb", &morphed(object!([1, 0]), &[0.0; 9]), &["2 weights for 1 morph targets"]);
    refused("huge.glb", &morphed(object!([1e60]), &[0.0; 9]), &["; "]);
}

/// A triangle with instances whose attributes are these accessors, which no bytes hold.
fn instanced(attributes: &[(&str, &str, u64)], nodes: usize) -> Vec<u8> {
    instanced_beside(0, attributes, nodes)
}

/// The same in a file with `unused` bytes more.
fn instanced_beside(unused: usize, attributes: &[(&str, &str, u64)], nodes: usize) -> Vec<u8> {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3", 3);
    let indices = data.accessor(&[0, 1, 2].repeat(12), 5121, "SCALAR", 36, false);
    let mut named = serde_json::Map::new();
    for (name, sort, count) in attributes {
        data.accessors.push(object!({ "componentType": 5126, "type": sort, "count": count }));
        named.insert((*name).to_owned(), object!(data.accessors.len() - 1));
    }
    data.bytes.resize(data.bytes.len() + unused, 0);
    let node = object!({ "mesh": 0, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": named } } });
    data.file(object!({ "nodes": vec![node; nodes],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": positions }, "indices": indices }] }] }))
}

#[test]
fn billions_of_instances_are_refused_before_they_are_made() {
    let place = "EXT_mesh_gpu_instancing: ";
    let billions = instanced(&[("TRANSLATION", "VEC3", 4_000_000_000)], 1);
    refused("billions.glb", &billions, &[place, "4000000000 instances", "the most for a file of "]);
    let granted = "with those before more than 1048576, the most for a file of ";
    refused("above.glb", &instanced_beside(1 << 21, &[("SCALE", "VEC3", (1 << 20) + 1)], 1), &[place, granted]);
    // A million is granted to a file of a million bytes, but not of twelve triangles; and not twice.
    let million = [("TRANSLATION", "VEC3", 1 << 20), ("ROTATION", "VEC4", 1 << 20), ("SCALE", "VEC3", 1 << 20)];
    refused("million.glb", &instanced_beside(1 << 20, &million, 1), &["8000000 triangles", "instances counted"]);
    refused(
        "twice.glb",
        &instanced_beside(1 << 20, &[("SCALE", "VEC3", 600_000)], 2),
        &["node 1 ", "600000 instances: with those before"],
    );
    refused(
        "uneven.glb",
        &instanced(&[("SCALE", "VEC3", 3), ("TRANSLATION", "VEC3", 4)], 1),
        &[place, "another number"],
    );
    refused("flat.glb", &instanced(&[("TRANSLATION", "VEC2", 3)], 1), &["TRANSLATION: vectors of 2 numbers"]);
    let (report, _) = told("same.glb", &instanced(&[("_ID", "SCALAR", 3)], 1));
    assert_eq!(report.repairs["instances in one place left out"], 2, "{report:?}");
    assert_eq!(report.measures["triangles"], 12.0);
    refused("no.glb", &instanced(&[("TRANSLATION", "VEC3", 0)], 1), &["no triangles"]);
}

#[test]
#[expect(clippy::disallowed_methods, reason = "it holds that no time goes as the square of the nodes")]
fn many_nodes_without_a_scene_cost_as_many_times_more() {
    let least = |count: usize| {
        let children: Vec<usize> = (1..count).collect();
        let mut nodes = vec![object!({ "children": children })];
        nodes.extend((1..count).map(|_| object!({})));
        let file = object!({ "asset": { "version": "2.0" }, "nodes": nodes }).to_string();
        let once = || {
            let from = Instant::now();
            let line = told("nodes.gltf", file.as_bytes()).0.reason.expect("no surface");
            assert!(line.contains("no triangles"), "{line}");
            from.elapsed()
        };
        (0..3).map(|_| once()).min().expect("three")
    };
    // Looking for each among all takes 100 times as long.
    let (few, many) = (least(20_000), least(200_000));
    assert!(many < few * 40, "{few:?}, {many:?}");
}
