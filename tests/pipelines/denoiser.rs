//! The pipeline of the bundled models makes the same bits each time, and no choice is made on the scenes that they are
//! judged on.

use crate::support::root;
use std::{fs, path::Path, process::Command};
use tauflow::lock::Lock;
use tauflow_cache::Digest;
use tauflow_contract::{Artifact, Collection, ItemKey};
use tauflow_testing::{Need, skip, slow};

/// The media type of models.
const MODEL: &str = "tauflow/model";

/// The targets of the pipeline: the bundled models.
const MODELS: [&str; 4] = ["fast_gbuffer", "fast_rgb", "best_gbuffer", "best_rgb"];

fn tauflow(folder: &Path, args: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tauflow"));
    let output = command.args(args).current_dir(folder).output().expect("it starts");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{args:?}: {text}");
    text
}

#[test]
fn models_have_the_same_bits_each_time() {
    if !slow() {
        return skip(Need::Slow, "TAUFLOW_SLOW is not set");
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    fs::copy(root().join("pipelines/denoiser.yaml"), folder.path().join("denoiser.yaml")).expect("copied");
    // Side by side, and one after the other: all cores, or a share of them.
    for (jobs, lock) in [("2", "--update-lock"), ("1", "--locked")] {
        let run = ["run", "denoiser.yaml", "--profile", "tiny", lock, "--jobs", jobs, "--cache", jobs];
        let text = tauflow(folder.path(), &run);
        assert!(lock != "--locked" || text.contains(".lock agrees"), "{text}");
        for node in MODELS {
            let out = format!("{jobs}-{node}");
            tauflow(
                folder.path(),
                &["export", "denoiser.yaml", node, "--profile", "tiny", "--cache", jobs, "-o", &out],
            );
        }
    }
    for node in MODELS {
        let model = |jobs: &str| {
            let folder = folder.path().join(format!("{jobs}-{node}"));
            fs::read(folder.join("model/model.safetensors")).expect("exported")
        };
        assert!(model("1") == model("2") && model("1").len() < 4 << 20, "{node}");
    }
}

#[test]
fn the_bundled_models_are_those_of_the_lock_file() {
    let lock = Lock::read(&root().join("pipelines/denoiser.lock"), "denoiser").expect("a lock file");
    let mut found = 0;
    for name in MODELS {
        let Some(locked) = lock.bitwise.get(&format!("{name}.rounded")) else { continue };
        let bytes = fs::read(root().join(format!("models/{name}.safetensors"))).expect("a model");
        let artifact = Artifact::blob(MODEL, Digest::of(&bytes));
        let items = [(ItemKey::new("model").expect("a name"), artifact)];
        assert_eq!(*locked, Collection { items: items.into() }.digest(), "{name}");
        found += 1;
    }
    assert!(found >= 2, "of those that were made again");
}

#[test]
fn no_choice_is_made_on_the_scenes_of_the_comparison() {
    for entry in fs::read_dir(root().join("pipelines")).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.extension().is_none_or(|extension| extension != "yaml") {
            continue;
        }
        let text = fs::read_to_string(&path).expect("text");
        let after = ["libraries: [", "library: ["].into_iter().flat_map(|name| text.split(name).skip(1));
        let lists = after.filter_map(|rest| rest.split(']').next());
        let listed = lists.flat_map(|list| list.split(|c: char| !c.is_ascii_digit())).any(|number| number == "2");
        assert!(!listed, "{}", path.display());
        let judges = ["denoiser_test.yaml", "denoiser_real.yaml"].iter().any(|name| path.ends_with(name));
        assert_eq!(text.contains("library: 2"), judges, "{}", path.display());
        for name in ["denoiser_test.yaml]", "denoiser_real.yaml]"] {
            assert!(!text.contains(name), "{} includes the comparison", path.display());
        }
        assert!(!judges || !text.contains("kind: training"), "the comparison trains nothing");
    }
}
