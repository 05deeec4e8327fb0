//! The descendants of this process: all processes that an action started, directly or indirectly.
//!
//! Killing the process group is not enough, because a process can leave it. No process leaves the tree of parents,
//! because this process adopts orphans.

use nix::{
    sys::{
        prctl,
        signal::{Signal, kill},
    },
    unistd::{Pid, getpid},
};
use std::{
    collections::BTreeMap,
    fs, io, thread,
    time::{Duration, Instant},
};

/// Time for processes that were killed to be gone, and for their folder to be empty.
pub(super) const PATIENCE: Duration = Duration::from_secs(2);
/// Time between two looks.
pub(super) const LOOK: Duration = Duration::from_millis(5);

/// From here on, what is below this process stays below it, whichever parent of it ends.
pub(super) fn take_in() -> io::Result<()> {
    Ok(prctl::set_child_subreaper(true)?)
}

/// Ends all processes below this one.
pub(super) fn end() {
    let start = Instant::now();
    loop {
        let found = below(getpid());
        if found.is_empty() || start.elapsed() > PATIENCE {
            return;
        }
        for process in found {
            let _ = kill(process, Signal::SIGKILL); // gone meanwhile: as good
        }
        thread::sleep(LOOK);
    }
}

/// The processes below one that are not dead.
fn below(top: Pid) -> Vec<Pid> {
    let mut children: BTreeMap<Pid, Vec<(Pid, bool)>> = BTreeMap::new();
    // Processes that end in the meantime are skipped, and new ones are found by the next scan.
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(process) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let told = fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        if let Some((parent, lives)) = parse(&told) {
            children.entry(parent).or_default().push((Pid::from_raw(process), lives));
        }
    }
    let (mut found, mut open) = (Vec::new(), vec![top]);
    while let Some(parent) = open.pop() {
        for (process, lives) in children.remove(&parent).unwrap_or_default() {
            open.push(process);
            if lives {
                found.push(process);
            }
        }
    }
    found
}

/// The parent in a process's `stat`, and whether it lives: a dead one stays listed until its parent has asked for it.
fn parse(stat: &str) -> Option<(Pid, bool)> {
    // The name of the program stands in brackets, and may hold any others.
    let (_, rest) = stat.rsplit_once(") ")?;
    let mut fields = rest.split(' ');
    let state = fields.next()?;
    Some((Pid::from_raw(fields.next()?.parse().ok()?), !matches!(state, "Z" | "X")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    fn names_of_programs_may_hold_anything() {
        assert_eq!(parse("17 (a) Z 1 (b)) S 4 17 17 0"), Some((Pid::from_raw(4), true)));
        assert_eq!(parse("17 (sh) Z 4 17"), Some((Pid::from_raw(4), false)));
        assert_eq!((parse(""), parse("17 (sh) S"), parse("17 (sh) S x")), (None, None, None));
    }

    #[test]
    fn children_of_children_are_found_and_the_dead_are_not() {
        let mut child = Command::new("sh").args(["-c", "sleep 60 & wait"]).spawn().expect("sh starts");
        let own = Pid::from_raw(i32::try_from(child.id()).expect("a small number"));
        let start = Instant::now();
        let sleeper = loop {
            match below(own)[..] {
                [sleeper] => break sleeper,
                _ => assert!(start.elapsed() < Duration::from_secs(60), "sh starts sleep"),
            }
            thread::sleep(LOOK);
        };
        assert!(below(getpid()).contains(&own) && below(getpid()).contains(&sleeper));
        kill(own, Signal::SIGKILL).and_then(|()| kill(sleeper, Signal::SIGKILL)).expect("they are ours");
        while below(getpid()).contains(&own) {
            thread::sleep(LOOK);
        }
        child.wait().expect("it is ours");
    }
}
