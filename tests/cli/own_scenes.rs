//! Scenes of one's own, under a stratum of any name, in the steps that group by stratum.

use crate::Place;
use std::fs;

const PIPELINE: &str = "\
pipeline: small
targets: [sampling, stats]
nodes:
  own:
    kind: scene_files
    params: { scenes: [{ path: rooms, stratum: my.kitchens }] }
  split:
    kind: content_signature_split
    inputs: { scenes: own }
    params: { test_share: 0.5 }
  sampling:
    kind: stratified_sampling
    inputs: { train: split.train, test: split.test }
    params: { train: 1, test: 1, strata: [my.kitchens] }
  stats:
    kind: scene_statistics
    inputs: { scenes: own }
    params: { spp: 8, resolution: [8, 8] }
";

fn room(light: &str) -> String {
    let camera = "<sensor type=\"perspective\"><float name=\"fov\" value=\"40\"/><transform name=\"to_world\"><lookat \
                  origin=\"0,1,4\" target=\"0,0,0\" up=\"0,1,0\"/></transform></sensor>";
    let light = format!("<emitter type=\"constant\"><rgb name=\"radiance\" value=\"{light}\"/></emitter>");
    format!("<scene version=\"3.0.0\"><integrator type=\"path\"/>{camera}<shape type=\"sphere\"/>{light}</scene>")
}

#[test]
fn own_strata_are_taken_wherever_scenes_are_grouped() {
    let place = Place::with(PIPELINE);
    fs::create_dir(place.path("rooms")).expect("writable");
    for (name, light) in [("rooms/a.xml", "1"), ("rooms/b.xml", "2")] {
        place.write(name, &room(light));
    }
    place.tauflow(&["check", "small.yaml"]).ends(0);
    place.tauflow(&["run", "small.yaml"]).ends(0);
    for (node, item) in [("sampling.train", "my.kitchens-00000"), ("sampling.test", "my.kitchens-00000")] {
        place.tauflow(&["export", "small.yaml", node, "-o", node]).ends(0);
        let items: Vec<String> = fs::read_dir(place.path(node))
            .expect("exported")
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .filter(|name| name.starts_with(item))
            .collect();
        assert_eq!(items.len(), 1, "{node}");
    }
    // A name that is none is an error with its line.
    place.write("small.yaml", &PIPELINE.replace("stratum: my.kitchens", "stratum: \"my kitchens\""));
    let said = place.tauflow(&["check", "small.yaml"]).ends(2);
    assert!(said.err.contains("cannot be the name of a stratum") && said.err.contains("small.yaml:6"), "{}", said.err);
}
