//! Perspective pinhole camera: Mitsuba's `perspective` with a box filter.

use crate::{
    geometry::Ray,
    lanes::{Real, Triple},
};
use glam::{DVec3, Vec2, Vec3};
use tauflow_contract::KindError;
use tauflow_data::{maths, scene};

/// A camera for a film of known size.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// Where it stands.
    pub origin: Vec3,
    near: f32,
    /// Middle of the film, in pixels.
    middle: Vec2,
    /// Along a pixel's width and height, for axial distance 1.
    right: DVec3,
    down: DVec3,
    forward: Vec3,
}

/// Where the film sees something.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Image {
    /// In pixels from the top left.
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Pixels in a unit of solid angle.
    pub(crate) pixels: f64,
    /// Distance at which the view begins.
    pub(crate) begin: f64,
}

impl Camera {
    /// The camera for a film of `width` by `height` pixels.
    ///
    /// # Errors
    /// If it looks nowhere: origin and target coincide, `up` is along the view, or the field of view is not in (0,
    /// 180).
    pub fn new(camera: &scene::Camera, width: usize, height: usize) -> Result<Self, KindError> {
        let origin = DVec3::from_array(camera.origin);
        let forward = DVec3::from_array(camera.target) - origin;
        let side = forward.cross(DVec3::from_array(camera.up));
        let tangible = |v: DVec3| v.length().is_finite() && v.length() > 1e-12;
        // Positions beyond single precision are invalid, too.
        if !(origin.as_vec3().is_finite() && tangible(forward) && tangible(side)) {
            return Err(KindError::Input(format!(
                "the camera at {origin} with target {:?} and up {:?} looks nowhere; give three directions that span a \
                 frame",
                camera.target, camera.up
            )));
        }
        let near = camera.near as f32;
        if !(camera.fov_x > 0.0 && camera.fov_x < 180.0 && near >= 0.0 && near.is_finite()) {
            return Err(KindError::Input(format!(
                "the camera has `fov_x: {}` and `near: {}`; use a field of view between 0 and 180 degrees and a near \
                 distance from 0 that single precision holds",
                camera.fov_x, camera.near
            )));
        }
        let (forward, side) = (forward / forward.length(), side / side.length());
        let up = side.cross(forward);
        let half = maths::tan(camera.fov_x * std::f64::consts::PI / 360.0);
        let pixel = 2.0 * half / width as f64;
        Ok(Self {
            origin: origin.as_vec3(),
            near,
            middle: Vec2::new(width as f32 * 0.5, height as f32 * 0.5),
            right: side * pixel,
            down: up * -pixel,
            forward: forward.as_vec3(),
        })
    }

    /// A direction as the camera sees it: to the right, up, and towards the camera.
    pub fn seen(&self, direction: Vec3) -> Vec3 {
        let direction = direction.as_dvec3();
        let across = |axis: DVec3| direction.dot(axis / axis.length());
        let back = -self.forward.as_dvec3();
        DVec3::new(across(self.right), -across(self.down), across(back)).as_vec3()
    }

    /// Rays through points of the film, in pixels from the top left.
    #[inline(always)]
    pub(crate) fn rays<R: Real>(&self, x: R, y: R) -> (Triple<R>, Triple<R>) {
        // From the middle of the film, where nothing cancels.
        let (x, y) = (x - self.middle.x, y - self.middle.y);
        let (right, down) = (Triple::splat(self.right.as_vec3()), Triple::splat(self.down.as_vec3()));
        let direction = (Triple::splat(self.forward) + right * x + down * y).normalize();
        let begin = R::splat(self.near) / direction.dot(Triple::splat(self.forward));
        (Triple::splat(self.origin) + direction * begin, direction)
    }

    /// Density over area, for one sample per pixel, with which points are seen by rays that arrive from `back`, over
    /// the cosines of what leaves them along `out`.
    #[inline(always)]
    pub(crate) fn density<R: Real>(&self, p: Triple<R>, back: Triple<R>, normal: Triple<R>, out: Triple<R>) -> R {
        let away = p - Triple::splat(self.origin);
        let cos = -back.dot(Triple::splat(self.forward));
        let pixels = R::splat((1.0 / self.right.length_squared()) as f32) / (cos * cos * cos);
        pixels / away.dot(away) * normal.dot(back).abs() / normal.dot(out).abs()
    }

    /// Where the film shows what lies in a unit direction from the camera; none of what lies behind.
    pub(crate) fn image(&self, direction: DVec3) -> Option<Image> {
        let forward = self.forward.as_dvec3();
        let cos = direction.dot(forward);
        if cos <= 0.0 {
            return None;
        }
        let pixel = self.right.length_squared();
        let across = |axis: DVec3| direction.dot(axis) / (pixel * cos);
        let (x, y) = (across(self.right) + f64::from(self.middle.x), across(self.down) + f64::from(self.middle.y));
        Some(Image { x, y, pixels: 1.0 / (pixel * cos * cos * cos), begin: f64::from(self.near) / cos })
    }

    /// The ray through a point of the film, in pixels from the top left.
    pub fn ray(&self, x: u32, y: u32, jitter: Vec2) -> Ray {
        let (origin, direction) = self.rays::<f32>(x as f32 + jitter.x, y as f32 + jitter.y);
        Ray::new(origin.into(), direction.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> scene::Camera {
        scene::Camera { origin: [0.0, 1.0, 5.0], target: [0.0, 1.0, 0.0], up: [0.0, 1.0, 0.0], fov_x: 90.0, near: 0.0 }
    }

    #[test]
    fn the_film_is_the_right_way_up() {
        let camera = Camera::new(&camera(), 8, 4).expect("a plain camera");
        let center = camera.ray(4, 2, Vec2::ZERO);
        assert!((center.direction - Vec3::NEG_Z).length() < 1e-6);
        let left = camera.ray(0, 2, Vec2::ZERO).direction;
        assert!((left - Vec3::new(-1.0, 0.0, -1.0).normalize()).length() < 1e-6, "half of 90 degrees to the left");
        let top = camera.ray(4, 0, Vec2::ZERO).direction;
        assert!((top - Vec3::new(0.0, 0.5, -1.0).normalize()).length() < 1e-6);
    }

    #[test]
    fn directions_are_seen_in_the_frame_of_the_film() {
        let plain = Camera::new(&camera(), 8, 4).expect("a plain camera");
        assert!((plain.seen(Vec3::new(0.1, 0.2, 0.3)) - Vec3::new(0.1, 0.2, 0.3)).length() < 1e-6);
        // From above: what faces up faces the camera, and what lies behind is up in the picture.
        let above = scene::Camera { origin: [0.0, 9.0, 0.0], target: [0.0; 3], up: [0.0, 0.0, -1.0], ..camera() };
        let above = Camera::new(&above, 8, 4).expect("a camera that looks down");
        assert!((above.seen(Vec3::Y) - Vec3::Z).length() < 1e-6 && (above.seen(Vec3::NEG_Z) - Vec3::Y).length() < 1e-6);
        assert!((above.seen(Vec3::X) - Vec3::X).length() < 1e-6);
    }

    #[test]
    fn rays_begin_at_the_near_plane() {
        let camera = Camera::new(&scene::Camera { near: 2.0, ..camera() }, 8, 8).expect("a plain camera");
        for (x, y) in [(0, 0), (4, 4), (7, 2)] {
            assert!((camera.ray(x, y, Vec2::ZERO).origin.z - 3.0).abs() < 1e-5);
        }
    }

    #[test]
    fn the_film_sees_a_direction_where_its_ray_goes() {
        let camera = Camera::new(&scene::Camera { near: 0.5, ..camera() }, 8, 4).expect("a plain camera");
        for (x, y) in [(0, 0), (5, 1), (7, 3)] {
            let at = |u: f32, v: f32| camera.ray(x, y, Vec2::new(u, v));
            let ray = at(0.25, 0.75);
            let seen = camera.image(ray.direction.as_dvec3()).expect("in front");
            assert!((seen.x - f64::from(x) - 0.25).abs() < 1e-5 && (seen.y - f64::from(y) - 0.75).abs() < 1e-5);
            assert!((f64::from((ray.origin - camera.origin).length()) - seen.begin).abs() < 1e-6);
            // The solid angle of a small square about it.
            let step = 0.01;
            let (right, down) = (at(0.25 + step, 0.75).direction, at(0.25, 0.75 + step).direction);
            let angle = (right - ray.direction).cross(down - ray.direction).length() / (step * step);
            assert!((f64::from(angle) * seen.pixels - 1.0).abs() < 0.02, "{angle} {seen:?}");
        }
        assert!(camera.image(DVec3::Z).is_none(), "behind");
    }

    #[test]
    fn cameras_that_see_nothing_are_refused() {
        let bad = |change: fn(&mut scene::Camera)| {
            let mut camera = camera();
            change(&mut camera);
            Camera::new(&camera, 8, 8).is_err()
        };
        assert!(bad(|c| c.target = c.origin) && bad(|c| c.up = [0.0, 0.0, 2.0]) && bad(|c| c.fov_x = 180.0));
        assert!(bad(|c| c.fov_x = f64::NAN) && bad(|c| c.origin[0] = f64::INFINITY) && bad(|c| c.near = -1.0));
        assert!(bad(|c| c.near = 1e39) && bad(|c| c.origin[0] = -1e39));
    }
}
