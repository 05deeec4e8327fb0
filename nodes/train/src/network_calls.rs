//! Numbers of network calls (NFE) that a kind takes as a param: checked once, where they are read.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use tauflow_contract::KindError;

/// Numbers of network calls, increasing from at least 1 up to [`NetworkCalls::MOST`]. Written as a list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<u64>", into = "Vec<u64>")]
pub struct NetworkCalls(Vec<u64>);

impl NetworkCalls {
    /// Most network calls of a rollout.
    pub const MOST: u64 = 10_000;

    /// The numbers, increasing.
    pub fn counts(&self) -> &[u64] {
        &self.0
    }
}

impl Default for NetworkCalls {
    fn default() -> Self {
        Self(vec![1, 2, 9, 20, 50])
    }
}

impl TryFrom<Vec<u64>> for NetworkCalls {
    type Error = KindError;

    fn try_from(counts: Vec<u64>) -> Result<Self, KindError> {
        if counts.first().is_none_or(|first| *first == 0) || counts.windows(2).any(|pair| pair[1] <= pair[0]) {
            return Err(KindError::Input(format!(
                "numbers of network calls must increase from at least 1, not {counts:?}; write for example \
                 `[1, 2, 9, 20, 50]`"
            )));
        }
        if counts.last().is_some_and(|last| *last > Self::MOST) {
            return Err(KindError::Input(format!(
                "more than {} network calls; use fewer, because more have no effect",
                Self::MOST
            )));
        }
        Ok(Self(counts))
    }
}

impl From<NetworkCalls> for Vec<u64> {
    fn from(calls: NetworkCalls) -> Self {
        calls.0
    }
}

impl JsonSchema for NetworkCalls {
    fn schema_name() -> Cow<'static, str> {
        "NetworkCalls".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "array",
            "items": { "type": "integer", "minimum": 1, "maximum": Self::MOST },
            "minItems": 1,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{from_value, json, to_value};

    #[test]
    fn calls_increase_and_have_bounds() {
        for fine in [json!([1, 10_000]), json!([1, 2, 9, 20, 50])] {
            let calls: NetworkCalls = from_value(fine.clone()).expect("increasing");
            assert_eq!(to_value(calls).expect("plain"), fine);
        }
        for (bad, said) in [
            (json!([]), "at least 1"),
            (json!([0, 1]), "at least 1"),
            (json!([2, 2]), "increase"),
            (json!([1, 10_001]), "more than 10000"),
            (json!([1, u64::MAX]), "more than 10000"),
        ] {
            let error = from_value::<NetworkCalls>(bad.clone()).expect_err("wrong").to_string();
            assert!(error.contains(said), "{bad}: {error}");
        }
    }
}
