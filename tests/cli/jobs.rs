//! Runs whose actions are jobs of a scheduler: Slurm where it is installed, and a shell that starts processes.

#[path = "../support/schedulers.rs"]
mod schedulers;

use crate::{Place, Said};
use schedulers::{HyperQueue, Slurm};
use std::{
    fs,
    io::Read,
    process::{Child, Command, ExitStatus, Output, Stdio},
    sync::{Mutex, OnceLock},
    thread,
    time::{Duration, Instant},
};
use tauflow_testing::{Need, skip};

/// Items of a list, each copied by a program that notes that it began and that it ended.
pub(crate) const PIPELINE: &str = "\
pipeline: small
seed: 3
nodes:
  numbers:
    kind: command
    params:
      run: [sh, numbers.sh]
      mode: gather
      outputs: { numbers: tauflow/files }
  copies:
    kind: command
    inputs: { numbers: numbers }
    params:
      run: [sh, copy.sh]
      inputs: { numbers: tauflow/files }
      outputs: { copies: tauflow/files }
  total:
    kind: command
    inputs: { copies: copies }
    params:
      run: [sh, total.sh]
      mode: gather
      inputs: { copies: tauflow/files }
      outputs: { total: tauflow/files }
";

/// A place with this pipeline, whose program takes so long for each item.
pub(crate) fn place(items: usize, seconds: &str) -> Place {
    let place = Place::with(PIPELINE);
    let here = place.path("").display().to_string();
    let script = |name: &str, text: &str| place.write(name, &text.replace("HERE", &here));
    script(
        "numbers.sh",
        &format!("for n in $(seq {items}); do mkdir out/numbers/$n; echo $n > out/numbers/$n/n; done"),
    );
    script(
        "copy.sh",
        &format!(
            "n=$(cat in/numbers/n); echo $n >> HERE/begun
sleep {seconds} || exit 1; echo $n >> HERE/ended; cp in/numbers/n out/copies/n"
        ),
    );
    script("total.sh", "mkdir out/total/all; cat in/copies/*/n | sort -n > HERE/total; cp HERE/total out/total/all/n");
    place
}

/// How often each item was begun or ended.
pub(crate) fn noted(place: &Place, what: &str) -> Vec<String> {
    let mut lines: Vec<String> =
        fs::read_to_string(place.path(what)).unwrap_or_default().lines().map(str::to_owned).collect();
    lines.sort();
    lines
}

/// The numbers up to this, in the order of their texts.
pub(crate) fn numbers(last: usize) -> Vec<String> {
    let mut all: Vec<String> = (1..=last).map(|n| n.to_string()).collect();
    all.sort();
    all
}

/// Options that have a shell start jobs as processes of this machine.
pub(crate) const SHELL: [&str; 10] = [
    "--executor",
    "command",
    "--submit",
    "setsid sh {script} > {log} 2>&1 < /dev/null & echo $!",
    "--poll",
    "ps -o pid=,stat= -p $(echo {ids} | tr ' ' ,) | awk '$2 !~ /Z/ { print $1, \"running\" }'",
    "--cancel",
    "kill {ids}",
    "--poll-every",
    "0.2s",
];

/// A scheduler, and what chooses it.
pub(crate) struct Scheduler {
    pub(crate) options: Vec<&'static str>,
    pub(crate) variables: Vec<(&'static str, String)>,
}

impl Scheduler {
    pub(crate) fn shell() -> Self {
        Self { options: SHELL.to_vec(), variables: Vec::new() }
    }

    pub(crate) fn command(&self, place: &Place, more: &[&str]) -> Command {
        let mut command = place.command(&[&["run", "small.yaml"], &self.options[..], more].concat());
        command.envs(self.variables.clone());
        command
    }

    pub(crate) fn run(&self, place: &Place, more: &[&str]) -> Said {
        let mut command = self.command(place, more);
        let mut run = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
        let read = |mut pipe: Box<dyn Read + Send>| {
            thread::spawn(move || {
                let mut bytes = Vec::new();
                pipe.read_to_end(&mut bytes).map(|_| bytes)
            })
        };
        let (out, err) = (run.stdout.take().expect("a pipe"), run.stderr.take().expect("a pipe"));
        let (out, err) = (read(Box::new(out)), read(Box::new(err)));
        let status = end_of(&mut run);
        let [stdout, stderr] = [out, err].map(|read| read.join().expect("it reads").expect("readable"));
        Said::of(&Output { status, stdout, stderr })
    }

    pub(crate) fn start(&self, place: &Place, more: &[&str]) -> Child {
        let err = fs::File::create(place.path("err")).expect("writable");
        self.command(place, more).stdout(Stdio::null()).stderr(err).spawn().expect("the program starts")
    }
}

/// Does a test with Slurm, or says that it skipped. Such tests take turns.
pub(crate) fn with_slurm(test: impl FnOnce(&Scheduler)) {
    static RUNNING: OnceLock<Option<Mutex<Slurm>>> = OnceLock::new();
    let Some(slurm) = RUNNING.get_or_init(|| Slurm::start().map(Mutex::new)) else {
        return skip(Need::Slurm, "slurm-wlm and munge are not installed");
    };
    let slurm = slurm.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    test(&Scheduler { options: vec!["--executor", "slurm", "--poll-every", "0.5s"], variables: slurm.variables() });
}

/// Does a test with a server and a worker of HyperQueue, or says that it skipped.
pub(crate) fn with_hyperqueue(test: impl FnOnce(&Scheduler)) {
    let Some(hyperqueue) = HyperQueue::start() else {
        return skip(Need::HyperQueue, "TAUFLOW_HYPERQUEUE names no Python with the package hyperqueue");
    };
    let options = vec!["--executor", "hyperqueue", "--poll-every", "0.5s"];
    test(&Scheduler { options, variables: hyperqueue.variables() });
}

/// How a run ends. One that takes far too long is killed: its scheduler may never start its jobs.
pub(crate) fn end_of(run: &mut Child) -> ExitStatus {
    let begun = Instant::now();
    loop {
        if let Some(status) = run.try_wait().expect("our own") {
            return status;
        }
        if begun.elapsed() > Duration::from_secs(300) {
            run.kill().expect("our own");
            let status = run.wait().expect("it ends");
            eprintln!("a run was killed that had not ended after five minutes");
            return status;
        }
        thread::sleep(Duration::from_millis(20));
    }
}

pub(crate) fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(90), "waited in vain until {what}");
        thread::sleep(Duration::from_millis(20));
    }
}

pub(crate) fn jobs_are_gone(place: &Place) -> bool {
    fs::read_dir(place.path("store/jobs")).map_or(true, |mut entries| entries.next().is_none())
}

fn jobs_are_noted(place: &Place) -> bool {
    let mut folders = fs::read_dir(place.path("store/jobs")).into_iter().flatten().flatten();
    folders.any(|folder| folder.path().join("jobs.json").is_file())
}

pub(crate) fn the_same_as_on_threads(scheduler: &Scheduler) {
    the_same_with(scheduler, &[]);
}

/// The digests of a run on threads, with these options of the run of jobs; the place with both caches.
pub(crate) fn the_same_with(scheduler: &Scheduler, more: &[&str]) -> Place {
    let place = Place::new();
    place.tauflow(&["run", "small.yaml", "--update-lock"]).ends(0);
    let other = place.path("store").with_file_name("other");
    let cache = other.display().to_string();
    let said = scheduler.run(&place, &[&["--locked", "--cache", &cache], more].concat()).ends(0);
    assert!(said.err.contains("small.lock agrees") && said.err.contains("jobs: "), "{}", said.err);
    assert!(!said.err.contains("warning"), "{}", said.err);
    let again = scheduler.run(&place, &[&["--cache", &cache], more].concat()).ends(0);
    assert!(again.err.contains("nothing to do"), "{}", again.err);
    place.tauflow(&["cache", "verify", "--cache", &cache]).ends(0);
    let left = fs::read_dir(other.join("jobs")).expect("there were jobs").count();
    assert_eq!(left, 0, "folders of jobs that have ended are removed");
    place
}

fn the_next_run_finds_the_jobs_of_one_that_was_killed(scheduler: &Scheduler) {
    let place = place(4, "4");
    let mut first = scheduler.start(&place, &["--batch", "100s"]);
    // A job may begin before the scheduler has told its id. Killed then, the run has no id to leave, and the next one
    // submits a job that waits for it.
    wait_until("a job runs, and its id is noted", || !noted(&place, "begun").is_empty() && jobs_are_noted(&place));
    first.kill().expect("our own");
    first.wait().expect("it ends");
    let said = scheduler.run(&place, &[]).ends(0);
    assert!(said.err.contains("of an earlier run found"), "{}", said.err);
    assert_eq!(noted(&place, "ended"), numbers(4), "nothing is done twice: {}", said.err);
    assert_eq!(fs::read_to_string(place.path("total")).expect("it was written"), "1\n2\n3\n4\n");
    assert!(jobs_are_gone(&place));
}

fn ctrl_c_cancels_jobs(scheduler: &Scheduler) {
    let place = place(3, "300");
    let mut run = scheduler.start(&place, &[]);
    wait_until("a job runs", || !noted(&place, "begun").is_empty());
    let interrupt = Command::new("kill").args(["-INT", &run.id().to_string()]).status().expect("kill starts");
    assert!(interrupt.success());
    assert_eq!(end_of(&mut run).code(), Some(130));
    let err = fs::read_to_string(place.path("err")).expect("it was written");
    assert!(err.contains("stopped; to resume") && !err.contains("warning"), "{err}");
    let folder = place.path("").display().to_string();
    let alive = || {
        let all = Command::new("ps").args(["-eo", "args"]).output().expect("ps starts");
        String::from_utf8_lossy(&all.stdout).lines().any(|line| line.contains("exec --batch") && line.contains(&folder))
    };
    wait_until("the jobs are cancelled", || !alive());
    assert!(jobs_are_gone(&place));
}

fn a_job_that_is_killed_runs_again(scheduler: &Scheduler, kill: impl Fn(&Place)) {
    let place = place(3, "1");
    let mut run = scheduler.start(&place, &["--jobs", "1", "--batch", "100s"]);
    wait_until("a job runs", || !noted(&place, "begun").is_empty());
    kill(&place);
    let status = end_of(&mut run);
    let err = fs::read_to_string(place.path("err")).expect("it was written");
    assert!(status.success() && err.contains("ended before it was done") && err.contains("it runs again"), "{err}");
    assert_eq!(noted(&place, "ended"), numbers(3), "{err}");
    assert!(jobs_are_gone(&place));
    // Without retries the action fails, and those behind it are done.
    fs::remove_dir_all(place.path("store")).expect("our own");
    fs::remove_file(place.path("begun")).expect("our own");
    fs::remove_file(place.path("ended")).expect("our own");
    let mut run = scheduler.start(&place, &["--jobs", "1", "--batch", "100s", "--retries", "0"]);
    wait_until("a job runs", || !noted(&place, "begun").is_empty());
    kill(&place);
    let status = end_of(&mut run);
    let err = fs::read_to_string(place.path("err")).expect("it was written");
    assert!(status.code() == Some(1) && err.contains("at attempt 1"), "{err}");
    assert_eq!(noted(&place, "ended").len(), 2, "{err}");
}

/// Kills the processes that run batches of this place.
pub(crate) fn kill_workers(place: &Place) {
    let folder = place.path("store").display().to_string();
    let all = Command::new("ps").args(["-eo", "pid,args"]).output().expect("ps starts");
    for line in String::from_utf8_lossy(&all.stdout).lines() {
        if line.contains("exec --batch") && line.contains(&folder) {
            let pid = line.split_whitespace().next().expect("a number");
            Command::new("kill").args(["-9", pid]).status().expect("kill starts");
        }
    }
}

#[test]
fn jobs_of_a_shell_give_the_digests_of_threads() {
    the_same_as_on_threads(&Scheduler::shell());
}

#[test]
fn jobs_of_a_shell_are_found_again() {
    the_next_run_finds_the_jobs_of_one_that_was_killed(&Scheduler::shell());
}

#[test]
fn jobs_of_a_shell_are_cancelled() {
    ctrl_c_cancels_jobs(&Scheduler::shell());
}

#[test]
fn jobs_of_a_shell_run_again() {
    a_job_that_is_killed_runs_again(&Scheduler::shell(), kill_workers);
}

#[test]
fn jobs_of_slurm_give_the_digests_of_threads() {
    with_slurm(the_same_as_on_threads);
}

#[test]
fn options_reach_the_jobs_of_their_node() {
    with_slurm(|slurm| {
        let place = place(1, "0");
        let names = ["numbers", "copies", "total"].map(|node| format!("--job-option={node}:--comment=of-{node}"));
        let more: Vec<&str> = names.iter().map(String::as_str).chain(["--job-option=--time=7"]).collect();
        slurm.run(&place, &more).ends(0);
        let mut show = Command::new("scontrol");
        let jobs = show.args(["-o", "show", "jobs"]).envs(slurm.variables.clone()).output().expect("scontrol starts");
        let jobs = String::from_utf8_lossy(&jobs.stdout).into_owned();
        let job =
            |node: &str| jobs.lines().find(|line| line.contains(&format!("Comment=of-{node}"))).map(str::to_owned);
        for node in ["numbers", "copies", "total"] {
            assert!(job(node).is_some_and(|job| job.contains("TimeLimit=00:07:00")), "{node}: {jobs}");
        }
    });
}

#[test]
fn jobs_of_slurm_are_found_again() {
    with_slurm(the_next_run_finds_the_jobs_of_one_that_was_killed);
}

#[test]
fn jobs_of_slurm_are_cancelled() {
    with_slurm(ctrl_c_cancels_jobs);
}

#[test]
fn jobs_of_slurm_run_again_that_were_killed_or_cancelled_by_somebody() {
    with_slurm(|slurm| {
        a_job_that_is_killed_runs_again(slurm, kill_workers);
        a_job_that_is_killed_runs_again(slurm, |_| {
            let mut cancel = Command::new("scancel");
            cancel.args(["--me", "--state=RUNNING"]).envs(slurm.variables.clone());
            assert!(cancel.status().expect("scancel starts").success());
        });
    });
}

#[test]
fn jobs_of_hyperqueue_are_the_same_are_found_are_cancelled_and_run_again() {
    with_hyperqueue(|hyperqueue| {
        the_same_as_on_threads(hyperqueue);
        the_next_run_finds_the_jobs_of_one_that_was_killed(hyperqueue);
        ctrl_c_cancels_jobs(hyperqueue);
        a_job_that_is_killed_runs_again(hyperqueue, kill_workers);
        crate::job_resources::are_asked_of_hyperqueue(hyperqueue);
    });
}

#[test]
fn a_scheduler_that_does_not_take_jobs_is_named() {
    let place = Place::new();
    let said = place.tauflow(&["run", "small.yaml", "--submit", "x"]).ends(2);
    assert!(said.err.contains("need --executor command"), "{}", said.err);
    let said = place.tauflow(&["run", "small.yaml", "--executor", "command"]).ends(2);
    assert!(said.err.contains("needs --submit") && said.err.contains("docs/many_machines.md"), "{}", said.err);
    let command = ["run", "small.yaml", "--executor", "command", "--poll", "true", "--cancel", "true {ids}"];
    let said = place.tauflow(&[&command[..], &["--submit", "qsub"]].concat()).ends(2);
    assert!(said.err.contains("must contain {script}"), "{}", said.err);
    let said = place.tauflow(&["run", "small.yaml", "--executor", "slurm", "--job-option=scene:--mem=1G"]).ends(2);
    assert!(said.err.contains("unknown node `scene`") && said.err.contains("scenes, split"), "{}", said.err);
    let mut command = place.command(&["run", "small.yaml", "--executor", "slurm"]);
    let said = Said::of(&command.env("PATH", "/nonexistent").output().expect("the program starts")).ends(3);
    assert!(said.err.contains("`sbatch` cannot be started"), "{}", said.err);
}
