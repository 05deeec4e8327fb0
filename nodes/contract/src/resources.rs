//! Resources that an action asks a scheduler for. They decide where and when it runs, and never what it makes: no key
//! contains them.

use std::fmt;

/// Resources of one action. A scheduler decides about resources that are not given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Resources {
    /// Processor cores.
    pub cores: Option<u32>,
    /// Bytes of memory.
    pub memory: Option<u64>,
    /// The longest time that it may take, in seconds.
    pub time: Option<u64>,
    /// GPUs.
    pub gpus: Option<u32>,
}

impl Resources {
    /// Sets the number of cores.
    pub const fn cores(self, cores: u32) -> Self {
        Self { cores: Some(cores), ..self }
    }

    /// Sets the memory in bytes.
    pub const fn memory(self, bytes: u64) -> Self {
        Self { memory: Some(bytes), ..self }
    }

    /// Sets the time limit in seconds, rounded up.
    pub fn time(self, seconds: f64) -> Self {
        Self { time: Some(seconds.max(1.0).ceil() as u64), ..self }
    }

    /// Sets the number of GPUs.
    pub const fn gpus(self, gpus: u32) -> Self {
        Self { gpus: Some(gpus), ..self }
    }

    /// Memory in MiB, rounded up.
    pub fn memory_mib(self) -> Option<u64> {
        self.memory.map(|bytes| bytes.div_ceil(1 << 20))
    }
}

impl fmt::Display for Resources {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted = |count: u32, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
        let memory = |bytes: u64| match bytes.div_ceil(1 << 20) {
            mib if mib >= 1024 => format!("{} GiB", (mib as f64 / 102.4).round() / 10.0),
            mib => format!("{mib} MiB"),
        };
        let time = |seconds: u64| match seconds {
            0..120 => format!("{seconds} s"),
            120..7200 => format!("{} min", seconds.div_ceil(60)),
            _ => format!("{} h", (seconds as f64 / 360.0).round() / 10.0),
        };
        let parts = [
            self.cores.map(|cores| counted(cores, "core")),
            self.memory.map(memory),
            self.time.map(time),
            self.gpus.filter(|gpus| *gpus > 0).map(|gpus| counted(gpus, "GPU")),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        f.write_str(&parts.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resources_are_shown_in_units_for_people() {
        let all = Resources::default().cores(4).memory(8 << 30).time(7200.0).gpus(1);
        assert_eq!(all.to_string(), "4 cores, 8 GiB, 2 h, 1 GPU");
        let small = Resources::default().cores(1).memory((3 << 20) + 1).time(89.2).gpus(0);
        assert_eq!(small.to_string(), "1 core, 4 MiB, 90 s");
        assert_eq!(small.memory_mib(), Some(4));
        assert_eq!(Resources::default().time(3600.0).to_string(), "60 min");
        assert_eq!(Resources::default().to_string(), "");
    }
}
