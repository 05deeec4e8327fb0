//! Which forms, assets and environment a scene may use: the procedural library and connected assets.
//!
//! **Coverage.** Assets take turns instead of being drawn: the main object of content `index` of a stratum is asset
//! number `ordinal * q + index` of a fixed order, where `ordinal` numbers the twelve strata and
//! `q = ceil(assets / 12)`. 12 q contents over all strata therefore show every object, and a single stratum shows all
//! of them in the same number of contents. Further things of a layout are drawn from the assets with `asset_share`.
//! HDRIs go in turns over L0 and L1 under an environment and in the open in the same way; L2 takes soft ones and L3
//! sunny ones, where there are any.
//!
//! **Hold-out.** A held-out pool is parted by name, before scenes are built: the names in the order of their hashes,
//! the first `test_share` of them (at least one) for testing. Exhibits ([`shown`]) are split by form, and furniture by
//! variants, because rooms need chairs on both sides. Skies are parted by sort.

use super::params::{HoldOut, SceneGenerationParams};
use tauflow_contract::{Context, Digest, Items, KindError};
use tauflow_data::{
    ContextClass, Regime, Stratum,
    records::{Asset, AssetBody},
    rng::Stream,
    scene::Side,
};
use tauflow_scene_library::{
    forms::{Family, Form, forms},
    skies::{self, Light, SKIES},
};

/// True for families whose forms a scene shows rather than needs: a held-out pool is parted by their forms, and
/// assets may stand in for them.
pub fn shown(family: Family) -> bool {
    matches!(
        family,
        Family::Vessel
            | Family::Food
            | Family::Sculpture
            | Family::Toy
            | Family::Ornament
            | Family::Instrument
            | Family::MachinePart
            | Family::Tool
            | Family::Solid
            | Family::Rock
    )
}

/// An environment of a scene.
pub enum Sky<'a> {
    /// A variant of a procedural sky.
    Procedural(&'static skies::Sky, u64),
    /// An HDRI: asset, image, mean luminance.
    Hdri(&'a Asset, Digest, f64),
}

impl Sky<'_> {
    /// The name it has in a recipe.
    pub fn name(&self) -> String {
        match self {
            Self::Procedural(sky, variant) => format!("procedural/{}-{variant:02}", sky.name),
            Self::Hdri(asset, ..) => asset.name.clone(),
        }
    }
}

/// All connected assets, in the order of their names' hashes.
#[derive(Default)]
pub struct Pool {
    objects: Vec<Asset>,
    hdris: Vec<Asset>,
}

/// The environments that are no skies.
const STUDIOS: [&str; 4] = ["softboxes", "spotlit", "tent", "windows"];

/// Share of light in the brightest thousandth of the sphere from which an HDRI counts as sunny.
const SUNNY: f64 = 0.25;

fn hashed(name: &str) -> [u8; 32] {
    Digest::of(name.as_bytes()).hash
}

impl Pool {
    /// Reads every asset of a collection.
    ///
    /// # Errors
    /// If a blob is missing or damaged.
    pub fn load(ctx: &Context<'_>, assets: Items<'_, Asset>) -> Result<Self, KindError> {
        let mut pool = Self::default();
        for (_, asset) in assets.iter() {
            let asset = asset.load(ctx)?;
            match asset.body {
                AssetBody::Object { .. } => pool.objects.push(asset),
                AssetBody::Hdri { .. } => pool.hdris.push(asset),
            }
        }
        pool.objects.sort_by_key(|a| hashed(&a.name));
        pool.hdris.sort_by_key(|a| hashed(&a.name));
        Ok(pool)
    }
}

/// The part of `all` (in the order of its names' hashes) that belongs to a side.
fn side_of<'a, T>(
    all: impl Iterator<Item = &'a T>,
    name: impl Fn(&T) -> &str,
    side: Option<Side>,
    share: f64,
) -> Vec<&'a T> {
    let mut all: Vec<&T> = all.collect();
    let Some(side) = side else { return all };
    all.sort_by_key(|t| hashed(name(t)));
    if all.len() < 2 {
        // Nothing to part: a single asset is for learning.
        return if side == Side::Train { all } else { Vec::new() };
    }
    let test = ((all.len() as f64 * share).round() as usize).clamp(1, all.len() - 1);
    match side {
        Side::Test => all[..test].to_vec(),
        Side::Train => all[test..].to_vec(),
    }
}

/// The assets available to a scene.
pub struct Cast<'a> {
    stratum: Stratum,
    /// The params of the generator.
    pub params: &'a SceneGenerationParams,
    /// Side of the asset pools, if any is held out.
    pub side: Option<Side>,
    /// The content's index among those of its stratum and side.
    index: u64,
    forms: Vec<&'static Form>,
    objects_side: Option<Side>,
    objects: Vec<&'a Asset>,
    skies: Vec<&'static skies::Sky>,
    hdris: Vec<&'a Asset>,
}

impl<'a> Cast<'a> {
    /// The cast of the `index`-th content of a stratum.
    ///
    /// If assets are held out, content `index` is for testing if `floor((index + 1) share) > floor(index share)`.
    pub fn new(pool: &'a Pool, params: &'a SceneGenerationParams, stratum: Stratum, index: u64) -> Self {
        let share = params.test_share;
        let tests_before = |i: u64| (i as f64 * share).floor() as u64;
        let (side, within) = if params.hold_out.is_empty() {
            (None, index)
        } else if tests_before(index + 1) > tests_before(index) {
            (Some(Side::Test), tests_before(index))
        } else {
            (Some(Side::Train), index - tests_before(index))
        };
        let objects_side = side.filter(|_| params.hold_out.contains(&HoldOut::Objects));
        let skies_side = side.filter(|_| params.hold_out.contains(&HoldOut::Environments));
        // Forms that glass suits are parted apart from the others, so that every regime keeps some on both sides;
        // skies likewise by how concentrated their light is.
        let mut chosen: Vec<&'static Form> = [true, false]
            .into_iter()
            .flat_map(|glass| {
                let all = forms().iter().filter(move |f| shown(f.family) && f.glass == glass);
                side_of(all, |f| f.name, objects_side, share)
            })
            .chain(forms().iter().filter(|f| !shown(f.family)))
            .collect();
        chosen.sort_by_key(|f| f.name);
        let skies = [Light::Soft, Light::Mixed, Light::Sun]
            .into_iter()
            .flat_map(|light| side_of(SKIES.iter().filter(|s| s.light == light), |s| s.name, skies_side, share))
            .collect();
        Self {
            stratum,
            params,
            side,
            index: within,
            forms: chosen,
            objects_side,
            objects: side_of(pool.objects.iter(), |a| &a.name, objects_side, share),
            skies,
            hdris: side_of(pool.hdris.iter(), |a| &a.name, skies_side, share),
        }
    }

    /// The forms that fit, in order of name.
    pub fn forms(&self, fits: impl Fn(&Form) -> bool) -> Vec<&'static Form> {
        self.forms.iter().filter(|f| fits(f)).copied().collect()
    }

    /// A variant of a form, of this library and of the scene's side.
    pub fn variant(&self, form: &Form, draw: &mut Stream) -> u64 {
        let count = form.variants;
        let Some(side) = self.objects_side.filter(|_| !shown(form.family) && count > 1) else {
            return self.params.variant(draw, count);
        };
        let tests = ((count as f64 * self.params.test_share).round() as u64).clamp(1, count - 1);
        let (first, many) = if side == Side::Test { (0, tests) } else { (tests, count - tests) };
        self.params.library * count + first + draw.below(many as usize) as u64
    }

    /// The asset whose turn it is, if any are connected.
    pub fn turn(&self) -> Option<&'a Asset> {
        let n = self.objects.len() as u64;
        let ordinal = Stratum::all().position(|s| s == self.stratum).unwrap_or(0) as u64;
        (n > 0).then(|| self.objects[((ordinal * n.div_ceil(12) + self.index) % n) as usize])
    }

    /// An asset that stands in for a thing, now and then.
    pub fn stand_in(&self, draw: &mut Stream) -> Option<&'a Asset> {
        (!self.objects.is_empty() && draw.part("asset").chance(self.params.asset_share))
            .then(|| *draw.part("which").pick(&self.objects))
    }

    /// A sky to be seen through windows: never one with a small sun.
    pub fn outside(&self, draw: &mut Stream) -> (&'static skies::Sky, u64) {
        let soft: Vec<&'static skies::Sky> =
            self.skies.iter().filter(|s| s.light == Light::Soft && !STUDIOS.contains(&s.name)).copied().collect();
        let sky = if soft.is_empty() { self.skies[draw.below(self.skies.len())] } else { soft[draw.below(soft.len())] };
        (sky, self.params.variant(draw, skies::VARIANTS))
    }

    /// The environment of a scene; none in rooms. Studios are for scenes in a `studio` alone.
    pub fn sky(&self, draw: &mut Stream, studio: bool) -> Option<Sky<'a>> {
        let stratum = self.stratum;
        let context = match stratum.context {
            ContextClass::Environment => 0,
            ContextClass::Open => 1,
            ContextClass::Enclosed => return None,
        };
        let outdoors = stratum.context == ContextClass::Environment;
        let top = |a: &Asset| if let AssetBody::Hdri { top_share, .. } = a.body { top_share } else { 0.0 };
        let fits: Vec<&'a Asset> = match stratum.regime {
            Regime::L0 | Regime::L1 => self.hdris.clone(),
            Regime::L2 => self.hdris.iter().filter(|a| top(a) < SUNNY).copied().collect(),
            // In the open the lamps make the caustics, and the sky had better be soft.
            Regime::L3 => self.hdris.iter().filter(|a| (top(a) >= SUNNY) == outdoors).copied().collect(),
        };
        if !fits.is_empty() {
            let turn = match stratum.regime {
                Regime::L0 => context,
                Regime::L1 => 2 + context,
                Regime::L2 | Regime::L3 => context,
            };
            let n = fits.len() as u64;
            let asset = fits[((turn * n.div_ceil(4) + self.index) % n) as usize];
            if let AssetBody::Hdri { image, mean, .. } = asset.body {
                return Some(Sky::Hdri(asset, image, mean));
            }
        }
        let light = match (stratum.regime, outdoors) {
            (Regime::L0 | Regime::L1, _) => None,
            (Regime::L3, true) => Some(Light::Sun),
            (Regime::L2, _) | (Regime::L3, false) => Some(Light::Soft),
        };
        let fits: Vec<&'static skies::Sky> =
            self.skies.iter().filter(|s| light.is_none_or(|light| s.light == light)).copied().collect();
        let fits = if fits.is_empty() { self.skies.clone() } else { fits };
        let placed: Vec<&'static skies::Sky> =
            fits.iter().filter(|s| studio == STUDIOS.contains(&s.name)).copied().collect();
        let fits = if placed.is_empty() { fits } else { placed };
        let sky = fits[draw.below(fits.len())];
        Some(Sky::Procedural(sky, self.params.variant(draw, skies::VARIANTS)))
    }
}
