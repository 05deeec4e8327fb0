//! Aiming: a camera drawn by the rules of a stage. Its view is not checked; it is only guaranteed to be outside of
//! solids.

use super::{
    place::tenth,
    stage::{From, Stage},
};
use tauflow_data::{
    geom::{Aabb, Vec3, add, direction, length, mul, sub},
    rng::Stream,
    scene::Camera,
};

/// Candidates tried before the search for a free place grows desperate.
const TRIES: usize = 64;

/// How near a camera comes to solids, metres.
const NEAR: f64 = 0.04;

/// Draws a camera of a stage, its horizontal field of view within `fov` degrees.
pub fn aim(stage: &Stage<'_>, fov: [f64; 2], stream: &Stream) -> Camera {
    let mut d = stream.clone();
    let total: f64 = stage.eyes.iter().map(|e| e.weight).sum();
    let fov_x = (d.range(fov[0], fov[1]) * 100.0).round() / 100.0;
    let mut best = ([0.0, 1.5, 3.0], [0.0, 0.8, 0.0]);
    for k in 0..2 * TRIES {
        let mut left = d.uniform() * total;
        let eye = stage.eyes.iter().find(|e| {
            left -= e.weight;
            left <= 0.0
        });
        let Some(eye) = eye.or(stage.eyes.last()) else { break };
        let target = within(&eye.at, &mut d);
        let origin = match &eye.from {
            From::Box(region) => within(region, &mut d),
            From::Orbit(distance, azimuth, elevation) => {
                let toward = direction(d.range(azimuth[0], azimuth[1]), d.range(elevation[0], elevation[1]));
                add(target, mul(toward, d.range(distance[0], distance[1])))
            }
        };
        let origin = match &stage.inside {
            Some(inside) => clamped(inside, origin),
            None => origin,
        };
        // The later the try, the more is made of what is left: straight up out of what is in the way.
        let lift = if k < TRIES { 0.0 } else { 0.03 * (k - TRIES) as f64 };
        let origin = [origin[0], origin[1] + lift, origin[2]].map(tenth);
        let target = target.map(tenth);
        let view = sub(target, origin);
        if length([view[0], 0.0, view[2]]) < 0.02 {
            continue;
        }
        best = (origin, target);
        if stage.world.clear(origin, NEAR) && above(stage, origin) {
            break;
        }
    }
    let (origin, target) = best;
    Camera { origin, target, up: [0.0, 1.0, 0.0], fov_x, near: 0.01 }
}

/// True if a place is above the land.
fn above(stage: &Stage<'_>, p: Vec3) -> bool {
    stage.skins.values().flat_map(|s| &s.lands).all(|(land, to_world)| {
        let h = land.relief.height(p[0] - to_world[0][3], p[2] - to_world[2][3]);
        h.is_none_or(|h| p[1] > to_world[1][3] + h + 0.1)
    })
}

fn within(region: &Aabb, d: &mut Stream) -> Vec3 {
    [0, 1, 2].map(|i| d.range(region.low[i], region.high[i]))
}

/// `p` moved into a room, off its walls.
fn clamped(room: &Aabb, p: Vec3) -> Vec3 {
    [0, 1, 2].map(|i| {
        let (low, high) = (room.low[i] + 0.12, room.high[i] - 0.12);
        if low > high { 0.5 * (low + high) } else { p[i].clamp(low, high) }
    })
}
