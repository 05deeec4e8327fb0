//! Names of ports that params decide. They are compared and passed around like the names in the program's text, so each
//! is kept once, for the life of the process.
//!
//! Ports are `Copy` and built in constants, which is why names are not owned. The memory that is never given back is
//! bounded: by the distinct names in the pipelines that a process reads. Reading a pipeline again adds nothing, so a
//! process that lives long and reads the same pipelines, such as a viewer, does not grow.

use std::{
    collections::BTreeSet,
    sync::{Mutex, MutexGuard, PoisonError},
};

fn known() -> MutexGuard<'static, BTreeSet<&'static str>> {
    static KNOWN: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    KNOWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A name that lives as long as the process; the same text is kept once.
pub fn interned(name: &str) -> &'static str {
    let mut known = known();
    if let Some(kept) = known.get(name) {
        return kept;
    }
    let kept: &'static str = Box::leak(name.to_owned().into_boxed_str());
    known.insert(kept);
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    #[test]
    fn one_text_is_kept_once() {
        let (a, b) = (interned(&String::from("a port")), interned(&String::from("a port")));
        assert!(std::ptr::eq(a, b) && a == "a port");
        assert_ne!(interned("another"), a);
    }

    #[test]
    fn what_is_kept_is_bounded_by_the_distinct_names_however_often_they_are_read() {
        let read = || {
            for n in 0..5000 {
                assert!(interned(&format!("bounded{}", n % 100)).starts_with("bounded"));
            }
        };
        thread::scope(|scope| (0..4).for_each(|_| drop(scope.spawn(read))));
        let kept = known().iter().filter(|name| name.starts_with("bounded")).count();
        assert_eq!(kept, 100, "20,000 readings of 100 names");
    }
}
