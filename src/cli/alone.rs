//! The separate process in which `exec` runs an action: its working directory, environment, termination, and sandbox.

use super::{
    CacheAt, CliError, Exit,
    descendants::{self, LOOK, PATIENCE},
    exec_args::ExecArgs,
};
use nix::{
    sys::{
        prctl,
        signal::{Signal, killpg},
    },
    unistd::{Pid, getpgrp},
};
use std::{
    ffi::{OsStr, OsString},
    fs, io,
    io::Read,
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Instant,
};
use tauflow_contract::PROGRAM_VARIABLES;
use tauflow_upstream::Address;
use tempfile::TempDir;

/// What an action is told of the environment: where programs are, and what is in keys. All else stays outside.
fn told() -> impl Iterator<Item = &'static str> {
    PROGRAM_VARIABLES.into_iter().chain(LIBRARIES)
}
/// Those of them that name libraries.
const LIBRARIES: [&str; 2] = ["TAUFLOW_OIDN", "TAUFLOW_ONNXRUNTIME"];
/// The sandbox: no network, no process of others, nothing that can be written. What is to be comes after it. `/run` has
/// the sockets of the system's services, and `/tmp` those of people's programs, which would be ways out.
const SANDBOX: [&str; 20] = [
    "--die-with-parent",
    "--new-session",
    "--unshare-net",
    "--unshare-pid",
    "--unshare-ipc",
    "--ro-bind",
    "/",
    "/",
    "--dev",
    "/dev",
    "--proc",
    "/proc",
    "--tmpfs",
    "/run",
    "--tmpfs",
    "/tmp",
    "--tmpfs",
    "/var/tmp",
    "--cap-drop",
    "ALL",
];

fn failed(what: &str, error: &io::Error) -> CliError {
    CliError::Environment(format!("cannot {what}: {error}"))
}

/// Runs the action in a process of its own, which has an empty folder, little of the environment, and no input. It ends
/// with all that it started, and its folder goes with it.
pub(super) fn alone(args: &ExecArgs, cache: &CacheAt) -> Result<Exit, CliError> {
    let absolute = |path: PathBuf| std::path::absolute(path).map_err(|e| failed("find the current folder", &e));
    let folder = Folder::new()?;
    let file = PathBuf::from(args.action());
    let file = file.is_file().then(|| absolute(file)).transpose()?;
    let action = file.clone().map_or_else(|| args.action().into(), PathBuf::into_os_string);
    let store = absolute(cache.folder())?;
    let upstream = match cache.upstream()? {
        Some(Address::Folder(folder)) => Some(Address::Folder(absolute(folder)?)),
        Some(Address::Objects(_)) if args.sandbox => {
            errln!("note: the sandbox has no network, so the upstream is not used");
            None
        }
        other => other,
    };
    let program = std::env::current_exe().map_err(|e| failed("find this program", &e))?;
    let mut command = match args.sandbox {
        true => {
            // A folder must be there to be let in.
            cache.open()?;
            let libraries = LIBRARIES.map(|name| passed(name).map(PathBuf::from));
            // A library loads what lies beside it.
            let beside = libraries.iter().flatten().filter_map(|library| library.parent());
            let beside = beside.filter(|folder| folder.is_absolute()).map(Some);
            let beside_store = upstream.as_ref().and_then(Address::folder).filter(|folder| folder.is_dir());
            let read = [Some(program.as_path()), file.as_deref(), beside_store].into_iter().chain(beside);
            sandbox(&program, &folder, &store, &read.flatten().collect::<Vec<_>>())?
        }
        false => Command::new(&program),
    };
    command.arg("exec").arg(action).arg("--inside").arg(folder.of("")).arg("--cache").arg(&store);
    command.arg("--upstream").arg(upstream.as_ref().map(Address::to_string).unwrap_or_default());
    command.arg("--upstream-key").arg(cache.upstream_key()?.map(|key| key.to_string()).unwrap_or_default());
    prepare(&mut command, &folder);
    if let Some(Address::Objects(_)) = upstream {
        // Programs of the action do not get them.
        command.envs(std::env::vars_os().filter(|(name, _)| name.to_str().is_some_and(tauflow_upstream::reads)));
    }
    let interrupted = Arc::new(AtomicBool::new(false));
    let seen = interrupted.clone();
    // The group of the action gets no Ctrl-C of ours, so that it is ended here.
    ctrlc::set_handler(move || seen.store(true, Ordering::Relaxed))
        .map_err(|e| CliError::Environment(format!("cannot listen for Ctrl-C: {e}")))?;
    descendants::take_in().map_err(|e| failed("take in what the action leaves", &e))?;
    let child = command.stdout(Stdio::piped()).spawn().map_err(|e| failed("start the action", &e))?;
    let ended = Running::new(child).wait(args.limit, &interrupted)?;
    folder.clear()?;
    Ok(match ended {
        Ended::Limit => {
            errln!("error: the action was stopped at its time limit; nothing was recorded");
            Exit::Failed
        }
        Ended::Interrupted => {
            errln!("stopped; nothing was recorded");
            Exit::Interrupted
        }
        Ended::Itself(status, told) => {
            out!("{told}");
            match status.code() {
                Some(0) => Exit::Done,
                Some(1) => Exit::Failed,
                Some(2) => Exit::Bad,
                Some(130) => Exit::Interrupted,
                Some(_) => Exit::Environment,
                None => {
                    errln!("error: the action's process was killed ({status})");
                    Exit::Failed
                }
            }
        }
    })
}

/// Gives a command the action's folder and environment, and a group of its own.
fn prepare(command: &mut Command, folder: &Folder) {
    command.env_clear().envs(told().filter_map(|name| Some((name, passed(name)?))));
    // Programs leave their temporary files here, and they go with the folder.
    command.env("TMPDIR", folder.of("tmp"));
    command.current_dir(folder.of("work")).process_group(0).stdin(Stdio::null());
}

/// A variable as the action gets it: the path of a library does not depend on the folder.
fn passed(name: &str) -> Option<OsString> {
    let value = std::env::var_os(name).filter(|value| !value.is_empty())?;
    let is_path = LIBRARIES.contains(&name) && value.to_string_lossy().contains('/');
    Some(if is_path { std::path::absolute(&value).map_or(value, PathBuf::into_os_string) } else { value })
}

/// `bwrap` with what it takes, once it is known to work here. What is to be `read` may lie where all else is hidden.
fn sandbox(program: &Path, folder: &Folder, store: &Path, read: &[&Path]) -> Result<Command, CliError> {
    let whole = folder.of("");
    let bare = || {
        let mut command = Command::new("bwrap");
        command.args(SANDBOX);
        for path in read {
            command.arg("--ro-bind").args([path, path]);
        }
        for path in [&whole, store] {
            command.arg("--bind").args([path, path]);
        }
        // Programs of some systems lie there.
        command.args(["--ro-bind-try", "/run/current-system", "/run/current-system"]);
        command.args([OsStr::new("--chdir"), folder.of("work").as_os_str(), OsStr::new("--"), program.as_os_str()]);
        command
    };
    let mut first = bare();
    prepare(first.arg("--version"), folder);
    let refused = |why: &str| {
        CliError::Environment(format!(
            "cannot create a sandbox: {why}; install bubblewrap, enable user namespaces, or omit --sandbox"
        ))
    };
    match first.output() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(refused("the program `bwrap` is not installed")),
        Err(error) => Err(refused(&format!("`bwrap` cannot be started: {error}"))),
        Ok(done) if !done.status.success() => Err(refused(String::from_utf8_lossy(&done.stderr).trim())),
        Ok(_) => Ok(bare()),
    }
}

/// The folder of an action: one to work in, which is empty, and one for temporary files.
struct Folder(TempDir);

impl Folder {
    fn new() -> Result<Self, CliError> {
        let made = || {
            let folder = Self(tempfile::tempdir()?);
            fs::create_dir(folder.of("work"))?;
            fs::create_dir(folder.of("tmp"))?;
            Ok(folder)
        };
        made().map_err(|e| failed("make a folder to run in", &e))
    }

    fn of(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Takes it away, though what was killed may be writing its last.
    fn clear(self) -> Result<(), CliError> {
        let (path, start) = (self.0.keep(), Instant::now());
        loop {
            match fs::remove_dir_all(&path) {
                Ok(()) => return Ok(()),
                Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
                Err(error) if start.elapsed() > PATIENCE => {
                    return Err(failed(&format!("take the action's folder {} away", path.display()), &error));
                }
                Err(_) => thread::sleep(LOOK),
            }
        }
    }
}

/// How an action ended.
enum Ended {
    /// After its time.
    Limit,
    /// By Ctrl-C.
    Interrupted,
    /// By itself, with what it said.
    Itself(ExitStatus, String),
}

/// Has this process, in which an action runs, end with its parent: if whoever started it is killed, nobody waits for it
/// any more, and nobody ends it after its time. All that it started ends then, and its folder goes. `stop` says so.
pub(super) fn end_with_parent(folder: &Path, stop: Arc<AtomicBool>) -> Result<(), CliError> {
    descendants::take_in().map_err(|e| failed("take in what the action leaves", &e))?;
    let folder = folder.to_owned();
    ctrlc::set_handler(move || {
        stop.store(true, Ordering::Relaxed);
        descendants::end();
        // Nothing else than what was made for the action, though the folder is named on the command line.
        for part in ["work", "tmp"] {
            let _ = fs::remove_dir_all(folder.join(part)); // nobody is left to be told
        }
        let _ = fs::remove_dir(&folder);
        // Processes that started in the meantime end with this process.
        let _ = killpg(getpgrp(), Signal::SIGKILL);
    })
    .map_err(|e| CliError::Environment(format!("cannot listen for signals: {e}")))?;
    prctl::set_pdeathsig(Signal::SIGTERM).map_err(|e| failed("listen for the end of its parent", &e.into()))
}

/// A process that leads a group. However it ends, all that it started does.
struct Running {
    child: Child,
    group: Pid,
}

impl Running {
    fn new(child: Child) -> Self {
        // Numbers of processes are below 2^22.
        let group = Pid::from_raw(i32::try_from(child.id()).expect("a process has a small number"));
        Self { child, group }
    }

    fn wait(mut self, limit: Option<f64>, interrupted: &AtomicBool) -> Result<Ended, CliError> {
        let mut stdout = self.child.stdout.take();
        let reader = thread::spawn(move || {
            let mut text = String::new();
            stdout.as_mut().map(|out| out.read_to_string(&mut text)).transpose().map(|_| text)
        });
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().map_err(|e| failed("wait for the action", &e))? {
                break status;
            }
            if limit.is_some_and(|limit| start.elapsed().as_secs_f64() > limit) {
                return Ok(Ended::Limit);
            }
            if interrupted.load(Ordering::Relaxed) {
                return Ok(Ended::Interrupted);
            }
            thread::sleep(LOOK);
        };
        // Remaining child processes may hold its output open.
        drop(self);
        let told = reader.join().ok().and_then(Result::ok).unwrap_or_default();
        Ok(Ended::Itself(status, told))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // None may be left; and what ended just now needs no end. The group at once, then what had left it.
        let _ = killpg(self.group, Signal::SIGKILL);
        let _ = self.child.wait();
        descendants::end();
    }
}
