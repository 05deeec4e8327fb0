//! `tauflow render`: what it writes, and what it says of it.

use crate::{Place, Said};
use std::{fs, io::Read, net::TcpListener, process::Command, thread};
use tauflow_data::{
    Image,
    image_io::{read_exr, write_exr},
};

const SCENE: &str = r#"<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,1,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/></film>
  </sensor>
  <shape type="sphere"/>
  LIGHT
</scene>
"#;

/// A lamp that lights nothing in view: it stands behind the camera and faces away.
const AWAY: &str = r#"<shape type="rectangle">
    <transform name="to_world"><translate x="0" y="0" z="20"/></transform>
    <emitter type="area"><rgb name="radiance" value="1, 1, 1"/></emitter>
  </shape>"#;

fn place() -> Place {
    let place = Place::new();
    place.write("scene.xml", &SCENE.replace("LIGHT", r#"<emitter type="constant"/>"#));
    place.write("dark.xml", &SCENE.replace("LIGHT", AWAY));
    place
}

fn render(place: &Place, more: &[&str]) -> Said {
    render_with("4", place, more)
}

fn render_with(spp: &str, place: &Place, more: &[&str]) -> Said {
    place.tauflow(&[&["render", "scene.xml", "--spp", spp], more].concat())
}

#[test]
fn a_place_where_no_file_can_be_is_told_before_the_work() {
    let place = place();
    fs::create_dir(place.path("folder.exr")).expect("writable");
    std::os::unix::fs::symlink("folder.exr", place.path("link.exr")).expect("writable");
    for (out, part) in [
        ("folder.exr", "folder.exr is a folder; name a file in it"),
        ("link.exr", "link.exr is a folder"),
        ("scene.xml/new/x.exr", "because scene.xml is no folder"),
    ] {
        let said = render(&place, &["-o", out]).ends(2);
        assert!(said.err.contains(part) && !said.err.contains("samples per pixel"), "{}", said.err);
    }
    // As long as a name can be.
    let long = "a".repeat(251) + ".exr";
    for out in [&long, "new/folder/x.exr"] {
        render(&place, &["-o", out]).ends(0);
        assert!(place.path(out).is_file(), "{out}");
    }
}

#[test]
fn layers_are_those_that_a_solver_reads() {
    let place = place();
    let said = render(&place, &["--gbuffer", "--gbuffer-samples", "4", "--variance", "-o", "x.exr"]).ends(0);
    assert!(said.out == "x.exr\n" && said.err.contains("scene ready after"), "{}", said.err);
    let layers = read_exr(&place.path("x.exr")).expect("an EXR");
    assert_eq!(layers.keys().map(String::as_str).collect::<Vec<_>>(), ["", "albedo", "normal", "variance"]);
    let bytes = fs::read(place.path("x.exr")).expect("written");
    let has = |name: &str| bytes.windows(name.len()).any(|part| part == name.as_bytes());
    assert!(has("normal.X\0") && has("albedo.R\0") && has("variance.B\0") && !has("normal.R\0"));
    // The middle of the sphere faces the camera, and the corner shows the sky.
    assert!(layers["normal"].pixel(12, 8)[2] > 0.9 && layers["normal"].pixel(0, 0) == [0.0; 3]);
    assert!(layers["variance"].data().iter().any(|v| *v > 0.0) && layers["variance"].pixel(0, 0) == [0.0; 3]);
    // The image is the same without them.
    render(&place, &["-o", "plain.exr"]).ends(0);
    assert_eq!(read_exr(&place.path("plain.exr")).expect("an EXR")[""], layers[""]);
    for (more, part) in [
        (&["--gbuffer", "-o", "x.png"][..], "no room for layers"),
        (&["--variance", "--sampler", "sobol", "-o", "y.exr"], "--sampler independent"),
        (&["--tev", "127.0.0.1", "-o", "y.exr"], "--tev 127.0.0.1"),
    ] {
        let said = render(&place, more);
        assert!(said.code != 0 && said.err.contains(part), "{said:?}");
    }
}

#[test]
fn one_sample_has_no_variance() {
    let place = place();
    for (words, part) in [
        (&["--spp", "1"][..], "--spp 1: one sample per pixel has no variance"),
        (&["--error", "0.01", "--at-most", "1"], "raise --at-most to 2 or more, or leave --variance out"),
    ] {
        let render = ["render", "scene.xml", "--variance", "-o", "x.exr"];
        let said = place.tauflow(&[&render[..], words].concat()).ends(2);
        assert!(said.err.contains(part) && !place.path("x.exr").exists(), "{}", said.err);
    }
    // However long a sample takes, there are two. Such a large film gets one at a time.
    let timed = ["--variance", "--seconds", "1e-9", "--width", "640", "--height", "480", "-o", "x.exr"];
    let said = place.tauflow(&[&["render", "scene.xml"], &timed[..]].concat()).ends(0);
    assert!(said.err.contains("\n2 samples per pixel"), "{}", said.err);
    // So much error is allowed that one sample is enough.
    let rough = place.tauflow(&["render", "scene.xml", "--variance", "--error", "1e9", "-o", "x.exr"]).ends(0);
    assert!(rough.err.contains("\n2 samples per pixel"), "{}", rough.err);
    render_with("2", &place, &["--variance", "-o", "x.exr"]).ends(0);
    assert!(read_exr(&place.path("x.exr")).expect("an EXR")["variance"].data().iter().any(|v| *v > 0.0));
}

#[test]
fn an_image_is_denoised_as_the_command_denoises_its_layers() {
    let place = place();
    let image = |file: &str, layer: &str| {
        read_exr(&place.path(file)).expect("an EXR").remove(layer).unwrap_or_else(|| panic!("{file}: no {layer}"))
    };
    render(&place, &["-o", "noisy.exr"]).ends(0);
    let said = render(&place, &["--denoise", "-o", "clean.exr"]).ends(0);
    assert!(said.err.contains("denoised in") && said.err.contains("of the noisy image kept"), "{}", said.err);
    let layers = read_exr(&place.path("clean.exr")).expect("an EXR");
    assert_eq!(layers.keys().map(String::as_str).collect::<Vec<_>>(), ["", "noisy"]);
    assert_eq!(layers["noisy"], image("noisy.exr", ""));
    render(&place, &["--gbuffer", "--variance", "-o", "layers.exr"]).ends(0);
    let words = ["denoise", "layers.exr", "--variance", "variance", "--per-sample", "--spp", "4", "-o", "other.exr"];
    place.tauflow(&[&words[..], &["--normals", "camera"]].concat()).ends(0);
    assert_eq!(layers[""], image("other.exr", ""));
    render_with("1024", &place, &["-o", "reference.exr"]).ends(0);
    let reference = image("reference.exr", "");
    let error = |image: &tauflow_data::Image| -> f64 {
        image.data().iter().zip(reference.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum()
    };
    let (noisy, clean) = (error(&layers["noisy"]), error(&layers[""]));
    assert!(clean < 0.7 * noisy, "{clean} {noisy}");
    // One sample has no variance, and a picture has no room for the noisy image.
    let said = render_with("1", &place, &["--denoise", "-o", "one.png"]).ends(0);
    assert!(said.err.contains("denoised in") && !said.err.contains("kept"), "{}", said.err);
    render_with("1", &place, &["-o", "plain.png"]).ends(0);
    let bytes = |file: &str| fs::read(place.path(file)).expect("written");
    assert_ne!(bytes("one.png"), bytes("plain.png"));
}

#[test]
fn samplers_and_integrators_are_chosen() {
    let place = place();
    let image = |more: &[&str]| {
        render(&place, &[more, &["-o", "x.exr"]].concat()).ends(0);
        read_exr(&place.path("x.exr")).expect("an EXR").remove("").expect("an image")
    };
    let plain = image(&[]);
    assert_ne!(image(&["--sampler", "sobol"]), plain);
    // One ball alone: light paths find only what meets two surfaces.
    assert_eq!(image(&["--integrator", "bidirectional"]), plain);
    render(&place, &["--integrator", "photons", "-o", "x.exr"]).ends(2);
}

#[test]
fn a_file_that_cannot_be_written_whole_leaves_the_one_that_is_there() {
    let place = place();
    render(&place, &["--width", "96", "--height", "64", "-o", "x.exr"]).ends(0);
    let before = fs::read(place.path("x.exr")).expect("written");
    assert!(before.len() > 1024, "it does not fit where 1,024 bytes do");
    let program = env!("CARGO_BIN_EXE_tauflow");
    let script = format!("ulimit -f 1; exec {program} render scene.xml --spp 8 --width 96 --height 64 -o x.exr");
    let output = Command::new("bash").args(["-c", &script]).current_dir(place.path("")).output().expect("bash starts");
    assert!(!output.status.success(), "files of a kilobyte hold no such image");
    assert_eq!(fs::read(place.path("x.exr")).expect("still there"), before);
}

#[test]
fn links_are_written_through_and_pipes_get_the_image() {
    let place = place();
    let program = env!("CARGO_BIN_EXE_tauflow");
    fs::create_dir(place.path("far")).expect("writable");
    fs::write(place.path("far/old.exr"), "old").expect("writable");
    for (link, to) in [("a.exr", "far/old.exr"), ("b.exr", "a.exr"), ("c.exr", "far/new.exr")] {
        std::os::unix::fs::symlink(to, place.path(link)).expect("writable");
    }
    render(&place, &["-o", "plain.exr"]).ends(0);
    let plain = fs::read(place.path("plain.exr")).expect("written");
    for (link, file) in [("b.exr", "far/old.exr"), ("c.exr", "far/new.exr")] {
        render(&place, &["-o", link]).ends(0);
        assert!(place.path(link).is_symlink() && fs::read(place.path(file)).expect("written") == plain, "{link}");
    }
    // Bytes of an EXR and nothing else, to a pipe with a name and to one without.
    for script in [
        format!("mkfifo p.exr; {program} render scene.xml --spp 4 -o p.exr 2>err & cat p.exr; wait"),
        format!("{program} render scene.xml --spp 4 -o /dev/stdout 2>err | cat"),
        format!("{program} render scene.xml --spp 4 -o /dev/stdout >file 2>err; cat file"),
    ] {
        let output = Command::new("bash").args(["-c", &script]).current_dir(place.path("")).output();
        let bytes = output.expect("bash starts").stdout;
        let told = fs::read_to_string(place.path("err")).unwrap_or_default();
        assert!(bytes == plain, "{script}: {} bytes, {told}", bytes.len());
    }
    for exposure in ["nan", "0", "-1", "inf", "1e-60", "9e-7", "6e5", "1e38"] {
        let said = render(&place, &[&format!("--exposure={exposure}"), "-o", "x.exr"]).ends(2);
        assert!(said.err.contains("--exposure"), "{}", said.err);
    }
    for exposure in ["--exposure=1e-6", "--exposure=5e5"] {
        render(&place, &[exposure, "-o", "x.exr"]).ends(0);
    }
    for (options, missing) in [(["--at-most", "5"], "--error"), (["--gbuffer-samples", "3"], "--gbuffer")] {
        let said = render(&place, &[&options[..], &["-o", "x.exr"]].concat()).ends(2);
        assert!(said.err.contains(missing), "{}", said.err);
    }
    let said = render(&place, &["--view", "1", "-o", "x.exr"]).ends(2);
    assert!(said.err.contains("there is no camera 1: it has one camera, counted from 0"), "{}", said.err);
}

#[test]
fn no_file_of_the_scene_is_written_over() {
    let place = place();
    let map = Image::new(8, 4, 3).map(|_| 1.0);
    for name in ["map.exr", "texture.exr"] {
        write_exr(&place.path(name), &[("", &map)]).expect("writable");
    }
    let texture = r#"<emitter type="envmap"><string name="filename" value="texture.exr"/></emitter>"#;
    place.write("lit.xml", &SCENE.replace("LIGHT", texture));
    for (link, to) in [("link.exr", "map.exr"), ("scene.exr", "scene.xml")] {
        std::os::unix::fs::symlink(to, place.path(link)).expect("writable");
    }
    let bytes = |file: &str| fs::read(place.path(file)).expect("there");
    for (scene, more, out, read) in [
        ("scene.xml", &["--env", "map.exr"][..], "map.exr", "map.exr"),
        ("scene.xml", &["--env", "map.exr"], "link.exr", "map.exr"),
        ("scene.xml", &[], "scene.exr", "scene.xml"),
        ("lit.xml", &[], "texture.exr", "texture.exr"),
    ] {
        let before = bytes(out);
        let said = place.tauflow(&[&["render", scene, "--spp", "1", "-o", out], more].concat()).ends(2);
        assert!(said.err.contains(&format!("{read} is read, and would be overwritten")), "{}", said.err);
        assert_eq!(bytes(out), before, "{out}");
    }
    render(&place, &["-o", "map.exr"]).ends(0);
    // An export to Mitsuba replaces an earlier one, but not the one that it reads.
    for _ in 0..2 {
        place.tauflow(&["scene", "mitsuba", "scene.xml", "-o", "sm"]).ends(0);
    }
    let before = bytes("sm/scene.xml");
    std::os::unix::fs::symlink("sm", place.path("same")).expect("writable");
    for out in ["sm", "same"] {
        let said = place.tauflow(&["scene", "mitsuba", "sm/scene.xml", "-o", out]).ends(2);
        let part = format!("sm/scene.xml is read, and would be overwritten by the export to {out}; name another");
        assert!(said.err.contains(&part) && bytes("sm/scene.xml") == before, "{}", said.err);
    }
}

#[test]
fn the_root_of_a_scene_may_be_spelled_in_any_way() {
    let place = place();
    for folder in ["kitchen", "other"] {
        fs::create_dir(place.path(folder)).expect("writable");
    }
    let include = r#"<include filename="../light.xml"/>"#;
    place.write("kitchen/scene.xml", &SCENE.replace("LIGHT", include));
    place.write("light.xml", r#"<scene version="3.0.0"><emitter type="constant"/></scene>"#);
    std::os::unix::fs::symlink("../kitchen", place.path("other/link")).expect("writable");
    let render = |path: &str, root: &str| place.tauflow(&["render", path, "--root", root, "--spp", "1", "-o", "x.exr"]);
    let whole = place.path("").display().to_string();
    for root in [".", "./", "kitchen/..", &whole] {
        render("kitchen/scene.xml", root).ends(0);
    }
    render("other/../kitchen/scene.xml", ".").ends(0);
    for path in ["kitchen/scene.xml", "other/../kitchen/scene.xml", "other/link/scene.xml"] {
        let said = render(path, "other").ends(2);
        assert!(said.err.contains("does not lie below `other`"), "{}", said.err);
    }
}

#[test]
fn darkness_is_not_taken_for_accuracy() {
    let place = place();
    let dark = ["render", "dark.xml", "--error", "0.1", "--at-most", "64", "--width", "2", "--height", "2"];
    let said = place.tauflow(&[&dark[..], &["-o", "x.exr"]].concat()).ends(0);
    assert!(said.err.contains("error unknown") && !said.err.contains("error 0"), "{}", said.err);
}

#[test]
fn a_viewer_sees_the_image() {
    let place = place();
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
    let address = listener.local_addr().expect("bound").to_string();
    let viewer = thread::spawn(move || {
        let mut bytes = Vec::new();
        listener.accept().expect("a client").0.read_to_end(&mut bytes).expect("all of it");
        bytes
    });
    render(&place, &["--tev", &address, "-o", "x.exr"]).ends(0);
    let bytes = viewer.join().expect("no panic");
    let image = read_exr(&place.path("x.exr")).expect("an EXR").remove("").expect("an image");
    let pixels: Vec<u8> = image.data().iter().flat_map(|v| v.to_le_bytes()).collect();
    assert!(bytes[4..].starts_with(b"\x04\0x.exr\0"), "the image is created");
    assert!(bytes.ends_with(&pixels), "its last state is what is written");
}
