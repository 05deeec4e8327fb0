//! Arranging things: scattered, in rows, in piles, round tables, along walls, hung, and the main object.

use super::{
    place::{GAP, Surface, Turn},
    props::{Ask, Pick, ask},
    shell::Wall,
    stage::{Rest, Stage},
};
use core::f64::consts::{PI, TAU};
use tauflow_data::Regime;
use tauflow_scene_library::forms::Family;

impl<'a> Stage<'a> {
    /// Puts a thing anywhere on a surface, turned by within `yaw`.
    pub fn drop(&mut self, pick: &Pick<'a>, on: &Surface, yaw: [f64; 2]) -> Option<usize> {
        let mut d = self.next();
        for _ in 0..24 {
            let at = [d.range(-on.half[0], on.half[0]), d.range(-on.half[1], on.half[1])];
            if let Some(thing) = self.put(pick, on, at, d.range(yaw[0], yaw[1])) {
                return Some(thing);
            }
        }
        None
    }

    /// Puts things of these asks anywhere on a surface; gives their numbers.
    pub fn scatter(&mut self, on: &Surface, asks: &[Ask], n: usize, yaw: [f64; 2]) -> Vec<usize> {
        let mut out = Vec::new();
        for _ in 0..n {
            if self.left() == 0 {
                break;
            }
            let ask = *self.next().pick(asks);
            let Some(pick) = self.pick(&ask) else { continue };
            out.extend(self.drop(&pick, on, yaw));
        }
        out
    }

    /// The same thing many times: things of one form and one material.
    pub fn repeat(&mut self, ask: &Ask, on: &Surface, n: usize, yaw: [f64; 2]) -> Vec<usize> {
        let Some(pick) = self.pick(ask) else { return Vec::new() };
        (0..n).filter_map(|_| self.drop(&pick, on, yaw)).collect()
    }

    /// A row along a surface's x, from its left end, `deep` from -1 (back) to 1 (front), until a share of it is full.
    pub fn row(&mut self, on: &Surface, asks: &[Ask], gap: [f64; 2], deep: f64, share: f64) -> Vec<usize> {
        let mut out = Vec::new();
        let mut d = self.next();
        let mut x = -on.half[0] + 0.004;
        let end = on.half[0] * (2.0 * share - 1.0);
        let mut misses = 0;
        while self.left() > 0 && misses < 4 {
            let ask = *d.pick(asks);
            let placed = self.pick(&ask).and_then(|pick| {
                let (width, depth) = (pick.size[0], pick.size[2]);
                if x + width > end {
                    return None;
                }
                let room = (on.half[1] - 0.5 * depth - 0.004).max(0.0);
                let thing = self.put(&pick, on, [x + 0.5 * width, deep * room], 0.0)?;
                x += width + d.range(gap[0], gap[1]);
                Some(thing)
            });
            match placed {
                Some(thing) => out.push(thing),
                None => misses += 1,
            }
        }
        out
    }

    /// A pile of flat things; gives their numbers from below.
    pub fn pile(&mut self, on: &Surface, ask: &Ask, at: [f64; 2], n: usize) -> Vec<usize> {
        let mut out: Vec<usize> = Vec::new();
        let mut d = self.next();
        let yaw = d.range(-0.4, 0.4);
        for _ in 0..2 * n {
            if out.len() == n {
                break;
            }
            let Some(pick) = self.pick(ask) else { break };
            let placed = match out.last() {
                None => self.put(&pick, on, at, yaw),
                Some(below) => match self.lid(*below) {
                    // Onto the middle of what lies there, if it is no larger.
                    Some(lid) => self.put(&pick, &lid, [0.0; 2], d.range(-0.1, 0.1)),
                    None => None,
                },
            };
            match placed {
                Some(thing) => out.push(thing),
                None if out.is_empty() => break,
                None => {}
            }
        }
        out
    }

    /// Seats round a table, of one form, facing it, pushed in as far as they go.
    pub fn around(&mut self, table: usize, seat: &Ask, n: usize, floor: &Surface) -> Vec<usize> {
        let Some(top) = self.top(table) else { return Vec::new() };
        let Some(pick) = self.pick(seat) else { return Vec::new() };
        let long = top.half[0] >= top.half[1];
        // Sides as unit vectors of the table's frame: the long ones first, then the ends.
        let (sides, ends) = if long {
            ([[0.0, 1.0], [0.0, -1.0]], [[1.0, 0.0], [-1.0, 0.0]])
        } else {
            ([[1.0, 0.0], [-1.0, 0.0]], [[0.0, 1.0], [0.0, -1.0]])
        };
        let along = top.half[0].max(top.half[1]);
        let fits = ((2.0 * along) / (pick.size[0] + 0.08)).floor().max(1.0) as usize;
        let per = n.div_ceil(2).min(fits);
        let mut seats: Vec<([f64; 2], f64)> = Vec::new();
        for i in 0..per {
            for side in sides {
                seats.push((side, along * ((2 * i + 1) as f64 / per as f64 - 1.0)));
            }
        }
        seats.extend(ends.map(|side| (side, 0.0)));
        let mut out = Vec::new();
        for (side, shift) in seats.into_iter().take(n) {
            let across = [side[1].abs(), side[0].abs()];
            let edge = top.half[0] * side[0].abs() + top.half[1] * side[1].abs();
            let jitter = self.any(-0.06, 0.06);
            let face = Turn::toward([-side[0], -side[1]]).after(top.turn);
            let turn = Turn::new(jitter * 2.0).after(face);
            for step in 0..30 {
                let far = edge + 0.5 * pick.size[2] - 0.3 + 0.04 * f64::from(step) + 0.5 * jitter.abs();
                let local = [side[0] * far + across[0] * shift, side[1] * far + across[1] * shift];
                let [x, _, z] = top.point(local);
                if let Some(thing) = self.put_at(&pick, floor, [x, z], turn) {
                    out.push(thing);
                    break;
                }
            }
        }
        out
    }

    /// A thing on the floor with its back to a wall, its middle within `along` (metres from the wall's middle).
    pub fn against(&mut self, wall: &Wall, floor: &Surface, ask: &Ask, along: [f64; 2]) -> Option<usize> {
        let pick = self.pick(ask)?;
        self.back_to(wall, floor, &pick, along)
    }

    /// As [`Stage::against`], for something chosen already.
    pub fn back_to(&mut self, wall: &Wall, floor: &Surface, pick: &Pick<'a>, along: [f64; 2]) -> Option<usize> {
        let mut d = self.next();
        let most = 0.5 * (wall.length - pick.size[0]) - 0.01;
        for _ in 0..16 {
            let s = d.range(along[0], along[1]).clamp(-most.max(0.0), most.max(0.0));
            let out = 0.5 * pick.size[2] + d.range(0.012, 0.05);
            let p = wall.point(s, 0.0, out);
            if wall.hides(s, pick.size[0], pick.size[1], 0.0) {
                continue;
            }
            if let Some(thing) = self.put_at(pick, floor, [p[0], p[2]], wall.turn) {
                return Some(thing);
            }
        }
        None
    }

    /// A thing that hangs on a wall: its middle within `along`, its lower edge at a height within `height`.
    pub fn on_wall(&mut self, wall: &Wall, ask: &Ask, along: [f64; 2], height: [f64; 2]) -> Option<usize> {
        let pick = self.pick(ask)?;
        self.hang_on(wall, &pick, along, height, false)
    }

    /// As [`Stage::on_wall`], for something chosen already; `over` lets it hang before a window.
    pub fn hang_on(
        &mut self,
        wall: &Wall,
        pick: &Pick<'a>,
        along: [f64; 2],
        height: [f64; 2],
        over: bool,
    ) -> Option<usize> {
        let mut d = self.next();
        let most = (0.5 * (wall.length - pick.size[0]) - 0.02).max(0.0);
        for _ in 0..12 {
            let s = d.range(along[0], along[1]).clamp(-most, most);
            let y = d.range(height[0], height[1]).min(wall.height - pick.size[1] - 0.02);
            if y < 0.0 || (!over && wall.hides(s, pick.size[0], pick.size[1], y)) {
                continue;
            }
            let at = wall.point(s, y, 0.5 * pick.size[2] + GAP);
            if let Some(thing) = self.settle(pick, at, wall.turn, Rest::Wall) {
                return Some(thing);
            }
        }
        None
    }

    /// A thing that hangs from a ceiling at height `y` over a place of the world.
    pub fn hang(&mut self, ask: &Ask, at: [f64; 2], y: f64, yaw: f64) -> Option<usize> {
        let pick = self.pick(ask)?;
        self.hang_pick(&pick, at, y, yaw)
    }

    /// As [`Stage::hang`], for something chosen already.
    pub fn hang_pick(&mut self, pick: &Pick<'a>, at: [f64; 2], y: f64, yaw: f64) -> Option<usize> {
        self.settle(pick, [at[0], y - pick.size[1] - GAP, at[1]], Turn::new(yaw), Rest::Hangs)
    }

    /// The scene's main object and what shows the regime beside it, on a surface; `size` is the longest side.
    ///
    /// The main object is the asset whose turn it is, or a form of these families. In L2 and L3 at least one thing of
    /// glass or a mirror comes beside it, if it is not of that itself.
    pub fn main(&mut self, on: &Surface, families: &[Family], size: [f64; 2]) -> Option<usize> {
        self.most += core::mem::take(&mut self.kept);
        let mut d = self.next();
        let high = [3.0 * on.half[0], on.clearance, 3.0 * on.half[1]];
        let mut thing = None;
        for attempt in 0..20 {
            let shrink = if attempt < 4 {
                1.0
            } else if attempt < 10 {
                0.75
            } else if attempt < 15 {
                0.5
            } else {
                0.3
            };
            let longest = d.range(size[0], size[1]) * shrink;
            let pick = match self.cast.turn() {
                Some(asset) if !self.has_main => Some(self.asset(asset, longest, high)),
                _ => {
                    let family = if attempt < 6 { *d.pick(families) } else { Family::Solid };
                    let mut ask = ask(family);
                    ask.high = high;
                    ask.glass = self.glassy() && (attempt % 2 == 0 || self.left() < 2);
                    // Things far from the requested size are scaled.
                    ask.longest = Some([longest, longest]);
                    self.pick(&ask)
                }
            };
            let Some(mut pick) = pick else { continue };
            self.decide(&mut pick, true);
            let spot = if attempt < 3 { on.part([-0.4, 0.4], [-0.4, 0.4]) } else { on.clone() };
            let middle = Surface { half: on.half, ..on.clone() };
            let mut at = [d.range(-spot.half[0], spot.half[0]), d.range(-spot.half[1], spot.half[1])];
            if attempt % 3 == 2 {
                at = [0.0; 2];
            }
            thing = self.put(&pick, &middle, at, d.range(0.0, TAU));
            if thing.is_some() {
                break;
            }
        }
        self.has_main |= thing.is_some();
        if let Some(thing) = thing {
            self.things[thing].main = true;
        }
        let shows = |s: &Self| s.things.iter().any(|t| t.glass);
        if self.glassy() {
            let wanted = 1 + d.below(if self.stratum.regime == Regime::L3 { 5 } else { 3 });
            let mut got = usize::from(thing.is_some_and(|t| self.things[t].glass));
            for attempt in 0..16 {
                if got >= wanted && shows(self) {
                    break;
                }
                let family = *d.pick(&[Family::Vessel, Family::Solid, Family::Ornament, Family::Solid]);
                let shrink = if attempt < 6 { 1.0 } else { 0.5 };
                let mut ask = ask(family).scaled(0.3 * size[0] * shrink, 0.8 * size[1] * shrink);
                ask.high = high;
                ask.glass = true;
                let Some(mut pick) = self.pick(&ask) else { continue };
                self.decide(&mut pick, true);
                if let Some(shown) = self.drop(&pick, on, [-PI, PI]) {
                    self.things[shown].main = true;
                    got += 1;
                }
            }
        }
        thing
    }
}
