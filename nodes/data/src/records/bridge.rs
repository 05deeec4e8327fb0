//! The bridge between rungs: the images at its stops, and the tables that `bridge_validation` makes of them.

use super::{Claim, Estimate, Refined, RefinedImages, estimate::infinite, has_intervals};
use crate::{
    DataError, SamplerKind,
    time::{INDEPENDENT_EXPONENT, VarianceTime, is_unsaid_exponent, unsaid_exponent},
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Artifact, Context, Digest, Handle, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json,
};

/// The results of `bridge_validation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bridge {
    /// Last sample count of the training ladder.
    pub n_max: u64,
    /// Number of scenes.
    pub scenes: u64,
    /// Number of groups of them that intervals are over; none where each scene stands for itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groups: Option<u64>,
    /// Space, output and features of the solvers, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub setting: BTreeMap<String, String>,
    /// One for each kind of stop (adjacent, direct), method and k.
    pub rows: Vec<BridgeRow>,
    /// Mean over all cases of a kind of stop, by method.
    pub summary: Vec<BridgeSummary>,
    /// Claims about solvers between rungs, tested against these figures.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub claims: Vec<Claim>,
    /// Every case.
    pub cases: Vec<BridgeCase>,
}

impl Bridge {
    /// Whether its means have intervals.
    pub fn has_intervals(&self) -> bool {
        has_intervals(self.scenes, self.groups)
    }
}

/// Mean over scenes at one stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeRow {
    /// `adjacent` (k -> k + 1) or `direct` (k -> the last).
    pub stop: String,
    /// The name of a [`BridgeMethod`](crate::methods::BridgeMethod), such as `mc_noise`.
    pub method: String,
    /// Sample count before.
    pub from_spp: u64,
    /// Sample count after.
    pub to_spp: u64,
    /// The fraction (tau_m - tau_k)/(1 - tau_k) of the way.
    pub fraction: f64,
    /// PSNR against the real I_m, linear.
    pub psnr: Estimate,
    /// Paired difference to hold.
    pub gain: Estimate,
    /// Variance and covariance by the held-out references; none without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moments: Option<MomentsRow>,
}

/// Second moments at a stop against those of the real rung, both around the held-out reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MomentsRow {
    /// Variance of the image, in units of sigma^2/m: 1 by the law.
    pub variance: Estimate,
    /// Variance of the real rung in these units.
    pub real_variance: Estimate,
    /// Ratio of both, less 1: the excess of variance.
    pub excess: Estimate,
    /// Covariance of the image with I_k, in units of sigma^2/m: 1 by the law.
    pub covariance: Estimate,
    /// Covariance of the real rung with I_k in these units.
    pub real_covariance: Estimate,
    /// Ratio of both, less 1.
    pub covariance_excess: Estimate,
}

/// Second moments of an image of a scene, as in [`MomentsRow`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// Variance of the image.
    pub variance: f64,
    /// Variance of the real rung.
    pub real_variance: f64,
    /// Covariance of the image with I_k.
    pub covariance: f64,
    /// Covariance of the real rung with I_k.
    pub real_covariance: f64,
}

/// Mean over all cases of a kind of stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeSummary {
    /// `adjacent` or `direct`.
    pub stop: String,
    /// The method.
    pub method: String,
    /// Number of cases.
    pub cases: u64,
    /// PSNR against the real I_m, linear.
    pub psnr: Estimate,
    /// Paired difference to hold.
    pub gain: Estimate,
    /// Share of cases that are better than hold.
    pub better: f64,
}

/// One scene at one stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeCase {
    /// The scene's item key.
    pub scene: String,
    /// `adjacent` or `direct`.
    pub stop: String,
    /// The method.
    pub method: String,
    /// Sample count before.
    pub from_spp: u64,
    /// Sample count after.
    pub to_spp: u64,
    /// PSNR against the real I_m, linear.
    #[serde(with = "infinite")]
    pub psnr: f64,
    /// Cosine between the update that was made and the real one, I_m - I_k; none for hold, which makes none.
    pub direction: Option<f64>,
    /// Second moments by the held-out reference; none without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moments: Option<Moments>,
}

const TABLES: &str = "bridge.json";
const CASES: &str = "cases.csv";
const MAPS: &str = "maps/";

/// The output of `bridge_validation`: tables, all cases as CSV, and maps as PNG, by name below `maps/`.
#[derive(Clone, Debug, PartialEq)]
pub struct BridgeFiles {
    /// The tables.
    pub bridge: Bridge,
    /// Every case, one a line.
    pub cases_csv: Vec<u8>,
    /// Pictures by scene and stop, such as `L0-open-000003/adjacent-01.png`.
    pub maps: BTreeMap<String, Vec<u8>>,
}

impl BridgeFiles {
    /// The tables, without the pictures.
    ///
    /// # Errors
    /// If the blob is missing or damaged.
    pub fn bridge(ctx: &Context<'_>, artifact: Handle<'_, Self>) -> Result<Bridge, KindError> {
        ctx.json(artifact.artifact(), TABLES)
    }

    /// Writes it as files, as [`Media::export`] does.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        to.put(TABLES, &pretty_json(&self.bridge)?)?;
        to.put(CASES, &self.cases_csv)?;
        self.maps.iter().try_for_each(|(name, png)| to.put(&format!("{MAPS}{name}"), png))
    }

    /// The tables and every case, with maps that are in the store already, by their names.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn of_stored(
        ctx: &Context<'_>,
        bridge: &Bridge,
        cases_csv: &[u8],
        maps: impl IntoIterator<Item = (String, Digest)>,
    ) -> Result<Stored<Self>, KindError> {
        let own = [(TABLES.to_owned(), ctx.put_json(bridge)?), (CASES.to_owned(), ctx.put(cases_csv)?)];
        let maps = maps.into_iter().map(|(name, digest)| (format!("{MAPS}{name}"), digest));
        Ok(Stored::tree(own.into_iter().chain(maps)))
    }
}

impl Media for BridgeFiles {
    const NAME: &'static str = "tauflow/bridge";
    const DOC: &'static str = "Tables of a bridge, every case, and maps: `bridge.json`, `cases.csv`, `maps/*.png`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let mut maps = BTreeMap::new();
        for (name, digest) in artifact.parts.iter() {
            if let Some(short) = name.strip_prefix(MAPS) {
                maps.insert(short.to_owned(), ctx.get(digest)?);
            }
        }
        Ok(Self { bridge: ctx.json(artifact, TABLES)?, cases_csv: ctx.part(artifact, CASES)?, maps })
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let map = |(name, png): (&String, &Vec<u8>)| Ok((name.clone(), ctx.put(png)?));
        let maps = self.maps.iter().map(map).collect::<Result<Vec<_>, KindError>>()?;
        Self::of_stored(ctx, &self.bridge, &self.cases_csv, maps)
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        Self::load(ctx, artifact)?.write(to)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let mut maps = BTreeMap::new();
        for name in from.names()? {
            if let Some(short) = name.strip_prefix(MAPS) {
                maps.insert(short.to_owned(), from.need(&name)?);
            }
        }
        let bridge = parse_json(TABLES, &from.need(TABLES)?)?;
        Self { bridge, cases_csv: from.need(CASES)?, maps }.store(ctx)
    }
}

/// First and last sample counts of the ladder that the solvers of a bridge were trained on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeClock {
    /// First sample count.
    pub n_min: u64,
    /// Last sample count.
    pub n_max: u64,
    /// The exponent alpha of the error, which falls with n^-alpha.
    #[serde(default = "unsaid_exponent", skip_serializing_if = "is_unsaid_exponent")]
    pub exponent: f64,
}

impl BridgeClock {
    /// The ends of independent samples.
    pub const fn new(n_min: u64, n_max: u64) -> Self {
        Self { n_min, n_max, exponent: INDEPENDENT_EXPONENT }
    }

    /// The ends of a clock.
    pub fn of(clock: &VarianceTime) -> Self {
        Self { n_min: clock.n_min() as u64, n_max: clock.n_max() as u64, exponent: clock.exponent() }
    }

    /// The clock.
    ///
    /// # Errors
    /// As [`VarianceTime::new`] and [`VarianceTime::with_exponent`].
    pub fn time(&self) -> Result<VarianceTime, DataError> {
        VarianceTime::new(self.n_min, self.n_max)?.with_exponent(self.exponent)
    }
}

const CLOCK: &str = "bridge.json";
const SETTING: &str = "setting.json";

/// The output of `bridge_refinement` for a scene: the images at every stop, and the clock.
#[derive(Clone, Debug, PartialEq)]
pub struct BridgeSteps {
    /// The clock.
    pub clock: BridgeClock,
    /// Space, output and features of the solvers, by name.
    pub setting: BTreeMap<String, String>,
    /// The images.
    pub images: RefinedImages,
}

impl Media for BridgeSteps {
    const NAME: &'static str = "tauflow/bridge-steps";
    const DOC: &'static str = "Images at the stops of a bridge, as EXR and PNG; `bridge.json` is its clock, \
        `setting.json` the solvers' setting.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let Refined { images, .. } = Refined::load_tree(ctx, artifact)?;
        Ok(Self { clock: ctx.json(artifact, CLOCK)?, setting: ctx.json(artifact, SETTING)?, images })
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let mut parts = Refined::parts(ctx, &self.images, (None, SamplerKind::Independent))?;
        parts.push((CLOCK.to_owned(), ctx.put_json(&self.clock)?));
        parts.push((SETTING.to_owned(), ctx.put_json(&self.setting)?));
        Ok(Stored::tree(parts))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let steps = Self::load(ctx, artifact)?;
        to.put(CLOCK, &pretty_json(&steps.clock)?)?;
        to.put(SETTING, &pretty_json(&steps.setting)?)?;
        Refined { images: steps.images, note: None, ..Default::default() }.write(to)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let clock = parse_json(CLOCK, &from.need(CLOCK)?)?;
        let setting = parse_json(SETTING, &from.need(SETTING)?)?;
        Self { clock, setting, images: Refined::read(from)?.images }.store(ctx)
    }
}
