//! The shared HDRIs and objects: each loads, malformed ones are refused in a line each, and every file gets into
//! scenes.

use crate::support::{load, shared, source};
use serde_json::json;
use std::collections::BTreeMap;
use tauflow_contract::{Blobs, Collection, MemoryBlobs};
use tauflow_data::{
    Image,
    mesh::Mesh,
    records::{Asset, AssetBody, AssetReport},
};

/// Luminance figures of the shared HDRIs, as their list of licences states them: file, largest, mean by solid angle,
/// share of the brightest thousandth of the sphere.
const LIGHT: [(&str, f64, f64, f64); 10] = [
    ("kloppenheim_05_1k.hdr", 78944.0, 0.804, 0.66),
    ("rooitou_park_1k.hdr", 64890.0, 0.756, 0.68),
    ("potsdamer_platz_1k.hdr", 10.943, 0.558, 0.01),
    ("kiara_1_dawn_1k.hdr", 46.225, 0.839, 0.04),
    ("st_fagans_interior_1k.hdr", 1110.9, 0.826, 0.16),
    ("dikhololo_night_1k.hdr", 72.572, 0.0842, 0.03),
    ("studio_small_03_1k.hdr", 3351.5, 2.22, 0.65),
    ("small_hangar_01_1k.exr", 85.242, 0.665, 0.09),
    ("neon_photostudio_256.exr", 73.88, 0.897, 0.06),
    ("blender_interior.exr", 32216.0, 1.05, 0.43),
];

/// Triangles that the default scenes draw.
const TRIANGLES: [(&str, f64); 21] = [
    ("Box.glb", 12.0),
    ("BoxVertexColors.glb", 12.0),
    ("Fox.glb", 576.0),
    ("MetalRoughSpheresNoTextures.glb", 1_040_409.0),
    ("ToyCar.gltf", 108_936.0),
    ("GlassVaseFlowers.glb", 14_036.0),
    ("TransmissionTest.glb", 128_775.0),
    ("AttenuationTest.glb", 292.0),
    ("ClearCoatTest.glb", 37_116.0),
    ("EmissiveStrengthTest.glb", 90.0),
    ("TextureTransformMultiTest.glb", 3956.0),
    ("NegativeScaleTest.glb", 7724.0),
    ("NormalTangentMirrorTest.glb", 5240.0),
    ("AlphaBlendModeTest.glb", 61.0),
    ("Suzanne.gltf", 3936.0),
    ("tea_set_01_1k.gltf", 40_296.0),
    ("glass-table.glb", 592.0),
    ("carbon-sphere.glb", 215_579.0),
    ("cat.glb", 4622.0),
    ("BoxMeshopt.glb", 12.0),
    ("basic_sci-fi_crate.glb", 256.0),
];

fn reports(blobs: &MemoryBlobs, made: &BTreeMap<String, Collection>) -> BTreeMap<String, AssetReport> {
    made["reports"].iter().map(|(key, artifact)| (key.to_string(), load(blobs, artifact))).collect()
}

#[test]
fn every_hdri_loads_with_the_light_it_is_known_for() {
    let Some(folder) = shared("hdri") else { return };
    let blobs = MemoryBlobs::default();
    let made = source(&blobs, "assets", json!({ "folders": [folder] }), &BTreeMap::new());
    let reports = reports(&blobs, &made);
    assert_eq!(reports.len(), LIGHT.len());
    for (name, largest, mean, top) in LIGHT {
        let report = &reports[name];
        assert!(report.accepted && report.sort.as_deref() == Some("environment"), "{report:?}");
        let near = |measure: &str, known: f64, within: f64| {
            let found = report.measures[measure];
            assert!((found - known).abs() <= within, "{name}: {measure} {found}, known {known}");
        };
        near("max_luminance", largest, 0.002 * largest);
        near("mean_luminance", mean, 0.01 * mean);
        near("top_share", top, 0.02);
        let asset: Asset = load(&blobs, made["assets"].get(name).expect("accepted"));
        let AssetBody::Hdri { image, .. } = asset.body else { panic!("{name} is no environment") };
        let image = Image::from_bytes(&blobs.get(&image).expect("in memory").expect("stored")).expect("a bitmap");
        assert!(image.data().iter().all(|v| v.is_finite() && *v >= 0.0), "{name}");
    }
    assert_eq!(reports["blender_interior.exr"].repairs["negative values set to 0"], 8980);
}

#[test]
fn every_object_loads_but_the_one_that_may_be_refused() {
    let Some(folder) = shared("gltf") else { return };
    let blobs = MemoryBlobs::default();
    let made = source(&blobs, "assets", json!({ "folders": [folder], "max_texture": 256 }), &BTreeMap::new());
    let reports = reports(&blobs, &made);
    assert_eq!(reports.len(), TRIANGLES.len());
    for (name, triangles) in TRIANGLES {
        let report = &reports[name];
        if name == "BoxMeshopt.glb" {
            let reason = report.reason.as_deref().expect("refused");
            assert!(reason.starts_with("BoxMeshopt.glb: ") && reason.contains("EXT_meshopt_compression"), "{reason}");
            continue;
        }
        assert!(report.accepted, "{report:?}");
        let lost: u64 = report.repairs.iter().filter(|(what, _)| what.starts_with("triangles")).map(|(_, n)| n).sum();
        assert_eq!(report.measures["triangles"] + lost as f64, triangles, "{report:?}");
        let asset: Asset = load(&blobs, made["assets"].get(name).expect("accepted"));
        let AssetBody::Object { parts, materials, bounds } = &asset.body else { panic!("{name} is no object") };
        let size = [0, 1, 2].map(|i| bounds[1][i] - bounds[0][i]);
        assert!((size.iter().copied().fold(0.0, f64::max) - 1.0).abs() < 1e-5, "{name}: {size:?}");
        assert!(bounds[0][1].abs() < 1e-5, "{name} stands at {}", bounds[0][1]);
        for part in parts {
            let mesh = Mesh::from_bytes(&blobs.get(&part.mesh).expect("in memory").expect("stored")).expect("a mesh");
            assert!(part.material < materials.len());
            assert!(mesh.positions.iter().flatten().all(|v| v.is_finite()), "{name}");
            for normal in mesh.normals.iter().flatten() {
                let length = normal.iter().map(|v| v * v).sum::<f32>();
                assert!((length - 1.0).abs() < 1e-4, "{name}: {normal:?}");
            }
        }
        println!("{name}: {:?} {:?} {:?}", report.measures, report.repairs, report.notes);
    }
}

/// Skinned objects, and along which axis each is longest where its joints are. Raw vertices of the first three lie on
/// their backs.
const SKINNED: [(&str, usize); 4] =
    [("CesiumMan.glb", 1), ("BrainStem.glb", 1), ("RiggedFigure.glb", 1), ("Fox.glb", 2)];

#[test]
fn skinned_objects_stand_as_their_joints_do() {
    let Some(folder) = shared("gltf") else { return };
    let path = |name: &str| std::path::Path::new(&folder).join(name);
    // A copy of the folder need not hold all of them.
    let there: Vec<_> = SKINNED.into_iter().filter(|(name, _)| path(name).is_file()).collect();
    assert!(!there.is_empty(), "{folder} holds none of {SKINNED:?}");
    for (name, longest) in there {
        let path = path(name);
        let blobs = MemoryBlobs::default();
        let made = source(&blobs, "assets", json!({ "files": [path], "max_texture": 64 }), &BTreeMap::new());
        let report = &reports(&blobs, &made)[name];
        assert!(report.accepted, "{report:?}");
        assert!(!report.repairs.keys().any(|what| what.contains("weight")), "{report:?}");
        let asset: Asset = load(&blobs, made["assets"].get(name).expect("accepted"));
        let AssetBody::Object { bounds, .. } = &asset.body else { panic!("{name} is no object") };
        let size = [0, 1, 2].map(|i| bounds[1][i] - bounds[0][i]);
        println!("{name}: {size:?} {:?}", report.notes);
        assert!((size[longest] - 1.0).abs() < 1e-5, "{name}: {size:?}");
    }
}

#[test]
fn malformed_files_give_one_line_each() {
    let Some(folder) = shared("gltf-invalid") else { return };
    let blobs = MemoryBlobs::default();
    let made = source(&blobs, "assets", json!({ "folders": [folder] }), &BTreeMap::new());
    assert!(!made.contains_key("assets"), "none is accepted");
    let reports = reports(&blobs, &made);
    assert_eq!(reports.len(), 10);
    let says = BTreeMap::from([
        ("BoxWithInfinites.glb", "no vertex is finite"),
        ("IndexOutOfRange.gltf", "is named"),
        ("RecursiveNodes.gltf", "ancestor"),
        ("invalid_json_chunk.glb", "JSON"),
        ("invalid_length.gltf", "bufferView 0"),
        ("invalid_magic.glb", "header"),
        ("length_mismatch.glb", "states"),
        ("no_bin_chunk.glb", "buffer 0"),
        ("not_found.gltf", "not_found.bin"),
        ("truncated_chunk_data.glb", "chunk"),
    ]);
    for (name, report) in &reports {
        let line = report.reason.as_deref().expect("refused");
        println!("{line}");
        assert!(line.starts_with(&format!("{name}: ")) && !line.contains('\n') && line.contains("; "), "{line}");
        assert!(line.contains(says[name.as_str()]), "{line}");
    }
}
