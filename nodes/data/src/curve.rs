//! Describes the trend of a training's curve in words.

use crate::records::TrainingPoint;
use std::fmt;

/// The recent trend of the test loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// It never was below what it was before the first step.
    NeverFell,
    /// It was lowest at this step, and has lost more than a quarter of its fall since.
    Rises(u64),
    /// The last quarter of the steps brought more than a tenth of the fall.
    Falls,
    /// Neither.
    Settled,
}

impl Standing {
    /// The trend of a curve so far; none without test scenes.
    pub fn of(points: &[TrainingPoint]) -> Option<Self> {
        let tests: Vec<(u64, f64)> = points.iter().filter_map(|p| p.test.map(|test| (p.step, test))).collect();
        let ((_, first), (end, last)) = tests.first().copied().zip(tests.last().copied())?;
        let (at, best) = tests.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let fallen = first - best;
        let late = tests.iter().rfind(|(step, _)| step * 4 <= end * 3).map_or(first, |(_, test)| *test) - last;
        Some(if fallen <= 0.0 {
            Self::NeverFell
        } else if last > best + 0.25 * fallen {
            Self::Rises(at)
        } else if late > 0.1 * fallen {
            Self::Falls
        } else {
            Self::Settled
        })
    }
}

impl fmt::Display for Standing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NeverFell => f.write_str("never fell"),
            Self::Rises(since) => write!(f, "rises since step {since}"),
            Self::Falls => f.write_str("still falling"),
            Self::Settled => f.write_str("settled"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_told_in_words() {
        let told = |tests: &[f64]| {
            let point = |(i, test): (usize, &f64)| TrainingPoint {
                step: i as u64 * 1000,
                train: None,
                test: Some(*test),
                gain: None,
                learning_rate: 1e-3,
                gradient_norm: None,
            };
            Standing::of(&tests.iter().enumerate().map(point).collect::<Vec<_>>()).map(|standing| standing.to_string())
        };
        assert_eq!(told(&[1.0, 0.8, 0.6, 0.4, 0.2]).as_deref(), Some("still falling"));
        assert_eq!(told(&[1.0, 0.5, 0.41, 0.4, 0.4]).as_deref(), Some("settled"));
        assert_eq!(told(&[1.0, 0.4, 0.5, 0.8, 0.9]).as_deref(), Some("rises since step 1000"));
        assert_eq!(told(&[1.0, 1.1, 1.2]).as_deref(), Some("never fell"));
        assert_eq!(told(&[]), None);
    }
}
