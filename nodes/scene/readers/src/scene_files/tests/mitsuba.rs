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
