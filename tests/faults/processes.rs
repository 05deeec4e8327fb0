//! Runs whose actions run in child processes, and what becomes of the run when these die.

use crate::{
    campaign::{Campaign, PIPELINE},
    child::PROCESSES,
};
use std::{fs, process::Command, thread, time::Duration};
use tauflow_testing::slow;

/// The child processes of a process.
fn children(of: u32) -> Vec<u32> {
    let listed = fs::read_to_string(format!("/proc/{of}/task/{of}/children")).unwrap_or_default();
    // Workers are threads, each of which has children of its own.
    let tasks = fs::read_dir(format!("/proc/{of}/task")).into_iter().flatten().flatten();
    let more = tasks.map(|task| fs::read_to_string(task.path().join("children")).unwrap_or_default());
    let all: Vec<String> = more.chain([listed]).collect();
    let mut found: Vec<u32> =
        all.iter().flat_map(|text| text.split_whitespace()).filter_map(|id| id.parse().ok()).collect();
    found.sort_unstable();
    found.dedup();
    found
}

#[test]
fn child_processes_killed_at_random_moments() {
    let mut campaign = Campaign::new("kill -9 and -TERM of a child process that runs a batch");
    let (runs, mut kills) = (if slow() { 30 } else { 3 }, 0);
    for run in 0..runs {
        let cache = campaign.fresh();
        // An action is given up when its process ended four times: every other run has fewer kills and must be whole.
        let (most, before) = (if run % 2 == 0 { 3 } else { u64::MAX }, kills);
        let mut process = campaign.start_with(&cache, PIPELINE, &[(PROCESSES, "1")]);
        while process.goes_on() {
            thread::sleep(Duration::from_millis(campaign.random(60)));
            let alive = children(process.id());
            if kills - before >= most {
                continue;
            }
            if let Some(id) = alive.get(campaign.random(alive.len() as u64) as usize) {
                let signal = if kills % 2 == 0 { "-9" } else { "-TERM" };
                let done = Command::new("kill").args([signal, &id.to_string()]).output().expect("kill starts");
                kills += u64::from(done.status.success());
            }
        }
        // The run itself never dies of it: at worst an action was hit too often, and is told as failed.
        let ended = process.wait();
        assert!(!ended.killed && (ended.code == 0 || most > 3 && ended.code == 1), "{ended:?}");
        let failures = ended.text.lines().filter(|line| line.starts_with("failed: "));
        failures.for_each(|line| assert!(line.contains("its process ended 4 times"), "{line}"));
        if ended.code == 0 {
            campaign.same(&ended, PIPELINE);
        }
        campaign.ends_well(&cache);
    }
    assert!(kills > runs, "children live long enough to be killed: {kills}");
    campaign.made(kills);
}

#[test]
fn a_process_that_crashes_costs_an_attempt_and_no_more() {
    let mut campaign = Campaign::new("crash of a child process");
    let cache = campaign.fresh();
    let marker = cache.with_extension("marker");
    let text = |param: &str| {
        format!(
            "pipeline: deadly\nnodes:\n  numbers: {{kind: numbers, params: {{count: 12}}}}\n  \
             deadly: {{kind: deadly, inputs: {{in: numbers}}, params: {{on: [70]{param}}}}}\n"
        )
    };
    let once = text(&format!(", once: {}", marker.display()));
    let ended = campaign.start_with(&cache, &once, &[(PROCESSES, "1")]).wait();
    assert!(marker.exists(), "it crashed");
    assert_eq!((ended.code, ended.text.matches("it runs again").count()), (0, 1), "{ended:?}");
    let ended = campaign.start_with(&cache, &text(""), &[(PROCESSES, "1")]).wait();
    let failed: Vec<&str> = ended.text.lines().filter(|line| line.starts_with("failed: ")).collect();
    assert_eq!((ended.code, failed.len()), (1, 1), "{ended:?}");
    assert!(failed[0].contains("deadly n0007 its process ended 4 times before it was done"), "{failed:?}");
    let others = campaign.done(&text("")).iter().filter(|line| line.starts_with("deadly")).count();
    assert_eq!(others, 11, "the rest of its batch comes through");
    campaign.made(5);
}
