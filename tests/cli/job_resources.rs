//! Resources of actions: the kind's, or those of the pipeline, as a scheduler is asked for them.

use crate::{
    Place,
    jobs::{Scheduler, place, with_slurm},
};
use std::{fs, os::unix::fs::PermissionsExt, process::Command};

/// A place whose copies ask for these resources.
fn asking(resources: &str) -> Place {
    let place = place(1, "0");
    let text = fs::read_to_string(place.path("small.yaml")).expect("it was written");
    let with = format!("    inputs: {{ numbers: numbers }}\n    resources: {resources}\n");
    place.write("small.yaml", &text.replacen("    inputs: { numbers: numbers }\n", &with, 1));
    place
}

fn program(place: &Place, name: &str, text: &str) {
    fs::create_dir_all(place.path("bin")).expect("writable");
    place.write(&format!("bin/{name}"), text);
    fs::set_permissions(place.path(&format!("bin/{name}")), fs::Permissions::from_mode(0o755)).expect("our own");
}

/// Commands of Slurm that note what they are told, and run all tasks at once.
fn recording(place: &Place) -> Scheduler {
    let sbatch = "#!/bin/sh
printf '%s\\n' \"$*\" >> HERE/asked
for option; do
    case $option in --array=*) last=${option##*-} ;; --output=*) log=${option#--output=} ;; esac
    script=$option
done
for n in $(seq 0 \"$last\"); do
    SLURM_ARRAY_TASK_ID=$n sh \"$script\" > \"$(echo \"$log\" | sed \"s/%a/$n/\")\" 2>&1
done
echo 7
";
    program(place, "sbatch", &sbatch.replace("HERE", &place.path("").display().to_string()));
    program(place, "squeue", "#!/bin/sh\n");
    let path = format!("{}:{}", place.path("bin").display(), std::env::var("PATH").unwrap_or_default());
    Scheduler { options: vec!["--executor", "slurm", "--poll-every", "0.2s"], variables: vec![("PATH", path)] }
}

fn asked(place: &Place) -> Vec<String> {
    fs::read_to_string(place.path("asked")).expect("it was written").lines().map(str::to_owned).collect()
}

#[test]
fn slurm_is_asked_for_the_resources_of_a_node_and_options_override_them() {
    let place = asking("{ cores: 3, memory: 1.5GiB, time: 2h, gpu: 1 }");
    let planned = place.tauflow(&["plan", "small.yaml"]).ends(0);
    assert!(planned.out.contains("\n  copies: 3 cores, 1.5 GiB, 2 h, 1 GPU\n"), "{}", planned.out);
    let scheduler = recording(&place);
    scheduler.run(&place, &["--job-option=copies:--mem=9G"]).ends(0);
    let asked = asked(&place);
    assert_eq!(asked.len(), 3, "a node each: {asked:?}");
    // The kind limits the time of its programs; a minute is for the start of the job.
    assert!(asked[0].contains(" --time=61 ") && !asked[0].contains("--mem"), "{asked:?}");
    let copies = " --cpus-per-task=3 --mem=1536M --time=121 --gres=gpu:1 --mem=9G ";
    assert!(asked[1].contains(copies), "{asked:?}");
    // They are no part of keys.
    let path = &scheduler.variables[0].1;
    let text = fs::read_to_string(place.path("small.yaml")).expect("it was written");
    let without: String = text.lines().filter(|line| !line.contains("resources:")).map(|l| format!("{l}\n")).collect();
    place.write("small.yaml", &without);
    let mut command = place.command(&["run", "small.yaml"]);
    let again = crate::Said::of(&command.env("PATH", path).output().expect("the program starts")).ends(0);
    assert!(again.err.contains("nothing to do"), "{}", again.err);
    let told = crate::Said::of(
        &place.command(&["explain", "small.yaml", "numbers"]).env("PATH", path).output().expect("it starts"),
    );
    assert!(told.out.contains("\nresources  60 min, as a job\n"), "{told:?}");
}

#[test]
fn jobs_hold_actions_of_the_same_resources() {
    let place = place(3, "0");
    let text = fs::read_to_string(place.path("small.yaml")).expect("it was written");
    let (before, _) = text.split_once("  total:").expect("the last node");
    let matrix = "    inputs: { numbers: numbers }\n    matrix: { time: [60, 600] }\n";
    place.write("small.yaml", &before.replacen("    inputs: { numbers: numbers }\n", matrix, 1));
    recording(&place).run(&place, &["--batch", "1000s"]).ends(0);
    let mut times: Vec<String> = asked(&place)[1..]
        .iter()
        .map(|line| line.split(' ').find(|word| word.starts_with("--time=")).expect("it has a limit").to_owned())
        .collect();
    times.sort();
    // The limit of one, a minute, and some seconds for the others.
    assert_eq!(times, ["--time=12", "--time=3"], "{:?}", asked(&place));
}

#[test]
fn other_schedulers_are_told_resources_by_number() {
    let place = asking("{ cores: 3, memory: 1.5GiB, time: 2h, gpu: 2 }");
    let mut scheduler = Scheduler::shell();
    let at = scheduler.options.iter().position(|option| *option == "--submit").expect("it is there") + 1;
    let submit = format!("echo {{cores}} {{memory}} {{time}} {{gpus}} >> asked; {}", scheduler.options[at]);
    scheduler.options[at] = submit.leak();
    scheduler.run(&place, &[]).ends(0);
    assert_eq!(asked(&place), ["1 0 3660 0", "3 1536 7260 2", "1 0 3660 0"]);
}

#[test]
fn slurm_gives_what_it_is_asked_for() {
    with_slurm(|slurm| {
        let place = asking("{ cores: 2, memory: 64MiB, time: 4m }");
        slurm.run(&place, &["--job-option=copies:--comment=these"]).ends(0);
        let mut show = Command::new("scontrol");
        let jobs = show.args(["-o", "show", "jobs"]).envs(slurm.variables.clone()).output().expect("scontrol starts");
        let jobs = String::from_utf8_lossy(&jobs.stdout).into_owned();
        let job = jobs.lines().rfind(|line| line.contains("Comment=these")).expect("a job of this node");
        for part in ["CPUs/Task=2", "MinMemoryNode=64M", "TimeLimit=00:05:00"] {
            assert!(job.contains(part), "{part}: {job}");
        }
    });
}

/// HyperQueue gets them in its own words.
pub(crate) fn are_asked_of_hyperqueue(hyperqueue: &Scheduler) {
    let place = asking("{ cores: 2, memory: 1000MB, time: 4m, gpu: 1 }");
    hyperqueue.run(&place, &[]).ends(0);
    let (_, server) = hyperqueue.variables.iter().find(|(name, _)| *name == "HQ_SERVER_DIR").expect("it is set");
    let jobs = fs::read_dir(format!("{server}/jobs")).expect("there were jobs").flatten();
    let told: Vec<String> = jobs.filter_map(|job| fs::read_to_string(job.path().join("options")).ok()).collect();
    let of_copies = "--cpus=2 --resource=mem=1000 --time-limit=300s --resource=gpus/nvidia=1";
    assert!(told.iter().any(|options| options == of_copies), "{told:?}");
    let place = asking("{ cores: 2, memory: 1000MB }");
    hyperqueue.run(&place, &["--job-option=--cpus=1", "--job-option=--resource=mem=7"]).ends(0);
    let jobs = fs::read_dir(format!("{server}/jobs")).expect("there were jobs").flatten();
    let told: Vec<String> = jobs.filter_map(|job| fs::read_to_string(job.path().join("options")).ok()).collect();
    // An option is given once.
    let of_copies = "--time-limit=3660s --cpus=1 --resource=mem=7";
    assert!(told.iter().any(|options| options == of_copies), "{told:?}");
}

#[test]
fn resources_of_a_pipeline_are_checked() {
    let place = asking("{ cores: 0, memory: 8, gpus: 1 }");
    let said = place.tauflow(&["check", "small.yaml"]).ends(2);
    for part in ["`cores` must be a whole number from 1", "`memory` must be a number above 0 with a unit", "`gpus`"] {
        assert!(said.err.contains(part), "{part}: {}", said.err);
    }
}
