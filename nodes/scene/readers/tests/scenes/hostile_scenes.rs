//! Scenes that are made to cost much, or that hold numbers nobody would write: each is read or refused in lines that
//! name file, place and remedy, within ten seconds and a gibibyte. Each is below 1 MB.

use crate::{
    fuzz::{held_by, timed},
    support::{act, kind, load},
};
use flate2::{Compression, write::ZlibEncoder};
use std::{
    collections::BTreeMap, fmt::Write as _, fs, io::Write as _, os::unix::fs::symlink, path::Path, time::Duration,
};
use tauflow_contract::{KindError, MemoryBlobs};
use tauflow_data::{Image, image_io::write_exr, records::AssetReport, scene::Bsdf};
use tauflow_scene_readers::{Loaded, Options, load_scene};

/// Seconds of one processor that a scene may take.
const LONGEST: u64 = 10;

/// Writes files into an empty folder; reads the first one as a scene. What it takes and holds is bounded.
pub fn read(files: &[(&str, &[u8])]) -> Result<Loaded, String> {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in files {
        assert!(bytes.len() <= 1 << 20, "{name}: {} bytes", bytes.len());
        fs::write(folder.path().join(name), bytes).expect("writable");
    }
    bounded(&folder.path().join(files[0].0), 0)
}

fn bounded(path: &Path, view: usize) -> Result<Loaded, String> {
    let options = Options { approximate: true, ..Options::default() };
    let ((done, held), took) = timed(|| held_by(|| load_scene(path, None, view, options)));
    assert!(took < Duration::from_secs(LONGEST) && held < 1 << 30, "{}: {took:?} and {held} bytes", path.display());
    done.map_err(|error| match error {
        KindError::Input(text) => text,
        other => panic!("no error of input: {other}"),
    })
}

/// What is told of a scene that is refused; each line has a file, a place and a remedy, and none is long.
pub fn refused(files: &[(&str, &[u8])]) -> String {
    let told = read(files).map(|_| ()).expect_err(files[0].0);
    for line in told.lines().filter(|line| !line.starts_with("and ")) {
        let shaped = line.contains(": ") && line.contains("; ") && line.len() < 2000;
        assert!(shaped && files.iter().any(|(name, _)| line.starts_with(name)), "{line}");
    }
    told
}

/// A pbrt file around these lines.
pub fn pbrt(world: &str) -> String {
    format!("Camera \"perspective\"\nWorldBegin\nLightSource \"point\"\n{world}\n")
}

/// A Mitsuba file around these lines.
pub fn mitsuba(inside: &str) -> String {
    format!(
        "<scene version=\"3.0.0\">\n<integrator type=\"path\"/><sensor type=\"perspective\"><float name=\"fov\" \
         value=\"40\"/></sensor>\n<emitter type=\"constant\"/>\n{inside}\n</scene>\n"
    )
}

#[test]
fn shapes_of_impossible_sizes_are_refused_with_their_lines() {
    for shape in [
        "\"sphere\" \"float radius\" -1",
        "\"sphere\" \"float radius\" 0",
        "\"sphere\" \"float radius\" 1 \"float zmin\" 2",
        "\"sphere\" \"float radius\" 1 \"float phimax\" 0",
        "\"disk\" \"float radius\" 0",
        "\"disk\" \"float phimax\" -3",
        "\"cylinder\" \"float phimax\" 0",
        "\"sphere\" \"float radius\" 1e300",
        "\"disk\" \"float radius\" 1e30",
    ] {
        let told = refused(&[("a.pbrt", pbrt(&format!("Shape {shape}")).as_bytes())]);
        assert!(told.starts_with("a.pbrt: line 4: "), "{shape}: {told}");
    }
    for inside in [
        "<shape type=\"sphere\"><float name=\"radius\" value=\"0\"/></shape>",
        "<shape type=\"sphere\"><transform name=\"to_world\"><scale value=\"0\"/></transform></shape>",
        "<shape type=\"disk\"><transform name=\"to_world\"><scale x=\"0\"/></transform></shape>",
        "<shape type=\"cube\"><transform name=\"to_world\"><scale x=\"1e300\"/></transform></shape>",
        "<emitter type=\"constant\"/>",
        "<emitter type=\"spot\"><float name=\"cutoff_angle\" value=\"500\"/></emitter>",
        "<emitter type=\"directional\"><transform name=\"to_world\"><scale value=\"0\"/></transform></emitter>",
    ] {
        let told = refused(&[("a.xml", mitsuba(inside).as_bytes())]);
        assert!(told.starts_with("a.xml: line 4: "), "{inside}: {told}");
    }
    let camera = "<scene version=\"3.0.0\"><emitter type=\"constant\"/>\n<sensor type=\"perspective\"><float \
                  name=\"fov\" value=\"40\"/><transform name=\"to_world\"><scale value=\"0\"/></transform></sensor>\
                  </scene>";
    let told = refused(&[("a.xml", camera.as_bytes())]);
    assert!(told.starts_with("a.xml: line 2: a camera whose transform leaves it no view"), "{told}");
}

#[test]
fn a_colour_that_refers_to_itself_is_refused() {
    let inside = "<bsdf type=\"diffuse\"><spectrum type=\"srgb\" name=\"reflectance\" id=\"a\"><ref name=\"color\" \
                  id=\"a\"/></spectrum></bsdf>";
    let shape = format!("<shape type=\"sphere\">{inside}</shape>");
    let told = refused(&[("a.xml", mitsuba(&shape).as_bytes())]);
    assert!(told.contains("a.xml: line 4: a colour that refers to itself"), "{told}");
}

#[test]
fn materials_of_impossible_numbers_are_refused_with_their_lines() {
    for bsdf in [
        "type=\"roughconductor\"><float name=\"alpha\" value=\"1000\"/>",
        "type=\"dielectric\"><float name=\"int_ior\" value=\"1e30\"/>",
        "type=\"plastic\"><float name=\"int_ior\" value=\"0\"/>",
        "type=\"thindielectric\"><float name=\"ext_ior\" value=\"0.001\"/>",
        "type=\"blendbsdf\"><bsdf type=\"mask\"><bsdf type=\"diffuse\"/></bsdf><bsdf type=\"diffuse\"/>",
    ] {
        let inside = format!("<shape type=\"cube\"><bsdf {bsdf}</bsdf></shape>");
        let told = refused(&[("a.xml", mitsuba(&inside).as_bytes())]);
        assert!(told.starts_with("a.xml: line 4: "), "{bsdf}: {told}");
    }
    for material in [
        "\"conductor\" \"float roughness\" 100 \"bool remaproughness\" false",
        "\"dielectric\" \"float eta\" 1e20",
        "\"dielectric\" \"float eta\" -1",
    ] {
        let told = refused(&[("a.pbrt", pbrt(&format!("Material {material} Shape \"sphere\"")).as_bytes())]);
        assert!(told.starts_with("a.pbrt: line 4: "), "{material}: {told}");
    }
}

#[test]
fn tessellated_shapes_are_counted_before_they_are_made() {
    let mut world = String::new();
    for i in 0..600 {
        writeln!(world, "Shape \"sphere\" \"float phimax\" {}", 100.0 + 0.1 * f64::from(i)).expect("in memory");
    }
    let told = refused(&[("a.pbrt", pbrt(&world).as_bytes())]);
    assert!(told.contains("mesh: with it the file asks for more than"), "{told}");
    // Spheres of many radii are one mesh.
    let mut world =
        "Texture \"t\" \"spectrum\" \"checkerboard\"\nMaterial \"diffuse\" \"texture reflectance\" \"t\"\n".to_owned();
    for i in 1..200 {
        writeln!(world, "Shape \"sphere\" \"float radius\" {}", 0.1 * f64::from(i)).expect("in memory");
    }
    let loaded = read(&[("a.pbrt", pbrt(&world).as_bytes())]).expect("a scene");
    assert_eq!((loaded.scene.shapes.len(), loaded.blobs.len()), (199, 1));
    // Curved patches by the indices of one.
    let patches = "0 1 2 3 ".repeat(100_000);
    let world =
        format!("Shape \"bilinearmesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0 1 1 1] \"integer indices\" [{patches}]");
    let told = refused(&[("a.pbrt", pbrt(&world).as_bytes())]);
    assert!(told.contains("mesh: with it the file asks for more than"), "{told}");
}

fn ply(faces: usize) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face \
         {faces}\nproperty list uchar int vertex_indices\nend_header\n",
        faces + 2
    );
    for i in 0..faces + 2 {
        writeln!(text, "{} {} 0", i % 2, i).expect("in memory");
    }
    for i in 0..faces {
        writeln!(text, "3 {i} {} {}", i + 1, i + 2).expect("in memory");
    }
    text
}

#[test]
fn meshes_that_are_scaled_in_many_ways_are_read_once_and_counted() {
    let (mesh, mut inside) = (ply(20_000), String::new());
    for i in 0..3000 {
        writeln!(
            inside,
            "<shape type=\"ply\"><string name=\"filename\" value=\"m.ply\"/><transform name=\"to_world\"><scale \
             x=\"{}\"/></transform></shape>",
            2 + i
        )
        .expect("in memory");
    }
    let told = refused(&[("a.xml", mitsuba(&inside).as_bytes()), ("m.ply", mesh.as_bytes())]);
    assert!(told.contains("with it the file asks for more than"), "{told}");
}

#[test]
fn fans_and_meshes_in_packed_files_cost_what_they_show() {
    let count = 200_000;
    let mut fan = format!(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face \
         1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n{count}"
    );
    (0..count).for_each(|i| fan.push_str([" 0", " 1", " 2"][i % 3]));
    let inside = "<shape type=\"ply\"><string name=\"filename\" value=\"m.ply\"/></shape>";
    let loaded = read(&[("a.xml", mitsuba(inside).as_bytes()), ("m.ply", fan.as_bytes())]).expect("a fan");
    assert_eq!(loaded.scene.shapes.len(), 1);
    // One packed mesh of 32 MB that a thousand entries of the list lead to.
    let mut body = 0u32.to_le_bytes().to_vec();
    body.push(0);
    body.extend(2_000_000u64.to_le_bytes());
    body.extend(1u64.to_le_bytes());
    body.resize(body.len() + 2_000_000 * 12 + 12, 0);
    let mut zip = ZlibEncoder::new(vec![0x1c, 0x04, 4, 0], Compression::best());
    zip.write_all(&body).expect("in memory");
    let mut file = zip.finish().expect("in memory");
    file.extend(vec![0; 8 * 1000]);
    file.extend(1000u32.to_le_bytes());
    let mut inside = String::new();
    for i in 1..1000 {
        writeln!(
            inside,
            "<shape type=\"serialized\"><string name=\"filename\" value=\"m.serialized\"/><integer \
             name=\"shape_index\" value=\"{i}\"/></shape>"
        )
        .expect("in memory");
    }
    let told = refused(&[("a.xml", mitsuba(&inside).as_bytes()), ("m.serialized", &file)]);
    assert!(told.contains("m.serialized") || told.contains("with it the file asks for more than"), "{told}");
}

#[test]
fn vertices_that_are_not_finite_are_noted() {
    let mesh = ply(3).replacen("0 0 0\n", "nan 0 0\n", 1);
    let inside = "<shape type=\"ply\"><string name=\"filename\" value=\"m.ply\"/></shape>";
    let loaded = read(&[("a.xml", mitsuba(inside).as_bytes()), ("m.ply", mesh.as_bytes())]).expect("a mesh");
    let note = "a.xml: line 4: 1 vertices of `m.ply` are not finite, and their triangles are left out";
    assert!(loaded.notes.iter().any(|n| n == note), "{:?}", loaded.notes);
}

#[test]
fn chains_of_blends_are_counted_over_the_whole_file() {
    let mut inside = "<bsdf type=\"diffuse\" id=\"b0\"/>\n".to_owned();
    for i in 1..12 {
        let ends = format!("<ref id=\"b{}\"/><ref id=\"b{}\"/>", i - 1, i - 1);
        writeln!(inside, "<bsdf type=\"blendbsdf\" id=\"b{i}\">{ends}</bsdf>").expect("in memory");
    }
    for i in 0..1500 {
        writeln!(
            inside,
            "<shape type=\"cube\"><bsdf type=\"blendbsdf\"><float name=\"weight\" value=\"{}\"/><ref id=\"b10\"/><ref \
             id=\"b10\"/></bsdf></shape>",
            f64::from(i) / 1500.0
        )
        .expect("in memory");
    }
    let told = refused(&[("a.xml", mitsuba(&inside).as_bytes())]);
    assert!(told.contains("BSDFs in BSDFs without end"), "{told}");
    let mut world = "MakeNamedMaterial \"m0\" \"string type\" \"diffuse\"\n".to_owned();
    for i in 1..11 {
        let j = i - 1;
        writeln!(world, "MakeNamedMaterial \"m{i}\" \"string type\" \"mix\" \"string materials\" [\"m{j}\" \"m{j}\"]")
            .expect("in memory");
    }
    for i in 0..1500 {
        let amount = f64::from(i) / 1500.0;
        writeln!(
            world,
            "Material \"mix\" \"string materials\" [\"m10\" \"m10\"] \"float amount\" {amount} Shape \"sphere\""
        )
        .expect("in memory");
    }
    let told = refused(&[("a.pbrt", pbrt(&world).as_bytes())]);
    assert!(told.contains("without end"), "{told}");
}

#[test]
fn many_materials_are_told_apart_quickly() {
    let mut inside = String::new();
    for i in 0..7000 {
        writeln!(
            inside,
            "<shape type=\"cube\"><bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"{}\"/></bsdf></shape>",
            f64::from(i % 3500) / 7000.0
        )
        .expect("in memory");
    }
    let loaded = read(&[("a.xml", mitsuba(&inside).as_bytes())]).expect("a scene");
    assert_eq!((loaded.scene.materials.len(), loaded.scene.shapes.len()), (3500, 7000));
    assert!(matches!(loaded.scene.materials[0], Bsdf::Diffuse { .. }));
}

fn exr(side: usize) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("map.exr");
    let image = Image::from_data(side, side, 3, vec![0.5; side * side * 3]).expect("fits");
    write_exr(&path, &[("", &image)]).expect("writable");
    fs::read(&path).expect("written")
}

#[test]
fn pictures_have_a_bound_on_their_sum_and_one_by_many_names_is_one() {
    let picture = exr(2048);
    let names: Vec<String> = (0..40).map(|i| format!("p{i}.exr")).collect();
    let textured = |name: &str| {
        format!(
            "<shape type=\"cube\"><bsdf type=\"diffuse\"><texture type=\"bitmap\" name=\"reflectance\"><string \
             name=\"filename\" value=\"{name}\"/></texture></bsdf></shape>\n"
        )
    };
    let many: String = names.iter().map(|name| textured(name)).collect();
    let scene = mitsuba(&many);
    let mut files: Vec<(&str, &[u8])> = vec![("a.xml", scene.as_bytes())];
    files.extend(names.iter().map(|name| (name.as_str(), picture.as_slice())));
    let told = refused(&files);
    assert!(told.contains("with it the file asks for more than"), "{told}");
    let many: String = (0..200).map(|i| textured(&format!("{}p.exr", "./".repeat(i)))).collect();
    let loaded = read(&[("a.xml", mitsuba(&many).as_bytes()), ("p.exr", &picture)]).expect("one picture");
    assert_eq!((loaded.blobs.len(), loaded.scene.materials.len()), (1, 1));
}

#[test]
fn maps_of_many_texels_are_not_spread_at_any_cost() {
    let lit = "LightSource \"infinite\" \"string filename\" \"p.exr\"\n".repeat(100);
    let scene = format!("Camera \"perspective\"\nWorldBegin\n{lit}Shape \"sphere\"\n");
    let told = refused(&[("a.pbrt", scene.as_bytes()), ("p.exr", &exr(300))]);
    assert!(told.contains("a second environment"), "{told}");
}

#[test]
fn defaults_attributes_and_parameters_cost_what_they_are() {
    let long = "x".repeat(60_000);
    let mut text = format!("<default name=\"d\" value=\"{long}\"/>\n<shape type=\"cube\">");
    (0..15_000).for_each(|i| writeln!(text, "<string name=\"n{i}\" value=\"$d\"/>").expect("in memory"));
    let told = refused(&[("a.xml", mitsuba(&format!("{text}</shape>")).as_bytes())]);
    assert!(told.contains("defaults are put into too many values"), "{told}");
    let named = format!("<default name=\"{long}\" value=\"1\"/><shape type=\"cube\" id=\"${long}\"/>");
    assert!(refused(&[("a.xml", mitsuba(&named).as_bytes())]).contains("a default's name has more than 256 bytes"));
    let mut many = String::new();
    (0..60_000).for_each(|i| write!(many, " a{i}=\"\"").expect("in memory"));
    let told = refused(&[("a.xml", mitsuba(&format!("<shape type=\"cube\"{many}/>")).as_bytes())]);
    assert!(told.starts_with("a.xml: line 4: an element of more than 64 attributes"), "{told}");
    let mut many = "<shape type=\"cube\">".to_owned();
    (0..25_000).for_each(|i| writeln!(many, "<float name=\"n{i}\" value=\"1\"/>").expect("in memory"));
    let told = refused(&[("a.xml", mitsuba(&format!("{many}</shape>")).as_bytes())]);
    assert!(told.contains("the parameter `n0` of the shape `cube` is not supported"), "{told}");
    let mut many = "Shape \"sphere\"".to_owned();
    (0..60_000).for_each(|i| write!(many, " \"float n{i}\" 1").expect("in memory"));
    assert!(refused(&[("a.pbrt", pbrt(&many).as_bytes())]).contains("the parameter `n0` of Shape"));
}

#[test]
fn comments_and_quotes_hide_no_attributes_and_make_none() {
    let inside = format!(
        "<!-- <shape {} /> -->\n<shape type=\"cube\"><string name=\"id\" value='{}'/></shape>",
        "a=\"\" ".repeat(100),
        "=".repeat(200)
    );
    let told = refused(&[("a.xml", mitsuba(&inside).as_bytes())]);
    assert!(told.starts_with("a.xml: line 5: the parameter `id` of the shape `cube`"), "{told}");
}

#[test]
fn files_are_not_included_at_any_cost() {
    let blank = " ".repeat(1 << 20);
    let again = "Include \"b\"\n".repeat(9000);
    let told = refused(&[("a.pbrt", pbrt(&again).as_bytes()), ("b", blank.as_bytes())]);
    assert!(told.contains("files are included again and again"), "{told}");
    let again = "<include filename=\"b.xml\"/>\n".repeat(900);
    let blank = format!("<scene version=\"3.0.0\">{}</scene>", " ".repeat(1_000_000));
    let told = refused(&[("a.xml", mitsuba(&again).as_bytes()), ("b.xml", blank.as_bytes())]);
    assert!(told.contains("files are included again and again"), "{told}");
}

#[test]
fn instances_of_many_shapes_are_counted() {
    let shapes = "Shape \"sphere\"\n".repeat(5000);
    let instances = "ObjectInstance \"o\"\n".repeat(30_000);
    let world = format!("ObjectBegin \"o\"\n{shapes}ObjectEnd\n{instances}");
    let told = refused(&[("a.pbrt", pbrt(&world).as_bytes())]);
    assert!(told.contains("more than a million shapes"), "{told}");
}

#[test]
fn marks_of_encodings_are_understood_or_named() {
    let scene = pbrt("Shape \"sphere\"");
    let marked = [b"\xEF\xBB\xBF", scene.as_bytes()].concat();
    assert_eq!(read(&[("a.pbrt", &marked)]).expect("a scene").scene.shapes.len(), 1);
    let wide: Vec<u8> = [0xFF, 0xFE].into_iter().chain(scene.bytes().flat_map(|b| [b, 0])).collect();
    for name in ["a.pbrt", "a.xml"] {
        let told = refused(&[(name, &wide)]);
        assert!(told.contains("it is UTF-16; unpack it, or save it as UTF-8"), "{told}");
    }
}

#[test]
fn many_cameras_are_refused() {
    let sensor = "<sensor type=\"perspective\"><float name=\"fov\" value=\"40\"/></sensor>\n".repeat(2000);
    let told = refused(&[("a.xml", mitsuba(&sensor).as_bytes())]);
    assert!(told.contains("2001 cameras; more than 1024 are not supported"), "{told}");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.xml");
    fs::write(&path, mitsuba(&sensor)).expect("writable");
    let kind = kind("scene_files");
    let params = serde_json::json!({ "scenes": [{ "path": path, "stratum": "L0-open" }] });
    assert_eq!(kind.items(&kind.resolve(&params).expect("fine params")).expect("items").len(), 1024);
}

#[test]
fn a_link_that_leads_nowhere_is_left_out_with_a_report() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("b.pbrt"), pbrt("Shape \"sphere\"")).expect("writable");
    symlink("nowhere", folder.path().join("a.pbrt")).expect("writable");
    let (kind, blobs) = (kind("scene_files"), MemoryBlobs::default());
    let params = |leave_out: bool| {
        let entry = serde_json::json!([{ "path": folder.path(), "stratum": "L0-open" }]);
        kind.resolve(&serde_json::json!({ "scenes": entry, "leave_out": leave_out })).expect("fine params")
    };
    let told = kind.items(&params(false)).expect_err("a link to nothing").to_string();
    assert!(told.contains("a.pbrt` cannot be read"), "{told}");
    let params = params(true);
    let items = kind.items(&params).expect("one of them can be read");
    let reports: Vec<AssetReport> = items
        .iter()
        .map(|item| {
            let outputs = act(&blobs, kind.as_ref(), &params, Some(item), BTreeMap::new()).expect("a report");
            load(&blobs, &outputs.items["reports"])
        })
        .collect();
    assert_eq!(reports.iter().map(|r| r.accepted).collect::<Vec<_>>(), [false, true]);
    let reason = reports[0].reason.as_deref().expect("a reason");
    assert!(reason.starts_with("L0-open-000000: file: no regular file"), "{reason}");
}
