//! Which scenes are of one group: views of one content, which no interval may count as independent scenes.
//!
//! Knows the report of a split, and no image.

use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Action, All, Context, KindError};
use tauflow_data::records::SplitReport;

/// The input of kinds that have intervals over groups.
pub(crate) const SPLIT: All<SplitReport> =
    All::new("split", "The report of the split: intervals are over its groups, otherwise over scenes.")
        .or_none()
        .single();

/// The group of each scene, if a split says so.
#[derive(Clone, Debug, Default)]
pub struct Groups(Option<BTreeMap<String, String>>);

impl Groups {
    /// Each scene for itself.
    pub fn none() -> Self {
        Self(None)
    }

    /// Those of a split.
    pub fn of_split(split: &SplitReport) -> Self {
        let own = |(scene, group): (&str, &str)| (scene.to_owned(), group.to_owned());
        Self(Some(split.signatures().into_iter().map(own).collect()))
    }

    /// Those of the split that an action reads, if one is connected.
    ///
    /// # Errors
    /// If the report is missing or damaged.
    pub(crate) fn load<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<Self, KindError> {
        let split = action.only_if(SPLIT)?.map(|report| report.load(ctx)).transpose()?;
        Ok(split.as_ref().map_or_else(Self::none, Self::of_split))
    }

    /// The group of a scene; none where each scene stands for itself.
    ///
    /// # Errors
    /// [`KindError::Input`] if the split does not have the scene.
    pub fn of(&self, scene: &str) -> Result<Option<&str>, KindError> {
        let Some(groups) = &self.0 else { return Ok(None) };
        groups.get(scene).map(|group| Some(group.as_str())).ok_or_else(|| {
            KindError::Input(format!(
                "`{}` does not have the scene `{scene}`; connect the report of the split that it comes from, or none",
                SPLIT.name()
            ))
        })
    }

    /// How many groups these scenes are of; none where each stands for itself.
    ///
    /// # Errors
    /// As [`Groups::of`].
    pub fn count<'a>(&self, scenes: impl Iterator<Item = &'a str>) -> Result<Option<u64>, KindError> {
        let found: BTreeSet<Option<&str>> = scenes.map(|scene| self.of(scene)).collect::<Result<_, _>>()?;
        Ok(self.0.as_ref().map(|_| found.len() as u64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{records::SceneGroup, scene::Side};

    #[test]
    fn scenes_are_of_the_groups_that_the_split_says() {
        let group = |signature: &str, items: &[&str]| SceneGroup {
            signature: signature.into(),
            side: Side::Test,
            items: items.iter().map(|item| (*item).to_owned()).collect(),
        };
        let split = SplitReport { groups: vec![group("s", &["a", "b"]), group("t", &["c"])], ..SplitReport::default() };
        let groups = Groups::of_split(&split);
        assert_eq!(
            ["a", "b", "c"].map(|s| groups.of(s).expect("there").map(str::to_owned)).map(|g| g.expect("one")),
            ["s", "s", "t"]
        );
        assert_eq!(groups.count(["a", "b"].into_iter()).expect("there"), Some(1));
        assert_eq!(groups.count(["a", "c"].into_iter()).expect("there"), Some(2));
        let refused = groups.of("d").expect_err("not there").to_string();
        assert!(refused.contains("`d`") && refused.contains("`split`"), "{refused}");
        assert_eq!(
            (Groups::none().of("d").expect("any"), Groups::none().count(["d"].into_iter()).expect("any")),
            (None, None)
        );
    }
}
