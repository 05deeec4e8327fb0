//! The pages in headless Chromium: at three widths nothing overflows or is cut off, texts are large enough and have
//! contrast in light and dark, and the browser has nothing to say.

mod common;
mod made_up;

use common::{extras, item, run};
use serde_json::{Value, json};
use std::{collections::BTreeMap, fs, path::Path, sync::atomic::AtomicBool};
use tauflow_contract::{Collection, Context, FileTree, Handle, MemoryBlobs, Silent};
use tauflow_data::{
    Image,
    records::{Evaluation, Ladder, Rung, ScoreTable},
};
use tauflow_report::{AdapterReportParams, ReportParams};
use tauflow_testing::Browser;

/// Side of the pictures; the page that people see has larger ones.
const SIDE: usize = 48;

/// Opens all that is folded, and shows all panels of tabs.
const UNFOLD: &str = "document.querySelectorAll('details').forEach((d) => { d.open = true; }); \
    (() => { const s = document.createElement('style'); \
    s.textContent = '.tabs > .tab { display: block !important; }'; document.head.append(s); })()";

/// What is wider than the page, or reaches out of its drawing. Tables of more columns may scroll, that of baselines
/// already above 10: each of its metrics has an interval.
const OVERFLOW: &str = "((columns) => { const w = document.documentElement.clientWidth, bad = []; \
    const name = (e) => `${e.tagName}.${e.getAttribute('class')} ${e.textContent.slice(0, 40)}`; \
    if (document.documentElement.scrollWidth > w) bad.push(`page ${document.documentElement.scrollWidth}`); \
    for (const e of document.querySelectorAll('body *')) { if (!e.checkVisibility()) continue; \
    const r = e.getBoundingClientRect(), scroll = e.closest('.scroll'); \
    if (!r.width || e.matches('.tabs > input')) continue; \
    const most = e.closest('#baselines') ? Math.min(columns, 10) : columns; \
    const few = e === scroll && (e.querySelector('tr')?.children.length ?? 0) <= most; \
    if (few && e.scrollWidth > e.clientWidth + 1) bad.push(`cut by ${e.scrollWidth - e.clientWidth}: ${name(e)}`); \
    if ((r.right > w + 1 || r.left < -1) && (e === scroll || !scroll)) bad.push(`out: ${name(e)}`); \
    const svg = e.closest('svg'); if (svg && e.tagName === 'text') { const s = svg.getBoundingClientRect(); \
    if (r.right > s.right + 2 || r.left < s.left - 2 || r.top < s.top - 2 || r.bottom > s.bottom + 2) \
    bad.push(`out of its drawing: ${name(e)}`); } } return bad; })";

/// Texts that are too small, as seen.
const SMALL: &str = "(() => { const bad = []; for (const e of document.querySelectorAll('body *')) { \
    const text = [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()); \
    if (!text || !e.checkVisibility()) continue; const svg = e.closest('svg'); \
    const scale = svg ? svg.getScreenCTM().a : 1, size = parseFloat(getComputedStyle(e).fontSize) * scale; \
    if (size < 9.99) bad.push(`${size.toFixed(1)} ${e.tagName}.${e.getAttribute('class')} ${e.textContent}`); \
    } return bad; })()";

/// Pairs of text and background with too little contrast, by WCAG AA.
const CONTRAST: &str = "(() => { const parse = (c) => { const n = (c.match(/[\\d.]+(e-\\d+)?/g) || []).map(Number); \
    return c.startsWith('color(') ? n.map((v, i) => i < 3 ? v * 255 : v) : n; }; \
    const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; \
    const lum = (c) => { const [r, g, b] = c.map((v) => linear(v / 255)); \
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; }; \
    const back = (e) => { for (; e; e = e.parentElement) { const c = parse(getComputedStyle(e).backgroundColor); \
    if (c.length === 3 || c[3] > 0.5) return c; } throw new Error('no background'); }; const bad = new Set(); \
    for (const e of document.querySelectorAll('body *')) { \
    const text = [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()); \
    if (!text || !e.checkVisibility()) continue; const style = getComputedStyle(e); \
    const a = lum(parse(e.closest('svg') ? style.fill : style.color)), b = lum(back(e)); \
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05); \
    if (ratio < 4.5) bad.add(`${ratio.toFixed(2)} ${e.tagName}.${e.getAttribute('class')}`); } return [...bad]; })()";

/// A page with its files. `TAUFLOW_KEEP_PAGES` names a folder that keeps a copy, for people who want to look.
fn write(folder: &Path, files: &FileTree) {
    if let (Some(keep), Some(name)) = (std::env::var_os("TAUFLOW_KEEP_PAGES"), folder.file_name()) {
        put(&Path::new(&keep).join(name), files);
    }
    put(folder, files);
}

fn put(folder: &Path, files: &FileTree) {
    for (name, bytes) in files {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().expect("below the folder")).expect("temporary files");
        fs::write(path, bytes).expect("temporary files");
    }
}

/// Looks at a page at all widths.
fn look(browser: &mut Browser, page: &Path, what: &str) {
    // Tables of so many columns have room.
    for (width, columns) in [(400, 0), (900, 10), (1400, 20)] {
        browser.size(width, 900);
        browser.open(page);
        browser.eval(UNFOLD);
        assert_eq!(browser.eval(&format!("{OVERFLOW}({columns})")), json!([]), "{what} at {width}");
        assert_eq!(browser.eval(SMALL), json!([]), "{what} at {width}");
    }
    // The table that ranks all methods is never cut.
    browser.size(400, 900);
    let cut = "[...document.querySelectorAll('#ranking .scroll')].map(e => e.scrollWidth - e.clientWidth)";
    assert!(browser.eval(cut).as_array().is_some_and(|all| all.iter().all(|by| *by == json!(0))), "{what}");
    // The rows of the opening figure are equally long.
    for width in [400, 900, 1400] {
        browser.size(width, 900);
        let rows = browser.eval(
            "(() => { const rows = {}; for (const e of document.querySelectorAll('.hero > div > div')) { \
             const y = Math.round(e.getBoundingClientRect().top); rows[y] = (rows[y] ?? 0) + 1; } \
             return new Set(Object.values(rows)).size; })()",
        );
        assert!(rows.as_u64() <= Some(1), "{what} at {width}: {rows}");
    }
    for scheme in ["light", "dark"] {
        let features = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        browser.call("Emulation.setEmulatedMedia", features);
        assert_eq!(browser.eval(CONTRAST), json!([]), "{what}, {scheme}");
    }
    browser.call("Emulation.setEmulatedMedia", json!({ "features": [] }));
    assert!(browser.problems().is_empty(), "{what}: {:#?}", browser.problems());
}

/// The evaluation, changed.
fn with(
    blobs: &MemoryBlobs,
    inputs: &BTreeMap<&'static str, Collection>,
    change: impl FnOnce(&mut Evaluation),
) -> BTreeMap<&'static str, Collection> {
    let stop = AtomicBool::new(false);
    let ctx = Context::new(blobs, &Silent, &stop);
    let (_, artifact) = inputs["evaluation"].iter().next().expect("one item");
    let mut evaluation = Handle::<Evaluation>::new(artifact).and_then(|one| one.load(&ctx)).expect("an evaluation");
    change(&mut evaluation);
    let mut inputs = inputs.clone();
    inputs.insert("evaluation", [item(&ctx, "evaluation", &evaluation)].into_iter().collect());
    inputs
}

#[test]
fn a_report_fits_any_window_and_can_be_read() {
    let Some(mut browser) = Browser::start("the report") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let blobs = MemoryBlobs::default();
    let inputs = extras::all(&blobs, SIDE);
    let without_baselines = with(&blobs, &inputs, |of| {
        of.baselines.clear();
        of.versus.clear();
        of.notes.clear();
    });
    let mut without_solver = with(&blobs, &inputs, |of| {
        of.methods.clear();
        of.versus.clear();
        of.claims.clear();
        of.nfe.clear();
    });
    for port in ["refined", "losses", "timings", "bridge", "time_error"] {
        without_solver.remove(port);
    }
    let one_call = with(&blobs, &inputs, |of| {
        of.nfe.truncate(1);
        of.methods.iter_mut().for_each(|table| table.at.truncate(1));
    });
    let pages = [
        ("whole", inputs.clone()),
        ("no baselines", without_baselines),
        ("no solver", without_solver),
        ("one call", one_call),
    ];
    for (what, inputs) in pages {
        let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
        let own = folder.path().join(what);
        write(&own, &files);
        let page = own.join("report.html");
        look(&mut browser, &page, what);
        // Every section shows something.
        let empty = browser.eval(
            "[...document.querySelectorAll('section')] \
             .filter((s) => !s.querySelector('table, svg, img, dl, .forest')).map((s) => s.id)",
        );
        assert_eq!(empty, json!([]), "{what}");
        let html = fs::read_to_string(page).expect("written");
        for (section, there) in [("curves", ["whole", "no baselines"].contains(&what)), ("ranking", true)] {
            assert_eq!(html.contains(&format!("<section id=\"{section}\"")), there, "{section}, {what}");
        }
        assert_eq!(html.contains("solver"), what != "no solver", "{what}");
    }
    // A picture leads to its frame in the viewer, beside the reference.
    let page = folder.path().join("whole/report.html");
    browser.size(1400, 900);
    browser.open(&page);
    let links = "[...document.querySelectorAll('td a[href]')].map((a) => a.getAttribute('href'))";
    let links = browser.eval(links);
    let link = links.as_array().expect("links").iter().filter_map(Value::as_str).find(|link| link.contains("NFE"));
    let link = link.expect("a refined image").to_owned();
    browser.eval(&format!("location.href = {link:?}"));
    browser.wait("typeof now === 'object' && now.a !== null && now.b !== null");
    let shown = browser.eval("[index.frames[now.a.frame].id, index.frames[now.b.frame].id, state.mode]");
    let scene = browser.eval("index.scenes[state.scene].key");
    assert_eq!((&shown[1], &shown[2]), (&json!("rungs/256 spp"), &json!("wipe")));
    let id = shown[0].as_str().expect("a frame");
    assert!(id.contains("/NFE 1"), "{id}");
    assert!(link.contains(&scene.as_str().expect("a key").replace('-', "%2D")), "{link} {scene}");
    // By itself it opens with the input.
    browser.open(&folder.path().join("whole/viewer.html"));
    browser.wait("now.a !== null && now.b !== null");
    assert_eq!(browser.eval("[index.frames[now.a.frame].id, state.mode]"), json!(["rungs/1 spp", "wipe"]));
    assert!(browser.problems().is_empty(), "{:#?}", browser.problems());
}

#[test]
fn a_table_of_samplers_fits_any_window_and_can_be_read() {
    let Some(mut browser) = Browser::start("the report of tables") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&blobs, &Silent, &stop);
    let estimate = |mean: f64| json!({ "mean": mean, "low": mean - 0.5, "high": mean + 0.5 });
    let samplers = ["independent", "sobol"];
    let cells: Vec<Value> = samplers
        .iter()
        .enumerate()
        .flat_map(|(i, sampler)| {
            [1, 4, 16].map(|spp| {
                let mean = 20.0 + f64::from(spp).ln() * (3.0 + i as f64);
                json!({ "at": [sampler, spp], "items": 12, "metrics": { "hdr_psnr": estimate(mean) },
                    "difference": { "hdr_psnr": estimate(mean / 20.0 - 1.0) } })
            })
        })
        .collect();
    let table: ScoreTable = serde_json::from_value(json!({
        "title": "Two samplers", "row_axes": 1, "metrics": ["hdr_psnr"], "reference_spp": 1024, "items": 12,
        "resamples": 100, "per_item": [], "cells": cells, "formats": { "latex": false },
        "axes": [{ "name": "sampler", "type": "text", "values": samplers },
            { "name": "spp", "type": "integer", "values": [1, 4, 16] }],
        "against": { "axis": "sampler", "value": "independent" }
    }))
    .expect("a table");
    let image = Image::from_data(SIDE, SIDE, 3, vec![0.4; 3 * SIDE * SIDE]).expect("fits");
    let ladder = |sampler: &str| {
        let meta = json!({ "counts": [1, 16], "width": SIDE, "height": SIDE, "rejected": 0, "mean_path_length": 2.0 });
        let rungs = [1, 16].map(|spp| Rung { spp, image: image.clone() }).into();
        let meta = serde_json::from_value(meta).expect("a ladder");
        item(&ctx, &format!("sampler={sampler}/L0-open-000000"), &Ladder { meta, rungs, variance: image.clone() })
    };
    let inputs = BTreeMap::from([
        ("tables", [item(&ctx, "table", &table)].into_iter().collect()),
        ("ladders", samplers.map(ladder).into_iter().collect()),
    ]);
    let files = run(&blobs, ReportParams::default(), &inputs).expect("a report");
    let own = folder.path().join("samplers");
    write(&own, &files);
    look(&mut browser, &own.join("report.html"), "samplers");
    let charts = browser.eval("document.querySelectorAll('.plots').length");
    assert_eq!(charts, json!(2), "the values, and the paired differences");
}

#[test]
fn the_page_of_adapters_fits_any_window_and_can_be_read() {
    let Some(mut browser) = Browser::start("the page of adapters") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    write(
        folder.path(),
        &made_up::files(AdapterReportParams::default(), &made_up::quality(), 2).expect("sound inputs"),
    );
    look(&mut browser, &folder.path().join("adapter_report.html"), "adapters");
    // The viewer opens with the adapted image beside the frozen one, as they are: display values have no tone map.
    browser.size(1400, 900);
    browser.open(&folder.path().join("viewer.html"));
    browser.wait("now.a !== null && now.b !== null");
    let shown = browser.eval("[now.a, now.b].map((image) => index.frames[image.frame].id)");
    assert_eq!(shown, json!(["images/adapted", "images/frozen"]));
    let strata = browser.eval("[...$('stratum').options].map((option) => option.value)");
    assert_eq!(strata, json!(["", "ddpm_own", "rf_own"]));
    // The direction of the adapted image is what the adapter changed; steps follow each other.
    browser.key("5");
    browser.wait("$('tag-b').textContent === 'from images, frozen'");
    assert_eq!(browser.eval("state.mode"), json!("direction"));
    browser.open(&folder.path().join("adapter_report.html"));
    let link = "viewer.html#scene=rf%5Fown%2D0000&a=trajectory%3A%20adapted%2Fstep%2032&mode=wipe";
    assert_eq!(browser.eval(&format!("document.querySelectorAll('a[href=\"{link}\"]').length")), json!(1));
    browser.eval(&format!("location.href = '{link}'"));
    browser.wait("typeof now === 'object' && now.a !== null && index.frames[now.a.frame].label === 'step 32'");
    browser.key("ArrowLeft");
    browser.wait("index.frames[now.a.frame].label === 'step 28'");
    assert!(browser.problems().is_empty(), "{:#?}", browser.problems());
}
