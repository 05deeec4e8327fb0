//! What the tests of all crates share: whether the slow suites are asked for, and what a test does that cannot run on
//! this machine. It is a dependency of tests alone, and knows no crate of the workspace.
//!
//! A test that cannot run calls [`skip`], which says so on the standard error even where the test harness captures the
//! output. `TAUFLOW_REQUIRE=qemu,bwrap` turns the skips of these [`Need`]s into failures: `.ci/run` sets it for all
//! that it installed, so that a test cannot stop running unnoticed.

mod browser;
mod shared;

pub use browser::Browser;
pub use shared::Shared;

use std::{fmt::Display, io::Write as _};

/// Something that a test needs and that not every machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// The shared assets or reference numbers beside the checkout.
    Shared,
    /// The database of `cargo deny` about vulnerable crates, which `.ci/run` asks.
    Advisories,
    /// A processor with AVX2.
    Avx2,
    /// A processor with AVX-512.
    Avx512,
    /// The shell `bash`.
    Bash,
    /// `bwrap`, and a kernel that lets it make a sandbox.
    Bwrap,
    /// The browser Chromium, which shows pages without a window.
    Chromium,
    /// The program `cargo deny`, which `.ci/run` runs.
    Deny,
    /// The program `mkfifo`.
    Fifo,
    /// The shell `fish`.
    Fish,
    /// A Python with the package `hyperqueue`, named by `TAUFLOW_HYPERQUEUE`.
    HyperQueue,
    /// A kernel with FUSE, and the right to mount such file systems.
    Fuse,
    /// The program `man`.
    Man,
    /// A library of ONNX Runtime, named by `TAUFLOW_ONNXRUNTIME`.
    Onnx,
    /// A Python with the package `moto` and its server, named by `TAUFLOW_MOTO`.
    Moto,
    /// The right to mount a file system in a namespace of its own.
    Mount,
    /// A library of Open Image Denoise, named by `TAUFLOW_OIDN`.
    Oidn,
    /// The program `python3`.
    Python,
    /// `qemu-x86_64`, which emulates other processors.
    Qemu,
    /// The right to become other users.
    Root,
    /// The program `script`, which gives a program a terminal.
    Script,
    /// Slurm, with the daemons of `slurm-wlm` and `munge`, and the right to start them.
    Slurm,
    /// The slow suites, which `TAUFLOW_SLOW=1` asks for.
    Slow,
    /// A Python with PyTorch, named by `TAUFLOW_PYTHON`.
    Torch,
    /// A device with a Vulkan driver, and tests that are built with the feature `gpu`.
    Vulkan,
    /// The shell `zsh`.
    Zsh,
}

impl Need {
    /// All needs with their names in `TAUFLOW_REQUIRE`.
    pub const ALL: [(&'static str, Self); 26] = [
        ("advisories", Self::Advisories),
        ("avx2", Self::Avx2),
        ("avx512", Self::Avx512),
        ("bash", Self::Bash),
        ("bwrap", Self::Bwrap),
        ("chromium", Self::Chromium),
        ("deny", Self::Deny),
        ("fifo", Self::Fifo),
        ("fish", Self::Fish),
        ("fuse", Self::Fuse),
        ("hyperqueue", Self::HyperQueue),
        ("man", Self::Man),
        ("moto", Self::Moto),
        ("mount", Self::Mount),
        ("oidn", Self::Oidn),
        ("onnx", Self::Onnx),
        ("python", Self::Python),
        ("qemu", Self::Qemu),
        ("root", Self::Root),
        ("script", Self::Script),
        ("shared", Self::Shared),
        ("slow", Self::Slow),
        ("slurm", Self::Slurm),
        ("torch", Self::Torch),
        ("vulkan", Self::Vulkan),
        ("zsh", Self::Zsh),
    ];

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, need)| *need == self).expect("every need is in the table").0
    }
}

/// The needs that a list of names requires.
///
/// # Errors
/// If a name is unknown.
fn required(list: &str) -> Result<Vec<Need>, String> {
    let names = list.split(',').map(str::trim).filter(|name| !name.is_empty());
    let need = |name: &str| {
        let known = Need::ALL.iter().find(|(known, _)| *known == name).map(|(_, need)| *need);
        known.ok_or_else(|| {
            let all = Need::ALL.map(|(known, _)| known).join(", ");
            format!("unknown name `{name}` in TAUFLOW_REQUIRE; choose from {all}")
        })
    };
    names.map(need).collect()
}

/// The value of an environment variable that is set and not empty.
pub fn set(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|value| !value.is_empty())
}

/// Whether the slow suites are asked for: `TAUFLOW_SLOW` is set and not empty.
pub fn slow() -> bool {
    set("TAUFLOW_SLOW").is_some()
}

/// Says on the standard error that a test, or a part of one, does not run here. The caller returns after it.
///
/// # Panics
/// If `TAUFLOW_REQUIRE` names the need, or a name that is none.
pub fn skip(need: Need, why: impl Display) {
    let required = required(&set("TAUFLOW_REQUIRE").unwrap_or_default()).unwrap_or_else(|error| panic!("{error}"));
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    assert!(!required.contains(&need), "{test} must run, as TAUFLOW_REQUIRE names `{}`: {why}", need.name());
    // The harness captures what `print!` and its kin write, and shows it for failures alone.
    let _ = writeln!(std::io::stderr(), "skipped: {test} ({}): {why}", need.name());
}

/// For a test that goes through the sets of vector instructions of this processor: says of those that it lacks that
/// they are left out. `available` are the names of those that it has.
///
/// # Panics
/// As [`skip`].
pub fn skip_missing_instructions<'a>(available: impl IntoIterator<Item = &'a str>) {
    let available: Vec<&str> = available.into_iter().collect();
    for (name, need) in [("avx2", Need::Avx2), ("avx512", Need::Avx512)] {
        if !available.contains(&name) {
            skip(need, format_args!("the part with {name}, which this processor lacks"));
        }
    }
}

/// Does a part of a long test, and says on the standard error what it took if that was a second or more.
pub fn part<T>(name: &str, work: impl FnOnce() -> T) -> T {
    let start = std::time::Instant::now();
    let done = work();
    let took = start.elapsed().as_secs_f64();
    if took >= 1.0 {
        let _ = writeln!(std::io::stderr(), "part: {name} {took:.1} s");
    }
    done
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requirements_are_names_of_needs() {
        assert_eq!(required("").as_deref(), Ok(&[][..]));
        assert_eq!(required(" qemu, bwrap,").as_deref(), Ok(&[Need::Qemu, Need::Bwrap][..]));
        let error = required("qemu,oidm").expect_err("unknown");
        assert!(error.contains("`oidm`") && error.contains("oidn"), "{error}");
        for (name, need) in Need::ALL {
            assert_eq!((need.name(), required(name).as_deref()), (name, Ok(&[need][..])));
        }
    }

    /// Holds a misspelt name even where nothing is skipped.
    #[test]
    fn what_is_required_now_is_known() {
        let now = required(&set("TAUFLOW_REQUIRE").unwrap_or_default());
        assert!(now.is_ok(), "{now:?}");
    }

    #[test]
    fn missing_instructions_are_told_and_fail_where_they_are_required() {
        const CHILD: &str = "TAUFLOW_TESTING_INSTRUCTIONS";
        if set(CHILD).is_some() {
            skip_missing_instructions(["portable", "sse2", "avx2"]);
            return;
        }
        let run = |required: &str| {
            let test = "tests::missing_instructions_are_told_and_fail_where_they_are_required";
            let mut child = std::process::Command::new(std::env::current_exe().expect("this program"));
            child.args(["--exact", test]).env(CHILD, "1").env("TAUFLOW_REQUIRE", required);
            child.output().expect("it starts")
        };
        let told = run("avx2");
        let text = String::from_utf8_lossy(&told.stderr).into_owned();
        assert!(told.status.success() && text.contains("(avx512): the part with avx512"), "{text}");
        assert!(!text.contains("(avx2)"), "{text}");
        assert!(!run("avx512").status.success());
    }

    #[test]
    fn a_skip_fails_where_it_is_required_and_only_there() {
        const CHILD: &str = "TAUFLOW_TESTING_CHILD";
        if set(CHILD).is_some() {
            skip(Need::Qemu, "it is not there");
            return;
        }
        let run = |required: &str| {
            let mut child = std::process::Command::new(std::env::current_exe().expect("this program"));
            child.args(["--exact", "tests::a_skip_fails_where_it_is_required_and_only_there"]);
            let child = child.env(CHILD, "1").env("TAUFLOW_REQUIRE", required).output().expect("it starts");
            (child.status.success(), String::from_utf8_lossy(&child.stderr).into_owned())
        };
        for required in ["", "bwrap"] {
            let (passed, told) = run(required);
            assert!(passed && told.contains("skipped: tests::a_skip") && told.contains("(qemu): it is not"), "{told}");
        }
        for required in ["bwrap,qemu", "qemuu"] {
            assert!(!run(required).0, "{required}");
        }
    }
}
