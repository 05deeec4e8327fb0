//! Cloth: a grid of points that falls, keeps its lengths and stays out of bodies (position-based; Mueller et al. 2007).

use super::{Body, skin};
use tauflow_data::geom::{Vec3, add, length, mul, sub};

/// A cloth in the making.
pub struct Cloth {
    columns: usize,
    rows: usize,
    points: Vec<Vec3>,
    before: Vec<Vec3>,
    fixed: Vec<bool>,
    /// Pairs that keep a distance: near ones exactly, far ones at least by half, which makes it stiff.
    links: Vec<(usize, usize, f64, f64)>,
}

impl Cloth {
    /// A grid over `f(s, t)`, s and t in [0, 1], of rest lengths as it lies; `stiff` in [0, 1] resists bending.
    pub fn new(columns: usize, rows: usize, stiff: f64, f: impl Fn(f64, f64) -> Vec3) -> Self {
        let points: Vec<Vec3> = (0..=rows)
            .flat_map(|j| (0..=columns).map(move |i| (i, j)))
            .map(|(i, j)| f(i as f64 / columns as f64, j as f64 / rows as f64))
            .collect();
        let mut links = Vec::new();
        for j in 0..=rows {
            for i in 0..=columns {
                let at = |i: usize, j: usize| j * (columns + 1) + i;
                let mut link = |other: usize, weight: f64| {
                    links.push((at(i, j), other, length(sub(points[at(i, j)], points[other])), weight));
                };
                if i < columns {
                    link(at(i + 1, j), 1.0);
                }
                if j < rows {
                    link(at(i, j + 1), 1.0);
                }
                if i < columns && j < rows {
                    link(at(i + 1, j + 1), 0.4);
                }
                if i > 0 && j < rows {
                    link(at(i - 1, j + 1), 0.4);
                }
                if i + 2 <= columns {
                    link(at(i + 2, j), stiff);
                }
                if j + 2 <= rows {
                    link(at(i, j + 2), stiff);
                }
            }
        }
        let fixed = vec![false; points.len()];
        Self { columns, rows, before: points.clone(), points, fixed, links }
    }

    /// Fixes the points for which `pinned(s, t)` holds.
    pub fn pinned(mut self, pinned: impl Fn(f64, f64) -> bool) -> Self {
        for j in 0..=self.rows {
            for i in 0..=self.columns {
                let (s, t) = (i as f64 / self.columns as f64, j as f64 / self.rows as f64);
                self.fixed[j * (self.columns + 1) + i] |= pinned(s, t);
            }
        }
        self
    }

    /// Lets it fall for `steps` of 1/60 s; `keep_out` moves a point that is inside something.
    pub fn fallen(mut self, steps: usize, keep_out: impl Fn(Vec3) -> Vec3) -> Self {
        let fall = [0.0, -9.8 / 3600.0, 0.0];
        for _ in 0..steps {
            for k in 0..self.points.len() {
                if !self.fixed[k] {
                    let p = self.points[k];
                    let speed = mul(sub(p, self.before[k]), 0.96);
                    self.before[k] = p;
                    self.points[k] = keep_out(add(p, add(speed, fall)));
                }
            }
            for round in 0..6 {
                for (a, b, rest, weight) in &self.links {
                    let d = sub(self.points[*b], self.points[*a]);
                    let l = length(d).max(1e-9);
                    let free = [self.fixed[*a], self.fixed[*b]].map(|f| if f { 0.0 } else { 1.0 });
                    let total: f64 = free[0] + free[1];
                    if total > 0.0 {
                        let by = mul(d, weight * (l - rest) / l / total);
                        self.points[*a] = add(self.points[*a], mul(by, free[0]));
                        self.points[*b] = sub(self.points[*b], mul(by, free[1]));
                    }
                }
                if round % 3 == 2 {
                    for k in 0..self.points.len() {
                        if !self.fixed[k] {
                            self.points[k] = keep_out(self.points[k]);
                        }
                    }
                }
            }
        }
        self
    }

    /// The cloth as an open sheet, its face on the side of (ds x dt).
    pub fn sheet(&self) -> Body {
        let rings: Vec<Vec<Vec3>> = self.points.chunks(self.columns + 1).map(<[Vec3]>::to_vec).collect();
        skin(&rings, [false, false], [false; 2]).smooth()
    }
}
