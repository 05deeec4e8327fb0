//! What goes wrong on clusters while jobs run: nodes are drained, disks are full, processes are killed at any time. The
//! results are the same, and nothing that a run announced as done is done again.

use crate::{
    Place,
    jobs::{Scheduler, end_of, kill_workers, noted, numbers, place, wait_until, with_hyperqueue, with_slurm},
    json,
};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::Duration,
};
use tauflow_testing::{Need, skip};

/// Numbers that seem random, and are the same in each test.
struct Draws(u64);

impl Draws {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }
}

/// The copies that a run announced as done by it.
fn announced(events: &Path) -> Vec<String> {
    let text = fs::read_to_string(events).unwrap_or_default();
    // The last line may be half a one.
    let events = text.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let done = events.filter(|of| of["event"] == "end" && of["outcome"] == "ran" && of["node"] == "copies");
    done.map(|of| of["item"].as_str().expect("a text").to_owned()).collect()
}

/// Kills jobs' processes and the run itself, again and again, at times that differ; then lets it end.
fn killed_at_random(scheduler: &Scheduler, seed: u64) {
    let place = place(10, "0.4");
    let mut draws = Draws(seed);
    let mut done: BTreeMap<String, u32> = BTreeMap::new();
    let (mut kills, mut runs) = (0, 0);
    loop {
        let events = place.path(&format!("events-{runs}"));
        let more = ["--batch", "1s", "--jobs", "3", "--retries", "100", "--events", "json"];
        let mut command = scheduler.command(&place, &more);
        let err = fs::File::create(place.path("err")).expect("writable");
        command.stdout(fs::File::create(&events).expect("writable")).stderr(err);
        let mut run = command.spawn().expect("the program starts");
        runs += 1;
        let status = loop {
            thread::sleep(Duration::from_millis(200 + draws.below(500)));
            if let Some(status) = run.try_wait().expect("our own") {
                break Some(status);
            }
            if kills == 8 {
                break Some(end_of(&mut run));
            }
            kills += 1;
            kill_workers(&place);
            if draws.below(3) == 0 {
                run.kill().expect("our own");
                end_of(&mut run);
                break None;
            }
        };
        for item in announced(&events) {
            *done.entry(item).or_default() += 1;
        }
        let err = || fs::read_to_string(place.path("err")).expect("it was written");
        match status {
            Some(status) if status.success() => break,
            Some(status) => panic!("{status}: {}", err()),
            None => assert!(runs < 40, "{}", err()),
        }
    }
    assert!(kills > 0, "it was too fast to be killed");
    assert!(done.values().all(|times| *times == 1), "announced as done, and done again: {done:?}");
    same_results(scheduler, &place, 10);
}

/// The results are there, and sound.
fn same_results(scheduler: &Scheduler, place: &Place, items: usize) {
    let expected: String = (1..=items).map(|n| format!("{n}\n")).collect();
    assert_eq!(fs::read_to_string(place.path("total")).expect("it was written"), expected);
    place.tauflow(&["cache", "verify"]).ends(0);
    // With the same variables, which are in the keys of programs.
    let again = scheduler.run(place, &[]).ends(0);
    assert!(again.err.contains("nothing to do"), "{}", again.err);
}

#[test]
fn workers_and_runs_that_are_killed_at_random_do_nothing_twice() {
    killed_at_random(&Scheduler::shell(), 1);
}

#[test]
fn slurm_survives_kills_at_random() {
    with_slurm(|slurm| killed_at_random(slurm, 2));
}

#[test]
fn hyperqueue_survives_kills_at_random() {
    with_hyperqueue(|hyperqueue| killed_at_random(hyperqueue, 3));
}

/// The node of a test's Slurm takes no jobs as long as this lives.
struct Drained<'a>(&'a Scheduler);

impl<'a> Drained<'a> {
    fn of(slurm: &'a Scheduler) -> Self {
        let drained = Self(slurm);
        assert!(drained.set(&["State=DRAIN", "Reason=test"]), "Slurm drains its node");
        drained
    }

    fn set(&self, what: &[&str]) -> bool {
        let host = Command::new("hostname").arg("-s").output().expect("hostname starts");
        let node = format!("NodeName={}", String::from_utf8_lossy(&host.stdout).trim());
        let mut control = Command::new("scontrol");
        control.args(["update", &node]).args(what).envs(self.0.variables.clone());
        control.status().is_ok_and(|status| status.success())
    }
}

impl Drop for Drained<'_> {
    fn drop(&mut self) {
        // A test that fails before this would leave a node that later tests wait for.
        let resumed = self.set(&["State=RESUME"]);
        assert!(resumed || thread::panicking(), "Slurm resumes its node");
    }
}

#[test]
fn a_node_that_is_drained_ends_its_jobs_and_takes_others_later() {
    with_slurm(|slurm| {
        // So many that some are left when the node is drained, however long that takes on a busy machine.
        let items = 12;
        let place = place(items, "1");
        let mut run = slurm.start(&place, &["--batch", "0.1s"]);
        wait_until("a job runs", || !noted(&place, "begun").is_empty());
        let drained = Drained::of(slurm);
        wait_until("those that had begun are done", || {
            let (begun, ended) = (noted(&place, "begun").len(), noted(&place, "ended").len());
            begun == ended
        });
        thread::sleep(Duration::from_secs(2));
        let before = noted(&place, "ended").len();
        let ended = run.try_wait().expect("our own");
        let err = || fs::read_to_string(place.path("err")).expect("it was written");
        assert!(before < items && ended.is_none(), "the rest waits: {before} are done; {ended:?}: {}", err());
        drop(drained);
        assert!(end_of(&mut run).success(), "{}", err());
        assert_eq!(noted(&place, "ended"), numbers(items), "nothing is done twice: {}", err());
        same_results(slurm, &place, items);
    });
}

/// A file system of this size at a folder, as long as this lives.
struct Small(PathBuf);

impl Small {
    fn at(folder: &Path, size: &str) -> Option<Self> {
        fs::create_dir_all(folder).expect("writable");
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"]).arg(folder).stderr(Stdio::null());
        if !mount.status().is_ok_and(|status| status.success()) {
            skip(Need::Mount, "file systems cannot be mounted");
            return None;
        }
        Some(Self(folder.to_owned()))
    }
}

/// A file system that is full, but for less than a page, as long as this lives.
struct Filled(PathBuf);

impl Filled {
    fn at(folder: &Path) -> Self {
        let filler = folder.join("filler");
        let to = filler.display();
        let script =
            format!("dd if=/dev/zero of='{to}' bs=4096; dd if=/dev/zero of='{to}' bs=1 oflag=append conv=notrunc");
        Command::new("sh").args(["-c", &script]).stderr(Stdio::null()).status().expect("sh starts");
        Self(filler)
    }
}

impl Drop for Filled {
    fn drop(&mut self) {
        let removed = fs::remove_file(&self.0);
        assert!(removed.is_ok() || thread::panicking(), "{removed:?}");
    }
}

impl Drop for Small {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[test]
fn a_full_folder_of_jobs_loses_no_result() {
    let place = place(4, "1");
    // The cache must be there before its folder of jobs is.
    place.tauflow(&["run", "small.yaml", "--target", "numbers"]).ends(0);
    let jobs = place.path("store/jobs");
    let Some(_small) = Small::at(&jobs, "256k") else { return };
    let mut run = Scheduler::shell().start(&place, &["--jobs", "1", "--batch", "100s", "--retries", "100"]);
    wait_until("an action is done", || !noted(&place, "ended").is_empty());
    // Jobs cannot tell any more that they are done, but their results are recorded.
    let filled = Filled::at(&jobs);
    wait_until("all are done", || noted(&place, "ended").len() == 4);
    drop(filled);
    let ended = end_of(&mut run).success();
    let err = fs::read_to_string(place.path("err")).expect("it was written");
    // While it was full, the run may have had no room for the next jobs, and said so.
    assert!(ended || err.contains("cannot write jobs to") && err.contains("No space left"), "{err}");
    Scheduler::shell().run(&place, &[]).ends(0);
    assert_eq!(noted(&place, "ended"), numbers(4), "nothing is done twice: {err}");
    assert_eq!(fs::read_to_string(place.path("total")).expect("it was written"), "1\n2\n3\n4\n");
}

#[test]
fn a_full_spool_of_slurm_is_waited_for() {
    with_slurm(|slurm| {
        let (_, configuration) = slurm.variables.iter().find(|(name, _)| *name == "SLURM_CONF").expect("it is set");
        let state = Path::new(configuration).parent().expect("a folder").join("state");
        let mounted = Command::new("mountpoint").arg("-q").arg(&state).status();
        if !mounted.is_ok_and(|status| status.success()) {
            return skip(Need::Mount, "file systems cannot be mounted");
        }
        let place = place(3, "1");
        let mut run = slurm.start(&place, &["--jobs", "1", "--batch", "0.1s"]);
        wait_until("a job runs", || !noted(&place, "begun").is_empty());
        let filled = Filled::at(&state);
        let err = || fs::read_to_string(place.path("err")).expect("it was written");
        wait_until("Slurm takes no job", || err().contains("trying again"));
        drop(filled);
        let status = end_of(&mut run);
        assert!(status.success(), "{}", err());
        assert_eq!(noted(&place, "ended"), numbers(3), "nothing is done twice: {}", err());
        same_results(slurm, &place, 3);
    });
}

#[test]
fn events_of_an_action_say_that_it_ran() {
    // What the tests above count.
    let place = place(2, "0");
    let said = place.tauflow(&["run", "small.yaml", "--events", "json"]).ends(0);
    let ends: Vec<_> = said.lines().into_iter().map(json).filter(|of| of["event"] == "end").collect();
    assert_eq!(ends.iter().filter(|of| of["node"] == "copies" && of["outcome"] == "ran").count(), 2, "{ends:?}");
}
