//! What Mitsuba makes of its files, where it is not what one would guess.

use super::*;

#[test]
fn maps_that_mirror_turn_what_has_no_normals_as_mitsuba_does() {
    let ply = |normals: bool| {
        let (names, of) =
            if normals { ("property float nx\nproperty float ny\nproperty float nz\n", " 0 0 1") } else { ("", "") };
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{names}\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n\
             0 0 0{of}\n1 0 0{of}\n0 1 0{of}\n3 0 1 2\n"
        )
        .into_bytes()
    };
    let files = [("bare.ply", ply(false)), ("own.ply", ply(true))];
    // Each printed by Mitsuba 3.9.1: whether the shading normal of a mirrored shape faces inwards.
    for (shape, turns) in [
        ("<shape type=\"sphere\">", true),
        ("<shape type=\"rectangle\">", false),
        ("<shape type=\"disk\">", false),
        ("<shape type=\"cube\">", false),
        ("<shape type=\"cylinder\">", false),
        ("<shape type=\"ply\"><string name=\"filename\" value=\"bare.ply\"/>", true),
        ("<shape type=\"ply\"><string name=\"filename\" value=\"own.ply\"/>", false),
        (
            "<shape type=\"ply\"><boolean name=\"face_normals\" value=\"true\"/>\
          <string name=\"filename\" value=\"own.ply\"/>",
            true,
        ),
    ] {
        for (flip, mirrored) in [(false, false), (false, true), (true, true)] {
            let side = if mirrored { -2.0 } else { 2.0 };
            let text = xml(&format!(
                "{shape}<transform name=\"to_world\"><scale x=\"{side}\" y=\"2\" z=\"2\"/></transform>\
                 <boolean name=\"flip_normals\" value=\"{flip}\"/></shape>"
            ));
            let loaded = load("a.xml", &text, &files, false).expect("all of it is supported");
            assert_eq!(loaded.scene.shapes[0].flip_normals, flip != (turns && mirrored), "{shape} {flip} {mirrored}");
        }
    }
    // An instance that mirrors turns nothing.
    let group = "<shape type=\"shapegroup\" id=\"g\"><shape type=\"ply\"><string name=\"filename\" value=\"bare.ply\"/>\
                 </shape></shape><shape type=\"instance\"><ref id=\"g\"/><transform name=\"to_world\">\
                 <scale x=\"-1\"/></transform></shape>";
    let loaded = load("a.xml", &xml(group), &files, false).expect("all of it is supported");
    assert!(!loaded.scene.shapes[0].flip_normals);
}

#[test]
fn paths_that_count_passages_are_told() {
    let of = |integrator: &str, bsdf: &str| {
        xml(&format!("{integrator}<shape type=\"cube\"><bsdf type=\"{bsdf}\"><bsdf type=\"diffuse\"/></bsdf></shape>"))
    };
    let depth = "<integer name=\"max_depth\" value=\"5\"/>";
    let counts = format!("<integrator type=\"path\">{depth}</integrator>");
    let told = load("a.xml", &of(&counts, "mask"), &[], false).expect_err("an approximation");
    assert!(told.starts_with("a.xml: line 7: `max_depth` of `path` counts passages through masks"), "{told}");
    for (integrator, bsdf) in [
        (format!("<integrator type=\"volpath\">{depth}</integrator>"), "mask"),
        ("<integrator type=\"path\"/>".to_owned(), "mask"),
        (counts, "twosided"),
    ] {
        load("a.xml", &of(&integrator, bsdf), &[], false).expect("all of it is supported");
    }
}

#[test]
fn what_mitsuba_refuses_or_shows_otherwise_is_told_with_its_line() {
    let text = xml("<shape type=\"cube\" colour=\"red\"><bsdf type=\"diffuse\" idd=\"x\"/></shape>\n\
         <shape type=\"cube\"><transform name=\"to_world\">\
         <rotate axis=\"y\" y=\"1\" angle=\"3\"/></transform></shape>\n\
         <shape type=\"sphere\"><integer name=\"radius\" value=\"2.5\"/></shape>\n\
         <shape type=\"sphere\"><float name=\"radius\" value=\"-1\"/></shape>\n\
         <shape type=\"sphere\"><transform name=\"to_world\"><scale x=\"2\"/></transform></shape>\n\
         <shape type=\"cube\"><bsdf type=\"twosided\"><bsdf type=\"dielectric\"/></bsdf></shape>\n\
         <emitter type=\"directional\"><vector name=\"direction\" value=\"0,0,0\"/></emitter>\n\
         <emitter type=\"point\"><spectrum type=\"blackbody\" name=\"intensity\">\
         <float name=\"temperature\" value=\"-5\"/></spectrum></emitter>\n");
    let told = load("a.xml", &text, &[], true).expect_err("none of it is sound");
    let expected = [
        (7, "`shape` has no attribute `colour`"),
        (7, "`bsdf` has no attribute `idd`"),
        (8, "`rotate` has no attribute `axis`"),
        (9, "`2.5` is no integer"),
        (10, "a sphere of radius -1"),
        (11, "a sphere that is scaled unevenly"),
        (12, "`twosided` about what lets light through"),
        (13, "a light without a direction"),
        (14, "a black body of -5 kelvin"),
    ];
    for (line, what) in expected {
        let found = told.lines().any(|l| l.starts_with(&format!("a.xml: line {line}: ")) && l.contains(what));
        assert!(found, "line {line}, {what}:\n{told}");
    }
}

/// A file by search path, as scenes of the world name them.
const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

#[test]
fn files_are_looked_for_in_search_paths_the_last_one_first() {
    let text = xml("<path value=\"one/\"/><path value=\"./two\"/>\n\
         <shape type=\"obj\"><string name=\"filename\" value=\"m.obj\"/></shape>\n\
         <shape type=\"obj\"><string name=\"filename\" value=\"sub/n.obj\"/></shape>\n\
         <shape type=\"obj\"><string name=\"filename\" value=\"own.obj\"/></shape>\n\
         <include filename=\"more.xml\"/>\n");
    let moved = TRIANGLE.replace("1 0 0", "9 0 0");
    let files = [
        ("one/m.obj", TRIANGLE.as_bytes().to_vec()),
        ("two/m.obj", moved.as_bytes().to_vec()),
        ("one/sub/n.obj", TRIANGLE.as_bytes().to_vec()),
        ("own.obj", TRIANGLE.as_bytes().to_vec()),
        ("two/more.xml", b"<scene version=\"3.0.0\"><shape type=\"cube\"/></scene>".to_vec()),
    ];
    let loaded = load("a.xml", &text, &files, false).expect("all of it is there");
    assert_eq!(loaded.scene.shapes.len(), 4);
    assert_eq!(mesh_of(&loaded, 0).positions[1], [9.0, 0.0, 0.0]);
    // They are found on disk as they are in memory.
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in &files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("writable");
        fs::write(path, bytes).expect("writable");
    }
    fs::write(folder.path().join("a.xml"), &text).expect("writable");
    let again = load_scene(&folder.path().join("a.xml"), None, 0, Options::default()).expect("as before");
    assert_eq!(again.scene.shapes, loaded.scene.shapes);
    let told = load("a.xml", &xml("<path value=\"/usr/share\"/>"), &[], false).expect_err("an absolute path");
    assert!(told.contains("line 7: the search path `/usr/share` is not relative to the main file"), "{told}");
}

#[test]
fn an_integrator_inside_another_one_is_what_renders() {
    let cube = "<shape type=\"cube\"/>";
    for wrapped in [
        "<integrator type=\"moment\"><integrator type=\"path\"><integer name=\"max_depth\" value=\"7\"/></integrator>\
         </integrator>",
        "<integrator type=\"aov\"><string name=\"aovs\" value=\"dd.y:depth\"/>\
         <integrator type=\"moment\" name=\"x\">\
         <integrator type=\"volpath\"><integer name=\"max_depth\" value=\"7\"/></integrator></integrator></integrator>",
    ] {
        let loaded = load("a.xml", &xml(&format!("{wrapped}{cube}")), &[], false).expect("a path tracer inside");
        assert_eq!(loaded.scene.max_depth, 7, "{wrapped}");
    }
    let told = load("a.xml", &xml(&format!("<integrator type=\"aov\"/>{cube}")), &[], false).expect_err("no radiance");
    assert!(told.contains("`aov` with 0 integrators inside is not supported"), "{told}");
}

#[test]
fn emitters_are_shared_by_reference() {
    let text = xml("<emitter type=\"area\" id=\"glow\"><rgb name=\"radiance\" value=\"3\"/></emitter>\n\
         <shape type=\"rectangle\"><ref id=\"glow\"/></shape><shape type=\"disk\"><ref id=\"glow\"/></shape>");
    let loaded = load("a.xml", &text, &[], false).expect("two lamps");
    let lit = |shape: &tauflow_data::scene::Shape| shape.emission == Some(Texture::rgb([3.0; 3]));
    assert!(loaded.scene.shapes.iter().all(lit), "{:?}", loaded.scene.shapes);
}

#[test]
fn what_is_not_rendered_is_named_with_its_line() {
    let fog = "<medium type=\"homogeneous\" id=\"fog\"/>\n";
    load("a.xml", &xml(&format!("{fog}<shape type=\"cube\"/>")), &[], false).expect("nothing is filled with it");
    for (inside, what) in [
        (
            "<shape type=\"cube\"><ref name=\"interior\" id=\"fog\"/></shape>",
            "the medium `homogeneous` inside the shape `cube` is not supported",
        ),
        ("<emitter type=\"projector\"/>", "the emitter `projector` is not supported"),
        ("<shape type=\"cube\"><bsdf type=\"polarizer\"/></shape>", "the bsdf `polarizer` is not supported"),
        ("<shape type=\"bsplinecurve\"/>", "the shape `bsplinecurve` is not supported"),
        ("<shape type=\"sdfgrid\"/>", "the shape `sdfgrid` is not supported"),
    ] {
        let told = load("a.xml", &xml(&format!("{fog}{inside}")), &[], false).expect_err(inside);
        assert!(told.starts_with(&format!("a.xml: line 8: {what}")), "{told}");
    }
}

#[test]
fn a_far_clip_matters_where_it_cuts() {
    let of = |far: &str, scale: &str| {
        xml(&format!(
            "<shape type=\"cube\"><transform name=\"to_world\"><scale value=\"{scale}\"/></transform></shape>"
        ))
        .replace("<float name=\"fov\" value=\"40\"/>", &format!("<float name=\"fov\" value=\"40\"/>{far}"))
    };
    let far = "<float name=\"far_clip\" value=\"7\"/>";
    let loaded = load("a.xml", &of(far, "1"), &[], false).expect("it ends at 6");
    assert!(!loaded.notes.iter().any(|note| note.contains("far_clip")), "{:?}", loaded.notes);
    for text in [of(far, "3"), of("", "20000")] {
        let told = load("a.xml", &text, &[], false).expect_err("it goes on");
        assert!(told.contains("line 2: `far_clip` of") && told.contains("cuts the scene"), "{told}");
        load("a.xml", &text, &[], true).expect("allowed");
    }
}

#[test]
fn a_missing_texture_is_one_mistake() {
    let gone = "<texture type=\"bitmap\" name=\"NAME\"><string name=\"filename\" value=\"gone.png\"/></texture>";
    for (sort, name) in [("principled", "clearcoat"), ("principled", "base_color"), ("plastic", "diffuse_reflectance")]
    {
        let texture = gone.replace("NAME", name);
        let text = xml(&format!("<shape type=\"cube\"><bsdf type=\"{sort}\">{texture}</bsdf></shape>"));
        let told = load("a.xml", &text, &[], false).expect_err("it is not there");
        assert_eq!(told.lines().count(), 1, "{told}");
    }
    let board = gone.replace("NAME", "color0");
    let text = xml(&format!(
        "<shape type=\"cube\"><bsdf type=\"diffuse\"><texture type=\"checkerboard\" name=\"reflectance\">{board}\
         </texture></bsdf></shape>"
    ));
    assert_eq!(load("a.xml", &text, &[], false).expect_err("it is not there").lines().count(), 1);
}

#[test]
fn finishes_are_read_as_mitsuba_has_them() {
    use tauflow_data::scene::Distribution::{Beckmann, Ggx};
    let of = |bsdf: &str| {
        let text = xml(&format!("<shape type=\"cube\"><bsdf type={bsdf}</bsdf></shape>"));
        let loaded = load("a.xml", &text, &[], false).unwrap_or_else(|told| panic!("{bsdf}: {told}"));
        loaded.scene.materials[0].clone()
    };
    let Bsdf::Finish { distribution, alpha, nonlinear, inner } = of("\"roughconductor\">") else { panic!("a finish") };
    assert_eq!((distribution, alpha, nonlinear), (Beckmann, None, false));
    assert!(matches!(*inner, Bsdf::Conductor { alpha: 0.1, .. }));
    let textured = "<texture type=\"checkerboard\" name=\"alpha\"><float name=\"color0\" value=\"0.2\"/>\
                    <float name=\"color1\" value=\"0.5\"/></texture><string name=\"distribution\" value=\"ggx\"/>";
    let Bsdf::Finish { distribution, alpha, inner, .. } = of(&format!("\"roughdielectric\">{textured}")) else {
        panic!("a finish")
    };
    assert!(distribution == Ggx && matches!(alpha, Some(Texture::Checkerboard { .. })), "{alpha:?}");
    assert!(matches!(*inner, Bsdf::Dielectric { .. }));
    let nonlinear = "<boolean name=\"nonlinear\" value=\"true\"/>";
    for sort in ["plastic", "roughplastic"] {
        let Bsdf::Finish { nonlinear, .. } = of(&format!("\"{sort}\">{nonlinear}")) else { panic!("a finish") };
        assert!(nonlinear, "{sort}");
    }
    let ggx = "\"roughconductor\"><string name=\"distribution\" value=\"ggx\"/>";
    assert!(matches!(of(ggx), Bsdf::Conductor { .. }) && matches!(of("\"plastic\">"), Bsdf::Plastic { .. }));
    // What was written for Mitsuba comes back.
    let both = "\"twosided\"><bsdf type=\"roughconductor\"><float name=\"alpha\" value=\"0\"/></bsdf>";
    assert!(matches!(of(both), Bsdf::TwoSided { inner } if matches!(*inner, Bsdf::Conductor { .. })));
}
