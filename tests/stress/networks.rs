//! Trained networks on images at the ends of what numbers can be.

use super::{
    Hazard, about, drift, held,
    learning::{Lab, SIDE, scene, short},
};
use tauflow_contract::Outputs;
use tauflow_data::{Image, time::TimeGrid};
use tauflow_train::{
    Conditioning, Course, Decay, Denoiser as _, Loss, Model, Parameterization, Space, TrainingParams, rollout,
};

const AREA: &str = "Networks";

/// A network of some dozen steps.
fn trained(parameterization: Parameterization, space: Space, loss: Loss) -> Result<Model, String> {
    let lab = Lab::new();
    let scenes = lab.scenes((0..4).map(|i| scene(i, 0.0)));
    let params = TrainingParams {
        parameterization,
        space,
        loss,
        conditioning: Conditioning::Gbuffer,
        steps: 40,
        learning_rate: 2e-3,
        decay: Decay::Cosine,
        test_every: 40,
        ..short()
    };
    let outputs = lab.train(&scenes, params)?;
    loaded(&lab, &outputs)
}

/// The model that a training made.
pub(super) fn loaded(lab: &Lab, outputs: &Outputs) -> Result<Model, String> {
    Model::load(&lab.part(outputs, "model")).map_err(|e| e.to_string())
}

fn refined(model: &Model, image: &Image, steps: usize) -> Result<Image, String> {
    refined_with(model, image, scene(9, 0.0).gbuffer.as_ref(), steps)
}

pub(super) fn refined_with(
    model: &Model,
    image: &Image,
    gbuffer: Option<&Image>,
    steps: usize,
) -> Result<Image, String> {
    let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
    rollout(model, image, gbuffer, course).map_err(|e| e.to_string())
}

/// Least and largest value.
pub(super) fn range(image: &Image) -> (f64, f64) {
    image.data().iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(f64::from(*v)), b.max(f64::from(*v))))
}

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    for parameterization in Parameterization::ALL {
        for (space, loss) in [(Space::Linear, Loss::Squared), (Space::Log1p, Loss::Absolute)] {
            let name = format!("{} of 40 steps in {} space", parameterization.name(), space.name());
            let model = trained(parameterization, space, loss);
            let model = || model.as_ref().map_err(Clone::clone);
            // Of the four, interpolants are the farthest from scaling.
            let most = if parameterization == Parameterization::VanillaRf { 0.25 } else { 0.125 };
            exposures(&name, &model, most, &mut add);
            flat(&name, &model, &mut add);
            firefly(&name, &model, &mut add);
            precision(&name, &model, &mut add);
            let came = model().and_then(|model| refined(model, &scene(9, 0.0).states[0], 1000));
            let came = came.and_then(|end| {
                let ((low, high), (_, most)) = (range(&end), range(&scene(9, 0.0).states[0]));
                held(low.is_finite() && high <= most, "finite, and no brighter than the input".into())
            });
            add(format!("{name}, 1,000 network calls"), "finite, and no brighter than the input", came);
            let blinding = scene(9, 0.0).states[0].map(|v| 1.0 + 1e38 * v);
            let came = match (space, model().and_then(|model| refined(model, &blinding, 9))) {
                (_, Err(told)) => held(
                    told.contains("exceed") && told.contains("use a lower exposure"),
                    "refused, with the remedy".into(),
                ),
                (Space::Log1p, Ok(_)) => Err("taken: its space ends at 6e37".into()),
                (Space::Linear, Ok(end)) => {
                    let ((low, high), (_, most)) = (range(&end), range(&blinding));
                    held(low.is_finite() && high <= most, "finite, and no brighter than the input".into())
                }
            };
            add(
                format!("{name}, radiance up to 1e38"),
                "finite, or refused with a specific error: nothing is clamped",
                came,
            );
        }
    }
    out
}

type Add<'a> = &'a mut dyn FnMut(String, &str, Result<String, String>);
type Trained<'a> = dyn Fn() -> Result<&'a Model, String> + 'a;

/// How far from what an exposure should do: nothing but to scale. Networks saw one; `most` is of the image's root mean
/// square.
fn exposures(name: &str, model: &Trained<'_>, most: f64, add: Add<'_>) {
    let image = scene(9, 0.0).states[0].clone();
    let came = model().and_then(|model| {
        let plain = refined(model, &image, 9)?;
        [-6i32, -3, -1, 1, 3, 6].into_iter().try_fold(0.0f64, |worst, exponent| {
            let factor = 10f32.powi(exponent);
            let exposed = image.map(|v| v * factor);
            let end = refined(model, &exposed, 9)?;
            let ((low, high), (_, most)) = (range(&end), range(&exposed));
            if !(low.is_finite() && high <= most) {
                return Err(format!("{low:e} to {high:e} of at most {most:e}, exposed by {factor:e}"));
            }
            Ok(worst.max(drift::distance(&end.map(|v| v / factor), &plain)))
        })
    });
    let came = came.and_then(|worst| {
        held(
            worst < most,
            format!("finite, no brighter than the input; off by up to {} of the result at exposure 1", about(worst)),
        )
    });
    add(
        format!("{name}, exposures of 1e-6, 1e-3, 0.1, 10, 1e3 and 1e6"),
        &format!("finite, and the result at exposure 1 times the exposure, to {most} of it"),
        came,
    );
}

/// One pixel of 1e6 among those of an ordinary scene: what becomes of it, and of what is around it.
fn firefly(name: &str, model: &Trained<'_>, add: Add<'_>) {
    const BRIGHT: f32 = 1e6;
    let (plain, at) = (scene(9, 0.0).states[0].clone(), SIDE / 2);
    let mut lit = plain.clone();
    lit.pixel_mut(at, at).iter_mut().for_each(|v| *v += BRIGHT);
    let largest = |image: &Image, far: std::ops::RangeInclusive<usize>| {
        let pixels = (0..SIDE * SIDE).filter(|i| far.contains(&(i % SIDE).abs_diff(at).max((i / SIDE).abs_diff(at))));
        pixels.flat_map(|i| image.pixel(i % SIDE, i / SIDE)).fold(0.0f32, |most, v| most.max(v.abs()))
    };
    let came = model().and_then(|model| {
        // A local secant holds up to the next rung: steps that go farther extrapolate it, and are no means.
        let local = model.parameterization() == Parameterization::LocalVelocity;
        let mut far = Vec::new();
        for steps in (1..=9).chain([50]) {
            let ((low, high), (_, most)) = (range(&refined(model, &lit, steps)?), range(&lit));
            let mean = low >= 0.0 && high <= most;
            if local && steps < 3 && low.is_finite() && high.is_finite() {
                far.push(format!("{} to {} in {steps}", about(low), about(high)));
            } else if !mean {
                return Err(format!("{low:e} to {high:e} of at most {most:e} in {steps} steps"));
            }
        }
        let overshoot = || format!("; steps longer than a rung overshoot: {}", far.join(", "));
        let far = if local { overshoot() } else { String::new() };
        let (without, end) = (refined(model, &plain, 9)?, refined(model, &lit, 9)?);
        let ((low, high), (_, most)) = (range(&end), range(&lit));
        let sum = |image: &Image| image.data().iter().map(|v| f64::from(*v)).sum::<f64>();
        held(
            low >= 0.0 && high <= most,
            format!(
                "finite, not negative, no brighter; after 9 steps the pixel has {}, its neighbours at most {} (without \
                 the firefly {}), all others at most {} ({}): {} of its light is left{far}",
                about(largest(&end, 0..=0).into()),
                about(largest(&end, 1..=1).into()),
                about(largest(&without, 1..=1).into()),
                about(largest(&end, 2..=SIDE).into()),
                about(largest(&without, 2..=SIDE).into()),
                about((sum(&end) - sum(&without)) / (3.0 * f64::from(BRIGHT))),
            ),
        )
    });
    add(
        format!("{name}, a firefly of 1e6 in one pixel, 1 to 9 and 50 steps"),
        "finite, not negative, no brighter than the firefly, because outputs are means of the input (local_velocity \
         from 3 steps on)",
        came,
    );
}

/// Its predictions, of single precision, under a rollout in double beside one in single.
fn precision(name: &str, model: &Trained<'_>, add: Add<'_>) {
    let calls: &[usize] = &[1, 9, 100, 1000];
    let start = scene(9, 0.0);
    let came = model().and_then(|model| {
        let found = drift::of_network(model, &start.states[0], start.gbuffer.as_ref(), calls)?;
        let said: Vec<String> =
            found.iter().zip(calls).map(|(drift, calls)| format!("{} in {calls}", about(*drift))).collect();
        held(found.iter().all(|drift| *drift < 1e-5), format!("off by {} calls", said.join(", ")))
    });
    add(
        format!("{name}, rollouts of the same network in single and in double precision, 1 to 1,000 network calls"),
        "the same to 1e-5 of the image",
        came,
    );
}

/// Images in which nothing varies.
fn flat(name: &str, model: &Trained<'_>, add: Add<'_>) {
    for (what, value) in [("black", 0.0f32), ("constant", 0.7)] {
        let came = model().and_then(|model| {
            let (low, high) = range(&refined(model, &Image::new(SIDE, SIDE, 3).map(|_| value), 9)?);
            let off = (low - f64::from(value)).abs().max((high - f64::from(value)).abs());
            held(
                off <= 1e-5 * f64::from(value),
                if off == 0.0 { "unchanged".into() } else { "unchanged to 1e-5".into() },
            )
        });
        add(format!("{name}, a {what} image"), "unchanged: a constant image has no noise", came);
    }
}
