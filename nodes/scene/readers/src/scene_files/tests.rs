//! Files of every sort as scenes, and what is said of those that cannot be.

mod gltf_files;
mod mitsuba;
mod pbrt_files;

use super::*;
use std::{fs, sync::atomic::AtomicBool};
use tauflow_contract::{KindRow, MemoryBlobs, NodeKind as _, Silent};
use tauflow_data::{
    Image,
    mesh::Mesh,
    scene::{Bsdf, Camera, Geometry, Texture},
};

/// A scene in files of these names.
fn load(name: &str, text: &str, more: &[(&str, Vec<u8>)], approximate: bool) -> Result<Loaded, String> {
    let mut parts: BTreeMap<String, Vec<u8>> =
        more.iter().map(|(name, bytes)| (given::part(name), bytes.clone())).collect();
    parts.insert(given::MAIN.to_owned(), text.as_bytes().to_vec());
    let options = Options { approximate, light_unit: LightUnit::Candela };
    read(name, &Setting::camera(0), &parts, options).map_err(|e| e.to_string())
}

fn xml(inside: &str) -> String {
    format!(
        "<scene version=\"3.0.0\">\n<sensor type=\"perspective\"><float name=\"fov\" value=\"40\"/>\n\
         <transform name=\"to_world\"><lookat origin=\"0,1,5\" target=\"0,1,0\" up=\"0,1,0\"/></transform>\n\
         <film type=\"hdrfilm\"><integer name=\"width\" value=\"200\"/><integer name=\"height\" value=\"100\"/>\n\
         <rfilter type=\"box\"/></film></sensor>\n<emitter type=\"constant\"/>\n{inside}</scene>"
    )
}

fn mesh_of(loaded: &Loaded, shape: usize) -> Mesh {
    let Geometry::Mesh { mesh } = &loaded.scene.shapes[shape].geometry else { panic!("no mesh") };
    Mesh::from_bytes(&loaded.blobs[mesh]).expect("a mesh")
}

const OBJ: &[u8] = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0.25\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";

#[test]
fn a_mitsuba_file_is_read_with_defaults_references_and_includes() {
    let text = xml("<default name=\"grey\" value=\"0.25\"/><default name=\"file\" value=\"t\"/>\n\
         <bsdf type=\"twosided\" id=\"paint\"><bsdf type=\"diffuse\">\
         <rgb name=\"reflectance\" value=\"$grey\"/></bsdf></bsdf>\n\
         <include filename=\"more/parts.xml\"/>\n\
         <shape type=\"rectangle\"><ref id=\"paint\"/><transform name=\"to_world\"><scale value=\"2\"/>\
         <rotate x=\"1\" angle=\"-90\"/><translate y=\"0.5\"/></transform></shape>\n\
         <shape type=\"obj\"><string name=\"filename\" value=\"$file.obj\"/><ref id=\"gold\"/>\
         <emitter type=\"area\"><rgb name=\"radiance\" value=\"1,2,3\"/></emitter></shape>\n\
         <integrator type=\"path\"><integer name=\"max_depth\" value=\"7\"/></integrator>\n");
    let parts = "<scene version=\"3.0.0\"><bsdf type=\"roughconductor\" id=\"gold\"><string name=\"material\" \
                 value=\"Au\"/><float name=\"alpha\" value=\"0.2\"/><string name=\"distribution\" \
                 value=\"ggx\"/></bsdf></scene>";
    let files = [("more/parts.xml", parts.as_bytes().to_vec()), ("t.obj", OBJ.to_vec())];
    let loaded = load("a.xml", &text, &files, false).expect("all of it is supported");
    let scene = &loaded.scene;
    assert_eq!((scene.max_depth, loaded.film), (7, Some([200, 100])));
    let camera =
        Camera { origin: [0.0, 1.0, 5.0], target: [0.0, 1.0, 0.0], up: [0.0, 1.0, 0.0], fov_x: 40.0, near: 0.01 };
    assert_eq!(scene.camera, camera);
    let grey = Bsdf::TwoSided { inner: Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.25) }) };
    assert_eq!(scene.materials[scene.shapes[0].material], grey);
    assert_eq!(scene.shapes[0].to_world, [[2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.5], [0.0, -2.0, 0.0, 0.0]]);
    let Bsdf::Conductor { eta, alpha, .. } = &scene.materials[scene.shapes[1].material] else { panic!("gold") };
    assert_eq!((eta[0], *alpha), (0.143_036, 0.2));
    assert_eq!(scene.shapes[1].emission, Some(Texture::rgb([1.0, 2.0, 3.0])));
    let mesh = mesh_of(&loaded, 1);
    // OBJ has v upwards, and no normals means smooth ones.
    assert!(mesh.uvs.expect("given").contains(&[0.0, 0.75]));
    assert!(mesh.normals.expect("made").iter().all(|n| *n == [0.0, 0.0, 1.0]));
}

#[test]
fn all_that_a_mitsuba_file_asks_too_much_is_named_with_its_line() {
    let text = xml("<shape type=\"sphere\"><bsdf type=\"hair\"/></shape>\n\
         <shape type=\"bsplinecurve\"/>\n\
         <shape type=\"sphere\"><bsdf type=\"roughplastic\"><float name=\"alpha_u\" value=\"0.3\"/>\
         <float name=\"alpha_v\" value=\"0.1\"/></bsdf></shape>\n\
         <shape type=\"cube\"><bsdf type=\"diffuse\"><float name=\"glow\" value=\"3\"/></bsdf></shape>\n\
         <shape type=\"disk\"><ref id=\"nothing\"/><medium type=\"homogeneous\" name=\"interior\"/></shape>\n\
         <shape type=\"cube\"><bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"2\"/></bsdf></shape>\n\
         <emitter type=\"sunsky\"/>\n\
         <shape type=\"ply\"><string name=\"filename\" value=\"../../none.ply\"/></shape>\n\
         <shape type=\"cube\"><bsdf type=\"measured\"/></shape>\n");
    let told = load("a.xml", &text, &[], false).expect_err("much of it is not");
    let expected = [
        (7, "the bsdf `hair` is not supported"),
        (8, "the shape `bsplinecurve` is not supported"),
        (9, "a plastic whose `alpha` is a texture or depends on the direction"),
        (10, "the parameter `glow` of the bsdf `diffuse` is not supported"),
        (11, "there is no `nothing`"),
        (11, "the medium `homogeneous`"),
        (12, "`reflectance` is [2.0, 2.0, 2.0]"),
        (13, "the emitter `sunsky` is not supported"),
        (14, "`../../none.ply` is no file"),
        (15, "the bsdf `measured` is not supported"),
    ];
    for (line, what) in expected {
        let found = told.lines().any(|l| l.starts_with(&format!("a.xml: line {line}: ")) && l.contains(what));
        assert!(found, "line {line}, {what}:\n{told}");
    }
    // What is only nearly the same may be allowed.
    let brushed = xml("<shape type=\"sphere\"><bsdf type=\"normalmap\"><rgb name=\"normalmap\" value=\"0.5 0.5 1\"/>\
         <bsdf type=\"roughconductor\"><float name=\"alpha_u\" value=\"0.3\"/><float name=\"alpha_v\" value=\"0.1\"/>\
         </bsdf></bsdf></shape>");
    assert!(load("a.xml", &brushed, &[], false).is_err());
    let notes = load("a.xml", &brushed, &[], true).expect("allowed").notes;
    assert!(
        notes.iter().any(|n| n.contains("line 7: approximated: the direction of anisotropic roughness")),
        "{notes:?}"
    );
}

#[test]
fn hostile_mitsuba_files_are_refused() {
    let deep = format!("{}{}", "<bsdf type=\"twosided\">".repeat(5000), "</bsdf>".repeat(5000));
    let loops = "<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf><shape type=\"cube\"><ref id=\"a\"/></shape>";
    let groups = "<shape type=\"shapegroup\" id=\"g\"><shape type=\"instance\"><ref id=\"g\"/></shape></shape>\
                  <shape type=\"instance\"><ref id=\"g\"/></shape>";
    let bomb =
        "<!DOCTYPE scene [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;\">]><scene version=\"3\">&b;</scene>";
    let spread = "<default name=\"a\" value=\"aaaaaaaaaaaaaaaa\"/>".to_owned()
        + &format!("<string name=\"x\" value=\"{}\"/>", "$a".repeat(9000));
    let doubled = (0..40).fold("<bsdf type=\"diffuse\" id=\"b0\"/>".to_owned(), |text, i| {
        let (id, of) = (i + 1, format!("<ref id=\"b{i}\"/>"));
        text + &format!("<bsdf type=\"blendbsdf\" id=\"b{id}\">{of}{of}</bsdf>")
    });
    let doubled = doubled + "<shape type=\"cube\"><ref id=\"b30\"/></shape>";
    for (text, what) in [
        (xml(&doubled), "without end"),
        (xml(&deep), "too deep"),
        (xml(loops), "without end"),
        (xml(groups), "an instance in a group"),
        (bomb.to_owned(), "no XML"),
        (xml(&spread), "too long"),
        ("<scene".to_owned(), "no XML"),
        ("<bsdf/>".to_owned(), "its root is `bsdf`"),
        (xml("<include filename=\"a.xml\"/>"), "no file"),
        (xml("<shape type=\"ply\"><string name=\"filename\" value=\"/etc/passwd\"/></shape>"), "no file"),
        (xml("").replace("3.0.0", "0.6.0"), "version 0.6.0"),
        (xml("").replace("<emitter type=\"constant\"/>", ""), "nothing in it gives light"),
        ("<scene version=\"3.0.0\"/>".to_owned(), "there is no camera"),
    ] {
        let told = load("a.xml", &text, &[], false).expect_err(what);
        assert!(told.contains(what) && told.len() < 60_000, "{what}: {told}");
    }
    let own = xml("<include filename=\"b.xml\"/>");
    let again = b"<scene version=\"3.0.0\"><include filename=\"b.xml\"/><include filename=\"b.xml\"/></scene>".to_vec();
    assert!(load("a.xml", &own, &[("b.xml", again)], false).expect_err("a loop").contains("too many files"));
}

const PBRT: &str = "Film \"rgb\" \"integer xresolution\" 200 \"integer yresolution\" 100\n\
    PixelFilter \"box\"\nIntegrator \"volpath\" \"integer maxdepth\" 3\n";

#[test]
fn a_pbrt_file_is_read_and_mirrored_as_its_left_hand_asks() {
    let text = format!(
        "{PBRT}LookAt 0 1 5  0 1 0  0 1 0\nCamera \"perspective\" \"float fov\" 40\nWorldBegin\n\
         LightSource \"infinite\" \"rgb L\" [1 2 3] \"float scale\" 2\n\
         Texture \"checks\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [.1 .2 .3]\n\
         \"float uscale\" 4 \"float vscale\" 8\n\
         MakeNamedMaterial \"a b\" \"string type\" \"diffuse\" \"texture reflectance\" \"checks\"\n\
         AttributeBegin\n Translate 3 0 0\n NamedMaterial \"a b\"\n\
         Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2]\nAttributeEnd\n\
         ObjectBegin \"ball\"\n\
         Material \"dielectric\" \"float eta\" 1.4\nShape \"sphere\" \"float radius\" 0.5 ObjectEnd\n\
         AttributeBegin Translate 1 2 3 Scale 2 2 2 ObjectInstance \"ball\" AttributeEnd\n\
         AttributeBegin AreaLightSource \"diffuse\" \"rgb L\" [4 4 4] ReverseOrientation\nShape \"disk\" AttributeEnd\n"
    );
    let scene = load("a.pbrt", &text, &[], false).expect("all of it is supported").scene;
    assert_eq!(scene.max_depth, 4);
    assert_eq!(scene.emitters, [Emitter::Constant { radiance: [2.0, 4.0, 6.0] }]);
    // What was at x = 3 is at -3, seen by a camera whose right is where pbrt's left is.
    assert_eq!(scene.shapes[0].to_world[0], [-1.0, 0.0, 0.0, -3.0]);
    assert_eq!(scene.shapes[1].to_world, [[-2.0, 0.0, 0.0, -1.0], [0.0, 2.0, 0.0, 2.0], [0.0, 0.0, 2.0, 3.0]]);
    assert_eq!(scene.shapes[1].geometry, Geometry::Sphere { center: [0.0; 3], radius: 0.5 });
    assert!(scene.shapes[2].flip_normals && scene.shapes[2].emission == Some(Texture::rgb([4.0; 3])));
    let near = |a: [f64; 3], b: [f64; 3]| assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9), "{a:?} {b:?}");
    near(scene.camera.origin, [0.0, 1.0, 5.0]);
    near(scene.camera.target, [0.0, 1.0, 4.0]);
    near(scene.camera.up, [0.0, 1.0, 0.0]);
    assert!((scene.camera.fov_x - 72.104_77).abs() < 1e-4, "40 degrees are along the shorter side");
    let Bsdf::TwoSided { inner } = &scene.materials[scene.shapes[0].material] else { panic!("two sides") };
    let checks = Texture::Checkerboard { color0: [0.1, 0.2, 0.3], color1: [0.0; 3], scale: [4.0, 8.0] };
    assert_eq!(**inner, Bsdf::Diffuse { reflectance: checks });
    // With the mirroring scale that files from right-handed programs have, nothing is turned.
    let right = text.replace("LookAt", "Scale -1 1 1 LookAt");
    let scene = load("a.pbrt", &right, &[], false).expect("as before").scene;
    assert_eq!(scene.shapes[0].to_world[0], [1.0, 0.0, 0.0, 3.0]);
    near(scene.camera.origin, [0.0, 1.0, 5.0]);
}

#[test]
fn pictures_of_pbrt_have_their_first_row_on_top() {
    let bytes = tauflow_data::image_io::exr_bytes(&[("", &Image::from_data(2, 2, 3, vec![0.5; 12]).expect("fits"))]);
    let text = format!(
        "{PBRT}Camera \"perspective\"\nWorldBegin\nLightSource \"point\" \"rgb I\" [1 1 1] \"point3 from\" [1 2 3]\n\
         Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"t.exr\"\n\
         \"float vscale\" 2 \"float udelta\" 0.5\n\
         Texture \"s\" \"spectrum\" \"scale\" \"texture tex\" \"t\" \"float scale\" 0.5\n\
         Material \"diffuse\" \"texture reflectance\" \"s\"\n\
         Shape \"bilinearmesh\" \"point3 P\" [0 0 1 1 0 1 0 1 1 1 1 1]\n"
    );
    let loaded = load("a.pbrt", &text, &[("t.exr", bytes.expect("written"))], false).expect("all of it is supported");
    let Bsdf::TwoSided { inner } = &loaded.scene.materials[0] else { panic!("two sides") };
    let Bsdf::Diffuse { reflectance: Texture::Bitmap { uv, scale, .. } } = &**inner else { panic!("a picture") };
    assert_eq!((uv, scale), (&[[1.0, 0.0, 0.5], [0.0, -2.0, 1.0]], &[0.5; 3]));
    let mesh = mesh_of(&loaded, 0);
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (4, 2));
    assert_eq!(loaded.scene.emitters, [Emitter::Point { position: [-1.0, 2.0, 3.0], intensity: [1.0; 3] }]);
}

#[test]
fn all_that_a_pbrt_file_asks_too_much_is_named_with_its_line() {
    let text = "Camera \"realistic\"\nWorldBegin\nLightSource \"spot\"\n\
                Material \"hair\" Shape \"sphere\"\nShape \"curve\"\nMaterial \"diffuse\" \"float glow\" 1\n\
                Shape \"sphere\"\nMediumInterface \"fog\" \"\"\nShape \"plymesh\" \"string filename\" \"../x.ply\"\n\
                NamedMaterial \"none\"\nShape \"disk\"\nAttributeBegin\nObjectInstance \"none\"\n";
    let told = load("a.pbrt", text, &[], false).expect_err("much of it is not");
    for (line, what) in [
        (1, "Camera `realistic` is not supported"),
        (3, "a spot's smooth edge"),
        (4, "the material `hair` is not supported"),
        (5, "Shape `curve` is not supported"),
        (6, "the parameter `glow` of Material `diffuse` is not supported"),
        (8, "MediumInterface `fog` is not supported"),
        (9, "`../x.ply` is no file"),
        (10, "there is no material `none`"),
        (12, "a block without its end"),
        (13, "there is no object `none`"),
    ] {
        let found = told.lines().any(|l| l.starts_with(&format!("a.pbrt: line {line}: ")) && l.contains(what));
        assert!(found, "line {line}, {what}:\n{told}");
    }
}

#[test]
fn approximations_of_pbrt_state_how_large_they_are() {
    let text = "Camera \"perspective\"\nWorldBegin\nLightSource \"spot\" \"float coneangle\" 30 \"float \
                conedeltaangle\" 5\n\
                Material \"dielectric\" \"spectrum eta\" \"glass-BK7\"\nShape \"sphere\"\n\
                Material \"coateddiffuse\"\nShape \"sphere\"\n";
    let notes = load("a.pbrt", text, &[], true).expect("allowed").notes;
    for figure in
        ["by up to 11% of the peak within the edge, and by -0.5% in all light", "varies by 0.5% from blue", "2.6%"]
    {
        assert!(notes.iter().any(|note| note.contains(figure)), "{figure}: {notes:#?}");
    }
}

#[test]
fn a_file_of_pbrt_v3_is_told_in_one_line() {
    for (text, line, what) in [
        (
            "WorldBegin\nMaterial \"matte\" \"rgb Kd\" [1 1 1]\nShape \"heightfield\"\nWorldEnd",
            2,
            "`Material \"matte\"`",
        ),
        ("WorldBegin\nShape \"sphere\" \"float radius\" 1\nWorldEnd", 3, "`WorldEnd`"),
        ("SurfaceIntegrator \"path\"\nhello", 1, "`SurfaceIntegrator \"path\"`"),
        ("WorldBegin\nMakeNamedMaterial \"a\" \"string type\" \"uber\"", 2, "`MakeNamedMaterial \"a\"`"),
    ] {
        let told = load("a.pbrt", text, &[], false).expect_err("of version 3");
        let start =
            format!("a.pbrt: line {line}: {what} says that it is a file of pbrt-v3; convert it by `pbrt --upgrade");
        assert!(told.starts_with(&start) && told.lines().count() == 1, "{told}");
    }
}

/// A triangle with a camera and three lights, in data URIs.
fn gltf_text() -> String {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let values = [0.0f32, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 4.0, 0.0];
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    json!({
        "asset": { "version": "2.0" }, "scene": 0,
        "scenes": [{ "nodes": [0, 1, 2, 3, 4, 5] }],
        "nodes": [
            { "mesh": 0, "translation": [10.0, 0.0, 0.0] },
            { "camera": 0, "translation": [0.0, 1.0, 5.0] },
            { "translation": [0.0, 3.0, 0.0], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
            { "rotation": [-core::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0, core::f64::consts::FRAC_1_SQRT_2],
              "extensions": { "KHR_lights_punctual": { "light": 1 } } },
            { "extensions": { "KHR_lights_punctual": { "light": 2 } } },
            { "camera": 1 }
        ],
        "cameras": [
            { "type": "perspective", "perspective": { "yfov": 0.7, "aspectRatio": 2.0, "znear": 0.1 } },
            { "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 10 } }
        ],
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": { "KHR_lights_punctual": { "lights": [
            { "type": "point", "intensity": 683.0, "color": [1.0, 0.5, 0.0] },
            { "type": "directional", "intensity": 5.0 },
            { "type": "spot", "spot": { "innerConeAngle": 0.1, "outerConeAngle": 0.2 } }
        ] } },
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                        "min": [0, 0, 0], "max": [4, 4, 0] }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "buffers": [{ "byteLength": 36,
            "uri": format!("data:application/octet-stream;base64,{}", STANDARD.encode(bytes)) }]
    })
    .to_string()
}

#[test]
fn a_gltf_file_is_a_scene_with_its_cameras_and_lights() {
    let text = gltf_text();
    assert_eq!(gltf::cameras(text.as_bytes()), 2);
    let loaded = load("a.gltf", &text, &[], false).expect("all of it is supported");
    let scene = &loaded.scene;
    let (camera, film) = (&scene.camera, loaded.film.expect("by its aspect"));
    assert_eq!((camera.origin, camera.target, film), ([0.0, 1.0, 5.0], [0.0, 1.0, 4.0], [1024, 512]));
    let half = tauflow_data::maths::tan(0.35) * 2.0;
    assert!((tauflow_data::maths::tan(camera.fov_x.to_radians() / 2.0) - half).abs() < 1e-6);
    let (mesh, map) = (mesh_of(&loaded, 0), &scene.shapes[0].to_world);
    let corner = tauflow_data::geom::apply(map, mesh.positions[1].map(f64::from));
    assert!(tauflow_data::geom::length(tauflow_data::geom::sub(corner, [14.0, 0.0, 0.0])) < 1e-5, "{corner:?}");
    assert_eq!(scene.emitters[0], Emitter::Point { position: [0.0, 3.0, 0.0], intensity: [683.0, 341.5, 0.0] });
    let Emitter::Directional { direction, irradiance } = &scene.emitters[1] else { panic!("a sun") };
    assert!((direction[1] + 1.0).abs() < 1e-6 && *irradiance == [5.0; 3], "{direction:?}");
    let Emitter::Spot { to_world, cutoff_angle, beam_width, .. } = &scene.emitters[2] else { panic!("a spot") };
    assert_eq!([0, 1, 2].map(|r: usize| to_world[r][2]), [0.0, 0.0, -1.0]);
    assert!((cutoff_angle - 0.2f64.to_degrees()).abs() < 1e-9 && (beam_width - 0.1f64.to_degrees()).abs() < 1e-9);
    // In watts a point light of 683 candela is one of 1.
    let parts = BTreeMap::from([(given::MAIN.to_owned(), text.as_bytes().to_vec())]);
    let options = Options { approximate: false, light_unit: LightUnit::Watt };
    let watts = read("a.gltf", &Setting::camera(0), &parts, options).expect("as before").scene;
    assert_eq!(watts.emitters[0], Emitter::Point { position: [0.0, 3.0, 0.0], intensity: [1.0, 0.5, 0.0] });
    let told = read("a.gltf", &Setting::camera(1), &parts, options).expect_err("no such camera here").to_string();
    assert!(told.contains("camera 1: orthographic cameras are not supported"), "{told}");
}

#[test]
fn folders_and_files_become_items_by_stratum_and_view() {
    let folder = tempfile::tempdir().expect("a folder");
    let root = folder.path();
    let put = |name: &str, bytes: &[u8]| {
        let path = root.join(name);
        fs::create_dir_all(path.parent().expect("in the folder")).expect("made");
        fs::write(path, bytes).expect("written");
    };
    let scene = xml("<include filename=\"../shared/part.xml\"/><shape type=\"obj\"><string name=\"filename\" \
                     value=\"../shared/t.obj\"/></shape>");
    put("rooms/room.xml", scene.as_bytes());
    put("shared/part.xml", b"<scene version=\"3.0.0\"><emitter type=\"point\"/></scene>");
    put("shared/t.obj", OBJ);
    put("two.gltf", gltf_text().as_bytes());
    let entry = |path: &str, stratum: &str| ScenePath {
        path: root.join(path).display().to_string(),
        stratum: stratum.parse().expect("a stratum"),
    };
    let params = SceneFilesParams {
        scenes: vec![entry("", "L1-enclosed"), entry("two.gltf", "L0-open")],
        leave_out: true,
        ..SceneFilesParams::default()
    };
    assert_eq!(SceneFiles::check(&params), []);
    let items = SceneFiles::items(&params).expect("listed");
    let keys: Vec<&str> = items.iter().map(|i| i.key.as_str()).collect();
    // The included file is a piece, and each camera a scene.
    let expected =
        ["L1-enclosed-000000", "L1-enclosed-000001", "L1-enclosed-000002", "L0-open-000000", "L0-open-000001"];
    assert_eq!(keys, expected);
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let run = |item: &SourceItem| {
        let bytes = |(name, path): &(String, std::path::PathBuf)| (name.clone(), fs::read(path).expect("there"));
        let file = Files(item.files.iter().map(bytes).collect()).store(&ctx).expect("in memory").into_artifact();
        let read = SceneFiles::project(&params, Some(&item.key), "main");
        let params: SceneFilesParams = serde_json::from_value(read).expect("its own");
        let each = BTreeMap::from([(tauflow_contract::FILE_PORT, &file)]);
        let action = Action { params, item: Some(&item.key), group: "main", seed: 0, each, all: BTreeMap::new() };
        let outputs = SceneFiles::run(&ctx, &action).expect("it is left out at worst");
        let record = outputs.items.get("scenes").map(|a| SceneRecord::load(&ctx, a).expect("a scene"));
        (record, AssetReport::load(&ctx, &outputs.items["reports"]).expect("a report"))
    };
    let (room, report) = run(&items[0]);
    let room = room.unwrap_or_else(|| panic!("{report:?}"));
    assert_eq!((room.recipe.stratum.as_str(), room.recipe.index, room.scene.shapes.len()), ("L1-enclosed", 0, 1));
    assert_eq!(room.recipe.layout, "file/room.xml");
    let (first, _) = run(&items[1]);
    let (second, told) = run(&items[2]);
    assert_eq!(first.expect("its first camera").recipe.layout, "file/two.gltf");
    assert!(second.is_none() && told.reason.expect("told").contains("orthographic"), "its second");
    // A file that is named alone may not leave its own folder.
    let alone = load_scene(&root.join("rooms/room.xml"), None, 0, Options::default()).expect_err("outside").to_string();
    assert!(alone.contains("`../shared/part.xml` is no file of up to 2 GiB below the folder"), "{alone}");
    load_scene(&root.join("rooms/room.xml"), Some(root), 0, Options::default()).expect("inside");
    // The root may be spelled in any way, but neither `..` nor a link leads out of it.
    let load = |path: &str, below: &str| {
        let loaded = load_scene(&root.join(path), Some(&root.join(below)), 0, Options::default());
        loaded.map(|_| ()).map_err(|error| error.to_string())
    };
    std::os::unix::fs::symlink("../rooms", root.join("shared/link")).expect("a link");
    for (path, below) in
        [("rooms/room.xml", "shared/.."), ("shared/../rooms/room.xml", ""), ("shared/link/room.xml", "")]
    {
        assert_eq!(load(path, below), Ok(()), "{path} below {below}");
    }
    for path in ["shared/../rooms/room.xml", "shared/link/room.xml"] {
        let told = load(path, "shared").expect_err("outside");
        assert!(told.contains("does not lie below"), "{told}");
    }
    let told = load("shared/link/room.xml", "rooms").expect_err("its files are outside");
    assert!(told.contains("`../shared/part.xml` is no file of up to 2 GiB below the folder"), "{told}");
    assert!(load("rooms/room.xml", "none").expect_err("no folder").contains("none` is no folder; name one"));
    assert!(load("none/room.xml", "").expect_err("no scene").contains("mend the path"));
    let bad = serde_json::json!({ "scenes": [{ "path": "a.xml", "stratum": "my scenes" }] });
    let problems = KindRow::<SceneFiles>::new().resolve(&bad).expect_err("no stratum");
    assert_eq!(problems[0].pointer, "/scenes/0/stratum");
}

#[test]
fn no_cut_or_changed_file_makes_a_panic() {
    let texts = [
        ("a.xml", xml("<shape type=\"sphere\"><bsdf type=\"plastic\"/><emitter type=\"area\"/></shape>")),
        ("a.pbrt", format!("{PBRT}Camera \"perspective\"\nWorldBegin\nLightSource \"distant\"\nShape \"sphere\"\n")),
        ("a.gltf", gltf_text()),
    ];
    for (name, text) in texts {
        load(name, &text, &[], true).unwrap_or_else(|e| panic!("{name}: {e}"));
        let bytes = text.as_bytes();
        for at in (0..bytes.len()).step_by(3) {
            for with in [b'"', b'9', b'<', b' ', b'-'] {
                let mut changed = bytes.to_vec();
                changed[at] = with;
                let Ok(changed) = String::from_utf8(changed) else { continue };
                let _ = load(name, &changed, &[], true);
                let _ = named(name, changed.as_bytes(), &Given::Parts(&BTreeMap::new()));
            }
            let _ = load(name, &text[..at], &[], true);
        }
    }
}
