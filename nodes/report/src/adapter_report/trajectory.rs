//! Trajectories: how a sample comes about, frame by frame.

use super::{
    album::step_of,
    montage::{factor, picture},
    samples::{ByBackbone, Sample},
};
use crate::{
    montage::reduce,
    page::{Section, tabs},
    sections::montage::linked,
    shelf::Viewer,
    text::escape,
};
use std::fmt::Write as _;
use tauflow_contract::{Context, KindError};
use tauflow_data::{Image, records::Variant};

/// Frames of a row at most; of more, some are left out evenly.
const MOST: usize = 8;

/// The trajectories of one sample.
pub(super) struct Trajectory {
    backbone: String,
    key: String,
    sample: u64,
    rows: Vec<(Variant, Vec<(u64, Image)>)>,
}

/// Of each backbone, those of the first sample that has frames.
///
/// # Errors
/// If an image is missing from the store or damaged.
pub(super) fn all(ctx: &Context<'_>, all: &ByBackbone<'_>, pixels: usize) -> Result<Vec<Trajectory>, KindError> {
    let mut out = Vec::new();
    for (backbone, of) in all {
        let has_frames = |sample: &&Sample<'_>| sample.meta.variants.iter().any(|its| !its.frames.is_empty());
        let Some(sample) = of.iter().find(has_frames) else { continue };
        let generated = sample.item.load(ctx)?;
        let rows = generated.variants.into_iter().filter(|its| !its.frames.is_empty()).map(|its| {
            let chosen = evenly(its.frames.len(), MOST);
            let frame = |at: usize| {
                let image = &its.frames[at].image;
                (its.frames[at].step, reduce(image, factor(image, pixels)))
            };
            (its.variant, chosen.into_iter().map(frame).collect())
        });
        let (backbone, key) = (backbone.clone(), sample.key.clone());
        out.push(Trajectory { backbone, key, sample: sample.meta.sample, rows: rows.collect() });
    }
    Ok(out)
}

/// At most `most` of 0..number, evenly, with the first and the last.
fn evenly(number: usize, most: usize) -> Vec<usize> {
    if number <= most {
        return (0..number).collect();
    }
    (0..most).map(|at| at * (number - 1) / (most - 1)).collect()
}

/// The section; none without frames.
///
/// # Errors
/// If a picture cannot be encoded.
pub(super) fn section(trajectories: &[Trajectory], viewer: Option<&Viewer>) -> Result<Option<Section>, KindError> {
    if trajectories.is_empty() {
        return Ok(None);
    }
    let panels = trajectories
        .iter()
        .map(|of| Ok((of.backbone.clone(), grid(of, viewer)?)))
        .collect::<Result<Vec<_>, KindError>>()?;
    let body = format!(
        "<p>States of the sampler after the given number of steps, clipped to display values. All rows start from the \
         same noise.</p>{}",
        tabs("trajectory", &panels)
    );
    Ok(Some(Section::new("trajectories", "Trajectories", body)))
}

fn grid(of: &Trajectory, viewer: Option<&Viewer>) -> Result<String, KindError> {
    let mut out = String::new();
    for (variant, frames) in &of.rows {
        out.push_str(r#"<div class="scroll"><table class="montage" style="min-width:640px"><thead><tr><th></th>"#);
        for (step, _) in frames {
            let _ = write!(out, "<th>step {step}</th>");
        }
        let _ = write!(out, "</tr></thead><tbody><tr><td>{}, sample {}</td>", escape(variant.label()), of.sample);
        for (step, image) in frames {
            let alt = format!("{}, step {step}, sample {} of {}", variant.label(), of.sample, of.backbone);
            let shown = linked(&picture(image, &alt)?, viewer, &of.key, &step_of(*variant, *step));
            let _ = write!(out, "<td>{shown}</td>");
        }
        out.push_str("</tr></tbody></table></div>");
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_chosen_evenly_with_both_ends() {
        assert_eq!(evenly(3, 8), [0, 1, 2]);
        assert_eq!(evenly(15, 8), [0, 2, 4, 6, 8, 10, 12, 14]);
        assert_eq!(evenly(101, 3), [0, 50, 100]);
    }
}
