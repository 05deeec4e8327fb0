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
fn hidden_emitters_behind_masks_are_refused() {
    let text = xml("<integrator type=\"path\"><boolean name=\"hide_emitters\" value=\"true\"/></integrator>\
                    <shape type=\"cube\"><bsdf type=\"mask\"><bsdf type=\"diffuse\"/></bsdf></shape>");
    let told = load("a.xml", &text, &[], true).expect_err("nothing bounds the difference");
    assert!(told.contains("shows emitters through masks") && told.contains("use `volpath`"), "{told}");
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
        load("a.xml", &text, &[], true).expect_err("it may hide anything");
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
    let Bsdf::Finish { distribution, alpha, alpha_v: None, nonlinear, inner } = of("\"roughconductor\">") else {
        panic!("a finish")
    };
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

/// A picture of 2 x 2 grey texels.
fn grey() -> (&'static str, Vec<u8>) {
    let image = tauflow_data::Image::from_data(2, 2, 3, vec![0.5; 12]).expect("fits");
    ("grey.exr", tauflow_data::image_io::exr_bytes(&[("", &image)]).expect("written"))
}

const GREY: &str = "<texture type=\"bitmap\" name=\"NAME\"><string name=\"filename\" value=\"grey.exr\"/>\
                    <boolean name=\"raw\" value=\"true\"/></texture>";

#[test]
fn roughness_along_both_tangents_is_read_from_numbers_and_textures() {
    let of = |alphas: &str| {
        let bsdf = format!("<bsdf type=\"roughconductor\">{alphas}</bsdf>");
        let loaded = load("a.xml", &xml(&format!("<shape type=\"cube\">{bsdf}</shape>")), &[grey()], false);
        loaded.unwrap_or_else(|told| panic!("{alphas}: {told}")).scene.materials[0].clone()
    };
    let number = |axis: &str, value: f64| format!("<float name=\"alpha_{axis}\" value=\"{value}\"/>");
    let Bsdf::Finish { alpha, alpha_v, inner, .. } = of(&(number("u", 0.1) + &number("v", 0.3))) else {
        panic!("a finish")
    };
    assert_eq!([alpha, alpha_v], [0.1, 0.3].map(|v| Some(Texture::scalar(v))));
    assert!(matches!(*inner, Bsdf::Conductor { .. }));
    let textured = of(&(GREY.replace("NAME", "alpha_u") + &number("v", 0.3)));
    assert!(
        matches!(
            &textured,
            Bsdf::Finish { alpha: Some(Texture::Bitmap { .. }), alpha_v: Some(Texture::Constant { .. }), .. }
        ),
        "{textured:?}"
    );
    // The same along both is one roughness.
    let Bsdf::Finish { alpha: None, alpha_v: None, inner, .. } = of(&(number("u", 0.2) + &number("v", 0.2))) else {
        panic!("Beckmann's facets")
    };
    assert!(matches!(*inner, Bsdf::Conductor { alpha: 0.2, .. }));
    let odd = xml("<shape type=\"cube\"><bsdf type=\"roughdielectric\"><float name=\"alpha_u\" value=\"0.1\"/>\
                   <float name=\"alpha_v\" value=\"1.5\"/></bsdf></shape>");
    let told = load("a.xml", &odd, &[], false).expect_err("too rough");
    assert!(told.contains("line 7: a roughness of 1.5"), "{told}");
}

#[test]
fn normal_and_bump_maps_are_read_with_their_options() {
    use tauflow_data::scene::ReliefForm::{Heights, Normals};
    let off = |name: &str| format!("<boolean name=\"{name}\" value=\"false\"/>");
    let of = |sort: &str, inside: &str| {
        let bsdf = format!("<bsdf type=\"{sort}\">{inside}<bsdf type=\"diffuse\"/></bsdf>");
        load("a.xml", &xml(&format!("<shape type=\"cube\">{bsdf}</shape>")), &[grey()], false)
    };
    let read = |sort: &str, inside: &str| of(sort, inside).expect("all of it is supported").scene.materials[0].clone();
    let map = GREY.replace("NAME", "normalmap");
    let Bsdf::Relief { form: Normals, flip: true, shadowing: true, .. } = read("normalmap", &map) else {
        panic!("both options are on by default")
    };
    let half = off("use_shadowing_function") + &map;
    let Bsdf::Relief { flip: true, shadowing: false, .. } = read("normalmap", &half) else { panic!("one is on") };
    let none = off("flip_invalid_normals") + &half;
    assert!(matches!(read("normalmap", &none), Bsdf::NormalMap { .. }));
    // The texture of a bump map may have any name.
    let heights = format!("<float name=\"scale\" value=\"2.5\"/>{}", GREY.replace("NAME", "whatever"));
    let Bsdf::Relief { form: Heights, scale, map: Texture::Bitmap { .. }, inner, .. } = read("bumpmap", &heights)
    else {
        panic!("a bump map")
    };
    assert!(scale == 2.5 && matches!(*inner, Bsdf::Diffuse { .. }));
    let board = "<texture type=\"checkerboard\" name=\"x\"/>";
    for (inside, what) in [
        (String::new(), "a bump map with 0 textures"),
        (heights.clone() + &map, "a bump map with 2 textures"),
        (board.to_owned(), "a bump map that is no picture"),
    ] {
        let told = of("bumpmap", &inside).expect_err(what);
        assert!(told.starts_with("a.xml: line 7: ") && told.contains(what), "{told}");
    }
    let nested = xml(&format!(
        "<shape type=\"cube\"><bsdf type=\"bumpmap\">{heights}<bsdf type=\"normalmap\">{map}\
         <bsdf type=\"diffuse\"/></bsdf></bsdf></shape>"
    ));
    let told = load("a.xml", &nested, &[grey()], false).expect_err("a map in a map");
    assert!(told.contains("line 7: a normal or bump map inside another one"), "{told}");
}

#[test]
fn normal_maps_on_coordinates_that_turn_as_the_mesh_lie_in_mitsubas_frames() {
    let ply = |v: f32| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             property float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
             0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 {v}\n3 0 1 2\n"
        )
        .into_bytes()
    };
    let map = GREY.replace("NAME", "normalmap");
    let off = "<boolean name=\"use_shadowing_function\" value=\"false\"/>\
               <boolean name=\"flip_invalid_normals\" value=\"false\"/>";
    for (v, flip, relief) in [(1.0, false, true), (-1.0, false, false), (1.0, true, false), (-1.0, true, true)] {
        let text = xml(&format!(
            "<shape type=\"ply\"><string name=\"filename\" value=\"m.ply\"/>\
             <boolean name=\"flip_normals\" value=\"{flip}\"/>\
             <bsdf type=\"normalmap\">{off}{map}<bsdf type=\"diffuse\"/></bsdf></shape>"
        ));
        let scene = load("a.xml", &text, &[grey(), ("m.ply", ply(v))], false).expect("all of it is supported").scene;
        let found = matches!(scene.materials[scene.shapes[0].material], Bsdf::Relief { .. });
        assert_eq!(found, relief, "v of {v}, {flip}");
        // What tauflow has written is in its own frames.
        let text = format!("{}\n{text}", tauflow_data::mitsuba::OWN);
        let scene = load("a.xml", &text, &[grey(), ("m.ply", ply(v))], false).expect("all of it is supported").scene;
        assert!(matches!(scene.materials[scene.shapes[0].material], Bsdf::NormalMap { .. }));
    }
}

#[test]
fn hidden_emitters_are_those_of_the_integrator() {
    let of = |integrator: &str, inside: &str| {
        let option = "<boolean name=\"hide_emitters\" value=\"true\"/>";
        let cube = format!("<shape type=\"cube\">{inside}</shape>");
        xml(&format!("<integrator type=\"{integrator}\">{option}</integrator>{cube}"))
    };
    assert!(load("a.xml", &of("path", ""), &[], false).expect("supported").scene.hide_emitters);
    assert!(!load("a.xml", &xml("<shape type=\"cube\"/>"), &[], false).expect("supported").scene.hide_emitters);
    // `path` counts a passage through a mask as a bounce, after which emitters are seen.
    let mask = "<bsdf type=\"mask\"><bsdf type=\"diffuse\"/></bsdf>";
    assert!(load("a.xml", &of("volpath", mask), &[], false).expect("supported").scene.hide_emitters);
    let told = load("a.xml", &of("path", mask), &[], false).expect_err("an approximation");
    assert!(told.contains("`hide_emitters` of `path` shows emitters through masks"), "{told}");
}

#[test]
fn a_missing_picture_is_one_error_and_no_more() {
    let picture = |name: &str| {
        format!("<texture type=\"bitmap\" name=\"{name}\"><string name=\"filename\" value=\"nope.png\"/></texture>")
    };
    let ggx = "<string name=\"distribution\" value=\"ggx\"/>";
    for (sort, name, more) in [
        ("roughplastic", "diffuse_reflectance", "<boolean name=\"nonlinear\" value=\"true\"/>".to_owned()),
        ("roughplastic", "alpha", "<float name=\"int_ior\" value=\"1.6\"/>".to_owned()),
        ("plastic", "specular_reflectance", "<boolean name=\"nonlinear\" value=\"true\"/>".to_owned()),
        ("roughconductor", "alpha", format!("<string name=\"material\" value=\"Au\"/>{ggx}")),
        ("roughconductor", "alpha_u", format!("<float name=\"alpha_v\" value=\"0.2\"/>{ggx}")),
        ("conductor", "specular_reflectance", "<string name=\"material\" value=\"Au\"/>".to_owned()),
        ("roughdielectric", "alpha", format!("<string name=\"int_ior\" value=\"bk7\"/>{ggx}")),
        ("dielectric", "specular_transmittance", "<float name=\"ext_ior\" value=\"1.1\"/>".to_owned()),
        ("thindielectric", "specular_reflectance", "<float name=\"ext_ior\" value=\"1.1\"/>".to_owned()),
        ("principled", "base_color", "<float name=\"roughness\" value=\"0.2\"/>".to_owned()),
        ("mask", "opacity", "<bsdf type=\"diffuse\"/>".to_owned()),
        ("blendbsdf", "weight", "<bsdf type=\"diffuse\"/><bsdf type=\"plastic\"/>".to_owned()),
        (
            "normalmap",
            "normalmap",
            "<bsdf type=\"diffuse\"/><boolean name=\"flip_invalid_normals\" value=\"false\"/>".to_owned(),
        ),
        ("bumpmap", "arbitrary", "<bsdf type=\"diffuse\"/><float name=\"scale\" value=\"2\"/>".to_owned()),
    ] {
        let inside = format!("<shape type=\"cube\"><bsdf type=\"{sort}\">{}{more}</bsdf></shape>", picture(name));
        let told = load("a.xml", &xml(&inside), &[], false).expect_err(sort);
        assert!(told.lines().count() == 1 && told.contains("`nope.png` is no file"), "{sort} {name}: {told}");
    }
    // In what is inside of a map.
    let diffuse = format!("<bsdf type=\"diffuse\">{}</bsdf>", picture("reflectance"));
    for map in ["<rgb name=\"normalmap\" value=\"0.5 0.5 1\"/>", ""] {
        let sort = if map.is_empty() { "twosided" } else { "normalmap" };
        let inside = format!("<shape type=\"cube\"><bsdf type=\"{sort}\">{map}{diffuse}</bsdf></shape>");
        let told = load("a.xml", &xml(&inside), &[], false).expect_err("no picture");
        assert!(told.lines().count() == 1 && told.contains("`nope.png` is no file"), "{sort}: {told}");
    }
    let envmap = "<emitter type=\"envmap\"><string name=\"filename\" value=\"no.exr\"/><float name=\"scale\" \
                  value=\"2\"/>\
                  </emitter>";
    let told = load("a.xml", &xml(envmap).replace("<emitter type=\"constant\"/>", ""), &[], false);
    assert_eq!(told.map(|_| ()).expect_err("no picture").lines().count(), 1);
}
