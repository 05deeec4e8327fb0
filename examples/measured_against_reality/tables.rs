//! The tables, in Markdown: medians with quartiles.

use crate::{nearest::Nearest, views::Panorama};
use std::collections::BTreeMap;
use tauflow_data::{
    ContextClass, Stratum,
    records::{PictureStatistics, SceneStatistics},
    statistics::quantile,
};

/// A number of something.
struct Measure<T> {
    name: &'static str,
    /// Digits after the point.
    digits: usize,
    value: fn(&T) -> Option<f64>,
}

/// The six that are held against reality, one of each property: detail, its distribution over sizes, how much colour
/// and how many colours, the range of light, and contrasts side by side.
const HELD: [Measure<PictureStatistics>; 6] = [
    Measure { name: "edge density", digits: 3, value: |p| Some(p.edge_density) },
    Measure { name: "slope of the spectrum", digits: 2, value: |p| p.spectrum_slope },
    Measure { name: "mean saturation", digits: 3, value: |p| Some(p.saturation) },
    Measure { name: "entropy of the hue, bits", digits: 2, value: |p| Some(p.hue_entropy) },
    Measure { name: "spread of log luminance, stops", digits: 2, value: |p| Some(p.log_luminance_spread) },
    Measure { name: "mean log contrast, stops", digits: 3, value: |p| Some(p.log_contrast) },
];
/// Another, which goes with the mean saturation.
const BESIDE: Measure<PictureStatistics> =
    Measure { name: "spread of saturation", digits: 3, value: |p| Some(p.saturation_spread) };

const GEOMETRY: [Measure<SceneStatistics>; 3] = [
    Measure { name: "discontinuities of depth, share", digits: 3, value: |s| Some(s.depth_discontinuities) },
    Measure { name: "discontinuities of normals, share", digits: 3, value: |s| Some(s.normal_discontinuities) },
    Measure { name: "samples per pixel to 1%", digits: 0, value: |s| s.samples_to_percent },
];

/// Lower quartile, median, upper quartile.
fn quartiles<'a, T: 'a>(measure: &Measure<T>, of: impl Iterator<Item = &'a T>) -> Option<[f64; 3]> {
    let mut values: Vec<f64> = of.filter_map(measure.value).collect();
    values.sort_by(f64::total_cmp);
    (!values.is_empty()).then(|| [0.25, 0.5, 0.75].map(|share| quantile(&values, share)))
}

fn cell<T>(measure: &Measure<T>, found: Option<[f64; 3]>) -> String {
    let digits = measure.digits;
    found.map_or_else(
        || "–".to_owned(),
        |[low, middle, high]| format!("**{middle:.digits$}** ({low:.digits$} to {high:.digits$})"),
    )
}

fn pictures_of(of: &BTreeMap<String, SceneStatistics>) -> impl Iterator<Item = &PictureStatistics> + Clone {
    of.values().map(|statistics| &statistics.picture)
}

/// The measures of pictures, and how many of six medians lie within the quartiles of the real views.
pub fn pictures(
    views: &[Panorama],
    procedural: &BTreeMap<String, SceneStatistics>,
    furnished: &BTreeMap<String, SceneStatistics>,
) {
    let real = || views.iter().flat_map(|map| &map.views).map(|view| &view.statistics);
    println!(
        "| of pictures | {} real views | {} procedural scenes | {} scenes with real assets | procedural median \
         within |",
        real().count(),
        procedural.len(),
        furnished.len()
    );
    println!("|---|---:|---:|---:|---|");
    let within = |theirs: Option<[f64; 3]>, ours: Option<[f64; 3]>| {
        theirs.zip(ours).is_some_and(|([low, _, high], [_, middle, _])| low <= middle && middle <= high)
    };
    let (mut own, mut assets) = (0, 0);
    for (measure, held) in HELD.iter().map(|measure| (measure, true)).chain([(&BESIDE, false)]) {
        let theirs = quartiles(measure, real());
        let ours = quartiles(measure, pictures_of(procedural));
        let others = quartiles(measure, pictures_of(furnished));
        own += usize::from(held && within(theirs, ours));
        assets += usize::from(held && within(theirs, others));
        println!(
            "| {} | {} | {} | {} | {} |",
            measure.name,
            cell(measure, theirs),
            cell(measure, ours),
            cell(measure, others),
            match (held, within(theirs, ours)) {
                (false, _) => "not held",
                (true, true) => "yes",
                (true, false) => "**no**",
            }
        );
    }
    println!("\nwithin the quartiles of real views: {own} of 6 medians, with real assets {assets} of 6\n");
}

fn head(first: &str) {
    println!("| {first} | {} |", HELD.map(|measure| measure.name).join(" | "));
    println!("|---|{}", "---:|".repeat(HELD.len()));
}

fn medians<'a>(name: &str, of: impl Iterator<Item = &'a PictureStatistics> + Clone) {
    let cells = HELD.iter().map(|measure| {
        quartiles(measure, of.clone())
            .map_or_else(|| "–".to_owned(), |[_, middle, _]| format!("{middle:.digits$}", digits = measure.digits))
    });
    println!("| {name} | {} |", cells.collect::<Vec<_>>().join(" | "));
}

/// Medians of each map.
pub fn maps(views: &[Panorama]) {
    head("medians of views");
    for map in views {
        medians(&map.name, map.views.iter().map(|view| &view.statistics));
    }
    println!();
}

/// Medians of each context.
pub fn contexts(procedural: &BTreeMap<String, SceneStatistics>) {
    head("medians of procedural scenes");
    for context in ContextClass::ALL {
        let of = procedural
            .iter()
            .filter(|(key, _)| Stratum::of_key(key).is_some_and(|(stratum, _)| stratum.context == context))
            .map(|(_, statistics)| &statistics.picture);
        medians(&context.to_string(), of);
    }
    println!();
}

/// Depth, normals and noise.
pub fn geometry(procedural: &BTreeMap<String, SceneStatistics>, furnished: &BTreeMap<String, SceneStatistics>) {
    println!("\n| of scenes | procedural | with real assets |");
    println!("|---|---:|---:|");
    for measure in &GEOMETRY {
        let of = |set: &BTreeMap<String, SceneStatistics>| cell(measure, quartiles(measure, set.values()));
        println!("| {} | {} | {} |", measure.name, of(procedural), of(furnished));
    }
    println!();
}

/// Distances to the nearest.
pub fn neighbours(found: &[Nearest]) {
    println!("| nearest, from | scenes | least | 1% | median | the nearest two |");
    println!("|---|---:|---:|---:|---:|---|");
    for Nearest { what, distances, closest } in found {
        let Some([a, b]) = closest else {
            println!("| {what} | 0 | – | – | – | – |");
            continue;
        };
        let [least, low, middle] = [0.0, 0.01, 0.5].map(|share| quantile(distances, share));
        println!("| {what} | {} | {least:.3} | {low:.3} | {middle:.3} | {a}, {b} |", distances.len());
    }
}
