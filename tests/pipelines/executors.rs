//! The quickstart on threads and in child processes: the same outputs.

use crate::support::root;
use std::process::Command;
use tauflow_testing::{Need, skip, slow};

#[test]
fn threads_and_processes_make_the_same_outputs_of_the_quickstart() {
    if !slow() {
        return skip(Need::Slow, "TAUFLOW_SLOW is not set");
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("quickstart.yaml");
    let text = std::fs::read_to_string(root().join("pipelines/quickstart.yaml")).expect("the quickstart");
    std::fs::write(file, text.replace("\nnodes:\n", "\ntargets: [evaluation]\n\nnodes:\n")).expect("writable");
    for (executor, lock) in [("threads", "--update-lock"), ("process", "--locked")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tauflow"));
        command.args(["run", "quickstart.yaml", "--profile", "tiny", lock]);
        command.args(["--executor", executor]);
        let output = command.args(["--cache", executor]).current_dir(folder.path()).output().expect("it starts");
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{executor}: {text}");
        assert!(lock != "--locked" || text.contains(".lock agrees"), "{text}");
    }
}
