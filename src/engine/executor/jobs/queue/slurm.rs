//! Slurm: jobs are the tasks of one array.

use super::{Class, Queue, Stage, Submission, ask};
use std::{collections::HashMap, fs, process::Command};
use tauflow_contract::Resources;

/// Jobs that one call of `scancel` names.
const MOST_NAMED: usize = 500;

/// See the module.
pub struct Slurm;

/// Options of `sbatch` that ask for resources.
fn asked(of: Resources) -> Vec<String> {
    let options = [
        of.cores.map(|cores| format!("--cpus-per-task={cores}")),
        of.memory_mib().map(|mib| format!("--mem={mib}M")),
        // Whole minutes; Slurm kills jobs up to a minute late.
        of.time.map(|seconds| format!("--time={}", seconds.div_ceil(60))),
        of.gpus.filter(|gpus| *gpus > 0).map(|gpus| format!("--gres=gpu:{gpus}")),
    ];
    options.into_iter().flatten().collect()
}

/// Options of `sbatch` that ask for nodes with a feature, alone.
fn of_class(class: Option<Class<'_>>) -> Vec<String> {
    let Some(Class { name, node }) = class else { return Vec::new() };
    let node = node.map(|node| format!("--nodelist={node}"));
    [Some(format!("--constraint={name}")), Some("--exclusive".to_owned()), node].into_iter().flatten().collect()
}

impl Queue for Slurm {
    fn submit(&self, of: &Submission<'_>) -> Result<Vec<String>, String> {
        let script = of.folder.path().join("array.sh");
        fs::write(&script, format!("#!/bin/sh\n{}\n", of.words("SLURM_ARRAY_TASK_ID")))
            .map_err(|error| format!("cannot write {}: {error}", script.display()))?;
        let mut command = Command::new("sbatch");
        command.args(["--parsable", "--no-requeue", "--open-mode=append", "--job-name", of.name]);
        command.arg(format!("--array=0-{}", of.jobs.saturating_sub(1)));
        // `%` begins a pattern in the names of outputs.
        let log = of.folder.log_of("{number}").display().to_string().replace('%', "%%").replace("{number}", "%a");
        command.arg(format!("--output={log}"));
        command.args(asked(of.resources)).args(of_class(of.class)).args(&of.options);
        let said = ask(command.arg(&script))?;
        // `ID`, or `ID;CLUSTER`; a plug-in may have printed more before.
        let id = said.lines().last().and_then(|line| line.split(';').next()).unwrap_or_default().trim();
        if id.is_empty() || !id.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(format!("`sbatch --parsable` printed no id of a job: {}", said.trim()));
        }
        Ok((0..of.jobs).map(|job| format!("{id}_{job}")).collect())
    }

    fn poll(&self, _: &[&str]) -> Result<HashMap<String, Stage>, String> {
        // Asked for an id that it has forgotten, it fails.
        let said = ask(Command::new("squeue").args(["--me", "--noheader", "--array", "--format=%i %T"]))?;
        let job = |line: &str| {
            let (id, state) = line.trim().split_once(' ')?;
            let waits = ["PENDING", "REQUEUED", "REQUEUE_HOLD", "SPECIAL_EXIT"].contains(&state);
            Some((id.to_owned(), if waits { Stage::Queued } else { Stage::Running }))
        };
        Ok(said.lines().filter_map(job).collect())
    }

    fn reason(&self, id: &str) -> Option<String> {
        // Where there is no accounting, the controller knows it for a few minutes.
        let accounted = ask(Command::new("sacct").args(["-n", "-X", "-P", "-o", "State,ExitCode", "-j", id])).ok();
        let accounted = accounted.and_then(|said| {
            let (state, code) = said.lines().next()?.split_once('|')?;
            Some(format!("{state}, exit code {code}"))
        });
        accounted.or_else(|| {
            let said = ask(Command::new("scontrol").args(["-o", "show", "job", id])).ok()?;
            let field = |name: &str| said.split_whitespace().find_map(|word| word.strip_prefix(name));
            Some(format!("{}, exit code {}", field("JobState=")?, field("ExitCode=")?))
        })
    }

    fn cancel(&self, ids: &[&str]) -> Result<(), String> {
        ids.chunks(MOST_NAMED).try_for_each(|some| ask(Command::new("scancel").args(some)).map(drop))
    }
}
