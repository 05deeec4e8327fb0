//! Branching growth, as L-systems make it, and the leaves it carries (Prusinkiewicz and Lindenmayer 1990).

use super::{Body, TAU, tube};
use tauflow_data::geom::{Vec3, add, cross, mul, unit};
use tauflow_data::{maths, rng::Stream};

/// How a plant branches.
#[derive(Clone, Copy, Debug)]
pub struct Growth {
    /// How many times branches branch again.
    pub levels: usize,
    /// Branches of each branch.
    pub children: usize,
    /// Length of a child by that of its parent.
    pub shorter: f64,
    /// Radius of a child by that of its parent.
    pub thinner: f64,
    /// Angle between a child and its parent, radians.
    pub angle: f64,
    /// From where on a branch children grow, as a share of it.
    pub from: f64,
    /// How much branches bend at random, and (with its sign) up or down.
    pub bend: f64,
    /// Pull upwards, or downwards where negative.
    pub lift: f64,
}

/// The grown tree: the wood, and the positions of leaves.
pub struct Branching {
    /// Trunk and branches.
    pub wood: Body,
    /// Points on the youngest branches with the direction they grow in.
    pub buds: Vec<(Vec3, Vec3)>,
}

impl Branching {
    /// Grows from `root` along `way`, for `length` metres at first, of `radius`; `buds` leaves on each last branch.
    pub fn grown(
        d: &mut Stream,
        growth: &Growth,
        root: Vec3,
        way: Vec3,
        length: f64,
        radius: f64,
        buds: usize,
    ) -> Self {
        let mut out = Self { wood: Body::default(), buds: Vec::new() };
        out.branch(d, growth, 0, root, unit(way), length, radius, buds);
        out
    }

    #[expect(clippy::too_many_arguments, reason = "the state of a turtle")]
    fn branch(
        &mut self,
        d: &mut Stream,
        growth: &Growth,
        level: usize,
        root: Vec3,
        way: Vec3,
        length: f64,
        radius: f64,
        buds: usize,
    ) {
        let steps = if level == 0 {
            8
        } else if level == 1 {
            5
        } else {
            3
        };
        let mut path = vec![root];
        let mut ways = vec![way];
        let (mut p, mut w) = (root, way);
        for _ in 0..steps {
            let wild = [0; 3].map(|_: i32| d.range(-1.0, 1.0) * growth.bend);
            let lift = if level == 0 { 0.0 } else { growth.lift };
            w = unit(add(w, add(wild, [0.0, lift, 0.0])));
            p = add(p, mul(w, length / steps as f64));
            path.push(p);
            ways.push(w);
        }
        let last = level == growth.levels;
        let end = if last { 0.3 } else { growth.thinner.max(0.45) };
        let sides = [10, 6, 4, 3][level.min(3)];
        let body = tube(&path, sides, |t| radius * (1.0 + (end - 1.0) * t)).smooth();
        self.wood = core::mem::take(&mut self.wood).smooth().with(body);
        let along = |t: f64| {
            let x = t * steps as f64;
            let k = (x as usize).min(steps - 1);
            let f = x - k as f64;
            (add(mul(path[k], 1.0 - f), mul(path[k + 1], f)), ways[k + 1])
        };
        if last {
            for k in 0..buds {
                let t = (k as f64 + d.range(0.3, 1.0)) / buds as f64;
                let (p, w) = along(t.min(1.0));
                self.buds.push((p, aside(w, d.range(0.0, TAU), d.range(0.5, 1.3))));
            }
            return;
        }
        let phase = d.range(0.0, TAU);
        for k in 0..growth.children {
            let share = if growth.children > 1 { k as f64 / (growth.children - 1) as f64 } else { 1.0 };
            let t = growth.from + (1.0 - growth.from) * share;
            let (p, w) = along(t);
            // The golden angle between one child and the next.
            let turn = phase + 2.399_963 * k as f64 + d.range(-0.3, 0.3);
            let way = aside(w, turn, growth.angle * d.range(0.75, 1.25));
            let size = d.range(0.8, 1.2) * (1.15 - 0.45 * share);
            let thin = radius * growth.thinner * (1.1 - 0.3 * share);
            self.branch(d, growth, level + 1, p, way, length * growth.shorter * size, thin, buds);
        }
    }
}

/// The direction at `angle` from `way`, turned about it by `turn`.
fn aside(way: Vec3, turn: f64, angle: f64) -> Vec3 {
    let s = unit(cross(if way[1].abs() > 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }, way));
    let t = cross(way, s);
    let side = add(mul(s, maths::cos(turn)), mul(t, maths::sin(turn)));
    unit(add(mul(way, maths::cos(angle)), mul(side, maths::sin(angle))))
}

/// A leaf at `root` along `way`, folded along its middle and drooping by `droop` of its length; six triangles.
pub fn leaf(root: Vec3, way: Vec3, size: [f64; 2], droop: f64) -> Body {
    let [length, width] = size;
    let side = unit(cross([0.0, 1.0, 0.0], add(way, [1e-4, 0.0, 2e-4])));
    let up = unit(cross(way, side));
    let mut body = Body::default().smooth();
    let mut add_point = |t: f64, s: f64| {
        let rise = 0.18 * s.abs() * width;
        let p = add(root, add(mul(way, t * length), add(mul(side, s * width), mul(up, rise))));
        body.point([p[0], p[1] - droop * length * t * t, p[2]], [s * width, -t * length])
    };
    let base = add_point(0.0, 0.0);
    let rows = [(0.3, 0.42), (0.65, 0.4)].map(|(t, s)| [add_point(t, -s), add_point(t, 0.0), add_point(t, s)]);
    let tip = add_point(1.0, 0.0);
    // Seen from above, the way points up the page and the side to the left.
    let [[l0, m0, r0], [l1, m1, r1]] = rows;
    body.triangles.extend([[base, m0, l0], [base, r0, m0], [m1, tip, r1], [l1, tip, m1]].map(|t| [t[0], t[2], t[1]]));
    body.triangles.extend([[l0, m0, m1], [l0, m1, l1], [m0, r0, r1], [m0, r1, m1]]);
    body
}

/// A small leaf of two triangles, folded along its middle.
pub fn small_leaf(root: Vec3, way: Vec3, size: [f64; 2], droop: f64) -> Body {
    let [length, width] = size;
    let side = unit(cross([0.0, 1.0, 0.0], add(way, [1e-4, 0.0, 2e-4])));
    let up = unit(cross(way, side));
    let mut body = Body::default();
    let mut add_point = |t: f64, s: f64| {
        let p = add(root, add(mul(way, t * length), add(mul(side, s * width), mul(up, 0.3 * s.abs() * width))));
        body.point([p[0], p[1] - droop * length * t * t, p[2]], [s * width, -t * length])
    };
    let ids = [add_point(0.0, 0.0), add_point(0.5, 0.5), add_point(1.0, 0.0), add_point(0.5, -0.5)];
    body.quad(ids);
    body
}

/// A blade of grass or a strap leaf: rises along `way`, bends over by `droop`, narrows to a point.
pub fn blade(root: Vec3, way: Vec3, size: [f64; 2], droop: f64, steps: usize) -> Body {
    let [length, width] = size;
    let side = unit(cross([0.0, 1.0, 0.0], add(way, [1e-3, 0.0, 2e-3])));
    let mut body = Body::default().smooth();
    for k in 0..steps {
        let t = k as f64 / steps as f64;
        let half = 0.5 * width * (1.0 - t * t) * (0.7 + 0.6 * t * (1.0 - t));
        let p = add(root, mul(way, t * length));
        let p = [p[0], p[1] - droop * length * t * t, p[2]];
        body.point(add(p, mul(side, -half)), [-half, -t * length]);
        body.point(add(p, mul(side, half)), [half, -t * length]);
    }
    let p = add(root, mul(way, length));
    let tip = body.point([p[0], p[1] - droop * length, p[2]], [0.0, -length]);
    for k in 0..steps as u32 - 1 {
        body.quad([2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2]);
    }
    body.triangles.push([tip - 2, tip - 1, tip]);
    body
}
