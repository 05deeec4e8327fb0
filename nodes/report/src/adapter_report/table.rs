//! The table of scores in the layout of the paper, and what the scores are.

use crate::{
    page::Section,
    text::{escape, fixed, interval, plural, signed},
};
use std::fmt::Write as _;
use tauflow_data::records::{
    BackboneQuality, Better, Estimate, Family, ImageQuality, ScoreColumn, Variant, VariantQuality,
};

/// The paper's columns.
const PAPER_SCORES: [&str; 4] = ["clipiqa", "musiq", "maniqa", "topiq_nr"];
/// The paper's figures: the family, then frozen and adapted ones.
///
/// # Source
/// The table of generative trajectory injection: LSUN church and bedroom backbones, 100 samples each.
const PAPER: [(Family, [f64; 4], [f64; 4]); 2] = [
    (Family::RectifiedFlow, [0.266, 51.222, 0.376, 0.500], [0.324, 51.588, 0.386, 0.492]),
    (Family::Ddpm, [0.493, 52.204, 0.430, 0.532], [0.539, 57.184, 0.520, 0.592]),
];

/// The name of a score for people.
pub(super) fn score_name(score: &str) -> String {
    match score {
        "mmd" => "MMD²".into(),
        "swd" => "SWD".into(),
        "niqe" => "NIQE".into(),
        "clipiqa" => "CLIPIQA".into(),
        "musiq" => "MUSIQ".into(),
        "maniqa" => "MANIQA".into(),
        "topiq_nr" => "TOPIQ-NR".into(),
        other => other.to_owned(),
    }
}

/// Decimals of figures of a column: about four significant ones of the largest.
pub(super) fn places<'a>(values: impl IntoIterator<Item = &'a Estimate>) -> usize {
    let largest = values.into_iter().map(|value| value.mean.abs()).filter(|v| v.is_finite()).fold(0.0, f64::max);
    match largest {
        v if v >= 1000.0 => 0,
        v if v >= 100.0 => 1,
        v if v >= 10.0 => 2,
        v if v >= 1.0 => 3,
        v if v >= 0.1 => 4,
        _ => 5,
    }
}

/// A score's name with an arrow to the better side.
pub(super) fn head(column: &ScoreColumn) -> String {
    let arrow = match column.better {
        Better::Higher => "↑",
        Better::Lower => "↓",
    };
    format!("{} {arrow}", escape(&score_name(&column.name)))
}

/// The variant of a backbone.
pub(super) fn variant(of: &BackboneQuality, variant: Variant) -> Option<&VariantQuality> {
    of.variants.iter().find(|its| its.variant == variant)
}

/// A backbone's name beside its family.
pub(super) fn backbone_name(of: &BackboneQuality) -> String {
    format!("{} <small>{}</small>", of.family.label(), escape(&of.backbone))
}

/// The section.
pub(super) fn section(quality: &ImageQuality) -> Section {
    let mut body = format!(
        "<p>Scores of {} of the frozen backbone, and of the same seeds with the adapter. Small print: 95% intervals \
         over samples and held-out renders. In parentheses: change relative to the frozen backbone. Arrows show \
         whether higher or lower is better.</p><div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Model</th>",
        samples(quality)
    );
    for column in &quality.columns {
        let _ = write!(body, "<th>{}</th>", head(column));
    }
    body.push_str("<th>Change</th></tr></thead><tbody>");
    for backbone in &quality.backbones {
        for (at, its) in backbone.variants.iter().enumerate() {
            let class = if at == 0 { r#" class="group""# } else { "" };
            let name = match its.variant {
                Variant::Frozen => format!("{} frozen", backbone_name(backbone)),
                Variant::Adapted => format!("{} + transport adapter", backbone.family.label()),
                control => format!("<span class=\"zero\">control: {}</span>", escape(control.label())),
            };
            let _ = write!(body, "<tr{class}><td>{name}</td>");
            for column in &quality.columns {
                body.push_str(&cell(quality, backbone, its, &column.name));
            }
            let change = if its.change == 0.0 { "0".to_owned() } else { format!("{:.2e}", its.change) };
            let _ = write!(body, "<td>{}</td></tr>", change.replace('-', "−"));
        }
    }
    body.push_str("</tbody></table></div>");
    body.push_str(&paper());
    Section::new("scores", "Scores", body)
}

fn samples(quality: &ImageQuality) -> String {
    let mut numbers: Vec<u64> = quality.backbones.iter().map(|backbone| backbone.samples).collect();
    numbers.sort_unstable();
    numbers.dedup();
    match numbers[..] {
        [only] => plural(only, "sample"),
        _ => "the samples".into(),
    }
}

fn cell(quality: &ImageQuality, backbone: &BackboneQuality, its: &VariantQuality, score: &str) -> String {
    let Some(value) = its.scores.get(score) else { return r#"<td class="zero">–</td>"#.into() };
    let column = quality.backbones.iter().flat_map(|of| &of.variants).filter_map(|of| of.scores.get(score));
    let digits = places(column);
    let frozen = variant(backbone, Variant::Frozen).and_then(|of| of.scores.get(score));
    let relative = match frozen {
        Some(frozen) if its.variant == Variant::Adapted && frozen.mean != 0.0 => {
            format!(" ({}%)", signed(100.0 * (value.mean - frozen.mean) / frozen.mean.abs(), 1))
        }
        _ => String::new(),
    };
    let judged = if score == quality.judged_by && its.variant == Variant::Adapted { " class=\"best\"" } else { "" };
    format!(
        "<td><span{judged}>{}{relative}</span><span class=\"ci\">{}</span></td>",
        fixed(value.mean, digits),
        interval(value, digits)
    )
}

/// The paper's figures.
fn paper() -> String {
    let mut out = String::from(
        "<h3>Results of the paper, for reference</h3><p>Published backbones of LSUN church and bedroom, 100 samples \
         each, η = 0.05. These values are not comparable with backbones trained on renders.</p><div \
         class=\"scroll\"><table class=\"wide\"><thead><tr><th>Model</th>",
    );
    for score in PAPER_SCORES {
        let _ = write!(out, "<th>{} ↑</th>", score_name(score));
    }
    out.push_str("</tr></thead><tbody>");
    for (family, frozen, adapted) in PAPER {
        let _ = write!(out, "<tr class=\"group\"><td>{} frozen</td>", family.label());
        for value in frozen {
            let _ = write!(out, "<td>{value:.3}</td>");
        }
        let _ = write!(out, "</tr><tr><td>{} + transport adapter</td>", family.label());
        for (value, base) in adapted.into_iter().zip(frozen) {
            let _ = write!(out, "<td>{value:.3} ({}%)</td>", signed(100.0 * (value / base - 1.0), 1));
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    out
}

/// What the scores are, and what was left out.
pub(super) fn conventions(quality: &ImageQuality) -> Section {
    let has = |name: &str| quality.columns.iter().any(|column| column.name == name);
    let mut body = String::from("<dl>");
    for (name, text) in [
        ("mmd", "Unbiased squared MMD to the held-out renders, on fixed random convolutional features."),
        ("swd", "Sliced Wasserstein distance to the held-out renders, on the same features."),
        ("niqe", "NIQE with a model fitted to clean renders."),
    ] {
        if has(name) {
            let _ = write!(body, "<dt>{}</dt><dd>{text}</dd>", score_name(name));
        }
    }
    let training = quality.training.map_or_else(String::new, |n| format!(", {} for training", plural(n, "render")));
    let _ = write!(
        body,
        "<dt>Renders</dt><dd>{} held out{training}.</dd><dt>Intervals</dt><dd>{} with replacement, of samples (with \
         all their variants) and of held-out renders.</dd><dt>Change</dt><dd>Largest difference of a value from the \
         frozen variant of the same sample.</dd>",
        plural(quality.references, "render"),
        plural(quality.resamples, "resample")
    );
    body.push_str("</dl>");
    for note in &quality.notes {
        let _ = write!(body, "<p class=\"note\">{}.</p>", escape(note.trim_end_matches('.')));
    }
    Section::new("conventions", "Definition of the scores", body)
}
