//! Light on its way out: where it starts, where it goes, and how much it carries.
//!
//! A light is picked by power. Points of a shape are drawn by area, directions by the cosine. Of the sky, directions
//! are drawn half as [`Environment`] draws them and half from all over the sphere, because its draws leave out what is
//! no brighter than the mean. The rays of one direction begin on a disk that covers the scene.

use super::{Light, Lights, ShapeLight};
use crate::{
    environment::Environment,
    geometry::{Frame, Ray, offset_origin},
    lanes::{Pair, Real, Triple, sin_cos_turn},
    rng::Sampler,
    world::World,
};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Light on its way.
pub(crate) struct Emitted {
    pub(crate) ray: Ray,
    /// Flux over the density of the draw.
    pub(crate) power: Vec3,
    /// Density of the draw over area and solid angle, over the cosine at the light, as [`Lights::emits`] has it; 0 of
    /// lights without extent.
    pub(crate) density: f32,
}

/// Dimensions of the first vertex of a light path.
mod dimension {
    pub(super) const LIGHT: u64 = 0;
    pub(super) const PART: u64 = 1;
    pub(super) const SPARE: u64 = 2;
    pub(super) const POINT: u64 = 3;
    pub(super) const DIRECTION: u64 = 4;
    pub(super) const HALF: u64 = 5;
}

/// Density of directions of the sky, by that of [`Environment::sample`].
#[inline(always)]
fn of_sky(pdf: f32) -> f32 {
    0.5 * pdf + 0.125 / PI
}

/// A direction about a normal, by the cosine.
fn by_cosine(normal: Vec3, u: Vec2) -> Vec3 {
    let (sin, cos) = sin_cos_turn(u.y);
    let radius = u.x.sqrt();
    let local = Vec3::new(radius * cos, radius * sin, (1.0 - u.x).max(0.0).sqrt());
    Frame::new(normal).to_world(local).normalize_or(normal)
}

fn everywhere(u: Vec2) -> Vec3 {
    let (sin, cos) = sin_cos_turn(u.y);
    let z = 1.0 - 2.0 * u.x;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * cos, radius * sin, z)
}

impl Lights {
    /// Density with which [`Lights::emit`] draws a point of a shape's light and a direction from it, over the cosine at
    /// the light: the same for all of them.
    #[inline(always)]
    pub(crate) fn emits(&self, light: u32) -> f32 {
        self.shape(light).map_or(0.0, |shape| self.probability[light as usize] / (shape.area() * PI))
    }

    /// The same of light from infinity, by the density with which sampling finds the direction.
    #[inline(always)]
    fn environment_emits<R: Real>(&self, pdf: R) -> R {
        let Some((_, index)) = &self.environment else { return R::zero() };
        (pdf * 0.5 + 0.125 / PI) * (self.probability[*index as usize] / self.disk())
    }

    /// The same of light from infinity in directions.
    #[inline(always)]
    pub(crate) fn sky_emits<R: Real>(&self, direction: Triple<R>) -> R {
        let Some((environment, _)) = &self.environment else { return R::zero() };
        self.environment_emits(environment.look_lanes(direction).1)
    }

    /// Area of the disk that covers the scene from any side.
    fn disk(&self) -> f32 {
        PI * self.radius * self.radius
    }

    /// Light from a draw; none where nothing is emitted.
    pub(crate) fn emit(&self, world: &World, sampler: &Sampler) -> Option<Emitted> {
        if self.is_empty() {
            return None;
        }
        let number = |which: u64| sampler.two(Sampler::vertex(0) + which);
        let (light, spare) = (number(dimension::LIGHT), number(dimension::SPARE));
        let chosen = self.alias.draw::<f32>(0, self.lights.len(), light.x, spare.y) as usize;
        let share = self.probability[chosen];
        let (point, towards) = (number(dimension::POINT), number(dimension::DIRECTION));
        match &self.lights[chosen] {
            Light::Shape(shape) => {
                let part = number(dimension::PART);
                let mut emitted = shape.emit(world, [light.y, part.x], Pair::new(point.x, point.y), towards)?;
                emitted.power /= share;
                emitted.density = self.emits(chosen as u32);
                Some(emitted)
            }
            Light::Environment => {
                let (environment, _) = self.environment.as_ref()?;
                let part = number(dimension::PART);
                let half = sampler.one(Sampler::vertex(0) + dimension::HALF);
                let numbers = [Vec2::new(light.y, part.y), Vec2::new(part.x, spare.x), towards];
                self.sky_ray(environment, half, numbers, point, share)
            }
            Light::Point { position, intensity } => {
                let ray = Ray::new(*position, everywhere(towards));
                Some(Emitted { ray, power: *intensity * (4.0 * PI / share), density: 0.0 })
            }
            Light::Spot(spot) => {
                let direction = everywhere(towards);
                let intensity: Vec3 = spot.intensity::<f32>(direction.into()).into();
                let ray = Ray::new(spot.position, direction);
                Some(Emitted { ray, power: intensity * (4.0 * PI / share), density: 0.0 })
            }
            Light::Directional { to_light, irradiance } => {
                let ray = self.disk_ray(*to_light, point);
                Some(Emitted { ray, power: *irradiance * (self.disk() / share), density: 0.0 })
            }
        }
    }

    fn sky_ray(
        &self,
        environment: &Environment,
        half: f32,
        numbers: [Vec2; 3],
        point: Vec2,
        share: f32,
    ) -> Option<Emitted> {
        let (to_light, radiance, pdf) = if half < 0.5 {
            environment.sample(numbers)
        } else {
            let direction = everywhere(numbers[2]);
            let (radiance, pdf) = environment.look(direction);
            (direction, radiance, pdf)
        };
        if !(half >= 0.5 || pdf > 0.0) {
            return None;
        }
        let power = radiance * (self.disk() / (of_sky(pdf) * share));
        Some(Emitted { ray: self.disk_ray(to_light, point), power, density: self.environment_emits(pdf) })
    }

    /// A ray from infinity through a point of the disk.
    fn disk_ray(&self, to_light: Vec3, point: Vec2) -> Ray {
        let (sin, cos) = sin_cos_turn(point.y);
        let frame = Frame::new(to_light);
        let aside = (frame.s * cos + frame.t * sin) * (self.radius * point.x.sqrt());
        Ray::new(self.center + aside + to_light * (self.radius * 1.01), -to_light)
    }
}

impl ShapeLight {
    pub(super) fn area(&self) -> f32 {
        self.area as f32
    }

    /// Light from a point drawn by area, into a direction drawn by the cosine.
    fn emit(&self, world: &World, pick: [f32; 2], u: Pair<f32>, towards: Vec2) -> Option<Emitted> {
        let found = self.by_area(world, pick, u);
        let normal: Vec3 = found.normal.into();
        let direction = by_cosine(normal, towards);
        let mut radiance: Vec3 = self.radiance(&found.at, found.normal, direction.into()).into();
        let material = &world.materials[world.shapes[self.shape as usize].material as usize].material;
        if let Some(opacity) = material.opacity_texture() {
            radiance *= opacity.at(&found.at).x.clamp(0.0, 1.0);
        }
        if radiance == Vec3::ZERO {
            return None;
        }
        let origin = offset_origin(found.p.into(), found.error.into(), normal, direction);
        Some(Emitted { ray: Ray::new(origin, direction), power: radiance * (self.area() * PI), density: 0.0 })
    }
}
