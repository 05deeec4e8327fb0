//! Tables of made-up scores.

use super::*;
use crate::groups::Groups;
use tauflow_contract::{ItemKey, Kind};
use tauflow_data::{
    records::{AxisValue, Metrics, SceneGroup, SceneScores, Score, ScoreTable, SplitReport, TableCell},
    scene::Side,
};

fn metrics(psnr: f64) -> Metrics {
    Metrics {
        hdr_psnr: psnr,
        hdr_psnr_max: psnr,
        hdr_mae: 1.0 / psnr,
        preview_psnr: psnr,
        preview_mae: 0.1,
        ssim: 0.5,
        ..Metrics::default()
    }
}

fn scores(key: &str, of: &[(u64, f64)]) -> (ItemKey, SceneScores) {
    let score = |(spp, psnr): &(u64, f64)| Score {
        method: "hold".into(),
        from_spp: *spp,
        to_spp: *spp,
        nfe: 0,
        metrics: metrics(*psnr),
    };
    let scores = of.iter().map(score).collect();
    (ItemKey::new(key).expect("plain"), SceneScores { reference_spp: 1024, scores, note: None })
}

/// Two samplers, two scenes of one stratum and one of another, two sample counts.
fn samplers() -> Vec<(ItemKey, SceneScores)> {
    let mut out = Vec::new();
    for (sampler, more) in [("independent", 0.0), ("sobol", 3.0)] {
        for (scene, base) in [("L0-open-000000", 20.0), ("L0-open-000001", 24.0), ("L3-enclosed-000000", 10.0)] {
            let of = [(4, base + more), (16, base + more + 6.0)];
            out.push(scores(&format!("sampler={sampler}/{scene}"), &of));
        }
    }
    out
}

fn made(scores: &[(ItemKey, SceneScores)], params: &TableParams) -> ScoreTable {
    tabulate(scores, &Groups::none(), params, 7).expect("a table")
}

fn at(table: &ScoreTable, values: &[&str]) -> TableCell {
    let at: Vec<AxisValue> = values.iter().map(|value| AxisValue::parse(value)).collect();
    table.cell(&at).unwrap_or_else(|| panic!("no cell {values:?} in {table:?}")).clone()
}

#[test]
fn two_samplers_by_sample_count_with_paired_differences() {
    let params = TableParams {
        columns: vec!["spp".into()],
        against: Some(AgainstParams { axis: "sampler".into(), value: Coordinate::Text("independent".into()) }),
        ..TableParams::default()
    };
    let table = made(&samplers(), &params);
    assert_eq!(table.axes.iter().map(|axis| axis.name.as_str()).collect::<Vec<_>>(), ["sampler", "spp"]);
    assert_eq!((table.row_axes, table.items, table.reference_spp), (1, 3, Some(1024)));
    let independent = at(&table, &["independent", "4"]);
    assert!((independent.metrics["hdr_psnr"].mean - 18.0).abs() < 1e-12 && independent.difference.is_empty());
    // Pairs differ by 3 in every scene, so the interval is a point, though scenes differ by 14 dB.
    let gain = at(&table, &["sobol", "16"]).difference["hdr_psnr"];
    assert!([gain.mean, gain.low, gain.high].iter().all(|value| (value - 3.0).abs() < 1e-9), "{gain:?}");
    assert!(independent.metrics["hdr_psnr"].high > independent.metrics["hdr_psnr"].low + 1.0);
    assert_eq!(table.per_item.len(), 12);
}

#[test]
fn a_stratum_is_an_axis_where_it_is_asked_for() {
    let params = TableParams {
        rows: vec!["stratum".into(), "sampler".into()],
        columns: vec!["spp".into()],
        ..TableParams::default()
    };
    let table = made(&samplers(), &params);
    assert_eq!(at(&table, &["L0-open", "sobol", "4"]).metrics["hdr_psnr"].mean, 25.0);
    assert_eq!(at(&table, &["L3-enclosed", "sobol", "4"]).items, 1);
}

#[test]
fn cells_of_one_item_or_of_one_group_have_no_intervals() {
    let params = TableParams { rows: vec!["stratum".into(), "sampler".into(), "spp".into()], ..TableParams::default() };
    let found = |table: &ScoreTable| {
        ["L0-open", "L3-enclosed"].map(|stratum| at(table, &[stratum, "sobol", "4"]).has_intervals())
    };
    assert_eq!(found(&made(&samplers(), &params)), [true, false]);
    let group = |signature: &str, items: &[&str]| SceneGroup {
        signature: signature.into(),
        side: Side::Test,
        items: items.iter().map(|item| (*item).to_owned()).collect(),
    };
    let groups = vec![group("s", &["L0-open-000000", "L0-open-000001"]), group("t", &["L3-enclosed-000000"])];
    let groups = Groups::of_split(&SplitReport { groups, ..SplitReport::default() });
    let table = tabulate(&samplers(), &groups, &params, 7).expect("a table");
    assert_eq!((table.groups, found(&table)), (Some(2), [false, false]));
    // Two groups together have intervals.
    let params = TableParams { columns: vec!["spp".into()], ..TableParams::default() };
    let table = tabulate(&samplers(), &groups, &params, 7).expect("a table");
    assert!(at(&table, &["sobol", "4"]).has_intervals());
}

fn refused(scores: &[(ItemKey, SceneScores)], params: &TableParams) -> String {
    tabulate(scores, &Groups::none(), params, 7).expect_err("refused").to_string()
}

#[test]
fn axes_that_are_unknown_or_left_over_are_refused_by_name() {
    let unknown = TableParams { columns: vec!["rung".into()], ..TableParams::default() };
    let told = refused(&samplers(), &unknown);
    assert!(told.contains("`rung`") && told.contains("`spp`") && told.contains("`sampler`"), "{told}");
    let left = TableParams { rows: vec!["sampler".into()], ..TableParams::default() };
    let told = refused(&samplers(), &left);
    assert!(told.contains("`spp` has the values `16`, `4`"), "{told}");
    let against = |axis: &str, value: Coordinate| TableParams {
        against: Some(AgainstParams { axis: axis.into(), value }),
        ..TableParams::default()
    };
    let told = refused(&samplers(), &against("nfe", Coordinate::Integer(0)));
    assert!(told.contains("`nfe`, which the table does not have"), "{told}");
    let told = refused(&samplers(), &against("spp", Coordinate::Integer(5)));
    assert!(told.contains("spp `5`") && told.contains("`4`, `16`"), "{told}");
}

#[test]
fn an_axis_that_others_determine_need_not_be_named() {
    let of = |from: u64, spp: u64| scores(&format!("from={from}/L0-open-000000"), &[(spp, 1.0)]);
    let rows = TableParams { rows: vec!["from".into()], ..TableParams::default() };
    let table = made(&[of(1, 1), of(4, 4)], &rows);
    assert_eq!((table.axes.len(), table.cells.len()), (1, 2));
    assert!(refused(&[of(1, 1), of(4, 4), scores("from=4/L0-open-000001", &[(8, 1.0)])], &rows).contains("`spp`"));
}

#[test]
fn cells_of_other_items_and_scores_that_meet_are_refused() {
    let mut fewer = samplers();
    fewer.pop();
    let told = refused(&fewer, &TableParams::default());
    assert!(told.contains("has a score of `L3-enclosed-000000`") && told.contains("sampler=sobol"), "{told}");
    let twice = [scores("L0-open-000000", &[(4, 1.0), (4, 2.0)])];
    assert!(refused(&twice, &TableParams::default()).contains("two scores of `L0-open-000000`"));
    let none = [scores("L0-open-000000", &[])];
    assert!(refused(&none, &TableParams::default()).contains("no scores"));
}

#[test]
fn metrics_and_axes_are_checked_before_a_run() {
    assert!(TableKind::check(&TableParams::default()).is_empty());
    let params = TableParams {
        metrics: vec!["psnr".into()],
        rows: vec!["spp".into()],
        columns: vec!["spp".into()],
        ..TableParams::default()
    };
    let found: Vec<String> = TableKind::check(&params).into_iter().map(|problem| problem.pointer).collect();
    assert_eq!(found, ["/metrics/0", "/columns/0"]);
}

#[test]
fn a_node_without_an_axis_stands_beside_those_that_have_it() {
    let mut all = samplers();
    for scene in ["L0-open-000000", "L0-open-000001", "L3-enclosed-000000"] {
        all.push(scores(&format!("method=oidn/{scene}"), &[(4, 30.0), (16, 33.0)]));
    }
    let table = made(&all, &TableParams { columns: vec!["spp".into()], ..TableParams::default() });
    assert_eq!(table.row_heads().len(), 3);
    assert_eq!(at(&table, &["oidn", "", "4"]).metrics["hdr_psnr"].mean, 30.0);
}

#[test]
fn a_metric_that_scores_lack_is_left_out_with_a_note() {
    let with_flip = |only: Option<&str>| {
        let mut all = samplers();
        for (key, of) in &mut all {
            if only.is_none_or(|part| key.as_str().contains(part)) {
                of.scores.iter_mut().for_each(|score| score.metrics.flip = Some(0.25));
            }
        }
        all
    };
    let params = |names: &[&str]| TableParams {
        metrics: names.iter().map(|name| (*name).to_owned()).collect(),
        columns: vec!["spp".into()],
        ..TableParams::default()
    };
    let table = made(&with_flip(None), &params(&["flip", "hdr_psnr"]));
    assert_eq!((table.metrics.len(), table.notes.len()), (2, 0));
    assert_eq!(at(&table, &["sobol", "4"]).metrics["flip"].mean, 0.25);
    // Some scores have it, none has it, and a node that left it out said why.
    let table = made(&with_flip(Some("sobol")), &params(&["flip", "hdr_psnr"]));
    assert_eq!(table.metrics, ["hdr_psnr"]);
    assert!(table.notes[0].contains("`flip`") && table.notes[0].contains("sampler=independent/"), "{:?}", table.notes);
    let mut all = samplers();
    assert_eq!(made(&all, &params(&["hdr_psnr", "lpips"])).notes, ["`lpips`, because no score has it"]);
    all[0].1.note = Some("`lpips`, because there are no weights".into());
    assert_eq!(made(&all, &params(&["hdr_psnr", "lpips"])).notes, ["`lpips`, because there are no weights"]);
    assert!(refused(&all, &params(&["lpips"])).contains("no metric of the table can be tabulated"));
}
