//! Numbers as records hold them: a mean with its interval, and numbers that may be infinite.

use serde::{Deserialize, Serialize};

/// A mean over scenes with its bootstrap 95% interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Lower end of the interval; the mean where [`has_intervals`] says that there is none.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Whether a mean over scenes has an interval: a single scene, or a single group of scenes where groups are known, does
/// not tell how others differ. Both ends of its [`Estimate`] are the mean.
pub fn has_intervals(scenes: u64, groups: Option<u64>) -> bool {
    scenes > 1 && groups.is_none_or(|groups| groups > 1)
}

/// JSON has no infinity: `null` stands for it.
pub(crate) mod infinite {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(value: &f64, to: S) -> Result<S::Ok, S::Error> {
        if value.is_finite() { Some(*value) } else { None }.serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::INFINITY))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_scene_or_one_group_has_no_interval() {
        assert!(has_intervals(2, None) && has_intervals(3, Some(2)));
        assert!(!has_intervals(1, None) && !has_intervals(4, Some(1)) && !has_intervals(1, Some(5)));
    }
}
