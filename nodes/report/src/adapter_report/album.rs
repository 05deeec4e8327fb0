//! The viewer beside the page: every sample in all variants, and how it came about.
//!
//! Knows no score.

use super::samples::{ByBackbone, Sample};
use crate::shelf::{Shelf, Viewer, add};
use tauflow_contract::{Context, KindError};
use tauflow_data::records::{Generated, Variant};
use tauflow_viewer::{Content, Scene};

/// The track of the final images.
const IMAGES: &str = "images";
const DISPLAY: &str = "display values in [0, 1], with the curve of sRGB";

/// The frame of a variant.
pub(super) fn image_of(variant: Variant) -> String {
    format!("{IMAGES}/{}", variant.label())
}

/// The track of a variant's trajectory.
fn steps_of(variant: Variant) -> String {
    format!("trajectory: {}", variant.label())
}

/// The frame of a step of a trajectory.
pub(super) fn step_of(variant: Variant, step: u64) -> String {
    format!("{}/step {step}", steps_of(variant))
}

/// The viewer of the first samples of each backbone, the backbones in turns; none without a sample. It opens with an
/// adapted image beside the frozen one.
///
/// # Errors
/// If an image is missing from the store or damaged.
pub(super) fn viewer(
    ctx: &Context<'_>,
    title: &str,
    all: &ByBackbone<'_>,
    most: usize,
) -> Result<Option<Viewer>, KindError> {
    let mut shelf = Shelf::default();
    let longest = all.values().map(Vec::len).max().unwrap_or(0).min(most);
    for place in 0..longest {
        for (backbone, samples) in all {
            let Some(sample) = samples.get(place) else { continue };
            ctx.check_cancelled()?;
            shelf.put(&sample.key, |shelf| scene(ctx, shelf, backbone, sample))?;
        }
    }
    let adapted = all.values().flatten().any(|sample| sample.has(Variant::Adapted));
    shelf.viewer(title, adapted.then(|| image_of(Variant::Adapted)).as_deref())
}

/// A sample as a scene of its backbone. All images are compared with the frozen one.
fn scene(ctx: &Context<'_>, shelf: &mut Shelf, backbone: &str, sample: &Sample<'_>) -> Result<Scene, KindError> {
    let mut scene = Scene { key: sample.key.clone(), stratum: backbone.to_owned(), ..Scene::default() };
    let generated: Generated = sample.item.load(ctx)?;
    for its in generated.variants {
        let place = its.variant as u64;
        let track = shelf.track(IMAGES, DISPLAY);
        let frame = shelf.frame(track, its.variant.label(), Content::Display, (place, None));
        if its.variant == Variant::Frozen {
            scene.reference = Some(frame);
        } else {
            shelf.made_from(frame, &image_of(Variant::Frozen));
        }
        add(&mut scene, frame, its.image);
        for own in its.frames {
            let track = shelf.track(&steps_of(its.variant), DISPLAY);
            let frame = shelf.frame(track, &format!("step {}", own.step), Content::Display, (own.step, None));
            shelf.follow(frame, "");
            add(&mut scene, frame, own.image);
        }
    }
    Ok(scene)
}
