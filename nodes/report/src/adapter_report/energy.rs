//! The energy that is injected in each sampler step.

use super::table::backbone_name;
use crate::{
    page::Section,
    svg::{Plot, Scale},
};
use tauflow_data::records::{BackboneQuality, ImageQuality, Variant};

/// The colour of a variant.
fn colour(variant: Variant) -> &'static str {
    match variant {
        Variant::Frozen => "hold",
        Variant::Adapted => "m3",
        Variant::EtaZero => "m4",
        Variant::UntrainedAdapter => "m6",
        Variant::ShuffledResiduals => "m2",
        Variant::GaussianResiduals => "m1",
    }
}

/// The section; none where nothing was injected.
pub(super) fn section(quality: &ImageQuality) -> Option<Section> {
    let injects = |backbone: &&BackboneQuality| backbone.variants.iter().any(|of| of.energy.iter().any(|e| *e > 0.0));
    let plots: Vec<String> = quality.backbones.iter().filter(injects).map(plot).collect();
    if plots.is_empty() {
        return None;
    }
    let body = format!(
        "<p>Mean over samples of the mean square of η g Δu, in the quantity that the adapter corrects: velocity (RF) \
         or the image's residual (DDPM). Variants without injection have no line.</p><div class=\"grid2 \
         charts\">{}</div>",
        plots.join("")
    );
    Some(Section::new("energy", "Injected energy", body))
}

fn plot(backbone: &BackboneQuality) -> String {
    let lines = backbone.variants.iter().filter(|of| of.energy.iter().any(|e| *e > 0.0));
    let lines: Vec<_> = lines.collect();
    let highest = lines.iter().flat_map(|of| of.energy.iter().copied()).fold(0.0, f64::max);
    let steps = backbone.steps as f64;
    let mut plot =
        Plot::new([560.0, 300.0], [70.0, 14.0, 16.0, 44.0], Scale::linear([1.0, steps]), Scale::linear([0.0, highest]));
    plot.y_axis(4).x_axis_round(6, "sampler step");
    for of in &lines {
        let points = of.energy.iter().enumerate().map(|(at, energy)| ((at + 1) as f64, *energy));
        plot.line(points, colour(of.variant));
        if let Some(last) = of.energy.last() {
            plot.end_label(*last, colour(of.variant), of.variant.label());
        }
    }
    let svg = plot.finish(&format!("Injected energy by sampler step, {}", backbone.backbone));
    format!("<figure>{svg}<figcaption>{}.</figcaption></figure>", backbone_name(backbone))
}
