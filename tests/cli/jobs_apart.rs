//! Jobs with a cache of their own, which share nothing with the run but an upstream.

use crate::{
    Place,
    jobs::{Scheduler, end_of, noted, numbers, place, the_same_with, wait_until, with_hyperqueue, with_slurm},
};
use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
};
use tauflow_testing::{Need, skip};

/// Files below a folder whose names end like this.
fn count(folder: &Path, end: &str) -> usize {
    let (mut open, mut found) = (vec![folder.to_owned()], 0);
    while let Some(path) = open.pop() {
        for entry in fs::read_dir(&path).into_iter().flatten().flatten() {
            match entry.path().is_dir() {
                true => open.push(entry.path()),
                false => found += usize::from(entry.file_name().to_string_lossy().ends_with(end)),
            }
        }
    }
    found
}

/// A shell whose jobs cannot see the caches of the run, if that can be arranged.
fn blind(place: &Place) -> Option<Scheduler> {
    let mut allowed = Command::new("unshare");
    allowed.args(["-m", "sh", "-c", "mount -t tmpfs tmpfs /mnt"]).stderr(Stdio::null());
    if !allowed.status().is_ok_and(|status| status.success()) {
        skip(Need::Mount, "file systems cannot be mounted");
        return None;
    }
    let mut scheduler = Scheduler::shell();
    let at = scheduler.options.iter().position(|option| *option == "--submit").expect("it is there") + 1;
    let hidden = ["store", "other"].map(|name| place.path(name).display().to_string()).join(" ");
    // A scheduler copies the script that it is given.
    let submit = format!(
        "cp {{script}} {{log}}.sh; setsid unshare -m sh -c 'for f in {hidden}; do [ ! -d $f ] || mount -t tmpfs tmpfs \
         $f; done; exec sh \"$0\"' {{log}}.sh > {{log}} 2>&1 < /dev/null & echo $!"
    );
    scheduler.options[at] = submit.leak();
    Some(scheduler)
}

fn options(place: &Place) -> Vec<String> {
    let at = |name: &str| place.path(name).display().to_string();
    vec!["--upstream".into(), at("upstream"), "--worker-cache".into(), at("workers")]
}

fn same_results(scheduler: &Scheduler) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (upstream, workers) = (at("upstream"), at("workers"));
    the_same_with(scheduler, &["--upstream", &upstream, "--worker-cache", &workers]);
    assert!(count(Path::new(&workers), ".log") > 0, "jobs have a cache of their own");
    assert!(count(Path::new(&upstream), ".index") > 0, "results go through the upstream");
    assert_eq!(count(&Path::new(&upstream).join("jobs"), ""), 0, "notes are deleted");
}

#[test]
fn jobs_with_a_cache_of_their_own_give_the_same_digests() {
    same_results(&Scheduler::shell());
    with_slurm(same_results);
}

#[test]
fn jobs_of_hyperqueue_with_a_cache_of_their_own_give_the_same_digests() {
    with_hyperqueue(same_results);
}

#[test]
fn jobs_that_cannot_see_the_cache_of_the_run_work_and_are_done_again_only_if_they_are_killed() {
    let place = place(3, "1");
    let Some(blind) = blind(&place) else { return };
    let options = options(&place);
    let more: Vec<&str> =
        ["--jobs", "1", "--batch", "100s"].into_iter().chain(options.iter().map(String::as_str)).collect();
    let mut run = blind.start(&place, &more);
    wait_until("a job runs", || !noted(&place, "begun").is_empty());
    // Its processes name the other cache.
    kill_those(&place.path("workers"));
    let status = end_of(&mut run);
    let err = fs::read_to_string(place.path("err")).expect("it was written");
    assert!(status.success() && err.contains("it runs again"), "{err}");
    assert_eq!(noted(&place, "ended"), numbers(3), "{err}");
    assert_eq!(fs::read_to_string(place.path("total")).expect("it was written"), "1\n2\n3\n");
    let again = place.tauflow(&["run", "small.yaml", "--upstream", &options[1]]).ends(0);
    assert!(again.err.contains("nothing to do"), "{}", again.err);
}

/// Kills the processes that run batches with this cache.
fn kill_those(cache: &Path) {
    let all = Command::new("ps").args(["-eo", "pid,args"]).output().expect("ps starts");
    let cache = cache.display().to_string();
    for line in String::from_utf8_lossy(&all.stdout).lines() {
        if line.contains("exec --batch") && line.contains(&cache) && !line.contains("unshare") {
            let pid = line.split_whitespace().next().expect("a number");
            Command::new("kill").args(["-9", pid]).status().expect("kill starts");
        }
    }
}

#[test]
fn a_cache_for_workers_needs_an_upstream_and_an_absolute_path() {
    let place = Place::new();
    let jobs = ["run", "small.yaml", "--executor", "command", "--submit", "x {script}", "--poll", "x", "--cancel"];
    let run = |more: &[&str]| place.tauflow(&[&jobs[..], &["x {ids}"], more].concat()).ends(2);
    let said = run(&["--worker-cache", "/scratch/cache"]);
    assert!(said.err.contains("no upstream"), "{}", said.err);
    let said = run(&["--worker-cache", "cache", "--upstream", "shared"]);
    assert!(said.err.contains("must be an absolute path"), "{}", said.err);
    let said = place.tauflow(&["run", "small.yaml", "--worker-cache", "/scratch/cache"]).ends(2);
    assert!(said.err.contains("--worker-cache needs --executor"), "{}", said.err);
}
