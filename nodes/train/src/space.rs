//! The spaces that states are moved in, and what the network is shown of light. Knows neither networks nor times.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_ops::{expm1, log1p, map};

/// The space in which states are moved and targets are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Space {
    /// Exposed linear radiance.
    #[default]
    Linear,
    /// sign(x) log(1 + |x|) of it.
    Log1p,
}

impl Space {
    /// Its name in pipelines.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Log1p => "log1p",
        }
    }

    /// The largest value in this space that [`Space::decode`] gives back: of logarithms that of 6e37, beyond which its
    /// exponential function stays.
    pub fn largest(self) -> f32 {
        match self {
            Self::Linear => f32::MAX,
            Self::Log1p => 87.0,
        }
    }

    /// A linear value in this space.
    #[inline(always)]
    pub fn encode(self, value: f32) -> f32 {
        match self {
            Self::Linear => value,
            Self::Log1p => signed_log1p(value),
        }
    }

    /// Linear values in this space.
    pub(crate) fn encode_all(self, values: &[f32]) -> Vec<f32> {
        match self {
            Self::Linear => values.to_vec(),
            Self::Log1p => map(
                values,
                #[inline(always)]
                |value| Self::Log1p.encode(value),
            ),
        }
    }

    /// Values of this space as linear ones.
    pub(crate) fn decode_all(self, values: &[f32]) -> Vec<f32> {
        match self {
            Self::Linear => values.to_vec(),
            Self::Log1p => map(
                values,
                #[inline(always)]
                |value| Self::Log1p.decode(value),
            ),
        }
    }

    /// A value of this space as a linear one.
    #[inline(always)]
    pub fn decode(self, value: f32) -> f32 {
        match self {
            Self::Linear => value,
            Self::Log1p => expm1(value.abs()).copysign(value),
        }
    }
}

/// sign(x) log(1 + |x|): what the network is shown of a linear value.
#[inline(always)]
pub fn signed_log1p(value: f32) -> f32 {
    log1p(value.abs()).copysign(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spaces_invert() {
        for value in [-3.0f32, -0.0, 0.0, 1e-6, 0.5, 80.0, 1e5] {
            let back = Space::Log1p.decode(Space::Log1p.encode(value));
            for space in [Space::Linear, Space::Log1p] {
                assert_eq!(space.encode_all(&[value, 2.0]), [space.encode(value), space.encode(2.0)]);
                assert_eq!(space.decode_all(&[value, 2.0]), [space.decode(value), space.decode(2.0)]);
            }
            assert!((back - value).abs() <= 2e-6 * value.abs().max(1e-6), "{value} {back}");
            assert_eq!(Space::Linear.encode(value), value);
        }
    }
}
