//! Framing: a camera that looks at the objects, stands in no wall, and sees them unobstructed.

use super::stage::View;
use crate::geom::{Aabb, Vec3, add, direction, length, mul, sub};
use tauflow_data::{maths, rng::Stream, scene::Camera};

/// What a camera has to look at and to look past.
pub struct Sight<'a> {
    /// Box of all objects.
    pub cluster: Aabb,
    /// Boxes of the objects.
    pub objects: &'a [Aabb],
    /// What would hide them.
    pub obstacles: &'a [Aabb],
    /// Where the camera may stand.
    pub view: &'a View,
    /// Lowest height of the camera.
    pub floor: f64,
    /// Range of the horizontal field of view, degrees.
    pub fov: [f64; 2],
}

/// Candidates tried before the best of them is taken.
const TRIES: usize = 48;

impl Sight<'_> {
    /// A camera that frames the objects.
    ///
    /// Candidates are drawn from the view; the first that lies clear of everything, sees the middle of every object
    /// and keeps its distance wins, else the one with the fewest faults.
    pub fn frame(&self, stream: &Stream) -> Camera {
        let mut best: Option<(usize, Camera)> = None;
        for k in 0..TRIES {
            let camera = self.candidate(&mut stream.part(&format!("try.{k}")));
            let faults = self.faults(&camera);
            if faults == 0 {
                return camera;
            }
            if best.as_ref().is_none_or(|(least, _)| faults < *least) {
                best = Some((faults, camera));
            }
        }
        best.expect("at least one candidate").1
    }

    /// A camera that was not looked through: anywhere about, aimed anywhere.
    pub fn unchecked(&self, stream: &Stream) -> Camera {
        let mut d = stream.part("unchecked");
        let reach = 2.0 + length(self.cluster.size());
        let mut at = || [d.range(-reach, reach), d.range(self.floor, 2.2), d.range(-reach, reach)];
        let (mut origin, mut target) = (at(), at());
        if let Some(room) = &self.view.room {
            origin = inside(room, origin);
            target = inside(room, target);
        }
        let view = sub(target, origin);
        // Two places outside of the same corner come to lie above each other in it, and straight up there is no frame.
        if length(view) < 0.1 || length([view[0], 0.0, view[2]]) < 1e-3 {
            target = add(origin, [0.0, -0.2, -1.0]);
        }
        let fov_x = d.range(self.fov[0], self.fov[1]);
        Camera { origin, target, up: [0.0, 1.0, 0.0], fov_x, near: 0.01 }
    }

    fn candidate(&self, d: &mut Stream) -> Camera {
        let size = self.cluster.size();
        // Half the diagonal overstates what is seen of a box; 0.85 of it fills the frame better.
        let radius = (0.42 * length(size)).max(0.25);
        let jitter = [d.range(-0.12, 0.12), d.range(-0.12, 0.05), d.range(-0.12, 0.12)];
        let target = add(self.cluster.center(), mul(jitter, radius));
        let mut fov_x = d.range(self.fov[0], self.fov[1]);
        let azimuth = d.range(self.view.azimuth[0], self.view.azimuth[1]);
        let elevation = d.range(self.view.elevation[0], self.view.elevation[1]);
        let toward = direction(azimuth, elevation);
        let half = (0.5 * fov_x).to_radians();
        let mut distance = radius / maths::sin(half) * d.range(0.95, 1.35);
        if let Some(room) = &self.view.room {
            let most = reach(room, target, toward) * d.range(0.88, 0.99);
            if distance > most {
                distance = most;
                let needed = 2.0 * maths::asin((radius * 1.05 / distance).min(0.7)).to_degrees();
                fov_x = fov_x.max(needed.min(90.0));
            }
            // A room is worth seeing: step back if there is space.
            distance = distance.max(d.range(0.6, 1.0) * most);
        }
        let mut origin = add(target, mul(toward, distance));
        origin[1] = origin[1].max(self.floor + 0.25);
        Camera { origin, target, up: [0.0, 1.0, 0.0], fov_x, near: 0.01 }
    }

    fn faults(&self, camera: &Camera) -> usize {
        let origin = camera.origin;
        let mut faults = 0;
        for obstacle in self.obstacles {
            faults += 4 * usize::from(obstacle.contains(origin, 0.15));
            for object in self.objects {
                faults += 2 * usize::from(obstacle.meets(origin, object.center()));
            }
        }
        for object in self.objects {
            faults += 4 * usize::from(object.contains(origin, 0.3));
        }
        if let Some(main) = self.objects.first() {
            // No other object before the main one.
            let hidden = self.objects[1..].iter().filter(|o| o.meets(origin, main.center())).count();
            faults += hidden;
        }
        if let Some(room) = &self.view.room {
            faults += 4 * usize::from(!room.contains(origin, -0.08));
        }
        faults
    }
}

/// `p` moved into a room, off its walls.
fn inside(room: &Aabb, p: Vec3) -> Vec3 {
    [0, 1, 2].map(|i| p[i].clamp(room.low[i] + 0.15, room.high[i] - 0.15))
}

/// How far one can go from `from` along `toward` within a room, off its walls.
fn reach(room: &Aabb, from: Vec3, toward: Vec3) -> f64 {
    let mut far = f64::INFINITY;
    for i in 0..3 {
        let wall = if toward[i] > 0.0 { room.high[i] - 0.12 } else { room.low[i] + 0.12 };
        if toward[i] != 0.0 {
            far = far.min((wall - from[i]) / toward[i]);
        }
    }
    far.max(0.3)
}
