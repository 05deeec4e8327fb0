//! How far rollouts in single precision drift from the same in double: with exact predictions, and with those of
//! networks.

use super::{
    about, held,
    transport::{Oracle, difference, image},
};
use tauflow_data::{Image, VarianceTime, time::TimeGrid};
use tauflow_train::{Course, Denoiser, Model, Parameterization, Space, rollout, rollout_to};

type Add<'a> = &'a mut dyn FnMut(String, &str, Result<String, String>);

/// The steps of a rollout, written down once more, in double precision.
fn wide(
    kind: Parameterization,
    times: &[f64],
    mut state: Vec<f64>,
    mut predict: impl FnMut(&[f64], f64) -> Result<Vec<f64>, String>,
) -> Result<Vec<f64>, String> {
    for pair in times.windows(2) {
        let (tau, next) = (pair[0], pair[1]);
        let share = match kind {
            // I += dtau/(1 - tau) (clean - I), with I - clean predicted.
            Parameterization::McNoise => -(next - tau) / (1.0 - tau),
            _ => next - tau,
        };
        let predicted = predict(&state, tau)?;
        for (state, prediction) in state.iter_mut().zip(predicted) {
            *state += share * prediction;
        }
    }
    Ok(state)
}

fn encoded(image: &Image, space: Space) -> Vec<f64> {
    image.data().iter().map(|v| f64::from(space.encode(*v))).collect()
}

fn decoded(state: &[f64], space: Space, like: &Image) -> Image {
    let data = state.iter().map(|v| space.decode(*v as f32)).collect();
    Image::from_data(like.width(), like.height(), 3, data).expect("the same shape")
}

/// Exact predictions, each precision with its own: their rounding is part of the drift.
fn of_oracle(oracle: &Oracle, steps: usize, to: f64) -> Result<f64, String> {
    let (start, clean) = (encoded(&oracle.start, oracle.space), encoded(&oracle.clean, oracle.space));
    let times = oracle.clock.grid_to(1.0, to, steps, TimeGrid::Ladder);
    let predict = |state: &[f64], tau: f64| {
        let one = |((state, clean), start): ((&f64, &f64), &f64)| match oracle.kind {
            Parameterization::McNoise => state - clean,
            Parameterization::VanillaRf => clean - start,
            _ => (clean - state) / (1.0 - tau),
        };
        Ok(state.iter().zip(&clean).zip(&start).map(one).collect())
    };
    let wide = decoded(&wide(oracle.kind, &times, start.clone(), predict)?, oracle.space, &oracle.start);
    let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
    let narrow = rollout_to(oracle, &oracle.start, None, course, to).map_err(|e| e.to_string())?;
    Ok(difference(&narrow, &wide))
}

/// A row for each parameterization.
pub fn oracles(add: Add<'_>) {
    let clock = VarianceTime::new(1, 512).expect("a ladder");
    let (start, clean) = (image(&[0.0, 7.0, 0.3, 1e-6, 100.0, 3e3]), image(&[0.5, 2.0, 0.3, 2e-6, 1e4, 30.0]));
    for kind in Parameterization::ALL {
        let of = |space, steps: &[usize], to: f64| {
            let oracle = Oracle { kind, space, clock, start: start.clone(), clean: clean.clone() };
            steps.iter().try_fold(0.0f64, |worst, steps| Ok::<_, String>(worst.max(of_oracle(&oracle, *steps, to)?)))
        };
        let came = [Space::Linear, Space::Log1p].into_iter().try_fold(Vec::new(), |mut said, space| {
            let (few, many) = (of(space, &[1, 2, 9], 64.0)?, of(space, &[50, 200, 1000], 64.0)?);
            let end = of(space, &[1, 2, 9, 50, 200, 1000], 512.0)?;
            let told = format!(
                "{}: {} in up to 9 calls, {} in up to 1,000, {} at the end",
                space.name(),
                about(few),
                about(many),
                about(end)
            );
            said.push(held(few < 1e-5 && many < 1e-4 && end < 1e-3, told)?);
            Ok::<_, String>(said)
        });
        add(
            format!(
                "{} with exact predictions, in single precision compared with double precision, in 1, 2, 9, 50, 200 \
                 and 1,000 network calls to \
                 64 samples of 512, and to the end",
                kind.name()
            ),
            "the same to 1e-4 of a value at 64 samples, and to 1e-3 at the end",
            came.map(|said| said.join("; ")),
        );
    }
}

/// Root mean square of the difference, over that of the second image.
pub(super) fn distance(a: &Image, b: &Image) -> f64 {
    let pairs = || a.data().iter().zip(b.data()).map(|(a, b)| (f64::from(*a), f64::from(*b)));
    (pairs().map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / pairs().map(|(_, b)| b * b).sum::<f64>()).sqrt()
}

/// A network, which speaks single precision, under a rollout in double beside one in single: the drift for each number
/// of calls.
pub(super) fn of_network(
    model: &Model,
    start: &Image,
    gbuffer: Option<&Image>,
    calls: &[usize],
) -> Result<Vec<f64>, String> {
    let space = model.space();
    let drift = |steps: &usize| {
        let times = model.clock().grid(1.0, *steps, TimeGrid::Ladder);
        let predict = |state: &[f64], tau: f64| {
            let state = Image::from_data(start.width(), start.height(), 3, state.iter().map(|v| *v as f32).collect());
            let said =
                model.predict(&state.map_err(|e| e.to_string())?, gbuffer, Some(tau)).map_err(|e| e.to_string())?;
            Ok(said.data().iter().map(|v| f64::from(*v)).collect())
        };
        let wide = wide(model.parameterization(), &times, encoded(start, space), predict)?;
        let course = Course { from: 1, steps: *steps, grid: TimeGrid::Ladder };
        let narrow = rollout(model, start, gbuffer, course).map_err(|e| e.to_string())?;
        Ok(distance(&narrow, &decoded(&wide, space, start)))
    };
    calls.iter().map(drift).collect()
}
