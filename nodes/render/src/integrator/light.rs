//! Light tracing: paths begin at the lights, and every surface that they meet sends light to the pinhole.
//!
//! It finds what a path from the camera hardly ever finds: light that glass and mirrors gather on a surface that
//! scatters it, and light of surfaces close to a lamp. It does not find what the camera sees in glass and mirrors. So
//! it is used in two ways:
//!
//! - [`Which::Alone`]: everything, for scenes that nothing specular is in.
//! - [`Which::Joined`]: beside a path tracer, which finds the same light by scattering and by sampling lights. All
//!   three are weighed by the power heuristic (Veach 1997). Light that comes straight from a lamp is left to the path
//!   tracer. So are lights without extent: no path from the camera finds what glass and mirrors make of them, and all
//!   integrators have one expectation. Paths are aimed ([`crate::lights::Aims`]).
//!
//! The contribution of a vertex is that of Veach's strategy t = 1 (*Robust Monte Carlo Methods*, section 10.3).
//! Scattering is evaluated with the directions that a path from the camera would have, so that radiance at interfaces
//! and shading normals agree with the path tracer (section 5.3).

use super::{Dimmed, PASSAGES, dimension, first_solid};
use crate::{
    bsdf::Material,
    camera::Camera,
    geometry::{Frame, Ray, offset_origin},
    lights::{Aims, Emitted},
    rng::{Sampler, render_state},
    splats::{Finds, Splat, Splats},
    surface::Interaction,
    world::World,
};
use glam::Vec3;
use rayon::prelude::*;
use tauflow_data::{SamplerKind, image::luminance, rng::mix};

/// Label that parts the numbers of light paths from those of paths from the camera.
const LIGHT_PATHS: u64 = 0x6C69_6768_7470;
/// Light paths of a task.
const TASK: u64 = 2048;
/// Pixels for each light path beside a path tracer.
const PIXELS: u64 = 4;
/// Label of the numbers of paths by which shares of pairs are learnt, and how many there are at most.
const TRIALS: u64 = 0x7472_6961_6C73;
const MOST_TRIALS: u64 = 1 << 14;
/// Shadow rays towards the camera end this short of where the view begins.
const VIEW_END: f32 = 1.0 - 1e-5;

/// Which light paths count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// All.
    Alone,
    /// All but those of one vertex, weighed against a path tracer.
    Joined,
}

/// How light paths are emitted, and how many for each sample index.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) aims: Aims,
    pub(crate) count: u64,
}

/// A light tracer at work on a film.
pub(crate) struct LightPaths<'a> {
    pub(crate) world: &'a World,
    pub(crate) camera: &'a Camera,
    pub(crate) size: (usize, usize),
    pub(crate) stream: u64,
    pub(crate) sampler: SamplerKind,
    pub(crate) which: Which,
    pub(crate) plan: &'a Plan,
}

/// Where a light path meets a surface.
struct Vertex<'a> {
    at: Interaction,
    frame: Frame,
    material: &'a Material,
    /// Towards the light.
    back: Vec3,
    mapped: bool,
}

/// What of a light path is known at a vertex.
struct Carried {
    power: Vec3,
    /// Density of the emission over area and solid angle, over the cosine at the light.
    density: f32,
    /// Vertices passed, and those of them that were not specular.
    vertices: u32,
    scattered: u32,
    /// A path from the camera may pass the same vertices the other way round. This is its density of scattering over
    /// that of this path, over projected solid angle, as a product over the vertices passed.
    ratio: f32,
    /// The same of a path from the camera that samples lights at the last of its vertices.
    by_lights: f32,
}

impl Plan {
    /// None where light paths bring nothing to the film.
    pub(crate) fn new(which: Which, world: &World, camera: &Camera, size: (usize, usize)) -> Option<Self> {
        let count = (size.0 * size.1) as u64;
        if which == Which::Alone {
            return Some(Self { aims: Aims::anywhere(&world.lights), count });
        }
        // A light path takes longer than one from the camera, and may light a pixel from each of its vertices.
        let first = Self { aims: Aims::towards_specular(world)?, count: count.div_ceil(PIXELS) };
        let sampler = SamplerKind::Independent;
        let (brought, paths) = LightPaths { world, camera, size, stream: 0, sampler, which, plan: &first }.try_out();
        Some(Self { aims: first.aims.learnt(&brought, &paths)?, count: first.count })
    }
}

impl LightPaths<'_> {
    /// What the samples of these indices find.
    pub(crate) fn trace(&self, samples: std::ops::Range<u64>) -> Splats {
        let (count, pixels) = (self.plan.count, self.size.0 * self.size.1);
        let many = samples.end - samples.start;
        let mut splats = Splats::new(pixels, many as usize);
        let state = mix(render_state(self.world.seed, self.stream), LIGHT_PATHS);
        let tasks = count.div_ceil(TASK);
        splats.gather(many * tasks, |task| {
            let (sample, part) = (task / tasks, task % tasks);
            let mut finds = Finds::default();
            for path in part * TASK..((part + 1) * TASK).min(count) {
                let numbers = self.numbers(state, path, samples.start + sample);
                self.path(&numbers, sample as u32, &mut finds);
            }
            finds
        });
        splats
    }

    fn numbers(&self, state: u64, path: u64, sample: u64) -> Sampler {
        let width = self.size.0 as u64;
        Sampler::new(self.sampler, state, ((path % width) as u32, (path / width) as u32), sample)
    }

    /// By pair of a light and a ball: squares of the light that paths bring, and how many paths there were.
    fn try_out(&self) -> (Vec<f64>, Vec<u64>) {
        let count = (8 * (self.size.0 * self.size.1) as u64).min(MOST_TRIALS);
        let state = mix(render_state(self.world.seed, self.stream), TRIALS);
        let pairs = self.plan.aims.len();
        let tasks: Vec<(Vec<f64>, Vec<u64>)> = (0..count.div_ceil(TASK))
            .into_par_iter()
            .map(|task| {
                let (mut brought, mut paths) = (vec![0.0; pairs], vec![0; pairs]);
                for path in task * TASK..((task + 1) * TASK).min(count) {
                    let mut finds = Finds::default();
                    let Some(pair) = self.path(&self.numbers(state, path, 0), 0, &mut finds) else { continue };
                    let squares =
                        finds.splats.iter().map(|splat| f64::from(luminance(&splat.light.to_array())).powi(2));
                    brought[pair] += squares.sum::<f64>();
                    paths[pair] += 1;
                }
                (brought, paths)
            })
            .collect();
        let mut all = (vec![0.0; pairs], vec![0; pairs]);
        for (brought, paths) in tasks {
            for pair in 0..pairs {
                all.0[pair] += brought[pair];
                all.1[pair] += paths[pair];
            }
        }
        all
    }

    /// One light path; the pair of light and ball that it began with.
    fn path(&self, numbers: &Sampler, sample: u32, finds: &mut Finds) -> Option<usize> {
        let pair = self.world.lights.pairing(&self.plan.aims, numbers)?;
        if let Some(emitted) = self.world.lights.emit(self.world, &self.plan.aims, &pair, numbers) {
            self.follow(emitted, numbers, sample, finds);
        }
        Some(pair.number)
    }

    fn follow(&self, emitted: Emitted, numbers: &Sampler, sample: u32, finds: &mut Finds) {
        let world = self.world;
        let mut ray = emitted.ray;
        let (power, density) = (emitted.power, emitted.density);
        let mut carried = Carried { power, density, vertices: 0, scattered: 0, ratio: 1.0, by_lights: 0.0 };
        // The last segment is that to the camera.
        for depth in 1..world.max_depth {
            finds.segments += 1;
            let Some((hit, at)) = first_solid(world, numbers, depth, ray) else { return };
            let material = world.material(&at);
            let frame = world.shading_frame(&hit, world.place(hit.primitive).1, &at, -ray.direction);
            let back = -ray.direction;
            let vertex = Vertex { at, frame, material, back, mapped: material.has_normal_map() };
            let counts = self.which == Which::Alone || carried.vertices > 0;
            if counts && material.has_smooth() {
                self.connect(&vertex, &carried, sample, finds);
            }
            if depth + 1 >= world.max_depth
                || !self.go_on(&vertex, &emitted, (numbers, depth), &mut carried, &mut ray, finds)
            {
                return;
            }
        }
    }

    /// Sends light from a vertex to the camera.
    fn connect(&self, vertex: &Vertex<'_>, carried: &Carried, sample: u32, finds: &mut Finds) {
        let at = &vertex.at;
        let away = at.p.as_dvec3() - self.camera.origin.as_dvec3();
        let square = away.length_squared();
        let distance = square.sqrt();
        if !(distance > 0.0 && distance.is_finite()) {
            return;
        }
        let direction = away / distance;
        let Some(image) = self.camera.image(direction) else { return };
        let (width, height) = self.size;
        let inside = image.x >= 0.0 && image.y >= 0.0 && image.x < width as f64 && image.y < height as f64;
        if !inside || distance <= image.begin {
            return;
        }
        let out = -direction.as_vec3();
        let Some((value, pdf)) = vertex.scatters(out, vertex.back) else { return };
        // Light that arrives spreads over the surface as its geometric normal has it.
        let (arrives, leaves) = (at.geometric.dot(vertex.back).abs(), at.geometric.dot(out).abs());
        let pixels = (image.pixels / square) as f32 * leaves;
        let mut light = carried.power * value * (pixels / arrives / self.plan.count as f32);
        if self.which == Which::Joined {
            let camera = pdf * pixels / arrives / (carried.density * self.plan.count as f32);
            let (by_scattering, by_lights) = (camera * carried.ratio, camera * carried.by_lights);
            light *= 1.0 / (1.0 + by_scattering * by_scattering + by_lights * by_lights);
        }
        if !light.is_finite() {
            finds.rejected += 1;
            return;
        }
        if light == Vec3::ZERO {
            return;
        }
        finds.segments += 1;
        let origin = offset_origin(at.p, at.error, at.geometric, out);
        let end = (self.camera.origin.as_dvec3() + direction * image.begin).as_vec3();
        let light = light * reaches(self.world, Ray { origin, direction: end - origin, t_max: VIEW_END });
        if light != Vec3::ZERO {
            let pixel = image.y as usize * width + image.x as usize;
            finds.splats.push(Splat { pixel: pixel as u32, sample, light });
        }
    }

    /// Scatters a light path at a vertex; false if it ends there.
    fn go_on(
        &self,
        vertex: &Vertex<'_>,
        emitted: &Emitted,
        (numbers, depth): (&Sampler, u32),
        carried: &mut Carried,
        ray: &mut Ray,
        finds: &mut Finds,
    ) -> bool {
        let first = Sampler::vertex(depth);
        let choice = numbers.two(first + dimension::LOBE_AND_ROULETTE);
        let local = vertex.frame.to_local(vertex.back);
        let bsdf = vertex.material.at(&vertex.at.surface);
        let Some(drawn) = bsdf.sample(local, choice.x, numbers.two(first + dimension::SCATTER)) else { return false };
        let out = vertex.frame.to_world(drawn.wi).normalize();
        let (arrives, leaves) = (vertex.at.geometric.dot(vertex.back).abs(), vertex.at.geometric.dot(out).abs());
        let weight = if drawn.delta {
            // Light is scattered as radiance is, but for the squared index, and spreads by geometric normals.
            let (along, onwards) = (local.z.abs(), drawn.wi.z.abs());
            let fits = !vertex.mapped || vertex.keeps_side(vertex.back);
            if !fits {
                return false;
            }
            drawn.weight * (drawn.eta * drawn.eta) * (along * leaves / (arrives * onwards))
        } else {
            let Some((value, pdf)) = vertex.scatters(out, vertex.back) else { return false };
            let turned = leaves / (drawn.pdf * arrives);
            if carried.vertices == 0 {
                carried.by_lights = self.world.lights.finds(emitted, vertex.at.p) * turned;
            } else {
                carried.by_lights *= pdf * turned;
            }
            carried.ratio *= pdf * turned;
            carried.scattered += 1;
            value * (leaves / (arrives * drawn.pdf))
        };
        let before = carried.power.max_element();
        let mut power = carried.power * weight;
        if power == Vec3::ZERO {
            return false;
        }
        if !(power.is_finite() && carried.ratio.is_finite() && carried.by_lights.is_finite()) {
            finds.rejected += 1;
            return false;
        }
        carried.vertices += 1;
        let ends_at_random = match self.which {
            Which::Alone => carried.vertices > 2,
            Which::Joined => carried.scattered > 0,
        };
        if ends_at_random {
            let survival = (power.max_element() / before).clamp(1.0 / (1u32 << 24) as f32, 0.95);
            if choice.y >= survival {
                return false;
            }
            power /= survival;
        }
        carried.power = power;
        *ray = Ray::new(offset_origin(vertex.at.p, vertex.at.error, vertex.at.geometric, out), out);
        true
    }
}

impl Vertex<'_> {
    /// What is scattered from the direction `to_light` towards `out`, times the cosine at `to_light`, and the density
    /// with which a path that comes from `out` finds it; none if nothing is.
    fn scatters(&self, out: Vec3, to_light: Vec3) -> Option<(Vec3, f32)> {
        let bsdf = self.material.at(&self.at.surface);
        let (wo, wi) = (self.frame.to_local(out), self.frame.to_local(to_light));
        let value = bsdf.eval(wo, wi);
        if value.max_element() <= 0.0 || (self.mapped && !self.keeps_side(to_light)) {
            return None;
        }
        Some((value, bsdf.pdf(wo, wi)))
    }

    /// Whether a normal map carries no light from `to_light` through the surface.
    fn keeps_side(&self, to_light: Vec3) -> bool {
        to_light.dot(self.at.shading) * self.frame.n.dot(to_light) > 0.0
    }
}

/// The share of light that reaches the end of a ray.
pub(crate) fn reaches(world: &World, ray: Ray) -> f32 {
    if !world.features.opacity {
        return if world.accel.occluded(&ray) { 0.0 } else { 1.0 };
    }
    let mut rest = Dimmed { ray, share: 1.0 };
    for _ in 0..=PASSAGES {
        let Some(hit) = world.accel.closest(&rest.ray) else { return rest.share };
        if !rest.pass(world, &hit) {
            return rest.share;
        }
    }
    0.0
}
