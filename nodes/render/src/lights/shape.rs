//! Shapes that emit on their outer side.
//!
//! Sphere sampling after Pharr, Jakob, Humphreys, *Physically Based Rendering*, 4th edition, section 6.2.4.

use super::{Arrival, Emission, Target, brightness};
use crate::{
    accel,
    bsdf::Surface,
    geometry::{Disk, Frame, Sphere, area_normal, gamma},
    surface::Form,
    texture::Texture,
    world::World,
};
use glam::{Vec2, Vec3, Vec4};
use std::f32::consts::PI;
use tauflow_data::maths;

/// A shape's light.
#[derive(Debug)]
pub(crate) struct ShapeLight {
    pub(crate) shape: u32,
    pub(crate) texture: Texture,
    /// First of its primitives.
    first: usize,
    /// Share of the area in the primitives up to and with each.
    cumulative: Vec<f32>,
    area: f64,
    /// The sphere, if it is one.
    sphere: Option<Sphere>,
}

/// A point on the shape, found by area.
struct Found {
    p: Vec3,
    error: Vec3,
    normal: Vec3,
    surface: Surface,
}

impl ShapeLight {
    /// `None` if it has no area, or its emission is 0.
    pub(super) fn new(emission: Emission, forms: &[accel::Primitive]) -> Option<Self> {
        let Emission { shape, texture, first, count } = emission;
        let own = &forms[first..first + count];
        let areas = own.iter().map(|form| match form {
            accel::Primitive::Triangle([a, b, c]) => area_normal(*a, *b, *c).map_or(0.0, |f| f.0),
            accel::Primitive::Sphere(s) => 4.0 * std::f64::consts::PI * f64::from(s.radius).powi(2),
            accel::Primitive::Disk(d) => d.area,
        });
        let mut area = 0.0;
        let sums: Vec<f64> = areas
            .map(|a| {
                area += a;
                area
            })
            .collect();
        let sphere = own.iter().find_map(|form| match form {
            accel::Primitive::Sphere(s) => Some(*s),
            _ => None,
        });
        let black = matches!(&texture, Texture::Constant(value) if *value == Vec3::ZERO);
        let cumulative = sums.iter().map(|s| (s / area) as f32).collect();
        (area > 0.0 && !black).then_some(Self { shape, texture, first, cumulative, area, sphere })
    }

    /// Power by the mean of its texture over the unit square of uv.
    pub(super) fn power(&self) -> f64 {
        const SIDE: u32 = 16;
        let mut sum = 0.0;
        for i in 0..SIDE * SIDE {
            let uv = Vec2::new((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5) / SIDE as f32;
            sum += brightness(self.texture.eval(&Surface { uv, color: Vec4::ONE }));
        }
        std::f64::consts::PI * self.area * sum / f64::from(SIDE * SIDE)
    }

    /// Radiance that leaves a point of the shape towards a direction, given its outer normal.
    #[inline]
    pub(crate) fn radiance(&self, surface: &Surface, normal: Vec3, direction: Vec3) -> Vec3 {
        if normal.dot(direction) > 0.0 { self.texture.eval(surface) } else { Vec3::ZERO }
    }

    /// Distance to a sphere's centre, and 1 - cos of the half angle that it fills; `None` if `from` is inside or on it.
    #[inline]
    fn cone(sphere: &Sphere, from: Vec3) -> Option<(f32, f32)> {
        let square = (sphere.center - from).length_squared();
        let share = sphere.radius * sphere.radius / square;
        (share < 0.9999).then(|| (square.sqrt(), share / (1.0 + (1.0 - share).sqrt())))
    }

    /// Density over solid angle, seen from `from`, with which the point `p` of outer normal `normal` is sampled.
    #[inline]
    pub(crate) fn pdf(&self, from: Vec3, p: Vec3, normal: Vec3) -> f32 {
        if let Some((_, width)) = self.sphere.as_ref().and_then(|sphere| Self::cone(sphere, from)) {
            return 1.0 / (2.0 * PI * width);
        }
        let d = p - from;
        let square = d.length_squared();
        // square / (cos area), with cos = |n . d| / sqrt(square).
        let facing = normal.dot(d).abs();
        if facing > 0.0 { square * square.sqrt() / (facing * self.area as f32) } else { 0.0 }
    }

    /// Samples the shape from a point.
    #[inline]
    pub(super) fn sample(&self, world: &World, from: Vec3, pick: f32, u: Vec2) -> Option<Arrival> {
        let shape = &world.shapes[self.shape as usize];
        let found = match (&shape.form, &self.sphere) {
            (Form::Sphere(sphere), _) => Self::on_sphere(sphere, from, u),
            (Form::Disk(disk), _) => Self::on_disk(disk, u),
            (Form::Mesh(mesh), _) => {
                let at = self.cumulative.partition_point(|c| *c <= pick).min(self.cumulative.len() - 1) + self.first;
                let primitive = &world.primitives[at];
                let [p0, p1, p2] = world.triangle(at as u32);
                let root = u.x.sqrt();
                let weights = [1.0 - root, root * (1.0 - u.y), root * u.y];
                let (a, b, c) = (p0 * weights[0], p1 * weights[1], p2 * weights[2]);
                Found {
                    p: a + b + c,
                    error: (a.abs() + b.abs() + c.abs()) * gamma(6),
                    normal: primitive.normal,
                    surface: mesh.surface(primitive, weights),
                }
            }
        };
        let normal = if shape.flip { -found.normal } else { found.normal };
        let d = found.p - from;
        let length = d.length();
        if length == 0.0 {
            return None;
        }
        let direction = d / length;
        let radiance = self.radiance(&found.surface, normal, -direction);
        let pdf = self.pdf(from, found.p, normal);
        if radiance == Vec3::ZERO || pdf <= 0.0 {
            return None;
        }
        let opacity = world.opacity_of(self.shape, &found.surface);
        let target = Target::Surface { p: found.p, error: found.error, normal };
        Some(Arrival { direction, target, weight: radiance * (opacity / pdf), pdf })
    }

    fn on_disk(disk: &Disk, u: Vec2) -> Found {
        let (radius, angle) = (u.x.sqrt(), 2.0 * PI * u.y);
        let (a, b) = (radius * maths::cosf(angle), radius * maths::sinf(angle));
        let (p, error) = disk.point(a, b);
        Found { p, error, normal: disk.normal, surface: Surface { uv: Disk::uv(a, b), color: Vec4::ONE } }
    }

    fn on_sphere(sphere: &Sphere, from: Vec3, u: Vec2) -> Found {
        let angle = 2.0 * PI * u.y;
        let (sin_phi, cos_phi) = (maths::sinf(angle), maths::cosf(angle));
        let n = if let Some((distance, width)) = Self::cone(sphere, from) {
            let drop = u.x * width;
            let (cos, sin2) = (1.0 - drop, drop * (2.0 - drop));
            let share = sphere.radius / distance;
            // Angle at the centre between the point and the direction back.
            let sin_alpha2 = sin2 / (share * share);
            let cos_alpha = sin2 / share + cos * (1.0 - sin_alpha2).max(0.0).sqrt();
            let sin_alpha = (1.0 - cos_alpha * cos_alpha).max(0.0).sqrt();
            Frame::new((from - sphere.center) / distance).to_world(Vec3::new(
                sin_alpha * cos_phi,
                sin_alpha * sin_phi,
                cos_alpha,
            ))
        } else {
            let z = 1.0 - 2.0 * u.x;
            let r = (1.0 - z * z).max(0.0).sqrt();
            Vec3::new(r * cos_phi, r * sin_phi, z)
        };
        let (p, normal, error) = sphere.project(sphere.center + n * sphere.radius);
        Found { p, error, normal, surface: Surface { uv: sphere.uv(normal), color: Vec4::ONE } }
    }
}
