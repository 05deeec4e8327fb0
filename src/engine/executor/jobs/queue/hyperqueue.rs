//! HyperQueue: jobs are the tasks of one of its jobs.

use super::{Class, Queue, Stage, Submission, ask};
use serde_json::Value;
use std::{
    collections::{BTreeSet, HashMap},
    process::Command,
};
use tauflow_contract::Resources;

/// See the module.
pub struct HyperQueue;

/// The job of an id `JOB_TASK`.
fn job(id: &str) -> &str {
    id.split_once('_').map_or(id, |(job, _)| job)
}

/// What an option sets: `--cpus`, or `--resource=mem`.
fn name(option: &str) -> &str {
    option.rsplit_once('=').map_or(option, |(name, _)| name)
}

/// Options of `hq submit` that ask for resources. Workers know their memory in megabytes.
fn asked(of: Resources, class: Option<Class<'_>>) -> Vec<String> {
    let cores = || of.cores.map(|cores| format!("--cpus={cores}"));
    let options = [
        // Whoever measures has all of the worker.
        class.map_or_else(cores, |_| Some("--cpus=all".to_owned())),
        class.map(|class| format!("--resource={}=1", class.name)),
        of.memory.map(|bytes| format!("--resource=mem={}", bytes.div_ceil(1_000_000))),
        of.time.map(|seconds| format!("--time-limit={seconds}s")),
        of.gpus.filter(|gpus| *gpus > 0).map(|gpus| format!("--resource=gpus/nvidia={gpus}")),
    ];
    options.into_iter().flatten().collect()
}

impl Queue for HyperQueue {
    fn submit(&self, of: &Submission<'_>) -> Result<Vec<String>, String> {
        let mut command = Command::new("hq");
        command.args(["submit", "--output-mode=quiet", "--name", of.name]);
        command.arg(format!("--array=0-{}", of.jobs.saturating_sub(1)));
        command.arg(format!("--stdout={}", of.folder.log_of("%{TASK_ID}").display())).arg("--stderr=none");
        // It takes an option once.
        let is_given = |option: &&String| of.options.iter().any(|given| name(given) == name(option));
        command.args(asked(of.resources, of.class).iter().filter(|option| !is_given(option))).args(&of.options);
        // It sets this variable, which enters the keys of programs.
        let threads = match std::env::var("OMP_NUM_THREADS") {
            Ok(threads) => format!("export OMP_NUM_THREADS={}", super::quoted(&threads)),
            Err(_) => "unset OMP_NUM_THREADS".to_owned(),
        };
        let script = format!("{threads}; exec 2>&1; {}", of.words("HQ_TASK_ID"));
        command.args(["--", "sh", "-c"]).arg(script);
        let said = ask(&mut command)?;
        let id = said.lines().last().unwrap_or_default().trim();
        if id.is_empty() || !id.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(format!("`hq submit --output-mode=quiet` printed no id of a job: {}", said.trim()));
        }
        Ok((0..of.jobs).map(|task| format!("{id}_{task}")).collect())
    }

    fn poll(&self, ids: &[&str]) -> Result<HashMap<String, Stage>, String> {
        let jobs: BTreeSet<&str> = ids.iter().map(|id| job(id)).collect();
        let mut found = HashMap::new();
        for job in jobs {
            let said = ask(Command::new("hq").args(["task", "list", job, "--output-mode=json"]))?;
            let tasks: Value = serde_json::from_str(&said)
                .map_err(|error| format!("`hq task list {job} --output-mode=json` printed no JSON: {error}"))?;
            for task in tasks[job].as_array().into_iter().flatten() {
                let stage = match task["state"].as_str().unwrap_or_default().to_lowercase().as_str() {
                    "waiting" => Stage::Queued,
                    "running" => Stage::Running,
                    _ => continue,
                };
                found.insert(format!("{job}_{}", task["id"]), stage);
            }
        }
        Ok(found)
    }

    fn reason(&self, id: &str) -> Option<String> {
        let (job, number) = id.split_once('_')?;
        let number: u64 = number.parse().ok()?;
        let said = ask(Command::new("hq").args(["task", "list", job, "--output-mode=json"])).ok()?;
        let tasks: Value = serde_json::from_str(&said).ok()?;
        let task = tasks[job].as_array()?.iter().find(|task| task["id"].as_u64() == Some(number))?;
        Some(format!("{} {}", task["state"].as_str()?, task["error"].as_str().unwrap_or_default()).trim().to_owned())
    }

    fn cancel(&self, ids: &[&str]) -> Result<(), String> {
        // It cancels whole jobs; their other tasks have ended, or end with the same run.
        let jobs: BTreeSet<&str> = ids.iter().map(|id| job(id)).collect();
        jobs.into_iter().try_for_each(|job| ask(Command::new("hq").args(["job", "cancel", job])).map(drop))
    }
}
