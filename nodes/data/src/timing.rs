//! Times as kinds measure them: repeated, taking turns, on a machine with a name. Only measured ports may hold them.

use nix::{
    sys::{
        resource::{UsageWho, getrusage},
        time::TimeVal,
    },
    time::{ClockId, clock_gettime},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use tauflow_contract::{Digest, Probe};
use tauflow_instructions::Instructions;

/// The machine on which times depend: the processor, its number of cores, and the system.
///
/// It is part of the keys of measurements, so that those of two machines are never mixed. The system's own identity is
/// part of it, as a digest: `/etc/machine-id`, or the name of the host. Clones of a system share the former, and cannot
/// be told apart by it. Virtual machines hide the processor's full name; its family, model, stepping and cache stand
/// beside it, and the widest vectors that kernels use.
pub fn machine() -> Value {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let told = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    describe(&told, cores, &std::env::var("RAYON_NUM_THREADS").unwrap_or_default(), &name_of_system())
}

/// The machine that enters the keys of times: that of the probe, if a run measures on another than this one.
pub fn measuring(probe: &dyn Probe) -> Value {
    probe.machine().unwrap_or_else(machine)
}

/// A machine for people, such as `AMD EPYC 7763, 2 cores, id 0123abcd`; none if it is unknown.
pub fn named(machine: &Value) -> Option<String> {
    let processor = machine.get("processor")?.as_str()?;
    let cores = machine.get("cores").and_then(Value::as_u64).unwrap_or(0);
    let cores = if cores == 1 { "1 core".to_owned() } else { format!("{cores} cores") };
    let identity: String =
        machine.get("identity").and_then(Value::as_str).unwrap_or("unknown").chars().take(8).collect();
    Some(format!("{processor}, {cores}, id {identity}"))
}

/// The same of a machine with this `/proc/cpuinfo`, so many cores, a limit of threads, and a system of this name.
fn describe(told: &str, cores: usize, threads: &str, system: &str) -> Value {
    json!({
        "processor": field(told, "model name"),
        "type": kind_of_processor(told),
        // Fewer than it has are another machine, and so are fewer threads than cores.
        "instructions": Instructions::best().name(),
        "cores": cores,
        "threads": threads,
        "system": format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
        // Only a digest leaves the machine.
        "identity": Digest::of(system.as_bytes()).hex()[..16],
    })
}

/// What tells this system from others of its make; nothing where it has neither identity nor name.
fn name_of_system() -> String {
    let read = |path: &str| std::fs::read_to_string(path).ok().filter(|told| !told.trim().is_empty());
    let told = read("/etc/machine-id").or_else(|| read("/proc/sys/kernel/hostname")).unwrap_or_default();
    told.trim().to_owned()
}

/// A field of the first processor that `/proc/cpuinfo` lists.
fn field<'a>(told: &'a str, name: &str) -> &'a str {
    let fields = told.lines().filter_map(|line| line.split_once(':'));
    fields.into_iter().find(|(key, _)| key.trim() == name).map_or("unknown", |(_, value)| value.trim())
}

/// Family, model and stepping, and the size of the last cache that is told of.
fn kind_of_processor(told: &str) -> String {
    let [family, model, stepping, cache] =
        ["cpu family", "model", "stepping", "cache size"].map(|name| field(told, name));
    format!("family {family}, model {model}, stepping {stepping}, cache {cache}")
}

/// The times of one method, per repeat, in seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Repeated {
    /// On the wall's clock.
    pub wall_s: Vec<f64>,
    /// CPU time of all threads of the process, and of its commands.
    pub cpu_s: Vec<f64>,
}

impl Repeated {
    /// Does something, and notes what it took.
    #[expect(clippy::disallowed_methods, reason = "this is where times are measured")]
    pub fn add<T>(&mut self, f: impl FnOnce() -> T) -> T {
        let (wall, cpu) = (Instant::now(), cpu_seconds());
        let out = f();
        self.cpu_s.push(cpu_seconds() - cpu);
        self.wall_s.push(wall.elapsed().as_secs_f64());
        out
    }
}

/// Processor time so far of this process and of the commands that it has waited for.
fn cpu_seconds() -> f64 {
    let own = clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID).map_or(Duration::ZERO, Duration::from);
    own.as_secs_f64() + commands_cpu_seconds()
}

/// Processor time so far of the commands that this process has waited for, in user and kernel mode.
pub fn commands_cpu_seconds() -> f64 {
    let seconds = |time: TimeVal| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6;
    getrusage(UsageWho::RUSAGE_CHILDREN).map_or(0.0, |used| seconds(used.user_time()) + seconds(used.system_time()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Set in the process that measures itself: other tests of this program take processor time, too.
    const ALONE: &str = "TAUFLOW_TIMING_ALONE";

    #[test]
    fn work_takes_processor_time_and_sleep_takes_none() {
        if std::env::var_os(ALONE).is_none() {
            let test = "timing::tests::work_takes_processor_time_and_sleep_takes_none";
            let mut child = std::process::Command::new(std::env::current_exe().expect("this program"));
            let child = child.args(["--exact", test]).env(ALONE, "1").output().expect("it starts");
            let told = String::from_utf8_lossy(&child.stdout);
            assert!(child.status.success() && told.contains("1 passed"), "{told}");
            return;
        }
        let mut took = Repeated::default();
        took.add(|| std::thread::sleep(Duration::from_millis(100)));
        let mut sum = 0u64;
        took.add(|| (0..50_000_000u64).for_each(|i| sum = std::hint::black_box(sum ^ i)));
        // A clock of the wall in place of the processor's would have both equal.
        assert!(took.wall_s[0] >= 0.1 && took.cpu_s[0] < 0.5 * took.wall_s[0], "{took:?}");
        assert!(took.cpu_s[1] > took.cpu_s[0] && took.wall_s[1] > 0.0, "{took:?}");
    }

    #[test]
    fn the_processor_time_of_commands_counts() {
        let mut took = Repeated::default();
        let before = commands_cpu_seconds();
        // The shell tells what it took itself, such as `0m0.120s 0m0.000s`.
        let work = "i=0; while [ $i -lt 200000 ]; do i=$((i+1)); done; times";
        let done = took.add(|| std::process::Command::new("sh").args(["-c", work]).output()).expect("a shell");
        let spent = commands_cpu_seconds() - before;
        let told = String::from_utf8_lossy(&done.stdout).into_owned();
        let seconds = |time: &str| -> Option<f64> {
            let (minutes, seconds) = time.strip_suffix('s')?.split_once('m')?;
            Some(60.0 * minutes.parse::<f64>().ok()? + seconds.parse::<f64>().ok()?)
        };
        let told: f64 = told.split_whitespace().take(2).map(|time| seconds(time).expect("a time")).sum();
        // The shell rounds to a hundredth of a second, for user and kernel mode each.
        assert!(told > 0.0 && spent >= told - 0.02 && took.cpu_s[0] >= spent, "{told} {spent} {took:?}");
    }

    #[test]
    fn processors_of_one_name_are_told_apart() {
        let told = "processor\t: 0\ncpu family\t: 25\nmodel\t\t: 1\nmodel name\t: AMD EPYC\nstepping\t: 1\n\
                    cache size\t: 512 KB\n\nprocessor\t: 1\nmodel\t\t: 17\n";
        assert_eq!(field(told, "model name"), "AMD EPYC");
        assert_eq!(kind_of_processor(told), "family 25, model 1, stepping 1, cache 512 KB");
        assert_ne!(kind_of_processor(told), kind_of_processor(&told.replace("stepping\t: 1", "stepping\t: 2")));
        assert!(kind_of_processor("").starts_with("family unknown"));
    }

    fn identity(machine: &Value) -> &str {
        machine["identity"].as_str().expect("a text")
    }

    #[test]
    fn a_machine_is_another_one_where_anything_differs() {
        let told = "cpu family\t: 25\nmodel\t\t: 1\nmodel name\t: AMD EPYC\n";
        let one = describe(told, 8, "", "0123");
        let others = [
            describe(&told.replace("EPYC", "Ryzen"), 8, "", "0123"),
            describe(&told.replace("25", "26"), 8, "", "0123"),
            describe(told, 4, "", "0123"),
            describe(told, 8, "4", "0123"),
            describe(told, 8, "", "4567"),
        ];
        for (i, other) in others.iter().enumerate() {
            assert!(*other != one && !others[..i].contains(other), "{i}: {other}");
        }
        assert!(one["identity"].as_str().is_some_and(|digest| digest.len() == 16 && !digest.contains("0123")));
        assert_eq!(named(&one).as_deref(), Some(format!("AMD EPYC, 8 cores, id {}", &identity(&one)[..8]).as_str()));
        assert_eq!(named(&Value::Null), None);
        // The machine of this test, in the same fields.
        let here = machine();
        assert!(here.as_object().expect("fields").keys().eq(one.as_object().expect("fields").keys()), "{here}");
    }
}
