//! Everything a report may show, loaded. Knows the artifacts of other kinds by their formats alone.

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use tauflow_contract::{Action, Artifact, Collection, Context, KindError};
use tauflow_data::{
    formats::{PackedScene, Verdict},
    results::{Bridge, Evaluation, TrainingLog, TrainingTiming},
    statistics::SceneStatistics,
};

/// Coordinates of a matrix cell, e.g. `parameterization` -> `mc_noise`.
pub type Cell = BTreeMap<String, String>;

/// What there is to report. What is `None` or empty was not connected.
#[derive(Clone, Debug)]
pub struct Material {
    /// Scores of every method.
    pub evaluation: Evaluation,
    /// Loss curves, by cell in order of keys.
    pub losses: Vec<TrainingLog>,
    /// Measured training times by cell.
    pub timings: Vec<(Cell, TrainingTiming)>,
    /// The gate's verdicts, by scene.
    pub verdicts: Vec<(String, Verdict)>,
    /// What the split says.
    pub split: Option<Split>,
    /// What the sampling says.
    pub sampling: Option<Sampling>,
    /// The bridge, with its maps.
    pub bridge: Option<BridgeFiles>,
    /// How far ladders keep to the 1/sqrt(n) law.
    pub convergence: Option<tauflow_data::convergence::Convergence>,
    /// Error against time.
    pub time_error: Option<tauflow_data::time_error::TimeError>,
    /// What scenes are, by scene.
    pub statistics: Vec<(String, SceneStatistics)>,
    /// Size and rungs of the references.
    pub references: Option<References>,
}

/// What is known of the references beside their pixels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct References {
    /// Sample counts of the ladder, increasing.
    pub counts: Vec<u64>,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Number of scenes.
    pub scenes: usize,
}

/// The item of `content_signature_split`'s port `report`, as far as it is shown.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Split {
    /// Number of signatures.
    pub groups: u64,
    /// Scenes on the two sides.
    pub sides: Sides,
    /// The same by stratum.
    pub strata: BTreeMap<String, Sides>,
    /// Signatures on both sides.
    pub leaks: Vec<serde_json::Value>,
    /// Signatures of more than one scene.
    pub near_duplicates: Vec<serde_json::Value>,
    /// Scenes left out.
    #[serde(default)]
    pub dropped: Vec<String>,
}

/// Scenes on the two sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sides {
    /// To learn from.
    pub train: u64,
    /// To judge by.
    pub test: u64,
}

/// The item of `stratified_sampling`'s port `report`, as far as it is shown.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Sampling {
    /// Scenes chosen to learn from.
    pub train: Quota,
    /// Scenes chosen to judge by.
    pub test: Quota,
    /// Strata that fall short.
    #[serde(default)]
    pub short: Vec<String>,
    /// Remarks.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// A side of [`Sampling`].
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Quota {
    /// Scenes asked for.
    pub wanted: u64,
    /// Scenes taken.
    pub chosen: u64,
    /// By stratum.
    pub strata: BTreeMap<String, StratumQuota>,
}

/// A stratum of [`Quota`].
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct StratumQuota {
    /// Scenes asked for.
    pub wanted: u64,
    /// Scenes there were.
    pub available: u64,
    /// Scenes taken.
    pub chosen: u64,
}

/// The bridge's table and its pictures.
#[derive(Clone, Debug)]
pub struct BridgeFiles {
    /// The table.
    pub bridge: Bridge,
    /// PNGs by name below `maps/`.
    pub maps: Vec<(String, Vec<u8>)>,
}

/// The cell that a key such as `parameterization=mc_noise+conditioning=rgb/x` names; empty if it names none.
pub fn cell_of_key(key: &str) -> Cell {
    let cell = if key.contains('/') { key.rsplit_once('/').map_or("", |(cell, _)| cell) } else { key };
    cell.split(['+', '/'])
        .filter_map(|part| part.split_once('=').map(|(axis, value)| (axis.to_owned(), value.to_owned())))
        .collect()
}

fn optional<'a, P>(action: &Action<'a, P>, port: &str) -> Option<&'a Collection> {
    action.whole.get(port).copied().filter(|c| !c.is_empty())
}

/// The value of every item of a port of JSON blobs.
fn all<T: DeserializeOwned, P>(
    ctx: &Context<'_>,
    action: &Action<'_, P>,
    port: &str,
) -> Result<Vec<(String, T)>, KindError> {
    let Some(collection) = optional(action, port) else { return Ok(Vec::new()) };
    collection.iter().map(|(key, artifact)| Ok((key.to_string(), ctx.json(artifact, "")?))).collect()
}

/// The value of a port of one JSON blob.
fn one<T: DeserializeOwned, P>(ctx: &Context<'_>, action: &Action<'_, P>, port: &str) -> Result<Option<T>, KindError> {
    only(action, port)?.map(|artifact| ctx.json(artifact, "")).transpose()
}

fn only<'a, P>(action: &Action<'a, P>, port: &str) -> Result<Option<&'a Artifact>, KindError> {
    let Some(collection) = optional(action, port) else { return Ok(None) };
    if collection.len() > 1 {
        return Err(KindError::Input(format!(
            "input `{port}` takes one item and got {}; name one cell of its node, as in `node[axis=value]`",
            collection.len()
        )));
    }
    Ok(collection.iter().next().map(|(_, artifact)| artifact))
}

/// The bridge of the port `bridge`.
fn bridge<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<Option<BridgeFiles>, KindError> {
    let Some(artifact) = only(action, "bridge")? else { return Ok(None) };
    let mut maps = Vec::new();
    for (name, digest) in artifact.parts.iter() {
        if let Some(short) = name.strip_prefix("maps/")
            && short.ends_with(".png")
        {
            maps.push((short.to_owned(), ctx.get(digest)?));
        }
    }
    Ok(Some(BridgeFiles { bridge: ctx.json(artifact, "bridge.json")?, maps }))
}

fn references<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<Option<References>, KindError> {
    let Some(collection) = optional(action, "references") else { return Ok(None) };
    let Some((_, artifact)) = collection.iter().next() else { return Ok(None) };
    let scene = PackedScene::from_bytes(&ctx.part(artifact, "")?)?;
    let Some(first) = scene.states.first() else { return Ok(None) };
    Ok(Some(References {
        counts: scene.counts,
        width: first.width(),
        height: first.height(),
        scenes: collection.len(),
    }))
}

impl Material {
    /// Loads every port but the images.
    ///
    /// # Errors
    /// If an artifact is missing or not what its port expects.
    pub fn load<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<Self, KindError> {
        let logs: Vec<(String, TrainingLog)> = all(ctx, action, "losses")?;
        let timings: Vec<(String, TrainingTiming)> = all(ctx, action, "timings")?;
        Ok(Self {
            evaluation: one(ctx, action, "evaluation")?.ok_or_else(|| {
                KindError::Input("input `evaluation` holds no item; connect a node of kind `evaluation`".into())
            })?,
            losses: logs.into_iter().map(|(_, log)| log).collect(),
            timings: timings.into_iter().map(|(key, timing)| (cell_of_key(&key), timing)).collect(),
            verdicts: all(ctx, action, "verdicts")?,
            split: one(ctx, action, "split")?,
            sampling: one(ctx, action, "sampling")?,
            bridge: bridge(ctx, action)?,
            convergence: one(ctx, action, "convergence")?,
            time_error: one(ctx, action, "time_error")?,
            statistics: all(ctx, action, "statistics")?,
            references: references(ctx, action)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_name_their_cells() {
        let cell = cell_of_key("parameterization=mc_noise+conditioning=rgb/L1-open-000003");
        assert_eq!(cell["parameterization"], "mc_noise");
        assert_eq!(cell["conditioning"], "rgb");
        assert_eq!(
            cell_of_key("conditioning=rgb+parameterization=x"),
            cell_of_key("parameterization=x+conditioning=rgb/log")
        );
        assert!(cell_of_key("L1-open-000003").is_empty());
    }
}
