//! Running a program within limits: how long it may take, how much memory it may have, and what it said at last.
//!
//! Knows nothing of kinds. Only system calls are made between fork and exec.
#![expect(unsafe_code, reason = "limits are set between fork and exec")]

use crate::trace::{Listener, Notes};
use nix::{
    sys::{
        resource::{Resource, setrlimit},
        signal::{Signal, killpg},
    },
    unistd::Pid,
};
use std::{
    collections::BTreeMap,
    ffi::OsString,
    io::{self, Read},
    os::unix::process::CommandExt,
    path::Path,
    process::{Child, Command, ExitStatus, Output, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};
use tauflow_contract::{Context, KindError, PROGRAM_VARIABLES, Seen};
use tauflow_data::timing::commands_cpu_seconds;

/// Most bytes of the standard error that are kept: the last ones.
const KEPT: usize = 16 << 10;
/// Most lines of it that an error repeats.
const LINES: usize = 8;
/// Most bytes of an answer.
const MOST_ANSWER: usize = 1 << 20;
/// After the end of a program, its pipes are read until nothing has come for so long: a process that left its group may
/// hold them open for ever.
const SILENCE: Duration = Duration::from_millis(500);

/// Variables that are the same for all programs. Python trusts bytecode of a source that was edited within the same
/// second, so it writes none.
const FIXED: [(&str, &str); 4] =
    [("LC_ALL", "C.UTF-8"), ("TZ", "UTC"), ("PYTHONDONTWRITEBYTECODE", "1"), ("PYTHONHASHSEED", "0")];

/// The variables that a program gets: those of [`PROGRAM_VARIABLES`], those that a node names, and the fixed ones.
fn variables(named: &[String]) -> BTreeMap<String, OsString> {
    let fixed = FIXED.iter().map(|(name, value)| ((*name).to_owned(), OsString::from(value)));
    fixed.chain(passed(named)).collect()
}

fn passed(named: &[String]) -> impl Iterator<Item = (String, OsString)> {
    let names = PROGRAM_VARIABLES.iter().copied().chain(named.iter().map(String::as_str));
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    names.filter_map(move |name| Some((name.to_owned(), set(name)?)))
}

/// The variables that a program gets, for keys: as digests, because a value may be a secret.
pub(crate) fn keyed_variables(named: &[String]) -> BTreeMap<String, String> {
    let digest = |value: OsString| blake3::hash(value.as_encoded_bytes()).to_hex()[..32].to_owned();
    passed(named).map(|(name, value)| (name, digest(value))).collect()
}

/// A program to run, with all that it starts.
pub(crate) struct Launch<'a> {
    /// The program and its arguments.
    pub(crate) words: &'a [String],
    /// Its working folder; none for that of this process.
    pub(crate) folder: Option<&'a Path>,
    /// Its folder for temporary files.
    pub(crate) temporary: &'a Path,
    /// The folder of everything that is made for it, which holds none of its inputs.
    pub(crate) own: &'a Path,
    /// Names of environment variables that it gets beside the usual ones.
    pub(crate) variables: &'a [String],
    /// The files that it looks at are noted.
    pub(crate) trace: bool,
    /// Most wall time; none for no limit.
    pub(crate) time: Option<Duration>,
    /// Most bytes of address space of each of its processes.
    pub(crate) memory: Option<u64>,
}

/// How a program ended.
pub(crate) enum Ended {
    /// It could not be started.
    Not(io::Error),
    /// It was ended because it took too long.
    Late(String),
    /// By itself. The text is the last that it wrote to standard error.
    Itself(ExitStatus, String),
}

/// A program that has run.
pub(crate) struct Ran {
    /// How it ended.
    pub(crate) ended: Ended,
    /// Seconds of wall and processor time. The latter are right where no other command ends meanwhile.
    pub(crate) seconds: [f64; 2],
    /// What it looked at among files, if that was noted.
    pub(crate) seen: Option<Seen>,
}

impl Ran {
    /// The last lines of the program, as the end of a message.
    pub(crate) fn tail(&self) -> String {
        match &self.ended {
            Ended::Not(_) => String::new(),
            Ended::Late(told) | Ended::Itself(_, told) => tail(told),
        }
    }

    fn not(error: io::Error) -> Self {
        Self { ended: Ended::Not(error), seconds: [0.0; 2], seen: None }
    }
}

impl Launch<'_> {
    /// Runs the program to its end, and ends what it left running.
    ///
    /// # Errors
    /// If the run is being stopped.
    #[expect(clippy::disallowed_methods, reason = "a limit of wall time, and times for ports that are measurements")]
    pub(crate) fn run(&self, ctx: &Context<'_>) -> Result<Ran, KindError> {
        let Some((program, arguments)) = self.words.split_first() else {
            return Ok(Ran::not(io::Error::other("there is no command")));
        };
        let mut command = Command::new(program);
        command.args(arguments).env_clear().envs(variables(self.variables)).env("TMPDIR", self.temporary);
        if let Some(folder) = self.folder {
            command.current_dir(folder);
        }
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).process_group(0);
        let memory = self.memory;
        let limit = move || {
            if let Some(bytes) = memory {
                setrlimit(Resource::RLIMIT_AS, bytes, bytes)?;
            }
            #[cfg(target_os = "linux")]
            nix::sys::prctl::set_pdeathsig(Signal::SIGKILL)?;
            Ok(())
        };
        // SAFETY: the closure makes two system calls of numbers, and allocates nothing.
        unsafe { command.pre_exec(limit) };
        let listener = match self.trace {
            true => {
                let own = [Some(self.own.to_owned()), self.own.canonicalize().ok()];
                match Listener::attach(&mut command, Notes::beside(own.into_iter().flatten())) {
                    Ok(listener) => Some(listener),
                    Err(error) => return Ok(Ran::not(error)),
                }
            }
            false => None,
        };
        let (started, spent) = (Instant::now(), commands_cpu_seconds());
        let mut child = match command.spawn() {
            Ok(child) => child,
            Err(error) => {
                listener.map(Listener::end);
                return Ok(Ran::not(error));
            }
        };
        let said = Said::of(&mut child);
        let mut late = false;
        let ended = loop {
            match child.try_wait() {
                Ok(Some(status)) => break Ok(status),
                Ok(None) => {}
                Err(error) => break Err(KindError::Environment(format!("cannot wait for a program: {error}"))),
            }
            if let Err(stopped) = ctx.check_cancelled() {
                break Err(stopped);
            }
            if self.time.is_some_and(|most| started.elapsed() > most) {
                late = true;
                end(&mut child);
                break child.wait().map_err(|e| KindError::Environment(format!("cannot wait for a program: {e}")));
            }
            thread::sleep(Duration::from_millis(if started.elapsed().as_secs() == 0 { 1 } else { 10 }));
        };
        let seconds = [started.elapsed().as_secs_f64(), commands_cpu_seconds() - spent];
        end(&mut child);
        let seen = listener.map(|listener| listener.end().seen());
        let text = said.text();
        let ended = if late { Ended::Late(text) } else { Ended::Itself(ended?, text) };
        Ok(Ran { ended, seconds, seen })
    }
}

/// Runs a program that prints an answer, and returns its output. If it takes longer than `most`, it is ended, and there
/// is none.
///
/// # Errors
/// If it cannot be started, or not be waited for, or prints more than a MiB.
#[expect(clippy::disallowed_methods, reason = "a limit of wall time")]
pub(crate) fn answer(program: &str, arguments: &[String], most: Duration) -> io::Result<Option<Output>> {
    let mut command = Command::new(program);
    command.args(arguments).env_clear().envs(variables(&[])).stdin(Stdio::null()).process_group(0);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    // One byte more than the limit shows that an answer is too long.
    let said = Said::by(child.stdout.take(), Keep::First(MOST_ANSWER + 1));
    let told = Said::of(&mut child);
    let started = Instant::now();
    let ended = loop {
        match child.try_wait() {
            Ok(None) if started.elapsed() <= most => thread::sleep(Duration::from_millis(2)),
            Ok(ended) => break Ok(ended),
            Err(error) => break Err(error),
        }
    };
    end(&mut child);
    let (ended, stdout, stderr) = (ended?, said.bytes(), told.bytes());
    if stdout.len() > MOST_ANSWER {
        return Err(io::Error::other(format!("it prints more than {MOST_ANSWER} bytes")));
    }
    Ok(ended.map(|status| Output { status, stdout, stderr }))
}

/// Ends a program with its group. Both may have ended.
fn end(child: &mut Child) {
    if let Ok(id) = i32::try_from(child.id()) {
        let _ = killpg(Pid::from_raw(id), Signal::SIGKILL);
    }
    let _ = child.kill();
    let _ = child.wait();
}

/// Which bytes of a pipe are kept, at most so many; the others are read, too, so that the program can go on.
#[derive(Clone, Copy)]
enum Keep {
    First(usize),
    Last(usize),
}

/// The output of a program to a pipe.
struct Said {
    /// The bytes that are kept, and the number of all bytes so far.
    text: Arc<Mutex<(Vec<u8>, u64)>>,
    reader: Option<thread::JoinHandle<()>>,
}

impl Said {
    /// The last that it writes to standard error.
    fn of(child: &mut Child) -> Self {
        Self::by(child.stderr.take(), Keep::Last(KEPT))
    }

    fn by(pipe: Option<impl Read + Send + 'static>, keep: Keep) -> Self {
        let text = Arc::new(Mutex::new((Vec::new(), 0)));
        let into = text.clone();
        let reader = pipe.map(|mut from| {
            thread::spawn(move || {
                let mut piece = [0; 4096];
                while let Ok(count @ 1..) = from.read(&mut piece) {
                    let mut text = into.lock().unwrap_or_else(PoisonError::into_inner);
                    let (kept, come) = &mut *text;
                    *come += count as u64;
                    match keep {
                        Keep::First(most) => {
                            let room = most.saturating_sub(kept.len());
                            kept.extend_from_slice(&piece[..count.min(room)]);
                        }
                        Keep::Last(most) => {
                            kept.extend_from_slice(&piece[..count]);
                            let over = kept.len().saturating_sub(most);
                            kept.drain(..over);
                        }
                    }
                }
            })
        });
        Self { text, reader }
    }

    fn come(&self) -> u64 {
        self.text.lock().unwrap_or_else(PoisonError::into_inner).1
    }

    /// The bytes that are kept, after the end of the program.
    #[expect(clippy::disallowed_methods, reason = "a limit of wall time")]
    fn bytes(self) -> Vec<u8> {
        let begun = Instant::now();
        let (mut last, mut since) = (self.come(), begun);
        let waits = |since: Instant| since.elapsed() < SILENCE && begun.elapsed() < 10 * SILENCE;
        while self.reader.as_ref().is_some_and(|reader| !reader.is_finished()) && waits(since) {
            thread::sleep(Duration::from_millis(1));
            let come = self.come();
            if come != last {
                (last, since) = (come, Instant::now());
            }
        }
        std::mem::take(&mut self.text.lock().unwrap_or_else(PoisonError::into_inner).0)
    }

    /// The last lines.
    fn text(self) -> String {
        last_lines(&String::from_utf8_lossy(&self.bytes()))
    }
}

/// The end of a message: the last lines of a program.
pub(crate) fn tail(told: &str) -> String {
    match told.is_empty() {
        true => "; it wrote nothing to standard error".to_owned(),
        false => format!("; its standard error ends with:\n{told}"),
    }
}

fn last_lines(text: &str) -> String {
    let lines: Vec<&str> = text.trim_end().lines().collect();
    let last = lines[lines.len().saturating_sub(LINES)..].join("\n");
    // A message is printed on terminals, which would obey escape sequences in it.
    last.replace(|c: char| c.is_control() && !matches!(c, '\n' | '\t'), "\u{fffd}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_is_answered_within_its_time() {
        let ask = |script: &str, most| {
            answer("sh", &["-c".to_owned(), script.to_owned()], Duration::from_millis(most)).expect("it starts")
        };
        let said = ask("echo 1.2; echo no >&2; exit 4", 20_000).expect("in time");
        assert_eq!((said.stdout, said.stderr, said.status.code()), (b"1.2\n".to_vec(), b"no\n".to_vec(), Some(4)));
        assert!(ask("sleep 600 & sleep 600", 50).is_none());
        // Long answers come whole, and one that a process of another group may go on with comes at once.
        let long = ask("seq 1 20000", 20_000).expect("in time");
        assert!(long.status.success() && long.stdout.ends_with(b"\n20000\n"), "{}", long.stdout.len());
        #[expect(clippy::disallowed_methods, reason = "a limit of wall time")]
        let begun = Instant::now();
        assert_eq!(ask("setsid sleep 20 & echo 1", 20_000).expect("in time").stdout, b"1\n");
        assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
        let endless = answer("sh", &["-c".to_owned(), "seq 1 1000000".to_owned()], Duration::from_secs(20));
        assert!(endless.expect_err("too long").to_string().contains("more than 1048576 bytes"));
        assert!(answer("/no/such/program", &[], Duration::from_secs(1)).is_err());
    }

    #[test]
    fn the_last_lines_are_the_last() {
        let text: String = (0..20).map(|line| format!("{line}\n")).collect();
        assert_eq!(last_lines(&text).lines().collect::<Vec<_>>(), ["12", "13", "14", "15", "16", "17", "18", "19"]);
        assert_eq!(last_lines(""), "");
        assert_eq!(last_lines("\u{1b}[31mred\u{7}\n\tplain"), "\u{fffd}[31mred\u{fffd}\n\tplain");
    }
}
