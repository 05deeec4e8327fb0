//! Refining an image along variance time in any number of steps. Knows no network: only that something predicts.

use crate::{parameterization::ParameterizationMaths as _, space::Space};
use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    methods::Parameterization,
    time::{TimeGrid, VarianceTime},
};

/// Something that predicts what its parameterization asks for.
pub trait Denoiser {
    /// Its parameterization.
    fn parameterization(&self) -> Parameterization;

    /// The space that its states and predictions are in.
    fn space(&self) -> Space;

    /// The clock of the ladder that it learned on.
    fn clock(&self) -> VarianceTime;

    /// The sample count that a local velocity at `count` samples points to: twice as many on dyadic ladders.
    fn next(&self, count: f64) -> f64 {
        2.0 * count
    }

    /// The prediction for a state [H, W, 3] in its space, at variance time `tau`, or of an unknown sample count, with
    /// albedo and normal [H, W, 6] if it was trained with them.
    ///
    /// # Errors
    /// If shapes do not fit what it was trained for, or it must be told the time.
    fn predict(&self, state: &Image, gbuffer: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError>;
}

/// Where a rollout starts and how it goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// Sample count of the endpoint that it starts from.
    pub from: u64,
    /// Network calls.
    pub steps: usize,
    /// How its times are spread.
    pub grid: TimeGrid,
}

/// Refines an endpoint, exposed linear radiance [H, W, 3], to the end of the clock; `steps` network calls.
///
/// # Errors
/// If the endpoint lies outside the clock, no step is asked for, or the model refuses the shapes.
pub fn rollout(
    model: &dyn Denoiser,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    course: Course,
) -> Result<Image, KindError> {
    rollout_to(model, endpoint, gbuffer, course, model.clock().n_max())
}

/// Refines an endpoint, exposed linear radiance [H, W, 3], to the noise of `to` samples; `steps` network calls.
///
/// # Errors
/// If the endpoints are not in order within the clock, no step is asked for, or the model refuses the shapes.
pub fn rollout_to(
    model: &dyn Denoiser,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    course: Course,
    to: f64,
) -> Result<Image, KindError> {
    walk(model, endpoint, gbuffer, (course, to), &mut |_, _| Ok(()))
}

/// The states of [`rollout`] after each network call, as exposed linear radiance [H, W, 3], with their variance times.
/// The last one is its result.
///
/// # Errors
/// As [`rollout`].
pub fn rollout_states(
    model: &dyn Denoiser,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    course: Course,
) -> Result<Vec<(f64, Image)>, KindError> {
    let mut states = Vec::with_capacity(course.steps);
    walk(model, endpoint, gbuffer, (course, model.clock().n_max()), &mut |tau, state| {
        states.push((tau, decode(model, state.clone(), endpoint)?));
        Ok(())
    })?;
    Ok(states)
}

/// Refines an endpoint, and shows each state in the model's space with its time.
fn walk(
    model: &dyn Denoiser,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    (course, to): (Course, f64),
    each: &mut dyn FnMut(f64, &Image) -> Result<(), KindError>,
) -> Result<Image, KindError> {
    let clock = model.clock();
    if course.steps == 0 {
        return Err(KindError::Input("a rollout of 0 steps; `nfe` counts from 1".into()));
    }
    let from = course.from as f64;
    if from < clock.n_min() || from >= clock.n_max() {
        return Err(KindError::Input(format!(
            "a rollout cannot start at {} spp: the training ladder goes from {} to {} spp; choose a `from` in this \
            range, below the last rung",
            course.from,
            clock.n_min(),
            clock.n_max()
        )));
    }
    if !(to > from && to <= clock.n_max()) {
        return Err(KindError::Input(format!(
            "a rollout from {from} spp cannot end at {to} spp: the end must be above the start and at most {}, the \
            last rung of the training ladder",
            clock.n_max()
        )));
    }
    readable(endpoint, gbuffer)?;
    let times = clock.grid_to(from, to, course.steps, course.grid);
    let mut state = encode(model, endpoint)?;
    for pair in times.windows(2) {
        let prediction = model.predict(&state, gbuffer, Some(pair[0]))?;
        state = model.parameterization().step(&state, &prediction, pair[0], pair[1]);
        each(pair[1], &state)?;
    }
    decode(model, state, endpoint)
}

/// The estimate of the converged image for exposed linear radiance [H, W, 3] of `count` samples, or of an unknown
/// count, which may differ from pixel to pixel; one network call.
///
/// A rollout ends at I_m, the last rung, which contains the samples of I_n: with the law, the fraction n/m of its noise
/// stays (of as many independent samples as have that error). Here all of it goes.
///
/// # Errors
/// If the model is not of MC noise, the count is not within its ladder, it was not trained for unknown counts, or it
/// refuses the shapes.
pub fn clean_estimate(
    model: &dyn Denoiser,
    image: &Image,
    gbuffer: Option<&Image>,
    count: Option<u64>,
) -> Result<Image, KindError> {
    if model.parameterization() != Parameterization::McNoise {
        return Err(KindError::Input(format!(
            "a clean image in one call needs a model of `mc_noise`, but this one is of `{}`",
            model.parameterization().name()
        )));
    }
    let (clock, count) = (model.clock(), count.map(|count| count as f64));
    if let Some(count) = count.filter(|count| *count < clock.n_min() || *count >= clock.n_max()) {
        return Err(KindError::Input(format!(
            "an image of {count} spp is outside the training ladder of {} to {} spp (its end excluded)",
            clock.n_min(),
            clock.n_max()
        )));
    }
    readable(image, gbuffer)?;
    let mut state = encode(model, image)?;
    let prediction = model.predict(&state, gbuffer, count.map(|count| clock.tau(count)))?;
    let share = count.map_or(1.0, |count| 1.0 - clock.independent(count) / clock.independent(clock.n_max()));
    for (state, noise) in state.data_mut().iter_mut().zip(prediction.data()) {
        *state -= (f64::from(*noise) / share) as f32;
    }
    decode(model, state, image)
}

/// A value that is no number would spread over the network's whole field of view.
pub(crate) fn readable(endpoint: &Image, gbuffer: Option<&Image>) -> Result<(), KindError> {
    for (image, what) in std::iter::once((endpoint, "endpoint")).chain(gbuffer.map(|gbuffer| (gbuffer, "G-buffer"))) {
        image.finite(what, "mend the image, or look at what made it")?;
    }
    Ok(())
}

pub(crate) fn encode(model: &dyn Denoiser, image: &Image) -> Result<Image, KindError> {
    let space = model.space();
    let data = space.encode_all(image.data());
    within(space, Image::from_data(image.width(), image.height(), image.channels(), data)?, image)
}

pub(crate) fn decode(model: &dyn Denoiser, state: Image, endpoint: &Image) -> Result<Image, KindError> {
    let space = model.space();
    let state = within(space, state, endpoint)?;
    let data = space.decode_all(state.data());
    Ok(Image::from_data(state.width(), state.height(), state.channels(), data)?)
}

/// A state, unless its endpoint is so bright that values leave what the space can hold: nothing is cut.
pub(crate) fn within(space: Space, state: Image, endpoint: &Image) -> Result<Image, KindError> {
    // NaN is not below the largest value, either.
    let fits = state.data().iter().filter(|v| v.abs() <= space.largest()).count();
    if fits == state.data().len() {
        return Ok(state);
    }
    let brightest = endpoint.data().iter().fold(0.0f32, |most, v| most.max(v.abs()));
    Err(KindError::Input(format!(
        "{} of the {} values of a state exceed single precision in `space: {}`: the maximum of the endpoint is \
        {brightest:.1e}; use a lower exposure",
        state.data().len() - fits,
        state.data().len(),
        space.name()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// Knows where the clean image is.
    struct Oracle {
        kind: Parameterization,
        space: Space,
        clean: f32,
        noisy: f32,
        calls: Cell<usize>,
        exponent: f64,
    }

    impl Oracle {
        fn new(kind: Parameterization, space: Space) -> Self {
            Self { kind, space, clean: space.encode(2.0), noisy: space.encode(7.0), calls: Cell::new(0), exponent: 0.5 }
        }
    }

    impl Denoiser for Oracle {
        fn parameterization(&self) -> Parameterization {
            self.kind
        }

        fn space(&self) -> Space {
            self.space
        }

        fn clock(&self) -> VarianceTime {
            VarianceTime::new(1, 512).expect("a ladder").with_exponent(self.exponent).expect("an exponent")
        }

        fn predict(&self, state: &Image, _: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError> {
            self.calls.set(self.calls.get() + 1);
            Ok(state.map(|x| match self.kind {
                Parameterization::McNoise => x - self.clean,
                Parameterization::McVelocity => (self.clean - x) / (1.0 - tau.expect("told")) as f32,
                // The straight line from noisy to clean has this velocity everywhere.
                Parameterization::LocalVelocity | Parameterization::VanillaRf => self.clean - self.noisy,
            }))
        }
    }

    fn noisy() -> Image {
        Image::from_data(2, 1, 3, vec![7.0; 6]).expect("fits")
    }

    #[test]
    fn an_oracle_is_followed_to_the_end_in_any_number_of_steps() {
        for kind in Parameterization::ALL {
            for space in [Space::Linear, Space::Log1p] {
                for grid in [TimeGrid::Ladder, TimeGrid::Uniform] {
                    for steps in [1, 2, 9, 50] {
                        let oracle = Oracle::new(kind, space);
                        let end = rollout(&oracle, &noisy(), None, Course { from: 1, steps, grid }).expect("in range");
                        assert_eq!(oracle.calls.get(), steps);
                        let course = Course { from: 1, steps, grid };
                        let states = rollout_states(&oracle, &noisy(), None, course).expect("in range");
                        let times: Vec<f64> = states.iter().map(|(tau, _)| *tau).collect();
                        assert_eq!(times, oracle.clock().grid(1.0, steps, grid)[1..]);
                        assert_eq!(states.last().map(|(_, image)| image), Some(&end), "the result");
                        let falling = states.windows(2).all(|pair| pair[1].1.data()[0] < pair[0].1.data()[0]);
                        assert!(falling, "from 7 towards 2 in each step");
                        for v in end.data() {
                            assert!((v - 2.0).abs() < 2e-4, "{kind:?} {space:?} {steps}: {v}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn an_oracle_of_noise_need_not_know_how_much_there_is() {
        for space in [Space::Linear, Space::Log1p] {
            let oracle = Oracle::new(Parameterization::McNoise, space);
            let clean = clean_estimate(&oracle, &noisy(), None, None).expect("one");
            assert!(clean.data().iter().all(|v| (v - 2.0).abs() < 2e-4), "{space:?}");
            let velocity = Oracle::new(Parameterization::LocalVelocity, space);
            let error = clean_estimate(&velocity, &noisy(), None, None).expect_err("none").to_string();
            assert!(error.contains("mc_noise"), "{error}");
            for count in [0, 512, 600] {
                assert!(clean_estimate(&oracle, &noisy(), None, Some(count)).is_err(), "{count}");
            }
        }
    }

    #[test]
    fn a_clean_image_is_as_far_as_the_error_of_the_ladder_says() {
        // A perfect network predicts the noise of n samples that those of 512 lack: 1 - (n/512)^(2 alpha) of it.
        for (exponent, count) in [(0.5, 64u64), (0.75, 64), (0.75, 2)] {
            let oracle = Oracle { exponent, ..Oracle::new(Parameterization::McNoise, Space::Linear) };
            let found = clean_estimate(&oracle, &noisy(), None, Some(count)).expect("one").data()[0];
            let share = 1.0 - (count as f64 / 512.0).powf(2.0 * exponent);
            assert!((f64::from(found) - (7.0 - 5.0 / share)).abs() < 1e-4, "{exponent} {count}: {found}");
        }
    }

    #[test]
    fn a_rollout_between_endpoints_keeps_to_the_schedule() {
        for kind in Parameterization::ALL {
            let oracle = Oracle::new(kind, Space::Linear);
            let share = oracle.clock().tau(64.0) as f32;
            for steps in [1, 3, 9] {
                let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
                let end = rollout_to(&oracle, &noisy(), None, course, 64.0).expect("in range");
                assert!((end.data()[0] - (7.0 + share * (2.0 - 7.0))).abs() < 1e-4, "{kind:?} {steps}");
                assert!(rollout_to(&oracle, &noisy(), None, course, 513.0).is_err());
                assert!(rollout_to(&oracle, &noisy(), None, course, 1.0).is_err());
            }
        }
    }

    #[test]
    fn what_lies_outside_the_clock_is_refused() {
        let oracle = Oracle::new(Parameterization::McNoise, Space::Linear);
        let course = |from, steps| Course { from, steps, grid: TimeGrid::Ladder };
        assert!(rollout(&oracle, &noisy(), None, course(512, 1)).is_err());
        assert!(rollout(&oracle, &noisy(), None, course(1, 0)).is_err());
    }
}
