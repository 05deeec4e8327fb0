//! Strata: regime x context, and the item keys that carry them. Own scenes may have any [`StratumName`].

mod name;

pub use name::StratumName;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, fmt, str::FromStr};
use tauflow_contract::ItemKey;

/// Difficulty of light transport, from easy to hard.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, JsonSchema)]
pub enum Regime {
    /// Diffuse only.
    L0,
    /// Glossy.
    L1,
    /// Refractive, without caustics.
    L2,
    /// Caustic-like.
    L3,
}

/// Where light comes from and how often it bounces.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ContextClass {
    /// Environment-dominant: objects under a sky.
    Environment,
    /// Open multi-bounce.
    Open,
    /// Enclosed multi-bounce: rooms.
    Enclosed,
}

impl Regime {
    /// All four.
    pub const ALL: [Self; 4] = [Self::L0, Self::L1, Self::L2, Self::L3];
}

impl ContextClass {
    /// All three.
    pub const ALL: [Self; 3] = [Self::Environment, Self::Open, Self::Enclosed];
}

impl fmt::Display for Regime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

impl fmt::Display for ContextClass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Environment => "environment",
            Self::Open => "open",
            Self::Enclosed => "enclosed",
        })
    }
}

/// A regime in a context: one of twelve.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Stratum {
    /// The regime.
    pub regime: Regime,
    /// The context.
    pub context: ContextClass,
}

impl Stratum {
    /// All twelve, in order of regime, then context.
    pub fn all() -> impl Iterator<Item = Self> {
        Regime::ALL
            .into_iter()
            .flat_map(|regime| ContextClass::ALL.into_iter().map(move |context| Self { regime, context }))
    }

    /// Key of the `index`-th scene of this stratum, e.g. `L1-open-000123`.
    pub fn item_key(&self, index: u64) -> ItemKey {
        ItemKey::new(format!("{self}-{index:06}")).expect("made of letters, digits and dashes")
    }

    /// The stratum and index of a key made by [`Stratum::item_key`], with or without a cell before it.
    pub fn of_key(key: &str) -> Option<(Self, u64)> {
        let own = key.rsplit('/').next()?;
        let (stratum, index) = own.rsplit_once('-')?;
        Some((stratum.parse().ok()?, index.parse().ok()?))
    }
}

impl fmt::Display for Stratum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.regime, self.context)
    }
}

/// A text that names no stratum.
#[derive(Debug, thiserror::Error)]
#[error("`{0}` is not a stratum: expected L0 to L3, a dash, and environment, open or enclosed")]
pub struct ParseStratumError(String);

impl FromStr for Stratum {
    type Err = ParseStratumError;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::all().find(|s| s.to_string() == text).ok_or_else(|| ParseStratumError(text.to_owned()))
    }
}

impl TryFrom<String> for Stratum {
    type Error = ParseStratumError;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Stratum> for String {
    fn from(stratum: Stratum) -> Self {
        stratum.to_string()
    }
}

impl JsonSchema for Stratum {
    fn schema_name() -> Cow<'static, str> {
        "Stratum".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let names: Vec<String> = Self::all().map(|stratum| stratum.to_string()).collect();
        json_schema!({ "type": "string", "enum": names })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_carry_their_stratum() {
        assert_eq!(Stratum::all().count(), 12);
        for stratum in Stratum::all() {
            let key = stratum.item_key(123);
            assert_eq!(Stratum::of_key(key.as_str()), Some((stratum, 123)));
        }
        assert_eq!(Stratum::of_key("cell/L1-open-000007").map(|s| s.1), Some(7));
        assert!(Stratum::of_key("L9-open-1").is_none());
        let open: Stratum = serde_json::from_str("\"L1-open\"").expect("a stratum");
        assert_eq!(serde_json::to_string(&open).expect("a text"), "\"L1-open\"");
        assert!(serde_json::from_str::<Stratum>("\"L9-open\"").is_err());
    }
}
