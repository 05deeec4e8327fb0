//! Content signatures: what a scene is, apart from how it is photographed.
//!
//! Knows recipes only. Two scenes of one signature are near-duplicates: the same layout template with the same
//! parameters to within a step, the same objects and the same environment. Camera, exposure, light and seed do not
//! count, and neither do the numbers of content and view: views of one content share a signature by what they show.

use std::collections::BTreeMap;
use tauflow_contract::{Digest, canonical_bytes};
use tauflow_data::{maths, records::Leak, scene::Recipe};

/// Step of the parameters when none is said.
pub const QUANTUM: f64 = 0.05;

/// The number of a parameter's step: `round(sign(v) ln(1 + |v|) / ln(1 + quantum))`.
///
/// Near 0 a step is `quantum` (metres, radians); for large values it is the share `quantum` of the value.
pub fn quantised(value: f64, quantum: f64) -> i64 {
    let size = maths::log1p(value.abs()) / maths::log1p(quantum);
    (if value < 0.0 { -size } else { size }).round() as i64
}

/// Digest of the layout template, its quantised parameters, the object set and the environment.
pub fn signature(recipe: &Recipe, quantum: f64) -> Digest {
    let params: BTreeMap<&str, i64> =
        recipe.layout_params.iter().map(|(name, value)| (name.as_str(), quantised(*value, quantum))).collect();
    let mut objects: Vec<&str> = recipe.objects.iter().map(String::as_str).collect();
    objects.sort_unstable();
    let value = serde_json::json!(["tauflow-signature-1", recipe.layout, params, objects, recipe.environment]);
    Digest::of(&canonical_bytes(&value))
}

/// Every signature that stands on both sides; there must be none.
pub fn check_leaks<'a>(
    train: impl IntoIterator<Item = (&'a str, &'a Recipe)>,
    test: impl IntoIterator<Item = (&'a str, &'a Recipe)>,
    quantum: f64,
) -> Vec<Leak> {
    let mut sides: BTreeMap<Digest, (Vec<String>, Vec<String>)> = BTreeMap::new();
    for (key, recipe) in train {
        sides.entry(signature(recipe, quantum)).or_default().0.push(key.to_owned());
    }
    for (key, recipe) in test {
        sides.entry(signature(recipe, quantum)).or_default().1.push(key.to_owned());
    }
    sides
        .into_iter()
        .filter(|(_, (train, test))| !train.is_empty() && !test.is_empty())
        .map(|(signature, (train, test))| Leak { signature: signature.to_string(), train, test })
        .collect()
}

/// Assets (objects if `objects`, environments if `environments`) that stand on both sides, by name.
pub fn shared_assets<'a>(
    train: impl IntoIterator<Item = &'a Recipe>,
    test: impl IntoIterator<Item = &'a Recipe>,
    objects: bool,
    environments: bool,
) -> Vec<String> {
    let names = |recipes: &mut dyn Iterator<Item = &'a Recipe>| {
        let mut out = std::collections::BTreeSet::new();
        for recipe in recipes {
            if objects {
                out.extend(recipe.objects.iter().cloned());
            }
            if environments && recipe.environment != "none" {
                out.insert(recipe.environment.clone());
            }
        }
        out
    };
    let train = names(&mut train.into_iter());
    let test = names(&mut test.into_iter());
    train.intersection(&test).cloned().collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use tauflow_data::scene::Side;

    pub(crate) fn recipe(stratum: &str, index: u64, width: f64) -> Recipe {
        Recipe {
            stratum: stratum.to_owned(),
            index,
            content: None,
            view: 0,
            layout: "box_room".to_owned(),
            layout_params: BTreeMap::from([("room.width".to_owned(), width), ("turn".to_owned(), -0.5)]),
            objects: vec!["procedural/vase-01".to_owned(), "cat.glb".to_owned()],
            environment: "none".to_owned(),
            side: None,
            exposure_ev: 0.1,
        }
    }

    #[test]
    fn camera_exposure_seed_and_side_do_not_count_but_content_does() {
        let base = recipe("L0-open", 3, 4.0);
        let same = |other: &Recipe| signature(&base, QUANTUM) == signature(other, QUANTUM);
        let mut other = base.clone();
        other.exposure_ev = -1.0;
        other.index = 9;
        (other.content, other.view) = (Some(8), 3);
        other.side = Some(Side::Test);
        other.objects.reverse();
        assert!(same(&other));
        other.layout_params.insert("turn".to_owned(), -0.500_01);
        assert!(same(&other), "within a step");
        for change in [
            |r: &mut Recipe| r.layout = "corridor".into(),
            |r: &mut Recipe| r.objects[0] = "dog.glb".into(),
            |r: &mut Recipe| r.environment = "sky".into(),
            |r: &mut Recipe| *r.layout_params.entry("room.width".into()).or_default() = 4.5,
        ] {
            let mut other = base.clone();
            change(&mut other);
            assert!(!same(&other));
        }
    }

    #[test]
    fn steps_are_absolute_near_zero_and_relative_far_out() {
        assert_eq!(quantised(0.0, 0.05), 0);
        assert_eq!(quantised(0.02, 0.05), 0);
        assert_eq!(quantised(0.05, 0.05), 1);
        assert_eq!(quantised(-0.05, 0.05), -1);
        assert_eq!(quantised(1000.0, 0.05), quantised(1010.0, 0.05));
        assert_ne!(quantised(1000.0, 0.05), quantised(1100.0, 0.05));
    }
}
