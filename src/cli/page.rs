//! The page of a run, `OUT/<pipeline>/index.html`: what is done, what runs, what failed, when, and the graph. It needs
//! no server and no network. While the run goes on, it asks the browser to load it again.

use super::{counted, seconds_text};
use crate::{
    pipeline::chart::{Chart, Look, Note, escaped},
    runs::{LiveNode, Outcome, RunRecord, Shown, date_text},
};
use std::{
    collections::BTreeMap,
    fmt::Write as _,
    path::{Path, PathBuf},
};

/// Seconds after which the page is loaded again.
const AGAIN: u32 = 3;
/// Tracks of the timeline, failures, folders, and links of each folder that are shown.
const MOST_TRACKS: usize = 48;
const MOST_FAILURES: usize = 30;
const MOST_FOLDERS: usize = 40;
const MOST_LINKS: usize = 60;
/// Size of the timeline.
const WIDTH: f64 = 1000.0;
const TRACK: f64 = 16.0;

const STYLE: &str = "\
body{font:15px/1.45 system-ui,sans-serif;color:#14263b;background:#fff;margin:0 auto;padding:1rem;max-width:72rem}
h1{font-size:1.5rem;margin:.2rem 0}h2{font-size:1.1rem;margin:1.6rem 0 .5rem}
.state{font-weight:600;padding:.1rem .6rem;border-radius:.6rem;white-space:nowrap}
.running{background:#fff4d6;color:#744210}.done{background:#e9f6ec;color:#22543d}
.failed,.error,.killed{background:#fdeaea;color:#9b2c2c}.interrupted{background:#eee;color:#333}
.facts{color:#51647a;font-size:.85rem;overflow-wrap:anywhere}
.wide{overflow-x:auto;border:1px solid #dde3ea;border-radius:.4rem;padding:.4rem}
.graph svg{max-width:100%;height:auto;display:block;margin:auto}#full:checked~.graph svg{max-width:none}
label{color:#51647a;font-size:.85rem}
table{border-collapse:collapse;font-size:.9rem}td,th{padding:.15rem .6rem;text-align:right;white-space:nowrap}
td:first-child,th:first-child{text-align:left}th{color:#51647a;font-weight:500}
td.text{text-align:left}.bar{display:block;width:8rem;height:.5rem;background:#e6eaf0;border-radius:.25rem}
.bar i{display:block;height:100%;border-radius:.25rem;background:#2f855a}
pre{white-space:pre-wrap;overflow-wrap:anywhere;background:#f6f8fa;padding:.5rem;margin:.2rem 0;font-size:.8rem}
details,p{overflow-wrap:anywhere}.timeline{min-width:40rem;width:100%;height:auto;display:block}
.key{display:flex;flex-wrap:wrap;gap:.2rem .9rem;font-size:.8rem;margin:.4rem 0}
.key i{display:inline-block;width:.8rem;height:.8rem;border-radius:.15rem;margin-right:.3rem;vertical-align:-1px}
@media(max-width:40rem){.bar{width:2.5rem}td,th{padding:.15rem .35rem}}
";

/// Shows the graph in full size, which a large one does not have at first.
const FULL: &str = "<input type=\"checkbox\" id=\"full\"> <label for=\"full\">full size</label>\n";

/// Says that the run is silent if the page is old, which only the browser can know.
const SCRIPT: &str = "\
const old=Date.now()/1000-Number(document.body.dataset.written);
if(old>30){const s=document.querySelector('.state');s.className='state killed';
s.textContent='no news for '+Math.round(old)+' s: killed, or not on this clock'}";

/// Colours of the timeline, told apart by lightness, too.
const COLOURS: [&str; 10] =
    ["#3d6ea5", "#e0a030", "#2f855a", "#a05195", "#d45087", "#5aa9c7", "#7a5c3a", "#8fae3e", "#665191", "#f07a55"];

/// The parts that do not change during the run.
pub(crate) struct Page {
    record: RunRecord,
    chart: Chart,
    /// The command that runs it again.
    again: String,
    /// The folder of the page.
    folder: PathBuf,
    colours: BTreeMap<String, &'static str>,
}

impl Page {
    pub(crate) fn new(record: &RunRecord, chart: Chart, order: &[String], again: String, folder: PathBuf) -> Self {
        let record = RunRecord { params: BTreeMap::new(), ..record.clone() };
        let colours = order.iter().zip(COLOURS.iter().cycle()).map(|(node, colour)| (node.clone(), *colour));
        Self { record, chart, again, folder, colours: colours.collect() }
    }

    /// The page as it is to be now.
    pub(crate) fn html(&self, shown: &Shown<'_>) -> String {
        let Shown { state, ended, .. } = shown;
        let going = ended.is_none();
        let record = &self.record;
        let name = escaped(&record.pipeline);
        let outcome = ended.map_or(Outcome::Running, |record| record.outcome);
        let mut out = String::from("<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n");
        if going {
            let _ = writeln!(out, "<meta http-equiv=\"refresh\" content=\"{AGAIN}\">");
        }
        let _ = write!(
            out,
            "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{name}: {}</title>\n\
             <style>{STYLE}</style></head>\n<body data-written=\"{}\">\n<h1>{name}</h1>\n",
            outcome.text(),
            crate::engine::now()
        );
        let elapsed = seconds_text(ended.map_or(state.elapsed_s, |record| record.elapsed_s));
        let word = if going { "for" } else { "after" };
        let _ = writeln!(
            out,
            "<p><span class=\"state {0}\">{0} {word} {elapsed}</span> {1}</p>",
            outcome.text(),
            summary(&state.nodes)
        );
        let commit = record.commit.as_ref().map_or_else(String::new, |hash| format!(", commit {}", escaped(hash)));
        let _ = writeln!(
            out,
            "<p class=\"facts\">run {} began {} UTC on {} ({} threads), tauflow {}{commit}<br><code>{}</code></p>",
            escaped(&record.id),
            date_text(record.started),
            escaped(&record.machine.host),
            record.machine.threads,
            escaped(&record.version),
            escaped(&record.command.join(" "))
        );
        if let Some(error) = ended.and_then(|record| record.error.as_ref()) {
            let _ = writeln!(out, "<h2>Error</h2>\n<pre>{}</pre>", escaped(error));
        }
        self.links(&mut out, shown.published);
        self.failures(&mut out, shown);
        self.nodes(&mut out, shown);
        self.timeline(&mut out, shown);
        let notes = state.nodes.iter().map(|node| (node.node.clone(), note(node, going))).collect();
        let _ = writeln!(out, "<h2>Graph</h2>\n{FULL}<div class=\"wide graph\">{}</div>", self.chart.svg(&notes));
        if going {
            let _ = writeln!(out, "<script>{SCRIPT}</script>");
        }
        out.push_str("</body></html>\n");
        out
    }

    fn links(&self, out: &mut String, published: &[PathBuf]) {
        if published.is_empty() {
            return;
        }
        let of = |path: &PathBuf| {
            let path: &Path = path.strip_prefix(&self.folder).unwrap_or(path);
            path.display().to_string()
        };
        let link = |text: &String| format!("<a href=\"{}\">{}</a>", address(text), escaped(text));
        let mut folders: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for text in published.iter().map(of) {
            let folder = text.rsplit_once('/').map_or("", |(folder, _)| folder);
            folders.entry(folder.to_owned()).or_default().push(text);
        }
        out.push_str("<h2>Results</h2>\n");
        // Reports first; then the other files beside them, and folders folded.
        let mut own = folders.remove("").unwrap_or_default();
        own.sort_by_key(|text| !text.ends_with(".html"));
        let own: Vec<String> = own.iter().map(link).collect();
        let _ = writeln!(out, "<p>{}</p>", own.join(" &middot; "));
        for (folder, files) in folders.iter().take(MOST_FOLDERS) {
            let links: Vec<String> = files.iter().take(MOST_LINKS).map(link).collect();
            let more = files.len().saturating_sub(MOST_LINKS);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let (folder, count) = (escaped(folder), counted(files.len() as u64, "file"));
            let _ = writeln!(
                out,
                "<details><summary>{folder}: {count}</summary><p>{}{more}</p></details>",
                links.join(" &middot; ")
            );
        }
        let more = folders.len().saturating_sub(MOST_FOLDERS);
        if more > 0 {
            let _ = writeln!(out, "<p>and {}</p>", counted(more as u64, "more folder"));
        }
    }

    fn failures(&self, out: &mut String, shown: &Shown<'_>) {
        let (failures, failed) = match shown.ended {
            Some(record) => (&record.failures, record.failed),
            None => (&shown.state.failures, shown.state.failed),
        };
        if failed == 0 {
            return;
        }
        let _ = writeln!(out, "<h2>Failures: {failed}</h2>");
        // Failures of one cause are shown once, with all their names.
        let mut causes: Vec<(&str, Vec<String>)> = Vec::new();
        for failure in failures {
            match causes.iter_mut().find(|(message, _)| *message == failure.message) {
                Some((_, names)) => names.push(failure.only()),
                None => causes.push((&failure.message, vec![failure.only()])),
            }
        }
        let mut shown = 0;
        for (message, names) in causes.iter().take(MOST_FAILURES) {
            shown += names.len() as u64;
            let more = match names.len() - 1 {
                0 => String::new(),
                more => format!(
                    "<details><summary>and {} with the same cause</summary><p>{}</p></details>",
                    counted(more as u64, "other"),
                    names[1..].iter().map(|name| escaped(name)).collect::<Vec<_>>().join(" &middot; ")
                ),
            };
            let _ = writeln!(
                out,
                "<p><b>{}</b></p><pre>{}</pre><p class=\"facts\">retry: <code>{} --only {}</code></p>{more}",
                escaped(&names[0]),
                escaped(message),
                escaped(&self.again),
                escaped(&super::quoted(&names[0]))
            );
        }
        if failed > shown {
            let _ = writeln!(out, "<p>and {} more</p>", failed - shown);
        }
    }

    fn nodes(&self, out: &mut String, shown: &Shown<'_>) {
        let state = shown.state;
        out.push_str("<h2>Nodes</h2>\n<div class=\"wide\"><table>\n<tr><th>node</th><th></th><th>as before</th>");
        out.push_str("<th>ran</th><th>running</th><th>to do</th><th>failed</th><th>blocked</th><th>time</th></tr>\n");
        for node in &state.nodes {
            let counts = &node.counts;
            let some = |n: u64| if n == 0 { String::new() } else { n.to_string() };
            let left = counts.expected.saturating_sub(counts.done()).saturating_sub(counts.running);
            let open = !node.known && shown.ended.is_none();
            let left = match (open, left) {
                (true, 0) => "?".to_owned(),
                (true, _) => format!("{left}+"),
                _ => some(left),
            };
            let share = if counts.expected == 0 { 0.0 } else { counts.done() as f64 / counts.expected as f64 };
            let _ = writeln!(
                out,
                "<tr><td>{}</td><td><span class=\"bar\"><i style=\"width:{:.0}%\"></i></span></td><td>{}</td>\
                 <td>{}</td><td>{}</td><td>{left}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                escaped(&node.node),
                (100.0 * share).min(100.0),
                some(counts.hit),
                some(counts.ran),
                some(counts.running),
                some(counts.failed),
                some(counts.blocked),
                if node.spent_s > 0.0 { seconds_text(node.spent_s) } else { String::new() }
            );
        }
        out.push_str("</table></div>\n");
        if state.running.is_empty() || shown.ended.is_some() {
            return;
        }
        let _ = writeln!(out, "<h2>Running: {}</h2>\n<div class=\"wide\"><table>", state.in_flight);
        for action in &state.running {
            let steps = if action.total > 0 { format!("{}/{}", action.done, action.total) } else { String::new() };
            let _ = writeln!(
                out,
                "<tr><td>{}</td><td>{}</td><td>{steps}</td><td class=\"text\">{}</td></tr>",
                escaped(&action.name()),
                seconds_text(action.for_s),
                escaped(&action.message)
            );
        }
        out.push_str("</table></div>\n");
    }

    fn timeline(&self, out: &mut String, shown: &Shown<'_>) {
        let tracks = &shown.timeline.tracks;
        if tracks.iter().all(Vec::is_empty) {
            return;
        }
        let total = shown.state.elapsed_s.max(1e-3);
        let drawn = tracks.len().min(MOST_TRACKS);
        let height = drawn as f64 * TRACK + 22.0;
        let _ = writeln!(
            out,
            "<h2>Timeline</h2>\n<div class=\"wide\"><svg class=\"timeline\" viewBox=\"0 0 {WIDTH} {height}\" \
             font-family=\"system-ui, sans-serif\" font-size=\"11\" fill=\"#51647a\">"
        );
        let x = |seconds: f64| seconds / total * WIDTH;
        let step = tick(total);
        let bottom = height - 18.0;
        let mut at = 0.0;
        while at <= total {
            let anchor = if at == 0.0 { "start" } else { "middle" };
            let _ = writeln!(
                out,
                "<path d=\"M{0:.1} 0 V{bottom}\" stroke=\"#e6eaf0\"/><text x=\"{0:.1}\" y=\"{1}\" \
                 text-anchor=\"{anchor}\">{2}</text>",
                x(at),
                height - 5.0,
                seconds_text(at)
            );
            at += step;
        }
        let mut named = Vec::new();
        for (number, bar) in
            tracks.iter().take(drawn).enumerate().flat_map(|(n, track)| track.iter().map(move |b| (n, b)))
        {
            let colour = self.colours.get(&*bar.node).copied().unwrap_or(COLOURS[0]);
            let parts = [&bar.node, &bar.cell, &bar.item];
            let name = parts.iter().filter(|part| !part.is_empty()).map(|part| &***part).collect::<Vec<_>>().join("/");
            let more = if bar.actions > 1 { format!(" and {} more", bar.actions - 1) } else { String::new() };
            let failed = if bar.failed { " stroke=\"#c53030\" stroke-width=\"2\"" } else { "" };
            let _ = writeln!(
                out,
                "<rect x=\"{:.2}\" y=\"{}\" width=\"{:.2}\" height=\"{}\" fill=\"{colour}\"{failed}><title>{}{more}: \
                 {}</title></rect>",
                x(bar.from),
                number as f64 * TRACK + 1.0,
                x(bar.to - bar.from).max(0.4),
                TRACK - 2.0,
                escaped(&name),
                seconds_text(bar.to - bar.from)
            );
            if !named.contains(&(&bar.node, colour)) {
                named.push((&bar.node, colour));
            }
        }
        out.push_str("</svg></div>\n<p class=\"key\">");
        for (node, colour) in named {
            let _ = write!(out, "<span><i style=\"background:{colour}\"></i>{}</span>", escaped(node));
        }
        out.push_str("</p>\n");
        if tracks.len() > drawn {
            let _ = writeln!(out, "<p class=\"facts\">{drawn} of {} tracks are shown</p>", tracks.len());
        }
    }
}

/// The line on a run that published pages are given.
pub(crate) fn account(record: &RunRecord) -> String {
    let commit = record.commit.as_ref().map_or_else(String::new, |hash| format!(", commit {}", escaped(hash)));
    let processor = record.machine.processor.trim();
    let machine = if processor.is_empty() { record.machine.host.as_str() } else { processor };
    format!(
        " Made by tauflow {}{commit}, {} UTC, on {} ({} threads), by <code>{}</code>.",
        escaped(&record.version),
        date_text(record.started),
        escaped(machine),
        record.machine.threads,
        escaped(&record.command.join(" "))
    )
}

/// A round distance of marks, of which there are at most ten.
fn tick(total: f64) -> f64 {
    let steps = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 1800.0, 3600.0];
    let fits = steps.into_iter().find(|step| total / step <= 10.0);
    fits.unwrap_or_else(|| (total / 10.0 / 3600.0).ceil() * 3600.0)
}

/// A path as the address of a link.
fn address(path: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~/".contains(&b);
    path.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

fn summary(nodes: &[LiveNode]) -> String {
    let total = |of: fn(&LiveNode) -> u64| nodes.iter().map(of).fold(0, u64::saturating_add);
    let (ran, hit, failed) = (total(|n| n.counts.ran), total(|n| n.counts.hit), total(|n| n.counts.failed));
    let failed = if failed > 0 { format!(", {failed} failed") } else { String::new() };
    format!("{} ran, {hit} as before{failed}", counted(ran, "action"))
}

/// The note of a node in the graph.
fn note(node: &LiveNode, going: bool) -> Note {
    let counts = &node.counts;
    let done = counts.hit + counts.ran;
    let finished = node.known && counts.done() == counts.expected;
    let look = match () {
        () if counts.failed + counts.blocked > 0 => Look::Failed,
        () if counts.running > 0 => Look::Running,
        () if finished && counts.expected > 0 => Look::Done,
        () => Look::Waiting,
    };
    let time = if node.spent_s > 0.0 { format!(", {}", seconds_text(node.spent_s)) } else { String::new() };
    let of = if finished || !going { done.to_string() } else { format!("{done} of {}", counts.expected) };
    let text = match counts.expected {
        0 => String::new(),
        _ if counts.ran == 0 && finished && counts.failed == 0 => format!("{done} as before"),
        _ => format!("{of} done{time}"),
    };
    Note { text, look }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_few_and_round() {
        for total in [0.01, 0.9, 7.0, 59.0, 400.0, 9000.0, 400_000.0] {
            assert!(total / tick(total) <= 10.0, "{total}");
        }
        assert_eq!((tick(7.0), tick(400.0), tick(400_000.0)), (1.0, 60.0, 43_200.0));
    }

    #[test]
    fn links_hold_no_other_signs() {
        assert_eq!(address("a b/x=1+y.html"), "a%20b/x%3D1%2By.html");
    }
}
