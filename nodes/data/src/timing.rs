//! Times as kinds measure them: repeated, taking turns, on a machine with a name. Nothing but measured ports may hold them.

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::time::Instant;

/// What times depend on beside the work: the processor, how many of its cores there are, and the system. Part of the keys of
/// measurements, so that those of two machines are never mixed.
pub fn machine() -> Value {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let system = format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS);
    json!({ "processor": processor(), "cores": cores, "system": system })
}

/// The processor's name, as the system has it.
fn processor() -> String {
    let told = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let named = told.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    named.map_or_else(|| "unknown".to_owned(), |(_, name)| name.trim().to_owned())
}

/// What one thing took, each time it was done, in seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Repeated {
    /// On the wall's clock.
    pub wall_s: Vec<f64>,
    /// Of all threads of the process together; of a command, its whole wall time again.
    pub cpu_s: Vec<f64>,
}

impl Repeated {
    /// Does something, and notes what it took.
    pub fn add<T>(&mut self, f: impl FnOnce() -> T) -> T {
        let (wall, cpu) = (Instant::now(), cpu_seconds());
        let out = f();
        self.cpu_s.push(cpu_seconds() - cpu);
        self.wall_s.push(wall.elapsed().as_secs_f64());
        out
    }
}

/// Processor time of this process so far.
fn cpu_seconds() -> f64 {
    let spent = clock_gettime(ClockId::ProcessCPUTime);
    spent.tv_sec as f64 + spent.tv_nsec as f64 * 1e-9
}

/// The times of a scene's images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// What was timed.
    pub entries: Vec<TimedImage>,
}

/// How long one image took to make, from the endpoint it starts from; or, of a path tracer, from nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimedImage {
    /// Which method made it, e.g. `mc_noise`.
    pub method: String,
    /// Sample count of the endpoint it starts from; of a path tracer, its own.
    pub from_spp: u64,
    /// Model calls; 0 for a path tracer.
    pub nfe: u64,
    /// The times.
    pub took: Repeated,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_time_and_sleep_no_processor() {
        let mut took = Repeated::default();
        took.add(|| std::thread::sleep(std::time::Duration::from_millis(30)));
        let mut sum = 0u64;
        took.add(|| (0..20_000_000u64).for_each(|i| sum = std::hint::black_box(sum ^ i)));
        assert!(took.wall_s[0] >= 0.03 && took.wall_s[1] > 0.0 && took.cpu_s[1] > 0.0, "{took:?}");
    }

    #[test]
    fn a_machine_has_a_name_that_does_not_change() {
        assert_eq!(machine(), machine());
        assert!(machine()["cores"].as_u64().is_some_and(|n| n >= 1));
    }
}
