//! Training times: the one measured section.

use crate::{
    material::Cell,
    page::Section,
    ranking::{conditioning_name, conditioning_order, extra, method_order},
    sections::method_html,
    text::{count, escape, fixed},
};
use std::{collections::BTreeSet, fmt::Write as _};
use tauflow_data::{
    methods::axes::{CONDITIONING, PARAMETERIZATION, SPACE},
    records::TrainingTiming,
    timing::named,
};

fn machine_cell(timing: &TrainingTiming) -> String {
    format!("<td class=\"left\">{}</td>", escape(&named(&timing.machine).unwrap_or_else(|| "unknown".into())))
}

/// The section; none without timings.
pub fn section(timings: &[(Cell, TrainingTiming)]) -> Option<Section> {
    if timings.is_empty() {
        return None;
    }
    let get = |cell: &Cell, axis: &str| cell.get(axis).cloned().unwrap_or_default();
    let mut rows: Vec<&(Cell, TrainingTiming)> = timings.iter().collect();
    rows.sort_by_cached_key(|(cell, _)| {
        (
            get(cell, SPACE),
            method_order(&get(cell, PARAMETERIZATION)),
            conditioning_order(&get(cell, CONDITIONING)),
            extra(cell),
        )
    });
    let machines: BTreeSet<Option<String>> = rows.iter().map(|(_, timing)| named(&timing.machine)).collect();
    let several = machines.len() > 1;
    let place = match machines.first() {
        Some(Some(machine)) if !several => format!("on {}", escape(machine)),
        _ if several => "on several machines, so times of different machines cannot be compared".to_owned(),
        _ => "on the machine that ran the pipeline".to_owned(),
    };
    let mut out = format!(
        "<p class=\"note\">Measured {place}. Times vary from run to run; no result above \
         depends on them. For a resumed training, steps are those of the last run.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>Method</th><th class=\"left\">Conditioning</th><th>Steps</th><th>Time \
         (s)</th><th>Median step (ms)</th><th>Steps/s</th><th>Threads</th>{}</tr></thead><tbody>",
        if several { "<th class=\"left\">Machine</th>" } else { "" },
    );
    let mut total = 0.0;
    for (cell, timing) in rows {
        let more = extra(cell);
        let conditioning = get(cell, CONDITIONING);
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"left\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>{}</tr>",
            method_html(&get(cell, PARAMETERIZATION)),
            escape(
                &[conditioning_name(&conditioning), more]
                    .into_iter()
                    .filter(|t| !t.is_empty())
                    .collect::<Vec<_>>()
                    .join(", ")
            ),
            count(timing.steps),
            fixed(timing.seconds, 1),
            fixed(timing.median_step_ms, 1),
            if timing.seconds > 0.0 { fixed(timing.steps as f64 / timing.seconds, 1) } else { "–".into() },
            timing.threads,
            if several { machine_cell(timing) } else { String::new() }
        );
        total += timing.seconds;
    }
    let _ = write!(
        out,
        "<tr class=\"total\"><td>All</td><td></td><td></td><td>{}</td>\
         <td></td><td></td><td></td>{}</tr></tbody></table></div>",
        fixed(total, 1),
        if several { "<td></td>" } else { "" }
    );
    Some(Section { class: "measured", ..Section::new("timings", "Timings (measured)", out) })
}
