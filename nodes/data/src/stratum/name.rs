//! Names of strata: those of the generated ones, and any that own scenes are given.

use super::Stratum;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, cmp::Ordering, fmt, str::FromStr, sync::Arc};
use tauflow_contract::ItemKey;

/// Longest name, in bytes.
const LONGEST: usize = 64;

/// Digits of an index in a key, and least digits of an index behind a name that is not a generated one.
const DIGITS: usize = 6;

/// The group of items whose keys name no stratum, and that of all items: no stratum has these names.
const OTHER: &str = "other";
const ALL: &str = "all";

/// The name of a stratum: one of the generated ones, such as `L1-open`, or any other that own scenes are given.
///
/// It has 1 to 64 letters, digits, `_`, `-` and `.`, begins with a letter or a digit, and is not `all` or `other`.
/// Generated strata come first, in their order, then the others by their names.
#[derive(Clone, PartialEq, Eq, Hash, Debug, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct StratumName(Arc<str>);

/// A text that cannot be the name of a stratum.
#[derive(Debug, thiserror::Error)]
#[error(
    "`{0}` cannot be the name of a stratum; use 1 to {LONGEST} letters, digits, `_`, `-` and `.`, beginning with a \
     letter or a digit, and neither `all` nor `other`"
)]
pub struct StratumNameError(String);

/// The place of a name among others: generated ones, free ones, and items without one.
fn rank(name: &str) -> (usize, &str) {
    let generated = Stratum::all().count();
    match name.parse::<Stratum>() {
        Ok(stratum) => (Stratum::all().position(|s| s == stratum).unwrap_or(generated), ""),
        Err(_) => (generated + usize::from(name == OTHER), name),
    }
}

impl StratumName {
    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The generated stratum of this name, if it is one.
    pub fn generated(&self) -> Option<Stratum> {
        self.0.parse().ok()
    }

    /// Key of the `index`-th scene of this stratum, e.g. `kitchens-000123`.
    pub fn item_key(&self, index: u64) -> ItemKey {
        ItemKey::new(format!("{self}-{index:0DIGITS$}")).expect("made of letters that keys have")
    }

    /// The stratum and index of a key made by [`StratumName::item_key`], with or without a cell before it.
    pub fn of_key(key: &str) -> Option<(Self, u64)> {
        let own = key.rsplit('/').next()?;
        let (name, index) = own.rsplit_once('-')?;
        let name: Self = name.parse().ok()?;
        let counted = index.len() >= DIGITS || name.generated().is_some();
        (counted && index.bytes().all(|b| b.is_ascii_digit())).then_some(())?;
        Some((name, index.parse().ok()?))
    }

    /// The group that an item belongs to in reports: its stratum, or `other`.
    pub fn group_of(key: &str) -> String {
        Self::of_key(key).map_or_else(|| OTHER.to_owned(), |(name, _)| name.to_string())
    }

    /// Groups in the order in which reports list them: generated strata, then others, then [`StratumName::group_of`]
    /// of items without one.
    pub fn in_order<'n>(names: impl IntoIterator<Item = &'n String>) -> Vec<String> {
        let mut names: Vec<String> = names.into_iter().cloned().collect();
        names.sort_by(|a, b| rank(a).cmp(&rank(b)));
        names.dedup();
        names
    }

    /// The name of a group as reports show it: regime and context apart.
    pub fn label(name: &str) -> String {
        if name.parse::<Stratum>().is_ok() { name.replacen('-', " ", 1) } else { name.to_owned() }
    }
}

impl Ord for StratumName {
    fn cmp(&self, other: &Self) -> Ordering {
        rank(&self.0).cmp(&rank(&other.0))
    }
}

impl PartialOrd for StratumName {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl fmt::Display for StratumName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for StratumName {
    type Err = StratumNameError;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let fine = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-' | b'.');
        let begins = text.bytes().next().is_some_and(|b| b.is_ascii_alphanumeric());
        if !begins || text.len() > LONGEST || !text.bytes().all(fine) || [ALL, OTHER].contains(&text) {
            return Err(StratumNameError(text.chars().take(2 * LONGEST).collect()));
        }
        Ok(Self(text.into()))
    }
}

impl TryFrom<String> for StratumName {
    type Error = StratumNameError;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<StratumName> for String {
    fn from(name: StratumName) -> Self {
        name.to_string()
    }
}

impl From<Stratum> for StratumName {
    fn from(stratum: Stratum) -> Self {
        Self(stratum.to_string().into())
    }
}

impl JsonSchema for StratumName {
    fn schema_name() -> Cow<'static, str> {
        "StratumName".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "minLength": 1, "maxLength": LONGEST,
            "pattern": "^[A-Za-z0-9][A-Za-z0-9_.-]*$" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked_and_keys_carry_them() {
        for name in ["kitchens", "my-scenes.v2", "L9-open", "7", "a_b", &"x".repeat(64)] {
            let stratum: StratumName = name.parse().expect(name);
            assert_eq!(StratumName::of_key(stratum.item_key(123).as_str()), Some((stratum.clone(), 123)));
            let cell = format!("from=1/{}", stratum.item_key(1_234_567));
            assert_eq!(StratumName::of_key(&cell), Some((stratum, 1_234_567)));
        }
        for name in ["", "-a", ".a", "a/b", "a b", "ä", "a=b", "a+b", "all", "other", &"x".repeat(65)] {
            assert!(name.parse::<StratumName>().is_err(), "{name}");
            assert!(serde_json::from_value::<StratumName>(serde_json::json!(name)).is_err(), "{name}");
        }
        for stratum in Stratum::all() {
            let name = StratumName::from(stratum);
            assert_eq!((name.item_key(7), name.generated()), (stratum.item_key(7), Some(stratum)));
            assert_eq!(serde_json::to_value(&name).expect("a text"), serde_json::json!(stratum));
        }
        // Other files of one name, and counts of few digits, name no stratum.
        for key in ["x.glb", "render-12", "a-00001x", "noindex", "-000001"] {
            assert_eq!((StratumName::of_key(key), StratumName::group_of(key)), (None, "other".to_owned()), "{key}");
        }
        assert_eq!(StratumName::group_of("L1-open-7"), "L1-open");
    }

    #[test]
    fn generated_strata_come_first() {
        let names = ["other", "kitchens", "L3-enclosed", "alleys", "L0-open", "L0-environment", "kitchens"];
        let ordered = StratumName::in_order(&names.map(str::to_owned));
        assert_eq!(ordered, ["L0-environment", "L0-open", "L3-enclosed", "alleys", "kitchens", "other"]);
        let mut all: Vec<StratumName> = ordered.iter().rev().filter_map(|name| name.parse().ok()).collect();
        all.sort();
        assert_eq!(all.iter().map(StratumName::as_str).collect::<Vec<_>>(), ordered[..5]);
        assert_eq!(["L0-open", "my-alleys"].map(StratumName::label), ["L0 open", "my-alleys"]);
    }
}
