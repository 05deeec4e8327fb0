#![doc = include_str!("bridge_validation.md")]

use crate::{
    bridge_maps::{stop_map, strip},
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
    methods::{BridgeMethod, HOLD, Parameterization},
    records::{
        BridgeCase, BridgeClock, BridgeFiles, BridgeSteps, Exposure, Ladder, Moments, PackedScene, RefinedImage,
        RefinedImages,
    },
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
const REFERENCES: All<Ladder> =
    All::new("references", "Held-out references of the same scenes, for variances and covariances.").or_none();
const EXPOSURE: All<Exposure> = All::new("exposure", "The exposure of the same scenes, for references.").or_none();
const MAIN: Group = Group::main(5);
const BRIDGE: Out<BridgeFiles> = Out::new(MAIN, "bridge", "Tables, cases and maps.").single().published();

impl Kind for BridgeValidation {
    type Params = BridgeValidationParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "bridge_validation",
            summary: "Compares solver steps between rungs with the real rungs.",
            manual: include_str!("bridge_validation.md"),
            mode: Mode::Gather,
            inputs: vec![ENDPOINTS.port(), STEPS.port(), REFERENCES.port(), EXPOSURE.port(), SPLIT.port()],
            outputs: vec![BRIDGE.port()],
            seeded: true,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let (endpoints, steps) = (action.all(ENDPOINTS)?, action.all(STEPS)?);
        same_scenes(endpoints, steps)?;
        let held = match (action.all_if(REFERENCES)?, action.all_if(EXPOSURE)?) {
            (Some(references), Some(exposure)) => Some((references, exposure)),
            (None, None) => None,
            _ => return Err(KindError::Input("`references` need `exposure`; connect both, or none".into())),
        };
        let mut maps: Vec<(String, Digest)> = Vec::new();
        let mut scenes = Vec::with_capacity(endpoints.len());
        let mut seen: Option<(BridgeClock, BTreeMap<String, String>)> = None;
        for (index, (key, packed)) in endpoints.iter().enumerate() {
            ctx.check_cancelled()?;
            let steps = steps.get(key.as_str()).expect("both have the same scenes");
            let BridgeSteps { clock: own, setting, images } = steps.load(ctx)?;
            let first = seen.get_or_insert_with(|| (own, setting.clone()));
            if *first != (own, setting) {
                return Err(KindError::Input(format!(
                    "`{key}` was stepped by solvers of another training ladder or setting than the scenes before it"
                )));
            }
            let held = match held {
                Some((references, exposure)) => {
                    let lacks = |port: &str| {
                        let told = format!("`{port}` lacks the item `{key}` of `endpoints`; connect the same scenes");
                        KindError::Input(told)
                    };
                    let ladder = references.get(key.as_str()).ok_or_else(|| lacks(REFERENCES.name()))?;
                    let exposure = exposure.get(key.as_str()).ok_or_else(|| lacks(EXPOSURE.name()))?;
                    Some(Held::new(&ladder.load(ctx)?, exposure.load(ctx)?.factor, key)?)
                }
                None => None,
            };
            let scene = Stepped { key: key.as_str(), packed: packed.load(ctx)?, images, held, time: own.time()? };
            scenes.push(scene.cases()?);
            if has_maps(index, endpoints.len(), action.params.map_scenes as usize) {
                for (name, png) in scene.maps()? {
                    maps.push((name, ctx.put(&png)?));
                }
            }
            ctx.progress(index as u64 + 1, endpoints.len() as u64, "");
        }
        let (clock, setting) =
            seen.ok_or_else(|| KindError::Input("there are no scenes to validate the bridge on".into()))?;
        let keys: Vec<&str> = endpoints.iter().map(|(key, _)| key.as_str()).collect();
        let groups = Groups::load(ctx, action)?;
        let (clock, seed) = ((clock.n_max, &setting), action.seed);
        let bridge = summarise(&scenes, (&keys, &groups), clock, action.params.resamples, seed)?;
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
    held: Option<Held>,
    time: VarianceTime,
}

/// A held-out reference, exposed, with the variance of its single samples.
struct Held {
    image: Image,
    variance: Image,
}

impl Held {
    fn new(ladder: &Ladder, factor: f64, key: &ItemKey) -> Result<Self, KindError> {
        let last = ladder.rungs.last();
        let last = last.ok_or_else(|| KindError::Input(format!("the reference of `{key}` has no rung")))?;
        if !ladder.meta.sampler.is_independent() {
            return Err(KindError::Input(format!(
                "the samples of the reference of `{key}` are correlated, so their variance is unknown; render it with \
                 `sampler: independent`"
            )));
        }
        let exposed = |image: &Image, factor: f64| image.map(|v| (f64::from(v) * factor) as f32);
        Ok(Self { image: exposed(&last.image, factor), variance: exposed(&ladder.variance, factor * factor) })
    }

    /// Moments of an image of m samples and of the real rung, around the reference; none where nothing varies.
    ///
    /// Both are sums over values, weighted by 1/(s^2 + mean s^2), so that neither a few very noisy pixels nor nearly
    /// noise-free ones decide, relative to the same sum of s^2/m.
    fn moments(&self, image: &Image, real: &Image, start: &Image, to: u64) -> Option<Moments> {
        let count = self.variance.data().len().max(1) as f64;
        let floor = self.variance.data().iter().map(|v| f64::from(*v)).sum::<f64>() / count;
        let (mut sums, mut law) = ([0.0; 4], 0.0);
        for at in 0..self.variance.data().len() {
            let variance = f64::from(self.variance.data()[at]);
            let off = |image: &Image| f64::from(image.data()[at]) - f64::from(self.image.data()[at]);
            let (own, truth, before) = (off(image), off(real), off(start));
            let weight = if floor > 0.0 { 1.0 / (variance + floor) } else { 0.0 };
            law += weight * variance / to as f64;
            let products = [own * own, truth * truth, own * before, truth * before];
            sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += weight * product);
        }
        let [variance, real_variance, covariance, real_covariance] = sums.map(|sum| sum / law);
        (law > 0.0).then_some(Moments { variance, real_variance, covariance, real_covariance })
    }
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
            if let Some(held) = self.held.as_ref().filter(|held| !held.image.same_shape(real)) {
                return Err(KindError::Input(format!(
                    "the reference of `{}` has {} x {} pixels, but the endpoints have {} x {}; render both with the \
                     same `resolution`",
                    self.key,
                    held.image.width(),
                    held.image.height(),
                    real.width(),
                    real.height()
                )));
            }
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
                moments: self.held.as_ref().and_then(|held| held.moments(image, real, start, to)),
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

    /// Two pictures for each stop, by scene and stop: of all methods of the network in linear radiance, and a strip of
    /// MC noise.
    fn maps(&self) -> Result<Vec<(String, Vec<u8>)>, KindError> {
        let mut stops: BTreeMap<Stop, BTreeMap<&str, &Image>> = BTreeMap::new();
        for (said, image) in &self.images {
            let images = stops.entry(self.stop(said)?).or_default();
            let method = BridgeMethod::of(&said.method);
            if method.rule != HOLD && !method.reference && !method.log {
                images.insert(&said.method, image);
            }
        }
        let mut maps = Vec::with_capacity(2 * stops.len());
        for ((stop, from, to), images) in stops {
            let (start, real) = (rung(&self.packed, from)?, rung(&self.packed, to)?);
            if let Some(stopped) = images.get(Parameterization::McNoise.name()) {
                maps.push((format!("{}/strip-{stop}-{from:02}.png", self.key), strip(start, stopped, real)?));
            }
            let images: Vec<&Image> = images.into_values().collect();
            maps.push((format!("{}/{stop}-{from:02}.png", self.key), stop_map(start, real, &images)?));
        }
        Ok(maps)
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
