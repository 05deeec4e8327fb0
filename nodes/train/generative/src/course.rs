//! A sample's way through its sampler, frozen and with adapters. All variants of a sample share its noise, which is a
//! function of (seed, sample, step), so that their way is the same until an adapter begins: it is taken once.
//!
//! Source: the paper's equations of the correction coordinate and of injection.

use crate::{
    adapter::Adapter,
    backbone::{Backbone, decoded},
    schedule::{Ddpm, Sampler},
};
use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    records::{GeneratedVariant, Snapshot, Variant},
    rng::Stream,
};

/// How a correction is put into a sampler.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Injection {
    /// Its strength.
    pub eta: f64,
    /// Share of the sampler's steps before it begins.
    pub start: f64,
}

impl Injection {
    /// eta g: eta times the square of how far the sampler is between the start and its end.
    fn gain(&self, progress: f64) -> f64 {
        let late = ((progress - self.start) / (1.0 - self.start)).clamp(0.0, 1.0);
        self.eta * late * late
    }

    /// Whether it has begun.
    fn begun(&self, progress: f64) -> bool {
        progress > self.start
    }
}

/// A clean image's value as an adapter sees it. `clamp_clean` clamps it to the range of the sampler, if the sampler
/// clips: a sampler that does not would make other images from a clamped prediction.
fn clamped(schedule: &Ddpm, clean: f32, clamp_clean: bool) -> f32 {
    match schedule.clip().filter(|_| clamp_clean) {
        Some(range) => clean.clamp(-range, range),
        None => clean,
    }
}

/// The frozen prediction in the coordinate that an adapter corrects: the velocity itself, or the state less the clean
/// image that the noise implies.
pub(crate) fn base(sampler: &Sampler, state: &[f32], prediction: &[f32], time: f64, clamp_clean: bool) -> Vec<f32> {
    let Sampler::Ddpm { schedule, .. } = sampler else { return prediction.to_vec() };
    let pairs = state.iter().zip(prediction);
    pairs.map(|(x, noise)| x - clamped(schedule, schedule.clean(*x, *noise, time as usize), clamp_clean)).collect()
}

/// The prediction with a correction, in the network's own terms: v + correction, or
/// eps + sqrt(abar/(1 - abar)) (I0 - clamp(I0) + correction), where the difference is there for `clamp_clean` alone.
fn injected(
    sampler: &Sampler,
    state: &[f32],
    prediction: &[f32],
    time: f64,
    clamp_clean: bool,
    correction: &[f32],
) -> Vec<f32> {
    let plus = |value: f32, by: f32| if by == 0.0 { value } else { value + by };
    let Sampler::Ddpm { schedule, .. } = sampler else {
        return prediction.iter().zip(correction).map(|(v, by)| plus(*v, *by)).collect();
    };
    let alpha = schedule.alpha(time as usize);
    let factor = (alpha / (1.0 - alpha)).sqrt() as f32;
    let numbers = state.iter().zip(prediction).zip(correction);
    numbers
        .map(|((x, noise), by)| {
            let clean = schedule.clean(*x, *noise, time as usize);
            let beyond = clean - clamped(schedule, clean, clamp_clean);
            plus(*noise, factor * (beyond + by))
        })
        .collect()
}

/// A sampler's time as adapters are told it: from 0 to 1.
pub(crate) fn unit_time(sampler: &Sampler, time: f64) -> f64 {
    match sampler {
        Sampler::Ddpm { schedule, .. } => time / (schedule.times() - 1) as f64,
        Sampler::Euler { .. } => time,
    }
}

/// A way of making a sample: frozen without an adapter.
pub struct Way<'a> {
    /// What it is called.
    pub variant: Variant,
    /// The adapter, and how it is put in.
    pub adapter: Option<(&'a Adapter, Injection)>,
}

impl Way<'_> {
    fn begun(&self, progress: f64) -> bool {
        self.adapter.as_ref().is_some_and(|(_, injection)| injection.begun(progress))
    }
}

/// One sample of a backbone.
pub struct Course<'a> {
    /// The network, which stays as it is.
    pub backbone: &'a Backbone,
    /// Its sampler.
    pub sampler: Sampler,
    /// Of all samples.
    pub seed: u64,
    /// Which one.
    pub sample: u64,
    /// Pixels of a side.
    pub side: usize,
    /// Steps after which the state is kept.
    pub frames: Vec<u64>,
}

/// A state on its way.
struct State {
    image: Image,
    energy: Vec<f64>,
    frames: Vec<Snapshot>,
}

impl Course<'_> {
    /// Standard normal numbers: of the start for 0, of step `index - 1` after it.
    fn noise(&self, index: u64) -> Vec<f32> {
        let mut stream = Stream::new(self.seed, &[self.sample, index]);
        (0..self.side * self.side * 3).map(|_| stream.normal() as f32).collect()
    }

    fn keep_frame(&self, state: &mut State, done: u64) {
        if self.frames.contains(&done) {
            let family = self.backbone.family();
            state.frames.push(Snapshot { step: done, image: state.image.map(|value| decoded(family, value)) });
        }
    }

    /// One step.
    fn step(&self, state: &mut State, step: usize, noise: &[f32], way: Option<&Way<'_>>) -> Result<(), KindError> {
        let (time, progress) = (self.sampler.time(step), step as f64 / self.sampler.steps() as f64);
        let mut prediction = self.backbone.predict(&[&state.image], &[time])?.remove(0).into_data();
        let mut energy = 0.0;
        if let Some((adapter, injection)) = way.filter(|way| way.begun(progress)).and_then(|way| way.adapter.as_ref()) {
            let clamp = adapter.info().clamp_clean;
            let base = base(&self.sampler, state.image.data(), &prediction, time, clamp);
            let base = Image::from_data(self.side, self.side, 3, base)?;
            let gain = injection.gain(progress) as f32;
            let correction = adapter.correct(&base, unit_time(&self.sampler, time))?.map(|value| gain * value);
            let square: f64 = correction.data().iter().map(|value| f64::from(*value).powi(2)).sum();
            energy = square / correction.data().len() as f64;
            prediction = injected(&self.sampler, state.image.data(), &prediction, time, clamp, correction.data());
        }
        self.sampler.advance(step, state.image.data_mut(), &prediction, noise);
        state.energy.push(energy);
        self.keep_frame(state, step as u64 + 1);
        Ok(())
    }

    /// Makes the sample in several ways; `calls` is told of each call of the network.
    ///
    /// # Errors
    /// If sizes do not fit, or values are no longer finite.
    pub fn run(&self, ways: &[Way<'_>], mut calls: impl FnMut()) -> Result<Vec<GeneratedVariant>, KindError> {
        let image = Image::from_data(self.side, self.side, 3, self.noise(0))?;
        let mut common = State { image, energy: Vec::new(), frames: Vec::new() };
        self.keep_frame(&mut common, 0);
        let steps = self.sampler.steps();
        let begun = |step: usize| ways.iter().any(|way| way.begun(step as f64 / steps as f64));
        let noise = |step: usize| if self.sampler.is_noisy(step) { self.noise(step as u64 + 1) } else { Vec::new() };
        let first = (0..steps).find(|step| begun(*step)).unwrap_or(steps);
        for step in 0..first {
            self.step(&mut common, step, &noise(step), None)?;
            calls();
        }
        let copy = |_: &Way<'_>| State {
            image: common.image.clone(),
            energy: common.energy.clone(),
            frames: common.frames.clone(),
        };
        let mut states: Vec<State> = ways.iter().map(copy).collect();
        for step in first..steps {
            let noise = noise(step);
            for (state, way) in states.iter_mut().zip(ways) {
                self.step(state, step, &noise, Some(way))?;
                calls();
            }
        }
        let family = self.backbone.family();
        let made = states.into_iter().zip(ways).map(|(state, way)| {
            state.image.finite(&format!("sample {} (`{}`)", self.sample, way.variant), "lower `eta`")?;
            let State { image, energy, frames } = state;
            let image = image.map(|value| decoded(family, value));
            Ok(GeneratedVariant { variant: way.variant, image, energy, frames })
        });
        made.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        adapter::{AdapterInfo, Residuals},
        backbone::Config,
        network::{NcsnppConfig, Unet2dConfig, slots},
        schedule::DdpmConfig,
    };
    use std::cell::Cell;
    use tauflow_contract::Digest;
    use tauflow_data::records::Family;
    use tauflow_tensors::Start;

    fn backbone(family: Family) -> Backbone {
        let config = match family {
            Family::Ddpm => Config::Ddpm(Box::new(Unet2dConfig::small(16, 16)), Box::default()),
            Family::RectifiedFlow => Config::RectifiedFlow(Box::new(NcsnppConfig::small(16, 16))),
        };
        let mut parameters = config.network().parameters().to_vec();
        parameters.iter_mut().filter(|p| p.start == Start::Zero).for_each(|p| p.start = Start::Normal(0.3));
        Backbone::new(config, &slots(&parameters).draw(5))
    }

    fn info(family: Family, clamp_clean: bool) -> AdapterInfo {
        let backbone = Digest::of(b"made up");
        AdapterInfo { backbone, family, residuals: Residuals::Rendered, clamp_clean, counts: vec![1, 2], steps: 1 }
    }

    /// An adapter whose last layer is not zero.
    fn trained(info: AdapterInfo) -> Adapter {
        let network = crate::adapter::AdapterNetwork::new();
        let mut weights = network.slots().draw(3);
        for values in weights.0.iter_mut().filter(|values| values.iter().all(|v| *v == 0.0)) {
            values.iter_mut().enumerate().for_each(|(i, v)| *v = (i % 11) as f32 * 0.02 - 0.1);
        }
        Adapter::new(info, weights)
    }

    fn course(backbone: &Backbone, steps: usize) -> Course<'_> {
        let frames = vec![0, steps as u64 / 2, steps as u64];
        Course { backbone, sampler: backbone.sampler(steps), seed: 7, sample: 2, side: 16, frames }
    }

    fn apart(a: &Image, b: &Image) -> f32 {
        a.data().iter().zip(b.data()).fold(0.0f32, |most, (a, b)| most.max((a - b).abs()))
    }

    #[test]
    fn no_strength_and_no_training_are_frozen_bit_for_bit_or_nearly_where_clean_images_are_clamped() {
        for family in [Family::Ddpm, Family::RectifiedFlow] {
            let backbone = backbone(family);
            for clamp_clean in [false, true] {
                let (trained, untrained) =
                    (trained(info(family, clamp_clean)), Adapter::untrained(info(family, clamp_clean), 1));
                let with =
                    |variant, adapter, eta| Way { variant, adapter: Some((adapter, Injection { eta, start: 0.5 })) };
                let ways = [
                    Way { variant: Variant::Frozen, adapter: None },
                    with(Variant::Adapted, &trained, 2.0),
                    with(Variant::EtaZero, &trained, 0.0),
                    with(Variant::UntrainedAdapter, &untrained, 2.0),
                ];
                let calls = Cell::new(0);
                let made = course(&backbone, 8).run(&ways, || calls.set(calls.get() + 1)).expect("fits");
                // Steps 0 to 4 are before or at the middle: taken once. Three steps are left for each way.
                assert_eq!(calls.get(), 5 + 3 * 4);
                let exact = family == Family::RectifiedFlow || !clamp_clean;
                for zero in &made[2..] {
                    let apart = apart(&zero.image, &made[0].image);
                    assert!(apart <= if exact { 0.0 } else { 1e-5 }, "{family:?} {clamp_clean}: {apart}");
                    assert!(zero.energy.iter().all(|energy| *energy == 0.0));
                }
                assert!(apart(&made[1].image, &made[0].image) > 1e-4, "{family:?} {clamp_clean}");
                assert_eq!(made[1].energy.iter().filter(|energy| **energy > 0.0).count(), 3);
                assert_eq!(made[1].frames.iter().map(|frame| frame.step).collect::<Vec<_>>(), [0, 4, 8]);
                assert!(made[1].frames[1] == made[0].frames[1] && made[1].frames[2] != made[0].frames[2]);
            }
        }
    }

    #[test]
    fn an_injected_correction_moves_the_clean_image_by_as_much() {
        let schedule = Ddpm::new(&DdpmConfig::default());
        let sampler = Sampler::Ddpm { schedule: schedule.clone(), steps: 100 };
        // Injection begins after the middle; near the first time, where abar is 4e-5, clean images are large numbers
        // whose rounding is all that is left of the correction.
        for (time, tolerance) in [(999.0, 1e-3f32), (500.0, 1e-5), (250.0, 1e-5), (20.0, 1e-5)] {
            let (state, noise, by) = ([0.9f32, -0.4, 2.0], [0.3f32, -1.5, 1.0], [0.02f32, -0.01, 0.05]);
            for clamp in [false, true] {
                let moved = injected(&sampler, &state, &noise, time, clamp, &by);
                for i in 0..3 {
                    let clean = schedule.clean(state[i], noise[i], time as usize);
                    let expected = if clamp { clean.clamp(-1.0, 1.0) } else { clean } - by[i];
                    let found = schedule.clean(state[i], moved[i], time as usize);
                    // The range of clean images is 2 wide.
                    assert!((found - expected).abs() < 2.0 * tolerance, "{time} {clamp}: {found} {expected}");
                }
            }
        }
    }

    #[test]
    fn a_sampler_that_does_not_clip_has_frozen_controls_too() {
        let no_clip = DdpmConfig { clip_sample: false, ..DdpmConfig::default() };
        let wide = DdpmConfig { clip_sample_range: 1.5, ..DdpmConfig::default() };
        for (config, limit) in [(no_clip, f32::INFINITY), (wide, 1.5)] {
            let schedule = Ddpm::new(&config);
            assert_eq!(clamped(&schedule, 7.0, true), limit.min(7.0));
            assert_eq!(clamped(&schedule, 7.0, false), 7.0);
            let sampler = Sampler::Ddpm { schedule: schedule.clone(), steps: 10 };
            // Without a correction, the sampler's own step from the injected prediction is the frozen one.
            let (state, noise) = ([2.5f32, -0.4, 0.1], [-1.5f32, 0.3, 1.0]);
            let same = injected(&sampler, &state, &noise, 400.0, true, &[0.0; 3]);
            let [mut frozen, mut zero] = [state, state];
            sampler.advance(5, &mut frozen, &noise, &[0.0; 3]);
            sampler.advance(5, &mut zero, &same, &[0.0; 3]);
            assert!(frozen.iter().zip(&zero).all(|(a, b)| (a - b).abs() < 1e-5), "{frozen:?} {zero:?}");
        }
    }

    #[test]
    fn strength_grows_with_the_square_after_the_start() {
        let injection = Injection { eta: 0.05, start: 0.5 };
        assert_eq!([0.0, 0.5, 0.75, 1.0].map(|at| injection.gain(at)), [0.0, 0.0, 0.0125, 0.05]);
        assert!(!injection.begun(0.5) && injection.begun(0.51));
    }

    #[test]
    fn samples_differ_by_number_and_seed_alone() {
        let backbone = backbone(Family::RectifiedFlow);
        let run = |seed, sample| {
            let course = Course { seed, sample, ..course(&backbone, 4) };
            course.run(&[Way { variant: Variant::Frozen, adapter: None }], || ()).expect("fits").remove(0).image
        };
        assert_eq!(run(7, 2), run(7, 2));
        assert!(run(7, 2) != run(7, 3) && run(7, 2) != run(8, 2));
    }
}
