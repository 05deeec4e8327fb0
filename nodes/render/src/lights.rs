//! The lights of a scene, and which of them to sample.
//!
//! A light is picked in proportion to what it would bring to the point if nothing stood in between and the surface
//! faced anywhere. With [`Choices::Adapted`](crate::choices::Choices), this is multiplied by the part that arrives: see
//! [`learnt`]. A tenth of the probability is spread evenly, so that none is ever left out. A scene of many lights picks
//! by power, with half of the probability spread evenly; adapted choices use a table for each cell of a grid.
//!
//! Shapes are sampled evenly over their area, spheres over the cone that they fill. Lights that emit nothing are
//! dropped.

mod aims;
mod arrival;
mod choice;
mod delta;
mod emission;
mod guide;
mod learnt;
mod shape;

use crate::{
    accel,
    alias::Alias,
    environment::Environment,
    lanes::{Integer, Mask, Pair, Real, Triple},
    texture::{LoadBitmap, Texture},
    world::World,
};
pub(crate) use aims::Aims;
pub(crate) use arrival::{Arrivals, Arrived, Vantage};
pub(crate) use choice::Choice;
use delta::Spot;
pub(crate) use emission::Emitted;
use glam::{DVec3, Vec3};
use guide::{Guide, shape_guide};
pub(crate) use learnt::Learnt;
pub(crate) use shape::ShapeLight;
use std::{collections::BTreeMap, sync::Arc};
use tauflow_contract::KindError;
use tauflow_data::{image::luminance, scene};

/// Scenes of more lights pick by power alone, or by what is learnt of cells.
const GUIDED: usize = 8;

/// A light.
#[derive(Debug)]
pub(crate) enum Light {
    Shape(ShapeLight),
    Environment,
    Point { position: Vec3, intensity: Vec3 },
    Spot(Spot),
    Directional { to_light: Vec3, irradiance: Vec3 },
}

/// The emission of a shape whose primitives are `first .. first + count`.
pub(crate) struct Emission {
    pub(crate) shape: u32,
    pub(crate) texture: Texture,
    pub(crate) first: usize,
    pub(crate) count: usize,
    /// Outer normal, if it is flat.
    pub(crate) normal: Option<Vec3>,
    /// Whether its outer side is turned in.
    pub(crate) flip: bool,
    /// Of a shared mesh that is scaled evenly: what all such shapes of one mesh have in common.
    pub(crate) even: Option<u32>,
}

/// The forms of emitting shapes, in the world, by shape and number.
pub(crate) type ShapeForms<'a> = &'a dyn Fn(u32, u32) -> accel::Primitive;

/// The lights of a scene.
pub struct Lights {
    lights: Vec<Light>,
    environment: Option<(Environment, u32)>,
    guides: Vec<Guide>,
    probability: Vec<f32>,
    alias: Alias,
    /// A sphere around the scene.
    center: Vec3,
    radius: f32,
    learnt: Option<Learnt>,
}

/// The scene's light from infinity, if it has one.
///
/// # Errors
/// If there are two, or an image is missing.
pub(crate) fn compile_environment(
    emitters: &[scene::Emitter],
    load: LoadBitmap<'_>,
) -> Result<Option<Environment>, KindError> {
    let mut found = None;
    for emitter in emitters {
        if !matches!(emitter, scene::Emitter::Constant { .. } | scene::Emitter::Envmap { .. }) {
            continue;
        }
        if found.is_some() {
            return Err(KindError::Input(
                "the scene has two environments; keep only one `constant` or `envmap`".into(),
            ));
        }
        found = Some(Environment::compile(emitter, load)?);
    }
    Ok(found)
}

fn brightness(value: Vec3) -> f64 {
    f64::from(luminance(&value.to_array())).max(f64::from(value.max_element()) * 0.1)
}

fn finite(what: &str, values: &[f64], rgb: scene::Rgb) -> Result<Vec3, KindError> {
    let fine = values.iter().all(|v| v.is_finite()) && rgb.iter().all(|v| v.is_finite() && *v >= 0.0);
    if fine {
        Ok(Vec3::from_array(rgb))
    } else {
        Err(KindError::Input(format!("a {what} light of {rgb:?} at {values:?}; use finite numbers, none below 0")))
    }
}

impl Lights {
    /// Collects lights and their probabilities.
    ///
    /// # Errors
    /// If an emitter has numbers that are not finite, or negative.
    pub(crate) fn new(
        emissions: Vec<Emission>,
        environment: Option<Environment>,
        emitters: &[scene::Emitter],
        forms: ShapeForms<'_>,
        bounds: (Vec3, Vec3),
    ) -> Result<Self, KindError> {
        let radius = f64::from((bounds.1 - bounds.0).length() * 0.5).max(1e-6);
        let disk = std::f64::consts::PI * radius * radius;
        let mut found: Vec<(Light, f64, Guide)> = Vec::new();
        // Shares of area are the same for all even copies of a mesh.
        let mut tables: BTreeMap<u32, Arc<Alias>> = BTreeMap::new();
        for emission in emissions {
            let (normal, shape, count) = (emission.normal, emission.shape, emission.count as u32);
            if let Some(light) = ShapeLight::new(emission, forms, &mut tables) {
                let (power, intensity) = light.power();
                let guide = shape_guide((0..count).map(|at| forms(shape, at)), normal, intensity as f32);
                found.push((Light::Shape(light), power, guide));
            }
        }
        for emitter in emitters {
            found.extend(Self::delta(emitter, disk)?);
        }
        let environment = environment.map(|environment| {
            // Seen by a surface that faces anywhere: a quarter of the light from all sides.
            let total = environment.total();
            let guide = Guide { strength: (0.25 * total) as f32, far: true, ..Guide::point(Vec3::ZERO, 0.0) };
            found.push((Light::Environment, disk * total, guide));
            (environment, found.len() as u32 - 1)
        });
        let count = found.len().max(1) as f64;
        let total: f64 = found.iter().map(|f| f.1).sum();
        let by_power = |power: f64| if total > 0.0 && total.is_finite() { power / total } else { 1.0 / count };
        let weights: Vec<f64> = found.iter().map(|f| 0.5 / count + 0.5 * by_power(f.1)).collect();
        let mut alias = Alias::default();
        alias.extend(&weights);
        let guides = found.iter().map(|f| f.2).collect();
        let lights = found.into_iter().map(|f| f.0).collect();
        let probability = weights.iter().map(|w| *w as f32).collect();
        let center = (bounds.0 + bounds.1) * 0.5;
        Ok(Self { lights, environment, guides, probability, alias, center, radius: radius as f32, learnt: None })
    }

    fn delta(emitter: &scene::Emitter, disk: f64) -> Result<Option<(Light, f64, Guide)>, KindError> {
        use std::f64::consts::PI;
        let found = match emitter {
            scene::Emitter::Constant { .. } | scene::Emitter::Envmap { .. } => return Ok(None),
            scene::Emitter::Point { position, intensity } => {
                let intensity = finite("point", position, *intensity)?;
                let position = DVec3::from_array(*position).as_vec3();
                let guide = Guide::point(position, 0.25 * brightness(intensity) as f32);
                (Light::Point { position, intensity }, 4.0 * PI * brightness(intensity), guide)
            }
            scene::Emitter::Spot { to_world, intensity, cutoff_angle, beam_width } => {
                let intensity = finite("spot", &[*cutoff_angle, *beam_width], *intensity)?;
                let spot = Spot::new(to_world, intensity, *cutoff_angle, *beam_width)?;
                let power = spot.solid_angle() * brightness(intensity);
                let guide = Guide::point(spot.position, 0.25 * brightness(spot.brightest()) as f32);
                (Light::Spot(spot), power, guide)
            }
            scene::Emitter::Directional { direction, irradiance } => {
                let irradiance = finite("directional", direction, *irradiance)?;
                let to_light = -DVec3::from_array(*direction).normalize_or_zero().as_vec3();
                if to_light == Vec3::ZERO {
                    return Err(KindError::Input("a directional light without a direction; give one".into()));
                }
                let strength = 0.25 * brightness(irradiance) as f32;
                let guide = Guide { strength, far: true, ..Guide::point(Vec3::ZERO, 0.0) };
                (Light::Directional { to_light, irradiance }, disk * brightness(irradiance), guide)
            }
        };
        Ok((found.1 > 0.0).then_some(found))
    }

    /// Takes over how lights are chosen.
    pub(crate) fn adapt(&mut self, learnt: Option<Learnt>) {
        self.learnt = learnt;
    }

    #[cfg(test)]
    pub(crate) fn is_adapted(&self) -> bool {
        self.learnt.is_some()
    }

    /// True if there is nothing to sample.
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// True if there are lights that only sampling finds.
    pub(crate) fn has_delta(&self) -> bool {
        self.lights.iter().any(|l| !matches!(l, Light::Shape(_) | Light::Environment))
    }

    /// True if there is light from infinity and other light, between which the choice by guides is poor.
    pub(crate) fn mixed(&self) -> bool {
        self.environment.is_some() && self.lights.len() > 1
    }

    /// The lights that are shapes, by index.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = (u32, &ShapeLight)> {
        self.lights.iter().enumerate().filter_map(|(index, light)| match light {
            Light::Shape(light) => Some((index as u32, light)),
            _ => None,
        })
    }

    /// The light from infinity.
    pub fn environment(&self) -> Option<&Environment> {
        self.environment.as_ref().map(|(environment, _)| environment)
    }

    /// Where points are in the grid of what is learnt: worked out once for each point, for others that differ by
    /// rounding may be in other cells.
    #[inline(always)]
    pub(crate) fn cell<R: Real>(&self, p: Triple<R>) -> R {
        match &self.learnt {
            Some(learnt) => learnt.cell(p),
            None => R::zero(),
        }
    }

    /// The part of each of a few lights that arrives in cells.
    #[inline(always)]
    fn parts<R: Real>(&self, cell: R) -> [R; GUIDED] {
        match &self.learnt {
            Some(learnt) => learnt.all(cell),
            None => [R::one(); GUIDED],
        }
    }

    /// The estimated contribution of each light to points, and the sum; for the few lights of most scenes.
    #[inline(always)]
    fn importances<R: Real>(&self, p: Triple<R>, parts: &[R; GUIDED]) -> ([R; GUIDED], R) {
        let (mut all, mut sum) = ([R::zero(); GUIDED], R::zero());
        for ((value, guide), part) in all.iter_mut().zip(&self.guides).zip(parts) {
            *value = guide.importance(p) * *part;
        }
        for value in all.iter().take(self.lights.len()) {
            sum += *value;
        }
        (all, sum)
    }

    #[inline(always)]
    fn share<R: Real>(&self, importance: R, sum: R) -> R {
        let even = 1.0 / self.lights.len() as f32;
        R::select(sum.positive() & sum.finite(), importance / sum * 0.9 + 0.1 * even, R::splat(even))
    }

    /// Probability with which points in cells pick a light.
    #[inline(always)]
    fn picked<R: Real>(&self, light: usize, p: Triple<R>, cell: R) -> R {
        match self.lights.len() {
            1 => R::one(),
            2..=GUIDED => {
                let (all, sum) = self.importances(p, &self.parts(cell));
                self.share(all[light], sum)
            }
            _ => match &self.learnt {
                Some(learnt) => learnt.probability(cell.to_integer(), R::Integer::splat(light as i32)),
                None => R::splat(self.probability[light]),
            },
        }
    }

    /// Radiance from infinity in directions, and the density with which sampling from `from` in `cell` finds them.
    #[inline(always)]
    pub(crate) fn environment_look<R: Real>(
        &self,
        (from, cell): (Triple<R>, R),
        direction: Triple<R>,
    ) -> (Triple<R>, R) {
        let Some((environment, index)) = &self.environment else { return (Triple::zero(), R::zero()) };
        let (radiance, pdf) = environment.look_lanes(direction);
        (radiance, pdf * self.picked(*index as usize, from, cell))
    }

    /// A shape's light.
    #[inline(always)]
    pub(crate) fn shape(&self, light: u32) -> Option<&ShapeLight> {
        match &self.lights[light as usize] {
            Light::Shape(light) => Some(light),
            _ => None,
        }
    }

    /// Density with which sampling from `from` in `cell` finds points `p` of a shape's light.
    #[inline(always)]
    pub(crate) fn shape_pdf<R: Real>(
        &self,
        light: u32,
        (from, cell): (Triple<R>, R),
        p: Triple<R>,
        normal: Triple<R>,
    ) -> R {
        let Some(shape) = self.shape(light) else { return R::zero() };
        shape.pdf(from, p, normal) * self.picked(light as usize, from, cell)
    }

    /// Samples a light from points, in the lanes of a mask. The first number selects the light.
    #[inline(always)]
    pub(crate) fn sample<R: Real>(
        &self,
        world: &World,
        from: &Vantage<R>,
        aims: Option<&Aims>,
        mask: R::Mask,
        numbers: [Pair<R>; 4],
    ) -> Arrived<R> {
        let count = self.lights.len();
        let pick = numbers[0].x;
        let mut arrived = Arrived::none();
        let (mut chosen, mut probability) = (R::Integer::splat(0), R::one());
        if let (Some(learnt), true) = (&self.learnt, count > GUIDED) {
            let cell = from.cell.to_integer();
            chosen = learnt.draw(cell, pick);
            probability = learnt.probability(cell, chosen);
            arrived.expected = learnt.arrives(cell, chosen);
        } else if count > GUIDED {
            chosen = self.alias.draw::<R>(chosen, count, pick, numbers[2].y);
            probability = R::gather(&self.probability, chosen);
        } else if count > 1 {
            let parts = self.parts(from.cell);
            let (all, sum) = self.importances(from.p, &parts);
            let mut below = R::zero();
            for (light, importance) in all.iter().enumerate().take(count) {
                let share = self.share(*importance, sum);
                // The last takes what rounding leaves over.
                let own = pick.ge(below);
                chosen = R::select_integer(own, R::Integer::splat(light as i32), chosen);
                probability = R::select(own, share, probability);
                arrived.expected = R::select(own, parts[light], arrived.expected);
                below += share;
            }
        }
        let mut indices = [0; 16];
        chosen.store(&mut indices);
        let mut rest = mask;
        while rest.any() {
            let light = indices[rest.bits().trailing_zeros() as usize & 15];
            let own = rest & R::same(chosen, R::Integer::splat(light as i32));
            rest = rest & !own;
            arrived.take(own, probability, self.sample_one(light as usize, world, from, aims, numbers));
        }
        arrived
    }

    #[inline(always)]
    fn sample_one<R: Real>(
        &self,
        light: usize,
        world: &World,
        from: &Vantage<R>,
        aims: Option<&Aims>,
        [a, b, c, point]: [Pair<R>; 4],
    ) -> Arrivals<R> {
        match &self.lights[light] {
            Light::Shape(shape) => {
                let (mut arrivals, found) = shape.sample(world, from, [a.y, b.x], point);
                if let Some(aims) = aims {
                    arrivals.emits = aims.of_shape(self, light as u32, found.p, found.normal, -arrivals.direction);
                }
                arrivals
            }
            Light::Environment => {
                let numbers = [Pair::new(a.y, b.y), Pair::new(b.x, c.x), point];
                let Some((environment, _)) = &self.environment else {
                    let none = Triple::zero();
                    return from.endless(none, none, R::zero(), R::Mask::from_bits(0));
                };
                let (direction, radiance, pdf) = environment.sample_lanes(numbers);
                let weight = radiance * (R::one() / pdf);
                let mut arrivals = from.endless(direction, weight, pdf, pdf.positive() & radiance.some());
                if let Some(aims) = aims {
                    arrivals.emits = aims.of_sky(self, emission::direction_density(pdf), from.p, direction);
                }
                arrivals
            }
            Light::Point { position, intensity } => from.lone(*position, Triple::splat(*intensity)),
            Light::Spot(spot) => {
                let direction = (from.p - Triple::splat(spot.position)).normalize();
                from.lone(spot.position, spot.intensity(direction))
            }
            Light::Directional { to_light, irradiance } => {
                from.endless(Triple::splat(*to_light), Triple::splat(*irradiance), R::zero(), !R::Mask::from_bits(0))
            }
        }
    }
}

#[cfg(test)]
mod tests;
