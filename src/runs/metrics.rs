//! Scores that runs produced, read from the cache: of `image_metrics`, `table` and `evaluation`.

use crate::{
    engine::{self, EngineError, Listed},
    registry,
    runs::RunOutput,
};
use std::{cmp::Ordering, collections::BTreeMap, fmt};
use tauflow_cache::Store;
use tauflow_contract::Media;
use tauflow_data::records::{AxisValue, Evaluation, METRICS, Metrics, SceneScores, Score, ScoreTable};

/// The part that a table is read from.
const TABLE: &str = "table.json";

/// The coordinates that tell rows of a table apart. Their order is that of tables: numbers by size.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Figure(Vec<(String, AxisValue)>);

impl Figure {
    pub(super) fn new<'t>(pairs: impl IntoIterator<Item = (&'t str, AxisValue)>) -> Self {
        Self(pairs.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
    }
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (name, value)) in self.0.iter().enumerate() {
            let comma = if place == 0 { "" } else { ", " };
            write!(f, "{comma}{name}={value}")?;
        }
        Ok(())
    }
}

impl Eq for Figure {}

impl PartialOrd for Figure {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Figure {
    fn cmp(&self, other: &Self) -> Ordering {
        let pair = |((name, value), (other, that)): (&(String, AxisValue), &(String, AxisValue))| {
            name.cmp(other).then_with(|| value.order(that))
        };
        let first = self.0.iter().zip(&other.0).map(pair).find(|by| by.is_ne());
        // Equal in order is equal in text: 1 and 1.0 are told apart.
        first.unwrap_or_else(|| self.0.len().cmp(&other.0.len()).then_with(|| self.to_string().cmp(&other.to_string())))
    }
}

/// Scores by figure and item, in the order of [`METRICS`]; none for a metric that was not computed.
pub(super) type Scores = BTreeMap<Figure, BTreeMap<String, Vec<Option<f64>>>>;

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

/// The coordinates of a score in its cell.
fn of_score(score: &Score) -> [(&'static str, AxisValue); 3] {
    let count = |value: u64| AxisValue::parse(&value.to_string());
    let method = AxisValue::Text(score.method.clone());
    [("method", method), ("from", count(score.from_spp)), ("nfe", count(score.nfe))]
}

/// Adds the scores of an artifact.
fn take(scores: &mut Scores, media: &str, key: &str, bytes: &[u8]) -> Result<(), serde_json::Error> {
    let mut add = |figure: Figure, item: &str, metrics: &Metrics| {
        let values = METRICS.map(|name| Some(registry::bounded(name, metrics.get(name)?)));
        scores.entry(figure).or_default().insert(item.to_owned(), values.to_vec());
    };
    if media == SceneScores::NAME {
        for score in serde_json::from_slice::<SceneScores>(bytes)?.scores {
            add(Figure::new(of_score(&score)), key, &score.metrics);
        }
    } else if media == ScoreTable::NAME {
        let table: ScoreTable = serde_json::from_slice(bytes)?;
        for row in &table.per_item {
            let at = table.axes.iter().zip(&row.at).map(|(axis, value)| (axis.name.as_str(), value.clone()));
            add(Figure::new(at), &row.item, &row.metrics);
        }
    } else {
        for row in serde_json::from_slice::<Evaluation>(bytes)?.per_scene {
            let cell = row.cell.iter().map(|(axis, value)| (axis.as_str(), AxisValue::parse(value)));
            add(Figure::new(cell.chain(of_score(&row.score))), &row.scene, &row.score.metrics);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use tauflow_data::records::BASIC;

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
        let (figure, items) = found.first_key_value().expect("a figure");
        assert_eq!(figure.to_string(), "method=m, from=4, nfe=2");
        let values = &items["L0-open-1"];
        assert_eq!(values[1..BASIC.len()], [2.0, 3.0, 4.0, 5.0, 0.5].map(Some));
        assert!(values[BASIC.len()..].iter().all(Option::is_none));
        assert!(values[0].is_some_and(f64::is_finite), "an infinite PSNR is held below the ceiling of the tables");
        let table = json!({
            "title": "t", "row_axes": 1, "metrics": ["ssim"], "reference_spp": 64, "items": 1, "resamples": 10,
            "axes": [{ "name": "spp", "type": "integer", "values": [4] }], "cells": [], "formats": { "latex": false },
            "per_item": [{ "item": "i", "stratum": "other", "at": [4], "metrics": metrics }]
        });
        let found = read(ScoreTable::NAME, table).expect("its own form");
        let (figure, items) = found.first_key_value().expect("a figure");
        assert_eq!((figure.to_string().as_str(), items["i"][5]), ("spp=4", Some(0.5)));
        assert!(read(Evaluation::NAME, json!({ "scores": [] })).is_err(), "another version is not misread");
    }

    #[test]
    fn figures_are_in_the_order_of_their_numbers() {
        let figure = |sampler: &str, spp: &str| {
            Figure::new([("sampler", AxisValue::parse(sampler)), ("spp", AxisValue::parse(spp))])
        };
        let mut figures = [("sobol", "2"), ("sobol", "10"), ("sobol", "0.5"), ("a", "10")].map(|(a, b)| figure(a, b));
        figures.sort();
        let told = figures.map(|figure| figure.to_string());
        assert_eq!(
            told,
            ["sampler=a, spp=10", "sampler=sobol, spp=0.5", "sampler=sobol, spp=2", "sampler=sobol, spp=10"]
        );
    }
}
