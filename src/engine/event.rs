//! Events of a run: the only view of a run outside of the scheduler.

use super::Listed;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::{borrow::Borrow, collections::BTreeMap, fmt, ops::Deref, path::PathBuf, sync::Arc, time::Duration};
use tauflow_contract::{Determinism, Digest, ItemKey};

/// A name that is said often: cheap to clone.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Name(Arc<str>);

impl From<&ItemKey> for Name {
    fn from(key: &ItemKey) -> Self {
        Self(key.text())
    }
}

impl From<&str> for Name {
    fn from(text: &str) -> Self {
        Self(text.into())
    }
}

impl Deref for Name {
    type Target = str;
    fn deref(&self) -> &str {
        &self.0
    }
}

impl Borrow<str> for Name {
    fn borrow(&self) -> &str {
        &self.0
    }
}

impl PartialEq<str> for Name {
    fn eq(&self, other: &str) -> bool {
        **self == *other
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Serialize for Name {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Ok(Self(String::deserialize(from)?.into()))
    }
}

/// Something that happened.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The run begins.
    Started {
        /// The pipeline.
        pipeline: Name,
        /// The nodes that are needed, in their order.
        nodes: Vec<Name>,
    },
    /// A node's cell, or a part of it, is as an earlier run left it.
    Unchanged {
        /// The node.
        node: Name,
        /// The cell, or empty.
        cell: Name,
        /// The output group.
        group: Name,
        /// How many actions that is.
        actions: u64,
    },
    /// A node has this many more actions to do.
    Expect {
        /// The node.
        node: Name,
        /// How many.
        actions: u64,
    },
    /// All actions of a node are known.
    Counted {
        /// The node.
        node: Name,
    },
    /// An action begins.
    Begin {
        /// The node.
        node: Name,
        /// The cell, or empty.
        cell: Name,
        /// The item, or empty.
        item: Name,
    },
    /// A long action goes on.
    Progress {
        /// The node.
        node: Name,
        /// The cell, or empty.
        cell: Name,
        /// The item, or empty.
        item: Name,
        /// Units done.
        done: u64,
        /// The total number.
        total: u64,
        /// A line.
        message: String,
    },
    /// An action ends; one that was done before ends without having begun.
    End {
        /// The node.
        node: Name,
        /// The cell, or empty.
        cell: Name,
        /// The item, or empty.
        item: Name,
        /// The output group.
        group: Name,
        /// Its outcome.
        outcome: Ended,
        /// Its wall time, in microseconds (of the run that made it).
        wall_us: u64,
        /// Bytes of its outputs.
        bytes: u64,
    },
    /// Why an action fails; its end follows.
    Failed {
        /// The failure.
        #[serde(flatten)]
        of: Failure,
    },
    /// Blobs are missing; their actions run again.
    Healing {
        /// The nodes that make them.
        nodes: Vec<Name>,
    },
    /// How many jobs of a scheduler wait and run.
    Jobs {
        /// They wait.
        queued: u64,
        /// They run.
        running: u64,
        /// Actions of each node in jobs that wait.
        waiting: BTreeMap<Name, u64>,
    },
    /// Something that people should know.
    Warning {
        /// What.
        message: String,
    },
    /// The run ends.
    Finished {
        /// Actions that ran.
        ran: u64,
        /// Actions that were done before.
        hit: u64,
        /// Actions that failed.
        failed: u64,
        /// Actions that could not be begun.
        blocked: u64,
        /// Bytes that were made.
        written: u64,
        /// Wall time, in seconds.
        elapsed_s: f64,
        /// Numbers of the nodes that were needed.
        nodes: Vec<NodeStat>,
        /// The actions that took longest.
        slowest: Vec<Slow>,
    },
}

/// The outcome of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// It was done before.
    Hit,
    /// It was done now.
    Ran,
    /// It failed.
    Failed,
    /// An input failed (or is unknown, in a dry run).
    Blocked,
    /// It would run, in a dry run.
    WouldRun,
}

/// Numbers of a node.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct NodeStat {
    /// The node.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// Actions that were done before.
    pub hit: u64,
    /// Actions that ran (or would, in a dry run).
    pub ran: u64,
    /// Actions that failed.
    pub failed: u64,
    /// Actions that could not be begun.
    pub blocked: u64,
    /// True if it is not known how many actions there are.
    pub unknown: bool,
    /// Lanes (a cell and an output group each) that were as an earlier run left them.
    pub unchanged: u64,
    /// Lanes in all.
    pub lanes: u64,
    /// Wall time of all its actions, in seconds, of the runs that made them.
    pub wall_s: f64,
    /// The part of it that was spent in this run.
    pub spent_s: f64,
    /// Bytes of its outputs.
    pub bytes: u64,
    /// Bytes of the blobs that this run made. Outputs may name blobs of others, which are counted where they were made.
    pub written: u64,
}

/// An action that took long.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Slow {
    /// The node.
    pub node: Name,
    /// The cell, or empty.
    pub cell: Name,
    /// The item, or empty.
    pub item: Name,
    /// Its duration in seconds.
    pub spent_s: f64,
}

impl Slow {
    /// `node/cell/item`.
    pub fn name(&self) -> String {
        let parts = [&self.node, &self.cell, &self.item];
        parts.iter().filter(|p| !p.is_empty()).map(|p| &***p).collect::<Vec<_>>().join("/")
    }
}

/// An output of a cell.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputOf {
    /// `node.port`, or `node[cell].port`.
    pub name: String,
    /// Whether its bits are reproducible, given what it is made from.
    pub determinism: Determinism,
    /// Content digest; none if it is not known, because something failed.
    pub digest: Option<Digest>,
    /// Media type of its items.
    pub media: &'static str,
    /// How the store lists its items; none if it is not known, or lists none.
    pub listed: Option<Listed>,
}

/// An action that failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// The node.
    pub node: String,
    /// The cell, or empty.
    pub cell: String,
    /// The item, or empty.
    pub item: String,
    /// The problem, its place, and the remedy.
    pub message: String,
}

impl Failure {
    /// The argument of `--only` that runs just this action.
    pub fn only(&self) -> String {
        let parts = [&self.node, &self.cell, &self.item];
        parts.iter().filter(|p| !p.is_empty()).map(|p| p.as_str()).collect::<Vec<_>>().join("/")
    }

    /// The message without what differs from item to item.
    pub fn cause(&self) -> String {
        if self.item.is_empty() { self.message.clone() } else { self.message.replace(&self.item, "<item>") }
    }
}

/// Numbers of a recheck or an audit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Compared {
    /// Results that came out as recorded.
    pub equal: u64,
    /// Results that did not.
    pub differing: u64,
}

/// The result of a run.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Numbers by node, in the pipeline's order.
    pub nodes: Vec<NodeStat>,
    /// Failures, in the order they happened.
    pub failures: Vec<Failure>,
    /// Results that were made again, and compared.
    pub compared: Compared,
    /// Number of actions that other shards have not done, by shard, from 1. Empty in a run without shards.
    pub elsewhere: BTreeMap<u32, u64>,
    /// True if the run was stopped.
    pub interrupted: bool,
    /// The actions that took longest in this run, longest first.
    pub slowest: Vec<Slow>,
    /// The outputs that were needed, whether made now or before.
    pub outputs: Vec<OutputOf>,
    /// Files that were written.
    pub published: Vec<PathBuf>,
    /// Wall time of this run.
    pub elapsed: Duration,
}

impl Summary {
    /// Whether all actions are done.
    pub fn is_whole(&self) -> bool {
        !self.interrupted && self.failures.is_empty() && self.elsewhere.is_empty()
    }

    /// Sum over nodes.
    pub fn total(&self, of: impl Fn(&NodeStat) -> u64) -> u64 {
        self.nodes.iter().map(of).fold(0, u64::saturating_add)
    }
}
