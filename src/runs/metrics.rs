//! Scores that runs produced, read from the cache: of `image_metrics`, `table` and `evaluation`.

use crate::{
    engine::{self, EngineError, Listed},
    registry,
    runs::RunOutput,
};
use std::collections::BTreeMap;
use tauflow_cache::Store;
use tauflow_contract::Media;
use tauflow_data::records::{Evaluation, METRICS, Metrics, SceneScores, ScoreTable};

/// The part that a table is read from.
const TABLE: &str = "table.json";

/// Scores by figure (the coordinates that tell rows of a table apart) and item, in the order of [`METRICS`].
pub(super) type Scores = BTreeMap<String, BTreeMap<String, Vec<f64>>>;

/// Whether an output holds scores.
pub(super) fn has_scores(output: &RunOutput) -> bool {
    [SceneScores::NAME, ScoreTable::NAME, Evaluation::NAME].contains(&&*output.media)
}

/// The scores of an output; none if the cache no longer holds all of them, or they are of another version.
///
/// # Errors
/// If the cache cannot be read.
pub(super) fn scores(store: &Store, media: &str, listed: &Listed) -> Result<Option<Scores>, EngineError> {
    let Some(items) = engine::listed_items(store, listed)? else { return Ok(None) };
    let mut scores = Scores::new();
    for (key, artifact) in items {
        let name = if media == ScoreTable::NAME { TABLE } else { "" };
        let Some(digest) = artifact.parts.iter().find(|(part, _)| **part == *name).map(|(_, digest)| *digest) else {
            return Ok(None);
        };
        let Some(bytes) = store.get(&digest)? else { return Ok(None) };
        if take(&mut scores, media, key.as_str(), &bytes).is_err() {
            return Ok(None);
        }
    }
    Ok(Some(scores))
}

/// Adds the scores of an artifact.
fn take(scores: &mut Scores, media: &str, key: &str, bytes: &[u8]) -> Result<(), serde_json::Error> {
    let mut add = |figure: String, item: &str, metrics: &Metrics| {
        let values = METRICS.map(|name| metrics.get(name).map_or(f64::NAN, |value| registry::bounded(name, value)));
        scores.entry(figure).or_default().insert(item.to_owned(), values.to_vec());
    };
    if media == SceneScores::NAME {
        for score in serde_json::from_slice::<SceneScores>(bytes)?.scores {
            let figure = format!("method={}, from={}, nfe={}", score.method, score.from_spp, score.nfe);
            add(figure, key, &score.metrics);
        }
    } else if media == ScoreTable::NAME {
        let table: ScoreTable = serde_json::from_slice(bytes)?;
        for row in &table.per_item {
            let at = table.axes.iter().zip(&row.at).map(|(axis, value)| format!("{}={value}", axis.name));
            add(at.collect::<Vec<_>>().join(", "), &row.item, &row.metrics);
        }
    } else {
        for row in serde_json::from_slice::<Evaluation>(bytes)?.per_scene {
            let mut at: Vec<String> = row.cell.iter().map(|(axis, value)| format!("{axis}={value}")).collect();
            at.push(format!("method={}, from={}, nfe={}", row.score.method, row.score.from_spp, row.score.nfe));
            add(at.join(", "), &row.scene, &row.score.metrics);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn scores_of_images_and_tables_are_read_by_figure_and_item() {
        let metrics = json!({
            "hdr_psnr": null, "hdr_psnr_max": 2.0, "hdr_mae": 3.0, "preview_psnr": 4.0, "preview_mae": 5.0, "ssim": 0.5
        });
        let read = |media: &str, value: serde_json::Value| {
            let mut scores = Scores::new();
            take(&mut scores, media, "L0-open-1", value.to_string().as_bytes()).map(|()| scores)
        };
        let of_images = json!({ "reference_spp": 64, "scores": [
            { "method": "m", "from_spp": 4, "to_spp": 64, "nfe": 2, "metrics": metrics }
        ] });
        let found = read(SceneScores::NAME, of_images).expect("its own form");
        let values = &found["method=m, from=4, nfe=2"]["L0-open-1"];
        assert_eq!(values[1..], [2.0, 3.0, 4.0, 5.0, 0.5]);
        assert!(values[0].is_finite(), "an infinite PSNR is held below the ceiling of the tables");
        let table = json!({
            "title": "t", "row_axes": 1, "metrics": ["ssim"], "reference_spp": 64, "items": 1, "resamples": 10,
            "axes": [{ "name": "spp", "type": "integer", "values": [4] }], "cells": [], "formats": { "latex": false },
            "per_item": [{ "item": "i", "stratum": "other", "at": [4], "metrics": metrics }]
        });
        let found = read(ScoreTable::NAME, table).expect("its own form");
        assert_eq!(found["spp=4"]["i"][5], 0.5);
        assert!(read(Evaluation::NAME, json!({ "scores": [] })).is_err(), "another version is not misread");
    }
}
