#![doc = include_str!("content_signature_split.md")]

use crate::{
    scene_generation::HoldOut,
    signature::{QUANTUM, check_leaks, shared_assets, signature},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, All, Context, Digest, Group, Handle, ItemKey, Items, Kind, KindError, KindSpec, Media, Mode, Out, Outputs,
};
use tauflow_data::{
    StratumName,
    records::{SceneGroup, SceneRecord, Sides, SplitReport},
    scene::{Recipe, Side},
};

const SCENES: All<SceneRecord> = All::new("scenes", "The scenes to split.");

const MAIN: Group = Group::main(2);
const TRAIN: Out<SceneRecord> = Out::new(MAIN, "train", "The training set.");
const TEST: Out<SceneRecord> = Out::new(MAIN, "test", "The test set.");
const REPORT: Out<SplitReport> = Out::new(MAIN, "report", "Groups with their scenes, counts and leaks.").single();

/// The kind `content_signature_split`.
pub struct ContentSignatureSplit;

/// Params of `content_signature_split`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ContentSignatureSplitParams {
    /// Share of the contents of each stratum for the test set.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub test_share: f64,
    /// Assets that must not be in both sets; scenes must be generated with the same `hold_out`.
    pub hold_out: Vec<HoldOut>,
    /// Quantisation step of layout parameters: absolute near 0, relative for large values.
    #[schemars(range(min = 0.000_001, max = 10.0))]
    pub quantum: f64,
}

impl Default for ContentSignatureSplitParams {
    fn default() -> Self {
        Self { test_share: 0.2, hold_out: Vec::new(), quantum: QUANTUM }
    }
}

/// A scene to place.
struct Entry<'a> {
    key: &'a ItemKey,
    scene: Handle<'a, SceneRecord>,
    recipe: Recipe,
    stratum: StratumName,
}

/// True if the `n`-th content of a stratum's pool goes to the test side: the `n` with
/// `floor((n + 1) share + 1/2) > floor(n share + 1/2)`, so that every prefix has its share to within a half.
pub fn is_test(n: u64, share: f64) -> bool {
    let before = |n: u64| (n as f64 * share + 0.5).floor();
    before(n + 1) > before(n)
}

fn load<'a>(ctx: &Context<'_>, scenes: Items<'a, SceneRecord>) -> Result<Vec<Entry<'a>>, KindError> {
    let mut entries = Vec::with_capacity(scenes.len());
    for (key, scene) in scenes.iter() {
        let recipe = SceneRecord::recipe(ctx, scene)?;
        let named = recipe.stratum.parse();
        let stratum =
            named.map_err(|e| KindError::Input(format!("scene `{key}`: its recipe names no stratum: {e}")))?;
        entries.push(Entry { key, scene, recipe, stratum });
    }
    // By index first: what a growing pool appends comes after all that was there.
    entries.sort_by(|a, b| (a.recipe.index, &a.stratum).cmp(&(b.recipe.index, &b.stratum)));
    Ok(entries)
}

impl Kind for ContentSignatureSplit {
    type Params = ContentSignatureSplitParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "content_signature_split",
            summary: "Splits scenes into a training and a test set that share no content signature.",
            manual: include_str!("content_signature_split.md"),
            mode: Mode::Gather,
            inputs: vec![SCENES.port()],
            outputs: vec![TRAIN.port(), TEST.port(), REPORT.port()],
            seeded: false,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let entries = load(ctx, action.all(SCENES)?)?;
        if !params.hold_out.is_empty()
            && let Some(entry) = entries.iter().find(|e| e.recipe.side.is_none())
        {
            return Err(KindError::Input(format!(
                "scene `{}` was drawn from no asset pool, but `hold_out` is asked for; \
                 give scene_generation the same `hold_out`",
                entry.key
            )));
        }
        let mut groups: BTreeMap<Digest, (Side, Vec<usize>)> = BTreeMap::new();
        let mut dropped = Vec::new();
        for (number, entry) in entries.iter().enumerate() {
            let group = groups.entry(signature(&entry.recipe, params.quantum)).or_insert_with(|| {
                // By its place in the pool, not among those that passed: a verdict moves no other group.
                let by_turn = if is_test(entry.recipe.content(), params.test_share) { Side::Test } else { Side::Train };
                (entry.recipe.side.unwrap_or(by_turn), Vec::new())
            });
            if entry.recipe.side.is_some_and(|side| side != group.0) {
                dropped.push(entry.key.to_string());
            } else {
                group.1.push(number);
            }
        }
        let (mut train, mut test) = (Vec::new(), Vec::new());
        let mut strata: BTreeMap<String, Sides> = BTreeMap::new();
        for (side, members) in groups.values() {
            for number in members {
                let counts = strata.entry(entries[*number].recipe.stratum.clone()).or_default();
                match side {
                    Side::Train => (train.push(&entries[*number]), counts.train += 1),
                    Side::Test => (test.push(&entries[*number]), counts.test += 1),
                };
            }
        }
        let recipes = |side: &[&'_ Entry<'_>]| side.iter().map(|e| e.recipe.clone()).collect::<Vec<_>>();
        let (train_recipes, test_recipes) = (recipes(&train), recipes(&test));
        let held = |which| params.hold_out.contains(&which);
        let shared = shared_assets(&train_recipes, &test_recipes, held(HoldOut::Objects), held(HoldOut::Environments));
        if !shared.is_empty() {
            return Err(KindError::Input(format!(
                "held-out assets stand on both sides: {}; draw the scenes with the same `hold_out`",
                shared.join(", ")
            )));
        }
        let leaks = check_leaks(
            train.iter().map(|e| (e.key.as_str(), &e.recipe)),
            test.iter().map(|e| (e.key.as_str(), &e.recipe)),
            params.quantum,
        );
        if let Some(leak) = leaks.first() {
            return Err(KindError::Internal(format!("signature {} stands on both sides of a split", leak.signature)));
        }
        let named = groups
            .iter()
            .filter(|(_, (_, members))| !members.is_empty())
            .map(|(signature, (side, members))| SceneGroup {
                signature: signature.to_string(),
                side: *side,
                items: members.iter().map(|n| entries[*n].key.to_string()).collect(),
            })
            .collect();
        let report = SplitReport {
            groups: named,
            quantum: params.quantum,
            sides: Sides { train: train.len() as u64, test: test.len() as u64 },
            strata,
            leaks,
            dropped,
        };
        let side = |entries: Vec<&Entry<'_>>| {
            entries.into_iter().map(|e| (e.key.clone(), e.scene.to_stored())).collect::<Vec<_>>()
        };
        Outputs::default().put_all(TRAIN, side(train)).put_all(TEST, side(test)).put_one(
            REPORT,
            REPORT.name(),
            report.store(ctx)?,
        )
    }
}

#[cfg(test)]
mod tests;
