#![doc = include_str!("bridge_validation.md")]

use crate::{
    bridge_maps::stop_map,
    bridge_tables::{SceneCases, csv, fraction, summarise},
    groups::{Groups, SPLIT},
    image_metrics::{not_comparable, rung},
    metrics::linear_psnr,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, All, Context, Digest, Group, ItemKey, Items, Kind, KindError, KindSpec, Mode, Out, Outputs,
};
use tauflow_data::{
    Image, VarianceTime,
    methods::HOLD,
    records::{BridgeCase, BridgeClock, BridgeFiles, BridgeSteps, PackedScene, RefinedImage, RefinedImages},
};

/// The kind `bridge_validation`.
pub struct BridgeValidation;

/// Params of `bridge_validation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BridgeValidationParams {
    /// Number of bootstrap resamples.
    #[schemars(range(min = 100, max = 100_000))]
    pub resamples: u64,
    /// Number of scenes with maps.
    #[schemars(range(max = 1000))]
    pub map_scenes: u64,
}

impl Default for BridgeValidationParams {
    fn default() -> Self {
        Self { resamples: 2000, map_scenes: 2 }
    }
}

const ENDPOINTS: All<PackedScene> = All::new("endpoints", "Scenes at consecutive sample counts, such as 1..10.");
const STEPS: All<BridgeSteps> = All::new("steps", "The output of `bridge_refinement` for the same scenes.");
const MAIN: Group = Group::main(3);
const BRIDGE: Out<BridgeFiles> = Out::new(MAIN, "bridge", "Tables, cases and maps.").single().published();

impl Kind for BridgeValidation {
    type Params = BridgeValidationParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "bridge_validation",
            summary: "Compares solver steps between rungs with the real rungs.",
            manual: include_str!("bridge_validation.md"),
            mode: Mode::Gather,
            inputs: vec![ENDPOINTS.port(), STEPS.port(), SPLIT.port()],
            outputs: vec![BRIDGE.port()],
            seeded: true,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let (endpoints, steps) = (action.all(ENDPOINTS)?, action.all(STEPS)?);
        same_scenes(endpoints, steps)?;
        let mut maps: Vec<(String, Digest)> = Vec::new();
        let mut scenes = Vec::with_capacity(endpoints.len());
        let mut clock: Option<BridgeClock> = None;
        for (index, (key, packed)) in endpoints.iter().enumerate() {
            ctx.check_cancelled()?;
            let steps = steps.get(key.as_str()).expect("both have the same scenes");
            let BridgeSteps { clock: own, images } = steps.load(ctx)?;
            if *clock.get_or_insert(own) != own {
                return Err(KindError::Input(format!(
                    "`{key}` was stepped by solvers of another training ladder than the scenes before it"
                )));
            }
            let scene = Stepped {
                key: key.as_str(),
                packed: packed.load(ctx)?,
                images,
                time: VarianceTime::new(own.n_min, own.n_max)?,
            };
            scenes.push(scene.cases()?);
            if has_maps(index, endpoints.len(), action.params.map_scenes as usize) {
                for (name, png) in scene.maps()? {
                    maps.push((name, ctx.put(&png)?));
                }
            }
            ctx.progress(index as u64 + 1, endpoints.len() as u64, "");
        }
        let clock = clock.ok_or_else(|| KindError::Input("there are no scenes to validate the bridge on".into()))?;
        let keys: Vec<&str> = endpoints.iter().map(|(key, _)| key.as_str()).collect();
        let groups = Groups::load(ctx, action)?;
        let bridge = summarise(&scenes, (&keys, &groups), clock.n_max, action.params.resamples, action.seed)?;
        let files = BridgeFiles::of_stored(ctx, &bridge, csv(&bridge).as_bytes(), maps)?;
        Outputs::default().put_one(BRIDGE, "bridge", files)
    }
}

fn same_scenes(endpoints: Items<'_, PackedScene>, steps: Items<'_, BridgeSteps>) -> Result<(), KindError> {
    let message = |key: &ItemKey, port: &str, other: &str| {
        KindError::Input(format!(
            "`{port}` lacks the item `{key}` of `{other}`; connect `bridge_refinement` of the same endpoints"
        ))
    };
    if let Some((key, _)) = endpoints.iter().find(|(key, _)| steps.get(key.as_str()).is_none()) {
        return Err(message(key, STEPS.name(), ENDPOINTS.name()));
    }
    match steps.iter().find(|(key, _)| endpoints.get(key.as_str()).is_none()) {
        Some((key, _)) => Err(message(key, ENDPOINTS.name(), STEPS.name())),
        None => Ok(()),
    }
}

/// Whether a scene is one of `wanted`, spread evenly over `count`.
fn has_maps(index: usize, count: usize, wanted: usize) -> bool {
    let wanted = wanted.min(count);
    (0..wanted).any(|i| i * count / wanted == index)
}

/// A scene's rungs and what was made of them.
struct Stepped<'a> {
    key: &'a str,
    packed: PackedScene,
    images: RefinedImages,
    time: VarianceTime,
}

/// Kind of stop, sample count before, sample count after.
type Stop = (&'static str, u64, u64);

impl Stepped<'_> {
    /// Kind of the stop between two rungs.
    fn stop(&self, said: &RefinedImage) -> Result<Stop, KindError> {
        let RefinedImage { from_spp: from, to_spp: to, .. } = *said;
        let last = self.packed.counts.last().copied().unwrap_or(0);
        if to == from + 1 {
            Ok(("adjacent", from, to))
        } else if to == last && from < to {
            Ok(("direct", from, to))
        } else {
            Err(KindError::Input(format!(
                "`steps` of `{}` has a step {from} -> {to}, which is neither to the next count nor to the last, {last}",
                self.key
            )))
        }
    }

    /// Every image, measured.
    fn cases(&self) -> Result<SceneCases, KindError> {
        let mut cases = SceneCases::new();
        for (said, image) in &self.images {
            let (stop, from, to) = self.stop(said)?;
            let (start, real) = (rung(&self.packed, from)?, rung(&self.packed, to)?);
            let psnr = linear_psnr(image, real).map_err(|e| not_comparable(&e, said, self.key))?;
            let is_hold = said.method == HOLD;
            if is_hold && image != start {
                return Err(KindError::Input(format!(
                    "the start of `steps` at {from} samples is not that of `endpoints` in `{}`; connect both to the \
                     same node",
                    self.key
                )));
            }
            let share = fraction(self.time, from, to)?;
            let case = BridgeCase {
                scene: self.key.to_owned(),
                stop: stop.to_owned(),
                method: said.method.clone(),
                from_spp: from,
                to_spp: to,
                psnr,
                direction: if is_hold { None } else { cosine(image, start, real) },
            };
            if cases.insert((stop, from, said.method.clone()), (share, case)).is_some() {
                return Err(KindError::Input(format!(
                    "`steps` of `{}` has two images of `{}` at {from} -> {to}",
                    self.key, said.method
                )));
            }
        }
        Ok(cases)
    }

    /// One picture for each stop, by scene and stop.
    fn maps(&self) -> Result<Vec<(String, Vec<u8>)>, KindError> {
        let mut stops: BTreeMap<Stop, BTreeMap<&str, &Image>> = BTreeMap::new();
        for (said, image) in &self.images {
            let images = stops.entry(self.stop(said)?).or_default();
            if said.method != HOLD {
                images.insert(&said.method, image);
            }
        }
        let map = |((stop, from, to), images): (Stop, BTreeMap<&str, &Image>)| {
            let images: Vec<&Image> = images.into_values().collect();
            let png = stop_map(rung(&self.packed, from)?, rung(&self.packed, to)?, &images)?;
            Ok((format!("{}/{stop}-{from:02}.png", self.key), png))
        };
        stops.into_iter().map(map).collect()
    }
}

/// Cosine between the update that was made and the real one; none if either is nothing.
fn cosine(image: &Image, start: &Image, real: &Image) -> Option<f64> {
    let (mut product, mut made, mut wanted) = (0.0, 0.0, 0.0);
    for ((image, start), real) in image.data().iter().zip(start.data()).zip(real.data()) {
        let start = f64::from(*start);
        let (a, b) = (f64::from(*image) - start, f64::from(*real) - start);
        product += a * b;
        made += a * a;
        wanted += b * b;
    }
    (made > 0.0 && wanted > 0.0).then(|| product / (made * wanted).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosines_of_updates() {
        let image = |data: [f32; 3]| Image::from_data(1, 1, 3, data.to_vec()).expect("fits");
        let (start, real) = (image([1.0, 1.0, 1.0]), image([2.0, 1.0, 1.0]));
        assert_eq!(cosine(&image([1.5, 1.0, 1.0]), &start, &real), Some(1.0));
        assert_eq!(cosine(&image([0.5, 1.0, 1.0]), &start, &real), Some(-1.0));
        assert_eq!(cosine(&image([1.0, 3.0, 1.0]), &start, &real), Some(0.0));
        assert_eq!(cosine(&start, &start, &real), None);
    }

    #[test]
    fn maps_are_spread_over_the_scenes() {
        let of = |count, wanted| (0..count).filter(|i| has_maps(*i, count, wanted)).collect::<Vec<_>>();
        assert_eq!(of(10, 2), [0, 5]);
        assert_eq!(of(3, 9), [0, 1, 2]);
        assert!(of(4, 0).is_empty());
    }
}
