//! Where things can go: flat places and reliefs to stand on, and what would be in the way.
//!
//! Knows boxes only: upright ones, turned about the vertical. Everything in metres.

use std::sync::Arc;
use tauflow_data::{
    geom::{Aabb, Vec3},
    maths,
    scene::Affine,
};
use tauflow_scene_library::Relief;

/// Air between things that touch. Surfaces in one place are met in an order that rounding decides, and renderers that
/// move rays off surfaces by fixed steps see light where bodies touch.
pub const GAP: f64 = 1e-3;

/// By how much a board ends short of what it meets. Two boards that meet leave [`GAP`] between them.
pub const SEAM: f64 = 0.5 * GAP;

/// How deep boxes may stand in each other before they count as overlapping.
pub const TOLERANCE: f64 = 5e-4;

/// Rounded to a tenth of a millimetre, which keeps scene files small.
pub fn tenth(v: f64) -> f64 {
    (v * 1e4).round() / 1e4
}

/// A turn about +y, +z towards +x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// Cosine, to six decimals.
    pub cos: f64,
    /// Sine, to six decimals.
    pub sin: f64,
}

impl Turn {
    /// No turn.
    pub const NONE: Self = Self { cos: 1.0, sin: 0.0 };

    /// A turn by an angle in radians.
    pub fn new(angle: f64) -> Self {
        let six = |v: f64| (v * 1e6).round() / 1e6 + 0.0;
        Self { cos: six(maths::cos(angle)), sin: six(maths::sin(angle)) }
    }

    /// The turn that takes +z to `toward`.
    pub fn toward(toward: [f64; 2]) -> Self {
        let l = (toward[0] * toward[0] + toward[1] * toward[1]).sqrt();
        if l < 1e-9 {
            return Self::NONE;
        }
        let six = |v: f64| (v * 1e6).round() / 1e6 + 0.0;
        Self { cos: six(toward[1] / l), sin: six(toward[0] / l) }
    }

    /// `self` after `first`.
    pub fn after(self, first: Self) -> Self {
        let six = |v: f64| (v * 1e6).round() / 1e6 + 0.0;
        Self {
            cos: six(self.cos * first.cos - self.sin * first.sin),
            sin: six(self.sin * first.cos + self.cos * first.sin),
        }
    }

    /// A point `[x, z]` turned.
    pub fn apply(self, [x, z]: [f64; 2]) -> [f64; 2] {
        [self.cos * x + self.sin * z, self.cos * z - self.sin * x]
    }

    /// A point `[x, z]` turned back.
    pub fn back(self, [x, z]: [f64; 2]) -> [f64; 2] {
        [self.cos * x - self.sin * z, self.cos * z + self.sin * x]
    }

    /// The map that turns and then moves to `at`.
    pub fn map(self, at: Vec3) -> Affine {
        [[self.cos, 0.0, self.sin, at[0]], [0.0, 1.0, 0.0, at[1]], [0.0 - self.sin, 0.0, self.cos, at[2]]]
    }
}

/// An upright box, turned.
#[derive(Clone, Copy, Debug)]
pub struct Solid {
    /// Bottom and top.
    pub y: [f64; 2],
    /// Middle, `[x, z]`.
    pub at: [f64; 2],
    /// Its turn.
    pub turn: Turn,
    /// Half sizes along its own x and z.
    pub half: [f64; 2],
}

impl Solid {
    /// A box given in a thing's own frame, where that thing stands.
    pub fn of(local: &Aabb, turn: Turn, at: Vec3) -> Self {
        let (c, s) = (local.center(), local.size());
        let [x, z] = turn.apply([c[0], c[2]]);
        Self {
            y: [local.low[1] + at[1], local.high[1] + at[1]],
            at: [x + at[0], z + at[2]],
            turn,
            half: [0.5 * s[0], 0.5 * s[2]],
        }
    }

    fn reach(&self, axis: [f64; 2]) -> f64 {
        let x = self.turn.cos * axis[0] - self.turn.sin * axis[1];
        let z = self.turn.sin * axis[0] + self.turn.cos * axis[1];
        self.half[0] * x.abs() + self.half[1] * z.abs()
    }

    /// How deep two boxes stand in each other: the least move that parts them; below 0 if they are apart.
    pub fn depth(&self, other: &Self) -> f64 {
        let mut depth = (self.y[1] - other.y[0]).min(other.y[1] - self.y[0]);
        if depth <= 0.0 {
            return depth;
        }
        let d = [other.at[0] - self.at[0], other.at[1] - self.at[1]];
        for turn in [self.turn, other.turn] {
            for axis in [[turn.cos, -turn.sin], [turn.sin, turn.cos]] {
                let apart = (d[0] * axis[0] + d[1] * axis[1]).abs();
                depth = depth.min(self.reach(axis) + other.reach(axis) - apart);
                if depth <= 0.0 {
                    return depth;
                }
            }
        }
        depth
    }

    /// True if a point lies in the box or nearer to it than `margin`.
    pub fn contains(&self, p: Vec3, margin: f64) -> bool {
        let [x, z] = self.turn.back([p[0] - self.at[0], p[2] - self.at[1]]);
        p[1] > self.y[0] - margin
            && p[1] < self.y[1] + margin
            && x.abs() < self.half[0] + margin
            && z.abs() < self.half[1] + margin
    }

    /// Its middle and half sizes along the world's axes.
    pub fn bounds(&self) -> Aabb {
        let (x, z) = (self.reach([1.0, 0.0]), self.reach([0.0, 1.0]));
        Aabb { low: [self.at[0] - x, self.y[0], self.at[1] - z], high: [self.at[0] + x, self.y[1], self.at[1] + z] }
    }
}

/// Everything that stands in the way.
#[derive(Default)]
pub struct World {
    /// The boxes of what is there.
    pub solids: Vec<Solid>,
    /// Boxes that are to stay empty.
    pub keep: Vec<Solid>,
}

impl World {
    /// True if boxes can stand there.
    pub fn free(&self, boxes: &[Solid]) -> bool {
        let all = || self.solids.iter().chain(&self.keep);
        boxes.iter().all(|b| all().all(|s| s.depth(b) <= TOLERANCE))
    }

    /// True if a point lies in nothing, and not nearer than `margin`.
    pub fn clear(&self, p: Vec3, margin: f64) -> bool {
        self.solids.iter().all(|s| !s.contains(p, margin))
    }
}

/// A place to stand on.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Middle of the flat place; of a relief, where its height is 0.
    pub center: Vec3,
    /// Its turn.
    pub turn: Turn,
    /// Half sizes along its own x and z.
    pub half: [f64; 2],
    /// Free height above.
    pub clearance: f64,
    /// The relief, if it is not flat.
    pub relief: Option<Arc<Relief>>,
}

impl Surface {
    /// A flat place along the world's axes.
    pub fn flat(center: Vec3, half: [f64; 2], clearance: f64) -> Self {
        Self { center, turn: Turn::NONE, half, clearance, relief: None }
    }

    /// The world's place of `[u, v]`, metres from its middle along its own x and z.
    pub fn point(&self, at: [f64; 2]) -> Vec3 {
        let [x, z] = self.turn.apply(at);
        [self.center[0] + x, self.center[1], self.center[2] + z]
    }

    /// A part of it, by shares of its sides from -1 to 1.
    pub fn part(&self, u: [f64; 2], v: [f64; 2]) -> Self {
        let middle = [0.5 * (u[0] + u[1]) * self.half[0], 0.5 * (v[0] + v[1]) * self.half[1]];
        let half = [0.5 * (u[1] - u[0]) * self.half[0], 0.5 * (v[1] - v[0]) * self.half[1]];
        Self { center: self.point(middle), half, ..self.clone() }
    }

    /// The same without a margin at its edges.
    pub fn inset(&self, margin: f64) -> Self {
        Self { half: self.half.map(|h| (h - margin).max(0.01)), ..self.clone() }
    }

    /// Its box, up to its clearance or 2 m.
    pub fn bounds(&self, height: f64) -> Aabb {
        let solid = Solid {
            y: [self.center[1], self.center[1] + height],
            at: [self.center[0], self.center[2]],
            turn: self.turn,
            half: self.half,
        };
        solid.bounds()
    }

    /// Lowest and highest ground under a rectangle of the world; none where there is no ground.
    pub fn ground(&self, at: [f64; 2], turn: Turn, half: [f64; 2]) -> Option<[f64; 2]> {
        let Some(relief) = &self.relief else { return Some([self.center[1]; 2]) };
        let mut span = [f64::INFINITY, f64::NEG_INFINITY];
        for i in -2..=2 {
            for j in -2..=2 {
                let [x, z] = turn.apply([half[0] * f64::from(i) * 0.5, half[1] * f64::from(j) * 0.5]);
                let h = self.center[1] + relief.height(at[0] + x, at[1] + z)?;
                span = [span[0].min(h), span[1].max(h)];
            }
        }
        Some(span)
    }

    /// True if a rectangle of the world lies on it.
    pub fn holds(&self, at: [f64; 2], turn: Turn, half: [f64; 2]) -> bool {
        let own = Solid { y: [0.0, 1.0], at: [self.center[0], self.center[2]], turn: self.turn, half: self.half };
        let rect = Solid { y: [0.0, 1.0], at, turn, half };
        let d = [at[0] - own.at[0], at[1] - own.at[1]];
        [([own.turn.cos, -own.turn.sin], own.half[0]), ([own.turn.sin, own.turn.cos], own.half[1])]
            .iter()
            .all(|(axis, half)| (d[0] * axis[0] + d[1] * axis[1]).abs() + rect.reach(*axis) <= half + 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solid(at: [f64; 2], angle: f64) -> Solid {
        Solid { y: [0.0, 1.0], at, turn: Turn::new(angle), half: [1.0, 0.5] }
    }

    #[test]
    fn boxes_meet_where_they_do() {
        assert!((solid([0.0, 0.0], 0.0).depth(&solid([1.9, 0.0], 0.0)) - 0.1).abs() < 1e-9);
        assert!(solid([0.0, 0.0], 0.0).depth(&solid([2.1, 0.0], 0.0)) < 0.0);
        // Turned by a quarter, its long side lies along z.
        assert!(solid([0.0, 0.0], 0.0).depth(&solid([1.6, 0.0], core::f64::consts::FRAC_PI_2)) < 0.0);
        assert!(solid([0.0, 0.0], 0.0).depth(&solid([0.0, 1.4], core::f64::consts::FRAC_PI_2)) > 0.09);
        // Corner to side: bounding boxes overlap, the boxes do not.
        assert!(solid([0.0, 0.0], 0.0).depth(&solid([1.75, 1.0], core::f64::consts::FRAC_PI_4)) < 0.0);
        assert!(solid([0.0, 0.0], 0.3).contains([0.5, 0.5, -0.1], 0.0));
    }

    #[test]
    fn surfaces_hold_what_lies_on_them() {
        let top = Surface { turn: Turn::new(0.7), ..Surface::flat([1.0, 0.8, 2.0], [0.6, 0.4], 1.0) };
        let [x, _, z] = top.point([0.5, 0.3]);
        assert!(top.holds([x, z], top.turn, [0.09, 0.09]));
        assert!(!top.holds([x, z], top.turn, [0.11, 0.09]));
        let relief = Relief { cells: 1, half: 1.0, heights: vec![0.0, 1.0, 0.0, 1.0] };
        let sloped = Surface { relief: Some(Arc::new(relief)), ..Surface::flat([0.0; 3], [1.0; 2], 9.0) };
        assert_eq!(sloped.ground([0.0, 0.0], Turn::NONE, [0.5, 0.5]), Some([0.25, 0.75]));
        assert_eq!(sloped.ground([0.9, 0.0], Turn::NONE, [0.5, 0.5]), None);
    }
}
