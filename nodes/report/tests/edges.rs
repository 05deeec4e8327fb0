//! The report over unusual material: scores without bounds, a single scene, held-out references, other solvers.

mod common;

use common::{LAST, cell, extras, run};
use serde_json::json;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{Collection, Context, FileTree, Handle, ItemKey, Media, MemoryBlobs, Silent};
use tauflow_data::{
    methods::{HOLD, Parameterization},
    records::{
        BridgeFiles, ClaimVerdict, Estimate, Evaluation, PSNR_CEILING, PackedScene, SceneRow, ScoreTable, TimeError,
        Versus,
    },
};
use tauflow_report::ReportParams;

/// Every input of a report.
struct Bench {
    blobs: MemoryBlobs,
    inputs: BTreeMap<&'static str, Collection>,
    stop: AtomicBool,
}

impl Bench {
    fn new() -> Self {
        let blobs = MemoryBlobs::default();
        let inputs = extras::all(&blobs, 12);
        Self { blobs, inputs, stop: AtomicBool::new(false) }
    }

    /// The inputs of a report without an evaluation: a table, references and images.
    fn of_a_table() -> Self {
        let mut bench = Self::new();
        bench.inputs.retain(|port, _| ["references", "refined"].contains(port));
        let table: ScoreTable = serde_json::from_value(json!({
            "title": "Methods", "row_axes": 1, "metrics": ["ssim"], "reference_spp": LAST, "items": 3,
            "axes": [{ "name": "method", "type": "text", "values": ["oidn"] }], "per_item": [], "resamples": 100,
            "cells": [], "formats": { "latex": false }
        }))
        .expect("a table");
        let ctx = Context::new(&bench.blobs, &Silent, &bench.stop);
        let table = common::item(&ctx, "table", &table);
        bench.inputs.insert("tables", [table].into_iter().collect());
        bench
    }

    /// Changes each item of a port; returns them in the order of their keys.
    fn change<M: Media>(&mut self, port: &'static str, mut change: impl FnMut(&mut M)) -> Vec<M> {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let (mut items, mut all) = (Vec::<(ItemKey, _)>::new(), Vec::new());
        for (key, artifact) in self.inputs[port].iter() {
            let mut own = Handle::<M>::new(artifact).and_then(|item| item.load(&ctx)).expect("stored");
            change(&mut own);
            items.push(common::item(&ctx, key.as_str(), &own));
            all.push(own);
        }
        self.inputs.insert(port, items.into_iter().collect());
        all
    }

    /// Changes the evaluation.
    fn evaluation(&mut self, change: impl FnMut(&mut Evaluation)) -> Evaluation {
        self.change("evaluation", change).remove(0)
    }

    /// Leaves the last rung of the references alone, as of a ladder of another stream.
    fn hold_references_out(&mut self) {
        self.change("references", |packed: &mut PackedScene| {
            packed.counts = packed.counts.split_off(packed.counts.len() - 1);
            packed.states = packed.states.split_off(packed.states.len() - 1);
        });
    }

    fn files(&self) -> FileTree {
        run(&self.blobs, ReportParams::default(), &self.inputs).expect("a report")
    }
}

fn text(files: &FileTree, name: &str) -> String {
    String::from_utf8(files[name].clone()).expect("text files are UTF-8")
}

/// What stands between two texts.
fn between<'a>(html: &'a str, first: &str, last: &str) -> &'a str {
    let (_, rest) = html.split_once(first).unwrap_or_else(|| panic!("{first} is missing"));
    rest.split_once(last).unwrap_or_else(|| panic!("no {last} after {first}")).0
}

/// A section of the page.
fn section<'a>(html: &'a str, id: &str) -> &'a str {
    between(html, &format!("<section id=\"{id}\""), "</section>")
}

#[test]
fn an_input_that_equals_its_reference_leaves_the_mean_of_its_stratum_finite() {
    let mut bench = Bench::new();
    let mut stratum = String::new();
    let evaluation = bench.evaluation(|of| {
        let row = of.per_scene.iter_mut().find(|row| row.score.method == HOLD).expect("a score of the input");
        row.score.metrics.hdr_psnr = f64::INFINITY;
        stratum = row.stratum.clone();
    });
    let own = |row: &&SceneRow| row.score.method == HOLD && row.stratum == stratum;
    let psnr: Vec<f64> = evaluation.per_scene.iter().filter(own).map(|row| row.score.metrics.hdr_psnr).collect();
    let mean = psnr.iter().map(|value| value.min(PSNR_CEILING)).sum::<f64>() / psnr.len() as f64;
    let html = text(&bench.files(), "report.html");
    let strata = section(&html, "strata");
    assert!(!strata.contains('∞'), "a gain or a mean is infinite");
    assert!(strata.contains(&format!("<td>{mean:.2}</td>")), "{mean}");
    let gain = evaluation.methods[0].at[0].strata[&stratum]["hdr_psnr"] - mean;
    assert!(strata.contains(&format!(">{gain:.2}</td>").replace('-', "−")), "{gain}");
    // The picture of the scene says what it is.
    assert!(section(&html, "pictures").contains("∞"));
    // Without an evaluation, the input whose PSNR is infinite is one of the scenes that choose the opening figure.
    let mut bench = Bench::of_a_table();
    let mut first = true;
    bench.change("references", |packed: &mut PackedScene| {
        let last = packed.states.len() - 1;
        if std::mem::take(&mut first) {
            packed.states[0] = packed.states[last].clone();
        }
    });
    assert!(text(&bench.files(), "report.html").contains("class=\"hero\""));
}

#[test]
fn held_out_references_keep_the_pictures_of_a_table() {
    let evaluation = Bench::new().evaluation(|_| ());
    let mut bench = Bench::of_a_table();
    bench.hold_references_out();
    let files = bench.files();
    let html = text(&files, "report.html");
    let pictures = section(&html, "pictures");
    let strata: BTreeSet<String> = common::scenes().iter().map(|(_, stratum)| stratum.to_string()).collect();
    assert_eq!(pictures.matches("<tr title=").count(), strata.len());
    assert!(!html.contains("Input, ") && !pictures.contains(">none<") && files.contains_key("methods.png"));
    assert!(
        pictures.contains("<a href=\"viewer.html\">Open the viewer</a> of these scenes.") && !pictures.contains('∞')
    );
    // The best column by mean PSNR, and the scene of its median.
    type Column<'a> = (&'a BTreeMap<String, String>, u64);
    let mut psnr: BTreeMap<Column<'_>, Vec<(f64, &str)>> = BTreeMap::new();
    for row in evaluation.per_scene.iter().filter(|row| row.score.method != HOLD) {
        let scores = psnr.entry((&row.cell, row.score.nfe)).or_default();
        scores.push((row.score.metrics.hdr_psnr, &row.scene));
    }
    let sum = |of: &[(f64, &str)]| of.iter().map(|(value, _)| value).sum::<f64>();
    let best = psnr.values_mut().max_by(|a, b| sum(a).total_cmp(&sum(b))).expect("scores");
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (value, scene) = best[(best.len() - 1) / 2];
    let hero = between(&html, "<figure class=\"hero\">", "</figure>");
    let told = "the test scene with the median HDR PSNR of the best method. Captions: HDR PSNR.";
    assert!(hero.contains(&format!("<figcaption>{scene}: {told} <a href=\"viewer.html#scene=")), "{scene} {hero:.400}");
    assert!(hero.contains(&format!("</b> · {value:.2} dB</span>")), "{value}");
    assert_eq!(hero.matches("<img").count(), 3, "two methods and the reference");
    // The viewer alone has a link, too.
    bench.inputs.remove("refined");
    let files = bench.files();
    assert!(files.contains_key("viewer.html") && !files.contains_key("methods.png"));
    assert!(text(&files, "report.html").contains("<a href=\"viewer.html\">Open the viewer</a> of the scenes."));
}

#[test]
fn held_out_references_are_told_from_the_last_rung() {
    let mut bench = Bench::new();
    let nested = text(&bench.files(), "report.html");
    assert!(nested.contains("contains the samples of every other rung") && nested.contains("Input, 1 spp"));
    assert!(nested.contains("ladders of <b>9 rungs</b> from 1 to 256 samples per pixel at 12 × 12"));
    bench.hold_references_out();
    let html = text(&bench.files(), "report.html");
    assert!(html.contains("<p class=\"note\">The reference has 256 samples per pixel. Intervals are 95%"));
    let head = between(&html, "<header", "</header>");
    assert!(!["of every other rung", "rungs</b>", "σ²"].iter().any(|words| head.contains(words)), "{head:.2000}");
    assert!(html.contains("; references of 256 samples per pixel at 12 × 12; "));
    // No column for an input that is not there; gains are over its score.
    assert!(!html.contains("Input, 1 spp") && !section(&html, "pictures").contains(">none<"));
    let [hero, other] = [&html, &nested].map(|html| between(html, "<figure class=\"hero\">", "</figure>"));
    assert!(hero.contains("the test scene with the median gain. Captions: gain in HDR PSNR over the input."));
    let captions = |hero: &str| hero.matches("<span><b>").count();
    assert_eq!(captions(hero) + 1, captions(other), "{hero:.400}");
    let gains = |hero: &str| -> Vec<String> {
        hero.split(" · ").skip(1).map(|rest| rest.split('<').next().unwrap_or("").to_owned()).collect()
    };
    assert_eq!(gains(hero), gains(other));
    // Without references nothing is known of them.
    bench.inputs.remove("references");
    let html = text(&bench.files(), "report.html");
    assert!(html.contains("The reference has 256 samples per pixel.") && !html.contains("of every other rung"));
}

/// An interval of a single scene, as bootstraps make it.
fn collapse<'a>(estimates: impl IntoIterator<Item = &'a mut Estimate>) {
    estimates.into_iter().for_each(|of| (of.low, of.high) = (of.mean, of.mean));
}

/// A bench whose figures are all of so many scenes and groups, of which one is independent.
fn single(scenes: u64, groups: Option<u64>) -> Bench {
    let mut bench = Bench::new();
    bench.evaluation(|of| {
        (of.scenes, of.groups) = (scenes, groups);
        collapse(of.hold.values_mut());
        for table in of.methods.iter_mut().chain(&mut of.baselines) {
            collapse(table.at.iter_mut().flat_map(|at| at.metrics.values_mut().chain(at.gain.values_mut())));
            collapse(table.auc.values_mut().chain(table.tv.values_mut()));
        }
        collapse(of.versus.iter_mut().flat_map(|of| of.gain.values_mut()));
        for claim in &mut of.claims {
            claim.verdict = ClaimVerdict::Undecided;
            collapse(claim.evidence.iter_mut().map(|of| &mut of.difference));
        }
    });
    bench.change("bridge", |of: &mut BridgeFiles| (of.bridge.scenes, of.bridge.groups) = (scenes, groups));
    bench.change("time_error", |of: &mut TimeError| {
        of.groups = groups;
        of.scenes = scenes;
        of.methods.iter_mut().flat_map(|of| &mut of.points).for_each(|of| {
            (of.all.scenes, of.all.groups) = (scenes, groups);
        });
    });
    bench
}

#[test]
fn one_scene_or_one_group_has_means_without_intervals() {
    let only = "Intervals are omitted, because there is only one";
    let cases = [(1, None, format!("{only} scene.")), (24, Some(1), format!("{only} group of scenes of one content."))];
    for (scenes, groups, told) in cases {
        let mut bench = single(scenes, groups);
        let files = bench.files();
        let html = text(&files, "report.html");
        assert!(!html.contains("significant"), "{scenes} {groups:?}");
        let head = between(&html, "<header", "</header>");
        assert!(head.contains(&told) && !head.contains("95%"), "{head:.2000}");
        for id in ["ranking", "results", "curves", "baselines", "bridge"] {
            let section = section(&html, id);
            assert!(section.contains(&told), "{id}: {told}");
            for interval in ["class=\"ci\">[", "; 0%</span>", "class=\"band", "Bands are", "<b>Bold</b>"] {
                assert!(!section.contains(interval), "{id}: {interval}");
            }
        }
        assert!(section(&html, "conventions").contains("<dd>none for a single scene"));
        // The best of a column is marked all the same.
        assert!(section(&html, "results").contains("class=\"best\""));
        let baselines = section(&html, "baselines");
        assert!(!baselines.contains("<td><b>") && baselines.contains("<span class=\"ci\">62%</span>"));
        let time = section(&html, "time");
        let points = between(time, "Crossover (spp)", "</table>");
        assert!(!points.contains("class=\"ci\">["), "{points:.2000}");
        let claims = section(&html, "claims");
        assert!(claims.contains("Their claims are undecided.") && claims.contains("+0.31 <small></small>"), "{claims}");
        assert!(!claims.contains("\"range") && !claims.contains("mean above") && !claims.contains("mean below"));
        for (file, head) in [
            ("results.csv", "low,high,gain,gain_low,gain_high"),
            ("curves.csv", "auc_low,auc_high,tv,tv_low,tv_high"),
            ("versus.csv", "difference_low,difference_high"),
            ("claims.csv", "low,high"),
        ] {
            let csv = text(&files, file);
            let mut lines = csv.lines().map(|line| line.split(',').collect::<Vec<_>>());
            let heads = lines.next().expect("a head");
            let ends = head.split(',').filter(|name| name.ends_with("low") || name.ends_with("high"));
            let places: Vec<usize> = ends.map(|name| heads.iter().position(|of| *of == name).expect("there")).collect();
            for line in lines {
                assert_eq!(line.len(), heads.len(), "{line:?}");
                assert!(places.iter().all(|place| line[*place].is_empty()), "{file}: {line:?}");
            }
        }
        let points = text(&files, "time_error.csv");
        let all: Vec<&str> = points.lines().filter(|line| line.contains(",all,")).collect();
        assert!(!all.is_empty() && all.iter().all(|line| !line.contains(",10,8,12.5,")), "{all:?}");
        // Draws of the trainings have intervals of their own.
        assert!(claims.contains("<small> draws [") && text(&files, "claims.csv").contains(",-0.25,,,"));
        // Two scenes have them again.
        bench.evaluation(|of| (of.scenes, of.groups) = (2, None));
        assert!(section(&text(&bench.files(), "report.html"), "results").contains("class=\"ci\">["));
    }
}

#[test]
fn a_stratum_of_one_group_has_times_without_intervals_whatever_others_have() {
    let mut bench = Bench::new();
    bench.change("time_error", |of: &mut TimeError| {
        of.groups = Some(7);
        for point in of.methods.iter_mut().flat_map(|of| &mut of.points) {
            point.all.groups = Some(7);
            for (name, of) in &mut point.strata {
                of.groups = Some(if name == "L1-open" { 1 } else { 2 });
            }
        }
    });
    let points = text(&bench.files(), "time_error.csv");
    let of = |stratum: &str| {
        let lines = points.lines().filter(|line| line.contains(&format!(",{stratum},")));
        lines.filter(|line| line.contains(",10,8,12.5,")).count()
    };
    assert!(of("L1-open") == 0 && of("L0-open") > 0 && of("all") > 0, "{points}");
}

#[test]
fn groups_are_the_unit_of_intervals_of_differences_too() {
    let mut bench = Bench::new();
    let told = |bench: &Bench| {
        between(section(&text(&bench.files(), "report.html"), "baselines"), "with 95%", " and ").to_owned()
    };
    assert_eq!(told(&bench), " intervals over 7 groups of scenes of one content");
    bench.evaluation(|of| of.groups = None);
    assert_eq!(told(&bench), " intervals over 24 scenes");
}

#[test]
fn solvers_without_a_parameterization_have_their_names() {
    let mut bench = Bench::new();
    // Cells without the axis, and without the conditioning where it is RGB; each at two numbers of calls.
    let other = |own: &BTreeMap<String, String>| {
        let mut cell = own.clone();
        let method = cell.remove("parameterization").expect("a solver of ours");
        if cell["conditioning"] == "rgb" {
            cell.remove("conditioning");
        }
        cell.insert("method".into(), format!("own_{method}"));
        cell
    };
    let evaluation = bench.evaluation(|of| {
        of.methods.iter_mut().for_each(|table| table.cell = other(&table.cell));
        let twice = |of: &Versus| [1, 2].map(|nfe| Versus { cell: other(&of.cell), nfe, ..of.clone() });
        of.versus = of.versus.iter().flat_map(twice).collect();
    });
    let files = bench.files();
    let csv = text(&files, "versus.csv");
    let rows: Vec<&str> = csv.lines().skip(1).collect();
    for own in &evaluation.methods {
        let start = format!("{},{},,", own.method, own.conditioning);
        assert!(rows.iter().any(|row| row.starts_with(&start)), "{start} {}", rows[0]);
    }
    assert!(rows.iter().all(|row| !row.starts_with(',')), "{}", rows[0]);
    let html = text(&files, "report.html");
    let section = section(&html, "baselines");
    for name in ["MC noise, RGB", "MC noise, G-buffer", "Vanilla RF, RGB", "Local velocity, G-buffer"] {
        assert!(section.contains(&format!("<td class=\"left\">{name}</td>")), "{name}");
    }
    // A panel for each conditioning, and a line for each solver, in both drawings of a plot.
    let plots: Vec<&str> = section.split("<figure>").skip(1).collect();
    assert_eq!(plots.len(), 2);
    for plot in &plots {
        for method in Parameterization::ALL {
            let line = format!("class=\"line of-{}\"", method.name());
            assert_eq!(plot.matches(&line).count(), 2, "{line}");
        }
    }
    assert!(plots[0].contains("G-buffer minus OIDN") && plots[1].contains("RGB minus OIDN"), "{:.300}", plots[1]);
    // Solvers of one method are lines of their own.
    bench.evaluation(|of| of.methods.iter_mut().for_each(|table| table.method = "mc_noise".into()));
    let html = text(&bench.files(), "report.html");
    let plot = self::section(&html, "baselines").split("<figure>").nth(1).expect("a plot").to_owned();
    assert_eq!(plot.matches("class=\"line of-mc_noise\"").count(), 2 * Parameterization::ALL.len());
    // The names of a cell that no table has are its own.
    bench.evaluation(|of| of.versus[0].cell = cell("mc_velocity", "rgb"));
    assert!(text(&bench.files(), "versus.csv").lines().nth(1).expect("a row").starts_with("mc_velocity,rgb,,1,oidn"));
}
