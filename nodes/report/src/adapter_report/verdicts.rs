//! Whether the adapter's gain is physical, and whether the backbones have learned what renders look like.

use super::table::{backbone_name, places, score_name};
use crate::{
    page::Section,
    text::{count, escape, fixed, interval, plural, signed},
};
use std::fmt::Write as _;
use tauflow_data::records::{BackboneQuality, ClaimVerdict, Estimate, ImageQuality};

fn verdict(verdict: ClaimVerdict) -> &'static str {
    match verdict {
        ClaimVerdict::Held => "held",
        ClaimVerdict::NotHeld => "did not hold",
        ClaimVerdict::Undecided => "undecided",
    }
}

/// The abstract: what was compared, and on how many backbones the gain is physical.
fn summary(quality: &ImageQuality) -> String {
    let all = &quality.backbones;
    let names: Vec<String> = all.iter().map(backbone_name).collect();
    let samples: u64 = all.iter().map(|backbone| backbone.samples).sum();
    let judged: Vec<_> = all.iter().filter_map(|backbone| backbone.claim.as_ref()).collect();
    let held = judged.iter().filter(|claim| claim.verdict == ClaimVerdict::Held).count();
    let found = if judged.is_empty() {
        "None of the samples are adapted.".to_owned()
    } else {
        format!(
            "By {}, the gain of the adapter is physical on <b>{held} of {}</b>.",
            escape(&score_name(&quality.judged_by)),
            plural(judged.len() as u64, "backbone")
        )
    };
    format!(
        "<p class=\"lead\">{} drew <b>{}</b>, each with the same noise in all variants, and {} held-out renders are \
         the reference. {found}</p>",
        if names.is_empty() { "No backbone".to_owned() } else { names.join(" and ") },
        plural(samples, "sample"),
        count(quality.references)
    )
}

/// What stands below the title: abstract, provenance, and a card for each backbone.
pub(super) fn header(quality: &ImageQuality, subtitle: &str, provenance: &str) -> String {
    let mut out = String::new();
    if !subtitle.trim().is_empty() {
        let _ = write!(out, "<p class=\"lead\">{}</p>", escape(subtitle));
    }
    out += &summary(quality);
    out += provenance;
    out.push_str("<div class=\"cards\">");
    for backbone in &quality.backbones {
        let judged = escape(&score_name(&quality.judged_by));
        let gain = backbone.gains.first().and_then(|gain| gain.scores.get(&quality.judged_by));
        if let (Some(claim), Some(gain)) = (&backbone.claim, gain) {
            let digits = places([gain]);
            let strong = if claim.verdict == ClaimVerdict::Held { " strong" } else { "" };
            let told = match claim.verdict {
                ClaimVerdict::Held => "physical: above 0 over every control",
                ClaimVerdict::NotHeld => "not physical: the frozen samples or a control do better",
                ClaimVerdict::Undecided => "undecided: not above 0 over every control",
            };
            let _ = write!(
                out,
                "<div class=\"card{strong}\"><div class=\"big\">{}</div><div class=\"what\">{}: gain of the adapter \
                 over frozen on {judged}, {}; {told}.</div></div>",
                signed(gain.mean, digits),
                backbone_name(backbone),
                interval(gain, digits)
            );
        }
        if let Some(gaussian) = &backbone.gaussian {
            let digits = places([&gaussian.nearer]);
            let _ = write!(
                out,
                "<div class=\"card\"><div class=\"big\">{}</div><div class=\"what\">{}: reduction of MMD² to held-out \
                 renders, compared with Gaussian images, {}.</div></div>",
                signed(gaussian.nearer.mean, digits),
                backbone_name(backbone),
                interval(&gaussian.nearer, digits)
            );
        }
    }
    out.push_str("</div>");
    out
}

/// The section; none without an adapted variant and without Gaussian images.
pub(super) fn section(quality: &ImageQuality) -> Option<Section> {
    let gains = gains(quality);
    let gaussian = gaussian(&quality.backbones);
    if gains.is_none() && gaussian.is_none() {
        return None;
    }
    let body = gains.unwrap_or_default() + &gaussian.unwrap_or_default();
    Some(Section::new("verdicts", "Is the gain physical?", body))
}

/// Gains of the adapted variant over the others, a row for each.
fn gains(quality: &ImageQuality) -> Option<String> {
    let judged: Vec<&BackboneQuality> = quality.backbones.iter().filter(|backbone| backbone.claim.is_some()).collect();
    if judged.is_empty() {
        return None;
    }
    let mut out = format!(
        "<p>Gain of the adapted variant over each other variant; above 0 means better. Intervals are 95%, paired by \
         sample. The deciding score is <b>{}</b>, chosen before the run. The gain counts as physical only if its \
         intervals over frozen and over every control are above 0.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>Gain over</th>",
        escape(&score_name(&quality.judged_by))
    );
    for column in &quality.columns {
        let _ = write!(out, "<th>{}</th>", escape(&score_name(&column.name)));
    }
    out.push_str("</tr></thead><tbody>");
    for backbone in judged {
        let Some(claim) = &backbone.claim else { continue };
        let _ = write!(
            out,
            "<tr class=\"group\"><td colspan=\"{}\">{}: physical gain <b>{}</b></td></tr>",
            quality.columns.len() + 1,
            backbone_name(backbone),
            verdict(claim.verdict)
        );
        for gain in &backbone.gains {
            let _ = write!(out, "<tr><td>{}</td>", escape(gain.over.label()));
            for column in &quality.columns {
                let all = backbone.gains.iter().filter_map(|gain| gain.scores.get(&column.name));
                let digits = places(all) + 1;
                let Some(value) = gain.scores.get(&column.name) else {
                    out.push_str(r#"<td class="zero">–</td>"#);
                    continue;
                };
                let judged = if column.name == quality.judged_by { " class=\"best\"" } else { "" };
                let _ = write!(
                    out,
                    "<td><span{judged}>{}</span><span class=\"ci\">{}</span></td>",
                    signed(value.mean, digits),
                    interval(value, digits)
                );
            }
            out.push_str("</tr>");
        }
    }
    out.push_str("</tbody></table></div>");
    Some(out)
}

/// Frozen backbones against Gaussian images.
fn gaussian(backbones: &[BackboneQuality]) -> Option<String> {
    let mut out = String::from(
        "<h3>Frozen backbones against Gaussian images</h3><p>Squared MMD to held-out renders, for the frozen \
         backbone's samples and for Gaussian images with the mean and covariance of the training set. A backbone with \
         a lower MMD has learned more than these two moments.</p><div class=\"scroll\"><table \
         class=\"wide\"><thead><tr><th>Backbone</th><th>Samples</th><th>Steps</th><th>Gaussian \
         images</th><th>Frozen</th><th>Nearer by</th><th>Verdict</th></tr></thead><tbody>",
    );
    let mut any = false;
    for backbone in backbones {
        let Some(found) = &backbone.gaussian else { continue };
        any = true;
        let digits = places([&found.gaussian, &found.frozen]);
        let cell = |value: &Estimate| {
            format!("<td>{}<span class=\"ci\">{}</span></td>", fixed(value.mean, digits), interval(value, digits))
        };
        let told = match () {
            () if found.nearer.low > 0.0 => "nearer",
            () if found.nearer.high < 0.0 => "farther",
            () => "undecided",
        };
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{}</td>{}{}{}<td><b>{told}</b></td></tr>",
            backbone_name(backbone),
            found.samples,
            found.steps,
            cell(&found.gaussian),
            cell(&found.frozen),
            cell(&found.nearer)
        );
    }
    out.push_str("</tbody></table></div>");
    any.then_some(out)
}
