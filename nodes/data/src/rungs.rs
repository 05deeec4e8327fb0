//! Params that several kinds take, as checked types: which rungs a ladder has, how samples are drawn, a film's size.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Largest power of two that `dyadic` takes.
const MOST_DYADIC: u64 = 1 << 62;

/// Which rungs a ladder has: sample counts, increasing from at least 1. Read from `{dyadic: 512}`, which stands for
/// 1, 2, 4 ... 512, or from a list; written as a list, so that the same rungs are the same param.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "RawRungs", into = "Vec<u64>")]
pub struct Rungs(Vec<u64>);

/// Rungs as they are written.
#[derive(Deserialize)]
#[serde(untagged, expecting = "write `{dyadic: 256}` or a list of sample counts such as `[1, 2, 4]`")]
enum RawRungs {
    // First, since a struct of one field would be read from a list of one number, too.
    List(Vec<u64>),
    Dyadic(Dyadic),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Dyadic {
    dyadic: u64,
}

/// Params that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ParamError(pub(crate) String);

impl Rungs {
    /// Powers of two from 1 to `last`.
    ///
    /// # Errors
    /// If `last` is no power of two.
    pub fn dyadic(last: u64) -> Result<Self, ParamError> {
        if !last.is_power_of_two() || last > MOST_DYADIC {
            return Err(ParamError(format!("`dyadic: {last}` is not a power of two up to 2^62; use for example 256")));
        }
        Ok(Self((0..=last.trailing_zeros()).map(|i| 1u64 << i).collect()))
    }

    /// These, in increasing order.
    ///
    /// # Errors
    /// If there is none, or they do not increase from at least 1.
    pub fn list(counts: Vec<u64>) -> Result<Self, ParamError> {
        let wrong = || ParamError(format!("rungs must be sample counts that increase from at least 1, not {counts:?}"));
        if counts.first().is_none_or(|first| *first == 0) || counts.windows(2).any(|pair| pair[1] <= pair[0]) {
            return Err(wrong());
        }
        Ok(Self(counts))
    }

    /// The sample counts, increasing.
    pub fn counts(&self) -> &[u64] {
        &self.0
    }

    /// The last sample count.
    pub fn last(&self) -> u64 {
        *self.0.last().expect("there is at least one rung")
    }
}

impl TryFrom<RawRungs> for Rungs {
    type Error = ParamError;
    fn try_from(raw: RawRungs) -> Result<Self, ParamError> {
        match raw {
            RawRungs::Dyadic(Dyadic { dyadic }) => Self::dyadic(dyadic),
            RawRungs::List(counts) => Self::list(counts),
        }
    }
}

impl From<Rungs> for Vec<u64> {
    fn from(rungs: Rungs) -> Self {
        rungs.0
    }
}

impl JsonSchema for Rungs {
    fn schema_name() -> Cow<'static, str> {
        "Rungs".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Which rungs a ladder has: `{dyadic: 512}` for 1, 2, 4 ... 512, or an increasing list.",
            "anyOf": [
                {
                    "type": "object",
                    "description": "Powers of two from 1 to this one.",
                    "properties": {
                        "dyadic": { "type": "integer", "minimum": 1, "description": "The last rung, a power of two." },
                    },
                    "required": ["dyadic"],
                    "additionalProperties": false,
                },
                {
                    "type": "array",
                    "description": "These, in increasing order.",
                    "items": { "type": "integer", "minimum": 1 },
                    "minItems": 1,
                },
            ],
        })
    }
}

/// Longest side of a film, in pixels.
pub const MAX_SIDE: u32 = 16384;

/// Width and height of a film in pixels, from 1 to [`MAX_SIDE`] each. Written as `[width, height]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "[u32; 2]", into = "[u32; 2]")]
pub struct Resolution {
    width: u32,
    height: u32,
}

impl Resolution {
    /// A film of this size.
    ///
    /// # Errors
    /// If a side is 0 or longer than [`MAX_SIDE`].
    pub fn new(width: u32, height: u32) -> Result<Self, ParamError> {
        if [width, height].iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return Err(ParamError(format!(
                "a film of {width} x {height} pixels cannot be rendered; use sides from 1 to {MAX_SIDE}"
            )));
        }
        Ok(Self { width, height })
    }

    /// Pixels in a row.
    pub fn width(self) -> usize {
        self.width as usize
    }

    /// Rows.
    pub fn height(self) -> usize {
        self.height as usize
    }
}

impl TryFrom<[u32; 2]> for Resolution {
    type Error = ParamError;
    fn try_from([width, height]: [u32; 2]) -> Result<Self, ParamError> {
        Self::new(width, height)
    }
}

impl From<Resolution> for [u32; 2] {
    fn from(of: Resolution) -> Self {
        [of.width, of.height]
    }
}

impl JsonSchema for Resolution {
    fn schema_name() -> Cow<'static, str> {
        "Resolution".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Width and height in pixels.",
            "type": "array",
            "items": { "type": "integer", "minimum": 1, "maximum": MAX_SIDE },
            "minItems": 2,
            "maxItems": 2,
        })
    }
}

/// Sampler of random numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum SamplerKind {
    /// Independent and identically distributed: what variance time rests on.
    #[default]
    Independent,
    /// Owen-scrambled Sobol' points: less error after the same number of samples, which depend on each other.
    Sobol,
}

impl SamplerKind {
    /// The value of older records, which lack this field, independent of the current default.
    pub fn unsaid() -> Self {
        Self::Independent
    }

    /// Its name in pipelines.
    pub fn name(self) -> &'static str {
        match self {
            Self::Independent => "independent",
            Self::Sobol => "sobol",
        }
    }

    /// Whether single samples say how far the mean of many is off.
    pub fn is_independent(&self) -> bool {
        *self == Self::Independent
    }
}

/// Estimator of radiance: the path tracer, or also paths from the lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum IntegratorKind {
    /// Paths from the camera.
    #[default]
    Path,
    /// Paths from the camera, and paths from the lights: less error in caustics and near lamps, in more time a sample.
    // The alias is in records of a version whose light paths found caustics only, and no longer told apart from these.
    #[serde(alias = "path_and_light")]
    Bidirectional,
}

impl IntegratorKind {
    /// What records of before there was a choice hold, whatever the default has become: they say nothing of it.
    pub fn unsaid() -> Self {
        Self::Path
    }

    /// Whether it is the path tracer.
    pub fn is_path(&self) -> bool {
        *self == Self::Path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{from_value, json, to_value};

    #[test]
    fn rungs_are_checked_once_and_written_as_a_list() {
        let rungs: Rungs = from_value(json!({ "dyadic": 8 })).expect("a power of two");
        assert_eq!((rungs.counts(), rungs.last()), (&[1, 2, 4, 8][..], 8));
        assert_eq!(to_value(&rungs).expect("plain"), json!([1, 2, 4, 8]));
        assert_eq!(from_value::<Rungs>(json!([1, 2, 4, 8])).expect("increasing"), rungs);
        assert_eq!(from_value::<Rungs>(json!([32])).expect("one rung").counts(), [32]);
        for (bad, said) in [
            (json!({ "dyadic": 12 }), "power of two"),
            (json!({ "dyadic": 1u64 << 63 }), "2^62"),
            (json!([]), "at least 1"),
            (json!([0, 1]), "at least 1"),
            (json!([1, 1]), "increase"),
            (json!("x"), "dyadic: 256"),
            (json!({ "dyadic": 4, "more": 1 }), "dyadic: 256"),
        ] {
            let error = from_value::<Rungs>(bad.clone()).expect_err("wrong").to_string();
            assert!(error.contains(said), "{bad}: {error}");
        }
    }

    #[test]
    fn films_have_sides_that_can_be_rendered() {
        let film: Resolution = from_value(json!([4, 2])).expect("small");
        assert_eq!((film.width(), film.height(), to_value(film).expect("plain")), (4, 2, json!([4, 2])));
        for bad in [json!([0, 1]), json!([1, MAX_SIDE + 1])] {
            assert!(from_value::<Resolution>(bad).expect_err("wrong").to_string().contains("16384"));
        }
    }
}
