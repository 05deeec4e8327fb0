//! Maps that perturb the shading normal.

use crate::{
    bsdf::{Points, Surface},
    lanes::{Real, Triple},
    texture::Texture,
};
use glam::{Vec2, Vec3};

/// How a map perturbs the shading normal.
#[derive(Clone, Debug)]
pub(crate) struct Relief {
    pub(super) map: Texture,
    pub(super) scale: f32,
    /// Whether the map holds heights.
    pub(crate) heights: bool,
    /// See [`scene::Bsdf::Relief`]; none of a plain normal map.
    pub(crate) options: Option<ReliefOptions>,
}

/// Options of a map that perturbs the shading normal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReliefOptions {
    /// Whether normals are turned about the shading normal where they would be seen from behind.
    pub(crate) flip: bool,
    /// Whether light at grazing incidence is dimmed.
    pub(crate) shadowing: bool,
    /// Whether the surface is two-sided around the map: seen from behind, it is as its mirror image from the front.
    pub(crate) mirrored: bool,
}

impl Relief {
    /// The normal of a normal map in its tangent frame, above the surface.
    #[inline]
    pub(crate) fn normal(&self, s: &Surface) -> Vec3 {
        let n = self.map.eval(s) * 2.0 - Vec3::ONE;
        // A map may point below the surface where it was compressed badly.
        Vec3::new(n.x * self.scale, n.y * self.scale, n.z.max(1e-3)).normalize_or(Vec3::Z)
    }

    /// Whether it is a normal map without options that reads no vertex colours.
    pub(crate) fn is_by_lane(&self) -> bool {
        !self.heights && self.options.is_none() && !self.map.reads_colors()
    }

    /// [`Relief::normal`] by lane.
    #[inline(always)]
    pub(crate) fn normals<R: Real>(&self, at: &Points<R>) -> Triple<R> {
        let n = self.map.lanes(at) * R::splat(2.0) - Triple::all(R::one());
        let n = Triple::new(n.x * self.scale, n.y * self.scale, n.z.max(R::splat(1e-3))).normalize();
        Triple::select(n.some(), n, Triple::splat(Vec3::Z))
    }

    /// The normal of a normal map in its tangent frame as Mitsuba reads it, of any length and on either side.
    pub(crate) fn raw_normal(&self, s: &Surface) -> Vec3 {
        let n = self.map.eval(s) * 2.0 - Vec3::ONE;
        Vec3::new(n.x * self.scale, n.y * self.scale, n.z)
    }

    /// The slopes of a bump map along u and v.
    pub(crate) fn slopes(&self, s: &Surface) -> Vec2 {
        self.map.slopes(s) * self.scale
    }
}
