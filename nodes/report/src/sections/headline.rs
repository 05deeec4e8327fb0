//! The head of the page: what was built, and the figures to remember.

use crate::{
    material::{Material, References},
    montage::Montage,
    ranking::{Standing, best_at, conditioning_name, method_name, ordered, standings},
    sections::{montage::linked, no_intervals, resampled},
    shelf::Viewer,
    text::{count, escape, fixed, plural, png_uri, signed},
};
use std::fmt::Write as _;
use tauflow_contract::KindError;
use tauflow_data::{
    image_io::encode_png,
    records::{Evaluation, MethodTable},
};

/// The sentence below the title; nothing without one.
pub fn subtitle(text: &str) -> String {
    if text.is_empty() { String::new() } else { format!("<p class=\"lead\">{}</p>", escape(text)) }
}

/// The abstract: a sentence on what was built, and one on the best solver.
pub fn summary(evaluation: &Evaluation, material: &Material) -> String {
    format!("<p class=\"lead\">{}{}</p>", built(evaluation, material), found(evaluation).unwrap_or_default())
}

/// One sentence on the best method at the first number of calls, and on the best solver if it is another; none without
/// a gain.
fn found(evaluation: &Evaluation) -> Option<String> {
    let nfe = evaluation.nfe.first().copied().unwrap_or(0);
    let standings = standings(evaluation, nfe);
    let first = standings.first()?;
    let gain = |of: &Standing<'_>| {
        let gain = of.gain?.get("hdr_psnr")?;
        let [mean, low, high] = [gain.mean, gain.low, gain.high].map(|value| signed(value, 2));
        let interval = format!(" (95% interval {low} to {high})");
        let interval = if evaluation.has_intervals() { interval } else { String::new() };
        Some(format!("<b>{mean} dB</b> HDR PSNR over its input{interval}"))
    };
    let Some(solver) = best_at(evaluation, nfe) else {
        return Some(format!(" The best method, {}, gains {}.", escape(&name(first.table?)), gain(first)?));
    };
    let ours = gain(standings.iter().find(|of| is(of, solver))?)?;
    Some(match first.table.filter(|table| !std::ptr::eq(*table, solver)) {
        Some(table) => format!(
            " The best method, {}, gains {}; the best solver at NFE {nfe}, {}, gains {ours}.",
            escape(&name(table)),
            gain(first)?,
            escape(&name(solver))
        ),
        None => format!(" The best method is a solver at NFE {nfe}, {}: it gains {ours}.", escape(&name(solver))),
    })
}

/// Whether the standing is that of a method.
fn is(of: &Standing<'_>, table: &MethodTable) -> bool {
    of.table.is_some_and(|own| std::ptr::eq(own, table))
}

/// The figures to remember.
pub fn block(evaluation: &Evaluation, material: &Material) -> String {
    let mut out = String::from("<div class=\"cards\">");
    best_cards(&mut out, evaluation, evaluation.nfe.first().copied().unwrap_or(0));
    data_cards(&mut out, evaluation, material);
    out.push_str("</div>");
    let _ = write!(out, "<p class=\"note\">{}</p>", reference_note(evaluation, material.references.as_ref()));
    out
}

/// The opening figure: input, best method, the best of the other sort, reference.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn hero(opening: &Montage, viewer: Option<&Viewer>) -> Result<String, KindError> {
    let Some(row) = opening.rows.first() else { return Ok(String::new()) };
    let mut out = String::from("<figure class=\"hero\"><div>");
    let shows_input = opening.shows_input();
    for (at, (picture, (_, head))) in row.pictures.iter().zip(&opening.columns).enumerate() {
        let Some(image) = &picture.image else { continue };
        let score = picture.psnr.filter(|_| at > 0 || !shows_input).map(|score| match row.input {
            Some(input) => signed(score - input, 2),
            None => fixed(score, 2),
        });
        let score = score.map_or_else(String::new, |score| format!(" · {score} dB"));
        let shown = format!(r#"<img alt="{}" src="{}">"#, escape(head), png_uri(&encode_png(image)?));
        let shown = linked(&shown, viewer, &row.scene, &picture.frame);
        let _ = write!(out, "<div>{shown}<span><b>{}</b>{score}</span></div>", escape(head));
    }
    let open = viewer.and_then(|viewer| viewer.address(&row.scene, &row.pictures.first()?.frame)).map(|address| {
        format!(
            " <a href=\"{address}\">Open the viewer</a> to compare, zoom and read pixels; every picture of a \
             scene is a link to it."
        )
    });
    let told = match (row.input, shows_input) {
        (Some(_), false) => "gain. Captions: gain in HDR PSNR over the input",
        (None, false) => "HDR PSNR of the best method. Captions: HDR PSNR",
        (_, true) => "gain. Captions: gain in HDR PSNR over the first picture",
    };
    let _ = write!(
        out,
        "</div><figcaption>{}: the test scene with the median {told}.{}</figcaption></figure>",
        escape(&row.scene),
        open.unwrap_or_default()
    );
    Ok(out)
}

/// One sentence on what was built.
fn built(evaluation: &Evaluation, material: &Material) -> String {
    let mut parts = Vec::new();
    let accepted = material.verdicts.iter().filter(|(_, v)| v.reasons.is_empty()).count() as u64;
    if !material.verdicts.is_empty() {
        parts.push(format!(
            "A pool of <b>{}</b>, of which the gate accepted <b>{}</b>",
            plural(material.verdicts.len() as u64, "scene"),
            count(accepted)
        ));
    }
    let train = material.sampling.as_ref().map(|s| s.train.chosen);
    let test = evaluation.scenes;
    parts.push(match train {
        Some(train) => format!("<b>{}</b> to train and <b>{}</b> to test", plural(train, "scene"), count(test)),
        None => format!("<b>{}</b> to test", plural(test, "scene")),
    });
    if let Some(references) = &material.references {
        let (first, last) = (references.counts.first().copied(), references.counts.last().copied());
        let what = match references.has_input(evaluation.from_spp) {
            true => format!(
                "ladders of <b>{} rungs</b> from {} to {}",
                references.counts.len(),
                count(first.unwrap_or(0)),
                count(last.unwrap_or(0))
            ),
            false => format!("references of {}", count(evaluation.reference_spp)),
        };
        parts.push(format!("{what} samples per pixel at {} × {}", references.width, references.height));
    }
    let compared = [(evaluation.methods.len(), "solver"), (evaluation.baselines.len(), "baseline")];
    let compared = compared.into_iter().filter(|(n, _)| *n > 0).map(|(n, what)| plural(n as u64, what));
    let compared: Vec<String> = compared.collect();
    if !compared.is_empty() {
        parts.push(format!("<b>{}</b> compared", compared.join(" and ")));
    }
    let mut text = parts.join("; ");
    if let Some(first) = text.get(..1).filter(|c| c.chars().all(char::is_lowercase)) {
        let upper = first.to_uppercase();
        text.replace_range(..1, &upper);
    }
    text + "."
}

/// Notes on the references, and on intervals. References that the input is no rung of are held out.
fn reference_note(evaluation: &Evaluation, references: Option<&References>) -> String {
    let n = evaluation.reference_spp;
    let reference = match references.is_some_and(|of| of.has_input(evaluation.from_spp)) {
        true => format!(
            "The reference is I<sub>{n}</sub>, the ladder's last rung. It contains the samples of every other rung, so \
             the squared error of I<sub>k</sub> is σ²(1/k − 1/{n}) instead of σ²/k. The variance of I<sub>{n}</sub> \
             itself is σ²/{n}."
        ),
        false => format!("The reference has {} samples per pixel.", count(n)),
    };
    let intervals = match evaluation.has_intervals() {
        true => format!("Intervals are 95% bootstrap intervals over {}.", resampled(evaluation.groups)),
        false => no_intervals("scene", evaluation.groups),
    };
    format!(
        "{reference} {intervals}{}",
        if evaluation.methods.len() > 1 { " The best solver is chosen on the test scenes." } else { "" }
    )
}

fn name(table: &MethodTable) -> String {
    let parts = [method_name(&table.method), conditioning_name(&table.conditioning)];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
}

fn card(out: &mut String, class: &str, big: &str, what: &str) {
    let _ = write!(out, r#"<div class="card{class}"><div class="big">{big}</div><div class="what">{what}</div></div>"#);
}

fn best_cards(out: &mut String, evaluation: &Evaluation, nfe: u64) {
    let standings = standings(evaluation, nfe);
    let solver = best_at(evaluation, nfe).and_then(|best| standings.iter().find(|of| is(of, best)));
    let best = standings.first().filter(|of| of.table.is_some());
    let mut shown: Vec<(&Standing<'_>, &str)> = best.map(|best| (best, "best method")).into_iter().collect();
    match (best, solver) {
        (Some(best), Some(solver)) if !std::ptr::eq(best, solver) => shown.push((solver, "best solver")),
        _ => {}
    }
    for (place, (of, what)) in shown.into_iter().enumerate() {
        let (Some(table), Some(gain)) = (of.table, of.gain.and_then(|gain| gain.get("hdr_psnr"))) else { continue };
        let interval = format!("; 95% interval {} to {}", signed(gain.low, 2), signed(gain.high, 2));
        let text = format!(
            "gain over the input of the {what}, {}{}{}",
            escape(&name(table)),
            if solver.is_some_and(|own| std::ptr::eq(own, of)) {
                format!(", at NFE {}", of.nfe)
            } else {
                String::new()
            },
            if evaluation.has_intervals() { interval } else { String::new() }
        );
        let strong = if place == 0 { " strong" } else { "" };
        card(out, strong, &format!("{} <small>dB</small>", signed(gain.mean, 2)), &text);
    }
    let steady = |t: &&MethodTable| t.auc.get("hdr_psnr").map(|e| e.mean).filter(|v| !v.is_nan());
    let top = ordered(evaluation)
        .into_iter()
        .filter(|t| steady(t).is_some())
        .reduce(|a, b| if steady(&b) > steady(&a) { b } else { a });
    if let Some((table, auc)) = top.and_then(|t| t.auc.get("hdr_psnr").map(|auc| (t, auc)))
        && evaluation.nfe.len() > 1
    {
        let what = format!(
            "best mean of a solver over log NFE {} to {} (AUC): {}",
            nfe,
            evaluation.nfe.last().copied().unwrap_or(nfe),
            escape(&name(table))
        );
        card(out, "", &format!("{} <small>dB</small>", fixed(auc.mean, 2)), &what);
    }
}

fn data_cards(out: &mut String, evaluation: &Evaluation, material: &Material) {
    if material.verdicts.is_empty() {
        return;
    }
    let pool = material.verdicts.len() as u64;
    let accepted = material.verdicts.iter().filter(|(_, v)| v.reasons.is_empty()).count() as u64;
    let mut strata: Vec<&str> = evaluation.per_scene.iter().map(|r| r.stratum.as_str()).collect();
    strata.sort_unstable();
    strata.dedup();
    let what =
        format!("scenes passed the gate; tested on {} in {}", count(evaluation.scenes), strata_text(strata.len()));
    card(out, "", &format!("{} <small>of {}</small>", count(accepted), count(pool)), &what);
}

fn strata_text(n: usize) -> String {
    if n == 1 { "1 stratum".into() } else { format!("{n} strata") }
}
