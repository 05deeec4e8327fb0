//! The report over synthetic material: what it holds, and that its figures are those it was given.

mod common;

use common::{extras, run};
use serde_json::json;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{Collection, Context, FileTree, Handle, ItemKey, Media, MemoryBlobs, Silent};
use tauflow_data::{
    Image, SamplerKind,
    records::{BASIC, Convergence, Estimate, Evaluation, Ladder, METRICS, Rung, ScoreTable, higher_is_better},
};
use tauflow_report::ReportParams;

fn text(files: &FileTree, name: &str) -> String {
    String::from_utf8(files[name].clone()).expect("text files are UTF-8")
}

fn whole() -> (MemoryBlobs, BTreeMap<&'static str, Collection>, Evaluation) {
    let blobs = MemoryBlobs::default();
    let inputs = extras::all(&blobs, 12);
    let cancel = std::sync::atomic::AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let (_, artifact) = inputs["evaluation"].iter().next().expect("one item");
    let evaluation = Handle::<Evaluation>::new(artifact).and_then(|item| item.load(&ctx)).expect("an evaluation");
    (blobs, inputs, evaluation)
}

/// Every tag is closed in order; returns the number of elements.
fn check_nesting(html: &str) -> usize {
    const VOID: [&str; 10] = ["meta", "img", "br", "input", "line", "circle", "path", "!doctype", "hr", "link"];
    let (mut open, mut elements) = (Vec::new(), 0);
    let mut rest = html;
    while let Some(start) = rest.find('<') {
        let end = start + rest[start..].find('>').expect("every tag ends");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        let name = tag.trim_start_matches('/').split([' ', '/']).next().expect("a name");
        // A comment has no end of its own.
        if tag.starts_with("!--") {
            continue;
        }
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "before {}", &rest[..rest.len().min(120)]);
        } else if !VOID.contains(&name) && !tag.ends_with('/') {
            open.push(name);
            elements += 1;
            if name == "style" {
                rest = &rest[rest.find("</style>").expect("the style ends")..];
            }
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
    elements
}

/// Text between tags, one entry for each run.
fn texts(html: &str) -> Vec<&str> {
    html.split('<')
        .filter_map(|part| part.split_once('>'))
        .map(|(_, text)| text.trim())
        .filter(|t| !t.is_empty())
        .collect()
}

/// A line of CSV without quoted fields.
fn fields(line: &str) -> Vec<&str> {
    line.split(',').collect()
}

#[test]
fn the_page_stands_alone_and_is_well_formed() {
    let (blobs, inputs, _) = whole();
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let html = text(&files, "report.html");
    for outside in ["http://", "https://", "<script", "@import", "url(", "<link", "<iframe", "src=\"/", "file:"] {
        assert!(!html.contains(outside), "{outside}");
    }
    assert!(html.split("src=\"").skip(1).all(|rest| rest.starts_with("data:image/png;base64,")));
    let links: Vec<&str> = html.split("href=\"").skip(1).collect();
    assert!(links.iter().all(|rest| rest.starts_with('#') || rest.starts_with("viewer.html#scene=")));
    // Each picture of a scene leads to it in the viewer.
    let linked = links.iter().filter(|rest| rest.starts_with("viewer.html")).count();
    assert!(linked > 100, "{linked}");
    assert!(texts(&html).iter().all(|t| !t.contains("NaN") && *t != "inf" && *t != "-inf"));
    assert!(html.split(" d=\"").skip(1).all(|path| !path.split('"').next().unwrap_or("").contains(['N', 'i'])));
    assert!(check_nesting(&html) > 500);
    let all = [
        "ranking",
        "results",
        "curves",
        "strata",
        "baselines",
        "time",
        "pictures",
        "bridge",
        "training",
        "data",
        "rejected",
        "scenes",
        "convergence",
        "timings",
    ];
    for id in all {
        assert!(html.contains(&format!("<section id=\"{id}\"")), "{id}");
        assert!(html.contains(&format!("href=\"#{id}\"")), "{id}");
    }
    // A denoiser stands beside the solvers of its conditioning: in the heat map of a call, and as a line in each plot.
    let section = |id: &str| {
        let start = html.find(&format!("<section id=\"{id}\"")).expect("there");
        &html[start..start + html[start..].find("</section>").expect("it ends")]
    };
    let maps = section("strata");
    assert!(maps.contains("OIDN"));
    // The gain, and the values of HDR PSNR and of the metrics on request: each stratum in each.
    assert_eq!(maps.matches("class=\"wide heat\"").count(), 2 + METRICS.len() - BASIC.len());
    for words in ["Gain in HDR PSNR (dB)", "HDR-FLIP at NFE", "LPIPS at NFE", "HDR PSNR (dB) at NFE"] {
        assert!(maps.contains(words), "{words}");
    }
    let figures: Vec<&str> = section("curves").split("<figure>").skip(1).collect();
    // Each metric, the paired gains of two, and close-ups of HDR MAE.
    assert_eq!(figures.len(), 2 * (METRICS.len() + 3));
    for figure in figures.into_iter().filter(|figure| !figure.contains("close-up")) {
        assert_eq!(figure.contains("OIDN"), figure.contains("G-buffer"), "{}", texts(figure).join(" "));
    }
    // All methods stand in one table, the best first.
    let places: Vec<f64> = section("ranking")
        .split("<tr><td>")
        .skip(1)
        .filter_map(|row| row.split("<td>").nth(1)?.split('<').next()?.parse().ok())
        .collect();
    assert!(places.len() > 3 && places.is_sorted_by(|a, b| a >= b), "{places:?}");
    assert!(section("ranking").contains("OIDN") && section("ranking").contains("the input itself"));
    // The opening figure: input, best method, best of the other sort if it has an image, reference.
    let hero = &html[html.find("class=\"hero\"").expect("a figure")..];
    let hero = &hero[..hero.find("</figure>").expect("it ends")];
    assert!(hero.matches("<img").count() >= 3 && hero.contains("the test scene with the median gain"), "{hero}");
    assert!(hero.contains("Input, ") && hero.contains("Reference, "));
    assert!(!html.contains("not connected"));
    assert!(html.contains("contains the samples of every other rung"));
    // Then error against time; what machines and notes say is text.
    let opening = html.find("class=\"opening\"").expect("a chart");
    assert!(
        html.find("class=\"hero\"") < Some(opening)
            && opening < html.find("class=\"cards\"").expect("figures to remember")
    );
    assert!(
        html.contains("Abacus &lt;9&gt;") && html.contains("no library &lt;here&gt;") && html.contains("<b>10.0×</b>")
    );
    assert!(html.contains("Omitted: another: no library."));
}

#[test]
fn the_same_material_gives_the_same_files() {
    let (blobs, inputs, _) = whole();
    let first = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    assert_eq!(first, run(&blobs, ReportParams::default(), &inputs).expect("a report"));
    let names: Vec<&str> = first.keys().map(String::as_str).filter(|n| !n.starts_with("bridge/maps")).collect();
    assert_eq!(
        names,
        [
            "bridge/bridge.json",
            "bridge/cases.csv",
            "claims.csv",
            "convergence.csv",
            "curves.csv",
            "gate-accepted.png",
            "gate-black.png",
            "gate-near_constant.png",
            "gate-over_exposed.png",
            "montage-gbuffer-by-nfe.png",
            "montage-gbuffer.png",
            "montage-rgb-by-nfe.png",
            "montage-rgb.png",
            "per_scene.csv",
            "report.html",
            "results.csv",
            "results.json",
            "table.tex",
            "tables.tex",
            "time_error.csv",
            "time_error_scenes.csv",
            "time_error_targets.csv",
            "timings.csv",
            "versus.csv",
            "viewer.html"
        ]
    );
    assert_eq!(first.keys().filter(|n| n.starts_with("bridge/maps/")).count(), 10);
    assert!(first["montage-rgb.png"].starts_with(b"\x89PNG"));
}

#[test]
fn tables_hold_the_figures_with_best_and_second_marked() {
    let (blobs, inputs, evaluation) = whole();
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let html = text(&files, "report.html");
    for metric in METRICS {
        let digits = if metric.contains("psnr") { 2 } else { 4 };
        let start = html.find(&format!("data-metric=\"{metric}\"")).expect("a table for each metric");
        let table = &html[start..start + html[start..].find("</table>").expect("the table ends")];
        let rows: Vec<&str> = table.split("<tr").skip(2).collect();
        assert_eq!(rows.len(), 1 + evaluation.methods.len() + evaluation.baselines.len());
        assert!(rows[9].contains("OIDN") && rows[9].contains("G-buffer"));
        // The order of rows: method, then conditioning with RGB first; the evaluation has conditioning outermost.
        for (r, row) in rows.iter().enumerate().skip(1).take(evaluation.methods.len()) {
            let (method, conditioning) = ((r - 1) / 2, (r - 1) % 2);
            let given = &evaluation.methods[conditioning * 4 + method];
            let cells: Vec<&str> = row.split("<td").skip(3).collect();
            let figures = given.at.iter().map(|a| a.metrics[metric]).chain([given.auc[metric], given.tv[metric]]);
            for (cell, figure) in cells.iter().zip(figures) {
                let markup = format!("<td{cell}");
                let seen = texts(&markup);
                let zero = format!("-{:.digits$}", 0.0);
                let minus = |v: f64| format!("{v:.digits$}").replace(&zero, &zero[1..]).replace('-', "−");
                assert_eq!(seen[0], minus(figure.mean), "{metric}, row {r}");
                assert_eq!(seen[1], format!("[{}, {}]", minus(figure.low), minus(figure.high)));
            }
            assert_eq!(cells.len(), evaluation.nfe.len() + 2);
        }
        // At each NFE the printed best is bold, the next underlined.
        for (c, nfe) in evaluation.nfe.iter().enumerate() {
            let column: Vec<(f64, bool, bool)> = rows
                .iter()
                .filter_map(|row| {
                    let cell = row.split("<td").nth(3 + c).expect("a cell for each NFE");
                    // What is made in one go has figures at NFE 1 alone.
                    let value = texts(&format!("<td{cell}"))[0].replace('−', "-").parse().ok()?;
                    Some((value, cell.contains("class=\"best\""), cell.contains("class=\"second\"")))
                })
                .collect();
            let better = |a: f64, b: f64| if higher_is_better(metric) { a > b } else { a < b };
            for (value, best, second) in &column {
                let above = column.iter().filter(|o| better(o.0, *value)).count();
                let tops = column.iter().filter(|o| !column.iter().any(|p| better(p.0, o.0))).count();
                assert_eq!(*best, above == 0, "{metric} at NFE {nfe}: {value}");
                assert_eq!(*second, tops == 1 && above == 1, "{metric} at NFE {nfe}: {value}");
            }
        }
    }
}

#[test]
fn csv_and_json_read_back_exactly() {
    let (blobs, inputs, evaluation) = whole();
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let csv = text(&files, "results.csv");
    let mut lines = csv.lines();
    let head = fields(lines.next().expect("a head"));
    let mut seen = 0;
    for line in lines {
        let row: BTreeMap<&str, &str> = head.iter().copied().zip(fields(line)).collect();
        assert_eq!(row.len(), head.len(), "{line}");
        let (nfe, metric): (u64, &str) = (row["nfe"].parse().expect("a number"), row["metric"]);
        let number = |name: &str| row[name].parse::<f64>().expect("a number");
        let (mean, gain) = if row["method"] == "hold" {
            (evaluation.hold[metric], None)
        } else {
            let table = evaluation
                .methods
                .iter()
                .chain(&evaluation.baselines)
                .find(|t| t.method == row["method"] && t.conditioning == row["conditioning"])
                .expect("a known cell");
            let at = table.at.iter().find(|a| a.nfe == nfe).expect("a known NFE");
            (at.metrics[metric], Some(at.gain[metric]))
        };
        assert_eq!([number("mean"), number("low"), number("high")], [mean.mean, mean.low, mean.high]);
        if let Some(gain) = gain {
            assert_eq!([number("gain"), number("gain_low"), number("gain_high")], [gain.mean, gain.low, gain.high]);
        }
        seen += 1;
    }
    assert_eq!(
        seen,
        METRICS.len() * (1 + evaluation.methods.len() * evaluation.nfe.len() + evaluation.baselines.len())
    );
    assert_eq!(text(&files, "per_scene.csv").lines().count(), 1 + evaluation.per_scene.len());
    let versus = text(&files, "versus.csv");
    let figures = evaluation.versus.iter().flat_map(|of| METRICS.map(|metric| (of, metric)));
    let figures = figures.filter_map(|(of, metric)| Some((of, metric, of.gain.get(metric)?)));
    let rows: Vec<&str> = versus.lines().skip(1).collect();
    assert_eq!(rows.len(), figures.clone().count());
    for (row, (of, metric, gain)) in rows.iter().zip(figures) {
        let better = of.better.get(metric).map_or_else(String::new, f64::to_string);
        let end = format!("{},{metric},{},{},{},{better}", of.baseline["conditioning"], gain.mean, gain.low, gain.high);
        assert!(row.contains(&of.method) && row.ends_with(&end), "{row} {end}");
    }
    assert_eq!(text(&files, "curves.csv").lines().count(), 1 + evaluation.methods.len() * METRICS.len());
    let json: serde_json::Value = serde_json::from_str(&text(&files, "results.json")).expect("JSON");
    let back: Evaluation = serde_json::from_value(json["evaluation"].clone()).expect("an evaluation");
    assert_eq!(back, evaluation);
    let gate = json["gate"].as_object().expect("an object");
    assert_eq!(gate.values().map(|g| g["pool"].as_u64().expect("a count")).sum::<u64>(), 120);
}

#[test]
fn the_latex_tables_have_their_structure() {
    let (blobs, inputs, evaluation) = whole();
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let tex = text(&files, "table.tex");
    assert_eq!(tex.matches('{').count(), tex.matches('}').count());
    for once in [r"\begin{tabular}{lllrrrrrrr}", r"\toprule", r"\bottomrule", r"\end{tabular}", r"\label{tab:hdr-psnr}"]
    {
        assert_eq!(tex.matches(once).count(), 1, "{once}");
    }
    let rows: Vec<&str> = tex.lines().filter(|l| l.ends_with(r"\\") && !l.contains("multicolumn")).collect();
    assert_eq!(rows.len(), 2 + evaluation.methods.len() + evaluation.baselines.len());
    assert!(rows.iter().all(|r| r.matches('&').count() == 9), "{rows:?}");
    let best =
        &evaluation.methods.iter().find(|t| t.method == "mc_noise" && t.conditioning == "gbuffer").expect("there");
    assert!(tex.contains(&format!(r"\textbf{{{:.2}}}", best.at[0].metrics["hdr_psnr"].mean)));
    assert!(tex.contains(r"\underline{"));
    assert_eq!(text(&files, "tables.tex").matches(r"\begin{table}").count(), METRICS.len() - 1);
}

#[test]
fn claims_are_told_with_their_verdicts() {
    let (blobs, inputs, _) = whole();
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let html = text(&files, "report.html");
    let start = html.find("id=\"claims\"").expect("the section");
    let section = &html[start..start + html[start..].find("</section>").expect("it ends")];
    assert_eq!(section.matches("MC noise has the best AUC").count(), 1, "named once for all its groups");
    for words in ["<b>held</b>", "<b>undecided</b>", "<b>did not hold</b>", "+0.31", "−0.25"] {
        assert!(section.contains(words), "{words}: {section}");
    }
    let csv = text(&files, "claims.csv");
    assert_eq!(csv.lines().count(), 1 + 5);
    assert!(csv.lines().all(|line| line.split(',').count() == 10), "{csv}");
}

#[test]
fn a_table_and_ladders_need_no_evaluation() {
    let (blobs, _, _) = whole();
    let stop = AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &stop);
    let estimate = json!({ "ssim": { "mean": 0.5, "low": 0.25, "high": 0.75 } });
    let table: ScoreTable = serde_json::from_value(json!({
        "title": "Samplers", "row_axes": 1, "metrics": ["ssim"], "reference_spp": 64, "items": 3, "resamples": 100,
        "axes": [{ "name": "sampler", "type": "text", "values": ["sobol"] }], "per_item": [],
        "cells": [{ "at": ["sobol"], "items": 3, "metrics": estimate }], "formats": { "latex": true }
    }))
    .expect("a table");
    let one =
        |key: &str, artifact| -> Collection { [(ItemKey::new(key).expect("plain"), artifact)].into_iter().collect() };
    let stored = table.store(&ctx).expect("in memory").into_artifact();
    let mut inputs = BTreeMap::from([("tables", one("table", stored))]);
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let html = text(&files, "report.html");
    check_nesting(&html);
    assert!(html.contains("Best SSIM: <b>0.5000</b>") && !html.contains("not connected"), "{html}");
    assert!(files.contains_key("tables/table/table.tex") && !files.contains_key("results.csv"));
    let image = Image::from_data(4, 4, 3, vec![0.5; 48]).expect("fits");
    let meta = serde_json::from_value(json!({
        "counts": [2], "width": 4, "height": 4, "rejected": 0, "mean_path_length": 1.0
    }));
    let rungs = vec![Rung { spp: 2, image: image.clone() }];
    let ladder = Ladder { meta: meta.expect("a ladder"), rungs, variance: image };
    let stored = ladder.store(&ctx).expect("in memory").into_artifact();
    inputs.insert("ladders", one("sampler=sobol/L0-open-000000", stored));
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let html = text(&files, "report.html");
    assert!(html.contains("sampler sobol, 2 spp") && files.contains_key("pictures.png"));
    // The viewer has the ladder, and the variance of its samples.
    assert!(html.contains("viewer.html#scene=L0%2Dopen%2D000000&amp;a=rungs%3A%20sobol%2F2%20spp"), "{html}");
    let viewer = text(&files, "viewer.html");
    assert!(viewer.contains("\"id\":\"rungs: sobol/2 spp\"") && viewer.contains("\"content\":\"variance\""));
}

#[test]
fn the_viewer_has_variances_states_and_rejected_scenes() {
    let (blobs, inputs, _) = whole();
    let index = |files: &FileTree| -> serde_json::Value {
        let page = text(files, "viewer.html");
        let (_, rest) = page.split_once("id=\"index\">").expect("an index");
        serde_json::from_str(rest.split_once("</script>").expect("its end").0).expect("JSON")
    };
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let index = index(&files);
    let frames = index["frames"].as_array().expect("frames");
    let place =
        |id: &str| frames.iter().position(|frame| frame["id"] == json!(id)).unwrap_or_else(|| panic!("no {id}"));
    assert_eq!(frames[place("variance/per sample")]["content"], json!("variance"));
    // States stand between the rungs at their times, each after the one before, the first after the input.
    let track = "MC noise, G-buffer: states of NFE 2";
    let [first, last] = [1, 2].map(|call| place(&format!("{track}/call {call} of 2")));
    let (input, reference) = (place("rungs/1 spp"), place("rungs/256 spp"));
    let rungs = &frames[input]["track"];
    assert_eq!(&index["tracks"][frames[first]["track"].as_u64().expect("a number") as usize]["between"], rungs);
    assert_eq!((&frames[first]["before"], &frames[last]["before"]), (&json!(input), &json!(first)));
    let tau = |frame: usize| frames[frame]["tau"].as_f64().expect("a time");
    assert!((tau(first) - 0.5).abs() < 1e-9 && tau(last) == tau(reference) && tau(reference) == 1.0);
    assert!(!frames.iter().any(|frame| frame["id"].as_str().is_some_and(|id| id.contains("states of NFE 1/"))));
    // Rejected scenes have their previews and reasons, and the pictures of the page lead to them.
    let rejected: Vec<&serde_json::Value> = index["scenes"]
        .as_array()
        .expect("scenes")
        .iter()
        .filter(|scene| scene["reasons"].as_array().is_some_and(|reasons| !reasons.is_empty()))
        .collect();
    assert!(rejected.len() > 3 && rejected.iter().any(|scene| scene["reasons"] == json!(["black"])));
    place("preview/32 spp");
    let html = text(&files, "report.html");
    let key = rejected[0]["key"].as_str().expect("a key").replace('-', "%2D");
    assert!(html.contains(&format!("<a href=\"viewer.html#scene={key}&amp;")), "{key}");
    // Ladders of one cell that are packed as references are there for the viewer; several are shown side by side.
    let unique = |html: &str| {
        let ids: Vec<&str> = html.split("<section id=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(ids.len(), ids.iter().collect::<BTreeSet<_>>().len(), "{ids:?}");
    };
    unique(&html);
    assert!(!files.contains_key("pictures.png") && !html.contains("id=\"renders\""));
    let mut several = inputs.clone();
    let cells = ["sobol", "independent"].map(|sampler| {
        let own = inputs["ladders"].iter();
        own.map(move |(key, ladder)| (ItemKey::new(format!("sampler={sampler}/{key}")).expect("plain"), ladder.clone()))
    });
    several.insert("ladders", cells.into_iter().flatten().collect());
    let files = run(&blobs, ReportParams::default(), &several).expect("a report");
    let html = text(&files, "report.html");
    unique(&html);
    assert!(files.contains_key("pictures.png") && html.contains("<section id=\"renders\""));
    assert!(html.contains("sampler sobol, 1 spp"));
}

#[test]
fn a_table_shows_the_pictures_of_any_method() {
    let (blobs, all, _) = whole();
    let table: ScoreTable = serde_json::from_value(json!({
        "title": "Methods", "row_axes": 1, "metrics": ["ssim"], "reference_spp": 64, "items": 3, "resamples": 100,
        "axes": [{ "name": "method", "type": "text", "values": ["oidn"] }], "per_item": [],
        "cells": [], "formats": { "latex": false }
    }))
    .expect("a table");
    let stop = AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &stop);
    let stored = table.store(&ctx).expect("in memory").into_artifact();
    let mut inputs: BTreeMap<_, _> = ["references", "refined"].map(|port| (port, all[port].clone())).into();
    inputs.insert("tables", [(ItemKey::new("table").expect("plain"), stored)].into_iter().collect());
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let html = text(&files, "report.html");
    check_nesting(&html);
    assert!(html.contains("<figure class=\"hero\">") && files.contains_key("methods.png"));
    let (_, section) = html.split_once("<section id=\"pictures\"").expect("pictures");
    let rows = section.split("</section>").next().expect("its end").matches("<tr title=").count();
    let strata: BTreeSet<String> = common::scenes().iter().map(|(_, stratum)| stratum.to_string()).collect();
    assert_eq!(rows, strata.len(), "a scene for each stratum");
    // The scores are those of the evaluation: the input has the same in both reports.
    let other = text(&run(&blobs, ReportParams::default(), &all).expect("a report"), "report.html");
    let captions = |html: &str| -> Vec<String> {
        let (_, section) = html.split_once("<section id=\"pictures\"").expect("pictures");
        let first = section.split("<tr title=").nth(1).expect("a row").split("class=\"psnr").skip(1);
        first.map(|text| text.split('>').nth(1).unwrap_or("").split('<').next().unwrap_or("").to_owned()).collect()
    };
    assert_eq!(captions(&html)[0], captions(&other)[0]);
}

#[test]
fn whatever_is_not_connected_is_left_out_and_named() {
    let (blobs, inputs, _) = whole();
    let only: BTreeMap<_, _> =
        inputs.iter().filter(|(p, _)| **p == "evaluation").map(|(p, c)| (*p, c.clone())).collect();
    let files = run(&blobs, ReportParams::default(), &only).expect("a report");
    let html = text(&files, "report.html");
    check_nesting(&html);
    for id in ["time", "pictures", "bridge", "training", "data", "scenes", "convergence", "timings"] {
        assert!(!html.contains(&format!("id=\"{id}\"")), "{id}");
    }
    assert!(html.contains(
        "Omitted, because these inputs are not connected: references; refined; losses; timings; verdicts; previews; \
         split; sampling; bridge; convergence; time_error; statistics."
    ));
    assert!(!files.keys().any(|n| n.ends_with(".png") || n == "timings.csv" || n == "viewer.html"));
    // Each optional input alone, and all but each.
    for port in inputs.keys().filter(|p| **p != "evaluation") {
        let mut some = only.clone();
        some.insert(port, inputs[port].clone());
        check_nesting(&text(&run(&blobs, ReportParams::default(), &some).expect("a report"), "report.html"));
        let mut most = inputs.clone();
        most.remove(port);
        check_nesting(&text(&run(&blobs, ReportParams::default(), &most).expect("a report"), "report.html"));
    }
    let none = run(&blobs, ReportParams::default(), &BTreeMap::new()).expect_err("the evaluation is required");
    assert!(none.to_string().contains("evaluation"), "{none}");
}

#[test]
fn ladders_of_correlated_samples_have_slopes_but_no_moments() {
    let (blobs, mut inputs, _) = whole();
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let section = |inputs: &BTreeMap<&'static str, Collection>| {
        let files = run(&blobs, ReportParams::default(), inputs).expect("a report");
        let html = text(&files, "report.html");
        check_nesting(&html);
        let (_, section) = html.split_once("<section id=\"convergence\"").expect("the section");
        (section.split("</section>").next().expect("its end").to_owned(), text(&files, "convergence.csv"))
    };
    let said = |section: &str, of: &str| section.contains(of);
    let (law, correlated) = ("Variance time assumes", "The samples of these ladders are correlated");
    let (covariances, sde) = ("Variances and covariances of rungs", "The Monte Carlo SDE compared");
    let (independent, _) = section(&inputs);
    assert_eq!([law, correlated, covariances, sde].map(|of| said(&independent, of)), [true, false, true, true]);

    let (_, artifact) = inputs["convergence"].iter().next().expect("one item");
    let mut convergence =
        Handle::<Convergence>::new(artifact).and_then(|item| item.load(&ctx)).expect("what the ladders do");
    // The kind `convergence` leaves these out for such ladders.
    convergence.sampler = SamplerKind::Sobol;
    convergence.sde.clear();
    for scene in &mut convergence.scenes {
        (scene.variance, scene.off_normal, scene.image) = Default::default();
        (scene.excess_kurtosis, scene.trusted_from, scene.image_from) = (None, None, None);
        scene.trust = "none: samples are correlated".into();
    }
    for row in convergence.strata.iter_mut().chain([&mut convergence.overall]) {
        (row.mean, row.covariance, row.off_normal) = Default::default();
        (row.excess_kurtosis, row.trusted_from) = (None, None);
        row.slope =
            row.slope.map(|slope| Estimate { mean: slope.mean - 0.2, low: slope.low - 0.2, high: slope.high - 0.2 });
    }
    inputs.insert("convergence", [common::item(&ctx, "convergence", &convergence)].into_iter().collect());
    let (sobol, csv) = section(&inputs);
    assert_eq!([law, correlated, covariances, sde].map(|of| said(&sobol, of)), [false, true, false, false]);
    // Slopes stay, with their intervals, in which the law is not.
    let total =
        sobol.split("<tr class=\"total\"").nth(1).and_then(|row| row.split("</tr>").next()).expect("all scenes");
    let cells = texts(total);
    assert!(cells.contains(&"−0.698") && cells.contains(&"no") && !cells.contains(&"yes"), "{cells:?}");
    assert!(sobol.contains("none: samples are correlated") && !sobol.contains("\u{b1}"), "no variances of scenes");
    let scene = csv.lines().nth(1).expect("a scene");
    assert!(scene.ends_with(&",".repeat(4 * convergence.counts.len())), "{scene}");
}

#[test]
fn titles_cannot_inject_markup() {
    let (blobs, inputs, _) = whole();
    let params = ReportParams {
        title: "<script>alert(1)</script> & \"co\"".into(),
        subtitle: "a < b".into(),
        ..ReportParams::default()
    };
    let html = text(&run(&blobs, params, &inputs).expect("a report"), "report.html");
    assert!(!html.contains("<script"));
    assert!(
        html.contains("<h1>&lt;script&gt;alert(1)&lt;/script&gt; &amp; &quot;co&quot;</h1>")
            && html.contains("a &lt; b")
    );
    check_nesting(&html);
}

#[test]
fn timings_touch_their_own_section_alone() {
    let (blobs, mut inputs, _) = whole();
    let with = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    inputs.remove("timings");
    let without = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let differ: Vec<&String> = with.keys().filter(|n| with.get(*n) != without.get(*n)).collect();
    assert_eq!(differ, ["report.html", "timings.csv"]);
    assert!(text(&with, "report.html").contains("Timings (measured)"));
}

#[test]
fn an_nfe_that_was_not_evaluated_is_refused() {
    let (blobs, inputs, _) = whole();
    let params = ReportParams { montage_nfe: Some(3), ..ReportParams::default() };
    let error = run(&blobs, params, &inputs).expect_err("3 is not there").to_string();
    assert!(error.contains("montage_nfe: 3") && error.contains("[1, 2, 9, 20, 50]"), "{error}");
    let params = ReportParams { montage_nfe: Some(9), ..ReportParams::default() };
    let html = text(&run(&blobs, params, &inputs).expect("a report"), "report.html");
    assert!(html.contains("Results by stratum at NFE 9"));
    // Solvers with G-buffers may have their own, as in the paper.
    let params = ReportParams { montage_nfe: Some(1), montage_nfe_gbuffer: Some(9), ..ReportParams::default() };
    let both = run(&blobs, params, &inputs).expect("a report");
    assert!(text(&both, "report.html").contains("at NFE 1, those with G-buffers at NFE 9. Captions"));
    let same = ReportParams { montage_nfe: Some(1), ..ReportParams::default() };
    let same = run(&blobs, same, &inputs).expect("a report");
    for (file, differs) in [("montage-rgb.png", false), ("montage-gbuffer.png", true)] {
        assert_eq!(both[file] != same[file], differs, "{file}");
    }
    let params = ReportParams { montage_nfe_gbuffer: Some(3), ..ReportParams::default() };
    let error = run(&blobs, params, &inputs).expect_err("3 is not there").to_string();
    assert!(error.contains("montage_nfe_gbuffer: 3"), "{error}");
}

#[test]
fn spaces_seeds_and_infinite_scores_have_their_place() {
    let (blobs, mut inputs, mut evaluation) = whole();
    evaluation.nfe.truncate(1);
    for (i, table) in evaluation.methods.iter_mut().enumerate() {
        table.at.truncate(1);
        if i % 2 == 1 {
            table.space = "log1p".into();
            table.cell.insert("space".into(), "log1p".into());
        }
        table.cell.insert("seed".into(), "2".into());
    }
    // An image that equals its reference; JSON holds no infinity, so it is in the scenes alone.
    for row in evaluation.per_scene.iter_mut().filter(|r| r.score.method == "hold").take(1) {
        row.score.metrics.hdr_psnr = f64::INFINITY;
    }
    let cancel = std::sync::atomic::AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let item = common::item(&ctx, "evaluation", &evaluation);
    inputs.insert("evaluation", [item].into_iter().collect());
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let html = text(&files, "report.html");
    check_nesting(&html);
    for told in ["<th class=\"left\">Space</th>", "<td class=\"left\">seed 2</td>", "RGB, log1p space, seed 2", "∞"] {
        assert!(html.contains(told), "{told}");
    }
    let tex = text(&files, "table.tex");
    assert!(tex.contains(r"\begin{tabular}{lllrrr}") && tex.contains("log1p & "), "{tex}");
    assert!(text(&files, "per_scene.csv").lines().any(|l| l.contains(",hold,,,1,256,0,inf,")));
    assert!(text(&files, "results.csv").contains("log1p,local_velocity,rgb,seed 2,1,256,1,hdr_psnr,"));
}
