//! Stops between the rungs of a ladder: where a solver puts the image of m samples, given the image of k. Knows no
//! network: only that something predicts.
//!
//! A solver predicts in the space that it was trained in. Images can be moved in this space or in another one: then the
//! predicted goal is converted, and the move is a straight line in the other space.

use crate::{
    law::Factors,
    parameterization::ParameterizationMaths as _,
    rollout::{Denoiser, encode, readable, within},
    space::Space,
};
use tauflow_contract::KindError;
use tauflow_data::{Image, maths, methods::Parameterization, rng::Stream, time::VarianceTime};

/// How a local velocity is rolled along the ladder, from each sample count to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LocalRule {
    /// An Euler step: the velocity times the difference of variance times.
    Step,
    /// The whole predicted difference to the next rung of the training ladder.
    Delta,
}

/// From endpoint I_k part of the way to the clean estimate, to where variance time puts I_m: I_k + (tau_m - tau_k)/(1 -
/// tau_k) (clean - I_k), in a space; one network call.
///
/// # Errors
/// If the model has no clean estimate, or m is not between k and the clock's end.
pub fn bridge_stop(
    model: &dyn Denoiser,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    (from, to): (u64, u64),
    space: Space,
) -> Result<Image, KindError> {
    let (tau, next) = span(model, from, to)?;
    readable(endpoint, gbuffer)?;
    let state = encode(model, endpoint)?;
    let prediction = model.predict(&state, gbuffer, Some(tau))?;
    let Some(clean) = model.parameterization().clean(&state, &prediction, tau) else {
        return Err(KindError::Input(format!(
            "a bridge stop needs an estimate of the clean image, which `{}` does not provide; use `mc_noise` or \
            `mc_velocity`",
            model.parameterization().name()
        )));
    };
    let own = model.space();
    let (mut moved, clean) = (convert(state, own, space, endpoint)?, convert(clean, own, space, endpoint)?);
    towards(&mut moved, &clean, ((next - tau) / (1.0 - tau)) as f32);
    convert(moved, space, Space::Linear, endpoint)
}

/// The images of k + 1, k + 2 .. m samples by a local velocity that is rolled along k -> k+1 -> .. -> m, in a space;
/// one network call each.
///
/// # Errors
/// As [`bridge_stop`].
pub fn local_path(
    model: &dyn Denoiser,
    endpoint: &Image,
    gbuffer: Option<&Image>,
    (from, to): (u64, u64),
    (space, rule): (Space, LocalRule),
) -> Result<Vec<Image>, KindError> {
    readable(endpoint, gbuffer)?;
    let own = model.space();
    let mut state = convert(endpoint.clone(), Space::Linear, space, endpoint)?;
    let mut path = Vec::with_capacity(to.saturating_sub(from) as usize);
    for n in from..to {
        let (tau, next) = span(model, n, n + 1)?;
        let seen = convert(state.clone(), space, own, endpoint)?;
        let prediction = model.predict(&seen, gbuffer, Some(tau))?;
        let ahead = model.clock().tau(model.next(n as f64)) - tau;
        let step = match rule {
            LocalRule::Step => next - tau,
            LocalRule::Delta => ahead,
        };
        if own == space {
            add(&mut state, &prediction, step as f32);
        } else {
            let mut goal = seen;
            add(&mut goal, &prediction, ahead as f32);
            towards(&mut state, &convert(goal, own, space, endpoint)?, (step / ahead) as f32);
        }
        path.push(convert(state.clone(), space, Space::Linear, endpoint)?);
    }
    Ok(path)
}

/// The expectation of I_m, given I_k and the converged image, all of linear radiance: the fraction 1 - k/m of the way.
pub fn expected_stop(endpoint: &Image, clean: &Image, (from, to): (u64, u64)) -> Image {
    let mut moved = endpoint.clone();
    towards(&mut moved, clean, (1.0 - from as f64 / to as f64) as f32);
    moved
}

/// Where variance time puts I_m between I_k and a clean image, all of linear radiance.
///
/// # Errors
/// If the stop is outside the clock.
pub fn timed_stop(
    model: &dyn Denoiser,
    endpoint: &Image,
    clean: &Image,
    (from, to): (u64, u64),
) -> Result<Image, KindError> {
    let (tau, next) = span(model, from, to)?;
    let mut moved = endpoint.clone();
    towards(&mut moved, clean, ((next - tau) / (1.0 - tau)) as f32);
    Ok(moved)
}

/// An image [H, W, C] under a Gaussian filter of this standard deviation in pixels. Weights beyond the border count for
/// nothing.
pub fn blurred(image: &Image, sigma: f64) -> Image {
    let reach = (4.0 * sigma).ceil() as usize;
    let weights: Vec<f64> = (0..=reach).map(|d| maths::exp(-0.5 * (d as f64 / sigma).powi(2))).collect();
    let (width, height, channels) = (image.width(), image.height(), image.channels());
    let pass = |from: &Image, count: usize, step: usize, at: &dyn Fn(usize) -> usize| {
        let mut to = from.clone();
        for (i, value) in to.data_mut().iter_mut().enumerate() {
            let place = at(i);
            let (mut sum, mut weight) = (0.0, 0.0);
            for other in place.saturating_sub(reach)..(place + reach + 1).min(count) {
                let own = weights[other.abs_diff(place)];
                sum += own * f64::from(from.data()[i + other * step - place * step]);
                weight += own;
            }
            *value = (sum / weight) as f32;
        }
        to
    };
    let rows = pass(image, width, channels, &|i| i / channels % width);
    pass(&rows, height, channels * width, &|i| i / (channels * width))
}

/// A draw of I_m, given its expectation and the variance of single samples, all of linear radiance: the mean of the m -
/// k samples that are yet to come adds the variance s^2 (m - k)/m^2.
pub fn stochastic_stop(expected: &Image, variance: &Image, (from, to): (u64, u64), mut stream: Stream) -> Image {
    let mut drawn = expected.clone();
    let (more, all) = (to.saturating_sub(from) as f64, to as f64);
    for (value, variance) in drawn.data_mut().iter_mut().zip(variance.data()) {
        let deviation = (f64::from(variance.max(0.0)) * more).sqrt() / all;
        *value = (f64::from(*value) + deviation * stream.normal()) as f32;
    }
    drawn
}

/// A solver that knows the converged image, and predicts the expectation of its target: the held-out reference in the
/// network's place.
pub struct ReferenceSolver {
    factors: Factors,
    space: Space,
    clean: Image,
}

impl ReferenceSolver {
    /// A solver in a space that knows this image of linear radiance [H, W, 3].
    pub fn new(factors: Factors, space: Space, clean: &Image) -> Self {
        Self { factors, space, clean: clean.map(|v| space.encode(v)) }
    }
}

impl Denoiser for ReferenceSolver {
    fn parameterization(&self) -> Parameterization {
        self.factors.parameterization()
    }

    fn space(&self) -> Space {
        self.space
    }

    fn clock(&self) -> VarianceTime {
        self.factors.clock()
    }

    fn next(&self, count: f64) -> f64 {
        self.factors.next(count)
    }

    fn predict(&self, state: &Image, _: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError> {
        if !state.same_shape(&self.clean) {
            return Err(KindError::Input(format!(
                "the held-out reference has {} x {} pixels, but the endpoint has {} x {}; render both with the same \
                `resolution`",
                self.clean.width(),
                self.clean.height(),
                state.width(),
                state.height()
            )));
        }
        let factor = self.factors.at(tau);
        let mut prediction = state.clone();
        for (value, clean) in prediction.data_mut().iter_mut().zip(self.clean.data()) {
            *value = (factor * (f64::from(*clean) - f64::from(*value))) as f32;
        }
        Ok(prediction)
    }
}

fn towards(state: &mut Image, goal: &Image, share: f32) {
    state.data_mut().iter_mut().zip(goal.data()).for_each(|(s, g)| *s += share * (*g - *s));
}

fn add(state: &mut Image, prediction: &Image, step: f32) {
    state.data_mut().iter_mut().zip(prediction.data()).for_each(|(s, p)| *s += step * *p);
}

/// An image of one space in another one.
fn convert(image: Image, from: Space, to: Space, endpoint: &Image) -> Result<Image, KindError> {
    let image = within(from, image, endpoint)?;
    if from == to {
        return Ok(image);
    }
    within(to, image.map(|v| to.encode(from.decode(v))), endpoint)
}

fn span(model: &dyn Denoiser, from: u64, to: u64) -> Result<(f64, f64), KindError> {
    let clock = model.clock();
    if (from as f64) < clock.n_min() || to <= from || to as f64 >= clock.n_max() {
        return Err(KindError::Input(format!(
            "the stop {from} -> {to} spp is outside the training ladder of {} to {} spp (its end excluded); bridge \
            stops use the clock of the training ladder",
            clock.n_min(),
            clock.n_max()
        )));
    }
    Ok((clock.tau(from as f64), clock.tau(to as f64)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Law;

    const DYADIC: [u64; 10] = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512];

    fn known(parameterization: Parameterization, space: Space) -> ReferenceSolver {
        let factors = Factors::new(parameterization, &DYADIC, Law::Covariances).expect("a ladder");
        ReferenceSolver::new(factors, space, &image(2.0))
    }

    fn image(value: f32) -> Image {
        Image::from_data(2, 1, 3, vec![value; 6]).expect("fits")
    }

    #[test]
    fn a_stop_goes_as_far_as_variance_time_in_its_space() {
        let clock = VarianceTime::new(1, 512).expect("a ladder");
        // MC noise is told to go to the last rung: 511/512 of the way to the converged image.
        let share = clock.tau(10.0) * 511.0 / 512.0;
        for space in [Space::Linear, Space::Log1p] {
            for own in [Space::Linear, Space::Log1p] {
                let model = known(Parameterization::McNoise, own);
                let stop = bridge_stop(&model, &image(7.0), None, (1, 10), space).expect("in range");
                let clean = own.decode(own.encode(7.0) + 511.0 / 512.0 * (own.encode(2.0) - own.encode(7.0)));
                let (from, goal) = (f64::from(space.encode(7.0)), f64::from(space.encode(clean)));
                let expected = f64::from(space.decode((from + clock.tau(10.0) * (goal - from)) as f32));
                assert!((f64::from(stop.data()[0]) - expected).abs() < 1e-4, "{own:?} in {space:?}: {share}");
            }
        }
    }

    #[test]
    fn deltas_halve_what_is_left_and_steps_keep_to_the_expectation() {
        for own in [Space::Linear, Space::Log1p] {
            let model = known(Parameterization::LocalVelocity, own);
            let left = |rule| -> Vec<f64> {
                let path = local_path(&model, &image(7.0), None, (1, 5), (own, rule)).expect("in range");
                let way = |v: f32| f64::from(own.encode(v) - own.encode(2.0));
                path.iter().map(|image| way(image.data()[0]) / way(7.0)).collect()
            };
            let deltas = left(LocalRule::Delta);
            // The whole difference to 2n at each n, whether or not n is a rung.
            assert_eq!(deltas.len(), 4);
            for (steps, left) in (1..).zip(&deltas) {
                assert!((left - 0.5f64.powi(steps)).abs() < 1e-5, "{own:?}: {deltas:?}");
            }
            let steps = left(LocalRule::Step);
            assert!(steps.iter().zip(2..).all(|(left, m)| (left * f64::from(m) - 1.0).abs() < 0.1), "{steps:?}");
            // In the other space, the same prediction moves images along another line, to the same side.
            let other = if own == Space::Linear { Space::Log1p } else { Space::Linear };
            let path = local_path(&model, &image(7.0), None, (1, 2), (other, LocalRule::Delta)).expect("in range");
            let here = local_path(&model, &image(7.0), None, (1, 2), (own, LocalRule::Delta)).expect("in range");
            // A whole delta ends at the predicted image in any space.
            assert!((path[0].data()[0] - here[0].data()[0]).abs() < 1e-4);
            let halfway = |space| {
                let path = local_path(&model, &image(7.0), None, (2, 3), (space, LocalRule::Step)).expect("in range");
                path[0].data()[0]
            };
            assert!((halfway(own) - halfway(other)).abs() > 1e-2);
        }
    }

    #[test]
    fn expected_and_drawn_stops_have_the_moments_of_real_rungs() {
        // Rungs of one pixel after another, of mean 2 and deviation 3.
        let (k, m, side) = (3u64, 10u64, 200usize);
        let mut stream = Stream::new(4, &[]);
        let mut image_of = |deviation: f64| {
            let data = (0..side * side * 3).map(|_| (2.0 + deviation * stream.normal()) as f32).collect();
            Image::from_data(side, side, 3, data).expect("fits")
        };
        let endpoint = image_of(3.0 / (k as f64).sqrt());
        let (mut clean, mut variance) = (endpoint.clone(), endpoint.clone());
        clean.data_mut().fill(2.0);
        variance.data_mut().fill(9.0);
        let moments = |image: &Image| {
            let pairs = image.data().iter().zip(endpoint.data());
            let (mut own, mut both) = (0.0, 0.0);
            for (a, b) in pairs {
                let (a, b) = (f64::from(*a) - 2.0, f64::from(*b) - 2.0);
                own += a * a;
                both += a * b;
            }
            let count = image.data().len() as f64;
            (own / count, both / count)
        };
        let expected = expected_stop(&endpoint, &clean, (k, m));
        let drawn = stochastic_stop(&expected, &variance, (k, m), Stream::new(5, &[]));
        let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 0.03, "{a} {b}");
        let (own, both) = moments(&drawn);
        near(own, 9.0 / m as f64);
        near(both, 9.0 / m as f64);
        // Without noise, the covariance is right, and k/m of the variance is there.
        let (own, both) = moments(&expected);
        near(own, 9.0 * k as f64 / (m * m) as f64);
        near(both, 9.0 / m as f64);
    }

    #[test]
    fn a_gaussian_filter_has_its_deviation_and_keeps_what_is_even() {
        let even = Image::from_data(5, 4, 3, vec![2.5; 60]).expect("fits");
        assert_eq!(blurred(&even, 0.7).data(), even.data());
        let (width, height) = (21usize, 19usize);
        let mut point = Image::from_data(width, height, 3, vec![0.0; width * height * 3]).expect("fits");
        point.data_mut()[(9 * width + 10) * 3 + 1] = 1.0;
        let spread = blurred(&point, 1.5);
        let (mut sum, mut along, mut across) = (0.0, 0.0, 0.0);
        for (i, value) in spread.data().iter().enumerate() {
            let (x, y, value) = ((i / 3 % width) as f64, (i / 3 / width) as f64, f64::from(*value));
            assert!(i % 3 == 1 || value == 0.0, "channels stay apart");
            sum += value;
            along += value * (x - 10.0).powi(2);
            across += value * (y - 9.0).powi(2);
        }
        for (is, wanted) in [(sum, 1.0), (along, 2.25), (across, 2.25)] {
            assert!((is / wanted - 1.0).abs() < 5e-3, "{is} {wanted}");
        }
    }

    #[test]
    fn stops_outside_the_ladder_and_other_parameterizations_are_refused() {
        let noise = known(Parameterization::McNoise, Space::Linear);
        assert!(bridge_stop(&noise, &image(7.0), None, (10, 512), Space::Linear).is_err());
        assert!(bridge_stop(&noise, &image(7.0), None, (10, 10), Space::Linear).is_err());
        let local = known(Parameterization::LocalVelocity, Space::Linear);
        let error = bridge_stop(&local, &image(7.0), None, (1, 2), Space::Linear).expect_err("no clean estimate");
        assert!(error.to_string().contains("mc_noise"), "{error}");
        let small = Image::from_data(1, 1, 3, vec![1.0; 3]).expect("fits");
        let error = bridge_stop(&noise, &small, None, (1, 2), Space::Linear).expect_err("sizes differ").to_string();
        assert!(error.contains("2 x 1") && error.contains("1 x 1"), "{error}");
    }
}
