//! `pipelines/adapter.yaml` with its profile `tiny`: both backbones, their adapters and controls, and samples in pairs.

use crate::support::{Done, root};
use std::collections::BTreeMap;
use tauflow::engine::RunOptions;
use tauflow_contract::Media;
use tauflow_data::records::{BackboneFiles, Family, Generated, TrainingLog, Variant};

#[test]
fn samples_of_both_backbones_are_made_in_pairs() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = root().join("pipelines/adapter.yaml");
    let done = Done::run_profile(&file, "tiny", Vec::new(), folder.path(), &RunOptions::default());
    let samples = done.collection("samples");
    let mut counts: BTreeMap<Family, usize> = BTreeMap::new();
    for (key, artifact) in samples.iter() {
        let sample = done.with(|ctx| Generated::load(ctx, artifact)).expect("whole");
        *counts.entry(sample.family).or_default() += 1;
        assert_eq!(key.as_str(), format!("{}-{:04}", sample.family.name(), sample.sample));
        let variants: Vec<Variant> = sample.variants.iter().map(|its| its.variant).collect();
        assert_eq!(variants, Variant::ALL, "{key}");
        let image = |variant| sample.variant(variant).expect("all are there").image.data();
        let apart = |variant: Variant| {
            let pairs = image(variant).iter().zip(image(Variant::Frozen));
            pairs.fold(0.0f32, |most, (a, b)| most.max((a - b).abs()))
        };
        assert!(apart(Variant::EtaZero) < 1e-5 && apart(Variant::UntrainedAdapter) < 1e-5, "{key}");
        assert!(apart(Variant::Adapted) > 0.0, "{key}");
        for its in &sample.variants {
            let injects = !matches!(its.variant, Variant::Frozen | Variant::EtaZero | Variant::UntrainedAdapter);
            // Nothing before the middle, and something in every step after it.
            let first = its.energy.len() / 2 + 1;
            assert!(its.energy[..first].iter().all(|energy| *energy == 0.0), "{key} {}", its.variant);
            assert!(its.energy[first..].iter().all(|energy| (*energy > 0.0) == injects), "{key} {}", its.variant);
        }
    }
    assert_eq!(counts, BTreeMap::from([(Family::Ddpm, 4), (Family::RectifiedFlow, 4)]));
    // One adapter for each backbone and residual, whose losses are numbers.
    let logs = done.collection("adapters.log");
    assert_eq!(logs.len(), 6);
    for (key, artifact) in logs.iter() {
        let log = done.with(|ctx| TrainingLog::load(ctx, artifact)).expect("whole");
        assert!(log.points.last().and_then(|point| point.train).is_some_and(f64::is_finite), "{key}");
    }
    // Backbones have the layout of published ones: what reads those reads these.
    for (key, artifact) in done.collection("trained").iter() {
        let files = done.with(|ctx| BackboneFiles::load(ctx, artifact)).expect("whole");
        let config: serde_json::Value = serde_json::from_str(&files.config).expect("JSON");
        assert!(config.get("_class_name").is_some() != config.get("nf").is_some(), "{key}: {config}");
    }
}
