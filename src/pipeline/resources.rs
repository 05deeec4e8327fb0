//! The resources that a pipeline asks a scheduler for, node by node: `resources: { cores: 4, memory: 8GiB, time: 2h,
//! gpu: 1 }`. They take the place of those of the kind.

use super::{
    read,
    yaml::{Data, Key, Yaml},
};
use crate::{
    diagnostics::{Hint, Problem},
    units,
};
use std::sync::Arc;
use tauflow_contract::Resources;

/// Keys of `resources`.
const KEYS: [&str; 4] = ["cores", "memory", "time", "gpu"];
/// Nobody has more of them.
const MOST: u64 = 100_000;

/// Resources of a node as its pipeline gives them: each is left to the kind, or given, or left to the scheduler.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AskedResources {
    cores: Option<Option<u32>>,
    memory: Option<Option<u64>>,
    time: Option<Option<u64>>,
    gpus: Option<Option<u32>>,
}

impl AskedResources {
    /// The resources of an action whose kind states these.
    pub fn over(self, kind: Resources) -> Resources {
        Resources {
            cores: self.cores.unwrap_or(kind.cores),
            memory: self.memory.unwrap_or(kind.memory),
            time: self.time.unwrap_or(kind.time),
            gpus: self.gpus.unwrap_or(kind.gpus),
        }
    }

    /// Reads `resources` of a node.
    pub(super) fn read(value: Yaml, problems: &mut Vec<Problem>) -> Self {
        let mut asked = Self::default();
        for (key, value) in read::map(value, "resources", problems) {
            match key.text.as_str() {
                "cores" => asked.cores = Some(count(&key, &value, 1, problems)),
                "gpu" => asked.gpus = Some(count(&key, &value, 0, problems)),
                "memory" => asked.memory = Some(quantity(&key, &value, "8GiB", units::bytes, problems)),
                "time" => {
                    let whole = |text: &str| units::seconds(text).map(|seconds| seconds.ceil() as u64);
                    asked.time = Some(quantity(&key, &value, "2h", whole, problems));
                }
                other => {
                    let names: Arc<[String]> = KEYS.iter().map(|key| (*key).to_owned()).collect();
                    let hint = Hint::near(other, "keys of `resources`", &names);
                    problems.push(Problem::at(key.span, format!("unknown key `{other}` of `resources`")).hint(hint));
                }
            }
        }
        asked
    }
}

/// A whole number; none for null.
fn count(key: &Key, value: &Yaml, least: u64, problems: &mut Vec<Problem>) -> Option<u32> {
    if value.data == Data::Null {
        return None;
    }
    let number = if let Data::Number(number) = &value.data { number.as_u64() } else { None };
    if let Some(number) = number.filter(|number| (least..=MOST).contains(number)) {
        return u32::try_from(number).ok();
    }
    let message = format!("`{}` must be a whole number from {least} to {MOST}", key.text);
    let hint = format!("write `{}: 1`, or `null` to leave it to the scheduler", key.text);
    problems.push(Problem::at(value.span, message).hint(hint));
    None
}

/// A quantity with a unit, above 0; none for null.
fn quantity(
    key: &Key,
    value: &Yaml,
    example: &str,
    parse: impl Fn(&str) -> Result<u64, String>,
    problems: &mut Vec<Problem>,
) -> Option<u64> {
    if value.data == Data::Null {
        return None;
    }
    // A number without a unit could mean anything.
    let has_unit = |text: &str| text.ends_with(|c: char| c.is_ascii_alphabetic());
    let found = match &value.data {
        Data::Text(text) if has_unit(text) => parse(text).ok().filter(|quantity| *quantity > 0),
        _ => None,
    };
    if found.is_none() {
        let message = format!("`{}` must be a number above 0 with a unit", key.text);
        let hint = format!("write `{}: {example}`, or `null` to leave it to the scheduler", key.text);
        problems.push(Problem::at(value.span, message).hint(hint));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::yaml;

    fn read(text: &str) -> (AskedResources, Vec<String>) {
        let mut problems = Vec::new();
        let asked = AskedResources::read(yaml::parse(text, 0).expect("YAML"), &mut problems);
        (asked, problems.into_iter().map(|problem| problem.message).collect())
    }

    #[test]
    fn a_pipeline_changes_the_resources_of_a_kind_one_by_one() {
        let kind = Resources::default().cores(2).memory(1 << 30).time(60.0);
        let (asked, problems) = read("{ cores: 8, memory: 1.5GiB, time: null, gpu: 1 }");
        assert!(problems.is_empty(), "{problems:?}");
        let expected = Resources { cores: Some(8), memory: Some(3 << 29), time: None, gpus: Some(1) };
        assert_eq!(asked.over(kind), expected);
        assert_eq!(AskedResources::default().over(kind), kind);
        assert_eq!(read("{ time: 90m }").0.over(kind).time, Some(5400));
    }

    #[test]
    fn wrong_resources_are_problems() {
        for (text, told) in [
            ("{ cores: 0 }", "`cores` must be a whole number from 1"),
            ("{ cores: 1.5 }", "`cores` must be a whole number"),
            ("{ gpu: -1 }", "`gpu` must be a whole number from 0"),
            ("{ memory: 8 }", "`memory` must be a number above 0 with a unit"),
            ("{ memory: '8' }", "`memory` must be a number above 0 with a unit"),
            ("{ memory: 0GiB }", "`memory` must be a number above 0"),
            ("{ time: 2 weeks }", "`time` must be a number above 0 with a unit"),
            ("{ gpus: 1 }", "unknown key `gpus` of `resources`"),
            ("4", "resources must be a map"),
        ] {
            let (_, problems) = read(text);
            assert!(problems.len() == 1 && problems[0].contains(told), "{text}: {problems:?}");
        }
    }
}
