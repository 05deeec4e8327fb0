//! Loss curves of every cell as small multiples, and what all of them gain over the same input.

use crate::{
    page::Section,
    ranking::{colour, conditioning_name, conditioning_order, method_name, method_order},
    svg::{Plot, Scale},
    text::{compact, count, escape},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_data::{
    curve::Standing,
    methods::axes::{CONDITIONING, PARAMETERIZATION},
    records::{TrainingLog, TrainingPoint},
};

/// The section; none without curves.
pub fn section(losses: &[TrainingLog]) -> Option<Section> {
    let first = losses.first()?;
    let mut logs: Vec<&TrainingLog> = losses.iter().collect();
    logs.sort_by_key(|l| (l.space.clone(), conditioning_order(&l.conditioning), method_order(&l.parameterization)));
    let many_spaces = logs.iter().any(|l| l.space != first.space);
    let same = logs.iter().all(|l| l.steps == first.steps && l.preset == first.preset);
    let setting = if same {
        format!("Every cell: preset <code>{}</code>, {} steps.", escape(&first.preset), count(first.steps))
    } else {
        "Presets and steps differ between cells: see <code>results.json</code>.".to_owned()
    };
    let weights: Vec<u64> = logs.iter().map(|l| l.weights).collect();
    let (least, most) = (weights.iter().min()?, weights.iter().max()?);
    let weights = if least == most { count(*least) } else { format!("{} to {}", count(*least), count(*most)) };
    let mut body = format!(
        "<p>{setting} {weights} weights. Bold line: loss of the averaged weights on test scenes. Thin line: loss of \
         training batches. Below each panel: PSNR gain of one call over the first rung, on the first test scenes. \
         Losses of different methods have different scales, so compare the shapes of curves, not their heights. \
         <i>Settled</i> means that the last quarter of the steps contributed less than a tenth of the decrease; more \
         steps with higher learning rates may still improve the model.</p><div class=\"grid4\">"
    );
    for log in &logs {
        let gain = log.points.last().and_then(|point| point.gain);
        let gain = gain.map(|gain| format!("<figcaption>{} dB</figcaption>", crate::text::signed(gain, 2)));
        let _ = write!(body, "<figure>{}{}</figure>", panel(log, many_spaces), gain.unwrap_or_default());
    }
    body.push_str("</div>");
    body.push_str(&gains(&logs));
    body.push_str(&params(&logs));
    Some(Section::new("training", "Training", body))
}

/// The gain of one call over the first rung, by steps: one panel per set of params except the method, all on the same
/// axes. Losses have scales of their own; this has one.
fn gains(logs: &[&TrainingLog]) -> String {
    let curve = |log: &TrainingLog| -> Vec<(f64, f64)> {
        log.points.iter().filter_map(|p| p.gain.map(|gain| (p.step as f64, gain))).collect()
    };
    if logs.iter().all(|log| curve(log).len() < 2) {
        return String::new();
    }
    let y = Scale::linear(logs.iter().flat_map(|log| curve(log)).map(|(_, gain)| gain));
    let most = logs.iter().map(|log| log.steps).max().unwrap_or(1);
    let mut panels: BTreeMap<String, Vec<&TrainingLog>> = BTreeMap::new();
    let mut order = Vec::new();
    for log in logs {
        let title = setting(log, logs);
        if !panels.contains_key(&title) {
            order.push(title.clone());
        }
        panels.entry(title).or_default().push(log);
    }
    let mut out = String::from(
        "<p>PSNR gain of one call on the first test scenes during training, with one scale for all cells. The section \
         on quality shows the effect of more calls.</p><div class=\"grid2\">",
    );
    for title in order {
        let x = Scale::linear([0.0, most as f64]);
        let mut plot = Plot::new([560.0, 250.0], [52.0, 108.0, 34.0, 40.0], x, y);
        plot.title(&format!("Gain of one call, {title}")).y_axis(5);
        plot.x_axis([(0.0, "0".to_owned()), (most as f64, count(most))], "step");
        for log in &panels[&title] {
            let (class, points) = (colour(&log.parameterization), curve(log));
            plot.line(points.clone(), &class);
            if let Some((_, last)) = points.last() {
                plot.end_label(*last, &class, &method_name(&log.parameterization));
            }
        }
        let _ = write!(out, "<figure>{}</figure>", plot.finish(&format!("Gain of one call by steps, {title}")));
    }
    out + "</div>"
}

/// The conditioning, and what else differs between trainings but the method.
fn setting(log: &TrainingLog, logs: &[&TrainingLog]) -> String {
    let differs = |name: &str| logs.iter().any(|other| other.params.get(name) != log.params.get(name));
    let named = |(name, value): (&String, &serde_json::Value)| match value.as_str() {
        Some(text) => format!(", {} {text}", name.replace('_', " ")),
        None => format!(", {} {value}", name.replace('_', " ")),
    };
    let others = log
        .params
        .iter()
        .filter(|(name, _)| ![PARAMETERIZATION, CONDITIONING].contains(&name.as_str()) && differs(name));
    conditioning_name(&log.conditioning).clone() + &others.map(named).collect::<String>()
}

/// Every param of the trainings: those that all share, with their values, and the names of those that differ.
fn params(logs: &[&TrainingLog]) -> String {
    let Some(first) = logs.first() else { return String::new() };
    let (mut shared, mut differ) = (Vec::new(), Vec::new());
    for (name, value) in &first.params {
        let name = escape(name);
        if logs.iter().all(|log| log.params.get(name.as_str()) == Some(value)) {
            shared.push(format!("<code>{name}: {}</code>", escape(&value.to_string())));
        } else {
            differ.push(format!("<code>{name}</code>"));
        }
    }
    if shared.is_empty() {
        return String::new();
    }
    let differ = if differ.is_empty() { String::new() } else { format!(" Cells differ in {}.", differ.join(", ")) };
    format!("<details><summary>All params</summary><p>{}.{differ}</p></details>", shared.join(", "))
}

/// First and last loss on the test scenes.
fn fall(log: &TrainingLog) -> Option<(f64, f64)> {
    let tests: Vec<f64> = log.points.iter().filter_map(|p| p.test).collect();
    Some((*tests.first()?, *tests.last()?))
}

/// The recent trend of the test loss, in words.
fn standing(log: &TrainingLog) -> String {
    match Standing::of(&log.points) {
        // Steps as the rest of the page has them.
        Some(Standing::Rises(since)) => format!(", rises since step {}", count(since)),
        Some(standing) => format!(", {standing}"),
        None => String::new(),
    }
}

fn panel(log: &TrainingLog, many_spaces: bool) -> String {
    let series = |pick: fn(&TrainingPoint) -> Option<f64>| -> Vec<(f64, f64)> {
        log.points.iter().filter_map(|p| pick(p).map(|v| (p.step as f64, v))).collect()
    };
    let (train, test) = (series(|p| p.train), series(|p| p.test));
    let y = Scale::log(train.iter().chain(&test).map(|p| p.1), 0.06);
    let x = Scale::linear([0.0, log.steps as f64]);
    let mut plot = Plot::new([290.0, 222.0], [46.0, 14.0, 50.0, 42.0], x, y);
    let class = colour(&log.parameterization);
    let space = if many_spaces { format!(", {}", log.space) } else { String::new() };
    plot.title(&format!("{}, {}{space}", method_name(&log.parameterization), conditioning_name(&log.conditioning)));
    plot.y_axis(4).x_axis([(0.0, "0".to_owned()), (log.steps as f64, count(log.steps))], "step");
    plot.line(train, &format!("{class} thin")).line(test.iter().copied(), &class);
    if let Some(last) = test.last() {
        plot.dots([*last], 3.2, &class);
    }
    let said = match fall(log) {
        Some((first, last)) => {
            let change = crate::text::signed((last / first - 1.0) * 100.0, 0);
            format!("test {} → {} ({change}%){}", compact(first), compact(last), standing(log))
        }
        None => "not measured on test scenes".to_owned(),
    };
    plot.subtitle(&said);
    plot.finish(&format!(
        "Loss of {} with {}: {said}",
        method_name(&log.parameterization),
        conditioning_name(&log.conditioning)
    ))
}
