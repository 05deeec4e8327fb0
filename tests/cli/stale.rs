//! Programs of pipelines are never stale: a change of whatever they read runs them again, and `plan` names it.

use crate::{Place, Said, programs::with};
use std::{fs, process::Command};
use tauflow_cache::Store;
use tauflow_data::{
    Image,
    image_io::{read_exr, write_exr},
};
use tauflow_testing::{Need, skip};

/// A denoiser and a command. Both import the same module, which reads a file.
const PIPELINE: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 2, regimes: [L0], contexts: [open] }
  previews:
    kind: ladder_rendering
    inputs: { scenes: scenes }
    params: { rungs: { dyadic: 16 }, resolution: [16, 16] }
  gate:
    kind: quality_gate
    inputs: { scenes: scenes, previews: previews }
  endpoints:
    kind: dataset_packing
    inputs: { ladders: previews, gbuffers: previews.gbuffer, exposure: gate.exposure }
  denoised:
    kind: external_denoiser
    inputs: { endpoints: endpoints }
    params:
      from: 1
      required: true
      method: mine
      command: [python3, HERE/denoise.py, \"{color}\", \"{albedo}\", \"{output}\"]
      variables: [DENOISE_PICK]
  made:
    kind: command
    params:
      run: [python3, command.py]
      mode: gather
      outputs: { made: tauflow/files }
      variables: [DENOISE_PICK]
";
const DENOISER: &str = "\
import helper, shutil, sys
shutil.copy(sys.argv[1 + helper.pick() % 2], sys.argv[3])
";
const COMMAND: &str = "\
import helper, os
os.mkdir('out/made/a')
open('out/made/a/pick', 'w').write(str(helper.pick()))
";
/// What is picked is decided by a file, by one that need not exist, and by a variable.
const HELPER: &str = "\
import os
HERE = os.path.dirname(os.path.abspath(__file__))
open(os.path.join(HERE, 'ran'), 'a').write('ran\\n')
def pick():
    if os.path.exists(os.path.join(HERE, 'extra.txt')):
        return 5
    with open(os.path.join(HERE, 'data', 'pick.txt')) as file:
        return int(file.read()) + int(os.environ.get('DENOISE_PICK', '0'))
";

/// A folder with the programs and a pipeline that runs them; none without Python.
fn place() -> Option<Place> {
    let python = Command::new("python3").arg("--version").output();
    if !python.is_ok_and(|done| done.status.success()) {
        skip(Need::Python, "there is no python3");
        return None;
    }
    let place = Place::with("");
    let here = place.path("").display().to_string();
    place.write("small.yaml", &PIPELINE.replace("HERE", here.trim_end_matches('/')));
    place.write("denoise.py", DENOISER);
    place.write("command.py", COMMAND);
    place.write("helper.py", HELPER);
    fs::create_dir(place.path("data")).expect("writable");
    place.write("data/pick.txt", "0");
    Some(place)
}

/// Runs the pipeline; how many programs ran.
#[track_caller]
fn run(place: &Place, variables: &[(&str, &str)], more: &[&str]) -> usize {
    let done = with(place, &[&["run", "small.yaml"], more].concat(), variables).ends(0);
    assert!(!done.err.contains("traced: no"), "{}", done.err);
    let ran = fs::read_to_string(place.path("ran")).unwrap_or_default().lines().count();
    let _ = fs::remove_file(place.path("ran"));
    ran
}

#[track_caller]
fn plan(place: &Place, variables: &[(&str, &str)]) -> Said {
    with(place, &["plan", "small.yaml"], variables).ends(0)
}

#[test]
fn a_change_of_what_a_program_reads_runs_it_again_and_is_named() {
    let Some(place) = place() else { return };
    let all = run(&place, &[], &[]);
    assert!(all >= 2, "both kinds run");
    assert_eq!(run(&place, &[], &[]), 0, "{}", plan(&place, &[]).out);
    // A file beside the programs that none of them looks for.
    place.write("notes.txt", "nothing");
    fs::create_dir(place.path("images")).expect("writable");
    assert_eq!(run(&place, &[], &[]), 0, "{}", plan(&place, &[]).out);
    let changed = HELPER.replace("return int", "return 1 + int");
    // Of the same length, at once: only the content tells.
    for (name, text, named) in [
        ("data/pick.txt", "1", "pick.txt"),
        ("helper.py", &changed, "helper.py"),
        ("extra.txt", "", "what exists in it"),
    ] {
        place.write(name, text);
        let told = plan(&place, &[]).out;
        assert!(told.matches(named).count() >= 2, "{name}: {told}");
        assert_eq!(run(&place, &[], &["--executor", "process"]), all, "{name}");
        assert_eq!(run(&place, &[], &[]), 0, "{name}: {}", plan(&place, &[]).out);
    }
    // The programs themselves, whose new files nobody has traced yet.
    for (name, text) in [("denoise.py", format!("{DENOISER}# more\n")), ("command.py", format!("{COMMAND}# more\n"))] {
        place.write(name, &text);
        let told = plan(&place, &[]).out;
        let lines: Vec<&str> = told.lines().filter(|line| line.contains("changed: ")).collect();
        assert!(lines.iter().any(|line| line.contains(name)), "{name}: {told}");
        assert!(!told.contains("the machine"), "{name}: {told}");
        run(&place, &[], &[]);
    }
    place.write("denoise.py", DENOISER);
    place.write("command.py", COMMAND);
    // What was so before is still known.
    fs::remove_file(place.path("extra.txt")).expect("it was written");
    place.write("helper.py", HELPER);
    place.write("data/pick.txt", "0");
    assert_eq!(run(&place, &[], &[]), 0, "{}", plan(&place, &[]).out);
    let variable = [("DENOISE_PICK", "1")];
    let told = plan(&place, &variable).out;
    assert!(told.matches("environment variable DENOISE_PICK").count() >= 2, "{told}");
    assert_eq!((run(&place, &variable, &[]), run(&place, &variable, &[])), (all, 0));
    assert_eq!(run(&place, &[], &[]), 0);
    // A variable that nobody declared does not come through.
    assert_eq!(run(&place, &[("DENOISE_OTHER", "1")], &[]), 0);
}

/// A program that learns of files in ways other than opening them by their names.
const ROUNDABOUT: &str = "\
#!HERE/interpreter
ln -s HERE/data/linked here
ln HERE/data/hard there
mkdir out/made/a
cat here there > out/made/a/text
python3 - >> out/made/a/text <<'END'
import os
os.chdir('HERE/data')
print(os.stat('size').st_size, os.readlink('link'), os.access('mode', os.X_OK))
print(os.read(os.open('created', os.O_RDONLY | os.O_CREAT), 9))
print(os.read(os.open('below', os.O_RDONLY, dir_fd=os.open('.', os.O_RDONLY)), 9))
END
echo ran >> HERE/ran
";

const MADE: &str = "\
pipeline: small
nodes:
  made:
    kind: command
    params:
      run: [./roundabout.sh]
      mode: gather
      outputs: { made: tauflow/files }
";

#[test]
fn roundabout_ways_to_a_file_are_followed() {
    use std::os::unix::fs::{PermissionsExt as _, symlink};
    let Some(place) = place() else { return };
    let here = place.path("").display().to_string();
    place.write("small.yaml", MADE);
    place.write("roundabout.sh", &ROUNDABOUT.replace("HERE", here.trim_end_matches('/')));
    let mode = |name: &str, mode| {
        fs::set_permissions(place.path(name), fs::Permissions::from_mode(mode)).expect("its owner may");
    };
    mode("roundabout.sh", 0o755);
    fs::copy("/bin/sh", place.path("interpreter")).expect("there is a shell");
    for name in ["linked", "hard", "size", "mode", "created", "below"] {
        place.write(&format!("data/{name}"), "1");
    }
    let link = |to: &str| {
        let _ = fs::remove_file(place.path("data/link"));
        symlink(to, place.path("data/link")).expect("writable");
    };
    link("size");
    assert_eq!((run(&place, &[], &[]), run(&place, &[], &[])), (1, 0));
    let changes: [(&str, &dyn Fn()); 8] = [
        ("through a link in its directory", &|| place.write("data/linked", "2")),
        ("through a hard link", &|| place.write("data/hard", "2")),
        ("the size", &|| place.write("data/size", "22")),
        ("the target of a link", &|| link("mode")),
        ("the mode", &|| mode("data/mode", 0o755)),
        ("opened or else made", &|| place.write("data/created", "2")),
        ("below a directory that is open", &|| place.write("data/below", "2")),
        ("the interpreter of a script", &|| {
            let mut program = fs::read(place.path("interpreter")).expect("a program");
            program.push(0);
            let _ = fs::remove_file(place.path("interpreter"));
            fs::write(place.path("interpreter"), program).expect("writable");
            mode("interpreter", 0o755);
        }),
    ];
    for (what, change) in changes {
        change();
        assert_eq!((run(&place, &[], &[]), run(&place, &[], &[])), (1, 0), "{what}");
    }
}

#[test]
fn a_recheck_names_what_is_not_declared_as_the_cause() {
    let Some(place) = place() else { return };
    place.write("helper.py", "import time\ndef pick():\n    return time.time_ns()\n");
    run(&place, &[], &["--target", "made"]);
    let told = with(&place, &["run", "small.yaml", "--target", "made", "--recheck", "1"], &[]).ends(1);
    let text = format!("{}{}", told.out, told.err);
    assert!(text.contains("not in the key") && text.contains("`depends`"), "{text}");
}

/// A renderer whose image is picked by the module.
const RENDERING: &str = "\
pipeline: small
seed: 3
nodes:
  scenes:
    kind: scene_generation
    params: { pool: 2, regimes: [L0], contexts: [open] }
  rendered:
    kind: external_renderer
    inputs: { scenes: scenes }
    params:
      method: mine
      command: [python3, HERE/render.py, \"{scene}\", \"{counts}\", \"{folder}\"]
      counts: [1]
      resolution: [4, 2]
      required: true
";
const RENDERER: &str = "\
import helper, os, shutil, sys
shutil.copy(os.path.join(helper.HERE, 'images', f'{helper.pick() % 2}.exr'), os.path.join(sys.argv[3], '1.exr'))
";

#[test]
fn a_renderer_runs_again_when_a_module_that_it_imports_changes() {
    let Some(place) = place() else { return };
    let here = place.path("").display().to_string();
    place.write("small.yaml", &RENDERING.replace("HERE", here.trim_end_matches('/')));
    place.write("render.py", RENDERER);
    fs::create_dir(place.path("images")).expect("writable");
    for value in [0, 1] {
        let image = Image::from_data(4, 2, 3, vec![value as f32; 24]).expect("fits");
        write_exr(&place.path(&format!("images/{value}.exr")), &[("", &image)]).expect("writable");
    }
    let rendered = |folder: &str| -> Vec<f32> {
        with(&place, &["export", "small.yaml", "rendered", "-o", folder], &[]).ends(0);
        let folders = fs::read_dir(place.path(folder)).expect("exported").filter_map(Result::ok);
        let files = folders.map(|entry| entry.path().join("mine-1-to-1-nfe-0.exr")).filter(|file| file.exists());
        files
            .flat_map(|file| read_exr(&file).expect("a picture").remove("").expect("unnamed").data().to_vec())
            .collect()
    };
    assert_eq!((run(&place, &[], &[]), run(&place, &[], &[])), (2, 0));
    assert_eq!(rendered("first"), [0.0; 48]);
    place.write("helper.py", &HELPER.replace("return int", "return 1 + int"));
    let told = plan(&place, &[]).out;
    assert!(told.contains("rendered: 2 x changed: file ") && told.contains("helper.py"), "{told}");
    assert_eq!((run(&place, &[], &[]), run(&place, &[], &[])), (2, 0));
    assert_eq!(rendered("second"), [1.0; 48]);
}

/// A program that runs this one: a traced process cannot trace others.
const NESTED: &str = "\
pipeline: outer
nodes:
  nested:
    kind: command
    params:
      run: [sh, HERE/nested.sh]
      mode: gather
      outputs: { said: tauflow/files }
";

#[test]
fn where_programs_cannot_be_traced_the_run_the_keys_and_the_manuals_say_so() {
    let Some(place) = place() else { return };
    let here = place.path("").display().to_string();
    let here = here.trim_end_matches('/');
    place.write("outer.yaml", &NESTED.replace("HERE", here));
    let program = env!("CARGO_BIN_EXE_tauflow");
    let script = format!(
        "cd {here}\n{program} run small.yaml --target made --cache {here}/inner --out {here}/inner_out 2> {here}/said \
         || exit 1\ncd - > {here}/nowhere\nmkdir out/said/a\ncp {here}/said out/said/a/said\n"
    );
    place.write("nested.sh", &script);
    let outer = with(&place, &["run", "outer.yaml"], &[]);
    let said = fs::read_to_string(place.path("said")).unwrap_or_default();
    let outer = outer.ends(0);
    assert!(!outer.err.contains("traced: no"), "{}", outer.err);
    assert!(said.contains("traced: no: the files that the program of `command` opens are not known"), "{said}");
    assert!(said.contains("`depends`"), "{said}");
    let keys = |store: &str| -> Vec<String> {
        let store = Store::open(&place.path(store)).expect("a store");
        let keys = store.keys_by_label("action", "command").into_iter();
        keys.filter_map(|key| store.read("action", &key)).map(|record| record.preimage).collect()
    };
    let (inner, outer) = (keys("inner"), keys("store"));
    assert!(inner.len() == 1 && inner[0].contains("\"traced\":\"no: "), "{inner:?}");
    assert!(outer.len() == 1 && outer[0].contains("\"traced\":\"yes\""), "{outer:?}");
    let manual = |kind: &str| place.tauflow(&["kinds", kind]).ends(0).out;
    assert!(manual("command").contains("`run` prints `traced: no`"));
    for kind in ["external_denoiser", "external_renderer"] {
        assert!(manual(kind).contains("`tauflow kinds command`"), "{kind} refers to what is said there");
    }
}
