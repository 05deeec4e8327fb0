//! Light on its way out: where it starts, where it goes, and how much it carries.
//!
//! Points of a shape are drawn by area. Directions are drawn by the cosine, or towards a ball of [`Aims`]. Half of the
//! directions to the sky are drawn as [`Environment`] does. The other half are drawn from the whole sphere, because the
//! environment's draws leave out what is no brighter than the mean. The rays of one direction begin on a disk that
//! covers the scene or the ball.

use super::{
    Light, Lights, ShapeLight,
    aims::{Aims, Ball, Pairing},
    shape::OnShape,
};
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
#[derive(Debug)]
pub(crate) struct Emitted {
    pub(crate) ray: Ray,
    /// Flux over the density of the draw.
    pub(crate) power: Vec3,
    /// Density of the draw over area and solid angle, over the cosine at the light; 0 of lights without extent.
    pub(crate) density: f32,
    source: Source,
}

/// Where light comes from.
#[derive(Clone, Copy, Debug)]
enum Source {
    /// A point of a shape's light, and the outer normal there.
    Shape { light: u32, p: Vec3, normal: Vec3 },
    /// Infinity, in this direction.
    Sky { to_light: Vec3 },
    /// A light without extent.
    Point,
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
pub(super) fn direction_density<R: Real>(pdf: R) -> R {
    pdf * 0.5 + 0.125 / PI
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
    /// Density with which [`Lights::emit`] draws light from infinity along rays, over area and solid angle.
    #[inline(always)]
    pub(crate) fn sky_emits<R: Real>(&self, aims: &Aims, origin: Triple<R>, to_light: Triple<R>) -> R {
        let Some((environment, _)) = &self.environment else { return R::zero() };
        let pdf = environment.look_lanes(to_light).1;
        aims.of_sky(self, direction_density(pdf), origin, to_light)
    }

    /// Area of the disk that covers the scene from any side.
    pub(super) fn disk(&self) -> f32 {
        PI * self.radius * self.radius
    }

    /// Which pair of a light and a place draws.
    pub(crate) fn pairing(&self, aims: &Aims, sampler: &Sampler) -> Option<Pairing> {
        let number = |which: u64| sampler.two(Sampler::vertex(0) + which);
        (!self.is_empty()).then(|| aims.draw(number(dimension::LIGHT).x, number(dimension::SPARE).y))
    }

    /// Light of a pair from a draw; none where nothing is emitted.
    pub(crate) fn emit(&self, world: &World, aims: &Aims, pair: &Pairing, sampler: &Sampler) -> Option<Emitted> {
        let number = |which: u64| sampler.two(Sampler::vertex(0) + which);
        let (light, spare) = (number(dimension::LIGHT), number(dimension::SPARE));
        let chosen = pair.light;
        let share = self.probability[chosen];
        let (point, towards) = (number(dimension::POINT), number(dimension::DIRECTION));
        match &self.lights[chosen] {
            Light::Shape(shape) => {
                let part = number(dimension::PART);
                let found = shape.by_area(world, [light.y, part.x], Pair::new(point.x, point.y));
                let normal: Vec3 = found.normal.into();
                let aim = pair.ball.filter(|ball| !ball.cone(found.p).inside);
                let direction = match aim {
                    Some(ball) => ball.towards(found.p.into(), towards),
                    None => by_cosine(normal, towards),
                };
                if aim.is_some_and(|ball| !ball.seen_along(found.p, direction.into())) {
                    return None; // rounding has put it beside its aim
                }
                let density = aims.of_shape(self, chosen as u32, found.p, found.normal, direction.into());
                let radiance = shape.shines(world, &found, direction);
                if radiance == Vec3::ZERO || density.is_nan() || density <= 0.0 {
                    return None;
                }
                let origin = offset_origin(found.p.into(), found.error.into(), normal, direction);
                let source = Source::Shape { light: chosen as u32, p: found.p.into(), normal };
                Some(Emitted { ray: Ray::new(origin, direction), power: radiance / density, density, source })
            }
            Light::Environment => {
                let (environment, _) = self.environment.as_ref()?;
                let part = number(dimension::PART);
                let half = sampler.one(Sampler::vertex(0) + dimension::HALF);
                let numbers = [Vec2::new(light.y, part.y), Vec2::new(part.x, spare.x), towards];
                let (to_light, radiance) = sky_direction(environment, half, numbers)?;
                let ray = match pair.ball {
                    Some(ball) => self.disk_ray(&ball, to_light, point),
                    None => self.disk_ray(&self.whole(), to_light, point),
                };
                if pair.ball.is_some_and(|ball| !ball.seen_along(ray.origin.into(), to_light.into())) {
                    return None; // rounding has put it beside its aim
                }
                let density = self.sky_emits(aims, ray.origin.into(), to_light.into());
                let source = Source::Sky { to_light };
                (density > 0.0 && radiance != Vec3::ZERO).then(|| Emitted {
                    ray,
                    power: radiance / density,
                    density,
                    source,
                })
            }
            Light::Point { position, intensity } => {
                let ray = Ray::new(*position, everywhere(towards));
                Some(Emitted { ray, power: *intensity * (4.0 * PI / share), density: 0.0, source: Source::Point })
            }
            Light::Spot(spot) => {
                let direction = everywhere(towards);
                let intensity: Vec3 = spot.intensity::<f32>(direction.into()).into();
                let ray = Ray::new(spot.position, direction);
                Some(Emitted { ray, power: intensity * (4.0 * PI / share), density: 0.0, source: Source::Point })
            }
            Light::Directional { to_light, irradiance } => {
                let ray = self.disk_ray(&self.whole(), *to_light, point);
                let power = *irradiance * (self.disk() / share);
                Some(Emitted { ray, power, density: 0.0, source: Source::Point })
            }
        }
    }

    /// Density over solid angle with which sampling lights from a point finds where light came from.
    pub(crate) fn finds(&self, emitted: &Emitted, from: Vec3) -> f32 {
        let from = (from.into(), self.cell::<f32>(from.into()));
        match emitted.source {
            Source::Shape { light, p, normal } => self.shape_pdf::<f32>(light, from, p.into(), normal.into()),
            Source::Sky { to_light } => self.environment_look::<f32>(from, to_light.into()).1,
            Source::Point => 0.0,
        }
    }

    /// The ball around the scene.
    fn whole(&self) -> Ball {
        Ball { center: self.center, radius: self.radius }
    }

    /// A ray from infinity through a point of the disk of a ball.
    fn disk_ray(&self, ball: &Ball, to_light: Vec3, point: Vec2) -> Ray {
        let (sin, cos) = sin_cos_turn(point.y);
        let frame = Frame::new(to_light);
        let aside = (frame.s * cos + frame.t * sin) * (ball.radius * point.x.sqrt());
        let height = (self.center - ball.center).dot(to_light) + self.radius * 1.01;
        Ray::new(ball.center + aside + to_light * height, -to_light)
    }
}

/// A direction towards light from infinity, and its radiance.
fn sky_direction(environment: &Environment, half: f32, numbers: [Vec2; 3]) -> Option<(Vec3, Vec3)> {
    if half < 0.5 {
        let (to_light, radiance, pdf) = environment.sample(numbers);
        return (pdf > 0.0).then_some((to_light, radiance));
    }
    let direction = everywhere(numbers[2]);
    Some((direction, environment.look(direction).0))
}

impl Ball {
    /// A direction from a point outside, even over the cone that the ball fills.
    fn towards(&self, p: Vec3, u: Vec2) -> Vec3 {
        let drop = u.x * self.cone::<f32>(p.into()).width;
        let (sin, cos) = sin_cos_turn(u.y);
        let radius = (drop * (2.0 - drop)).max(0.0).sqrt();
        let axis = (self.center - p).normalize_or(Vec3::Z);
        Frame::new(axis).to_world(Vec3::new(radius * cos, radius * sin, 1.0 - drop)).normalize_or(axis)
    }
}

impl ShapeLight {
    pub(super) fn area(&self) -> f32 {
        self.area as f32
    }

    /// Radiance of a point towards a direction, where it is opaque.
    fn shines(&self, world: &World, found: &OnShape<f32>, direction: Vec3) -> Vec3 {
        let radiance: Vec3 = self.radiance(&found.at, found.normal, direction.into()).into();
        let material = &world.materials[world.shapes[self.shape as usize].material as usize].material;
        let opacity = material.opacity_texture().map_or(1.0, |opacity| opacity.at(&found.at).x.clamp(0.0, 1.0));
        radiance * opacity
    }
}
