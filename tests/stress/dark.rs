//! Networks that see G-buffers, by whose albedo they divide, where albedo is dark or textured.

use super::{
    Hazard, about, drift, held,
    learning::{Lab, SIDE, guided, scene, sound},
    networks::{loaded, range, refined_with},
};
use tauflow_data::{Image, records::PackedScene};
use tauflow_train::{Loss, Model, Parameterization, Space};

const AREA: &str = "Networks and albedo";
/// What networks add to albedo before it divides.
const BLACK: f64 = 0.02;
const BRIGHT: f32 = 1e6;
/// The pixel of `scene` that is made bright.
const SPOT: usize = 33;

/// A G-buffer of this albedo for pixel and colour, facing up.
fn gbuffer(albedo: impl Fn(usize, usize) -> f32) -> Image {
    let pixels = (0..SIDE * SIDE).flat_map(|p| [albedo(p, 0), albedo(p, 1), albedo(p, 2), 0.0, 0.0, 1.0]);
    Image::from_data(SIDE, SIDE, 6, pixels.collect()).expect("fits")
}

/// From pixel to pixel and colour to colour another albedo.
fn textured() -> Image {
    const ALBEDO: [f32; 5] = [0.0, 1e-6, 0.02, 0.5, 1.0];
    gbuffer(|pixel, colour| ALBEDO[(pixel + pixel / SIDE + colour) % 5])
}

/// White but for the pixel of the firefly, which is black.
fn spot() -> Image {
    gbuffer(|pixel, _| if pixel == SPOT { 0.0 } else { 1.0 })
}

/// What networks divide by, for each value of an image.
fn divisors(gbuffer: &Image) -> Vec<f64> {
    gbuffer.data().chunks_exact(6).flat_map(|pixel| [0, 1, 2].map(|c| f64::from(pixel[c]) + BLACK)).collect()
}

/// The most light in an image: radiance by albedo.
fn light(image: &Image, gbuffer: &Image) -> f64 {
    image.data().iter().zip(divisors(gbuffer)).map(|(v, by)| f64::from(*v) / by).fold(0.0, f64::max)
}

/// A network that learned on all of these G-buffers.
fn trained(parameterization: Parameterization, space: Space, loss: Loss) -> Result<Model, String> {
    let lab = Lab::new();
    let with = |(i, gbuffer): (usize, Image)| {
        let bright = if i == 3 { BRIGHT } else { 0.0 };
        PackedScene { gbuffer: Some(gbuffer), ..scene(i as u64, bright) }
    };
    let scenes = [gbuffer(|_, _| 0.0), gbuffer(|_, _| 1e-6), textured(), spot()];
    let params = guided(parameterization, space, loss);
    let outputs = lab.train(&lab.scenes(scenes.into_iter().enumerate().map(with)), params)?;
    sound(&lab, &outputs)?;
    loaded(&lab, &outputs)
}

/// The image after so many steps, in which nothing has more light than in the first.
fn dimmer(model: &Model, image: &Image, gbuffer: &Image, steps: usize) -> Result<(Image, f64), String> {
    let end = refined_with(model, image, Some(gbuffer), steps)?;
    let (low, high) = range(&end);
    let share = light(&end, gbuffer) / light(image, gbuffer);
    // Rounding of logarithms, where they are the space.
    if low >= 0.0 && high.is_finite() && share <= 1.0 + 1e-4 {
        return Ok((end, share));
    }
    Err(format!("{low:e} to {high:e}, {share} of the light, in {steps} steps"))
}

/// The numbers of steps that are means of what is there: a local secant holds up to the next rung.
fn courses(parameterization: Parameterization) -> [usize; 3] {
    [if parameterization == Parameterization::LocalVelocity { 3 } else { 1 }, 9, 50]
}

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    let (plain, lit) = (scene(9, 0.0).states[0].clone(), scene(9, BRIGHT).states[0].clone());
    for parameterization in Parameterization::ALL {
        for (space, loss) in [(Space::Linear, Loss::Squared), (Space::Log1p, Loss::Absolute)] {
            let courses = courses(parameterization);
            let from = courses[0];
            let name = format!("{} of 20 steps in {} space", parameterization.name(), space.name());
            let model = trained(parameterization, space, loss);
            let model = || model.as_ref().map_err(Clone::clone);
            let came = model().map(|_| "finite losses and weights".into());
            add(
                format!(
                    "{name}, trained with albedo 0, albedo 1e-6, albedo that varies from 0 to 1 between pixels, and \
                     albedo 0 below a firefly of 1e6 among white pixels"
                ),
                "finite losses and weights",
                came,
            );
            let came = model().and_then(|model| {
                let [most, apart] = courses.into_iter().try_fold([0.0f64; 2], |[most, apart], steps| {
                    let (black, a) = dimmer(model, &plain, &gbuffer(|_, _| 0.0), steps)?;
                    let (dark, b) = dimmer(model, &plain, &gbuffer(|_, _| 1e-6), steps)?;
                    let (_, c) = dimmer(model, &plain, &textured(), steps)?;
                    Ok::<_, String>([most.max(a).max(b).max(c), apart.max(drift::distance(&dark, &black))])
                })?;
                held(
                    apart < 1e-3,
                    format!(
                        "finite, not negative; at most {most:.2} of the input's light; images of albedo 1e-6 and 0 \
                         differ by {}",
                        about(apart)
                    ),
                )
            });
            add(
                format!(
                    "{name}, albedo 0, albedo 1e-6, and albedo that varies from 0 to 1 between pixels; {from}, 9 and \
                     50 steps"
                ),
                "finite, not negative; radiance/(albedo + 0.02) at most that of the input, because outputs are means \
                 of it; with albedo 1e-6 the image of albedo 0, to 1e-3",
                came,
            );
            let came = model().and_then(|model| {
                // Light of 3/4 everywhere on the texture: whatever the weights, its mean is itself.
                let texture = textured();
                let even = divisors(&texture).into_iter().map(|by| (0.75 * by) as f32).collect();
                let even = Image::from_data(SIDE, SIDE, 3, even).map_err(|e| e.to_string())?;
                let off = courses.into_iter().try_fold(0.0f64, |worst, steps| {
                    let (end, _) = dimmer(model, &even, &texture, steps)?;
                    let off = |(a, b): (&f32, &f32)| f64::from((a - b).abs() / b);
                    Ok::<_, String>(end.data().iter().zip(even.data()).map(off).fold(worst, f64::max))
                })?;
                held(off < 1e-4, format!("unchanged, each value to {}", about(off)))
            });
            add(
                format!(
                    "{name}, uniform light on albedo that varies from 0 to 1 between pixels; {from}, 9 and 50 steps"
                ),
                "unchanged, each value to 1e-4: the light has no noise",
                came,
            );
            let came = model().and_then(|model| {
                let most = courses.into_iter().try_fold(0.0f64, |most, steps| {
                    let (end, _) = dimmer(model, &lit, &spot(), steps)?;
                    Ok::<_, String>(most.max(range(&end).1))
                })?;
                let (least, times) = (range(&dimmer(model, &lit, &spot(), 9)?.0).0, most / f64::from(BRIGHT));
                Ok(format!("finite, not negative (from {}); at most {times:.2} times the firefly", about(least)))
            });
            add(
                format!("{name}, a firefly of 1e6 on albedo 0 among white pixels; {from}, 9 and 50 steps"),
                "finite, not negative; at most 51 times the firefly: its light, radiance/0.02, on a white pixel",
                came,
            );
        }
    }
    out
}
