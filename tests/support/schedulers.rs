//! Schedulers that tests start on this machine: Slurm, where it is installed, and HyperQueue by its Python package.

use std::{
    fs::{self, File},
    io,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};
use tauflow_testing::set;
use tempfile::TempDir;

/// A file of `tests/support`.
fn support(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support").join(name)
}

/// Slurm with one node. It is stopped on drop, and at the end of this process.
pub struct Slurm {
    folder: TempDir,
}

impl Slurm {
    /// Starts it; none if it is not installed.
    pub fn start() -> Option<Self> {
        let there = |program: &str| {
            ["/usr/bin", "/usr/sbin", "/bin", "/sbin"].iter().any(|folder| Path::new(folder).join(program).is_file())
        };
        if !["sbatch", "squeue", "slurmctld", "slurmd", "munged"].iter().all(|program| there(program)) {
            return None;
        }
        let slurm = Self { folder: TempDir::new().expect("a temporary folder") };
        let (started, said) = slurm.act("start").expect("it can be called");
        assert!(started, "{said}");
        Some(slurm)
    }

    /// Whether that succeeded, and what was said. Its daemons must not hold the pipes of the test's output.
    fn act(&self, what: &str) -> io::Result<(bool, String)> {
        let log = self.folder.path().join(format!("{what}.out"));
        let file = File::create(&log)?;
        let mut command = Command::new("sh");
        command.arg(support("slurm.sh")).arg(what).arg(self.folder.path());
        command.arg(std::process::id().to_string());
        let status = command.stdout(file.try_clone()?).stderr(file).stdin(Stdio::null()).status()?;
        Ok((status.success(), fs::read_to_string(&log).unwrap_or_default()))
    }

    /// The variables by which its commands find it.
    pub fn variables(&self) -> Vec<(&'static str, String)> {
        vec![("SLURM_CONF", self.folder.path().join("slurm.conf").display().to_string())]
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        let _ = self.act("stop"); // it also ends with this process
    }
}

/// A server of HyperQueue with a worker of two cores, until it is dropped.
pub struct HyperQueue {
    folder: TempDir,
    serving: Child,
}

impl HyperQueue {
    /// Starts it; none without the package.
    pub fn start() -> Option<Self> {
        let python = set("TAUFLOW_HYPERQUEUE")?;
        let folder = TempDir::new().expect("a temporary folder");
        // In place of the program `hq`, which the package lacks.
        let (program, script) = (folder.path().join("hq"), support("hq.py"));
        fs::write(&program, format!("#!/bin/sh\nexec '{python}' '{}' \"$@\"\n", script.display())).expect("writable");
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("our own");
        let mut serve = Command::new(&program);
        serve.args(["serve", "2"]).env("HQ_SERVER_DIR", folder.path().join("server")).stdin(Stdio::piped());
        let log = folder.path().join("log");
        let file = File::create(&log).expect("writable");
        let serving = serve.stdout(file.try_clone().expect("a file")).stderr(file).spawn().expect("it starts");
        let begun = Instant::now();
        while !fs::read_to_string(&log).is_ok_and(|log| log.lines().any(|line| line == "ready")) {
            assert!(begun.elapsed() < Duration::from_secs(90), "HyperQueue does not serve");
            thread::sleep(Duration::from_millis(20));
        }
        Some(Self { folder, serving })
    }

    /// The variables by which `hq` is found, and finds the server.
    pub fn variables(&self) -> Vec<(&'static str, String)> {
        let at = |name: &str| self.folder.path().join(name).display().to_string();
        let path = format!("{}:{}", at(""), std::env::var("PATH").unwrap_or_default());
        vec![("PATH", path), ("HQ_SERVER_DIR", at("server"))]
    }
}

impl Drop for HyperQueue {
    fn drop(&mut self) {
        drop(self.serving.stdin.take());
        let _ = self.serving.wait(); // it ends when its input does
    }
}
