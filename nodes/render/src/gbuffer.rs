//! Features: albedo and camera-space shading normal of the first surface, or of the first that scatters light, averaged
//! over samples of each pixel.

use crate::{
    accumulator::Accumulator,
    geometry::{Ray, offset_origin},
    integrator::{dimension, first_solid},
    render::Renderer,
    rng::{Sampler, render_state},
};
use glam::Vec3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::KindError;
use tauflow_data::{Image, SamplerKind, records::GBuffer};

/// Label that parts the samples of the G-buffer from those of the render.
const GBUFFER_STREAM: u64 = 0x6762_7566;
/// Samples between looks at whether to stop.
const CHUNK: u64 = 8;

/// The surface that a G-buffer describes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GBufferSurface {
    /// The first, mirrors and clear glass included.
    #[default]
    First,
    /// The first that is no smooth mirror and no clear glass: what is seen in mirrors and behind glass. Its albedo is
    /// tinted by them.
    Rough,
}

impl Renderer<'_> {
    /// Renders the G-buffer of a surface with `samples` a pixel; `pause` may stop it.
    ///
    /// # Errors
    /// Returns the error of `pause`, or an error with the number of values that are not finite.
    pub fn gbuffer(
        &self,
        (stream, surface): (u64, GBufferSurface),
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
                    let sampler = Sampler::new(SamplerKind::Independent, state, pixel, index);
                    let features = self.features(&sampler, pixel, surface);
                    albedo.add(index, features[0]);
                    normal.add(index, features[1]);
                }
            });
            done = until;
        }
        (albedo.count, normal.count) = (done, done);
        Ok(GBuffer { albedo: finite(albedo.mean(), "albedo")?, normal: finite(normal.mean(), "normal")? })
    }

    fn features(&self, sampler: &Sampler, pixel: (u32, u32), surface: GBufferSurface) -> [[f32; 3]; 2] {
        let world = self.world();
        let mut ray = self.camera_ray(sampler, pixel);
        let mut tint = Vec3::ONE;
        for depth in 0..world.max_depth {
            let Some((hit, at)) = first_solid(world, sampler, depth, ray) else { break };
            let (material, back) = (world.material(&at), -ray.direction);
            let frame = world.shading_frame(&hit, world.place(hit.primitive).1, &at, back);
            if surface == GBufferSurface::First || material.has_smooth() {
                let albedo = tint * material.at(&at.surface).albedo();
                return [albedo.to_array(), self.seen(frame.n).to_array()];
            }
            let first = Sampler::vertex(depth);
            let (lobe, two) =
                (sampler.two(first + dimension::LOBE_AND_ROULETTE).x, sampler.two(first + dimension::SCATTER));
            let Some(drawn) = material.at(&at.surface).sample(frame.to_local(back), lobe, two) else { break };
            tint *= drawn.weight;
            let out = frame.to_world(drawn.wi).normalize();
            ray = Ray::new(offset_origin(at.p, at.error, at.geometric, out), out);
        }
        [[0.0; 3]; 2]
    }
}

/// An image, unless it has values that are not finite: materials are held to their bounds, so that it is the surface
/// that is broken.
fn finite(image: Image, what: &str) -> Result<Image, KindError> {
    let remedy = "mend the normals, texture coordinates or materials of what is seen";
    image.finite(&format!("G-buffer's {what}"), remedy)?;
    Ok(image)
}
