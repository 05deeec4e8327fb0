//! Convergence scene by scene: slopes, tails, and how far variance time can be trusted.

use super::{holds, optional, slope};
use crate::{
    csv::field,
    text::{count, escape, fixed},
};
use std::fmt::Write as _;
use tauflow_data::records::{AgainstLaw, Convergence, OFF_NORMAL, TOLERANCE};

/// The table; nothing without scenes.
pub fn table(convergence: &Convergence) -> String {
    if convergence.scenes.is_empty() {
        return String::new();
    }
    let last = convergence.counts.last().copied().unwrap_or_default();
    let mut out = format!(
        "<details><summary>Scene by scene</summary><p class=\"note\">Intervals of slopes are over blocks of pixels. \
         The slope is omitted for noise-free scenes. Var(I<sub>n</sub>) is divided by σ²/n, with each pixel \
         normalised by its standard deviation, and shown with its standard error. “Near normal from”: the first rung \
         from which these pixel errors are within {}% of a normal distribution. “Image near the law from”: the first \
         rung from which the mean squared error of the ladder, without normalisation, is within {}% of σ²/n. \
         Intervals of heavy-tailed scenes are too narrow, because they do not include rare samples that this ladder \
         has not drawn.</p><div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Scene</th><th>Slope</th><th>−½ \
         inside</th><th>Var(I<sub>n</sub>), n = {}</th><th>n = {}</th><th>Excess kurtosis</th><th>Tail \
         index</th><th>Variance in the top 1%</th><th>Near normal from</th><th>Image near the law from</th><th \
         class=\"left\">Validity of variance time</th></tr></thead><tbody>",
        fixed(100.0 * OFF_NORMAL, 0),
        fixed(100.0 * TOLERANCE, 0),
        count(convergence.counts.first().copied().unwrap_or_default()),
        count(last)
    );
    let figure = |of: Option<&AgainstLaw>| {
        of.map_or_else(|| "–".into(), |of| format!("{} ± {}", fixed(of.value, 2), fixed(of.error, 2)))
    };
    for scene in &convergence.scenes {
        let reasons = if scene.reasons.is_empty() {
            String::new()
        } else {
            format!("<span class=\"ci words\">heavy tail: {}</span>", escape(&scene.reasons.join("; ")))
        };
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td><td>{}</td><td>{}%</td><td>{}</td><td>{}</td><td class=\"left text\">{}{reasons}</td></tr>",
            escape(&scene.scene),
            slope(scene.slope.as_ref(), scene.unresolved),
            holds(scene.slope.as_ref()),
            figure(scene.variance.first()),
            figure(scene.variance.last()),
            optional(scene.excess_kurtosis),
            optional(scene.tail_index),
            fixed(scene.tail_share * 100.0, 0),
            scene.trusted_from.map_or_else(|| "–".into(), count),
            scene.image_from.map_or_else(|| "–".into(), count),
            escape(&scene.trust)
        );
    }
    out + "</tbody></table></div></details>"
}

/// One row for each scene; what a scene does not have is empty.
pub fn csv(convergence: &Convergence) -> String {
    let mut out = String::from(
        "scene,slope,slope_low,slope_high,unresolved,excess_kurtosis,tail_index,tail_share,\
         trusted_from,image_from,heavy_tail,reasons,trust",
    );
    for n in &convergence.counts {
        let _ = write!(out, ",variance_{n},variance_{n}_error,off_normal_{n},image_{n}");
    }
    out.push('\n');
    let optional = |value: Option<f64>| value.map_or_else(String::new, |v| v.to_string());
    for scene in &convergence.scenes {
        let _ = write!(
            out,
            "{},{},{},{},{},{},{},{},{},{},{},{},{}",
            field(&scene.scene),
            optional(scene.slope.map(|slope| slope.mean)),
            optional(scene.slope.map(|slope| slope.low)),
            optional(scene.slope.map(|slope| slope.high)),
            scene.unresolved,
            optional(scene.excess_kurtosis),
            optional(scene.tail_index),
            scene.tail_share,
            scene.trusted_from.map_or_else(String::new, |n| n.to_string()),
            scene.image_from.map_or_else(String::new, |n| n.to_string()),
            scene.heavy_tail,
            field(&scene.reasons.join("; ")),
            field(&scene.trust)
        );
        for k in 0..convergence.counts.len() {
            let of = scene.variance.get(k);
            let values = [
                of.map(|of| of.value),
                of.map(|of| of.error),
                scene.off_normal.get(k).copied(),
                scene.image.get(k).copied(),
            ];
            values.into_iter().for_each(|value| out.extend([",".to_owned(), optional(value)]));
        }
        out.push('\n');
    }
    out
}
