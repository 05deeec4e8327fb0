//! Where light paths are sent: towards balls that enclose what is specular, or anywhere.
//!
//! A path is emitted for a pair of a light and a ball, or of a light and the whole scene. Towards a ball, directions
//! are even over the cone that it fills, as seen from a point of a lamp; light from infinity falls evenly on its disk.
//! Any pair may emit the same ray: its density is the sum over all pairs of the light (Veach's one-sample model with
//! the balance heuristic). The shares of pairs follow from the light that they catch, and then from what a few paths
//! bring to the film; a fixed part stays as it was, so that no pair is ever left out.

use super::{Light, Lights};
use crate::{
    alias::Alias,
    lanes::{Real, Triple},
    surface::{Form, IN_WORLD},
    world::World,
};
use glam::Vec3;
use std::f32::consts::PI;

/// Balls at most; those of more shapes are joined.
const BALLS: usize = 16;
/// Part of a light's paths that goes anywhere.
const ANYWHERE: f64 = 0.5;
/// Part of all paths that is spread as by the light that pairs catch, whatever they bring to the film.
const KEPT: f64 = 0.2;
/// A ball with a smaller part of all paths is left out.
const IDLE: f64 = 0.01;
/// Fewer paths of a pair say too little of it.
const FEW: u64 = 32;
/// A point is taken as inside a ball from this squared ratio of radius and distance on.
const INSIDE: f32 = 0.999;

/// A ball around specular shapes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ball {
    pub(crate) center: Vec3,
    pub(crate) radius: f32,
}

/// Where light paths are sent.
#[derive(Debug)]
pub(crate) struct Aims {
    balls: Vec<Ball>,
    /// Probability of each pair, light by light; the last pair of a light is with the whole scene.
    shares: Vec<f32>,
    alias: Alias,
}

/// A pair of a light and where its light goes: to a ball, or anywhere.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pairing {
    pub(crate) number: usize,
    pub(crate) light: usize,
    pub(crate) ball: Option<Ball>,
}

impl Aims {
    /// Light of all lights goes anywhere.
    pub(crate) fn anywhere(lights: &Lights) -> Self {
        Self::of(Vec::new(), lights.probability.iter().map(|share| f64::from(*share)).collect())
    }

    /// Half of the light of each light goes to what is specular, if anything is; none if no light has an extent.
    pub(crate) fn towards_specular(world: &World) -> Option<Self> {
        let lights = &world.lights;
        let balls = joined(balls(world));
        let mut weights = Vec::with_capacity(lights.lights.len() * (balls.len() + 1));
        for (number, light) in lights.lights.iter().enumerate() {
            let power = if light.has_extent() { f64::from(lights.probability[number]) } else { 0.0 };
            let caught: Vec<f64> = balls.iter().map(|ball| lights.caught(number, ball)).collect();
            let all: f64 = caught.iter().sum();
            // Half of it evenly: what a ball brings to the film does not follow from its size.
            let even = 0.5 / balls.len() as f64;
            let share = |own: &f64| 0.5 * own / all.max(f64::MIN_POSITIVE) + even;
            weights.extend(caught.iter().map(|own| power * (1.0 - ANYWHERE) * share(own)));
            weights.push(if balls.is_empty() { power } else { power * ANYWHERE });
        }
        (weights.iter().sum::<f64>() > 0.0).then(|| Self::of(balls, weights))
    }

    fn of(balls: Vec<Ball>, weights: Vec<f64>) -> Self {
        let total: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let mut alias = Alias::default();
        alias.extend(&weights);
        Self { balls, shares: weights.iter().map(|weight| (weight / total) as f32).collect(), alias }
    }

    /// Number of pairs.
    pub(crate) fn len(&self) -> usize {
        self.shares.len()
    }

    /// The same pairs, with shares by what paths of each have brought: `brought` is the sum over the paths of a pair
    /// of the square of their light, `paths` how many there were. None if nothing was brought.
    pub(crate) fn learnt(self, brought: &[f64], paths: &[u64]) -> Option<Self> {
        // Variance is least if shares are in proportion to the root of the mean square. A pair with few paths takes the
        // mean square of its ball over all lights.
        let each = self.balls.len() + 1;
        let of_ball = |pair: usize| -> (f64, u64) {
            let all = (pair % each..self.len()).step_by(each);
            all.fold((0.0, 0), |(square, count), at| (square + brought[at], count + paths[at]))
        };
        let root = |pair: usize| {
            let (square, count) = if paths[pair] < FEW { of_ball(pair) } else { (brought[pair], paths[pair]) };
            (square / (count as f64).max(1.0)).sqrt()
        };
        let best: Vec<f64> = (0..self.len()).map(|pair| f64::from(self.shares[pair]) * root(pair)).collect();
        let sum: f64 = best.iter().sum();
        (sum > 0.0 && sum.is_finite()).then(|| {
            let weights = self.shares.iter().zip(&best);
            let weights = weights.map(|(old, best)| KEPT * f64::from(*old) + (1.0 - KEPT) * best / sum).collect();
            self.without_idle(weights)
        })
    }

    /// Drops balls that get few paths, because each ball takes time at every vertex. Their paths go anywhere.
    fn without_idle(self, weights: Vec<f64>) -> Self {
        let each = self.balls.len() + 1;
        let sum = |ball: usize| weights.iter().skip(ball).step_by(each).sum::<f64>();
        let kept: Vec<usize> = (0..self.balls.len()).filter(|ball| sum(*ball) >= IDLE).collect();
        let of_light = |own: &[f64]| -> Vec<f64> {
            let balls: Vec<f64> = kept.iter().map(|ball| own[*ball]).collect();
            let rest = own.iter().sum::<f64>() - balls.iter().sum::<f64>();
            balls.into_iter().chain([rest]).collect()
        };
        let weights = weights.chunks(each).flat_map(of_light).collect();
        Self::of(kept.iter().map(|ball| self.balls[*ball]).collect(), weights)
    }

    /// The pair of a draw.
    pub(super) fn draw(&self, pick: f32, accept: f32) -> Pairing {
        let number = self.alias.draw::<f32>(0, self.shares.len(), pick, accept) as usize;
        let (light, to) = (number / (self.balls.len() + 1), number % (self.balls.len() + 1));
        Pairing { number, light, ball: self.balls.get(to).copied() }
    }

    fn of_light(&self, light: usize) -> &[f32] {
        &self.shares[light * (self.balls.len() + 1)..][..self.balls.len() + 1]
    }

    /// Density of emission over area and solid angle, over the cosine at the light, from points of a shape of this
    /// light whose outer normals are `normal` towards `out`.
    #[inline(always)]
    pub(crate) fn of_shape<R: Real>(
        &self,
        lights: &Lights,
        light: u32,
        p: Triple<R>,
        normal: Triple<R>,
        out: Triple<R>,
    ) -> R {
        let Some(shape) = lights.shape(light) else { return R::zero() };
        let shares = self.of_light(light as usize);
        let cos = normal.dot(out);
        let (mut by_cosine, mut by_cone) = (R::splat(shares[self.balls.len()]), R::zero());
        for (ball, share) in self.balls.iter().zip(shares) {
            let cone = ball.cone(p);
            let ahead = (Triple::splat(ball.center) - p).dot(out).positive();
            let hit = ball.seen_along(p, out) & ahead;
            by_cosine += R::splat(*share).only(cone.inside);
            by_cone += (R::splat(*share * (0.5 / PI)) / cone.width).only(hit & !cone.inside);
        }
        let density = by_cosine * (1.0 / PI) + by_cone / cos;
        (density * (1.0 / shape.area())).only(cos.positive())
    }

    /// The same of light from infinity along rays, by the density with which their directions are drawn.
    #[inline(always)]
    pub(super) fn of_sky<R: Real>(&self, lights: &Lights, drawn: R, origin: Triple<R>, to_light: Triple<R>) -> R {
        let Some((_, light)) = &lights.environment else { return R::zero() };
        let shares = self.of_light(*light as usize);
        let mut sum = R::splat(shares[self.balls.len()] / lights.disk());
        for (ball, share) in self.balls.iter().zip(shares) {
            let hit = ball.seen_along(origin, to_light);
            sum += R::splat(*share / (PI * ball.radius * ball.radius)).only(hit);
        }
        drawn * sum
    }
}

/// The cones that a ball fills, seen from points.
pub(super) struct Cone<R: Real> {
    /// 1 - cos of the half angle.
    pub(super) width: R,
    /// Lanes within the ball, or nearly so.
    pub(super) inside: R::Mask,
}

impl Ball {
    /// Lanes where a line through a point meets it.
    #[inline(always)]
    pub(super) fn seen_along<R: Real>(&self, p: Triple<R>, direction: Triple<R>) -> R::Mask {
        let aside = (Triple::splat(self.center) - p).cross(direction);
        aside.dot(aside).le(R::splat(self.radius * self.radius))
    }

    #[inline(always)]
    pub(super) fn cone<R: Real>(&self, p: Triple<R>) -> Cone<R> {
        let d = Triple::splat(self.center) - p;
        let share = R::splat(self.radius * self.radius) / d.dot(d);
        let inside = share.ge(R::splat(INSIDE));
        Cone { width: share / ((R::one() - share).max(R::zero()).sqrt() + 1.0), inside }
    }
}

impl Light {
    fn has_extent(&self) -> bool {
        matches!(self, Self::Shape(_) | Self::Environment)
    }
}

impl Lights {
    /// Share of a light's power that a ball catches, roughly; what it lacks is a factor that all balls share.
    fn caught(&self, light: usize, ball: &Ball) -> f64 {
        let square = f64::from(ball.radius).powi(2);
        match &self.lights[light] {
            Light::Shape(_) => {
                let guide = &self.guides[light];
                let distance = f64::from(guide.center.distance_squared(ball.center)).max(f64::from(guide.square));
                square / (distance + square)
            }
            _ => square,
        }
    }
}

/// A ball around each specular shape.
fn balls(world: &World) -> Vec<Ball> {
    let mut balls = Vec::new();
    for shape in &world.shapes {
        if !world.materials[shape.material as usize].material.has_specular() {
            continue;
        }
        let ball = match &shape.form {
            Form::Sphere(sphere) => Ball { center: sphere.center, radius: sphere.radius },
            Form::Disk(disk) => {
                let radius = (disk.x.length_squared() + disk.y.length_squared()).sqrt();
                Ball { center: disk.center, radius }
            }
            Form::Mesh(_) => {
                let placements = world.accel.placements();
                let placed = (shape.placed != IN_WORLD).then(|| placements.placed::<f32>(shape.placed as i32));
                let corners = || {
                    (shape.base..shape.base + shape.count).flat_map(|at| {
                        let positions = world.table.facts::<f32>(at as i32).positions;
                        positions.map(|p| Vec3::from(placed.as_ref().map_or(p, |of| of.point(p, Triple::zero()).0)))
                    })
                };
                let (low, high) = corners().fold((Vec3::MAX, Vec3::MIN), |(low, high), p| (low.min(p), high.max(p)));
                let center = (low + high) * 0.5;
                let square = corners().map(|p| p.distance_squared(center)).fold(0.0, f32::max);
                Ball { center, radius: square.sqrt() }
            }
        };
        if ball.center.is_finite() && ball.radius.is_finite() && shape.count > 0 {
            // Room for rounding.
            balls.push(Ball { center: ball.center, radius: ball.radius * 1.001 + 1e-5 * ball.center.length() + 1e-9 });
        }
    }
    balls
}

/// The ball around balls.
fn around(balls: &[Ball]) -> Ball {
    let bounds = balls.iter().fold((Vec3::MAX, Vec3::MIN), |(low, high), ball| {
        (low.min(ball.center - ball.radius), high.max(ball.center + ball.radius))
    });
    let center = (bounds.0 + bounds.1) * 0.5;
    let radius = balls.iter().map(|ball| ball.center.distance(center) + ball.radius).fold(0.0, f32::max);
    Ball { center, radius }
}

/// As many balls as there may be: the widest group is halved until there are as many groups.
fn joined(balls: Vec<Ball>) -> Vec<Ball> {
    if balls.len() <= BALLS {
        return balls;
    }
    let mut groups = vec![(around(&balls), balls)];
    while groups.len() < BALLS {
        let widest = (0..groups.len())
            .filter(|at| groups[*at].1.len() > 1)
            .max_by(|a, b| groups[*a].0.radius.total_cmp(&groups[*b].0.radius));
        let Some(widest) = widest else { break };
        let (_, mut all) = groups.swap_remove(widest);
        let (low, high) =
            all.iter().fold((Vec3::MAX, Vec3::MIN), |(low, high), b| (low.min(b.center), high.max(b.center)));
        let axis = (high - low).max_position();
        all.sort_by(|a, b| a.center[axis].total_cmp(&b.center[axis]));
        let rest = all.split_off(all.len() / 2);
        groups.extend([all, rest].map(|half| (around(&half), half)));
    }
    groups.into_iter().map(|group| group.0).collect()
}

#[cfg(test)]
mod tests;
