//! Choosing things and putting them in their places.
//!
//! Every way of placing ends in one check: a thing rests on its support, and its boxes stand in nobody's.

use super::{
    cast::shown,
    place::{GAP, Solid, Surface, Turn},
    stage::{Body, Rest, Stage, Thing},
};
use tauflow_data::{
    geom::{Aabb, Vec3, apply, compose, translation},
    records::{Asset, AssetBody},
    scene::Affine,
};
use tauflow_scene_library::{
    facts,
    forms::{Family, Form},
};

/// How a thing is turned over before it is put down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stance {
    /// As it was made.
    AsMade,
    /// On its flattest side, its longest along x.
    Lying,
    /// Longest side up, thinnest along x: a book on a shelf.
    Upright,
}

/// A request: a family, sizes in metres, a stance.
#[derive(Clone, Copy, Debug)]
pub struct Ask {
    /// The family.
    pub family: Family,
    /// Names, any of which will do; all if empty, or if the scene may use none of these.
    pub names: &'static [&'static str],
    /// Smallest width, height and depth.
    pub low: Vec3,
    /// Largest width, height and depth.
    pub high: Vec3,
    /// The stance.
    pub stance: Stance,
    /// Its longest side, to which it is scaled; as made if none.
    pub longest: Option<[f64; 2]>,
    /// Only what glass suits.
    pub glass: bool,
}

/// Asks for a family.
pub const fn ask(family: Family) -> Ask {
    Ask { family, names: &[], low: [0.0; 3], high: [100.0; 3], stance: Stance::AsMade, longest: None, glass: false }
}

impl Ask {
    /// Forms of one of these names, if there are any.
    pub const fn named(self, names: &'static [&'static str]) -> Self {
        Self { names, ..self }
    }

    /// Largest width, height and depth.
    pub const fn most(self, width: f64, height: f64, depth: f64) -> Self {
        Self { high: [width, height, depth], ..self }
    }

    /// Smallest width, height and depth.
    pub const fn least(self, width: f64, height: f64, depth: f64) -> Self {
        Self { low: [width, height, depth], ..self }
    }

    /// On its flattest side.
    pub const fn lying(self) -> Self {
        Self { stance: Stance::Lying, ..self }
    }

    /// On end.
    pub const fn upright(self) -> Self {
        Self { stance: Stance::Upright, ..self }
    }

    /// Scaled so that its longest side is within a range.
    pub const fn scaled(self, low: f64, high: f64) -> Self {
        Self { longest: Some([low, high]), ..self }
    }
}

/// Something chosen, ready to be put down.
#[derive(Clone)]
pub struct Pick<'a> {
    body: Body<'a>,
    /// Takes it to its stance, foot on y = 0, x and z centred.
    local: Affine,
    /// Width, height and depth in its stance.
    pub size: Vec3,
    solids: Vec<Aabb>,
    /// Its base: centre and half sizes.
    foot: ([f64; 2], [f64; 2]),
    special: bool,
    glass: bool,
    set: u32,
}

/// The axes that end up as x, y and z, and their signs: the six ways to turn a box over.
const WAYS: [[(usize, f64); 3]; 6] = [
    [(0, 1.0), (1, 1.0), (2, 1.0)],
    [(0, 1.0), (2, -1.0), (1, 1.0)],
    [(1, -1.0), (0, 1.0), (2, 1.0)],
    [(2, 1.0), (1, 1.0), (0, -1.0)],
    [(1, 1.0), (2, -1.0), (0, -1.0)],
    [(2, 1.0), (0, 1.0), (1, 1.0)],
];

/// The box of an object; empty for an HDRI.
fn box_of(asset: &Asset) -> Aabb {
    match &asset.body {
        AssetBody::Hdri { .. } => Aabb::EMPTY,
        AssetBody::Object { bounds: [low, high], .. } => Aabb { low: *low, high: *high },
    }
}

/// A pick of a body in a stance, before it is known how it is used.
fn pose<'a>(body: Body<'a>, bounds: &Aabb, solids: &[Aabb], stance: Stance, scale: f64) -> Pick<'a> {
    let size = bounds.size();
    let way = match stance {
        Stance::AsMade => WAYS[0],
        Stance::Lying | Stance::Upright => *WAYS
            .iter()
            .max_by(|a, b| {
                let worth = |w: &[(usize, f64); 3]| {
                    let s = [size[w[0].0], size[w[1].0], size[w[2].0]];
                    if stance == Stance::Lying { s[0] - s[1] } else { s[1] - s[0] }
                };
                // The first of equals wins, so that what is right already stays.
                worth(a).total_cmp(&worth(b)).then(core::cmp::Ordering::Greater)
            })
            .expect("six ways"),
    };
    let mut turned = [[0.0; 4]; 3];
    for (row, (axis, sign)) in turned.iter_mut().zip(way) {
        row[axis] = sign * scale;
    }
    let b = bounds.mapped(&turned);
    let shift = [-0.5 * (b.low[0] + b.high[0]), -b.low[1], -0.5 * (b.low[2] + b.high[2])];
    let local = compose(&translation(shift), &turned);
    let solids: Vec<Aabb> = solids.iter().map(|s| s.mapped(&local)).collect();
    let bounds = bounds.mapped(&local);
    let mut foot = Aabb::EMPTY;
    for s in solids.iter().filter(|s| s.low[1] < 0.03) {
        foot = foot.union(s);
    }
    if foot.low[0] > foot.high[0] {
        foot = bounds;
    }
    let (c, h) = (foot.center(), foot.size());
    Pick {
        body,
        local,
        size: bounds.size(),
        solids,
        foot: ([c[0], c[2]], [0.5 * h[0], 0.5 * h[2]]),
        special: false,
        glass: false,
        set: 0,
    }
}

impl<'a> Stage<'a> {
    /// Chooses a thing; none if no form of the library that the scene may use fits.
    pub fn pick(&mut self, ask: &Ask) -> Option<Pick<'a>> {
        let mut d = self.next();
        let all = self.cast.forms(|f| f.family == ask.family && (f.glass || !ask.glass));
        let named: Vec<&'static Form> = all.iter().filter(|f| ask.names.contains(&f.name)).copied().collect();
        let forms = if named.is_empty() { all } else { named };
        if forms.is_empty() {
            return None;
        }
        for _ in 0..12 {
            let form = forms[d.below(forms.len())];
            let variant = self.cast.variant(form, &mut d);
            let made = match facts(form, variant) {
                Ok(made) => made,
                Err(fault) => {
                    self.fault.get_or_insert(fault);
                    return None;
                }
            };
            let size = made.bounds.size();
            let scale = match ask.longest {
                Some([low, high]) => d.range(low, high) / size[0].max(size[1]).max(size[2]),
                None => 1.0,
            };
            let mut pick = pose(Body::Form(made.clone()), &made.bounds, &made.solids, ask.stance, scale);
            if (0..3).any(|i| pick.size[i] < ask.low[i] || pick.size[i] > ask.high[i]) {
                continue;
            }
            if shown(ask.family)
                && let Some(asset) = self.cast.stand_in(&mut d)
            {
                let longest = pick.size[0].max(pick.size[1]).max(pick.size[2]);
                pick = self.asset(asset, longest, ask.high);
            }
            self.decide(&mut pick, d.part("special").chance(0.5));
            return Some(pick);
        }
        None
    }

    /// An asset of a size, no larger than `high`.
    pub(super) fn asset(&mut self, asset: &'a Asset, longest: f64, high: Vec3) -> Pick<'a> {
        let bounds = box_of(asset);
        let size = bounds.size();
        let mut scale = longest / size[0].max(size[1]).max(size[2]).max(1e-9);
        for i in 0..3 {
            scale = scale.min(high[i] / size[i].max(1e-9));
        }
        pose(Body::Asset(asset), &bounds, &[bounds], Stance::AsMade, scale)
    }

    pub(super) fn decide(&mut self, pick: &mut Pick<'a>, special: bool) {
        let suits = match &pick.body {
            Body::Form(facts) => facts.form.glass,
            Body::Asset(asset) => match &asset.body {
                AssetBody::Object { parts, .. } => !parts.is_empty() && parts.iter().all(|p| p.closed),
                AssetBody::Hdri { .. } => false,
            },
        };
        pick.special = special;
        pick.glass = special && suits && self.glassy();
        pick.set = self.new_set();
    }

    /// Puts a thing on a surface at `[x, z]` metres from its middle, turned by `yaw`; none if it cannot stand there.
    pub fn put(&mut self, pick: &Pick<'a>, on: &Surface, at: [f64; 2], yaw: f64) -> Option<usize> {
        let turn = if yaw == 0.0 { on.turn } else { Turn::new(yaw).after(on.turn) };
        let [x, _, z] = on.point(at);
        self.put_at(pick, on, [x, z], turn)
    }

    /// Puts a thing on a surface at a place of the world.
    pub fn put_at(&mut self, pick: &Pick<'a>, on: &Surface, at: [f64; 2], turn: Turn) -> Option<usize> {
        let (middle, half) = pick.foot;
        let off = turn.apply(middle);
        let foot = [at[0] + off[0], at[1] + off[1]];
        if pick.size[1] > on.clearance || !on.holds(foot, turn, half) {
            return None;
        }
        let ground = on.ground(foot, turn, half)?;
        match on.relief {
            // On uneven ground a thing goes in as deep as its lowest side asks for.
            Some(_) if ground[1] - ground[0] > 0.4 * pick.size[1] => None,
            Some(_) => self.settle(pick, [at[0], ground[0] - 0.005, at[1]], turn, Rest::Rooted),
            None => self.settle(pick, [at[0], ground[0] + GAP, at[1]], turn, Rest::Stands),
        }
    }

    /// Sets a thing down if nothing is in its way.
    pub(super) fn settle(&mut self, pick: &Pick<'a>, at: Vec3, turn: Turn, rest: Rest) -> Option<usize> {
        if self.things.len() >= self.most {
            return None;
        }
        let at = at.map(|v| (v * 1e5).round() / 1e5);
        let solids: Vec<Solid> = pick.solids.iter().map(|s| Solid::of(s, turn, at)).collect();
        if !self.world.free(&solids) {
            return None;
        }
        let first = self.world.solids.len();
        let mut bounds = Aabb::EMPTY;
        solids.iter().for_each(|s| bounds = bounds.union(&s.bounds()));
        self.world.solids.extend(solids);
        let mut to_world = compose(&turn.map(at), &pick.local);
        for row in &mut to_world {
            for v in row.iter_mut() {
                *v = (*v * 1e6).round() / 1e6 + 0.0;
            }
        }
        let tops = match &pick.body {
            Body::Form(facts) if pick.local[0][0] == 1.0 && pick.local[1][1] == 1.0 => facts
                .tops
                .iter()
                .map(|t| Surface { turn, ..Surface::flat(apply(&to_world, t.center), t.half, t.clearance) })
                .collect(),
            _ => Vec::new(),
        };
        self.things.push(Thing {
            body: pick.body.clone(),
            to_world,
            rest,
            special: pick.special,
            glass: pick.glass,
            main: false,
            set: pick.set,
            power: None,
            solids: first..self.world.solids.len(),
            tops,
            bounds,
        });
        Some(self.things.len() - 1)
    }

    /// Chooses a thing and puts it at a place.
    pub fn place(&mut self, ask: &Ask, on: &Surface, at: [f64; 2], yaw: f64) -> Option<usize> {
        let pick = self.pick(ask)?;
        self.put(&pick, on, at, yaw)
    }
}
