//! First-hit features: albedo and camera-space shading normal, averaged over samples of each pixel.

use crate::{
    accumulator::Accumulator,
    integrator::first_solid,
    render::Renderer,
    rng::{Sampler, render_state},
};
use rayon::prelude::*;
use tauflow_contract::KindError;
use tauflow_data::{Image, SamplerKind, records::GBuffer};

/// Label that parts the samples of the G-buffer from those of the render.
const GBUFFER_STREAM: u64 = 0x6762_7566;
/// Samples between looks at whether to stop.
const CHUNK: u64 = 8;

impl Renderer<'_> {
    /// Renders the G-buffer with `samples` a pixel; `pause` may stop it.
    ///
    /// # Errors
    /// Returns the error of `pause`, or an error with the number of values that are not finite.
    pub fn gbuffer(
        &self,
        stream: u64,
        samples: u64,
        pause: &mut dyn FnMut(u64) -> Result<(), KindError>,
    ) -> Result<GBuffer, KindError> {
        let state = tauflow_data::rng::mix(render_state(self.world().seed, stream), GBUFFER_STREAM);
        let (width, height) = self.size();
        let (mut albedo, mut normal) = (Accumulator::new(width, height), Accumulator::new(width, height));
        let mut done = 0;
        while done < samples {
            pause(done)?;
            let until = (done + CHUNK).min(samples);
            albedo.pixels.par_iter_mut().zip(&mut normal.pixels).enumerate().for_each(|(at, (albedo, normal))| {
                let pixel = self.pixel(at);
                for index in done..until {
                    let features = self.features(&Sampler::new(SamplerKind::Independent, state, pixel, index), pixel);
                    albedo.add(index, features[0]);
                    normal.add(index, features[1]);
                }
            });
            done = until;
        }
        (albedo.count, normal.count) = (done, done);
        Ok(GBuffer { albedo: finite(albedo.mean(), "albedo")?, normal: finite(normal.mean(), "normal")? })
    }

    fn features(&self, sampler: &Sampler, pixel: (u32, u32)) -> [[f32; 3]; 2] {
        let world = self.world();
        let ray = self.camera_ray(sampler, pixel);
        let Some((hit, at)) = first_solid(world, sampler, 0, ray) else {
            return [[0.0; 3]; 2];
        };
        let albedo = world.material(&at).at(&at.surface).albedo();
        let normal = self.seen(world.shading_frame(&hit, world.place(hit.primitive).1, &at, -ray.direction).n);
        [albedo.to_array(), normal.to_array()]
    }
}

/// An image, unless it has values that are not finite: materials are held to their bounds, so that it is the surface
/// that is broken.
fn finite(image: Image, what: &str) -> Result<Image, KindError> {
    let remedy = "mend the normals, texture coordinates or materials of what is seen";
    image.finite(&format!("G-buffer's {what}"), remedy)?;
    Ok(image)
}
