//! Lights without extent: Mitsuba's `point` and `spot`.

use crate::geometry::Map;
use glam::{DVec3, Vec3};
use tauflow_contract::KindError;
use tauflow_data::{maths, scene::Affine};

/// Unit direction from one point to another, and the squared distance; `None` if they coincide.
#[inline]
pub(super) fn towards(from: Vec3, to: Vec3) -> Option<(Vec3, f32)> {
    let d = to - from;
    let square = d.length_squared();
    (square > 0.0 && square.is_finite()).then(|| (d / square.sqrt(), square))
}

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

    /// Intensity in a direction away from the light.
    #[inline]
    pub(super) fn intensity(&self, direction: Vec3) -> Vec3 {
        let cos = direction.dot(self.axis);
        if cos <= self.cos_cutoff {
            Vec3::ZERO
        } else if cos >= self.cos_beam {
            self.intensity
        } else {
            self.intensity * ((self.cutoff - maths::acosf(cos)) / (self.cutoff - self.beam))
        }
    }
}
