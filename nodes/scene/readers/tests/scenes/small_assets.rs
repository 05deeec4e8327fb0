//! Small files made here: a GLB of every sort of accessor, maps with broken texels, and files with random damage.

use crate::{
    reports::report_on,
    support::{act, kind, load, shared},
};
use serde_json::{Value, json as object};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};
use tauflow_contract::{Artifact, Blobs, MemoryBlobs};
use tauflow_data::{
    Image,
    image_io::write_exr,
    mesh::Mesh,
    records::{Asset, AssetBody, AssetReport},
    rng::Stream,
    scene::{Bsdf, Texture},
};

/// A folder for files made here.
pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::create_dir_all(&folder).expect("a writable target folder");
    folder
}

/// Decodes one file; its report and asset.
fn decode(blobs: &MemoryBlobs, path: &Path) -> (AssetReport, Option<Artifact>) {
    let kind = kind("assets");
    let params = kind.resolve(&object!({ "files": [path] })).expect("fine params");
    let items = kind.items(&params).expect("the file");
    assert_eq!(items.len(), 1);
    let outputs = act(blobs, kind.as_ref(), &params, Some(&items[0]), BTreeMap::new()).expect("a report at least");
    (load(blobs, &outputs.items["reports"]), outputs.items.get("assets").cloned())
}

/// The asset that one file is, and its report.
pub fn asset(blobs: &MemoryBlobs, path: &Path) -> (AssetReport, Asset) {
    let (report, artifact) = decode(blobs, path);
    let artifact = artifact.unwrap_or_else(|| panic!("{report:?}"));
    (report, load(blobs, &artifact))
}

/// The mesh of a part.
pub fn mesh(blobs: &MemoryBlobs, asset: &Asset, part: usize) -> Mesh {
    let AssetBody::Object { parts, .. } = &asset.body else { panic!("no object") };
    Mesh::from_bytes(&blobs.get(&parts[part].mesh).expect("in memory").expect("stored")).expect("a mesh")
}

/// A GLB of a JSON and a binary chunk.
pub fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut text = json.as_bytes().to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut body = binary.to_vec();
    body.resize(body.len().next_multiple_of(4), 0);
    let mut out = b"glTF".to_vec();
    let total = 12 + 8 + text.len() + 8 + body.len();
    for word in [2, total as u32, text.len() as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(text);
    out.extend((body.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(body);
    out
}

/// Buffer, views and accessors in the making.
#[derive(Default)]
pub struct Data {
    pub bytes: Vec<u8>,
    views: Vec<Value>,
    pub accessors: Vec<Value>,
}

impl Data {
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(object!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend_from_slice(bytes);
        self.views.len() - 1
    }

    pub fn accessor(&mut self, bytes: &[u8], component: u32, sort: &str, count: usize, normalized: bool) -> usize {
        let view = self.view(bytes);
        self.accessors.push(object!({ "bufferView": view, "componentType": component, "type": sort, "count": count,
            "normalized": normalized }));
        self.accessors.len() - 1
    }

    pub fn floats(&mut self, values: &[f32], sort: &str, width: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&bytes, 5126, sort, values.len() / width, false)
    }

    pub fn file(&self, mut rest: Value) -> Vec<u8> {
        let fields = rest.as_object_mut().expect("an object");
        fields.insert("asset".into(), object!({ "version": "2.0" }));
        fields.insert("buffers".into(), object!([{ "byteLength": self.bytes.len() }]));
        fields.insert("bufferViews".into(), object!(self.views));
        fields.insert("accessors".into(), object!(self.accessors));
        glb(&rest.to_string(), &self.bytes)
    }
}

#[test]
fn accessors_of_every_sort_and_transforms_are_read() {
    let mut data = Data::default();
    // A square of normalised bytes, 127 standing for 1; one corner is moved by a sparse accessor.
    let corners: [[i8; 4]; 4] = [[0, 0, 0, 0], [127, 0, 0, 0], [127, 127, 0, 0], [0, 64, 0, 0]];
    let bytes: Vec<u8> = corners.as_flattened().iter().map(|v| *v as u8).collect();
    let positions = data.accessor(&bytes, 5120, "VEC3", 4, true);
    let view = data.accessors[positions]["bufferView"].as_u64().expect("a view") as usize;
    data.views[view]["byteStride"] = object!(4);
    let index = data.view(&[3]);
    let value = data.view(&[0, 127, 0]);
    data.accessors[positions]["sparse"] = object!({ "count": 1,
        "indices": { "bufferView": index, "componentType": 5121 }, "values": { "bufferView": value } });
    let colors =
        data.accessor(&[255, 0, 51, 255, 0, 0, 0, 255, 0, 0, 255, 255, 51, 51, 51, 128], 5121, "VEC4", 4, true);
    let uv = data.accessor(
        &[0u16, 0, 65535, 0, 65535, 65535, 0, 65535].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>(),
        5123,
        "VEC2",
        4,
        true,
    );
    let fan = data.accessor(&[0, 1, 2, 3], 5121, "SCALAR", 4, false);
    let strip: Vec<u8> = [0u16, 1, 3, 2].iter().flat_map(|v| v.to_le_bytes()).collect();
    let strip = data.accessor(&strip, 5123, "SCALAR", 4, false);
    let attributes = object!({ "POSITION": positions, "COLOR_0": colors, "TEXCOORD_0": uv });
    let material = object!({ "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorFactor": [1, 0.5, 1, 0.5] } });
    // Turned so that its z is up, doubled, mirrored; a child that is moved.
    let half = core::f32::consts::FRAC_1_SQRT_2;
    let bytes = data.file(object!({
        "materials": [material],
        "meshes": [{ "primitives": [
            { "attributes": attributes, "indices": fan, "mode": 6, "material": 0 },
            { "attributes": attributes, "indices": strip, "mode": 5, "material": 0 },
            { "attributes": attributes, "mode": 0 },
        ] }],
        "nodes": [{ "children": [1], "rotation": [-half, 0, 0, half], "scale": [2, 2, -2] },
            { "mesh": 0, "translation": [5, 0, 7] }],
        "scenes": [{ "nodes": [0] }],
    }));
    let path = folder("accessors").join("square.glb");
    fs::write(&path, bytes).expect("writable");
    let blobs = MemoryBlobs::default();
    let (report, asset) = asset(&blobs, &path);
    assert_eq!(report.measures["triangles"], 4.0);
    assert_eq!(report.measures["metres"], 2.0);
    assert_eq!(report.repairs["primitives of points or lines left out"], 1);
    for part in 0..2 {
        let mesh = mesh(&blobs, &asset, part);
        assert!(mesh.normals.is_none(), "flat");
        // The rotation takes y to -z, the mirror of z leaves the plane: the square lies flat, from -z to +z.
        let of = |corner: usize| mesh.positions[corner];
        let fits = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6);
        let expected = [[-0.5, 0.0, 0.5], [0.5, 0.0, 0.5], [0.5, 0.0, -0.5], [-0.5, 0.0, -0.5]];
        for corner in expected {
            assert!((0..4).any(|i| fits(of(i), corner)), "{corner:?} in {:?}", mesh.positions);
        }
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            let up = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2]);
            // Seen from the front before, the front is what the mirror leaves it: below.
            assert!(up < 0.0, "{mesh:?}");
        }
        let colors = mesh.colors.expect("vertex colours");
        assert!(colors.contains(&[1.0, 0.0, 0.2, 1.0]), "{colors:?}");
    }
    let AssetBody::Object { materials, parts, .. } = &asset.body else { panic!("no object") };
    assert!(parts.iter().all(|p| !p.closed && p.material == 0), "{parts:?}");
    let Bsdf::Mask { opacity, .. } = &materials[0].own else { panic!("{materials:?}") };
    assert!(matches!(opacity, Texture::Product { .. }), "factor times vertex alpha: {opacity:?}");
}

#[test]
fn materials_follow_their_extensions() {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3", 3);
    let materials = object!([
        { "emissiveFactor": [1, 0.5, 0], "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 8 },
            "KHR_materials_ior": { "ior": 2.0 }, "KHR_materials_clearcoat": { "clearcoatFactor": 0.5,
            "clearcoatRoughnessFactor": 0.25 } } },
        { "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.75 } } },
        { "extensions": { "KHR_materials_unlit": {} }, "alphaMode": "MASK", "alphaCutoff": 0.4,
            "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.2, 0.3, 0.3] } },
        { "extensions": { "KHR_materials_pbrSpecularGlossiness": { "diffuseFactor": [0.5, 0.25, 0.125, 1],
            "glossinessFactor": 0.75, "specularFactor": [0.02, 0.02, 0.02] } } },
    ]);
    let primitives: Vec<Value> =
        (0..4).map(|m| object!({ "attributes": { "POSITION": positions }, "material": m })).collect();
    let bytes = data.file(object!({ "materials": materials, "meshes": [{ "primitives": primitives }],
        "nodes": [{ "mesh": 0 }], "scenes": [{ "nodes": [0] }] }));
    let path = folder("materials").join("four.glb");
    fs::write(&path, bytes).expect("writable");
    let (report, asset) = asset(&MemoryBlobs::default(), &path);
    assert!(report.repairs.is_empty(), "{report:?}");
    assert!(report.notes.iter().any(|note| note.contains("8%")), "an index of 2: {report:?}");
    let AssetBody::Object { materials, .. } = asset.body else { panic!("no object") };
    let inner = |bsdf: &Bsdf| match bsdf {
        Bsdf::TwoSided { inner } => (**inner).clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!(materials[0].emission, Some(Texture::rgb([8.0, 4.0, 0.0])));
    let Bsdf::Principled { specular, clearcoat, clearcoat_gloss, .. } = inner(&materials[0].own) else { panic!() };
    // F0 = 1/9, beyond what the parameter can say.
    assert_eq!((specular, clearcoat, clearcoat_gloss), (1.0, 0.5, 0.75));
    assert!(materials[1].transmissive);
    let Bsdf::Blend { weight, b, .. } = &materials[1].own else { panic!("{:?}", materials[1]) };
    assert!(*weight == Texture::scalar(0.75) && matches!(**b, Bsdf::ThinDielectric { .. }));
    let Bsdf::Mask { opacity, inner: masked } = &materials[2].own else { panic!("{:?}", materials[2]) };
    assert!(*opacity == Texture::scalar(0.0) && materials[2].own == materials[2].diffuse);
    assert!(matches!(inner(masked), Bsdf::Diffuse { .. }));
    let Bsdf::Principled { base_color, roughness, specular, metallic, .. } = inner(&materials[3].own) else { panic!() };
    assert_eq!((base_color, metallic), (Texture::rgb([0.5, 0.25, 0.125]), Texture::scalar(0.0)));
    assert!(roughness == Texture::scalar(0.25) && (specular - 0.25).abs() < 1e-6);
}

#[test]
fn values_beyond_what_the_format_allows_are_cut_and_counted() {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3", 3);
    let colors = data.floats(&[0.5, 2.0, 0.25, 1.0, 0.5, 1.0, -0.25, 1.0, 0.5, 1.0, 0.25, 1.0], "VEC4", 4);
    let uv = data.floats(&[0.0, f32::NAN, 1.0, 0.0, 0.0, 1.0], "VEC2", 2);
    let material = object!({ "pbrMetallicRoughness": { "baseColorFactor": [2, 0.5, 1, 1], "metallicFactor": 1.5,
        "roughnessFactor": -1, "baseColorTexture": { "index": 0 } }, "emissiveFactor": [1, 0, 0], "extensions": {
        "KHR_materials_emissive_strength": { "emissiveStrength": 1e8 }, "KHR_materials_ior": { "ior": 9 },
        "KHR_materials_clearcoat": { "clearcoatFactor": 3, "clearcoatRoughnessFactor": 0.5 } } });
    // A white pixel.
    let png = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGP4//8/AAX+Av4N70a4AAAAAElFTkSuQmCC";
    let bytes = data.file(object!({ "materials": [material], "nodes": [{ "mesh": 0 }], "scenes": [{ "nodes": [0] }],
        "images": [{ "uri": format!("data:image/png;base64,{png}") }], "textures": [{ "source": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": positions, "COLOR_0": colors, "TEXCOORD_0": uv },
            "material": 0 }] }] }));
    let path = folder("beyond").join("bright.glb");
    fs::write(&path, bytes).expect("writable");
    let blobs = MemoryBlobs::default();
    let (report, asset) = asset(&blobs, &path);
    let count = |name: &str| report.repairs.get(name).copied().unwrap_or(0);
    // Base colour, metallic, roughness and clearcoat.
    assert_eq!(count("material factors outside of 0 to 1 cut to it"), 4, "{report:?}");
    assert_eq!(count("values of vertex colours outside of 0 to 1 cut to it"), 2, "{report:?}");
    assert_eq!(count("texture coordinates that are not finite set to 0"), 1, "{report:?}");
    assert_eq!(count("indices of refraction outside of 1 to 4 cut to it"), 1, "{report:?}");
    assert_eq!(count("radiances outside of 0 to 1e6 cut to it"), 1, "{report:?}");
    let mesh = mesh(&blobs, &asset, 0);
    assert_eq!(mesh.colors.expect("colours")[..2], [[0.5, 1.0, 0.25, 1.0], [0.5, 1.0, 0.0, 1.0]]);
    let AssetBody::Object { materials, .. } = &asset.body else { panic!("no object") };
    assert_eq!(materials[0].emission, Some(Texture::rgb([1e6, 0.0, 0.0])));
}

#[test]
fn values_that_the_format_allows_but_that_cannot_be_worked_with_are_set_and_counted() {
    // A tetrahedron, or one of its sides.
    let import = |name: &str, triangles: usize, extensions: Value| {
        let mut data = Data::default();
        let corners = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let positions = data.floats(&corners, "VEC3", 3);
        let indices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3];
        let indices = data.accessor(&indices[..3 * triangles], 5121, "SCALAR", 3 * triangles, false);
        let bytes = data.file(object!({ "materials": [{ "extensions": extensions }], "nodes": [{ "mesh": 0 }],
            "scenes": [{ "nodes": [0] }], "meshes": [{ "primitives": [{ "attributes": { "POSITION": positions },
            "indices": indices, "material": 0 }] }] }));
        let path = folder("unworkable").join(name);
        fs::write(&path, bytes).expect("writable");
        let (report, asset) = asset(&MemoryBlobs::default(), &path);
        let AssetBody::Object { materials, .. } = asset.body else { panic!("no object") };
        (report.repairs, materials[0].own.clone())
    };
    let body = |thickness: f64, color: [f64; 3]| {
        let volume = object!({ "thicknessFactor": thickness, "attenuationDistance": 1.0, "attenuationColor": color });
        let extensions = object!({ "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_volume": volume });
        import("body.glb", 4, extensions).0
    };
    let (colors, thick) = (
        "attenuation colours outside of 1e-6 to 1 cut to it",
        "thicknesses of more than 1000 attenuation distances cut to it",
    );
    let counted = |list: &[(&str, u64)]| -> BTreeMap<String, u64> {
        list.iter().map(|(what, n)| ((*what).to_owned(), *n)).collect()
    };
    assert_eq!(body(1000.0, [1e-6, 0.5, 1.0]), counted(&[]));
    assert_eq!(body(1.0, [0.0, -1.0, 1.5]), counted(&[(colors, 3)]));
    assert_eq!(body(1001.0, [0.5, 0.5, 1.0]), counted(&[(thick, 1)]));
    // White loses nothing, however thick.
    assert_eq!(body(1e6, [1.0; 3]), counted(&[]));
    let pane = |ior: f64| {
        let extensions = object!({ "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_ior": { "ior": ior } });
        let (repairs, own) = import("pane.glb", 1, extensions);
        let Bsdf::Blend { b, .. } = &own else { panic!("{own:?}") };
        let Bsdf::ThinDielectric { int_ior, .. } = &**b else { panic!("{own:?}") };
        (repairs, *int_ior)
    };
    let thin = "indices of refraction of thin or open surfaces below 1.01 set to it";
    assert_eq!(pane(1.005), (counted(&[(thin, 1)]), 1.01));
    assert_eq!(pane(1.01), (counted(&[]), 1.01));
}

#[test]
fn volumes_tint_closed_bodies_by_their_thickness() {
    let mut data = Data::default();
    // A tetrahedron.
    let corners = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let positions = data.floats(&corners, "VEC3", 3);
    let indices = data.accessor(&[0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], 5121, "SCALAR", 12, false);
    let volume = object!({ "thicknessFactor": 3.0, "attenuationDistance": 1.5, "attenuationColor": [0.25, 0.5, 1.0] });
    let material = object!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1 },
        "KHR_materials_volume": volume }, "pbrMetallicRoughness": { "baseColorFactor": [1, 0.5, 1, 1] } });
    let bytes = data.file(object!({ "materials": [material], "nodes": [{ "mesh": 0 }], "scenes": [{ "nodes": [0] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": positions }, "indices": indices,
            "material": 0 }] }] }));
    let path = folder("volumes").join("body.glb");
    fs::write(&path, bytes).expect("writable");
    let (report, asset) = asset(&MemoryBlobs::default(), &path);
    assert!(report.notes.iter().any(|n| n.contains("attenuation")), "{report:?}");
    let AssetBody::Object { materials, .. } = asset.body else { panic!("no object") };
    let Bsdf::Principled { base_color, .. } = &materials[0].own else { panic!("{:?}", materials[0]) };
    let Texture::Product { a, b } = base_color else { panic!("{base_color:?}") };
    let (Texture::Constant { value: own }, Texture::Constant { value: tint }) = (&**a, &**b) else { panic!() };
    // Twice the distance: the square of the colour.
    let off = |found: f32, expected: f32| (found - expected).abs() > 1e-6;
    assert!(*own == [1.0, 0.5, 1.0] && !tint.iter().zip([0.0625, 0.25, 1.0]).any(|(f, e)| off(*f, e)), "{tint:?}");
}

#[test]
fn maps_with_broken_texels_are_mended_and_counted() {
    let folder = folder("maps");
    let mut image = Image::new(4, 2, 3);
    image.data_mut().fill(1.5);
    image.pixel_mut(1, 0).copy_from_slice(&[f32::NAN, -2.0, 0.5]);
    image.pixel_mut(2, 1).copy_from_slice(&[f32::INFINITY, 7.0, f32::NEG_INFINITY]);
    let path = folder.join("tiny.exr");
    write_exr(&path, &[("", &image)]).expect("writable");
    let blobs = MemoryBlobs::default();
    let (report, made) = asset(&blobs, &path);
    let AssetBody::Hdri { image, size, .. } = made.body else { panic!("no environment") };
    assert_eq!(size, [4, 2]);
    let image = Image::from_bytes(&blobs.get(&image).expect("in memory").expect("stored")).expect("a bitmap");
    assert_eq!(image.pixel(1, 0), &[0.0, 0.0, 0.5]);
    assert_eq!(image.pixel(2, 1), &[7.0, 7.0, 0.0]);
    assert_eq!(report.repairs["NaN values set to 0"], 1);
    assert_eq!(report.repairs["negative values set to 0"], 2);
    assert_eq!(report.repairs["infinite values set to the largest finite"], 1);
    assert_eq!(report.repairs["texels repaired"], 2);
    let path = folder.join("Größe 1.hdr");
    fs::write(&path, b"#?RGBE\n\n-Y 1 +X 2\n\x80\x40\x20\x81\x80\x80\x80\x80").expect("writable");
    let (report, made) = asset(&blobs, &path);
    assert_eq!((report.name.as_str(), made.name.as_str()), ("Gr__e_1.hdr", "Gr__e_1.hdr"));
    assert!(report.repairs.is_empty(), "{report:?}");
}

/// Runs files with bytes changed, dropped or cut off through the kind: no panic, and one line for each that is refused.
fn damage(name: &str, whole: &[u8], times: usize) {
    let kind = kind("assets");
    let params = kind.resolve(&object!({ "files": ["unused"], "max_texture": 16 })).expect("fine params");
    let mut draw = Stream::new(11, &[]).part(name);
    let mut refused = 0;
    for round in 0..times {
        let mut bytes = whole.to_vec();
        match round % 4 {
            0 => bytes.truncate(draw.below(whole.len())),
            1 => {
                let at = draw.below(whole.len());
                bytes.drain(at..(at + 1 + draw.below(8)).min(whole.len()));
            }
            _ => (0..1 + draw.below(6)).for_each(|_| {
                // Half of the damage goes to the first kilobyte, where headers and JSON are.
                let reach = if draw.chance(0.5) { whole.len().min(1024) } else { whole.len() };
                bytes[draw.below(reach)] = draw.bits() as u8;
            }),
        }
        let report = report_on(kind.as_ref(), &params, name, &bytes);
        assert_eq!(report.accepted, report.reason.is_none());
        if let Some(line) = report.reason {
            refused += 1;
            assert!(line.starts_with(name) && !line.contains('\n') && line.contains("; "), "{line}");
        }
    }
    assert!(refused * 4 > times, "{name}: {refused} of {times} refused");
}

#[test]
fn damaged_files_of_draco_never_panic() {
    // What the fuzz test does more of with smaller files.
    let Some(folder) = shared("gltf") else { return };
    let name = "carbon-sphere.glb";
    damage(name, &fs::read(Path::new(&folder).join(name)).expect("a shared file"), 24);
}
