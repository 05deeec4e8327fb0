//! Probes: properties of the machine in keys that only a program can provide.
//!
//! Read-only commands must not start programs of a pipeline. A kind therefore does not run them in
//! [`Kind::environment`](crate::Kind::environment), but passes the question to a probe.

use serde_json::Value;

/// Knows whether programs may be run now, what they told before, and where measurements are made.
pub trait Probe {
    /// The answer to a question that only a program can give, which `ask` runs. The question says all that is known to
    /// decide the answer: the command line, the contents of the files that it names, the machine.
    ///
    /// None if nothing may run now and no earlier answer is known.
    fn answer(&self, question: &Value, ask: &dyn Fn() -> Value) -> Option<Value>;

    /// The machine on which the group's times are measured, if it is another than this one.
    fn machine(&self) -> Option<Value> {
        None
    }
}

/// Asks, each time.
pub struct Act;

impl Probe for Act {
    fn answer(&self, _question: &Value, ask: &dyn Fn() -> Value) -> Option<Value> {
        Some(ask())
    }
}

/// Runs nothing, and knows of nothing that ran before.
pub struct Look;

impl Probe for Look {
    fn answer(&self, _question: &Value, _ask: &dyn Fn() -> Value) -> Option<Value> {
        None
    }
}
