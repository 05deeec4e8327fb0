//! Where the measurements of a run are made: on this machine, on another one that runs jobs, or on one whose results
//! an upstream has.
//!
//! The keys of actions that only measure contain the machine, so that a run that measures elsewhere asks for other
//! keys, and nothing that another machine measured is taken for a measurement of this one. Actions that measure while
//! they make something else, such as trainings, have the same key everywhere. Their measurements count only if they
//! were made in this store, or if the run accepts them ([`Fetched`]).

use super::{
    EngineError,
    records::{self, MACHINE, MEMO, maker},
};
use crate::pipeline::Pipeline;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::sync::Arc;
use tauflow_cache::{CacheError, Key, Record, Store};
use tauflow_contract::{Basis, Determinism, KindSpec, MemoKey};
use tauflow_data::timing::{machine, named};

/// See the module. The default measures on this machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The machine as kinds describe it; none for this one.
    pub machine: Option<Value>,
    /// Its name; empty for this one.
    pub host: String,
    /// Measurements are taken from an upstream, and nothing is measured here.
    pub accepted: bool,
    /// Jobs have stores of their own: what they measure beside other outputs comes from an upstream.
    #[serde(default)]
    pub apart: bool,
    /// Jobs of this run measure there.
    #[serde(skip)]
    pub jobs: bool,
}

/// A machine that measured something, as a record of [`MACHINE`] holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// As kinds describe it.
    pub machine: Value,
    /// Its name.
    pub host: String,
}

/// The name of the host in [`maker`]'s text.
fn host_of(maker: &str) -> &str {
    maker.rsplit_once(", tauflow ").map_or(maker, |(host, _)| host)
}

impl Machine {
    /// This one.
    pub fn here() -> Self {
        Self { machine: machine(), host: host_of(&maker()).to_owned() }
    }

    fn key(&self) -> Key {
        Key::of(self.machine.to_string().as_bytes())
    }

    /// Notes that it measures, so that others can accept its measurements.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn keep(&self, store: &Store) -> Result<(), CacheError> {
        let payload = json!(self).to_string();
        records::keep_last(store, &records::note(MACHINE, self.key(), &self.host, self.machine.to_string(), payload))
    }

    /// All that a store and what is beyond it know, by name.
    fn known(store: &Store) -> Vec<Self> {
        let keys = store.keys_with_beyond(MACHINE);
        let found = store.lookup_many(MACHINE, &keys).into_iter().flatten();
        let read = |record: Arc<Record>| serde_json::from_str::<Self>(&record.payload).ok();
        let mut found: Vec<Self> = found.filter_map(read).collect();
        found.sort_by(|a, b| (&a.host, a.key()).cmp(&(&b.host, b.key())));
        found
    }

    /// Whether it is meant by its host, or by its host and the beginning of its key.
    fn is_named(&self, name: &str) -> bool {
        let by_key =
            |(host, key): (&str, &str)| host == self.host && !key.is_empty() && self.key().hex().starts_with(key);
        name == self.host || name.rsplit_once('@').is_some_and(by_key)
    }

    fn words(&self) -> String {
        named(&self.machine).map_or_else(|| self.host.clone(), |of| format!("{} ({of})", self.host))
    }
}

impl Measured {
    fn memo(pipeline: &Pipeline) -> MemoKey {
        let basis = Basis::new("measured", 1, "machine").with(json!({ "pipeline": pipeline.name }), None);
        MemoKey { basis, inputs: Vec::new() }
    }

    /// As the last run of the pipeline in this store measured: commands that run nothing look at its results.
    pub fn last(store: &Store, pipeline: &Pipeline) -> Self {
        // Of this store alone: nothing is asked of an upstream.
        let record = store.read(MEMO, &Self::memo(pipeline).hash());
        record.and_then(|record| serde_json::from_str(&record.payload).ok()).unwrap_or_default()
    }

    /// Jobs measure on this machine.
    pub fn by_jobs(of: Machine) -> Self {
        Self { machine: Some(of.machine), host: of.host, jobs: true, ..Self::default() }
    }

    /// Notes it for commands that run nothing, and the machine for those that accept its measurements if the run
    /// `measures`.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn begin(&self, store: &Store, pipeline: &Pipeline, measures: bool) -> Result<(), CacheError> {
        match &self.machine {
            Some(machine) if measures && self.jobs => {
                Machine { machine: machine.clone(), host: self.host.clone() }.keep(store)?;
            }
            None if measures && !self.accepted => Machine::here().keep(store)?,
            _ => {}
        }
        let last = Self::last(store, pipeline);
        // A run without measurements leaves open where they are made.
        if measures || (self.accepted, self.apart) != (last.accepted, last.apart) {
            self.keep(store, pipeline)?;
        }
        Ok(())
    }

    /// Notes it for [`Self::last`].
    fn keep(&self, store: &Store, pipeline: &Pipeline) -> Result<(), CacheError> {
        if *self == Self::last(store, pipeline) {
            return Ok(());
        }
        let key = Self::memo(pipeline);
        let preimage = serde_json::to_string(&key).expect("a key holds only plain values");
        let payload = json!(self).to_string();
        records::keep_last(store, &records::note(MEMO, key.hash(), &key.name(), preimage, payload))
    }

    /// The measurements of another machine that this store or its upstream has: of the one of this name, or of the only
    /// one there is.
    ///
    /// # Errors
    /// If it is not known which machine is meant.
    pub fn accept(store: &Store, host: Option<&str>) -> Result<Self, EngineError> {
        let known = Machine::known(store);
        let here = Machine::here().machine;
        let meant: Vec<&Machine> = match host {
            Some(named) => known.iter().filter(|of| of.is_named(named)).collect(),
            None => known.iter().filter(|of| of.machine != here).collect(),
        };
        // One host measures as several machines, if it had other cores or settings at times.
        let full = |of: &Machine| format!("{}@{}", of.host, &of.key().hex()[..8]);
        let is_alone = |of: &Machine| known.iter().filter(|other| other.host == of.host).count() == 1;
        let name = |of: &Machine| if is_alone(of) { of.host.clone() } else { full(of) };
        let list = |of: &[&Machine]| {
            let one = |of: &&Machine| of.words().replacen(&of.host, &name(of), 1);
            of.iter().map(one).collect::<Vec<_>>().join(", ")
        };
        match meant[..] {
            [of] => {
                let machine = (of.machine != here).then(|| of.machine.clone());
                Ok(Self { machine, host: of.host.clone(), accepted: true, ..Self::default() })
            }
            [] => {
                let all = list(&known.iter().collect::<Vec<_>>());
                let all = if all.is_empty() { "none".to_owned() } else { all };
                let of = host.map_or_else(|| "another machine".to_owned(), |host| format!("`{host}`"));
                Err(EngineError::Request(format!(
                    "--accept-measured: the cache and its upstream have no measurements of {of} (known: {all}); push \
                     them there with `tauflow cache push PIPELINE --all`"
                )))
            }
            _ => Err(EngineError::Request(format!(
                "--accept-measured: several machines measured: {}; name one, as in --accept-measured={}",
                list(&meant),
                name(meant[0])
            ))),
        }
    }

    /// The machine in words, if it is not this one, or if results are accepted.
    pub fn words(&self) -> Option<String> {
        if self.machine.is_none() && !self.accepted {
            return None;
        }
        let machine = self.machine.clone().unwrap_or_else(machine);
        Some(Machine { machine, host: self.host.clone() }.words())
    }

    /// The machine on which this run cannot measure, and takes what was measured there.
    pub fn only_there(&self) -> Option<Arc<str>> {
        (self.machine.is_some() && !self.jobs).then(|| self.host.as_str().into())
    }
}

/// Which records of an upstream count for an action that measures while it makes something else.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Fetched {
    /// All of them: nobody reads what it measures, or jobs of the run made them.
    #[default]
    All,
    /// None: its times are to be measured in this store.
    None,
    /// Those that this host made.
    Of(Arc<str>),
}

impl Fetched {
    /// Whether a record counts.
    pub fn counts(&self, record: &Record) -> bool {
        match self {
            _ if !record.fetched => true,
            Self::All => true,
            Self::None => false,
            Self::Of(host) => host_of(&record.maker) == &**host,
        }
    }
}

/// Whether a group has measurements beside other outputs.
pub fn is_mixed(spec: &KindSpec, group: &str) -> bool {
    let mut of_group = spec.outputs.iter().filter(|port| port.group.name == group);
    !spec.measures(group) && of_group.any(|port| port.determinism == Determinism::Measured)
}
