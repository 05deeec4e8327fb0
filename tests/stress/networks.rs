//! Trained networks on images at the ends of what numbers can be.

use super::{
    Hazard, held,
    learning::{Lab, SIDE, scene, short},
};
use tauflow_data::{Image, time::TimeGrid};
use tauflow_train::{Conditioning, Course, Decay, Loss, Model, Parameterization, Space, TrainingParams, rollout};

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
    Model::load(&lab.part(&outputs, "model")).map_err(|e| e.to_string())
}

fn refined(model: &Model, image: &Image, steps: usize) -> Result<Image, String> {
    let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
    rollout(model, image, scene(9, 0.0).gbuffer.as_ref(), course).map_err(|e| e.to_string())
}

/// Least and largest value.
fn range(image: &Image) -> (f64, f64) {
    image.data().iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(f64::from(*v)), b.max(f64::from(*v))))
}

/// Root mean square of the difference, over that of the second image.
fn distance(a: &Image, b: &Image) -> f64 {
    let pairs = || a.data().iter().zip(b.data()).map(|(a, b)| (f64::from(*a), f64::from(*b)));
    (pairs().map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / pairs().map(|(_, b)| b * b).sum::<f64>()).sqrt()
}

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    for parameterization in Parameterization::ALL {
        for (space, loss) in [(Space::Linear, Loss::Squared), (Space::Log1p, Loss::Absolute)] {
            let name = format!("{} of 40 steps in {} space", parameterization.name(), space.name());
            let model = trained(parameterization, space, loss);
            let model = || model.as_ref().map_err(Clone::clone);
            exposures(&name, &model, &mut add);
            flat(&name, &model, &mut add);
            if space == Space::Linear {
                let came = model().and_then(|model| refined(model, &scene(9, 0.0).states[0], 1000));
                let came = came.and_then(|end| {
                    let ((low, high), (_, most)) = (range(&end), range(&scene(9, 0.0).states[0]));
                    held(low.is_finite() && high <= most, "finite, and no brighter than the input".into())
                });
                add(format!("{name}, 1,000 calls"), "finite, and no brighter than the input", came);
            }
            let blinding = scene(9, 0.0).states[0].map(|v| 1.0 + 1e38 * v);
            let came = match (space, model().and_then(|model| refined(model, &blinding, 9))) {
                (_, Err(told)) => {
                    held(told.contains("beyond") && told.contains("expose it lower"), "refused, with what to do".into())
                }
                (Space::Log1p, Ok(_)) => Err("taken: its space ends at 6e37".into()),
                (Space::Linear, Ok(end)) => {
                    let ((low, high), (_, most)) = (range(&end), range(&blinding));
                    held(low.is_finite() && high <= most, "finite, and no brighter than the input".into())
                }
            };
            add(format!("{name}, radiance up to 1e38"), "finite, or refused by name: nothing is cut", came);
        }
    }
    out
}

type Add<'a> = &'a mut dyn FnMut(String, &str, Result<String, String>);
type Trained<'a> = dyn Fn() -> Result<&'a Model, String> + 'a;

/// How far from what an exposure should do: nothing but to scale.
fn exposures(name: &str, model: &Trained<'_>, add: Add<'_>) {
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
            Ok(worst.max(distance(&end.map(|v| v / factor), &plain)))
        })
    });
    // In words: the last digits of a training are not the point.
    let came = came.and_then(|worst| {
        let share = [(0.05, "a twentieth"), (0.125, "an eighth"), (0.25, "a quarter")];
        let share = share.into_iter().find(|(share, _)| worst < *share).ok_or(format!("off by {worst:.2}"))?.1;
        Ok(format!("finite, no brighter than the input, and the image of exposure 1 but for less than {share} of it"))
    });
    add(
        format!("{name}, exposures of 1e-6, 1e-3, 0.1, 10, 1e3 and 1e6"),
        "finite, and what exposure 1 gives, exposed so, to a quarter",
        came,
    );
}

/// Images in which nothing varies.
fn flat(name: &str, model: &Trained<'_>, add: Add<'_>) {
    for (what, value) in [("black", 0.0f32), ("constant", 0.7)] {
        let came = model().and_then(|model| {
            let (low, high) = range(&refined(model, &Image::new(SIDE, SIDE, 3).map(|_| value), 9)?);
            let off = (low - f64::from(value)).abs().max((high - f64::from(value)).abs());
            held(off <= 1e-5 * f64::from(value), if off == 0.0 { "itself".into() } else { "itself to 1e-5".into() })
        });
        add(format!("{name}, a {what} image"), "itself: nothing varies, so nothing is noise", came);
    }
}
