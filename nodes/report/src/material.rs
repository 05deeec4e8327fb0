//! Everything a report may show, loaded. Knows other kinds by the records they hand on.

use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Action, All, Context, InputPort, KindError, Media};
use tauflow_data::{
    records::{
        AssetReport, Bridge, BridgeFiles, Convergence, Evaluation, Ladder, PackedScene, Refined, Rollout,
        SamplingReport, SceneRecord, SceneStatistics, ScoreTable, SplitReport, TimeError, TrainingLog, TrainingTiming,
        Verdict,
    },
    scene::Recipe,
};

pub const EVALUATION: All<Evaluation> = All::new("evaluation", "Scores of every method.").or_none().single();
pub const TABLES: All<ScoreTable> = All::new("tables", "Tables of scores by any axes.").or_none();
pub const LADDERS: All<Ladder> = All::new("ladders", "Ladders whose images the page shows side by side.").or_none();
pub const REFERENCES: All<PackedScene> =
    All::new("references", "Packed test scenes: input and reference of the images.").or_none();
pub const REFINED: All<Refined> =
    All::new("refined", "Refined images of all cells, and of baselines for the figure that opens the page.").or_none();
pub const STATES: All<Rollout> =
    All::new("states", "States of solvers between their network calls, for the viewer.").or_none();
const LOSSES: All<TrainingLog> = All::new("losses", "Loss curves of all cells.").or_none();
const TIMINGS: All<TrainingTiming> = All::new("timings", "Measured training times of all cells.").or_none();
const VERDICTS: All<Verdict> = All::new("verdicts", "Verdicts of the quality gate on the pool.").or_none();
pub const PREVIEWS: All<Ladder> =
    All::new("previews", "The previews that the gate checked, for images of rejected scenes.").or_none();
const SPLIT: All<SplitReport> = All::new("split", "Report of the split.").or_none().single();
const SAMPLING: All<SamplingReport> = All::new("sampling", "Report of the sampling.").or_none().single();
const BRIDGE: All<BridgeFiles> = All::new("bridge", "Bridge validation: tables, cases, maps.").or_none().single();
const CONVERGENCE: All<Convergence> =
    All::new("convergence", "Validity of the 1/sqrt(n) law for the ladders.").or_none().single();
const TIME_ERROR: All<TimeError> =
    All::new("time_error", "Error against time: the first section of the page.").or_none().single();
const STATISTICS: All<SceneStatistics> = All::new("statistics", "Statistics of the scenes.").or_none();
pub const ASSETS: All<AssetReport> =
    All::new("assets", "Import results of the files with HDRIs and objects, from `assets`.").or_none();
pub const TRAIN_SCENES: All<SceneRecord> =
    All::new("train_scenes", "Training scenes, to count those with assets from files.").or_none();
pub const TEST_SCENES: All<SceneRecord> =
    All::new("test_scenes", "Test scenes, to count those with assets from files.").or_none();

/// The inputs of `report`.
pub const INPUTS: &[InputPort] = &[
    EVALUATION.port(),
    REFERENCES.port(),
    REFINED.port(),
    LOSSES.port(),
    TIMINGS.port(),
    VERDICTS.port(),
    PREVIEWS.port(),
    SPLIT.port(),
    SAMPLING.port(),
    BRIDGE.port(),
    CONVERGENCE.port(),
    TIME_ERROR.port(),
    STATISTICS.port(),
    TABLES.port(),
    LADDERS.port(),
    STATES.port(),
    ASSETS.port(),
    TRAIN_SCENES.port(),
    TEST_SCENES.port(),
];

/// Coordinates of a matrix cell, e.g. `parameterization` -> `mc_noise`.
pub type Cell = BTreeMap<String, String>;

/// The inputs of the report. `None` or empty inputs are not connected.
#[derive(Clone, Debug)]
pub struct Material {
    /// Scores of every method.
    pub evaluation: Option<Evaluation>,
    /// Loss curves, by cell in order of keys.
    pub losses: Vec<TrainingLog>,
    /// Measured training times by cell.
    pub timings: Vec<(Cell, TrainingTiming)>,
    /// The gate's verdicts, by scene.
    pub verdicts: Vec<(String, Verdict)>,
    /// Report of the split.
    pub split: Option<SplitReport>,
    /// Report of the sampling.
    pub sampling: Option<SamplingReport>,
    /// The bridge, with its maps.
    pub bridge: Option<BridgeFiles>,
    /// Validity of the 1/sqrt(n) law for the ladders.
    pub convergence: Option<Convergence>,
    /// Error against time.
    pub time_error: Option<TimeError>,
    /// Statistics per scene.
    pub statistics: Vec<(String, SceneStatistics)>,
    /// Size and rungs of the references.
    pub references: Option<References>,
    /// Tables of scores, by key.
    pub tables: Vec<(String, ScoreTable)>,
    /// Assets from files; empty ones if the pipeline has none.
    pub assets: Option<Assets>,
}

/// Files with assets, and the scenes that use them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Assets {
    /// Import results, by file.
    pub reports: Vec<AssetReport>,
    /// Uses in training scenes, if connected.
    pub train: Option<Uses>,
    /// Uses in test scenes, if connected.
    pub test: Option<Uses>,
}

/// Uses of assets from files in the scenes of one side.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Uses {
    /// Number of scenes.
    pub scenes: u64,
    /// Scenes with at least one object from a file.
    pub with_object: u64,
    /// Scenes with an environment map from a file.
    pub with_environment: u64,
    /// Scenes by file.
    pub by_name: BTreeMap<String, u64>,
}

impl Uses {
    /// Number of scenes that use a file.
    pub fn of(&self, name: &str) -> u64 {
        self.by_name.get(name).copied().unwrap_or(0)
    }

    fn add(&mut self, recipe: &Recipe) {
        let from_file = |name: &&String| !name.starts_with("procedural/");
        let objects: BTreeSet<&String> = recipe.objects.iter().filter(from_file).collect();
        let environment = Some(&recipe.environment).filter(|name| *name != "none").filter(from_file);
        self.scenes += 1;
        self.with_object += u64::from(!objects.is_empty());
        self.with_environment += u64::from(environment.is_some());
        for name in objects.into_iter().chain(environment) {
            *self.by_name.entry(name.clone()).or_default() += 1;
        }
    }
}

/// Metadata of the references.
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

impl References {
    /// Whether the input of so many samples is a rung below the last: held-out references lack it.
    pub fn has_input(&self, from_spp: u64) -> bool {
        self.counts.contains(&from_spp) && self.counts.iter().any(|count| *count > from_spp)
    }
}

/// The cell that a key such as `parameterization=mc_noise+conditioning=rgb/x` names; empty if it names none.
pub fn cell_of_key(key: &str) -> Cell {
    let cell = if key.contains('/') { key.rsplit_once('/').map_or("", |(cell, _)| cell) } else { key };
    cell.split(['+', '/'])
        .filter_map(|part| part.split_once('=').map(|(axis, value)| (axis.to_owned(), value.to_owned())))
        .collect()
}

/// Every item of a port, by key.
fn all<M: Media, P>(ctx: &Context<'_>, action: &Action<'_, P>, port: All<M>) -> Result<Vec<(String, M)>, KindError> {
    let Some(items) = action.all_if(port)? else { return Ok(Vec::new()) };
    items.iter().map(|(key, item)| Ok((key.to_string(), item.load(ctx)?))).collect()
}

/// The only item of a port, if there is one.
fn one<M: Media, P>(ctx: &Context<'_>, action: &Action<'_, P>, port: All<M>) -> Result<Option<M>, KindError> {
    action.only_if(port)?.map(|item| item.load(ctx)).transpose()
}

fn uses<P>(ctx: &Context<'_>, action: &Action<'_, P>, port: All<SceneRecord>) -> Result<Option<Uses>, KindError> {
    let Some(scenes) = action.all_if(port)? else { return Ok(None) };
    let mut out = Uses::default();
    for (_, scene) in scenes.iter() {
        out.add(&SceneRecord::recipe(ctx, scene)?);
    }
    Ok(Some(out))
}

fn assets<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<Option<Assets>, KindError> {
    if action.all_if(ASSETS)?.is_none() {
        return Ok(None);
    }
    let reports = all(ctx, action, ASSETS)?.into_iter().map(|(_, report)| report).collect();
    Ok(Some(Assets { reports, train: uses(ctx, action, TRAIN_SCENES)?, test: uses(ctx, action, TEST_SCENES)? }))
}

fn references<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<Option<References>, KindError> {
    let Some(items) = action.all_if(REFERENCES)? else { return Ok(None) };
    let Some((_, item)) = items.iter().next() else { return Ok(None) };
    let scene = item.load(ctx)?;
    let Some(first) = scene.states.first() else { return Ok(None) };
    Ok(Some(References { counts: scene.counts, width: first.width(), height: first.height(), scenes: items.len() }))
}

impl Material {
    /// Loads every port but the images.
    ///
    /// # Errors
    /// If an artifact is missing or not what its port expects.
    pub fn load<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<Self, KindError> {
        let timings = all(ctx, action, TIMINGS)?;
        Ok(Self {
            evaluation: one(ctx, action, EVALUATION)?,
            tables: all(ctx, action, TABLES)?,
            losses: all(ctx, action, LOSSES)?.into_iter().map(|(_, log)| log).collect(),
            timings: timings.into_iter().map(|(key, timing)| (cell_of_key(&key), timing)).collect(),
            verdicts: all(ctx, action, VERDICTS)?,
            split: one(ctx, action, SPLIT)?,
            sampling: one(ctx, action, SAMPLING)?,
            bridge: one(ctx, action, BRIDGE)?,
            convergence: one(ctx, action, CONVERGENCE)?,
            time_error: one(ctx, action, TIME_ERROR)?,
            statistics: all(ctx, action, STATISTICS)?,
            references: references(ctx, action)?,
            assets: assets(ctx, action)?,
        })
    }

    /// The tables of the bridge.
    pub fn bridge_tables(&self) -> Option<&Bridge> {
        self.bridge.as_ref().map(|files| &files.bridge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_assets_from_files_are_counted_and_each_once_per_scene() {
        let mut recipe = Recipe {
            stratum: "L0-open".into(),
            index: 0,
            content: None,
            view: 0,
            layout: "table".into(),
            layout_params: BTreeMap::new(),
            objects: vec!["cat.glb".into(), "cat.glb".into(), "procedural/vase".into()],
            environment: "none".into(),
            side: None,
            exposure_ev: 0.0,
        };
        let mut uses = Uses::default();
        uses.add(&recipe);
        recipe.objects.retain(|name| name != "cat.glb");
        recipe.environment = "procedural/dusk".into();
        uses.add(&recipe);
        recipe.environment = "dawn.hdr".into();
        uses.add(&recipe);
        assert_eq!((uses.scenes, uses.with_object, uses.with_environment), (3, 1, 1));
        assert_eq!((uses.of("cat.glb"), uses.of("dawn.hdr"), uses.of("procedural/vase")), (1, 1, 0));
    }

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
