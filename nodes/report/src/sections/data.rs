//! How the benchmark's scenes came about: the gate, the split, the sampling.

use crate::{
    gate_sheets::explained,
    material::Material,
    page::Section,
    text::{count, escape, plural},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};
use tauflow_data::{
    StratumName,
    records::{Quota, REASONS, SamplingReport, SplitReport, Verdict},
};

/// The section; none if neither verdicts, split nor sampling is there.
pub fn section(material: &Material) -> Option<Section> {
    let mut body = String::new();
    if !material.verdicts.is_empty() {
        body.push_str(&gate(&material.verdicts));
    }
    if material.split.is_some() || material.sampling.is_some() {
        body.push_str(&sides(material.split.as_ref(), material.sampling.as_ref()));
    }
    (!body.is_empty()).then(|| Section::new("data", "Scenes: gate, split, sampling", body))
}

/// Counts of the gate in a stratum.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gate {
    /// Scenes of the pool.
    pub pool: u64,
    /// Scenes let through.
    pub accepted: u64,
    /// Scenes rejected, by their first reason.
    pub rejected: BTreeMap<String, u64>,
}

/// The gate's work by stratum; a scene with several reasons counts under its first.
pub fn gate_counts(verdicts: &[(String, Verdict)]) -> BTreeMap<String, Gate> {
    let mut out: BTreeMap<String, Gate> = BTreeMap::new();
    for (key, verdict) in verdicts {
        let stratum = StratumName::group_of(key);
        let gate = out.entry(stratum).or_default();
        gate.pool += 1;
        match verdict.reasons.first() {
            None => gate.accepted += 1,
            Some(reason) => *gate.rejected.entry(reason.clone()).or_default() += 1,
        }
    }
    out
}

fn reason_class(index: usize) -> String {
    format!("m{}", [3, 0, 4, 7, 6, 1, 5, 2][index % 8])
}

fn number(n: u64) -> String {
    if n == 0 { r#"<span class="zero">0</span>"#.into() } else { count(n) }
}

fn gate(verdicts: &[(String, Verdict)]) -> String {
    let strata = gate_counts(verdicts);
    let told: BTreeSet<&String> = strata.values().flat_map(|g| g.rejected.keys()).collect();
    let mut reasons: Vec<&String> = told.into_iter().collect();
    reasons.sort_by_key(|reason| REASONS.iter().position(|(name, _)| name == reason).unwrap_or(REASONS.len()));
    let (pool, accepted) = strata.values().fold((0, 0), |(p, a), g| (p + g.pool, a + g.accepted));
    let mut out = format!(
        "<h3>Quality gate</h3><p>The gate checked previews of {}, accepted {} and rejected {}. A scene with several \
         reasons is counted under its first.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>Stratum</th><th>Pool</th><th>Accepted</th><th class=\"left\" \
         style=\"padding-left:24px\">Share</th>",
        plural(pool, "scene"),
        count(accepted),
        count(pool - accepted)
    );
    for (i, reason) in reasons.iter().enumerate() {
        let _ = write!(
            out,
            r#"<th title="{}"><span class="key {}"></span>{}</th>"#,
            escape(explained(reason)),
            reason_class(i),
            escape(&reason.replace('_', " "))
        );
    }
    out.push_str("</tr></thead><tbody>");
    let mut total = Gate { pool, accepted, ..Gate::default() };
    for stratum in StratumName::in_order(strata.keys()) {
        let gate = &strata[&stratum];
        for (reason, n) in &gate.rejected {
            *total.rejected.entry(reason.clone()).or_default() += n;
        }
        gate_row(&mut out, &StratumName::label(&stratum), gate, &reasons, "");
    }
    gate_row(&mut out, "All", &total, &reasons, r#" class="total""#);
    out.push_str("</tbody></table></div>");
    out
}

fn gate_row(out: &mut String, name: &str, gate: &Gate, reasons: &[&String], class: &str) {
    let share = |n: u64| n as f64 / gate.pool.max(1) as f64 * 100.0;
    let _ = write!(
        out,
        "<tr{class}><td>{}</td><td>{}</td><td>{}</td><td class=\"left\" style=\"padding-left:24px\">\
         <span class=\"bar\"><i class=\"m2\" style=\"width:{:.1}%\"></i>",
        escape(name),
        count(gate.pool),
        number(gate.accepted),
        share(gate.accepted)
    );
    for (i, reason) in reasons.iter().enumerate() {
        let n = gate.rejected.get(*reason).copied().unwrap_or(0);
        if n > 0 {
            let _ = write!(out, r#"<i class="{}" style="width:{:.1}%"></i>"#, reason_class(i), share(n));
        }
    }
    out.push_str("</span></td>");
    for reason in reasons {
        let _ = write!(out, "<td>{}</td>", number(gate.rejected.get(*reason).copied().unwrap_or(0)));
    }
    out.push_str("</tr>");
}

fn sides(split: Option<&SplitReport>, sampling: Option<&SamplingReport>) -> String {
    let mut out = String::from("<h3>Split and sampling</h3>");
    if let Some(split) = split {
        let leaks = match split.leaks.len() as u64 {
            0 => "No content signature is on both sides".to_owned(),
            n => format!("<b>{} on both sides</b>", plural(n, "signature")),
        };
        let _ = write!(
            out,
            "<p>{} of scenes with equal content: {} for training, {} for testing. {leaks}; {}.{}</p>",
            plural(split.groups.len() as u64, "group"),
            count(split.sides.train),
            count(split.sides.test),
            match split.shared() {
                0 => "every group has one scene".to_owned(),
                1 => "1 group has several scenes, all on one side".to_owned(),
                n => format!("{} groups have several scenes, each group on one side", count(n as u64)),
            },
            match split.dropped.len() as u64 {
                0 => String::new(),
                n => format!(" {} omitted, because their content is on the opposite side.", plural(n, "scene")),
            }
        );
    }
    if let Some(sampling) = sampling {
        let _ = write!(
            out,
            "<p>Chosen: {} for training and {} for testing.{}</p>",
            plural(sampling.train.chosen, "scene"),
            plural(sampling.test.chosen, "scene"),
            sampling.notes.iter().map(|n| format!(" {}.", escape(&capital(n)))).collect::<String>()
        );
        for short in &sampling.short {
            let _ = write!(out, "<p><b>Short:</b> {}.</p>", escape(short));
        }
    }
    out.push_str("<div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Stratum</th>");
    if split.is_some() {
        out.push_str("<th>Split: train</th><th>Split: test</th>");
    }
    if sampling.is_some() {
        out.push_str("<th>Chosen: train</th><th>Chosen: test</th>");
    }
    out.push_str("</tr></thead><tbody>");
    let chosen = |quota: &Quota, stratum: &str| quota.strata.get(stratum).map_or(0, |q| q.chosen);
    let split_strata = split.into_iter().flat_map(|split| split.strata.keys());
    let chosen_strata = sampling.into_iter().flat_map(|s| s.train.strata.keys().chain(s.test.strata.keys()));
    for stratum in StratumName::in_order(split_strata.chain(chosen_strata)) {
        let _ = write!(out, "<tr><td>{}</td>", escape(&StratumName::label(&stratum)));
        if let Some(split) = split {
            let sides = split.strata.get(&stratum).copied().unwrap_or_default();
            let _ = write!(out, "<td>{}</td><td>{}</td>", number(sides.train), number(sides.test));
        }
        if let Some(s) = sampling {
            let (train, test) = (chosen(&s.train, &stratum), chosen(&s.test, &stratum));
            let _ = write!(out, "<td>{}</td><td>{}</td>", number(train), number(test));
        }
        out.push_str("</tr>");
    }
    out.push_str(r#"<tr class="total"><td>All</td>"#);
    if let Some(split) = split {
        let _ = write!(out, "<td>{}</td><td>{}</td>", count(split.sides.train), count(split.sides.test));
    }
    if let Some(s) = sampling {
        let _ = write!(out, "<td>{}</td><td>{}</td>", count(s.train.chosen), count(s.test.chosen));
    }
    out.push_str("</tr></tbody></table></div>");
    out
}

fn capital(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or_else(String::new, |c| c.to_uppercase().collect::<String>() + chars.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_count_under_their_first_reason() {
        let verdict = |reasons: &[&str]| Verdict {
            reasons: reasons.iter().map(|r| (*r).to_owned()).collect(),
            measures: BTreeMap::new(),
        };
        let verdicts = vec![
            ("L0-open-000000".to_owned(), verdict(&[])),
            ("L0-open-000001".to_owned(), verdict(&["black", "near_constant"])),
            ("L3-enclosed-000001".to_owned(), verdict(&["black"])),
        ];
        let counts = gate_counts(&verdicts);
        assert_eq!((counts["L0-open"].pool, counts["L0-open"].accepted), (2, 1));
        assert_eq!(counts["L0-open"].rejected["black"], 1);
        assert!(!counts["L0-open"].rejected.contains_key("near_constant"));
        assert_eq!(counts["L3-enclosed"].accepted, 0);
    }
}
