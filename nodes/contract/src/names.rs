//! Names of ports that params decide. A pipeline names few, and they are compared and handed around like those in the
//! program's text; so each is kept once, for as long as the process lives.

use std::{
    collections::BTreeSet,
    sync::{Mutex, PoisonError},
};

/// A name that lives as long as the process; the same text is kept once.
pub fn interned(name: &str) -> &'static str {
    static KNOWN: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
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

    #[test]
    fn one_text_is_kept_once() {
        let (a, b) = (interned(&String::from("a port")), interned(&String::from("a port")));
        assert!(std::ptr::eq(a, b) && a == "a port");
        assert_ne!(interned("another"), a);
    }
}
