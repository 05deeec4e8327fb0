//! Bridge validation: stops from k to m on ladders that no model was trained on.

use crate::{
    page::{Section, tabs},
    ranking::{Rank, colour, method_name, rank},
    sections::{method_html, no_intervals, signed_print, small_print},
    svg::{Plot, Scale},
    text::{count, escape, fixed, png_uri, signed},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_data::{
    methods::{
        BridgeMethod, EXPECTATION, GAUSSIAN, GAUSSIAN_TAU, HOLD, LOCAL_DELTA, LOCAL_STEP, Parameterization, STOCHASTIC,
    },
    records::{Bridge, BridgeFiles, BridgeRow, Estimate, MomentsRow},
};

/// Order of rules.
const ORDER: [&str; 8] =
    [HOLD, GAUSSIAN, GAUSSIAN_TAU, LOCAL_DELTA, LOCAL_STEP, Parameterization::McNoise.name(), EXPECTATION, STOCHASTIC];

/// The section. `scenes` is how many scenes' maps are shown.
pub fn section(files: &BridgeFiles, scenes: usize) -> Section {
    let bridge = &files.bridge;
    let counts = bridge.rows.iter().flat_map(|r| [r.from_spp, r.to_spp]);
    let (first, last) = (counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0));
    let setting: Vec<String> = bridge.setting.iter().map(|(name, value)| format!("{name} {value}")).collect();
    let setting = if setting.is_empty() { String::new() } else { format!(" ({})", escape(&setting.join(", "))) };
    let mut out = format!(
        "<p>Solvers are stopped between rungs of {first} to {last} samples per pixel on {} scenes, and compared with \
         the <em>rendered</em> rung I<sub>m</sub>. The models{setting} were trained on ladders that end at \
         n<sub>max</sub> = {}. MC noise predicts I<sub>k</sub> + (τ<sub>m</sub> − τ<sub>k</sub>)/(1 − τ<sub>k</sub>) \
         (clean − I<sub>k</sub>), with τ of that ladder. The local delta adds the predicted difference to twice as \
         many samples at each stop, and the local step the part of it that belongs to one more sample. Images move in \
         linear radiance, or in log1p where the name says so. <em>Reference</em> in a name means that a held-out \
         reference stands in the network's place. I<sub>m</sub> contains the samples of I<sub>k</sub>, so hold is a \
         strong baseline.</p>",
        bridge.scenes, bridge.n_max
    );
    if !bridge.has_intervals() {
        let _ = write!(out, "<p class=\"note\">{}</p>", no_intervals("scene", bridge.groups));
    }
    out.push_str("<div class=\"grid2 tables\">");
    for (stop, title) in stops(bridge) {
        let _ = write!(out, "<div><h3>{title}</h3><div class=\"scroll\">{}</div></div>", summary(bridge, stop));
    }
    out.push_str("</div><div class=\"grid2 charts\">");
    let charts: [Shown; 2] = [("PSNR (dB)", |r| r.psnr), ("Gain over hold (dB)", |r| r.gain)];
    for shown in charts {
        let drawn = |row: &&BridgeRow| {
            let BridgeMethod { rule, log, reference } = BridgeMethod::of(&row.method);
            !log && !reference && rule != STOCHASTIC
        };
        let shown_rows = bridge.rows.iter().filter(drawn).map(shown.1);
        let y = Scale::linear(shown_rows.flat_map(|e| [e.mean, e.low, e.high]));
        for (stop, title) in stops(bridge) {
            let _ = write!(out, "<figure>{}</figure>", chart(bridge, stop, &title, shown, y));
        }
    }
    out.push_str("</div>");
    let mut panels: Vec<(String, String)> = Vec::new();
    for (stop, title) in stops(bridge) {
        for (reference, log) in [(false, false), (false, true), (true, false), (true, true)] {
            let of = |method: &BridgeMethod<'_>| (method.reference, method.log) == (reference, log);
            if bridge.rows.iter().any(|row| of(&BridgeMethod::of(&row.method)) && row.method != HOLD) {
                let space = BridgeMethod { reference, log, rule: HOLD }.space();
                let title = format!("{title}, {space}{}", if reference { ", reference" } else { "" });
                panels.push((title, by_k(bridge, stop, &of)));
            }
        }
    }
    if !panels.is_empty() {
        let _ = write!(out, "<details><summary>Tables by k</summary>{}</details>", tabs("bridge-rows", &panels));
    }
    out.push_str(&moments(bridge));
    out.push_str(&strips(&files.maps, scenes));
    let stops: BTreeMap<String, Vec<u8>> =
        files.maps.iter().filter(|(name, _)| !name.contains(STRIP)).map(|(a, b)| (a.clone(), b.clone())).collect();
    out.push_str(&maps(&stops, scenes));
    Section::new("bridge", "Bridge validation", out)
}

/// Kinds of stop that there are, with their titles.
fn stops(bridge: &Bridge) -> Vec<(&str, String)> {
    let known = [("adjacent", "Adjacent stops, k → k + 1"), ("direct", "Direct stops")];
    let mut out = Vec::new();
    for (stop, title) in known {
        if let Some(row) = bridge.rows.iter().find(|r| r.stop == stop) {
            let title = if stop == "direct" { format!("{title}, k → {}", row.to_spp) } else { title.to_owned() };
            out.push((stop, title));
        }
    }
    out
}

/// Order of methods: of the network first, linear first, then by rule.
fn order(method: &str) -> (bool, bool, usize) {
    let BridgeMethod { rule, log, reference } = BridgeMethod::of(method);
    (reference, log, ORDER.iter().position(|m| *m == rule).unwrap_or(ORDER.len()))
}

fn summary(bridge: &Bridge, stop: &str) -> String {
    let mut rows: Vec<_> = bridge.summary.iter().filter(|s| s.stop == stop).collect();
    rows.sort_by_key(|s| (order(&s.method), s.method.clone()));
    // References are no methods that one could choose.
    let own = |method: &str| !BridgeMethod::of(method).reference;
    let column: Vec<Option<f64>> = rows.iter().map(|r| own(&r.method).then_some(r.psnr.mean)).collect();
    let ranks = rank(&column, true, 2);
    let mut out = String::from(
        "<table class=\"wide\"><thead><tr><th>Method</th><th>Cases</th><th>PSNR (dB)</th><th>Gain over \
         hold</th><th>Better than hold</th></tr></thead><tbody>",
    );
    for (row, rank) in rows.iter().zip(ranks) {
        let mean = fixed(row.psnr.mean, 2);
        let mean = match rank {
            Rank::Best => format!("<b class=\"best\">{mean}</b>"),
            Rank::Second => format!("<span class=\"second\">{mean}</span>"),
            Rank::Other => mean,
        };
        let (gain, better) = if row.method == HOLD {
            ("<span class=\"zero\">–</span>".to_owned(), "<span class=\"zero\">–</span>".to_owned())
        } else {
            (
                signed(row.gain.mean, 2) + &signed_print(&row.gain, 2, bridge.has_intervals()),
                format!("{}%", fixed(row.better * 100.0, 0)),
            )
        };
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{mean}{}</td><td>{gain}</td><td>{better}</td></tr>",
            method_html(&row.method),
            count(row.cases),
            small_print(&row.psnr, 2, bridge.has_intervals())
        );
    }
    out + "</tbody></table>"
}

/// Rows of a kind of stop, by method in order.
fn by_method<'a>(
    bridge: &'a Bridge,
    stop: &str,
    of: &dyn Fn(&BridgeMethod<'_>) -> bool,
) -> Vec<(&'a str, Vec<&'a BridgeRow>)> {
    let mut map: BTreeMap<(_, &str), Vec<&BridgeRow>> = BTreeMap::new();
    for row in bridge.rows.iter().filter(|r| r.stop == stop && of(&BridgeMethod::of(&r.method))) {
        map.entry((order(&row.method), row.method.as_str())).or_default().push(row);
    }
    map.into_iter()
        .map(|((_, method), mut rows)| {
            rows.sort_by_key(|r| r.from_spp);
            (method, rows)
        })
        .collect()
}

/// A chart: the title, and the figure of a row.
type Shown = (&'static str, fn(&BridgeRow) -> Estimate);

fn chart(bridge: &Bridge, stop: &str, title: &str, shown: Shown, y: Scale) -> String {
    // The drawn noise of `stochastic` is far below the others by PSNR, which is no measure of it.
    let of = |method: &BridgeMethod<'_>| !method.reference && !method.log && method.rule != STOCHASTIC;
    let methods = by_method(bridge, stop, &of);
    let (what, figure) = shown;
    let ks: Vec<u64> = methods.first().map(|(_, rows)| rows.iter().map(|r| r.from_spp).collect()).unwrap_or_default();
    let mut plot = Plot::new([560.0, 290.0], [48.0, 96.0, 34.0, 40.0], Scale::linear(ks.iter().map(|k| *k as f64)), y);
    plot.title(&format!("{what}: {title}")).y_axis(6);
    plot.x_axis(ks.iter().map(|k| (*k as f64, k.to_string())), "k, samples before");
    for (method, rows) in methods.iter().filter(|(method, _)| *method != HOLD && bridge.has_intervals()) {
        let band: Vec<_> = rows.iter().map(|r| (r.from_spp as f64, figure(r).low, figure(r).high)).collect();
        plot.band(&band, &colour(method));
    }
    for (method, rows) in &methods {
        let class = colour(method);
        let points: Vec<_> = rows.iter().map(|r| (r.from_spp as f64, figure(r).mean)).collect();
        if *method == HOLD {
            plot.line(points.iter().copied(), &format!("{class} dashed"));
        } else {
            plot.line(points.iter().copied(), &class).dots(points.iter().copied(), 3.2, &class);
        }
        if let Some((_, last)) = points.last() {
            plot.end_label(*last, &class, &method_name(method));
        }
    }
    plot.finish(&format!("{what} by k, {title}; the values are in the tables of this section"))
}

fn by_k(bridge: &Bridge, stop: &str, of: &dyn Fn(&BridgeMethod<'_>) -> bool) -> String {
    let methods = by_method(bridge, stop, of);
    let mut out = String::from("<div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Stop</th><th>Fraction</th>");
    for (method, _) in &methods {
        let _ = write!(out, "<th>{}</th>", escape(&method_name(method)));
    }
    out.push_str("</tr></thead><tbody>");
    let rows = methods.first().map_or(0, |(_, rows)| rows.len());
    for i in 0..rows {
        let first = methods[0].1[i];
        let ranks = rank(&methods.iter().map(|(_, r)| r.get(i).map(|r| r.psnr.mean)).collect::<Vec<_>>(), true, 2);
        let _ = write!(out, "<tr><td>{} → {}</td><td>{}</td>", first.from_spp, first.to_spp, fixed(first.fraction, 3));
        for ((_, rows), rank) in methods.iter().zip(ranks) {
            let class = match rank {
                Rank::Best => "best",
                Rank::Second => "second",
                Rank::Other => "",
            };
            let _ = match rows.get(i) {
                Some(r) => write!(
                    out,
                    "<td><span class=\"{class}\">{}</span>{}</td>",
                    fixed(r.psnr.mean, 2),
                    small_print(&r.psnr, 2, bridge.has_intervals())
                ),
                None => write!(out, "<td class=\"zero\">–</td>"),
            };
        }
        out.push_str("</tr>");
    }
    out + "</tbody></table></div>"
}

/// Variances and covariances against those of the real rungs, by stop; empty without references.
fn moments(bridge: &Bridge) -> String {
    let is_shown = |row: &&BridgeRow| [EXPECTATION, STOCHASTIC].contains(&BridgeMethod::of(&row.method).rule);
    let shown: Vec<(&BridgeRow, &MomentsRow)> =
        bridge.rows.iter().filter(is_shown).filter_map(|row| Some((row, row.moments.as_ref()?))).collect();
    let mut methods: Vec<&str> = shown.iter().map(|(row, _)| row.method.as_str()).collect();
    methods.sort_by_key(|method| order(method));
    methods.dedup();
    if methods.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<h3>Variances and covariances</h3><p>Around a held-out reference, each stop has a variance, and a covariance \
         with I<sub>k</sub>. The table shows by how much they exceed those of the rendered rung. Given the converged \
         image, the expectation of I<sub>m</sub> is 1 − k/m of the way to it, with too little variance; the stochastic \
         bridge adds the variance σ²(m − k)/m² of the samples that are missing.</p><details open><summary>Excess by \
         stop</summary><div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Stop</th>",
    );
    for method in &methods {
        let name = escape(&method_name(method));
        let _ = write!(out, "<th>{name}, variance</th><th>{name}, covariance</th>");
    }
    out.push_str("</tr></thead><tbody>");
    let mut stops: Vec<(&str, u64, u64)> =
        shown.iter().map(|(row, _)| (row.stop.as_str(), row.from_spp, row.to_spp)).collect();
    stops.sort_unstable();
    stops.dedup();
    let percent = |of: &Estimate| {
        let value = |v: f64| format!("{}%", signed(100.0 * v, 1));
        match bridge.has_intervals() {
            true => format!("{}<span class=\"ci\">[{}, {}]</span>", value(of.mean), value(of.low), value(of.high)),
            false => value(of.mean),
        }
    };
    for (stop, from, to) in stops {
        let _ = write!(out, "<tr><td>{from} → {to}</td>");
        for method in &methods {
            let at = |row: &BridgeRow| (row.stop.as_str(), row.from_spp, row.method.as_str()) == (stop, from, *method);
            let _ = match shown.iter().find(|(row, _)| at(row)) {
                Some((_, of)) => {
                    write!(out, "<td>{}</td><td>{}</td>", percent(&of.excess), percent(&of.covariance_excess))
                }
                None => write!(out, "<td class=\"zero\">–</td><td class=\"zero\">–</td>"),
            };
        }
        out.push_str("</tr>");
    }
    out + "</tbody></table></div></details>"
}

/// What names of strips contain.
const STRIP: &str = "/strip-";

/// Names and PNGs of pictures, by folder.
type Folders<'a> = BTreeMap<&'a str, Vec<(&'a str, &'a [u8])>>;

/// The pictures of the first scenes; those of the first one are open.
fn pictures(out: &mut String, folders: Folders<'_>, scenes: usize) {
    for (i, (folder, files)) in folders.into_iter().take(scenes).enumerate() {
        let open = if i == 0 { " open" } else { "" };
        let _ = write!(out, "<details{open}><summary>{}</summary><div class=\"maps\">", escape(folder));
        for (file, png) in files {
            let name = map_name(file);
            let _ = write!(
                out,
                "<figure><img alt=\"{0}\" src=\"{1}\"><figcaption>{0}</figcaption></figure>",
                escape(&name),
                png_uri(png)
            );
        }
        out.push_str("</div></details>");
    }
}

/// The strips of the first scenes, one row a stop.
fn strips(maps: &BTreeMap<String, Vec<u8>>, scenes: usize) -> String {
    let mut folders = Folders::new();
    for (name, png) in maps {
        if let Some((folder, file)) = name.split_once(STRIP) {
            folders.entry(folder).or_default().push((file.trim_end_matches(".png"), png));
        }
    }
    if folders.is_empty() || scenes == 0 {
        return String::new();
    }
    let mut out = String::from(
        "<h3>Bridge stops of MC noise</h3><p>From left to right: the input I<sub>k</sub>, the stop, the rendered rung \
         I<sub>m</sub>, the update (grey is none), and the absolute difference of the stop to I<sub>m</sub> (black is \
         none, white the largest).</p>",
    );
    pictures(&mut out, folders, scenes);
    out
}

/// A map's name for people: `adjacent-01` is the adjacent stop from k = 1.
fn map_name(file: &str) -> String {
    match file.rsplit_once('-').and_then(|(stop, k)| Some((stop, k.parse::<u64>().ok()?))) {
        Some((stop, k)) => format!("{stop} stop, k = {k}"),
        None => file.replace(['/', '_'], " "),
    }
}

/// The maps of the first scenes, by folder.
fn maps(maps: &BTreeMap<String, Vec<u8>>, scenes: usize) -> String {
    let mut folders = Folders::new();
    for (name, png) in maps {
        let (folder, file) = name.split_once('/').unwrap_or(("", name));
        folders.entry(folder).or_default().push((file.trim_end_matches(".png"), png));
    }
    if folders.is_empty() || scenes == 0 {
        return String::new();
    }
    let more = folders.len().saturating_sub(scenes);
    let mut out = String::from(
        "<h3>Update directions and absolute differences</h3><p>Upper row of each picture: the rendered update \
         I<sub>m</sub> − I<sub>k</sub>, then the update of each method. Grey means no change, brighter more light, \
         darker less light, and a tint a change of colour. Lower row: absolute difference to I<sub>m</sub> for hold \
         and for each method, from black (none) through red and yellow to white (largest).</p>",
    );
    pictures(&mut out, folders, scenes);
    if more > 0 {
        let _ = write!(
            out,
            "<p class=\"note\">Images of {more} more scenes are in <code>bridge/maps/</code> next to this page.</p>"
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_named_by_their_stop() {
        assert_eq!(map_name("adjacent-01"), "adjacent stop, k = 1");
        assert_eq!(map_name("over_view"), "over view");
        let png = |name: &str| (name.to_owned(), vec![1u8]);
        let html = maps(&BTreeMap::from([png("a/adjacent-01.png"), png("b/direct-02.png")]), 1);
        assert!(html.contains("k = 1") && !html.contains("k = 2") && html.contains("Images of 1 more"));
        let html = strips(&BTreeMap::from([png("a/strip-adjacent-01.png"), png("a/direct-02.png")]), 1);
        assert!(html.contains("adjacent stop, k = 1") && !html.contains("direct"));
    }
}
