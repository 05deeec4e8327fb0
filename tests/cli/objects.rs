//! Upstreams in object stores and on web servers.

#[path = "../../cache/upstream/tests/servers/mod.rs"]
mod servers;

use crate::{Place, Said};
use servers::{S3, Web};
use std::{
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    sync::atomic::Ordering,
};

const SECRET: &str = "wJalrXUtnFEMIsecret";

impl Place {
    fn at(&self, machine: &str, url: &str, s3: Option<&S3>, arguments: &[&str]) -> Command {
        let mut command = self.command(arguments);
        command.env("TAUFLOW_CACHE", self.path(machine)).env("TAUFLOW_UPSTREAM", url);
        // Nobody's own account takes part.
        let own = std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("AWS_"));
        own.for_each(|(name, _)| {
            command.env_remove(name);
        });
        if let Some(s3) = s3 {
            command.env("AWS_ENDPOINT_URL", &s3.url).env("AWS_ALLOW_HTTP", "true");
            command.env("AWS_ACCESS_KEY_ID", "AKIDEXAMPLE").env("AWS_SECRET_ACCESS_KEY", SECRET);
        }
        command
    }

    fn over(&self, machine: &str, url: &str, s3: Option<&S3>, arguments: &[&str]) -> Said {
        Said::of(&self.at(machine, url, s3, arguments).output().expect("the program starts"))
    }
}

/// The requests that a command made.
fn requests(said: &Said) -> u64 {
    let line = said.err.lines().find_map(|line| line.strip_prefix("upstream: ")).unwrap_or_default();
    line.split(' ').next().and_then(|n| n.replace(',', "").parse().ok()).unwrap_or_else(|| panic!("{said:?}"))
}

/// All bytes of all files below a folder.
fn all_bytes(folder: &Path) -> Vec<u8> {
    let (mut open, mut all) = (vec![folder.to_owned()], Vec::new());
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(fs::read_dir(&path).expect("readable").flatten().map(|entry| entry.path()));
        } else {
            all.extend(fs::read(&path).unwrap_or_default());
        }
    }
    all
}

fn contains(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|window| window == text.as_bytes())
}

#[test]
fn results_go_through_s3_in_few_requests() {
    let Some(s3) = S3::start(false) else { return };
    let (place, url) = (Place::new(), "s3://lab/results/tauflow");
    let on = |machine: &str, arguments: &[&str]| place.over(machine, url, Some(&s3), arguments);
    let said = on("a", &["run", "small.yaml", "--push"]).ends(0);
    assert!(said.err.contains("pushed ") && !said.err.contains("note: "), "{}", said.err);
    let said = on("b", &["run", "small.yaml"]).ends(0);
    assert!(said.err.contains("nothing to do") && !said.err.contains("note: "), "{}", said.err);
    assert!(requests(&said) <= 6, "{}", said.err);
    // The index is kept, and nothing else is lacking.
    let said = on("b", &["run", "small.yaml", "--no-rollup"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    on("b", &["export", "small.yaml", "scenes", "--out", "exported"]).ends(0);
    on("b", &["cache", "verify"]).ends(0);
    let said = on("c", &["cache", "pull"]).ends(0);
    assert!(said.out.ends_with(" 0 here already\n"), "{}", said.out);
    // All of a pack of 30 MB comes in ranges that grow.
    assert!(requests(&said) <= 16, "{}", said.err);
    let said = place.over("c", "", None, &["run", "small.yaml"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    // An edit runs what it must, and goes back.
    on("b", &["run", "small.yaml", "--profile", "more", "--push"]).ends(0);
    let stat = on("a", &["cache", "stat", "--upstream", url]).ends(0).out;
    assert!(stat.starts_with(url) && stat.contains("2 packs with 2 indices"), "{stat}");
    for machine in ["a", "b", "c"] {
        assert!(!contains(&all_bytes(&place.path(machine)), SECRET), "the secret is in the cache of {machine}");
    }
    // A bucket that is missing, and a prefix of somebody else.
    let said = place.over("a", "s3://nobody/x", Some(&s3), &["cache", "push"]).ends(3);
    assert!(said.err.contains("NoSuchBucket"), "{}", said.err);
    let said = place.over("a", "s3://lab/results", Some(&s3), &["cache", "push"]).ends(2);
    assert!(said.err.contains("is not an upstream"), "{}", said.err);
}

#[test]
fn machines_push_to_s3_at_once() {
    let Some(s3) = S3::start(false) else { return };
    let (place, url) = (Place::new(), "s3://lab");
    let pools = ["scenes.pool=8", "scenes.pool=9", "scenes.pool=10"];
    let run = |(machine, pool): (&&str, &str)| {
        let mut command = place.at(machine, url, Some(&s3), &["run", "small.yaml", "--push", "--set", pool]);
        command.stderr(Stdio::null()).stdout(Stdio::null()).spawn().expect("the program starts")
    };
    let mut all: Vec<Child> = ["a", "b", "c"].iter().zip(pools).map(run).collect();
    for child in &mut all {
        assert!(child.wait().expect("it ends").success());
    }
    for pool in pools {
        let said = place.over("d", url, Some(&s3), &["run", "small.yaml", "--set", pool]).ends(0);
        assert!(said.err.contains("nothing to do") && !said.err.contains("note: "), "{}", said.err);
    }
}

#[test]
fn wrong_credentials_are_told_without_them_and_work_goes_on() {
    let Some(s3) = S3::start(true) else { return };
    let (place, url) = (Place::new(), "s3://lab/x");
    let said = place.over("a", url, Some(&s3), &["run", "small.yaml"]).ends(0);
    assert_eq!(said.err.matches("note: the upstream is not used").count(), 1, "{}", said.err);
    assert!(said.err.contains("access is denied") && said.err.contains("InvalidAccessKeyId"), "{}", said.err);
    let pushed = place.over("a", url, Some(&s3), &["cache", "push"]).ends(3);
    assert!(pushed.err.contains("check the credentials in the environment"), "{}", pushed.err);
    for text in [said.err, said.out, pushed.err] {
        assert!(!text.contains(SECRET) && !text.contains("AKIDEXAMPLE"), "{text}");
    }
    assert!(!contains(&all_bytes(&place.path("a")), SECRET));
    // A run that is to push fails before it begins.
    let said = place.over("b", url, Some(&s3), &["run", "small.yaml", "--push"]).ends(3);
    assert!(!said.err.contains(" ran, "), "{}", said.err);
}

#[test]
fn a_web_server_serves_what_was_pushed_to_its_folder() {
    let place = Place::new();
    let shared = place.path("shared").display().to_string();
    place.over("a", &shared, None, &["run", "small.yaml", "--push"]).ends(0);
    place.over("a", &shared, None, &["run", "small.yaml", "--profile", "more", "--push"]).ends(0);
    let web = Web::serve(place.path("shared"));
    for profile in [&[][..], &["--profile", "more"]] {
        let said = place.over("b", &web.url, None, &[&["run", "small.yaml"], profile].concat()).ends(0);
        assert!(said.err.contains("nothing to do") && !said.err.contains("note: "), "{}", said.err);
    }
    let before = web.requests.load(Ordering::Relaxed);
    let said = place.over("c", &web.url, None, &["run", "small.yaml"]).ends(0);
    assert_eq!(requests(&said), web.requests.load(Ordering::Relaxed) - before, "what is told is what was asked");
    place.over("c", &web.url, None, &["export", "small.yaml", "scenes", "--out", "exported"]).ends(0);
    place.over("d", "", None, &["run", "small.yaml", "--set", "scenes.pool=9"]).ends(0);
    let said = place.over("d", &web.url, None, &["cache", "push"]).ends(3);
    assert!(said.err.contains("a web server is for reading only"), "{}", said.err);
}

#[test]
fn a_server_that_is_killed_is_one_note_and_the_run_makes_the_rest() {
    let place = Place::new();
    let shared = place.path("shared").display().to_string();
    place.over("a", &shared, None, &["run", "small.yaml", "--push"]).ends(0);
    let web = Web::serve(place.path("shared"));
    // The marker, the list and the index arrive. Then it is gone.
    web.allowed.store(3, Ordering::Relaxed);
    let said = place.over("b", &web.url, None, &["run", "small.yaml", "--profile", "more"]).ends(0);
    assert_eq!(said.err.matches("note: ").count(), 1, "{}", said.err);
    assert!(said.err.contains("note: the upstream is not used any more: "), "{}", said.err);
    assert!(web.requests.load(Ordering::Relaxed) >= 5, "it was asked again before it was given up");
    let said = place.over("b", "", None, &["run", "small.yaml", "--profile", "more"]).ends(0);
    assert!(said.err.contains("nothing to do"), "{}", said.err);
    // The outputs are the same as without any upstream.
    let digests = |machine: &str| {
        place.over(machine, "", None, &["run", "small.yaml", "--profile", "more", "--update-lock"]).ends(0);
        let name = if place.path("small.more.lock").exists() { "small.more.lock" } else { "small.lock" };
        fs::read_to_string(place.path(name)).expect("it was written")
    };
    assert_eq!(digests("b"), digests("alone"));
    // From the first request on.
    web.allowed.store(0, Ordering::Relaxed);
    let said = place.over("c", &web.url, None, &["run", "small.yaml"]).ends(0);
    assert_eq!(said.err.matches("note: the upstream is not used: ").count(), 1, "{}", said.err);
}
