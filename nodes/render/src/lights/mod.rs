//! The lights of a scene, and which of them to sample.
//!
//! A light is picked with half the probability by power, half evenly: a strong sun outside must not starve the lamp in
//! the room. Shapes are sampled evenly over their area, spheres over the cone that they fill. Lights that emit nothing
//! are dropped.

mod delta;
mod shape;

use crate::{
    accel,
    environment::Environment,
    texture::{LoadBitmap, Texture},
};
use delta::Spot;
use glam::{DVec3, Vec2, Vec3};
pub(crate) use shape::ShapeLight;
use tauflow_contract::KindError;
use tauflow_data::{image::luminance, scene};

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
}

/// Where a shadow ray ends.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Target {
    /// At infinity.
    Infinity,
    /// At a point that is no surface.
    Point(Vec3),
    /// At a surface.
    Surface { p: Vec3, error: Vec3, normal: Vec3 },
}

/// Light that may arrive at a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    /// Unit direction towards it.
    pub(crate) direction: Vec3,
    /// Where the shadow ray ends.
    pub(crate) target: Target,
    /// Radiance over the density of the sample, the choice of light included.
    pub(crate) weight: Vec3,
    /// Density over solid angle, the choice of light included; 0 for lights that nothing else can find.
    pub(crate) pdf: f32,
}

/// The lights of a scene.
pub struct Lights {
    lights: Vec<Light>,
    environment: Option<(Environment, u32)>,
    probability: Vec<f32>,
    cumulative: Vec<f32>,
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
            return Err(KindError::Input("the scene has two environments; keep one `constant` or `envmap`".into()));
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
        forms: &[accel::Primitive],
        bounds: (Vec3, Vec3),
    ) -> Result<Self, KindError> {
        let radius = f64::from((bounds.1 - bounds.0).length() * 0.5).max(1e-6);
        let mut found: Vec<(Light, f64)> = Vec::new();
        for emission in emissions {
            if let Some(light) = ShapeLight::new(emission, forms) {
                let power = light.power();
                found.push((Light::Shape(light), power));
            }
        }
        for emitter in emitters {
            found.extend(Self::delta(emitter, radius)?);
        }
        let environment = environment.map(|environment| {
            let power = f64::from(environment.power(radius as f32));
            found.push((Light::Environment, power));
            (environment, found.len() as u32 - 1)
        });
        let count = found.len().max(1) as f64;
        let total: f64 = found.iter().map(|f| f.1).sum();
        let by_power = |power: f64| if total > 0.0 && total.is_finite() { power / total } else { 1.0 / count };
        let probability: Vec<f32> = found.iter().map(|f| (0.5 / count + 0.5 * by_power(f.1)) as f32).collect();
        let mut sum = 0.0;
        let cumulative = probability
            .iter()
            .map(|p| {
                sum += f64::from(*p);
                sum as f32
            })
            .collect();
        let lights = found.into_iter().map(|f| f.0).collect();
        Ok(Self { lights, environment, probability, cumulative })
    }

    fn delta(emitter: &scene::Emitter, radius: f64) -> Result<Option<(Light, f64)>, KindError> {
        use std::f64::consts::PI;
        let found = match emitter {
            scene::Emitter::Constant { .. } | scene::Emitter::Envmap { .. } => return Ok(None),
            scene::Emitter::Point { position, intensity } => {
                let intensity = finite("point", position, *intensity)?;
                let position = DVec3::from_array(*position).as_vec3();
                (Light::Point { position, intensity }, 4.0 * PI * brightness(intensity))
            }
            scene::Emitter::Spot { to_world, intensity, cutoff_angle, beam_width } => {
                let intensity = finite("spot", &[*cutoff_angle, *beam_width], *intensity)?;
                let spot = Spot::new(to_world, intensity, *cutoff_angle, *beam_width)?;
                let power = spot.solid_angle() * brightness(intensity);
                (Light::Spot(spot), power)
            }
            scene::Emitter::Directional { direction, irradiance } => {
                let irradiance = finite("directional", direction, *irradiance)?;
                let to_light = -DVec3::from_array(*direction).normalize_or_zero().as_vec3();
                if to_light == Vec3::ZERO {
                    return Err(KindError::Input("a directional light without a direction; give one".into()));
                }
                (Light::Directional { to_light, irradiance }, PI * radius * radius * brightness(irradiance))
            }
        };
        Ok((found.1 > 0.0).then_some(found))
    }

    /// True if there is nothing to sample.
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// True if there are lights that only sampling finds.
    pub(crate) fn has_delta(&self) -> bool {
        self.lights.iter().any(|l| !matches!(l, Light::Shape(_) | Light::Environment))
    }

    /// Index of each shape's light, and the shape.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = (u32, u32)> {
        self.lights.iter().enumerate().filter_map(|(index, light)| match light {
            Light::Shape(light) => Some((index as u32, light.shape)),
            _ => None,
        })
    }

    /// The light from infinity.
    pub fn environment(&self) -> Option<&Environment> {
        self.environment.as_ref().map(|(environment, _)| environment)
    }

    /// Density with which sampling finds a direction towards infinity.
    #[inline]
    pub(crate) fn environment_pdf(&self, direction: Vec3) -> f32 {
        self.environment.as_ref().map_or(0.0, |(e, at)| self.probability[*at as usize] * e.pdf(direction))
    }

    /// A shape's light.
    #[inline]
    pub(crate) fn shape(&self, light: u32) -> Option<&ShapeLight> {
        match &self.lights[light as usize] {
            Light::Shape(light) => Some(light),
            _ => None,
        }
    }

    /// Density with which sampling from `from` finds the point `p` of a shape's light.
    #[inline]
    pub(crate) fn shape_pdf(&self, light: u32, from: Vec3, p: Vec3, normal: Vec3) -> f32 {
        self.shape(light).map_or(0.0, |l| self.probability[light as usize] * l.pdf(from, p, normal))
    }

    /// Samples a light from the point `from`: `pick` chooses light and primitive, `u` the point on it.
    #[inline]
    pub(crate) fn sample(&self, world: &crate::world::World, from: Vec3, pick: Vec2, u: Vec2) -> Option<Arrival> {
        let at = self.cumulative.partition_point(|c| *c <= pick.x).min(self.lights.len() - 1);
        let probability = self.probability[at];
        let lone = |direction, target, weight| Some(Arrival { direction, target, weight, pdf: 0.0 });
        match &self.lights[at] {
            Light::Shape(light) => {
                let arrival = light.sample(world, from, pick.y, u)?;
                Some(Arrival { weight: arrival.weight / probability, pdf: arrival.pdf * probability, ..arrival })
            }
            Light::Environment => {
                let (environment, _) = self.environment.as_ref()?;
                let (direction, radiance, pdf) = environment.sample(u);
                let pdf = pdf * probability;
                let found = pdf > 0.0 && radiance != Vec3::ZERO;
                found.then(|| Arrival { direction, target: Target::Infinity, weight: radiance / pdf, pdf })
            }
            Light::Point { position, intensity } => {
                let (direction, square) = delta::towards(from, *position)?;
                lone(direction, Target::Point(*position), *intensity / (square * probability))
            }
            Light::Spot(spot) => {
                let (direction, square) = delta::towards(from, spot.position)?;
                let intensity = spot.intensity(-direction);
                let found = intensity != Vec3::ZERO;
                found.then(|| lone(direction, Target::Point(spot.position), intensity / (square * probability)))?
            }
            Light::Directional { to_light, irradiance } => lone(*to_light, Target::Infinity, *irradiance / probability),
        }
    }
}
