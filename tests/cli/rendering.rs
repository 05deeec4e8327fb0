//! `tauflow render`: what it writes, and what it says of it.

use crate::{Place, Said};
use std::{fs, io::Read, net::TcpListener, process::Command, thread};
use tauflow_data::image_io::read_exr;

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
    place.tauflow(&[&["render", "scene.xml", "--spp", "4"], more].concat())
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
    for exposure in ["nan", "0", "-1", "inf", "1e-60"] {
        let said = render(&place, &[&format!("--exposure={exposure}"), "-o", "x.exr"]).ends(2);
        assert!(said.err.contains("--exposure"), "{}", said.err);
    }
    let said = render(&place, &["--view", "1", "-o", "x.exr"]).ends(2);
    assert!(said.err.contains("there is no camera 1: it has one camera, counted from 0"), "{}", said.err);
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
