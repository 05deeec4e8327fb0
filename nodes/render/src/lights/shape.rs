//! Shapes that emit on their outer side.
//!
//! Sphere sampling after Pharr, Jakob, Humphreys, *Physically Based Rendering*, 4th edition, section 6.2.4.

use super::{Arrivals, Emission, ShapeForms, brightness};
use crate::{
    accel,
    alias::Alias,
    bsdf::{Points, Surface},
    geometry::{Disk, Frames, Sphere, area_normal, gamma, offset_origins},
    lanes::{Integer, Mask, Pair, Real, Triple, sin_cos_turn},
    surface::{Form, IN_WORLD},
    texture::Texture,
    world::World,
};
use glam::{Vec2, Vec3, Vec4};
use std::{collections::BTreeMap, f32::consts::PI, sync::Arc};

/// Shadow rays end this short of a surface: the rounding of a distance near 1, with room to spare.
const SHADOW_END: f32 = 1.0 - 1e-5;

/// A shape's light.
#[derive(Debug)]
pub(crate) struct ShapeLight {
    pub(crate) shape: u32,
    pub(crate) texture: Texture,
    /// First of its primitives in the table, and how many there are.
    pub(super) first: usize,
    pub(super) count: usize,
    /// Its primitives by area.
    alias: Arc<Alias>,
    pub(super) area: f64,
    /// The sphere, if it is one that shines outwards.
    sphere: Option<Sphere>,
}

/// Points on the shape.
pub(super) struct OnShape<R> {
    pub(super) p: Triple<R>,
    pub(super) error: Triple<R>,
    pub(super) normal: Triple<R>,
    pub(super) at: Points<R>,
}

impl ShapeLight {
    /// `None` if it has no area, or its emission is 0.
    pub(super) fn new(
        emission: Emission,
        forms: ShapeForms<'_>,
        tables: &mut BTreeMap<u32, Arc<Alias>>,
    ) -> Option<Self> {
        let Emission { shape, first, count, .. } = emission;
        let texture = emission.texture;
        let areas: Vec<f64> = (0..count as u32)
            .map(|at| match forms(shape, at) {
                accel::Primitive::Triangle([a, b, c]) => area_normal(a, b, c).map_or(0.0, |f| f.0),
                accel::Primitive::Sphere(s) => 4.0 * std::f64::consts::PI * f64::from(s.radius).powi(2),
                accel::Primitive::Disk(d) => d.area,
            })
            .collect();
        let area: f64 = areas.iter().sum();
        let sphere = (0..count.min(1) as u32).find_map(|at| match forms(shape, at) {
            // One that shines inwards is seen from within, or through itself.
            accel::Primitive::Sphere(s) if !emission.flip => Some(s),
            _ => None,
        });
        let black = matches!(&texture, Texture::Constant(value) if *value == Vec3::ZERO);
        let table = || {
            let mut alias = Alias::default();
            alias.extend(&areas);
            Arc::new(alias)
        };
        let alias = match emission.even {
            Some(mesh) => tables.entry(mesh).or_insert_with(table).clone(),
            None => table(),
        };
        (area > 0.0 && !black).then_some(Self { shape, texture, first, count, alias, area, sphere })
    }

    /// Mean radiance over its texture, as brightness.
    fn mean(&self) -> f64 {
        const SIDE: u32 = 16;
        if let Texture::Constant(value) = &self.texture {
            return brightness(*value);
        }
        let mut sum = 0.0;
        for i in 0..SIDE * SIDE {
            let uv = Vec2::new((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5) / SIDE as f32;
            sum += brightness(self.texture.eval(&Surface { uv, color: Vec4::ONE }));
        }
        sum / f64::from(SIDE * SIDE)
    }

    /// Power, and intensity along the normal if it were flat.
    pub(super) fn power(&self) -> (f64, f64) {
        let intensity = self.mean() * self.area;
        (std::f64::consts::PI * intensity, intensity)
    }

    /// Radiance that leaves points of the shape towards directions, given the outer normals.
    #[inline(always)]
    pub(crate) fn radiance<R: Real>(&self, at: &Points<R>, normal: Triple<R>, direction: Triple<R>) -> Triple<R> {
        self.texture.one_by_one(at).only(normal.dot(direction).positive())
    }

    /// Distances to a sphere's centre, 1 - cos of the half angle that it fills, and the lanes outside of it.
    #[inline(always)]
    fn cone<R: Real>(sphere: &Sphere, from: Triple<R>) -> (R, R, R::Mask) {
        let d = Triple::splat(sphere.center) - from;
        let square = d.dot(d);
        let share = R::splat(sphere.radius * sphere.radius) / square;
        let width = share / ((R::one() - share).max(R::zero()).sqrt() + 1.0);
        (square.sqrt(), width, share.lt(R::splat(0.9999)))
    }

    /// Density over solid angle, seen from `from`, with which the points `p` of outer normals `normal` are sampled.
    #[inline(always)]
    pub(crate) fn pdf<R: Real>(&self, from: Triple<R>, p: Triple<R>, normal: Triple<R>) -> R {
        let d = p - from;
        let square = d.dot(d);
        // square / (cos area), with cos = |n . d| / sqrt(square).
        let facing = normal.dot(d).abs();
        let pdf = (square * square.sqrt() / (facing * self.area as f32)).only(facing.positive());
        let Some(sphere) = &self.sphere else { return pdf };
        let (_, width, outside) = Self::cone(sphere, from);
        R::select(outside, R::splat(1.0 / (2.0 * PI)) / width, pdf)
    }

    /// Samples the shape from points, and says where on it: the numbers choose the primitive, `u` the point on it.
    #[inline(always)]
    pub(super) fn sample<R: Real>(
        &self,
        world: &World,
        from: &super::Vantage<R>,
        [pick, accept]: [R; 2],
        u: Pair<R>,
    ) -> (Arrivals<R>, OnShape<R>) {
        let shape = &world.shapes[self.shape as usize];
        let mut found = match &shape.form {
            Form::Sphere(sphere) => self.on_sphere(world, sphere, from.p, u),
            Form::Disk(disk) => on_disk(disk, u),
            Form::Mesh(_) => self.on_mesh(world, [pick, accept], u),
        };
        // Normals of the table are turned already.
        let turned = shape.flip && !matches!(shape.form, Form::Mesh(_));
        let normal = if turned { -found.normal } else { found.normal };
        found.normal = normal;
        let d = found.p - from.p;
        let length = d.length();
        let direction = d * (R::one() / length);
        let radiance = self.radiance(&found.at, normal, -direction);
        let pdf = self.pdf(from.p, found.p, normal);
        let valid = length.positive() & pdf.positive() & radiance.some();
        let mut weight = radiance * (R::one() / pdf);
        if let Some(opacity) = world.materials[shape.material as usize].material.opacity_texture() {
            weight = weight * opacity.one_by_one(&found.at).x.clamp(0.0, 1.0);
        }
        let origin = offset_origins(from.p, from.error, from.normal, direction);
        let end = offset_origins(found.p, found.error, normal, -direction);
        let emits = R::zero();
        (Arrivals { direction, origin, ray: end - origin, t_max: SHADOW_END, weight, pdf, emits, valid }, found)
    }

    /// A point drawn by area, with the normal of its outer side.
    pub(super) fn by_area(&self, world: &World, pick: [f32; 2], u: Pair<f32>) -> OnShape<f32> {
        let shape = &world.shapes[self.shape as usize];
        let mut found = match &shape.form {
            Form::Sphere(sphere) => self.on_whole_sphere(world, sphere, u),
            Form::Disk(disk) => on_disk(disk, u),
            Form::Mesh(_) => return self.on_mesh(world, pick, u),
        };
        if shape.flip {
            found.normal = -found.normal;
        }
        found
    }

    fn on_whole_sphere(&self, world: &World, sphere: &Sphere, u: Pair<f32>) -> OnShape<f32> {
        let (sin, cos) = sin_cos_turn(u.y);
        let z = 1.0 - 2.0 * u.x;
        let r = (1.0 - z * z).max(0.0).sqrt();
        self.at_normal(world, sphere, Triple::new(r * cos, r * sin, z))
    }

    #[inline(always)]
    fn on_mesh<R: Real>(&self, world: &World, [pick, accept]: [R; 2], u: Pair<R>) -> OnShape<R> {
        let own = self.alias.draw::<R>(R::Integer::splat(0), self.count, pick, accept);
        let primitive = own + R::Integer::splat(self.first as i32);
        let facts = world.table.facts::<R>(primitive);
        let [p0, p1, p2] = facts.positions;
        let root = u.x.sqrt();
        let weights = [R::one() - root, root * (R::one() - u.y), root * u.y];
        let (a, b, c) = (p0 * weights[0], p1 * weights[1], p2 * weights[2]);
        let zero = R::zero();
        let uv =
            if self.texture.reads_uv() || world.features.opacity { facts.uv(weights) } else { Pair::new(zero, zero) };
        let mut at = Points { uv, color: Triple::all(R::one()), alpha: R::one() };
        let shape = &world.shapes[self.shape as usize];
        if self.texture.reads_colors() || world.materials[shape.material as usize].material.reads_colors() {
            colors(world, self.shape, primitive, weights, &mut at);
        }
        let (p, error) = (a + b + c, (a.abs() + b.abs() + c.abs()) * R::splat(gamma(6)));
        if shape.placed == IN_WORLD {
            return OnShape { p, error, normal: facts.normal, at };
        }
        let placed = world.accel.placements().placed::<R>(R::Integer::splat(shape.placed as i32));
        let (p, error) = placed.point(p, error);
        let normal = placed.normal(facts.normal) * R::splat(if shape.flip { -1.0 } else { 1.0 });
        OnShape { p, error, normal, at }
    }

    #[inline(always)]
    fn on_sphere<R: Real>(&self, world: &World, sphere: &Sphere, from: Triple<R>, u: Pair<R>) -> OnShape<R> {
        let one = R::one();
        let (sin_phi, cos_phi) = sin_cos_turn(u.y);
        let center = Triple::splat(sphere.center);
        let (distance, width, outside) = Self::cone(sphere, from);
        let drop = u.x * width;
        let (cos, sin2) = (one - drop, drop * (R::splat(2.0) - drop));
        let share = R::splat(sphere.radius) / distance;
        // Angle at the centre between the point and the direction back.
        let sin_alpha2 = sin2 / (share * share);
        let cos_alpha = sin2 / share + cos * (one - sin_alpha2).max(R::zero()).sqrt();
        let sin_alpha = (one - cos_alpha * cos_alpha).max(R::zero()).sqrt();
        let back = (from - center) * (one / distance);
        let seen = Frames::new(back).to_world(Triple::new(sin_alpha * cos_phi, sin_alpha * sin_phi, cos_alpha));
        let outside = if self.sphere.is_some() { outside } else { R::Mask::from_bits(0) };
        let mut n = seen;
        if (!outside).any() {
            let z = one - u.x * 2.0;
            let r = (one - z * z).max(R::zero()).sqrt();
            n = Triple::select(outside, seen, Triple::new(r * cos_phi, r * sin_phi, z));
        }
        self.at_normal(world, sphere, n)
    }

    /// Points of a sphere by their normals, of almost unit length.
    #[inline(always)]
    fn at_normal<R: Real>(&self, world: &World, sphere: &Sphere, n: Triple<R>) -> OnShape<R> {
        let center = Triple::splat(sphere.center);
        let n = n.normalize();
        let arm = n * R::splat(sphere.radius);
        let error = arm.abs() * R::splat(gamma(6)) + (center.abs() + arm.abs()) * R::splat(gamma(2));
        let one = R::one();
        let mut at = Points { uv: Pair::new(R::zero(), R::zero()), color: Triple::all(one), alpha: one };
        if self.texture.reads_uv() || world.features.opacity {
            at.uv = sphere.uv_lanes(n);
        }
        OnShape { p: center + arm, error, normal: n, at }
    }
}

#[inline(always)]
fn on_disk<R: Real>(disk: &Disk, u: Pair<R>) -> OnShape<R> {
    let radius = u.x.sqrt();
    let (sin, cos) = sin_cos_turn(u.y);
    let (x, y) = (Triple::splat(disk.x) * (radius * cos), Triple::splat(disk.y) * (radius * sin));
    let center = Triple::splat(disk.center);
    let at = Points { uv: Pair::new(radius, u.y), color: Triple::all(R::one()), alpha: R::one() };
    OnShape {
        p: center + x + y,
        error: (center.abs() + x.abs() + y.abs()) * R::splat(gamma(4)),
        normal: Triple::splat(disk.normal),
        at,
    }
}

/// Vertex colours at points of triangles.
#[inline(always)]
fn colors<R: Real>(world: &World, shape: u32, primitive: R::Integer, weights: [R; 3], at: &mut Points<R>) {
    let (mut index, mut rows) = ([0; 16], [[0.0f32; 16]; 6]);
    primitive.store(&mut index);
    weights[1].store(&mut rows[0]);
    weights[2].store(&mut rows[1]);
    for lane in 0..R::N {
        let color = world.color(shape, index[lane], rows[0][lane], rows[1][lane]);
        for (row, value) in rows[2..].iter_mut().zip(color.to_array()) {
            row[lane] = value;
        }
    }
    at.color = Triple::load([&rows[2], &rows[3], &rows[4]], 0);
    at.alpha = R::load(&rows[5]);
}
