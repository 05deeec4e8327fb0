//! Which objects and which environment a scene gets: from the procedural library and from connected assets.
//!
//! **Coverage.** Assets take turns instead of being drawn: the main object of the `index`-th scene of a stratum is
//! asset number `ordinal * q + index` of a fixed order, where `ordinal` numbers the twelve strata and
//! `q = ceil(assets / 12)`. So 12 q scenes spread over all strata show every object, and any one stratum shows all
//! of them in as many scenes. HDRIs go in turns over L0 and L1 under an environment and in the open in the same way;
//! L2 takes soft ones and L3 sunny ones, where there are any.
//!
//! **Hold-out.** A held-out pool is parted by name, before scenes are built: the names in the order of their hashes,
//! the first `test_share` of them (at least one) for testing. Procedural objects are parted by form, skies by sort.

use super::{
    forms::{FORMS, Form},
    params::{HoldOut, SceneGenerationParams},
    skies::{self, Light, SKIES},
};
use tauflow_contract::{Context, Digest, Items, KindError};
use tauflow_data::{
    ContextClass, Regime, Stratum,
    records::{Asset, AssetBody},
    rng::Stream,
    scene::Side,
};

/// An object of a scene.
#[derive(Clone, Copy)]
pub enum Choice<'a> {
    /// A variant of a form.
    Form(&'static Form, u64),
    /// An asset.
    Asset(&'a Asset),
}

impl Choice<'_> {
    /// The name it has in a recipe.
    pub fn name(&self) -> String {
        match self {
            Self::Form(form, variant) => format!("procedural/{}-{variant:02}", form.name),
            Self::Asset(asset) => asset.name.clone(),
        }
    }

    /// True if every part encloses a volume and glass suits it.
    pub fn glass(&self) -> bool {
        match self {
            Self::Form(form, _) => form.glass,
            Self::Asset(asset) => match &asset.body {
                AssetBody::Object { parts, .. } => !parts.is_empty() && parts.iter().all(|p| p.closed),
                AssetBody::Hdri { .. } => false,
            },
        }
    }
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

/// What a scene may draw from.
pub struct Cast<'a> {
    stratum: Stratum,
    params: &'a SceneGenerationParams,
    /// Side of the asset pools, if any is held out.
    pub side: Option<Side>,
    /// The scene's index among those of its stratum and side.
    index: u64,
    forms: Vec<&'static Form>,
    objects: Vec<&'a Asset>,
    skies: Vec<&'static skies::Sky>,
    hdris: Vec<&'a Asset>,
}

impl<'a> Cast<'a> {
    /// The cast of the `index`-th scene of a stratum.
    ///
    /// With a hold-out, scene `index` is for testing if `floor((index + 1) share) > floor(index share)`.
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
        let forms = [true, false]
            .into_iter()
            .flat_map(|glass| side_of(FORMS.iter().filter(|f| f.glass == glass), |f| f.name, objects_side, share))
            .collect();
        let skies = [Light::Soft, Light::Mixed, Light::Sun]
            .into_iter()
            .flat_map(|light| side_of(SKIES.iter().filter(|s| s.light == light), |s| s.name, skies_side, share))
            .collect();
        Self {
            stratum,
            params,
            side,
            index: within,
            forms,
            objects: side_of(pool.objects.iter(), |a| &a.name, objects_side, share),
            skies,
            hdris: side_of(pool.hdris.iter(), |a| &a.name, skies_side, share),
        }
    }

    fn form(&self, draw: &mut Stream, glass: bool) -> Choice<'a> {
        let fits: Vec<&'static Form> = self.forms.iter().filter(|f| f.glass || !glass).copied().collect();
        let form = fits[draw.below(fits.len())];
        Choice::Form(form, self.params.variant(draw, form.variants))
    }

    /// The objects of a scene, the main one first. In L2 and L3 at least one of them suits glass: a procedural form
    /// joins an asset that does not.
    pub fn objects(&self, draw: &Stream, count: usize) -> Vec<Choice<'a>> {
        let glassy = matches!(self.stratum.regime, Regime::L2 | Regime::L3);
        let ordinal = Stratum::all().position(|s| s == self.stratum).unwrap_or(0) as u64;
        let mut chosen = Vec::new();
        for slot in 0..count {
            let mut d = draw.part(&format!("object.{slot}"));
            let asset = if self.objects.is_empty() {
                None
            } else if slot == 0 {
                let n = self.objects.len() as u64;
                Some(self.objects[((ordinal * n.div_ceil(12) + self.index) % n) as usize])
            } else {
                d.part("asset").chance(self.params.asset_share).then(|| *d.part("which").pick(&self.objects))
            };
            chosen.push(match asset {
                Some(asset) => Choice::Asset(asset),
                None => self.form(&mut d, glassy && slot == 0),
            });
        }
        if glassy && !chosen.iter().any(Choice::glass) {
            let extra = self.form(&mut draw.part("glass"), true);
            if chosen.len() > 1 { chosen[1] = extra } else { chosen.push(extra) }
        }
        chosen
    }

    /// The environment of a scene; none in rooms.
    pub fn sky(&self, draw: &mut Stream) -> Option<Sky<'a>> {
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
        let sky = fits[draw.below(fits.len())];
        Some(Sky::Procedural(sky, self.params.variant(draw, skies::VARIANTS)))
    }
}
