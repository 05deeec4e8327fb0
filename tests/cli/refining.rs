//! `tauflow refine`: a solver out of a pipeline, on images out of any renderer.

use crate::{Place, json};
use std::fs;
use tauflow_data::{
    image_io::{read_exr, write_exr},
    time::VarianceTime,
};

pub(crate) const PIPELINE: &str = "\
pipeline: small
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 4, regimes: [L0], contexts: [open, enclosed] }
  ladders:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: { dyadic: 8 }, resolution: [16, 16], gbuffer_samples: 4 }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: ladders }
    params: { contrast: 0.0, inside: 1.0, near_share: 1.0, sky_share: 1.0, surface_share: 1.0,
      edges: 0.0, noisy_share: 1.0, to_see: 0.0 }
  set:
    kind: dataset_packing
    inputs: { ladders: ladders, gbuffers: ladders.gbuffer, exposure: gate.exposure }
  solvers:
    kind: training
    matrix: { conditioning: [rgb, gbuffer] }
    inputs: { train: set }
    params: { steps: 3, batch: 2, crop: 16 }
targets: [solvers]
";

#[test]
fn an_image_of_any_renderer_is_refined() {
    let place = Place::with(PIPELINE);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    place.tauflow(&["export", "small.yaml", "solvers.model", "-o", "models"]).ends(0);
    place.tauflow(&["export", "small.yaml", "ladders.gbuffer", "-o", "gbuffers"]).ends(0);
    let listed = place.tauflow(&["checkpoints", "small.yaml", "-o", "checkpoints"]).ends(0);
    let row = listed.lines().into_iter().find(|line| line.starts_with("solvers[conditioning=rgb]")).unwrap_or_default();
    assert_eq!(row.split_whitespace().nth(1), Some("3"), "it says the steps: {}", listed.out);
    let bytes = |path: &str| fs::read(place.path(path)).expect("it was written");
    let written = "checkpoints/solvers/conditioning=rgb/model.safetensors";
    assert!(listed.out.contains(written) && bytes(written) == bytes("models/conditioning=rgb/model/model.safetensors"));
    // A changed pipeline shows what there is, and of which run it is.
    let run = json(place.tauflow(&["runs", "--json"]).ends(0).lines()[0])["id"].as_str().expect("an id").to_owned();
    let stale = place.tauflow(&["checkpoints", "small.yaml", "--set", "ladders.stream=5", "-o", "stale"]).ends(0);
    assert_eq!(stale.out.matches(&format!("stale, of run {run}")).count(), 2, "{stale:#?}");
    assert!(bytes("stale/solvers/conditioning=rgb/model.safetensors") == bytes(written));
    assert_eq!(listed.out.matches("up to date").count(), 2, "{listed:#?}");
    let scene = ["render", "small.yaml", "--item", "scenes/L0-open-000000", "--spp", "2", "-o", "in.exr"];
    place.tauflow(&[&scene[..], &["--width", "16", "--height", "16"]].concat()).ends(0);
    let refine = |model: &str, more: &[&str]| {
        let model = format!("models/conditioning={model}/model/model.safetensors");
        place.tauflow(&[&["refine", &model, "in.exr", "--from-spp", "2"], more].concat())
    };
    let read = |name: &str| read_exr(&place.path(name)).expect("an EXR").remove("").expect("unnamed");
    let said = refine("rgb", &["--nfe", "3", "-o", "out.exr"]).ends(0);
    assert!(said.out == "out.exr\n" && said.err.starts_with("2 spp -> 8 spp in 3 network calls"), "{}", said.err);
    let (before, after) = (read("in.exr"), read("out.exr"));
    assert!(after.same_shape(&before) && after != before && after.data().iter().all(|v| v.is_finite()));
    refine("rgb", &["--nfe", "3", "-o", "again.exr"]).ends(0);
    assert_eq!(read("again.exr"), after);
    // A step of MC noise goes along a line: to 4 samples it is that to the end, cut short.
    refine("rgb", &["-o", "whole.exr"]).ends(0);
    refine("rgb", &["--to-spp", "8", "-o", "end.exr"]).ends(0);
    refine("rgb", &["--to-spp", "4", "-o", "half.exr"]).ends(0);
    assert_eq!(read("end.exr"), read("whole.exr"));
    let clock = VarianceTime::new(1, 8).expect("a ladder");
    let share = ((clock.tau(4.0) - clock.tau(2.0)) / (1.0 - clock.tau(2.0))) as f32;
    let (whole, half) = (read("whole.exr"), read("half.exr"));
    let largest = before.data().iter().fold(0.0f32, |most, v| most.max(*v));
    for ((from, to), half) in before.data().iter().zip(whole.data()).zip(half.data()) {
        assert!((half - (from + share * (to - from))).abs() < 1e-5 * largest, "{from} {half} {to}");
    }
    refine("rgb", &["--exposure", "2", "-o", "out.png"]).ends(0);
    refine("rgb", &["--nfe", "3", "--mirrors", "4", "-o", "mirrored.exr"]).ends(0);
    assert_ne!(read("mirrored.exr"), after);

    // With a G-buffer, of a file of its own or of layers of the image.
    let features = "gbuffers/L0-open-000000/gbuffer.exr";
    refine("gbuffer", &["--gbuffer", features, "-o", "apart.exr"]).ends(0);
    let error = refine("gbuffer", &["-o", "x.exr"]).ends(2).err;
    assert!(error.contains("albedo") && error.contains("--gbuffer"), "{error}");
    let mut layers = read_exr(&place.path(features)).expect("an EXR");
    layers.insert(String::new(), before.clone());
    let layers: Vec<_> = layers.iter().map(|(name, image)| (name.as_str(), image)).collect();
    write_exr(&place.path("in.exr"), &layers).expect("written");
    refine("gbuffer", &["-o", "together.exr"]).ends(0);
    assert_eq!(read("together.exr"), read("apart.exr"));
    // The layers that `render` writes are such layers.
    let layers = ["-o", "ours.exr", "--width", "16", "--height", "16", "--gbuffer", "--gbuffer-samples", "4"];
    place.tauflow(&[&scene[..6], &layers].concat()).ends(0);
    let model = "models/conditioning=gbuffer/model/model.safetensors";
    let ours = |name: &str, more: &[&str]| {
        let args = ["refine", model, "ours.exr", "--from-spp", "2", "-o", name];
        place.tauflow(&[&args[..], more].concat()).ends(0);
        read(name)
    };
    assert!(read("ours.exr") == before, "the image itself is the same");
    // They are those of the ladder, with as many samples.
    assert!(ours("by_layers.exr", &[]) == read("apart.exr"));
    assert!(ours("by_file.exr", &["--gbuffer", "ours.exr"]) == read("apart.exr"));

    // None of what is read is written over, also not through a link.
    std::os::unix::fs::symlink("in.exr", place.path("link.exr")).expect("writable");
    std::os::unix::fs::symlink("models/conditioning=rgb/model/model.safetensors", place.path("model.exr"))
        .expect("writable");
    for (out, name) in [("in.exr", "in.exr"), ("link.exr", "in.exr"), ("model.exr", "model.safetensors")] {
        let kept = bytes(out);
        let error = refine("rgb", &["-o", out]).ends(2).err;
        assert!(error.contains(&format!("{name} is read, and would be overwritten")) && bytes(out) == kept, "{error}");
    }
    let kept = bytes(features);
    let error = refine("gbuffer", &["--gbuffer", features, "-o", features]).ends(2).err;
    assert!(error.contains("gbuffer.exr is read, and would be") && bytes(features) == kept, "{error}");

    // What is wrong is named.
    let mut odd = read_exr(&place.path(features)).expect("an EXR");
    odd.get_mut("normal").expect("the layer").data_mut()[0] = f32::INFINITY;
    let odd: Vec<_> = odd.iter().map(|(name, image)| (name.as_str(), image)).collect();
    write_exr(&place.path("odd.exr"), &odd).expect("written");
    let error = refine("gbuffer", &["--gbuffer", "odd.exr", "-o", "x.exr"]).ends(2).err;
    assert!(error.contains("odd.exr") && error.contains("pixel (0, 0)"), "{error}");
    let small = tauflow_data::Image::new(8, 8, 3);
    write_exr(&place.path("odd.exr"), &[("albedo", &small), ("normal", &small)]).expect("written");
    let error = refine("gbuffer", &["--gbuffer", "odd.exr", "-o", "x.exr"]).ends(2).err;
    assert!(error.contains("16 x 16") && error.contains("8 x 8"), "{error}");
    let error = refine("gbuffer", &["--gbuffer", "none.exr", "-o", "x.exr"]).ends(2).err;
    assert!(error.contains("none.exr"), "{error}");
    for (more, part) in [
        (&["--to-spp", "9", "-o", "x.exr"][..], "at most 8"),
        (&["--nfe", "0", "-o", "x.exr"], "1..=10000"),
        (&["--nfe", "1000000000000", "-o", "x.exr"], "1..=10000"),
        (&["--mirrors", "3", "-o", "x.exr"], "1, 2, 4 or 8"),
        (&["--exposure=-1", "-o", "x.exr"], "positive"),
        (&["--exposure=1e300", "-o", "x.exr"], "lower --exposure"),
        (&["--exposure=1e-300", "-o", "x.exr"], "raise --exposure"),
        (&["-o", "x.jpg"], ".exr"),
    ] {
        let error = refine("rgb", more).ends(2).err;
        assert!(error.contains(part), "{more:?}: {error}");
    }
    let mut broken = before;
    broken.data_mut()[3 * 17] = f32::NAN;
    write_exr(&place.path("in.exr"), &[("", &broken)]).expect("written");
    let error = refine("rgb", &["-o", "x.exr"]).ends(2).err;
    assert!(error.contains("pixel (1, 1) is not finite"), "{error}");
    place.write("in.exr", "no picture");
    let error = refine("rgb", &["-o", "x.exr"]).ends(2).err;
    assert!(error.contains("in.exr"), "{error}");
}
