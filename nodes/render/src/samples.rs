//! Single samples of a render, each with what its path meets first, for data sets of samples.
//!
//! The samples are those of a ladder: their mean is its rung of as many samples, up to rounding.

use crate::{
    integrator::first_solid,
    render::{Renderer, Setup},
    rng::{Sampler, render_state},
    world::{LoadBlob, World},
};
use rayon::prelude::*;
use tauflow_contract::KindError;
use tauflow_data::{Image, scene::Scene};

/// How far a sample is that meets nothing, in units of the scene.
pub const FAR: f32 = 1e5;

/// One sample of every pixel, with three values in each.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Linear radiance.
    pub radiance: Image,
    /// Where its path meets the first surface, in the world; at a distance of [`FAR`] for none.
    pub position: Image,
    /// The shading normal there, in the world, towards the camera; 0 for no surface.
    pub normal: Image,
    /// The albedo there; 0 for no surface.
    pub albedo: Image,
}

/// Hands the samples 0..`count` of a stream to `take`, one after the other.
///
/// # Errors
/// If the scene cannot be compiled, a value is not finite, or `take` says to stop.
pub fn render_samples(
    scene: &Scene,
    load: LoadBlob<'_>,
    (setup, stream): (Setup, u64),
    count: u64,
    take: &mut dyn FnMut(Sample) -> Result<(), KindError>,
) -> Result<(), KindError> {
    let world = World::new(scene, load)?.with_choices(setup.choices);
    let renderer = Renderer::new(&world, setup.film, stream)?;
    let renderer = renderer.with_sampler(setup.sampler).with_integrator(setup.integrator);
    (0..count).try_for_each(|index| take(sample(&renderer, (setup, stream), index)?))
}

fn sample(renderer: &Renderer<'_>, (setup, stream): (Setup, u64), index: u64) -> Result<Sample, KindError> {
    // An accumulator that says it has the samples before this one adds no other.
    let mut one = renderer.begin();
    one.count = index;
    renderer.advance(&mut one, index + 1, &mut |_| Ok(()))?;
    let state = render_state(renderer.world().seed, stream);
    let (width, height) = renderer.size();
    let met = |at: usize| -> [[f32; 3]; 3] {
        let pixel = renderer.pixel(at);
        let sampler = Sampler::new(setup.sampler, state, pixel, index);
        let (world, ray) = (renderer.world(), renderer.camera_ray(&sampler, pixel));
        let Some((hit, at)) = first_solid(world, &sampler, 0, ray) else {
            let far = ray.origin + FAR * ray.direction;
            return [far.to_array(), [0.0; 3], [0.0; 3]];
        };
        let normal = world.shading_frame(&hit, world.place(hit.primitive).1, &at, -ray.direction).n;
        let albedo = world.material(&at).at(&at.surface).albedo();
        [at.p.to_array(), normal.to_array(), albedo.to_array()]
    };
    let met: Vec<[[f32; 3]; 3]> = (0..width * height).into_par_iter().map(met).collect();
    let image = |what: &str, data: Vec<f32>| -> Result<Image, KindError> {
        let image = Image::from_data(width, height, 3, data).expect("three values for each pixel");
        image.finite(what, "mend the normals, texture coordinates or materials of what is seen")?;
        Ok(image)
    };
    let of = |part: usize| met.iter().flat_map(|parts| parts[part]).collect::<Vec<f32>>();
    let radiance = one.pixels.iter().flat_map(|pixel| pixel.sum.map(|value| value as f32)).collect();
    Ok(Sample {
        radiance: image("sample's radiance", radiance)?,
        position: image("sample's position", of(0))?,
        normal: image("sample's normal", of(1))?,
        albedo: image("sample's albedo", of(2))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;
    use glam::Vec3;
    use tauflow_contract::Digest;
    use tauflow_data::Resolution;

    #[test]
    fn samples_have_the_mean_of_a_rung_and_see_what_the_camera_sees() {
        let built = scenes::everything();
        let scene = &built.scene;
        let film = Resolution::new(12, 10).expect("a film");
        let setup = Setup::new(film);
        let mut all = Vec::new();
        let load = &mut |digest: &Digest| built.load(digest);
        render_samples(scene, load, (setup, 0), 5, &mut |sample| {
            all.push(sample);
            Ok(())
        })
        .expect("rendered");
        let world = World::new(scene, load).expect("a world").with_choices(setup.choices);
        let renderer = Renderer::new(&world, film, 0).expect("a renderer");
        let mut rung = renderer.begin();
        renderer.advance(&mut rung, 5, &mut |_| Ok(())).expect("rendered");
        for (at, value) in rung.mean().data().iter().enumerate() {
            let mean = all.iter().map(|sample| f64::from(sample.radiance.data()[at])).sum::<f64>() / 5.0;
            assert!((mean - f64::from(*value)).abs() <= 1e-6 * f64::from(value.abs()), "{mean}, not {value}");
        }
        // A position lies on the ray through its pixel.
        let camera = renderer.middle_ray((0, 0)).origin;
        for sample in &all {
            for (at, position) in sample.position.data().chunks_exact(3).enumerate() {
                let pixel = renderer.pixel(at);
                let towards = (Vec3::from_slice(position) - camera).normalize();
                let middle = renderer.middle_ray(pixel).direction;
                assert!(towards.dot(middle) > 0.97, "{pixel:?}: {towards} is not near {middle}");
                let normal = Vec3::from_slice(&sample.normal.data()[3 * at..3 * at + 3]);
                assert!(normal.length() == 0.0 || (normal.length() - 1.0).abs() < 1e-3, "{normal}");
                assert!(normal.dot(towards) <= 0.1, "{normal} looks away from the camera");
            }
        }
    }
}
