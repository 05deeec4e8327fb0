//! The figures as CSV.

use crate::csv::field;
use std::fmt::Write as _;
use tauflow_data::records::ImageQuality;

/// Each score of each variant.
pub(super) fn scores(quality: &ImageQuality) -> String {
    let mut out = String::from("backbone,family,variant,score,mean,low,high,change\n");
    for of in &quality.backbones {
        for its in &of.variants {
            for (score, value) in &its.scores {
                let _ = writeln!(
                    out,
                    "{},{},{},{},{},{},{},{}",
                    field(&of.backbone),
                    of.family.name(),
                    its.variant,
                    field(score),
                    value.mean,
                    value.low,
                    value.high,
                    its.change
                );
            }
        }
    }
    out
}

/// Gains of the adapted variant over each of the others.
pub(super) fn gains(quality: &ImageQuality) -> String {
    let mut out = String::from("backbone,over,score,gain,low,high\n");
    for of in &quality.backbones {
        for gain in &of.gains {
            for (score, value) in &gain.scores {
                let (backbone, score) = (field(&of.backbone), field(score));
                let (over, mean, low, high) = (gain.over, value.mean, value.low, value.high);
                let _ = writeln!(out, "{backbone},{over},{score},{mean},{low},{high}");
            }
        }
    }
    out
}

/// The injected energy of each step.
pub(super) fn energy(quality: &ImageQuality) -> String {
    let mut out = String::from("backbone,variant,step,energy\n");
    for of in &quality.backbones {
        for its in &of.variants {
            for (at, energy) in its.energy.iter().enumerate() {
                let _ = writeln!(out, "{},{},{},{energy}", field(&of.backbone), its.variant, at + 1);
            }
        }
    }
    out
}

/// Scores of single images.
pub(super) fn per_sample(quality: &ImageQuality) -> String {
    let mut out = String::from("backbone,sample,variant,score,value\n");
    for row in &quality.per_sample {
        for (score, value) in &row.scores {
            let _ = writeln!(out, "{},{},{},{},{value}", field(&row.backbone), row.sample, row.variant, field(score));
        }
    }
    out
}
