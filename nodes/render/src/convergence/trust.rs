//! Flags of scenes, and how far variance time can be trusted there.

use tauflow_data::records::{HEAVY_INDEX, HEAVY_KURTOSIS, HEAVY_SHARE, OFF_NORMAL, TOLERANCE};

/// The first rung from which on errors of pixels are near normal.
pub(super) fn trusted_from(counts: &[u64], off_normal: &[f64]) -> Option<u64> {
    from(counts, off_normal, |distance| distance <= OFF_NORMAL)
}

/// The first rung from which on the image's mean square error is near the law's.
pub(super) fn image_from(counts: &[u64], image: &[f64]) -> Option<u64> {
    from(counts, image, |ratio| (ratio - 1.0).abs() <= TOLERANCE)
}

/// The first rung from which on all keep to it.
fn from(counts: &[u64], values: &[f64], keeps: impl Fn(f64) -> bool) -> Option<u64> {
    let near = values.iter().rev().take_while(|value| keeps(**value)).count();
    counts[counts.len().saturating_sub(near)..].first().copied()
}

/// Why a scene's samples are to be called heavy-tailed; empty if they are not.
pub(super) fn reasons(tail_index: Option<f64>, excess_kurtosis: Option<f64>, tail_share: f64) -> Vec<String> {
    let index = tail_index.filter(|index| *index < HEAVY_INDEX);
    let kurtosis = excess_kurtosis.filter(|kurtosis| *kurtosis > HEAVY_KURTOSIS);
    let share = (tail_share > HEAVY_SHARE).then_some(100.0 * tail_share);
    let found = [
        index.map(|index| format!("tail index {index:.2}, below {HEAVY_INDEX}")),
        kurtosis.map(|kurtosis| format!("excess kurtosis {kurtosis:.0}, above {HEAVY_KURTOSIS}")),
        share.map(|share| format!("{share:.0}% of the variance in 1% of the pixels")),
    ];
    found.into_iter().flatten().collect()
}

/// How far variance time can be trusted in a scene, in words.
pub(super) fn words(counts: &[u64], off_normal: &[f64], image: &[f64]) -> String {
    let (Some(first), Some(last), Some(least)) = (counts.first(), counts.last(), off_normal.last()) else {
        return "no noise".into();
    };
    let (percent, within) = (100.0 * OFF_NORMAL, 100.0 * TOLERANCE);
    let since = |from: u64| if from == *first { "at every rung".into() } else { format!("from {from} samples on") };
    let pixels = match trusted_from(counts, off_normal) {
        Some(from) => format!("pixels within {percent:.0}% of normal {}", since(from)),
        None => format!("pixels still {:.0}% off normal at {last} samples", 100.0 * least),
    };
    let whole = match image_from(counts, image) {
        Some(from) => format!("the image's squared error within {within:.0}% of the law's {}", since(from)),
        None => format!("the image's squared error not within {within:.0}% of the law's at {last} samples"),
    };
    format!("{pixels}; {whole}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_trusted_from_where_all_later_rungs_are_near_normal() {
        let counts = [1, 2, 4, 8];
        assert_eq!(trusted_from(&counts, &[0.3, 0.08, 0.12, 0.05]), Some(8));
        assert_eq!(trusted_from(&counts, &[0.09, 0.08, 0.1, 0.05]), Some(1));
        assert_eq!(trusted_from(&counts, &[0.01, 0.01, 0.01, 0.2]), None);
        assert_eq!(trusted_from(&counts, &[]), None);
        assert_eq!(image_from(&counts, &[0.5, 1.2, 0.8, 1.0]), Some(2));
        assert_eq!(
            words(&counts, &[0.3, 0.3, 0.1, 0.05], &[1.0; 4]),
            "pixels within 10% of normal from 4 samples on; \
             the image's squared error within 20% of the law's at every rung"
        );
        assert_eq!(
            words(&counts, &[0.3, 0.3, 0.3, 0.25], &[1.0, 1.0, 1.0, 0.3]),
            "pixels still 25% off normal at 8 samples; \
             the image's squared error not within 20% of the law's at 8 samples"
        );
        assert_eq!(words(&counts, &[], &[]), "no noise");
    }

    #[test]
    fn a_scene_is_flagged_for_each_of_three_reasons() {
        assert!(reasons(Some(2.1), Some(99.0), 0.5).is_empty() && reasons(None, None, 0.0).is_empty());
        let all = reasons(Some(1.7), Some(900.2), 0.62);
        assert_eq!(
            all,
            ["tail index 1.70, below 2", "excess kurtosis 900, above 100", "62% of the variance in 1% of the pixels"]
        );
    }
}
