//! Reports of the split and the sampling of scenes.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::json_media;

/// Scenes on the two sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sides {
    /// To learn from.
    pub train: u64,
    /// To judge by.
    pub test: u64,
}

/// The report of `content_signature_split`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SplitReport {
    /// Step of the layout's parameters.
    pub quantum: f64,
    /// Scenes on the two sides.
    pub sides: Sides,
    /// The same by stratum.
    pub strata: BTreeMap<String, Sides>,
    /// Signatures on both sides; always none.
    pub leaks: Vec<Leak>,
    /// Every signature with its scenes, in the order of signatures.
    pub groups: Vec<SceneGroup>,
    /// Scenes left out, as their signature is on the side that they were not drawn for.
    pub dropped: Vec<String>,
}

/// A signature that stands on both sides.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leak {
    /// The signature.
    pub signature: String,
    /// Scenes on the train side.
    pub train: Vec<String>,
    /// Scenes on the test side.
    pub test: Vec<String>,
}

/// Scenes of one signature: views of one content, which differ in camera, exposure and light alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneGroup {
    /// The signature.
    pub signature: String,
    /// Its side.
    pub side: crate::scene::Side,
    /// The scenes.
    pub items: Vec<String>,
}

impl SplitReport {
    /// The signature of each scene.
    pub fn signatures(&self) -> BTreeMap<&str, &str> {
        let of = |group| {
            let SceneGroup { signature, items, .. }: &SceneGroup = group;
            items.iter().map(|item| (item.as_str(), signature.as_str()))
        };
        self.groups.iter().flat_map(of).collect()
    }

    /// Groups of more than one scene.
    pub fn shared(&self) -> usize {
        self.groups.iter().filter(|group| group.items.len() > 1).count()
    }
}

/// The report of `stratified_sampling`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SamplingReport {
    /// Scenes chosen to learn from.
    pub train: Quota,
    /// Scenes chosen to judge by.
    pub test: Quota,
    /// Strata that fall short, one line each.
    pub short: Vec<String>,
    /// Remarks.
    pub notes: Vec<String>,
}

/// A side of a [`SamplingReport`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quota {
    /// Scenes asked for.
    pub wanted: u64,
    /// Scenes taken.
    pub chosen: u64,
    /// True if every stratum was asked for equally many.
    pub equal: bool,
    /// By stratum.
    pub strata: BTreeMap<String, StratumQuota>,
}

/// A stratum of a [`Quota`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StratumQuota {
    /// Scenes asked for.
    pub wanted: u64,
    /// Scenes there were.
    pub available: u64,
    /// Scenes taken.
    pub chosen: u64,
}

json_media! {
    SplitReport, "tauflow/split-report", "Groups, counts and leaks of a split.";
    SamplingReport, "tauflow/sampling-report", "Wanted, available and chosen scenes by stratum.";
}
