//! Lights without extent: Mitsuba's `point` and `spot`.

use crate::{
    geometry::Map,
    lanes::{Real, Triple, acos},
};
use glam::{DVec3, Vec3};
use tauflow_contract::KindError;
use tauflow_data::{maths, scene::Affine};

/// A spot light whose intensity falls linearly with the angle between two half angles.
#[derive(Debug)]
pub(crate) struct Spot {
    pub(crate) position: Vec3,
    axis: Vec3,
    intensity: Vec3,
    cutoff: f32,
    beam: f32,
    cos_cutoff: f32,
    cos_beam: f32,
}

impl Spot {
    pub(super) fn new(to_world: &Affine, intensity: Vec3, cutoff: f64, beam: f64) -> Result<Self, KindError> {
        let map = Map::new(to_world);
        let (position, axis) = (map.point(DVec3::ZERO), map.vector(DVec3::Z).normalize_or_zero());
        if !(cutoff > 0.0 && cutoff <= 180.0 && beam >= 0.0 && beam <= cutoff) {
            return Err(KindError::Input(format!(
                "a spot light with `cutoff_angle: {cutoff}` and `beam_width: {beam}`; use 0 <= beam_width <= \
                 cutoff_angle <= 180"
            )));
        }
        if axis == DVec3::ZERO || !position.is_finite() {
            return Err(KindError::Input("a spot light whose `to_world` has no direction; give it one".into()));
        }
        let radians = |degrees: f64| degrees * std::f64::consts::PI / 180.0;
        Ok(Self {
            position,
            axis: axis.as_vec3(),
            intensity,
            cutoff: radians(cutoff) as f32,
            beam: radians(beam) as f32,
            cos_cutoff: maths::cos(radians(cutoff)) as f32,
            cos_beam: maths::cos(radians(beam)) as f32,
        })
    }

    /// Solid angle lit, for its power.
    pub(super) fn solid_angle(&self) -> f64 {
        2.0 * std::f64::consts::PI * (1.0 - 0.5 * f64::from(self.cos_cutoff + self.cos_beam))
    }

    /// Intensity in directions away from the light.
    #[inline(always)]
    pub(super) fn intensity<R: Real>(&self, direction: Triple<R>) -> Triple<R> {
        let cos = direction.dot(Triple::splat(self.axis));
        let fall = (R::splat(self.cutoff) - acos(cos)) / (self.cutoff - self.beam);
        let share = R::select(cos.ge(R::splat(self.cos_beam)), R::one(), fall);
        Triple::splat(self.intensity) * share.only(cos.gt(R::splat(self.cos_cutoff)))
    }

    /// Its largest intensity.
    pub(super) fn brightest(&self) -> Vec3 {
        self.intensity
    }
}
