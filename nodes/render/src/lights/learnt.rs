//! The part of the light that guides promise which arrives, in the cells of a grid: learnt from a few paths before the
//! render.
//!
//! The paths go from the camera over three surfaces. From each, one sample of every light is drawn, or of a few lights
//! where there are many. The root mean square of what arrives over what the guide promises is the part of a light in a
//! cell: its contribution varies as much, and probabilities in proportion to it give the least variance. Cells with few
//! surfaces lean towards the mean over all cells. All depends on the scene alone, so that samples stay independent.

use super::{GUIDED, Lights, Vantage, brightness};
use crate::{
    geometry::{Ray, offset_origin},
    integrator::{dimension, first_solid, reaches},
    lanes::{Integer, Real, Triple},
    render::Renderer,
    rng::{Sampler, render_state},
    table::Halves,
    world::World,
};
use glam::Vec3;
use rayon::prelude::*;
use tauflow_data::{Resolution, SamplerKind, rng::mix};

/// Scenes of more lights learn nothing.
const MOST: usize = 256;
/// Cells along each axis.
const CELLS: usize = 8;
/// Paths along each axis of the film.
const SIDE: u32 = 48;
/// Surfaces of a path at which lights are looked for.
const SURFACES: usize = 3;
/// Segments of a path at most: glass and mirrors are passed.
const SEGMENTS: u32 = 8;
/// Label that parts the numbers of these paths from those of the render.
const STREAM: u64 = 0x006c_6561_726e_7400;
/// Weight of the mean over all cells, as a number of surfaces.
const LEAN: f64 = 2.0;
/// The least part of a light: more may arrive where no path came by.
const LEAST: f64 = 1e-3;
/// The greatest part that counts: next to a lamp, single samples are far brighter than the guide.
const MOST_PART: f64 = 16.0;
/// Probability, among many lights, that does not follow from what arrives.
const BY_POWER: f64 = 0.2;

/// Parts of the lights that arrive, by cell.
#[derive(Debug)]
pub(crate) struct Learnt {
    low: Vec3,
    /// Cells per length.
    scale: Vec3,
    lights: i32,
    /// The part of each light, cell by cell.
    arrives: Vec<f32>,
    /// The same of up to [`GUIDED`] lights: half a record for each cell. Empty if there are more.
    few: Halves,
    /// For each of many lights, the sum of the probabilities of those before it, and 1 at the end, cell by cell.
    before: Vec<f32>,
}

/// A surface, and the squared part that arrived of each light that was looked for.
struct Met {
    p: Vec3,
    parts: Vec<(usize, f64)>,
}

impl Learnt {
    /// Learns the parts of a world's lights; none if there is nothing to choose, or nothing is seen.
    pub(crate) fn of(world: &World) -> Option<Self> {
        let lights = world.lights.lights.len();
        if !(2..=MOST).contains(&lights) {
            return None;
        }
        // A camera that looks nowhere is told of by who renders.
        let renderer = Renderer::new(world, Resolution::new(SIDE, SIDE).ok()?, 0).ok()?;
        let state = mix(render_state(world.seed, 0), STREAM);
        let paths = (0..(SIDE * SIDE) as usize).into_par_iter();
        let met: Vec<Vec<Met>> = paths.map(|at| path(&renderer, state, renderer.pixel(at))).collect();
        let met: Vec<Met> = met.into_iter().flatten().collect();
        let (low, high) = extent(&met)?;
        // A margin of odd size keeps walls at round places off the borders of cells: light paths and paths from the
        // camera reach the same point with other roundings.
        let size = high - low;
        let (low, size) = (low - 0.0123 * size, 1.0494 * size);
        let scale = CELLS as f32 / size.max(Vec3::splat((size.max_element() * 1e-3).max(1e-20)));
        let (arrives, few, before) = (Vec::new(), Halves::default(), Vec::new());
        let mut learnt = Self { low, scale, lights: lights as i32, arrives, few, before };
        learnt.arrives = learnt.parts(lights, &met);
        if lights > GUIDED {
            learnt.before = learnt.steps(&world.lights);
        } else {
            learnt.few = learnt.records();
        }
        (low.is_finite() && scale.is_finite()).then_some(learnt)
    }

    fn parts(&self, lights: usize, met: &[Met]) -> Vec<f32> {
        let (mut sums, mut all) = (vec![[0.0; 2]; CELLS.pow(3) * lights], vec![[0.0; 2]; lights]);
        for met in met {
            let cell = self.cell::<f32>(met.p.into()) as usize;
            for (light, square) in &met.parts {
                for sum in [&mut sums[cell * lights + light], &mut all[*light]] {
                    *sum = [sum[0] + square, sum[1] + 1.0];
                }
            }
        }
        let part = |at: usize| {
            let ([sum, count], [total, of]) = (sums[at], all[at % lights]);
            let mean = if of > 0.0 { total / of } else { 1.0 };
            ((sum + LEAN * mean) / (count + LEAN)).sqrt().max(LEAST) as f32
        };
        (0..sums.len()).map(part).collect()
    }

    /// The parts of few lights, with 0 for those that are missing.
    fn records(&self) -> Halves {
        let mut few = Halves::default();
        for parts in self.arrives.chunks_exact(self.lights as usize) {
            few.push(std::array::from_fn(|light| parts.get(light).copied().unwrap_or(0.0)));
        }
        few
    }

    /// Probabilities of many lights, each the sum of those before.
    fn steps(&self, lights: &Lights) -> Vec<f32> {
        let count = lights.lights.len();
        let mut steps = Vec::with_capacity(CELLS.pow(3) * (count + 1));
        for cell in 0..CELLS.pow(3) {
            let place = [cell % CELLS, cell / CELLS % CELLS, cell / CELLS / CELLS];
            // Guides grow beyond bounds towards a lamp: their mean over the middles of eighths of the cell.
            let points = (0..8usize).map(|eighth| {
                let at = |axis: usize| place[axis] as f32 + if eighth >> axis & 1 == 1 { 0.75 } else { 0.25 };
                self.low + Vec3::new(at(0), at(1), at(2)) / self.scale
            });
            let points: Vec<Vec3> = points.collect();
            let promised = |light: usize| -> f64 {
                points.iter().map(|p| f64::from(lights.guides[light].importance::<f32>((*p).into()))).sum()
            };
            let part = |light: usize| f64::from(self.arrives[cell * count + light]);
            let weights: Vec<f64> = (0..count).map(|light| promised(light) * part(light)).collect();
            let sum: f64 = weights.iter().sum();
            let sound = sum > 0.0 && sum.is_finite();
            let mut below = 0.0;
            for (weight, power) in weights.iter().zip(&lights.probability) {
                steps.push(below as f32);
                let power = f64::from(*power);
                below += if sound { (1.0 - BY_POWER) * weight / sum + BY_POWER * power } else { power };
            }
            steps.push(1.0);
        }
        steps
    }

    /// The cells of points; those beyond the grid are in the nearest.
    #[inline(always)]
    pub(super) fn cell<R: Real>(&self, p: Triple<R>) -> R {
        let x = place(p.x, self.low.x, self.scale.x);
        let y = place(p.y, self.low.y, self.scale.y);
        let z = place(p.z, self.low.z, self.scale.z);
        (z * CELLS as f32 + y) * CELLS as f32 + x
    }

    /// The parts of up to [`GUIDED`] lights that arrive in cells.
    #[inline(always)]
    pub(super) fn all<R: Real>(&self, cell: R) -> [R; GUIDED] {
        self.few.columns(cell.to_integer())
    }

    /// The part of a light that arrives in cells.
    #[inline(always)]
    pub(super) fn arrives<R: Real>(&self, cell: R::Integer, light: R::Integer) -> R {
        R::gather(&self.arrives, cell * R::Integer::splat(self.lights) + light)
    }

    /// Puts a border of cells at a height, and lets mostly light 0 arrive below it, and mostly light 1 above.
    #[cfg(test)]
    pub(super) fn part_at(&mut self, height: f32) {
        (self.low.y, self.scale.y) = (height - 1e-3 * CELLS as f32 / 2.0, 1e3);
        for (at, part) in self.arrives.iter_mut().enumerate() {
            let (cell, light) = (at / self.lights as usize, at % self.lights as usize);
            let above = cell / CELLS % CELLS >= CELLS / 2;
            *part = if above == (light == 1) { 1.0 } else { 0.05 };
        }
        self.few = self.records();
    }

    #[cfg(test)]
    pub(super) fn arrives_most(&self) -> f32 {
        self.arrives.iter().copied().fold(0.0, f32::max)
    }

    /// Draws one of many lights in cells.
    #[inline(always)]
    pub(super) fn draw<R: Real>(&self, cell: R::Integer, pick: R) -> R::Integer {
        let first = cell * R::Integer::splat(self.lights + 1);
        let mut light = R::Integer::splat(0);
        let mut step = (self.lights as u32).next_power_of_two() as i32 / 2;
        while step > 0 {
            let ahead = (light + R::Integer::splat(step)).min(R::Integer::splat(self.lights));
            // The last is 1, which no number reaches.
            light = R::select_integer(pick.ge(R::gather(&self.before, first + ahead)), ahead, light);
            step /= 2;
        }
        light
    }

    /// The probability of [`Learnt::draw`].
    #[inline(always)]
    pub(super) fn probability<R: Real>(&self, cell: R::Integer, light: R::Integer) -> R {
        let at = cell * R::Integer::splat(self.lights + 1) + light;
        R::gather(&self.before, at + R::Integer::splat(1)) - R::gather(&self.before, at)
    }
}

/// The number of the cell along one axis.
#[inline(always)]
fn place<R: Real>(v: R, low: f32, scale: f32) -> R {
    ((v - low) * scale).clamp(0.0, CELLS as f32 - 0.5).floor()
}

/// Where most surfaces are: without the outermost fiftieth on each side of each axis.
fn extent(met: &[Met]) -> Option<(Vec3, Vec3)> {
    let ends = |axis: usize| {
        let mut values: Vec<f32> = met.iter().map(|met| met.p[axis]).collect();
        values.sort_by(f32::total_cmp);
        let outer = values.len() / 50;
        Some([*values.get(outer)?, *values.get(values.len().checked_sub(1 + outer)?)?])
    };
    let [x, y, z] = [ends(0)?, ends(1)?, ends(2)?];
    Some((Vec3::new(x[0], y[0], z[0]), Vec3::new(x[1], y[1], z[1])))
}

/// The surfaces of one path.
fn path(renderer: &Renderer<'_>, state: u64, pixel: (u32, u32)) -> Vec<Met> {
    let world = renderer.world();
    let sampler = Sampler::new(SamplerKind::Independent, state, pixel, 0);
    let mut ray = renderer.camera_ray(&sampler, pixel);
    let mut met = Vec::new();
    for depth in 0..world.max_depth.min(SEGMENTS) {
        let Some((hit, at)) = first_solid(world, &sampler, depth, ray) else { break };
        let (material, back) = (world.material(&at), -ray.direction);
        let frame = world.shading_frame(&hit, world.place(hit.primitive).1, &at, back);
        let first = Sampler::vertex(depth);
        if material.has_smooth() {
            let facing = if at.geometric.dot(back) < 0.0 { -at.geometric } else { at.geometric };
            let both = material.transmits();
            let from = Vantage { p: at.p.into(), error: at.error.into(), normal: at.geometric.into(), cell: 0.0 };
            met.push(Met { p: at.p, parts: parts(world, &sampler, first, &from, (facing, both)) });
        }
        if met.len() >= SURFACES {
            break;
        }
        let (lobe, two) =
            (sampler.two(first + dimension::LOBE_AND_ROULETTE).x, sampler.two(first + dimension::SCATTER));
        let Some(drawn) = material.at(&at.surface).sample(frame.to_local(back), lobe, two) else { break };
        let out = frame.to_world(drawn.wi).normalize();
        ray = Ray::new(offset_origin(at.p, at.error, at.geometric, out), out);
    }
    met
}

/// The squared parts of lights that arrive at a surface, from both sides if it lets light through.
fn parts(
    world: &World,
    sampler: &Sampler,
    first: u64,
    from: &Vantage<f32>,
    (facing, both): (Vec3, bool),
) -> Vec<(usize, f64)> {
    let lights = world.lights.lights.len();
    // If there are many lights, a path looks for every `stride`th.
    let stride = lights.div_ceil(GUIDED);
    let offset = (sampler.one(first + dimension::LIGHT) * stride as f32) as usize % stride;
    let part = |light: usize| {
        let own = first + ((light as u64 + 1) << 32);
        let numbers = [0, 1, 2, 3].map(|number| sampler.two(own + number).into());
        let one = world.lights.sample_one::<f32>(light, world, from, None, numbers);
        let (direction, weight): (Vec3, Vec3) = (one.direction.into(), one.weight.into());
        let promised = f64::from(world.lights.guides[light].importance::<f32>(from.p));
        let cos = facing.dot(direction);
        let cos = if both { cos.abs() } else { cos.max(0.0) };
        let part = brightness(weight) * f64::from(cos) / promised;
        let ray = Ray { origin: one.origin.into(), direction: one.ray.into(), t_max: one.t_max };
        let arrives = one.valid && part > 0.0 && part.is_finite() && reaches(world, ray) > 0.0;
        (light, if arrives { part.min(MOST_PART).powi(2) } else { 0.0 })
    };
    (offset..lights).step_by(stride).map(part).collect()
}
